//! Tune: a controller designed with deviations, previewed by the agent's own library, pushed, and measured.

mod book;
mod editor;
mod outlook;

use std::time::Duration;

use leptos::{leptos_dom::helpers::TimeoutHandle, prelude::*};
use plumbline_rest::design::{Controller, Controllers, Design, Gains, Preview, Question, Steps};
use serde_json::json;

use crate::{
    ctx::{Ctx, ctx},
    model::live::Live,
    model::tuning::{self, Draft},
    net,
    panel::envelope::EnvelopeBeside,
};
use book::Book;
use editor::Editor;
use outlook::{Loops, Responses};

/// A preview is asked for when the design has stood still this long.
const SETTLE: Duration = Duration::from_millis(250);
/// Steps are previewed this long, s.
const DURATION_S: f64 = 6.0;
/// Altitude step previewed while none was measured, m.
const STEP_M: f64 = 0.5;
/// Yaw step previewed, rad.
const YAW_STEP_RAD: f64 = 0.35;

/// What the parts of the page share.
#[derive(Clone, Copy)]
struct Bench {
    ctx: Ctx,
    /// Controllers there are.
    kinds: RwSignal<Vec<Controller>>,
    /// The design being made.
    draft: RwSignal<Option<Draft>>,
    /// What the vehicle says of its gains.
    book: RwSignal<Gains>,
    /// Answer to the newest question that was answered.
    preview: RwSignal<Option<Result<Preview, String>>>,
    /// Does it belong to the design as it is now?
    fresh: RwSignal<bool>,
    asked: StoredValue<u64>,
}

impl Bench {
    /// Part of an address that names the vehicle.
    fn vehicle_path(self) -> Option<String> {
        let vehicle = self.ctx.app.with_value(|app| app.vehicle.clone());
        vehicle.map(|id| String::from(js_sys::encode_uri_component(&id)))
    }

    /// The query that names it; empty without one.
    fn query(self) -> String {
        self.vehicle_path().map_or_else(String::new, |id| format!("?vehicle={id}"))
    }

    /// Controllers with the defaults of this vehicle, then what is in use; the draft begins as that.
    fn load(self) {
        let query = self.query();
        leptos::task::spawn_local(async move {
            let mut kinds =
                net::json::<Controllers>("GET", &format!("/api/v1/design/controllers{query}"), None, "").await;
            if kinds.is_err() {
                // A vehicle that has not described itself yet: the default airframe.
                kinds = net::json("GET", "/api/v1/design/controllers", None, "").await;
            }
            match kinds {
                Ok(kinds) => {
                    let _ = self.kinds.try_set(kinds.controllers);
                }
                Err(failure) => {
                    let _ = self.preview.try_set(Some(Err(failure.text)));
                    let _ = self.fresh.try_set(true);
                    return;
                }
            }
            self.reload_book().await;
            if self.draft.try_with_untracked(Option::is_none) == Some(true) {
                self.take_in_use();
            }
        });
    }

    async fn reload_book(self) {
        let Some(id) = self.vehicle_path() else { return };
        if let Ok(book) = net::json::<Gains>("GET", &format!("/api/v1/vehicles/{id}/gains"), None, "").await {
            let _ = self.book.try_set(book);
        }
    }

    /// The draft becomes what is in use, or the defaults where nothing is known.
    fn take_in_use(self) {
        let design = self.book.try_with_untracked(tuning::in_use).flatten();
        let kinds = self.kinds.try_get_untracked().unwrap_or_default();
        let made = design.and_then(|design| Draft::of(&design, &kinds).ok());
        let _ = self.draft.try_set(made.or_else(|| kinds.first().map(Draft::default_of)));
    }

    /// What is in use, as a draft of the same controller; `None` where it is another one or not known.
    fn used(self) -> Option<Draft> {
        let name = self.draft.with(|d| d.as_ref().map(|d| d.controller.clone()))?;
        let design = self.book.with(tuning::in_use)?;
        let used = self.kinds.with(|kinds| Draft::of(&design, kinds)).ok()?;
        (used.controller == name).then_some(used)
    }

    /// The kind of the draft.
    fn kind(self) -> Option<Controller> {
        let name = self.draft.with(|d| d.as_ref().map(|d| d.controller.clone()))?;
        self.kinds.with(|all| all.iter().find(|k| k.controller == name).cloned())
    }

    /// Changes the draft.
    fn change(self, change: impl FnOnce(&mut Draft)) {
        self.draft.update(|draft| {
            if let Some(draft) = draft {
                change(draft);
            }
        });
    }

    /// Asks what the draft would do.
    fn ask(self) {
        let Some(draft) = self.draft.get_untracked() else { return };
        let number = self.asked.get_value() + 1;
        self.asked.set_value(number);
        let z_m = Some(self.ctx.live.with_value(Self::measured_size).unwrap_or(STEP_M));
        let question = Question {
            design: draft.design(),
            step: Steps { z_m, yaw_rad: Some(YAW_STEP_RAD), ..Steps::default() },
            duration_s: Some(DURATION_S),
        };
        let query = self.query();
        leptos::task::spawn_local(async move {
            let url = format!("/api/v1/design/preview{query}");
            let answer = net::json::<Preview>("POST", &url, Some(json!(question).to_string()), "").await;
            // An older question's answer says nothing about the draft of now.
            if self.asked.try_get_value() != Some(number) {
                return;
            }
            let _ = self.preview.try_set(Some(answer.map_err(|failure| failure.text)));
            let _ = self.fresh.try_set(true);
        });
    }

    /// Size of the newest altitude step measured in this flight, m.
    fn measured_size(live: &Live) -> Option<f64> {
        live.log.steps.back().map(|s| s.to_m - s.from_m).filter(|s| s.abs() >= 0.05)
    }

    /// Sends a request about the gains of this vehicle; afterwards the book is read again.
    fn send(self, what: String, method: &'static str, action: &'static str, body: serde_json::Value) {
        self.ctx.command_then(what, method, action, body, move |answer| {
            let done = answer.is_ok();
            leptos::task::spawn_local(async move {
                self.reload_book().await;
                if done {
                    // The change against what is in use is another now.
                    self.ask();
                }
            });
        });
    }
}

/// The Tune page.
#[component]
pub fn Tune() -> impl IntoView {
    let ctx = ctx();
    let bench = Bench {
        ctx,
        kinds: RwSignal::new(Vec::new()),
        draft: RwSignal::new(None),
        book: RwSignal::new(Gains::default()),
        preview: RwSignal::new(None),
        fresh: RwSignal::new(false),
        asked: StoredValue::new(0),
    };
    provide_context(bench);
    // Another vehicle is another design.
    let vehicle = Memo::new(move |_| ctx.app(|app| app.vehicle.clone()));
    Effect::new(move |_| {
        vehicle.get();
        bench.draft.set(None);
        bench.load();
    });
    let waiting = StoredValue::new(None::<TimeoutHandle>);
    // A step that is measured is predicted at its size.
    let measured = Memo::new(move |_| ctx.live(Bench::measured_size));
    Effect::new(move |_| {
        bench.draft.track();
        measured.track();
        bench.fresh.set(false);
        if let Some(handle) = waiting.get_value() {
            handle.clear();
        }
        waiting.set_value(set_timeout_with_handle(move || bench.ask(), SETTLE).ok());
    });
    on_cleanup(move || {
        if let Some(Some(handle)) = waiting.try_get_value() {
            handle.clear();
        }
    });
    // Gains change without this page too: another operator, a refusal, a restart.
    let revision = Memo::new(move |_| ctx.live(|live| live.gains.get().map(|g| (g.revision, g.sha256.clone()))));
    Effect::new(move |before: Option<()>| {
        revision.get();
        if before.is_some() {
            leptos::task::spawn_local(bench.reload_book());
        }
    });
    // Asked once the preview is there: by then the design has stood still.
    let design = Memo::new(move |before: Option<&Option<Design>>| {
        let draft = bench.draft.with(|draft| draft.as_ref().map(Draft::design));
        if bench.fresh.get() { draft } else { before.cloned().flatten() }
    });
    view! {
        <main class="tune" id="main">
            <h1 class="visually-hidden">"Tune"</h1>
            <Editor />
            <div class="tune-centre">
                <Responses />
                <Loops />
            </div>
            <div class="tune-book">
                <Book />
                <EnvelopeBeside design=design.into() />
            </div>
        </main>
    }
}

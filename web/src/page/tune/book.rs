//! Verdict and push; what is in use; revisions and the way back; files.

use leptos::prelude::*;
use plumbline_rest::command as rest;
use plumbline_rest::design::{Design, Revision};
use serde_json::{Value, json};

use super::Bench;
use crate::{
    event::Tone,
    model::{
        format, listing,
        tuning::{Draft, Start, start, title},
    },
    net,
    page::flights::local_offset_min,
    panel::alarms::Guarded,
};

/// Right column of the Tune page.
#[component]
pub(super) fn Book() -> impl IntoView {
    view! {
        <Verdict />
        <Revisions />
    }
}

/// May it fly, and if not, why not.
#[component]
fn Verdict() -> impl IntoView {
    let bench: Bench = expect_context();
    let accepted = Memo::new(move |_| {
        bench.fresh.get() && bench.preview.with(|p| matches!(p, Some(Ok(preview)) if preview.accepted))
    });
    let connected = Memo::new(move |_| bench.ctx.app(|app| app.listed().is_some_and(|v| v.connected)));
    let text = move || {
        if !bench.fresh.get() {
            return ("quiet", "Solving…".to_owned());
        }
        match bench.preview.get() {
            None => ("quiet", "No preview yet".to_owned()),
            Some(Err(why)) => ("bad", format!("Cannot be solved: {why}")),
            Some(Ok(p)) if p.accepted => {
                ("good", "✓ Certified for this vehicle. The agent examines it again before it flies.".to_owned())
            }
            Some(Ok(p)) => ("bad", format!("Refused: {}", p.refusal.unwrap_or_default())),
        }
    };
    let push = move |_| {
        if let Some(draft) = bench.draft.get_untracked() {
            bench.send(format!("Push {}", title(&draft.controller)), "PUT", "gains", json!(draft.design()));
        }
    };
    view! {
        <section class="card verdict" aria-label="Push">
            <header><h2>"Verdict"</h2></header>
            <p class=move || text().0 role="status">{move || text().1}</p>
            <Guarded><button type="button" class="go" disabled=move || !(accepted.get() && connected.get()) on:click=push>"Push to the vehicle"</button></Guarded>
            <p class="quiet">{move || if connected.get() {
                "Applied between two ticks, without a bump; in flight too."
            } else {
                "No vehicle is connected: designs can be previewed and saved."
            }}</p>
        </section>
    }
}

/// Reads a chosen file into the draft.
fn import(bench: Bench, input: web_sys::HtmlInputElement) {
    use wasm_bindgen_futures::JsFuture;
    let Some(file) = input.files().and_then(|files| files.get(0)) else { return };
    leptos::task::spawn_local(async move {
        let text = JsFuture::from(file.text()).await.ok().and_then(|t| t.as_string()).unwrap_or_default();
        let kinds = bench.kinds.get_untracked();
        let read = serde_json::from_str::<Design>(&text)
            .map_err(|e| format!("no design: {e}"))
            .and_then(|design| Draft::of(&design, &kinds));
        match read {
            Ok(draft) => {
                bench.draft.set(Some(draft));
                bench.ctx.tell(Tone::Done, format!("{} read; nothing was pushed", file.name()));
            }
            Err(error) => bench.ctx.tell(Tone::Error, format!("{}: {error}", file.name())),
        }
        // The same file can be chosen again.
        input.set_value("");
    });
}

/// Saves the draft, with what came of it, as a file.
fn export(bench: Bench) {
    let certified =
        bench.preview.with_untracked(|p| p.as_ref().and_then(|p| p.as_ref().ok()).and_then(|p| p.gains.clone()));
    let design = bench.draft.with_untracked(|d| d.as_ref().map(|draft| json!(draft.design())));
    let Some(design) = certified.filter(|_| bench.fresh.get_untracked()).or(design) else { return };
    let text = serde_json::to_string_pretty(&design).unwrap_or_default();
    net::save("gains.json", "application/json", &text);
}

/// Pushes made before, newest first.
#[component]
fn Revisions() -> impl IntoView {
    let bench: Bench = expect_context();
    let in_use = Memo::new(move |_| bench.book.with(|b| (b.revision, b.controller.clone().unwrap_or_default())));
    let rows = move || bench.book.with(|b| b.revisions.iter().rev().take(30).cloned().collect::<Vec<_>>());
    let file = NodeRef::<leptos::html::Input>::new();
    let began = Memo::new(move |_| {
        bench.ctx.live(|live| {
            let begin_s = live.status.get().map_or(0.0, |s| s.flight_start_us as f64 * 1e-6);
            start(&live.log, begin_s, live.status.get().map(|s| s.gains_revision))
        })
    });
    let to_start = move |_| {
        let what = "Back to the gains the flight started with".to_owned();
        match began.get_untracked() {
            Start::Unknown | Start::InUse => {}
            Start::Revision(number) => {
                bench.send(what, "POST", "gains/revert", json!(rest::Which { revision: Some(number) }));
            }
            Start::Configured(design) => bench.send(what, "PUT", "gains", json!(*design)),
        }
    };
    view! {
        <section class="card revisions" aria-label="Gains in use and revisions">
            <header>
                <h2>"In use"</h2>
                <span class="num" aria-label="Gains in use">{move || match in_use.get() {
                    (Some(0), controller) => format!("{}, as configured", title(&controller)),
                    (Some(revision), controller) => format!("{}, revision {revision}", title(&controller)),
                    (None, _) => format::NONE.to_owned(),
                }}</span>
            </header>
            <div class="buttons">
                <button type="button" on:click=move |_| export(bench)>"Save JSON"</button>
                <button type="button" on:click=move |_| {
                    if let Some(input) = file.get_untracked() {
                        input.click();
                    }
                }>"Open JSON…"</button>
                <input type="file" accept=".json,application/json" hidden node_ref=file aria-label="Gains file" on:change:target=move |e| import(bench, e.target()) />
            </div>
            <Guarded>
                <button type="button" class="to-start" disabled=move || matches!(began.get(), Start::Unknown | Start::InUse) on:click=to_start>
                    {move || match began.get() {
                        Start::Unknown => "Start of the flight: not known here",
                        Start::InUse => "As the flight started",
                        Start::Revision(_) | Start::Configured(_) => "Back to the gains the flight started with",
                    }}
                </button>
            </Guarded>
            <div class="table-wrap">
                {move || {
                    let all = rows();
                    if all.is_empty() {
                        return view! { <p class="quiet">"No gains were pushed yet: the vehicle flies those it started with."</p> }.into_any();
                    }
                    let now = in_use.get().0;
                    all.into_iter().map(|r| view! { <Entry entry=r now /> }).collect::<Vec<_>>().into_any()
                }}
            </div>
        </section>
    }
}

#[component]
fn Entry(entry: Revision, now: Option<u32>) -> impl IntoView {
    let bench: Bench = expect_context();
    let number = entry.revision;
    let flying = now == Some(number);
    let accepted = entry.stage == "accepted";
    let revert = move |_| {
        bench.send(
            format!("Revert to revision {number}"),
            "POST",
            "gains/revert",
            json!(rest::Which { revision: Some(number) }),
        )
    };
    let when = listing::when(entry.pushed_unix_us, local_offset_min());
    view! {
        <div class="revision" class:flying=flying>
            <b class="num">{number}</b>
            <span>{title(entry.design.get("controller").and_then(Value::as_str).unwrap_or("lqr_integral"))}</span>
            <span class="quiet num">{when}</span>
            <span class=if accepted { "chip" } else { "chip alert" } title=entry.reason.clone()>{if flying { "in use".to_owned() } else { entry.stage.clone() }}</span>
            {(accepted && !flying).then(|| view! { <Guarded><button type="button" class="small" aria-label=format!("Revert to revision {number}") on:click=revert>"Revert"</button></Guarded> })}
            {(!accepted).then(|| view! { <p class="bad">{entry.reason.clone()}</p> })}
        </div>
    }
}

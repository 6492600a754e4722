//! Flight: one recording, with the charts it was flown with, a scrub bar, and everything known about it.

mod again;
mod detail;
mod facts;
mod reestimate;
mod report;
mod scrub;
mod table;

use leptos::prelude::*;
use plumbline_proto::DecodeError;
use plumbline_rest::flight::{Flight, Labels};
use plumbline_rest::people::Role;
use serde_json::json;

use crate::{
    ctx::{Ctx, Graphics, ctx},
    deck::Deck,
    event::{Failure, Tone},
    keys,
    model::{
        arriving::Arriving,
        format::{self, NONE},
        listing::{self, Part},
        live::Live,
        route::Route,
    },
    net,
    page::flights::local_offset_min,
    panel::{
        alarms::{Guarded, StatusLine},
        charts::Charts,
        cursors::CursorsCard,
        hold::HoldButton,
        horizon::HorizonCard,
        lanes::Lanes,
        layouts,
        readouts::Readouts,
        signals::Messages,
        toolbar::Link,
        top_view::FromAbove,
        waiting::Waiting,
    },
};

pub use detail::WHOLE_S;
use facts::Summary;
pub use report::ReportPage;
use scrub::Scrub;

/// A recording, loaded.
#[derive(Clone)]
enum Loaded {
    Loading,
    Failed(String),
    Ready(Box<Deck>),
}

/// Messages of some kinds of a flight: all, or those that the rest of the query leaves; `told` is told which part of the
/// flight has come, s.
pub async fn load(id: &str, kinds: &str, rest: &str, told: impl Fn(f64)) -> Result<Live, Failure> {
    let unreadable = |error: DecodeError| Failure { status: 0, text: error.to_string() };
    let mut arriving = Arriving::default();
    let url = format!("/api/v1/flights/{id}/frames?kinds={kinds}{rest}");
    net::pieces(&url, |piece| arriving.take(piece).map(&told).map_err(unreadable)).await?;
    arriving.flight().map_err(unreadable)
}

/// The page of one flight.
#[component]
pub fn FlightPage(
    /// Which.
    id: String,
) -> impl IntoView {
    let ctx = ctx();
    let summary = RwSignal::new(None::<Result<Flight, Failure>>);
    let loaded = RwSignal::new(Loaded::Loading);
    let share = RwSignal::new(None::<f64>);
    let owner = Owner::current();
    let url = format!("/api/v1/flights/{id}");
    {
        let (url, id) = (url.clone(), id.clone());
        leptos::task::spawn_local(async move {
            let known = net::json::<Flight>("GET", &url, None, "").await;
            let length_s = known.as_ref().ok().map(|flight| flight.duration_s);
            summary.try_set(Some(known));
            let Some(length_s) = length_s else { return };
            let told = move |covered_s: f64| {
                let _ = share.try_set(Some(covered_s / length_s.max(1e-3)));
            };
            let frames = detail::overview(&id, length_s, told).await;
            // The page may have been left meanwhile: then its signals are gone.
            if loaded.is_disposed() {
                return;
            }
            let made = match (frames, owner) {
                (Ok(live), _) if live.curves.is_empty() => {
                    Loaded::Failed("it holds no message that a chart could show".into())
                }
                (Ok(live), Some(owner)) => Loaded::Ready(Box::new(owner.with(|| Deck::recorded(ctx, live)))),
                (Ok(_), None) => return,
                (Err(failure), _) => Loaded::Failed(failure.text),
            };
            loaded.set(made);
        });
    }
    on_cleanup(move || ctx.deck.set(None));
    let refused = Memo::new(move |_| summary.with(|s| s.as_ref().and_then(|s| s.as_ref().err().cloned())));
    move || match refused.get() {
        Some(failure) if failure.status == 404 => {
            view! { <main class="sheet" id="main"><NoFlight id=id.clone() /></main> }.into_any()
        }
        Some(failure) => view! {
            <main class="sheet" id="main">
                <h1>"The flight cannot be shown"</h1>
                <p role="alert">{failure.text}</p>
                <p><Link to=Route::Flights>"← Flights"</Link></p>
            </main>
        }
        .into_any(),
        None => view! { <Shown id=id.clone() summary loaded share /> }.into_any(),
    }
}

/// What is said of a flight that there is not.
#[component]
fn NoFlight(
    /// As asked for.
    id: String,
) -> impl IntoView {
    view! {
        <h1>"No such flight"</h1>
        <p>"There is no recording " <code>{id}</code> " on this ground. It may have been deleted, or the address is misspelt."</p>
        <p><Link to=Route::Flights>"← All flights"</Link></p>
    }
}

#[component]
fn Shown(
    id: String,
    summary: RwSignal<Option<Result<Flight, Failure>>>,
    loaded: RwSignal<Loaded>,
    share: RwSignal<Option<f64>>,
) -> impl IntoView {
    let ctx = ctx();
    provide_context(RwSignal::new(Part::default()));
    view! {
        <main class="flight-page" id="main">
            <Head id=id.clone() summary />
            {move || match loaded.get() {
                Loaded::Loading => view! { <Waiting text="Loading the recording…" share /> }.into_any(),
                Loaded::Failed(why) => view! {
                    <p class="banner bad" role="alert"><b>"The recording cannot be shown: "</b>{why}". Its files can still be downloaded above."</p>
                }.into_any(),
                Loaded::Ready(deck) => {
                    let deck = *deck;
                    ctx.deck.set(Some(deck));
                    view! { <Player id=id.clone() deck summary /> }.into_any()
                }
            }}
        </main>
    }
}

/// Name, downloads, delete.
#[component]
fn Head(id: String, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    let url = StoredValue::new(format!("/api/v1/flights/{id}"));
    let name = RwSignal::new(String::new());
    Effect::new(move |_| {
        if let Some(Ok(flight)) = summary.get() {
            name.set(flight.title().to_owned());
        }
    });
    let rename =
        move |_| save(ctx, url.get_value(), json!(Labels { name: Some(name.get_untracked()), notes: None }), summary);
    let delete = Callback::new(move |()| {
        let asked_at = keys::pointer();
        leptos::task::spawn_local(async move {
            match net::json::<serde_json::Value>("DELETE", &url.get_value(), None, &ctx.operator()).await {
                Ok(_) => {
                    ctx.tell(Tone::Done, "Flight deleted");
                    ctx.go(Route::Flights);
                }
                Err(failure) => ctx.failed(asked_at, "Delete refused", &failure),
            }
        });
    });
    let facts = move || {
        summary.with(|s| match s {
            Some(Ok(f)) => format!(
                "{} · {} · {} · {}",
                listing::when(f.started_unix_us, local_offset_min()),
                format::clock(f.duration_s),
                if f.rig.is_empty() { NONE } else { &f.rig },
                f.completeness.name()
            ),
            Some(Err(e)) => e.text.clone(),
            None => String::new(),
        })
    };
    // The charts begin where the flight does.
    let stretch = Memo::new(move |_| {
        let deck = ctx.deck.get()?;
        let begin_s = deck.origin_s.get();
        deck.zoom.get().map(|(from_s, to_s)| [(from_s - begin_s).max(0.0), to_s - begin_s])
    });
    let flight = StoredValue::new(id.clone());
    let tables: RwSignal<Part> = expect_context();
    let part = Memo::new(move |_| Part { stretch_s: stretch.get(), ..tables.get() });
    let meant = move || Some(part.with(Part::name)).filter(|name| !name.is_empty());
    view! {
        <h1 class="visually-hidden">{move || format!("Flight {}", name.get())}</h1>
        <div class="sheet-head">
            <Link to=Route::Flights>"← Flights"</Link>
            <input
                type="text"
                class="title"
                aria-label="Name of the flight"
                prop:value=name
                on:input:target=move |e| name.set(e.target().value())
                on:change=rename
            />
            <span class="quiet num one-line">{facts}</span>
            <span class="push downloads">
                <Link to=Route::Report(id.clone())>"Report"</Link>
                {move || meant().map(|name| view! {
                    <span class="quiet num one-line" title="Downloads keep to what is zoomed into, tables also to columns and rate of the card Tables; MCAP is the file as recorded">
                        {name} ":"
                    </span>
                })}
                {listing::FORMS.map(|(form, name)| view! {
                    <a class="button" href=move || flight.with_value(|id| part.with(|part| listing::download(id, form, part))) download="">{name}</a>
                })}
            </span>
            <span class="delete"><Guarded takes=Role::Admin><HoldButton label="Delete" class="warn" action=delete /></Guarded></span>
        </div>
    }
}

/// Writes name or notes.
fn save(ctx: Ctx, url: String, body: serde_json::Value, summary: RwSignal<Option<Result<Flight, Failure>>>) {
    let asked_at = keys::pointer();
    leptos::task::spawn_local(async move {
        match net::json::<Flight>("PATCH", &url, Some(body.to_string()), &ctx.operator()).await {
            Ok(flight) => {
                // Told to nobody: the tables would be built anew, and what is being typed into them lost.
                summary.try_update_untracked(|known| *known = Some(Ok(flight)));
                ctx.tell(Tone::Done, "Saved");
            }
            Err(failure) => ctx.failed(asked_at, "Not saved", &failure),
        }
    });
}

/// Charts, scrub bar and summary.
#[component]
fn Player(id: String, deck: Deck, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    provide_context(deck);
    provide_context(Messages::of_flight(id.clone()));
    layouts::begin(deck);
    let reading = detail::follow(deck, id);
    let drawn = Memo::new(move |_| !matches!(ctx.graphics.get(), Graphics::Off(_)));
    view! {
        <div class="fly replay">
            <StatusLine />
            <div class="left">
                <Show when=move || drawn.get()><HorizonCard /></Show>
                <Readouts />
                <FromAbove />
                <CursorsCard />
            </div>
            <div class="centre">
                <Show when=move || drawn.get()>
                    <Lanes />
                    <Charts />
                </Show>
                <Scrub deck reading />
            </div>
            <div class="right"><Summary summary /></div>
        </div>
    }
}

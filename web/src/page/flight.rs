//! Flight: one recording, with the charts it was flown with, a scrub bar, and everything known about it.

use std::time::Duration;

use leptos::{ev, html, prelude::*};
use serde_json::json;

use crate::{
    ctx::{Ctx, Graphics, ctx},
    deck::Deck,
    event::{Failure, Tone},
    model::{
        api::{Flight, FlownAttack, Step},
        format::{self, NONE},
        listing,
        live::Live,
        route::Route,
    },
    net,
    page::flights::local_offset_min,
    panel::{
        charts::{AltitudeChart, AttitudeChart},
        events::Events,
        hold::HoldButton,
        horizon::HorizonCard,
        motors::MotorsAndTicks,
        readouts::Readouts,
        residuals::Residuals,
        toolbar::Link,
    },
};

/// Kinds the charts need; samples of IMUs and cameras stay in the file.
const KINDS: &str = "estimate,control,residuals,truth,height,status,attacks,event,step,description";
/// Playback speeds.
const SPEEDS: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];

/// A recording, loaded.
#[derive(Clone)]
enum Loaded {
    Loading,
    Failed(String),
    Ready(Box<Deck>),
}

/// Loads the messages of a flight as a deck.
pub async fn load_frames(id: &str) -> Result<Live, Failure> {
    let bytes = net::bytes(&format!("/api/flights/{id}/frames?kinds={KINDS}")).await?;
    let mut flight = Live::recorded();
    flight.ingest(&bytes, 0.0).map_err(|e| Failure { status: 0, text: e.to_string() })?;
    Ok(flight)
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
    let owner = Owner::current();
    let url = format!("/api/flights/{id}");
    {
        let (url, id) = (url.clone(), id.clone());
        leptos::task::spawn_local(async move {
            summary.try_set(Some(net::json("GET", &url, None, "").await));
            let frames = load_frames(&id).await;
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
    view! {
        <main class="flight-page" id="main">
            <Head id=id.clone() summary />
            {move || match loaded.get() {
                Loaded::Loading => view! { <p class="banner">"Loading the recording…"</p> }.into_any(),
                Loaded::Failed(why) => view! {
                    <p class="banner bad" role="alert"><b>"The recording cannot be shown: "</b>{why}". Its files can still be downloaded above."</p>
                }.into_any(),
                Loaded::Ready(deck) => {
                    let deck = *deck;
                    ctx.deck.set(Some(deck));
                    view! { <Player deck summary /> }.into_any()
                }
            }}
        </main>
    }
}

/// Name, downloads, delete.
#[component]
fn Head(id: String, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    let url = StoredValue::new(format!("/api/flights/{id}"));
    let name = RwSignal::new(String::new());
    Effect::new(move |_| {
        if let Some(Ok(flight)) = summary.get() {
            name.set(flight.title().to_owned());
        }
    });
    let rename = move |_| save(ctx, url.get_value(), json!({ "name": name.get_untracked() }), summary);
    let delete = Callback::new(move |()| {
        leptos::task::spawn_local(async move {
            match net::json::<serde_json::Value>("DELETE", &url.get_value(), None, &ctx.operator()).await {
                Ok(_) => {
                    ctx.tell(Tone::Done, "Flight deleted");
                    ctx.go(Route::Flights);
                }
                Err(failure) => ctx.tell(Tone::Error, format!("Delete refused: {}", failure.text)),
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
                f.completeness
            ),
            Some(Err(e)) => e.text.clone(),
            None => String::new(),
        })
    };
    view! {
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
                <a class="button" href=format!("/api/flights/{id}/mcap") download="">"MCAP"</a>
                <a class="button" href=format!("/api/flights/{id}/csv") download="">"CSV"</a>
            </span>
            <span class="delete"><HoldButton label="Delete" class="warn" action=delete /></span>
        </div>
    }
}

/// Writes name or notes.
fn save(ctx: Ctx, url: String, body: serde_json::Value, summary: RwSignal<Option<Result<Flight, Failure>>>) {
    leptos::task::spawn_local(async move {
        match net::json::<Flight>("PATCH", &url, Some(body.to_string()), &ctx.operator()).await {
            Ok(flight) => {
                if !flight.id.is_empty() {
                    summary.try_set(Some(Ok(flight)));
                }
                ctx.tell(Tone::Done, "Saved");
            }
            Err(failure) => ctx.tell(Tone::Error, format!("Not saved: {}", failure.text)),
        }
    });
}

/// Charts, scrub bar and summary.
#[component]
fn Player(deck: Deck, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    provide_context(deck);
    let drawn = Memo::new(move |_| !matches!(ctx.graphics.get(), Graphics::Off(_)));
    view! {
        <div class="fly replay">
            <div class="left">
                <Show when=move || drawn.get()><HorizonCard /></Show>
                <Readouts />
            </div>
            <div class="centre">
                <Show when=move || drawn.get()>
                    <AltitudeChart />
                    <AttitudeChart />
                    <Residuals />
                    <MotorsAndTicks />
                </Show>
                <Scrub deck />
                <Events />
            </div>
            <div class="right"><Summary summary /></div>
        </div>
    }
}

/// Play, speed, position, event marks.
#[component]
fn Scrub(deck: Deck) -> impl IntoView {
    let playing = RwSignal::new(false);
    let speed = RwSignal::new(1.0);
    let bar = NodeRef::<html::Div>::new();
    let (begin, end) = deck
        .data
        .with_value(|live| live.curves.time_span_s().map_or((0.0, 1.0), |s| (s.start, s.end.max(s.start + 0.001))));
    let length = end - begin;
    let last = StoredValue::new(net::now_ms());
    let step = move || {
        let now = net::now_ms();
        let passed = (now - last.get_value()) * 1e-3;
        last.set_value(now);
        if !playing.get_untracked() {
            return;
        }
        let next = deck.playhead.get_untracked() + passed * speed.get_untracked();
        deck.playhead.set(next.min(end));
        if next >= end {
            playing.set(false);
        }
    };
    if let Ok(timer) = set_interval_with_handle(step, Duration::from_millis(33)) {
        on_cleanup(move || timer.clear());
    }
    let toggle = move || {
        if !playing.get_untracked() && deck.playhead.get_untracked() >= end - 1e-6 {
            deck.playhead.set(begin);
        }
        playing.update(|p| *p = !*p);
    };
    let seek = move |delta: f64| deck.playhead.update(|t| *t = (*t + delta).clamp(begin, end));
    let keys = window_event_listener(ev::keydown, move |e| {
        use wasm_bindgen::JsCast;
        let tag =
            e.target().and_then(|t| t.dyn_into::<web_sys::Element>().ok()).map(|t| t.tag_name()).unwrap_or_default();
        if matches!(tag.as_str(), "INPUT" | "TEXTAREA" | "SELECT") || e.ctrl_key() || e.alt_key() || e.meta_key() {
            return;
        }
        let far = if e.shift_key() { 10.0 } else { 1.0 };
        match e.key().as_str() {
            " " if !matches!(tag.as_str(), "BUTTON" | "A" | "SUMMARY") => toggle(),
            "ArrowLeft" => seek(-far),
            "ArrowRight" => seek(far),
            "Home" => deck.playhead.set(begin),
            "End" => deck.playhead.set(end),
            _ => return,
        }
        e.prevent_default();
    });
    on_cleanup(move || keys.remove());
    let go_to = move |e: &ev::PointerEvent| {
        let Some(bar) = bar.get_untracked() else { return };
        let rect = bar.get_bounding_client_rect();
        let fraction = ((f64::from(e.client_x()) - rect.left()) / rect.width().max(1.0)).clamp(0.0, 1.0);
        deck.playhead.set(begin + fraction * length);
    };
    let percent = move |time: f64| (time - begin) / length * 100.0;
    let marks = deck.data.with_value(|live| {
        let events = live.events.iter().map(|e| (e.time_us as f64 * 1e-6, e.kind.clone(), e.text.clone()));
        events.filter(|(t, _, _)| *t >= begin && *t <= end).collect::<Vec<_>>()
    });
    let spans = deck.data.with_value(|live| {
        live.spans.iter().filter(|s| s.seen).map(|s| (s.start_s.max(begin), s.end_s.min(end))).collect::<Vec<_>>()
    });
    view! {
        <div class="card scrub" role="group" aria-label="Replay">
            <button type="button" class="play" aria-label=move || if playing.get() { "Pause replay" } else { "Play replay" } title="Space" on:click=move |_| toggle()>
                {move || if playing.get() { "❚❚" } else { "▶" }}
            </button>
            <select class="small" aria-label="Replay speed" on:change:target=move |e| speed.set(e.target().value().parse().unwrap_or(1.0))>
                {SPEEDS.into_iter().map(|s| view! { <option value=s.to_string() selected=move || speed.get() == s>{format!("{s}×")}</option> }).collect::<Vec<_>>()}
            </select>
            <output class="num">{move || format!("{} / {}", tenths(deck.playhead.get() - begin), tenths(length))}</output>
            <div
                class="scrub-bar"
                node_ref=bar
                role="slider"
                tabindex="0"
                aria-label="Position in the flight, in seconds"
                aria-valuemin="0"
                aria-valuemax=format!("{length:.1}")
                aria-valuenow=move || format!("{:.1}", deck.playhead.get() - begin)
                on:pointerdown=move |e| {
                    if let Some(bar) = bar.get_untracked() {
                        let _ = bar.set_pointer_capture(e.pointer_id());
                    }
                    go_to(&e);
                }
                on:pointermove=move |e| if e.buttons() == 1 { go_to(&e) }
            >
                {spans.into_iter().map(|(a, b)| view! {
                    <i class="scrub-attack" style=format!("left:{:.2}%;width:{:.2}%", percent(a), (percent(b) - percent(a)).max(0.3))></i>
                }).collect::<Vec<_>>()}
                {marks.into_iter().map(|(time, kind, text)| view! {
                    <i class=format!("scrub-mark {kind}") style=format!("left:{:.2}%", percent(time)) title=text></i>
                }).collect::<Vec<_>>()}
                <b class="scrub-head" style=move || format!("left:{:.2}%", percent(deck.playhead.get()))></b>
            </div>
        </div>
    }
}

/// `m:ss.t`
fn tenths(seconds: f64) -> String {
    let tenth = (seconds.max(0.0) * 10.0).round() as u64;
    format!("{}:{:02}.{}", tenth / 600, tenth / 10 % 60, tenth % 10)
}

/// Everything known about the flight, beside its charts.
#[component]
fn Summary(summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    view! {
        {move || match summary.get() {
            None => view! { <section class="card"><header><h2>"Flight"</h2></header><p class="quiet">"Loading…"</p></section> }.into_any(),
            Some(Err(failure)) => view! { <section class="card"><header><h2>"Flight"</h2></header><p class="bad">{failure.text}</p></section> }.into_any(),
            Some(Ok(flight)) => view! { <Facts flight summary /> }.into_any(),
        }}
    }
}

#[component]
fn Facts(flight: Flight, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    let url = StoredValue::new(format!("/api/flights/{}", flight.id));
    let notes = RwSignal::new(flight.notes.clone().unwrap_or_default());
    let fact = |name: &'static str, value: String| view! { <div><dt>{name}</dt><dd class="num">{value}</dd></div> };
    let missing = if flight.missing == 0 { "none".to_owned() } else { format::count(flight.missing) };
    let rms =
        flight.tracking_rms_m.map_or_else(|| NONE.to_owned(), |m| format!("{} mm RMS", format::fixed(m * 1e3, 1)));
    view! {
        <section class="card facts" aria-label="Steps">
            <header><h2>"Steps"</h2><span class="quiet num push">{rms}</span></header>
            <StepTable steps=flight.steps.clone() />
        </section>
        <section class="card facts" aria-label="Attacks">
            <header><h2>"Attacks"</h2></header>
            <AttackTable attacks=flight.attacks.clone() />
        </section>
        <section class="card facts" aria-label="Flight">
            <header><h2>"Flight"</h2></header>
            <dl class="facts-list">
                {fact("id", flight.id.clone())}
                {fact("vehicle", format!("{} ({})", flight.vehicle_id, flight.vehicle))}
                {fact("airframe", flight.airframe.clone())}
                {fact("rig", flight.rig.clone())}
                {fact("seed", flight.seed.map_or_else(|| NONE.to_owned(), |s| s.to_string()))}
                {fact("agent", flight.agent_version.clone())}
                {fact("messages", format::count(flight.messages))}
                {fact("missing", missing)}
                {fact("size", format::bytes(flight.size_bytes))}
            </dl>
            <details class="counts">
                <summary>"Messages by topic"</summary>
                <table><tbody>
                    {flight.counts.iter().map(|(topic, n)| view! { <tr><th scope="row">{topic.clone()}</th><td class="num">{format::count(*n)}</td></tr> }).collect::<Vec<_>>()}
                </tbody></table>
            </details>
        </section>
        <section class="card facts notes" aria-label="Notes">
            <header><h2><label for="notes">"Notes"</label></h2></header>
            <textarea
                id="notes"
                rows="4"
                placeholder="What was tried, what was seen"
                prop:value=notes
                on:input:target=move |e| notes.set(e.target().value())
                on:change=move |_| save(ctx, url.get_value(), json!({ "notes": notes.get_untracked() }), summary)
            ></textarea>
        </section>
    }
}

#[component]
fn StepTable(steps: Vec<Step>) -> impl IntoView {
    if steps.is_empty() {
        return view! { <p class="quiet">"No setpoint step in this flight."</p> }.into_any();
    }
    let seconds = |v: Option<f64>| format::maybe(v, 2);
    view! {
        <table class="dense">
            <thead><tr><th class="num">"at s"</th><th class="num">"step m"</th><th class="num" title="10 % to 90 %">"rise s"</th><th class="num">"over %"</th><th class="num">"settle s"</th><th class="num">"err mm"</th></tr></thead>
            <tbody>
                {steps.into_iter().map(|s| view! {
                    <tr>
                        <td class="num">{format::fixed(s.start_s, 1)}</td>
                        <td class="num">{format!("{}→{}", format::fixed(s.from_m, 1), format::fixed(s.to_m, 1))}</td>
                        <td class="num">{seconds(s.rise_time_s)}</td>
                        <td class="num">{format::maybe(s.overshoot_percent, 1)}</td>
                        {if s.interrupted {
                            view! { <td class="quiet" colspan="2" title="The next step began before this one was inside the band">"interrupted"</td> }.into_any()
                        } else {
                            view! {
                                <td class="num">{seconds(s.settling_time_s)}</td>
                                <td class="num">{s.steady_error_m.map_or_else(|| NONE.to_owned(), |e| format::signed(e * 1e3, 0))}</td>
                            }.into_any()
                        }}
                    </tr>
                }).collect::<Vec<_>>()}
            </tbody>
        </table>
    }.into_any()
}

#[component]
fn AttackTable(attacks: Vec<FlownAttack>) -> impl IntoView {
    if attacks.is_empty() {
        return view! { <p class="quiet">"No attack in this flight."</p> }.into_any();
    }
    view! {
        <ul class="attack-list">
            {attacks.into_iter().map(|a| {
                let channel = if a.channel == "all" || a.channel.is_empty() { String::new() } else { format!(" {}", a.channel.replace('_', " ")) };
                let what = format!("{} {}{channel}: {} {}", a.sensor.replace('_', " "), a.instance, a.kind.replace('_', " "), format::signed(a.magnitude, 2));
                view! {
                    <li>
                        <span class="attack-title" title=what.clone()>{what.clone()}</span>
                        <span class="num quiet">{format!("{} s, {} s", format::fixed(a.start_s, 1), format::fixed(a.duration_s, 1))}</span>
                        <span class=format!("chip {}", a.phase)>{a.phase.clone()}</span>
                    </li>
                }
            }).collect::<Vec<_>>()}
        </ul>
    }.into_any()
}

#[cfg(test)]
mod tests {
    #[test]
    fn positions_have_tenths() {
        assert_eq!(super::tenths(62.34), "1:02.3");
        assert_eq!(super::tenths(-1.0), "0:00.0");
        assert_eq!(super::tenths(59.97), "1:00.0");
    }
}

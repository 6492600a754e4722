//! The bar on top of every page: vehicle, mode, link, recording, battery, who controls, and the motor cut.

use leptos::prelude::*;
use plumbline_proto::v1::Mode;
use serde_json::json;

use crate::{
    app::{App, Socket},
    ctx::{Ctx, ctx},
    event::Event,
    model::{api, format, names, route::Route},
    panel::alarms::{EMPTY, LOW},
    store,
};

/// A link to another page that does not load it anew.
#[component]
pub fn Link(
    /// Where to.
    to: Route,
    /// Is it where we are?
    #[prop(optional, into)]
    current: Signal<bool>,
    /// What it says.
    children: Children,
) -> impl IntoView {
    let ctx = ctx();
    let href = to.path();
    view! {
        <a
            href=href
            aria-current=move || current.get().then_some("page")
            on:click=move |e| {
                // A new tab stays the browser's business.
                if !(e.ctrl_key() || e.meta_key() || e.shift_key() || e.button() != 0) {
                    e.prevent_default();
                    ctx.go(to.clone());
                }
            }
        >{children()}</a>
    }
}

/// Below this age the page's own view of it is the ripple of its batches, ms.
const HERE_MS: f64 = 250.0;

/// The link, in words: (text, class, explanation).
fn link_state(ctx: Ctx) -> (String, &'static str, String) {
    let socket = ctx.app(|app| app.socket);
    if socket != Socket::Open {
        let text = match socket {
            Socket::Idle => "no vehicle",
            Socket::Opening => "connecting",
            _ => "ground lost",
        };
        return (
            text.to_owned(),
            if socket == Socket::Waiting { "bad" } else { "quiet" },
            "Live connection to the ground station".into(),
        );
    }
    ctx.live(|live| match &live.ground.link {
        Some(l) if !l.connected => {
            (format!("link lost {}", format::age(l.age_ms * 1e-3)), "bad", "The vehicle is not connected to the ground station".to_owned())
        }
        Some(l) => {
            // What is here may be older than what the ground has.
            let here_ms = live.age_s(crate::net::now_ms()).map_or(0.0, |s| s * 1e3);
            let age_ms = if here_ms > HERE_MS { here_ms.max(l.age_ms) } else { l.age_ms };
            let class = if age_ms > 500.0 || l.loss_percent > 10.0 {
                "bad"
            } else if age_ms > 100.0 || l.loss_percent > 1.0 {
                "warn"
            } else {
                "good"
            };
            let text = format!(
                "{:>3} ms · {:>3} Hz · {} %",
                format::fixed(age_ms.min(9999.0), 0),
                format::fixed(l.rate_hz, 0),
                format::fixed(l.loss_percent, if l.loss_percent > 0.0 && l.loss_percent < 10.0 { 1 } else { 0 })
            );
            let more = format!(
                "Age, rate and loss of telemetry. Round trip {} ms; {} received, {} missing; this page was too slow for {}",
                format::fixed(l.round_trip_ms, 1),
                format::count(l.received),
                format::count(l.missing),
                format::count(l.viewer_dropped)
            );
            (text, class, more)
        }
        None => ("waiting for data".to_owned(), "quiet", "No link status yet".to_owned()),
    })
}

/// The recording, in words.
fn recording_state(ctx: Ctx) -> (String, &'static str, String) {
    ctx.live(|live| match &live.ground.recording {
        Some(r) if !r.error.is_empty() => ("REC failed".to_owned(), "bad", r.error.clone()),
        Some(r) if r.recording => {
            let whole = if r.missing == 0 { "complete" } else { "filling" };
            let more = format!(
                "{}: {} messages, {}; {} missing, which the agent's own log still has to fill in",
                r.flight_id,
                format::count(r.messages),
                format::bytes(r.bytes),
                format::count(r.missing)
            );
            (format!("REC {} {whole}", format::clock(r.duration_s)), "recording", more)
        }
        Some(_) => ("not recording".to_owned(), "quiet", "Arming starts a recording; R starts one by hand".to_owned()),
        None => (format::NONE.to_owned(), "quiet", "No word from the recorder yet".to_owned()),
    })
}

/// The toolbar.
#[component]
pub fn Toolbar() -> impl IntoView {
    let ctx = ctx();
    let at = move |route: Route| {
        Signal::derive(move || ctx.route.with(|r| std::mem::discriminant(r) == std::mem::discriminant(&route)))
    };
    let in_flights = Signal::derive(move || {
        matches!(ctx.route.get(), Route::Flights | Route::Flight(_) | Route::Report(_) | Route::Compare(_))
    });
    let vehicles = Memo::new(move |_| ctx.app(App::offered));
    let mode = Memo::new(move |_| ctx.live(|live| live.status.get().map_or(Mode::Unspecified, |s| s.mode())));
    let armed = Memo::new(move |_| ctx.live(|live| live.status.get().map(|s| s.armed)));
    let link = Memo::new(move |_| link_state(ctx));
    let recording = Memo::new(move |_| recording_state(ctx));
    let battery = Memo::new(move |_| {
        ctx.live(|live| {
            live.status.get().zip(live.battery_v()).map(|(s, battery_v)| {
                let (volts, percent) = (format::fixed(battery_v, 1), format::fixed(100.0 * s.battery_fraction, 0));
                // By the charge itself, as the alarms: what is shown is rounded.
                (format!("{volts} V · {percent} %"), s.battery_fraction < LOW, s.battery_fraction < EMPTY)
            })
        })
    });
    let holder = Memo::new(move |_| ctx.live(|live| live.holder().to_owned()));
    let mine = move || holder.get() == ctx.operator();
    let lease = move |_| {
        if mine() {
            ctx.command("Release control", "DELETE", "lease", json!({}));
        } else {
            ctx.take_control();
        }
    };
    let elsewhere = Memo::new(move |_| ctx.app(|app| app.elsewhere().map(|ground| ground.name.clone())));
    let old = Memo::new(move |_| ctx.is_old(|live| &live.status));
    let theme = move |_| {
        ctx.dark.update(|d| *d = !*d);
        store::set("theme", if ctx.dark.get_untracked() { "dark" } else { "light" });
    };
    view! {
        <header class="toolbar" role="banner">
            <Link to=Route::Fly><span class="brand">"Plumbline"</span></Link>
            <nav aria-label="Pages">
                <Link to=Route::Fly current=at(Route::Fly)>"Fly"</Link>
                <Link to=Route::Flights current=in_flights>"Flights"</Link>
                <Link to=Route::Experiments current=at(Route::Experiments)>"Experiments"</Link>
                <Link to=Route::Tune current=at(Route::Tune)>"Tune"</Link>
                <Link to=Route::Calibrate current=at(Route::Calibrate)>"Calibrate"</Link>
                <Link to=Route::Setup current=at(Route::Setup)>"Setup"</Link>
            </nav>
            <select
                class="vehicle"
                aria-label="Vehicle"
                on:change:target=move |e| ctx.dispatch(Event::Choose(e.target().value()))
            >
                {move || {
                    let all = vehicles.get();
                    if all.is_empty() {
                        view! { <option>"no vehicle"</option> }.into_any()
                    } else {
                        all.into_iter().map(|(id, connected)| {
                            let shown = id.clone();
                            let text = if connected { id.clone() } else { format!("{id} (offline)") };
                            view! { <option value=id prop:selected=move || ctx.app(|a| a.vehicle.as_deref() == Some(shown.as_str()))>{text}</option> }
                        }).collect::<Vec<_>>().into_any()
                    }
                }}
            </select>
            <span class="tag mode" class:stale=old aria-label="Mode">{move || names::mode(mode.get())}</span>
            <span
                class="tag armed-tag"
                class:armed=move || armed.get() == Some(true)
                class:stale=old
                role="status"
                aria-label="Arming"
            >{move || match armed.get() { Some(true) => "ARMED", Some(false) => "disarmed", None => format::NONE }}</span>
            <span class=move || format!("tag link num {}", link.get().1) title=move || link.get().2 aria-label="Link">
                <i class="dot" aria-hidden="true"></i>{move || link.get().0}
            </span>
            <button
                type="button"
                class=move || format!("tag rec num {}", recording.get().1)
                title=move || format!("{} (R)", recording.get().2)
                aria-label=move || format!("Recording: {}", recording.get().0)
                on:click=move |_| ctx.toggle_recording()
            >
                <i class="dot" aria-hidden="true"></i>{move || recording.get().0}
            </button>
            <span
                class="tag battery num"
                class:stale=old
                class:bad=move || battery.get().is_some_and(|b| b.2)
                class:warn=move || battery.get().is_some_and(|b| b.1 && !b.2)
                aria-label="Battery"
                title="Battery voltage and charge"
            >{move || battery.get().map_or_else(|| format::NONE.to_owned(), |b| b.0)}</span>
            <span class="spring"></span>
            <button
                type="button"
                class="lease"
                class:mine=mine
                class:other=move || !mine() && !holder.get().is_empty()
                title=move || {
                    let holder = holder.get();
                    if let Some(ground) = elsewhere.get() { format!("It is flown from ground {ground}: control is taken there") }
                    else if holder.is_empty() { "Nobody controls; your first command takes control".to_owned() }
                    else if mine() { "You control this vehicle; press to release".to_owned() }
                    else { format!("{holder} controls; press to take over") }
                }
                disabled=move || elsewhere.with(Option::is_some)
                on:click=lease
            >
                <small>{move || if mine() { "you control".to_owned() } else if holder.get().is_empty() { "nobody controls".to_owned() } else { holder.get() }}</small>
                <b>{move || if mine() { "Release" } else if holder.get().is_empty() { "Take control" } else { "Take over" }}</b>
            </button>
            {move || ctx.session.with(api::who).map(|who| view! {
                <a class="tag" href="/login" title=format!("Signed in as {who}")>"sign out"</a>
            })}
            <button type="button" class="icon" aria-label="Keys and help" title="Keys (?)" on:click=move |_| ctx.help.set(true)>"?"</button>
            <button
                type="button"
                class="icon"
                aria-label="Dark theme"
                aria-pressed=move || ctx.dark.get().to_string()
                title="Light or dark"
                on:click=theme
            >"◐"</button>
            <button type="button" class="cut" title="Ctrl+Shift+X. Latched: needs an explicit release." on:click=move |_| ctx.cut()>
                "CUT MOTORS" <span>" – vehicle falls"</span>
            </button>
        </header>
    }
}

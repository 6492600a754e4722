//! The bar on top of every page: vehicle, mode, link, recording, battery, who controls, and the motor cut.

use leptos::prelude::*;
use plumbline_proto::v1::{LinkStatus, RecordingStatus};
use serde_json::json;

use crate::{
    app::{App, Socket},
    ctx::ctx,
    event::Event,
    model::{api, format, live::Live, names, route::Route},
    net,
    panel::alarms::{Battery, Guarded},
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

/// What is said of the link, in figures: text is written of them only once they change.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shown {
    /// No connection to the ground is open.
    Closed(Socket),
    /// The ground has not said anything of it yet.
    Unknown,
    /// The vehicle is not connected to the ground.
    Lost { age_ms: f64 },
    /// It is.
    Up { age_ms: f64, rate_hz: f64, loss_percent: f64 },
}

impl Shown {
    /// `here_ms`: age of the newest message on this page.
    fn new(socket: Socket, link: Option<&LinkStatus>, here_ms: f64) -> Self {
        match link {
            _ if socket != Socket::Open => Self::Closed(socket),
            None => Self::Unknown,
            Some(link) if !link.connected => Self::Lost { age_ms: link.age_ms },
            Some(link) => {
                // What is here may be older than what the ground has.
                let age_ms = if here_ms > HERE_MS { here_ms.max(link.age_ms) } else { link.age_ms };
                Self::Up { age_ms, rate_hz: link.rate_hz, loss_percent: link.loss_percent }
            }
        }
    }

    fn class(self) -> &'static str {
        match self {
            Self::Closed(Socket::Waiting) | Self::Lost { .. } => "bad",
            Self::Closed(_) | Self::Unknown => "quiet",
            Self::Up { age_ms, loss_percent, .. } if age_ms > 500.0 || loss_percent > 10.0 => "bad",
            Self::Up { age_ms, loss_percent, .. } if age_ms > 100.0 || loss_percent > 1.0 => "warn",
            Self::Up { .. } => "good",
        }
    }

    fn text(self) -> String {
        match self {
            Self::Closed(Socket::Idle) => "no vehicle".to_owned(),
            Self::Closed(Socket::Opening) => "connecting".to_owned(),
            Self::Closed(_) => "ground lost".to_owned(),
            Self::Unknown => "waiting for data".to_owned(),
            Self::Lost { age_ms } => format!("link lost {}", format::age(age_ms * 1e-3)),
            Self::Up { age_ms, rate_hz, loss_percent } => format!(
                "{:>3} ms · {:>3} Hz · {} %",
                format::fixed(age_ms.min(9999.0), 0),
                format::fixed(rate_hz, 0),
                format::fixed(loss_percent, if loss_percent > 0.0 && loss_percent < 10.0 { 1 } else { 0 })
            ),
        }
    }

    /// What explains it; of a link that is up, more figures do.
    fn explained(self, more: impl FnOnce() -> String) -> String {
        match self {
            Self::Closed(_) => "Live connection to the ground station".to_owned(),
            Self::Unknown => "No link status yet".to_owned(),
            Self::Lost { .. } => "The vehicle is not connected to the ground station".to_owned(),
            Self::Up { .. } => more(),
        }
    }
}

/// The recording, in words: (text, class, explanation).
fn recording_state(status: Option<&RecordingStatus>) -> (String, &'static str, String) {
    match status {
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
    }
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
    let mode = Memo::new(move |_| ctx.live(Live::mode));
    let armed = Memo::new(move |_| ctx.live(|live| live.status.get().map(|s| s.armed)));
    let link = Memo::new(move |_| {
        let socket = ctx.app(|app| app.socket);
        ctx.live(|live| {
            let here_ms = live.age_s(net::now_ms()).map_or(0.0, |s| s * 1e3);
            Shown::new(socket, live.ground.link.as_ref(), here_ms)
        })
    });
    let link_class = Memo::new(move |_| link.get().class());
    let counts = Memo::new(move |_| {
        let counted = |l: &LinkStatus| (l.round_trip_ms, l.received, l.missing, l.viewer_dropped);
        ctx.live(|live| live.ground.link.as_ref().map(counted).unwrap_or_default())
    });
    let counted = Memo::new(move |_| {
        let (round_trip_ms, received, missing, dropped) = counts.get();
        format!(
            "Age, rate and loss of telemetry. Round trip {} ms; {} received, {} missing; this page was too slow for {}",
            format::fixed(round_trip_ms, 1),
            format::count(received),
            format::count(missing),
            format::count(dropped)
        )
    });
    let recorder = Memo::new(move |_| ctx.live(|live| live.ground.recording.clone()));
    let recording = Memo::new(move |_| recorder.with(|status| recording_state(status.as_ref())));
    let battery = Memo::new(move |_| ctx.live(Battery::of));
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
            // Shown last and reached first by Tab.
            <button type="button" class="cut" title="Ctrl+Shift+X. Latched: needs an explicit release." on:click=move |_| ctx.cut()>
                "CUT MOTORS" <span>" – vehicle falls"</span>
            </button>
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
            <span class=move || format!("tag link num {}", link_class.get()) title=move || link.get().explained(|| counted.get()) aria-label="Link">
                <i class="dot" aria-hidden="true"></i>{move || link.get().text()}
            </span>
            <Guarded>
                <button
                    type="button"
                    class=move || format!("tag rec num {}", recording.get().1)
                    title=move || format!("{} (R)", recording.get().2)
                    aria-label=move || format!("Recording: {}", recording.get().0)
                    on:click=move |_| ctx.toggle_recording()
                >
                    <i class="dot" aria-hidden="true"></i>{move || recording.get().0}
                </button>
            </Guarded>
            <span
                class="tag battery num"
                class:stale=old
                class:bad=move || battery.get().is_some_and(|b| b.empty)
                class:warn=move || battery.get().is_some_and(|b| b.low && !b.empty)
                aria-label="Battery"
                title="Battery voltage and charge"
            >{move || battery.get().map_or_else(|| format::NONE.to_owned(), Battery::text)}</span>
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
        </header>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: LinkStatus = LinkStatus {
        wall_time_us: 0,
        connected: true,
        age_ms: 8.4,
        round_trip_ms: 2.0,
        clock_offset_us: 0.0,
        rate_hz: 100.0,
        loss_percent: 0.0,
        received: 5000,
        missing: 0,
        viewer_dropped: 0,
        newest_time_us: 0,
    };

    #[test]
    fn the_link_is_the_same_until_a_figure_that_is_shown_is_another() {
        let shown = |link: &LinkStatus, here_ms| Shown::new(Socket::Open, Some(link), here_ms);
        // A later status with the same figures, and a page that batches.
        let later = LinkStatus { wall_time_us: 9, newest_time_us: 9, received: 5100, ..UP };
        assert_eq!(shown(&UP, 10.0), shown(&later, HERE_MS));
        assert_eq!(shown(&UP, 10.0).text(), "  8 ms · 100 Hz · 0 %");
        assert_eq!(shown(&UP, 400.0).text(), "400 ms · 100 Hz · 0 %");
        let lossy = |age_ms, loss_percent| shown(&LinkStatus { age_ms, loss_percent, ..UP }, 0.0).class();
        assert_eq!([lossy(8.0, 0.0), lossy(8.0, 1.5), lossy(101.0, 0.0)], ["good", "warn", "warn"]);
        assert_eq!([lossy(501.0, 0.0), lossy(8.0, 11.0)], ["bad", "bad"]);
    }

    #[test]
    fn a_link_that_is_not_up_says_why() {
        let told = |shown: Shown| (shown.text(), shown.class(), shown.explained(|| "figures".to_owned()));
        let ground = "Live connection to the ground station".to_owned();
        let closed = |socket| told(Shown::new(socket, Some(&UP), 0.0));
        assert_eq!(closed(Socket::Idle), ("no vehicle".to_owned(), "quiet", ground.clone()));
        assert_eq!(closed(Socket::Waiting), ("ground lost".to_owned(), "bad", ground));
        assert_eq!(Shown::new(Socket::Open, None, 0.0), Shown::Unknown);
        let lost = Shown::new(Socket::Open, Some(&LinkStatus { connected: false, age_ms: 2400.0, ..UP }), 0.0);
        assert_eq!((lost.text().as_str(), lost.class()), ("link lost 2.4 s", "bad"));
        assert_eq!(told(Shown::new(Socket::Open, Some(&UP), 0.0)).2, "figures");
    }
}

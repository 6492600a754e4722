//! The handle every panel holds: read the state, send commands, follow routes. Copyable; owns nothing.
//!
//! Samples never become signals. [`Ctx::tick`] beats ten times a second and text is read again then;
//! curves are drawn by `paint.rs` on animation frames from the same state.

use std::time::Duration;

use leptos::prelude::*;
use serde_json::{Value, json};

use crate::{
    app::App,
    deck::Deck,
    event::{Effect, Event, Failure, Tone},
    model::{
        api::{Answer, Session},
        live::Live,
        route::Route,
    },
    net, store,
};

/// Text is written this often.
const TICK: Duration = Duration::from_millis(100);
/// Least history asked for, s.
const LEAST_HISTORY_S: f64 = 30.0;
/// Most; the ground keeps no more.
const MOST_HISTORY_S: f64 = 120.0;
/// The ground is asked for its state this often.
const POLL: Duration = Duration::from_millis(2000);

/// Whether curves can be drawn.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Graphics {
    /// Not known yet.
    #[default]
    Starting,
    /// Drawing, on this backend.
    On(String),
    /// The browser took the canvas away; it usually gives it back within seconds.
    Lost,
    /// Not possible, and why: numbers only.
    Off(String),
}

/// See the module documentation.
#[derive(Clone, Copy)]
pub struct Ctx {
    /// Ground, vehicles, socket, notices.
    pub app: StoredValue<App, LocalStorage>,
    /// What flies.
    pub live: StoredValue<Live, LocalStorage>,
    /// Beats ten times a second.
    pub tick: RwSignal<u64>,
    /// Beats when [`App`] changes: notices, vehicles, socket.
    pub changed: RwSignal<u64>,
    /// Page shown.
    pub route: RwSignal<Route>,
    /// Dark page?
    pub dark: RwSignal<bool>,
    /// Can curves be drawn?
    pub graphics: RwSignal<Graphics>,
    /// Charts of the page shown.
    pub deck: RwSignal<Option<Deck>>,
    /// Charts of the live vehicle; they outlive a visit to another page.
    pub live_deck: StoredValue<Option<Deck>>,
    /// List of keys open?
    pub help: RwSignal<bool>,
    /// Attack panel asked for by key.
    pub attacks_focus: RwSignal<u64>,
    /// Who is signed in.
    pub session: RwSignal<Session>,
    operator: StoredValue<String>,
    socket: StoredValue<Option<net::LiveSocket>, LocalStorage>,
}

impl Ctx {
    /// Sets everything up; call once.
    pub fn begin() -> Self {
        let path = window().location().pathname().unwrap_or_default();
        let ctx = Self {
            app: StoredValue::new_local(App::new(store::get("vehicle"))),
            live: StoredValue::new_local(Live::default()),
            tick: RwSignal::new(0),
            changed: RwSignal::new(0),
            route: RwSignal::new(Route::from_path(&path)),
            dark: RwSignal::new(store::dark()),
            graphics: RwSignal::new(Graphics::Starting),
            deck: RwSignal::new(None),
            live_deck: StoredValue::new(None),
            help: RwSignal::new(false),
            attacks_focus: RwSignal::new(0),
            session: RwSignal::new(Session::default()),
            operator: StoredValue::new(store::operator()),
            socket: StoredValue::new_local(None),
        };
        let deck = Deck::live(ctx);
        // History for the window shown and no more: decoding it delays the first live value.
        let window_s = deck.window_s.get_untracked();
        ctx.app.update_value(|app| app.history_s = window_s.clamp(LEAST_HISTORY_S, MOST_HISTORY_S));
        ctx.live_deck.set_value(Some(deck));
        set_interval(move || ctx.tick.update(|n| *n += 1), TICK);
        set_interval(move || ctx.dispatch(Event::Poll), POLL);
        leptos::task::spawn_local(async move {
            // The account is the operator's name where there is one; the first socket is opened after it is known.
            if let Ok(session) = net::json::<Session>("GET", "/api/session", None, "").await {
                if let Some(name) = &session.name {
                    ctx.operator.set_value(name.clone());
                }
                ctx.session.set(session);
            }
            ctx.dispatch(Event::Poll);
        });
        ctx
    }

    /// Takes an event into the state and does what follows from it.
    pub fn dispatch(self, event: Event) {
        let quiet = matches!(event, Event::Batch(..) | Event::Poll);
        let effects = self.app.try_update_value(|app| self.live.try_update_value(|live| app.update(live, event)));
        for effect in effects.flatten().unwrap_or_default() {
            self.perform(effect);
        }
        if !quiet {
            self.changed.update(|n| *n += 1);
        }
    }

    fn perform(self, effect: Effect) {
        match effect {
            Effect::FetchState => {
                leptos::task::spawn_local(async move {
                    let ground = net::json("GET", "/api/ground", None, "").await;
                    self.dispatch(Event::Ground(ground));
                    let vehicles = net::json("GET", "/api/vehicles", None, "").await;
                    self.dispatch(Event::Vehicles(vehicles));
                });
            }
            Effect::OpenSocket(id, history_s) => {
                self.socket.set_value(None);
                let socket = self
                    .operator
                    .with_value(|who| net::LiveSocket::open(&id, who, history_s, move |event| self.dispatch(event)));
                if socket.is_none() {
                    self.dispatch(Event::SocketClosed);
                }
                self.socket.set_value(socket);
            }
            Effect::RetryIn(ms) => {
                set_timeout(move || self.dispatch(Event::Reconnect), Duration::from_millis(ms.into()))
            }
            Effect::Remember(id) => store::set("vehicle", &id),
            Effect::DismissIn(number, ms) => {
                set_timeout(move || self.dispatch(Event::Dismiss(number)), Duration::from_millis(ms.into()));
            }
        }
    }

    /// Reads the connection state; runs again when it changes.
    pub fn app<T>(self, read: impl FnOnce(&App) -> T) -> T {
        self.changed.track();
        self.app.with_value(read)
    }

    /// Reads what flies; runs again ten times a second.
    pub fn live<T>(self, read: impl FnOnce(&Live) -> T) -> T {
        self.tick.track();
        self.live.with_value(read)
    }

    /// Flight time now, µs; 0 before the first message.
    pub fn flight_now_us(self) -> f64 {
        self.live.with_value(|live| live.clock.flight_now_us(net::now_ms()).unwrap_or(live.newest_us as f64))
    }

    /// This page's name for the ground's lease.
    pub fn operator(self) -> String {
        self.operator.get_value()
    }

    /// Sends a command to the vehicle shown. The answer becomes a notice named `what`.
    pub fn command(self, what: impl Into<String>, method: &'static str, action: &str, body: Value) {
        let what = what.into();
        let Some(vehicle) = self.app.with_value(|app| app.vehicle.clone()) else {
            self.dispatch(Event::Tell(Tone::Error, format!("{what}: no vehicle is connected")));
            return;
        };
        let id = String::from(js_sys::encode_uri_component(&vehicle));
        let url = format!("/api/vehicles/{id}/{action}");
        let operator = self.operator();
        leptos::task::spawn_local(async move {
            let answer: Result<Answer, Failure> = net::json(method, &url, Some(body.to_string()), &operator).await;
            self.dispatch(Event::Answered(what, answer));
        });
    }

    /// Cuts the motors. Needs no lease, no confirmation.
    pub fn cut(self) {
        self.command("Cut motors", "POST", "cut", json!({}));
    }

    /// Asks for an altitude, m.
    pub fn set_altitude(self, altitude_m: f64) {
        // Steps of 0.1 must not become 0.7999999.
        let rounded = (altitude_m * 1e4).round() / 1e4;
        let what = format!("Setpoint {} m", crate::model::format::fixed(rounded, 2));
        self.command(what, "POST", "setpoint", json!({ "altitude_m": rounded }));
    }

    /// Moves the altitude setpoint in use by `step_m`, within the vehicle's limits.
    pub fn step_altitude(self, step_m: f64) {
        let target = self.live.with_value(|live| {
            let now = live.control.get().and_then(|c| c.setpoint.as_ref()).and_then(|s| s.altitude_m);
            let limits = live.description.get().and_then(|d| d.limits);
            now.map(|now| match limits {
                Some(l) if l.altitude_max_m > l.altitude_min_m => {
                    (now + step_m).clamp(l.altitude_min_m, l.altitude_max_m)
                }
                _ => now + step_m,
            })
        });
        match target {
            Some(target) => self.set_altitude(target),
            None => {
                self.dispatch(Event::Tell(Tone::Error, "Setpoint: the vehicle has not told its setpoint yet".into()))
            }
        }
    }

    /// Starts or stops a recording by hand.
    pub fn toggle_recording(self) {
        let on = self.live.with_value(|live| live.recording.as_ref().is_some_and(|r| r.recording));
        let what = if on { "Stop recording" } else { "Start recording" };
        self.command(what, "POST", "recording", json!({ "on": !on }));
    }

    /// Aborts every attack.
    pub fn abort_attacks(self) {
        self.command("Abort attacks", "DELETE", "attacks", json!({}));
    }

    /// Shows another page.
    pub fn go(self, route: Route) {
        if let Ok(history) = window().history() {
            let _ = history.push_state_with_url(&wasm_bindgen::JsValue::NULL, "", Some(&route.path()));
        }
        document().set_title(route.title());
        self.route.set(route);
    }

    /// Tells the operator something.
    pub fn tell(self, tone: Tone, text: impl Into<String>) {
        self.dispatch(Event::Tell(tone, text.into()));
    }
}

/// The handle, from the root.
pub fn ctx() -> Ctx {
    expect_context()
}

//! The handle every panel holds: read the state, send commands, follow routes. Copyable; owns nothing.
//!
//! Samples never become signals. [`Ctx::tick`] beats (`TICK_MS`) and text is read again then;
//! curves are drawn by `paint.rs` on animation frames from the same state.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use leptos::prelude::*;
use plumbline_proto::{codec, v1::Mode};
use plumbline_rest::command as rest;
use plumbline_rest::people::{Role, Session};
use serde_json::{Value, json};

use crate::{
    address,
    app::{App, MOST_HISTORY_S, Socket},
    deck::Deck,
    event::{Effect, Event, Failure, Tone},
    model::{api, by_hand::Led, draft::Draft, guide::Guide, layout::Layout, live::Live, route::Route, topic::Topic},
    net,
    panel::{
        prepare::Prepared,
        setpoint::{self, Target},
    },
    store,
    turns::{self, Turns},
};

/// Text is written this often, ms, beside curves.
const TICK_MS: f64 = 100.0;
/// And at least this often, ms, however late the page is; no more often on pages of text, where each change has the browser go over all of it.
const MOST_TICK_MS: f64 = 250.0;
/// Least history asked for, s.
const LEAST_HISTORY_S: f64 = 30.0;
/// History is asked for once the page shows what is, ms; it is read for so long at a time, and then not for a while.
const HISTORY_AFTER_MS: f64 = 400.0;
const PIECE_MS: f64 = 6.0;
const PAUSE_MS: f64 = 18.0;
/// A hint beside the pointer stays this long.
const HINT: Duration = Duration::from_secs(4);
/// The ground is asked for its state this often, unless it still is.
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

/// A few words beside the pointer.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub struct Hint {
    pub number: u64,
    pub text: String,
    /// Is it a notice, too, which screen readers hear?
    pub noticed: bool,
    pub x: f64,
    pub y: f64,
}

/// See the module documentation. Over fifteen fields: each is the handle of something that panels read and follow by
/// itself; in groups, every use of one would only be longer.
#[derive(Clone, Copy)]
pub struct Ctx {
    /// Ground, vehicles, socket, notices.
    pub app: StoredValue<App, LocalStorage>,
    /// What flies.
    pub live: StoredValue<Live, LocalStorage>,
    /// Beats while the page lives (`TICK_MS`, `MOST_TICK_MS`).
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
    /// How far the first flight has come; `None` when nobody is led through one.
    pub guide: RwSignal<Option<Guide>>,
    /// Through which flight of an experiment by hand somebody is led.
    pub led: RwSignal<Option<Led>>,
    /// Attack panel asked for by key.
    pub attacks_focus: RwSignal<u64>,
    /// Attacks written and not yet on the vehicle; they outlive a visit to another page, and a refusal.
    pub drafts: RwSignal<Vec<Draft>>,
    /// What the ground expects of those that it prepared.
    pub prepared: RwSignal<Option<Prepared>>,
    /// Why the last thing pressed was not done, beside the pointer.
    pub hint: RwSignal<Option<Hint>>,
    /// Who is signed in.
    pub session: RwSignal<Session>,
    /// Altitude asked for and not yet reached: steps count from there.
    target: StoredValue<Option<Target>>,
    /// Commands that are not answered yet.
    turns: StoredValue<Turns, LocalStorage>,
    /// Of which vehicle so much past is wanted, s, once a page is open that shows it.
    past_wanted: RwSignal<Option<(String, f64)>>,
    operator: RwSignal<String>,
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
            guide: RwSignal::new(store::guide()),
            led: RwSignal::new(store::led()),
            attacks_focus: RwSignal::new(0),
            drafts: RwSignal::new(store::drafts()),
            prepared: RwSignal::new(None),
            hint: RwSignal::new(None),
            target: StoredValue::new(None),
            turns: StoredValue::new_local(Turns::default()),
            session: RwSignal::new(Session::default()),
            past_wanted: RwSignal::new(None),
            operator: RwSignal::new(store::operator()),
            socket: StoredValue::new_local(None),
        };
        let deck = Deck::live(ctx);
        if let Some(layout) = Layout::read(address::all).filter(|_| ctx.route.with_untracked(|r| *r == Route::Fly)) {
            deck.show(layout);
        }
        // First what the window shows.
        let window_s = deck.window_s.get_untracked();
        ctx.app.update_value(|app| app.history_s = window_s.clamp(LEAST_HISTORY_S, MOST_HISTORY_S));
        ctx.live_deck.set_value(Some(deck));
        // The vehicle whose socket is open already needs no list.
        if let Some(vehicle) = net::Early::vehicle() {
            ctx.dispatch(Event::Choose(vehicle));
        }
        ctx.beat(net::now_ms());
        leptos::prelude::Effect::new(move |_| ctx.drafts.with(|drafts| store::keep_drafts(drafts)));
        leptos::prelude::Effect::new(move |_| {
            let shown = ctx.route.with(|route| matches!(route, Route::Fly | Route::Tune));
            if let Some((id, seconds)) = ctx.past_wanted.get().filter(|_| shown) {
                ctx.past_wanted.set(None);
                leptos::task::spawn_local(ctx.history(id, seconds));
            }
        });
        set_interval(move || ctx.dispatch(Event::Poll), POLL);
        leptos::task::spawn_local(async move {
            // The account is the operator's name where there is one; the first socket is opened after it is known.
            if let Ok(session) = net::json::<Session>("GET", "/api/v1/session", None, "").await {
                if let Some(name) = &session.name {
                    ctx.operator.set(name.clone());
                }
                ctx.session.set(session);
            }
            ctx.dispatch(Event::Poll);
        });
        ctx
    }

    /// Has everything that reads what flies run again, which was due at `due_ms`; then ten times a second beside curves, four times on pages
    /// of text, and less often by as much as the page is late: keys and commands come before text.
    fn beat(self, due_ms: f64) {
        let now_ms = net::now_ms();
        let curves = self.route.with_untracked(|route| matches!(route, Route::Fly | Route::Tune | Route::Calibrate));
        let every_ms = if curves { TICK_MS } else { MOST_TICK_MS };
        let pause_ms = (every_ms + (now_ms - due_ms).max(0.0)).min(MOST_TICK_MS);
        set_timeout(move || self.beat(now_ms + pause_ms), Duration::from_millis(pause_ms as u64));
        self.forget_reached();
        self.tick.update(|n| *n += 1);
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
                    let ground = net::state("/api/v1/ground").await;
                    self.dispatch(Event::Ground(ground));
                    let vehicles = net::state("/api/v1/vehicles").await;
                    self.dispatch(Event::Vehicles(vehicles));
                });
            }
            Effect::OpenSocket(id) => {
                self.socket.set_value(None);
                let who = self.operator.get_untracked();
                let socket = net::LiveSocket::open(&id, &who, move |event| self.dispatch(event));
                if socket.is_none() {
                    self.dispatch(Event::SocketClosed);
                }
                self.socket.set_value(socket);
            }
            Effect::FetchHistory(id, seconds) => self.past_wanted.set(Some((id, seconds))),
            Effect::RetryIn(ms) => {
                set_timeout(move || self.dispatch(Event::Reconnect), Duration::from_millis(ms.into()))
            }
            Effect::Remember(id) => store::set("vehicle", &id),
            Effect::DismissIn(number, ms) => {
                set_timeout(move || self.dispatch(Event::Dismiss(number)), Duration::from_millis(ms.into()));
            }
        }
    }

    /// Asks for the past of vehicle `id` and reads it in pieces: what arrives meanwhile is shown meanwhile.
    async fn history(self, id: String, seconds: f64) {
        net::pause(HISTORY_AFTER_MS).await;
        // The newest state, its boot included, is here by now.
        let boot = self.live.with_value(Live::boot);
        let url = format!("/api/v1/vehicles/{}/history?seconds={seconds:.0}", js_sys::encode_uri_component(&id));
        // Without it the charts begin now; the socket says when the ground is gone.
        let Ok(batch) = net::bytes(&url).await else { return };
        let Ok(mut frames) = codec::decode_batch(&batch) else { return };
        let mut past = Box::new(Live::past(boot));
        loop {
            let begun = net::now_ms();
            while net::now_ms() - begun < PIECE_MS {
                match frames.next() {
                    Some(Ok(frame)) => past.frame(&frame, begun),
                    _ => return self.dispatch(Event::History(id, seconds, past)),
                }
            }
            net::pause(PAUSE_MS).await;
        }
    }

    /// Reads the connection state; runs again when it changes.
    pub fn app<T>(self, read: impl FnOnce(&App) -> T) -> T {
        self.changed.track();
        self.app.with_value(read)
    }

    /// Reads what flies; runs again with each beat.
    pub fn live<T>(self, read: impl FnOnce(&Live) -> T) -> T {
        self.tick.track();
        self.live.with_value(read)
    }

    /// Flight time now, µs; 0 before the first message.
    pub fn flight_now_us(self) -> f64 {
        self.live.with_value(|live| live.clock.now_us(net::now_ms()))
    }

    /// How old what is shown is, s; runs again with each beat.
    pub fn age_s(self) -> Option<f64> {
        self.live(|live| live.age_s(net::now_ms()))
    }

    /// Is the newest message of a topic too old to be shown as what is? Runs again with each beat.
    pub fn is_old<T>(self, topic: fn(&Live) -> &Topic<T>) -> bool {
        self.live(|live| live.is_old(topic(live), net::now_ms()))
    }

    /// This page's name for the ground's lease.
    pub fn operator(self) -> String {
        self.operator.get()
    }

    /// Calls the operator something else, from now on and after a reload. Control does not go along.
    pub fn rename(self, name: &str) {
        let operator = store::rename(name);
        if operator == self.operator.get_untracked() || self.session.with_untracked(|s| s.name.is_some()) {
            return;
        }
        if self.live.with_value(|live| live.holder() == self.operator.get_untracked()) {
            self.command("Release control", "DELETE", "lease", json!({}));
        }
        self.operator.set(operator);
        if let Some(vehicle) = self.app.with_value(|app| app.vehicle.clone()) {
            self.perform(Effect::OpenSocket(vehicle));
        }
    }

    /// Why the account of this page may not do what takes `needed`; `None` where it may.
    pub fn lacks(self, needed: Role) -> Option<String> {
        let role = self.session.with(|session| session.role).filter(|role| *role < needed)?;
        Some(format!("You are signed in as {}: it takes {}", role.name(), needed.name()))
    }

    /// Why the vehicle would not be commanded from this page; `None` where it would.
    pub fn refusal(self) -> Option<String> {
        if let Some(why) = self.lacks(Role::Operator) {
            return Some(why);
        }
        if let Some(name) = self.app(|app| app.elsewhere().map(|ground| ground.name.clone())) {
            return Some(format!("It is flown from ground {name}: here its motors can be cut, and nothing else"));
        }
        let operator = self.operator.get();
        let open = self.app(|app| app.socket == Socket::Open);
        self.live(|live| {
            let holder = live.holder();
            let other = open && !holder.is_empty() && holder != operator;
            other.then(|| format!("{holder} controls this vehicle: take over first"))
        })
    }

    /// Says `why` beside the pointer, for a while.
    pub fn refuse(self, why: String) {
        self.say_at(crate::keys::pointer(), why, false);
    }

    /// Says as a notice, and at `asked_at`, where it was asked for, why nothing came of `what`.
    pub fn failed(self, asked_at: (f64, f64), what: &str, failure: &Failure) {
        self.say_at(asked_at, failure.text.clone(), true);
        self.tell(Tone::Error, format!("{what}: {}", failure.text));
    }

    fn say_at(self, (x, y): (f64, f64), text: String, noticed: bool) {
        let number = self.hint.with_untracked(|hint| hint.as_ref().map_or(0, |hint| hint.number + 1));
        self.hint.set(Some(Hint { number, text, noticed, x, y }));
        let done = move || {
            if self.hint.with_untracked(|hint| hint.as_ref().is_some_and(|hint| hint.number == number)) {
                self.hint.set(None);
            }
        };
        set_timeout(done, HINT);
    }

    /// Sends a command to the vehicle shown. The answer becomes a notice named `what`; a refusal is also said where it was asked.
    pub fn command(self, what: impl Into<String>, method: &'static str, action: &str, body: Value) {
        self.command_then(what, method, action, body, |_| {});
    }

    /// As [`Ctx::command`]; `then` is called when it was accepted, or with why it was not.
    pub fn command_then(
        self,
        what: impl Into<String>,
        method: &'static str,
        action: &str,
        body: Value,
        then: impl FnOnce(Result<(), &str>) + 'static,
    ) {
        let what = what.into();
        // The cut asks nobody; who holds control is not asked for it.
        if !matches!(action, "cut" | "lease")
            && let Some(why) = untrack(|| self.refusal())
        {
            then(Err(&why));
            return self.refuse(why);
        }
        let Some(vehicle) = self.app.with_value(|app| app.vehicle.clone()) else {
            self.dispatch(Event::Tell(Tone::Error, format!("{what}: no vehicle is connected")));
            return then(Err("no vehicle is connected"));
        };
        let id = String::from(js_sys::encode_uri_component(&vehicle));
        let url = format!("/api/v1/vehicles/{id}/{action}");
        let (operator, seen_us) = (self.operator.get_untracked(), self.seen_us());
        let urgent = api::counts_late(method, action, &body);
        let within_ms = (!urgent).then_some(net::COMMAND_MS);
        let asked_at = crate::keys::pointer();
        let turn = api::in_order(action).then(|| self.turns.try_update_value(|turns| turns.take(urgent))).flatten();
        let (turn, kept) = turn.unzip();
        let kept = Rc::new(Cell::new(kept));
        if turn.is_some() {
            let over = Rc::clone(&kept);
            set_timeout(move || drop(over.take()), turns::LONGEST);
        }
        leptos::task::spawn_local(async move {
            let mut overtaken = false;
            if let Some(mut turn) = turn {
                turn.comes().await;
                overtaken = self.turns.with_value(|turns| turns.overtook(&turn));
            }
            let answer = if overtaken {
                Err(Failure { status: 0, text: "not sent, what was asked after it comes first".to_owned() })
            } else {
                net::command(method, &url, body.to_string(), &operator, seen_us, within_ms).await
            };
            drop(kept.take());
            if let Err(failure) = &answer {
                self.say_at(asked_at, failure.text.clone(), true);
            }
            then(answer.as_ref().map(|_| ()).map_err(|failure| failure.text.as_str()));
            self.dispatch(Event::Answered(what, answer));
        });
    }

    /// Flight time of the newest message shown, µs; zero before the first.
    pub fn seen_us(self) -> u64 {
        self.live.with_value(|live| live.clock.newest_us())
    }

    /// Cuts the motors. Needs no lease, no confirmation.
    pub fn cut(self) {
        self.command("Cut motors", "POST", "cut", json!({}));
    }

    /// Has the vehicle land, where one flies that can: a recording flown again cannot.
    pub fn land(self) {
        if !self.live.with_value(Live::is_replay) {
            let mode = crate::model::names::mode_json(Mode::Land);
            self.command("Land", "POST", "mode", json!(rest::Mode { mode }));
        }
    }

    /// Takes control, from whoever has it.
    pub fn take_control(self) {
        self.command("Take control", "PUT", "lease", json!({}));
    }

    /// Asks for an altitude, m.
    pub fn set_altitude(self, altitude_m: f64) {
        // Steps of 0.1 must not become 0.7999999.
        let rounded = (altitude_m * 1e4).round() / 1e4;
        let what = format!("Setpoint {} m", crate::model::format::fixed(rounded, 2));
        let vehicle = self.app.with_value(|app| app.vehicle.clone());
        self.target.set_value(Some(self.live.with_value(|live| Target::new(rounded, vehicle, live))));
        self.command_then(
            what,
            "POST",
            "setpoint",
            json!(rest::Setpoint { altitude_m: Some(rounded), ..rest::Setpoint::default() }),
            move |answer| {
                let now_us = self.flight_now_us() as u64;
                self.target.update_value(|target| match target {
                    // Something else has been asked for since.
                    Some(asked) if asked.altitude_m != rounded => {}
                    Some(asked) if answer.is_ok() => asked.accepted(now_us),
                    _ => *target = None,
                });
            },
        );
    }

    /// What was asked for counts no longer than [`Target::counts`] says.
    fn forget_reached(self) {
        let vehicle = self.app.with_value(|app| app.vehicle.clone());
        self.live.with_value(|live| {
            self.target.update_value(|target| drop(target.take_if(|asked| !asked.counts(vehicle.as_ref(), live))));
        });
    }

    /// Moves the altitude setpoint by one step up or down, from what was asked for last and not from where the
    /// vehicle's profile happens to be, onto the grid of the steps and within the vehicle's limits.
    pub fn step_altitude(self, up: bool) {
        self.forget_reached();
        let (now, limits) =
            self.live.with_value(|live| (live.setpoint_m(), live.description.get().and_then(|d| d.limits)));
        let asked = self.target.with_value(|target| target.as_ref().map(|asked| asked.altitude_m));
        let Some(from) = asked.or(now) else {
            self.dispatch(Event::Tell(Tone::Error, "Setpoint: the vehicle has not reported its setpoint yet".into()));
            return;
        };
        let target = setpoint::stepped(from, up);
        self.set_altitude(match limits {
            Some(l) if l.altitude_max_m > l.altitude_min_m => target.clamp(l.altitude_min_m, l.altitude_max_m),
            _ => target,
        });
    }

    /// Starts or stops a recording by hand.
    pub fn toggle_recording(self) {
        let on = self.live.with_value(|live| live.ground.recording.as_ref().is_some_and(|r| r.recording));
        let what = if on { "Stop recording" } else { "Start recording" };
        self.command(what, "POST", "recording", json!(rest::Recording { on: !on }));
    }

    /// Aborts every attack.
    pub fn abort_attacks(self) {
        self.command("Abort attacks", "DELETE", "attacks", json!({}));
    }

    /// Shows another page; the one shown keeps what its address says.
    pub fn go(self, route: Route) {
        if self.route.with_untracked(|shown| *shown == route) {
            return;
        }
        if let Ok(history) = window().history() {
            let _ = history.push_state_with_url(&wasm_bindgen::JsValue::NULL, "", Some(&route.path()));
        }
        self.route.set(route);
    }

    /// Tells the operator something.
    pub fn tell(self, tone: Tone, text: impl Into<String>) {
        self.dispatch(Event::Tell(tone, text.into()));
    }
}

/// Runs `act` again and again while the calling component lives.
pub fn every(period: Duration, act: impl Fn() + 'static) {
    // Fails only without a window.
    if let Ok(timer) = set_interval_with_handle(act, period) {
        on_cleanup(move || timer.clear());
    }
}

/// The handle, from the root.
pub fn ctx() -> Ctx {
    expect_context()
}

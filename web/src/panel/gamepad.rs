//! A gamepad flies the vehicle shown, in stabilise and in the air, while its right shoulder button is held. Whoever lets go
//! of it has the vehicle level, and holding its altitude.

use std::time::Duration;

use leptos::{ev, prelude::*};
use plumbline_proto::v1::Mode;
use plumbline_rest::command::{self as rest, Answer};
use serde::Serialize;
use serde_json::json;
use wasm_bindgen::JsCast;
use web_sys::GamepadButton;

use crate::{
    ctx::{Ctx, ctx, every},
    event::{Event, Failure},
    model::{
        curves::DEGREES,
        format,
        instrument::Instrument,
        names,
        stick::{Asked, Sticks},
    },
    net,
};

/// The right shoulder button of the standard mapping.
const DEAD_MAN: u32 = 5;
/// How often the sticks are read, and sent unless the answer before is still awaited.
const PERIOD: Duration = Duration::from_millis(50);
/// How long an order of the sticks may wait for its answer, ms: then they are read anew.
const STICKS_MS: u32 = 500;

/// The first gamepad there is: its name, its sticks, and whether the dead-man button is held. A browser keeps the last that it
/// read of it for a hidden page, which therefore holds nothing.
fn gamepad() -> Option<(String, Sticks, bool)> {
    let pads = window().navigator().get_gamepads().ok()?;
    let pad = pads.iter().find_map(|pad| pad.dyn_into::<web_sys::Gamepad>().ok().filter(|pad| pad.connected()))?;
    let axes = pad.axes();
    let axis = |i| axes.get(i).as_f64().filter(|v| v.is_finite()).unwrap_or(0.0);
    let held = pad.buttons().get(DEAD_MAN).dyn_into::<GamepadButton>().is_ok_and(|button| button.pressed());
    let held = held && !document().hidden();
    Some((pad.id(), Sticks { turn: axis(0), down: axis(1), right: axis(2), back: axis(3) }, held))
}

/// Why the sticks do nothing now; `None` where they fly.
fn idle(ctx: Ctx) -> Option<&'static str> {
    ctx.live.with_value(|live| {
        let Some(status) = live.status.get() else { return Some("No vehicle is there.") };
        if live.is_replay() {
            return Some("A recording flown again has no sticks.");
        }
        if !status.armed || status.disarms_in_s.is_some() {
            return Some("It takes over in the air: take off in altitude hold, then choose Stabilise.");
        }
        (status.mode() != Mode::Stabilise).then_some("Choose Stabilise: there the sticks are tilt, turn and thrust.")
    })
}

/// What a vehicle is asked for while the dead-man button is held.
#[derive(Debug, Clone)]
struct Held {
    vehicle: String,
    asked: Asked,
    /// Flight time of the newest message of it that was shown, µs.
    seen_us: u64,
}

/// What a gamepad does, between two readings.
#[derive(Clone, Copy)]
struct Pad {
    ctx: Ctx,
    name: RwSignal<Option<String>>,
    held: RwSignal<Option<Held>>,
    /// An order of the sticks waits for its answer.
    waits: StoredValue<bool>,
    read_ms: StoredValue<f64>,
}

impl Pad {
    fn read(self) {
        let found = gamepad();
        let name = found.as_ref().map(|(name, ..)| name.clone());
        if self.name.with_untracked(|known| *known != name) {
            self.name.set(name);
        }
        let now = net::now_ms();
        let dt_s = ((now - self.read_ms.get_value()) * 1e-3).clamp(0.0, 0.2);
        self.read_ms.set_value(now);
        let flies = found.filter(|(.., held)| *held && idle(self.ctx).is_none());
        let flies = flies.zip(self.ctx.app.with_value(|app| app.vehicle.clone()));
        let before = self.held.get_untracked();
        match (flies, before) {
            (Some(((_, sticks, _), vehicle)), before) if before.as_ref().is_none_or(|held| held.vehicle == vehicle) => {
                if let Some(why) = untrack(|| self.ctx.refusal()) {
                    return self.ctx.refuse(why);
                }
                let (yaw_rad, [tilt, throttle]) = self.ctx.live.with_value(|live| {
                    let yaw = Instrument::newest(live, 0.0).roll_pitch_yaw_deg.map_or(0.0, |[_, _, yaw]| yaw / DEGREES);
                    let limits = live.description.get().and_then(|d| d.limits);
                    (yaw, limits.map_or([0.0, 1.0], |l| [l.tilt_max_rad, f64::INFINITY]))
                });
                let before = before.map_or(Asked::level(yaw_rad), |held| held.asked);
                let asked = before.after(sticks, dt_s, tilt, throttle);
                let held = Held { vehicle, asked, seen_us: self.ctx.seen_us() };
                self.held.set(Some(held.clone()));
                self.send(held);
            }
            // Let go, lost, landed, or another vehicle is shown.
            (_, Some(held)) => {
                self.held.set(None);
                self.let_go(held);
            }
            (_, None) => {}
        }
    }

    /// Only what was answered last is followed: sticks that were not heard in time are read anew.
    fn send(self, Held { vehicle, asked, seen_us }: Held) {
        if self.waits.get_value() {
            return;
        }
        self.waits.set_value(true);
        leptos::task::spawn_local(async move {
            let answer = command(self.ctx, &vehicle, "setpoint", asked.setpoint(), seen_us, STICKS_MS).await;
            self.waits.try_update_value(|waits| *waits = false);
            // What overtook it is the release, after which an order of the sticks is refused, and may be.
            if answer.is_err() && self.held.try_with_untracked(Option::is_some) == Some(true) {
                self.ctx.dispatch(Event::Answered("Sticks".to_owned(), answer));
            }
        });
    }

    /// Has the vehicle that was flown, whichever is shown by now, hold its altitude: it is level then, and deaf to sticks that are
    /// still under way. Where it cannot hold it, it is asked to be level.
    fn let_go(self, held: Held) {
        let shown = self.ctx.app.with_value(|app| app.vehicle.as_ref() == Some(&held.vehicle));
        if shown && idle(self.ctx).is_some() {
            return;
        }
        let Held { vehicle, asked, seen_us } = held;
        let seen_us = if shown { self.ctx.seen_us() } else { seen_us };
        let ctx = self.ctx;
        leptos::task::spawn_local(async move {
            let mode = rest::Mode { mode: names::mode_json(Mode::AltitudeHold) };
            let held = command(ctx, &vehicle, "mode", mode, seen_us, net::COMMAND_MS).await;
            let refused = held.is_err();
            ctx.dispatch(Event::Answered("Sticks let go: altitude hold".to_owned(), held));
            if refused {
                let level = Asked::level(asked.roll_pitch_yaw_rad[2]).setpoint();
                let answer = command(ctx, &vehicle, "setpoint", level, seen_us, net::COMMAND_MS).await;
                ctx.dispatch(Event::Answered("Sticks let go: level".to_owned(), answer));
            }
        });
    }
}

/// Sends a command to a vehicle, shown or not, of which `seen_us` was shown last.
async fn command(
    ctx: Ctx,
    vehicle: &str,
    action: &str,
    body: impl Serialize,
    seen_us: u64,
    within_ms: u32,
) -> Result<Answer, Failure> {
    let url = format!("/api/v1/vehicles/{}/{action}", js_sys::encode_uri_component(vehicle));
    let who = untrack(|| ctx.operator());
    net::command("POST", &url, json!(body).to_string(), &who, seen_us, Some(within_ms)).await
}

/// The card; nothing where no gamepad is connected. A browser shows one once a button of it was pressed.
#[component]
pub fn GamepadCard() -> impl IntoView {
    let ctx = ctx();
    let pad = Pad {
        ctx,
        name: RwSignal::new(None),
        held: RwSignal::new(None),
        waits: StoredValue::new(false),
        read_ms: StoredValue::new(net::now_ms()),
    };
    every(PERIOD, move || pad.read());
    // At once: a hidden page's timers are slow.
    let hiding = window_event_listener(ev::visibilitychange, move |_| pad.read());
    on_cleanup(move || {
        hiding.remove();
        // Whoever leaves this page has let go.
        if let Some(Some(held)) = pad.held.try_get_untracked() {
            pad.let_go(held);
        }
    });
    let vehicle = move || ctx.app(|app| app.vehicle.clone()).unwrap_or_else(|| format::NONE.to_owned());
    let why = Memo::new(move |_| {
        ctx.live(|_| ());
        idle(ctx)
    });
    let degrees = |rad: f64| format!("{}°", format::signed(rad * DEGREES, 0));
    let told = move || match (pad.held.get(), why.get()) {
        (Some(Held { asked, .. }), _) => {
            let [roll, pitch, yaw] = asked.roll_pitch_yaw_rad.map(degrees);
            format!("roll {roll}, pitch {pitch}, yaw {yaw}, thrust {} %", format::fixed(100.0 * asked.throttle, 0))
        }
        (None, Some(why)) => why.to_owned(),
        (None, None) => "Hold the right shoulder button (R1); letting go levels and holds the altitude.".to_owned(),
    };
    view! {
        <Show when=move || pad.name.with(Option::is_some)>
            <section class="card gamepad" class:flies=move || pad.held.with(Option::is_some) aria-label="Gamepad">
                <header><h2>"Gamepad"</h2><small class="quiet one-line push" title=move || pad.name.get()>{move || pad.name.get()}</small></header>
                <p><b>{move || if pad.held.with(Option::is_some) { format!("Flies {}", vehicle()) } else { format!("For {}", vehicle()) }}</b></p>
                <p class="num">{told}</p>
            </section>
        </Show>
    }
}

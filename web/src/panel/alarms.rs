//! What must not be missed: bars on a line that is kept for them, so that they cover no chart and move nothing under the
//! pointer, and a few words beside the pointer when what was pressed is refused.

use leptos::prelude::*;
use plumbline_proto::v1::Failsafe;
use plumbline_rest::command as rest;
use serde_json::json;
use wasm_bindgen::JsCast;

use super::events::Events;
use crate::{
    ctx::{Ctx, ctx},
    keys,
    model::{format, names},
    net,
    tones::{Tones, Tune},
};

/// From this age on the bar says how old the data are, s.
const OLD_S: f64 = 1.0;
/// Charge below which the battery is low, and nearly empty.
pub(super) const LOW: f64 = 0.30;
pub(super) const EMPTY: f64 = 0.15;

/// The failsafe that acts, or ended the flight: its name, the same with its reason, and whether it still acts.
fn failsafe(ctx: Ctx) -> Option<(&'static str, String, bool)> {
    ctx.live(|live| {
        let status = live.status.get().filter(|s| s.failsafe() != Failsafe::None)?;
        let title = names::failsafe(status.failsafe());
        let reason = &status.failsafe_reason;
        let text = if reason.is_empty() { title.to_owned() } else { format!("{title} – {reason}") };
        Some((title, text, status.armed || status.cut_latched))
    })
}

/// Battery, where it is low: (what it is, the same with its figures, nearly empty?).
fn battery(ctx: Ctx) -> Option<(&'static str, String, bool)> {
    ctx.live(|live| {
        let battery_v = live.battery_v()?;
        let status = live.status.get().filter(|status| status.battery_fraction < LOW)?;
        let empty = status.battery_fraction < EMPTY;
        let what = if empty { "Battery nearly empty" } else { "Battery low" };
        let (volts, percent) = (format::fixed(battery_v, 1), format::fixed(100.0 * status.battery_fraction, 0));
        let todo = if status.armed { ": land now" } else { "" };
        // A failsafe beside it says the rest.
        let text = match status.failsafe() {
            Failsafe::BatteryLow | Failsafe::BatteryDescend => format!("{volts} V"),
            _ => format!("{what}, {volts} V · {percent} %{todo}."),
        };
        Some((what, text, empty))
    })
}

/// Who took control from this page, and when (wall time of the ground, µs).
fn lost_to(ctx: Ctx) -> Option<(String, u64)> {
    let operator = ctx.operator();
    ctx.live(|live| {
        let lease = live.ground.lease.as_ref()?;
        (lease.taken_from == operator && lease.holder != operator && !lease.holder.is_empty())
            .then(|| (lease.holder.clone(), lease.wall_time_us))
    })
}

/// What outlives a visit to another page: what was read and need not be shown again, and where the bars are.
#[derive(Clone, Copy)]
pub struct AlarmState {
    /// The loss of control that was read, by its time.
    lost: RwSignal<u64>,
    /// The failsafe that was, by its text.
    failsafe: RwSignal<String>,
    /// Lines on the page that hold the bars.
    lines: RwSignal<usize>,
}

impl Default for AlarmState {
    fn default() -> Self {
        Self { lost: RwSignal::new(0), failsafe: RwSignal::new(String::new()), lines: RwSignal::new(0) }
    }
}

/// What is still so is sounded again after this long, s: a failsafe, an empty battery.
const REPEAT_S: u64 = 4;

/// Sounds what the bars say, for as long as the page lives: once when it begins, again and again while a failsafe acts or
/// the battery is nearly empty.
pub fn sound(ctx: Ctx) {
    let tones: Tones = expect_context();
    let acts = Memo::new(move |_| failsafe(ctx).is_some_and(|(.., acts)| acts));
    let battery = Memo::new(move |_| battery(ctx).map(|(.., empty)| empty));
    let round = Memo::new(move |_| {
        let repeats = acts.get() || battery.get() == Some(true);
        repeats.then(|| (ctx.live(|_| net::now_ms()) * 1e-3) as u64 / REPEAT_S)
    });
    Effect::new(move |before: Option<Option<u64>>| {
        let now = round.get();
        if now.is_some() && before.is_some_and(|before| before != now) {
            tones.play(if acts.get_untracked() { Tune::Failsafe } else { Tune::Battery });
        }
        now
    });
    // What was so before this page came is told by its bars alone.
    let once = move |tune: Tune, is: Memo<bool>| {
        Effect::new(move |before: Option<bool>| {
            let now = is.get();
            if now && before == Some(false) {
                tones.play(tune);
            }
            now
        });
    };
    once(Tune::Battery, Memo::new(move |_| battery.get() == Some(false)));
    once(Tune::Old, Memo::new(move |_| ctx.age_s().is_some_and(|age| age >= OLD_S)));
    once(Tune::Lost, Memo::new(move |_| lost_to(ctx).is_some()));
}

/// The bars, beside each other. What an alarm is is told once, when it begins: what counts on, its age or its figures, is there to be
/// read and not announced, or a screen reader would begin anew with each change.
#[component]
pub fn Alarms() -> impl IntoView {
    let ctx = ctx();
    let AlarmState { lost: read, failsafe: ended, .. } = expect_context();
    let tones: Tones = expect_context();
    let age = Memo::new(move |_| ctx.age_s().filter(|age| *age >= OLD_S).map(|age| age.floor()));
    let failsafe = Memo::new(move |_| failsafe(ctx));
    let battery = Memo::new(move |_| battery(ctx));
    let lost = Memo::new(move |_| lost_to(ctx));
    let simulated = Memo::new(move |_| ctx.live(|live| live.description.get().is_some_and(|d| d.vehicle == "sim")));
    view! {
        <div class="alarms" role="alert" aria-atomic="false" aria-label="Alarms">
            {move || age.get().map(|s| view! {
                <p class="alarm bad data-age"><span class="visually-hidden">"Data is old."</span><b aria-live="off">{format!("Data is {s:.0} s old.")}</b> " What is shown was then; commands may still arrive."</p>
            })}
            {move || failsafe.get().filter(|(_, text, acts)| *acts || *text != ended.get()).map(|(title, text, acts)| view! {
                <p class="alarm loud" class:bad=acts>
                    <span class="visually-hidden">{title}</span>
                    <b aria-live="off" title=text.clone()>{text.clone()}</b>
                    {acts.then(|| view! {
                        <button type="button" class="small" title="Tones for alarms on or off (T)" on:click=move |_| tones.switch(!tones.on.get_untracked())>
                            {move || if tones.on.get() { "Mute" } else { "Unmute" }}
                        </button>
                    })}
                    {(!acts).then(|| view! {
                        <button type="button" class="plain" aria-label="Dismiss" on:click=move |_| ended.set(text.clone())>"×"</button>
                    })}
                </p>
            })}
            {move || battery.get().map(|(what, text, empty)| view! {
                <p class="alarm" class:bad=empty>
                    <span class="visually-hidden">{what}</span>
                    <b aria-live="off">{text}</b>
                    {simulated.get().then(|| view! {
                        <button type="button" class="small" on:click=move |_| ctx.command("New battery", "POST", "simulator", json!(rest::Simulator { battery: true, reset: false }))>"New battery"</button>
                    })}
                </p>
            })}
            {move || lost.get().filter(|(_, at)| *at != read.get()).map(|(who, at)| view! {
                <p class="alarm">
                    <b>{format!("{who} took control.")}</b> " You are viewing; the motor cut stays yours."
                    <button type="button" class="small" on:click=move |_| ctx.take_control()>"Take over"</button>
                    <button type="button" class="plain" aria-label="Dismiss" on:click=move |_| read.set(at)>"×"</button>
                </p>
            })}
        </div>
    }
}

/// Why what was pressed was not done, beside the pointer.
#[component]
pub fn HintBubble() -> impl IntoView {
    let ctx = ctx();
    move || {
        ctx.hint.get().map(|hint| {
            let place =
                format!("left:clamp(8.5rem,{:.0}px,100vw - 8.5rem);top:min({:.0}px,100dvh - 5rem)", hint.x, hint.y);
            view! { <p class="hint" role="alert" style=place>{hint.text}</p> }
        })
    }
}

/// The line above the charts: what happened last, and on it whatever must not be missed.
#[component]
pub fn StatusLine() -> impl IntoView {
    let AlarmState { lines, .. } = expect_context();
    lines.update(|n| *n += 1);
    on_cleanup(move || lines.update(|n| *n = n.saturating_sub(1)));
    view! { <div class="status-line"><Events /><Alarms /></div> }
}

/// The bars on top of a page that keeps no line for them.
#[component]
pub fn PageAlarms() -> impl IntoView {
    let AlarmState { lines, .. } = expect_context();
    view! { <Show when=move || lines.get() == 0><div class="page-alarms"><Alarms /></div></Show> }
}

/// Landing and the motor cut, always within reach of a thumb where the screen is small.
#[component]
pub fn Dock() -> impl IntoView {
    let ctx = ctx();
    let flies = Memo::new(move |_| ctx.live(|live| live.status.get().is_some_and(|s| s.armed) && !live.is_replay()));
    view! {
        <section class="dock" aria-label="Land and cut">
            <button type="button" class="land" disabled=move || !flies.get() on:click=move |_| ctx.land()>"Land"</button>
            <button type="button" class="cut" on:click=move |_| ctx.cut()>"CUT MOTORS"</button>
        </section>
    }
}

/// Does this event only fold or unfold a list, which commands nothing?
fn unfolds(e: &leptos::ev::Event) -> bool {
    let at = e.target().and_then(|target| target.dyn_into::<web_sys::Element>().ok());
    at.is_some_and(|at| at.closest("summary").ok().flatten().is_some())
}

/// Controls that are refused while another operator is in control: they look so, and say why where they are pressed. Lists can be
/// unfolded all the same.
#[component]
pub fn Guarded(children: Children) -> impl IntoView {
    let ctx = ctx();
    let refusal = Memo::new(move |_| ctx.refusal());
    let stop = move |e: &leptos::ev::Event| {
        if let Some(why) = refusal.get_untracked().filter(|_| !unfolds(e)) {
            e.prevent_default();
            e.stop_propagation();
            ctx.refuse(why);
        }
    };
    view! {
        <div
            class="guarded"
            class:refused=move || refusal.with(Option::is_some)
            role="group"
            aria-label="Commands"
            aria-disabled=move || refusal.with(Option::is_some).then_some("true")
            aria-description=refusal
            on:click:capture=move |e| stop(&e)
            on:submit:capture=move |e| stop(&e)
            on:pointerdown:capture=move |e| {
                if refusal.with_untracked(Option::is_some) && !unfolds(&e) {
                    keys::pointed(f64::from(e.client_x()), f64::from(e.client_y()));
                    stop(&e);
                }
            }
            on:keydown:capture=move |e| {
                if matches!(e.key().as_str(), "Enter" | " ") {
                    stop(&e);
                }
            }
        >{children()}</div>
    }
}

//! What must not be missed: bars on a line that is kept for them, so that they cover no chart and move nothing under the
//! pointer, and a few words beside the pointer when what was pressed is refused.

use leptos::prelude::*;
use plumbline_proto::v1::Failsafe;
use plumbline_rest::{command as rest, people::Role};
use serde_json::json;
use wasm_bindgen::JsCast;

use super::events::Events;
use crate::{
    ctx::{Ctx, ctx},
    keys,
    model::{format, live::Live, names},
    net,
    tones::{Tones, Tune},
};

/// From this age on the bar says how old the data are, s.
const OLD_S: f64 = 1.0;
/// Charge below which the battery is low, and nearly empty.
const LOW: f64 = 0.30;
const EMPTY: f64 = 0.15;

/// The failsafe that acts, or ended the flight.
#[derive(Debug, Clone, PartialEq)]
struct Acting {
    failsafe: Failsafe,
    reason: String,
    /// Does it still act?
    acts: bool,
}

impl Acting {
    fn of(live: &Live) -> Option<Self> {
        let status = live.status.get().filter(|s| s.failsafe() != Failsafe::None)?;
        let (failsafe, reason) = (status.failsafe(), status.failsafe_reason.clone());
        Some(Self { failsafe, reason, acts: status.armed || status.cut_latched })
    }

    /// Its name.
    fn title(&self) -> &'static str {
        names::failsafe(self.failsafe)
    }

    /// Its reason, as it follows its name.
    fn why(&self) -> String {
        if self.reason.is_empty() { String::new() } else { format!(" – {}", self.reason) }
    }

    /// Both.
    fn text(&self) -> String {
        self.title().to_owned() + &self.why()
    }
}

/// The battery as it is shown: text is written of it only once it changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Battery {
    volts: f64,
    /// Of its charge; whole ones.
    percent: f64,
    /// By the charge itself: what is shown is rounded.
    pub low: bool,
    /// Nearly empty?
    pub empty: bool,
}

impl Battery {
    pub(super) fn of(live: &Live) -> Option<Self> {
        let (status, volts) = live.status.get().zip(live.battery_v())?;
        let charge = status.battery_fraction;
        Some(Self { volts, percent: (100.0 * charge).round_ties_even(), low: charge < LOW, empty: charge < EMPTY })
    }

    /// Voltage and charge.
    pub(super) fn text(self) -> String {
        format!("{} V · {} %", format::fixed(self.volts, 1), format::fixed(self.percent, 0))
    }
}

/// A battery that is low.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LowBattery {
    battery: Battery,
    armed: bool,
    /// A failsafe beside it says what is to be done.
    told: bool,
}

impl LowBattery {
    fn of(live: &Live) -> Option<Self> {
        let battery = Battery::of(live).filter(|battery| battery.low)?;
        let status = live.status.get()?;
        let told = matches!(status.failsafe(), Failsafe::BatteryLow | Failsafe::BatteryDescend);
        Some(Self { battery, armed: status.armed, told })
    }

    fn title(self) -> &'static str {
        if self.battery.empty { "Battery nearly empty" } else { "Battery low" }
    }

    /// The same with its figures.
    fn text(self) -> String {
        if self.told {
            return format!("{} V", format::fixed(self.battery.volts, 1));
        }
        let todo = if self.armed { ": land now" } else { "" };
        format!("{}, {}{todo}.", self.title(), self.battery.text())
    }
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
    let acts = Memo::new(move |_| ctx.live(Acting::of).is_some_and(|failsafe| failsafe.acts));
    let battery = Memo::new(move |_| ctx.live(LowBattery::of).map(|low| low.battery.empty));
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
    let failsafe = Memo::new(move |_| ctx.live(Acting::of));
    let battery = Memo::new(move |_| ctx.live(LowBattery::of));
    let lost = Memo::new(move |_| lost_to(ctx));
    let simulated = Memo::new(move |_| ctx.live(|live| live.description.get().is_some_and(|d| d.vehicle == "sim")));
    view! {
        <div class="alarms" role="alert" aria-atomic="false" aria-label="Alarms">
            {move || age.get().map(|s| view! {
                <p class="alarm bad data-age"><span class="visually-hidden">"Data is old."</span><b aria-live="off">{format!("Data is {s:.0} s old.")}</b> " What is shown was then; commands may still arrive."</p>
            })}
            {move || failsafe.get().map(|f| (f.text(), f)).filter(|(text, f)| f.acts || *text != ended.get()).map(|(text, f)| view! {
                <p class="alarm loud" class:bad=f.acts>
                    <span class="visually-hidden">{f.title()}</span>
                    <b aria-live="off">{f.title()}<span>{f.why()}</span></b>
                    {f.acts.then(|| view! {
                        <button type="button" class="small" title="Tones for alarms on or off (T)" on:click=move |_| tones.switch(!tones.on.get_untracked())>
                            {move || if tones.on.get() { "Mute" } else { "Unmute" }}
                        </button>
                    })}
                    {(!f.acts).then(|| view! {
                        <button type="button" class="plain" aria-label="Dismiss" on:click=move |_| ended.set(text.clone())>"×"</button>
                    })}
                </p>
            })}
            {move || battery.get().map(|low| view! {
                <p class="alarm" class:bad=low.battery.empty>
                    <span class="visually-hidden">{low.title()}</span>
                    <b aria-live="off">{low.text()}</b>
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
            let role = (!hint.noticed).then_some("alert");
            view! { <p class="hint" role=role aria-hidden=hint.noticed.then_some("true") style=place>{hint.text}</p> }
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
            <h2 class="visually-hidden">"Land and cut"</h2>
            <Guarded><button type="button" class="land" disabled=move || !flies.get() on:click=move |_| ctx.land()>"Land"</button></Guarded>
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
pub fn Guarded(
    /// Where it is nothing of the vehicle's, and whoever controls it has no part in it: the role that it takes.
    #[prop(optional)]
    takes: Option<Role>,
    children: Children,
) -> impl IntoView {
    let ctx = ctx();
    let refusal = Memo::new(move |_| takes.map_or_else(|| ctx.refusal(), |role| ctx.lacks(role)));
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

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::{Kind, v1::Status};

    use crate::model::live::append;

    /// Of a vehicle with this status.
    fn live(status: &Status) -> Live {
        let (mut live, mut batch) = (Live::recorded(), Vec::new());
        append(&mut batch, Kind::Status, 0, 1, 1_000_000, status);
        live.ingest(&batch, 0.0).unwrap();
        live
    }

    #[test]
    fn the_battery_is_the_same_until_a_figure_that_is_shown_is_another() {
        let of = |battery_v, battery_fraction| {
            Battery::of(&live(&Status { battery_v, battery_fraction, ..Status::default() })).unwrap()
        };
        let (full, less) = (of(12.2, 0.952), of(12.2, 0.944));
        assert_eq!((full.text().as_str(), full == of(12.2, 0.9546), full == less), ("12.2 V · 95 %", true, false));
        // What rounds to the limit is below it all the same.
        let low = of(11.0, 0.2996);
        assert_eq!((low.text().as_str(), low.low, low.empty), ("11.0 V · 30 %", true, false));
        assert!(of(10.4, 0.149).empty && !of(11.0, 0.3).low);
        // As it was written without rounding first: a tie goes to the even figure.
        assert_eq!((of(11.0, 0.125).text(), format::fixed(12.5, 0)), ("11.0 V · 12 %".to_owned(), "12".to_owned()));
        assert_eq!(Battery::of(&live(&Status::default())), None);
    }

    #[test]
    fn a_low_battery_says_what_is_to_be_done_unless_a_failsafe_does() {
        let status = Status { battery_v: 10.4, battery_fraction: 0.12, armed: true, ..Status::default() };
        let text = |status: &Status| LowBattery::of(&live(status)).map(LowBattery::text);
        assert_eq!(text(&status).as_deref(), Some("Battery nearly empty, 10.4 V · 12 %: land now."));
        let landed = Status { armed: false, battery_fraction: 0.2, ..status.clone() };
        assert_eq!(text(&landed).as_deref(), Some("Battery low, 10.4 V · 20 %."));
        let descends = Status { failsafe: Failsafe::BatteryDescend.into(), ..status.clone() };
        assert_eq!(text(&descends).as_deref(), Some("10.4 V"));
        assert_eq!(text(&Status { battery_fraction: 0.5, ..status }), None);
    }

    #[test]
    fn a_failsafe_has_its_reason_and_acts_while_armed_or_cut() {
        let status = Status {
            failsafe: Failsafe::TiltCut.into(),
            failsafe_reason: "41° above 30°".to_owned(),
            cut_latched: true,
            ..Status::default()
        };
        let cut = Acting::of(&live(&status)).unwrap();
        assert_eq!((cut.text(), cut.acts), (format!("{} – 41° above 30°", names::failsafe(Failsafe::TiltCut)), true));
        assert!(!Acting::of(&live(&Status { cut_latched: false, ..status })).unwrap().acts);
        assert_eq!(Acting::of(&live(&Status::default())), None);
    }
}

//! Altitude setpoint: steps, presets, an exact field; and a card for what else the mode takes.

use leptos::prelude::*;
use plumbline_proto::v1::Mode;
use serde_json::json;

use super::paths::{PathForm, PathsButton};
use super::top_view::TopView;
use crate::{
    ctx::ctx,
    keys,
    model::{curves::DEGREES, format, live::Live},
};

/// Altitudes one press away, m.
const PRESETS_M: [f64; 3] = [0.5, 0.8, 1.0];
/// One press of a step button or an arrow key, m.
pub const STEP_M: f64 = 0.1;
/// Altitudes that differ by no more are the same, m.
const SAME_M: f64 = 1e-6;
/// A profile that comes no nearer to an altitude than it was for this long does not go there, flight time, µs: at the default
/// limits one that turns round is as near again after 1 s.
const STANDS_US: u64 = 2_000_000;

/// The next altitude on the grid of [`STEP_M`] above or below `from_m`.
pub fn stepped(from_m: f64, up: bool) -> f64 {
    // What lies on the grid, but for rounding, moves by a whole step.
    const SLACK: f64 = 1e-6;
    let steps = from_m / STEP_M;
    (if up { (steps + SLACK).floor() + 1.0 } else { (steps - SLACK).ceil() - 1.0 }) * STEP_M
}

/// An altitude asked for, while the vehicle's profile goes there: steps count from it. Failsafes, paths and other operators
/// may have the vehicle go elsewhere at any time, and nothing but its profile tells of that.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Altitude, m.
    pub altitude_m: f64,
    vehicle: Option<String>,
    mode: Mode,
    /// Once the vehicle has accepted it: how far off the profile was at its nearest, m, and when, flight time, µs.
    nearing: Option<(f64, u64)>,
}

impl Target {
    /// Asked for just now, of `vehicle`, which reports as `live`.
    pub fn new(altitude_m: f64, vehicle: Option<String>, live: &Live) -> Self {
        Self { altitude_m, vehicle, mode: live.mode(), nearing: None }
    }

    /// The vehicle has accepted it, at flight time `now_us`: its profile starts.
    pub fn accepted(&mut self, now_us: u64) {
        self.nearing = Some((f64::INFINITY, now_us));
    }

    /// Does it still count, `vehicle` being shown, which reports as `live`? Not once the profile is there, stands or goes
    /// elsewhere, nor in another mode, nor for another vehicle.
    pub fn counts(&mut self, vehicle: Option<&String>, live: &Live) -> bool {
        let same = self.vehicle.as_ref() == vehicle && self.mode == live.mode();
        if !same || !matches!(self.mode, Mode::AltitudeHold | Mode::Hold) {
            return false;
        }
        let Some((least_m, since_us)) = &mut self.nearing else { return true };
        let Some((now_m, time_us)) = live.setpoint_m().zip(live.control.time_us()) else { return false };
        let off_m = (self.altitude_m - now_m).abs();
        if off_m < *least_m - SAME_M {
            (*least_m, *since_us) = (off_m, time_us.max(*since_us));
        }
        off_m > SAME_M && time_us.saturating_sub(*since_us) < STANDS_US
    }
}

/// The setpoint card.
#[component]
pub fn SetpointCard() -> impl IntoView {
    let ctx = ctx();
    let typed = RwSignal::new(String::new());
    let problem = RwSignal::new(String::new());
    let paths = RwSignal::new(false);
    let replayed = Memo::new(move |_| ctx.live(|live| live.is_replay()));
    let in_use = Memo::new(move |_| ctx.live(|live| live.setpoint_m()));
    let old = Memo::new(move |_| ctx.is_old(|live| &live.control));
    let limits = Memo::new(move |_| {
        ctx.live(|live| live.description.get().and_then(|d| d.limits).map(|l| (l.altitude_min_m, l.altitude_max_m)))
    });
    let set = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        match format::parse_number(&typed.get_untracked()) {
            Ok(value) => {
                problem.set(String::new());
                ctx.set_altitude(value);
                typed.set(String::new());
                keys::let_go();
            }
            Err(error) => problem.set(error),
        }
    };
    view! {
        <section class="card setpoint" aria-label="Setpoint">
            <header>
                <h2>"Setpoint"</h2>
                <Show when=move || !replayed.get()><PathsButton open=paths /></Show>
                <output class="big num" class:stale=old aria-label="Altitude setpoint in use">{move || format::maybe(in_use.get(), 2)} <small>"m"</small></output>
            </header>
            <Show when=move || !replayed.get()>
                <div class="buttons steps-row">
                    <button type="button" aria-label="Altitude down 0.1 m" title="Down 0.1 m (↓)" on:click=move |_| ctx.step_altitude(false)>"−0.1"</button>
                    <button type="button" aria-label="Altitude up 0.1 m" title="Up 0.1 m (↑)" on:click=move |_| ctx.step_altitude(true)>"+0.1"</button>
                    {PRESETS_M.into_iter().map(|p| view! {
                        <button
                            type="button"
                            class="num"
                            aria-label=format!("Altitude {p:.1} m")
                            aria-pressed=move || in_use.get().is_some_and(|s| (s - p).abs() < SAME_M).to_string()
                            on:click=move |_| ctx.set_altitude(p)
                        >{format!("{p:.1}")}</button>
                    }).collect::<Vec<_>>()}
                </div>
                <form class="exact" on:submit=set>
                    <input
                        type="text"
                        inputmode="decimal"
                        autocomplete="off"
                        aria-label="Exact altitude in metres"
                        placeholder=move || limits.get().map_or_else(|| "exact, m".to_owned(), |(low, high)| {
                            format!("{} – {} m", format::fixed(low, 2), format::fixed(high, 2))
                        })
                        prop:value=typed
                        on:input:target=move |e| {
                            typed.set(e.target().value());
                            problem.set(String::new());
                        }
                    />
                    <button type="submit">"Set"</button>
                    <Problem text=problem />
                </form>
                <PathForm open=paths />
            </Show>
        </section>
    }
}

/// What else the mode takes, when it takes it. A card of its own, below the others: those stay where they are.
#[component]
pub fn ModeFields() -> impl IntoView {
    let ctx = ctx();
    let mode = Memo::new(move |_| ctx.live(|live| if live.is_replay() { Mode::Unspecified } else { live.mode() }));
    let card = |name, about: &'static str, picture: Option<AnyView>, entries| {
        view! {
            <section class="card setpoint" aria-label=name><header><h2>{name}</h2><span class="quiet">{about}</span></header>{picture}<Fields name entries /></section>
        }
    };
    move || match mode.get() {
        Mode::Hold => {
            card("Position", "from above, north up", Some(view! { <TopView settable=true /> }.into_any()), &POSITION)
                .into_any()
        }
        Mode::Stabilise => card("Attitude and thrust", "", None, &ATTITUDE).into_any(),
        _ => ().into_any(),
    }
}

/// A number that the setpoint of a mode takes: name on the page, unit there, name on the wire, wire units of one.
type Entry = (&'static str, &'static str, &'static str, f64);

/// Position and yaw, in hold.
const POSITION: [Entry; 3] =
    [("east", "m", "x_m", 1.0), ("north", "m", "y_m", 1.0), ("yaw", "°", "yaw_rad", 1.0 / DEGREES)];
/// Attitude and thrust, in stabilise.
const ATTITUDE: [Entry; 3] = [
    ("roll", "°", "roll_rad", 1.0 / DEGREES),
    ("pitch", "°", "pitch_rad", 1.0 / DEGREES),
    ("thrust", "% weight", "throttle", 0.01),
];

/// The given fields as JSON; empty ones keep their value on the vehicle.
fn body(entries: &[Entry], texts: &[String]) -> Result<serde_json::Value, String> {
    let mut out = serde_json::Map::new();
    for ((_, _, key, factor), text) in entries.iter().zip(texts) {
        if !text.trim().is_empty() {
            out.insert((*key).to_owned(), json!(format::parse_number(text)? * factor));
        }
    }
    if out.is_empty() { Err("no value is given".to_owned()) } else { Ok(out.into()) }
}

/// What is wrong with what was typed, below its form and over what follows: nothing moves for it.
#[component]
fn Problem(text: RwSignal<String>) -> impl IntoView {
    view! { <span class="problem" role="alert" class:told=move || !text.with(String::is_empty)>{text}</span> }
}

/// A row of number fields, sent together.
#[component]
fn Fields(name: &'static str, entries: &'static [Entry]) -> impl IntoView {
    let ctx = ctx();
    let texts: Vec<RwSignal<String>> = entries.iter().map(|_| RwSignal::new(String::new())).collect();
    let typed = texts.clone();
    let problem = RwSignal::new(String::new());
    let send = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let texts: Vec<String> = typed.iter().map(|text| text.get_untracked()).collect();
        match body(entries, &texts) {
            Ok(body) => {
                problem.set(String::new());
                ctx.command(name, "POST", "setpoint", body);
                keys::let_go();
            }
            Err(error) => problem.set(error),
        }
    };
    view! {
        <form class="fields" aria-label=name on:submit=send>
            {entries.iter().zip(texts).map(|((label, unit, ..), text)| view! {
                <label class="field">
                    <span>{*label} " " <small>{*unit}</small></span>
                    <input type="text" inputmode="decimal" autocomplete="off" prop:value=text on:input:target=move |e| {
                        text.set(e.target().value());
                        problem.set(String::new());
                    } />
                </label>
            }).collect::<Vec<_>>()}
            <button type="submit">"Go"</button>
            <Problem text=problem />
        </form>
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::v1;

    /// What a vehicle reports at flight time `ms`: its mode, and where its profile is.
    fn reports(live: &mut Live, ms: u64, mode: Mode, altitude_m: f64) {
        let setpoint = v1::Setpoint { altitude_m: Some(altitude_m), ..Default::default() };
        live.status.set(v1::Status { mode: mode as i32, ..Default::default() }, ms * 1000);
        live.control.set(v1::Control { setpoint: Some(setpoint), ..Default::default() }, ms * 1000);
    }

    #[test]
    fn steps_count_from_what_was_asked_for_only_while_the_profile_goes_there() {
        let (a, b) = (Some("a".to_owned()), Some("b".to_owned()));
        let hold = Mode::AltitudeHold;
        let flying = || {
            // GIVEN a profile on its way from 0.5 m, after 1.5 m was asked for and accepted
            let mut live = Live::default();
            reports(&mut live, 0, hold, 0.5);
            let mut target = Target::new(1.5, a.clone(), &live);
            reports(&mut live, 1500, hold, 0.5);
            assert!(target.counts(a.as_ref(), &live), "its answer may be long on its way");
            target.accepted(1_500_000);
            for (ms, altitude_m) in [(1600, 0.5), (2400, 0.6), (3000, 0.9)] {
                reports(&mut live, ms, hold, altitude_m);
                assert!(target.counts(a.as_ref(), &live), "{altitude_m}");
            }
            (target, live)
        };
        // WHEN it arrives, stands or turns back, or another mode begins, THEN it counts no more
        for (ms, mode, altitude_m, why) in [
            (3100, hold, 1.5, "it is there"),
            (3100, Mode::Hold, 0.9, "another mode"),
            (3100, Mode::Land, 0.9, "no altitude is held"),
            (5000, hold, 0.9, "it stands"),
            (5000, hold, 0.7, "it goes elsewhere"),
        ] {
            let (mut target, mut live) = flying();
            reports(&mut live, ms, mode, altitude_m);
            assert!(!target.counts(a.as_ref(), &live), "{why}");
        }
        // WHEN it swings, and so comes nearer again and again, but no nearer than it was
        let (mut target, mut live) = flying();
        for ms in (3200_u64..=5000).step_by(200) {
            reports(&mut live, ms, hold, if ms.is_multiple_of(400) { 0.7 } else { 0.9 });
            assert_eq!(target.counts(a.as_ref(), &live), ms < 5000, "{ms} ms");
        }
        // WHEN another vehicle is shown
        let (mut target, live) = flying();
        assert!(!target.counts(b.as_ref(), &live));
        // WHEN nothing is heard for a while, THEN nothing is known against it
        assert!(target.counts(a.as_ref(), &live));
    }

    #[test]
    fn steps_end_on_the_grid() {
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(stepped(stepped(stepped(0.5, true), true), true), 0.8);
        near(stepped(0.83, true), 0.9);
        near(stepped(0.83, false), 0.8);
        near(stepped(0.8 - 1e-9, true), 0.9);
        near(stepped(0.1, false), 0.0);
    }

    #[test]
    fn empty_fields_keep_their_value_and_degrees_become_radians() {
        let texts = ["1,5", " ", "180"].map(str::to_owned);
        let value = body(&POSITION, &texts).unwrap();
        assert_eq!(value["x_m"], 1.5);
        assert!(value.get("y_m").is_none());
        assert!((value["yaw_rad"].as_f64().unwrap() - std::f64::consts::PI).abs() < 1e-12);
        assert!(body(&POSITION, &[const { String::new() }; 3]).is_err());
        assert!(body(&ATTITUDE, &["a".to_owned()]).unwrap_err().contains('a'));
    }
}

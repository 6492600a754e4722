//! The three experiments of [Paternain] VIII, flown: roll let go (VIII-A), yaw on strings (VIII-B), take-off (VIII-C).
//!
//! All figures are of the simulator's truth. Angles in degrees, time zero where the hand lets go or the step is asked. Each is
//! flown of the seed that is made of its scenario's own.

use super::Headless;
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::ControllerKind;

/// One experiment.
pub struct Answer {
    /// Time, truth, estimate; degrees or metres.
    pub curve: Vec<(f64, f64, f64)>,
    /// Where it begins, deg or m …
    pub from: f64,
    /// … and where it should go.
    pub to: f64,
    /// From 10 to 90 % of the way, s; `None` when it does not get there.
    pub rise_s: Option<f64>,
    /// Beyond the target, in the curve's unit.
    pub overshoot: f64,
    /// When it is within the band (2° or 5 cm) of the target for good, s.
    pub settled_s: Option<f64>,
    /// Distance from the target at the end.
    pub final_error: f64,
}

impl Answer {
    fn of(curve: Vec<(f64, f64, f64)>, to: f64, band: f64) -> Self {
        let after = || curve.iter().filter(|(t, ..)| *t >= 0.0).map(|(t, truth, _)| (*t, *truth));
        let from = after().next().map_or(f64::NAN, |(_, v)| v);
        let way = |v: f64| (v - from) / (to - from);
        let first = |fraction: f64| after().find(|(_, v)| way(*v) >= fraction).map(|(t, _)| t);
        let beyond = after().map(|(_, v)| way(v) - 1.0).fold(0.0, f64::max);
        let last_outside = after().filter(|(_, v)| (v - to).abs() > band).map(|(t, _)| t).next_back();
        let end = after().next_back();
        Self {
            from,
            to,
            rise_s: first(0.1).zip(first(0.9)).map(|(low, high)| high - low),
            overshoot: beyond * (to - from).abs(),
            settled_s: last_outside.map_or(Some(0.0), |t| end.filter(|(last, _)| last - t > 0.1).map(|_| t)),
            final_error: end.map_or(f64::NAN, |(_, v)| (v - to).abs()),
            curve,
        }
    }
}

/// When the last hand lets go, s since boot.
fn released_s(scenario: &Scenario) -> f64 {
    scenario.script.pushes.iter().map(|push| push.at_s + push.duration_s).fold(0.0, f64::max)
}

fn flown(
    seed: &dyn Fn(u64) -> u64,
    name: &str,
    start_s: impl Fn(&Scenario) -> f64,
    value: impl Fn([f64; 4]) -> f64,
) -> Vec<(f64, f64, f64)> {
    let mut flown = Headless::start_seeded(name, ControllerKind::LqrIntegral, seed);
    let start = start_s(&flown.scenario);
    let mut curve = Vec::new();
    flown.run(|tick| {
        let angles =
            |(roll, pitch, yaw): (f64, f64, f64), z: f64| [roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees(), z];
        let truth = angles(tick.truth.world_from_body.euler_angles(), tick.truth.position_enu_m.z);
        let estimate =
            angles(tick.estimate.world_from_body.euler_angles(), tick.estimate.kinematics().position_enu_m.z);
        curve.push((tick.time.as_seconds() - start, value(truth), value(estimate)));
    });
    curve
}

/// VIII-A: roll held at 20° for 0.4 s and let go.
pub fn roll(seed: &dyn Fn(u64) -> u64) -> Answer {
    Answer::of(flown(seed, "single_axis_roll", released_s, |v| v[0]), 0.0, 2.0)
}

/// VIII-B: thrust below lift-off, hung on a string; yaw held aside for 1.2 s and let go.
pub fn yaw(seed: &dyn Fn(u64) -> u64) -> Answer {
    let curve = flown(seed, "string_yaw", released_s, |v| v[2]);
    // Back to the heading held before the hand came: what the magnetometers take for the target.
    let held = curve.iter().take_while(|(t, ..)| *t < -1.5).last().map_or(0.0, |(_, truth, _)| *truth);
    Answer::of(curve, held, 2.0)
}

/// VIII-C: take-off from the floor to 1 m.
pub fn take_off(seed: &dyn Fn(u64) -> u64) -> Answer {
    let asked = |scenario: &Scenario| {
        let steps = scenario.script.steps.iter();
        steps
            .filter(|step| matches!(step.command, plumbline_agent::command::Command::Setpoint(_)))
            .map(|s| s.at_s)
            .fold(0.0, f64::max)
    };
    Answer::of(flown(seed, "takeoff", asked, |v| v[3]), 1.0, 0.05)
}

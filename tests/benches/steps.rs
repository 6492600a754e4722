//! How the vehicle answers: altitude step on the strings, take-off, roll let go. Prints JSON lines.
//!
//! The step meter's figures come from the estimate; beside each stands the same figure from the simulator's truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use plumbline_support::headless::{Headless, paternain};
use serde_json::json;

fn main() {
    altitude_step();
    take_off();
    roll();
}

fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn line(name: &str, value: Option<f64>, unit: &str, limit: f64, source: &str) {
    let value = value.map(round);
    println!(
        "{}",
        json!({ "bench": "steps", "name": name, "value": value, "unit": unit, "limit": limit, "source": source })
    );
}

/// When the truth entered ±`band` around `to` for good, s after `start`.
fn settled(truth: &[(f64, f64)], start: f64, until: f64, to: f64, band: f64) -> Option<f64> {
    let inside = truth.iter().filter(|(t, _)| *t >= start && *t < until);
    let last_outside = inside.clone().filter(|(_, z)| (z - to).abs() > band).map(|(t, _)| *t).next_back();
    match last_outside {
        Some(t) if until - t < 0.05 => None,
        Some(t) => Some(t - start),
        None => Some(0.0),
    }
}

/// 0.5 → 1.0 m: must settle within ±5 cm in 4 s and overshoot at most 15 %.
fn altitude_step() {
    let mut flown = Headless::start("altitude_step_half_metre");
    let (mut truth, mut metered) = (Vec::new(), None);
    flown.run(|tick| {
        truth.push((tick.time.as_seconds(), tick.truth.position_enu_m.z));
        metered = tick.step.filter(|step| step.finished && (step.to_m - 1.0).abs() < 1e-9).or(metered);
    });
    let step = metered.expect("a finished step to 1.0 m");
    let start = step.start.as_seconds();
    let until = start + 9.0;
    let highest = truth.iter().filter(|(t, _)| *t >= start && *t < until).map(|(_, z)| *z).fold(0.0, f64::max);
    let overshoot = (highest - 1.0).max(0.0) / 0.5 * 100.0;
    line("altitude_settling", step.settling_time_s, "s", 4.0, "step meter");
    line("altitude_settling_truth", settled(&truth, start, until, 1.0, 0.05), "s", 4.0, "truth");
    line("altitude_overshoot", Some(step.overshoot_percent), "%", 15.0, "step meter");
    line("altitude_overshoot_truth", Some(overshoot), "%", 15.0, "truth");
    line("altitude_rise", step.rise_time_s, "s", f64::NAN, "step meter");
    line("altitude_steady_error", step.steady_error_m, "m", 0.05, "step meter");
}

/// 0 → 1 m in free flight: [Paternain] VIII-C overshot by a metre; ours by 0.2 m at most.
fn take_off() {
    let answer = paternain::take_off(&|own| own);
    line("take_off_overshoot", Some(answer.overshoot), "m", 0.2, "truth; [Paternain] VIII-C: 1 m");
    line("take_off_final_error", Some(answer.final_error), "m", 0.05, "truth");
}

/// [Paternain] VIII-A: held at 20° for 0.4 s and let go; back in 0.4 s, at most 4° beyond.
fn roll() {
    let answer = paternain::roll(&|own| own);
    line("roll_held", Some(answer.from), "deg", 20.0, "truth");
    line("roll_rise", answer.rise_s, "s", 0.4, "truth; [Paternain] VIII-A");
    line("roll_overshoot", Some(answer.overshoot), "deg", 4.0, "truth; [Paternain] VIII-A");
}

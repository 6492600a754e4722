//! How long a tick takes, and how much faster than real time a flight is. A measurement:
//! `cargo test --release -p plumbline-agent --test tick_cost -- --ignored --nocapture`.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::Instant;

use common::{Flown, scenario};
use plumbline_agent::vehicle::Vehicle;

#[test]
#[ignore = "a measurement"]
fn tick_cost() {
    let mut f = Flown::new(&scenario("altitude_step"));
    let script = f.scenario.script.clone();
    let mut times = Vec::new();
    let mut before = None;
    let whole = Instant::now();
    while f.vehicle.time().as_seconds() < 45.0 {
        let frame = f.vehicle.sense().unwrap();
        f.flight.heartbeat(frame.time);
        script.commands(before, frame.time, |c| {
            f.flight.apply(c, frame.time);
        });
        before = Some(frame.time);
        let start = Instant::now();
        let command = f.flight.step(&frame).command;
        times.push(start.elapsed().as_secs_f64() * 1e6);
        let applied = f.vehicle.actuate(&command).unwrap();
        f.flight.applied(applied);
    }
    let speed = f.vehicle.time().as_seconds() / whole.elapsed().as_secs_f64();
    times.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"agent\",\"name\":\"tick\",\"median_us\":{:.2},\"p99_us\":{:.2},\"times_real_time\":{:.0}}}",
        times[times.len() / 2],
        times[times.len() * 99 / 100],
        speed
    );
}

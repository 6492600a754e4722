//! The tick: time of `Flight::step` with the EKF in the loop, allocations in it, and how much faster than real time a
//! whole simulated flight runs on one core. Prints JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::time::Instant;

use plumbline_support::counting::{self, Counting};
use plumbline_support::headless::Headless;
use serde_json::json;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const TICK_LIMIT_US: f64 = 100.0;
const SPEED_LIMIT: f64 = 200.0;

fn main() {
    tick_time();
    speed();
}

fn tick_time() {
    let mut flown = Headless::start("altitude_step");
    let ticks = (flown.scenario.duration_s * flown.scenario.tick_rate_hz) as usize;
    let mut times_us = Vec::with_capacity(ticks);
    let mut allocations = 0;
    for _ in 0..ticks {
        let sensed = flown.sense();
        let before = counting::requests();
        let begun = Instant::now();
        flown.fly(&sensed);
        times_us.push(begun.elapsed().as_secs_f64() * 1e6);
        allocations += counting::requests() - before;
    }
    times_us.sort_by(f64::total_cmp);
    let at = |fraction: f64| round(times_us[((ticks - 1) as f64 * fraction).round() as usize]);
    println!(
        "{}",
        json!({ "bench": "tick", "name": "flight_step", "value": at(0.5), "unit": "us", "median": at(0.5), "p99": at(0.99),
            "max": at(1.0), "limit": TICK_LIMIT_US, "ticks": ticks })
    );
    println!(
        "{}",
        json!({ "bench": "tick", "name": "allocations", "value": allocations as f64 / ticks as f64, "unit": "per tick",
            "limit": 0, "ticks": ticks })
    );
}

fn speed() {
    let mut flown = Headless::start("altitude_step");
    let begun = Instant::now();
    let mut last = 0.0;
    flown.run(|tick| last = tick.time.as_seconds());
    let wall_s = begun.elapsed().as_secs_f64();
    println!(
        "{}",
        json!({ "bench": "tick", "name": "simulated_flight_speed", "value": round(last / wall_s), "unit": "x real time",
            "limit": SPEED_LIMIT, "simulated_s": last, "wall_s": round(wall_s) })
    );
}

fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

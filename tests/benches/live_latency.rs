//! Sensor sample → received by a WebSocket client on loopback, with 20 viewers, one of whom stops reading.
//!
//! One flying agent in the release build. The age of a sample is wall time at reception minus the agent's boot wall
//! time minus the sample's flight time: one machine, one clock. Prints JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use plumbline_proto::{Kind, v1};
use plumbline_support::system::{Live, PATIENCE, Rig, scenario};
use serde_json::json;

const VIEWERS: usize = 20;
const SPAN: Duration = Duration::from_secs(15);
const LIMIT_MS: f64 = 30.0;

fn main() {
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    let mut live = rig.live();
    let description = live.until(PATIENCE, "description", |frame| frame.message::<v1::Description>(Kind::Description));
    live.step_response(0.5);
    // Eighteen that read, one that is measured, one that will stop reading.
    let ended = Arc::new(AtomicBool::new(false));
    let readers: Vec<_> = (0..VIEWERS - 2)
        .map(|_| {
            let (mut live, ended) = (rig.live(), ended.clone());
            std::thread::spawn(move || {
                while !ended.load(Ordering::Relaxed) {
                    live.frame();
                }
            })
        })
        .collect();
    let before = measure(&mut live, description.boot_wall_time_us);
    let stalled = rig.live();
    // Long enough for its socket buffers to fill before the second measurement.
    measure(&mut live, description.boot_wall_time_us);
    let after = measure(&mut live, description.boot_wall_time_us);
    report("sensor_to_websocket", &before, VIEWERS - 1, 0, None);
    report("sensor_to_websocket_one_stalled", &after, VIEWERS, 1, Some(after.p99 / before.p99));
    drop(stalled);
    ended.store(true, Ordering::Relaxed);
    for reader in readers {
        reader.join().unwrap();
    }
    rig.disarm();
    let flight = rig.finished_flight();
    println!(
        "{}",
        json!({ "bench": "live", "name": "recorded_missing", "value": flight["missing"], "unit": "messages",
            "messages": flight["messages"], "limit": 0 })
    );
    rig.stop();
}

struct Ages {
    median: f64,
    p99: f64,
    most: f64,
    samples: usize,
    lost: u64,
    rate_hz: f64,
}

/// Ages of every IMU sample of instance 1 over [`SPAN`], and what the viewer missed of all messages.
fn measure(live: &mut Live, boot_wall_time_us: u64) -> Ages {
    let begun = Instant::now();
    let mut ages = Vec::new();
    let mut sequences = Vec::new();
    while begun.elapsed() < SPAN {
        let frame = live.frame();
        if frame.sequence > 0 {
            sequences.push(frame.sequence);
        }
        if frame.is(Kind::Imu) && frame.instance == 1 {
            let now_us = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as f64;
            ages.push((now_us - boot_wall_time_us as f64 - frame.time_us as f64) * 1e-3);
        }
    }
    ages.sort_by(f64::total_cmp);
    sequences.sort_unstable();
    let span = sequences.last().unwrap() - sequences.first().unwrap() + 1;
    sequences.dedup();
    let at = |fraction: f64| ages[((ages.len() - 1) as f64 * fraction).round() as usize];
    Ages {
        median: at(0.5),
        p99: at(0.99),
        most: at(1.0),
        samples: ages.len(),
        lost: span - sequences.len() as u64,
        rate_hz: ages.len() as f64 / SPAN.as_secs_f64(),
    }
}

fn report(name: &str, ages: &Ages, viewers: usize, stalled: usize, ratio: Option<f64>) {
    let round = |value: f64| (value * 1e3).round() / 1e3;
    println!(
        "{}",
        json!({ "bench": "live", "name": name, "value": round(ages.p99), "unit": "ms", "median": round(ages.median),
            "p99": round(ages.p99), "max": round(ages.most), "limit": LIMIT_MS, "samples": ages.samples,
            "rate_hz": ages.rate_hz.round(), "viewers": viewers, "stalled": stalled, "lost": ages.lost,
            "p99_ratio": ratio.map(round) })
    );
}

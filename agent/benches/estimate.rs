//! `cargo xtask bench estimate`: time and allocations of the estimators, one thread, one run; JSON lines. With a
//! Python that has filterpy (`PLUMBLINE_FILTERPY`, set by xtask) its filters run over the same log beside ours.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_agent::estimate::Estimator;
use plumbline_agent::estimate::bank::build;
use plumbline_agent::estimate::ekf_bias::EkfBias;
use plumbline_agent::estimate::filter::ekf_hybrid::EkfHybrid;
use plumbline_agent::estimate::filter::measurement::TwelveState;
use plumbline_agent::estimate::filter::mocap_recipe::{LOG_RATE_HZ, LogRow, PROCESS_DENSITY, measurements};
use plumbline_agent::estimate::filter::ukf::Ukf;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::euler_body::{EulerBody, M, X, process_noise};
use plumbline_agent::recordings::{mocap_log, shared};
use plumbline_agent::sensor::{ImuSample, MocapPoseSample, SensorFrame, SensorModel};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::MotorCommand;
use plumbline_agent::vehicle::Vehicle;
use plumbline_proto::time::FlightTime;
use plumbline_support::counting::{self, Counting};
use serde_json::json;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Limits of the issue.
const EKF_LIMIT_US: f64 = 3.0;
const UKF_LIMIT_US: f64 = 25.0;
const PEER_RATIO: f64 = 100.0;
/// A timing is the median over blocks of this many calls: a clock read costs a hundredth of a call.
const BLOCK: usize = 200;

/// Median, and 99th percentile, of the mean time of a call in a block, µs; allocations of all calls.
struct Timing {
    median_us: f64,
    p99_us: f64,
    allocations: u64,
    calls: usize,
}

fn time(calls: usize, mut call: impl FnMut(usize)) -> Timing {
    (0..calls.min(BLOCK)).for_each(&mut call);
    let mut blocks = Vec::with_capacity(calls / BLOCK);
    let mut allocations = 0;
    for block in 0..calls / BLOCK {
        let before = counting::requests();
        let begun = Instant::now();
        for k in 0..BLOCK {
            call(block * BLOCK + k);
        }
        let took = begun.elapsed().as_secs_f64() * 1e6 / BLOCK as f64;
        allocations += counting::requests() - before;
        blocks.push(took);
    }
    blocks.sort_by(f64::total_cmp);
    let at = |q: f64| blocks[((blocks.len() - 1) as f64 * q) as usize];
    Timing { median_us: at(0.5), p99_us: at(0.99), allocations, calls }
}

fn print(name: &str, us: f64, limit_us: Option<f64>, timing: &Timing) {
    let line = json!({
        "bench": "estimate", "name": name, "value": round(us), "unit": "us", "p99": round(timing.p99_us),
        "target": limit_us, "met": limit_us.map(|limit| us <= limit && timing.allocations == 0),
        "allocations": timing.allocations, "calls": timing.calls,
    });
    println!("{line}");
}

fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn main() {
    bias_filter();
    in_flight();
    let Some(path) = shared("reference/mocap_log_circle.csv") else {
        println!("{}", json!({ "bench": "estimate", "name": "mocap log", "skipped": "the reference logs are absent" }));
        return;
    };
    let log = mocap_log::read(&path).unwrap();
    let (ekf_us, ukf_us) = (hybrid(&log), unscented(&log));
    peer(&path, log.len().min(1200), ekf_us, ukf_us);
}

/// A hovering IMU, with a motion-capture pose (six scalars) in every `pose_every`-th frame.
fn frames(count: usize, pose_every: usize) -> Vec<SensorFrame> {
    let attitude = UnitQuaternion::from_euler_angles(0.05, -0.03, 0.4);
    (1..=count)
        .map(|k| {
            let time = FlightTime(k as u64 * 5000);
            let mut frame = SensorFrame { time, ..SensorFrame::default() };
            frame.imus[0] = Some(ImuSample {
                time,
                gyro_radps: Vector3::new(0.001, -0.002, 0.003),
                accel_mps2: attitude.inverse() * Vector3::new(0.0, 0.0, 9.81),
                mag_ut: None,
                temperature_c: 25.0,
            });
            if k % pose_every == 0 {
                let pose =
                    MocapPoseSample { time, position_enu_m: Vector3::new(0.0, 0.0, 1.0), world_from_body: attitude };
                frame.mocap_pose = Some(pose);
            }
            frame
        })
        .collect()
}

/// The error-state EKF: a whole step with one IMU sample, and what one scalar correction adds to it.
fn bias_filter() {
    let applied = MotorCommand { throttle: [0.5; 4] };
    let run = |pose_every: usize| {
        let frames = frames(60_000, pose_every);
        let mut filter = EkfBias::new(SensorModel::default());
        // Aligned, and its yaw known, before the clock starts.
        for frame in frames.iter().take(400) {
            black_box(filter.step(frame, &applied));
        }
        time(frames.len() - 800, |k| {
            black_box(filter.step(&frames[400 + k], &applied));
        })
    };
    let alone = run(399);
    print("ekf_bias/imu_prediction", alone.median_us, Some(EKF_LIMIT_US), &alone);
    let aided = run(1);
    print("ekf_bias/scalar_correction", (aided.median_us - alone.median_us) / 6.0, Some(EKF_LIMIT_US), &aided);
}

/// Every estimator over a simulated flight on the string rig: what one tick of it costs.
fn in_flight() {
    let scenario = Scenario::default_string_rig();
    let config = scenario.flight_config();
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let hover = MotorCommand { throttle: [Airframe::iris().hover_command(); 4] };
    let frames: Vec<SensorFrame> = (0..4000)
        .map(|_| {
            let frame = vehicle.sense().unwrap();
            vehicle.actuate(&hover).unwrap();
            frame
        })
        .collect();
    let assumed = config.assumptions();
    use plumbline_agent::types::EstimatorKind as K;
    for kind in [K::EkfBias, K::Complementary, K::EkfHybrid, K::Ukf, K::ConstantAcceleration, K::Vqf, K::Lanes] {
        let mut estimator = build(kind, &assumed).unwrap();
        let timing = time(frames.len() - BLOCK, |k| {
            black_box(estimator.step(&frames[k], &hover));
        });
        let name = kind.as_str_name().trim_start_matches("ESTIMATOR_KIND_").to_lowercase();
        print(&format!("tick/{name}"), timing.median_us, None, &timing);
    }
}

/// The hybrid EKF on the log: prediction, and one scalar; µs of a whole step of one prediction and seven rows.
fn hybrid(log: &[LogRow]) -> f64 {
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(PROCESS_DENSITY.0, PROCESS_DENSITY.1, h);
    let mut filter = EkfHybrid::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let timing = time(log.len() - BLOCK, |k| filter.predict(&log[k].input, h, &q));
    print("ekf_hybrid/prediction", timing.median_us, Some(EKF_LIMIT_US), &timing);

    let mut residuals = ArrayVec::new();
    let mut filter = EkfHybrid::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let timing = time(log.len() - BLOCK, |k| {
        residuals.clear();
        filter.correct(&measurements(&log[k])[..1], &mut residuals);
    });
    print("ekf_hybrid/scalar_correction", timing.median_us, Some(EKF_LIMIT_US), &timing);

    let mut filter = EkfHybrid::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let timing = time(log.len() - BLOCK - 1, |k| {
        filter.predict(&log[k].input, h, &q);
        residuals.clear();
        filter.correct(&measurements(&log[k + 1]), &mut residuals);
    });
    print("ekf_hybrid/step_of_seven_rows", timing.median_us, None, &timing);
    timing.median_us
}

/// The UKF on the log; µs of a whole step of one prediction and seven rows.
fn unscented(log: &[LogRow]) -> f64 {
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(PROCESS_DENSITY.0, PROCESS_DENSITY.1, h);
    let mut residuals = ArrayVec::new();
    let mut filter = Ukf::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let timing = time(log.len() - BLOCK - 1, |k| {
        filter.predict(&log[k].input, h, &q);
        residuals.clear();
        filter.correct(&measurements(&log[k + 1]), &mut residuals);
    });
    print("ukf/step_of_seven_rows", timing.median_us, Some(UKF_LIMIT_US), &timing);
    timing.median_us
}

/// Python's filterpy over the first `rows` rows of the same log.
fn peer(log: &Path, rows: usize, ekf_us: f64, ukf_us: f64) {
    let skipped = |reason: &str| {
        println!("{}", json!({ "bench": "estimate", "name": "filterpy", "skipped": reason }));
    };
    let Some(python) = std::env::var_os("PLUMBLINE_FILTERPY").filter(|python| !python.is_empty()) else {
        return skipped("no Python with filterpy: start this as `cargo xtask bench estimate`");
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/filterpy_peer.py");
    let output = Command::new(python).arg(script).arg(log).arg(rows.to_string()).output();
    let output = match output {
        Ok(output) if output.status.success() => output.stdout,
        Ok(output) => return skipped(&String::from_utf8_lossy(&output.stderr)),
        Err(error) => return skipped(&error.to_string()),
    };
    let theirs: serde_json::Value = serde_json::from_slice(&output).unwrap();
    for (name, ours_us) in [("ekf", ekf_us), ("ukf", ukf_us)] {
        let theirs_us = theirs[format!("{name}_us")].as_f64().unwrap();
        let line = json!({
            "bench": "estimate", "name": format!("filterpy/{name}_ratio"), "value": round(theirs_us / ours_us),
            "unit": "times as fast", "target": PEER_RATIO, "met": theirs_us / ours_us >= PEER_RATIO,
            "filterpy_us": round(theirs_us), "ours_us": round(ours_us), "rows": rows,
            "filterpy_rmse_m": theirs[format!("{name}_rmse_m")],
        });
        println!("{line}");
    }
}

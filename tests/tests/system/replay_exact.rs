//! A flight file flown again goes through the same pipeline: the same every time, and as it was.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use plumbline_proto::{Kind, Message, v1};
use plumbline_support::system::{Live, Rig, scenario};
use plumbline_tests::harness::Vehicle;

/// The replay's estimator starts in mid-flight without knowing anything; after this it must know as much as it did then.
const CONVERGENCE_S: f64 = 6.0;
/// Altitude of the replay against the altitude estimated in flight, once converged: both within a few sigma of 1 cm.
const ALTITUDE_TOLERANCE_M: f64 = 0.03;
/// Roll and pitch likewise, against the sum of what both say of themselves: without a position the tilt is known to 20
/// to 50 mrad, and two filters of different experience then differ by up to 20.
const TILT_TOLERANCE_SIGMA: f64 = 0.5;
/// What neither may say to be unsure of more than.
const TILT_SIGMA_MAX_RAD: f64 = 0.06;
/// Every estimator streams: faster than this the rate cap of the link thins what is compared.
const SPEED: &str = "2";

/// The estimator in the loop.
const IN_LOOP: v1::EstimatorKind = v1::EstimatorKind::Lanes;

type Estimates = BTreeMap<u64, v1::Estimate>;

/// Estimates of the estimator in the loop, by flight time; how long they took to compute is not compared.
fn keep(estimates: &mut Estimates, mut estimate: v1::Estimate) {
    estimate.step_time_us = 0.0;
    estimates.insert(estimate.time_us, estimate);
}

fn recorded(file: &[u8]) -> Estimates {
    let mut estimates = Estimates::new();
    for message in mcap::MessageStream::new(file).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == Kind::Estimate.topic(IN_LOOP as u16) {
            keep(&mut estimates, v1::Estimate::decode(message.data.as_ref()).unwrap());
        }
    }
    estimates
}

fn replayed(file: &Path, last_us: u64) -> Estimates {
    let rig = Rig::start(&Vehicle::Replayed { file: file.to_path_buf(), speed: SPEED.to_owned() });
    let mut live = Live::connect(rig.api(), &rig.system().vehicle("live?history=60"));
    let mut estimates = Estimates::new();
    live.until(Duration::from_secs(60), "the end of the replay", |frame| {
        if frame.instance == IN_LOOP as u16
            && let Some(estimate) = frame.message(Kind::Estimate)
        {
            keep(&mut estimates, estimate);
        }
        // The last tick may hold no estimate of its own.
        (estimates.keys().next_back().is_some_and(|time| time + 100_000 >= last_us)).then_some(())
    });
    rig.stop();
    estimates
}

#[test]
fn a_flight_file_flown_again_gives_the_same_estimates() {
    // GIVEN the file of a flight with a step in it
    let rig = Rig::start(&scenario("altitude_step"));
    let mut live = rig.live();
    rig.fly_to(0.5);
    live.step_response(0.5);
    rig.command("POST", "setpoint", serde_json::json!({ "altitude_m": 0.8 }));
    live.step_response(0.8);
    rig.disarm();
    let flight = rig.finished_flight();
    let id = flight["id"].as_str().unwrap();
    let bytes = rig.api().get(&format!("/api/v1/flights/{id}/mcap")).unwrap().body;
    let folder = rig.stop();
    let file = folder.path().join("flight.mcap");
    std::fs::write(&file, &bytes).unwrap();
    let recorded = recorded(&bytes);
    let (first_us, last_us) = (*recorded.keys().next().unwrap(), *recorded.keys().next_back().unwrap());
    // WHEN it is flown again, twice, by two systems that know nothing of each other
    let (once, twice) = std::thread::scope(|scope| {
        let twice = scope.spawn(|| replayed(&file, last_us));
        (replayed(&file, last_us), twice.join().unwrap())
    });
    // THEN both replays agree to the last bit
    let common: Vec<_> = once.keys().filter(|time| twice.contains_key(time)).copied().collect();
    assert!(common.len() * 10 >= once.len() * 9, "{} of {} estimates in both", common.len(), once.len());
    for time in &common {
        assert_eq!(once[time], twice[time], "at {time} µs");
    }
    // AND with what was estimated in flight, once the filter has found its feet
    let from_us = first_us + (CONVERGENCE_S * 1e6) as u64;
    let mut compared = 0;
    for (time, then) in recorded.range(from_us..) {
        let Some(now) = once.get(time) else { continue };
        let (a, b) = (then.position_enu_m.unwrap(), now.position_enu_m.unwrap());
        assert!((a.z - b.z).abs() < ALTITUDE_TOLERANCE_M, "at {time} µs: altitude {} then, {} now", a.z, b.z);
        let (a, b) = (then.roll_pitch_yaw_rad.unwrap(), now.roll_pitch_yaw_rad.unwrap());
        let (sigma, tau) = (then.attitude_sigma_rad.unwrap(), now.attitude_sigma_rad.unwrap());
        for (a, b, sigma, tau) in [(a.x, b.x, sigma.x, tau.x), (a.y, b.y, sigma.y, tau.y)] {
            assert!(sigma.max(tau) < TILT_SIGMA_MAX_RAD, "at {time} µs: sure to {sigma} then, {tau} now");
            let allowed = TILT_TOLERANCE_SIGMA * (sigma + tau);
            assert!((a - b).abs() < allowed, "at {time} µs: {a} then, {b} now; {allowed} allowed");
        }
        compared += 1;
    }
    assert!(compared > 200, "only {compared} estimates to compare");
}

//! Who finds an attack at what rate of false alarms: the lanes' own statistic beside χ² and CUSUM, in the same flights.
//!
//! The score of a sensor in a flight is the most that its statistic reached from the onset to the end. Attacked sensors are
//! to be above the threshold, those of flights without an attack below: every threshold gives a point of the curve. The
//! lanes fly, so that nothing found changes what the others are given.

use plumbline_agent::attack::{Channel, Kind};
use plumbline_agent::types::EstimatorKind;
use plumbline_experiment::attacked::{Attacked, KINDS};
use plumbline_experiment::draw::parallel;
use plumbline_experiment::flight::{Setup, fly_watched};
use plumbline_experiment::judge::STEADY_S;
use plumbline_experiment::monitor::Monitor;
use plumbline_experiment::reception::altitude_m;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_support::effort::Effort;
use plumbline_tests::report::{Plot, Report, ReportError, Series};
use serde_json::json;

use super::case::{Case, Pilot};

/// Rates of false alarms, of healthy sensors and flights, at which detection is told.
const RATES: [f64; 2] = [0.01, 0.05];
const TESTS: [&str; 3] = ["lanes", "chi-square", "CUSUM"];
/// Name, sensor, and which of its channels.
type Attacking = (&'static str, SensorKind, fn(Channel) -> bool);
/// What sensors are told apart: an IMU by the quantity that is attacked.
const QUANTITIES: [Attacking; 4] = [
    ("height", SensorKind::Height, |_| true),
    ("IMU", SensorKind::Imu, |channel| matches!(channel, Channel::All)),
    ("gyroscope", SensorKind::Imu, |channel| matches!(channel, Channel::Gyro | Channel::GyroAxis(_))),
    ("accelerometer", SensorKind::Imu, |channel| matches!(channel, Channel::Accel | Channel::AccelAxis(_))),
];

/// The most of each test's statistic, by sensor.
type Scores = Vec<(SensorId, [f64; 3])>;

/// Flies `setup` and watches from `from_s`.
fn scores(setup: &Setup, from_s: f64) -> Scores {
    let mut monitor = Monitor::default();
    let mut most = Scores::new();
    let mut note = |sensor: SensorId, test: usize, value: f64| {
        let index = most.iter().position(|(id, _)| *id == sensor).unwrap_or_else(|| {
            most.push((sensor, [0.0; 3]));
            most.len() - 1
        });
        most[index].1[test] = most[index].1[test].max(value);
    };
    let flown = fly_watched(setup, |flight, _| {
        let received = &flight.report().received;
        monitor.take(received, altitude_m(flight));
        if received.time.as_seconds() < from_s {
            return;
        }
        for (sensor, [chi_square, cusum]) in monitor.statistics() {
            note(sensor, 1, chi_square);
            note(sensor, 2, cusum);
        }
        let Some(judge) = flight.judge() else { return };
        for device in judge.isolation().devices() {
            // Beyond 1 is what the lanes exclude; what repeats itself, or is excluded otherwise, is beyond any threshold.
            let certain = if device.flagged.is_some() { 1.0 } else { 0.0 };
            note(device.sensor, 0, device.evidence.window_ratio.max(certain));
        }
    });
    flown.unwrap();
    most
}

/// Part of the attacked above the threshold that `rate` of the healthy reach.
fn found_at(rate: f64, healthy: &[f64], attacked: &[f64]) -> f64 {
    let mut sorted = healthy.to_vec();
    sorted.sort_by(f64::total_cmp);
    let allowed = (rate * sorted.len() as f64) as usize;
    let threshold = sorted[sorted.len() - 1 - allowed];
    attacked.iter().filter(|score| **score > threshold).count() as f64 / attacked.len() as f64
}

/// Area under the curve: how often an attacked one scores above a healthy one.
pub(crate) fn area(healthy: &[f64], attacked: &[f64]) -> f64 {
    let above = |a: f64| healthy.iter().map(|h| if a > *h { 1.0 } else { f64::from(a == *h) / 2.0 }).sum::<f64>();
    attacked.iter().map(|a| above(*a)).sum::<f64>() / (healthy.len() * attacked.len()) as f64
}

fn curve(healthy: &[f64], attacked: &[f64]) -> Vec<(f64, f64)> {
    let rates = (0..=100).map(|i| f64::from(i) / 100.0 * (1.0 - 1.0 / healthy.len() as f64));
    rates.map(|rate| (rate, found_at(rate, healthy, attacked))).collect()
}

/// One attacked sensor of a flight.
struct Found {
    kind: Kind,
    channel: Channel,
    sensor: SensorId,
    scores: [f64; 3],
}

pub fn roc(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Detection against false alarms");
    let case = Case { end_s: 40.0, ..Case::ALL[0] };
    let seeds = effort.seed_base..effort.seed_base + effort.flights;
    let setup = |seed: u64, attacks: &[_]| {
        let setup = Pilot::LANES.setup(&case.scenario(seed), attacks, 0.0);
        assert_eq!(setup.config.estimators, [EstimatorKind::Lanes]);
        setup
    };
    let quiet = parallel(effort.flights as usize, |i| scores(&setup(seeds.start + i as u64, &[]), STEADY_S));
    let works: Vec<(u64, SensorKind, Kind)> = seeds
        .clone()
        .flat_map(|seed| {
            [SensorKind::Height, SensorKind::Imu]
                .into_iter()
                .flat_map(move |of| KINDS.map(move |kind| (seed, of, kind)))
        })
        .collect();
    let attacked = parallel(works.len(), |i| {
        let (seed, of, kind) = works[i];
        let scenario = case.scenario(seed);
        let attacks = Attacked::Kind(of, kind).attacks(&scenario.flight_config().sensors, seed);
        let scores = scores(&setup(seed, &attacks), attacks[0].start_s);
        let of = scores.into_iter().find(|(sensor, _)| *sensor == attacks[0].sensor);
        let scores = of.map_or([0.0; 3], |(_, scores)| scores);
        Found { kind, channel: attacks[0].channel, sensor: attacks[0].sensor, scores }
    });
    for (name, of, channel) in QUANTITIES {
        let healthy: [Vec<f64>; 3] = std::array::from_fn(|test| {
            let all = quiet.iter().flatten().filter(|(sensor, _)| sensor.kind == of);
            all.map(|(_, scores)| scores[test]).collect()
        });
        let those: Vec<&Found> = attacked.iter().filter(|f| f.sensor.kind == of && channel(f.channel)).collect();
        let mut plot =
            Plot::new(&format!("Detection: {name}"), "healthy sensors above the threshold", "attacked above it");
        for (test, by) in TESTS.into_iter().enumerate() {
            let all: Vec<f64> = those.iter().map(|found| found.scores[test]).collect();
            if all.is_empty() {
                continue;
            }
            plot = plot.with(Series::line(by, curve(&healthy[test], &all)));
            tell(report, effort, &format!("roc/{name}/all/{by}"), &healthy[test], &all);
            for kind in KINDS {
                let of: Vec<f64> = those.iter().filter(|f| f.kind == kind).map(|f| f.scores[test]).collect();
                if !of.is_empty() {
                    tell(report, effort, &format!("roc/{name}/{kind:?}/{by}"), &healthy[test], &of);
                }
            }
        }
        report.figure(&format!("roc_{}", name.to_lowercase()), "Every kind and size, drawn", &plot)?;
    }
    Ok(())
}

fn tell(report: &mut Report, effort: &Effort, name: &str, healthy: &[f64], attacked: &[f64]) {
    let [at_1, at_5] = RATES.map(|rate| found_at(rate, healthy, attacked));
    let reached = |part: f64| plumbline_experiment::draw::percentile(healthy, part);
    let more = json!({
        "seed_base": effort.seed_base, "attacked": attacked.len(), "healthy": healthy.len(), "area": area(healthy, attacked),
        "found_at_5_percent": at_5, "healthy_95": reached(0.95), "healthy_99": reached(0.99),
    });
    report.value(name, at_1, "found at 1 %", more);
}

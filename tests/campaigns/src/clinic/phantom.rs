//! Four real IMUs: one of them attacked in a recorded flight, its other samples untouched.

use std::path::{Path, PathBuf};

use plumbline_agent::attack::{Attack, Bounds, Channel, Injector, Kind, Schedule};
use plumbline_agent::estimate::bank::{self, Assumptions};
use plumbline_agent::estimate::secure::SLOTS;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::recordings;
use plumbline_agent::types::{EstimatorKind, MotorCommand};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use plumbline_tests::report::Report;
use serde_json::json;

use plumbline_experiment::draw::{median, parallel, worst};

use super::Effort;

/// Attacks begin this long after the first frame, s, and end with the recording.
const ONSET_S: f64 = 10.0;
/// Inclination is judged from here on, s after the first frame.
const JUDGED_FROM_S: f64 = 8.0;

/// Name, kind, magnitude, channel. Biases far above what healthy units differ by.
const ATTACKS: [(&str, Kind, f64, Channel); 5] = [
    ("bias_gyro", Kind::Bias, 0.5, Channel::Gyro),
    ("bias_accel", Kind::Bias, 4.0, Channel::Accel),
    ("freeze", Kind::Freeze, 0.0, Channel::All),
    ("replay", Kind::Replay, 3.0, Channel::All),
    ("scale", Kind::Scale, 1.5, Channel::All),
];

/// Largest inclination error under attack, over the clean run's.
const RATIO: f64 = 1.2;

struct Run {
    inclination_deg: f64,
    /// Onset to flag, s; zero where it was flagged already.
    delay_s: Option<f64>,
    /// Flags raised on others, or before the attack.
    false_exclusions: Vec<SensorId>,
    minutes: f64,
}

fn run_one(folder: &Path, attack: Option<(usize, u8)>, effort: &Effort) -> Option<Run> {
    let mut recording = recordings::open(folder).ok()?;
    let sensors = recording.info().sensor_model();
    let airframe = Airframe::iris();
    let mut secure = bank::build(
        EstimatorKind::Secure,
        &Assumptions { airframe: &airframe, sensors: &sensors, window_slots: SLOTS },
    )
    .unwrap();
    let sensors: Vec<SensorId> = recording.info().sensors.iter().map(|s| s.id).collect();
    let mut injector = Injector::new(
        Bounds { duration_max_s: 3600.0, rate_max_radps: 100.0, accel_max_mps2: 100.0, ..Bounds::default() },
        true,
        &sensors,
    );
    let victim = attack.map(|(_, instance)| SensorId::new(SensorKind::Imu, instance));
    let (mut begun, mut sum, mut count) = (None, 0.0, 0.0);
    let mut run = Run { inclination_deg: f64::NAN, delay_s: None, false_exclusions: Vec::new(), minutes: 0.0 };
    let mut flagged: Vec<SensorId> = Vec::new();
    let mut applied = MotorCommand::default();
    while let Some(tick) = recording.next_tick() {
        let frame = tick.received.unwrap_or(tick.sensed);
        let now = frame.time;
        let start: FlightTime = *begun.get_or_insert_with(|| {
            if let Some((index, instance)) = attack {
                let (_, kind, magnitude, channel) = ATTACKS[index];
                let one = Attack {
                    id: 1,
                    sensor: SensorId::new(SensorKind::Imu, instance),
                    channel,
                    kind,
                    start_s: ONSET_S,
                    duration_s: 3000.0,
                    magnitude,
                    seed: effort.flown.seed(1),
                };
                injector
                    .upload(&Schedule { id: 1, attacks: [one].into_iter().collect(), ..Schedule::default() }, now)
                    .unwrap();
            }
            now
        });
        let received = injector.apply(&frame);
        let estimate = secure.step(&received, &applied);
        applied = tick.applied.unwrap_or(applied);
        let t = now.seconds_since(start);
        run.minutes = t / 60.0;
        if let Some(truth) = tick.truth.filter(|_| t >= JUDGED_FROM_S) {
            // What a vertical vector in the body differs by: heading does not enter.
            let up = |q: &nalgebra::UnitQuaternion<f64>| q.inverse() * nalgebra::Vector3::z();
            let angle = up(&estimate.world_from_body).angle(&up(&truth.world_from_body));
            sum += angle * angle;
            count += 1.0;
        }
        let Some(own) = secure.secure() else { continue };
        if t >= ONSET_S && victim.is_some_and(|id| flagged.contains(&id)) {
            run.delay_s = run.delay_s.or(Some(0.0));
        }
        for device in own.isolation().devices() {
            let known = flagged.iter().position(|id| *id == device.sensor);
            match (device.flagged.is_some(), known) {
                (true, None) => {
                    flagged.push(device.sensor);
                    if Some(device.sensor) == victim && t >= ONSET_S {
                        run.delay_s = run.delay_s.or(Some(t - ONSET_S));
                    } else {
                        run.false_exclusions.push(device.sensor);
                    }
                }
                (false, Some(at)) => {
                    flagged.remove(at);
                }
                _ => {}
            }
        }
    }
    run.inclination_deg = (sum / count).sqrt().to_degrees();
    Some(run)
}

pub fn run(report: &mut Report, effort: &Effort) {
    report.heading("Four real IMUs: Phantom 4");
    let root = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    let folder = ["data/phantom4_4imu_rtk", "phantom4_4imu_rtk"].map(|f| root.join(f)).into_iter().find(|f| f.is_dir());
    let Some(folder) = folder else {
        return report.skipped("phantom4", &format!("{} is absent", root.join("data/phantom4_4imu_rtk").display()));
    };
    let mut flights: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.join("IMU_4.csv").is_file())
        .collect();
    flights.sort();
    let clean: Vec<Run> =
        parallel(flights.len(), |i| run_one(&flights[i], None, effort)).into_iter().flatten().collect();
    if clean.len() != flights.len() || clean.is_empty() {
        return report.skipped("phantom4", "a recording could not be read");
    }
    let name = |i: usize| flights[i].file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let minutes: f64 = clean.iter().map(|r| r.minutes).sum();
    let flags: usize = clean.iter().map(|r| r.false_exclusions.len()).sum();
    // The recordings in which the IMUs agree without attack: there the attacked one, and no other, is to be flagged.
    let agreeing: Vec<usize> = (0..flights.len()).filter(|i| clean[*i].false_exclusions.is_empty()).collect();
    let contradictory: serde_json::Map<_, _> = (0..flights.len())
        .filter(|i| !clean[*i].false_exclusions.is_empty())
        .map(|i| (name(i), json!(clean[i].false_exclusions.iter().map(SensorId::to_string).collect::<Vec<_>>())))
        .collect();
    report.value(
        "phantom4/clean",
        flags as f64 / minutes,
        "false flags/min",
        json!({ "flights": flights.len(), "minutes": minutes, "flagged_without_attack": contradictory,
            "inclination_deg": median(&clean.iter().map(|r| r.inclination_deg).collect::<Vec<_>>()) }),
    );
    let mut rows = Vec::new();
    for (index, (attack, ..)) in ATTACKS.iter().enumerate() {
        let runs: Vec<(usize, Run)> = parallel(4 * flights.len(), |i| {
            Some((i / 4, run_one(&flights[i / 4], Some((index, 1 + (i % 4) as u8)), effort)?))
        })
        .into_iter()
        .flatten()
        .collect();
        for (which, only) in [("", &agreeing), ("/every_recording", &(0..flights.len()).collect())] {
            let runs = || runs.iter().filter(|(f, _)| only.contains(f));
            let ratios: Vec<f64> = runs().map(|(f, r)| r.inclination_deg / clean[*f].inclination_deg).collect();
            let delays: Vec<f64> = runs().filter_map(|(_, r)| r.delay_s).collect();
            let wrong: usize = runs().map(|(_, r)| r.false_exclusions.len()).sum();
            let count = ratios.len();
            report.value(
                &format!("phantom4/{attack}{which}"),
                median(&ratios),
                "of clean inclination error",
                json!({ "worst": worst(&ratios), "flagged": delays.len(), "runs": count, "detection_s": median(&delays),
                    "detection_worst_s": worst(&delays), "wrong_flags": wrong, "limit": RATIO,
                    "met": worst(&ratios) <= RATIO && delays.len() == count && wrong == 0 }),
            );
            rows.push(vec![
                (*attack).to_owned(),
                if which.is_empty() { "IMUs agree".to_owned() } else { "every recording".to_owned() },
                format!("{:.3}", median(&ratios)),
                format!("{:.3}", worst(&ratios)),
                format!("{} of {count}", delays.len()),
                wrong.to_string(),
                format!("{:.2}", median(&delays)),
                format!("{:.2}", worst(&delays)),
            ]);
        }
    }
    let headers =
        ["attack", "recordings", "inclination", "worst", "flagged", "others flagged", "after, s", "at most, s"];
    report
        .table(
            "phantom4",
            "Inclination error over the clean run's (limit 1.2); one of four IMUs attacked.",
            &headers,
            &rows,
        )
        .unwrap();
}

//! Recordings flown again by the program itself: what it tells is what the recording says.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use plumbline_agent::recordings::shared;
use plumbline_proto::{Kind, Message, v1};

/// Flies without a ground, as fast as possible; the one file that it writes into `folder`.
fn fly(folder: &Path, arguments: &[&str]) -> Told {
    let output = Command::new(env!("CARGO_BIN_EXE_plumbline-agent"))
        .args(arguments)
        .args(["--ground", "none", "--speed", "max", "--log"])
        .arg(folder)
        .env("RUST_LOG", "warn")
        .output()
        .unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    let files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{arguments:?}: {files:?}");
    Told::read(&files[0])
}

/// What a flight told.
struct Told {
    file: PathBuf,
    description: v1::Description,
    controls: BTreeMap<u64, v1::Control>,
    estimates: BTreeMap<u64, BTreeMap<u16, v1::Estimate>>,
    heights: BTreeMap<(u16, u64), v1::HeightSample>,
    steps: Vec<v1::StepResponse>,
    statuses: Vec<v1::Status>,
    events: Vec<String>,
    truths: usize,
    /// Instances of sensors that told something, by topic.
    sensors: BTreeSet<String>,
}

impl Told {
    fn read(file: &Path) -> Self {
        let mut told = Self {
            file: file.to_path_buf(),
            description: v1::Description::default(),
            controls: BTreeMap::new(),
            estimates: BTreeMap::new(),
            heights: BTreeMap::new(),
            steps: Vec::new(),
            statuses: Vec::new(),
            events: Vec::new(),
            truths: 0,
            sensors: BTreeSet::new(),
        };
        let bytes = std::fs::read(file).unwrap();
        let mut sequence = None;
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            assert!(sequence.is_none_or(|last| message.sequence == last + 1), "a message is lost");
            sequence = Some(message.sequence);
            told.take(&message.channel.topic, &message.data);
        }
        told
    }

    fn take(&mut self, topic: &str, bytes: &[u8]) {
        let (kind, instance) = Kind::from_topic(topic).unwrap();
        if topic.starts_with("/sensor/") {
            self.sensors.insert(topic.trim_start_matches("/sensor/").replace(['/', '_'], " "));
        }
        match kind {
            Kind::Description => self.description = v1::Description::decode(bytes).unwrap(),
            Kind::Control => {
                let control = v1::Control::decode(bytes).unwrap();
                self.controls.insert(control.time_us, control);
            }
            Kind::Estimate => {
                let estimate = v1::Estimate::decode(bytes).unwrap();
                self.estimates.entry(estimate.time_us).or_default().insert(instance, estimate);
            }
            Kind::Height => {
                let sample = v1::HeightSample::decode(bytes).unwrap();
                self.heights.insert((instance, sample.time_us), sample);
            }
            Kind::StepResponse => self.steps.push(v1::StepResponse::decode(bytes).unwrap()),
            Kind::Status => self.statuses.push(v1::Status::decode(bytes).unwrap()),
            Kind::Event => self.events.push(v1::Event::decode(bytes).unwrap().text),
            Kind::Truth => self.truths += 1,
            _ => {}
        }
    }

    /// Instances of heights that were received otherwise than sensed, with the first offset.
    fn altered(&self) -> BTreeMap<u16, f64> {
        let altered = |sample: &v1::HeightSample| Some(sample.received_m? - sample.sensed_m);
        self.heights.iter().rev().filter_map(|((i, _), s)| altered(s).map(|by| (*i, by))).collect()
    }

    fn in_loop(&self) -> v1::EstimatorKind {
        self.statuses.last().unwrap().estimator_in_loop()
    }
}

/// A flight with steps and an attack on height 2.
fn attacked_flight(folder: &Path) -> Told {
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenarios/height_attack.toml");
    fly(&folder.join("then"), &["--scenario", scenario.to_str().unwrap(), "--script"])
}

#[test]
fn an_own_flight_comes_back_as_it_was_and_can_be_flown_under_other_attacks_and_estimators() {
    let folder = tempfile::tempdir().unwrap();
    let then = attacked_flight(folder.path());
    let file = then.file.to_str().unwrap();
    let offset = then.altered()[&2];
    assert!(!then.steps.is_empty() && (offset - 0.5).abs() < 1e-9, "attacked by {offset} m");

    // GIVEN nothing else THEN sensors, receptions, motors, modes, setpoints and steps are those of then.
    let now = fly(&folder.path().join("now"), &["--vehicle", "replay", file]);
    assert_eq!((now.description.vehicle.as_str(), &now.description.scenario), ("replay", &then.description.scenario));
    assert_eq!((&now.sensors, &now.heights), (&then.sensors, &then.heights));
    assert_eq!(now.controls, then.controls);
    assert_eq!(now.steps, then.steps);
    let modes = |told: &Told| {
        let mut modes: Vec<_> = told.statuses.iter().map(|s| (s.mode, s.armed)).collect();
        modes.dedup();
        modes
    };
    assert_eq!(modes(&now), modes(&then));
    assert!(now.statuses.iter().all(|s| !s.ready_to_arm && s.replay_progress > 0.0 && !s.cut_latched));
    assert!(now.statuses.last().unwrap().battery_v > 10.0);
    // AND the estimate, once it has found its feet, agrees with the one of then.
    let from = now.controls.keys().next().unwrap() + 8_000_000;
    let mut compared = 0;
    for (time, both) in now.estimates.range(from..) {
        let (a, b) = (&both[&9], &then.estimates[time][&9]);
        let apart = (a.position_enu_m.unwrap().z - b.position_enu_m.unwrap().z).abs();
        assert!(apart < 0.02, "at {time} µs the altitudes are {apart} m apart");
        assert!(a.step_time_us > 0.0 && a.step_time_us < 1e5, "{} µs", a.step_time_us);
        compared += 1;
    }
    assert!(compared > 5000, "{compared}");
    assert!(now.events.len() <= 2, "{:?}", now.events);

    // GIVEN another schedule THEN the old attack is gone and the new one is received.
    let schedule = folder.path().join("other.toml");
    let attack = "[[attack]]\nsensor = \"height\"\ninstance = 3\nkind = \"bias\"\nstart_s = 5\nduration_s = 4\nmagnitude = -0.3\n";
    std::fs::write(&schedule, attack).unwrap();
    let arguments = ["--vehicle", "replay", file, "--attack-schedule", schedule.to_str().unwrap()];
    let other = fly(&folder.path().join("other"), &arguments);
    let altered = other.altered();
    assert_eq!(altered.keys().collect::<Vec<_>>(), [&3], "{altered:?}");
    assert!((altered[&3] + 0.3).abs() < 1e-9, "{altered:?}");
    assert!(other.events.iter().any(|text| text.contains("active")), "{:?}", other.events);

    // GIVEN another estimator THEN it is in the loop and meets the attack of then.
    let primary = fly(&folder.path().join("primary"), &["--vehicle", "replay", file, "--estimator", "primary"]);
    assert_eq!((now.in_loop(), primary.in_loop()), (v1::EstimatorKind::Lanes, v1::EstimatorKind::Complementary));
    assert_eq!(primary.altered(), then.altered());
    assert!(primary.estimates.values().all(|all| all.get(&9).is_none_or(|e| !e.in_loop)));
    assert_eq!(primary.estimates.values().filter(|all| all.contains_key(&2)).count(), primary.controls.len());
}

#[test]
fn a_replay_of_a_replay_is_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let then = attacked_flight(folder.path());
    let once = fly(&folder.path().join("once"), &["--vehicle", "replay", then.file.to_str().unwrap()]);
    let twice = fly(&folder.path().join("twice"), &["--vehicle", "replay", once.file.to_str().unwrap()]);
    assert_eq!((&twice.controls, &twice.heights, &twice.steps), (&once.controls, &once.heights, &once.steps));
    let timeless = |told: &Told| {
        let mut estimates = told.estimates.clone();
        estimates.values_mut().flat_map(|all| all.values_mut()).for_each(|e| e.step_time_us = 0.0);
        estimates
    };
    assert!(timeless(&twice) == timeless(&once), "the same samples, other estimates");
}

#[test]
fn recordings_of_others_show_their_own_sensors_and_their_estimators_start() {
    let four_imus = ["gnss 1", "imu 1", "imu 2", "imu 3", "imu 4"];
    for (file, sensors, truth) in [
        ("broad_imu_mocap/11_undisturbed_slow_translation_B.csv.gz", &["imu 1"][..], true),
        ("phantom4_4imu_rtk/Horizontal_path_1", &four_imus, true),
        ("px4_ulog/sample_logging_tagged_and_default_params.ulg", &["barometer 1", "gnss 1", "imu 1"], true),
        ("px4_ulog/test_ulog.ulg", &["barometer 1", "gnss 1", "imu 1"], false),
        ("rotorpy_sim/hummingbird_lissajous.csv.gz", &["imu 1", "mocap pose 1"], true),
    ] {
        let Some(path) = shared(&format!("data/{file}")) else { continue };
        let folder = tempfile::tempdir().unwrap();
        let told = fly(folder.path(), &["--vehicle", "replay", path.to_str().unwrap()]);
        assert_eq!(told.sensors.iter().collect::<Vec<_>>(), sensors, "{file}");
        let mut described: Vec<_> = told.description.sensors.iter().map(|s| s.name.as_str()).collect();
        described.sort_unstable();
        assert_eq!(described, sensors, "{file}");
        assert!(told.description.sensors.iter().all(|s| s.rate_hz > 0.0 && !s.unit.is_empty()), "{file}");
        assert_eq!(told.truths > 0, truth, "{file}");
        // The one log of a flight knows when its vehicle was armed; the others do not say, or were never armed.
        let armed = file.ends_with("/test_ulog.ulg");
        assert_eq!(told.controls.values().any(|c| c.armed), armed, "{file}");
        assert_eq!(told.statuses.iter().any(|s| s.armed), armed, "{file}");
        let first = *told.estimates.keys().next().unwrap();
        let healthy = |e: &v1::Estimate| e.health() == v1::Health::Healthy;
        let started = told.estimates.iter().find(|(_, all)| all.get(&1).is_some_and(healthy)).map(|(t, _)| t - first);
        assert!(started.is_some_and(|us| us < 2_500_000), "{file}: healthy after {started:?} µs");
        let finite = |e: &v1::Estimate| {
            let a = e.roll_pitch_yaw_rad.unwrap();
            // One that is initialising estimates no place.
            e.position_enu_m.is_none_or(|p| [p.x, p.y, p.z].iter().all(|v| v.is_finite()))
                && [a.x, a.y, a.z].iter().all(|v| v.is_finite())
        };
        assert!(told.estimates.values().flat_map(|all| all.values()).all(finite), "{file}");
        assert!(told.events.len() <= 3, "{file}: {:?}", told.events);
    }
}

//! Plans over recordings: found, refused with the line, flown again, reported, opened.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use plumbline_agent::flight::Flight;
use plumbline_agent::log::{self, LogConfig, RING_BYTES};
use plumbline_agent::recordings;
use plumbline_agent::sensor::suite::Suite;
use plumbline_agent::telemetry::{Around, Identification, Outlet, Telemetry};
use plumbline_experiment::by_hand::{self, ByHandError};
use plumbline_experiment::flight::fly_watched;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::recordings::{Against, Library};
use plumbline_experiment::row::Row;
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::{Experiment, StoreError};
use plumbline_experiment::{open, parquet, report, summary, trace};
use plumbline_proto::time::WallTime;
use plumbline_rest::experiment::FlownByHand;

/// 27 s in the air; from 15 s after its beginning on a height is attacked.
const FLOWN: &str = r#"
name = "flown"
[scenario]
duration_s = 30
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 },
]
[attack]
sensor = "height"
instance = 2
kind = "bias"
magnitude = -0.5
start_s = 18.0
"#;

/// 2 recordings × 2 estimators × with and without an attack.
const PLAN: &str = r#"
name = "again"
baseline = { "attack.kind" = "none" }
[attack]
sensor = "height"
instance = 1
kind = "bias"
magnitude = 0.5
start_s = 16.0
[[factor]]
key = "recording"
values = ["first", "second"]
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
[[factor]]
key = "attack.kind"
values = ["none", "bias"]
"#;

/// Flies `plan` with this seed into the archive below `data`, the truth in it or not.
fn record(data: &Path, name: &str, plan: &str, seed: u64, with_truth: bool) {
    let condition = Plan::from_toml(plan).unwrap().condition(0).unwrap();
    let setup = condition.setup(seed);
    let folder = tempfile::tempdir().unwrap();
    let identification = Identification {
        agent_id: name.into(),
        boot_id: seed,
        boot_wall_time: WallTime(1_000_000_000 * seed),
        vehicle: "sim",
        rig: String::new(),
        scenario: condition.scenario_text(seed),
        seed,
        source_file: String::new(),
        sensors: setup.scenario.suite.descriptions(),
        strings: Default::default(),
        promise: None,
    };
    let (ring, frames) = rtrb::RingBuffer::new(RING_BYTES);
    let settings = LogConfig {
        folder: folder.path().into(),
        max_bytes: log::DEFAULT_MAX_BYTES,
        agent_id: name.into(),
        boot_wall_time: identification.boot_wall_time,
    };
    let kept = log::spawn(settings, frames).unwrap();
    let described = Flight::new(setup.config.clone()).unwrap();
    let mut telemetry = Telemetry::new(identification, &described, None, Some(Outlet::new(ring)));
    let mut last = None;
    fly_watched(&setup, |flight, truth| {
        while telemetry.log_room().is_some_and(|room| room < 256 << 10) {
            std::thread::yield_now();
        }
        telemetry.tick(flight, Some(truth).filter(|_| with_truth), &Around::default());
        last = Some(truth.time);
    })
    .unwrap();
    telemetry.shutdown(last.unwrap());
    kept.stop();
    let files = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
    let file = files.into_iter().find(|path| path.extension().is_some_and(|ending| ending == "mcap")).unwrap();
    let flights = data.join("flights");
    std::fs::create_dir_all(&flights).unwrap();
    std::fs::copy(file, flights.join(format!("{name}.mcap"))).unwrap();
}

fn made(data: &Path, plan: &str) -> Experiment {
    let plan = Plan::over(plan, &Library::archive(data)).unwrap();
    Experiment::create(&Experiment::root(data), plan).unwrap()
}

fn flown(experiment: &Experiment) -> Vec<Row> {
    assert_eq!(run(experiment, &Options::default(), &AtomicBool::new(false), |_, _| {}).unwrap(), Ended::Complete);
    experiment.rows().unwrap()
}

#[test]
fn recordings_are_flown_under_other_estimators_and_attacks_and_each_row_opens() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    for (name, seed) in [("first", 1), ("second", 2)] {
        record(data, name, FLOWN, seed, true);
    }
    let experiment = made(data, PLAN);
    let rows = flown(&experiment);
    let at = |recording: usize, estimator: usize, kind: usize| &rows[4 * recording + 2 * estimator + kind];
    assert_eq!(rows.len(), 8);
    for row in &rows {
        // Flown by somebody else, and well; what was done to its sensors then is not done again.
        assert_eq!(row.lost(), "", "flight {}", row.index);
        assert!(row.value("altitude_m") < 0.2 && row.value("effort_per_s") > 0.0, "{row:?}");
        assert!((0.001..0.5).contains(&row.value("estimate_m")), "{row:?}");
    }
    for recording in [0, 1] {
        // The way flown is the same, whoever estimates and whatever is attacked.
        let ways: Vec<_> = (0..4).map(|of| at(recording, of / 2, of % 2).value("altitude_m")).collect();
        assert!(ways.iter().all(|way| *way == ways[0]), "{ways:?}");
        let (clean, attacked) = (at(recording, 1, 0), at(recording, 1, 1));
        assert_eq!((clean.value("missed"), attacked.value("missed")), (0.0, 0.0), "{attacked:?}");
        assert!((0.0..3.0).contains(&attacked.value("delay_s")) && clean.value("delay_s").is_nan(), "{attacked:?}");
        assert!(attacked.value("estimate_m") < 0.1, "{attacked:?}");
    }
    assert!(at(0, 0, 0) != at(1, 0, 0));

    // THEN flown again it is the same, on its own and kept in a file with the traces of the estimator asked for
    let file = open::open(&experiment, 3).unwrap();
    let again = recordings::open(&file).unwrap();
    let info = again.info();
    assert_eq!(info.attacked.iter().map(|(sensor, _)| sensor.to_string()).collect::<Vec<_>>(), ["height 1"]);
    let original = recordings::open(&data.join("flights/first.mcap")).unwrap();
    assert_eq!((info.span, info.sensors.len()), (original.info().span, original.info().sensors.len()));
    assert!(info.has_truth && info.has_motors);

    // THEN there is a report, a table and errors over time, and not a NaN among them
    trace::write(&experiment, 1).unwrap();
    assert!(trace::bands(&experiment).unwrap().bands.iter().all(|band| !band.t_s.is_empty()));
    let page = report::page(&experiment, "").unwrap();
    assert!(page.contains("Recordings flown again") && page.contains("flights/3/open") && !page.contains("NaN"));
    assert!(std::fs::read(parquet::export(&experiment).unwrap()).unwrap().starts_with(b"PAR1"));
    let results = summary::results(&experiment).unwrap();
    assert_eq!((results.notes.len(), results.conditions[3].detected.unwrap().count), (1, 1));

    // WHEN nothing is done to its sensors THEN what was received then is received again, its attack included
    let plan = "name = \"then\"\nrecording = \"first\"\n[agent]\nestimators = { in_loop = \"lanes\" }\n";
    let [then] = flown(&made(data, plan))[..] else { panic!("one flight") };
    assert!(then.value("missed") == 0.0 && (0.0..3.0).contains(&then.value("delay_s")), "{then:?}");
    // THEN it is another flight than the one without, and than that of somebody who knows
    assert!(then.value("estimate_m") != at(0, 1, 0).value("estimate_m"));
    let [known] = flown(&made(data, &format!("reception = \"oracle\"\n{plan}")))[..] else { panic!("one flight") };
    assert!(known.value("estimate_m") != then.value("estimate_m"), "{known:?}");

    // WHEN a recording is another one than before THEN nothing of the two is mixed
    let before = Plan::over(PLAN, &Library::archive(data)).unwrap().hash();
    std::fs::copy(data.join("flights/first.mcap"), data.join("flights/second.mcap")).unwrap();
    assert_ne!(Plan::over(PLAN, &Library::archive(data)).unwrap().hash(), before);
    let kept = Experiment::open(&Experiment::root(data), &experiment.id).unwrap();
    kept.own().unwrap();
    let refused = run(&kept, &Options::default(), &AtomicBool::new(false), |_, _| {}).unwrap_err();
    assert!(matches!(refused, StoreError::Recording(_)) && refused.to_string().contains("second.mcap"), "{refused}");
    assert!(kept.rows().unwrap() == rows);
}

/// GIVEN a plan that an operator flies WHEN a recording is accepted THEN its attack is in it, and its place is free to the last.
#[test]
fn a_recording_is_accepted_with_its_attack_and_in_one_place() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    record(data, "attacked", FLOWN, 1, true);
    record(data, "clean", &FLOWN.replace("kind = \"bias\"", "kind = \"none\""), 1, true);
    let plan = "name = \"by_hand\"\n[by_hand]\nvehicle = \"sim\"\naltitude_m = [0.9, 0.9]\n[agent]\n\
                estimators = { in_loop = \"lanes\" }\n[attack]\nsensor = \"height\"\nkind = \"bias\"\nmagnitude = 0.5\nstart_s = 6.0\n";
    let experiment = made(data, plan);
    let told = |flight: &str| FlownByHand { flight: flight.into(), accepted: true, ..FlownByHand::default() };
    let library = Library::archive(data);
    let refused = by_hand::keep(&experiment, &told("clean"), &library).unwrap_err();
    assert!(refused.to_string().contains("clean: nothing is attacked in it"), "{refused}");
    // Somebody else takes the place while the recording is fetched.
    let (from, to) = (data.join("flights/attacked.mcap"), data.join("flights/late.mcap"));
    let journal = experiment.folder.join("by_hand.jsonl");
    let other = serde_json::to_string(&told("first")).unwrap() + "\n";
    let meanwhile = Library::archive(data).fetching(move |_| {
        std::fs::copy(&from, &to).unwrap();
        std::fs::write(&journal, &other).unwrap();
    });
    let refused = by_hand::keep(&experiment, &told("late"), &meanwhile).unwrap_err();
    assert!(matches!(&refused, ByHandError::Taken { index: 0, flight } if flight == "first"), "{refused}");
    std::fs::remove_file(experiment.folder.join("by_hand.jsonl")).unwrap();
    by_hand::keep(&experiment, &told("attacked"), &library).unwrap();
    let detected = summary::results(&experiment).unwrap().conditions[0].detected;
    assert_eq!(detected.map(|part| (part.count, part.of)), Some((1, 1)));
}

#[test]
fn without_truth_measures_say_what_they_are_against() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let suite = "[scenario]\nsuite = { preset = \"string_rig\", add = [\"mocap_pose\"] }\n";
    record(data, "setpoint", FLOWN, 3, false);
    record(data, "captured", &FLOWN.replace("[scenario]\n", suite), 3, false);
    let plan = "name = \"blind\"\n[[factor]]\nkey = \"recording\"\nvalues = [\"setpoint\", \"captured\"]\n[attack]\n";
    let plan = format!("{plan}sensor = \"none\"\n");
    let experiment = made(data, &plan);
    let against: Vec<_> = experiment.plan.recordings.named().map(|named| named.against).collect();
    assert_eq!(against, [Against::Setpoint, Against::MotionCapture]);
    let [blind, captured] = flown(&experiment)[..] else { panic!("two flights") };
    // The estimate less the setpoint; what needs a truth is nothing.
    assert!((0.0..0.2).contains(&blind.value("altitude_m")), "{blind:?}");
    assert!(["estimate_m", "tilt_rad", "nees", "outside_bound"].iter().all(|measure| blind.value(measure).is_nan()));
    assert!(blind.value("nis").is_finite() && blind.value("effort_per_s") > 0.0);
    assert!((0.0..0.2).contains(&captured.value("altitude_m")), "{captured:?}");
    assert!((0.0..0.1).contains(&captured.value("estimate_m")), "{captured:?}");
    assert!(captured.value("tilt_rad") < 0.1, "{captured:?}");
    let results = summary::results(&experiment).unwrap();
    assert!(results.notes[1].contains("setpoint: neither truth nor motion capture"), "{:?}", results.notes);
    assert!(results.notes[2].contains("captured: no truth") && results.notes.len() == 3, "{:?}", results.notes);
    let page = report::page(&experiment, "").unwrap();
    assert!(page.contains("neither truth nor motion capture") && !page.contains("NaN"), "{page}");
    trace::write(&experiment, 1).unwrap();
    assert!(trace::bands(&experiment).unwrap().bands.iter().all(|band| !band.t_s.is_empty()));
}

#[test]
fn what_cannot_be_flown_again_is_refused_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    record(data, "first", FLOWN, 1, true);
    record(data, "short", &FLOWN.replace("duration_s = 30", "duration_s = 14").replace("18.0", "13.0"), 1, true);
    std::fs::write(data.join("flights/empty.mcap"), b"").unwrap();
    let broad = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,\
                 ref_px_m,ref_py_m,ref_pz_m,movement\n";
    let no_samples = data.join("none.csv");
    std::fs::write(&no_samples, broad).unwrap();
    let one = |rest: &str| format!("name = \"a\"\nrecording = \"first\"\n{rest}");
    let factor =
        |name: &str| format!("name = \"a\"\n\n[[factor]]\nkey = \"recording\"\nvalues = [\"first\", {name}]\n");
    let sensors = Suite::string_rig().descriptions();
    assert!(!sensors.iter().any(|described| described.id.to_string().starts_with("gnss")));
    for (text, line, expected) in [
        (one("").replace("first", "nobody"), 2, "not the id of a finished flight"),
        (one("").replace("first", "../flights/first"), 2, "not the id of a finished flight"),
        (factor("\"nobody\""), 4, "\"nobody\""),
        (factor("7"), 4, "7: not the name"),
        (factor("\"empty\""), 4, "empty file"),
        (factor("\"short\""), 4, "lasts 11.0 s, and flights are judged from 12 s on"),
        (one("[attack]\nsensor = \"gnss\"\nkind = \"bias\"\nmagnitude = 1.0\n"), 3, "no gnss 1"),
        (one("[attack]\nsensor = \"height\"\ninstance = 9\nkind = \"bias\"\nstart_s = 14.0\n"), 3, "height 9"),
        (one("[attack]\nsensor = \"height\"\nkind = \"bias\"\nmagnitude = 0.2\nstart_s = 27.5\n"), 2, "27.5 s"),
        (one("[scenario]\nworld = \"datasheet\"\n"), 3, "a recording is flown instead"),
        (one("[agent.estimators]\nin_loop = \"nose\"\n"), 4, "nose"),
        ("name = \"a\"\nrecording = 3\n".into(), 2, "3"),
    ] {
        let error = Plan::over(&text, &Library::archive(data)).map(|plan| plan.flights()).expect_err(&text);
        assert!(error.message.contains(expected), "{text}\ngives: {error}");
        assert_eq!(error.line, line, "{text}\ngives: {error}");
    }
    // A file is named where files may be, and workers, who have none, say so.
    let file = one("").replace("first", no_samples.to_str().unwrap());
    let error = Plan::over(&file, &Library::archive(data).with_files()).expect_err("no samples");
    assert!(error.message.contains("nothing to fly") && error.line == 2, "{error}");
    let error = Plan::from_toml(&one("")).expect_err("no library");
    assert!(error.message.contains("not by workers"), "{error}");
    let path = data.join("flights/first.mcap");
    let plan = Plan::over(&one("").replace("first", path.to_str().unwrap()), &Library::archive(data).with_files());
    assert_eq!(plan.unwrap().flights(), 1);
}

#[test]
fn files_of_others_are_flown_again_and_say_only_what_is_in_them() {
    let files = ["broad_imu_mocap/02_undisturbed_slow_rotation_B.csv.gz", "rotorpy_sim/hummingbird_lissajous.csv.gz"];
    let found: Option<Vec<_>> = files.iter().map(|file| recordings::shared(&format!("data/{file}"))).collect();
    let Some(found) = found else { return };
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "name = \"others\"\n[agent.estimators]\nin_loop = \"lanes\"\n[[factor]]\nkey = \"recording\"\nvalues = {found:?}\n\
         [[factor]]\nkey = \"attack.sensor\"\nvalues = [\"none\", \"imu\"]\n[attack]\nkind = \"dropout\"\nmagnitude = 0.5\n\
         start_s = 14.0\n"
    );
    let plan = Plan::over(&text, &Library::archive(folder.path()).with_files()).unwrap();
    let experiment = Experiment::create(&Experiment::root(folder.path()), plan).unwrap();
    let rows = flown(&experiment);
    for row in &rows {
        assert!(row.value("tilt_rad").is_finite() && row.value("altitude_m").is_nan(), "{row:?}");
        assert!(row.value("altitude_most_m").is_nan() && row.lost().is_empty(), "{row:?}");
    }
    assert!(rows[0] != rows[1] && rows[2] != rows[3]);
    assert!(!report::page(&experiment, "").unwrap().contains("NaN"));
}

#[test]
fn a_flight_with_turning_motors_is_no_rest_to_calibrate_from() {
    use plumbline_agent::calibration::Kind;
    use plumbline_agent::offline::calibrate::{CalibrateError, Request, from_path};

    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), "first", FLOWN, 1, true);
    let path = folder.path().join("flights/first.mcap");
    for kind in [Kind::Accelerometer, Kind::Gyroscope, Kind::Magnetometer, Kind::Thermal, Kind::Allan] {
        let request = Request::new(kind, "2026-01-31T12:00:00Z");
        let error = from_path(&path, None, &Request { from_s: Some(10.0), ..request.clone() }).unwrap_err();
        assert!(matches!(error, CalibrateError::Motors { at_s, .. } if (10.0..10.1).contains(&at_s)), "{error}");
        assert!(error.to_string().contains("the motors turn at 10.0 s of first.mcap"), "{error}");
        // Outside the stretch they may turn.
        let before = from_path(&path, None, &Request { to_s: Some(2.0), ..request }).unwrap_err();
        assert!(!matches!(before, CalibrateError::Motors { .. }), "{before}");
    }
}

/// GIVEN scans that are stamped where they begin, 33 ms before they see the floor, up to 2 ms later by the host's clock, and motion capture
/// that is stamped as it sees WHEN a flight in the world of the data sheets steps up and down THEN it tells both by themselves.
#[test]
fn a_flight_tells_how_late_its_heights_are_stamped() {
    use plumbline_agent::calibration::Kind;
    use plumbline_agent::offline::calibrate::{Request, from_path};

    let step = |k: u32| {
        let (at_s, altitude_m) = (5 + 3 * k, if k.is_multiple_of(2) { 0.8 } else { 1.4 });
        format!("{{ at_s = {at_s}, do = \"setpoint\", altitude_m = {altitude_m} }},\n")
    };
    let steps: String = (0..21).map(step).collect();
    let plan = format!(
        r#"
name = "stepped"
[scenario]
world = "datasheet"
duration_s = 70
rig = {{ free = {{ height_m = 0.0 }} }}
suite = {{ preset = "string_rig", add = ["mocap_pose"] }}
script = [
  {{ at_s = 3, do = "arm" }}, {{ at_s = 4, do = "mode", mode = "altitude_hold" }},
  {steps}]
"#
    );
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), "stepped", &plan, 21, false);
    let path = folder.path().join("flights/stepped.mcap");
    let file = from_path(&path, None, &Request::new(Kind::Delays, "2026-01-31T12:00:00Z")).unwrap();
    assert_eq!(file.parameters.len(), 4, "{:?}", file.notes);
    for of in &file.parameters {
        let (truth_s, sigma_s) = (if of.name == "mocap_pose_1" { 0.0 } else { -0.0315 }, of.sigma.unwrap());
        assert!((of.value - truth_s).abs() < 3.0 * sigma_s && sigma_s < 0.01, "{of:?}");
    }
}

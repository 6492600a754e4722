//! Plans flown, killed, resumed, reported and opened.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use plumbline_agent::flight::Flight;
use plumbline_experiment::flight::fly_watched;
use plumbline_experiment::plan::{Draw, Plan};
use plumbline_experiment::row::{ROW_BYTES, Row};
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::{Experiment, StoreError};
use plumbline_experiment::{compare, open, parquet, report, summary, trace};

/// 2 × 2 conditions × 4 repeats of 18 s.
const PLAN: &str = r#"
name = "small"
description = "A <bias> on one height"
repeats = 4
seed = 40
baseline = { "attack.kind" = "none" }
[scenario]
duration_s = 18
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 },
]
[attack]
sensor = "height"
kind = "bias"
magnitude = 1.0
start_s = 13.0
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "secure"]
[[factor]]
key = "attack.kind"
values = ["none", "bias"]
"#;
const FLIGHTS: u64 = 16;

fn made(root: &Path) -> Experiment {
    Experiment::create(root, Plan::from_toml(PLAN).unwrap()).unwrap()
}

fn flown(experiment: &Experiment) -> Ended {
    run(experiment, &Options::default(), &AtomicBool::new(false), |_, _| {}).unwrap()
}

fn rows(experiment: &Experiment) -> Vec<Row> {
    experiment.rows().unwrap()
}

/// Not a test: what the test below starts and kills.
#[test]
#[ignore = "the process that is killed by another test"]
fn flies_until_it_is_killed() {
    let Some(root) = std::env::var_os("PLUMBLINE_EXPERIMENT_ROOT") else { return };
    let threads = std::env::var("PLUMBLINE_EXPERIMENT_THREADS").unwrap().parse().unwrap();
    let options = Options { threads, ..Options::default() };
    run(&made(Path::new(&root)), &options, &AtomicBool::new(false), |_, _| {}).unwrap();
}

#[test]
fn killed_at_any_moment_every_flight_is_there_once_and_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let undisturbed = made(&folder.path().join("undisturbed"));
    assert_eq!(flown(&undisturbed), Ended::Complete);
    let expected = rows(&undisturbed);
    assert_eq!(expected.len() as u64, FLIGHTS);

    let table = |experiment: &Experiment| std::fs::read(parquet::export(experiment).unwrap()).unwrap();
    let expected_table = table(&undisturbed);
    let wanted: u32 = std::env::var("PLUMBLINE_ROUNDS").map_or(2, |rounds| rounds.parse().unwrap());
    let (mut kills, mut experiments) = (0, 0);
    while kills < wanted {
        experiments += 1;
        let root = folder.path().join(format!("killed-{experiments}"));
        kills += killed_until_it_is_whole(&root, kills.into(), &expected[0]);
        let killed = made(&root);
        assert_eq!(flown(&killed), Ended::Complete);
        assert!(rows(&killed) == expected, "a row differs");
        // Nothing was flown twice: the file holds each row once.
        assert_eq!(std::fs::metadata(killed.folder.join("flights.rows")).unwrap().len(), FLIGHTS * ROW_BYTES as u64);
        assert!(table(&killed) == expected_table, "the tables differ");
    }
    println!("{kills} kills over {experiments} experiments of {FLIGHTS} flights");
}

/// Runs and kills until every flight is there; how many kills that took. `from`: rounds before, for other moments than theirs.
fn killed_until_it_is_whole(root: &Path, from: u64, torn: &Row) -> u32 {
    let killed = made(root);
    let mut kills = 0;
    for round in from.. {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "experiment::flies_until_it_is_killed", "--ignored", "--nocapture"])
            .env("PLUMBLINE_EXPERIMENT_ROOT", root)
            .env("PLUMBLINE_EXPERIMENT_THREADS", (1 + round % 3).to_string())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // From its first row on: another moment each round.
        let before = killed.done();
        while killed.done() == before && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        std::thread::sleep(Duration::from_millis(37 * round % 100));
        child.kill().unwrap();
        let ended = child.wait().unwrap();
        kills += u32::from(!ended.success());
        // A row that was torn as well: half of one at the end.
        if round % 2 == 0 && killed.done() < FLIGHTS {
            let path = killed.folder.join("flights.rows");
            let mut bytes = std::fs::read(&path).unwrap();
            bytes.extend_from_slice(&torn.encode()[..ROW_BYTES / 2]);
            std::fs::write(&path, bytes).unwrap();
        }
        if killed.done() == FLIGHTS {
            break;
        }
        assert!(round < from + 50, "{} of {FLIGHTS} after {} rounds", killed.done(), round - from);
    }
    kills
}

#[test]
fn an_experiment_is_stopped_resumed_reported_and_opened() {
    let folder = tempfile::tempdir().unwrap();
    let experiment = made(folder.path());
    // WHEN it is asked to stop THEN it ends early, and somebody else cannot fly it meanwhile
    let stop = AtomicBool::new(false);
    let options = Options { threads: 1, ..Options::default() };
    let ended = run(&experiment, &options, &stop, |progress, _| {
        assert!(matches!(experiment.hold(), Err(StoreError::Running(_))));
        assert!(experiment.since().is_some());
        if progress.done == 2 {
            experiment.ask_to_stop().unwrap();
        }
    });
    assert_eq!(ended.unwrap(), Ended::Stopped);
    let done = experiment.done();
    assert!((2..FLIGHTS).contains(&done), "{done}");
    assert!(experiment.since().is_none());
    // The report of what is there is whole at any time.
    assert!(report::page(&experiment, "").unwrap().contains(&format!("{done} of {FLIGHTS} flights")));
    let mut more = 0;
    let ended = run(&experiment, &Options::default(), &stop, |_, _| more += 1);
    assert_eq!((ended.unwrap(), done + more), (Ended::Complete, FLIGHTS));
    stop.store(true, Ordering::Relaxed);
    assert_eq!(run(&experiment, &options, &stop, |_, _| panic!("nothing is left")).unwrap(), Ended::Stopped);

    // THEN the secure estimator excludes the height, the EKF says nothing of it, and nothing is lost
    let results = summary::results(&experiment).unwrap();
    assert_eq!(results.conditions.len(), 4);
    let detected: Vec<_> = results.conditions.iter().map(|c| c.detected.map(|part| (part.count, part.of))).collect();
    assert_eq!(detected, [None, Some((0, 4)), None, Some((4, 4))]);
    assert!(results.conditions.iter().all(|condition| condition.lost.is_empty()));
    let altitude = |number: usize| results.conditions[number].measures[0].unwrap();
    assert!(altitude(3).median < 0.05, "{:?}", altitude(3));
    let difference = results.conditions[3].differences[0].unwrap();
    assert_eq!((difference.baseline, difference.pairs), (2, 4));

    // THEN the report is one file, with a dot for each flight that leads to it
    let page = std::fs::read_to_string(report::write(&experiment, "http://127.0.0.1:4747").unwrap()).unwrap();
    for index in 0..FLIGHTS {
        let link = format!("http://127.0.0.1:4747/api/v1/experiments/{}/flights/{index}/open", experiment.id);
        assert!(page.contains(&link), "{link}");
    }
    assert!(page.contains("A &lt;bias&gt; on one height") && !page.contains("<script") && !page.contains("src="));
    // THEN a flight is flown again, the same bit for bit, into a file that readers of recordings open
    // and on three quarters of the stack that a thread has, which an estimator is made on before it is on the heap.
    let opened = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(3 << 19);
        thread.spawn_scoped(scope, || open::open(&experiment, 7)).unwrap().join()
    });
    let file = opened.unwrap().unwrap();
    let recording = plumbline_agent::recordings::open(&file).unwrap();
    assert!(recording.info().ticks > 2000, "{:?}", recording.info());
    assert!(recording.info().scenario.as_deref().unwrap().contains("seed = 41"), "{:?}", recording.info().scenario);
    assert!(matches!(open::open(&experiment, FLIGHTS), Err(open::OpenError::Unknown { .. })));
    // A row that is not what the flight comes to is told.
    let path = experiment.folder.join("flights.rows");
    let mut other = rows(&experiment);
    other[7].values[0] += 1e-9;
    std::fs::write(&path, other.iter().flat_map(Row::encode).collect::<Vec<u8>>()).unwrap();
    assert!(matches!(open::open(&experiment, 7), Err(open::OpenError::Otherwise(7))));
}

/// GIVEN a height biased with lanes in the loop, and with an EKF WHEN both are flown THEN what the model expects stands beside the first,
/// and why it is not known beside the second.
#[test]
fn what_the_model_expects_stands_beside_what_is_flown() {
    let folder = tempfile::tempdir().unwrap();
    let plan = PLAN.replace("\"secure\"", "\"lanes\"").replace("repeats = 4", "repeats = 2");
    let experiment = Experiment::create(folder.path(), Plan::from_toml(&plan).unwrap()).unwrap();
    flown(&experiment);
    let results = summary::results(&experiment).unwrap();
    let says: Vec<_> = results.conditions.iter().map(plumbline_rest::experiment::Condition::beside).collect();
    let unknown = "expected: not known, the model has lanes in the loop, not ekf_bias";
    let [None, Some(ekf), None, Some(lanes)] = &says[..] else { panic!("{says:?}") };
    assert_eq!((ekf.as_str(), lanes.as_str()), (unknown, "expected 1.00, flown 1.00 (0.34 to 1.00)"));
    let page = report::page(&experiment, "").unwrap();
    assert!(page.contains(lanes) && page.contains(unknown) && page.contains("<td class=n>1.00</td>"), "{page}");
    // GIVEN what another version expected of it, and the file of one that knew no expectation
    let path = experiment.folder.join("expected.json");
    std::fs::write(&path, r#"{"3":{"probability":0.2}}"#).unwrap();
    let differs = summary::results(&experiment).unwrap().conditions[3].beside().unwrap();
    assert_eq!(differs, "expected 0.20, flown 1.00 (0.34 to 1.00): differs by more than the interval");
    std::fs::remove_file(path).unwrap();
    assert!(summary::results(&experiment).unwrap().conditions.iter().all(|condition| condition.expected.is_none()));
}

#[test]
fn what_changed_between_two_experiments_is_what_was_changed() {
    let folder = tempfile::tempdir().unwrap();
    let first = made(folder.path());
    flown(&first);
    // GIVEN the same plan with a bias that passes the gates WHEN both are compared
    let smaller = PLAN.replace("magnitude = 1.0", "magnitude = 0.1");
    let second = Experiment::create(folder.path(), Plan::from_toml(&smaller).unwrap()).unwrap();
    flown(&second);
    let compared = compare::compare(&first, &second).unwrap();
    // THEN the plans differ in that, flights without the attack are the same, and those with it are not
    assert_eq!(compared.plans, [("attack.magnitude".into(), "1.0".into(), "0.1".into())]);
    assert_eq!((compared.programs, compared.alone), (false, [0, 0]));
    let same: Vec<_> = compared.conditions.iter().map(|pair| (pair.pairs, pair.same, pair.detected)).collect();
    assert_eq!(same, [(4, 4, None), (4, 0, Some([0, 0])), (4, 4, None), (4, 0, Some([4, 4]))]);
    let altitude = |condition: usize| compared.conditions[condition].measures[0].unwrap();
    assert_eq!(altitude(0).difference.median, 0.0);
    // An EKF alone rejects 1 m and follows 0.1 m.
    assert!(altitude(1).medians[1] > 3.0 * altitude(1).medians[0], "{:?}", altitude(1));
    assert!(altitude(1).difference.median > 0.0, "{:?}", altitude(1));
    // Four pairs have no interval, and nothing of them is in bold.
    assert_eq!(altitude(1).difference.interval, None);
    let page = report::compare(&first, &second, "").unwrap();
    assert!(page.contains("the same program, another plan: 8 of 16 flights"), "{page}");
    assert!(!page.contains("went another way") && !page.contains("<script"));
    assert!(page.contains("<small>no interval, d ") && !page.contains("<br><b>"), "{page}");

    // GIVEN what a version flew that had one measure fewer THEN the others are compared
    let older =
        Experiment::create(folder.path(), Plan::from_toml(&format!("{PLAN}# older\n[stop]\nminutes = 9\n")).unwrap());
    let older = older.unwrap();
    let shorter = |row: &Row| {
        let mut bytes = row.encode()[..4 + 8 * 15].to_vec();
        bytes.extend(&row.encode()[ROW_BYTES - 20..ROW_BYTES - 4]);
        bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
        bytes
    };
    std::fs::write(older.folder.join("flights.rows"), rows(&first).iter().flat_map(shorter).collect::<Vec<u8>>())
        .unwrap();
    let path = older.folder.join("identity.json");
    let mut identity: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for key in ["measures", "draw"] {
        assert!(identity.as_object_mut().unwrap().remove(key).is_some(), "{key}");
    }
    identity["program"] = "0.0.9".into();
    std::fs::write(&path, identity.to_string()).unwrap();
    let older = Experiment::open(folder.path(), &older.id).unwrap();
    assert_eq!(older.done(), FLIGHTS);
    // What was drawn then is not drawn as it is now.
    let kept = Experiment::open(folder.path(), &first.id).unwrap();
    assert_eq!((older.plan.draw, kept.plan.draw), (Draw::Joined, Draw::Derived));
    let compared = compare::compare(&older, &first).unwrap();
    assert!(
        compared.programs && compared.conditions.iter().all(|pair| (pair.pairs, pair.same) == (4, 4)),
        "{compared:?}"
    );
    assert!(compared.conditions[0].measures[0].is_some() && compared.conditions[0].measures[15].is_none());
}

#[test]
fn errors_over_time_are_those_of_the_same_flights() {
    let folder = tempfile::tempdir().unwrap();
    // An EKF alone follows a bias that passes its gates.
    let plan = Plan::from_toml(&PLAN.replace("magnitude = 1.0", "magnitude = 0.1")).unwrap();
    let experiment = Experiment::create(folder.path(), plan).unwrap();
    flown(&experiment);
    assert!(!report::page(&experiment, "").unwrap().contains("Error over time"));
    let table = trace::write(&experiment, 2).unwrap();
    assert!(std::fs::read(table).unwrap().starts_with(b"PAR1"));
    let bands = trace::bands(&experiment).unwrap();
    assert_eq!((bands.repeats, bands.bands.len()), (2, 4));
    // The onset is 13 s after boot. Before it nothing differs; after it only the EKF alone is led astray.
    let error_m = |condition: usize, from_s: f64, to_s: f64| {
        let band = &bands.bands[condition];
        let within = band.t_s.iter().zip(&band.quartiles).filter(|(t_s, _)| (from_s..to_s).contains(*t_s));
        within.map(|(_, [_, median, _])| *median).fold(0.0, f64::max)
    };
    assert!(bands.bands.iter().all(|band| (band.t_s[0] + 13.0).abs() < 0.06), "{:?}", bands.bands[0].t_s[0]);
    assert_eq!(error_m(0, -13.0, 0.0), error_m(1, -13.0, 0.0));
    assert!(error_m(1, 0.0, 5.0) > 2.0 * error_m(0, 0.0, 5.0), "{} {}", error_m(1, 0.0, 5.0), error_m(0, 0.0, 5.0));
    let page = report::page(&experiment, "").unwrap();
    assert!(page.contains("Error over time") && page.contains("the first 2 flights of each condition"));
    // A curve for each attacked condition, against the one of the same estimator without the attack.
    assert!(page.contains("Receiver operating characteristic"));
    assert_eq!(page.matches("bias: area ").count(), 2, "{page}");
}

#[test]
fn enough_is_enough_and_a_budget_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let text = PLAN.replace("repeats = 4", "repeats = 30").replace("\"ekf_bias\", \"secure\"", "\"ekf_bias\"");
    let plan = |stop: &str| Plan::from_toml(&format!("{text}{stop}")).unwrap();
    // Any interval is narrower than a thousand times the median: ten repeats are enough.
    let experiment = Experiment::create(folder.path(), plan("[stop]\ninterval = 1000.0\n")).unwrap();
    assert_eq!(flown(&experiment), Ended::Complete);
    assert_eq!(experiment.done(), 20);
    let experiment = Experiment::create(folder.path(), plan("[stop]\nminutes = 0.0001\n")).unwrap();
    assert_eq!(flown(&experiment), Ended::Spent);
    assert!(experiment.done() < 30, "{}", experiment.done());
}

/// GIVEN an attack on a sensor of any kind WHEN somebody who knows stands before the estimator THEN it receives nothing of it meanwhile;
/// GIVEN one on a rotor THEN the motor is told it, whoever stands there.
#[test]
fn attacks_are_flown_whatever_stands_before_the_estimator() {
    let flown = |reception: &str, sensor: &str, magnitude: &str, watch: &mut dyn FnMut(f64, &Flight)| {
        let text = PLAN
            .replace("repeats = 4", &format!("reception = \"{reception}\""))
            .replace("\"ekf_bias\", \"secure\"", "\"ekf_bias\"")
            .replace("[scenario]", "[scenario]\nsuite = { preset = \"string_rig\", add = [\"mocap_pose\"] }")
            .replace("sensor = \"height\"", &format!("sensor = \"{sensor}\""))
            .replace("magnitude = 1.0", &format!("magnitude = {magnitude}"));
        let setup = Plan::from_toml(&text).unwrap().condition(1).unwrap().setup(40);
        fly_watched(&setup, |flight, truth| watch(truth.time.as_seconds(), flight)).unwrap();
    };
    let (mut before, mut meanwhile) = (0, 0);
    flown("oracle", "mocap_pose", "0.5", &mut |t_s, flight| {
        let received = u32::from(flight.report().received.mocap_pose.is_some());
        // A tick beside the onset is neither.
        before += if t_s < 12.9 { received } else { 0 };
        meanwhile += if t_s > 13.1 { received } else { 0 };
    });
    assert!(before > 10 && meanwhile == 0, "{before} before, {meanwhile} meanwhile");
    for reception in ["all", "oracle", "median", "chi_square", "ekf_per_imu"] {
        let mut told = false;
        flown(reception, "rotor", "-0.1", &mut |t_s, flight| {
            let report = flight.report();
            told |= t_s > 13.0 && report.command.throttle != report.commanded.throttle;
        });
        assert!(told, "{reception}");
    }
}

#[test]
fn flights_are_kept_where_their_ticks_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let text = PLAN.replace("\"ekf_bias\", \"secure\"", "\"ekf_bias\"").replace("repeats = 4", "repeats = 2");
    let experiment = Experiment::create(folder.path(), Plan::from_toml(&text).unwrap()).unwrap();
    std::fs::create_dir(experiment.folder.join("ticks.json")).unwrap();
    let ended = run(&experiment, &Options::default(), &AtomicBool::new(false), |progress, _| {
        // Until the disk is asked again.
        std::thread::sleep(Duration::from_millis(if progress.done == 1 { 2100 } else { 0 }));
    });
    assert!(matches!(&ended, Err(StoreError::Io { path, .. }) if path.ends_with("ticks.json")), "{ended:?}");
    assert_eq!(experiment.done(), 4);
}

#[test]
fn what_another_program_began_is_not_gone_on_with_and_damage_is_flown_again() {
    let folder = tempfile::tempdir().unwrap();
    let text = PLAN.replace("repeats = 4", "repeats = 1").replace("\"ekf_bias\", \"secure\"", "\"ekf_bias\"");
    let experiment = Experiment::create(folder.path(), Plan::from_toml(&text).unwrap()).unwrap();
    flown(&experiment);
    let before = rows(&experiment);
    // GIVEN a row in the middle that a disk has spoilt
    let path = experiment.folder.join("flights.rows");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[5] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(rows(&experiment).len(), before.len() - 1);
    flown(&experiment);
    assert!(rows(&experiment) == before);
    // GIVEN an identity of another program
    let path = experiment.folder.join("identity.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace(&experiment.identity.hash, "0123")).unwrap();
    let foreign = Experiment::open(folder.path(), &experiment.id).unwrap();
    assert!(matches!(foreign.hold(), Err(StoreError::Foreign { .. })));
    assert!(matches!(Experiment::open(folder.path(), "../small"), Err(StoreError::Unknown(_))));
}

/// What DuckDB and Polars read of `flights.parquet`, one JSON line.
const READS: &str = "
import sys, json, duckdb, polars
name = sys.argv[1]
by = duckdb.sql(f\"\"\"select \\\"attack.kind\\\", count(*), count(delay_s), median(altitude_m), sum(seed)
    from '{name}' group by 1 order by 1\"\"\").fetchall()
frame = polars.read_parquet(name)
print(json.dumps([by, frame.height, frame.width, frame['index'].to_list(), frame['altitude_m'].sum(),
    frame['lateral_m'].null_count(), frame['agent.estimators.in_loop'].unique().sort().to_list()]))
";

#[test]
fn duckdb_and_polars_read_the_table() {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import duckdb, polars"]).output();
    if !has.is_ok_and(|ran| ran.status.success()) {
        plumbline_agent::recordings::skipped("no Python with duckdb and polars");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let experiment = made(folder.path());
    flown(&experiment);
    let table = parquet::export(&experiment).unwrap();
    let ran = Command::new(&python).args(["-c", READS]).arg(&table).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let read: serde_json::Value = serde_json::from_slice(&ran.stdout).unwrap();
    let rows = rows(&experiment);
    let of = |kind: u64, value: &str| -> Vec<f64> {
        rows.iter().filter(|row| u64::from(row.index) % 2 == kind).map(|row| row.value(value)).collect()
    };
    let median = plumbline_experiment::draw::median;
    assert_eq!(read[0][0][0], "bias");
    assert_eq!((read[0][0][1].as_u64(), read[0][0][2].as_u64(), read[0][0][4].as_u64()), (Some(8), Some(4), Some(332)));
    assert_eq!(read[0][0][3].as_f64(), Some(median(&of(1, "altitude_m"))));
    assert_eq!(read[0][1][3].as_f64(), Some(median(&of(0, "altitude_m"))));
    assert_eq!((read[1].as_u64(), read[2].as_u64()), (Some(FLIGHTS), Some(4 + 2 + 1 + 22)));
    assert_eq!(read[3], serde_json::json!((0..FLIGHTS).collect::<Vec<_>>()));
    let sum: f64 = rows.iter().map(|row| row.value("altitude_m")).sum();
    assert!((read[4].as_f64().unwrap() / sum - 1.0).abs() < 1e-12);
    // Nothing was held horizontally: null, not NaN.
    assert_eq!(read[5].as_u64(), Some(FLIGHTS));
    assert_eq!(read[6], serde_json::json!(["ekf_bias", "secure"]));
}

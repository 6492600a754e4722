//! Plans flown, killed, resumed, reported and opened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::{ROW_BYTES, Row};
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::{Experiment, StoreError};
use plumbline_experiment::{open, parquet, report, summary};

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

    let root = folder.path().join("killed");
    let killed = made(&root);
    let mut kills = 0;
    for round in 0_u64.. {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "flies_until_it_is_killed", "--ignored", "--nocapture"])
            .env("PLUMBLINE_EXPERIMENT_ROOT", &root)
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
            bytes.extend_from_slice(&expected[0].encode()[..ROW_BYTES / 2]);
            std::fs::write(&path, bytes).unwrap();
        }
        if killed.done() == FLIGHTS {
            break;
        }
        assert!(round < 50, "{} of {FLIGHTS} after {round} rounds", killed.done());
    }
    assert!(kills >= 2, "{kills} kills");
    assert_eq!(flown(&killed), Ended::Complete);
    assert!(rows(&killed) == expected, "a row differs");
    // Nothing was flown twice: the file holds each row once.
    assert_eq!(std::fs::metadata(killed.folder.join("flights.rows")).unwrap().len(), FLIGHTS * ROW_BYTES as u64);
    let table = |experiment: &Experiment| std::fs::read(parquet::export(experiment).unwrap()).unwrap();
    assert!(table(&killed) == table(&undisturbed), "the tables differ");
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
    let file = open::open(&experiment, 7).unwrap();
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
    assert_eq!((read[1].as_u64(), read[2].as_u64()), (Some(FLIGHTS), Some(4 + 2 + 1 + 15)));
    assert_eq!(read[3], serde_json::json!((0..FLIGHTS).collect::<Vec<_>>()));
    let sum: f64 = rows.iter().map(|row| row.value("altitude_m")).sum();
    assert!((read[4].as_f64().unwrap() / sum - 1.0).abs() < 1e-12);
    // Nothing was held horizontally: null, not NaN.
    assert_eq!(read[5].as_u64(), Some(FLIGHTS));
    assert_eq!(read[6], serde_json::json!(["ekf_bias", "secure"]));
}

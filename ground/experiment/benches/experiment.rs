//! Experiments: flight-seconds a second on one core for each estimator, bytes kept of a flight, how soon a plan of 100 000
//! flights begins and how soon a page of its results is read. Prints JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write as _;
use std::time::Instant;

use plumbline_experiment::flight::fly;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::ROW_BYTES;
use plumbline_experiment::store::Experiment;
use plumbline_experiment::{parquet, summary};
use plumbline_support::memory_mib;
use serde_json::json;

/// Flight-seconds a second on one core with the secure estimator.
const SPEED_LIMIT: f64 = 150.0;
const BYTES_LIMIT: f64 = 1000.0;
const BEGIN_LIMIT_S: f64 = 1.0;
const OPEN_LIMIT_S: f64 = 1.0;
/// Flights timed of each estimator.
const FLIGHTS: u64 = 4;

const PLAN: &str = r#"
name = "bench"
repeats = 2500
[scenario]
world = "datasheet"
duration_s = 30
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 }, { at_s = 18, do = "setpoint", altitude_m = 1.2 },
]
[attack]
sensor = "height"
kind = "bias"
[[factor]]
key = "agent.estimators.in_loop"
values = ESTIMATORS
[[factor]]
key = "attack.magnitude"
values = SIZES
"#;
const SIZES: &str =
    "[0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0]";

fn of(estimators: &str, sizes: &str) -> String {
    PLAN.replace("ESTIMATORS", estimators).replace("SIZES", sizes)
}

fn line(name: &str, value: f64, unit: &str, limit: Option<f64>) {
    println!("{}", json!({ "bench": "experiment", "name": name, "value": value, "unit": unit, "limit": limit }));
}

fn main() {
    for name in ["ekf_bias", "secure", "lanes"] {
        let text = of(&format!("[{name:?}]"), SIZES);
        let Ok(plan) = Plan::from_toml(&text) else { continue };
        let begun = Instant::now();
        let mut cpu_s = 0.0;
        for index in 0..FLIGHTS {
            let (condition, repeat) = plan.place(index);
            let setup = plan.condition(condition).unwrap().setup(plan.seed_of(repeat));
            let before = thread_s();
            let outcome = fly(&setup).unwrap();
            cpu_s += thread_s() - before;
            assert_eq!(outcome.lost, None);
        }
        let wall_s = begun.elapsed().as_secs_f64();
        let limit = (name == "secure").then_some(SPEED_LIMIT);
        let flown_s = 30.0 * FLIGHTS as f64;
        line(&format!("flight_s_per_cpu_s/{name}"), flown_s / cpu_s, "1", limit);
        line(&format!("flight_s_per_wall_s/{name}"), flown_s / wall_s, "1", None);
    }
    whole();
    large();
}

/// A thousand flights of 30 s, three estimators in turn, on all cores: how fast, and what the process holds meanwhile.
fn whole() {
    let folder = tempfile::tempdir().unwrap();
    // 3 estimators × 4 sizes × 84.
    let text =
        of("[\"ekf_bias\", \"secure\", \"lanes\"]", "[0.01, 0.05, 0.2, 1.0]").replace("repeats = 2500", "repeats = 84");
    let plan = Plan::from_toml(&text).unwrap();
    let experiment = Experiment::create(folder.path(), plan).unwrap();
    let options = plumbline_experiment::run::Options::default();
    let stop = std::sync::atomic::AtomicBool::new(false);
    let (begun, mut held) = (Instant::now(), Vec::new());
    let flights = experiment.plan.flights();
    plumbline_experiment::run::run(&experiment, &options, &stop, |progress, _| {
        if progress.done % (flights / 10) == 0 {
            held.push(memory_mib(std::process::id(), "VmRSS") * f64::from(1 << 20));
        }
    })
    .unwrap();
    let took_s = begun.elapsed().as_secs_f64();
    let flown_s = 30.0 * flights as f64;
    line("whole/flights", flights as f64, "1", None);
    line("whole/flight_s_per_s", flown_s / took_s, "1", None);
    line("whole/flight_s_per_s_and_core", flown_s / took_s / options.threads as f64, "1", Some(SPEED_LIMIT));
    line("whole/resident_after_a_tenth", held[0], "B", None);
    line("whole/resident_at_the_end", held[held.len() - 1], "B", None);
    line("whole/growth", held[held.len() - 1] / held[0] - 1.0, "1", None);
    let kept: u64 =
        std::fs::read_dir(&experiment.folder).unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    line("whole/kept_per_flight", kept as f64 / flights as f64, "B", Some(BYTES_LIMIT));
    // A dot of the report: flown again from its seed into a flight file.
    let mut opened_s: Vec<f64> = (0..flights)
        .step_by(flights as usize / 9)
        .map(|index| {
            let begun = Instant::now();
            plumbline_experiment::open::open(&experiment, index).unwrap();
            begun.elapsed().as_secs_f64()
        })
        .collect();
    opened_s.sort_by(f64::total_cmp);
    line("open/median", opened_s[opened_s.len() / 2], "s", Some(OPEN_LIMIT_S));
    line("open/most", opened_s[opened_s.len() - 1], "s", Some(OPEN_LIMIT_S));
}

/// 100 000 flights: reading and trying the plan, making its folder, the first flights that are missing; then its results.
fn large() {
    let folder = tempfile::tempdir().unwrap();
    let text = of("[\"ekf_bias\", \"secure\"]", SIZES);
    let begun = thread_s();
    let plan = Plan::from_toml(&text).unwrap();
    assert_eq!(plan.flights(), 100_000);
    let experiment = Experiment::create(folder.path(), plan).unwrap();
    let stop = std::sync::atomic::AtomicBool::new(true);
    let options = plumbline_experiment::run::Options::default();
    plumbline_experiment::run::run(&experiment, &options, &stop, |_, _| {}).unwrap();
    line("begin_100000", thread_s() - begun, "cpu s", Some(BEGIN_LIMIT_S));
    line("bytes_per_flight", ROW_BYTES as f64, "B", Some(BYTES_LIMIT));

    let condition = experiment.plan.condition(0).unwrap();
    let (mut row, _) = plumbline_experiment::run::flown(&experiment.plan, &Ok(condition), 0).unwrap();
    let mut bytes = std::io::BufWriter::new(std::fs::File::create(experiment.folder.join("flights.rows")).unwrap());
    for index in 0..100_000 {
        row.index = index;
        bytes.write_all(&row.encode()).unwrap();
    }
    bytes.flush().unwrap();
    let begun = thread_s();
    assert_eq!(summary::flights(&experiment, 99_000, 100, None).unwrap().flights.len(), 100);
    line("page_of_100000", thread_s() - begun, "cpu s", None);
    let begun = thread_s();
    assert_eq!(summary::results(&experiment).unwrap().conditions.len(), 40);
    line("statistics_of_100000", thread_s() - begun, "cpu s", None);
    let begun = thread_s();
    let table = parquet::export(&experiment).unwrap();
    line("parquet_of_100000", thread_s() - begun, "cpu s", None);
    line("parquet_bytes_per_flight", std::fs::metadata(table).unwrap().len() as f64 / 1e5, "B", None);
}

/// Time that this thread has had a processor, s: others that run beside it do not count.
fn thread_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

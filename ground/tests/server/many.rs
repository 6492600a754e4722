//! Experiments on many machines: NATS server, workers, lead and storage are processes of their own, and all of them are killed.
//!
//! `nats-server` and moto (Python) are started where they are installed; what is skipped is said.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crate::common::servers::{Bucket, Nats, PATIENCE, Process, drawn};
use plumbline_experiment::part::Part;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::Row;
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::Experiment;
use plumbline_ground::many::{Job, ManyError, Poisoned, Shards, jobs, lead, poison, worker};

/// 2 conditions × 30 repeats.
const PLAN: &str = r#"
name = "many"
repeats = 30
seed = 40
[scenario]
duration_s = 14
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 },
]
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
"#;
const FLIGHTS: u64 = 60;
/// Flights of a job.
const SIZE: u64 = 4;
/// Kills of a campaign's rounds; a few of them in a test.
const ROUNDS: &str = "PLUMBLINE_ROUNDS";

fn ground() -> Command {
    Command::new(env!("CARGO_BIN_EXE_plumbline-ground"))
}

fn a_worker(nats: &Nats, store: &str) -> Process {
    Process::start(ground().args(["worker", "--threads", "1", "--nats", &nats.url(), "--store", store]))
}

fn a_lead(nats: &Nats, store: &str, plan: &Path, data: &Path) -> Process {
    let mut command = ground();
    command
        .args(["experiment", "spread"])
        .arg(plan)
        .args(["--nats", &nats.url(), "--store", store, "--data"])
        .arg(data);
    Process::start(command.args(["--size", &SIZE.to_string()]))
}

fn made(data: &Path) -> Experiment {
    Experiment::create(&Experiment::root(data), Plan::from_toml(PLAN).unwrap()).unwrap()
}

/// Flown by one process that nobody disturbs, once for all tests.
fn undisturbed() -> &'static [Row] {
    static ROWS: OnceLock<Vec<Row>> = OnceLock::new();
    ROWS.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let experiment = made(folder.path());
        let ended = run(&experiment, &Options::default(), &AtomicBool::new(false), |_, _| {}).unwrap();
        assert_eq!(ended, Ended::Complete);
        experiment.rows().unwrap()
    })
}

fn each_once(experiment: &Experiment, expected: &[Row]) {
    assert!(experiment.rows().unwrap() == expected, "a row differs");
    assert_eq!(experiment.done(), FLIGHTS, "a flight is there twice");
}

#[test]
fn workers_server_and_lead_are_killed_and_every_flight_is_there_once_and_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let Some(mut nats) = Nats::start(folder.path()) else { return };
    let rounds: u64 = std::env::var(ROUNDS).map_or(6, |rounds| rounds.parse().unwrap());
    let plan = folder.path().join("plan.toml");
    std::fs::write(&plan, PLAN).unwrap();
    let (mut kills, mut attempts, mut dice) = (0, 0, drawn());
    while kills < rounds {
        // GIVEN a lead and two workers WHEN one of all is killed every few flights THEN it ends whole
        attempts += 1;
        let data = folder.path().join(format!("data-{attempts}"));
        let shards = folder.path().join(format!("shards-{attempts}"));
        let store = shards.to_str().unwrap().to_owned();
        let experiment = made(&data);
        let mut workers = [a_worker(&nats, &store), a_worker(&nats, &store)];
        let mut lead = a_lead(&nats, &store, &plan, &data);
        let (begun, mut before) = (Instant::now(), 0);
        while experiment.done() < FLIGHTS {
            assert!(begun.elapsed() < PATIENCE, "{} flights after {kills} kills", experiment.done());
            std::thread::sleep(Duration::from_millis(30 + (170.0 * dice.uniform()) as u64));
            // Whoever ended of itself, because nobody answered, is started again as whoever was killed.
            if lead.0.try_wait().unwrap().is_some() && experiment.done() < FLIGHTS {
                lead = a_lead(&nats, &store, &plan, &data);
            }
            for worker in &mut workers {
                if worker.0.try_wait().unwrap().is_some() {
                    *worker = a_worker(&nats, &store);
                }
            }
            let there = std::fs::read_dir(shards.join(&experiment.id)).map_or(0, Iterator::count);
            if there == before || kills == rounds {
                continue;
            }
            before = there;
            match (4.0 * dice.uniform()) as u64 {
                0 => workers[0].kill(),
                1 => nats.kill_and_start_again(),
                2 => lead.kill(),
                _ => workers[1].kill(),
            }
            kills += 1;
        }
        drop((lead, workers));
        each_once(&experiment, undisturbed());
    }
    println!("{kills} kills over {attempts} experiments of {FLIGHTS} flights");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_cannot_be_flown_is_set_aside_with_its_error_and_the_lead_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let Some(nats) = Nats::start(folder.path()) else { return };
    let store = folder.path().join("shards");
    let open = || Shards::open(store.to_str().unwrap()).unwrap();
    let client = async_nats::connect(nats.url()).await.unwrap();
    let context = async_nats::jetstream::new(client);
    let stop = Arc::new(AtomicBool::new(false));
    let working = worker::Working { threads: 1, idle: None };
    let (url, asked, shards) = (nats.url(), stop.clone(), open());
    let works = tokio::spawn(async move { worker::work(&url, shards, working, asked).await });
    // GIVEN what is no job, and a job of another program WHEN a worker takes them THEN it goes on, and they lie aside
    let plan = Plan::from_toml(PLAN).unwrap();
    let job = |hash: &str, first| Job { hash: hash.into(), plan: PLAN.into(), part: Part { first, count: 2 } };
    let hash = plan.hash();
    let payloads = [
        b"no job".to_vec(),
        serde_json::to_vec(&job("0123", 0)).unwrap(),
        serde_json::to_vec(&job(&hash, FLIGHTS - 1)).unwrap(),
        serde_json::to_vec(&job(&hash, 2)).unwrap(),
    ];
    for payload in payloads {
        loop {
            // The streams are the worker's to make.
            let sent = context.publish(jobs(), payload.clone().into()).await.unwrap();
            if sent.await.is_ok() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
    let shards = open();
    let begun = Instant::now();
    while !shards.has(&Experiment::id_of(&plan), Part { first: 2, count: 2 }).await.unwrap() {
        assert!(begun.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let stream = context.get_stream("PLUMBLINE_POISON").await.unwrap();
    let mut errors = Vec::new();
    for sequence in 1..=3 {
        let message = stream.get_raw_message(sequence).await.unwrap();
        errors.push(serde_json::from_slice::<Poisoned>(&message.payload).unwrap().error);
    }
    assert!(errors[0].starts_with("no job: ") && errors[1].starts_with("hash 0123 is not"), "{errors:?}");
    assert!(errors[2].contains("flights 59 and 2 after it are not of the 60"), "{errors:?}");
    stop.store(true, Ordering::Relaxed);
    works.await.unwrap().unwrap();

    // GIVEN a lead whose every job was set aside THEN it ends, and says what the first one's worker said
    let experiment = made(&folder.path().join("data"));
    let (id, url, shards) = (experiment.id.clone(), nats.url(), open());
    let leads =
        tokio::spawn(
            async move { lead::spread(&experiment, &url, &shards, 30, &AtomicBool::new(false), |_| {}).await },
        );
    tokio::time::sleep(Duration::from_secs(2)).await;
    // More of them than are read at a time: the last one counts as well.
    for first in std::iter::repeat_n(0, 120).chain([30]) {
        let job = Job { part: Part { first, count: 30 }, ..job(&hash, 0) };
        let poisoned = Poisoned { job: serde_json::to_string(&job).unwrap(), error: format!("because of {first}") };
        let payload = serde_json::to_vec(&poisoned).unwrap();
        context.publish(poison(&id), payload.into()).await.unwrap().await.unwrap();
    }
    match leads.await.unwrap() {
        Err(ManyError::Poisoned { jobs: 2, missing: 58, first }) => assert_eq!(first, "because of 0"),
        other => panic!("{other:?}"),
    }
    let stops = Plan::from_toml(&format!("{PLAN}[stop]\nminutes = 1\n")).unwrap();
    let experiment = Experiment::create(folder.path(), stops).unwrap();
    let led = lead::spread(&experiment, &nats.url(), &open(), 30, &AtomicBool::new(false), |_| {}).await;
    assert!(matches!(led, Err(ManyError::Stops)));
}

#[test]
fn an_array_without_a_queue_is_gathered() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, store) = (folder.path().join("plan.toml"), folder.path().join("shards"));
    std::fs::write(&plan, PLAN).unwrap();
    let part = |nth: &str| {
        let mut command = ground();
        command.args(["experiment", "part"]).arg(&plan).args(["--part", nth, "--size", "7", "--store"]).arg(&store);
        command.output().unwrap()
    };
    let gather = || {
        let data = folder.path().join("data");
        let mut command = ground();
        command.args(["experiment", "gather"]).arg(&plan).arg("--store").arg(&store).arg("--data").arg(&data);
        let ran = command.output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        made(&data)
    };
    assert!(part("1/2").status.success());
    assert_eq!(gather().done(), 4 * 7 + 4, "jobs 1, 3, 5, 7 and the short one of nine");
    // A shard that a disk has spoilt is flown again.
    let spoilt = store.join(Experiment::id_of(&Plan::from_toml(PLAN).unwrap())).join("0000007-7.rows");
    assert!(part("2/2").status.success());
    let bytes = std::fs::read(&spoilt).unwrap();
    std::fs::write(&spoilt, &bytes[..210]).unwrap();
    assert_eq!(gather().done(), FLIGHTS - 7);
    assert!(!spoilt.exists() && part("2/2").status.success());
    each_once(&gather(), undisturbed());
    let refused = part("3/2");
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("3/2 is not K/N"), "{said}");
}

/// GIVEN workers and a lead whose clocks are years apart THEN every flight is there once and the same: nobody compares clocks.
#[test]
fn clocks_of_workers_that_are_years_apart_change_nothing() {
    let Some(library) = std::env::var_os("PLUMBLINE_FAKETIME") else {
        plumbline_agent::recordings::skipped("no libfaketime (a Debian package)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let Some(nats) = Nats::start(folder.path()) else { return };
    let (plan, data, store) =
        (folder.path().join("plan.toml"), folder.path().join("data"), folder.path().join("shards"));
    std::fs::write(&plan, PLAN).unwrap();
    let experiment = made(&data);
    let at = |mut command: Command, offset: &str| {
        command.env("LD_PRELOAD", &library).env("FAKETIME", offset).env("DONT_FAKE_MONOTONIC", "1");
        command
    };
    let mut told = at(Command::new("date"), "+2y");
    let year = |text: Vec<u8>| String::from_utf8(text).unwrap().trim().parse::<u32>().unwrap();
    let years = [told.arg("+%Y").output().unwrap(), Command::new("date").arg("+%Y").output().unwrap()];
    let [faked, true_year] = years.map(|ran| year(ran.stdout));
    assert_eq!(faked, true_year + 2, "clocks are really changed");
    let worker = |offset: &str| {
        let mut command = at(ground(), offset);
        Process::start(command.args(["worker", "--threads", "1", "--nats", &nats.url(), "--store"]).arg(&store))
    };
    let _workers = [worker("+2y"), worker("-3y")];
    let mut lead = at(ground(), "-40m");
    lead.args(["experiment", "spread"]).arg(&plan).args(["--nats", &nats.url(), "--size", "4", "--store"]).arg(&store);
    let ran = lead.arg("--data").arg(&data).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    each_once(&experiment, undisturbed());
}

#[test]
fn shards_lie_in_a_bucket_and_one_that_is_gone_costs_nothing_that_was_flown() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(nats), Some(storage)) = (Nats::start(folder.path()), Bucket::start("shards")) else { return };
    let (plan, data) = (folder.path().join("plan.toml"), folder.path().join("data"));
    std::fs::write(&plan, PLAN).unwrap();
    let experiment = made(&data);
    // GIVEN a worker whose bucket is not there yet
    let mut working = ground();
    working.envs(storage.settings()).args([
        "worker",
        "--threads",
        "1",
        "--nats",
        &nats.url(),
        "--store",
        "s3://shards/of/tests",
    ]);
    let _worker = Process::start(&mut working);
    let mut leading = ground();
    leading.args(["experiment", "spread"]).arg(&plan).args(["--nats", &nats.url(), "--store", "s3://shards/of/tests"]);
    leading.envs(storage.settings()).args(["--size", "20", "--data"]).arg(&data);
    // Without the bucket a lead says so and ends.
    let refused = leading.output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("storage s3://shards/of/tests"), "{said}");
    storage.make();
    let mut lead = Process::start(&mut leading);
    let wait_for = |flights: u64| {
        let begun = Instant::now();
        while experiment.done() < flights {
            assert!(begun.elapsed() < PATIENCE, "{} flights", experiment.done());
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    // WHEN the bucket goes after the first shard was gathered, and comes back empty
    wait_for(20);
    lead.kill();
    storage.delete();
    std::thread::sleep(Duration::from_secs(3));
    storage.make();
    let _lead = Process::start(&mut leading);
    // THEN all is there once
    wait_for(FLIGHTS);
    each_once(&experiment, undisturbed());
}

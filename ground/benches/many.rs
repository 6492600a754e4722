//! Experiments on many machines: how much sooner two and four workers on this machine end, what a job costs beside its flights,
//! and what 64 workers would wait for first. Prints JSON lines; `nats-server` is started by it.
//!
//! | symbol | what | from |
//! |---|---|---|
//! | c | a job beside its flights, s of its worker | whole runs: jobs of one flight less jobs of fifty |
//! | g | taking one shard into the experiment, s of the lead | gathering shards that are there |
//! | l | naming one shard that is there, once a second, s of the lead | naming them all |
//!
//! The 64 workers are simulated job by job: each flies for its job's flights and c; the lead looks once a second, names every
//! shard that is there and takes those that are new.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use plumbline_experiment::part::Part;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::Experiment;
use plumbline_ground::many::{Shards, lead};
use serde_json::json;

const FLIGHTS: u64 = 200;
const SIZES: [u64; 2] = [1, 50];
const WORKERS: [usize; 3] = [1, 2, 4];
/// Workers and flights of the calculation.
const CROWD: usize = 64;
const LARGE: u64 = 100_000;

const PLAN: &str = r#"
name = "NAME"
repeats = 200
[scenario]
world = "datasheet"
duration_s = 30
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 }, { at_s = 18, do = "setpoint", altitude_m = 1.2 },
]
[[factor]]
key = "agent.estimators.in_loop"
values = ["lanes"]
"#;

struct Process(Child);

impl Process {
    fn start(command: &mut Command) -> Self {
        Self(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn line(name: &str, value: f64, unit: &str) {
    println!("{}", json!({ "bench": "many", "name": name, "value": value, "unit": unit }));
}

fn plan(name: &str) -> Plan {
    Plan::from_toml(&PLAN.replace("NAME", name)).unwrap()
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let server = std::env::var_os("PLUMBLINE_NATS").unwrap_or_else(|| "nats-server".into());
    let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
    let mut command = Command::new(server);
    command.args(["-js", "-a", "127.0.0.1", "-p", &port.to_string(), "-sd"]).arg(folder.path().join("nats"));
    let _server = Process::start(&mut command);
    let begun = Instant::now();
    while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
        assert!(begun.elapsed() < Duration::from_secs(20), "nats-server does not listen");
        std::thread::sleep(Duration::from_millis(20));
    }
    let url = format!("nats://127.0.0.1:{port}");
    let experiment = Experiment::create(&folder.path().join("alone"), plan("alone")).unwrap();
    let begun = Instant::now();
    let options = Options { threads: 1, ..Options::default() };
    assert_eq!(run(&experiment, &options, &AtomicBool::new(false), |_, _| {}).unwrap(), Ended::Complete);
    let alone_s = begun.elapsed().as_secs_f64();
    let flight_s = alone_s / FLIGHTS as f64;
    line("flight_alone", flight_s, "s");
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut one_worker_s = [0.0; SIZES.len()];
    for (size, one_s) in SIZES.into_iter().zip(&mut one_worker_s) {
        for workers in WORKERS {
            let name = format!("w{workers}s{size}");
            let took_s = runtime.block_on(spread(folder.path(), &name, &url, workers, size));
            if workers == 1 {
                *one_s = took_s;
            }
            line(&format!("{FLIGHTS}_flights/{workers}_workers/jobs_of_{size}"), took_s, "s");
            line(&format!("speed_up/{workers}_workers/jobs_of_{size}"), *one_s / took_s, "1");
        }
    }
    let [single_s, fifty_s] = one_worker_s;
    let fewer = (FLIGHTS - FLIGHTS.div_ceil(SIZES[1])) as f64;
    let job_s = (single_s - fifty_s) / fewer;
    line("job_beside_its_flights", job_s, "s");
    let (take_s, name_s) = runtime.block_on(lead_costs(folder.path()));
    line("lead_takes_a_shard", take_s, "s");
    line("lead_names_a_shard", name_s, "s");
    for size in [1, 10, 50, 500] {
        let (took_s, busy) = crowd(size, flight_s, job_s.max(0.0), take_s, name_s);
        line(&format!("simulated/{CROWD}_workers/jobs_of_{size}/speed_up"), LARGE as f64 * flight_s / took_s, "1");
        line(&format!("simulated/{CROWD}_workers/jobs_of_{size}/lead_busy"), busy, "1");
    }
}

/// A whole experiment over the queue; how long it took from the first job to the last row, s.
async fn spread(folder: &Path, name: &str, url: &str, workers: usize, size: u64) -> f64 {
    let store = folder.join(format!("shards-{name}"));
    let worker = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_plumbline-ground"));
        Process::start(command.args(["worker", "--threads", "1", "--nats", url, "--store"]).arg(&store))
    };
    let _workers: Vec<Process> = (0..workers).map(|_| worker()).collect();
    tokio::time::sleep(Duration::from_secs(1)).await;
    let experiment = Experiment::create(&folder.join(name), plan(name)).unwrap();
    let shards = Shards::open(store.to_str().unwrap()).unwrap();
    let begun = Instant::now();
    let ended = lead::spread(&experiment, url, &shards, size, &AtomicBool::new(false), |_| {}).await.unwrap();
    assert_eq!(ended, Ended::Complete);
    begun.elapsed().as_secs_f64()
}

/// What the lead needs to take one shard, and to name one that is there, s.
async fn lead_costs(folder: &Path) -> (f64, f64) {
    let experiment = Experiment::create(&folder.join("lead"), plan("lead")).unwrap();
    let store = folder.join("shards-lead");
    let shards = Shards::open(store.to_str().unwrap()).unwrap();
    let mut rows = Part { first: 0, count: 1 }.fly(&experiment.plan, || true).unwrap().0;
    let parts: Vec<Part> = Part::all(FLIGHTS, 1).collect();
    for part in &parts {
        rows[0].index = part.first as u32;
        shards.put(&experiment.id, &experiment.plan, *part, &rows).await.unwrap();
    }
    let begun = Instant::now();
    let named = shards.names(&experiment.id).await.unwrap().len();
    let name_s = begun.elapsed().as_secs_f64() / named as f64;
    let begun = Instant::now();
    lead::gather(&experiment, &shards).await.unwrap();
    (begun.elapsed().as_secs_f64() / named as f64 - name_s, name_s)
}

/// [`CROWD`] workers with jobs of `size`: how long [`LARGE`] flights take, s, and which part of it the lead works.
fn crowd(size: u64, flight_s: f64, job_s: f64, take_s: f64, name_s: f64) -> (f64, f64) {
    let jobs = LARGE.div_ceil(size);
    let each_s = size as f64 * flight_s + job_s;
    // Workers are alike, so a job ends every each_s / CROWD once all have begun.
    let ended = |t: f64| ((t / each_s).floor() * CROWD as f64).min(jobs as f64);
    let (mut t, mut taken, mut busy_s) = (0.0, 0.0, 0.0);
    while taken < jobs as f64 {
        t += 1.0;
        let there = ended(t);
        let work_s = name_s * there + take_s * (there - taken);
        (t, busy_s, taken) = (t + work_s, busy_s + work_s, there);
    }
    (t, busy_s / t)
}

//! `cargo xtask bench sse`: the decoders on the reference windows, and the whole tick of decoders and lanes on simulated
//! flights; one thread, one run, JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use plumbline_agent::estimate::Estimator;
use plumbline_agent::estimate::lanes::Lanes;
use plumbline_agent::estimate::secure::{
    Program, compress::Compressed, conic::Conic, newton::Newton, newton::Settings,
};
use plumbline_agent::estimate::secure::{SLOTS, Secure};
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::offline::decode::Windows;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::{EstimatorKind, MotorCommand};
use plumbline_agent::vehicle::Vehicle;
use plumbline_support::counting::{self, Counting};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// CPU time of this thread.
fn cpu_time() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid, exclusively borrowed timespec for the whole call.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    assert_eq!(status, 0, "CLOCK_THREAD_CPUTIME_ID");
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

fn timed(run: impl FnOnce()) -> f64 {
    let begun = cpu_time();
    run();
    (cpu_time() - begun).as_secs_f64() * 1e6
}

/// Times `run` on every window, `rounds` times; microseconds, sorted.
fn measure(windows: &[Vec<f64>], rounds: usize, mut run: impl FnMut(&[f64])) -> Vec<f64> {
    windows.iter().for_each(|w| run(w));
    let mut times: Vec<f64> =
        (0..rounds).flat_map(|_| windows).map(|window| timed(|| run(black_box(window)))).collect();
    times.sort_by(f64::total_cmp);
    times
}

fn at(times: &[f64], q: f64) -> f64 {
    times[((times.len() - 1) as f64 * q) as usize]
}

fn print(name: &str, times: &[f64], ratio: Option<f64>, more: serde_json::Value) {
    let mut line = serde_json::json!({
        "bench": "sse", "name": name, "unit": "us", "value": at(times, 0.5), "median": at(times, 0.5),
        "p99": at(times, 0.99), "samples": times.len(), "ratio_to_newton": ratio,
    });
    if let (Some(line), serde_json::Value::Object(more)) = (line.as_object_mut(), more) {
        line.extend(more);
    }
    println!("{line}");
}

fn skipped(name: &str, reason: &str) {
    println!("{}", serde_json::json!({ "bench": "sse", "name": name, "skipped": reason }));
}

fn main() {
    let root = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join("reference/sse_windows.json");
    match Windows::read(&path) {
        Ok(file) => decoders(&file, &path),
        Err(error) => skipped("decoders", &error.to_string()),
    }
    secure_tick();
    lanes_tick();
}

fn decoders(file: &Windows, path: &Path) {
    let phi = file.matrices::<10>().unwrap();
    let windows: Vec<Vec<f64>> = file.cases.iter().map(|c| c.y.concat()).collect();
    let none = || serde_json::json!({});
    let problem = Compressed::<10>::new(&phi, Program::L2).unwrap();
    // The flying tolerance; the tests use the tighter default.
    let settings = Settings { tolerance: 1e-6, ..Settings::default() };
    let mut newton = Newton::new(&problem, settings);
    let before = counting::requests();
    let times = measure(&windows, 400, |w| {
        black_box(newton.decode(&problem, w, None).unwrap());
    });
    // `measure` itself allocates its list.
    let allocations = counting::requests() - before;
    let median = at(&times, 0.5);
    let per_solve = allocations as f64 / times.len() as f64;
    print(
        "newton l2, cold start",
        &times,
        Some(1.0),
        serde_json::json!({ "allocations_per_solve": per_solve.floor() }),
    );
    let ratio = |times: &[f64]| Some(at(times, 0.5) / median);

    let mut conic = Conic::new(&problem).unwrap();
    let times = measure(&windows, 20, |w| {
        black_box(conic.decode(&problem, w).unwrap());
    });
    print("clarabel l2, compressed cones, update_b", &times, ratio(&times), none());

    let whole = Compressed::<10>::uncompressed(&phi).unwrap();
    let times = measure(&windows, 5, |w| {
        black_box(Conic::new(&whole).unwrap().decode(&whole, w).unwrap());
    });
    print("clarabel l2, naive", &times, ratio(&times), none());

    let problem = Compressed::<10>::new(&phi, Program::L1).unwrap();
    let mut newton = Newton::new(&problem, settings);
    let times = measure(&windows, 40, |w| {
        black_box(newton.decode(&problem, w, None).unwrap());
    });
    print("newton l1, cold start", &times, ratio(&times), none());
    let mut conic = Conic::new(&problem).unwrap();
    let times = measure(&windows, 5, |w| {
        black_box(conic.decode(&problem, w).unwrap());
    });
    print("clarabel l1, update_b", &times, ratio(&times), none());

    match cvxpy(path) {
        Ok(times) => print("python cvxpy l2, parametrised, Clarabel", &times, ratio(&times), none()),
        Err(reason) => skipped("python cvxpy l2", &reason),
    }
}

/// Solves the same windows in cvxpy, with Y a parameter of one problem; process CPU time, µs, sorted.
const CVXPY: &str = "
import json, sys, time
import cvxpy as cp, numpy as np
d = json.load(open(sys.argv[1]))
phi = [np.array(p) for p in d['Phi']]
x = cp.Variable(phi[0].shape[1])
ys = [cp.Parameter(p.shape[0]) for p in phi]
problem = cp.Problem(cp.Minimize(sum(cp.norm(y - p @ x) for y, p in zip(ys, phi))))
times = []
for k in range(2):
    for case in d['cases']:
        for y, value in zip(ys, case['Y']):
            y.value = np.array(value)
        begun = time.process_time()
        problem.solve(solver=cp.CLARABEL)
        if k: times.append((time.process_time() - begun) * 1e6)
print(json.dumps(sorted(times)))
";

/// In a virtual environment of its own under `target/tools`, made on first use.
fn cvxpy(windows: &Path) -> Result<Vec<f64>, String> {
    let tools = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../target"), PathBuf::from)
        .join("tools/cvxpy");
    let python = tools.join("bin/python");
    let run = |program: &Path, arguments: &[&str]| -> Result<Vec<u8>, String> {
        let out = Command::new(program).args(arguments).output().map_err(|e| format!("{}: {e}", program.display()))?;
        let last = |text: &[u8]| String::from_utf8_lossy(text).lines().last().unwrap_or_default().to_owned();
        if out.status.success() { Ok(out.stdout) } else { Err(last(&out.stderr)) }
    };
    let has_it = python.is_file() && run(&python, &["-c", "import cvxpy"]).is_ok();
    if !has_it {
        std::fs::create_dir_all(&tools).map_err(|e| e.to_string())?;
        run(Path::new("python3"), &["-m", "venv", &tools.to_string_lossy()])?;
        run(&python, &["-m", "pip", "install", "--quiet", "cvxpy", "clarabel"])?;
    }
    let out = run(&python, &["-c", CVXPY, &windows.to_string_lossy()])?;
    serde_json::from_slice(&out).map_err(|e| e.to_string())
}

/// What an estimator was given at each tick of a simulated flight of its own, and the flight it was.
struct Flown {
    frames: Vec<(SensorFrame, MotorCommand)>,
    config: FlightConfig,
    /// Of the whole flight, simulator included: how many times real time on one core.
    speed: f64,
}

/// A flight in `world` with `kind` in the loop and nothing beside it, in which one height and one IMU are attacked.
fn flown(world: &str, kind: EstimatorKind) -> Flown {
    let text = "name = \"bench\"\nduration_s = 40\n\
        [[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n\
        [[script]]\nat_s = 5\ndo = \"setpoint\"\naltitude_m = 0.8\n\
        [[attack]]\nsensor = \"height\"\ninstance = 2\nkind = \"bias\"\nstart_s = 15\nduration_s = 10\nmagnitude = 0.5\n\
        [[attack]]\nsensor = \"imu\"\ninstance = 2\nchannel = \"accel\"\nkind = \"bias\"\nstart_s = 15\nduration_s = 10\n\
        magnitude = 2\n";
    let scenario = Scenario::from_toml(&format!("world = \"{world}\"\n{text}")).unwrap();
    let mut config = scenario.flight_config();
    config.estimators = vec![kind];
    config.in_loop = kind;
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let mut flight = Flight::new(config.clone()).unwrap();
    let ticks = (scenario.duration_s * scenario.tick_rate_hz) as usize;
    let mut frames = Vec::with_capacity(ticks);
    let mut before = None;
    let mut applied = MotorCommand::default();
    let took_us = timed(|| {
        for _ in 0..ticks {
            let frame = vehicle.sense().unwrap();
            flight.heartbeat(frame.time);
            scenario.script.commands(before, frame.time, |c| {
                let _ = flight.apply(c, frame.time);
            });
            before = Some(frame.time);
            let report = flight.step(&frame);
            frames.push((report.received, applied));
            applied = vehicle.actuate(&report.command).unwrap();
            flight.applied(applied);
        }
    });
    assert!(flight.report().armed, "{world}: {kind:?} did not fly to the end");
    Flown { frames, config, speed: 1e6 * scenario.duration_s / took_us }
}

/// Times every tick of `estimator`, and apart from them those of which `apart` says so.
fn ticks<E: Estimator>(
    frames: &[(SensorFrame, MotorCommand)],
    estimator: &mut E,
    mut apart: impl FnMut(&E) -> bool,
) -> Ticks {
    let (mut all, mut some) = (Vec::with_capacity(frames.len()), Vec::with_capacity(frames.len()));
    let before = counting::requests();
    for (frame, applied) in frames {
        let took = timed(|| {
            black_box(estimator.step(frame, applied));
        });
        all.push(took);
        if apart(estimator) {
            some.push(took);
        }
    }
    let allocations = counting::requests() - before;
    all.sort_by(f64::total_cmp);
    some.sort_by(f64::total_cmp);
    Ticks { all, apart: some, allocations }
}

/// Sorted times, us.
struct Ticks {
    all: Vec<f64>,
    apart: Vec<f64>,
    allocations: u64,
}

/// The whole tick of the decoders' estimator: decode, identify, filter.
fn secure_tick() {
    let Flown { frames, config, .. } = flown("bench", EstimatorKind::Secure);
    let mut secure = Secure::new(config.sensor_model, &config.airframe, SLOTS).unwrap();
    let mut windows = 0;
    let timed = ticks(&frames, &mut secure, |secure| std::mem::replace(&mut windows, secure.window().count) != windows);
    let more = serde_json::json!({ "allocations": timed.allocations });
    print("secure tick that decodes: decode, identify, filter", &timed.apart, None, more.clone());
    print("secure tick, all", &timed.all, None, more);
}

/// The whole tick of the lanes, and that at which the attacked set changes; then how fast their flight runs, beside the
/// shipped EKF's.
fn lanes_tick() {
    const WORLD: &str = "datasheet";
    let Flown { frames, config, speed } = flown(WORLD, EstimatorKind::Lanes);
    let mut lanes = Lanes::new(config.sensor_model, &config.airframe);
    let mut attacked = lanes.isolation().excluded();
    let timed = ticks(&frames, &mut lanes, |lanes| {
        let now = lanes.isolation().excluded();
        std::mem::replace(&mut attacked, now) != now
    });
    let more = |limit: f64| serde_json::json!({ "world": WORLD, "allocations": timed.allocations, "limit": limit });
    print("lanes tick, all", &timed.all, None, more(40.0));
    if timed.apart.is_empty() {
        skipped("lanes tick at a detection", "nothing was detected");
    } else {
        print("lanes tick at a detection", &timed.apart, None, more(150.0));
    }
    let shipped = flown(WORLD, EstimatorKind::EkfBias).speed;
    for (name, speed) in [("lanes", speed), ("ekf_bias", shipped)] {
        let line = serde_json::json!({ "bench": "sse", "name": format!("simulated flight with {name}"), "unit": "x real time",
            "value": speed, "world": WORLD, "limit": 200 });
        println!("{line}");
    }
}

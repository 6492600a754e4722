//! The agent's flight thread, drivers and motor guard fly the wire rig in real time: how long a sample takes from the wire
//! to the pulses on the wire, what the drivers cost, allocations in a tick, and the altitude beside that of the same flights
//! without wires. Prints JSON lines.
//!
//! A sample's way ends at the first pulses set after the tick that first had it. Ticks and samples keep their own time, so
//! each flight begins at another phase between them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::HashMap;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plumbline_agent::config::AgentConfig;
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::stop::Stop;
use plumbline_agent::runner::{Runner, RunnerOptions, RunnerPorts};
use plumbline_agent::sensor::{ImuSample, MAX_IMUS, SensorFrame};
use plumbline_agent::sim::Scenario;
use plumbline_agent::telemetry::{Outlet, Telemetry};
use plumbline_agent::types::MotorCommand;
use plumbline_agent::vehicle::{Awaited, DeviceState, MotorStop, Vehicle, VehicleError};
use plumbline_devices::motors::GuardLine;
use plumbline_devices::reader::Zero;
use plumbline_devices::spec;
use plumbline_devices::vehicle::HardwareVehicle;
use plumbline_support::counting::{self, Counting};
use plumbline_support::flown::{Flown, identification, runner_options, scenario};
use plumbline_wires::{PULSES_US, WireRig, Wiring};
use serde_json::{Value, json};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const MEDIAN_LIMIT_MS: f64 = 2.0;
const P99_LIMIT_MS: f64 = 5.0;
/// The figures of the altitude through the wires may be so many times those without.
const ALTITUDE_LIMIT: f64 = 1.1;
/// Phases between ticks and samples, in a tick; a seed for each, from 1 on; `PLUMBLINE_FLIGHTS` and `PLUMBLINE_SEED` say otherwise. The largest overshoot of one
/// flight varies by a seventh: of four the mean is known to 10 % only.
const FLIGHTS: u64 = 8;
/// Ports open and ESCs arm before the script begins, s.
const LATER_S: f64 = 3.0;
/// From a setpoint on, until the altitude counts as held, s.
const SETTLING_S: f64 = 5.0;

fn main() {
    let (mut through, mut without) = (Vec::new(), Vec::new());
    let flights =
        std::env::var("PLUMBLINE_FLIGHTS").map_or(FLIGHTS, |given| given.parse().expect("a number of flights"));
    let first = std::env::var("PLUMBLINE_SEED").map_or(1, |given| given.parse().expect("the first flight's seed"));
    for number in 0..flights {
        let mut scenario = Scenario::from_toml(&scenario("altitude_step")).unwrap();
        scenario.seed = first + number;
        scenario.duration_s += LATER_S;
        scenario.script.steps.iter_mut().for_each(|step| step.at_s += LATER_S);
        through.push(fly(&scenario, number as f64 / flights as f64));
        without.push(simulate(&wiring().completed(scenario)));
    }
    ways(&through, "talks", &[3]);
    ways(&through, "answers", &[0, 1, 2]);
    costs(&through);
    altitudes(&through, &without);
}

/// The scans themselves go the way of every sample.
fn wiring() -> Wiring {
    Wiring { record_scans: true, ..Wiring::usual() }
}

/// A tick as it went.
#[derive(Clone, Copy)]
struct Mark {
    /// Just before the motors were told.
    told: Instant,
    /// Samples of IMUs that it had.
    imus: [Option<[u64; 2]>; MAX_IMUS],
    /// Allocations of the flight thread until it began.
    requests: u64,
}

/// The vehicle of the agent, with a mark for each tick.
struct Marked {
    inner: HardwareVehicle,
    marks: Arc<Mutex<Vec<Mark>>>,
    next: Mark,
}

/// What tells a sample from others, whatever axes it is in.
fn key(gyro_radps: &nalgebra::Vector3<f64>, accel_mps2: &nalgebra::Vector3<f64>) -> [u64; 2] {
    [gyro_radps, accel_mps2].map(|v| (v.norm() * 1e9).round() as u64)
}

impl Vehicle for Marked {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        let requests = counting::requests();
        let frame = self.inner.sense()?;
        let imu = |sample: &Option<ImuSample>| sample.map(|s| key(&s.gyro_radps, &s.accel_mps2));
        self.next = Mark { told: Instant::now(), imus: frame.imus.each_ref().map(imu), requests };
        Ok(frame)
    }
    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        self.next.told = Instant::now();
        self.marks.lock().unwrap().push(self.next);
        self.inner.actuate(command)
    }
    fn awaited(&mut self) -> Option<Awaited> {
        self.inner.awaited()
    }
    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        self.inner.motor_stop()
    }
    fn pass_over(&mut self, gap_s: f64) -> f64 {
        self.inner.pass_over(gap_s)
    }
    fn device(&mut self, index: usize) -> Option<DeviceState<'_>> {
        self.inner.device(index)
    }
}

/// What is kept of a flight through the wires.
struct Through {
    /// Of each IMU, ms.
    ways: [Vec<f64>; MAX_IMUS],
    /// Time and altitude.
    truth: Vec<(f64, f64)>,
    /// The rig's longest time between two of its ticks, and between two pulses in flight, ms: what stood still where a flight stands out.
    gaps_ms: [f64; 2],
    /// Per armed tick.
    requests: Vec<u64>,
    /// Share of a core.
    readers: f64,
    flight: f64,
    guard: f64,
    misses: u64,
}

fn fly(scenario: &Scenario, phase: f64) -> Through {
    let folder = tempfile::tempdir().unwrap();
    let rig = WireRig::start(scenario, folder.path(), &wiring()).unwrap();
    let file = folder.path().join("agent.toml");
    std::fs::write(&file, rig.configuration()).unwrap();
    let config = AgentConfig::read(&file).unwrap();
    let suite = spec::suite(&config.device).unwrap();
    let airframe = scenario.airframe.clone();
    let mut flight = FlightConfig::new(airframe.clone(), scenario.rig.kind(&airframe), &suite);
    config.apply(&mut flight).unwrap();
    let flight = Flight::new(flight).unwrap();

    let (line, mut guard) = guarded(&file);
    let zero = Zero::ticking(scenario.tick_rate_hz);
    let devices = config.device.iter().filter_map(|device| device.start(&zero, config.real_time).unwrap()).collect();
    let marks = Arc::new(Mutex::new(Vec::with_capacity((scenario.duration_s * scenario.tick_rate_hz) as usize + 400)));
    let next = Mark { told: Instant::now(), imus: [None; MAX_IMUS], requests: 0 };
    let inner = HardwareVehicle::new(devices, Arc::new(line), zero.clone());
    let vehicle = Marked { inner, marks: marks.clone(), next };
    let (ring, mut sink) = rtrb::RingBuffer::new(1 << 20);
    let telemetry = Telemetry::new(identification(scenario), &flight, Some(Outlet::new(ring)), None);
    let script = Some(scenario.script.clone());
    let options =
        RunnerOptions { real_time: true, ..runner_options(Pace::Times(1.0), Some(scenario.duration_s), script) };
    // The rig's ticks began when its first truth was kept.
    let begun = loop {
        match rig.truths().first() {
            Some((at, _)) => break *at,
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    };
    let ticks = (begun.elapsed().as_secs_f64() / scenario.tick_s()).ceil() + 40.0;
    let begins = begun + Duration::from_secs_f64((ticks + phase) * scenario.tick_s());
    zero.set(begins);
    let ports = RunnerPorts { zero: Some(begins), ..RunnerPorts::default() };
    let flying = std::thread::Builder::new()
        .name("flight".into())
        .spawn(move || Runner::new(Box::new(vehicle), flight, telemetry, options, ports).run(&Stop::default()))
        .unwrap();
    std::thread::sleep(begins.saturating_duration_since(Instant::now()) + Duration::from_secs(1));
    let before = (Instant::now(), Used::now(guard.id()));
    let end = begins + Duration::from_secs_f64(scenario.duration_s - 1.0);
    while Instant::now() < end {
        let held = sink.slots();
        sink.read_chunk(held).unwrap().commit_all();
        std::thread::sleep(Duration::from_millis(10));
    }
    let (wall_s, used) = (before.0.elapsed().as_secs_f64(), Used::now(guard.id()));
    let summary = flying.join().unwrap().unwrap();
    // The line is closed with the vehicle.
    guard.wait().unwrap();
    let share = |of: fn(&Used) -> f64| (of(&used) - of(&before.1)) / wall_s;
    let marks = std::mem::take(&mut *marks.lock().unwrap());
    let seconds = |at: &Instant| at.saturating_duration_since(begins).as_secs_f64();
    Through {
        ways: ways_of(&rig, &marks),
        gaps_ms: [gap_ms(rig.truths().iter().map(|(at, _)| *at)), gap_ms(turning(&rig).into_iter())],
        truth: rig.truths().iter().map(|(at, truth)| (seconds(at), truth.position_enu_m.z)).collect(),
        requests: flying_marks(&rig, &marks).windows(2).map(|pair| pair[1].requests - pair[0].requests).collect(),
        readers: share(|used| used.readers),
        flight: share(|used| used.flight),
        guard: share(|used| used.guard),
        misses: summary.deadline_misses,
    }
}

/// The agent's own guard of the motors, and the line to it.
fn guarded(config: &std::path::Path) -> (GuardLine, Child) {
    let (near, far) = UnixStream::pair().unwrap();
    let mut guard = Command::new(env!("CARGO_BIN_EXE_plumbline-agent"));
    guard.arg("motor-guard").arg("--config").arg(config).stdin(Stdio::from(OwnedFd::from(far)));
    (GuardLine::new(near).unwrap(), guard.spawn().unwrap())
}

/// Processor time so far, s.
#[derive(Default)]
struct Used {
    readers: f64,
    flight: f64,
    guard: f64,
}

impl Used {
    fn now(guard: u32) -> Self {
        let seconds = |path: &std::path::Path| {
            let text = std::fs::read_to_string(path.join("schedstat")).unwrap_or_default();
            text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
        };
        let mut used = Self { guard: seconds(format!("/proc/{guard}").as_ref()), ..Self::default() };
        for task in std::fs::read_dir("/proc/self/task").unwrap().flatten() {
            let name = std::fs::read_to_string(task.path().join("comm")).unwrap_or_default();
            match name.trim() {
                "flight" => used.flight += seconds(&task.path()),
                name if name.starts_with("dev ") => used.readers += seconds(&task.path()),
                _ => {}
            }
        }
        used
    }
}

/// Longest time between two, ms.
fn gap_ms(times: impl Iterator<Item = Instant> + Clone) -> f64 {
    let gaps = times.clone().zip(times.skip(1)).map(|(before, after)| after.saturating_duration_since(before));
    round(gaps.max().unwrap_or_default().as_secs_f64() * 1e3)
}

/// The pulses that turned a motor.
fn turning(rig: &WireRig) -> Vec<Instant> {
    rig.pulses().iter().filter(|(_, widths)| widths[0] > PULSES_US[0] + 3.0).map(|(at, _)| *at).collect()
}

/// Ticks between the first and the last pulse that turned a motor.
fn flying_marks(rig: &WireRig, marks: &[Mark]) -> Vec<Mark> {
    let turning = turning(rig);
    let (first, last) = (turning.first().expect("it flew"), turning.last().unwrap());
    marks.iter().filter(|mark| mark.told >= *first && mark.told < *last).copied().collect()
}

/// From each sample on the wire to the first pulses after the tick that first had it, ms, for each IMU.
fn ways_of(rig: &WireRig, marks: &[Mark]) -> [Vec<f64>; MAX_IMUS] {
    let pulses: Vec<Instant> = rig.pulses().iter().map(|(at, _)| *at).collect();
    let mut sent: [HashMap<[u64; 2], Vec<Instant>>; MAX_IMUS] = Default::default();
    for (at, sample) in rig.sent() {
        let key = key(&sample.reading.gyro_radps, &sample.reading.accel_mps2);
        sent[sample.imu].entry(key).or_default().push(at);
    }
    let mut ways: [Vec<f64>; MAX_IMUS] = Default::default();
    for mark in flying_marks(rig, marks) {
        let Some(pulse) = pulses.get(pulses.partition_point(|at| *at < mark.told)) else { continue };
        for (imu, had) in mark.imus.iter().enumerate() {
            // Resolutions are coarse: the same values may come again. The last that had been sent is the one.
            let times = had.and_then(|key| sent[imu].get_mut(&key));
            let last = times.and_then(|times| times.drain(..times.partition_point(|at| *at < mark.told)).next_back());
            if let Some(at) = last {
                ways[imu].push(pulse.saturating_duration_since(at).as_secs_f64() * 1e3);
            }
        }
    }
    ways
}

fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn at(sorted: &[f64], fraction: f64) -> f64 {
    round(sorted[((sorted.len() - 1) as f64 * fraction).round() as usize])
}

fn ways(flights: &[Through], what: &str, imus: &[usize]) {
    let of = |flights: &[Through]| {
        let mut all: Vec<f64> =
            flights.iter().flat_map(|flown| imus.iter().flat_map(|imu| flown.ways[*imu].iter().copied())).collect();
        all.sort_by(f64::total_cmp);
        assert!(all.len() > 1000 * flights.len(), "{} samples of an IMU that {what} came to a pulse", all.len());
        all
    };
    let (all, each) = (of(flights), flights.iter().map(|flown| of(std::slice::from_ref(flown))));
    let medians: Vec<f64> = each.map(|all| at(&all, 0.5)).collect();
    println!(
        "{}",
        json!({ "bench": "wires", "name": format!("sample_to_pulse_imu_{what}"), "value": at(&all, 0.5), "unit": "ms",
            "median": at(&all, 0.5), "p99": at(&all, 0.99), "max": at(&all, 1.0), "limit": MEDIAN_LIMIT_MS,
            "p99_limit": P99_LIMIT_MS, "samples": all.len(), "median_by_phase": medians })
    );
}

fn costs(flights: &[Through]) {
    let mean = |of: fn(&Through) -> f64| flights.iter().map(of).sum::<f64>() / flights.len() as f64;
    let line = |name: &str, value: f64, unit: &str, more: Value| {
        println!("{}", json!({ "bench": "wires", "name": name, "value": round(value), "unit": unit, "more": more }));
    };
    let (readers, flight, guard) = (mean(|f| f.readers), mean(|f| f.flight), mean(|f| f.guard));
    line(
        "drivers_cpu",
        100.0 * readers,
        "% of a core",
        json!({ "devices": 8, "flight": round(100.0 * flight), "guard": round(100.0 * guard) }),
    );
    let ticks: usize = flights.iter().map(|flown| flown.requests.len()).sum();
    let requests: u64 = flights.iter().flat_map(|flown| &flown.requests).sum();
    let most = flights.iter().flat_map(|flown| &flown.requests).max();
    line(
        "allocations",
        requests as f64 / ticks as f64,
        "per tick",
        json!({ "limit": 0, "ticks": ticks, "most": most }),
    );
    for (index, name) in ["rig_gap", "pulse_gap"].into_iter().enumerate() {
        let each: Vec<f64> = flights.iter().map(|flown| flown.gaps_ms[index]).collect();
        line(name, each.iter().fold(0.0, |most, gap| gap.max(most)), "ms", json!({ "flights": each }));
    }
    let misses: u64 = flights.iter().map(|flown| flown.misses).sum();
    line("deadlines_missed", misses as f64, "ticks", json!({ "flights": flights.len() }));
}

/// The same flight in the simulator alone: time and altitude.
fn simulate(scenario: &Scenario) -> Vec<(f64, f64)> {
    let mut flown = Flown::with_config(scenario.clone(), scenario.flight_config());
    flown.until(scenario.duration_s);
    flown.rows.iter().map(|row| (row.t_s, row.truth.position_enu_m.z)).collect()
}

/// Setpoints of the scenario: from, until, from what altitude, to which.
const STEPS: [[f64; 4]; 4] =
    [[5.0, 15.0, 0.3, 0.5], [15.0, 24.0, 0.5, 0.8], [24.0, 33.0, 0.8, 1.0], [33.0, 42.0, 1.0, 0.5]];

/// Altitude less setpoint of one flight: rms while held and from the first setpoint on, largest overshoot, m.
fn altitude(truth: &[(f64, f64)]) -> [f64; 3] {
    let within =
        |from: f64, until: f64| truth.iter().filter(move |(t, _)| (from + LATER_S..until + LATER_S).contains(t));
    let rms = |after: f64| {
        let off = |[from, until, _, to]: [f64; 4]| within(from + after, until).map(move |(_, z)| (z - to).powi(2));
        let all: Vec<f64> = STEPS.into_iter().flat_map(off).collect();
        (all.iter().sum::<f64>() / all.len() as f64).sqrt()
    };
    let beyond = |[from, until, before, to]: [f64; 4]| {
        within(from, until).map(move |(_, z)| (z - to) * (to - before).signum()).fold(0.0, f64::max)
    };
    [rms(SETTLING_S), rms(0.0), STEPS.into_iter().map(beyond).fold(0.0, f64::max)]
}

fn altitudes(through: &[Through], without: &[Vec<(f64, f64)>]) {
    let (wired, plain): (Vec<_>, Vec<_>) =
        through.iter().zip(without).map(|(flown, truth)| (altitude(&flown.truth), altitude(truth))).unzip();
    for (index, name) in ["altitude_held_rms", "altitude_rms", "altitude_overshoot"].into_iter().enumerate() {
        let mean = |all: &[[f64; 3]]| all.iter().map(|figures| figures[index]).sum::<f64>() / all.len() as f64;
        let each = |all: &[[f64; 3]]| all.iter().map(|figures| round(figures[index])).collect::<Vec<_>>();
        // One sigma of the ratio, by the differences of flights of one seed.
        let off: Vec<f64> = wired.iter().zip(&plain).map(|(w, p)| (w[index] - p[index]) / mean(&plain)).collect();
        let (n, middle) = (off.len() as f64, off.iter().sum::<f64>() / off.len() as f64);
        let sigma = (off.iter().map(|x| (x - middle).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
        println!(
            "{}",
            json!({ "bench": "wires", "name": name, "value": round(mean(&wired)), "unit": "m", "without": round(mean(&plain)),
                "ratio": round(mean(&wired) / mean(&plain)), "ratio_sigma": round(sigma), "ratio_limit": ALTITUDE_LIMIT, "flights": each(&wired),
                "flights_without": each(&plain) })
        );
    }
}

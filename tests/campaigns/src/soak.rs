//! Hours in minutes: one agent at 200 Hz, twenty viewers of which five stall and five reconnect all the time.
//!
//! The recording must be complete, and no tick missed because of the ground. `PLUMBLINE_MINUTES` of it.
//!
//! **Flat**: resident memory (RSS) of ground and agent is read from the kernel every ten seconds. The first third of the
//! run, and never less than the [`WARM_UP`] in which the bounded histories fill, is left out. A straight line through the
//! rest must not rise by more than [`SLOPE_MAX_MIB_PER_HOUR`], and its last quarter must not lie higher than its first by
//! more than that and [`NOISE_MIB`]. What a run is too short to show is not judged: see [`JUDGED_FROM`].
//!
//! A machine that does other things misses ticks by itself. Two things tell those apart: before and after, the agent
//! flies alone, without a ground; and on each processor a bare timer runs with the flight thread's priority. Missed ticks
//! beside which no timer was late are at most the ground's doing, and so are those by which it is more than chance
//! makes of the rate alone: the smaller of both counts is judged.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::figures::{Figures, quantile, setting};
use super::witness::{Witness, now_us};
use plumbline_proto::{Kind, v1};
use plumbline_support::system::{Live, PATIENCE, options, scenario};
use plumbline_support::{memory_mib, scenario_file};
use plumbline_tests::harness::{Process, System, SystemOptions, wait_until};
use serde_json::json;

const READERS: usize = 10;
const STALLED: usize = 5;
const RECONNECTING: usize = 5;
/// The hub keeps two minutes of history for viewers that come; until then its memory grows as it should.
const WARM_UP: Duration = Duration::from_secs(130);
/// A leak of 20 bytes for each of the 700 messages a second would be 48 MiB an hour.
const SLOPE_MAX_MIB_PER_HOUR: f64 = 4.0;
/// A part of a recording being written holds the index of two and a half minutes and gives it back.
const NOISE_MIB: f64 = 2.0;
/// Below this the recording's parts alone, two and a half minutes each, tilt any line.
const JUDGED_FROM: Duration = Duration::from_secs(20 * 60);
const SAMPLE_EVERY: Duration = Duration::from_secs(10);

/// A timer as late as this explains a missed tick of 5 ms: it looks once a millisecond, at half of what was missed.
const LATE_US: f64 = 2_500.0;
/// Counts that differ from what is expected by so many sigmas (Poisson) are not chance.
const CHANCE_SIGMAS: f64 = 3.0;
/// Where a miss that a status tells of may have happened: a status comes ten times a second.
const TOLD_WITHIN_US: u64 = 300_000;

/// Flies the scenario's script without a ground for about so long: ticks, and how many were missed.
fn alone(options: &SystemOptions, folder: &Path, least: Duration) -> (u64, u64) {
    let number = |line: &str, key: &str| -> Option<u64> {
        let rest = line.split(&format!("{key}=")).nth(1)?;
        rest.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
    };
    let scenario = scenario_file("altitude_step");
    let begun = Instant::now();
    let (mut ticks, mut missed) = (0, 0);
    while begun.elapsed() < least {
        let mut command = Command::new(&options.binaries.agent);
        command.args(["--vehicle", "sim", "--script", "--ground", "none", "--scenario"]).arg(&scenario);
        command.arg("--log").arg(folder.join("alone")).env("NO_COLOR", "1");
        let mut agent = Process::start("agent alone", command, false).unwrap();
        let told = |line: &str| Some((number(line, "ticks")?, number(line, "deadline_misses")?));
        let (flown, late) = agent.wait_for(Duration::from_secs(300), told).unwrap();
        (ticks, missed) = (ticks + flown, missed + late);
    }
    (ticks, missed)
}

/// Memory of one process over time.
#[derive(Default)]
struct Memory {
    /// Since the start, s, and resident, MiB.
    resident: Vec<(f64, f64)>,
    /// Of it, not backed by a file, MiB.
    anonymous: Vec<f64>,
}

impl Memory {
    fn look(&mut self, id: u32, since_start: Duration) {
        self.resident.push((since_start.as_secs_f64(), memory_mib(id, "VmRSS")));
        self.anonymous.push(memory_mib(id, "RssAnon"));
    }

    /// Says how it went, and whether it was flat.
    fn judge(&self, name: &str, figures: &mut Figures, spread: &serde_json::Value) {
        let end = self.resident.last().map_or(0.0, |(at, _)| *at);
        let begin = (end / 3.0).max(WARM_UP.as_secs_f64());
        let settled: Vec<_> = self.resident.iter().filter(|(at, _)| *at >= begin).copied().collect();
        let quarter = (settled.len() / 4).max(1);
        let mean = |points: &[(f64, f64)]| points.iter().map(|(_, mib)| mib).sum::<f64>() / points.len().max(1) as f64;
        let risen =
            mean(&settled[settled.len().saturating_sub(quarter)..]) - mean(&settled[..quarter.min(settled.len())]);
        let mut sizes: Vec<f64> = settled.iter().map(|(_, mib)| *mib).collect();
        let rounded = |mib: &f64| (mib * 10.0).round() / 10.0;
        let series: Vec<f64> = self.resident.iter().map(|(_, mib)| rounded(mib)).collect();
        let anonymous: Vec<f64> = self.anonymous.iter().map(rounded).collect();
        figures.tell(
            &format!("{name}_memory"),
            quantile(&mut sizes, 0.5),
            "MiB",
            json!({ "least": quantile(&mut sizes, 0.0), "most": quantile(&mut sizes, 1.0), "every_s": SAMPLE_EVERY.as_secs(),
                "resident": series, "anonymous": anonymous }),
        );
        let slope = slope_per_hour(&settled);
        let mut more = spread.clone();
        more["from_s"] = begin.round().into();
        more["to_s"] = end.round().into();
        if end < JUDGED_FROM.as_secs_f64() {
            figures.tell(&format!("{name}_slope"), slope, "MiB/h", more);
            return;
        }
        figures.at_most(&format!("{name}_slope"), slope, SLOPE_MAX_MIB_PER_HOUR, "MiB/h", more);
        let limit = SLOPE_MAX_MIB_PER_HOUR * (end - begin) / 3600.0 + NOISE_MIB;
        figures.at_most(&format!("{name}_risen"), risen, limit, "MiB", json!({ "of": "last quarter over first" }));
    }
}

/// Processes that wanted to run, over the last minute.
fn load() -> f64 {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().and_then(|first| first.parse().ok()).unwrap_or(f64::NAN)
}

/// Least-squares slope of (s, MiB), MiB per hour.
fn slope_per_hour(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let covariance: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    3600.0 * covariance / variance
}

pub fn run() -> std::process::ExitCode {
    let minutes = setting("PLUMBLINE_MINUTES", 10);
    let mut figures = Figures::new("soak", setting("PLUMBLINE_SEED", 1));
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let timers: Vec<_> = (0..processors).map(|n| Witness::start(Some(n), Duration::from_millis(1), 1_000.0)).collect();
    let control = Duration::from_secs(60 * minutes / 10);
    let before = alone(&options, folder.path(), control);
    let system = System::start(&options, &scenario("altitude_step")).unwrap();
    let command = |route: &str, body| system.api().send("POST", &system.vehicle(route), &body).unwrap().status == 200;
    assert!(command("recording", json!({ "on": true })));
    wait_until(PATIENCE, || command("arm", json!({})).then_some(())).expect("armed");
    assert!(command("mode", json!({ "mode": "altitude_hold" })));
    assert!(command("setpoint", json!({ "altitude_m": 0.5 })));

    let viewers = Viewers::of(&system);
    let begun = Instant::now();
    let mut sampled = sample(&system, Duration::from_secs(60 * minutes).max(WARM_UP + Duration::from_secs(60)));
    let (reconnects, misses) = viewers.end();
    let spread = json!({ "minutes": minutes, "viewers": READERS + STALLED + RECONNECTING, "stalled": STALLED,
        "reconnects": reconnects });
    sampled.ground.judge("ground", &mut figures, &spread);
    sampled.agent.judge("agent", &mut figures, &spread);
    figures.tell(
        "load",
        quantile(&mut sampled.loads, 0.5),
        "processes",
        json!({ "most": quantile(&mut sampled.loads, 1.0),
        "processors": processors }),
    );
    let flown_s = begun.elapsed().as_secs_f64();
    let missed = Missed::of(&misses, &timers);
    command("disarm", json!({}));
    command("recording", json!({ "on": false }));
    report_recording(&mut figures, &system, minutes);
    system.stop().unwrap();
    let after = alone(&options, folder.path(), control);
    missed.report(&mut figures, flown_s, (before.0 + after.0, before.1 + after.1));
    figures.finish()
}

fn view(system: &System, history: u32) -> Live {
    Live::connect(system.api(), &system.vehicle(&format!("live?history={history}")))
}

/// Those who read all the time, and those who come and go, on threads of their own.
struct Viewers {
    ended: Arc<AtomicBool>,
    reconnects: Arc<AtomicU64>,
    /// When the count of missed ticks grew, µs of wall time, and to what.
    misses: Arc<Mutex<Vec<(u64, u64)>>>,
    threads: Vec<JoinHandle<()>>,
}

impl Viewers {
    fn of(system: &System) -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let reconnects = Arc::new(AtomicU64::new(0));
        let misses = Arc::new(Mutex::new(Vec::<(u64, u64)>::new()));
        let mut threads = Vec::new();
        for reader in 0..READERS {
            let (mut live, ended, misses) = (view(system, 0), ended.clone(), misses.clone());
            threads.push(std::thread::spawn(move || {
                while !ended.load(Ordering::Relaxed) {
                    let Some(frame) = live.try_frame() else { return };
                    if reader == 0
                        && let Some(status) = frame.message::<v1::Status>(Kind::Status)
                    {
                        let mut misses = misses.lock().unwrap();
                        if misses.last().is_none_or(|(_, count)| *count < status.deadline_misses) {
                            misses.push((now_us(), status.deadline_misses));
                        }
                    }
                }
            }));
        }
        let api = system.api().clone();
        for n in 0..RECONNECTING {
            let (api, ended, path) = (api.clone(), ended.clone(), system.vehicle("live?history=60"));
            let reconnects = reconnects.clone();
            threads.push(std::thread::spawn(move || {
                while !ended.load(Ordering::Relaxed) {
                    let mut live = Live::connect(&api, &path);
                    let until = Instant::now() + Duration::from_millis(700 + 300 * n as u64);
                    while Instant::now() < until && live.try_frame().is_some() {}
                    reconnects.fetch_add(1, Ordering::Relaxed);
                }
            }));
        }
        Self { ended, reconnects, misses, threads }
    }

    /// How often they came again, and the missed ticks they were told of.
    fn end(self) -> (u64, Vec<(u64, u64)>) {
        self.ended.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().unwrap());
        (self.reconnects.load(Ordering::Relaxed), self.misses.lock().unwrap().clone())
    }
}

/// What the machine's kernel says over time.
#[derive(Default)]
struct Sampled {
    ground: Memory,
    agent: Memory,
    loads: Vec<f64>,
}

/// Looks at both processes for so long, beside viewers that never read.
fn sample(system: &System, length: Duration) -> Sampled {
    // The ground closes them after a while, and they come back.
    let stall = || (0..STALLED).map(|_| view(system, 0)).collect();
    let mut stalled: Vec<Live> = stall();
    let begun = Instant::now();
    let (mut sampled, mut looked) = (Sampled::default(), Duration::ZERO);
    while begun.elapsed() < length {
        std::thread::sleep(Duration::from_secs(1));
        let t = begun.elapsed();
        if t.as_secs().is_multiple_of(45) {
            stalled = stall();
        }
        if t >= looked + SAMPLE_EVERY {
            looked = t;
            sampled.ground.look(system.ground.process.id(), t);
            sampled.agent.look(system.agent.process.id(), t);
            sampled.loads.push(load());
        }
    }
    drop(stalled);
    sampled
}

fn report_recording(figures: &mut Figures, system: &System, minutes: u64) {
    // The parts of a long flight are merged in the background first.
    let complete = wait_until(Duration::from_secs(120 + 15 * minutes), || {
        let flights = system.api().get_json("/api/v1/flights?limit=1000").ok()?;
        let flight = flights["flights"].get(0)?.clone();
        (flight["completeness"] == "complete").then_some(flight)
    });
    let flight = complete.unwrap_or_default();
    figures.at_most(
        "missing",
        flight["missing"].as_f64().unwrap_or(f64::NAN),
        0.0,
        "messages",
        json!({ "messages": flight["messages"], "filled": flight["filled"], "duration_s": flight["duration_s"],
            "size_bytes": flight["size_bytes"] }),
    );
}

/// Ticks missed beside the ground.
struct Missed {
    all: u64,
    /// Those of them beside which no timer was late.
    unexplained: u64,
}

impl Missed {
    fn of(misses: &[(u64, u64)], timers: &[Witness]) -> Self {
        let excused = |at: u64| {
            let late = |timer: &Witness| timer.worst_us(at.saturating_sub(TOLD_WITHIN_US), at + 50_000) >= LATE_US;
            timers.iter().any(late)
        };
        let mut missed = Self { all: 0, unexplained: 0 };
        for pair in misses.windows(2) {
            let [(_, before), (at, after)] = pair else { continue };
            missed.all += after - before;
            missed.unexplained += if excused(*at) { 0 } else { after - before };
        }
        missed
    }

    /// Compares with ticks flown, and missed, without a ground.
    fn report(&self, figures: &mut Figures, flown_s: f64, (ticks, missed_alone): (u64, u64)) {
        let per_hour = |missed: u64, seconds: f64| (missed as f64 * 3600.0 / seconds.max(1.0)).round();
        let alone_s = ticks as f64 / 200.0;
        figures.tell(
            "missed_ticks",
            self.all as f64,
            "ticks",
            json!({ "per_hour": per_hour(self.all, flown_s), "alone_per_hour": per_hour(missed_alone, alone_s),
                "alone": missed_alone, "alone_ticks": ticks }),
        );
        let expected = missed_alone as f64 * flown_s / alone_s.max(1.0);
        let spread = (expected * (1.0 + flown_s / alone_s.max(1.0))).sqrt();
        let excess = (self.all as f64 - expected - CHANCE_SIGMAS * spread).max(0.0).round();
        let more = json!({ "beside_punctual_timers": self.unexplained, "more_than_alone": excess });
        let of_ground = excess.min(self.unexplained as f64);
        figures.at_most("missed_ticks_of_the_ground", of_ground, 0.0, "ticks", more);
    }
}

//! A flight over a bad radio: 30 % loss, bursts, reordering, repetition, a fade of 3 s and one of 12 s.
//!
//! The radio is [`Radio`]; everything else is the product. What the onboard log holds is what was sent; what a viewer
//! received, and when, is what was delivered. The age of a message is its arrival at the viewer minus its log time, less
//! the clock offset that the ground measures (as the page's link age). Afterwards the flight file must hold the onboard log, byte for byte.
//! `PLUMBLINE_SEED` chooses the accidents.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::figures::{Figures, quantile, setting};
use plumbline_proto::{Kind, v1};
use plumbline_support::files::{self, Logged};
use plumbline_support::system::{Live, PATIENCE, options, scenario};
use plumbline_tests::harness::{Agent, Faults, Ground, Radio, wait_until};
use plumbline_tests::xtask::XtaskError;
use serde_json::{Value, json};

/// A radio across a hall: 6 ms there and back.
const AIR: Faults = Faults {
    loss: 0.0,
    burst_begins: 0.0,
    burst_ends: 0.0,
    delay: Duration::from_millis(3),
    jitter: Duration::from_millis(2),
    repeated: 0.0,
    outage: false,
};
const LOSSY: Faults = Faults { loss: 0.3, ..AIR };
/// Bursts of 20 packets on average, a quarter of the time.
const BURSTY: Faults = Faults { burst_begins: 1.0 / 60.0, burst_ends: 1.0 / 20.0, ..AIR };
/// Late by up to four ticks, every tenth twice.
const SHUFFLED: Faults = Faults { jitter: Duration::from_millis(20), repeated: 0.1, loss: 0.05, ..AIR };
const OUT: Faults = Faults { outage: true, ..AIR };

/// Promised by issue and DESIGN.
const DELIVERY_MIN: f64 = 0.65;
const AGE_P99_MAX_MS: f64 = 50.0;
const RESUME_MAX_MS: f64 = 100.0;
/// Backfill of the whole flight, at the least rate that backfill may fall to, takes no longer than this.
const COMPLETE_WITHIN: Duration = Duration::from_secs(300);

fn now_us() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as u64
}

/// A phase of the flight: name, begin and end, µs of wall time.
type Phase = (&'static str, u64, u64);

/// Arrival of each live message at a viewer, µs, by sequence number; and the agent's clock as the ground measures it.
#[derive(Default)]
struct Seen {
    arrivals: HashMap<u32, u64>,
    /// Ground minus agent, µs, at arrival.
    offsets: Vec<f64>,
}

/// Somebody who watches on a thread of his own.
struct Viewer {
    seen: Arc<Mutex<Seen>>,
    ended: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Viewer {
    fn of(ground: &Ground) -> Self {
        let seen = Arc::new(Mutex::new(Seen::default()));
        let ended = Arc::new(AtomicBool::new(false));
        let mut live = Live::connect(&ground.api, "/api/v1/vehicles/iris-1/live?history=0");
        let thread = {
            let (seen, ended) = (seen.clone(), ended.clone());
            std::thread::spawn(move || {
                while !ended.load(Ordering::Relaxed) {
                    let frame = live.frame();
                    let mut seen = seen.lock().unwrap();
                    if let Some(link) = frame.message::<v1::LinkStatus>(Kind::Link) {
                        seen.offsets.push(link.clock_offset_us);
                    }
                    if frame.sequence > 0 {
                        seen.arrivals.entry(frame.sequence as u32).or_insert_with(now_us);
                    }
                }
            })
        };
        Self { seen, ended, thread }
    }

    fn end(self) -> Seen {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        std::mem::take(&mut *self.seen.lock().unwrap())
    }
}

fn command(ground: &Ground, route: &str, body: Value) -> Result<Value, XtaskError> {
    ground.api.command("POST", &format!("/api/v1/vehicles/iris-1/{route}"), &body)
}

pub fn run() -> std::process::ExitCode {
    let seed = setting("PLUMBLINE_SEED", 1);
    let scale = setting("PLUMBLINE_SECONDS", 15);
    let mut figures = Figures::new("link", seed);
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let mut ground = Ground::start(&options).unwrap();
    let radio = Radio::to(ground.link, AIR, seed).unwrap();
    ground.link = radio.address();
    let mut agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();

    let viewer = Viewer::of(&ground);
    let phases = fly(&ground, &radio, scale);
    stop_recording(&ground, &agent);
    let stopped_us = now_us();
    let flight = completed(&ground);
    let completed_us = now_us();
    let id = flight["id"].as_str().unwrap().to_owned();
    let file = ground.api.get(&format!("/api/v1/flights/{id}/mcap")).unwrap().body;
    let seen = viewer.end();
    agent.process.interrupt(Duration::from_secs(10)).unwrap();
    let onboard = std::fs::read(options.data.join("iris-1/log").join(format!("{id}.mcap"))).unwrap();
    ground.process.interrupt(Duration::from_secs(10)).unwrap();

    let (sent, recorded) = (files::messages(&onboard), files::messages(&file));
    report_phases(&mut figures, &phases, &sent, &seen);
    let differing = sent.iter().filter(|(s, message)| recorded.get(s) != Some(message)).count()
        + recorded.keys().filter(|s| !sent.contains_key(s)).count();
    figures.at_most("differs_from_onboard_log", differing as f64, 0.0, "messages", json!({ "messages": sent.len() }));
    figures.at_most(
        "missing",
        flight["missing"].as_f64().unwrap(),
        0.0,
        "messages",
        json!({ "live": flight["live"], "filled": flight["filled"] }),
    );
    figures.tell("complete_after_landing", (completed_us - stopped_us) as f64 * 1e-6, "s", json!({}));
    let passed = radio.passed();
    figures.tell(
        "packets_lost",
        passed.lost as f64,
        "packets",
        json!({ "taken": passed.taken, "repeated": passed.repeated, "reordered": passed.reordered }),
    );
    figures.finish()
}

/// Records, flies, and lets the radio have its troubles one after the other.
fn fly(ground: &Ground, radio: &Radio, scale: u64) -> Vec<Phase> {
    // By hand, so that the recording outlasts the landing that a fade of 3 s forces.
    command(ground, "recording", json!({ "on": true })).unwrap();
    wait_until(PATIENCE, || command(ground, "arm", json!({})).ok()).expect("armed");
    command(ground, "mode", json!({ "mode": "altitude_hold" })).unwrap();
    command(ground, "setpoint", json!({ "altitude_m": 0.5 })).unwrap();

    let mut phases = Vec::new();
    let mut phase = |name, faults, seconds| {
        radio.set(faults);
        let begin = now_us();
        std::thread::sleep(Duration::from_secs(seconds));
        phases.push((name, begin, now_us()));
    };
    phase("cable", AIR, scale / 2);
    phase("loss_30", LOSSY, scale);
    phase("fade_3s", OUT, 3);
    phase("loss_30_after_fade", LOSSY, scale);
    phase("bursts", BURSTY, scale);
    phase("shuffled", SHUFFLED, scale);
    phase("fade_12s", OUT, 12);
    phase("loss_30_after_long_fade", LOSSY, scale);
    phase("cable_again", AIR, 2);
    phases
}

fn stop_recording(ground: &Ground, agent: &Agent) {
    let mut last = String::new();
    let stopped = wait_until(PATIENCE, || {
        let disarmed = command(ground, "disarm", json!({}));
        let answer = disarmed.and_then(|_| command(ground, "recording", json!({ "on": false })));
        answer.map_err(|error| last = error.to_string()).ok()
    });
    assert!(stopped.is_some(), "the recording cannot be stopped: {last}\n{}", agent.process.last_lines(30));
}

/// The flight, once the ground has all of it.
fn completed(ground: &Ground) -> Value {
    let complete = wait_until(COMPLETE_WITHIN, || {
        let flights = ground.api.get_json("/api/v1/flights?limit=1000").ok()?;
        let flight = flights["flights"].get(0)?.clone();
        (flight["completeness"] == "complete").then_some(flight)
    });
    complete.unwrap_or_else(|| panic!("not complete: {}", ground.api.get_json("/api/v1/flights?limit=1000").unwrap()))
}

/// What was delivered in each phase, and how soon again after each fade.
fn report_phases(figures: &mut Figures, phases: &[Phase], sent: &BTreeMap<u32, Logged>, seen: &Seen) {
    let arrivals = &seen.arrivals;
    // Flight time zero is a little later than the agent has it, and the page reckons with it as we do here.
    let offset_us =
        quantile(&mut seen.offsets.iter().copied().filter(|offset| *offset != 0.0).collect::<Vec<_>>(), 0.5);
    figures.tell("clock_offset", offset_us * 1e-3, "ms", json!({}));
    for phase in phases {
        report(figures, *phase, sent, arrivals, offset_us);
    }
    for (name, promised) in [("fade_3s", true), ("fade_12s", false)] {
        let (_, _, back) = phases.iter().find(|phase| phase.0 == name).unwrap();
        let first = sent.iter().filter(|(_, m)| m.wall_us >= *back).filter_map(|(s, _)| arrivals.get(s)).min();
        let resumed_ms = first.map_or(f64::NAN, |at| at.saturating_sub(*back) as f64 * 1e-3);
        let name = format!("{name}_resumes_after");
        match promised {
            true => figures.at_most(&name, resumed_ms, RESUME_MAX_MS, "ms", json!({})),
            false => figures.tell(&name, resumed_ms, "ms", json!({})),
        }
    }
}

fn report(
    figures: &mut Figures,
    (name, begin, end): Phase,
    sent: &BTreeMap<u32, Logged>,
    arrivals: &HashMap<u32, u64>,
    offset_us: f64,
) {
    // Less a moment at each end, in which the radio changes.
    let margin_us = 200_000;
    let within: Vec<_> =
        sent.iter().filter(|(_, m)| (begin + margin_us..end.saturating_sub(margin_us)).contains(&m.wall_us)).collect();
    let mut ages: Vec<f64> = within
        .iter()
        .filter_map(|(sequence, message)| {
            let arrived = arrivals.get(sequence)?;
            Some((*arrived as f64 - message.wall_us as f64 - offset_us) * 1e-3)
        })
        .collect();
    let ticks = within.iter().filter(|(_, m)| m.topic == "/control").count();
    let delivery = ages.len() as f64 / within.len().max(1) as f64;
    let more = json!({ "sent": within.len(), "delivered": ages.len(),
        "control_hz": (ticks as f64 * 1e6 / (end - begin - 2 * margin_us) as f64).round() });
    if name.starts_with("fade") {
        figures.tell(&format!("{name}_delivery"), delivery, "fraction", more);
        return;
    }
    let p99 = quantile(&mut ages, 0.99);
    let median = quantile(&mut ages, 0.5);
    let age = json!({ "median": (median * 1e3).round() / 1e3 });
    if name.starts_with("loss_30") && name != "loss_30_after_long_fade" || name.starts_with("cable") {
        figures.at_least(&format!("{name}_delivery"), delivery, DELIVERY_MIN, "fraction", more);
        figures.at_most(&format!("{name}_age_p99"), p99, AGE_P99_MAX_MS, "ms", age);
    } else {
        figures.tell(&format!("{name}_delivery"), delivery, "fraction", more);
        figures.tell(&format!("{name}_age_p99"), p99, "ms", age);
    }
}

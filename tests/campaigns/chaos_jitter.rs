//! The flight thread keeps its time whatever becomes of ground, link and disk: tick jitter of each trouble against the
//! quiet phases before and after it, in the same run, in turns. What is told is the median of the turns' ratios: a quiet
//! machine's jitter alone goes from 76 to 126 us and back within minutes, which three turns taken together could not tell
//! from an effect (0.71 to 1.24 for the same trouble in three runs).
//!
//! The jitter is the agent's own (99th percentile of |start − due| of each second), read from its onboard log, which needs
//! no link. Phases:
//!
//! | phase | what goes wrong |
//! |---|---|
//! | ground_dead | the ground is stopped (SIGSTOP) |
//! | link_saturated | a radio that loses two of three packets, half a second late, and junk at the agent's socket |
//! | disk_slow | the disk of the onboard log answers for 0.3 s every 5 s: whoever writes to it waits |
//! | disk_busy | a neighbour writes and syncs without pause: the machine's processors and interrupts are busy with it |
//!
//! On each processor a bare timer runs beside the agent, with its rate and priority, and touches nothing: what a busy
//! machine does to any thread is seen there. The promise is made for the first three; for the last it is that the agent
//! suffers no more than the bare timer of the processor that suffers most: a real-time thread stays where it is.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "chaos/disk.rs"]
mod disk;
#[path = "chaos/figures.rs"]
mod figures;
#[path = "chaos/files.rs"]
mod files;
#[path = "../tests/support/mod.rs"]
mod support;
#[path = "chaos/witness.rs"]
mod witness;

use std::io::Write as _;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use figures::{Figures, quantile, setting};
use plumbline_proto::{Message as _, v1};
use plumbline_tests::harness::{Agent, Faults, Ground, Radio, wait_until};
use serde_json::json;
use support::{options, scenario};
use witness::{Witness, now_us};

/// DESIGN: within 20 % of the quiet run.
const RATIO_MAX: f64 = 1.2;
/// Packets of junk a second: far more than any radio carries.
const JUNK_HZ: u32 = 5_000;
/// The agent's own.
const TICK: Duration = Duration::from_millis(5);
/// Each trouble comes so often.
const TURNS: u32 = 9;
const FROZEN: Duration = Duration::from_millis(4_700);
const THAWED: Duration = Duration::from_millis(300);

/// Does `work` again and again while `during` runs.
fn beside(work: impl Fn() + Send + 'static, during: impl FnOnce()) {
    let ended = Arc::new(AtomicBool::new(false));
    let thread = {
        let ended = ended.clone();
        std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                work();
            }
        })
    };
    during();
    ended.store(true, Ordering::Relaxed);
    thread.join().unwrap();
}

fn main() -> std::process::ExitCode {
    let seed = setting("PLUMBLINE_SEED", 1);
    let seconds = setting("PLUMBLINE_SECONDS", 7);
    let mut figures = Figures::new("jitter", seed);
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let disk = disk::Disk::mount(&options.data.join("iris-1/log")).map(Arc::new);
    if let Err(reason) = &disk {
        figures.skip("disk_slow", reason);
    }
    let mut ground = Ground::start(&options).unwrap();
    let radio = Radio::to(ground.link, Faults::default(), seed).unwrap();
    ground.link = radio.address();
    let mut agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    let command = |route: &str, body| ground.api.command("POST", &format!("/api/vehicles/iris-1/{route}"), &body);
    command("recording", json!({ "on": true })).unwrap();
    wait_until(support::PATIENCE, || command("arm", json!({})).ok()).expect("armed");
    command("mode", json!({ "mode": "altitude_hold" })).unwrap();
    command("setpoint", json!({ "altitude_m": 0.5 })).unwrap();
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let bare: Vec<_> = (0..processors).map(|processor| Witness::start(Some(processor), TICK, 0.0)).collect();

    let mut phases: Vec<(&str, u64, u64)> = Vec::new();
    let mut phase = |name: &'static str| {
        let begin = now_us();
        std::thread::sleep(Duration::from_secs(seconds));
        phases.push((name, begin, now_us()));
    };
    for _ in 0..TURNS {
        phase("quiet");
        ground.process.signal(libc::SIGSTOP);
        phase("ground_dead");
        ground.process.signal(libc::SIGCONT);
        phase("quiet");
        let to = radio.agent().expect("an agent that has spoken");
        radio.set(Faults { loss: 0.67, delay: Duration::from_millis(500), ..Faults::default() });
        let junk = UdpSocket::bind("127.0.0.1:0").unwrap();
        let flood = move || {
            let _ = junk.send_to(&[0x5a; 1_100], to);
            std::thread::sleep(Duration::from_secs(1) / JUNK_HZ);
        };
        beside(flood, || phase("link_saturated"));
        radio.set(Faults::default());
        if let Ok(disk) = &disk {
            phase("quiet");
            let slow = disk.clone();
            let stutter = move || {
                slow.freeze();
                std::thread::sleep(FROZEN);
                slow.thaw();
                std::thread::sleep(THAWED);
            };
            beside(stutter, || phase("disk_slow"));
        }
        phase("quiet");
        let path = folder.path().join("neighbour");
        let busy = move || {
            let mut file = std::fs::File::create(&path).unwrap();
            file.write_all(&vec![1; 4 << 20]).unwrap();
            file.sync_all().unwrap();
        };
        beside(busy, || phase("disk_busy"));
    }
    phase("quiet");
    agent.process.interrupt(Duration::from_secs(15)).unwrap();
    drop(ground);

    let log = files::messages_of(&options.data.join("iris-1/log"), "");
    let mut statuses: Vec<(u64, v1::Status)> = log
        .values()
        .filter(|message| message.topic == "/status")
        .map(|message| (message.wall_us, v1::Status::decode(message.data.as_slice()).unwrap()))
        .collect();
    statuses.sort_by_key(|(at, _)| *at);
    // Each second's figure is told until the next one: taken once.
    let mut told = statuses.clone();
    told.dedup_by_key(|(_, status)| status.tick_jitter_p99_us.to_bits());
    // The first second and a half of a phase still tells of the one before.
    let settled = |index: usize| (phases[index].1 + 1_500_000, phases[index].2);
    let of_agent = |index: usize| -> Vec<f64> {
        let (begin, end) = settled(index);
        let within = told.iter().filter(|(at, _)| (begin..end).contains(at));
        within.map(|(_, status)| status.tick_jitter_p99_us).collect()
    };
    let misses = |index: usize| -> u64 {
        let (_, begin, end) = phases[index];
        let mut within = statuses.iter().filter(|(at, _)| (begin..end).contains(at)).map(|(_, s)| s.deadline_misses);
        let first = within.next().unwrap_or(0);
        within.next_back().unwrap_or(first) - first
    };
    for name in ["ground_dead", "link_saturated", "disk_slow", "disk_busy"] {
        let turns: Vec<usize> = (0..phases.len()).filter(|index| phases[*index].0 == name).collect();
        if turns.is_empty() {
            continue;
        }
        let around = |index: &usize| [index - 1, index + 1].into_iter().filter(|index| phases[*index].0 == "quiet");
        // Of each turn, troubled and quiet; then of all turns, the least and the most of their ratios, and the medians.
        let judge = |of: &dyn Fn(usize) -> Vec<f64>| {
            let turn = |index: &usize| {
                let mut quiet: Vec<f64> = around(index).flat_map(of).collect();
                [quantile(&mut of(*index), 0.5), quantile(&mut quiet, 0.5)]
            };
            let pairs: Vec<[f64; 2]> = turns.iter().map(turn).filter(|pair| pair.iter().all(|v| *v > 0.0)).collect();
            let all =
                |value: &dyn Fn(&[f64; 2]) -> f64, q| quantile(&mut pairs.iter().map(value).collect::<Vec<_>>(), q);
            let [least, ratio, most] = [0.0, 0.5, 1.0].map(|q| all(&|[troubled, quiet]| troubled / quiet, q));
            (ratio, [least, most], all(&|pair| pair[0], 0.5).round(), all(&|pair| pair[1], 0.5).round())
        };
        let (agent, [least, most], troubled, quiet) = judge(&of_agent);
        let of_timer = |timer: &Witness| judge(&|index| timer.jitter_us(phases[index].1, phases[index].2));
        let (machine, _, bare_us, bare_quiet_us) =
            bare.iter().map(of_timer).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NAN, [0.0; 2], 0.0, 0.0));
        let missed: u64 = turns.iter().map(|index| misses(*index)).sum();
        let missed_quiet: u64 = turns.iter().flat_map(around).map(misses).sum();
        let more = json!({ "jitter_p99_us": troubled, "quiet_us": quiet, "turns": turns.len(), "least": (least * 1e3).round() / 1e3, "most": (most * 1e3).round() / 1e3,
            "bare_timer_ratio": (machine * 1e3).round() / 1e3, "bare_timer_us": bare_us, "bare_timer_quiet_us": bare_quiet_us,
            "missed": missed, "missed_quiet": missed_quiet });
        if name == "disk_busy" {
            figures.tell("disk_busy_ratio", agent, "of quiet", more);
            figures.at_most("disk_busy_beyond_bare_timer", agent / machine, RATIO_MAX, "of its ratio", json!({}));
        } else {
            figures.at_most(&format!("{name}_ratio"), agent, RATIO_MAX, "of quiet", more);
        }
    }
    figures.finish()
}

//! The flight thread keeps its time whatever becomes of ground, link and disk: tick jitter of each trouble against the
//! quiet phases before and after it, in the same run.
//!
//! The jitter is the agent's own (99th percentile of |start − due| of each second), read from its onboard log, which needs
//! no link. Phases: ground stopped (SIGSTOP), link saturated (a radio that loses two of three packets, half a second late,
//! and a flood of junk at the agent's socket), disk slow (a neighbour that writes and syncs without pause).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "chaos/figures.rs"]
mod figures;
#[path = "chaos/files.rs"]
mod files;
#[path = "../tests/support/mod.rs"]
mod support;

use std::io::Write as _;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use figures::{Figures, quantile, setting};
use plumbline_proto::{Message as _, v1};
use plumbline_tests::harness::{Agent, Faults, Ground, Radio, wait_until};
use serde_json::json;
use support::{options, scenario};

/// DESIGN: within 20 % of the quiet run.
const RATIO_MAX: f64 = 1.2;
/// Packets of junk a second: far more than any radio carries.
const JUNK_HZ: u32 = 5_000;

fn now_us() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as u64
}

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
    let seconds = setting("PLUMBLINE_SECONDS", 15);
    let mut figures = Figures::new("jitter", seed);
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let mut ground = Ground::start(&options).unwrap();
    let radio = Radio::to(ground.link, Faults::default(), seed).unwrap();
    ground.link = radio.address();
    let mut agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    let command = |route: &str, body| ground.api.command("POST", &format!("/api/vehicles/iris-1/{route}"), &body);
    command("recording", json!({ "on": true })).unwrap();
    wait_until(support::PATIENCE, || command("arm", json!({})).ok()).expect("armed");
    command("mode", json!({ "mode": "altitude_hold" })).unwrap();
    command("setpoint", json!({ "altitude_m": 0.5 })).unwrap();

    let mut phases: Vec<(&str, u64, u64)> = Vec::new();
    let mut phase = |name: &'static str| {
        let begin = now_us();
        std::thread::sleep(Duration::from_secs(seconds));
        phases.push((name, begin, now_us()));
    };
    for _ in 0..2 {
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
        phase("quiet");
        let path = folder.path().join("neighbour");
        let busy = move || {
            let mut file = std::fs::File::create(&path).unwrap();
            file.write_all(&vec![1; 4 << 20]).unwrap();
            file.sync_all().unwrap();
        };
        beside(busy, || phase("disk_slow"));
    }
    phase("quiet");
    agent.process.interrupt(Duration::from_secs(15)).unwrap();
    drop(ground);

    let log = files::messages_of(&options.data.join("iris-1/log"), "");
    let statuses: Vec<(u64, v1::Status)> = log
        .values()
        .filter(|message| message.topic == "/status")
        .map(|message| (message.wall_us, v1::Status::decode(message.data.as_slice()).unwrap()))
        .collect();
    // The first second and a half of a phase still tells of the one before.
    let of = |index: usize| -> Vec<f64> {
        let (_, begin, end) = phases[index];
        let within = statuses.iter().filter(|(at, _)| (begin + 1_500_000..end).contains(at));
        within.map(|(_, status)| status.tick_jitter_p99_us).collect()
    };
    let misses = |index: usize| -> u64 {
        let (_, begin, end) = phases[index];
        let mut within = statuses.iter().filter(|(at, _)| (begin..end).contains(at)).map(|(_, s)| s.deadline_misses);
        let first = within.next().unwrap_or(0);
        within.next_back().unwrap_or(first) - first
    };
    for name in ["ground_dead", "link_saturated", "disk_slow"] {
        let (mut troubled, mut quiet, mut missed, mut missed_quiet) = (Vec::new(), Vec::new(), 0, 0);
        for index in (0..phases.len()).filter(|index| phases[*index].0 == name) {
            troubled.extend(of(index));
            quiet.extend(of(index - 1).into_iter().chain(of(index + 1)));
            missed += misses(index);
            missed_quiet += misses(index - 1) + misses(index + 1);
        }
        let (troubled, quiet) = (quantile(&mut troubled, 0.5), quantile(&mut quiet, 0.5));
        figures.at_most(
            &format!("{name}_ratio"),
            troubled / quiet,
            RATIO_MAX,
            "of quiet",
            json!({ "jitter_p99_us": troubled.round(), "quiet_us": quiet.round(), "missed": missed,
                "missed_quiet_twice_as_long": missed_quiet }),
        );
    }
    figures.finish()
}

//! Hostile and clumsy clients: how long the motor cut takes beneath each load they put on the ground.
//!
//! Ground and agent really run; somebody is signed in and holds control, a flight is being recorded. In each round the
//! vehicle is armed and cut, by a request on a connection of its own. Measured is the time from before that connection
//! is opened to the first control tick with the motors off. The ticks are told by a live view: flight time becomes wall
//! time by the shortest delay ever seen between the two, so that what the live view takes does not count; `seen_p99_ms`
//! tells when the live view knew. `PLUMBLINE_ROUNDS` cuts beneath each load; `PLUMBLINE_ONLY` names
//! some of them.

mod client;
mod loads;

use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::figures::{Figures, quantile, setting};
use client::{Client, PASSWORD};
use loads::Load;
use plumbline_ground::people::{Accounts, Role};
use plumbline_proto::{Kind, v1};
use plumbline_support::system::{PATIENCE, frames, free_port, options, scenario};
use plumbline_tests::harness::{Process, System, SystemOptions, wait_until};
use serde_json::json;

/// What the issue of the cut promises: p99, from the request to the motors off.
const CUT_MAX_MS: f64 = 50.0;
/// A load is on for this long before the first cut.
const SETTLE: Duration = Duration::from_millis(500);
/// A cut that shows no effect for this long counts as one that takes so long.
const GIVEN_UP: Duration = Duration::from_secs(10);
/// What the ground may take beneath a load, MiB. Ten tables at a time took 8.2 GB once.
const PEAK_MAX_MIB: f64 = 768.0;
/// Files that a ground short of them may open.
const SCARCE_FILES: u32 = 512;
/// People besides the pilot.
const CROWD: usize = 8;

/// What the live view tells of the control ticks.
#[derive(Default)]
struct Seen {
    /// Wall time minus flight time, µs: the least there was.
    offset_us: Option<i64>,
    armed: bool,
    /// When the motors went off last: by the vehicle's clock, and seen here, µs of wall time.
    off_us: Option<(i64, i64)>,
}

fn now_us() -> i64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_micros() as i64
}

/// Follows the control ticks on a thread of its own.
fn watch(client: &Client) -> Arc<Mutex<Seen>> {
    let seen = Arc::new(Mutex::new(Seen::default()));
    let mut socket = client.socket("/api/v1/vehicles/iris-1/live?history=0", &client.pilot).unwrap();
    let told = seen.clone();
    std::thread::spawn(move || {
        while let Ok(message) = socket.read() {
            let tokio_tungstenite::tungstenite::Message::Binary(batch) = message else { continue };
            let arrived_us = now_us();
            for frame in frames(&batch) {
                if let Some(control) = frame.message::<v1::Control>(Kind::Control) {
                    let mut seen = told.lock().unwrap();
                    let offset = arrived_us - control.time_us as i64;
                    let offset = seen.offset_us.map_or(offset, |least| least.min(offset));
                    seen.offset_us = Some(offset);
                    if seen.armed && !control.armed && control.motor_command.iter().all(|motor| *motor == 0.0) {
                        seen.off_us = Some((control.time_us as i64 + offset, arrived_us));
                    }
                    seen.armed = control.armed;
                }
            }
        }
    });
    seen
}

/// Arms, whatever else goes on.
fn arm(client: &Client, seen: &Mutex<Seen>) {
    let mut last = None;
    let armed = wait_until(PATIENCE, || {
        client.command("release-cut", &json!({}));
        last = client.command("arm", &json!({}));
        last.as_ref().filter(|(status, _)| *status == 200)?;
        wait_until(Duration::from_secs(1), || seen.lock().unwrap().armed.then_some(()))
    });
    assert!(armed.is_some(), "not armed: {last:?}");
    seen.lock().unwrap().off_us = None;
}

/// Cuts beneath a load, `rounds` times.
fn trial(figures: &mut Figures, client: &Client, load: &Load, ground: u32, rounds: u64) {
    // From now on the most memory is that of this load.
    let _ = std::fs::write(format!("/proc/{ground}/clear_refs"), "5");
    let seen = watch(client);
    let running = (load.begin)(client);
    std::thread::sleep(SETTLE);
    let (mut motors_off, mut noticed, mut refused) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..rounds {
        arm(client, &seen);
        let begun_us = now_us();
        let begun = Instant::now();
        // The answer is waited for elsewhere: what counts is the vehicle.
        let asking = client.clone();
        let asked = std::thread::spawn(move || asking.command("cut", &json!({})));
        let off = loop {
            if let Some(off) = seen.lock().unwrap().off_us {
                break Some(off);
            }
            if begun.elapsed() > GIVEN_UP {
                break None;
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        let given_up = begun_us + GIVEN_UP.as_micros() as i64;
        let (off_us, noticed_us) = off.unwrap_or((given_up, given_up));
        motors_off.push((off_us - begun_us) as f64 * 1e-3);
        noticed.push((noticed_us - begun_us) as f64 * 1e-3);
        let answer = asked.join().unwrap();
        if answer.as_ref().is_none_or(|(status, _)| *status != 200) {
            refused.push(format!("{answer:?}"));
        }
    }
    let more = json!({
        "median_ms": quantile(&mut motors_off, 0.5), "worst_ms": quantile(&mut motors_off, 1.0), "n": rounds,
        "seen_p99_ms": quantile(&mut noticed, 0.99), "not_answered": refused,
    });
    let peak = peak_mib(ground);
    figures.at_most(&format!("peak_{}", load.name), peak, PEAK_MAX_MIB, "MiB", json!({}));
    figures.at_most(&format!("cut_p99_{}", load.name), quantile(&mut motors_off, 0.99), CUT_MAX_MS, "ms", more);
    drop(running);
}

pub fn run() -> std::process::ExitCode {
    let rounds = setting("PLUMBLINE_ROUNDS", 20);
    let only = std::env::var("PLUMBLINE_ONLY").unwrap_or_default();
    let chosen = |loads: &'static [Load]| loads.iter().filter(|load| load.name.contains(&only)).collect::<Vec<_>>();
    let mut figures = Figures::new("clients", setting("PLUMBLINE_SEED", 1));
    rlimit::increase_nofile_limit(u64::MAX).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(folder.path());
    options.port = free_port();
    let mut system = System::start(&options, &scenario("altitude_step")).unwrap();
    let data = options.data.join("ground");
    let accounts = Accounts::of(&data);
    accounts.add("pilot", Role::Operator, PASSWORD).unwrap();
    (0..CROWD).for_each(|n| accounts.add(&format!("crowd-{n}"), Role::Viewer, PASSWORD).unwrap());

    let client = Client::plain(system.api().address, &data, CROWD);
    let recording = wait_until(PATIENCE, || client.command("recording", &json!({ "on": true })).filter(|a| a.0 == 200));
    assert!(recording.is_some(), "no recording");
    for load in chosen(loads::PLAIN) {
        trial(&mut figures, &client, load, system.ground.process.id(), rounds);
    }

    // The same ground, as a network sees it; then one that may open few files.
    restart(&mut system, &options, &["--tls"], None);
    let client = Client::by_tls(system.api().address, &data, CROWD);
    back(&client);
    for load in chosen(loads::TLS) {
        trial(&mut figures, &client, load, system.ground.process.id(), rounds);
    }
    restart(&mut system, &options, &[], Some(SCARCE_FILES));
    let client = Client::plain(system.api().address, &data, CROWD);
    back(&client);
    for load in chosen(loads::SCARCE) {
        trial(&mut figures, &client, load, system.ground.process.id(), rounds);
    }
    let (_, ground) = client.get("/api/v1/ground", &client.pilot).expect("the ground");
    let ground: serde_json::Value = serde_json::from_str(&ground).expect("JSON");
    let silent = f64::from(u8::from(!ground["recording_error"].is_null()));
    figures.at_most("recording_stopped", silent, 0.0, "times", json!({ "said": ground["recording_error"] }));
    system.stop().unwrap();
    figures.finish()
}

/// Most memory that a process ever held, MiB.
fn peak_mib(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0");
    line.trim().trim_end_matches("kB").trim().parse::<f64>().unwrap_or(0.0) / 1024.0
}

/// Begins the ground again where it was, with other arguments, and with a bound on its open files.
fn restart(system: &mut System, options: &SystemOptions, arguments: &[&str], files: Option<u32>) {
    system.ground.process.interrupt(Duration::from_secs(20)).unwrap();
    let mut command = match files {
        None => Command::new(&options.binaries.ground),
        Some(files) => {
            let mut bounded = Command::new("prlimit");
            bounded.arg(format!("--nofile={files}:{files}")).arg(&options.binaries.ground);
            bounded
        }
    };
    command.args(arguments).arg("--data").arg(options.data.join("ground"));
    command.arg("--listen").arg(system.ground.api.address.to_string());
    command.arg("--agent-listen").arg(system.ground.link.to_string());
    system.ground.process = Process::start("ground", command, false).unwrap();
    let says = |line: &str| line.contains("Plumbline is at http").then_some(());
    system.ground.process.wait_for(PATIENCE, says).unwrap();
}

/// Waits for the vehicle to be connected again.
fn back(client: &Client) {
    let back = wait_until(PATIENCE, || {
        let (_, text) = client.get("/api/v1/vehicles", &client.pilot)?;
        text.contains("\"connected\":true").then_some(())
    });
    assert!(back.is_some(), "the vehicle has not come back");
}

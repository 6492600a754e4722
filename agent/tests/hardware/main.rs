//! The agent as a process on vehicles that are there, as far as it can tell.
//!
//! - [`wires`]: the simulator behind ports that speak each device's protocol.
//! - [`every`]: the same with a device of each driver.
//! - [`by_pose`], [`offboard`]: a double of a PX4 autopilot that keeps its rules of offboard mode ([`autopilot`]).
//! - [`stock`]: doubles of a stock PX4 and a stock ArduPilot that the simulator is flown by.
//!
//! Tests begin in the order of their names: of the doubles' flights, which take little of a processor and wait for one another, the
//! longest come first and the others between those through wires, which take much.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod autopilot;
mod by_pose;
mod every;
mod offboard;
#[path = "../../../tests/src/xtask/ports.rs"]
mod ports;
mod stock;
mod wires;

use std::ffi::OsString;
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

use plumbline_proto::{Message, v1};

/// Longest wait for anything, on a machine that compiles beside us.
const PATIENCE: Duration = Duration::from_secs(90);

/// Where it keeps calibrations.
const KEPT: &str = "kept";

/// An agent that flies a script without a ground.
struct Agent {
    process: Child,
    folder: tempfile::TempDir,
}

impl Agent {
    /// Flies the script of `scenario` in `folder` with these attacks, if any.
    fn start(folder: tempfile::TempDir, vehicle: &str, configuration: &str, scenario: &str, attacks: &str) -> Self {
        Self::start_with(folder, vehicle, configuration, scenario, attacks, &["--script"])
    }

    /// The same, told `options` as well, and the script only if they say so.
    fn start_with(
        folder: tempfile::TempDir,
        vehicle: &str,
        configuration: &str,
        scenario: &str,
        attacks: &str,
        options: &[&str],
    ) -> Self {
        let at = |name: &str| folder.path().join(name);
        // What somebody calibrated here is not flown with.
        let kept = format!("kept_calibrations = {:?}\n", at(KEPT));
        std::fs::write(at("agent.toml"), kept + configuration).unwrap();
        std::fs::write(at("scenario.toml"), scenario).unwrap();
        let mut agent = Command::new(env!("CARGO_BIN_EXE_plumbline-agent"));
        agent.args(["--vehicle", vehicle, "--ground", "none", "--config"]).arg(at("agent.toml")).args(options);
        agent.arg("--scenario").arg(at("scenario.toml"));
        agent.arg("--log").arg(at("log")).arg("--identity").arg(at("identity"));
        if !attacks.is_empty() {
            std::fs::write(at("attacks.toml"), attacks).unwrap();
            agent.arg("--attack-schedule").arg(at("attacks.toml"));
        }
        let process = agent.stderr(std::fs::File::create(at("said")).unwrap()).spawn().unwrap();
        Self { process, folder }
    }

    fn said(&self) -> String {
        said(self.folder.path())
    }

    fn ended(&mut self) -> Option<ExitStatus> {
        self.process.try_wait().unwrap()
    }

    /// Until it has ended.
    fn end(&mut self) -> ExitStatus {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.ended() {
                return status;
            }
            assert!(begun.elapsed() < PATIENCE, "does not end: {}", self.said());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// At once, and by no other process: what follows is timed.
    fn signal(&self, signal: i32) {
        let id = i32::try_from(self.process.id()).unwrap();
        // SAFETY: our own child, not yet waited for, so the number is still its.
        let sent = unsafe { libc::kill(id, signal) };
        assert_eq!(sent, 0, "{}", std::io::Error::last_os_error());
    }

    /// Until it has said `text`.
    fn wait_said(&mut self, text: &str) {
        self.wait(text, |agent| agent.said().contains(text));
    }

    /// Until it records a flight.
    fn wait_recording(&mut self) {
        let log = self.folder.path().join("log");
        let is_flight = |file: std::fs::DirEntry| file.path().extension().is_some_and(|e| e == "mcap");
        self.wait("flight file", |_| log.read_dir().is_ok_and(|files| files.flatten().any(is_flight)));
    }

    fn wait(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = Instant::now();
        loop {
            // First: what it said last counts.
            let ended = self.ended();
            if done(self) {
                return;
            }
            assert!(begun.elapsed() < PATIENCE && ended.is_none(), "no {what:?}, {ended:?}: {}", self.said());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Has its reader lost the device of that name?
    fn lost(&self, name: &str) -> bool {
        self.said().lines().any(|line| line.contains("device lost") && line.contains(name))
    }

    /// How often devices came up.
    fn ups(&self) -> usize {
        self.said().matches("device up").count()
    }

    /// Messages of one topic of the flight file.
    fn recorded<M: Message + Default>(&self, topic: &str) -> Vec<M> {
        let files = std::fs::read_dir(self.folder.path().join("log")).unwrap().flatten().map(|entry| entry.path());
        let file = files.filter(|path| path.extension().is_some_and(|e| e == "mcap")).max();
        let bytes = std::fs::read(file.unwrap_or_else(|| panic!("no flight file: {}", self.said()))).unwrap();
        let stream = mcap::MessageStream::new(&bytes);
        let stream = stream.unwrap_or_else(|error| panic!("a file of {} B, {error}: {}", bytes.len(), self.said()));
        let messages = stream.map(Result::unwrap);
        messages.filter(|m| m.channel.topic == topic).map(|m| M::decode(&*m.data).unwrap()).collect()
    }

    /// The flight file has an event with each of these texts.
    fn assert_told(&self, texts: &[&str]) {
        let events: Vec<v1::Event> = self.recorded("/event");
        for text in texts {
            assert!(events.iter().any(|event| event.text.contains(text)), "{text}: {events:#?}");
        }
    }
}

fn udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A Python with pymavlink; where there is none, `what` is told to be skipped.
fn pymavlink(what: &str) -> Option<OsString> {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import pymavlink"]).output().is_ok_and(|ran| ran.status.success());
    if !has {
        plumbline_agent::recordings::skipped(&format!("{what}: no Python with pymavlink"));
    }
    has.then_some(python)
}

fn said(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("said")).unwrap_or_default()
}

impl Drop for Agent {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

//! Kills ground and agent at random moments in flight and looks at what is left.
//!
//! A viewer notes which messages were delivered, and when. After a kill the victim's files are read as they lie on the
//! disk, before anything repairs or refills them: every message of a flight that had been delivered for longer than a
//! flush takes must be there. Then the victim is started again, on the same folder, and the index must agree with the
//! files. At the end all files are opened by the third-party reader.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plumbline_proto::{Kind, v1};
use plumbline_tests::harness::radio::Chance;
use plumbline_tests::harness::{Agent, Ground, SystemOptions, wait_until};
use serde_json::{Value, json};

use crate::files;
use crate::system::{Live, PATIENCE, scenario};

/// What was found.
#[derive(Debug, Default)]
pub struct Tally {
    /// Rounds flown.
    pub rounds: u64,
    /// Times that the ground was killed.
    pub ground_kills: u64,
    /// Times that the agent was killed.
    pub agent_kills: u64,
    /// Rounds in which the vehicle was armed when something was killed.
    pub in_flight: u64,
    /// Age of the oldest message that a kill of the ground cost, when it was killed, ms; one entry a kill.
    pub ground_tails_ms: Vec<f64>,
    /// The same of the agent.
    pub agent_tails_ms: Vec<f64>,
    /// Files that the third-party reader opened.
    pub opened: usize,
    /// What should not be.
    pub faults: Vec<String>,
}

/// A viewer's notes on one boot of the agent.
#[derive(Debug, Default)]
struct Notes {
    /// Arrival of each live message.
    arrivals: BTreeMap<u64, Instant>,
    /// Last sequence number and id of each flight announced, by its first.
    flights: BTreeMap<u64, (Option<u64>, String)>,
    armed: bool,
}

/// Somebody who watches and takes notes.
pub struct Viewer {
    notes: Arc<Mutex<Notes>>,
    ended: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Viewer {
    /// Watches the vehicle of `ground` from now on.
    pub fn of(ground: &Ground) -> Self {
        let (notes, ended) = (Arc::new(Mutex::new(Notes::default())), Arc::new(AtomicBool::new(false)));
        let mut live = Live::connect(&ground.api, "/api/v1/vehicles/iris-1/live?history=0");
        let thread = {
            let (notes, ended) = (notes.clone(), ended.clone());
            std::thread::spawn(move || {
                // Ends with the ground.
                while let Some(frame) = live.try_frame().filter(|_| !ended.load(Ordering::Relaxed)) {
                    let mut notes = notes.lock().unwrap();
                    if let Some(mark) = frame.message::<v1::FlightMark>(Kind::Flight) {
                        notes.flights.insert(mark.first_sequence, (mark.last_sequence, mark.flight_id));
                    }
                    if let Some(status) = frame.message::<v1::Status>(Kind::Status) {
                        notes.armed = status.armed;
                        // Its opening mark came before this viewer.
                        let known = notes.flights.values().any(|(_, id)| *id == status.flight_id);
                        if !known && !status.flight_id.is_empty() && frame.sequence > 0 {
                            notes.flights.insert(frame.sequence, (None, status.flight_id));
                        }
                    }
                    if frame.sequence > 0 {
                        notes.arrivals.entry(frame.sequence).or_insert_with(Instant::now);
                    }
                }
            })
        };
        Self { notes, ended, thread: Some(thread) }
    }
}

impl Viewer {
    /// Age at `killed` of the oldest delivered message of a flight that `folder` does not hold, ms.
    ///
    /// # Errors
    /// No message of any flight was delivered: nothing can be said.
    pub fn lost(&self, folder: &Path, killed: Instant) -> Result<f64, String> {
        lost(&self.notes.lock().unwrap(), folder, killed)
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Runs `rounds` kills chosen by `seed` in the folder of `options`, whose port must be fixed.
pub fn run(options: &SystemOptions, rounds: u64, seed: u64) -> Tally {
    let mut chance = Chance(seed);
    let mut tally = Tally::default();
    let mut ground = Ground::start(options).unwrap();
    let mut agent = Agent::start(options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    let flights = options.data.join("ground/flights");
    let log = options.data.join("iris-1/log");
    for round in 0..rounds {
        let viewer = Viewer::of(&ground);
        fly(&ground);
        std::thread::sleep(Duration::from_millis(300 + (1_500.0 * chance.draw()) as u64));
        let (kill_ground, kill_agent) = match chance.draw() {
            x if x < 0.45 => (true, false),
            x if x < 0.9 => (false, true),
            _ => (true, true),
        };
        tally.rounds += 1;
        tally.in_flight += u64::from(viewer.notes.lock().unwrap().armed);
        if kill_ground {
            let killed = Instant::now();
            ground.process.kill();
            tally.ground_kills += 1;
            match viewer.lost(&flights, killed) {
                Ok(tail_ms) => tally.ground_tails_ms.push(tail_ms),
                Err(fault) => tally.faults.push(format!("round {round}, ground killed: {fault}")),
            }
        }
        if kill_agent {
            let killed = Instant::now();
            agent.process.kill();
            tally.agent_kills += 1;
            match viewer.lost(&log, killed) {
                Ok(tail_ms) => tally.agent_tails_ms.push(tail_ms),
                Err(fault) => tally.faults.push(format!("round {round}, agent killed: {fault}")),
            }
        }
        drop(viewer);
        if kill_ground {
            ground = Ground::start(options).unwrap();
        }
        if kill_agent {
            // Until the new one has said hello the ground shows the old one.
            let boot =
                |ground: &Ground| ground.api.get_json("/api/v1/vehicles").ok().map(|list| list[0]["boot_id"].clone());
            let old = boot(&ground);
            agent = Agent::start(options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
            let new = || (kill_ground || boot(&ground) != old).then_some(());
            wait_until(PATIENCE, new).expect("the agent's new self");
        } else {
            agent.wait_until_connected(&ground.api).unwrap();
        }
        if let Err(fault) = consistent(&ground, &flights) {
            tally.faults.push(format!("round {round}: {fault}"));
        }
    }
    agent.process.interrupt(PATIENCE).unwrap();
    ground.process.interrupt(PATIENCE).unwrap();
    let all: Vec<_> =
        [&flights, &log].into_iter().flat_map(|folder| files::paths(folder, |name| name.ends_with(".mcap"))).collect();
    let left = files::paths(&flights, |name| name.ends_with(".part") || name.ends_with(".corrupt"));
    if !left.is_empty() {
        tally.faults.push(format!("left behind after an orderly end: {left:?}"));
    }
    for path in &all {
        if !files::finished(&std::fs::read(path).unwrap()) {
            tally.faults.push(format!("{} is not finished", path.display()));
        }
    }
    match opened_by_python(&all) {
        Some(Ok(opened)) => tally.opened = opened,
        Some(Err(fault)) => tally.faults.push(fault),
        None => {}
    }
    tally
}

/// Records by hand at once, and flies as soon as the vehicle lets itself be armed.
pub fn fly(ground: &Ground) {
    let command = |route: &str, body: Value| {
        let reply = ground.api.send("POST", &format!("/api/v1/vehicles/iris-1/{route}"), &body);
        reply.is_ok_and(|reply| reply.status == 200)
    };
    wait_until(PATIENCE, || command("recording", json!({ "on": true })).then_some(())).expect("recording");
    // Armed already, or landed after the ground was away: either is a flight.
    wait_until(Duration::from_secs(8), || {
        let armed = ground.api.get_json("/api/v1/vehicles").ok()?[0]["armed"] == true;
        (armed || command("arm", json!({}))).then_some(())
    });
    if command("mode", json!({ "mode": "altitude_hold" })) {
        command("setpoint", json!({ "altitude_m": 0.5 }));
    }
}

/// Age at the kill of the oldest delivered message of a flight that `folder` does not hold, ms.
fn lost(notes: &Notes, folder: &Path, killed: Instant) -> Result<f64, String> {
    let mut delivered = 0;
    let mut oldest = Duration::ZERO;
    for (first, (last, id)) in &notes.flights {
        let held = files::messages_of(folder, id);
        for (sequence, arrived) in notes.arrivals.range(first..=&last.unwrap_or(u64::MAX)) {
            delivered += 1;
            if !held.contains_key(&(*sequence as u32)) {
                oldest = oldest.max(killed.saturating_duration_since(*arrived));
            }
        }
    }
    if delivered == 0 {
        return Err("no message of any flight was delivered".into());
    }
    Ok(oldest.as_secs_f64() * 1e3)
}

/// Does the index say what the files hold?
///
/// # Errors
/// Where they differ.
pub fn consistent(ground: &Ground, folder: &Path) -> Result<(), String> {
    let listed = wait_until(PATIENCE, || {
        let list = ground.api.get_json("/api/v1/flights?limit=1000").ok()?;
        (list["ready"] == true).then(|| list["flights"].as_array().cloned().unwrap_or_default())
    });
    let listed = listed.ok_or("the ground does not become ready")?;
    let ids: Vec<&str> = listed.iter().filter_map(|flight| flight["id"].as_str()).collect();
    for path in files::paths(folder, |name| name.ends_with(".mcap")) {
        let id = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let Some(flight) = listed.iter().find(|flight| flight["id"] == id) else {
            return Err(format!("{id} is not in the index: {ids:?}"));
        };
        // What is being completed changes under our eyes.
        if flight["completeness"] != "complete" {
            continue;
        }
        let held = files::messages(&std::fs::read(&path).map_err(|e| e.to_string())?).len() as u64;
        if flight["messages"] != held || flight["missing"] != 0 {
            return Err(format!("the index says {flight}, the file holds {held} messages"));
        }
    }
    Ok(())
}

/// Opens all files with the third-party reader; `None` where it is not there.
///
/// # Errors
/// The first that it does not open.
pub fn opened_by_python(paths: &[std::path::PathBuf]) -> Option<Result<usize, String>> {
    let python = files::python()?;
    let opened = paths.iter().try_for_each(|path| files::counts_by(&python, path).map(drop));
    Some(opened.map(|()| paths.len()))
}

//! The power fails in flight: ground and agent write to a file system of their own, and at a random moment what its
//! device holds is copied. Bytes that only the kernel knew are gone, names in folders as well. `PLUMBLINE_ROUNDS` of it.
//!
//! Both programs are stopped (SIGSTOP) and what they had begun to sync is waited for before the copy is made, so that it is
//! one moment's; ages are counted to the copy. Then both start on it: what is left must be repaired, open in the
//! third-party reader and agree with the index. The disk is in memory: a real one adds the time it takes to sync.

use std::path::Path;
use std::time::{Duration, Instant};

use super::disk::Disk;
use super::figures::{Figures, quantile, setting};
use plumbline_support::system::{PATIENCE, free_port, options, scenario};
use plumbline_support::{files, kill};
use plumbline_tests::harness::radio::Chance;
use plumbline_tests::harness::{Agent, Ground, SystemOptions};
use serde_json::json;

/// The promise: at most the last flush.
const TAIL_MAX_MS: f64 = 250.0;

/// Do all threads of a process stand still?
fn stopped(id: u32) -> bool {
    let state = |thread: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        stat.rsplit(") ").next().and_then(|rest| rest.chars().next())
    };
    std::fs::read_dir(format!("/proc/{id}/task")).unwrap().flatten().all(|thread| state(thread) == Some('T'))
}

pub fn run() -> std::process::ExitCode {
    let (rounds, seed) = (setting("PLUMBLINE_ROUNDS", 20), setting("PLUMBLINE_SEED", 1));
    let mut figures = Figures::new("power", seed);
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let options = SystemOptions { port: free_port(), ..options(&data) };
    let (flights, log) = (data.join("ground/flights"), data.join("iris-1/log"));
    let mut chance = Chance(seed);
    let (mut ground_ms, mut agent_ms, mut faults, mut opened) = (Vec::new(), Vec::new(), Vec::<String>::new(), 0);
    let mut disk = match Disk::mount(&data) {
        Ok(disk) => disk,
        Err(reason) => {
            figures.skip("power", &reason);
            return figures.finish();
        }
    };
    let vehicle = scenario("altitude_step");
    for round in 0..rounds {
        let mut ground = Ground::start(&options).unwrap();
        let mut agent = Agent::start(&options, "iris-1", &vehicle, &ground).unwrap();
        // Who trusts whom was written by the test, which promises nothing.
        disk.sync();
        let viewer = kill::Viewer::of(&ground);
        kill::fly(&ground);
        std::thread::sleep(Duration::from_millis(300 + (2_500.0 * chance.draw()) as u64));
        let processes = [&ground.process, &agent.process];
        processes.iter().for_each(|process| process.signal(libc::SIGSTOP));
        let asked = Instant::now();
        while !processes.iter().all(|process| stopped(process.id())) {
            assert!(asked.elapsed() < PATIENCE, "not stopped");
            std::thread::sleep(Duration::from_millis(1));
        }
        let cut = Instant::now();
        let image = Disk::image(round + 1);
        disk.copy_to(&image);
        ground.process.kill();
        agent.process.kill();
        drop((ground, agent, disk));
        disk = Disk::of(&image, &data).expect("the copy is a file system");
        for (side, folder, tails) in [("ground", &flights, &mut ground_ms), ("agent", &log, &mut agent_ms)] {
            match viewer.lost(folder, cut) {
                Ok(tail_ms) => tails.push(tail_ms),
                Err(fault) => faults.push(format!("round {round}, {side}: {fault}")),
            }
        }
        drop(viewer);
        match restarted(&options, &flights, &log) {
            Ok(files) => opened += files,
            Err(fault) => faults.push(format!("round {round}: {fault}")),
        }
    }
    for (name, tails) in [("ground", &mut ground_ms), ("agent", &mut agent_ms)] {
        let (median, most) = (quantile(tails, 0.5), quantile(tails, 1.0));
        let more = json!({ "median": median.round(), "cuts": tails.len() });
        figures.at_most(&format!("{name}_oldest_lost"), most, TAIL_MAX_MS, "ms", more);
    }
    figures.tell("opened_by_python", opened as f64, "files", json!({ "rounds": rounds }));
    figures.at_most("faults", faults.len() as f64, 0.0, "faults", json!({ "first": faults.first() }));
    faults.iter().for_each(|fault| eprintln!("{fault}"));
    figures.finish()
}

/// Starts both on what is left, lets them repair it and looks at every file.
fn restarted(options: &SystemOptions, flights: &Path, log: &Path) -> Result<usize, String> {
    let mut ground = Ground::start(options).map_err(|error| error.to_string())?;
    let vehicle = scenario("altitude_step");
    let mut agent = Agent::start(options, "iris-1", &vehicle, &ground).map_err(|error| error.to_string())?;
    kill::consistent(&ground, flights)?;
    agent.process.interrupt(PATIENCE).map_err(|error| error.to_string())?;
    ground.process.interrupt(PATIENCE).map_err(|error| error.to_string())?;
    let paths = |folder: &Path| files::paths(folder, |name| name.ends_with(".mcap"));
    let all = [paths(flights), paths(log)].concat();
    if let Some(left) = all.iter().find(|path| !files::finished(&std::fs::read(path).unwrap())) {
        return Err(format!("{} is not finished", left.display()));
    }
    kill::opened_by_python(&all).unwrap_or(Ok(0))
}

//! `plumbline-wires FOLDER [SCENARIO] [usual|every|others]`: the wire rig until it is ended, and the configuration that flies
//! it; `every` has a device of each driver, `others` the other ways to the same.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use plumbline_devices::scheduling;
use plumbline_sim::Scenario;
use plumbline_wires::{WireRig, Wiring};

fn main() -> ExitCode {
    let mut arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let named = |last: &PathBuf| match last.to_str() {
        Some("usual") => Some(Wiring::usual()),
        Some("every") => Some(Wiring::every()),
        Some("others") => Some(Wiring::others()),
        _ => None,
    };
    let wiring = arguments.last().filter(|_| arguments.len() > 1).and_then(named);
    if wiring.is_some() {
        arguments.pop();
    }
    let wiring = wiring.unwrap_or_else(Wiring::usual);
    let outcome = match arguments.as_slice() {
        [folder] => run(folder, None, &wiring),
        [folder, scenario] => run(folder, Some(scenario), &wiring),
        _ => Err("usage: plumbline-wires FOLDER [SCENARIO] [usual|every|others]".into()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("plumbline-wires: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(folder: &Path, scenario: Option<&PathBuf>, wiring: &Wiring) -> Result<(), Box<dyn Error>> {
    let scenario = match scenario {
        Some(file) => Scenario::from_toml(&std::fs::read_to_string(file)?)?,
        None => Scenario::default_string_rig(),
    };
    std::fs::create_dir_all(folder)?;
    let folder = folder.canonicalize()?;
    // The world and its devices keep their time under any load, as real ones do; their threads have this one's priority.
    scheduling::ask_for_real_time(scheduling::FLIGHT);
    let rig = WireRig::start(&scenario, &folder, wiring)?;
    let file = folder.join("agent.toml");
    std::fs::write(&file, rig.configuration())?;
    println!("plumbline-agent --vehicle hardware --config {}", file.display());
    ended()?;
    drop(rig);
    Ok(())
}

/// Waits for Ctrl-C or a request to terminate.
fn ended() -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(async {
        let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        Ok(())
    })
}

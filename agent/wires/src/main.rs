//! `plumbline-wires FOLDER [SCENARIO]`: the wire rig until it is ended, and the configuration that flies it.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use plumbline_devices::scheduling;
use plumbline_sim::Scenario;
use plumbline_wires::WireRig;

fn main() -> ExitCode {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let outcome = match arguments.as_slice() {
        [folder] => run(folder, None),
        [folder, scenario] => run(folder, Some(scenario)),
        _ => Err("usage: plumbline-wires FOLDER [SCENARIO]".into()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("plumbline-wires: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(folder: &Path, scenario: Option<&PathBuf>) -> Result<(), Box<dyn Error>> {
    let scenario = match scenario {
        Some(file) => Scenario::from_toml(&std::fs::read_to_string(file)?)?,
        None => Scenario::default_string_rig(),
    };
    std::fs::create_dir_all(folder)?;
    let folder = folder.canonicalize()?;
    // The world and its devices keep their time under any load, as real ones do; their threads have this one's priority.
    scheduling::ask_for_real_time(scheduling::FLIGHT);
    let rig = WireRig::start(&scenario, &folder)?;
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

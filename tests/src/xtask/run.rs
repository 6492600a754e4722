//! `cargo xtask run`: the whole product with a simulated quadrotor on strings, from nothing.

use std::path::PathBuf;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use super::progress::Progress;
use super::{Workspace, XtaskError, signals, web};
use crate::harness::{Binaries, System, SystemOptions, Vehicle};

const POLL: Duration = Duration::from_millis(100);
/// The agent itself gives a landing no longer than a minute.
const LANDING_MAX: Duration = Duration::from_secs(75);

/// What to run.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Fly this recording again instead of simulating.
    #[arg(long, value_name = "FILE", conflicts_with = "scenario")]
    pub replay: Option<PathBuf>,
    /// Speed of the replay, times real time; 0 begins standing still, `max` is as fast as possible.
    #[arg(long, default_value = "1", requires = "replay")]
    pub speed: String,
    /// Scenario to simulate; the default is the quadrotor hanging on four strings.
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Fly the simulator through the drivers of real devices: it speaks their protocols on ports of its own. `every` has a device of
    /// each driver, `others` the other ways to the same.
    #[arg(long, value_name = "RIG", conflicts_with = "replay", num_args = 0..=1, default_missing_value = USUAL_WIRING)]
    #[arg(value_parser = [USUAL_WIRING, "every", "others"])]
    pub wires: Option<String>,
    /// Port of the page; agents connect to the next one (UDP).
    #[arg(long, default_value_t = 4747)]
    pub port: u16,
    /// Where flights, identities and onboard logs are kept.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Build page and programs as they are released; otherwise only what flies and estimates is optimised.
    #[arg(long)]
    pub release: bool,
}

/// Builds, starts, and stays until Ctrl-C or until one of the programs ends.
///
/// # Errors
/// What could not be built or started, or which program ended by itself.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let vehicle = match (&options.replay, &options.scenario) {
        (Some(file), _) => Vehicle::Replayed { file: absolute(file)?, speed: options.speed.clone() },
        (None, scenario) => {
            let own = || Ok(workspace.root.join(DEFAULT_SCENARIO));
            let scenario = scenario.as_deref().map_or_else(own, absolute)?;
            match options.wires.clone() {
                Some(wiring) => Vehicle::OnWires { scenario, wiring },
                None => Vehicle::Simulated { scenario },
            }
        }
    };
    let folder = build(workspace, options)?;

    signals::catch();
    let data = options.data.clone().unwrap_or_else(|| workspace.root.join("data"));
    let system_options = SystemOptions {
        binaries: Binaries::inside(&workspace.target.join(folder)),
        data,
        port: options.port,
        echo: true,
    };
    let mut system = System::start(&system_options, &vehicle)?;
    println!("\n  Plumbline is at  http://{}\n  Ctrl-C stops everything.\n", system.api().address);
    while !signals::interrupted() {
        let ended = [&mut system.ground.process, &mut system.agent.process]
            .into_iter()
            .chain(system.agent.rig.as_mut())
            .find_map(|process| process.ended().map(|status| (process.name.clone(), status)));
        if let Some((name, status)) = ended {
            let _ = system.stop();
            return Err(XtaskError::Other(format!("{name} ended by itself with {status}")));
        }
        std::thread::sleep(POLL);
    }
    eprintln!("xtask: stopping; a vehicle in flight lands first, Ctrl-C again cuts its motors");
    system.agent.process.signal(libc::SIGINT);
    let (begun, mut cut) = (Instant::now(), false);
    while system.agent.process.ended().is_none() && begun.elapsed() < LANDING_MAX {
        if signals::interrupts() > 1 && !cut {
            system.agent.process.signal(libc::SIGINT);
            cut = true;
        }
        std::thread::sleep(POLL);
    }
    system.stop()
}

/// Builds the page, its bundler and the programs side by side; programs as they are released hold the page, and wait for it.
///
/// Returns the folder of the programs below the target folder.
fn build(checkout: &Workspace, options: &Options) -> Result<&'static str, XtaskError> {
    let (profile, folder) = if options.release { ("release", "release") } else { ("dev", "debug") };
    let mut cargo = checkout.cargo();
    cargo.args(["build", "--locked", "--bins", "--profile", profile]);
    cargo.args(["--package", "plumbline-ground", "--package", "plumbline-agent"]);
    if options.wires.is_some() {
        cargo.args(["--package", "plumbline-wires"]);
    }
    let progress = Progress::new();
    let page = web::Options { dev: !options.release, wasm: None };
    if options.release {
        web::run(checkout, &page)?;
        progress.build("programs", &mut cargo, |_, _| {})?;
        return Ok(folder);
    }
    cargo.args(["--package", web::BUNDLER]);
    let (made, bundler) = mpsc::channel();
    std::thread::scope(|scope| {
        let programs = scope.spawn(|| {
            progress.build("programs", &mut cargo, move |target, file| {
                if target == web::BUNDLER {
                    // Nobody waits for it where the page could not be compiled.
                    let _ = made.send(file.to_owned());
                }
            })
        });
        let missing = |_| XtaskError::Other(format!("{} was not built", web::BUNDLER));
        let page = web::build(checkout, &page, &progress, || bundler.recv().map_err(missing));
        let panicked = |_| Err(XtaskError::Other("the build of the programs ended in a panic".into()));
        programs.join().unwrap_or_else(panicked).and(page)
    })?;
    Ok(folder)
}

/// The wire rig with the devices of the string rig's suite.
pub const USUAL_WIRING: &str = "usual";
/// The quadrotor hanging on four strings.
pub const DEFAULT_SCENARIO: &str = "tests/scenarios/altitude_step.toml";

fn absolute(file: &std::path::Path) -> Result<PathBuf, XtaskError> {
    std::fs::canonicalize(file).map_err(XtaskError::file(file))
}

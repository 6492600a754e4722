//! The scripted browser: the page as a user has it, driven by role and label.

use std::collections::BTreeSet;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;

use serde_json::Value;

use super::ports::{PORTS_LATE, Ports, WIRE_FLIGHTS};
use super::run::{DEFAULT_SCENARIO, USUAL_WIRING};
use super::tally::Tally;
use super::test::run_and_read;
use super::{Workspace, XtaskError, tools};
use crate::harness::{Api, Binaries, Ground, System, SystemOptions, Vehicle};

/// They measure how fast a page is: no other browser runs beside them.
const MEASURING: [&str; 3] = ["fly.mjs", "hidden.mjs", "trust.mjs"];
/// They fly the same vehicle, and wait for it more than for anything else.
const FLYING: [&str; 5] = ["reports.mjs", "signals.mjs", "envelope.mjs", "axe.mjs", "foxglove.mjs"];
/// Reads what was recorded meanwhile.
const FILES: &str = "mcap.mjs";
/// Flies the wire rig.
const WIRES: &str = "wires.mjs";

/// What is flown, how, and the script beside it.
type Part = (&'static str, fn(&Workspace, &[&str], &mut Tally) -> Result<(), XtaskError>, &'static str);

/// Starts ground and simulated vehicle, lets `tests/browser/fly.mjs` work the page, `hidden.mjs` hide it and `trust.mjs`
/// try to mislead it, `reports.mjs` and `signals.mjs` look into flights with it, `envelope.mjs` has attacks prepared, `axe.mjs` look for what keeps people out and `foxglove.mjs`
/// watch as Foxglove does, counts their steps, and has `mcap.mjs` read both sides' files; beside those that measure nothing a vehicle
/// that holds its position with `hold.mjs`, one whose battery empties with `battery.mjs`, a recording flown again with `replay.mjs`, one of
/// a sensor in somebody's hands with `guided.mjs`, every page beside its pictures with `looks.mjs` and accounts on a ground of their own
/// with `people.mjs`; then the drivers of real devices with `wires.mjs`.
///
/// Of the scripts only those that `chosen` names, if it names any.
/// With `PLUMBLINE_SHOTS=1` they leave pictures of what they pass by in `target/screenshots`; one of a step that fails lies there always.
pub fn test(workspace: &Workspace, chosen: &[String], tally: &mut Tally) {
    let beside: [Part; 6] = [
        ("a vehicle under motion capture", hold, "hold.mjs"),
        ("a small battery", battery, "battery.mjs"),
        ("a replay", replay, "replay.mjs"),
        ("a sensor in somebody's hands", hands, "guided.mjs"),
        ("a recording that stands still", looks, "looks.mjs"),
        ("a ground with accounts", people, "people.mjs"),
    ];
    let alone: [Part; 1] = [("the wire rig", wires, WIRES)];
    let others = beside.iter().chain(&alone).map(|(.., script)| *script);
    let all: Vec<&str> = MEASURING.into_iter().chain(FLYING).chain([FILES]).chain(others).collect();
    for unknown in chosen.iter().filter(|name| !all.contains(&name.as_str())) {
        tally.check::<(), _>("browser", Err(format!("there is no script {unknown:?}")));
    }
    let wanted = |script: &str| chosen.is_empty() || chosen.iter().any(|one| one == script);
    // Found before anybody looks for them at the same time as somebody else; what cannot be had is told by each who wants it.
    let _ = (tools::browser(workspace), tools::python(workspace));
    let each = |parts: &[Part], tally: &mut Tally| {
        for (what, part, script) in parts.iter().filter(|(.., script)| wanted(script)) {
            let outcome = part(workspace, &[*script], tally);
            tally.check(&format!("browser: {what} starts and stops cleanly"), outcome);
        }
    };
    let counted = std::thread::scope(|scope| {
        let (measured, begin) = mpsc::channel();
        let beside = scope.spawn(move || {
            let mut tally = Tally::silent();
            // Nothing is sent: it ends once nobody could.
            let _ = begin.recv();
            each(&beside, &mut tally);
            tally
        });
        if [&MEASURING[..], &FLYING, &[FILES]].concat().into_iter().any(wanted) {
            let outcome = fly(workspace, wanted, measured, tally);
            tally.check("browser: system starts and stops cleanly", outcome);
        } else {
            drop(measured);
        }
        beside.join()
    });
    match counted {
        Ok(mut counted) => tally.take_over(&mut counted),
        Err(_) => drop(tally.check::<(), _>("browser", Err("ended in a panic"))),
    }
    each(&alone, tally);
}

/// Runs `scripts` beside a system that flies `vehicle`, and stops it.
fn with(
    workspace: &Workspace,
    options: &SystemOptions,
    vehicle: &Vehicle,
    scripts: &[&str],
    tally: &mut Tally,
) -> Result<(), XtaskError> {
    let system = System::start(options, vehicle)?;
    let read = run_all(workspace, scripts, system.api(), tally);
    let stopped = system.stop();
    read.and(stopped)
}

/// Flies the wire rig. Its ports are pseudo terminals, which the kernel's workers serve after everything else on a busy
/// machine: a flight that fails while another such port was late is none, and is flown again. Where all of them fail at the same
/// step, it is not the ports.
fn wires(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    let vehicle = Vehicle::OnWires { scenario: workspace.root.join(DEFAULT_SCENARIO), wiring: USUAL_WIRING.to_owned() };
    let mut failed_at = BTreeSet::new();
    for flight in 1..=WIRE_FLIGHTS {
        let ports = Ports::watch().map_err(XtaskError::file("a pseudo terminal"))?;
        let mut counted = Tally::silent();
        let flown = options(workspace, "debug", "browser-wires")
            .and_then(|options| with(workspace, &options, &vehicle, scripts, &mut counted));
        let late = ports.worst();
        eprintln!("xtask: browser: a port beside the wire rig's was {} ms late at most", late.as_millis());
        let error = || flown.as_ref().err().map(ToString::to_string).unwrap_or_default();
        failed_at.insert(counted.first_failed().map_or_else(error, str::to_owned));
        if flown.is_ok() || late < PORTS_LATE || (flight == WIRE_FLIGHTS && failed_at.len() == 1) {
            tally.take_over(&mut counted);
            return flown;
        }
        eprintln!("xtask: browser: flight {flight} of {WIRE_FLIGHTS} of the wire rig is none");
    }
    eprintln!("xtask: skipped: browser: the wire rig: this machine serves its ports too late");
    tally.skip(1, &BTreeSet::new());
    Ok(())
}

fn hold(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    simulated(workspace, "browser-hold", "circle", scripts, tally)
}

fn battery(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    simulated(workspace, "browser-battery", "small_battery", scripts, tally)
}

/// Runs `scripts` beside a simulated vehicle under this scenario.
fn simulated(
    workspace: &Workspace,
    name: &str,
    scenario: &str,
    scripts: &[&str],
    tally: &mut Tally,
) -> Result<(), XtaskError> {
    let vehicle = Vehicle::Simulated { scenario: workspace.root.join(format!("tests/scenarios/{scenario}.toml")) };
    with(workspace, &options(workspace, "debug", name)?, &vehicle, scripts, tally)
}

fn people(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    alone(workspace, &options(workspace, "debug", "browser-people")?, scripts, tally)
}

/// Runs `scripts` beside a ground without a vehicle, and stops it.
fn alone(
    workspace: &Workspace,
    options: &SystemOptions,
    scripts: &[&str],
    tally: &mut Tally,
) -> Result<(), XtaskError> {
    let mut ground = Ground::start(options)?;
    let read = run_all(workspace, scripts, &ground.api, tally);
    let stopped = ground.process.interrupt(std::time::Duration::from_secs(10)).map(drop);
    read.and(stopped)
}

fn replay(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    recorded(workspace, "browser-replay", "1", scripts, tally)
}

fn looks(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    recorded(workspace, "browser-looks", "0", scripts, tally)
}

/// Records the scripted flight without a ground, as fast as it goes, and flies it again at this speed.
fn recorded(
    workspace: &Workspace,
    name: &str,
    speed: &str,
    scripts: &[&str],
    tally: &mut Tally,
) -> Result<(), XtaskError> {
    let options = options(workspace, "debug", name)?;
    let log = options.data.join("recorded");
    let mut agent = Command::new(&options.binaries.agent);
    agent.args(["--vehicle", "sim", "--script", "--ground", "none", "--speed", "max", "--scenario"]);
    agent.arg(workspace.root.join(DEFAULT_SCENARIO)).arg("--log").arg(&log);
    agent.arg("--identity").arg(options.data.join("recorder"));
    super::workspace::run(&mut agent)?;
    let file = newest_flight(&log)?;
    with(workspace, &options, &Vehicle::Replayed { file, speed: speed.into() }, scripts, tally)
}

/// Makes a recording of a sensor that is turned by hand, and flies it again from a standstill.
fn hands(workspace: &Workspace, scripts: &[&str], tally: &mut Tally) -> Result<(), XtaskError> {
    let options = options(workspace, "debug", "browser-hands")?;
    std::fs::create_dir_all(&options.data).map_err(XtaskError::file(&options.data))?;
    let file = options.data.join("turned.csv");
    let mut maker = Command::new(tools::browser(workspace)?.node);
    super::workspace::run(maker.arg(workspace.root.join("tests/browser/turned.mjs")).arg(&file))?;
    with(workspace, &options, &Vehicle::Replayed { file, speed: "0".into() }, scripts, tally)
}

/// `measured` goes when others may run as well.
fn fly(
    workspace: &Workspace,
    wanted: impl Fn(&str) -> bool,
    measured: mpsc::Sender<()>,
    tally: &mut Tally,
) -> Result<(), XtaskError> {
    let options = options(workspace, "debug", "browser-test")?;
    let vehicle = Vehicle::Simulated { scenario: workspace.root.join(DEFAULT_SCENARIO) };
    let system = System::start(&options, &vehicle)?;
    let of = |scripts: &[&'static str]| scripts.iter().copied().filter(|script| wanted(script)).collect::<Vec<_>>();
    let fast = run_all(workspace, &of(&MEASURING), system.api(), tally);
    drop(measured);
    let read = fast.and(run_all(workspace, &of(&FLYING), system.api(), tally));
    let api = system.api().clone();
    let stopped = system.stop();
    if wanted(FILES) {
        // One file of each side, and what is exported for it, as Foxglove would open them.
        let mut reader = script(workspace, FILES, &api)?;
        let (flight, drawn) = (newest_flight(&options.data.join("ground/flights"))?, options.data.join("drawn"));
        let mut export = Command::new(&options.binaries.ground);
        super::workspace::run(export.args(["export", "--format", "foxglove", "--output"]).arg(&drawn).arg(&flight))?;
        reader.arg(flight).arg(newest_flight(&options.data.join("iris-1/log"))?).arg(newest_flight(&drawn)?);
        run_script(&mut reader, tally)?;
    }
    read.and(stopped)
}

/// A browser that root starts puts itself before everything else on the machine, the kernel's workers included that serve
/// the wire rig's ports; anybody else's may not.
fn as_anybody(script: &mut Command) {
    const CAP_SYS_NICE: libc::c_ulong = 23;
    // SAFETY: between fork and exec there is one system call, with plain numbers; without the right to drop it there is nothing to drop.
    unsafe {
        script.pre_exec(|| {
            libc::prctl(libc::PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0);
            Ok(())
        });
    }
}

/// Each of the scripts, whatever came of those before; the first failure.
fn run_all(workspace: &Workspace, scripts: &[&str], api: &Api, tally: &mut Tally) -> Result<(), XtaskError> {
    let python = tools::python(workspace)?;
    let mut all = Ok(());
    for name in scripts {
        let ran = script(workspace, name, api)
            .and_then(|mut script| run_script(script.env("PLUMBLINE_PYTHON", &python), tally));
        all = all.and(ran);
    }
    all
}

/// The last flight file of a folder.
fn newest_flight(folder: &Path) -> Result<PathBuf, XtaskError> {
    let files = std::fs::read_dir(folder).map_err(XtaskError::file(folder))?.flatten().map(|entry| entry.path());
    let flights = files.filter(|path| path.extension().is_some_and(|e| e == "mcap"));
    flights.max().ok_or_else(|| XtaskError::Other(format!("no flight was recorded in {}", folder.display())))
}

/// What flies beside a measured page.
#[derive(Debug, Clone, Copy)]
pub enum Beside {
    /// The simulated vehicle on its strings.
    Vehicle,
    /// The ground alone.
    Nothing,
}

/// Measures in a browser, by this script; needs the programs of the release build.
///
/// # Errors
/// Something was not measured.
pub fn bench(workspace: &Workspace, name: &str, beside: Beside) -> Result<(), XtaskError> {
    let options = options(workspace, "release", "browser-bench")?;
    let mut tally = Tally::silent();
    match beside {
        Beside::Vehicle => {
            let vehicle = Vehicle::Simulated { scenario: workspace.root.join(DEFAULT_SCENARIO) };
            with(workspace, &options, &vehicle, &[name], &mut tally)
        }
        Beside::Nothing => alone(workspace, &options, &[name], &mut tally),
    }
}

fn options(workspace: &Workspace, folder: &str, name: &str) -> Result<SystemOptions, XtaskError> {
    let data = workspace.target.join(name);
    if data.exists() {
        std::fs::remove_dir_all(&data).map_err(XtaskError::file(&data))?;
    }
    Ok(SystemOptions { binaries: Binaries::inside(&workspace.target.join(folder)), data, port: 0, echo: false })
}

fn script(workspace: &Workspace, name: &str, api: &Api) -> Result<Command, XtaskError> {
    let tools = tools::browser(workspace)?;
    let screenshots = workspace.target.join("screenshots");
    std::fs::create_dir_all(&screenshots).map_err(XtaskError::file(&screenshots))?;
    let mut script = Command::new(&tools.node);
    script
        .arg(workspace.root.join("tests/browser").join(name))
        .env("PLUMBLINE_URL", format!("http://{}", api.address))
        .env("PLUMBLINE_CHROMIUM", &tools.chromium)
        .env("PLUMBLINE_MODULES", &tools.modules)
        .env("PLUMBLINE_SCREENSHOTS", &screenshots);
    as_anybody(&mut script);
    if name == WIRES {
        // Beside real devices the browser runs on another computer.
        super::workspace::idle(&mut script);
    }
    Ok(script)
}

/// Each step is one line `{"step":"…","ok":true}`, or with `false` and an `error`; other lines are for people.
fn run_script(script: &mut Command, tally: &mut Tally) -> Result<(), XtaskError> {
    let mut ended = false;
    let success = run_and_read(script, |line| match serde_json::from_str::<Value>(line) {
        Ok(step) if step["step"].is_string() => {
            let name = format!("browser: {}", step["step"].as_str().unwrap_or_default());
            let error = step["error"].as_str().unwrap_or("no reason given").to_owned();
            tally.check(&name, if step["ok"] == true { Ok(()) } else { Err(error) });
            if step["note"].is_object() {
                eprintln!("  {}", step["note"]);
            }
        }
        Ok(end) if end["end"] == true => ended = true,
        _ => println!("{line}"),
    })?;
    let name = script.get_args().next().map(|file| Path::new(file).display().to_string()).unwrap_or_default();
    if ended && success {
        Ok(())
    } else {
        Err(XtaskError::Other(format!("{name} {}", if ended { "had failures" } else { "did not reach its end" })))
    }
}

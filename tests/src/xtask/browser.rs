//! The scripted browser: the page as a user has it, driven by role and label.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::tally::Tally;
use super::test::run_and_read;
use super::{Workspace, XtaskError, run::DEFAULT_SCENARIO, tools};
use crate::harness::{Api, Binaries, Ground, System, SystemOptions, Vehicle};

/// Starts ground and simulated vehicle, lets `tests/browser/fly.mjs` work the page, counts its steps.
pub fn test(workspace: &Workspace, tally: &mut Tally) {
    let outcome = fly(workspace, tally);
    tally.check("browser: system starts and stops cleanly", outcome);
}

fn fly(workspace: &Workspace, tally: &mut Tally) -> Result<(), XtaskError> {
    let python = tools::python(workspace)?;
    let data = workspace.target.join("browser-test");
    if data.exists() {
        std::fs::remove_dir_all(&data).map_err(XtaskError::file(&data))?;
    }
    let options =
        SystemOptions { binaries: Binaries::inside(&workspace.target.join("debug")), data, port: 0, echo: false };
    let vehicle = Vehicle::Simulated { scenario: workspace.root.join(DEFAULT_SCENARIO) };
    let system = System::start(&options, &vehicle)?;
    let mut script = script(workspace, "fly.mjs", system.api())?;
    let read = run_script(script.env("PLUMBLINE_PYTHON", &python), tally);
    let stopped = system.stop();
    read.and(stopped)
}

/// The charts' frame rate, as the page's own bench measures it; needs the ground of the release build.
///
/// # Errors
/// The page did not measure, or drew nothing.
pub fn bench(workspace: &Workspace) -> Result<(), XtaskError> {
    let mut ground = Ground::start(&options(workspace, "release", "charts-bench")?)?;
    let mut tally = Tally::silent();
    let read = run_script(&mut script(workspace, "charts.mjs", &ground.api)?, &mut tally);
    let _ = ground.process.interrupt(std::time::Duration::from_secs(10));
    read
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
    Ok(script)
}

/// Each step is one line `{"step":"…","ok":true}`, or with `false` and an `error`; other lines are for people.
pub fn run_script(script: &mut Command, tally: &mut Tally) -> Result<(), XtaskError> {
    let mut ended = false;
    let success = run_and_read(script, |line| match serde_json::from_str::<Value>(line) {
        Ok(step) if step["step"].is_string() => {
            let name = format!("browser: {}", step["step"].as_str().unwrap_or_default());
            let error = step["error"].as_str().unwrap_or("no reason given").to_owned();
            tally.check(&name, if step["ok"] == true { Ok(()) } else { Err(error) });
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

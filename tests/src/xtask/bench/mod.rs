//! `cargo xtask bench [NAME]`: every promised figure as one JSON line `{"bench", "name", "value", "unit", …}`.

mod build;

use std::process::Stdio;

use super::{Workspace, XtaskError, browser, tools, web, workspace};

/// What to measure.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// One of the benches; all of them without a name.
    pub name: Option<String>,
}

/// Name, and the bench program in `tests/benches` or what xtask does itself.
const BENCHES: [(&str, Bench); 12] = [
    ("control", Bench::Program("control")),
    ("tick", Bench::Program("tick")),
    ("steps", Bench::Program("steps")),
    ("sse", Bench::Program("sse")),
    ("estimate", Bench::Program("estimate")),
    ("experiment", Bench::Program("experiment")),
    ("many", Bench::Program("many")),
    ("wires", Bench::Program("wires")),
    ("page", Bench::Browser("page.mjs", browser::Beside::Vehicle)),
    ("live", Bench::Program("live_latency")),
    ("charts", Bench::Browser("charts.mjs", browser::Beside::Nothing)),
    ("build", Bench::Build),
];

#[derive(Debug, Clone, Copy)]
enum Bench {
    /// A bench program.
    Program(&'static str),
    /// A script of the browser.
    Browser(&'static str, browser::Beside),
    Build,
}

/// Runs the named bench, or all; the lines go to standard output, everything else to standard error.
///
/// # Errors
/// No such bench, or the first that could not be run.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let chosen: Vec<_> =
        BENCHES.iter().filter(|(name, _)| options.name.as_deref().is_none_or(|wanted| wanted == *name)).collect();
    if chosen.is_empty() {
        let wanted = options.name.as_deref().unwrap_or_default();
        let names = BENCHES.map(|(name, _)| name).join(", ");
        return Err(XtaskError::Other(format!("no bench is called `{wanted}`; there are: {names}")));
    }
    let whole = chosen.iter().any(|(name, _)| ["live", "page", "charts"].contains(name));
    if whole {
        // The page first: the ground embeds it.
        web::run(workspace, &web::Options::default())?;
        let programs = ["--bin", "plumbline-ground", "--bin", "plumbline-agent"];
        let mut cargo = workspace.cargo();
        workspace::run(cargo.args(["build", "--locked", "--workspace", "--release"]).args(programs))?;
    }
    for (name, bench) in chosen {
        eprintln!("xtask: bench {name}");
        match bench {
            Bench::Browser(script, beside) => browser::bench(workspace, script, *beside)?,
            Bench::Build => build::run(workspace)?,
            Bench::Program(name) => program(workspace, name)?,
        }
    }
    Ok(())
}

/// Runs a bench without a harness, in release. Built with the whole workspace: a package alone would ask other features
/// of the libraries, and build them again.
///
/// # Errors
/// It could not be built, or failed.
pub fn program(workspace: &Workspace, name: &str) -> Result<(), XtaskError> {
    let mut cargo = workspace.cargo();
    cargo.args(["bench", "--locked", "--workspace", "--bench", name]);
    if name == "many" {
        cargo.args(["--features", "plumbline-ground/many"]);
        match tools::nats_server(workspace) {
            Ok(server) => drop(cargo.env("PLUMBLINE_NATS", server)),
            Err(error) => {
                eprintln!("xtask: bench many is left out: {error}");
                return Ok(());
            }
        }
    }
    cargo.env("PLUMBLINE_BINARIES", workspace.target.join("release"));
    // Without pip the bench says so itself and measures the rest.
    let peers = match name {
        "estimate" => Some(("PLUMBLINE_FILTERPY", tools::filterpy(workspace))),
        "control" => Some(("PLUMBLINE_SLYCOT", tools::slycot(workspace))),
        _ => None,
    };
    match peers {
        Some((variable, Ok(python))) => drop(cargo.env(variable, python)),
        Some((_, Err(error))) => eprintln!("xtask: nothing to compare {name} with: {error}"),
        None => {}
    }
    workspace::run(cargo.stdin(Stdio::null()))
}

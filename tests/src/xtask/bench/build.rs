//! `cargo xtask bench build`: from a fresh checkout to the address of the page, and again after a change, as a developer waits for it.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::harness::Process;
use crate::xtask::XtaskError;
use crate::xtask::workspace::{self, Workspace, output};

/// Of each change; of the first build there is one.
const ROUNDS: usize = 3;
const PATIENCE: Duration = Duration::from_secs(3600);
/// The vehicle was never armed: nothing has to land first.
const END: Duration = Duration::from_secs(60);
/// Longest wait for a first build, s.
const COLD_S: f64 = 360.0;

struct Change {
    name: &'static str,
    file: &'static str,
    /// Before the function that is added.
    attribute: &'static str,
    goal_s: f64,
}

/// Without its attribute the linker would leave the page's function out.
const EXPORTED: &str = "#[wasm_bindgen::prelude::wasm_bindgen]\n";
const CHANGES: [Change; 2] = [
    Change { name: "agent_change", file: "agent/core/src/lib.rs", attribute: "", goal_s: 30.0 },
    Change { name: "page_change", file: "web/src/lib.rs", attribute: EXPORTED, goal_s: 20.0 },
];

/// Measures in a copy of the checkout, which is removed afterwards. What cargo has downloaded stays downloaded.
///
/// # Errors
/// The copy could not be made, or `cargo xtask run` did not come to its address.
pub fn run(workspace: &Workspace) -> Result<(), XtaskError> {
    let root = workspace.target.join("bench-build");
    remove(&root)?;
    copy(&workspace.root, &root)?;
    let cold = until_address(&root)?;
    tell("cold", &mut [cold], COLD_S);
    for change in &CHANGES {
        let mut seconds = [0.0; ROUNDS];
        for (round, took) in seconds.iter_mut().enumerate() {
            change.make(&root, round)?;
            *took = until_address(&root)?;
        }
        tell(change.name, &mut seconds, change.goal_s);
    }
    remove(&root)
}

/// The median of the rounds, and each.
fn tell(name: &str, seconds: &mut [f64], goal: f64) {
    seconds.sort_by(f64::total_cmp);
    let median = seconds.get(seconds.len() / 2);
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let line = json!({
        "bench": "build", "name": name, "value": median, "unit": "s", "goal": goal, "rounds": seconds, "cores": cores,
    });
    println!("{line}");
}

/// From the command to the address, s.
fn until_address(root: &Path) -> Result<f64, XtaskError> {
    let begun = Instant::now();
    let workspace = Workspace { root: root.to_owned(), target: root.join("target") };
    let mut cargo = workspace.cargo();
    cargo.args(["xtask", "run", "--port", "0"]).env_remove("CARGO_TARGET_DIR");
    let mut run = Process::start("cargo xtask run", cargo, false)?;
    run.wait_for(PATIENCE, |line| line.contains("Plumbline is at").then_some(()))?;
    let seconds = begun.elapsed().as_secs_f64();
    run.interrupt(END)?;
    Ok((seconds * 10.0).round() / 10.0)
}

impl Change {
    /// A function more, another one each time: everything that stands on the file is built anew.
    fn make(&self, root: &Path, round: usize) -> Result<(), XtaskError> {
        let file = root.join(self.file);
        let mut text = std::fs::read_to_string(&file).map_err(XtaskError::file(&file))?;
        let Self { name, attribute, .. } = self;
        text.push_str(&format!("\n/// Changed.\n{attribute}pub fn {name}_{round}() -> usize {{\n    {round}\n}}\n"));
        std::fs::write(&file, text).map_err(XtaskError::file(&file))
    }
}

/// Every file that git does not ignore, committed or not.
fn copy(from: &Path, to: &Path) -> Result<(), XtaskError> {
    let mut git = Command::new("git");
    let listed = output(git.current_dir(from).args(["ls-files", "--cached", "--others", "--exclude-standard", "-z"]))?;
    // Listed and missing: removed, and not yet committed as removed.
    for name in listed.split_terminator('\0').filter(|name| from.join(name).exists()) {
        let copy = to.join(name);
        let folder = copy.parent().unwrap_or(to);
        std::fs::create_dir_all(folder).map_err(XtaskError::file(folder))?;
        std::fs::copy(from.join(name), &copy).map_err(XtaskError::file(&copy))?;
    }
    // A repository of its own, as a clone is.
    workspace::run(Command::new("git").current_dir(to).args(["init", "--quiet"]))
}

fn remove(folder: &Path) -> Result<(), XtaskError> {
    if folder.exists() { std::fs::remove_dir_all(folder).map_err(XtaskError::file(folder)) } else { Ok(()) }
}

//! `cargo xtask fuzz`: everything that reads what others wrote, for as long as is asked, and how far that reaches.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use super::XtaskError;
use super::workspace::{self, Workspace};

/// How long to fuzz.
#[derive(Debug, Clone, clap::Args)]
pub struct FuzzOptions {
    /// Time for each decoder, min; a JSON line is printed each minute.
    #[arg(long, default_value_t = 10.0)]
    pub minutes: f64,
    /// Decoders beside each other.
    #[arg(long, default_value_t = 1)]
    pub threads: u32,
    /// Only decoders with this in their names.
    #[arg(long, default_value = "fuzz")]
    pub only: String,
    /// Chooses the damage: each minute takes the next one.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Build without optimisation.
    #[arg(long)]
    pub dev: bool,
    /// Tell which lines were reached, a JSON line for each room. Builds everything anew, and needs cargo-llvm-cov.
    #[arg(long)]
    pub coverage: bool,
}

/// Fuzzes every decoder.
///
/// # Errors
/// A decoder failed; its input is kept in `target/fuzz`. Or a program is missing.
pub fn fuzz(workspace: &Workspace, options: &FuzzOptions) -> Result<(), XtaskError> {
    let report = workspace.target.join("fuzz-coverage.json");
    let mut cargo = workspace.cargo();
    if options.coverage {
        measuring()?;
        cargo.args(["llvm-cov", "--json", "--summary-only", "--output-path"]).arg(&report);
    } else {
        cargo.arg("test");
    }
    // The whole workspace chosen: with the features that everything else was built with.
    cargo.args(["--locked", "--workspace", "--test", "fuzz"]);
    cargo.args(if options.dev { &[][..] } else { &["--release"][..] }).args(["--", "--nocapture"]);
    cargo.arg(&options.only).arg(format!("--test-threads={}", options.threads));
    cargo.env("PLUMBLINE_FUZZ_MINUTES", options.minutes.to_string()).env("PLUMBLINE_SEED", options.seed.to_string());
    workspace::run(cargo.stdin(Stdio::null()))?;
    if options.coverage {
        let text = std::fs::read_to_string(&report).map_err(XtaskError::file(&report))?;
        rooms(&text, &workspace.root).iter().for_each(|line| println!("{line}"));
    }
    Ok(())
}

fn measuring() -> Result<(), XtaskError> {
    let there = Command::new("cargo").args(["llvm-cov", "--version"]).output().is_ok_and(|ran| ran.status.success());
    let missing = || XtaskError::Missing {
        what: "cargo-llvm-cov".into(),
        how: "cargo install cargo-llvm-cov --locked\nrustup component add llvm-tools".into(),
    };
    if there { Ok(()) } else { Err(missing()) }
}

/// Lines and those reached, for each folder of sources that anything was reached of.
fn rooms(report: &str, root: &Path) -> Vec<Value> {
    let report: Value = serde_json::from_str(report).unwrap_or_default();
    let mut rooms: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    for file in report["data"][0]["files"].as_array().into_iter().flatten() {
        let path = Path::new(file["filename"].as_str().unwrap_or_default());
        let Ok(inside) = path.strip_prefix(root) else { continue };
        let room = inside.parent().unwrap_or(inside).to_string_lossy().into_owned();
        let lines = &file["summary"]["lines"];
        let sums = rooms.entry(room).or_default();
        sums.0 += lines["count"].as_u64().unwrap_or(0);
        sums.1 += lines["covered"].as_u64().unwrap_or(0);
    }
    let reached = rooms.into_iter().filter(|(room, (_, covered))| *covered > 0 && !room.starts_with("tests"));
    let line = |(room, (lines, covered)): (String, (u64, u64))| {
        let share = (1e3 * covered as f64 / lines as f64).round() / 10.0;
        json!({ "fuzz": "coverage", "name": room, "value": share, "unit": "%", "lines": lines, "covered": covered })
    };
    reached.map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_summed_by_room_and_foreign_files_left_out() {
        let file = |name: &str, count: u64, covered: u64| json!({ "filename": name, "summary": { "lines": { "count": count, "covered": covered } } });
        let files = [
            file("/w/ground/src/hub/a.rs", 10, 5),
            file("/w/ground/src/hub/b.rs", 30, 25),
            file("/w/ground/src/never.rs", 9, 0),
            file("/elsewhere/src/x.rs", 9, 9),
        ];
        let report = json!({ "data": [{ "files": files }] }).to_string();
        let told = rooms(&report, Path::new("/w"));
        assert_eq!(told.len(), 1, "{told:?}");
        assert_eq!((&told[0]["name"], &told[0]["value"]), (&json!("ground/src/hub"), &json!(75.0)));
    }
}

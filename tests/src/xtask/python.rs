//! The Python package: built as its users install it, its types checked, and flown on the simulator.

use std::process::Command;

use super::tally::Tally;
use super::test::run_and_read;
use super::{Workspace, XtaskError, tools, workspace};

/// What takes long: all of the ground's API asked, which computes, and flights in real time, which wait.
const LONG: [&str; 2] = ["tests/test_api.py", "tests/test_fly.py"];

/// Checks `tests/python` with the programs of the debug build. Where its packages cannot be had, says so and counts it as skipped.
pub fn test(workspace: &Workspace, tally: &mut Tally) {
    let python = match tools::plumbline(workspace) {
        Ok(python) => python,
        Err(error) => {
            eprintln!("xtask: skipped: the Python package: {error}");
            tally.skip(1, &Default::default());
            return;
        }
    };
    let promtool = tools::promtool(workspace).inspect_err(|error| eprintln!("xtask: {error}")).ok();
    let folder = workspace.root.join("tests/python");
    let command = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        command.args(["-B", "-m"]).args(arguments).current_dir(&folder);
        command.env("PLUMBLINE_BINARIES", workspace.target.join("debug"));
        command.envs(promtool.iter().map(|promtool| ("PLUMBLINE_PROMTOOL", promtool)));
        command
    };
    let mut install =
        command(&["pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--force-reinstall", "."]);
    if tally.check("the Python package is built and installed", workspace::run(&mut install)).is_none() {
        return;
    }
    let run = |what: &[&str]| pytest(command(&["pytest", "-q", "-p", "no:cacheprovider"]).args(what));
    // Beside each other: each has a ground of its own.
    std::thread::scope(|scope| {
        let long = LONG.each_ref().map(|file| scope.spawn(|| run(&[*file])));
        let cache = workspace.target.join("tools/mypy").display().to_string();
        for (name, what) in [("package", &["-p", "plumbline"][..]), ("tests and examples", &["tests", "examples"])] {
            let mut mypy = command(&["mypy", "--cache-dir", &cache]);
            tally.check(&format!("mypy --strict: {name}"), workspace::run(mypy.args(what)));
        }
        let others = run(&LONG.map(|file| ["--ignore", file]).concat());
        let panicked = |_| Err(XtaskError::Other("ended in a panic".into()));
        for ran in long.map(|ran| ran.join().unwrap_or_else(panicked)).into_iter().chain([others]) {
            match ran {
                Ok([passed, failed, skipped]) => {
                    tally.add("python", passed, failed);
                    tally.skip(skipped, &Default::default());
                }
                Err(error) => drop(tally.check::<(), _>("python", Err(error))),
            }
        }
    });
}

/// What it passed, failed and skipped; what it said is printed in one piece, as another one may be running.
fn pytest(command: &mut Command) -> Result<[u64; 3], XtaskError> {
    let (mut counts, mut said) = (None, Vec::new());
    let ran = run_and_read(command, |line| {
        counts = summary(line).or(counts);
        said.push(line.to_owned());
    });
    println!("{}", said.join("\n"));
    let success = ran?;
    // What ends otherwise than by a test that failed was interrupted, whatever passed before.
    let counts = counts.filter(|[_, failed, _]| success || *failed > 0);
    counts.ok_or_else(|| XtaskError::Other("pytest did not reach its end".into()))
}

/// Passed, failed and skipped tests, of the last line of pytest: `1 failed, 16 passed, 1 skipped in 64.91s (0:01:04)`.
fn summary(line: &str) -> Option<[u64; 3]> {
    let (counts, _) = line.rsplit_once(" in ")?;
    let mut found = [0; 3];
    for part in counts.trim_matches(['=', ' ']).split(", ") {
        let (count, what) = part.split_once(' ')?;
        let count: u64 = count.parse().ok()?;
        match what {
            "passed" => found[0] += count,
            "failed" | "error" | "errors" => found[1] += count,
            "skipped" => found[2] += count,
            _ => {}
        }
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_of_pytest_is_read_and_nothing_else() {
        assert_eq!(summary("2 failed, 15 passed, 12 warnings in 64.91s (0:01:04)"), Some([15, 2, 0]));
        assert_eq!(summary("17 passed, 1 skipped in 3.20s"), Some([17, 0, 1]));
        assert_eq!(summary("1 error in 0.10s"), Some([0, 1, 0]));
        for other in ["", "..F. [100%]", "raised in 5s", "E  waiting in 3 s"] {
            assert_eq!(summary(other), None, "{other}");
        }
    }
}

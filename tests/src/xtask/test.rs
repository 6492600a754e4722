//! `cargo xtask test`: every check there is, set up from nothing, with one closing line.

use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use super::tally::{CargoTestOutput, Tally};
use super::{Workspace, XtaskError, browser, python, signals, tools, web, workspace};

/// What to check.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Options {
    /// Leave the browser out.
    #[arg(long)]
    pub no_browser: bool,
    /// Only this step, on what is already built.
    #[arg(long, value_name = "STEP", value_parser = ["format", "page-and-clippy", "cargo-test", "python", "browser"])]
    pub only: Option<String>,
    /// Of the browser's scripts only these, by name: `trust.mjs`; may be given more than once.
    #[arg(long, value_name = "NAME")]
    pub script: Vec<String>,
}

/// All there is, with what the two commands do without.
pub const EVERYTHING: [&str; 4] = [
    "--workspace",
    "--locked",
    "--features",
    "plumbline-ground/many,plumbline-agent/i2c,plumbline-agent/spi,plumbline-bundler/compress",
];

/// How many tests of a binary run side by side.
const THREADS: &str = "RUST_TEST_THREADS";
/// Where less is free, bytes, tests that record may fail for want of it.
const FREE_MIN: u64 = 1 << 30;

/// Runs everything; a step that fails does not stop the others. True when all is well.
pub fn run(workspace: &Workspace, options: &Options) -> bool {
    signals::catch();
    let mut tally = Tally::default();
    steps(workspace, options, &mut tally);
    if signals::interrupted() {
        tally.add("interrupted", 0, 1);
    }
    tally.good()
}

fn steps(workspace: &Workspace, options: &Options, tally: &mut Tally) {
    type Step<'a> = (&'a str, &'a mut dyn FnMut(&mut Tally));
    let linting = Cell::new(None);
    let steps: [Step; 5] = [
        ("format", &mut |tally| {
            let format = || {
                tools::rust_components(workspace)?;
                workspace::run(workspace.cargo().args(["fmt", "--all", "--check"]))
            };
            tally.check("format", format());
        }),
        ("page-and-clippy", &mut |tally| linting.set(page_and_clippy(workspace, options, tally))),
        ("cargo-test", &mut |tally| linting.set(cargo_test(workspace, options, tally))),
        ("python", &mut |tally| python::test(workspace, tally)),
        ("browser", &mut |tally| {
            // It measures how fast a page is.
            lint(linting.take(), tally);
            if options.no_browser {
                eprintln!("xtask: browser left out, as asked");
            } else {
                browser::test(workspace, &options.script, tally);
            }
        }),
    ];
    for (name, step) in steps {
        if options.only.as_deref().is_some_and(|only| only != name) {
            continue;
        }
        if signals::interrupted() {
            return;
        }
        let started = std::time::Instant::now();
        eprintln!("\nxtask: {name}");
        step(tally);
        let free = workspace.free_bytes();
        let free_gb = free.map_or("? GB".into(), |free| format!("{:.1} GB", free as f64 * 1e-9));
        eprintln!("xtask: {name} took {:.0} s; {free_gb} are free", started.elapsed().as_secs_f64());
        if free.is_some_and(|free| free < FREE_MIN) {
            // Grounds stop recording on a full disk, and whatever waits for a flight would fail without saying why.
            let text = format!("after {name} only {free_gb} are free at {}", workspace.target.display());
            tally.check::<(), _>("disk", Err(text));
        }
    }
    lint(linting.take(), tally);
}

/// Waits for the lints, where they were begun.
fn lint(linting: Option<Result<Lints, XtaskError>>, tally: &mut Tally) {
    if let Some(lints) = linting {
        tally.check("clippy", lints.and_then(Lints::wait));
    }
}

/// The page, programs and tests. What links the page keeps one core busy for long: the others are made meanwhile, and what the steps
/// behind this one want from elsewhere is fetched. The lints begin behind it where this step is all there is.
fn page_and_clippy(workspace: &Workspace, options: &Options, tally: &mut Tally) -> Option<Result<Lints, XtaskError>> {
    let (made, bundler) = mpsc::channel();
    let page = std::thread::scope(|scope| {
        let fetching = options.only.is_none().then(|| scope.spawn(|| tools::fetch(workspace, !options.no_browser)));
        let missing = |_| XtaskError::Other("the page has no bundler".into());
        let page =
            scope.spawn(move || web::weigh(workspace, &web::Options::default(), || bundler.recv().map_err(missing)));
        // The first under the lock that all of these wait for.
        if let Some(built) = tally.check("bundler", web::bundler(workspace)) {
            // Nobody waits for it where the page could not be compiled.
            let _ = made.send(built);
        }
        drop(made);
        // What does not compile is counted by the step that runs it, and what was not fetched by who wants it.
        let _ = build(workspace);
        let _ = fetching.map(|fetching| fetching.join());
        page.join().unwrap_or_else(|_| Err(XtaskError::Other("the build of the page ended in a panic".into())))
    });
    tally.check("page ≤ 2 MB", page);
    options.only.is_some().then(|| Lints::start(workspace))
}

/// Clippy beside tests, which wait for half their time: it has what they leave of the processors.
struct Lints {
    command: String,
    clippy: Child,
}

impl Lints {
    fn start(workspace: &Workspace) -> Result<Self, XtaskError> {
        let mut clippy = workspace.cargo();
        clippy.args(["clippy", "--quiet"]).args(EVERYTHING).args(["--all-targets", "--", "-D", "warnings"]);
        let command = workspace::command_line(&clippy);
        let started = workspace::idle(&mut clippy).stdin(Stdio::null()).spawn();
        let clippy = started.map_err(|source| XtaskError::Start { command: command.clone(), source })?;
        Ok(Self { command, clippy })
    }

    fn wait(mut self) -> Result<(), XtaskError> {
        let status =
            self.clippy.wait().map_err(|source| XtaskError::Start { command: self.command.clone(), source })?;
        if status.success() { Ok(()) } else { Err(XtaskError::Failed { command: self.command.clone(), status }) }
    }
}

impl Drop for Lints {
    /// Whoever was interrupted leaves no compiler behind; one that has ended is not there any more.
    fn drop(&mut self) {
        let _ = self.clippy.kill();
        let _ = self.clippy.wait();
    }
}

/// Binaries and tests in one build, so that nothing is compiled twice for other features.
fn build(workspace: &Workspace) -> Result<(), XtaskError> {
    workspace::run(workspace.cargo().arg("build").args(EVERYTHING).args(["--bins", "--tests"]))
}

/// Unit, integration and system tests of all members, and what lints beside them and goes on behind their end, unless this step is all
/// there is.
fn cargo_test(workspace: &Workspace, options: &Options, tally: &mut Tally) -> Option<Result<Lints, XtaskError>> {
    let lints = || options.only.is_none().then(|| Lints::start(workspace));
    if tally.check("build", build(workspace)).is_none() {
        return lints();
    }
    let mut cargo = workspace.cargo();
    cargo.arg("test").args(EVERYTHING).arg("--no-fail-fast").stdout(Stdio::piped());
    // Those that take long fly in real time, and leave the cores idle.
    if std::env::var_os(THREADS).is_none() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        cargo.env(THREADS, (2 * cores + 1).to_string());
    }
    cargo.env("PLUMBLINE_BINARIES", workspace.target.join("debug"));
    if let Some(python) = tally.check("python with mcap", tools::python(workspace)) {
        cargo.env("PLUMBLINE_PYTHON", python);
    }
    for (variable, found) in [
        ("PLUMBLINE_NATS", tools::nats_server(workspace)),
        ("PLUMBLINE_POSTGRES", tools::postgres(workspace)),
        ("PLUMBLINE_FAKETIME", tools::faketime(workspace)),
    ] {
        match found {
            Ok(path) => drop(cargo.env(variable, path)),
            Err(error) => eprintln!("xtask: {error}"),
        }
    }
    if let Err(error) = tools::octave() {
        eprintln!("xtask: {error}");
    }
    // What is absent is told here by the tests that wanted it.
    let absent = workspace.target.join("skipped.txt");
    if tally.check("list of skipped tests", std::fs::write(&absent, "")).is_some() {
        cargo.env("PLUMBLINE_SKIPPED", &absent);
    }
    let mut output = CargoTestOutput::default();
    let mut linting = None;
    let ran = run_and_read(&mut cargo, |line| {
        // Once a test says something, no cargo waits for another any more.
        linting.get_or_insert_with(lints);
        output.line(line);
        println!("{line}");
    });
    match ran {
        Ok(success) => output.finish(success),
        Err(error) => {
            tally.check::<(), _>("cargo test", Err(error));
        }
    }
    tally.add("cargo test", output.passed, output.failed);
    let absent = std::fs::read_to_string(&absent).unwrap_or_default();
    tally.skip(output.ignored, &absent.lines().filter_map(|line| Some(line.split_once(": ")?.0.to_owned())).collect());
    linting.unwrap_or_else(lints)
}

/// What a command wrote is waited for so long after its end.
const AFTER_END: Duration = Duration::from_secs(5);

/// Runs to the end, passing on each line of its standard output. True when it says success. What it has started and left behind may hold its
/// output open for ever: that is told, and not waited for.
pub fn run_and_read(command: &mut std::process::Command, read: impl FnMut(&str)) -> Result<bool, XtaskError> {
    run_and_read_for(AFTER_END, command, read)
}

fn run_and_read_for(
    after_end: Duration,
    command: &mut std::process::Command,
    mut read: impl FnMut(&str),
) -> Result<bool, XtaskError> {
    let line = workspace::command_line(command);
    let start = |source| XtaskError::Start { command: line.clone(), source };
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().map_err(start)?;
    let (send, lines) = mpsc::channel();
    if let Some(stdout) = child.stdout.take() {
        std::thread::spawn(move || {
            // Tests may print anything: bytes that are no UTF-8 must not end the reading.
            let mut lines = BufReader::new(stdout).split(b'\n');
            while lines.next().is_some_and(|line| send.send(line).is_ok()) {}
        });
    }
    loop {
        match lines.recv_timeout(after_end) {
            Ok(bytes) => read(&String::from_utf8_lossy(&bytes.map_err(start)?)),
            Err(RecvTimeoutError::Disconnected) => return Ok(child.wait().map_err(start)?.success()),
            Err(RecvTimeoutError::Timeout) => {
                if let Some(status) = child.try_wait().map_err(start)? {
                    eprintln!("xtask: {line} has ended, and something that it started has not");
                    return Ok(status.success());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_command_leaves_behind_is_not_waited_for_and_every_line_is_read() {
        let begun = std::time::Instant::now();
        let mut lines = Vec::new();
        let mut command = std::process::Command::new("sh");
        command.args(["-c", "printf 'one\\n\\377\\n'; sleep 60 & echo three; exit 3"]);
        let after_end = Duration::from_secs(1);
        let success = run_and_read_for(after_end, &mut command, |line| lines.push(line.to_owned())).unwrap();
        assert!(!success && begun.elapsed() < 4 * AFTER_END, "{:?}", begun.elapsed());
        assert_eq!(lines, ["one", "\u{fffd}", "three"]);
    }
}

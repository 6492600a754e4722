//! How far the cargos are that build side by side, told while they do.

use std::io::{BufRead, BufReader, IsTerminal as _, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::XtaskError;
use super::workspace::command_line;

/// Between two lines in a log; on a terminal one line is written again and again.
const EVERY_LOG: Duration = Duration::from_secs(20);
const EVERY_TERMINAL: Duration = Duration::from_millis(200);
/// What is built already is counted within moments: an estimate from then on would promise too much.
const ESTIMATE_AFTER: Duration = Duration::from_secs(10);
/// Share of the units that must have been built before their pace tells anything.
const ESTIMATE_FROM: f64 = 0.05;

/// What is being built. Cargo counts: a unit is a crate, a build script or its run.
#[derive(Debug)]
pub struct Progress {
    terminal: bool,
    begun: Instant,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    lanes: Vec<Lane>,
    told: Instant,
}

#[derive(Debug)]
struct Lane {
    name: &'static str,
    begun: Instant,
    done: u64,
    all: u64,
    /// Done when [`ESTIMATE_AFTER`] had passed.
    fresh: Option<u64>,
}

impl Progress {
    /// Nothing is built yet.
    pub fn new() -> Self {
        let now = Instant::now();
        let state = Mutex::new(State { lanes: Vec::new(), told: now });
        Self { terminal: std::io::stderr().is_terminal(), begun: now, state }
    }

    /// Runs a `cargo build` to its end. `made` is told the target and each file of what has been built.
    ///
    /// # Errors
    /// It could not be started, or failed; why stands on standard error.
    pub fn build(
        &self,
        name: &'static str,
        cargo: &mut Command,
        mut made: impl FnMut(&str, &Path),
    ) -> Result<(), XtaskError> {
        cargo.args(["--message-format", "json-render-diagnostics"]);
        cargo.env("CARGO_TERM_PROGRESS_WHEN", "always").env("CARGO_TERM_PROGRESS_WIDTH", "100");
        if self.terminal {
            cargo.env("CARGO_TERM_COLOR", "always");
        }
        let line = command_line(cargo);
        let start = |source| XtaskError::Start { command: line.clone(), source };
        let mut child =
            cargo.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(start)?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let lane = self.lane(name);
        std::thread::scope(|scope| {
            scope.spawn(move || stderr.map(|stderr| self.listen(lane, stderr)));
            for message in stdout.into_iter().flat_map(|stdout| BufReader::new(stdout).lines()).map_while(Result::ok) {
                artifact(&message, &mut made);
            }
        });
        let status = child.wait().map_err(start)?;
        self.tell(|state| {
            if let Some(lane) = state.lanes.get_mut(lane) {
                lane.done = lane.all;
            }
        });
        if status.success() { Ok(()) } else { Err(XtaskError::Failed { command: line, status }) }
    }

    fn lane(&self, name: &'static str) -> usize {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.lanes.push(Lane { name, begun: Instant::now(), done: 0, all: 0, fresh: None });
        state.lanes.len() - 1
    }

    /// Reads what cargo writes for a terminal, counts, and passes on what is no progress.
    fn listen(&self, lane: usize, stderr: impl Read) {
        let mut text = Vec::new();
        for byte in BufReader::new(stderr).bytes().map_while(Result::ok) {
            match byte {
                // Cargo writes its progress over itself.
                b'\r' | b'\n' => {
                    self.heard(lane, &String::from_utf8_lossy(&text), byte == b'\n');
                    text.clear();
                }
                byte => text.push(byte),
            }
        }
    }

    fn heard(&self, lane: usize, line: &str, ended: bool) {
        let plain = plain(line);
        if let Some((done, all)) = counted(&plain) {
            self.tell(|state| {
                if let Some(lane) = state.lanes.get_mut(lane) {
                    (lane.done, lane.all) = (done, all);
                    if lane.begun.elapsed() > ESTIMATE_AFTER {
                        lane.fresh.get_or_insert(done);
                    }
                }
            });
        } else if ended && !plain.trim_start().starts_with("Compiling ") {
            let clear = if self.terminal { "\r\x1b[K" } else { "" };
            eprintln!("{clear}{}", line.trim_start_matches("\x1b[K"));
        }
    }

    fn tell(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut state);
        let every = if self.terminal { EVERY_TERMINAL } else { EVERY_LOG };
        let ended = state.lanes.iter().all(|lane| lane.done == lane.all);
        if state.told.elapsed() < every && !(ended && self.terminal) {
            return;
        }
        state.told = Instant::now();
        let text = if ended { String::new() } else { format!("xtask: {}", state.text()) };
        if self.terminal {
            eprint!("\r\x1b[K{text}");
        } else if !ended {
            eprintln!("{text}");
        }
    }

    /// Since the first build began, s.
    pub fn seconds(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }
}

impl State {
    fn text(&self) -> String {
        let lanes = self.lanes.iter().filter(|lane| lane.done < lane.all);
        let counts: Vec<_> = lanes.clone().map(|lane| format!("{} {} of {}", lane.name, lane.done, lane.all)).collect();
        let left = lanes.map(|lane| lane.left(lane.begun.elapsed())).max().flatten();
        format!("building {}{}", counts.join(", "), left.map_or(String::new(), |left| format!(", {}", about(left))))
    }
}

impl Lane {
    /// As fast as since the estimate began.
    fn left(&self, elapsed: Duration) -> Option<Duration> {
        let built = self.done.saturating_sub(self.fresh?) as f64;
        if built <= ESTIMATE_FROM * self.all as f64 {
            return None;
        }
        let left = self.all.saturating_sub(self.done) as f64 / built;
        Some(elapsed.saturating_sub(ESTIMATE_AFTER).mul_f64(left))
    }
}

fn about(left: Duration) -> String {
    match left.as_secs().div_ceil(60) {
        0 | 1 => "about a minute left".into(),
        minutes => format!("about {minutes} min left"),
    }
}

/// The files of a message that tells of something built.
fn artifact(message: &str, made: &mut impl FnMut(&str, &Path)) {
    let Ok(message) = serde_json::from_str::<serde_json::Value>(message) else { return };
    let Some(target) = message["target"]["name"].as_str() else { return };
    for file in message["filenames"].as_array().into_iter().flatten().filter_map(|file| file.as_str()) {
        made(target, Path::new(file));
    }
}

/// Units done, and all: `    Building [====>   ] 12/345: serde, syn(build)`.
fn counted(line: &str) -> Option<(u64, u64)> {
    let (_, counts) = line.trim_start().strip_prefix("Building [")?.split_once("] ")?;
    let (done, all) = counts.split(':').next()?.split_once('/')?;
    Some((done.trim().parse().ok()?, all.trim().parse().ok()?))
}

/// Without what colours a terminal.
fn plain(line: &str) -> String {
    let mut parts = line.split('\x1b');
    let first = parts.next().unwrap_or_default().to_owned();
    // An escape sequence ends with its first letter.
    parts.fold(first, |plain, part| plain + part.split_once(char::is_alphabetic).map_or("", |(_, rest)| rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_s_progress_is_counted_with_and_without_colours() {
        assert_eq!(counted("    Building [====>      ] 12/345: serde, syn(build)"), Some((12, 345)));
        let coloured = "\x1b[K\x1b[1m\x1b[96m    Building\x1b[0m [=>  ]   7/18: a";
        assert_eq!(counted(&plain(coloured)), Some((7, 18)));
        for other in ["   Compiling serde v1.0.0", " Downloading [=>  ] 3/9: 10 MB", "error: [1/2] 3/4", ""] {
            assert_eq!(counted(other), None, "{other}");
        }
    }

    #[test]
    fn what_is_left_is_told_at_the_pace_since_what_was_there_already_was_counted() {
        let lane = |done| Lane { name: "page", begun: Instant::now(), done, all: 300, fresh: Some(100) };
        assert_eq!(lane(200).left(Duration::from_secs(70)), Some(Duration::from_secs(60)));
        assert_eq!(lane(115).left(Duration::from_secs(70)), None);
        assert_eq!(about(Duration::from_secs(61)), "about 2 min left");
        assert_eq!(about(Duration::from_secs(60)), "about a minute left");
    }

    #[test]
    fn a_build_tells_of_what_it_made() {
        let mut made = Vec::new();
        let message =
            r#"{"reason":"compiler-artifact","target":{"name":"plumbline_web"},"filenames":["/t/a.wasm","/t/a.rlib"]}"#;
        for line in [message, "not JSON", r#"{"reason":"build-finished","success":true}"#] {
            artifact(line, &mut |target, file| made.push((target.to_owned(), file.to_owned())));
        }
        assert_eq!(made, ["/t/a.wasm", "/t/a.rlib"].map(|file| ("plumbline_web".to_owned(), file.into())));
    }
}

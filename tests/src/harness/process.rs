//! A child process that ends with us, can be interrupted as by Ctrl-C, and whose output can be waited for.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::xtask::XtaskError;

/// Lines kept of a child; the oldest give way, so that a child that talks never waits for a test that does not listen.
const LINES: usize = 2000;
const POLL: Duration = Duration::from_millis(20);

/// A running child.
#[derive(Debug)]
pub struct Process {
    /// For messages.
    pub name: String,
    child: Child,
    said: Arc<Said>,
    /// Number of the next line that [`Process::wait_for`] looks at.
    next: u64,
}

/// What a child said, shared with the two threads that listen.
#[derive(Debug, Default)]
struct Said {
    lines: Mutex<Lines>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Lines {
    /// The newest [`LINES`].
    kept: VecDeque<String>,
    /// Lines that gave way.
    dropped: u64,
    /// Outputs still open.
    open: usize,
}

impl Said {
    fn lines(&self) -> MutexGuard<'_, Lines> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut Lines)) {
        change(&mut self.lines());
        self.changed.notify_all();
    }
}

impl Process {
    /// Starts `command` in a process group of its own: Ctrl-C in our terminal is ours to pass on.
    /// `echo` also writes each of its lines to our standard error, with its name in front.
    ///
    /// # Errors
    /// The command that could not be started.
    pub fn start(name: &str, mut command: Command, echo: bool) -> Result<Self, XtaskError> {
        use std::os::unix::process::CommandExt;
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        #[cfg(target_os = "linux")]
        // SAFETY: prctl is async-signal-safe, and asks the kernel to end the child when we are killed.
        unsafe {
            command.pre_exec(|| {
                libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
                Ok(())
            });
        }
        let line = format!("{command:?}");
        let mut child = command.spawn().map_err(|source| XtaskError::Start { command: line, source })?;
        let said = Arc::new(Said::default());
        let outputs: [Option<Box<dyn Read + Send>>; 2] = [
            child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
            child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
        ];
        for pipe in outputs.into_iter().flatten() {
            said.change(|lines| lines.open += 1);
            let (said, name) = (said.clone(), name.to_owned());
            std::thread::spawn(move || {
                for line in BufReader::new(pipe).lines().map_while(Result::ok) {
                    if echo {
                        eprintln!("{name}: {line}");
                    }
                    said.change(|lines| {
                        lines.kept.push_back(line);
                        if lines.kept.len() > LINES {
                            lines.kept.pop_front();
                            lines.dropped += 1;
                        }
                    });
                }
                said.change(|lines| lines.open -= 1);
            });
        }
        Ok(Self { name: name.to_owned(), child, said, next: 0 })
    }

    /// Waits for a line that `wanted` turns into something.
    ///
    /// # Errors
    /// The child ended or `limit` passed first; the message holds the child's last lines.
    pub fn wait_for<T>(&mut self, limit: Duration, wanted: impl Fn(&str) -> Option<T>) -> Result<T, XtaskError> {
        let until = Instant::now() + limit;
        let mut lines = self.said.lines();
        let why = loop {
            let index = self.next.saturating_sub(lines.dropped);
            if let Some(line) = usize::try_from(index).ok().and_then(|index| lines.kept.get(index)) {
                self.next = lines.dropped.max(self.next) + 1;
                if let Some(found) = wanted(line) {
                    return Ok(found);
                }
                continue;
            }
            let left = until.saturating_duration_since(Instant::now());
            if lines.open == 0 {
                break "it ended".to_owned();
            }
            if left.is_zero() {
                break format!("no word within {limit:?}");
            }
            lines = self.said.changed.wait_timeout(lines, left).unwrap_or_else(PoisonError::into_inner).0;
        };
        drop(lines);
        Err(self.gave_up(&why))
    }

    fn gave_up(&self, why: &str) -> XtaskError {
        XtaskError::Other(format!("{}: {why}; its last lines:\n{}", self.name, self.last_lines(20)))
    }

    /// Its last lines.
    pub fn last_lines(&self, count: usize) -> String {
        let lines = self.said.lines();
        let first = lines.kept.len().saturating_sub(count);
        lines.kept.iter().skip(first).map(String::as_str).collect::<Vec<_>>().join("\n")
    }

    /// How it ended, if it has.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Its process number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal.
    pub fn signal(&self, signal: i32) {
        if let Ok(id) = i32::try_from(self.child.id()) {
            // SAFETY: our own child, not yet waited for, so the number is still its.
            unsafe { libc::kill(id, signal) };
        }
    }

    /// Ctrl-C, and the time to tidy up; then killed.
    ///
    /// # Errors
    /// It had to be killed: stopping cleanly is part of what is tested.
    pub fn interrupt(&mut self, limit: Duration) -> Result<ExitStatus, XtaskError> {
        if self.ended().is_none() {
            self.signal(libc::SIGINT);
        }
        let until = Instant::now() + limit;
        while Instant::now() < until {
            if let Some(status) = self.ended() {
                return Ok(status);
            }
            std::thread::sleep(POLL);
        }
        self.kill();
        Err(self.gave_up(&format!("still running {limit:?} after Ctrl-C, killed")))
    }

    /// SIGKILL, as a power cut would.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.ended().is_none() {
            self.kill();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Process {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        Process::start("sh", command, false).unwrap()
    }

    #[test]
    fn lines_of_both_outputs_are_waited_for_and_the_end_is_told_with_them() {
        let mut process = shell("echo on port 1; echo oops >&2; exit 3");
        let port = process.wait_for(POLL * 100, |line| line.strip_prefix("on port ")?.parse::<u16>().ok());
        assert_eq!(port.unwrap(), 1);
        let error = process.wait_for(POLL * 100, |line| (line == "never said").then_some(())).unwrap_err().to_string();
        assert!(error.contains("it ended") && error.contains("oops"), "{error}");
        assert_eq!(process.interrupt(POLL * 100).unwrap().code(), Some(3));
    }

    #[test]
    fn a_child_is_interrupted_as_by_ctrl_c_and_killed_when_it_does_not_listen() {
        let mut tidy = shell("trap 'echo tidied; exit 0' INT; echo ready; while :; do sleep 0.02; done");
        tidy.wait_for(POLL * 100, |line| (line == "ready").then_some(())).unwrap();
        assert!(tidy.interrupt(POLL * 100).unwrap().success());
        tidy.wait_for(POLL * 100, |line| (line == "tidied").then_some(())).unwrap();
        let mut deaf = shell("trap '' INT; echo ready; while :; do sleep 0.02; done");
        deaf.wait_for(POLL * 100, |line| (line == "ready").then_some(())).unwrap();
        let error = deaf.interrupt(POLL * 5).unwrap_err().to_string();
        assert!(error.contains("killed"), "{error}");
        assert!(deaf.ended().is_some());
    }

    #[test]
    fn a_child_that_talks_too_much_neither_waits_nor_fills_memory() {
        let mut process = shell("i=0; while [ $i -lt 5000 ]; do echo line $i; i=$((i+1)); done; echo last");
        let _ = process.wait_for(POLL * 500, |_| None::<()>);
        // Its outputs end a moment before it does.
        let ended = crate::harness::wait_until(Duration::from_secs(10), || process.ended());
        assert!(ended.is_some());
        assert_eq!(process.last_lines(1), "last");
        assert_eq!(process.said.lines().kept.len(), LINES);
    }
}

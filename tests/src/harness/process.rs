//! A child process that ends with us, can be interrupted as by Ctrl-C, and whose output can be waited for.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use crate::xtask::XtaskError;

/// Lines of a child waiting to be read by us; beyond that the oldest reader thread waits, the child with it, unless
/// the lines are only echoed.
const LINES: usize = 4096;
const POLL: Duration = Duration::from_millis(20);

/// A running child.
#[derive(Debug)]
pub struct Process {
    /// For messages.
    pub name: String,
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
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
        let (sender, lines) = sync_channel(LINES);
        let outputs: [Option<Box<dyn Read + Send>>; 2] = [
            child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
            child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
        ];
        for pipe in outputs.into_iter().flatten() {
            let (sender, name) = (sender.clone(), name.to_owned());
            std::thread::spawn(move || {
                for line in BufReader::new(pipe).lines().map_while(Result::ok) {
                    if echo {
                        eprintln!("{name}: {line}");
                    }
                    // A full queue drops the line: a child that talks must never wait for a test that does not listen.
                    let _ = sender.try_send(line);
                }
            });
        }
        Ok(Self { name: name.to_owned(), child, lines, seen: Vec::new() })
    }

    /// Waits for a line that `wanted` turns into something.
    ///
    /// # Errors
    /// The child ended or `limit` passed first; the message holds the child's last lines.
    pub fn wait_for<T>(&mut self, limit: Duration, wanted: impl Fn(&str) -> Option<T>) -> Result<T, XtaskError> {
        let until = Instant::now() + limit;
        loop {
            match self.lines.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(line) => {
                    let found = wanted(&line);
                    self.seen.push(line);
                    if let Some(found) = found {
                        return Ok(found);
                    }
                }
                Err(RecvTimeoutError::Timeout) => return Err(self.gave_up(&format!("no word within {limit:?}"))),
                Err(RecvTimeoutError::Disconnected) => return Err(self.gave_up("it ended")),
            }
        }
    }

    fn gave_up(&self, why: &str) -> XtaskError {
        XtaskError::Other(format!("{}: {why}; its last lines:\n{}", self.name, self.last_lines(20)))
    }

    /// Its last lines that were looked at.
    pub fn last_lines(&self, count: usize) -> String {
        self.seen.get(self.seen.len().saturating_sub(count)..).unwrap_or_default().join("\n")
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
                self.seen.extend(self.lines.try_iter());
                return Ok(status);
            }
            std::thread::sleep(POLL);
        }
        self.kill();
        self.seen.extend(self.lines.try_iter());
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

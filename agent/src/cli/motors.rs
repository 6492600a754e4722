//! The motors by hand, and the guard that owns them in flight.

use std::io::{BufRead as _, Write as _};
use std::os::fd::{AsFd as _, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use plumbline_agent::config::AgentConfig;
use plumbline_agent::types::{MotorCommand, ROTORS};
use plumbline_devices::motors::{GuardLine, STOPPING, claim, guard, stop_anew};
use plumbline_devices::spec::MotorsSpec;

use super::{Failure, in_file};

/// What has to be typed before a motor turns.
const CONFIRMATION: &str = "propellers off";
/// Highest throttle of a test.
const THROTTLE_MAX: f64 = 0.15;
/// How often a command is sent in a test: well within the guard's patience.
const PERIOD: Duration = Duration::from_millis(20);

/// One motor at low throttle, on the bench; or all of them stopped.
#[derive(Debug, clap::Args)]
#[group(id = "what", required = true, multiple = false, args = ["test", "stop"])]
pub struct MotorsArguments {
    /// Configuration with `[motors]`.
    #[arg(long)]
    config: PathBuf,
    /// Which motor, 1 to 4, in the order of the airframe.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=ROTORS as i64))]
    test: Option<u8>,
    /// Stop all of them, once no other program holds them: what a dead agent's unit does.
    #[arg(long)]
    stop: bool,
    /// Throttle, 0 to 0.15.
    #[arg(long, default_value_t = 0.06)]
    throttle: f64,
    /// How long, s, up to 10.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
}

/// The process that holds the motors; the agent starts it, nobody else does.
#[derive(Debug, clap::Args)]
pub struct GuardArguments {
    /// Configuration with `[motors]`.
    #[arg(long)]
    config: PathBuf,
}

fn motors(file: &Path, config: &AgentConfig) -> Result<MotorsSpec, Failure> {
    config.motors.clone().ok_or_else(|| in_file(file, "no [motors]: nothing to fly with"))
}

/// Starts the guard of the motors of `config`, which was read from `file`; returns the line to it.
pub fn guarded(file: &Path, config: &AgentConfig) -> Result<GuardLine, Failure> {
    motors(file, config)?;
    let (near, far) = UnixStream::pair()?;
    Command::new(std::env::current_exe()?)
        .arg("motor-guard")
        .arg("--config")
        .arg(file)
        .stdin(Stdio::from(OwnedFd::from(far)))
        // It says nothing there, and outlives the agent: whoever reads the agent's output does not wait for it.
        .stdout(Stdio::null())
        // Ctrl-C is for the agent alone: the guard ends when the agent has.
        .process_group(0)
        .spawn()?;
    Ok(GuardLine::new(near)?)
}

fn held(spec: &MotorsSpec) -> Failure {
    format!("{}: another program holds these motors", spec.port).into()
}

/// Stops the motors, when the guard that holds them has ended.
fn stop(file: &Path) -> Result<(), Failure> {
    let config = AgentConfig::read(file)?;
    let Some((spec, mut pulses)) = config.motors.as_ref().and_then(|spec| Some((spec, spec.pulses()?))) else {
        return Ok(writeln!(std::io::stdout(), "no motors of its own: nothing to stop")?);
    };
    let begun = Instant::now();
    let _owner = loop {
        match claim(&spec.port) {
            Ok(Some(owner)) => break owner,
            // It tries for as long to stop them.
            Ok(None) if begun.elapsed() > STOPPING => return Err(held(spec)),
            Err(error) if begun.elapsed() > STOPPING => return Err(error.into()),
            Ok(None) | Err(_) => std::thread::sleep(PERIOD),
        }
    };
    stop_anew(pulses.as_mut(), spec.range())?;
    Ok(writeln!(std::io::stdout(), "motors stopped")?)
}

impl GuardArguments {
    /// Sets pulses until the agent is gone, whatever way it went.
    pub fn run(&self) -> Result<(), Failure> {
        let config = AgentConfig::read(&self.config)?;
        let spec = motors(&self.config, &config)?;
        // One owner: who tests a motor cannot do it in flight.
        let Some(_owner) = claim(&spec.port)? else { return Err(held(&spec)) };
        let mut socket = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned()?);
        let mut pulses = spec.pulses().ok_or("[motors]: no such port")?;
        guard(&mut socket, pulses.as_mut(), spec.range(), Duration::from_secs_f64(spec.arming_s))?;
        Ok(())
    }
}

impl MotorsArguments {
    /// Asks, then turns one motor; or stops all.
    pub fn run(&self) -> Result<(), Failure> {
        self.test.map_or_else(|| stop(&self.config), |motor| self.turn(motor))
    }

    fn turn(&self, motor: u8) -> Result<(), Failure> {
        // A NaN fails both comparisons.
        if !(self.throttle > 0.0 && self.throttle <= THROTTLE_MAX) {
            return Err(format!("--throttle {}: not above 0, to {THROTTLE_MAX}", self.throttle).into());
        }
        if !(self.seconds > 0.0 && self.seconds <= 10.0) {
            return Err(format!("--seconds {}: not above 0, to 10", self.seconds).into());
        }
        let config = AgentConfig::read(&self.config)?;
        let spec = motors(&self.config, &config)?;
        let mut out = std::io::stdout();
        write!(out, "Motor {motor} will turn for {} s. Type \"{CONFIRMATION}\" when they are: ", self.seconds)?;
        out.flush()?;
        let mut typed = String::new();
        std::io::stdin().lock().read_line(&mut typed)?;
        if typed.trim() != CONFIRMATION {
            return Err(format!("{:?} is not \"{CONFIRMATION}\": no motor turns", typed.trim()).into());
        }
        let line = guarded(&self.config, &config)?;
        let mut command = MotorCommand::default();
        let arming = Instant::now() + Duration::from_secs_f64(spec.arming_s + 0.2);
        let end = arming + Duration::from_secs_f64(self.seconds);
        while Instant::now() < end {
            if let Some(throttle) = command.throttle.get_mut(usize::from(motor) - 1) {
                *throttle = if Instant::now() < arming { 0.0 } else { self.throttle };
            }
            line.send(&command).map_err(|error| format!("the guard of the motors is gone: {error}"))?;
            std::thread::sleep(PERIOD);
        }
        line.send(&MotorCommand::default())?;
        writeln!(out, "motor {motor} stopped")?;
        Ok(())
    }
}

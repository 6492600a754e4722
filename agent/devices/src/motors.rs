//! Motors: pulses for speed controllers, and the guard that stops them whatever becomes of the agent.
//!
//! A PWM chip goes on with its last pulses for ever, whoever set them. So a process of its own, the guard, holds it: the
//! flight thread sends it a record a tick through a socket pair. When no record comes for [`SILENCE`], or the other end
//! closes (a killed process closes everything), the guard sets the pulses that stop.
//!
//! The command (0 to 1) is the pulse width scaled, as the fitted motor curve takes it (\[Clinic\] 5.5); 0 is the pulse at
//! which an ESC stands still.

use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::fs::OpenOptionsExt as _;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use plumbline_core::flight::Guide;
use plumbline_core::types::{MotorCommand, ROTORS};
use plumbline_core::vehicle::{AutopilotState, MOTOR_TIMEOUT_S, MotorStop};

use crate::fault::DeviceError;
use crate::port::{Bus, PortName};
use crate::protocol::pca9685;

/// Without a record for this long the motors stop: it and the ESC's own reaction fit the promised time-out.
pub const SILENCE: Duration = Duration::from_millis(60);
/// A channel of the kernel's PWM can be used this long after it was asked for: its group is given by udev.
const EXPORTED: Duration = Duration::from_secs(1);
/// Motors whose pulses cannot be set are tried to be stopped for this long.
pub const STOPPING: Duration = Duration::from_secs(60);
const STOP_AGAIN: Duration = Duration::from_millis(5);
/// Head, four commands, their sum.
pub const RECORD: usize = 10;
const HEAD: u8 = 0xA7;

/// Sets pulses.
pub trait Pulses: Send {
    /// Sets up, with no pulse yet.
    ///
    /// # Errors
    /// It cannot be reached, or is another chip.
    fn open(&mut self) -> Result<(), DeviceError>;

    /// Sets the pulse of each motor, µs.
    ///
    /// # Errors
    /// It cannot be reached.
    fn set(&mut self, widths_us: &[f64; ROTORS]) -> Result<(), DeviceError>;
}

/// A PCA9685.
pub struct Pca9685 {
    /// Its bus.
    pub port: PortName,
    /// Its address.
    pub address: u8,
    /// Its channel of each motor.
    pub channels: [u8; ROTORS],
    /// Pulses a second.
    pub rate_hz: f64,
    /// Open.
    pub bus: Option<Box<dyn Bus>>,
}

impl Pca9685 {
    fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let Some(bus) = &mut self.bus else { return Ok(()) };
        bus.transfer(self.address, bytes, &mut []).map_err(|error| self.port.error(error))
    }
}

impl Pulses for Pca9685 {
    fn open(&mut self) -> Result<(), DeviceError> {
        self.bus = Some(self.port.open_bus()?);
        let prescale = pca9685::prescale(self.rate_hz);
        self.write(&[pca9685::MODE1, pca9685::ASLEEP])?;
        self.write(&[pca9685::PRESCALE, prescale])?;
        self.write(&[pca9685::MODE1, pca9685::AWAKE])?;
        let mut found = [0];
        if let Some(bus) = &mut self.bus {
            let read = bus.transfer(self.address, &[pca9685::PRESCALE], &mut found);
            read.map_err(|error| self.port.error(error))?;
        }
        if found != [prescale] {
            let value = found[0].to_string();
            return Err(DeviceError::Wrong { what: "divider", value, expected: "what was written: a PCA9685" });
        }
        // Oscillator's start (data sheet 7.3.1.1).
        std::thread::sleep(Duration::from_millis(1));
        Ok(())
    }

    fn set(&mut self, widths_us: &[f64; ROTORS]) -> Result<(), DeviceError> {
        let prescale = pca9685::prescale(self.rate_hz);
        let [a, b, c, d] = self.channels;
        let register = |channel: u8| pca9685::CHANNELS + 4 * channel;
        if [b, c, d] == [a + 1, a + 2, a + 3] {
            // Neighbours go in one transfer.
            let mut message = arrayvec::ArrayVec::<u8, 17>::new();
            message.push(register(a));
            widths_us.iter().for_each(|width| message.extend(pca9685::encode_channel(*width, prescale)));
            return self.write(&message);
        }
        for (channel, width) in self.channels.into_iter().zip(widths_us) {
            let [w, x, y, z] = pca9685::encode_channel(*width, prescale);
            self.write(&[register(channel), w, x, y, z])?;
        }
        Ok(())
    }
}

/// The kernel's PWM: one chip's folder in `/sys/class/pwm`.
pub struct Sysfs {
    /// `/sys/class/pwm/pwmchip0`.
    pub chip: PathBuf,
    /// Its channel of each motor.
    pub channels: [u8; ROTORS],
    /// Pulses a second.
    pub rate_hz: f64,
}

impl Sysfs {
    fn write(&self, file: &str, value: u64) -> Result<(), DeviceError> {
        let path = self.chip.join(file);
        let mut options = File::options();
        let written = options
            .write(true)
            .truncate(true)
            // Whatever is there instead of the kernel's file is an error, never waited for: pulses that stop are tried again.
            .custom_flags(libc::O_NONBLOCK)
            .open(&path)
            .and_then(|mut f| f.write_all(format!("{value}\n").as_bytes()));
        written.map_err(|source| DeviceError::Port { port: path.display().to_string(), source })
    }
}

impl Pulses for Sysfs {
    fn open(&mut self) -> Result<(), DeviceError> {
        for channel in self.channels {
            let pulse = format!("pwm{channel}/duty_cycle");
            if !self.chip.join(format!("pwm{channel}")).exists() {
                self.write("export", channel.into())?;
            }
            let asked = Instant::now();
            loop {
                // A period below the pulse is refused, and a pulse before any period: the pulse goes first, if it can.
                let _ = self.write(&pulse, 0);
                match self.write(&format!("pwm{channel}/period"), (1e9 / self.rate_hz) as u64) {
                    Ok(()) => break,
                    Err(error) if asked.elapsed() > EXPORTED => return Err(error),
                    Err(_) => std::thread::sleep(STOP_AGAIN),
                }
            }
            self.write(&format!("pwm{channel}/enable"), 1)?;
        }
        Ok(())
    }

    fn set(&mut self, widths_us: &[f64; ROTORS]) -> Result<(), DeviceError> {
        for (channel, width) in self.channels.into_iter().zip(widths_us) {
            self.write(&format!("pwm{channel}/duty_cycle"), (width * 1e3) as u64)?;
        }
        Ok(())
    }
}

/// Pulse widths of commands 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PulseRange {
    /// At which an ESC stands still, µs.
    pub stop_us: f64,
    /// Full, µs.
    pub full_us: f64,
}

impl PulseRange {
    /// The pulses of a command.
    pub fn widths_us(&self, command: &MotorCommand) -> [f64; ROTORS] {
        command.throttle.map(|t| self.stop_us + (self.full_us - self.stop_us) * t.clamp(0.0, 1.0))
    }
}

/// A command on its way to the guard.
pub fn encode(command: &MotorCommand) -> [u8; RECORD] {
    let [a, b, c, d] =
        command.throttle.map(|t| ((if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) }) * 65_535.0).round() as u16);
    let ([a0, a1], [b0, b1], [c0, c1], [d0, d1]) = (a.to_le_bytes(), b.to_le_bytes(), c.to_le_bytes(), d.to_le_bytes());
    let sum = [a0, a1, b0, b1, c0, c1, d0, d1].iter().fold(HEAD, |sum: u8, byte| sum.wrapping_add(*byte));
    [HEAD, a0, a1, b0, b1, c0, c1, d0, d1, sum]
}

/// The newest whole record at the end of `bytes`, and how many bytes are dealt with.
fn newest(bytes: &[u8]) -> (Option<MotorCommand>, usize) {
    let (mut at, mut command) = (0, None);
    while let Some(record) = bytes.get(at..at + RECORD) {
        let (sum, rest) = record.split_last().unwrap_or((&0, &[]));
        let fits = record.first() == Some(&HEAD) && rest.iter().fold(0, |s: u8, b| s.wrapping_add(*b)) == *sum;
        if fits {
            let throttle = |motor: usize| f64::from(crate::framer::le::u16(record, 1 + 2 * motor)) / 65_535.0;
            command = Some(MotorCommand { throttle: std::array::from_fn(throttle) });
        }
        at += if fits { RECORD } else { 1 };
    }
    (command, at)
}

/// The guard: sets what comes through `socket`, and stops the motors when nothing does. Returns when the other end closed.
///
/// For `arming` at first only the pulse that stops is given, so that ESCs arm. Pulses that cannot be set are tried again
/// with the next command; after [`SILENCE`] of it the other end is told by closing `socket`.
///
/// # Errors
/// The pulses could not be set for [`SILENCE`]. Those that stop were tried again for [`STOPPING`], as the chip goes on with
/// its last.
pub fn guard(
    socket: &mut UnixStream,
    pulses: &mut dyn Pulses,
    range: PulseRange,
    arming: Duration,
) -> Result<(), DeviceError> {
    pulses.open()?;
    pulses.set(&[range.stop_us; ROTORS])?;
    let outcome = obey(socket, pulses, range, Instant::now() + arming);
    let _ = socket.shutdown(Shutdown::Both);
    stop(pulses, range)?;
    outcome
}

/// Sets what comes through `socket` until it is closed, or the pulses can be set no longer.
fn obey(
    socket: &mut UnixStream,
    pulses: &mut dyn Pulses,
    range: PulseRange,
    armed_at: Instant,
) -> Result<(), DeviceError> {
    let end = |source| DeviceError::Port { port: "the agent's socket".into(), source };
    socket.set_read_timeout(Some(SILENCE)).map_err(end)?;
    let (mut bytes, mut held) = ([0_u8; 64 * RECORD], 0);
    let mut turning = false;
    let mut set_last = Instant::now();
    loop {
        let outcome = socket.read(bytes.get_mut(held..).unwrap_or_default());
        let command = match outcome {
            Ok(0) => return Ok(()),
            Ok(count) => {
                held += count;
                let (command, used) = newest(bytes.get(..held).unwrap_or_default());
                bytes.copy_within(used..held, 0);
                held -= used;
                command
            }
            Err(error) if crate::port::timed_out(&error) => {
                if turning {
                    tracing::error!("no command for {} ms: motors stopped", SILENCE.as_millis());
                }
                Some(MotorCommand::default())
            }
            Err(error) => return Err(end(error)),
        };
        let Some(command) = command else { continue };
        let command = if Instant::now() < armed_at { MotorCommand::default() } else { command };
        let turns = command != MotorCommand::default();
        // What stands still and shall is not told again and again.
        if !turns && !turning {
            set_last = Instant::now();
            continue;
        }
        match pulses.set(&range.widths_us(&command)) {
            Ok(()) => (turning, set_last) = (turns, Instant::now()),
            Err(error) if set_last.elapsed() > SILENCE => return Err(error),
            Err(error) => tracing::warn!(%error, "pulses not set"),
        }
    }
}

/// Sets the pulses that stop, again and again while that fails.
fn stop(pulses: &mut dyn Pulses, range: PulseRange) -> Result<(), DeviceError> {
    until_done(|| pulses.set(&[range.stop_us; ROTORS]))
}

/// Stops motors that nobody holds any more, whatever they were left with.
///
/// # Errors
/// They could not be reached for [`STOPPING`].
pub fn stop_anew(pulses: &mut dyn Pulses, range: PulseRange) -> Result<(), DeviceError> {
    until_done(|| {
        pulses.open()?;
        pulses.set(&[range.stop_us; ROTORS])
    })
}

fn until_done(mut attempt: impl FnMut() -> Result<(), DeviceError>) -> Result<(), DeviceError> {
    let begun = Instant::now();
    loop {
        match attempt() {
            Err(error) if begun.elapsed() > STOPPING => return Err(error),
            Err(_) => std::thread::sleep(STOP_AGAIN),
            Ok(()) => return Ok(()),
        }
    }
}

/// The right to set the pulses of `port`, for as long as it is kept; `None` while another program has it.
///
/// What is locked is the port itself, which everybody sees by one name, also a unit with folders of its own.
///
/// # Errors
/// It cannot be opened.
pub fn claim(port: &str) -> Result<Option<File>, DeviceError> {
    let opened = match PortName::parse(port) {
        // A socket cannot be opened: the lock lies beside it.
        Some(PortName::Socket(path)) => File::create(format!("{path}.lock")),
        _ => File::open(port),
    };
    let failed = |source| DeviceError::Port { port: port.to_owned(), source };
    let file = opened.map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Ok(None),
        Err(std::fs::TryLockError::Error(error)) => Err(failed(error)),
    }
}

/// What the flight thread commands: the motors, or an autopilot in front of them.
pub trait Motors: MotorStop {
    /// Hands a command over without waiting; returns what is applied.
    ///
    /// # Errors
    /// Nobody is there any more who would apply it.
    fn send(&self, command: &MotorCommand) -> io::Result<MotorCommand>;

    /// What an autopilot flies by whose own controller flies; `None` where nothing carries a flight.
    fn guide(&self, guide: Option<&Guide<'_>>) {
        let _ = guide;
    }

    /// The autopilot, where it is one.
    fn autopilot(&self) -> Option<AutopilotState> {
        None
    }
}

impl Motors for GuardLine {
    fn send(&self, command: &MotorCommand) -> io::Result<MotorCommand> {
        Self::send(self, command).map(|()| *command)
    }
}

/// The agent's end of the guard's socket.
#[derive(Debug)]
pub struct GuardLine(UnixStream);

impl GuardLine {
    /// Over `socket`, which will not block.
    ///
    /// # Errors
    /// The socket cannot be set so.
    pub fn new(socket: UnixStream) -> io::Result<Self> {
        socket.set_nonblocking(true)?;
        Ok(Self(socket))
    }

    /// Sends a command; one for which there is no room is given up, as the guard stops the motors then.
    ///
    /// # Errors
    /// The guard is gone.
    pub fn send(&self, command: &MotorCommand) -> io::Result<()> {
        match (&self.0).write(&encode(command)) {
            Err(error) if error.kind() != ErrorKind::WouldBlock => Err(error),
            _ => Ok(()),
        }
    }
}

impl MotorStop for GuardLine {
    fn stop(&self) {
        if let Err(error) = self.send(&MotorCommand::default()) {
            tracing::error!(%error, "the motor guard is gone");
        }
    }
}

const _: () = assert!(SILENCE.as_millis() < (MOTOR_TIMEOUT_S * 1e3) as u128, "the guard keeps the promise");

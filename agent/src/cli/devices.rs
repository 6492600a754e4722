//! What is attached, and what it says.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use plumbline_agent::config::AgentConfig;
use plumbline_devices::port::serial_ports;
use plumbline_devices::reader::Zero;
use plumbline_devices::spec::DeviceSpec;

use super::{Failure, in_file};

/// How long devices are given to answer.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often what a device says is shown.
const SHOWN: Duration = Duration::from_millis(200);

/// Lists ports and what answers on them, or shows one device's stream.
#[derive(Debug, clap::Args)]
pub struct DevicesArguments {
    /// Configuration with `[[device]]`.
    #[arg(long)]
    config: Option<PathBuf>,
    #[command(subcommand)]
    what: Option<What>,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Shows a device's readings.
    Test {
        /// Its name in the configuration.
        name: String,
        /// How long, s.
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
    },
}

impl DevicesArguments {
    /// Does what is asked.
    pub fn run(&self) -> Result<(), Failure> {
        let devices = match &self.config {
            Some(file) => AgentConfig::read(file)?.device,
            None => Vec::new(),
        };
        match &self.what {
            None => list(&devices),
            Some(What::Test { name, seconds }) => {
                let device = devices.iter().find(|device| device.name == *name);
                let file = self.config.as_deref().ok_or("devices test: needs --config with [[device]]")?;
                let known = || devices.iter().map(|d| d.name.as_str()).collect::<Vec<_>>().join(", ");
                let device =
                    device.ok_or_else(|| in_file(file, format!("no device {name:?}; there are {}", known())))?;
                show(device, Duration::try_from_secs_f64(*seconds)?)
            }
        }
    }
}

/// Ports, and the devices of the configuration with what they do within [`PATIENCE`].
fn list(devices: &[DeviceSpec]) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    for port in serial_ports() {
        writeln!(out, "port    {}", port.display())?;
    }
    let zero = Zero::default();
    zero.set(Instant::now());
    let mut started = Vec::new();
    for device in devices {
        started.extend(device.start(&zero)?.map(|(_, reader)| (device, reader)));
    }
    let begun = Instant::now();
    let waiting = |(_, reader): &(_, plumbline_devices::reader::Reader)| !reader.state().health().up;
    while begun.elapsed() < PATIENCE && started.iter().any(waiting) {
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_millis(500).min(PATIENCE));
    for (device, reader) in &started {
        let health = reader.state().health();
        let rate_hz = health.readings as f64 / begun.elapsed().as_secs_f64();
        let state = if health.up { format!("up, about {rate_hz:.0} readings/s") } else { "no".to_owned() };
        let DeviceSpec { name, driver, port, .. } = device;
        write!(out, "device  {name}: {driver:?} on {port}: {state}, {} faults", health.faults)?;
        writeln!(out, "{}{}", if health.reason.is_empty() { "" } else { ": " }, health.reason)?;
    }
    Ok(())
}

/// The readings of one device, a few a second, and how it does at the end.
fn show(device: &DeviceSpec, span: Duration) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    let zero = Zero::default();
    zero.set(Instant::now());
    let Some((_, mut reader)) = device.start(&zero)? else {
        return Err(format!("{}: no such port", device.port).into());
    };
    let begun = Instant::now();
    while begun.elapsed() < span {
        std::thread::sleep(SHOWN);
        let newest = std::iter::from_fn(|| reader.pop()).last();
        let health = reader.state().health();
        match newest {
            Some(arrived) => writeln!(out, "{:9.3} s  {:?}", arrived.time.as_seconds(), arrived.reading)?,
            None => writeln!(out, "           nothing: {}", health.reason)?,
        }
    }
    let health = reader.state().health();
    writeln!(
        out,
        "{} readings, {} faults, jitter {:.0} µs, clock {:+.1} ppm, opened {} times; {}",
        health.readings,
        health.faults,
        health.jitter_us,
        1e6 * health.skew,
        health.opened,
        if health.reason.is_empty() { "no fault" } else { &health.reason }
    )?;
    Ok(())
}

//! What is attached, and what it says.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use plumbline_agent::config::AgentConfig;
use plumbline_agent::sensor::suite::Suite;
use plumbline_devices::port::{PortName, buses, serial_ports};
use plumbline_devices::reader::Zero;
use plumbline_devices::spec::{DeviceSpec, DriverKind};
use plumbline_proto::ids::SensorId;

use super::{Failure, in_file};

/// How long devices are given to answer.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long each driver tries a port: a BNO055 needs a second to start.
const ANSWER: Duration = Duration::from_millis(2500);
/// A GNSS receiver has a fix a second, as it is made.
const FIXES: Duration = Duration::from_millis(4500);
/// How long the readings of a device that was found are counted.
const COUNTED: Duration = Duration::from_secs(1);
/// So many are no noise that looks like one.
const FIRST_READINGS: u64 = 3;
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
    /// Asks what answers, driver by driver, and writes what was found as `[[device]]`. On the bench: other devices are sent
    /// what they may not understand.
    Probe {
        /// Ports; where none is named every serial port and I²C bus that no `[[device]]` has.
        ports: Vec<String>,
    },
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
            Some(What::Probe { ports }) if ports.is_empty() => {
                let all = serial_ports().into_iter().chain(buses()).map(|port| port.display().to_string());
                let free: Vec<String> = all.filter(|port| devices.iter().all(|device| device.port != *port)).collect();
                probe(&free)
            }
            Some(What::Probe { ports }) => probe(ports),
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
    for port in serial_ports().into_iter().chain(buses()) {
        writeln!(out, "port    {}", port.display())?;
    }
    let zero = Zero::default();
    zero.set(Instant::now());
    let mut started = Vec::new();
    for device in devices {
        started.extend(device.start(&zero, false)?.map(|(_, reader)| (device, reader)));
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

/// What answers on each of `ports`, as tables of a configuration; every port at a time of its own.
fn probe(ports: &[String]) -> Result<(), Failure> {
    if ports.is_empty() {
        return Err("devices probe: there is no port that is free; name one".into());
    }
    if let Some(port) = ports.iter().find(|port| DeviceSpec::guesses(port).is_empty()) {
        return Err(format!("devices probe: {port:?} is no serial port and no I²C bus").into());
    }
    let found: Vec<_> = std::thread::scope(|scope| {
        let asked: Vec<_> = ports.iter().map(|port| scope.spawn(|| found_on(port))).collect();
        asked.into_iter().map(|thread| thread.join().unwrap_or_default()).collect()
    });
    let mut out = std::io::stdout();
    // Of each kind of sensor, how many there are; of some there is room for few.
    let (mut counts, mut suite) = (BTreeMap::<i32, u8>::new(), Suite::empty());
    for (port, found) in ports.iter().zip(found) {
        if found.is_empty() {
            writeln!(out, "# {port}: nothing that a driver knows\n")?;
        }
        for Found { device, rate_hz } in found {
            // As a configuration has it.
            let driver = format!("{:?}", device.driver).to_lowercase();
            let (mut sensors, mut left_out) = (Vec::new(), String::new());
            for kind in device.driver.kinds() {
                let count = counts.entry(*kind as i32).or_default();
                let next = SensorId::new(*kind, *count + 1);
                if suite.add(*kind) {
                    *count += 1;
                    sensors.push(format!("\"{next}\""));
                } else {
                    left_out += &format!(", no room for {next}");
                }
            }
            let place = counts.values().sum::<u8>();
            writeln!(out, "[[device]] # {rate_hz:.0} readings/s{left_out}")?;
            writeln!(out, "name = \"{driver:.6} {place}\"\ndriver = \"{driver}\"\nport = \"{port}\"")?;
            if let Some(baud) = device.baud {
                writeln!(out, "baud = {baud}")?;
            }
            if let Some(address) = device.address {
                writeln!(out, "address = {address}")?;
            }
            writeln!(out, "sensors = [{}]\n", sensors.join(", "))?;
        }
    }
    Ok(())
}

struct Found {
    device: DeviceSpec,
    rate_hz: f64,
}

/// One device of a serial port, every one of a bus.
fn found_on(port: &str) -> Vec<Found> {
    let serial = matches!(PortName::parse(port), Some(PortName::Serial(_)));
    let mut found: Vec<Found> = Vec::new();
    for device in DeviceSpec::guesses(port) {
        let taken = |other: &Found| serial || other.device.address() == device.address();
        if found.iter().any(taken) {
            continue;
        }
        let zero = Zero::default();
        zero.set(Instant::now());
        let Ok(Some((_, reader))) = device.start(&zero, false) else { continue };
        let (begun, answer) = (Instant::now(), if device.driver == DriverKind::Gnss { FIXES } else { ANSWER });
        while begun.elapsed() < answer && reader.state().health().readings < FIRST_READINGS {
            std::thread::sleep(Duration::from_millis(20));
        }
        let first = reader.state().health().readings;
        if first >= FIRST_READINGS {
            std::thread::sleep(COUNTED);
            let more = reader.state().health().readings - first;
            found.push(Found { device, rate_hz: more as f64 / COUNTED.as_secs_f64() });
        }
    }
    found
}

/// The readings of one device, a few a second, and how it does at the end.
fn show(device: &DeviceSpec, span: Duration) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    let zero = Zero::default();
    zero.set(Instant::now());
    let Some((_, mut reader)) = device.start(&zero, false)? else {
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
        "{} readings, {} faults, jitter {:.0} µs, clock {:+.1} ppm{}, opened {} times; {}",
        health.readings,
        health.faults,
        health.jitter_us,
        1e6 * health.skew,
        if health.round_trip_us > 0.0 {
            format!(", round trip {:.0} µs", health.round_trip_us)
        } else {
            String::new()
        },
        health.opened,
        if health.reason.is_empty() { "no fault" } else { &health.reason }
    )?;
    Ok(())
}

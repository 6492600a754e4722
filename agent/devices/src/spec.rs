//! `[[device]]` and `[motors]` of a configuration: what is attached where. Checked as a whole before anything is opened.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use plumbline_core::model::geodesy::{Geodetic, TangentPlane};
use plumbline_core::sensor::suite::Suite;
use plumbline_core::types::{Actuation, ROTORS};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use serde::Deserialize;

use crate::autopilot::{Attachment, Autopilot};
use crate::driver::Driver;
use crate::driver::bno055::Bno055;
use crate::driver::hokuyo::Hokuyo;
use crate::driver::invensense::Invensense;
use crate::driver::mavlink::Mavlink;
use crate::driver::mocap::{Mocap, System};
use crate::driver::registers::{Chip, Registers};
use crate::driver::stream::Talker;
use crate::motors::{Pca9685, PulseRange, Pulses, Sysfs};
use crate::port::PortName;
use crate::protocol::gnss::GnssStream;
use crate::protocol::mavlink::Signer;
use crate::protocol::mongoose::Mongoose;
use crate::protocol::tfmini::TfMini;
use crate::reader::{Options, Reader, Zero};
use crate::vehicle::Mounted;

/// What is wrong with a table of the configuration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value} is not {expected}")]
pub struct SpecError {
    /// Which `[[device]]`, from 0; `None` for `[motors]`.
    pub device: Option<usize>,
    /// The key.
    pub key: &'static str,
    /// The offending value.
    pub value: String,
    /// What it should be.
    pub expected: &'static str,
}

/// A device by its driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DriverKind {
    /// Bosch BNO055 on a serial port or I²C.
    Bno055,
    /// InvenSense MPU or ICM on I²C or SPI.
    Invensense,
    /// UART IMU with barometer.
    Mongoose,
    /// Hokuyo URG-04LX, looking down.
    Hokuyo,
    /// Benewake TFmini, looking down.
    Tfmini,
    /// GNSS receiver, UBX or NMEA.
    Gnss,
    /// OptiTrack.
    Natnet,
    /// Vicon.
    Vicon,
    /// Barometer on I²C.
    Ms5611,
    /// Barometer on I²C.
    Bmp280,
    /// Voltage of the battery on I²C.
    Ina219,
    /// Voltage of the battery on I²C.
    Ina226,
    /// A PX4 autopilot's own sensors and voltage.
    Mavlink,
}

impl DriverKind {
    /// Kinds of sensors it may be; a voltage is none.
    pub fn kinds(self) -> &'static [SensorKind] {
        match self {
            Self::Bno055 | Self::Invensense => &[SensorKind::Imu],
            Self::Mongoose => &[SensorKind::Imu, SensorKind::Barometer],
            Self::Hokuyo | Self::Tfmini => &[SensorKind::Height],
            Self::Gnss => &[SensorKind::Gnss],
            Self::Natnet | Self::Vicon => &[SensorKind::MocapPose],
            Self::Ms5611 | Self::Bmp280 => &[SensorKind::Barometer],
            Self::Ina219 | Self::Ina226 => &[],
            Self::Mavlink => &[SensorKind::Imu, SensorKind::Height, SensorKind::Barometer],
        }
    }

    /// Can it be set to another baud rate?
    fn any_baud(self) -> bool {
        matches!(self, Self::Mongoose | Self::Tfmini | Self::Gnss | Self::Mavlink)
    }

    /// Usual baud rate, address and rate, Hz.
    fn usual(self) -> (u32, u8, f64) {
        match self {
            Self::Bno055 => (115_200, 0x28, 100.0),
            Self::Invensense => (0, 0x68, 200.0),
            Self::Mongoose | Self::Tfmini => (115_200, 0, 100.0),
            Self::Hokuyo => (115_200, 0, 10.0),
            Self::Gnss => (38_400, 0, 5.0),
            Self::Natnet | Self::Vicon => (0, 0, 100.0),
            Self::Ms5611 => (0, 0x77, 40.0),
            Self::Bmp280 => (0, 0x76, 50.0),
            Self::Ina219 | Self::Ina226 => (0, 0x40, 10.0),
            Self::Mavlink => (921_600, 0, 200.0),
        }
    }
}

/// One `[[device]]`: one field for each key, hence so many.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceSpec {
    /// For people; unique.
    pub name: String,
    /// What it is.
    pub driver: DriverKind,
    /// Where; see [`crate::port`].
    pub port: String,
    /// Which sensors it is, as `["imu 1"]`; a voltage is none.
    #[serde(default)]
    pub sensors: Vec<String>,
    /// Baud rate; usual for the device when left out, and the only one of a BNO055 or Hokuyo.
    pub baud: Option<u32>,
    /// I²C address.
    pub address: Option<u8>,
    /// Readings a second; usual for the device when left out.
    pub rate_hz: Option<f64>,
    /// Constant latency, s.
    #[serde(default)]
    pub delay_s: f64,
    /// One-sigma of its first quantity (rad/s, m, Pa, m), as estimators assume it; typical when left out.
    pub sigma: Option<f64>,
    /// Where it sits, FLU from the centre of mass, m.
    #[serde(default)]
    pub position_flu_m: Vector3<f64>,
    /// Roll, pitch, yaw of its axes in the body, rad.
    #[serde(default)]
    pub mounting_rpy_rad: Vector3<f64>,
    /// Its calibration, as `plumbline-agent calibrate` writes it.
    pub calibration: Option<PathBuf>,
    /// NatNet: streaming id of the rigid body. Vicon: name of the object.
    #[serde(default)]
    pub body: String,
    /// NatNet: `address:port` of its commands.
    pub server: Option<SocketAddr>,
    /// Motion capture: which of its axes is up, `y` or `z`.
    pub up: Option<String>,
    /// GNSS: latitude, longitude (deg), altitude (m) of the world's origin; the first fix when left out.
    pub origin: Option<[f64; 3]>,
    /// Voltage: of the battery for one volt at the chip.
    pub divider: Option<f64>,
    /// Scanner: whole scans go into the flight file, too.
    #[serde(default)]
    pub record_scans: bool,
}

/// `[motors]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorsSpec {
    /// `pca9685`, `sysfs`, or `mavlink`: an autopilot in front of them.
    pub driver: String,
    /// Bus of the chip, the folder of the kernel's PWM chip, or the autopilot's port, as its device says.
    pub port: String,
    /// I²C address.
    #[serde(default = "pca9685_address")]
    pub address: u8,
    /// Channel of each motor, in the order of the airframe; an autopilot's output of it, from 0.
    #[serde(default = "first_four")]
    pub channels: [u8; ROTORS],
    /// Pulses a second.
    #[serde(default = "pulse_rate_hz")]
    pub rate_hz: f64,
    /// Pulse at which the ESCs stand still, and at full, µs; of an autopilot's outputs too.
    #[serde(default = "pulse_us")]
    pub pulse_us: [f64; 2],
    /// The pulse that stands still is given this long before any other, s: ESCs arm.
    #[serde(default = "arming_s")]
    pub arming_s: f64,
    /// An autopilot's: number of its system.
    #[serde(default = "first_system")]
    pub system: u8,
    /// What it is given: `rates`, with thrust, or `pose`, our estimate and a place, which its own controller flies by.
    pub depth: Option<String>,
    /// File with the key that both sides sign their messages with: 32 bytes, or 64 hexadecimal digits.
    pub signing_key: Option<PathBuf>,
    /// Thrust at which it hovers, 0 to 1.
    #[serde(default = "hover_thrust")]
    pub hover_thrust: f64,
    /// Time constant of its rate loop, s.
    #[serde(default = "rate_loop_s")]
    pub rate_loop_s: f64,
}

/// Bits a second on an autopilot's wire with `rate_hz` IMU samples a second: see [`crate::driver::mavlink`] for the rest.
fn autopilot_baud(rate_hz: f64) -> f64 {
    10.0 * (75.0 * rate_hz + 7800.0)
}

fn pca9685_address() -> u8 {
    0x40
}
fn first_four() -> [u8; ROTORS] {
    [0, 1, 2, 3]
}
fn pulse_rate_hz() -> f64 {
    400.0
}
fn pulse_us() -> [f64; 2] {
    [1000.0, 2000.0]
}
fn arming_s() -> f64 {
    2.0
}
fn first_system() -> u8 {
    1
}
fn hover_thrust() -> f64 {
    0.5
}
fn rate_loop_s() -> f64 {
    0.05
}

/// Farthest from the centre of mass that anything of a lab quadrotor sits, m.
const LEVER_MAX_M: f64 = 1.0;

impl DeviceSpec {
    /// Readings a second.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz.unwrap_or(self.driver.usual().2)
    }

    /// Baud rate of its serial port; 0 of a device that has none.
    pub fn baud(&self) -> u32 {
        self.baud.unwrap_or(self.driver.usual().0)
    }

    /// I²C address; 0 of a device that has none.
    pub fn address(&self) -> u8 {
        self.address.unwrap_or(self.driver.usual().1)
    }

    /// Its sensors that can be read.
    pub fn ids(&self) -> impl Iterator<Item = SensorId> {
        self.sensors.iter().filter_map(|name| name.parse().ok())
    }

    fn check(&self) -> Result<(), (&'static str, String, &'static str)> {
        if self.name.is_empty() || self.name.len() > 10 {
            return Err(("name", format!("{:?}", self.name), "1 to 10 characters"));
        }
        let port = PortName::parse(&self.port);
        let fits = match self.driver {
            DriverKind::Bno055 => matches!(port, Some(PortName::Serial(_) | PortName::I2c(_) | PortName::Socket(_))),
            DriverKind::Natnet | DriverKind::Vicon => matches!(port, Some(PortName::Datagrams(_))),
            DriverKind::Mavlink => matches!(port, Some(PortName::Datagrams(_) | PortName::Serial(_))),
            DriverKind::Invensense => {
                matches!(port, Some(PortName::I2c(_) | PortName::Socket(_) | PortName::Spi(_)))
            }
            _ if self.driver.usual().0 > 0 => matches!(port, Some(PortName::Serial(_))),
            _ => matches!(port, Some(PortName::I2c(_) | PortName::Socket(_))),
        };
        if !fits {
            return Err(("port", format!("{:?}", self.port), "a port that this driver can use"));
        }
        for name in &self.sensors {
            let id = name.parse::<SensorId>().ok();
            if !id.is_some_and(|id| id.instance > 0 && self.driver.kinds().contains(&id.kind)) {
                return Err(("sensors", format!("{name:?}"), "a sensor that this driver gives, as \"imu 1\""));
            }
        }
        let numbers = || self.ids().filter(|id| id.kind != SensorKind::Barometer).map(|id| id.instance);
        if numbers().any(|number| numbers().any(|other| other != number)) {
            return Err((
                "sensors",
                format!("{:?}", self.sensors),
                "sensors of one number, as \"imu 1\", \"height 1\"",
            ));
        }
        let within = |key, value: f64, min: f64, max: f64, expected| {
            // A NaN fails both comparisons.
            if value >= min && value <= max { Ok(()) } else { Err((key, value.to_string(), expected)) }
        };
        if let Some(baud) = self.baud {
            let usual = self.driver.usual().0;
            match port {
                Some(PortName::Serial(_)) if self.driver.any_baud() => {
                    within("baud", baud.into(), 1200.0, 4e6, "1200 to 4000000")?;
                }
                Some(PortName::Serial(_)) if baud == usual => {}
                Some(PortName::Serial(_)) => {
                    return Err(("baud", baud.to_string(), "115200, the only one of this device"));
                }
                _ => return Err(("baud", baud.to_string(), "for this port: only a serial one has a baud rate")),
            }
        }
        let serial = matches!(port, Some(PortName::Serial(_)));
        if self.driver == DriverKind::Mavlink && serial && f64::from(self.baud()) < autopilot_baud(self.rate_hz()) {
            let expected =
                "enough for its messages: ten bits a byte, 75 bytes an IMU sample, 7800 bytes a second besides";
            return Err(("baud", self.baud().to_string(), expected));
        }
        within("rate_hz", self.rate_hz(), 0.1, 1000.0, "0.1 to 1000 Hz")?;
        within("delay_s", self.delay_s, 0.0, 1.0, "0 to 1 s")?;
        within("sigma", self.sigma.unwrap_or(1.0), 1e-9, 1e6, "a positive number")?;
        within("divider", self.divider.unwrap_or(1.0), 0.01, 1000.0, "0.01 to 1000")?;
        within("address", self.address().into(), if self.driver.usual().1 > 0 { 8.0 } else { 0.0 }, 119.0, "8 to 119")?;
        for value in self.position_flu_m.iter() {
            within("position_flu_m", *value, -LEVER_MAX_M, LEVER_MAX_M, "within 1 m of the centre of mass")?;
        }
        for value in self.mounting_rpy_rad.iter() {
            within("mounting_rpy_rad", *value, -std::f64::consts::TAU, std::f64::consts::TAU, "angles within ±2π rad")?;
        }
        if self.record_scans && (self.driver != DriverKind::Hokuyo || self.ids().next().is_none()) {
            return Err(("record_scans", "true".into(), "for this device: only a hokuyo that is a height has scans"));
        }
        if !matches!(self.up.as_deref(), None | Some("y" | "z")) {
            return Err(("up", format!("{:?}", self.up), "\"y\" or \"z\""));
        }
        if self.driver == DriverKind::Natnet && (self.server.is_none() || self.body.parse::<i32>().is_err()) {
            return Err(("body", format!("{:?}", self.body), "the number of a rigid body, beside a `server`"));
        }
        if self.driver == DriverKind::Vicon && !(1..=24).contains(&self.body.len()) {
            return Err(("body", format!("{:?}", self.body), "the name of an object, 1 to 24 characters"));
        }
        Ok(())
    }

    /// What could be on `port`, to be tried one after the other: each driver that tells its own device from others, at its
    /// usual addresses and baud rates. Never the address of motors.
    pub fn guesses(port: &str) -> Vec<Self> {
        let guess = |driver, baud, address| Self {
            name: "guess".into(),
            driver,
            port: port.into(),
            sensors: Vec::new(),
            baud,
            address,
            rate_hz: None,
            delay_s: 0.0,
            sigma: None,
            position_flu_m: Vector3::zeros(),
            mounting_rpy_rad: Vector3::zeros(),
            calibration: None,
            body: String::new(),
            server: None,
            up: None,
            origin: None,
            divider: None,
            record_scans: false,
        };
        match PortName::parse(port) {
            // Those that only talk first: nothing is written to them.
            Some(PortName::Serial(_)) => vec![
                guess(DriverKind::Tfmini, None, None),
                guess(DriverKind::Mongoose, None, None),
                guess(DriverKind::Gnss, None, None),
                guess(DriverKind::Gnss, Some(9600), None),
                guess(DriverKind::Mavlink, None, None),
                guess(DriverKind::Hokuyo, None, None),
                guess(DriverKind::Bno055, None, None),
            ],
            Some(PortName::I2c(_) | PortName::Socket(_)) => [
                (DriverKind::Bno055, [0x28, 0x29]),
                (DriverKind::Invensense, [0x68, 0x69]),
                (DriverKind::Bmp280, [0x76, 0x77]),
                (DriverKind::Ms5611, [0x76, 0x77]),
            ]
            .into_iter()
            .flat_map(|(driver, addresses)| addresses.map(|address| guess(driver, None, Some(address))))
            .collect(),
            Some(PortName::Spi(_)) => vec![guess(DriverKind::Invensense, None, None)],
            _ => Vec::new(),
        }
    }

    /// Its driver, closed; `None` for a port that a check would have refused.
    pub fn driver(&self) -> Option<Box<dyn Driver>> {
        let port = PortName::parse(&self.port)?;
        let (baud, rate_hz) = (self.baud(), self.rate_hz());
        let chip = |port, chip| -> Box<dyn Driver> {
            Box::new(Registers::new(port, self.address(), chip, rate_hz, self.divider.unwrap_or(1.0)))
        };
        Some(match self.driver {
            DriverKind::Bno055 => Box::new(Bno055::new(port, self.address(), rate_hz)),
            DriverKind::Invensense => Box::new(Invensense::new(port, self.address(), rate_hz)),
            DriverKind::Mongoose => Box::new(Talker::<Mongoose>::new(port, baud)),
            DriverKind::Tfmini => Box::new(Talker::<TfMini>::new(port, baud)),
            DriverKind::Gnss => Box::new(Talker::<GnssStream>::new(port, baud)),
            DriverKind::Hokuyo => Box::new(Hokuyo::new(port)),
            DriverKind::Natnet => {
                let system = System::NatNet { server: self.server?, id: self.body.parse().ok()?, rate_hz };
                Box::new(Mocap::new(port, system))
            }
            DriverKind::Vicon => Box::new(Mocap::new(port, System::Vicon { object: self.body.clone(), rate_hz })),
            DriverKind::Ms5611 => chip(port, Chip::Ms5611([0; 8])),
            DriverKind::Bmp280 => chip(port, Chip::Bmp280([0; 24])),
            DriverKind::Ina219 => chip(port, Chip::Ina219),
            DriverKind::Ina226 => chip(port, Chip::Ina226),
            DriverKind::Mavlink => {
                let autopilot = Autopilot::new(Attachment::new(port, baud));
                Box::new(Mavlink::new(Arc::new(autopilot), rate_hz))
            }
        })
    }

    /// Its driver in a thread, with `real_time` priority for a flight, and where it sits; `None` for a port that a check would have
    /// refused.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn start(&self, zero: &Zero, real_time: bool) -> std::io::Result<Option<(Mounted, Reader)>> {
        self.driver().map(|driver| self.start_with(driver, zero, real_time)).transpose()
    }

    /// `driver` in a thread, with `real_time` priority for a flight, and where this device sits.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn start_with(
        &self,
        driver: Box<dyn Driver>,
        zero: &Zero,
        real_time: bool,
    ) -> std::io::Result<(Mounted, Reader)> {
        let place = |barometer: bool| {
            let own = self.ids().find(|id| (id.kind == SensorKind::Barometer) == barometer);
            own.map_or(usize::MAX, |id| usize::from(id.instance) - 1)
        };
        let rpy = self.mounting_rpy_rad;
        // Up along y becomes up along z.
        let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
        let mounted = Mounted {
            name: self.name.clone(),
            port: self.port.clone(),
            index: place(false),
            barometer: place(true),
            body_from_sensor: Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z),
            position_flu_m: self.position_flu_m,
            origin: self.origin.map(|[lat, lon, alt]| TangentPlane::new(Geodetic::from_degrees(lat, lon, alt))),
            world_from_mocap: if self.up.as_deref() == Some("y") { upright } else { UnitQuaternion::identity() },
        };
        // A device of 1 Hz is not silent after one second.
        let silence = Duration::from_secs_f64((5.0 / self.rate_hz()).max(0.5));
        let (name, record_scans) = (self.name.clone(), self.record_scans);
        let options = Options { name, delay_s: self.delay_s, silence, real_time, record_scans };
        Ok((mounted, Reader::start(driver, options, zero.clone())?))
    }
}

/// Checks every device, and that no two of them claim the same.
///
/// # Errors
/// [`SpecError`] of the first bad one.
pub fn check(devices: &[DeviceSpec]) -> Result<(), SpecError> {
    for (index, device) in devices.iter().enumerate() {
        let bad = |key, value, expected| SpecError { device: Some(index), key, value, expected };
        device.check().map_err(|(key, value, expected)| bad(key, value, expected))?;
        if device.sensors.is_empty() && !measures_voltage(device.driver) {
            // Its readings would go nowhere.
            return Err(bad("sensors", "[]".into(), "the sensors that it is, as \"imu 1\""));
        }
        for other in devices.iter().take(index) {
            if other.name == device.name {
                return Err(bad("name", format!("{:?}", device.name), "a name of its own"));
            }
            let shared = matches!(PortName::parse(&device.port), Some(PortName::I2c(_) | PortName::Socket(_)));
            if other.port == device.port && (!shared || other.address() == device.address()) {
                let (key, value) = if shared {
                    ("address", device.address().to_string())
                } else {
                    ("port", format!("{:?}", device.port))
                };
                return Err(bad(key, value, "a port, or an address on it, that no other device has"));
            }
            if let Some(twice) = device.sensors.iter().find(|name| other.sensors.contains(name)) {
                return Err(bad("sensors", format!("{twice:?}"), "a sensor that no other device is"));
            }
        }
    }
    suite(devices).map(drop)
}

fn measures_voltage(driver: DriverKind) -> bool {
    driver.kinds().is_empty() || driver == DriverKind::Mavlink
}

/// The suite that these devices are, with the data sheets of typical units.
///
/// # Errors
/// [`SpecError`]: instances of a kind do not count up from 1, or there are too many.
pub fn suite(devices: &[DeviceSpec]) -> Result<Suite, SpecError> {
    let mut suite = Suite { battery_sigma_v: None, ..Suite::empty() };
    let mut all: Vec<(SensorId, usize)> =
        devices.iter().enumerate().flat_map(|(index, device)| device.ids().map(move |id| (id, index))).collect();
    all.sort_by_key(|(id, _)| (id.kind as i32, id.instance));
    for (id, index) in &all {
        let fits = suite.add(id.kind) && suite.contains(*id);
        if !fits {
            let value = format!("{:?}", id.to_string());
            let expected = "the next instance of its kind, counted from 1";
            return Err(SpecError { device: Some(*index), key: "sensors", value, expected });
        }
    }
    let of = |wanted: SensorId| all.iter().find(|(id, _)| *id == wanted).and_then(|(_, index)| devices.get(*index));
    suite.sheets_mut(|id, sheet| {
        let Some(device) = of(id) else { return };
        let timing = sheet.timing_mut();
        (timing.rate_hz, timing.delay_s, timing.phase_s) = (device.rate_hz(), device.delay_s, 0.0);
        let mut first = device.sigma;
        sheet.qualities(&mut |_, quality| {
            if let Some(sigma) = first.take() {
                quality.sigma = sigma;
            }
        });
    });
    let place = |kind: SensorKind, index: usize| of(SensorId::new(kind, index as u8 + 1));
    for (index, imu) in suite.imus.iter_mut().enumerate() {
        if let Some(device) = place(SensorKind::Imu, index) {
            (imu.position_flu_m, imu.mounting_rpy_rad) = (device.position_flu_m, device.mounting_rpy_rad);
        }
    }
    for (index, height) in suite.heights.iter_mut().enumerate() {
        if let Some(device) = place(SensorKind::Height, index) {
            height.position_flu_m = device.position_flu_m;
        }
    }
    if devices.iter().any(|device| measures_voltage(device.driver)) {
        suite.battery_sigma_v = Some(0.02);
    }
    Ok(suite)
}

impl MotorsSpec {
    /// Checks every value.
    ///
    /// # Errors
    /// [`SpecError`] of the first bad one.
    pub fn check(&self) -> Result<(), SpecError> {
        let bad = |key, value, expected| Err(SpecError { device: None, key, value, expected });
        let port = PortName::parse(&self.port);
        let bus = matches!(port, Some(PortName::I2c(_) | PortName::Socket(_)));
        match self.driver.as_str() {
            "pca9685" if bus => {}
            "sysfs" if self.port.starts_with('/') => {}
            "mavlink" if matches!(port, Some(PortName::Datagrams(_) | PortName::Serial(_))) => {}
            "pca9685" | "sysfs" | "mavlink" => {
                return bad(
                    "port",
                    format!("{:?}", self.port),
                    "a bus, the folder of a PWM chip, or an autopilot's serial port or udp",
                );
            }
            _ => return bad("driver", format!("{:?}", self.driver), "\"pca9685\", \"sysfs\" or \"mavlink\""),
        }
        match self.depth.as_deref() {
            None => {}
            Some("rates" | "pose") if self.is_autopilot() => {}
            Some("rates" | "pose") => {
                return bad("depth", format!("{:?}", self.depth), "for these motors: only an autopilot has it");
            }
            Some(other) => return bad("depth", format!("{other:?}"), "\"rates\" or \"pose\""),
        }
        if let Some(key) = self.signing_key.as_ref().filter(|_| !self.is_autopilot()) {
            return bad("signing_key", format!("{key:?}"), "for these motors: only an autopilot signs");
        }
        if !(50.0..=400.0).contains(&self.rate_hz) {
            return bad("rate_hz", self.rate_hz.to_string(), "50 to 400 Hz");
        }
        let [stop, full] = self.pulse_us;
        if !(stop >= 500.0 && full > stop && full <= 2500.0_f64.min(0.95e6 / self.rate_hz)) {
            return bad(
                "pulse_us",
                format!("[{stop}, {full}]"),
                "two rising widths of 500 to 2500 µs, below the period",
            );
        }
        let mut channels = self.channels.to_vec();
        channels.sort_unstable();
        channels.dedup();
        if channels.len() != ROTORS || channels.iter().any(|channel| *channel > 15) {
            return bad("channels", format!("{:?}", self.channels), "four different channels, 0 to 15");
        }
        if !(0.05..=0.95).contains(&self.hover_thrust) {
            return bad("hover_thrust", self.hover_thrust.to_string(), "0.05 to 0.95");
        }
        if !(0.005..=0.5).contains(&self.rate_loop_s) {
            return bad("rate_loop_s", self.rate_loop_s.to_string(), "0.005 to 0.5 s");
        }
        if !(0.0..=30.0).contains(&self.arming_s) {
            return bad("arming_s", self.arming_s.to_string(), "0 to 30 s");
        }
        Ok(())
    }

    /// Is it an autopilot that is commanded?
    pub fn is_autopilot(&self) -> bool {
        self.driver == "mavlink"
    }

    /// What is commanded.
    pub fn actuation(&self) -> Actuation {
        match self.depth.as_deref() {
            _ if !self.is_autopilot() => Actuation::Motors,
            Some("pose") => Actuation::Pose,
            _ => Actuation::Rates,
        }
    }

    /// The autopilot on `port` at `baud`, closed, with the key of [`MotorsSpec::signing_key`].
    pub fn autopilot(&self, port: PortName, baud: u32, key: Option<[u8; 32]>) -> Autopilot {
        Autopilot::new(Attachment {
            port,
            baud,
            system: self.system,
            actuation: self.actuation(),
            channels: self.channels,
            range: self.range(),
            signer: key.map(|key| Arc::new(Signer::new(key))),
        })
    }

    /// What sets the pulses, closed; `None` for an autopilot, and for what a check would have refused.
    pub fn pulses(&self) -> Option<Box<dyn Pulses>> {
        let (channels, rate_hz) = (self.channels, self.rate_hz);
        Some(match self.driver.as_str() {
            "mavlink" => return None,
            "sysfs" => Box::new(Sysfs { chip: PathBuf::from(&self.port), channels, rate_hz }),
            _ => {
                let port = PortName::parse(&self.port)?;
                Box::new(Pca9685 { port, address: self.address, channels, rate_hz, bus: None })
            }
        })
    }

    /// Pulses of commands 0 and 1.
    pub fn range(&self) -> PulseRange {
        let [stop_us, full_us] = self.pulse_us;
        PulseRange { stop_us, full_us }
    }
}

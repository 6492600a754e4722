//! Which devices the rig has and how each is attached, with the agent's configuration that fits.

use std::path::Path;

use nalgebra::Vector3;
use plumbline_core::sensor::suite::Timing;
use plumbline_devices::protocol::scip;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_sim::Scenario;

/// What a device speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speaks {
    /// An IMU that answers.
    Bno055,
    /// An ICM-20602, an IMU that answers.
    Invensense,
    /// An IMU with barometer that talks.
    Mongoose,
    /// A scanner that streams once it is asked to.
    Hokuyo,
    /// A beam that talks.
    Tfmini,
    /// A GNSS receiver that talks UBX, and NMEA beside it.
    Ubx,
    /// A GNSS receiver that talks NMEA.
    Nmea,
    /// OptiTrack's server.
    Natnet,
    /// Vicon's.
    Vicon,
    /// A barometer that answers.
    Ms5611,
    /// A barometer that answers.
    Bmp280,
    /// A voltmeter that answers.
    Ina219,
    /// A voltmeter that answers.
    Ina226,
}

/// How a device is attached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// By a serial port of its own.
    Uart,
    /// To the bus, at this address.
    Bus(u8),
    /// By a network: datagrams on the loopback.
    Datagrams,
}

/// A device of the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attached {
    /// Name in the configuration, and of its port's link in the folder.
    pub name: &'static str,
    /// Its protocol.
    pub speaks: Speaks,
    /// Where.
    pub wire: Wire,
    /// Which sensors it is, as the configuration says; none is a voltage.
    pub sensors: &'static [&'static str],
}

/// What gives the motors their pulses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// A PCA9685 on the bus.
    Pca9685,
    /// The kernel's PWM, a folder.
    Sysfs,
}

/// A scan is whole so long after its scanner has passed the front, s.
const SCAN_WHOLE_S: f64 = 0.1 * (*scip::STEPS.end() - scip::FRONT_STEP) as f64 / scip::STEPS_PER_TURN as f64;
/// And there so long after it, s: on the grid of the ticks.
const SCAN_THERE_S: f64 = 0.035;
/// Address of the PWM chip.
pub(crate) const PWM: u8 = 0x40;
/// Streaming id of the rigid body, and name of the object.
pub(crate) const BODY: (i32, &str) = (7, "iris");
/// Where the pivot of the motion-capture body sits, FLU, m, and how it is turned, rad: neither is the vehicle's own.
pub(crate) const CAPTURED: [[f64; 3]; 2] = [[0.02, -0.01, 0.06], [0.0, 0.0, 0.4]];

/// What is attached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wiring {
    /// The devices.
    pub devices: Vec<Attached>,
    /// Do scanners have their scans recorded?
    pub record_scans: bool,
    /// The motors' way.
    pub drive: Drive,
}

impl Wiring {
    /// Three BNO055 and a Mongoose (the fourth IMU, and the barometer), two Hokuyo and a TFmini, an INA226, a PCA9685.
    pub fn usual() -> Self {
        use Speaks::{Bno055, Hokuyo, Ina226, Mongoose, Tfmini};
        use Wire::{Bus, Uart};
        let at = |name, speaks, wire, sensors| Attached { name, speaks, wire, sensors };
        let devices = vec![
            at("imu1", Bno055, Uart, &["imu 1"] as &[_]),
            at("imu2", Bno055, Uart, &["imu 2"]),
            at("imu3", Bno055, Uart, &["imu 3"]),
            at("imu4", Mongoose, Uart, &["imu 4", "barometer 1"]),
            at("height1", Hokuyo, Uart, &["height 1"]),
            at("height2", Hokuyo, Uart, &["height 2"]),
            at("height3", Tfmini, Uart, &["height 3"]),
            at("battery", Ina226, Bus(0x41), &[]),
        ];
        Self { devices, record_scans: false, drive: Drive::Pca9685 }
    }

    /// A device of each driver, but for the other ways to the same: [`Wiring::others`]. Scans are recorded, motors are on the
    /// kernel's PWM.
    pub fn every() -> Self {
        use Speaks::{Bmp280, Bno055, Hokuyo, Ina219, Invensense, Mongoose, Ms5611, Natnet, Tfmini, Ubx};
        use Wire::{Bus, Datagrams, Uart};
        let at = |name, speaks, wire, sensors| Attached { name, speaks, wire, sensors };
        let devices = vec![
            at("imu1", Bno055, Uart, &["imu 1"] as &[_]),
            at("imu2", Bno055, Bus(0x28), &["imu 2"]),
            at("imu3", Invensense, Bus(0x68), &["imu 3"]),
            at("imu4", Mongoose, Uart, &["imu 4"]),
            at("height1", Hokuyo, Uart, &["height 1"]),
            at("height2", Hokuyo, Uart, &["height 2"]),
            at("height3", Tfmini, Uart, &["height 3"]),
            at("baro1", Ms5611, Bus(0x77), &["barometer 1"]),
            at("baro2", Bmp280, Bus(0x76), &["barometer 2"]),
            at("gnss", Ubx, Uart, &["gnss 1"]),
            at("mocap", Natnet, Datagrams, &["mocap pose 1"]),
            at("battery", Ina219, Bus(0x41), &[]),
        ];
        Self { devices, record_scans: true, drive: Drive::Sysfs }
    }

    /// The same with NMEA alone, Vicon, an INA226 and a PCA9685.
    pub fn others() -> Self {
        use Speaks::{Ina219, Ina226, Natnet, Nmea, Ubx, Vicon};
        let mut wiring = Self { drive: Drive::Pca9685, ..Self::every() };
        for device in &mut wiring.devices {
            device.speaks = match device.speaks {
                Ubx => Nmea,
                Natnet => Vicon,
                Ina219 => Ina226,
                same => same,
            };
        }
        wiring
    }

    /// `scenario` with a typical unit of each sensor that is attached and that its suite lacks, and heights by a scanner as late as
    /// its scans are.
    #[must_use]
    pub fn completed(&self, mut scenario: Scenario) -> Scenario {
        for sensor in self.devices.iter().flat_map(Attached::ids) {
            while !scenario.suite.contains(sensor) && scenario.suite.add(sensor.kind) {}
        }
        for scanner in self.devices.iter().filter(|device| device.speaks == Speaks::Hokuyo) {
            if let Some(height) = scenario.suite.heights.get_mut(scanner.index()) {
                height.timing.delay_s = SCAN_THERE_S;
            }
        }
        scenario
    }

    /// The agent's configuration: devices, motors, and attacks allowed, as nothing can fall. Datagrams go to and from the
    /// ports that `ports` has for each device, the agent's own and the server's.
    pub(crate) fn configuration(&self, scenario: &Scenario, folder: &Path, ports: &[[u16; 2]]) -> String {
        let mut text = "[rig.hanging_strings]\n\n[attacks]\nenabled = true\n".to_owned();
        let bus = format!("unix:{}/bus", folder.display());
        for (device, [own, server]) in self.devices.iter().zip(ports) {
            let Attached { name, speaks, wire, sensors } = device;
            let driver = speaks.driver();
            text += &format!("\n[[device]]\nname = \"{name}\"\ndriver = \"{driver}\"\n");
            text += &match wire {
                Wire::Uart => format!("port = \"{}/{name}\"\n", folder.display()),
                Wire::Bus(address) => format!("port = \"{bus}\"\naddress = {address}\n"),
                Wire::Datagrams => format!("port = \"udp:127.0.0.1:{own}\"\n"),
            };
            let (id, object) = BODY;
            text += &match speaks {
                Speaks::Natnet => format!("server = \"127.0.0.1:{server}\"\nbody = \"{id}\"\nup = \"y\"\n"),
                Speaks::Hokuyo if self.record_scans => "record_scans = true\n".to_owned(),
                Speaks::Vicon => format!("body = \"{object}\"\n"),
                Speaks::Ubx | Speaks::Nmea => {
                    let site = &scenario.site;
                    format!("origin = {:?}\n", [site.latitude_deg, site.longitude_deg, site.altitude_m])
                }
                _ => String::new(),
            };
            if let Some(timing) = device.timing(scenario) {
                let [position, turn] = device.place(scenario);
                text += &format!(
                    "sensors = {sensors:?}\nrate_hz = {:?}\ndelay_s = {:?}\nposition_flu_m = {:?}\nmounting_rpy_rad = {:?}\n",
                    speaks.rate_hz(&timing),
                    speaks.delay_s(&timing),
                    position.as_slice(),
                    turn.as_slice()
                );
            }
        }
        text + &match self.drive {
            Drive::Pca9685 => format!("\n[motors]\ndriver = \"pca9685\"\nport = \"{bus}\"\narming_s = 1.0\n"),
            Drive::Sysfs => {
                format!("\n[motors]\ndriver = \"sysfs\"\nport = \"{}/pwmchip0\"\narming_s = 1.0\n", folder.display())
            }
        }
    }
}

impl Speaks {
    /// Its driver in a configuration.
    fn driver(self) -> &'static str {
        match self {
            Self::Bno055 => "bno055",
            Self::Invensense => "invensense",
            Self::Mongoose => "mongoose",
            Self::Hokuyo => "hokuyo",
            Self::Tfmini => "tfmini",
            Self::Ubx | Self::Nmea => "gnss",
            Self::Natnet => "natnet",
            Self::Vicon => "vicon",
            Self::Ms5611 => "ms5611",
            Self::Bmp280 => "bmp280",
            Self::Ina219 => "ina219",
            Self::Ina226 => "ina226",
        }
    }

    /// What its driver cannot know of the way of its samples.
    fn delay_s(self, timing: &Timing) -> f64 {
        if self == Self::Hokuyo { timing.delay_s - SCAN_WHOLE_S } else { timing.delay_s }
    }

    /// How often it is read, or talks, for a simulated sensor that samples so often.
    fn rate_hz(self, timing: &Timing) -> f64 {
        match self {
            // Two conversions take 18 ms.
            Self::Ms5611 => timing.rate_hz.min(40.0),
            Self::Bmp280 => timing.rate_hz.min(50.0),
            _ => timing.rate_hz,
        }
    }
}

impl Attached {
    /// Its sensors.
    pub fn ids(&self) -> impl Iterator<Item = SensorId> {
        self.sensors.iter().filter_map(|name| name.parse().ok())
    }

    /// Place of its first sensor's samples in a frame.
    pub(crate) fn index(&self) -> usize {
        self.ids().next().map_or(0, |id| usize::from(id.instance).saturating_sub(1))
    }

    /// When its first sensor samples in the scenario's vehicle.
    fn timing(&self, scenario: &Scenario) -> Option<Timing> {
        let (own, mut found) = (self.ids().next()?, None);
        scenario.suite.sheets(|id, _, sheet| found = found.or((id == own).then(|| *sheet.timing())));
        found
    }

    /// Where it sits in the scenario's vehicle, and how it is turned.
    pub(crate) fn place(&self, scenario: &Scenario) -> [Vector3<f64>; 2] {
        let (suite, index) = (&scenario.suite, self.index());
        let place = match self.ids().next().map(|id| id.kind) {
            Some(SensorKind::Imu) => suite.imus.get(index).map(|imu| [imu.position_flu_m, imu.mounting_rpy_rad]),
            Some(SensorKind::Height) => {
                suite.heights.get(index).map(|height| [height.position_flu_m, Vector3::zeros()])
            }
            Some(SensorKind::MocapPose) => Some(CAPTURED.map(Vector3::from)),
            _ => None,
        };
        place.unwrap_or_default()
    }
}

//! ArduPilot in the loop, by its JSON interface for simulators (`--model JSON`).
//!
//! ArduPilot (SITL) sends a datagram of servo pulses to port 9002 and goes on when a line of JSON comes back:
//!
//! | bytes | servo packet, little-endian | |
//! |---|---|---|
//! | 0 | magic | 18458 with 16 channels, 29569 with 32 |
//! | 2 | frame rate | Hz, the step that it would like (`SIM_RATE_HZ`) |
//! | 4 | frame count | +1 with each packet, from 0 when it starts |
//! | 8 | pulses | µs, 2 bytes a channel |
//!
//! | it sends | means | done |
//! |---|---|---|
//! | the next count | the line before was received | the next tick |
//! | the same count again | the line was lost | the same line again, the world stands |
//! | a later count | packets to us were lost | taken |
//! | count 0, or a lower one from another port | it was started anew | the world and its time stamp begin anew |
//! | a lower count | an old packet | passed over |
//!
//! Of sensors ArduPilot takes one IMU and range finders. GNSS, barometer and compass it makes itself of position and
//! attitude, which are the truth: attacks on those are its own (`SIM_GPS1_GLTCH_X` and others), and none of ours has a way
//! there. What is not fresh is sent again, as its reader asks for every field in every line.
//!
//! Read in ArduPilot's `libraries/SITL/examples/JSON/readme.md` and `SIM_JSON.cpp`, tried with a double only.

use std::fmt::Write as _;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use plumbline_core::event::{Severity, text};
use plumbline_core::frames::{Enu, Flu, Frd, Ned};
use plumbline_core::sensor::suite::Suite;
use plumbline_core::sensor::{MAX_HEIGHTS, SensorFrame};
use plumbline_core::types::ROTORS;
use plumbline_core::vehicle::{Truth, VehicleError};
use plumbline_devices::port::timed_out;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use plumbline_sim::Scenario;

use crate::{Answer, HilError, Line, Notices, Patience, SLICE, Step, attitude_wxyz, check, notice, slant_m};

/// Where ArduPilot's first instance looks for its simulator.
pub const ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 9002);
const NAME: &str = "ArduPilot";
/// Its fastest loop is 400 Hz on copters; slower ticks than `SCHED_LOOP_RATE` are for one that was slowed down.
const RATES_HZ: [f64; 2] = [200.0, 1000.0];
/// Magic numbers and the channels that go with them.
const MAGIC: [(u16, usize); 2] = [(18_458, 16), (29_569, 32)];
const HEAD: usize = 8;
/// Longer than any packet, to see that one is too long.
const DATAGRAM: usize = 256;
/// Pulses of command 0 and 1, µs.
const PULSES_US: [f64; 2] = [1000.0, 2000.0];
/// A line with every field.
const LINE_BYTES: usize = 2048;

/// Outputs of ArduPilot at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Servos {
    /// The step that it would like, Hz.
    pub frame_rate_hz: u16,
    /// Counts its packets since it started.
    pub frame_count: u32,
    /// Pulses of its first outputs, µs.
    pub pulses_us: [u16; ROTORS],
}

/// Why a datagram is no servo packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ServoError {
    /// Of another program, or of another version of the interface.
    #[error("magic {0} is not 18458 or 29569")]
    Magic(u16),
    /// Cut, or longer than it says.
    #[error("{got} bytes, {expected} expected")]
    Length {
        /// Its length.
        got: usize,
        /// What its magic says.
        expected: usize,
    },
}

impl Servos {
    /// Reads one datagram.
    ///
    /// # Errors
    /// [`ServoError`] with the offending value.
    pub fn read(datagram: &[u8]) -> Result<Self, ServoError> {
        let u16_at = |at: usize| {
            let bytes = datagram.get(at..at + 2).and_then(|two| two.try_into().ok());
            bytes.map(u16::from_le_bytes)
        };
        let short = ServoError::Length { got: datagram.len(), expected: HEAD + 2 * MAGIC[0].1 };
        let magic = u16_at(0).ok_or(short)?;
        let (_, channels) = MAGIC.into_iter().find(|(known, _)| *known == magic).ok_or(ServoError::Magic(magic))?;
        let expected = HEAD + 2 * channels;
        if datagram.len() != expected {
            return Err(ServoError::Length { got: datagram.len(), expected });
        }
        let [low, high] = [4, 6].map(|at| u32::from(u16_at(at).unwrap_or_default()));
        Ok(Self {
            frame_rate_hz: u16_at(2).unwrap_or_default(),
            frame_count: low | high << 16,
            pulses_us: std::array::from_fn(|motor| u16_at(HEAD + 2 * motor).unwrap_or_default()),
        })
    }

    /// Motors, 0 to 1. Those that stand get the shortest pulse, or none.
    fn answer(&self) -> Answer {
        let [stands, full] = PULSES_US;
        let motors = self.pulses_us.map(|pulse| ((f64::from(pulse) - stands) / (full - stands)).clamp(0.0, 1.0));
        Answer { motors, armed: motors.iter().any(|motor| *motor > 0.0), anew: false }
    }
}

/// What was received last of the sensors that it takes.
#[derive(Debug, Clone, Default)]
struct Held {
    imu: Option<(Vector3<f64>, Vector3<f64>)>,
    ranges_m: [Option<f64>; MAX_HEIGHTS],
}

impl Held {
    fn update(&mut self, received: &SensorFrame, truth: &Truth) {
        if let Some(imu) = received.imus.first().and_then(Option::as_ref) {
            self.imu = Some((imu.gyro_radps, imu.accel_mps2));
        }
        for (held, fresh) in self.ranges_m.iter_mut().zip(&received.heights) {
            *held = fresh.map(|fresh| slant_m(fresh.height_m, &truth.world_from_body)).or(*held);
        }
    }
}

/// Puts one tick, `time_s` after ArduPilot started, into `line`. Keys that its reader asks for go first: it looks for their
/// letters and not for JSON, so `velocity` must stand before anything that begins alike.
fn write_line(line: &mut String, time_s: f64, held: &Held, truth: &Truth, battery_v: Option<f64>) {
    // Before its first sample the IMU measures what is.
    let (gyro, force) = held.imu.unwrap_or((truth.body_rates_radps, truth.specific_force_mps2));
    let (Frd(gyro), Frd(force)) = (Flu(gyro).into(), Flu(force).into());
    let (Ned(position), Ned(velocity)) = (Enu(truth.position_enu_m).into(), Enu(truth.velocity_enu_mps).into());
    let [w, x, y, z] = attitude_wxyz(truth.world_from_body);
    line.clear();
    // Writing into a string does not fail.
    let _ = write!(
        line,
        "\n{{\"timestamp\":{time_s:.6},\"imu\":{{\"gyro\":{},\"accel_body\":{}}},\"position\":{},\
         \"quaternion\":[{w:e},{x:e},{y:e},{z:e}],\"velocity\":{}",
        Three(gyro),
        Three(force),
        Three(position),
        Three(velocity),
    );
    for (number, range_m) in (1..).zip(held.ranges_m) {
        if let Some(range_m) = range_m {
            let _ = write!(line, ",\"rng_{number}\":{range_m:e}");
        }
    }
    if let Some(volt) = battery_v {
        let _ = write!(line, ",\"battery\":{{\"voltage\":{volt:e}}}");
    }
    line.push_str("}\n");
}

/// Three numbers in brackets, without a space: its reader takes none before the first.
struct Three(Vector3<f64>);

impl std::fmt::Display for Three {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(v) = self;
        write!(f, "[{:e},{:e},{:e}]", v.x, v.y, v.z)
    }
}

/// Is there a way for the samples of `sensor` of a vehicle with these sensors to ArduPilot?
pub fn reaches(suite: &Suite, sensor: SensorId) -> bool {
    let most = match sensor.kind {
        SensorKind::Imu => 1,
        SensorKind::Height => suite.heights.len(),
        _ => 0,
    };
    (1..=most).contains(&usize::from(sensor.instance))
}

/// Waits for ArduPilot's first packet.
#[derive(Debug)]
pub struct Listener {
    socket: UdpSocket,
    address: SocketAddr,
    tick_rate_hz: f64,
    suite: Suite,
}

impl Listener {
    /// On `address`, to fly `scenario`.
    ///
    /// # Errors
    /// [`HilError`] when nothing can be received there, or ArduPilot cannot fly the scenario.
    pub fn bind(address: SocketAddr, scenario: &Scenario) -> Result<Self, HilError> {
        check(scenario, NAME, RATES_HZ)?;
        let failed = |source| HilError::Port { autopilot: NAME, address, source };
        let socket = UdpSocket::bind(address).map_err(failed)?;
        let address = socket.local_addr().map_err(failed)?;
        Ok(Self { socket, address, tick_rate_hz: scenario.tick_rate_hz, suite: scenario.suite.clone() })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The first that sends a servo packet.
    ///
    /// # Errors
    /// [`HilError::Accept`].
    pub fn accept(self, patience: Patience) -> Result<ArduPilot, HilError> {
        let failed = |source| HilError::Accept { autopilot: NAME, address: self.address, source };
        let mut datagram = [0; DATAGRAM];
        loop {
            let (length, peer) = self.socket.recv_from(&mut datagram).map_err(failed)?;
            match Servos::read(datagram.get(..length).unwrap_or_default()) {
                Ok(servos) => {
                    return Ok(ArduPilot {
                        socket: self.socket,
                        peer,
                        tick_rate_hz: self.tick_rate_hz,
                        suite: self.suite,
                        patience,
                        last: servos,
                        began: None,
                        held: Held::default(),
                        line: String::with_capacity(LINE_BYTES),
                        greeted: false,
                        faults: 0,
                    });
                }
                Err(error) => tracing::warn!(%peer, %error, "no servo packet of ArduPilot"),
            }
        }
    }
}

/// The line to one ArduPilot.
#[derive(Debug)]
pub struct ArduPilot {
    socket: UdpSocket,
    peer: SocketAddr,
    tick_rate_hz: f64,
    suite: Suite,
    patience: Patience,
    last: Servos,
    /// Flight time at which it started.
    began: Option<FlightTime>,
    held: Held,
    line: String,
    greeted: bool,
    /// Datagrams that were no servo packets.
    faults: u64,
}

impl Line for ArduPilot {
    fn reaches(&self, sensor: SensorId) -> bool {
        reaches(&self.suite, sensor)
    }

    fn exchange(&mut self, step: &Step<'_>, notices: &mut Notices) -> Result<Option<Answer>, VehicleError> {
        let now = step.received.time;
        if !self.greeted {
            self.greeted = true;
            let what = text(format_args!(
                "ArduPilot at {} flies; it asks for steps of 1/{} s and gets 1/{:.0} s",
                self.peer, self.last.frame_rate_hz, self.tick_rate_hz
            ));
            notice(notices, Severity::Info, what);
        }
        let began = *self.began.get_or_insert(now);
        self.held.update(step.received, step.truth);
        let battery_v = step.received.battery_v;
        write_line(&mut self.line, now.seconds_since(began), &self.held, step.truth, battery_v);
        self.send(now)?;
        let until = Instant::now() + self.patience.answer;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if (self.patience.asked_to_end)() {
                return Ok(None);
            }
            if left.is_zero() {
                let reason = format!(
                    "no servo packet for {:.0} s (datagrams of none: {})",
                    self.patience.answer.as_secs_f64(),
                    self.faults
                );
                return Err(self.lost(now, &reason));
            }
            let Some((servos, from)) = self.receive(left.min(SLICE), now, notices)? else { continue };
            let count = servos.frame_count;
            let anew = if from == self.peer { count == 0 } else { count < self.last.frame_count };
            if count == self.last.frame_count {
                self.peer = from;
                self.send(now)?;
            } else if anew {
                let what = text(format_args!(
                    "ArduPilot was started anew at {now}: frame {count} after {}; the world begins anew",
                    self.last.frame_count
                ));
                notice(notices, Severity::Warning, what);
                (self.peer, self.last, self.began) = (from, servos, None);
                self.held = Held::default();
                return Ok(Some(Answer { anew: true, ..servos.answer() }));
            } else if count > self.last.frame_count {
                (self.peer, self.last) = (from, servos);
                return Ok(Some(servos.answer()));
            }
        }
    }
}

impl ArduPilot {
    fn send(&self, now: FlightTime) -> Result<(), VehicleError> {
        match self.socket.send_to(self.line.as_bytes(), self.peer) {
            Ok(_) => Ok(()),
            // It is not there just now; its silence will be told.
            Err(error) if gone(&error) => Ok(()),
            Err(error) => Err(self.lost(now, &error.to_string())),
        }
    }

    /// A servo packet within `wait`, and where it came from.
    fn receive(
        &mut self,
        wait: Duration,
        now: FlightTime,
        notices: &mut Notices,
    ) -> Result<Option<(Servos, SocketAddr)>, VehicleError> {
        let mut datagram = [0; DATAGRAM];
        let read = self
            .socket
            .set_read_timeout(Some(wait.max(Duration::from_micros(1))))
            .and_then(|()| self.socket.recv_from(&mut datagram));
        let (length, from) = match read {
            Ok(read) => read,
            Err(error) if timed_out(&error) || gone(&error) => return Ok(None),
            Err(error) => return Err(self.lost(now, &error.to_string())),
        };
        match Servos::read(datagram.get(..length).unwrap_or_default()) {
            Ok(servos) => Ok(Some((servos, from))),
            Err(error) => {
                self.faults += 1;
                if self.faults == 1 {
                    let what = text(format_args!("a datagram of {from} at {now} is no servo packet: {error}"));
                    notice(notices, Severity::Warning, what);
                }
                Ok(None)
            }
        }
    }

    fn lost(&self, now: FlightTime, reason: &str) -> VehicleError {
        VehicleError::Invalid { what: format!("ArduPilot at {}", self.peer), reason: format!("{reason}, at {now}") }
    }
}

/// Did the system say that nobody listens there?
fn gone(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn packet(magic: u16, rate: u16, count: u32, pulses: &[u16]) -> Vec<u8> {
        let mut bytes = [magic, rate].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
        bytes.extend(count.to_le_bytes());
        bytes.extend(pulses.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn servo_packets_of_both_lengths_are_read() {
        for (magic, channels) in MAGIC {
            let pulses: Vec<u16> = (0..channels as u16).map(|k| 1000 + 100 * k).collect();
            let servos = Servos::read(&packet(magic, 400, 70_000, &pulses)).unwrap();
            assert_eq!((servos.frame_rate_hz, servos.frame_count), (400, 70_000));
            assert_eq!(servos.pulses_us, [1000, 1100, 1200, 1300]);
            let answer = servos.answer();
            assert_eq!((answer.motors, answer.armed), ([0.0, 0.1, 0.2, 0.3], true));
        }
        let stands =
            Servos::read(&packet(18_458, 400, 0, &[1000, 0, 900, 1000, 2200, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]));
        let answer = stands.unwrap().answer();
        assert_eq!((answer.motors, answer.armed), ([0.0; 4], false));
    }

    #[test]
    fn what_is_no_servo_packet_is_refused_with_its_value() {
        let whole = packet(18_458, 400, 1, &[1500; 16]);
        assert_eq!(Servos::read(&whole[..21]), Err(ServoError::Length { got: 21, expected: 40 }));
        assert_eq!(Servos::read(&whole[..1]), Err(ServoError::Length { got: 1, expected: 40 }));
        assert_eq!(Servos::read(&[]), Err(ServoError::Length { got: 0, expected: 40 }));
        assert_eq!(Servos::read(&packet(18_459, 400, 1, &[1500; 16])), Err(ServoError::Magic(18_459)));
        let long = packet(29_569, 400, 1, &[1500; 33]);
        assert_eq!(Servos::read(&long), Err(ServoError::Length { got: 74, expected: 72 }));
    }

    #[test]
    fn a_line_is_json_in_north_east_down() {
        let truth = Truth {
            position_enu_m: Vector3::new(1.0, 2.0, 3.0),
            velocity_enu_mps: Vector3::new(0.1, 0.2, 1e-9),
            world_from_body: UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2),
            ..Truth::unknown(FlightTime(0))
        };
        let held = Held {
            imu: Some((Vector3::new(0.1, 0.2, 0.3), Vector3::new(1.0, 2.0, 9.81))),
            ranges_m: [Some(3.0), None, Some(2.5), None, None],
        };
        let mut line = String::new();
        write_line(&mut line, 2500.0025, &held, &truth, Some(11.1));
        assert!(line.starts_with('\n') && line.ends_with("}\n") && !line.contains(' '), "{line:?}");
        let said: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(said["timestamp"], 2500.0025);
        assert_eq!(said["imu"]["accel_body"], serde_json::json!([1.0, -2.0, -9.81]));
        assert_eq!(said["imu"]["gyro"], serde_json::json!([0.1, -0.2, -0.3]));
        assert_eq!(said["position"], serde_json::json!([2.0, 1.0, -3.0]));
        assert_eq!(said["velocity"], serde_json::json!([0.2, 0.1, -1e-9]));
        assert!((said["quaternion"][0].as_f64().unwrap() - 1.0).abs() < 1e-9, "facing north: {said}");
        assert_eq!((&said["rng_1"], &said["rng_3"], &said["rng_2"]), (&3.0.into(), &2.5.into(), &().into()));
        assert_eq!(said["battery"]["voltage"], 11.1);
        // Its reader looks for the first place where the letters of a key stand.
        let first = |key: &str| line.find(key).unwrap();
        assert!(first("velocity") < first("rng_1") && first("position") < first("quaternion"));
    }
}

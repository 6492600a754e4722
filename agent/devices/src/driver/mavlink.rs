//! A PX4 autopilot over MAVLink 2: its sensors, and the way into and out of offboard mode.
//!
//! | asked for | when |
//! |---|---|
//! | HIGHRES_IMU, DISTANCE_SENSOR, SYS_STATUS at their rates | when it is found, and again while no IMU comes |
//! | offboard mode | disarmed, after [`STREAMED`] of setpoints, until it is in it |
//! | arming | in offboard mode, once the flight's motors shall turn |
//! | disarming, without landing | in offboard mode, armed by us, once they shall not |
//!
//! Whoever else arms it, or takes it out of offboard mode, is left alone.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use mavlink::dialects::common::{
    COMMAND_ACK_DATA, DISTANCE_SENSOR_DATA, HEARTBEAT_DATA, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavAutopilot,
    MavCmd, MavMessage, MavModeFlag, MavResult, MavSensorOrientation, MavState, MavType, TIMESYNC_DATA,
};
use mavlink::error::MessageReadError;
use mavlink::{MavHeader, MavlinkReader};
use nalgebra::Vector3;
use plumbline_core::frames::{Flu, Frd};

use super::{Driver, Heard, Outlet};
use crate::autopilot::{AUTOPILOT, Autopilot, OFFBOARD};
use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::port::timed_out;
use crate::reading::{BarometerReading, ImuReading, RangeReading, Reading};

/// Setpoints this long before the switch: PX4 asks for a second.
pub const STREAMED: Duration = Duration::from_millis(1200);
/// Without a setpoint for this long the stream has ended.
const STREAM_ENDS: Duration = Duration::from_millis(200);
/// Longest wait for its first heartbeat, and longest without one.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often what is not done yet is asked for again, and how often our heartbeat is sent.
const AGAIN: Duration = Duration::from_millis(500);
const DISARM_AGAIN: Duration = Duration::from_millis(50);
const HEARTBEAT: Duration = Duration::from_secs(1);
/// A reader that was held up for longer looks anew.
const STALL: Duration = Duration::from_millis(250);
/// Rates of height and voltage, Hz.
const SLOW_HZ: [f64; 2] = [50.0, 2.0];
/// Largest datagram taken.
const DATAGRAM: usize = 4096;

/// What is known of the autopilot, and what was asked last.
#[derive(Debug)]
struct Known {
    heard: Instant,
    armed: bool,
    offboard: bool,
    /// It was armed because we asked, and obeyed.
    flew: bool,
    setpoints: (u64, Instant),
    streams_since: Option<Instant>,
    imu: Instant,
    polled: Instant,
    asked: Instant,
    greeted: Instant,
}

/// The reader's end.
pub struct Mavlink {
    autopilot: Arc<Autopilot>,
    rate_hz: f64,
    known: Option<Known>,
    datagram: Box<[u8; DATAGRAM]>,
}

impl Mavlink {
    /// Of `autopilot`, not yet found, with so many IMU samples a second.
    pub fn new(autopilot: Arc<Autopilot>, rate_hz: f64) -> Self {
        Self { autopilot, rate_hz, known: None, datagram: Box::new([0; DATAGRAM]) }
    }

    /// One datagram's length and sender, if one comes in time.
    fn datagram(&mut self) -> Result<Option<(usize, SocketAddr)>, DeviceError> {
        match self.autopilot.socket()?.recv_from(self.datagram.as_mut()) {
            Ok(found) => Ok(Some(found)),
            // Nobody listens there just now.
            Err(error) if timed_out(&error) || error.kind() == std::io::ErrorKind::ConnectionRefused => Ok(None),
            Err(error) => Err(self.autopilot.port.error(error)),
        }
    }

    /// Drops what waits: it says what was, not what is.
    fn forget(&mut self) -> Result<(), DeviceError> {
        let Self { autopilot, datagram, .. } = self;
        let socket = autopilot.socket()?;
        let blocking = |on: bool| socket.set_nonblocking(!on).map_err(|error| autopilot.port.error(error));
        blocking(false)?;
        while socket.recv(datagram.as_mut()).is_ok() {}
        blocking(true)
    }

    /// Asks for its messages.
    fn subscribe(&self) {
        let [height_hz, voltage_hz] = SLOW_HZ;
        for (message, rate_hz) in [(105.0, self.rate_hz), (132.0, height_hz), (1.0, voltage_hz)] {
            self.autopilot.order(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, message, (1e6 / rate_hz) as f32);
        }
    }
}

/// The messages of `system`'s autopilot in a datagram; what is damaged or foreign is passed over.
fn messages(datagram: &[u8], system: u8) -> impl Iterator<Item = MavMessage> {
    let mut reader = MavlinkReader::new(datagram);
    std::iter::from_fn(move || {
        loop {
            match reader.read_any_message::<MavMessage>() {
                Ok((MavHeader { system_id, component_id: AUTOPILOT, .. }, message))
                    if system_id == u32::from(system) =>
                {
                    return Some(message);
                }
                Ok(_) | Err(MessageReadError::Parse(_)) => {}
                Err(MessageReadError::Io(_)) => return None,
            }
        }
    })
}

impl Known {
    fn new(now: Instant, flew: bool) -> Self {
        Self {
            heard: now,
            armed: false,
            offboard: false,
            flew,
            setpoints: (0, now),
            streams_since: None,
            imu: now,
            polled: now,
            asked: now,
            greeted: now - HEARTBEAT,
        }
    }

    fn beat(&mut self, beat: &HEARTBEAT_DATA, now: Instant) {
        self.heard = now;
        self.armed = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        self.offboard = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
            && (beat.custom_mode >> 16) & 0xff == OFFBOARD;
    }

    /// An answer comes sooner than the next heartbeat.
    fn answered(&mut self, ack: &COMMAND_ACK_DATA, wanted: bool) {
        if ack.result == MavResult::MAV_RESULT_ACCEPTED {
            match ack.command {
                MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => self.armed = wanted,
                MavCmd::MAV_CMD_DO_SET_MODE => self.offboard = true,
                _ => {}
            }
        }
    }

    /// What is due: our heartbeat, the next step towards what the flight wants.
    fn attend(&mut self, autopilot: &Autopilot, now: Instant) {
        if now - self.greeted >= HEARTBEAT {
            self.greeted = now;
            autopilot.say(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                custom_mode: 0,
                mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
                autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
                base_mode: MavModeFlag::empty(),
                system_status: MavState::MAV_STATE_ACTIVE,
                mavlink_version: 3,
            }));
        }
        let (count, at) = self.setpoints;
        if autopilot.setpoints() != count {
            self.setpoints = (autopilot.setpoints(), now);
            self.streams_since.get_or_insert(now);
        } else if now - at > STREAM_ENDS {
            self.streams_since = None;
        }
        let wanted = autopilot.wanted.load(Ordering::Acquire);
        let obeys = self.armed && self.offboard && (self.flew || wanted);
        if wanted && self.flew && !self.offboard {
            autopilot.taken.store(true, Ordering::Release);
        }
        self.flew = (self.flew || obeys) && (wanted || self.armed);
        autopilot.obeys(obeys);
        let streams = self.streams_since.is_some_and(|since| now - since >= STREAMED);
        if self.flew && !wanted && self.offboard && self.armed {
            if now - self.asked >= DISARM_AGAIN {
                self.asked = now;
                autopilot.disarm();
            }
        } else if now - self.asked >= AGAIN && !self.armed && streams && !self.flew {
            self.asked = now;
            if !self.offboard {
                // A custom mode, and which.
                autopilot.order(MavCmd::MAV_CMD_DO_SET_MODE, 1.0, OFFBOARD as f32);
            } else if wanted {
                autopilot.arm();
            }
        }
    }
}

impl Driver for Mavlink {
    fn open(&mut self) -> Result<(), DeviceError> {
        self.forget()?;
        let (system, begun) = (self.autopilot.system, Instant::now());
        while begun.elapsed() < PATIENCE {
            let Some((length, from)) = self.datagram()? else { continue };
            let datagram = self.datagram.get(..length).unwrap_or_default();
            let beat = messages(datagram, system).find_map(|message| match message {
                MavMessage::HEARTBEAT(beat) => Some(beat),
                _ => None,
            });
            let Some(beat) = beat else { continue };
            if beat.autopilot != MavAutopilot::MAV_AUTOPILOT_PX4 {
                let value = format!("{:?}", beat.autopilot);
                return Err(DeviceError::Wrong { what: "autopilot", value, expected: "MAV_AUTOPILOT_PX4" });
            }
            if beat.mavtype != MavType::MAV_TYPE_QUADROTOR {
                let value = format!("{:?}", beat.mavtype);
                return Err(DeviceError::Wrong { what: "vehicle", value, expected: "MAV_TYPE_QUADROTOR" });
            }
            // From here on nobody else is heard, nor spoken to.
            self.autopilot.socket()?.connect(from).map_err(|error| self.autopilot.port.error(error))?;
            let now = Instant::now();
            let mut known = Known::new(now, self.known.as_ref().is_some_and(|known| known.flew));
            known.beat(&beat, now);
            self.known = Some(known);
            self.subscribe();
            return Ok(());
        }
        Err(DeviceError::Silent { what: "heartbeat of the autopilot", seconds: PATIENCE.as_secs_f64() })
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let length = self.datagram()?.map_or(0, |(length, _)| length);
        let (at, autopilot) = (Instant::now(), self.autopilot.clone());
        let Some(known) = &mut self.known else { return Ok(()) };
        let gap = at - std::mem::replace(&mut known.polled, at);
        if gap > STALL {
            // This thread stood still: what has come since is old.
            return Err(
                Fault::Value { what: "silence of this reader, s", value: gap.as_secs_f64(), expected: "less" }.into()
            );
        }
        for message in messages(self.datagram.get(..length).unwrap_or_default(), autopilot.system) {
            match message {
                MavMessage::HEARTBEAT(beat) => known.beat(&beat, at),
                MavMessage::COMMAND_ACK(ack) => known.answered(&ack, autopilot.wanted.load(Ordering::Acquire)),
                MavMessage::HIGHRES_IMU(imu) => {
                    known.imu = at;
                    inertial(&imu, &autopilot, at, out);
                }
                MavMessage::DISTANCE_SENSOR(range) => below(&range, at, out),
                MavMessage::SYS_STATUS(status) if status.voltage_battery != u16::MAX => {
                    let volts = 1e-3 * f64::from(status.voltage_battery);
                    autopilot.powered(volts);
                    out(Ok(Heard { at, stamp: None, after_us: 0.0, reading: Reading::Battery(volts) }));
                }
                MavMessage::TIMESYNC(sync) if sync.tc1 == 0 => {
                    let tc1 = autopilot.now_ns();
                    autopilot.say(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1, ..sync }));
                }
                _ => {}
            }
        }
        known.attend(&autopilot, at);
        if at - known.heard > PATIENCE {
            return Err(DeviceError::Silent { what: "heartbeat of the autopilot", seconds: PATIENCE.as_secs_f64() });
        }
        if at - known.imu > HEARTBEAT {
            known.imu = at;
            self.subscribe();
        }
        Ok(())
    }
}

/// Gyroscope, accelerometer, magnetometer; the barometer where it is new.
fn inertial(imu: &HIGHRES_IMU_DATA, autopilot: &Autopilot, at: Instant, out: &mut Outlet<'_>) {
    use HighresImuUpdatedFlags as Has;
    let flu = |x: f32, y: f32, z: f32| {
        let Flu(v) = Frd(Vector3::new(x, y, z).cast::<f64>()).into();
        v
    };
    let (gyro_radps, accel_mps2) = (flu(imu.xgyro, imu.ygyro, imu.zgyro), flu(imu.xacc, imu.yacc, imu.zacc));
    if let Some(value) = gyro_radps.iter().chain(accel_mps2.iter()).find(|value| !value.is_finite()) {
        out(Err(Fault::Value { what: "IMU sample", value: *value, expected: "a number" }));
        return;
    }
    autopilot.measured(&gyro_radps);
    let stamp = Some(Stamp { ticks: imu.time_usec, tick_us: 1.0, roll_over: 1 << 62 });
    let field = || 100.0 * flu(imu.xmag, imu.ymag, imu.zmag);
    let temperature_c = f64::from(imu.temperature);
    let reading = Reading::Imu(ImuReading {
        gyro_radps,
        accel_mps2,
        mag_ut: imu.fields_updated.contains(Has::HIGHRES_IMU_UPDATED_XMAG).then(field).filter(|f| f.norm().is_finite()),
        temperature_c,
    });
    out(Ok(Heard { at, stamp, after_us: 0.0, reading }));
    if imu.fields_updated.contains(Has::HIGHRES_IMU_UPDATED_ABS_PRESSURE) && imu.abs_pressure.is_finite() {
        let pressure_pa = 100.0 * f64::from(imu.abs_pressure);
        let reading = Reading::Barometer(BarometerReading { pressure_pa, temperature_c });
        out(Ok(Heard { at, stamp, after_us: 0.0, reading }));
    }
}

/// A distance downwards, where it is within the sensor's reach.
fn below(range: &DISTANCE_SENSOR_DATA, at: Instant, out: &mut Outlet<'_>) {
    let within = (range.min_distance..=range.max_distance).contains(&range.current_distance);
    if within && range.orientation == MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270 {
        let distance_m = 1e-2 * f64::from(range.current_distance);
        let reading = Reading::Range(RangeReading { distance_m, scanned: false, sigma_m: f64::NAN });
        out(Ok(Heard { at, stamp: None, after_us: 0.0, reading }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::port::PortName;

    fn heard(imu: &HIGHRES_IMU_DATA) -> Vec<Result<Reading, Fault>> {
        let autopilot = Autopilot::new(PortName::parse("udp:127.0.0.1:0").unwrap(), 1);
        let mut all = Vec::new();
        inertial(imu, &autopilot, Instant::now(), &mut |heard| all.push(heard.map(|heard| heard.reading)));
        all
    }

    #[test]
    fn an_imu_is_turned_into_our_axes_and_units_and_what_is_no_number_is_refused() {
        let mut imu = HIGHRES_IMU_DATA {
            xgyro: 0.1,
            ygyro: 0.2,
            zacc: -9.81,
            xmag: 0.2,
            abs_pressure: 1013.25,
            fields_updated: HighresImuUpdatedFlags::all(),
            ..HIGHRES_IMU_DATA::DEFAULT
        };
        let [Ok(Reading::Imu(sample)), Ok(Reading::Barometer(pressure))] = heard(&imu)[..] else {
            panic!("two readings")
        };
        assert!((sample.gyro_radps - Vector3::new(0.1, -0.2, 0.0)).norm() < 1e-6, "{sample:?}");
        assert!(
            (sample.accel_mps2.z - 9.81).abs() < 1e-5 && (sample.mag_ut.unwrap().x - 20.0).abs() < 1e-5,
            "{sample:?}"
        );
        assert!((pressure.pressure_pa - 101_325.0).abs() < 1.0);
        imu.yacc = f32::NAN;
        assert!(matches!(heard(&imu)[..], [Err(Fault::Value { what: "IMU sample", .. })]));
    }

    #[test]
    fn offboard_mode_is_asked_for_after_a_second_of_setpoints_and_never_while_it_is_armed() {
        let autopilot = Autopilot::new(PortName::parse("udp:127.0.0.1:0").unwrap(), 1);
        let begun = Instant::now();
        let asked = |known: &mut Known, until_s: f64| {
            let mut at_s = None;
            for tick in 1..(until_s * 20.0) as u32 {
                let now = begun + Duration::from_millis(50 * u64::from(tick));
                known.setpoints.0 = u64::from(tick);
                let before = known.asked;
                known.attend(&autopilot, now);
                at_s = at_s.or((known.asked != before).then(|| (now - begun).as_secs_f64()));
            }
            at_s
        };
        let first = asked(&mut Known::new(begun, false), 3.0).unwrap();
        assert!((1.2..1.4).contains(&first), "{first}");
        let mut armed = Known { armed: true, ..Known::new(begun, false) };
        assert_eq!(asked(&mut armed, 3.0), None);
    }
}

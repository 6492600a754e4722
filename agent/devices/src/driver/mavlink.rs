//! A PX4 autopilot over MAVLink 2, on a serial port or UDP: its sensors, its clock, what it says that it does, and the way
//! into and out of offboard mode.
//!
//! | asked for | when |
//! |---|---|
//! | [`MESSAGES`] at their rates, one after the other | when it is found, and again while no IMU comes |
//! | TIMESYNC | ten times a second until ten were answered, then each second |
//! | offboard mode | disarmed, after [`STREAMED`] of setpoints, until it is in it |
//! | arming | in offboard mode, once the flight's motors shall turn |
//! | disarming, without landing | in offboard mode, armed by us, once they shall not |
//!
//! An interval that is refused is told as a fault; of a message without which nothing flies it is an error. Whoever else arms
//! it, or takes it out of offboard mode, is left alone.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use mavlink::MavHeader;
use mavlink::dialects::common::{
    ATTITUDE_TARGET_DATA, COMMAND_ACK_DATA, DISTANCE_SENSOR_DATA, HEARTBEAT_DATA, HIGHRES_IMU_DATA,
    HighresImuUpdatedFlags, MavAutopilot, MavCmd, MavMessage, MavModeFlag, MavResult, MavSensorOrientation, MavState,
    MavType, SERVO_OUTPUT_RAW_DATA, TIMESYNC_DATA,
};
use nalgebra::Vector3;
use plumbline_core::frames::{Flu, Frd};
use plumbline_core::types::Actuation;

use super::{Driver, Exchange, Heard, Outlet};
use crate::autopilot::wire::Wire;
use crate::autopilot::{AUTOPILOT, Autopilot, OFFBOARD};
use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::framer::Framer;
use crate::protocol::mavlink::Frames;
use crate::reading::{BarometerReading, ImuReading, RangeReading, Reading};

/// Setpoints this long before the switch: PX4 asks for a second.
pub const STREAMED: Duration = Duration::from_millis(1200);
/// Without a setpoint for this long the stream has ended.
const STREAM_ENDS: Duration = Duration::from_millis(200);
/// Longest wait for its first heartbeat, longest without one, and longest from our order to arm until it does.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often what is not done yet is asked for again, and how often our heartbeat is sent.
const AGAIN: Duration = Duration::from_millis(500);
const DISARM_AGAIN: Duration = Duration::from_millis(50);
const HEARTBEAT: Duration = Duration::from_secs(1);
/// A reader that was held up for longer looks anew.
const STALL: Duration = Duration::from_millis(250);
/// An interval that is not answered is asked for again, so often in all.
const ANSWERED: Duration = Duration::from_millis(300);
const ASKED: u8 = 3;
/// Between two questions about its clock: of the first ones, and later.
const QUICK: (u8, Duration) = (10, Duration::from_millis(100));
const CALM: Duration = Duration::from_secs(1);
/// Most bytes taken at once.
const READ: usize = 4096;

/// A message that is asked for.
struct Wanted {
    id: u32,
    name: &'static str,
    /// As the error calls it.
    interval: &'static str,
    /// Hz; `None`: as the IMU is configured.
    rate_hz: Option<f64>,
    /// Refused, it cannot be used: never, by pose, always.
    needed: Needed,
}

#[derive(PartialEq)]
enum Needed {
    No,
    ByPose,
    Always,
}

/// What is asked for.
const MESSAGES: [Wanted; 5] = [
    Wanted {
        id: 105,
        name: "HIGHRES_IMU",
        interval: "the interval of HIGHRES_IMU",
        rate_hz: None,
        needed: Needed::Always,
    },
    Wanted {
        id: 36,
        name: "SERVO_OUTPUT_RAW",
        interval: "the interval of SERVO_OUTPUT_RAW",
        rate_hz: Some(50.0),
        needed: Needed::ByPose,
    },
    Wanted {
        id: 132,
        name: "DISTANCE_SENSOR",
        interval: "the interval of DISTANCE_SENSOR",
        rate_hz: Some(50.0),
        needed: Needed::No,
    },
    Wanted {
        id: 83,
        name: "ATTITUDE_TARGET",
        interval: "the interval of ATTITUDE_TARGET",
        rate_hz: Some(50.0),
        needed: Needed::No,
    },
    Wanted {
        id: 1,
        name: "SYS_STATUS",
        interval: "the interval of SYS_STATUS",
        rate_hz: Some(5.0),
        needed: Needed::No,
    },
];

/// The interval being asked for; answers name none, so there is one at a time.
#[derive(Debug)]
struct Asking {
    /// Of [`MESSAGES`]; beyond the last: all are dealt with.
    index: usize,
    times: u8,
    at: Instant,
}

/// What is known of the autopilot, and what was asked last.
#[derive(Debug)]
struct Known {
    heard: Instant,
    armed: bool,
    offboard: bool,
    /// It was armed because we asked, and obeyed.
    flew: bool,
    /// When it was ordered to arm: if it arms within [`PATIENCE`] that is ours, wanted still or not.
    ordered: Option<Instant>,
    setpoints: (u64, Instant),
    streams_since: Option<Instant>,
    imu: Instant,
    polled: Instant,
    asked: Instant,
    greeted: Instant,
    asking: Asking,
    /// When its clock was asked last, and how often it answered.
    clock: (Instant, u8),
    exchange: Option<Exchange>,
}

/// The reader's end.
pub struct Mavlink {
    autopilot: Arc<Autopilot>,
    rate_hz: f64,
    known: Option<Known>,
    wire: Option<Arc<Wire>>,
    framer: Framer<Frames>,
    bytes: Box<[u8; READ]>,
}

impl Mavlink {
    /// Of `autopilot`, not yet found, with so many IMU samples a second.
    pub fn new(autopilot: Arc<Autopilot>, rate_hz: f64) -> Self {
        let framer = Framer::new(Frames { signer: autopilot.attachment.signer.clone() });
        Self { autopilot, rate_hz, known: None, wire: None, framer, bytes: Box::new([0; READ]) }
    }

    /// What comes within a read's wait, and who sent it where there are several.
    fn read(&mut self, mut each: impl FnMut(Result<(MavHeader, MavMessage), Fault>)) -> Result<Peer, DeviceError> {
        let Some(wire) = &self.wire else { return Ok(None) };
        let read = wire.read(self.bytes.as_mut());
        let (count, peer) = read.map_err(|error| self.autopilot.attachment.port.error(error))?;
        if wire.is_datagrams() {
            // No frame goes on in the next one.
            self.framer.clear();
        }
        self.framer.push(self.bytes.get(..count).unwrap_or_default(), &mut each);
        Ok(peer)
    }

    /// Waits for its heartbeat, and speaks with nobody else from then on.
    fn find(&mut self) -> Result<HEARTBEAT_DATA, DeviceError> {
        let (system, begun) = (self.autopilot.attachment.system, Instant::now());
        let (mut stranger, mut fault) = (None, None);
        while begun.elapsed() < PATIENCE {
            let mut found = None;
            let peer = self.read(|frame| match frame {
                Ok((MavHeader { system_id, component_id: AUTOPILOT, .. }, MavMessage::HEARTBEAT(beat))) => {
                    if system_id == u32::from(system) {
                        found = Some(beat);
                    } else {
                        stranger = Some(system_id);
                    }
                }
                Ok(_) => {}
                Err(given) => fault = Some(given),
            })?;
            if let (Some(beat), Some(wire)) = (found, &self.wire) {
                wire.keep_to(peer).map_err(|error| self.autopilot.attachment.port.error(error))?;
                return Ok(beat);
            }
        }
        let silent = DeviceError::Silent { what: "heartbeat of the autopilot", seconds: PATIENCE.as_secs_f64() };
        Err(match (stranger, fault) {
            (Some(heard), _) => DeviceError::Stranger { wanted: system, heard },
            (None, Some(Fault::Unsigned)) => Fault::Unsigned.into(),
            _ => silent,
        })
    }
}

/// Who sent what was read.
type Peer = Option<std::net::SocketAddr>;

impl Known {
    fn new(now: Instant, flew: bool) -> Self {
        Self {
            heard: now,
            armed: false,
            offboard: false,
            flew,
            ordered: None,
            setpoints: (0, now),
            streams_since: None,
            imu: now,
            polled: now,
            asked: now,
            greeted: now - HEARTBEAT,
            asking: Asking { index: 0, times: 0, at: now },
            clock: (now - CALM, 0),
            exchange: None,
        }
    }

    fn beat(&mut self, beat: &HEARTBEAT_DATA, now: Instant) {
        self.heard = now;
        self.armed = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        self.offboard = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
            && (beat.custom_mode >> 16) & 0xff == OFFBOARD;
        // We arm it in offboard mode: armed in another one, or only so long after the order, it is somebody else's.
        if self.armed && !self.offboard || self.ordered.is_some_and(|at| now - at > PATIENCE) {
            self.ordered = None;
        }
    }

    /// An answer comes sooner than the next heartbeat.
    fn answered(
        &mut self,
        ack: &COMMAND_ACK_DATA,
        autopilot: &Autopilot,
        out: &mut Outlet<'_>,
    ) -> Result<(), DeviceError> {
        let accepted = ack.result == MavResult::MAV_RESULT_ACCEPTED;
        match ack.command {
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if accepted => self.armed = autopilot.arms.load(Ordering::Acquire),
            MavCmd::MAV_CMD_DO_SET_MODE if accepted => self.offboard = true,
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL if self.asking.times > 0 => {
                let Some(wanted) = MESSAGES.get(self.asking.index) else { return Ok(()) };
                (self.asking.index, self.asking.times) = (self.asking.index + 1, 0);
                if !accepted {
                    return refused(wanted, Some(ack.result), autopilot, out);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Asks for the next message that is not dealt with.
    fn subscribe(
        &mut self,
        autopilot: &Autopilot,
        rate_hz: f64,
        now: Instant,
        out: &mut Outlet<'_>,
    ) -> Result<(), DeviceError> {
        let Some(wanted) = MESSAGES.get(self.asking.index) else { return Ok(()) };
        if self.asking.times > 0 && now - self.asking.at < ANSWERED {
            return Ok(());
        }
        if self.asking.times >= ASKED {
            (self.asking.index, self.asking.times) = (self.asking.index + 1, 0);
            return refused(wanted, None, autopilot, out);
        }
        (self.asking.times, self.asking.at) = (self.asking.times + 1, now);
        let interval_us = 1e6 / wanted.rate_hz.unwrap_or(rate_hz);
        autopilot.order(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, wanted.id as f32, interval_us as f32);
        Ok(())
    }

    /// Asks its clock, when that is due.
    fn synchronise(&mut self, autopilot: &Autopilot, now: Instant) {
        let (asked, times) = self.clock;
        let (first, quick) = QUICK;
        if now - asked >= if times < first { quick } else { CALM } {
            self.clock.0 = now;
            let ts1 = autopilot.ns_at(Instant::now());
            autopilot.say(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: 0, ts1, ..TIMESYNC_DATA::DEFAULT }));
        }
    }

    /// A question about our clock, or the answer about its own, which came `at`.
    fn timesync(&mut self, sync: &TIMESYNC_DATA, autopilot: &Autopilot, at: Instant) {
        if sync.tc1 == 0 {
            let tc1 = autopilot.ns_at(Instant::now());
            autopilot.say(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1, ..*sync }));
            return;
        }
        let age_ns = autopilot.ns_at(at) - sync.ts1;
        // Others ask it too, by their own clocks; ours is asked each second.
        let Ok(age) = u64::try_from(age_ns).map(Duration::from_nanos) else { return };
        let Some(asked) = at.checked_sub(age).filter(|_| age < CALM && sync.tc1 > 0) else { return };
        self.clock.1 = self.clock.1.saturating_add(1);
        let stamp = Stamp { ticks: sync.tc1.unsigned_abs(), tick_us: 1e-3, roll_over: 1 << 62 };
        self.exchange = Some(Exchange { asked, answered: at, stamp });
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
        let obeys = self.armed && self.offboard && (self.flew || wanted || self.ordered.is_some());
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
                self.ordered = Some(now);
                autopilot.arm();
            }
        }
    }

    /// Takes a message of the autopilot that came `at`.
    fn take(
        &mut self,
        message: &MavMessage,
        autopilot: &Autopilot,
        at: Instant,
        out: &mut Outlet<'_>,
    ) -> Result<(), DeviceError> {
        match message {
            MavMessage::HEARTBEAT(beat) => self.beat(beat, at),
            MavMessage::COMMAND_ACK(ack) => return self.answered(ack, autopilot, out),
            MavMessage::HIGHRES_IMU(imu) => {
                self.imu = at;
                inertial(imu, autopilot, at, out);
            }
            MavMessage::DISTANCE_SENSOR(range) => below(range, at, out),
            MavMessage::SYS_STATUS(status) if status.voltage_battery != u16::MAX => {
                let volts = 1e-3 * f64::from(status.voltage_battery);
                autopilot.powered(volts);
                out(Ok(Heard { at, stamp: None, after_us: 0.0, reading: Reading::Battery(volts) }));
            }
            MavMessage::ATTITUDE_TARGET(target) => aims(target, autopilot),
            MavMessage::SERVO_OUTPUT_RAW(outputs) if outputs.port == 0 => {
                autopilot.puts_out(&pulses(outputs));
            }
            MavMessage::TIMESYNC(sync) => self.timesync(sync, autopilot, at),
            _ => {}
        }
        Ok(())
    }

    /// Does what is due at `at`.
    fn due(
        &mut self,
        autopilot: &Autopilot,
        rate_hz: f64,
        at: Instant,
        out: &mut Outlet<'_>,
    ) -> Result<(), DeviceError> {
        let gap = at - std::mem::replace(&mut self.polled, at);
        if gap > STALL {
            // This thread stood still: what has come since is old.
            return Err(
                Fault::Value { what: "silence of this reader, s", value: gap.as_secs_f64(), expected: "less" }.into()
            );
        }
        self.attend(autopilot, at);
        self.synchronise(autopilot, at);
        self.subscribe(autopilot, rate_hz, at, out)?;
        if at - self.heard > PATIENCE {
            return Err(DeviceError::Silent { what: "heartbeat of the autopilot", seconds: PATIENCE.as_secs_f64() });
        }
        if at - self.imu > HEARTBEAT {
            (self.imu, self.asking) = (at, Asking { index: 0, times: 0, at });
        }
        Ok(())
    }
}

impl Driver for Mavlink {
    fn open(&mut self) -> Result<(), DeviceError> {
        let attachment = &self.autopilot.attachment;
        self.framer.clear();
        self.wire = Some(Arc::new(Wire::open(&attachment.port, attachment.baud)?));
        let beat = self.find()?;
        if beat.autopilot != MavAutopilot::MAV_AUTOPILOT_PX4 {
            let value = format!("{:?}", beat.autopilot);
            return Err(DeviceError::Wrong { what: "autopilot", value, expected: "MAV_AUTOPILOT_PX4" });
        }
        if beat.mavtype != MavType::MAV_TYPE_QUADROTOR {
            let value = format!("{:?}", beat.mavtype);
            return Err(DeviceError::Wrong { what: "vehicle", value, expected: "MAV_TYPE_QUADROTOR" });
        }
        self.autopilot.attach(self.wire.clone());
        let now = Instant::now();
        let (flew, ordered) = self.known.as_ref().map_or((false, None), |known| (known.flew, known.ordered));
        let mut known = Known { ordered, ..Known::new(now, flew) };
        known.beat(&beat, now);
        self.known = Some(known);
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let autopilot = self.autopilot.clone();
        let Some(mut known) = self.known.take() else { return Ok(()) };
        let mut outcome = Ok(());
        let read = self.read(|frame| {
            let at = Instant::now();
            match frame {
                Ok((header, message))
                    if header.component_id == AUTOPILOT
                        && header.system_id == u32::from(autopilot.attachment.system) =>
                {
                    let taken = known.take(&message, &autopilot, at, out);
                    if outcome.is_ok() {
                        outcome = taken;
                    }
                }
                Ok(_) => {}
                Err(fault) => out(Err(fault)),
            }
        });
        let at = Instant::now();
        let outcome = read.map(drop).and(outcome).and_then(|()| known.due(&autopilot, self.rate_hz, at, out));
        self.known = Some(known);
        outcome
    }

    fn exchange(&mut self) -> Option<Exchange> {
        self.known.as_mut()?.exchange.take()
    }

    fn close(&mut self) {
        self.autopilot.attach(None);
        self.wire = None;
    }
}

/// The interval of `wanted` is refused with `result`, or not answered for.
fn refused(
    wanted: &Wanted,
    result: Option<MavResult>,
    autopilot: &Autopilot,
    out: &mut Outlet<'_>,
) -> Result<(), DeviceError> {
    let by_pose = autopilot.attachment.actuation == Actuation::Pose;
    if wanted.needed == Needed::Always || (wanted.needed == Needed::ByPose && by_pose) {
        let value = result.map_or_else(|| "not answered".to_owned(), |result| format!("{result:?}"));
        return Err(DeviceError::Wrong { what: wanted.interval, value, expected: "MAV_RESULT_ACCEPTED" });
    }
    let what = wanted.name;
    out(Err(result.map_or(Fault::Unanswered { what }, |result| Fault::Refused { what, code: result as u32 })));
    Ok(())
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

/// Rates and thrust that its own loops aim at.
fn aims(target: &ATTITUDE_TARGET_DATA, autopilot: &Autopilot) {
    let rates = Vector3::new(target.body_roll_rate, target.body_pitch_rate, target.body_yaw_rate).cast::<f64>();
    if rates.iter().all(|rate| rate.is_finite()) && target.thrust.is_finite() {
        let Flu(rates) = Frd(rates).into();
        autopilot.aims_at(&rates, f64::from(target.thrust));
    }
}

/// Pulses of its outputs, µs.
fn pulses(outputs: &SERVO_OUTPUT_RAW_DATA) -> [u16; 16] {
    let SERVO_OUTPUT_RAW_DATA {
        servo1_raw: a,
        servo2_raw: b,
        servo3_raw: c,
        servo4_raw: d,
        servo5_raw: e,
        servo6_raw: f,
        servo7_raw: g,
        servo8_raw: h,
        servo9_raw: i,
        servo10_raw: j,
        servo11_raw: k,
        servo12_raw: l,
        servo13_raw: m,
        servo14_raw: n,
        servo15_raw: o,
        servo16_raw: p,
        ..
    } = *outputs;
    [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(imu: &HIGHRES_IMU_DATA) -> Vec<Result<Reading, Fault>> {
        let autopilot = Autopilot::silent();
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
        let autopilot = Autopilot::silent();
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

    /// GIVEN an autopilot that was ordered to arm WHEN the motors are cut before it confirms THEN it is disarmed once it does,
    /// by its answer or by a heartbeat, and again where that was lost.
    #[test]
    fn what_arms_after_a_cut_is_disarmed() {
        for answers in [true, false] {
            let autopilot = Autopilot::silent();
            let begun = Instant::now();
            let at = |ms: u64| begun + Duration::from_millis(ms);
            let setpoints = (u64::MAX, begun);
            let mut known = Known { offboard: true, setpoints, streams_since: Some(begun), ..Known::new(begun, false) };
            let beat = |armed: MavModeFlag| HEARTBEAT_DATA {
                custom_mode: OFFBOARD << 16,
                base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | armed,
                ..HEARTBEAT_DATA::DEFAULT
            };
            let armed = beat(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
            let ack = COMMAND_ACK_DATA {
                command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
                result: MavResult::MAV_RESULT_ACCEPTED,
                ..COMMAND_ACK_DATA::DEFAULT
            };
            let disarms = || !autopilot.arms.load(Ordering::Acquire);
            autopilot.wanted.store(true, Ordering::Release);
            known.attend(&autopilot, at(1300));
            assert!(known.ordered.is_some() && !disarms());
            autopilot.wanted.store(false, Ordering::Release);
            known.beat(&beat(MavModeFlag::empty()), at(1310));
            known.attend(&autopilot, at(1320));
            assert!(!disarms(), "nothing is known yet");
            if answers {
                known.answered(&ack, &autopilot, &mut |_| {}).unwrap();
            } else {
                known.beat(&armed, at(1390));
            }
            known.attend(&autopilot, at(1400));
            assert!(disarms() && known.asked == at(1400), "answers: {answers}");
            // Its answer to the disarming, and a heartbeat that says that it did not.
            known.answered(&ack, &autopilot, &mut |_| {}).unwrap();
            known.attend(&autopilot, at(1500));
            known.beat(&armed, at(2000));
            known.attend(&autopilot, at(2010));
            assert_eq!(known.asked, at(2010), "again");
            // From then on whoever arms it is left alone.
            known.beat(&beat(MavModeFlag::empty()), at(4400));
            known.attend(&autopilot, at(4410));
            known.beat(&armed, at(5000));
            known.attend(&autopilot, at(5010));
            assert!(known.ordered.is_none() && !known.flew && known.asked == at(2010));
        }
    }

    /// GIVEN an autopilot that was ordered to arm WHEN a pilot arms it in another mode, and goes over to offboard in the air THEN it
    /// is not disarmed.
    #[test]
    fn what_a_pilot_armed_is_never_disarmed() {
        let autopilot = Autopilot::silent();
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let mut known = Known { offboard: true, ordered: Some(begun), ..Known::new(begun, false) };
        let armed = |mode: MavModeFlag| HEARTBEAT_DATA {
            custom_mode: OFFBOARD << 16,
            base_mode: MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED | mode,
            ..HEARTBEAT_DATA::DEFAULT
        };
        for (mode, ms) in [(MavModeFlag::empty(), 400), (MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 900)] {
            known.beat(&armed(mode), at(ms));
            known.attend(&autopilot, at(ms + 10));
        }
        assert!(known.armed && known.offboard && known.ordered.is_none());
        assert!(!known.flew && known.asked == begun, "nothing is asked of it");
    }
}

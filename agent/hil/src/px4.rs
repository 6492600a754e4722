//! PX4 in the loop, by its MAVLink interface for simulators.
//!
//! PX4 (SITL) is the client: it connects by TCP to the simulator, 127.0.0.1:4560 for its first instance. Its clock is the
//! time of HIL_SENSOR 0, and HIL_ACTUATOR_CONTROLS with the flag LOCKSTEP is its answer to that message:
//!
//! | phase | a tick |
//! |---|---|
//! | PX4 starts, nothing heard of its motors yet | waits for no answer, at the runner's pace |
//! | lockstep | waits for the answer to its HIL_SENSOR 0; older answers are passed over |
//! | lockstep, IMU 1 gave no sample | PX4 may have nothing to answer to: waits no longer than a tick lasts |
//! | the flag is not set (a PX4 built without lockstep) | takes what has come |
//!
//! HIL_SENSOR 0 goes first, so that PX4 stamps everything else of the tick with the same time. Read in PX4's
//! `SimulatorMavlink.cpp` and in the bridge of Gazebo Classic, tried with a double only.

pub mod messages;

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use mavlink::dialects::common::{
    HEARTBEAT_DATA, HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags, MavAutopilot, MavMessage, MavModeFlag,
    MavState, MavType,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use plumbline_core::event::{Severity, text};
use plumbline_core::sensor::suite::Suite;
use plumbline_core::types::ROTORS;
use plumbline_core::vehicle::VehicleError;
use plumbline_devices::framer::Framer;
use plumbline_devices::port::timed_out;
use plumbline_devices::protocol::mavlink::Frames;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use plumbline_sim::Scenario;

use crate::{Answer, HilError, Line, Notices, Patience, SLICE, Step, check, notice};

/// Where PX4's first instance looks for its simulator.
pub const ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 4560);
const NAME: &str = "PX4";
/// As other simulators call themselves to it.
const SENDER: (u8, u8) = (1, 200);
/// IMUs, magnetometers and barometers that it takes; more make it complain at every message.
const IMUS: usize = 3;
const MAGNETOMETERS: usize = 2;
const BAROMETERS: usize = 2;
/// Its controllers run at up to 400 Hz, and it says that simulators give 250.
const RATES_HZ: [f64; 2] = [200.0, 400.0];
/// Longest wait for its motors after it connected: it may still be starting.
const STARTS: Duration = Duration::from_secs(60);
const HEARTBEAT_S: f64 = 1.0;
/// After such a silence in lockstep a frame begun is none.
const RESYNCHRONISE: Duration = Duration::from_millis(500);
/// Bytes read at once: some forty answers.
const BYTES: usize = 4096;
/// A tick's messages.
const OUT_BYTES: usize = 2048;

/// Is there a way for the samples of `sensor` of a vehicle with these sensors to PX4?
pub fn reaches(suite: &Suite, sensor: SensorId) -> bool {
    let most = match sensor.kind {
        SensorKind::Imu => IMUS,
        SensorKind::Barometer => BAROMETERS,
        SensorKind::Height => suite.heights.len(),
        SensorKind::Gnss | SensorKind::MocapPose => 1,
        _ => 0,
    };
    (1..=most).contains(&usize::from(sensor.instance))
}

/// Waits for PX4 to connect.
#[derive(Debug)]
pub struct Listener {
    socket: TcpListener,
    address: SocketAddr,
    suite: Suite,
    tick: Duration,
}

impl Listener {
    /// On `address`, to fly `scenario`.
    ///
    /// # Errors
    /// [`HilError`] when nothing can be received there, or PX4 cannot fly the scenario.
    pub fn bind(address: SocketAddr, scenario: &Scenario) -> Result<Self, HilError> {
        check(scenario, NAME, RATES_HZ)?;
        let failed = |source| HilError::Port { autopilot: NAME, address, source };
        let socket = TcpListener::bind(address).map_err(failed)?;
        let address = socket.local_addr().map_err(failed)?;
        let tick = Duration::from_secs_f64(scenario.tick_s());
        Ok(Self { socket, address, suite: scenario.suite.clone(), tick })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The first that connects; others are refused from then on.
    ///
    /// # Errors
    /// [`HilError::Accept`].
    pub fn accept(self, patience: Patience) -> Result<Px4, HilError> {
        let failed = |source| HilError::Accept { autopilot: NAME, address: self.address, source };
        let (stream, peer) = self.socket.accept().map_err(failed)?;
        stream.set_nodelay(true).map_err(failed)?;
        stream.set_write_timeout(Some(patience.answer)).map_err(failed)?;
        Ok(Px4 {
            stream,
            peer,
            suite: self.suite,
            tick: self.tick,
            patience,
            framer: Framer::new(Frames::default()),
            bytes: Box::new([0; BYTES]),
            out: Vec::with_capacity(OUT_BYTES),
            sequence: 0,
            connected: Instant::now(),
            beaten: None,
            heard: Heard::default(),
        })
    }
}

/// What was heard of it so far.
#[derive(Debug, Default)]
struct Heard {
    /// Its last answer said that it keeps step; `None` before the first.
    lockstep: Option<bool>,
    /// Its clock was seen to be ours.
    follows: bool,
    /// Frames that were damaged.
    faults: u64,
    told_faults: bool,
}

/// The newest answer to the messages of `now` among the bytes at hand.
fn newest_answer(
    framer: &mut Framer<Frames>,
    heard: &mut Heard,
    now: FlightTime,
) -> Option<HIL_ACTUATOR_CONTROLS_DATA> {
    let mut newest = None;
    while let Some(frame) = framer.next() {
        match frame {
            Ok((_, MavMessage::HIL_ACTUATOR_CONTROLS(controls))) => {
                heard.follows |= controls.time_usec == now.0;
                if !(heard.follows && controls.time_usec < now.0) {
                    newest = Some(controls);
                }
            }
            // Its heartbeat, and the wish for HIL_STATE_QUATERNION, which it gets at every tick.
            Ok(_) => {}
            Err(_) => heard.faults += 1,
        }
    }
    newest
}

/// The connection to one PX4.
#[derive(Debug)]
pub struct Px4 {
    stream: TcpStream,
    peer: SocketAddr,
    suite: Suite,
    tick: Duration,
    patience: Patience,
    framer: Framer<Frames>,
    bytes: Box<[u8; BYTES]>,
    out: Vec<u8>,
    sequence: u8,
    connected: Instant,
    beaten: Option<FlightTime>,
    heard: Heard,
}

impl Line for Px4 {
    fn reaches(&self, sensor: SensorId) -> bool {
        reaches(&self.suite, sensor)
    }

    fn exchange(&mut self, step: &Step<'_>, notices: &mut Notices) -> Result<Option<Answer>, VehicleError> {
        let now = step.received.time;
        // PX4 takes a time of zero for «never».
        if now.0 == 0 {
            return Ok(None);
        }
        self.collect(step);
        if let Err(error) = self.stream.write_all(&self.out) {
            let blocked = timed_out(&error);
            return Err(self.lost(now, &if blocked { "takes no more messages".to_owned() } else { error.to_string() }));
        }
        let stepped = step.received.imus.first().is_some_and(Option::is_some);
        let wait = match self.heard.lockstep {
            Some(true) if stepped => self.patience.answer,
            Some(true) => self.tick,
            _ => self.patience.unstepped,
        };
        let answer = self.answer(now, wait)?;
        self.tell(now, notices);
        let Some(controls) = answer else {
            let waited = match self.heard.lockstep {
                Some(true) if stepped => self.patience.answer,
                None if self.connected.elapsed() > STARTS => STARTS,
                _ => return Ok(None),
            };
            if (self.patience.asked_to_end)() {
                return Ok(None);
            }
            let (faults, skipped) = (self.heard.faults, self.framer.skipped());
            let reason = format!(
                "no actuator controls for {:.0} s (damaged frames: {faults}, bytes of no frame: {skipped})",
                waited.as_secs_f64()
            );
            return Err(self.lost(now, &reason));
        };
        let first = self.heard.lockstep.is_none();
        let lockstep = controls.flags.contains(HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP);
        self.heard.lockstep = Some(lockstep);
        if first {
            let what = if lockstep { "in lockstep" } else { "without lockstep: in real time only" };
            let severity = if lockstep { Severity::Info } else { Severity::Warning };
            notice(notices, severity, text(format_args!("PX4 at {} flies {what}", self.peer)));
        }
        let mut motors = [0.0; ROTORS];
        for (motor, control) in motors.iter_mut().zip(controls.controls) {
            // A motor without a function is not a number.
            *motor = if control.is_nan() { 0.0 } else { f64::from(control) };
        }
        let armed = controls.mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        Ok(Some(Answer { motors, armed, anew: false }))
    }
}

impl Px4 {
    /// Every message of this tick into `out`.
    fn collect(&mut self, step: &Step<'_>) {
        self.out.clear();
        let Step { received, truth, site } = *step;
        let now = received.time;
        for index in 0..IMUS {
            let imu = received.imus.get(index).and_then(Option::as_ref);
            let barometer = received.barometers.get(index).and_then(Option::as_ref);
            let message = messages::sensor(now, index as u8, imu, index < MAGNETOMETERS, barometer);
            // The first one is PX4's clock: it goes out with nothing fresh, too.
            if index == 0 || !message.fields_updated.is_empty() {
                self.say(&MavMessage::HIL_SENSOR(message));
            }
        }
        if let Some(fix) = &received.gnss {
            self.say(&MavMessage::HIL_GPS(messages::gps(now, fix, site)));
        }
        for index in 0..received.heights.len() {
            let sample = received.heights.get(index).and_then(Option::as_ref);
            if let (Some(sample), Some(sheet)) = (sample, self.suite.heights.get(index)) {
                let message = messages::distance(now, index as u8, sample, sheet, &truth.world_from_body);
                self.say(&MavMessage::DISTANCE_SENSOR(message));
            }
        }
        if let (Some(pose), Some(sheet)) = (&received.mocap_pose, &self.suite.mocap_pose) {
            let message = messages::odometry(now, pose, sheet);
            self.say(&MavMessage::ODOMETRY(message));
        }
        self.say(&MavMessage::HIL_STATE_QUATERNION(messages::state(truth, site)));
        if self.beaten.is_none_or(|last| now.seconds_since(last) >= HEARTBEAT_S) {
            self.beaten = Some(now);
            self.say(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                custom_mode: 0,
                mavtype: MavType::MAV_TYPE_GENERIC,
                autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
                base_mode: MavModeFlag::empty(),
                system_status: MavState::MAV_STATE_ACTIVE,
                mavlink_version: 3,
            }));
        }
    }

    fn say(&mut self, message: &MavMessage) {
        let mut raw = MAVLinkV2MessageRaw::new();
        let (system, component_id) = SENDER;
        raw.serialize_message(MavHeader { system_id: system.into(), component_id, sequence: self.sequence }, message);
        self.sequence = self.sequence.wrapping_add(1);
        self.out.extend_from_slice(raw.raw_bytes());
    }

    /// The newest answer to the messages of `now`; `None` where none comes within `wait`, or the program was asked to end.
    fn answer(&mut self, now: FlightTime, wait: Duration) -> Result<Option<HIL_ACTUATOR_CONTROLS_DATA>, VehicleError> {
        let until = Instant::now() + wait;
        let mut heard = Instant::now();
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let read = self.read(left.min(SLICE)).map_err(|error| self.lost(now, &error.to_string()))?;
            let mut newest = None;
            match read {
                Some(0) => return Err(self.lost(now, "closed the connection")),
                Some(length) => {
                    heard = Instant::now();
                    let mut rest = self.bytes.get(..length).unwrap_or_default();
                    while !rest.is_empty() {
                        rest = self.framer.fill(rest);
                        newest = newest_answer(&mut self.framer, &mut self.heard, now).or(newest);
                    }
                }
                None if left.is_zero() || (self.patience.asked_to_end)() => return Ok(None),
                // It waits for us as we do for it: the answer may hide behind noise that promised a longer frame.
                None if heard.elapsed() >= RESYNCHRONISE => {
                    while newest.is_none() && self.framer.give_up() {
                        newest = newest_answer(&mut self.framer, &mut self.heard, now);
                    }
                }
                None => {}
            }
            if newest.is_some() {
                return Ok(newest);
            }
        }
    }

    /// Bytes at hand within `wait`; `None` where there are none, zero at the end of the stream.
    fn read(&mut self, wait: Duration) -> io::Result<Option<usize>> {
        if wait.is_zero() {
            self.stream.set_nonblocking(true)?;
        } else {
            // Less than a microsecond would mean for ever.
            self.stream.set_read_timeout(Some(wait.max(Duration::from_micros(1))))?;
        }
        let read = self.stream.read(self.bytes.as_mut());
        if wait.is_zero() {
            self.stream.set_nonblocking(false)?;
        }
        match read {
            Ok(length) => Ok(Some(length)),
            Err(error) if timed_out(&error) || error.kind() == ErrorKind::Interrupted => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Tells once of what is no MAVLink.
    fn tell(&mut self, now: FlightTime, notices: &mut Notices) {
        let (faults, skipped) = (self.heard.faults, self.framer.skipped());
        if faults + skipped > 0 && !self.heard.told_faults {
            self.heard.told_faults = true;
            let what = text(format_args!(
                "PX4 at {} sends what is no MAVLink at {now}: {faults} damaged frames, {skipped} bytes of none",
                self.peer
            ));
            notice(notices, Severity::Warning, what);
        }
    }

    fn lost(&self, now: FlightTime, reason: &str) -> VehicleError {
        VehicleError::Invalid { what: format!("PX4 at {}", self.peer), reason: format!("{reason}, at {now}") }
    }
}

//! An autopilot in front of the motors: PX4's offboard interface over MAVLink 2, at two depths.
//!
//! - [`rates`]: body rates and thrust (SET_ATTITUDE_TARGET); we estimate and control.
//! - [`pose`]: our estimate (ODOMETRY) and a place (SET_POSITION_TARGET_LOCAL_NED); we estimate, its own controller flies
//!   (\[Clinic\] 5.8).
//!
//! When setpoints stay out for half a second the autopilot leaves offboard mode by itself; nothing here stops its motors
//! sooner once this program is dead.

pub mod pose;
pub mod rates;
pub(crate) mod wire;

use std::io::{self, ErrorKind};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use mavlink::dialects::common::{COMMAND_LONG_DATA, MavCmd, MavMessage};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use nalgebra::Vector3;
use plumbline_core::types::{Actuation, MotorCommand, ROTORS};
use plumbline_core::vehicle::AutopilotState;

use crate::motors::PulseRange;
use crate::port::PortName;
use crate::protocol::mavlink::Signer;
use wire::Wire;

/// Of a companion computer, in the autopilot's own system.
const COMPONENT: u8 = 191;
/// The autopilot itself.
pub(crate) const AUTOPILOT: u8 = 1;
/// PX4's main mode for what comes from outside, in the third byte of its custom mode.
pub(crate) const OFFBOARD: u32 = 6;
/// Second parameter of a disarming that asks for no landing.
const FORCE: f32 = 21_196.0;
/// What was heard longer ago says nothing of now: the autopilot itself waits for half a second, ms.
const STALE_MS: u64 = 250;

/// Numbers from one thread for another; each is whole, and all are of the same moment or its neighbour.
#[derive(Debug)]
pub(crate) struct Numbers<const N: usize> {
    values: [AtomicU64; N],
    /// When they were set, ms of our clock; 0 for never.
    at_ms: AtomicU64,
}

impl<const N: usize> Default for Numbers<N> {
    fn default() -> Self {
        Self { values: std::array::from_fn(|_| AtomicU64::new(0)), at_ms: AtomicU64::new(0) }
    }
}

impl<const N: usize> Numbers<N> {
    pub fn set(&self, values: [f64; N]) {
        for (to, from) in self.values.iter().zip(values) {
            to.store(from.to_bits(), Ordering::Relaxed);
        }
    }

    pub fn get(&self) -> [f64; N] {
        self.values.each_ref().map(|value| f64::from_bits(value.load(Ordering::Relaxed)))
    }
}

/// What an autopilot is, and how it is used.
#[derive(Debug, Clone)]
pub struct Attachment {
    /// Where its bytes come.
    pub port: PortName,
    /// Of a serial port.
    pub baud: u32,
    /// Its system's number.
    pub system: u8,
    /// Rates or pose.
    pub actuation: Actuation,
    /// Its output of each motor, and its pulses as commands.
    pub channels: [u8; ROTORS],
    /// At which its outputs stand still and are full.
    pub range: PulseRange,
    /// Signs what is sent and verifies what comes.
    pub signer: Option<Arc<Signer>>,
}

impl Attachment {
    /// System 1 on `port`, whose sensors are read.
    pub fn new(port: PortName, baud: u32) -> Self {
        Self {
            port,
            baud,
            system: 1,
            actuation: Actuation::Rates,
            channels: [0, 1, 2, 3],
            range: PulseRange { stop_us: 1000.0, full_us: 2000.0 },
            signer: None,
        }
    }
}

/// The way to one autopilot, for the reader that listens to it and the flight thread that commands it.
#[derive(Debug)]
pub struct Autopilot {
    pub(crate) attachment: Attachment,
    /// Open while its reader has it open.
    wire: Mutex<Option<Arc<Wire>>>,
    begun: Instant,
    sequence: AtomicU8,
    setpoints: AtomicU64,
    /// Shall the motors turn?
    pub(crate) wanted: AtomicBool,
    /// Was it ordered last to arm, not to disarm?
    pub(crate) arms: AtomicBool,
    /// When it was last known to be armed and in offboard mode because we asked, ms of our clock; 0 for never.
    obeyed_ms: AtomicU64,
    /// It left offboard mode while it flew for us.
    pub(crate) taken: AtomicBool,
    gyro_flu_radps: Numbers<3>,
    voltage_v: AtomicU64,
    /// Rates FLU and thrust that its loops aim at.
    aims_at: Numbers<4>,
    /// Commands of its outputs.
    outputs: Numbers<ROTORS>,
}

impl Autopilot {
    /// As `attachment` says, closed.
    pub fn new(attachment: Attachment) -> Self {
        Self {
            attachment,
            wire: Mutex::default(),
            begun: Instant::now(),
            sequence: AtomicU8::new(0),
            setpoints: AtomicU64::new(0),
            wanted: AtomicBool::new(false),
            arms: AtomicBool::new(false),
            obeyed_ms: AtomicU64::new(0),
            taken: AtomicBool::new(false),
            gyro_flu_radps: Numbers::default(),
            voltage_v: AtomicU64::new(f64::NAN.to_bits()),
            aims_at: Numbers::default(),
            outputs: Numbers::default(),
        }
    }

    /// One that nobody answers for.
    #[cfg(test)]
    pub(crate) fn silent() -> Self {
        Self::new(Attachment::new(PortName::parse("udp:127.0.0.1:0").unwrap(), 0))
    }

    /// What is sent goes there from here on; nowhere without any.
    pub(crate) fn attach(&self, wire: Option<Arc<Wire>>) {
        *self.wire.lock().unwrap_or_else(PoisonError::into_inner) = wire;
    }

    /// Setpoints sent so far.
    pub(crate) fn setpoints(&self) -> u64 {
        self.setpoints.load(Ordering::Relaxed)
    }

    pub(crate) fn measured(&self, gyro_flu_radps: &Vector3<f64>) {
        self.gyro_flu_radps.set((*gyro_flu_radps).into());
    }

    fn gyro_flu_radps(&self) -> Vector3<f64> {
        self.gyro_flu_radps.get().into()
    }

    pub(crate) fn powered(&self, voltage_v: f64) {
        self.voltage_v.store(voltage_v.to_bits(), Ordering::Relaxed);
    }

    fn voltage_v(&self) -> f64 {
        f64::from_bits(self.voltage_v.load(Ordering::Relaxed))
    }

    /// Its loops aim at these rates and this thrust.
    pub(crate) fn aims_at(&self, rates_flu_radps: &Vector3<f64>, thrust: f64) {
        let [x, y, z] = (*rates_flu_radps).into();
        self.aims_at.set([x, y, z, thrust]);
        self.aims_at.at_ms.store(self.now_ms().max(1), Ordering::Release);
    }

    /// Its outputs have these pulses, µs, 0 where there is none.
    pub(crate) fn puts_out(&self, pulses_us: &[u16; 16]) {
        let PulseRange { stop_us, full_us } = self.attachment.range;
        let mut commands = [0.0; ROTORS];
        for (command, channel) in commands.iter_mut().zip(self.attachment.channels) {
            let pulse_us = pulses_us.get(usize::from(channel)).copied().unwrap_or_default();
            *command = ((f64::from(pulse_us) - stop_us) / (full_us - stop_us)).clamp(0.0, 1.0);
        }
        self.outputs.set(commands);
        self.outputs.at_ms.store(self.now_ms().max(1), Ordering::Release);
    }

    /// What it said lately.
    fn said(&self) -> AutopilotState {
        let [x, y, z, thrust] = self.aims_at.get();
        AutopilotState {
            asked: None,
            aims_at: self.is_fresh(&self.aims_at.at_ms).then(|| (Vector3::new(x, y, z), thrust)),
            outputs: self.is_fresh(&self.outputs.at_ms).then(|| MotorCommand { throttle: self.outputs.get() }),
        }
    }

    /// It is armed and in offboard mode because we asked, or is not.
    pub(crate) fn obeys(&self, does: bool) {
        self.obeyed_ms.store(if does { self.now_ms().max(1) } else { 0 }, Ordering::Release);
    }

    /// Is that so, as far as was heard just now? After a silence of ours its own failsafe may fly it.
    fn obeyed(&self) -> bool {
        self.is_fresh(&self.obeyed_ms)
    }

    fn is_fresh(&self, at_ms: &AtomicU64) -> bool {
        let at_ms = at_ms.load(Ordering::Acquire);
        at_ms > 0 && self.now_ms().saturating_sub(at_ms) < STALE_MS
    }

    /// Our clock at `instant`, ns: the one that TIMESYNC answers with.
    pub(crate) fn ns_at(&self, instant: Instant) -> i64 {
        instant.saturating_duration_since(self.begun).as_nanos() as i64
    }

    fn now_ms(&self) -> u64 {
        self.begun.elapsed().as_millis() as u64
    }

    /// Sends a message. What finds no room, or nobody yet, is given up. Two threads speak, and one waits until the other's
    /// frame is written, 1 ms at most: a signature whose time is not newer than the last that arrived is refused.
    pub(crate) fn say(&self, message: &MavMessage) {
        let wire = self.wire.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(wire) = wire.as_ref() else { return };
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let header = MavHeader { system_id: self.attachment.system.into(), component_id: COMPONENT, sequence };
        let raw = match &self.attachment.signer {
            Some(signer) => signer.sign(header, message),
            None => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message(header, message);
                raw
            }
        };
        wire.write(raw.raw_bytes());
    }

    /// The same of a setpoint, which is counted: a stream of them keeps it in offboard mode.
    fn setpoint(&self, message: &MavMessage) {
        self.say(message);
        self.setpoints.fetch_add(1, Ordering::Relaxed);
    }

    /// Sends a command with its first two parameters.
    pub(crate) fn order(&self, command: MavCmd, param1: f32, param2: f32) {
        self.say(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1,
            param2,
            command,
            target_system: self.attachment.system,
            target_component: AUTOPILOT,
            ..COMMAND_LONG_DATA::DEFAULT
        }));
    }

    pub(crate) fn arm(&self) {
        self.arms.store(true, Ordering::Release);
        self.order(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0);
    }

    /// Off at once, in the air as well.
    pub(crate) fn disarm(&self) {
        self.arms.store(false, Ordering::Release);
        self.order(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE);
    }

    /// The motors shall turn, or shall not, as `command` says.
    fn wants(&self, command: &MotorCommand) -> io::Result<()> {
        if self.taken.load(Ordering::Acquire) {
            return Err(io::Error::new(
                ErrorKind::ConnectionAborted,
                "left offboard mode: its pilot or its failsafe flies",
            ));
        }
        self.wanted.store(*command != MotorCommand::default(), Ordering::Release);
        Ok(())
    }

    /// Motors off, where it flies for us.
    fn stop(&self) {
        self.wanted.store(false, Ordering::Release);
        if self.obeyed() {
            self.disarm();
        }
    }
}

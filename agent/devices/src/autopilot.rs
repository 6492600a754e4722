//! An autopilot as the vehicle, commanded by body rates and thrust: PX4's offboard interface over MAVLink 2.
//!
//! What the flight commands the motors is taken back to the wrench that they would give, and that to what a rate loop needs
//! to give it:
//!
//! ω_s = ω + t_r J⁻¹ τ, c = c_h T / (m g)
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | T, τ | thrust and torque of the wrench | N, N m |
//! | ω | angular rate, as the autopilot measured it last | rad/s |
//! | J, m g | inertia and weight of the airframe | kg m², N |
//! | t_r | time constant of the autopilot's rate loop | s |
//! | c_h | thrust at which the autopilot hovers (`MPC_THR_HOVER`) | 1 |
//! | ω_s, c | body rates and thrust of SET_ATTITUDE_TARGET | rad/s, 1 |
//!
//! Assumes a rate loop of first order and a thrust that is linear in c. The rates' own loop runs in the autopilot on its own
//! gyroscopes: no attack of ours reaches it. When setpoints stay out for half a second the autopilot leaves offboard mode by
//! itself; nothing here stops its motors sooner once this program is dead.

use std::io::{self, ErrorKind};
use std::net::UdpSocket;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use mavlink::dialects::common::{
    AttitudeTargetTypemask, COMMAND_LONG_DATA, MavCmd, MavMessage, SET_ATTITUDE_TARGET_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use nalgebra::Vector3;
use plumbline_core::frames::{Flu, Frd};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::MotorStop;

use crate::fault::DeviceError;
use crate::motors::Motors;
use crate::port::PortName;

/// Of a companion computer, in the autopilot's own system.
const COMPONENT: u8 = 191;
/// The autopilot itself.
pub(crate) const AUTOPILOT: u8 = 1;
/// PX4's main mode for what comes from outside, in the third byte of its custom mode.
pub(crate) const OFFBOARD: u32 = 6;
/// Second parameter of a disarming that asks for no landing.
const FORCE: f32 = 21_196.0;
/// Longest that a setpoint waits for room in the socket.
const ROOM: Duration = Duration::from_millis(1);
/// What was heard longer ago says nothing of now: the autopilot itself waits for half a second, ms.
const STALE_MS: u64 = 250;
/// Battery ratios that count.
const VOLTAGE_RATIO: (f64, f64) = (0.7, 1.25);

/// The way to one autopilot, for the reader that listens to it and the flight thread that commands it.
#[derive(Debug)]
pub struct Autopilot {
    pub(crate) port: PortName,
    /// Its system's number.
    pub(crate) system: u8,
    socket: OnceLock<UdpSocket>,
    begun: Instant,
    sequence: AtomicU8,
    setpoints: AtomicU64,
    /// Shall the motors turn?
    pub(crate) wanted: AtomicBool,
    /// When it was last known to be armed and in offboard mode because we asked, ms of our clock; 0 for never.
    obeyed_ms: AtomicU64,
    /// It left offboard mode while it flew for us.
    pub(crate) taken: AtomicBool,
    gyro_flu_radps: [AtomicU64; 3],
    voltage_v: AtomicU64,
}

impl Autopilot {
    /// `system`, whose datagrams come to `port`.
    pub fn new(port: PortName, system: u8) -> Self {
        Self {
            port,
            system,
            socket: OnceLock::new(),
            begun: Instant::now(),
            sequence: AtomicU8::new(0),
            setpoints: AtomicU64::new(0),
            wanted: AtomicBool::new(false),
            obeyed_ms: AtomicU64::new(0),
            taken: AtomicBool::new(false),
            gyro_flu_radps: Default::default(),
            voltage_v: AtomicU64::new(f64::NAN.to_bits()),
        }
    }

    /// Its socket, bound by the first who asks.
    pub(crate) fn socket(&self) -> Result<&UdpSocket, DeviceError> {
        if let Some(socket) = self.socket.get() {
            return Ok(socket);
        }
        let socket = self.port.open_datagrams()?;
        socket.set_write_timeout(Some(ROOM)).map_err(|error| self.port.error(error))?;
        Ok(self.socket.get_or_init(|| socket))
    }

    /// Setpoints sent so far.
    pub(crate) fn setpoints(&self) -> u64 {
        self.setpoints.load(Ordering::Relaxed)
    }

    pub(crate) fn measured(&self, gyro_flu_radps: &Vector3<f64>) {
        for (to, from) in self.gyro_flu_radps.iter().zip(gyro_flu_radps.iter()) {
            to.store(from.to_bits(), Ordering::Relaxed);
        }
    }

    pub(crate) fn powered(&self, voltage_v: f64) {
        self.voltage_v.store(voltage_v.to_bits(), Ordering::Relaxed);
    }

    /// It is armed and in offboard mode because we asked, or is not.
    pub(crate) fn obeys(&self, does: bool) {
        let now_ms = self.begun.elapsed().as_millis() as u64;
        self.obeyed_ms.store(if does { now_ms.max(1) } else { 0 }, Ordering::Release);
    }

    /// Is that so, as far as was heard just now? After a silence of ours its own failsafe may fly it.
    fn obeyed(&self) -> bool {
        let at_ms = self.obeyed_ms.load(Ordering::Acquire);
        at_ms > 0 && (self.begun.elapsed().as_millis() as u64).saturating_sub(at_ms) < STALE_MS
    }

    /// Our clock, ns.
    pub(crate) fn now_ns(&self) -> i64 {
        self.begun.elapsed().as_nanos() as i64
    }

    /// Sends a message. What finds no room, or nobody yet, is given up.
    pub(crate) fn say(&self, message: &MavMessage) {
        let Some(socket) = self.socket.get() else { return };
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: self.system.into(), component_id: COMPONENT, sequence };
        raw.serialize_message(header, message);
        let _ = socket.send(raw.raw_bytes());
    }

    /// Sends a command with its first two parameters.
    pub(crate) fn order(&self, command: MavCmd, param1: f32, param2: f32) {
        self.say(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1,
            param2,
            command,
            target_system: self.system,
            target_component: AUTOPILOT,
            ..COMMAND_LONG_DATA::DEFAULT
        }));
    }

    pub(crate) fn arm(&self) {
        self.order(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0);
    }

    /// Off at once, in the air as well.
    pub(crate) fn disarm(&self) {
        self.order(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE);
    }
}

/// The flight thread's end: commands of four motors, as body rates and thrust.
#[derive(Debug)]
pub struct AutopilotLine {
    autopilot: Arc<Autopilot>,
    airframe: Airframe,
    hover_thrust: f64,
    rate_loop_s: f64,
}

impl AutopilotLine {
    /// To `autopilot` on `airframe`: hovers at `hover_thrust`, 0 to 1; its rate loop has the time constant `rate_loop_s`.
    pub fn new(autopilot: Arc<Autopilot>, airframe: Airframe, hover_thrust: f64, rate_loop_s: f64) -> Self {
        Self { autopilot, airframe, hover_thrust, rate_loop_s }
    }

    /// Body rates FLU, rad/s, and thrust, 0 to 1, that give the wrench of `command`.
    pub fn target(&self, command: &MotorCommand) -> (Vector3<f64>, f64) {
        if *command == MotorCommand::default() {
            return (Vector3::zeros(), 0.0);
        }
        let load = |value: &AtomicU64| f64::from_bits(value.load(Ordering::Relaxed));
        let ratio = load(&self.autopilot.voltage_v) / self.airframe.battery.nominal_v();
        let (least, most) = VOLTAGE_RATIO;
        let ratio = if ratio.is_nan() { 1.0 } else { ratio.clamp(least, most) };
        let speeds = command.throttle.map(|throttle| self.airframe.motor_curve.speed_radps(throttle, ratio));
        let wrench = self.airframe.wrench(&speeds);
        let gyro = Vector3::from(self.autopilot.gyro_flu_radps.each_ref().map(load));
        let turn = wrench.torque_flu_nm.component_div(&self.airframe.inertia_kgm2);
        let thrust = self.hover_thrust * wrench.thrust_n / self.airframe.weight_n();
        (gyro + self.rate_loop_s * turn, thrust.clamp(0.0, 1.0))
    }
}

impl Motors for AutopilotLine {
    fn send(&self, command: &MotorCommand) -> io::Result<MotorCommand> {
        let autopilot = &self.autopilot;
        if autopilot.taken.load(Ordering::Acquire) {
            return Err(io::Error::new(
                ErrorKind::ConnectionAborted,
                "left offboard mode: its pilot or its failsafe flies",
            ));
        }
        autopilot.wanted.store(*command != MotorCommand::default(), Ordering::Release);
        let (rates, thrust) = self.target(command);
        let Frd(rates) = Flu(rates).into();
        autopilot.say(&MavMessage::SET_ATTITUDE_TARGET(SET_ATTITUDE_TARGET_DATA {
            time_boot_ms: autopilot.begun.elapsed().as_millis() as u32,
            q: [1.0, 0.0, 0.0, 0.0],
            body_roll_rate: rates.x as f32,
            body_pitch_rate: rates.y as f32,
            body_yaw_rate: rates.z as f32,
            thrust: thrust as f32,
            target_system: autopilot.system,
            target_component: AUTOPILOT,
            type_mask: AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE,
            thrust_body: [0.0; 3],
        }));
        autopilot.setpoints.fetch_add(1, Ordering::Relaxed);
        Ok(if autopilot.obeyed() { *command } else { MotorCommand::default() })
    }
}

impl MotorStop for AutopilotLine {
    fn stop(&self) {
        self.autopilot.wanted.store(false, Ordering::Release);
        if self.autopilot.obeyed() {
            self.autopilot.disarm();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> AutopilotLine {
        let autopilot = Arc::new(Autopilot::new(PortName::parse("udp:127.0.0.1:0").unwrap(), 1));
        AutopilotLine::new(autopilot, Airframe::iris(), 0.4, 0.05)
    }

    #[test]
    fn hovering_asks_for_hover_thrust_and_keeps_the_rate_that_is() {
        let line = line();
        let hovers = MotorCommand { throttle: [line.airframe.hover_command(); 4] };
        line.autopilot.measured(&Vector3::new(0.1, -0.2, 0.3));
        let (rates, thrust) = line.target(&hovers);
        assert!((thrust - 0.4).abs() < 1e-6, "{thrust}");
        assert!((rates - Vector3::new(0.1, -0.2, 0.3)).norm() < 1e-6, "{rates}");
        assert_eq!(line.target(&MotorCommand::default()), (Vector3::zeros(), 0.0));
    }

    #[test]
    fn a_torque_asks_for_a_rate_that_its_loop_turns_into_that_torque() {
        let line = line();
        let hover = line.airframe.hover_command();
        let throttle =
            std::array::from_fn(|motor| hover + 0.02 * line.airframe.rotors[motor].position_flu_m.y.signum());
        let (rates, _) = line.target(&MotorCommand { throttle });
        let speeds = throttle.map(|t| line.airframe.motor_curve.speed_radps(t, 1.0));
        let torque = line.airframe.wrench(&speeds).torque_flu_nm;
        assert!(torque.x.abs() > 0.01);
        let given = rates.component_mul(&line.airframe.inertia_kgm2) / 0.05;
        assert!((given - torque).norm() < 1e-9, "{given} {torque}");
    }
}

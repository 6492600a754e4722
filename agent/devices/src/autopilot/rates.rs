//! Commands of four motors as body rates and thrust.
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
//! gyroscopes: no attack of ours reaches it.

use std::io;
use std::sync::Arc;

use mavlink::dialects::common::{AttitudeTargetTypemask, MavMessage, SET_ATTITUDE_TARGET_DATA};
use nalgebra::Vector3;
use plumbline_core::frames::{Flu, Frd};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::{AutopilotState, MotorStop};

use super::{AUTOPILOT, Autopilot, Numbers};
use crate::motors::Motors;

/// Battery ratios that count.
const VOLTAGE_RATIO: (f64, f64) = (0.7, 1.25);

/// The flight thread's end.
#[derive(Debug)]
pub struct RatesLine {
    autopilot: Arc<Autopilot>,
    airframe: Airframe,
    hover_thrust: f64,
    rate_loop_s: f64,
    /// Rates FLU and thrust of the last setpoint.
    asked: Numbers<4>,
}

impl RatesLine {
    /// To `autopilot` on `airframe`: hovers at `hover_thrust`, 0 to 1; its rate loop has the time constant `rate_loop_s`.
    pub fn new(autopilot: Arc<Autopilot>, airframe: Airframe, hover_thrust: f64, rate_loop_s: f64) -> Self {
        Self { autopilot, airframe, hover_thrust, rate_loop_s, asked: Numbers::default() }
    }

    /// Body rates FLU, rad/s, and thrust, 0 to 1, that give the wrench of `command`.
    pub fn target(&self, command: &MotorCommand) -> (Vector3<f64>, f64) {
        if *command == MotorCommand::default() {
            return (Vector3::zeros(), 0.0);
        }
        let ratio = self.autopilot.voltage_v() / self.airframe.battery.nominal_v();
        let (least, most) = VOLTAGE_RATIO;
        let ratio = if ratio.is_nan() { 1.0 } else { ratio.clamp(least, most) };
        let speeds = command.throttle.map(|throttle| self.airframe.motor_curve.speed_radps(throttle, ratio));
        let wrench = self.airframe.wrench(&speeds);
        let turn = wrench.torque_flu_nm.component_div(&self.airframe.inertia_kgm2);
        let thrust = self.hover_thrust * wrench.thrust_n / self.airframe.weight_n();
        (self.autopilot.gyro_flu_radps() + self.rate_loop_s * turn, thrust.clamp(0.0, 1.0))
    }
}

impl Motors for RatesLine {
    fn send(&self, command: &MotorCommand) -> io::Result<MotorCommand> {
        let autopilot = &self.autopilot;
        autopilot.wants(command)?;
        let (rates, thrust) = self.target(command);
        self.asked.set([rates.x, rates.y, rates.z, thrust]);
        let Frd(rates) = Flu(rates).into();
        autopilot.setpoint(&MavMessage::SET_ATTITUDE_TARGET(SET_ATTITUDE_TARGET_DATA {
            time_boot_ms: autopilot.now_ms() as u32,
            q: [1.0, 0.0, 0.0, 0.0],
            body_roll_rate: rates.x as f32,
            body_pitch_rate: rates.y as f32,
            body_yaw_rate: rates.z as f32,
            thrust: thrust as f32,
            target_system: autopilot.attachment.system,
            target_component: AUTOPILOT,
            type_mask: AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE,
            thrust_body: [0.0; 3],
        }));
        Ok(if autopilot.obeyed() { *command } else { MotorCommand::default() })
    }

    fn autopilot(&self) -> Option<AutopilotState> {
        let [x, y, z, thrust] = self.asked.get();
        Some(AutopilotState { asked: Some((Vector3::new(x, y, z), thrust)), ..self.autopilot.said() })
    }
}

impl MotorStop for RatesLine {
    fn stop(&self) {
        self.autopilot.stop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> RatesLine {
        RatesLine::new(Arc::new(Autopilot::silent()), Airframe::iris(), 0.4, 0.05)
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

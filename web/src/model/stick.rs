//! What the sticks of a gamepad mean in stabilise: tilt, turning, thrust. The vehicle bounds and smooths them once more.

use plumbline_rest::command::Setpoint;

use super::curves::DEGREES;

/// A stick that is moved less is at rest.
const REST: f64 = 0.08;
/// How much softer the middle is than the ends: 0 is a straight line, 1 all cubic.
const EXPO: f64 = 0.5;
/// Tilt of a stick at its end, where the vehicle's own limit is not lower, rad.
const TILT_RAD: f64 = 12.0 / DEGREES;
/// Fastest change of the tilt asked for, rad/s, of the thrust, weights a second, and fastest turn, rad/s.
const TILT_RATE_RADPS: f64 = 40.0 / DEGREES;
const THROTTLE_RATE_PER_S: f64 = 0.6;
const TURN_RADPS: f64 = 45.0 / DEGREES;
/// Thrust of a stick at its ends differs so much from the weight, weights.
const THROTTLE: f64 = 0.3;

/// Sticks as the standard mapping of browsers numbers them: each -1 to 1, right and down positive.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sticks {
    /// Left stick, to the right: turns right.
    pub turn: f64,
    /// Left stick, down: less thrust.
    pub down: f64,
    /// Right stick, to the right: leans right.
    pub right: f64,
    /// Right stick, down: leans back.
    pub back: f64,
}

/// What is asked of the vehicle, from the moment on at which the dead-man button was pressed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// Roll, pitch (nose down positive), yaw, rad.
    pub roll_pitch_yaw_rad: [f64; 3],
    /// Thrust over weight.
    pub throttle: f64,
}

impl Asked {
    /// Level, with the weight for a thrust, heading as it is.
    pub fn level(yaw_rad: f64) -> Self {
        Self { roll_pitch_yaw_rad: [0.0, 0.0, yaw_rad], throttle: 1.0 }
    }

    /// After `dt_s` of these sticks; tilt and thrust within the vehicle's limits.
    #[must_use]
    pub fn after(self, sticks: Sticks, dt_s: f64, tilt_max_rad: f64, throttle_max: f64) -> Self {
        let tilt = TILT_RAD.min(tilt_max_rad);
        let [roll, pitch, yaw] = self.roll_pitch_yaw_rad;
        let toward = |from: f64, to: f64, rate: f64| from + (to - from).clamp(-rate * dt_s, rate * dt_s);
        let throttle = (1.0 - THROTTLE * shaped(sticks.down)).min(throttle_max);
        Self {
            roll_pitch_yaw_rad: [
                toward(roll, tilt * shaped(sticks.right), TILT_RATE_RADPS),
                toward(pitch, -tilt * shaped(sticks.back), TILT_RATE_RADPS),
                wrapped(yaw - TURN_RADPS * dt_s * shaped(sticks.turn)),
            ],
            throttle: toward(self.throttle, throttle, THROTTLE_RATE_PER_S),
        }
    }

    /// As the ground takes it.
    pub fn setpoint(self) -> Setpoint {
        // Finer than a stick: what is recorded of it can be read.
        let rounded = |value: f64| (value * 1e3).round() / 1e3;
        let [roll, pitch, yaw] = self.roll_pitch_yaw_rad.map(|rad| Some(rounded(rad)));
        Setpoint {
            roll_rad: roll,
            pitch_rad: pitch,
            yaw_rad: yaw,
            throttle: Some(rounded(self.throttle)),
            ..Setpoint::default()
        }
    }
}

/// Rest in the middle, soft about it, whole at the ends.
fn shaped(stick: f64) -> f64 {
    let moved = ((stick.abs() - REST) / (1.0 - REST)).clamp(0.0, 1.0);
    (moved * (1.0 - EXPO) + EXPO * moved.powi(3)).copysign(stick)
}

fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticks_rest_in_the_middle_and_reach_their_ends() {
        assert_eq!([0.0, 0.07, -0.08, 1.0, -1.0, 7.0].map(shaped), [0.0, 0.0, -0.0, 1.0, -1.0, 1.0]);
        assert!(shaped(0.5) < 0.4 && shaped(-0.5) == -shaped(0.5), "soft about the middle");
        let still = Asked::level(0.3).after(Sticks::default(), 1.0, 0.35, 1.5).setpoint();
        assert_eq!(still, Asked::level(0.3).setpoint());
    }

    #[test]
    fn right_leans_right_forward_leans_forward_and_nothing_jumps() {
        let sticks = Sticks { turn: 1.0, down: -1.0, right: 1.0, back: -1.0 };
        let once = Asked::level(0.0).after(sticks, 0.05, 0.35, 1.5);
        let [roll, pitch, yaw] = once.roll_pitch_yaw_rad;
        assert!(roll > 0.0 && pitch > 0.0 && yaw < 0.0 && once.throttle > 1.0, "{once:?}");
        assert!(roll <= TILT_RATE_RADPS * 0.05 + 1e-12 && once.throttle <= 1.0 + THROTTLE_RATE_PER_S * 0.05 + 1e-12);
        let held = (0..200).fold(once, |asked, _| asked.after(sticks, 0.05, 0.1, 1.2));
        assert_eq!((held.roll_pitch_yaw_rad[0], held.throttle), (0.1, 1.2), "the vehicle's limits");
        assert!(held.roll_pitch_yaw_rad[2].abs() <= std::f64::consts::PI);
        let setpoint = held.setpoint();
        assert!(setpoint.altitude_m.is_none() && setpoint.roll_rad == Some(0.1));
    }
}

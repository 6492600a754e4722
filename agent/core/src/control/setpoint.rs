//! Setpoints: limits, and the profile that takes the controller from one to the next.
//!
//! The operator's step is never shown to the controller: altitude and position follow a
//! trapezoidal velocity profile (acceleration and speed limited, no overshoot by itself), angles
//! and throttle a rate limit. Velocity and acceleration of the profile are fed forward.

use nalgebra::Vector3;

use super::Setpoint;
use crate::frames::wrap_pi;

/// How far and how fast the vehicle may be asked to go. Enforced by the agent, whatever a ground says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lowest altitude setpoint, m.
    pub altitude_min_m: f64,
    /// Highest altitude setpoint, m.
    pub altitude_max_m: f64,
    /// Largest |x| and |y|, m.
    pub lateral_max_m: f64,
    /// Fastest climb, m/s.
    pub climb_max_mps: f64,
    /// Fastest descent, m/s.
    pub descent_max_mps: f64,
    /// Largest roll and pitch setpoint, rad.
    pub tilt_max_rad: f64,
    /// Highest collective throttle in stabilise mode, fraction of the weight.
    pub throttle_max: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            altitude_min_m: 0.0,
            altitude_max_m: 2.0,
            lateral_max_m: 2.0,
            climb_max_mps: 0.6,
            descent_max_mps: 0.5,
            tilt_max_rad: 0.35,
            throttle_max: 1.5,
        }
    }
}

/// Vertical acceleration of the profile, m/s².
const VERTICAL_ACCELERATION_MPS2: f64 = 1.2;
/// Horizontal speed and acceleration of the profile, m/s, m/s².
const HORIZONTAL_SPEED_MPS: f64 = 1.0;
const HORIZONTAL_ACCELERATION_MPS2: f64 = 1.0;
/// Rate of the yaw setpoint, rad/s.
const YAW_RATE_RADPS: f64 = 1.0;
/// Rate of the roll and pitch setpoints, rad/s.
const TILT_RATE_RADPS: f64 = 2.0;
/// Rate of the throttle, 1/s.
const THROTTLE_RATE_PER_S: f64 = 1.0;

/// Moves a setpoint towards its target within the limits.
#[derive(Debug, Clone, Copy, Default)]
pub struct Profile {
    now: Setpoint,
}

impl Profile {
    /// What the controller is given.
    pub fn setpoint(&self) -> &Setpoint {
        &self.now
    }

    /// Starts again from `setpoint`, at rest.
    pub fn restart(&mut self, setpoint: Setpoint) {
        self.now = Setpoint { velocity_enu_mps: Vector3::zeros(), acceleration_enu_mps2: Vector3::zeros(), ..setpoint };
    }

    /// Goes along with a path that is continuous by itself.
    pub fn follow(&mut self, setpoint: Setpoint) -> &Setpoint {
        self.now = setpoint;
        &self.now
    }

    /// One tick towards `target`.
    pub fn step(&mut self, target: &Setpoint, limits: &Limits, dt_s: f64) -> &Setpoint {
        let bounds = [
            (HORIZONTAL_SPEED_MPS, HORIZONTAL_SPEED_MPS, HORIZONTAL_ACCELERATION_MPS2),
            (HORIZONTAL_SPEED_MPS, HORIZONTAL_SPEED_MPS, HORIZONTAL_ACCELERATION_MPS2),
            (limits.climb_max_mps, limits.descent_max_mps, VERTICAL_ACCELERATION_MPS2),
        ];
        for (axis, (up, down, acceleration)) in bounds.into_iter().enumerate() {
            let mut p = self.now.position_enu_m[axis];
            let mut v = self.now.velocity_enu_mps[axis];
            trapezoid(&mut p, &mut v, target.position_enu_m[axis], up, down, acceleration, dt_s);
            self.now.position_enu_m[axis] = p;
            // The last tick, which stops at once, is no acceleration to be flown.
            let changed = if dt_s > 0.0 { (v - self.now.velocity_enu_mps[axis]) / dt_s } else { 0.0 };
            self.now.acceleration_enu_mps2[axis] = changed.clamp(-acceleration, acceleration);
            self.now.velocity_enu_mps[axis] = v;
        }
        let angles = &mut self.now.roll_pitch_yaw_rad;
        for axis in 0..2 {
            angles[axis] = towards(angles[axis], target.roll_pitch_yaw_rad[axis], TILT_RATE_RADPS * dt_s);
        }
        let yaw_step = wrap_pi(target.roll_pitch_yaw_rad.z - angles.z);
        angles.z = wrap_pi(angles.z + yaw_step.clamp(-YAW_RATE_RADPS * dt_s, YAW_RATE_RADPS * dt_s));
        self.now.throttle = towards(self.now.throttle, target.throttle, THROTTLE_RATE_PER_S * dt_s);
        &self.now
    }
}

/// Where a profile that moves with `velocity_enu_mps` at `position_enu_m` comes to rest at the earliest, ENU, m.
pub fn rests_at(position_enu_m: &Vector3<f64>, velocity_enu_mps: &Vector3<f64>) -> Vector3<f64> {
    let brake = Vector3::new(HORIZONTAL_ACCELERATION_MPS2, HORIZONTAL_ACCELERATION_MPS2, VERTICAL_ACCELERATION_MPS2);
    let braking = velocity_enu_mps.zip_map(&brake, |v, brake| 0.5 * v * v.abs() / brake);
    position_enu_m + braking
}

fn towards(from: f64, to: f64, step: f64) -> f64 {
    from + (to - from).clamp(-step, step)
}

/// One tick of a trapezoidal profile that stops at `target`.
fn trapezoid(p: &mut f64, v: &mut f64, target: f64, up: f64, down: f64, acceleration: f64, dt_s: f64) {
    let missing = target - *p;
    // The fastest speed from which the profile can still stop, this tick's travel included.
    let lost = acceleration * dt_s;
    let stopping = (lost * lost + 2.0 * acceleration * missing.abs()).sqrt() - lost;
    let wanted = if missing >= 0.0 { stopping.min(up) } else { -stopping.min(down) };
    *v = towards(*v, wanted, lost);
    let step = *v * dt_s;
    let arrives = missing == 0.0 || (step / missing >= 1.0 - 1e-9) || missing.abs() < 1e-6;
    if arrives && v.abs() <= 2.0 * lost {
        *p = target;
        *v = 0.0;
    } else {
        *p += step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(z: f64) -> Setpoint {
        Setpoint { position_enu_m: Vector3::new(0.0, 0.0, z), ..Setpoint::default() }
    }

    #[test]
    fn altitude_arrives_without_overshoot_within_its_limits_at_every_rate() {
        let limits = Limits::default();
        for dt in [0.001, 0.005, 0.02] {
            for (from, to) in [(0.0, 1.0), (1.0, 0.2), (0.5, 0.51)] {
                let mut profile = Profile::default();
                profile.restart(target(from));
                let (mut last_v, mut t) = (0.0, 0.0);
                while profile.setpoint().position_enu_m.z != to {
                    let s = profile.step(&target(to), &limits, dt);
                    let (z, v) = (s.position_enu_m.z, s.velocity_enu_mps.z);
                    assert!(v <= limits.climb_max_mps + 1e-12 && v >= -limits.descent_max_mps - 1e-12);
                    assert!((v - last_v).abs() <= VERTICAL_ACCELERATION_MPS2 * dt * 2.1 + 1e-6, "jump {last_v} to {v}");
                    assert!((z - from) * (z - to) <= 1e-9, "overshoots: {z} beyond {to}");
                    last_v = v;
                    t += dt;
                    assert!(t < 10.0, "never arrives at {to}: {z} moving at {v}");
                }
                assert_eq!(profile.setpoint().velocity_enu_mps.z, 0.0);
            }
        }
    }

    #[test]
    fn yaw_takes_the_short_way() {
        let mut profile = Profile::default();
        let mut from = target(0.0);
        from.roll_pitch_yaw_rad.z = 3.0;
        profile.restart(from);
        let mut to = from;
        to.roll_pitch_yaw_rad.z = -3.0;
        profile.step(&to, &Limits::default(), 0.1);
        assert!((profile.setpoint().roll_pitch_yaw_rad.z - 3.1).abs() < 1e-12);
    }
}

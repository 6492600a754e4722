//! Trim points: hover, straight flight, circles about the vertical (\[Paternain\] VI).
//!
//! In steady flight with yaw rate Ω the velocity seen from the heading frame is constant, so the
//! force that rotors must give is f = m (Ω ẑ × v + g ẑ) + k_d v; its length is the thrust and its
//! direction is body z, which fixes roll and pitch. Body rates are Ω ẑ seen from the body; the
//! torque is ω × I ω.

use nalgebra::Vector3;

use super::airframe::Airframe;
use crate::frames::from_roll_pitch_yaw;
use crate::types::GRAVITY_MPS2;

/// One steady flight; heading zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trim {
    /// Velocity, m/s, in the frame of the heading.
    pub velocity_enu_mps: Vector3<f64>,
    /// Attitude, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Body rates FLU, rad/s.
    pub body_rates_radps: Vector3<f64>,
    /// Thrust along body z, N.
    pub thrust_n: f64,
    /// Torque FLU, N m.
    pub torque_flu_nm: Vector3<f64>,
}

impl Trim {
    /// At rest.
    pub fn hover(airframe: &Airframe) -> Self {
        Self::steady(airframe, Vector3::zeros(), 0.0)
    }

    /// Straight flight at `velocity_enu_mps`.
    pub fn straight(airframe: &Airframe, velocity_enu_mps: Vector3<f64>) -> Self {
        Self::steady(airframe, velocity_enu_mps, 0.0)
    }

    /// A circle of `radius_m` at `speed_mps`, nose along the path, counter-clockwise.
    pub fn circle(airframe: &Airframe, radius_m: f64, speed_mps: f64) -> Self {
        Self::steady(airframe, Vector3::new(speed_mps, 0.0, 0.0), speed_mps / radius_m)
    }

    /// Steady flight at a velocity that is constant in the heading frame, with a yaw rate.
    pub fn steady(airframe: &Airframe, velocity_mps: Vector3<f64>, yaw_rate_radps: f64) -> Self {
        let yaw_rate = Vector3::new(0.0, 0.0, yaw_rate_radps);
        let gravity = Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        let force =
            (yaw_rate.cross(&velocity_mps) + gravity) * airframe.mass_kg + velocity_mps * airframe.linear_drag_nspm;
        let thrust_n = force.norm();
        // With yaw zero, body z is (cos roll sin pitch, −sin roll, cos roll cos pitch).
        let roll = (-force.y / thrust_n).asin();
        let pitch = force.x.atan2(force.z);
        let roll_pitch_yaw_rad = Vector3::new(roll, pitch, 0.0);
        let body_rates_radps = from_roll_pitch_yaw(&roll_pitch_yaw_rad).inverse() * yaw_rate;
        let momentum = airframe.inertia_kgm2.component_mul(&body_rates_radps);
        Self {
            velocity_enu_mps: velocity_mps,
            roll_pitch_yaw_rad,
            body_rates_radps,
            thrust_n,
            torque_flu_nm: body_rates_radps.cross(&momentum),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::integrate::rk4;
    use crate::model::rigid_body::{Input, State, derivative};
    use crate::types::Wrench;

    #[test]
    fn a_trimmed_circle_closes() {
        let airframe = Airframe::iris();
        let (radius, speed) = (2.0, 1.5);
        let trim = Trim::circle(&airframe, radius, speed);
        let mut state = State::at_rest(Vector3::new(0.0, -radius, 1.0));
        state.velocity_enu_mps = trim.velocity_enu_mps;
        state.world_from_body = *from_roll_pitch_yaw(&trim.roll_pitch_yaw_rad);
        state.body_rates_radps = trim.body_rates_radps;
        let rotors = Wrench { thrust_n: trim.thrust_n, torque_flu_nm: trim.torque_flu_nm };
        let input = Input { rotors, ..Input::default() };
        let period = std::f64::consts::TAU * radius / speed;
        let start = state;
        let steps = 4000;
        let mut widest = 0.0_f64;
        for _ in 0..steps {
            state = rk4(&state, period / f64::from(steps), |x| derivative(&airframe, x, &input)).normalised();
            widest = widest.max((state.position_enu_m.xy().norm() - radius).abs());
        }
        assert!(widest < 1e-6, "left the circle by {widest} m");
        assert!((state.position_enu_m - start.position_enu_m).norm() < 1e-6);
    }
}

//! Heading from a magnetometer, given the attitude: the angle between the levelled field and magnetic
//! north, as a measurement of yaw.

use nalgebra::Vector3;

use super::measure::{Kinematics, Row};
use crate::frames::wrap_pi;

/// A heading row and what it needs beside it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading {
    /// The full row.
    pub row: Row,
    /// Horizontal part of the field, µT: the angle's noise is the field's noise divided by it.
    pub horizontal_ut: f64,
}

/// Row of the field `mag_body_ut` where magnetic north lies `declination_rad` east of north.
///
/// With R = exp(δφ×)R̂, the levelled field is m̂ ≈ m − δφ × m, and its angle about the vertical gives
/// H = [−m_z m̄_x/h, −m_z m̄_y/h, 1] with m̄ the unit horizontal direction and h its length.
/// `None` when the field is (nearly) vertical.
pub fn heading(state: &Kinematics, mag_body_ut: &Vector3<f64>, declination_rad: f64) -> Option<Heading> {
    let m = state.world_from_body * mag_body_ut;
    let h = m.x.hypot(m.y);
    // Dips steeper than 84° leave no usable direction.
    if h.is_nan() || h <= 0.1 * m.norm() {
        return None;
    }
    let reference = std::f64::consts::FRAC_PI_2 - declination_rad;
    let innovation = wrap_pi(reference - m.y.atan2(m.x));
    let row = Row::new(innovation).attitude(Vector3::new(-m.z * m.x / (h * h), -m.z * m.y / (h * h), 1.0));
    Some(Heading { row, horizontal_ut: h })
}

#[cfg(test)]
mod tests {
    use super::super::measure::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        let mag = Vector3::new(12.0, 18.0, -35.0);
        check::jacobian(&check::state(), |s| heading(s, &mag, 0.1).unwrap().row, 1e-7);
    }

    #[test]
    fn facing_magnetic_north_has_no_innovation() {
        let mut state = check::state();
        let declination = 0.2;
        let field = Vector3::new(f64::sin(declination) * 20.0, f64::cos(declination) * 20.0, -40.0);
        let mag = state.world_from_body.inverse() * field;
        assert!(heading(&state, &mag, declination).unwrap().row.innovation.abs() < 1e-12);
        // An estimate 0.1 rad too far left asks for −0.1 rad.
        state.world_from_body = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::z() * 0.1) * state.world_from_body;
        assert!((heading(&state, &mag, declination).unwrap().row.innovation + 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_vertical_field_is_refused() {
        let state = Kinematics { world_from_body: nalgebra::UnitQuaternion::identity(), ..check::state() };
        assert!(heading(&state, &Vector3::new(0.1, 0.0, -45.0), 0.0).is_none());
        assert!(heading(&state, &Vector3::zeros(), 0.0).is_none());
    }
}

//! Attitude straight from the accelerometer and magnetometer (\[Paternain\] IV-A), and what gravity says of
//! the tilt.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | a | specific force in the body frame FLU, +g up at rest | m/s² |
//! | m | magnetic field in the body frame | µT |
//! | D | magnetic declination, east of north positive | rad |

use nalgebra::{UnitQuaternion, Vector3};

use crate::frames::{from_roll_pitch_yaw, wrap_pi};

/// Standard gravity used throughout, m/s².
pub const GRAVITY_MPS2: f64 = 9.81;

/// Roll and pitch (rad) from the specific force, exact when the vehicle does not accelerate.
///
/// \[Paternain\] IV with errata 5: roll = +atan2(a_y, a_z); pitch = −arcsin(a_x/|a|), written with atan2 so
/// that it needs no norm and no clamp.
pub fn tilt(specific_force_mps2: &Vector3<f64>) -> (f64, f64) {
    let a = specific_force_mps2;
    (a.y.atan2(a.z), (-a.x).atan2(a.y.hypot(a.z)))
}

/// Yaw (rad, ENU) from the field in the body frame, given roll and pitch.
///
/// The field is levelled by M = Ry(pitch) Rx(roll) (\[Paternain\] IV); its horizontal part points to
/// magnetic north, D east of true north, which is yaw π/2 − D. Deviation from \[Paternain\], errata 6:
/// atan2 instead of arctan, and ENU instead of north-west-up.
/// `None` when the field is vertical or not finite.
pub fn heading(mag_body_ut: &Vector3<f64>, roll_rad: f64, pitch_rad: f64, declination_rad: f64) -> Option<f64> {
    let level_from_body = from_roll_pitch_yaw(&Vector3::new(roll_rad, pitch_rad, 0.0));
    let m = level_from_body * mag_body_ut;
    let horizontal = m.x.hypot(m.y);
    (horizontal.is_finite() && horizontal > 1e-3 * m.norm().max(1e-9))
        .then(|| wrap_pi(std::f64::consts::FRAC_PI_2 - declination_rad - m.y.atan2(m.x)))
}

/// Attitude from gravity and, where it says something, the magnetic field; yaw zero without it.
pub fn from_gravity_and_field(
    specific_force_mps2: &Vector3<f64>,
    mag_body_ut: Option<&Vector3<f64>>,
    declination_rad: f64,
) -> UnitQuaternion<f64> {
    let (roll, pitch) = tilt(specific_force_mps2);
    let yaw = mag_body_ut.and_then(|m| heading(m, roll, pitch, declination_rad)).unwrap_or(0.0);
    from_roll_pitch_yaw(&Vector3::new(roll, pitch, yaw))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::roll_pitch_yaw;

    #[test]
    fn attitude_is_recovered_from_gravity_and_field() {
        // GIVEN random attitudes and a field dipping 65° with 7° declination, WHEN solved, THEN exact.
        let declination = 7f64.to_radians();
        let field_enu =
            50.0 * Vector3::new(declination.sin() * 0.42, declination.cos() * 0.42, -(1.0 - 0.42f64.powi(2)).sqrt());
        for i in 0..200 {
            let t = f64::from(i);
            let q = from_roll_pitch_yaw(&Vector3::new(
                (t * 0.7).sin() * 3.0,
                (t * 1.3).cos() * 1.5,
                (t * 0.37).sin() * 3.1,
            ));
            let a = q.inverse() * Vector3::new(0.0, 0.0, GRAVITY_MPS2);
            let m = q.inverse() * field_enu;
            let found = from_gravity_and_field(&a, Some(&m), declination);
            assert!(found.angle_to(&q) < 1e-6, "{} vs {}", roll_pitch_yaw(&found), roll_pitch_yaw(&q));
        }
    }

    #[test]
    fn a_vertical_field_gives_no_heading() {
        assert!(heading(&Vector3::new(0.0, 0.0, -50.0), 0.0, 0.0, 0.0).is_none());
        assert!(heading(&Vector3::new(f64::NAN, 0.0, -50.0), 0.0, 0.0, 0.0).is_none());
    }
}

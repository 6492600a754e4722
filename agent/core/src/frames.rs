//! Frames, and every conversion between them.
//!
//! Inside the project the world is ENU (x east, y north, z up) and the body is FLU (x forward, y left,
//! z up). NED (north, east, down) and FRD (forward, right, down) exist here and in the drivers that
//! speak them, nowhere else.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | roll φ | rotation about body x | rad |
//! | pitch θ | rotation about body y; positive pitches the nose **down** (FLU) | rad |
//! | yaw ψ | rotation about world z; 0 faces east, π/2 faces north | rad |
//! | heading | compass heading, clockwise from north | rad |
//!
//! world_from_body = Rz(ψ) Ry(θ) Rx(φ): "ZYX" of all four sources, whatever they call it
//! (\[Umasankar\] says 123; errata 1).

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// A vector in the world frame east, north, up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Enu(pub Vector3<f64>);

/// A vector in the world frame north, east, down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ned(pub Vector3<f64>);

/// A vector in the body frame forward, left, up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Flu(pub Vector3<f64>);

/// A vector in the body frame forward, right, down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Frd(pub Vector3<f64>);

impl From<Ned> for Enu {
    fn from(Ned(v): Ned) -> Self {
        Self(Vector3::new(v.y, v.x, -v.z))
    }
}

impl From<Enu> for Ned {
    fn from(Enu(v): Enu) -> Self {
        Self(Vector3::new(v.y, v.x, -v.z))
    }
}

impl From<Frd> for Flu {
    fn from(Frd(v): Frd) -> Self {
        Self(Vector3::new(v.x, -v.y, -v.z))
    }
}

impl From<Flu> for Frd {
    fn from(Flu(v): Flu) -> Self {
        Self(Vector3::new(v.x, -v.y, -v.z))
    }
}

/// ENU ← NED (and NED ← ENU, it is its own inverse): half a turn about (1, 1, 0)/√2.
fn enu_from_ned() -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0))
}

/// FLU ← FRD (and back): half a turn about x.
fn flu_from_frd() -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0))
}

/// The attitude ENU ← FLU of a vehicle whose autopilot says NED ← FRD.
pub fn enu_from_flu(ned_from_frd: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    enu_from_ned() * ned_from_frd * flu_from_frd()
}

/// The attitude NED ← FRD of a vehicle whose attitude here is ENU ← FLU.
pub fn ned_from_frd(enu_from_flu: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    enu_from_ned() * enu_from_flu * flu_from_frd()
}

/// Roll, pitch, yaw (rad) of `world_from_body`. Pitch is in [−π/2, π/2]; at ±π/2 roll is zero.
pub fn roll_pitch_yaw(world_from_body: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = world_from_body.quaternion();
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    let sin_pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0);
    if sin_pitch.abs() > 1.0 - 1e-12 {
        // Roll and yaw turn about the same axis: give it all to yaw. Here w² + z² = ½, never 0.
        return Vector3::new(0.0, FRAC_PI_2.copysign(sin_pitch), wrap_pi(2.0 * z.atan2(w)));
    }
    Vector3::new(
        (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)),
        sin_pitch.asin(),
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)),
    )
}

/// The attitude of roll, pitch, yaw (rad): Rz(ψ) Ry(θ) Rx(φ).
pub fn from_roll_pitch_yaw(roll_pitch_yaw_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(roll_pitch_yaw_rad.x, roll_pitch_yaw_rad.y, roll_pitch_yaw_rad.z)
}

/// Angle between body z and the world's vertical, rad, 0..π.
pub fn tilt_rad(world_from_body: &UnitQuaternion<f64>) -> f64 {
    let q = world_from_body.quaternion();
    (1.0 - 2.0 * (q.i * q.i + q.j * q.j)).clamp(-1.0, 1.0).acos()
}

/// The same angle in (−π, π]; NaN stays NaN.
pub fn wrap_pi(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Compass heading (clockwise from north, 0..2π) of an ENU yaw.
pub fn heading_from_yaw(yaw_rad: f64) -> f64 {
    (FRAC_PI_2 - yaw_rad).rem_euclid(TAU)
}

/// ENU yaw in (−π, π] of a compass heading.
pub fn yaw_from_heading(heading_rad: f64) -> f64 {
    wrap_pi(FRAC_PI_2 - heading_rad)
}

/// The matrix of the cross product: skew(a) b = a × b.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ned_north_is_enu_y_and_frd_right_is_minus_flu_y() {
        assert_eq!(Enu::from(Ned(Vector3::new(1.0, 2.0, 3.0))), Enu(Vector3::new(2.0, 1.0, -3.0)));
        assert_eq!(Flu::from(Frd(Vector3::new(1.0, 2.0, 3.0))), Flu(Vector3::new(1.0, -2.0, -3.0)));
        let v = Vector3::new(0.3, -0.7, 0.1);
        assert_eq!(Enu::from(Ned::from(Enu(v))), Enu(v));
        assert_eq!(Flu::from(Frd::from(Flu(v))), Flu(v));
    }

    #[test]
    fn attitudes_convert_as_vectors_do() {
        // GIVEN a NED/FRD attitude and a body vector, WHEN either path is taken to ENU, THEN they agree.
        let ned_from_frd_attitude = UnitQuaternion::from_euler_angles(0.3, -0.2, 2.1);
        let frd = Vector3::new(0.4, 1.2, -0.5);
        let by_vectors = Enu::from(Ned(ned_from_frd_attitude * frd)).0;
        let by_attitude = enu_from_flu(ned_from_frd_attitude) * Flu::from(Frd(frd)).0;
        assert!((by_vectors - by_attitude).norm() < 1e-14);
        assert!(ned_from_frd(enu_from_flu(ned_from_frd_attitude)).angle_to(&ned_from_frd_attitude) < 1e-7);
        // Facing north in NED (yaw 0) is yaw π/2 in ENU.
        let north = enu_from_flu(UnitQuaternion::identity());
        assert!((roll_pitch_yaw(&north).z - FRAC_PI_2).abs() < 1e-12);
        assert!(tilt_rad(&north) < 1e-7);
    }

    #[test]
    fn euler_angles_round_trip_and_agree_with_the_matrix() {
        for (roll, pitch, yaw) in [(0.1, 0.2, 0.3), (-3.0, 1.5, -3.1), (1.7, -1.2, 2.0), (0.0, 0.0, PI)] {
            let q = from_roll_pitch_yaw(&Vector3::new(roll, pitch, yaw));
            let r = q.to_rotation_matrix();
            let (sr, cr, sp, cp, sy, cy) =
                (f64::sin(roll), f64::cos(roll), f64::sin(pitch), f64::cos(pitch), f64::sin(yaw), f64::cos(yaw));
            // [Umasankar] Eq. 3 with errata 1: Rz(ψ) Ry(θ) Rx(φ).
            let expected = Matrix3::new(
                cy * cp,
                cy * sp * sr - sy * cr,
                cy * sp * cr + sy * sr,
                sy * cp,
                sy * sp * sr + cy * cr,
                sy * sp * cr - cy * sr,
                -sp,
                cp * sr,
                cp * cr,
            );
            assert!((r.matrix() - expected).norm() < 1e-12);
            let back = roll_pitch_yaw(&q);
            for (a, b) in back.iter().zip([roll, pitch, yaw]) {
                assert!(wrap_pi(a - b).abs() < 1e-9, "{back} for {roll} {pitch} {yaw}");
            }
        }
    }

    #[test]
    fn gimbal_lock_keeps_the_attitude() {
        for pitch in [FRAC_PI_2, -FRAC_PI_2] {
            for yaw in [-3.0, -1.0, 0.0, 0.5, 2.0, 3.1] {
                for roll in [0.0, 0.7, -2.0] {
                    let q = from_roll_pitch_yaw(&Vector3::new(roll, pitch, yaw));
                    let again = from_roll_pitch_yaw(&roll_pitch_yaw(&q));
                    assert!(again.angle_to(&q) < 1e-5, "roll {roll} pitch {pitch} yaw {yaw}: {}", again.angle_to(&q));
                }
            }
        }
    }

    #[test]
    fn angles_wrap() {
        assert_eq!(wrap_pi(PI), PI);
        assert!((wrap_pi(-PI) - PI).abs() < 1e-15);
        assert!((wrap_pi(7.0) - (7.0 - TAU)).abs() < 1e-15);
        assert!(wrap_pi(f64::NAN).is_nan());
        assert!((heading_from_yaw(0.0) - FRAC_PI_2).abs() < 1e-15);
        assert!((yaw_from_heading(heading_from_yaw(-2.5)) + 2.5).abs() < 1e-12);
    }

    #[test]
    fn skew_is_the_cross_product() {
        let (a, b) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.2, 0.9, -3.0));
        assert!((skew(&a) * b - a.cross(&b)).norm() < 1e-15);
    }
}

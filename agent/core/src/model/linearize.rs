//! ẋ ≈ A x + B u about a trim point of the corrected rigid body (\[Paternain\] VI, Eq. 3).
//!
//! State, in this order ([`ix`]): x y z vx vy vz (ENU, m, m/s), roll pitch yaw (rad), p q r (body
//! rates, rad/s). Input: thrust minus the trim thrust (N), torque about body x y z (N m). All are
//! deviations from the trim point. The rotors' angular momentum is left out: it vanishes at hover.
//!
//! Analytic; the tests compare with finite differences of `rigid_body::derivative`.

use nalgebra::{SMatrix, Vector3};

use super::airframe::Airframe;
use super::trim::Trim;

/// Indices of the state.
pub mod ix {
    /// East, m.
    pub const X: usize = 0;
    /// North, m.
    pub const Y: usize = 1;
    /// Up, m.
    pub const Z: usize = 2;
    /// m/s.
    pub const VX: usize = 3;
    /// m/s.
    pub const VY: usize = 4;
    /// m/s.
    pub const VZ: usize = 5;
    /// rad.
    pub const ROLL: usize = 6;
    /// rad.
    pub const PITCH: usize = 7;
    /// rad.
    pub const YAW: usize = 8;
    /// Body rate about x, rad/s.
    pub const P: usize = 9;
    /// Body rate about y, rad/s.
    pub const Q: usize = 10;
    /// Body rate about z, rad/s.
    pub const R: usize = 11;
    /// Indices of the input.
    pub const THRUST: usize = 0;
    /// Torque about body x.
    pub const TORQUE_X: usize = 1;
    /// Torque about body y.
    pub const TORQUE_Y: usize = 2;
    /// Torque about body z.
    pub const TORQUE_Z: usize = 3;
}

/// A and B.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// ∂ẋ/∂x.
    pub a: SMatrix<f64, 12, 12>,
    /// ∂ẋ/∂u.
    pub b: SMatrix<f64, 12, 4>,
}

/// A and B at hover with yaw zero: the heading frame.
pub fn hover(airframe: &Airframe) -> Linear {
    linearize(airframe, &Trim::hover(airframe))
}

/// A and B at `trim`, in the world frame at the instant when its heading is `trim.roll_pitch_yaw_rad.z`.
pub fn linearize(airframe: &Airframe, trim: &Trim) -> Linear {
    let (m, kd, i) = (airframe.mass_kg, airframe.linear_drag_nspm, airframe.inertia_kgm2);
    let angles = trim.roll_pitch_yaw_rad;
    let (sr, cr) = angles.x.sin_cos();
    let (sp, cp) = angles.y.sin_cos();
    let (sy, cy) = angles.z.sin_cos();
    let w = trim.body_rates_radps;
    let t = trim.thrust_n / m;
    let mut a = SMatrix::<f64, 12, 12>::zeros();
    for k in 0..3 {
        a[(ix::X + k, ix::VX + k)] = 1.0;
        a[(ix::VX + k, ix::VX + k)] = -kd / m;
    }
    // v̇ = T/m R ẑ + …, R ẑ = (cr sp cy + sr sy, cr sp sy − sr cy, cr cp).
    let by_roll = Vector3::new(-sr * sp * cy + cr * sy, -sr * sp * sy - cr * cy, -sr * cp);
    let by_pitch = Vector3::new(cr * cp * cy, cr * cp * sy, -cr * sp);
    let by_yaw = Vector3::new(-cr * sp * sy + sr * cy, cr * sp * cy + sr * sy, 0.0);
    for (column, slope) in [(ix::ROLL, by_roll), (ix::PITCH, by_pitch), (ix::YAW, by_yaw)] {
        a.fixed_view_mut::<3, 1>(ix::VX, column).copy_from(&(slope * t));
    }
    // Euler rates: roll' = p + tan(pitch)(sr q + cr r), pitch' = cr q − sr r, yaw' = (sr q + cr r)/cp.
    let (along, across) = (sr * w.y + cr * w.z, cr * w.y - sr * w.z);
    let tp = sp / cp;
    a[(ix::ROLL, ix::ROLL)] = tp * across;
    a[(ix::ROLL, ix::PITCH)] = along / (cp * cp);
    a[(ix::PITCH, ix::ROLL)] = -along;
    a[(ix::YAW, ix::ROLL)] = across / cp;
    a[(ix::YAW, ix::PITCH)] = along * sp / (cp * cp);
    a[(ix::ROLL, ix::P)] = 1.0;
    a[(ix::ROLL, ix::Q)] = tp * sr;
    a[(ix::ROLL, ix::R)] = tp * cr;
    a[(ix::PITCH, ix::Q)] = cr;
    a[(ix::PITCH, ix::R)] = -sr;
    a[(ix::YAW, ix::Q)] = sr / cp;
    a[(ix::YAW, ix::R)] = cr / cp;
    // I ω̇ = τ − ω × I ω.
    a[(ix::P, ix::Q)] = (i.y - i.z) * w.z / i.x;
    a[(ix::P, ix::R)] = (i.y - i.z) * w.y / i.x;
    a[(ix::Q, ix::P)] = (i.z - i.x) * w.z / i.y;
    a[(ix::Q, ix::R)] = (i.z - i.x) * w.x / i.y;
    a[(ix::R, ix::P)] = (i.x - i.y) * w.y / i.z;
    a[(ix::R, ix::Q)] = (i.x - i.y) * w.x / i.z;
    let mut b = SMatrix::<f64, 12, 4>::zeros();
    let up = Vector3::new(cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp);
    b.fixed_view_mut::<3, 1>(ix::VX, ix::THRUST).copy_from(&(up / m));
    for k in 0..3 {
        b[(ix::P + k, ix::TORQUE_X + k)] = 1.0 / i[k];
    }
    Linear { a, b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::from_roll_pitch_yaw;
    use crate::model::rigid_body::{Input, State, derivative};
    use crate::types::Wrench;
    use nalgebra::SVector;

    /// ẋ in the coordinates of this module, from the quaternion model.
    fn f(airframe: &Airframe, x: &SVector<f64, 12>, thrust_n: f64, torque: Vector3<f64>) -> SVector<f64, 12> {
        let part = |i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
        let angles = part(ix::ROLL);
        let state = State {
            position_enu_m: part(ix::X),
            velocity_enu_mps: part(ix::VX),
            world_from_body: *from_roll_pitch_yaw(&angles),
            body_rates_radps: part(ix::P),
        };
        let input = Input { rotors: Wrench { thrust_n, torque_flu_nm: torque }, ..Input::default() };
        let d = derivative(airframe, &state, &input);
        // Euler rates from the quaternion rate, by a short step along it.
        let h = 1e-6;
        let at = |s: f64| {
            let q = nalgebra::UnitQuaternion::new_normalize(state.world_from_body + d.world_from_body * s);
            crate::frames::roll_pitch_yaw(&q)
        };
        let euler_rate = (at(h) - at(-h)) / (2.0 * h);
        let mut out = SVector::<f64, 12>::zeros();
        for (at, v) in [
            (ix::X, d.position_enu_m),
            (ix::VX, d.velocity_enu_mps),
            (ix::ROLL, euler_rate),
            (ix::P, d.body_rates_radps),
        ] {
            out.fixed_view_mut::<3, 1>(at, 0).copy_from(&v);
        }
        out
    }

    #[test]
    fn analytic_jacobians_match_finite_differences_at_every_kind_of_trim() {
        let mut airframe = Airframe::iris();
        airframe.inertia_kgm2 = Vector3::new(0.02, 0.03, 0.045);
        let trims = [
            Trim::hover(&airframe),
            Trim::straight(&airframe, Vector3::new(3.0, -1.0, 0.5)),
            Trim::circle(&airframe, 2.0, 1.5),
        ];
        for trim in &trims {
            let linear = linearize(&airframe, trim);
            let mut x = SVector::<f64, 12>::zeros();
            for (at, v) in
                [(ix::VX, trim.velocity_enu_mps), (ix::ROLL, trim.roll_pitch_yaw_rad), (ix::P, trim.body_rates_radps)]
            {
                x.fixed_view_mut::<3, 1>(at, 0).copy_from(&v);
            }
            let h = 1e-4;
            for column in 0..12 {
                let mut step = SVector::<f64, 12>::zeros();
                step[column] = h;
                let slope = (f(&airframe, &(x + step), trim.thrust_n, trim.torque_flu_nm)
                    - f(&airframe, &(x - step), trim.thrust_n, trim.torque_flu_nm))
                    / (2.0 * h);
                let error = (slope - linear.a.column(column)).amax();
                assert!(error < 1e-5, "A column {column}: {error:.1e} at {trim:?}");
            }
            for column in 0..4 {
                let mut d = [0.0; 4];
                d[column] = h;
                let at = |s: f64| {
                    let torque = trim.torque_flu_nm + Vector3::new(d[1], d[2], d[3]) * s;
                    f(&airframe, &x, trim.thrust_n + s * d[0], torque)
                };
                let error = ((at(1.0) - at(-1.0)) / (2.0 * h) - linear.b.column(column)).amax();
                assert!(error < 1e-5, "B column {column}: {error:.1e} at {trim:?}");
            }
        }
    }

    #[test]
    fn hover_couples_velocity_to_tilt_with_gravity() {
        let linear = hover(&Airframe::iris());
        assert!((linear.a[(ix::VX, ix::PITCH)] - 9.81).abs() < 1e-12);
        assert!((linear.a[(ix::VY, ix::ROLL)] + 9.81).abs() < 1e-12);
    }
}

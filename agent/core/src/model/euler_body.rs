//! The twelve-state rigid body of \[Umasankar\] Eq. 8 with roll, pitch, yaw as states, its Jacobian and its
//! Runge–Kutta step: what the hybrid EKF and the UKF propagate.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | x | x y z, vx vy vz (world ENU), φ θ ψ (ZYX), p q r (body FLU); places in [`ix`] | m, m/s, rad, rad/s |
//! | u | T, τx, τy, τz: thrust along body z and torques | N, N m |
//! | f | specific force in the body frame: (0, 0, T/m), or what accelerometers measured | m/s² |
//! | I | principal moments of inertia | kg m² |
//!
//! Deviations from \[Umasankar\] Eq. 8 (ERRATA 3, 4): sign of cos ψ sin φ in v̇y; ṙ is its own row. No drag and
//! no rotor inertia, as in the source. Singular at pitch ±90°.

use nalgebra::{SMatrix, SVector, Vector3};

pub use crate::model::linearize::ix;

/// States.
pub const N: usize = 12;
/// State vector.
pub type X = SVector<f64, N>;
/// Input vector.
pub type U = SVector<f64, 4>;
/// Matrix over the states.
pub type M = SMatrix<f64, N, N>;

/// Mass, inertia, gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EulerBody {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Principal moments of inertia, kg m².
    pub inertia_kgm2: Vector3<f64>,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
}

/// What acts on the body, gravity aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Action {
    /// Specific force in the body frame FLU, m/s².
    pub force_mps2: Vector3<f64>,
    /// Torque in the body frame FLU, N m.
    pub torque_nm: Vector3<f64>,
}

/// An input of the model: [`U`] as in the source, or an [`Action`] with a specific force that need not point
/// along body z.
pub trait Input {
    /// What it does to `body`.
    fn action(&self, body: &EulerBody) -> Action;
}

impl Input for U {
    fn action(&self, body: &EulerBody) -> Action {
        Action {
            force_mps2: Vector3::new(0.0, 0.0, self[ix::THRUST] / body.mass_kg),
            torque_nm: Vector3::new(self[ix::TORQUE_X], self[ix::TORQUE_Y], self[ix::TORQUE_Z]),
        }
    }
}

impl Input for Action {
    fn action(&self, _: &EulerBody) -> Action {
        *self
    }
}

impl EulerBody {
    /// The 3DR Iris of \[Umasankar\].
    pub fn iris() -> Self {
        Self { mass_kg: 1.545, inertia_kgm2: Vector3::new(0.029125, 0.029125, 0.055225), gravity_mps2: 9.81 }
    }

    /// ẋ = f(x, u), \[Umasankar\] Eq. 8.
    pub fn derivative(&self, x: &X, u: &impl Input) -> X {
        self.derivative_under(x, &u.action(self))
    }

    fn derivative_under(&self, x: &X, Action { force_mps2: f, torque_nm: t }: &Action) -> X {
        let (sf, cf) = x[ix::ROLL].sin_cos();
        let (st, ct) = x[ix::PITCH].sin_cos();
        let (ss, cs) = x[ix::YAW].sin_cos();
        let (p, q, r) = (x[ix::P], x[ix::Q], x[ix::R]);
        let i = &self.inertia_kgm2;
        let turning = r * cf + q * sf;
        // Ry(θ) Rx(φ) f: the force in the heading frame.
        let across = f.y * cf - f.z * sf;
        let upward = f.y * sf + f.z * cf;
        let ahead = f.x * ct + upward * st;
        X::from([
            x[ix::VX],
            x[ix::VY],
            x[ix::VZ],
            cs * ahead - ss * across,
            // Deviation from [Umasankar] Eq. 8, errata 3: −cos ψ sin φ.
            ss * ahead + cs * across,
            upward * ct - f.x * st - self.gravity_mps2,
            p + turning * st / ct,
            q * cf - r * sf,
            turning / ct,
            (t.x + (i.y - i.z) * q * r) / i.x,
            (t.y + (i.z - i.x) * p * r) / i.y,
            // Deviation from [Umasankar] Eq. 8, errata 4.
            (t.z + (i.x - i.y) * p * q) / i.z,
        ])
    }

    /// A = ∂f/∂x, \[Umasankar\] Eq. 9.
    pub fn jacobian(&self, x: &X, u: &impl Input) -> M {
        let (sf, cf) = x[ix::ROLL].sin_cos();
        let (st, ct) = x[ix::PITCH].sin_cos();
        let (ss, cs) = x[ix::YAW].sin_cos();
        let (p, q, r) = (x[ix::P], x[ix::Q], x[ix::R]);
        let (i, f) = (&self.inertia_kgm2, u.action(self).force_mps2);
        let across = f.y * cf - f.z * sf;
        let upward = f.y * sf + f.z * cf;
        let ahead = f.x * ct + upward * st;
        let tt = st / ct;
        let (turning, turned) = (r * cf + q * sf, q * cf - r * sf);
        let mut a = M::zeros();
        a[(ix::X, ix::VX)] = 1.0;
        a[(ix::Y, ix::VY)] = 1.0;
        a[(ix::Z, ix::VZ)] = 1.0;
        // ∂across/∂φ = −upward, ∂upward/∂φ = across, ∂ahead/∂θ = v̇z + g.
        a[(ix::VX, ix::ROLL)] = cs * across * st + ss * upward;
        a[(ix::VX, ix::PITCH)] = cs * (upward * ct - f.x * st);
        a[(ix::VX, ix::YAW)] = -ss * ahead - cs * across;
        a[(ix::VY, ix::ROLL)] = ss * across * st - cs * upward;
        a[(ix::VY, ix::PITCH)] = ss * (upward * ct - f.x * st);
        a[(ix::VY, ix::YAW)] = cs * ahead - ss * across;
        a[(ix::VZ, ix::ROLL)] = across * ct;
        a[(ix::VZ, ix::PITCH)] = -ahead;
        a[(ix::ROLL, ix::ROLL)] = turned * tt;
        a[(ix::ROLL, ix::PITCH)] = turning / (ct * ct);
        a[(ix::ROLL, ix::P)] = 1.0;
        a[(ix::ROLL, ix::Q)] = sf * tt;
        a[(ix::ROLL, ix::R)] = cf * tt;
        a[(ix::PITCH, ix::ROLL)] = -turning;
        a[(ix::PITCH, ix::Q)] = cf;
        a[(ix::PITCH, ix::R)] = -sf;
        a[(ix::YAW, ix::ROLL)] = turned / ct;
        a[(ix::YAW, ix::PITCH)] = turning * st / (ct * ct);
        a[(ix::YAW, ix::Q)] = sf / ct;
        a[(ix::YAW, ix::R)] = cf / ct;
        a[(ix::P, ix::Q)] = r * (i.y - i.z) / i.x;
        a[(ix::P, ix::R)] = q * (i.y - i.z) / i.x;
        a[(ix::Q, ix::P)] = r * (i.z - i.x) / i.y;
        a[(ix::Q, ix::R)] = p * (i.z - i.x) / i.y;
        a[(ix::R, ix::P)] = q * (i.x - i.y) / i.z;
        a[(ix::R, ix::Q)] = p * (i.x - i.y) / i.z;
        a
    }

    /// One classical Runge–Kutta step of `h` seconds with `u` held.
    pub fn step(&self, x: &X, u: &impl Input, h: f64) -> X {
        let action = u.action(self);
        let k1 = self.derivative_under(x, &action);
        let k2 = self.derivative_under(&(x + k1 * (0.5 * h)), &action);
        let k3 = self.derivative_under(&(x + k2 * (0.5 * h)), &action);
        let k4 = self.derivative_under(&(x + k3 * h), &action);
        x + (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0)
    }

    /// Φ = I + Ah + (Ah)²/2 + (Ah)³/6 with A at the middle of the step.
    pub fn transition(&self, x: &X, next: &X, u: &impl Input, h: f64) -> M {
        let ah = self.jacobian(&((x + next) * 0.5), u) * h;
        let squared = ah * ah;
        M::identity() + ah + squared * 0.5 + squared * ah / 6.0
    }
}

/// Process noise of one step of `h` seconds: white acceleration of density `accel` (m/s²/√Hz) and white
/// angular acceleration of density `turn` (rad/s²/√Hz), each held over the step: Qd = G diag(q²/h) Gᵀ with
/// G = [h²/2; h] on position and velocity, and on angles and rates.
pub fn process_noise(accel: f64, turn: f64, h: f64) -> M {
    let mut q = M::zeros();
    for (first, second, density) in [(ix::X, ix::VX, accel), (ix::ROLL, ix::P, turn)] {
        let variance = density * density / h;
        for axis in 0..3 {
            let (a, b) = (first + axis, second + axis);
            q[(a, a)] = variance * h.powi(4) / 4.0;
            q[(a, b)] = variance * h.powi(3) / 2.0;
            q[(b, a)] = q[(a, b)];
            q[(b, b)] = variance * h * h;
        }
    }
    q
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::from_roll_pitch_yaw;

    fn states() -> impl Iterator<Item = (X, U)> {
        (0..50).map(|k| {
            let x = X::from_fn(|i, _| (f64::from(k) * 1.7 + i as f64 * 0.9).sin());
            (x, U::new(15.0 + (f64::from(k)).cos(), 0.1, -0.2, 0.05))
        })
    }

    #[test]
    fn derivative_is_newton_and_euler_with_rotation_matrices() {
        let body = EulerBody::iris();
        for (x, u) in states() {
            let q = from_roll_pitch_yaw(&Vector3::new(x[6], x[7], x[8]));
            let aside = Action { force_mps2: Vector3::new(1.0, -2.0, 9.0), ..u.action(&body) };
            let pushed = body.derivative(&x, &aside).fixed_rows::<3>(ix::VX).into_owned();
            assert!((pushed - (q * aside.force_mps2 - Vector3::new(0.0, 0.0, 9.81))).norm() < 1e-12);
            let f = body.derivative(&x, &u);
            let v = q * Vector3::new(0.0, 0.0, u[0] / body.mass_kg) - Vector3::new(0.0, 0.0, 9.81);
            assert!((Vector3::new(f[3], f[4], f[5]) - v).norm() < 1e-12);
            let w = Vector3::new(x[9], x[10], x[11]);
            let i = body.inertia_kgm2;
            let wd = (Vector3::new(u[1], u[2], u[3]) - w.cross(&i.component_mul(&w))).component_div(&i);
            assert!((Vector3::new(f[9], f[10], f[11]) - wd).norm() < 1e-12);
            // The angles move as the quaternion does.
            let h = 1e-6;
            let moved = q * nalgebra::UnitQuaternion::from_scaled_axis(w * h);
            let rates = Vector3::new(f[6], f[7], f[8]) * h + Vector3::new(x[6], x[7], x[8]);
            assert!(from_roll_pitch_yaw(&rates).angle_to(&moved) < 1e-9);
        }
    }

    #[test]
    fn jacobian_matches_finite_differences() {
        let body = EulerBody { inertia_kgm2: Vector3::new(0.01, 0.013, 0.02), ..EulerBody::iris() };
        for (x, u) in states() {
            // Also with a force that does not point along body z.
            let mut action = u.action(&body);
            action.force_mps2 += Vector3::new(3.0 * x[0], -2.0, 0.0);
            let a = body.jacobian(&x, &action);
            for j in 0..N {
                let mut e = X::zeros();
                e[j] = 1e-6;
                let numeric = (body.derivative(&(x + e), &action) - body.derivative(&(x - e), &action)) / 2e-6;
                assert!((a.column(j) - numeric).amax() < 1e-6, "column {j}");
            }
        }
    }

    #[test]
    fn hover_stays() {
        let body = EulerBody::iris();
        let x = X::from([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0]);
        let u = U::new(body.mass_kg * body.gravity_mps2, 0.0, 0.0, 0.0);
        assert!((body.step(&x, &u, 0.1) - x).norm() < 1e-12);
    }
}

//! The corrected nonlinear rigid body of \[Paternain\] Eq. 2, in quaternion form: ẋ = f(x, u).
//!
//! | symbol | meaning | unit, frame |
//! |---|---|---|
//! | p, v | position and velocity of the centre of mass | m, m/s, ENU |
//! | q | attitude, world from body | unit quaternion |
//! | ω | body rates | rad/s, FLU |
//! | T, τ | rotor thrust along body z, rotor torque | N, N m |
//! | h | angular momentum of the rotors, I_zzm Σ sᵢ ωᵢ, along body z | N m s |
//!
//! ṗ = v, v̇ = −g ẑ + (R T ẑ − k_d (v − wind) + F) / m, q̇ = ½ q ⊗ (0, ω),
//! I ω̇ = τ + τ_ext − ω × (I ω + h ẑ) − ḣ ẑ.
//!
//! Deviations from \[Paternain\] Eq. 2 (ERRATA): attitude by quaternion, so that no row carries the faulty
//! product of item 1; the rotor term has opposite signs in ω̇x and ω̇y (2); (Ixx − Iyy) ωx ωy and the rotor
//! acceleration stand in ω̇z (3); no gravity moment −dMg in free flight, a pivot rig adds its own (4).
//! Drag is \[Clinic\] Eq. 2, divided by m as its appendix forgets. Assumes principal body axes and a rigid frame.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::model::airframe::Airframe;
use crate::model::integrate::Integrable;
use crate::types::{GRAVITY_MPS2, ROTORS, Wrench};

/// State of the body. The quaternion is free to leave the unit sphere inside an integration step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Centre of mass, ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Its velocity, ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Attitude; see [`State::normalised`].
    pub world_from_body: Quaternion<f64>,
    /// Body rates, FLU, rad/s.
    pub body_rates_radps: Vector3<f64>,
}

/// Time derivative of [`State`], field by field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Derivative {
    /// m/s.
    pub position_enu_m: Vector3<f64>,
    /// m/s².
    pub velocity_enu_mps: Vector3<f64>,
    /// 1/s.
    pub world_from_body: Quaternion<f64>,
    /// rad/s².
    pub body_rates_radps: Vector3<f64>,
}

/// What acts on the body.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Input {
    /// Thrust and torque of the rotors.
    pub rotors: Wrench,
    /// h = I_zzm Σ sᵢ ωᵢ, N m s, along body z.
    pub rotor_momentum_nms: f64,
    /// ḣ = I_zzm Σ sᵢ ω̇ᵢ, N m.
    pub rotor_momentum_rate_nm: f64,
    /// Every other force but gravity and drag, ENU, N.
    pub force_enu_n: Vector3<f64>,
    /// Every other torque about the centre of mass, FLU, N m.
    pub torque_flu_nm: Vector3<f64>,
    /// Velocity of the air, ENU, m/s.
    pub wind_enu_mps: Vector3<f64>,
}

impl Input {
    /// The input of rotors at `speed_radps`, accelerating at `acceleration_radps2`; nothing else acts.
    pub fn from_rotors(airframe: &Airframe, speed_radps: &[f64; ROTORS], acceleration_radps2: &[f64; ROTORS]) -> Self {
        let sum = |values: &[f64; ROTORS]| {
            let signed = airframe.rotors.iter().zip(values).map(|(rotor, v)| rotor.spin.sign() * v);
            airframe.rotor_inertia_kgm2 * signed.sum::<f64>()
        };
        Self {
            rotors: airframe.wrench(speed_radps),
            rotor_momentum_nms: sum(speed_radps),
            rotor_momentum_rate_nm: sum(acceleration_radps2),
            ..Self::default()
        }
    }
}

impl State {
    /// At rest and level, yaw zero, at `position_enu_m`.
    pub fn at_rest(position_enu_m: Vector3<f64>) -> Self {
        Self {
            position_enu_m,
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: Quaternion::identity(),
            body_rates_radps: Vector3::zeros(),
        }
    }

    /// Attitude as a unit quaternion.
    pub fn attitude(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::new_normalize(self.world_from_body)
    }

    /// The same with its quaternion back on the unit sphere; call after each integration step.
    pub fn normalised(mut self) -> Self {
        self.world_from_body = *self.attitude();
        self
    }

    /// Are all numbers finite?
    pub fn is_finite(&self) -> bool {
        self.position_enu_m.iter().all(|v| v.is_finite())
            && self.velocity_enu_mps.iter().all(|v| v.is_finite())
            && self.world_from_body.coords.iter().all(|v| v.is_finite())
            && self.body_rates_radps.iter().all(|v| v.is_finite())
    }
}

impl Integrable for State {
    type Derivative = Derivative;
    fn moved(&self, d: &Derivative, h: f64) -> Self {
        Self {
            position_enu_m: self.position_enu_m + d.position_enu_m * h,
            velocity_enu_mps: self.velocity_enu_mps + d.velocity_enu_mps * h,
            world_from_body: self.world_from_body + d.world_from_body * h,
            body_rates_radps: self.body_rates_radps + d.body_rates_radps * h,
        }
    }
}

/// Turns the body vector `v` into the world; `q` is nearly of unit length.
pub fn rotate(q: &Quaternion<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let u = q.vector();
    let t = 2.0 * u.cross(v);
    v + q.scalar() * t + u.cross(&t)
}

/// q̇ = ½ q ⊗ (0, ω).
pub fn quaternion_rate(q: &Quaternion<f64>, body_rates_radps: &Vector3<f64>) -> Quaternion<f64> {
    q * Quaternion::from_imag(*body_rates_radps * 0.5)
}

/// ẋ = f(x, u). Pure.
pub fn derivative(airframe: &Airframe, x: &State, u: &Input) -> Derivative {
    let thrust_enu = rotate(&x.world_from_body, &Vector3::new(0.0, 0.0, u.rotors.thrust_n));
    // [Clinic] Eq. 2
    let drag_enu = (u.wind_enu_mps - x.velocity_enu_mps) * airframe.linear_drag_nspm;
    let gravity_enu = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
    Derivative {
        position_enu_m: x.velocity_enu_mps,
        velocity_enu_mps: gravity_enu + (thrust_enu + drag_enu + u.force_enu_n) / airframe.mass_kg,
        world_from_body: quaternion_rate(&x.world_from_body, &x.body_rates_radps),
        body_rates_radps: angular_acceleration(airframe, &x.body_rates_radps, u),
    }
}

/// ω̇, rad/s²: \[Paternain\] Eq. 2 rows ω̇x, ω̇y, ω̇z as corrected.
pub fn angular_acceleration(airframe: &Airframe, body_rates_radps: &Vector3<f64>, u: &Input) -> Vector3<f64> {
    let w = body_rates_radps;
    let i = airframe.inertia_kgm2;
    let tau = u.rotors.torque_flu_nm + u.torque_flu_nm;
    let h = u.rotor_momentum_nms;
    Vector3::new(
        (tau.x + (i.y - i.z) * w.y * w.z - w.y * h) / i.x,
        (tau.y + (i.z - i.x) * w.x * w.z + w.x * h) / i.y,
        (tau.z + (i.x - i.y) * w.x * w.y - u.rotor_momentum_rate_nm) / i.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::airframe::{Rotor, Spin};
    use crate::model::integrate::rk4;
    use nalgebra::{Matrix3, Rotation3};
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// A lopsided vehicle, so that no term cancels by symmetry.
    fn lopsided() -> Airframe {
        let mut a = Airframe::paternain();
        a.inertia_kgm2 = Vector3::new(0.010, 0.013, 0.021);
        a.rotors = [
            Rotor { position_flu_m: Vector3::new(0.31, -0.02, 0.05), spin: Spin::CounterClockwise },
            Rotor { position_flu_m: Vector3::new(0.01, 0.30, 0.02), spin: Spin::Clockwise },
            Rotor { position_flu_m: Vector3::new(-0.28, 0.03, 0.04), spin: Spin::CounterClockwise },
            Rotor { position_flu_m: Vector3::new(-0.02, -0.33, 0.03), spin: Spin::Clockwise },
        ];
        a
    }

    fn cross_matrix(v: &Vector3<f64>) -> Matrix3<f64> {
        Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
    }

    /// Newton–Euler written independently: rotation matrices, forces summed rotor by rotor, the angular
    /// momentum of body and rotors as one vector, cross products as matrices.
    fn newton_euler(
        a: &Airframe,
        r: &Matrix3<f64>,
        v: &Vector3<f64>,
        w: &Vector3<f64>,
        speed: &[f64; 4],
        accel: &[f64; 4],
    ) -> (Vector3<f64>, Matrix3<f64>, Vector3<f64>) {
        let mut force_world = Vector3::new(0.0, 0.0, -9.81 * a.mass_kg) - v * a.linear_drag_nspm;
        let mut moment = Vector3::zeros();
        let inertia = Matrix3::from_diagonal(&a.inertia_kgm2);
        let mut momentum = inertia * w;
        let mut rotor_momentum_rate = Vector3::zeros();
        for i in 0..4 {
            let up = Vector3::new(0.0, 0.0, 1.0);
            let axis = match a.rotors[i].spin {
                Spin::CounterClockwise => up,
                Spin::Clockwise => -up,
            };
            let thrust = up * (a.thrust_coefficient_ns2 * speed[i] * speed[i]);
            force_world += r * thrust;
            moment += cross_matrix(&a.rotors[i].position_flu_m) * thrust;
            // The air holds the blade back; the body feels the opposite of the rotor's rotation.
            moment -= axis * (a.drag_torque_coefficient_nms2 * speed[i] * speed[i]);
            momentum += axis * (a.rotor_inertia_kgm2 * speed[i]);
            rotor_momentum_rate += axis * (a.rotor_inertia_kgm2 * accel[i]);
        }
        // d/dt (momentum) in the rotating frame = moment
        let w_dot = inertia.try_inverse().unwrap() * (moment - cross_matrix(w) * momentum - rotor_momentum_rate);
        (force_world / a.mass_kg, r * cross_matrix(w), w_dot)
    }

    /// Relative to the largest term: what double precision leaves after a dozen operations.
    const TOLERANCE: f64 = 1e-12;

    #[test]
    fn agrees_with_newton_euler_on_1000_random_states() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut draw = |scale: f64| rng.random_range(-scale..scale);
        for a in [lopsided(), Airframe::iris(), Airframe::clinic()] {
            let mut worst = [0.0f64; 3];
            for _ in 0..1000 {
                let q = Quaternion::new(draw(1.0), draw(1.0), draw(1.0), draw(1.0)).normalize();
                let x = State {
                    position_enu_m: Vector3::from_fn(|_, _| draw(10.0)),
                    velocity_enu_mps: Vector3::from_fn(|_, _| draw(10.0)),
                    world_from_body: q,
                    body_rates_radps: Vector3::from_fn(|_, _| draw(10.0)),
                };
                let speed: [f64; 4] = std::array::from_fn(|_| 600.0 + draw(500.0));
                let accel: [f64; 4] = std::array::from_fn(|_| draw(5e4));
                let d = derivative(&a, &x, &Input::from_rotors(&a, &speed, &accel));
                let r = Rotation3::from(UnitQuaternion::new_unchecked(q)).into_inner();
                let (v_dot, r_dot, w_dot) =
                    newton_euler(&a, &r, &x.velocity_enu_mps, &x.body_rates_radps, &speed, &accel);
                // Ṙ from q̇: differentiate the rotation of each basis vector.
                let qd = d.world_from_body;
                let r_dot_q = Matrix3::from_columns(&[0, 1, 2].map(|i| {
                    let e = Quaternion::from_imag(Vector3::ith(i, 1.0));
                    (qd * e * q.conjugate() + q * e * qd.conjugate()).imag()
                }));
                assert_eq!(d.position_enu_m, x.velocity_enu_mps);
                worst[0] = worst[0].max((d.velocity_enu_mps - v_dot).norm() / v_dot.norm().max(1.0));
                worst[1] = worst[1].max((r_dot_q - r_dot).norm() / r_dot.norm().max(1.0));
                worst[2] = worst[2].max((d.body_rates_radps - w_dot).norm() / w_dot.norm().max(1.0));
            }
            assert!(worst.iter().all(|w| *w < TOLERANCE), "{}: {worst:?}", a.name);
        }
    }

    /// ERRATA [Paternain] 1: the velocity rows in the form printed (roll ψ, pitch φ, yaw θ), corrected.
    #[test]
    fn attitude_is_yaw_pitch_roll_as_in_the_corrected_equation_2() {
        let (roll, pitch, yaw) = (0.4f64, -0.3f64, 1.1f64);
        let q = *UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let v_body = Vector3::new(0.7, -1.3, 0.4);
        let (sr, cr, sp, cp, sy, cy) = (roll.sin(), roll.cos(), pitch.sin(), pitch.cos(), yaw.sin(), yaw.cos());
        let expected = Vector3::new(
            v_body.x * cp * cy + v_body.y * (cy * sp * sr - cr * sy) + v_body.z * (sr * sy + cr * cy * sp),
            v_body.x * cp * sy + v_body.y * (cr * cy + sy * sp * sr) + v_body.z * (cr * sy * sp - cy * sr),
            -v_body.x * sp + v_body.y * cp * sr + v_body.z * cp * cr,
        );
        assert!((rotate(&q, &v_body) - expected).norm() < 1e-12);
    }

    #[test]
    fn torque_free_motion_keeps_momentum_and_energy() {
        let a = lopsided();
        let mut x = State::at_rest(Vector3::zeros());
        x.body_rates_radps = Vector3::new(1.0, 2.0, 8.0);
        let momentum = |x: &State| rotate(&x.world_from_body, &a.inertia_kgm2.component_mul(&x.body_rates_radps));
        let energy = |x: &State| 0.5 * a.inertia_kgm2.dot(&x.body_rates_radps.component_mul(&x.body_rates_radps));
        let (l0, e0) = (momentum(&x), energy(&x));
        for _ in 0..5000 {
            x = rk4(&x, 1e-3, |x| derivative(&a, x, &Input::default())).normalised();
        }
        assert!((momentum(&x) - l0).norm() / l0.norm() < 1e-8);
        assert!((energy(&x) / e0 - 1.0).abs() < 1e-8);
    }
}

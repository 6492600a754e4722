//! Cascaded PID: position ─► velocity ─► tilt ─► rate ─► torque, and altitude ─► climb ─► thrust: the
//! baseline that every lab knows.
//!
//! | loop | law |
//! |---|---|
//! | horizontal | a = k_v (k_p (r − p) + v_r − v) + k_i ∫(…), tilt = a/g in the heading frame |
//! | altitude | the same with its own gains and a_r, thrust = m (g + a) / (cos roll cos pitch) |
//! | tilt, yaw | ω_r = k (angle_r − angle) |
//! | rate | τ = I (k_p (ω_r − ω) + k_i ∫(ω_r − ω) − k_d ω̇), ω̇ through a first-order filter |
//!
//! Gains are per unit of mass or inertia, so that one set fits every airframe. Integrals are frozen
//! while the mixer could not give what was asked for, and limited.

use nalgebra::{DMatrix, Vector2, Vector3};

use super::tuning::Parameter;
use super::{
    COS_TILT_MIN, Controller, ControllerKind, Loops, Setpoint, TILT_FROM_POSITION_RAD, Trim, Wrench, short_of,
};
use crate::estimate::Estimate;
use crate::frames::{roll_pitch_yaw, wrap_pi};
use crate::model::airframe::Airframe;
use crate::model::linearize::ix;
use crate::model::state_space::StateSpace;
use crate::types::GRAVITY_MPS2;

/// Limit of the position error, m.
const POSITION_ERROR_MAX_M: f64 = 1.0;
/// Limit of the rates asked for, rad/s.
const RATE_MAX_RADPS: f64 = 4.0;
/// Limit of the yaw error, rad.
const YAW_ERROR_MAX_RAD: f64 = 0.5;
/// Larger yaw errors are not integrated, rad: somebody holds the vehicle.
const YAW_INTEGRATED_RAD: f64 = 0.2;
/// Limits of the integrators' output: m/s² horizontally and vertically, rad/s² of tilt and yaw.
const INTEGRATOR_MAX: [f64; 4] = [1.5, 3.0, 20.0, 5.0];
/// Time constant of the derivative's filter, s.
const DERIVATIVE_FILTER_S: f64 = 0.01;

/// Its parameters, in the order of `Gains`.
pub const PARAMETERS: [Parameter; 13] = [
    Parameter::new("position_p", "1/s", 0.0, 10.0),
    Parameter::new("velocity_p", "1/s", 0.0, 20.0),
    Parameter::new("velocity_i", "1/s^2", 0.0, 20.0),
    Parameter::new("altitude_p", "1/s", 0.0, 20.0),
    Parameter::new("climb_p", "1/s", 0.0, 50.0),
    Parameter::new("climb_i", "1/s^2", 0.0, 50.0),
    Parameter::new("tilt_p", "1/s", 0.0, 50.0),
    Parameter::new("tilt_rate_p", "1/s", 0.0, 100.0),
    Parameter::new("tilt_rate_i", "1/s^2", 0.0, 500.0),
    Parameter::new("tilt_rate_d", "1", 0.0, 2.0),
    Parameter::new("yaw_p", "1/s", 0.0, 20.0),
    Parameter::new("yaw_rate_p", "1/s", 0.0, 50.0),
    Parameter::new("yaw_rate_i", "1/s^2", 0.0, 100.0),
];

/// What the parameters are without being told: 8 rad/s of tilt, 2.5 rad/s of yaw, 1 rad/s of position.
pub const DEFAULTS: [f64; 13] = [0.9, 2.2, 0.3, 2.0, 5.0, 2.0, 7.0, 18.0, 12.0, 0.1, 2.5, 6.0, 2.0];

/// The gains by name; units as in [`PARAMETERS`].
#[derive(Debug, Clone, Copy, PartialEq)]
struct Gains {
    position_p: f64,
    velocity: (f64, f64),
    altitude_p: f64,
    climb: (f64, f64),
    tilt_p: f64,
    tilt_rate: (f64, f64, f64),
    yaw_p: f64,
    yaw_rate: (f64, f64),
}

/// The controller.
#[derive(Debug, Clone, PartialEq)]
pub struct Pid {
    gains: Gains,
    mass_kg: f64,
    inertia_kgm2: Vector3<f64>,
    /// Horizontal, world frame, m/s².
    velocity_integral: Vector2<f64>,
    /// m/s².
    climb_integral: f64,
    /// Roll, pitch, yaw, rad/s².
    rate_integral: Vector3<f64>,
    /// Filtered angular acceleration of roll and pitch, and the rates it was last taken from.
    turning: Vector2<f64>,
    last_rates: Option<Vector2<f64>>,
    /// Could thrust, torque x y z not be given?
    short: [bool; 4],
}

impl Pid {
    /// With `values` in the order of [`PARAMETERS`]; the defaults where they are missing.
    pub fn new(airframe: &Airframe, values: &[f64]) -> Self {
        let value = |i: usize| values.get(i).copied().unwrap_or(DEFAULTS[i]);
        Self {
            gains: Gains {
                position_p: value(0),
                velocity: (value(1), value(2)),
                altitude_p: value(3),
                climb: (value(4), value(5)),
                tilt_p: value(6),
                tilt_rate: (value(7), value(8), value(9)),
                yaw_p: value(10),
                yaw_rate: (value(11), value(12)),
            },
            mass_kg: airframe.mass_kg,
            inertia_kgm2: airframe.inertia_kgm2,
            velocity_integral: Vector2::zeros(),
            climb_integral: 0.0,
            rate_integral: Vector3::zeros(),
            turning: Vector2::zeros(),
            last_rates: None,
            short: [false; 4],
        }
    }

    /// What it multiplies with.
    pub fn values(&self) -> [f64; 13] {
        let g = &self.gains;
        [
            g.position_p,
            g.velocity.0,
            g.velocity.1,
            g.altitude_p,
            g.climb.0,
            g.climb.1,
            g.tilt_p,
            g.tilt_rate.0,
            g.tilt_rate.1,
            g.tilt_rate.2,
            g.yaw_p,
            g.yaw_rate.0,
            g.yaw_rate.1,
        ]
    }

    /// The law for small errors at ticks of `period_s`, in the heading frame.
    ///
    /// States: integrals of x, y, climb, roll, pitch, yaw; filtered ṗ and q̇; p and q of the tick before.
    pub fn linear(&self, period_s: f64, horizontal: bool) -> StateSpace {
        const STATES: usize = 10;
        let g = &self.gains;
        let t = period_s;
        let mut law = StateSpace {
            a: DMatrix::zeros(STATES, STATES),
            b: DMatrix::zeros(STATES, 12),
            c: DMatrix::zeros(4, STATES),
            d: DMatrix::zeros(4, 12),
        };
        // A row over (states, errors), so that each line of the code below is a line of `control`.
        let n = STATES + 12;
        let unit = |i: usize| nalgebra::DVector::<f64>::from_fn(n, |r, _| if r == i { 1.0 } else { 0.0 });
        let (state, error) = (|i: usize| unit(i), |i: usize| unit(STATES + i));
        let mut put = |i: usize, row: &nalgebra::DVector<f64>| {
            for c in 0..STATES {
                law.a[(i, c)] = row[c];
            }
            for c in 0..12 {
                law.b[(i, c)] = row[STATES + c];
            }
        };
        let zero = nalgebra::DVector::<f64>::zeros(n);
        // An integral without gain is no state.
        let integral = |i: usize, wanted: &nalgebra::DVector<f64>, gain: f64| {
            if gain > 0.0 { state(i) + wanted * (gain * t) } else { zero.clone() }
        };
        // Tilt asked for by the horizontal loop: pitch = a_x/g, roll = −a_y/g.
        let mut tilt = [zero.clone(), zero.clone()];
        for axis in 0..2 {
            let wanted = error(ix::X + axis) * -g.position_p - error(ix::VX + axis);
            let integral = integral(axis, &wanted, g.velocity.1);
            if horizontal {
                put(axis, &integral);
                let acceleration = &wanted * g.velocity.0 + integral;
                tilt[1 - axis] = acceleration * if axis == 0 { 1.0 / GRAVITY_MPS2 } else { -1.0 / GRAVITY_MPS2 };
            }
        }
        let wanted = error(ix::Z) * -g.altitude_p - error(ix::VZ);
        let climb = integral(2, &wanted, g.climb.1);
        put(2, &climb);
        let thrust = (&wanted * g.climb.0 + climb) * self.mass_kg;
        let share = t / (t + DERIVATIVE_FILTER_S);
        let mut torque = [zero.clone(), zero.clone(), zero.clone()];
        for axis in 0..2 {
            let rate = error(ix::P + axis);
            let wanted = (&tilt[axis] - error(ix::ROLL + axis)) * g.tilt_p - &rate;
            let integral = integral(3 + axis, &wanted, g.tilt_rate.1);
            put(3 + axis, &integral);
            let turning = state(6 + axis) * (1.0 - share) + (&rate - state(8 + axis)) * (share / t);
            put(6 + axis, &turning);
            put(8 + axis, &rate);
            let acceleration = &wanted * g.tilt_rate.0 + integral - turning * g.tilt_rate.2;
            torque[axis] = acceleration * self.inertia_kgm2[axis];
        }
        let wanted = error(ix::YAW) * -g.yaw_p - error(ix::R);
        let turn = integral(5, &wanted, g.yaw_rate.1);
        put(5, &turn);
        torque[2] = (&wanted * g.yaw_rate.0 + turn) * self.inertia_kgm2.z;
        for (r, row) in std::iter::once(&thrust).chain(&torque).enumerate() {
            for c in 0..STATES {
                law.c[(r, c)] = row[c];
            }
            for c in 0..12 {
                law.d[(r, c)] = row[STATES + c];
            }
        }
        law
    }
}

impl Controller for Pid {
    fn kind(&self) -> ControllerKind {
        ControllerKind::Pid
    }

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        let g = self.gains;
        let angles = roll_pitch_yaw(&estimate.world_from_body);
        let motion = estimate.motion_or_rest();
        let error = setpoint.position_enu_m - motion.position_enu_m;
        let velocity_error = setpoint.velocity_enu_mps - motion.velocity_enu_mps;

        let mut tilt = setpoint.tilt_rad(loops, angles.z);
        if loops.horizontal {
            let wanted = error.xy().map(|e| g.position_p * e.clamp(-POSITION_ERROR_MAX_M, POSITION_ERROR_MAX_M))
                + velocity_error.xy();
            if !(self.short[ix::TORQUE_X] || self.short[ix::TORQUE_Y]) {
                let limit = INTEGRATOR_MAX[0];
                self.velocity_integral =
                    (self.velocity_integral + wanted * (g.velocity.1 * dt_s)).map(|v| v.clamp(-limit, limit));
            }
            let a = (wanted * g.velocity.0 + self.velocity_integral) / GRAVITY_MPS2;
            let (sin, cos) = angles.z.sin_cos();
            let (ahead, left) = (cos * a.x + sin * a.y, cos * a.y - sin * a.x);
            tilt += Vector2::new(-left, ahead).map(|v| v.clamp(-TILT_FROM_POSITION_RAD, TILT_FROM_POSITION_RAD));
        }

        let thrust_n = if loops.altitude {
            let wanted = g.altitude_p * error.z.clamp(-POSITION_ERROR_MAX_M, POSITION_ERROR_MAX_M) + velocity_error.z;
            if !self.short[ix::THRUST] {
                let limit = INTEGRATOR_MAX[1];
                self.climb_integral = (self.climb_integral + wanted * g.climb.1 * dt_s).clamp(-limit, limit);
            }
            let a = g.climb.0 * wanted + self.climb_integral + setpoint.acceleration_enu_mps2.z;
            self.mass_kg * (GRAVITY_MPS2 + a) / (angles.x.cos() * angles.y.cos()).max(COS_TILT_MIN)
        } else {
            self.mass_kg * GRAVITY_MPS2 * setpoint.throttle
        };

        let yaw = wrap_pi(setpoint.roll_pitch_yaw_rad.z - angles.z).clamp(-YAW_ERROR_MAX_RAD, YAW_ERROR_MAX_RAD);
        let rates = estimate.body_rates_radps;
        let asked = Vector3::new(g.tilt_p * (tilt.x - angles.x), g.tilt_p * (tilt.y - angles.y), g.yaw_p * yaw)
            .map(|v| v.clamp(-RATE_MAX_RADPS, RATE_MAX_RADPS));
        let wanted = asked - rates;
        let integrated = Vector3::new(g.tilt_rate.1, g.tilt_rate.1, g.yaw_rate.1);
        for axis in 0..3 {
            let held = axis == 2 && yaw.abs() > YAW_INTEGRATED_RAD;
            if !self.short[ix::TORQUE_X + axis] && !held {
                let limit = INTEGRATOR_MAX[if axis == 2 { 3 } else { 2 }];
                let next = self.rate_integral[axis] + wanted[axis] * integrated[axis] * dt_s;
                self.rate_integral[axis] = next.clamp(-limit, limit);
            }
        }
        if dt_s > 0.0 {
            let share = dt_s / (dt_s + DERIVATIVE_FILTER_S);
            let last = self.last_rates.unwrap_or(rates.xy());
            self.turning += ((rates.xy() - last) / dt_s - self.turning) * share;
            self.last_rates = Some(rates.xy());
        }
        let damping = Vector3::new(self.turning.x, self.turning.y, 0.0) * g.tilt_rate.2;
        let proportional = Vector3::new(g.tilt_rate.0, g.tilt_rate.0, g.yaw_rate.0);
        let acceleration = wanted.component_mul(&proportional) + self.rate_integral - damping;
        Wrench { thrust_n: thrust_n.max(0.0), torque_flu_nm: acceleration.component_mul(&self.inertia_kgm2) }
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        self.short = short_of(asked, given, support_n, self.mass_kg * GRAVITY_MPS2);
    }

    fn integrator(&self) -> [f64; 4] {
        [self.velocity_integral.x, self.velocity_integral.y, self.climb_integral, self.rate_integral.z]
    }

    fn reset(&mut self) {
        self.velocity_integral.fill(0.0);
        self.climb_integral = 0.0;
        self.rate_integral.fill(0.0);
        self.turning.fill(0.0);
        self.last_rates = None;
        self.short = [false; 4];
    }

    fn trim(&self) -> Trim {
        Trim {
            thrust_n: self.climb_integral * self.mass_kg,
            acceleration_mps2: self.velocity_integral,
            yaw_torque_nm: self.rate_integral.z * self.inertia_kgm2.z,
        }
    }

    fn take_over(&mut self, trim: &Trim) {
        let limited = |v: f64, limit: f64| v.clamp(-limit, limit);
        self.climb_integral = limited(trim.thrust_n / self.mass_kg, INTEGRATOR_MAX[1]);
        self.velocity_integral = trim.acceleration_mps2.map(|v| limited(v, INTEGRATOR_MAX[0]));
        self.rate_integral =
            Vector3::new(0.0, 0.0, limited(trim.yaw_torque_nm / self.inertia_kgm2.z, INTEGRATOR_MAX[3]));
    }
}

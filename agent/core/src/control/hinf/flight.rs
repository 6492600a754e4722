//! The H∞ controller that flies: mixed sensitivity on the double integrators of roll, pitch, yaw, altitude and
//! position, each with one fast pole residualised: six channels of order 3.
//!
//! Deviation from \[Strategies\], whose controller sees x, y, z and yaw only and holds no attitude: position acts
//! through the tilt that the inner channels hold, so that the same controller flies with and without a
//! horizontal position. One normalised problem, 1/s² with W_S at ω₀, serves every channel: K(s) = k² K₀(s/k)
//! has the bandwidth k ω₀. Angular accelerations are multiplied by the inertia, linear ones by the mass.
//!
//! K₀ is taken apart, because only its parts can be limited without harm:
//!
//! | part | what is done to it |
//! |---|---|
//! | slow pole (integral action) | limited; stands while the mixer could not give what was asked for, or the angle is far off; handed over |
//! | stiffness: the rest at zero frequency | acts on the limited error |
//! | lead: the rest without its stiffness, zero in the steady state | acts on the whole error: it is all the damping there is |
//!
//! The disturbance at the plant's input decides how stiff K₀ is: without it the controller cancels the plant's
//! poles at zero and hardly answers a steady error. A channel must answer a steady torque (motors that differ by
//! a per cent turn the vehicle with 0.3 rad/s²) well within the angle up to which it integrates, or that angle
//! is passed, nothing integrates, and it turns on.
//!
//! Channels are sampled by the bilinear transform.

use nalgebra::{DMatrix, Matrix2, Matrix3, RowVector2, RowVector3, Vector2, Vector3};

use super::reduction::{residualise_fastest, split_slowest};
use super::synthesis::{central, optimal_gamma};
use super::weights::{Weight, mixed_sensitivity};
use crate::control::tuning::Parameter;
use crate::control::{COS_TILT_MIN, Controller, TILT_FROM_POSITION_RAD, Trim, short_of};
use crate::estimate::Estimate;
use crate::frames::{roll_pitch_yaw, wrap_pi};
use crate::linalg::LinalgError;
use crate::model::airframe::Airframe;
use crate::model::linearize::ix;
use crate::model::state_space::StateSpace;
use crate::types::{ControllerKind, GRAVITY_MPS2, Loops, Setpoint, Wrench};

/// Its parameters, in order. Efforts and disturbance belong to the normalised problem.
pub const PARAMETERS: [Parameter; 8] = [
    Parameter::new("horizontal_bandwidth", "rad/s", 0.05, 3.0),
    Parameter::new("altitude_bandwidth", "rad/s", 0.1, 8.0),
    Parameter::new("tilt_bandwidth", "rad/s", 0.5, 20.0),
    Parameter::new("yaw_bandwidth", "rad/s", 0.1, 8.0),
    Parameter::new("sensitivity_peak", "1", 1.1, 5.0),
    Parameter::new("effort_low", "1/s^2", 0.5, 100.0),
    Parameter::new("effort_high", "1/s^2", 0.05, 20.0),
    Parameter::new("disturbance", "1/s^2", 0.001, 2.0),
];

/// What the parameters are without being told.
pub const DEFAULTS: [f64; 8] = [0.75, 2.0, 5.0, 2.8, 2.0, 9.0, 2.0, 0.1];

/// ω₀ of the normalised problem, rad/s.
const NORMAL_RADPS: f64 = 0.5;
/// Corner of the effort's weight in the normalised problem, rad/s.
const EFFORT_CORNER_RADPS: f64 = 100.0;
/// Floor of the sensitivity at low frequencies.
const FLOOR: f64 = 1e-3;
/// γ of the controller, relative to the smallest.
const GAMMA_FACTOR: f64 = 1.01;
/// Tolerance of the smallest γ.
const GAMMA_TOLERANCE: f64 = 1e-6;
/// Limits of the slow parts: m/s² horizontally and vertically, rad/s² of tilt and yaw.
const SLOW_MAX: [f64; 4] = [1.5, 3.0, 20.0, 5.0];
/// Larger errors do not move the slow part: somebody holds the vehicle, or it is turning. rad of tilt and yaw.
const INTEGRATED_MAX: [f64; 4] = [f64::INFINITY, f64::INFINITY, 0.2, 0.1];
/// Limits of the errors that stiffness and slow part answer: m horizontally, m vertically, rad of tilt, rad of yaw.
const ERROR_MAX: [f64; 4] = [1.0, 0.5, 1.0, 0.5];

/// One channel's law, sampled: acceleration from the error. The slow part's state is what it gives.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    slow: (f64, f64, f64),
    a: Matrix2<f64>,
    b: Vector2<f64>,
    c: RowVector2<f64>,
    d: f64,
    /// Fast state in the steady state with an error of one, and what the fast part gives then.
    steady: Vector2<f64>,
    stiffness: f64,
    limits: Limits,
}

/// Where a channel stops being linear.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limits {
    /// What the slow part may give.
    slow: f64,
    /// Errors beyond it count as this much for stiffness and slow part.
    error: f64,
    /// Errors beyond it are not integrated.
    integrated: f64,
}

/// State of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Memory {
    slow: f64,
    fast: Vector2<f64>,
    /// Error of the tick before.
    error: Option<f64>,
}

impl Channel {
    /// The acceleration for `error`; the slow part does not move while it `stands`.
    fn run(&self, memory: &mut Memory, error: f64, stands: bool) -> f64 {
        let (a, b, direct) = self.slow;
        let limited = error.clamp(-self.limits.error, self.limits.error);
        // The first error was always there.
        if memory.error.is_none() && error.is_finite() {
            memory.fast = self.steady * error;
        }
        let lead = (self.c * memory.fast)[0] + (self.d - self.stiffness) * error;
        let out = memory.slow + (direct + self.stiffness) * limited + lead;
        if error.is_finite() {
            memory.error = Some(error);
            memory.fast = self.a * memory.fast + self.b * error;
            if !(stands || error.abs() > self.limits.integrated) {
                memory.slow = (a * memory.slow + b * limited).clamp(-self.limits.slow, self.limits.slow);
            }
        }
        out
    }

    /// The same for the error of an angle: a step by a whole turn is no movement.
    fn turn(&self, memory: &mut Memory, error: f64, stands: bool) -> f64 {
        let before = memory.error.unwrap_or(error);
        let step = error - before;
        memory.fast += self.steady * (step - wrap_pi(step));
        self.run(memory, error, stands)
    }

    fn values(&self) -> impl Iterator<Item = f64> + '_ {
        [self.slow.0, self.slow.1, self.slow.2, self.d]
            .into_iter()
            .chain(self.a.iter().chain(&self.b).chain(&self.c).copied())
    }

    /// The whole channel: slow part first.
    fn matrices(&self) -> (Matrix3<f64>, Vector3<f64>, RowVector3<f64>, f64) {
        let (slow_a, slow_b, direct) = self.slow;
        let mut a = Matrix3::zeros();
        a[(0, 0)] = slow_a;
        a.fixed_view_mut::<2, 2>(1, 1).copy_from(&self.a);
        let b = Vector3::new(slow_b, self.b.x, self.b.y);
        let c = RowVector3::new(1.0, self.c[0], self.c[1]);
        (a, b, c, direct + self.d)
    }
}

/// The controller.
#[derive(Debug, Clone, PartialEq)]
pub struct Hinf {
    horizontal: Channel,
    altitude: Channel,
    tilt: Channel,
    yaw: Channel,
    mass_kg: f64,
    inertia_kgm2: Vector3<f64>,
    /// World x, world y, z, roll, pitch, yaw.
    memories: [Memory; 6],
    /// Could thrust, torque x y z not be given?
    short: [bool; 4],
}

/// K₀ around 1/s², one fast pole residualised.
fn normalised(peak: f64, effort: (f64, f64), disturbance: f64) -> Result<StateSpace, LinalgError> {
    let double = StateSpace {
        a: nalgebra::dmatrix![0.0, 1.0; 0.0, 0.0],
        b: nalgebra::dmatrix![0.0; 1.0],
        c: nalgebra::dmatrix![1.0, 0.0],
        d: DMatrix::zeros(1, 1),
    };
    let performance = Weight::performance(NORMAL_RADPS, peak, FLOOR);
    let effort = Weight::effort(effort.0, effort.1, EFFORT_CORNER_RADPS);
    let problem = mixed_sensitivity(&double, &[performance], &[effort], disturbance);
    let gamma = GAMMA_FACTOR * optimal_gamma(&problem, GAMMA_TOLERANCE)?;
    let none =
        LinalgError::NotConverged { what: "H-infinity synthesis", iterations: 0, change: gamma, residual: gamma };
    let solved = central(&problem, gamma)?.ok_or(none)?;
    Ok(residualise_fastest(&solved.controller)?.0)
}

/// k² K₀(s/k), sampled by the bilinear transform.
fn sampled(shape: &StateSpace, k: f64, period_s: f64, limits: Limits) -> Result<Channel, LinalgError> {
    let (pole, parts) = split_slowest(shape)?;
    let half = 0.5 * period_s;
    let (pole, gain) = (pole * k, (parts.c * parts.b)[(0, 0)] * k * k * k);
    let shrink = 1.0 / (1.0 - pole * half);
    let a = parts.rest.a.fixed_view::<2, 2>(0, 0) * k;
    let b = parts.rest.b.fixed_view::<2, 1>(0, 0) * k;
    let c = parts.rest.c.fixed_view::<1, 2>(0, 0) * (k * k);
    let singular = || LinalgError::Singular { what: "I - AT/2", condition: f64::INFINITY };
    let inverse = (Matrix2::identity() - a * half).try_inverse().ok_or_else(singular)?;
    let c = c * inverse;
    let d = parts.rest.d[(0, 0)] * k * k + (c * b)[0] * half;
    let (a, b) = (inverse * (Matrix2::identity() + a * half), inverse * b * period_s);
    // The state that stands still at an error of one: x = A x + B.
    let steady = (Matrix2::identity() - a).try_inverse().ok_or_else(singular)? * b;
    Ok(Channel {
        slow: ((1.0 + pole * half) * shrink, gain * period_s * shrink * shrink, gain * half * shrink),
        a,
        b,
        c,
        d,
        steady,
        stiffness: (c * steady)[0] + d,
        limits,
    })
}

impl Hinf {
    /// Solves for `values` in the order of [`PARAMETERS`], the defaults where they are missing.
    ///
    /// # Errors
    /// When no γ is possible.
    pub fn new(airframe: &Airframe, period_s: f64, values: &[f64]) -> Result<Self, LinalgError> {
        let value = |i: usize| values.get(i).copied().unwrap_or(DEFAULTS[i]);
        let shape = normalised(value(4), (value(5), value(6)), value(7))?;
        let channel = |i: usize| {
            let limits = Limits { slow: SLOW_MAX[i], error: ERROR_MAX[i], integrated: INTEGRATED_MAX[i] };
            sampled(&shape, value(i) / NORMAL_RADPS, period_s, limits)
        };
        Ok(Self {
            horizontal: channel(0)?,
            altitude: channel(1)?,
            tilt: channel(2)?,
            yaw: channel(3)?,
            mass_kg: airframe.mass_kg,
            inertia_kgm2: airframe.inertia_kgm2,
            memories: [Memory::default(); 6],
            short: [false; 4],
        })
    }

    /// What it multiplies with.
    pub fn each_value(&self, take: impl FnMut(f64)) {
        let channels = [&self.horizontal, &self.altitude, &self.tilt, &self.yaw];
        channels.into_iter().flat_map(Channel::values).for_each(take);
    }

    /// The law for small errors, in the heading frame; with or without the horizontal channels.
    pub fn linear(&self, horizontal: bool) -> StateSpace {
        // Channel, error's state, sign: the error is reference minus state.
        let blocks = [
            (self.altitude, ix::Z, ix::THRUST, self.mass_kg),
            (self.tilt, ix::ROLL, ix::TORQUE_X, self.inertia_kgm2.x),
            (self.tilt, ix::PITCH, ix::TORQUE_Y, self.inertia_kgm2.y),
            (self.yaw, ix::YAW, ix::TORQUE_Z, self.inertia_kgm2.z),
        ];
        let outer = if horizontal { 6 } else { 0 };
        let n = outer + 12;
        let mut out = StateSpace {
            a: DMatrix::zeros(n, n),
            b: DMatrix::zeros(n, 12),
            c: DMatrix::zeros(4, n),
            d: DMatrix::zeros(4, 12),
        };
        for (i, (channel, state, input, scale)) in blocks.into_iter().enumerate() {
            let at = outer + 3 * i;
            let (a, b, c, d) = channel.matrices();
            out.a.view_mut((at, at), (3, 3)).copy_from(&a);
            out.b.view_mut((at, state), (3, 1)).copy_from(&-b);
            out.c.view_mut((input, at), (1, 3)).copy_from(&(c * scale));
            out.d[(input, state)] = -d * scale;
        }
        if horizontal {
            // Tilt asked for: pitch = a_x/g, roll = −a_y/g; it adds to the error of the tilt channels.
            let (ha, hb, hc, hd) = self.horizontal.matrices();
            let (_, tilt_b, _, tilt_d) = self.tilt.matrices();
            for (axis, block, input, sign) in [(ix::X, 2, ix::TORQUE_Y, 1.0), (ix::Y, 1, ix::TORQUE_X, -1.0)] {
                let (at, inner) = (3 * axis, outer + 3 * block);
                let scale = if axis == ix::X { self.inertia_kgm2.y } else { self.inertia_kgm2.x };
                out.a.view_mut((at, at), (3, 3)).copy_from(&ha);
                out.b.view_mut((at, axis), (3, 1)).copy_from(&-hb);
                let from_state = hc * (sign / GRAVITY_MPS2);
                let direct = -hd * sign / GRAVITY_MPS2;
                out.a.view_mut((inner, at), (3, 3)).copy_from(&(tilt_b * from_state));
                out.b.view_mut((inner, axis), (3, 1)).copy_from(&(tilt_b * direct));
                out.c.view_mut((input, at), (1, 3)).copy_from(&(from_state * (tilt_d * scale)));
                out.d[(input, axis)] = tilt_d * direct * scale;
            }
        }
        out
    }
}

impl Controller for Hinf {
    fn kind(&self) -> ControllerKind {
        ControllerKind::Hinf
    }

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, _dt_s: f64) -> Wrench {
        let angles = roll_pitch_yaw(&estimate.world_from_body);
        let error = setpoint.position_enu_m - estimate.motion_or_rest().position_enu_m;
        let limited = |v: f64, limit: f64| v.clamp(-limit, limit);
        let (short, [x, y, z, roll, pitch, turn]) = (self.short, &mut self.memories);

        let mut tilt = setpoint.tilt_rad(loops, angles.z);
        if loops.horizontal {
            let stands = short[ix::TORQUE_X] || short[ix::TORQUE_Y];
            let ax = self.horizontal.run(x, error.x, stands) / GRAVITY_MPS2;
            let ay = self.horizontal.run(y, error.y, stands) / GRAVITY_MPS2;
            let (sin, cos) = angles.z.sin_cos();
            tilt.x += limited(sin * ax - cos * ay, TILT_FROM_POSITION_RAD);
            tilt.y += limited(cos * ax + sin * ay, TILT_FROM_POSITION_RAD);
        } else {
            (*x, *y) = (Memory::default(), Memory::default());
        }

        let thrust_n = if loops.altitude {
            let a = self.altitude.run(z, error.z, short[ix::THRUST]) + setpoint.acceleration_enu_mps2.z;
            self.mass_kg * (GRAVITY_MPS2 + a) / (angles.x.cos() * angles.y.cos()).max(COS_TILT_MIN)
        } else {
            *z = Memory::default();
            self.mass_kg * GRAVITY_MPS2 * setpoint.throttle
        };

        let yaw = wrap_pi(setpoint.roll_pitch_yaw_rad.z - angles.z);
        let turning = Vector3::new(
            self.tilt.turn(roll, tilt.x - angles.x, short[ix::TORQUE_X]),
            self.tilt.turn(pitch, tilt.y - angles.y, short[ix::TORQUE_Y]),
            self.yaw.turn(turn, yaw, short[ix::TORQUE_Z]),
        );
        Wrench { thrust_n: thrust_n.max(0.0), torque_flu_nm: turning.component_mul(&self.inertia_kgm2) }
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        self.short = short_of(asked, given, support_n, self.mass_kg * GRAVITY_MPS2);
    }

    fn integrator(&self) -> [f64; 4] {
        // The slow parts, m/s² and rad/s².
        let [x, y, z, _, _, yaw] = &self.memories;
        [x.slow, y.slow, z.slow, yaw.slow]
    }

    fn reset(&mut self) {
        self.memories = [Memory::default(); 6];
        self.short = [false; 4];
    }

    fn trim(&self) -> Trim {
        let [x, y, z, yaw] = self.integrator();
        Trim {
            thrust_n: self.mass_kg * z,
            acceleration_mps2: Vector2::new(x, y),
            yaw_torque_nm: self.inertia_kgm2.z * yaw,
        }
    }

    fn take_over(&mut self, trim: &Trim) {
        self.memories = [Memory::default(); 6];
        let [x, y, z, _, _, yaw] = &mut self.memories;
        x.slow = trim.acceleration_mps2.x.clamp(-SLOW_MAX[0], SLOW_MAX[0]);
        y.slow = trim.acceleration_mps2.y.clamp(-SLOW_MAX[0], SLOW_MAX[0]);
        z.slow = (trim.thrust_n / self.mass_kg).clamp(-SLOW_MAX[1], SLOW_MAX[1]);
        yaw.slow = (trim.yaw_torque_nm / self.inertia_kgm2.z).clamp(-SLOW_MAX[3], SLOW_MAX[3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angular acceleration of yaw by motors that differ by a per cent (two sigma of four), rad/s².
    const UNEVEN_RADPS2: f64 = 0.35;

    #[test]
    fn a_steady_torque_is_answered_well_within_the_angle_that_is_integrated() {
        for name in Airframe::NAMES {
            let hinf = Hinf::new(&Airframe::by_name(name).unwrap(), 0.005, &DEFAULTS).unwrap();
            for channel in [&hinf.tilt, &hinf.yaw] {
                let answered = channel.stiffness * channel.limits.integrated;
                assert!(answered > 2.0 * UNEVEN_RADPS2, "{name}: {answered:.2} rad/s²");
            }
        }
    }

    #[test]
    fn parts_together_are_the_channel() {
        let hinf = Hinf::new(&Airframe::iris(), 0.005, &DEFAULTS).unwrap();
        let channel = hinf.yaw;
        let (a, b, c, d) = channel.matrices();
        let error = |k: u32| 0.05 * (0.1 * f64::from(k)).sin();
        let mut memory = Memory { error: Some(0.0), ..Memory::default() };
        let mut x = Vector3::zeros();
        for k in 0..500 {
            let expected = (c * x)[0] + d * error(k);
            assert!((channel.turn(&mut memory, error(k), false) - expected).abs() < 1e-9);
            x = a * x + b * error(k);
        }
    }

    #[test]
    fn turning_past_half_a_turn_kicks_nothing() {
        let hinf = Hinf::new(&Airframe::iris(), 0.005, &DEFAULTS).unwrap();
        let mut memory = Memory::default();
        // 1 rad/s for a turn and a half: the damping is the same all the way, the stiffness changes its side once a turn.
        let (mut before, mut largest) = (None, 0.0_f64);
        for k in 0..2000 {
            let error = wrap_pi(0.005 * f64::from(k));
            let stiff = (hinf.yaw.stiffness + hinf.yaw.slow.2) * error.clamp(-0.5, 0.5);
            let damping = hinf.yaw.turn(&mut memory, error, true) - stiff;
            if k > 300 {
                let steady = *before.get_or_insert(damping);
                largest = largest.max((damping - steady).abs() / steady.abs());
            }
        }
        assert!(largest < 1e-6, "the lead changes by {largest:.1e} of itself");
    }
}

//! The H∞ controller that flies: mixed sensitivity on the double integrators of roll, pitch, yaw, altitude and
//! position, each with one fast pole residualised: six channels of order 3.
//!
//! Deviation from [Strategies], whose controller sees x, y, z and yaw only and holds no attitude: position acts
//! through the tilt that the inner channels hold, so that the same controller flies with and without a
//! horizontal position. A normalised problem, 1/s² with W_S at ω₀, serves every bandwidth: K(s) = k² K₀(s/k)
//! has the bandwidth k ω₀. Two shapes: tilt, loose at low frequencies because the position loop corrects it, and
//! the outer ones, firm.
//!
//! Angular accelerations are multiplied by the inertia, linear ones by the mass. Channels are sampled by the
//! bilinear transform; the slow pole of each (its integral action) stands apart, so that it can be limited,
//! stand still while the mixer could not give what was asked for, and be handed over. The profile's vertical
//! acceleration is fed forward.

use nalgebra::{DMatrix, Matrix2, Matrix3, RowVector2, RowVector3, Vector2, Vector3};

use super::reduction::{residualise_fastest, split_slowest};
use super::synthesis::{central, optimal_gamma};
use super::weights::{Weight, mixed_sensitivity};
use crate::control::tuning::Parameter;
use crate::control::{Controller, ControllerKind, Loops, Setpoint, Trim, Wrench};
use crate::estimate::Estimate;
use crate::frames::{roll_pitch_yaw, wrap_pi};
use crate::linalg::LinalgError;
use crate::model::GRAVITY_MPS2;
use crate::model::airframe::Airframe;
use crate::model::linearize::ix;
use crate::model::state_space::StateSpace;

/// Its parameters, in order. Efforts and disturbances belong to the normalised problems.
pub const PARAMETERS: [Parameter; 13] = [
    Parameter::new("horizontal_bandwidth", "rad/s", 0.05, 3.0),
    Parameter::new("altitude_bandwidth", "rad/s", 0.1, 8.0),
    Parameter::new("tilt_bandwidth", "rad/s", 0.5, 20.0),
    Parameter::new("yaw_bandwidth", "rad/s", 0.1, 8.0),
    Parameter::new("outer_sensitivity_peak", "1", 1.1, 5.0),
    Parameter::new("outer_effort_low", "m/s^2", 0.5, 100.0),
    Parameter::new("outer_effort_high", "m/s^2", 0.05, 20.0),
    Parameter::new("outer_disturbance", "m/s^2", 0.001, 2.0),
    Parameter::new("tilt_sensitivity_peak", "1", 1.1, 5.0),
    Parameter::new("tilt_floor", "1", 0.001, 0.9),
    Parameter::new("tilt_effort_low", "rad/s^2", 0.5, 100.0),
    Parameter::new("tilt_effort_high", "rad/s^2", 0.05, 20.0),
    Parameter::new("tilt_disturbance", "rad/s^2", 0.001, 2.0),
];

/// What the parameters are without being told.
pub const DEFAULTS: [f64; 13] = [0.5, 1.6, 4.8, 1.2, 2.0, 9.0, 2.0, 0.005, 1.5, 0.3, 20.0, 5.0, 0.02];

/// ω₀ of the outer problem and of the tilt's, rad/s.
const NORMAL_RADPS: [f64; 2] = [0.5, 0.8];
/// Corner of the effort's weight in the normalised problems, rad/s.
const EFFORT_CORNER_RADPS: f64 = 100.0;
/// Floor of the sensitivity at low frequencies, but for tilt.
const FLOOR: f64 = 1e-3;
/// γ of the controller, relative to the smallest.
const GAMMA_FACTOR: f64 = 1.01;
/// Tolerance of the smallest γ.
const GAMMA_TOLERANCE: f64 = 1e-6;
/// Limits of the slow parts: m/s² horizontally and vertically, rad/s² of tilt and yaw.
const SLOW_MAX: [f64; 4] = [1.5, 3.0, 20.0, 5.0];
/// Larger yaw errors do not move the slow part, rad: somebody holds the vehicle, or it is turning.
const YAW_INTEGRATED_RAD: f64 = 0.2;
/// Limit of the vertical acceleration fed forward, m/s².
const FED_FORWARD_MAX_MPS2: f64 = 3.0;
/// Limits of the errors: m horizontally, m vertically, rad of yaw.
const ERROR_MAX: [f64; 3] = [1.0, 0.5, 0.5];
/// Limit of the tilt asked for, rad.
const TILT_MAX_RAD: f64 = 0.30;
/// Thrust is raised for tilt up to this (60°), no further.
const COS_TILT_MIN: f64 = 0.5;
/// A wrench counts as not given when it differs by this fraction of the weight, or N m.
const SHORTFALL: f64 = 1e-3;

/// One channel's law, sampled: acceleration from the error. The slow part's state is what it gives.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    slow: (f64, f64, f64),
    a: Matrix2<f64>,
    b: Vector2<f64>,
    c: RowVector2<f64>,
    d: f64,
    slow_max: f64,
}

/// State of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Memory {
    slow: f64,
    fast: Vector2<f64>,
}

impl Channel {
    /// The acceleration for `error`; the slow part does not move while it `stands`.
    fn run(&self, memory: &mut Memory, error: f64, stands: bool) -> f64 {
        let (a, b, direct) = self.slow;
        let out = memory.slow + direct * error + (self.c * memory.fast)[0] + self.d * error;
        if error.is_finite() {
            memory.fast = self.a * memory.fast + self.b * error;
            if !stands {
                memory.slow = (a * memory.slow + b * error).clamp(-self.slow_max, self.slow_max);
            }
        }
        out
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
    /// Vertical velocity of the setpoint at the tick before, m/s.
    climbing_mps: Option<f64>,
    /// Could thrust, torque x y z not be given?
    short: [bool; 4],
}

/// K₀ around 1/s², one fast pole residualised.
fn normalised(performance: Weight, effort: (f64, f64), disturbance: f64) -> Result<StateSpace, LinalgError> {
    let double = StateSpace {
        a: nalgebra::dmatrix![0.0, 1.0; 0.0, 0.0],
        b: nalgebra::dmatrix![0.0; 1.0],
        c: nalgebra::dmatrix![1.0, 0.0],
        d: DMatrix::zeros(1, 1),
    };
    let effort = Weight::effort(effort.0, effort.1, EFFORT_CORNER_RADPS);
    let problem = mixed_sensitivity(&double, &[performance], &[effort], disturbance);
    let gamma = GAMMA_FACTOR * optimal_gamma(&problem, GAMMA_TOLERANCE)?;
    let none =
        LinalgError::NotConverged { what: "H-infinity synthesis", iterations: 0, change: gamma, residual: gamma };
    let solved = central(&problem, gamma)?.ok_or(none)?;
    Ok(residualise_fastest(&solved.controller)?.0)
}

/// k² K₀(s/k), sampled by the bilinear transform.
fn sampled(shape: &StateSpace, k: f64, period_s: f64, slow_max: f64) -> Result<Channel, LinalgError> {
    let (pole, parts) = split_slowest(shape)?;
    let half = 0.5 * period_s;
    let (pole, gain) = (pole * k, (parts.c * parts.b)[(0, 0)] * k * k * k);
    let shrink = 1.0 / (1.0 - pole * half);
    let a = parts.rest.a.fixed_view::<2, 2>(0, 0) * k;
    let b = parts.rest.b.fixed_view::<2, 1>(0, 0) * k;
    let c = parts.rest.c.fixed_view::<1, 2>(0, 0) * (k * k);
    let singular = LinalgError::Singular { what: "I - AT/2", condition: f64::INFINITY };
    let inverse = (Matrix2::identity() - a * half).try_inverse().ok_or(singular)?;
    Ok(Channel {
        slow: ((1.0 + pole * half) * shrink, gain * period_s * shrink * shrink, gain * half * shrink),
        a: inverse * (Matrix2::identity() + a * half),
        b: inverse * b * period_s,
        c: c * inverse,
        d: parts.rest.d[(0, 0)] * k * k + (c * inverse * b)[0] * half,
        slow_max,
    })
}

impl Hinf {
    /// Solves for `values` in the order of [`PARAMETERS`], the defaults where they are missing.
    ///
    /// # Errors
    /// When no γ is possible.
    pub fn new(airframe: &Airframe, period_s: f64, values: &[f64]) -> Result<Self, LinalgError> {
        let value = |i: usize| values.get(i).copied().unwrap_or(DEFAULTS[i]);
        let [outer_normal, tilt_normal] = NORMAL_RADPS;
        let outer_performance = Weight::performance(outer_normal, value(4), FLOOR);
        let outer = normalised(outer_performance, (value(5), value(6)), value(7))?;
        let tilt_performance = Weight::performance(tilt_normal, value(8), value(9));
        let tilt = normalised(tilt_performance, (value(10), value(11)), value(12))?;
        Ok(Self {
            horizontal: sampled(&outer, value(0) / outer_normal, period_s, SLOW_MAX[0])?,
            altitude: sampled(&outer, value(1) / outer_normal, period_s, SLOW_MAX[1])?,
            tilt: sampled(&tilt, value(2) / tilt_normal, period_s, SLOW_MAX[2])?,
            yaw: sampled(&outer, value(3) / outer_normal, period_s, SLOW_MAX[3])?,
            mass_kg: airframe.mass_kg,
            inertia_kgm2: airframe.inertia_kgm2,
            memories: [Memory::default(); 6],
            climbing_mps: None,
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

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        let angles = roll_pitch_yaw(&estimate.world_from_body);
        let error = setpoint.position_enu_m - estimate.position_enu_m;
        let limited = |v: f64, limit: f64| v.clamp(-limit, limit);
        let (short, [x, y, z, roll, pitch, turn]) = (self.short, &mut self.memories);

        let mut tilt = setpoint.roll_pitch_yaw_rad.xy();
        if loops.horizontal {
            let stands = short[ix::TORQUE_X] || short[ix::TORQUE_Y];
            let ax = self.horizontal.run(x, limited(error.x, ERROR_MAX[0]), stands) / GRAVITY_MPS2;
            let ay = self.horizontal.run(y, limited(error.y, ERROR_MAX[0]), stands) / GRAVITY_MPS2;
            let (sin, cos) = angles.z.sin_cos();
            tilt.x += limited(sin * ax - cos * ay, TILT_MAX_RAD);
            tilt.y += limited(cos * ax + sin * ay, TILT_MAX_RAD);
        } else {
            (*x, *y) = (Memory::default(), Memory::default());
        }

        let climbing_mps = setpoint.velocity_enu_mps.z;
        let changed = climbing_mps - self.climbing_mps.replace(climbing_mps).unwrap_or(climbing_mps);
        let thrust_n = if loops.altitude {
            let fed = if dt_s > 0.0 { limited(changed / dt_s, FED_FORWARD_MAX_MPS2) } else { 0.0 };
            let a = self.altitude.run(z, limited(error.z, ERROR_MAX[1]), short[ix::THRUST]) + fed;
            self.mass_kg * (GRAVITY_MPS2 + a) / (angles.x.cos() * angles.y.cos()).max(COS_TILT_MIN)
        } else {
            *z = Memory::default();
            self.mass_kg * GRAVITY_MPS2 * setpoint.throttle
        };

        let yaw = limited(wrap_pi(setpoint.roll_pitch_yaw_rad.z - angles.z), ERROR_MAX[2]);
        let held = short[ix::TORQUE_Z] || yaw.abs() > YAW_INTEGRATED_RAD;
        let turning = Vector3::new(
            self.tilt.run(roll, tilt.x - angles.x, short[ix::TORQUE_X]),
            self.tilt.run(pitch, tilt.y - angles.y, short[ix::TORQUE_Y]),
            self.yaw.run(turn, yaw, held),
        );
        Wrench { thrust_n: thrust_n.max(0.0), torque_flu_nm: turning.component_mul(&self.inertia_kgm2) }
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench) {
        let torque = asked.torque_flu_nm - given.torque_flu_nm;
        let weight = SHORTFALL * self.mass_kg * GRAVITY_MPS2;
        self.short = [
            (asked.thrust_n - given.thrust_n).abs() > weight,
            torque.x.abs() > SHORTFALL,
            torque.y.abs() > SHORTFALL,
            torque.z.abs() > SHORTFALL,
        ];
    }

    fn integrator(&self) -> [f64; 4] {
        // The slow parts, m/s² and rad/s².
        let [x, y, z, _, _, yaw] = &self.memories;
        [x.slow, y.slow, z.slow, yaw.slow]
    }

    fn reset(&mut self) {
        self.memories = [Memory::default(); 6];
        self.climbing_mps = None;
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

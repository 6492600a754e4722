//! LQG (\[Strategies\]): an LQR behind a steady-state Kalman filter.
//!
//! What flies ([`Lqg`]) has nine outputs (position, angles, rates of the estimate in the loop) and is sampled;
//! the four-output design of the source, with a phase margin of 5°, is [`Replica`].
//!
//! | symbol | meaning |
//! |---|---|
//! | F, F_e | regulator and estimator gains of \[Strategies\]: u = F x̂ + v r, F = −K, F_e = −L |
//! | v | −(C (A + BF)⁻¹ B)⁻¹ |
//! | x̂ | filter's state; here x y z vx vy vz roll pitch yaw p q r |
//!
//! Deviations from \[Strategies\]: the closed loop is [A, BF; −F_eC, A+BF+F_eC] (ERRATA 2), v without F_eC
//! (ERRATA 3; the literal one gives a gain of 25.66 in x and y).

use nalgebra::{DMatrix, SMatrix, SVector, Vector3};

use super::gains::{Gain, GainsError, lqr_gains};
use super::lqr_integral::{LqrIntegral, Weights};
use super::tuning::Parameter;
use super::{Controller, ControllerKind, Loops, Setpoint, Trim, Wrench};
use crate::estimate::{Estimate, Motion, filter::lqe};
use crate::frames::{from_roll_pitch_yaw, roll_pitch_yaw, wrap_pi};
use crate::linalg::{LinalgError, care, expm_with_integral};
use crate::model::airframe::Airframe;
use crate::model::discretize::zero_order_hold;
use crate::model::linearize::{hover, ix};
use crate::model::state_space::StateSpace;

/// Its parameters: densities of the process and measurement noise of the filter.
pub const PARAMETERS: [Parameter; 5] = [
    Parameter::new("acceleration_noise", "m/s^2/sqrt(Hz)", 1e-4, 100.0),
    Parameter::new("turn_noise", "rad/s^2/sqrt(Hz)", 1e-4, 100.0),
    Parameter::new("position_noise", "m/sqrt(Hz)", 1e-6, 1.0),
    Parameter::new("angle_noise", "rad/sqrt(Hz)", 1e-6, 1.0),
    Parameter::new("rate_noise", "rad/s/sqrt(Hz)", 1e-6, 1.0),
];
/// What they are without being told.
pub const DEFAULTS: [f64; 5] = [0.3, 1.0, 0.002, 0.0005, 0.001];

/// The outputs: x y z, roll pitch yaw, p q r.
pub const OUTPUTS: [usize; 9] = [ix::X, ix::Y, ix::Z, ix::ROLL, ix::PITCH, ix::YAW, ix::P, ix::Q, ix::R];

type State = SVector<f64, 12>;
type FilterGain = SMatrix<f64, 12, 9>;

/// The controller with nine outputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Lqg {
    regulator: LqrIntegral,
    a: SMatrix<f64, 12, 12>,
    b: SMatrix<f64, 12, 4>,
    /// L of the update, with the horizontal states and without.
    gains: [FilterGain; 2],
    weight_n: f64,
    /// Predicted for this tick, world frame; none before the first.
    predicted: Option<State>,
    /// Given since the last tick: thrust minus weight, torque.
    given: SVector<f64, 4>,
}

/// Process noise per second of white accelerations on the states `kept`.
fn process(kept: &[usize], acceleration: f64, turn: f64) -> DMatrix<f64> {
    DMatrix::from_fn(kept.len(), kept.len(), |r, c| match kept[r] {
        _ if r != c => 0.0,
        ix::VX..=ix::VZ => acceleration * acceleration,
        ix::P..=ix::R => turn * turn,
        _ => 0.0,
    })
}

/// Rows of the identity that pick `outputs` out of the states `kept`.
fn selection(outputs: &[usize], kept: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(outputs.len(), kept.len(), |r, c| if kept[c] == outputs[r] { 1.0 } else { 0.0 })
}

/// L at ticks of `period_s` for the states `kept`; zero elsewhere.
fn filter_gain(
    airframe: &Airframe,
    period_s: f64,
    noise: &[f64; 5],
    kept: &[usize],
) -> Result<FilterGain, LinalgError> {
    let linear = hover(airframe);
    let n = kept.len();
    let a = DMatrix::from_fn(n, n, |r, c| linear.a[(kept[r], kept[c])]);
    let outputs: Vec<usize> = OUTPUTS.into_iter().filter(|o| kept.contains(o)).collect();
    let [acceleration, turn, position, angle, rate] = *noise;
    let density = |output: usize| match output {
        ix::X..=ix::Z => position,
        ix::ROLL..=ix::YAW => angle,
        _ => rate,
    };
    // A density on samples T apart: variance density²/T.
    let r = DMatrix::from_fn(outputs.len(), outputs.len(), |i, j| {
        if i == j { density(outputs[i]).powi(2) / period_s } else { 0.0 }
    });
    // ∫₀ᵀ e^{As} Q e^{Aᵀs} ds.
    let (_, q) = expm_with_integral(&a.transpose(), &process(kept, acceleration, turn), period_s)?;
    let sampled = zero_order_hold(&a, &DMatrix::zeros(n, 1), period_s)?;
    let found = lqe::discrete(&sampled.a, &selection(&outputs, kept), &q, &r)?.gain;
    let mut full = FilterGain::zeros();
    for (row, &state) in kept.iter().enumerate() {
        for (column, output) in outputs.iter().enumerate() {
            if let Some(at) = OUTPUTS.iter().position(|o| o == output) {
                full[(state, at)] = found[(row, column)];
            }
        }
    }
    Ok(full)
}

/// Position and velocity turned by `angle` about the vertical.
fn turned(x: &State, angle: f64) -> State {
    let (sin, cos) = angle.sin_cos();
    let mut out = *x;
    for at in [ix::X, ix::VX] {
        out[at] = cos * x[at] - sin * x[at + 1];
        out[at + 1] = sin * x[at] + cos * x[at + 1];
    }
    out
}

impl Lqg {
    /// Solves regulator and filter; `values` in the order of [`PARAMETERS`], defaults where missing.
    ///
    /// # Errors
    /// When one of the Riccati equations has no usable solution.
    pub fn new(airframe: &Airframe, period_s: f64, weights: &Weights, values: &[f64]) -> Result<Self, GainsError> {
        let mut weights = *weights;
        weights.state[12..].fill(0.0);
        let [k, k_attitude] = lqr_gains(airframe, period_s, &weights)?;
        let noise: [f64; 5] = std::array::from_fn(|i| values.get(i).copied().unwrap_or(DEFAULTS[i]));
        let everything: Vec<usize> = (0..12).collect();
        let attitude: Vec<usize> =
            everything.iter().copied().filter(|i| ![ix::X, ix::Y, ix::VX, ix::VY].contains(i)).collect();
        let linear = hover(airframe);
        let (a, b) =
            (DMatrix::from_fn(12, 12, |r, c| linear.a[(r, c)]), DMatrix::from_fn(12, 4, |r, c| linear.b[(r, c)]));
        let sampled = zero_order_hold(&a, &b, period_s)?;
        Ok(Self {
            regulator: LqrIntegral::new(airframe, k, k_attitude),
            a: SMatrix::from_fn(|r, c| sampled.a[(r, c)]),
            b: SMatrix::from_fn(|r, c| sampled.b[(r, c)]),
            gains: [
                filter_gain(airframe, period_s, &noise, &everything)?,
                filter_gain(airframe, period_s, &noise, &attitude)?,
            ],
            weight_n: airframe.weight_n(),
            predicted: None,
            given: SVector::zeros(),
        })
    }

    /// What it multiplies with: K, K without the horizontal loop, and both filter gains, row-major.
    pub fn each_value(&self, mut take: impl FnMut(f64)) {
        self.regulator.gains().iter().for_each(|k| k.transpose().iter().for_each(|v| take(*v)));
        self.gains.iter().for_each(|l| l.transpose().iter().for_each(|v| take(*v)));
    }

    /// K of the regulator, and K without the horizontal loop.
    pub fn gains(&self) -> [&Gain; 2] {
        self.regulator.gains()
    }

    /// The law for small errors. x̂ is the filter's prediction, in the heading frame.
    pub fn linear(&self, horizontal: bool) -> StateSpace {
        let which = usize::from(!horizontal);
        let (k, l) = (self.regulator.gains()[which], &self.gains[which]);
        let kept: Vec<usize> = (0..12).filter(|i| horizontal || ![ix::X, ix::Y, ix::VX, ix::VY].contains(i)).collect();
        let k = DMatrix::from_fn(4, 12, |r, c| k[(r, c)]);
        let l = DMatrix::from_fn(12, 9, |r, c| l[(r, c)]);
        let c = selection(&OUTPUTS, &(0..12).collect::<Vec<_>>());
        let (a, b) = (DMatrix::from_fn(12, 12, |r, c| self.a[(r, c)]), DMatrix::from_fn(12, 4, |r, c| self.b[(r, c)]));
        let correct = DMatrix::identity(12, 12) - &l * &c;
        let closed = a - b * &k;
        let whole = StateSpace { a: &closed * &correct, b: &closed * &l * &c, c: -&k * correct, d: -&k * l * c };
        StateSpace {
            a: whole.a.select_rows(&kept).select_columns(&kept),
            b: whole.b.select_rows(&kept),
            c: whole.c.select_columns(&kept),
            d: whole.d,
        }
    }

    /// Corrects the prediction with `estimate`'s outputs; the estimate as the filter has it.
    fn filtered(&mut self, estimate: &Estimate, loops: Loops) -> Estimate {
        let angles = roll_pitch_yaw(&estimate.world_from_body);
        let motion = estimate.motion_or_rest();
        let mut measured = State::zeros();
        for (at, v) in [
            (ix::X, motion.position_enu_m),
            (ix::VX, motion.velocity_enu_mps),
            (ix::ROLL, angles),
            (ix::P, estimate.body_rates_radps),
        ] {
            measured.fixed_rows_mut::<3>(at).copy_from(&v);
        }
        // Velocities count at the start only, where they are as good as any other guess.
        let before = self.predicted.unwrap_or(measured);
        let mut innovation = turned(&(measured - before), -angles.z);
        innovation[ix::YAW] = wrap_pi(innovation[ix::YAW]);
        let seen = SVector::<f64, 9>::from_fn(|i, _| innovation[OUTPUTS[i]]);
        let gain = &self.gains[usize::from(!loops.horizontal)];
        let mut x = before + turned(&(gain * seen), angles.z);
        x[ix::YAW] = wrap_pi(x[ix::YAW]);
        if !loops.horizontal {
            // Not observed, not used.
            for at in [ix::X, ix::Y, ix::VX, ix::VY] {
                x[at] = measured[at];
            }
        }
        self.predicted = Some(x);
        let part = |at: usize| Vector3::new(x[at], x[at + 1], x[at + 2]);
        Estimate {
            motion: Some(Motion { position_enu_m: part(ix::X), velocity_enu_mps: part(ix::VX), ..motion }),
            world_from_body: from_roll_pitch_yaw(&part(ix::ROLL)),
            body_rates_radps: part(ix::P),
            ..Estimate::default()
        }
    }
}

impl Controller for Lqg {
    fn kind(&self) -> ControllerKind {
        ControllerKind::Lqg
    }

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        let filtered = self.filtered(estimate, loops);
        self.regulator.control(&filtered, setpoint, loops, dt_s)
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        self.regulator.applied(asked, given, support_n);
        let Some(x) = self.predicted else { return };
        let torque = given.torque_flu_nm;
        // What holds the trim is no acceleration.
        let held = self.regulator.trim();
        let lift = given.thrust_n * x[ix::ROLL].cos() * x[ix::PITCH].cos() - self.weight_n - held.thrust_n;
        self.given = SVector::from([lift, torque.x, torque.y, torque.z - held.yaw_torque_nm]);
        // The model holds in the heading frame.
        let yaw = x[ix::YAW];
        let mut next = turned(&(self.a * turned(&x, -yaw) + self.b * self.given), yaw);
        next[ix::YAW] = wrap_pi(next[ix::YAW]);
        self.predicted = next.iter().all(|v| v.is_finite()).then_some(next);
    }

    fn integrator(&self) -> [f64; 4] {
        [0.0; 4]
    }

    fn reset(&mut self) {
        self.regulator.reset();
        self.predicted = None;
        self.given.fill(0.0);
    }

    fn trim(&self) -> Trim {
        self.regulator.trim()
    }

    fn take_over(&mut self, trim: &Trim) {
        self.regulator.take_over(trim);
    }
}

/// The continuous LQG of \[Strategies\] for any outputs, noise and weights: what its chapter plots.
#[derive(Debug, Clone, PartialEq)]
pub struct Replica {
    /// The plant: its outputs are those measured.
    pub plant: StateSpace,
    /// u = F x̂ + v r.
    pub f: DMatrix<f64>,
    /// x̂' = (A + BF + F_eC) x̂ + B v r − F_e y.
    pub fe: DMatrix<f64>,
}

impl Replica {
    /// Solves both Riccati equations: Q, R of the regulator, Q_e, R_e of the estimator.
    ///
    /// # Errors
    /// When one has no stabilising solution.
    pub fn new(
        plant: StateSpace,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        qe: &DMatrix<f64>,
        re: &DMatrix<f64>,
    ) -> Result<Self, LinalgError> {
        let f = -care(&plant.a, &plant.b, q, r)?.k;
        let fe = -lqe::continuous(&plant.a, &plant.c, qe, re)?.gain;
        Ok(Self { plant, f, fe })
    }

    /// As printed: C picks x, y, z, yaw; Q = CᵀC, R = 0.7 I, Q_e = BBᵀ, R_e = 0.9 I.
    ///
    /// # Errors
    /// When a Riccati equation has no stabilising solution.
    pub fn printed(airframe: &Airframe) -> Result<Self, LinalgError> {
        let plant = super::hinf::strategies::whole_plant(airframe);
        let (q, qe) = (plant.c.transpose() * &plant.c, &plant.b * plant.b.transpose());
        let identity = DMatrix::<f64>::identity(4, 4);
        Self::new(plant, &q, &(&identity * 0.7), &qe, &(identity * 0.9))
    }

    /// v = −(C (A + BF)⁻¹ B)⁻¹ for the outputs `c` that have a reference.
    ///
    /// # Errors
    /// When the loop has no such gain.
    pub fn reference_gain(&self, c: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
        self.gain_of(c, &(&self.plant.a + &self.plant.b * &self.f))
    }

    /// v with F_eC in it, as printed: wrong (ERRATA 3).
    ///
    /// # Errors
    /// When the loop has no such gain.
    pub fn literal_reference_gain(&self, c: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
        self.gain_of(c, &(&self.plant.a + &self.plant.b * &self.f + &self.fe * &self.plant.c))
    }

    fn gain_of(&self, c: &DMatrix<f64>, a: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
        let singular = LinalgError::Singular { what: "A + BF", condition: f64::INFINITY };
        let inner = a.clone().lu().solve(&self.plant.b).ok_or(singular)?;
        Ok(-crate::linalg::inverse("C (A + BF)^-1 B", &(c * inner))?)
    }

    /// From measurements to inputs.
    pub fn controller(&self) -> StateSpace {
        let StateSpace { a, b, c, .. } = &self.plant;
        StateSpace {
            a: a + b * &self.f + &self.fe * c,
            b: -&self.fe,
            c: self.f.clone(),
            d: DMatrix::zeros(self.f.nrows(), c.nrows()),
        }
    }

    /// [A, BF; −F_eC, A + BF + F_eC], outputs y. The reference enters through `v` (u = F x̂ + v r), or, without
    /// it, subtracted from the measurement.
    pub fn closed_loop(&self, v: Option<&DMatrix<f64>>) -> StateSpace {
        let StateSpace { a, b, c, .. } = &self.plant;
        let n = a.nrows();
        let mut whole = DMatrix::zeros(2 * n, 2 * n);
        whole.view_mut((0, 0), (n, n)).copy_from(a);
        whole.view_mut((0, n), (n, n)).copy_from(&(b * &self.f));
        whole.view_mut((n, 0), (n, n)).copy_from(&(-&self.fe * c));
        whole.view_mut((n, n), (n, n)).copy_from(&(a + b * &self.f + &self.fe * c));
        let references = v.map_or(c.nrows(), DMatrix::ncols);
        let mut input = DMatrix::zeros(2 * n, references);
        match v {
            Some(v) => {
                input.view_mut((0, 0), (n, references)).copy_from(&(b * v));
                input.view_mut((n, 0), (n, references)).copy_from(&(b * v));
            }
            None => input.view_mut((n, 0), (n, references)).copy_from(&self.fe),
        }
        let mut output = DMatrix::zeros(c.nrows(), 2 * n);
        output.view_mut((0, 0), c.shape()).copy_from(c);
        let d = DMatrix::zeros(c.nrows(), references);
        StateSpace { a: whole, b: input, c: output, d }
    }
}

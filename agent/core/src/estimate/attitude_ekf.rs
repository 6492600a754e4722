//! Attitude EKF: error-state Kalman filter on gyroscope, accelerometer and magnetometer that calibrates them as it goes.
//!
//! What VQF leaves in heading is mostly not noise: the magnetometer lags the gyroscope by 10 to 15 ms, the gyroscope's
//! scale and misalignment are off by 0.1 to 0.4 %, and iron on the vehicle adds a constant field. All of it is
//! estimated here, beside the biases. That level means no motion on average replaces VQF's low-pass: the horizontal
//! velocity, leaking with a time constant, is measured to be zero (a vehicle that stays in a room).
//!
//! 1. Each sample is integrated into attitude and velocity, and P propagated (`covariance.rs`).
//! 2. The mean specific force of the first 0.3 s sets the tilt, that of the field its direction; a filter that finds
//!    itself far from upright starts again (`start.rs`).
//! 3. Each fourth sample corrects: velocity zero, the bias at rest by the slow rate, and the magnetometer, which corrects
//!    neither tilt nor velocity (`field.rs`).
//!
//! The frame L is level; its yaw follows the gyroscope and is no error state. Heading is the direction of the field h in
//! it, so whatever turns L turns h backwards.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | q, R | L ← body | |
//! | γ = g − b | gyroscope less its bias | rad/s |
//! | ω = (I − S) γ | angular rate; S scale and misalignment | rad/s |
//! | f_w = R (a − b_a) | specific force in L, less the accelerometer's bias | m/s² |
//! | v | horizontal velocity in L | m/s |
//! | h | field in L | µT |
//! | m_b | hard iron in the body frame | µT |
//! | τ | lag of the magnetometer behind the gyroscope | s |
//! | δ | heading of L: the field points to magnetic north | rad |
//! | P | covariance of the 26 error states | |

mod covariance;
mod field;
mod start;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use self::covariance::{Covariance, ErrorState, Propagation, ix};
use self::field::{Gate, Sample};
use self::start::Start;
use super::EstimatorKind;
use super::attitude::{AttitudeEstimator, AttitudeFilter};
use super::filter::kalman;
use super::vqf::rest::{Period, Rest};
use crate::frames::wrap_pi;

/// One degree, rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// Nominal time between samples, s; the real one is measured.
const PERIOD_S: f64 = 0.005;
/// Samples from one correction to the next.
const CORRECT_EVERY: u32 = 4;
/// Time constant with which velocity leaks, s.
const VELOCITY_LEAK_S: f64 = 8.0;
/// Velocity, one-sigma, m/s …
const VELOCITY_SIGMA_MPS: f64 = 0.4;
/// … correlated over this, s.
const VELOCITY_CORRELATION_S: f64 = 1.0;
/// Velocity at rest, one-sigma, m/s …
const REST_VELOCITY_SIGMA_MPS: f64 = 0.03;
/// … correlated over this, s.
const REST_CORRELATION_S: f64 = 0.5;
/// Slow rate at rest less the bias, one-sigma over one second, rad/s.
const REST_RATE_SIGMA_RADPS: f64 = 0.05 * DEGREE;
/// The specific force is taken to point up at least this much, m/s²: it makes the upside-down solution unstable.
const FORCE_UP_MIN_MPS2: f64 = 0.3 * 9.81;

/// What is estimated beside P.
#[derive(Debug, Clone, PartialEq)]
struct State {
    /// q.
    level_from_body: UnitQuaternion<f64>,
    /// v.
    velocity_mps: Vector2<f64>,
    /// S.
    gyro_matrix: Matrix3<f64>,
    /// b_a.
    accel_bias_mps2: Vector3<f64>,
    /// b.
    gyro_bias_radps: Vector3<f64>,
    /// h.
    field_ut: Vector3<f64>,
    /// m_b.
    hard_iron_ut: Vector3<f64>,
    /// τ.
    lag_s: f64,
}

impl State {
    fn new() -> Self {
        Self {
            level_from_body: UnitQuaternion::identity(),
            velocity_mps: Vector2::zeros(),
            gyro_matrix: Matrix3::zeros(),
            accel_bias_mps2: Vector3::zeros(),
            gyro_bias_radps: Vector3::zeros(),
            field_ut: Vector3::zeros(),
            hard_iron_ut: Vector3::zeros(),
            lag_s: 0.0,
        }
    }

    /// ω of a gyroscope sample.
    fn rate_radps(&self, gyro: &Vector3<f64>) -> Vector3<f64> {
        let gamma = gyro - self.gyro_bias_radps;
        gamma - self.gyro_matrix * gamma
    }

    /// Takes the correction `x`; the rotation of L that is in it.
    fn correct(&mut self, x: &ErrorState) -> UnitQuaternion<f64> {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(x[ix::TILT], x[ix::TILT + 1], 0.0));
        self.level_from_body = tilt * self.level_from_body;
        self.velocity_mps += x.fixed_rows::<2>(ix::VELOCITY);
        self.gyro_matrix += Matrix3::from_fn(|i, j| x[ix::GYRO_MATRIX + 3 * i + j]);
        self.accel_bias_mps2 += x.fixed_rows::<3>(ix::ACCEL_BIAS);
        self.gyro_bias_radps += x.fixed_rows::<3>(ix::GYRO_BIAS);
        self.field_ut += x.fixed_rows::<3>(ix::FIELD);
        self.hard_iron_ut += x.fixed_rows::<3>(ix::HARD_IRON);
        self.lag_s += x[ix::LAG];
        tilt
    }
}

/// The filter proper: one gyroscope, one accelerometer, one magnetometer.
#[derive(Debug, Clone)]
pub struct AttitudeEkf {
    declination_rad: f64,
    state: State,
    p: Covariance,
    start: Start,
    period: Period,
    rest: Rest,
    gate: Gate,
    /// Samples and time since the last correction.
    waiting: (u32, f64),
    /// The same since the last magnetometer sample that was used.
    field_waiting: (u32, f64),
}

impl AttitudeEkf {
    /// Level, heading zero, until the first samples; `declination_rad` is magnetic declination, east positive.
    pub fn new(declination_rad: f64) -> Self {
        Self {
            declination_rad,
            state: State::new(),
            p: covariance::prior(),
            start: Start::default(),
            period: Period::new(PERIOD_S),
            rest: Rest::new(PERIOD_S),
            gate: Gate::default(),
            waiting: (0, 0.0),
            field_waiting: (0, 0.0),
        }
    }

    /// One IMU sample, `dt_s` after the one before; samples that are not finite are skipped.
    pub fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>) {
        if !(dt_s >= 0.0 && dt_s.is_finite() && (gyro + force).iter().all(|x| x.is_finite())) {
            return;
        }
        let field = field.filter(|m| m.iter().all(|x| x.is_finite()));
        if self.period.take(dt_s) {
            self.rest.retune(self.period.used_s());
        }
        self.rest.push_gyro(gyro);
        self.rest.push_force(dt_s, force);

        let state = &mut self.state;
        let gamma = gyro - state.gyro_bias_radps;
        let rate = state.rate_radps(gyro);
        state.level_from_body *= UnitQuaternion::from_scaled_axis(rate * dt_s);
        state.level_from_body.renormalize_fast();
        let rotation = state.level_from_body.to_rotation_matrix().into_inner();
        let force_world = rotation * (force - state.accel_bias_mps2);
        state.velocity_mps += dt_s * (force_world.xy() - state.velocity_mps / VELOCITY_LEAK_S);

        if self.start.push(dt_s, &force_world) {
            covariance::restart(&mut self.p);
        }
        if self.start.lasts() {
            self.start.settle(&mut self.state, field);
            return;
        }
        let force_up_mps2 = force_world.z.max(FORCE_UP_MIN_MPS2);
        let field_ut = self.state.field_ut;
        covariance::propagate(&mut self.p, &Propagation { dt_s, rotation, gamma, rate, force_up_mps2, field_ut });
        self.correct(dt_s, &rate, &rotation, field);
        if !self.p.diagonal().iter().all(|variance| *variance >= 0.0) {
            // Rounding, or samples beyond any sense: the calibration is not worth keeping.
            *self = Self::new(self.declination_rad);
        }
    }

    /// Pseudo-velocity, rest and the magnetometer, where they are due.
    fn correct(&mut self, dt_s: f64, rate: &Vector3<f64>, rotation: &Matrix3<f64>, field: Option<&Vector3<f64>>) {
        for waiting in [&mut self.waiting, &mut self.field_waiting] {
            *waiting = (waiting.0 + 1, waiting.1 + dt_s);
        }
        let mut x = ErrorState::zeros();
        let due = self.waiting.0 >= CORRECT_EVERY && self.waiting.1 > 0.0;
        if due {
            self.correct_motion(&mut x);
        }
        let field = field.filter(|_| self.field_waiting.0 >= CORRECT_EVERY && self.field_waiting.1 > 0.0);
        if let Some(field) = field {
            if self.state.field_ut == Vector3::zeros() {
                // None came during the start.
                self.state.field_ut = rotation * (field - self.state.hard_iron_ut);
            }
            let elapsed_s = std::mem::take(&mut self.field_waiting).1;
            let moving = !self.rest.holds();
            let sample = Sample { field_ut: field, rotation, rate, moving, t: elapsed_s };
            self.gate.correct(&mut self.p, &mut x, &self.state, &sample);
        }
        if due || field.is_some() {
            let tilt = self.state.correct(&x);
            self.start.turn(&tilt);
        }
    }

    /// The vehicle is going nowhere on average; at rest the gyroscope shows its bias.
    fn correct_motion(&mut self, x: &mut ErrorState) {
        let t = std::mem::take(&mut self.waiting).1;
        let r = if self.rest.holds() {
            REST_VELOCITY_SIGMA_MPS.powi(2) * (REST_CORRELATION_S / t).max(1.0)
        } else {
            2.0 * VELOCITY_SIGMA_MPS.powi(2) * VELOCITY_CORRELATION_S / t
        };
        for i in 0..2 {
            let h = covariance::unit(ix::VELOCITY + i);
            correct_scalar(&mut self.p, x, &h, -self.state.velocity_mps[i], r, 0);
        }
        if let Some(slow) = self.rest.rate_at_rest() {
            let innovation = slow - self.state.gyro_bias_radps;
            for i in 0..3 {
                let h = covariance::unit(ix::GYRO_BIAS + i);
                correct_scalar(&mut self.p, x, &h, innovation[i], REST_RATE_SIGMA_RADPS.powi(2) / t, 0);
            }
        }
    }

    /// World ENU ← body.
    pub fn world_from_body(&self) -> UnitQuaternion<f64> {
        let h = &self.state.field_ut;
        let heading = h.x.atan2(h.y) - self.declination_rad;
        UnitQuaternion::from_scaled_axis(Vector3::z() * heading) * self.state.level_from_body
    }

    /// Gyroscope bias, rad/s.
    pub fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.state.gyro_bias_radps
    }

    /// Scale and misalignment of the gyroscope, S: the rate is (I − S) times the sample less its bias.
    pub fn gyro_matrix(&self) -> Matrix3<f64> {
        self.state.gyro_matrix
    }

    /// Hard iron that moves with the vehicle, body frame, µT.
    pub fn hard_iron_ut(&self) -> Vector3<f64> {
        self.state.hard_iron_ut
    }

    /// How far the magnetometer lags behind the gyroscope, s.
    pub fn magnetometer_lag_s(&self) -> f64 {
        self.state.lag_s
    }

    /// The filter for the same samples backwards: gyroscope samples have the other sign. It starts from this attitude
    /// and calibration, as uncertain of both as at the first sample.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let state = State {
            velocity_mps: -self.state.velocity_mps,
            gyro_bias_radps: -self.state.gyro_bias_radps,
            lag_s: -self.state.lag_s,
            ..self.state.clone()
        };
        Self {
            state,
            p: covariance::prior(),
            rest: Rest::new(self.period.used_s()),
            waiting: (0, 0.0),
            field_waiting: (0, 0.0),
            ..self.clone()
        }
    }

    /// One-sigma of the heading, rad: of the direction of h.
    pub fn heading_sigma_rad(&self) -> f64 {
        let h = self.state.field_ut.xy();
        let across = Vector2::new(h.y, -h.x) / h.norm_squared().max(1e-9);
        let variance = across.dot(&(self.p.fixed_view::<2, 2>(ix::FIELD, ix::FIELD) * across));
        variance.max(0.0).sqrt()
    }

    /// One-sigma of the tilt about the two level axes, rad.
    pub fn tilt_sigma_rad(&self) -> f64 {
        self.p.fixed_view::<2, 2>(ix::TILT, ix::TILT).trace().max(0.0).sqrt()
    }
}

/// One scalar y − ŷ = h δx + noise of variance `r`, for what is left of it after the correction `x` so far. The states
/// before `first` are considered, not corrected (Schmidt): their gain is zero.
fn correct_scalar(p: &mut Covariance, x: &mut ErrorState, h: &ErrorState, innovation: f64, r: f64, first: usize) {
    let (ph, s) = kalman::innovation_variance(p, h, r);
    let innovation = innovation - h.dot(x);
    if !(s > 0.0 && innovation.is_finite()) {
        return;
    }
    let mut k = ph / s;
    k.rows_mut(0, first).fill(0.0);
    kalman::correct_scalar(p, h, r, &k);
    *x += k * innovation;
}

/// The filter as an estimator.
pub type AttitudeEkfEstimator = AttitudeEstimator<AttitudeEkf>;

impl AttitudeFilter for AttitudeEkf {
    const KIND: EstimatorKind = EstimatorKind::AttitudeEkf;

    fn with_declination(declination_rad: f64) -> Self {
        Self::new(declination_rad)
    }

    fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>) {
        Self::push(self, dt_s, gyro, force, field);
    }

    fn world_from_body(&self) -> UnitQuaternion<f64> {
        Self::world_from_body(self)
    }

    fn gyro_bias_radps(&self) -> Vector3<f64> {
        Self::gyro_bias_radps(self)
    }

    fn rate_radps(&self, gyro: &Vector3<f64>) -> Vector3<f64> {
        self.state.rate_radps(gyro)
    }

    fn heading_disagreement_rad(&self) -> f64 {
        let (y, h) = (self.gate.measured_ut(), &self.state.field_ut);
        wrap_pi(y.x.atan2(y.y) - h.x.atan2(h.y))
    }

    fn field_disturbed(&self) -> bool {
        self.gate.disturbed()
    }
}

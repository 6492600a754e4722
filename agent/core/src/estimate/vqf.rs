//! VQF: attitude from gyroscope, accelerometer and magnetometer alone, the independent watchdog.
//!
//! After D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and
//! magnetic disturbance rejection", Information Fusion 91 (2023), written anew from its description. It
//! shares no state, no position sensor and, when given one IMU to use, no IMU with the filter in the loop:
//! an attack on heights, GNSS or motion capture cannot reach it.
//!
//! 1. The gyroscope is integrated: almost inertial frame ← body.
//! 2. The specific force, turned into that frame, is low-passed over several seconds: accelerations of a
//!    vehicle that stays in a room average out, and turning does not smear. Its direction corrects tilt.
//! 3. The magnetometer corrects heading alone (`vqf/heading.rs`).
//! 4. Gyroscope bias: from the corrections in motion, from the gyroscope itself at rest (`vqf/bias.rs`).
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | q_g | integrated gyroscope | |
//! | q_a | tilt correction, almost inertial → level | |
//! | δ | heading of the level frame | rad |
//! | b | gyroscope bias and its covariance P | rad/s |
//! | τ | time constants | s |

mod bias;
mod heading;
pub(super) mod rest;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};

use self::bias::Bias;
use self::heading::Heading;
use self::rest::{Period, Rest};
use super::EstimatorKind;
use super::attitude::{AttitudeEstimator, AttitudeFilter, levelling};
use super::filter::low_pass::LowPass;

/// One degree, rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Low-pass of the specific force, s (this and what follows: the paper's defaults).
pub const TAU_ACCEL_S: f64 = 3.0;
/// Heading correction, s.
const TAU_MAG_S: f64 = 9.0;
/// Gyroscope bias at start, one-sigma, rad/s.
const BIAS_SIGMA_RADPS: f64 = 0.5 * DEGREE;
/// Time in which an uncorrected bias becomes 0.1 °/s uncertain, s.
const BIAS_FORGETTING_S: f64 = 100.0;
/// Largest bias, rad/s.
const BIAS_LIMIT_RADPS: f64 = 2.0 * DEGREE;

/// What differs from use to use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VqfOptions {
    /// Nominal time between IMU samples, s; what really arrives is measured and used.
    pub period_s: f64,
    /// Use the magnetometer.
    pub use_mag: bool,
    /// Magnetic declination, rad, east positive.
    pub declination_rad: f64,
}

impl Default for VqfOptions {
    fn default() -> Self {
        Self { period_s: 0.005, use_mag: true, declination_rad: 0.0 }
    }
}

/// The filter proper: one gyroscope, one accelerometer, one magnetometer.
#[derive(Debug, Clone)]
pub struct Vqf {
    options: VqfOptions,
    period: Period,
    /// q_g.
    inertial_from_body: UnitQuaternion<f64>,
    /// q_a.
    level_from_inertial: UnitQuaternion<f64>,
    force: LowPass<3>,
    bias: Bias,
    rest: Rest,
    heading: Heading,
}

impl Vqf {
    /// Level, heading zero, until the first samples.
    pub fn new(options: VqfOptions) -> Self {
        let t = options.period_s;
        Self {
            options,
            period: Period::new(t),
            inertial_from_body: UnitQuaternion::identity(),
            level_from_inertial: UnitQuaternion::identity(),
            force: LowPass::new(TAU_ACCEL_S, t),
            bias: Bias::new(t),
            rest: Rest::new(t),
            heading: Heading::new(t),
        }
    }

    /// One IMU sample, `dt_s` after the one before.
    pub fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>) {
        if self.period.take(dt_s) {
            let t = self.period.used_s();
            self.force.retune(t);
            self.bias.retune(t);
            self.rest.retune(t);
        }
        self.push_gyro(dt_s, gyro);
        self.push_force(dt_s, force);
        self.heading.wait(dt_s);
        if let Some(field) = field.filter(|_| self.options.use_mag) {
            let level = self.level_from_inertial * self.inertial_from_body * field;
            self.heading.push(&level, self.rest.slow_rate(), TAU_MAG_S);
        }
    }

    /// World ENU ← body.
    pub fn world_from_body(&self) -> UnitQuaternion<f64> {
        let heading = self.heading.delta_rad() - self.options.declination_rad;
        UnitQuaternion::from_scaled_axis(Vector3::z() * heading) * self.level_from_inertial * self.inertial_from_body
    }

    /// Gyroscope bias, rad/s.
    pub fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.bias.radps()
    }

    /// One-sigma of the bias, rad/s.
    pub fn gyro_bias_sigma_radps(&self) -> Vector3<f64> {
        self.bias.sigma_radps()
    }

    /// Is the field unlike the reference field?
    pub fn field_disturbed(&self) -> bool {
        self.heading.disturbed()
    }

    /// Magnetic heading less estimated heading at the last magnetometer sample, rad.
    pub fn heading_disagreement_rad(&self) -> f64 {
        self.heading.disagreement_rad()
    }

    /// Nothing has moved for a while.
    pub fn at_rest(&self) -> bool {
        self.rest.holds()
    }

    fn push_gyro(&mut self, dt_s: f64, gyro: &Vector3<f64>) {
        self.rest.push_gyro(gyro);
        self.inertial_from_body *= UnitQuaternion::from_scaled_axis((gyro - self.bias.radps()) * dt_s);
        self.inertial_from_body.renormalize_fast();
    }

    fn push_force(&mut self, dt_s: f64, force: &Vector3<f64>) {
        if force.norm_squared() == 0.0 || dt_s <= 0.0 {
            return;
        }
        self.rest.push_force(dt_s, force);
        let up = self.level_from_inertial * self.force.push(self.inertial_from_body * force);
        let Some(up) = up.try_normalize(1e-9) else { return };
        self.level_from_inertial = levelling(&up) * self.level_from_inertial;
        self.level_from_inertial.renormalize_fast();
        let rotation = (self.level_from_inertial * self.inertial_from_body).to_rotation_matrix().into_inner();
        self.bias.update(&up, &rotation, self.rest.rate_at_rest(), self.period.used_s());
    }
}

/// The filter as an estimator.
pub type VqfEstimator = AttitudeEstimator<Vqf>;

impl AttitudeFilter for Vqf {
    const KIND: EstimatorKind = EstimatorKind::Vqf;

    fn with_declination(declination_rad: f64) -> Self {
        Self::new(VqfOptions { declination_rad, ..VqfOptions::default() })
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

    fn heading_disagreement_rad(&self) -> f64 {
        Self::heading_disagreement_rad(self)
    }

    fn field_disturbed(&self) -> bool {
        Self::field_disturbed(self)
    }
}

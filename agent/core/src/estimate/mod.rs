//! Estimators: the state of the vehicle from the samples received and the motor commands applied.
//!
//! Several run side by side in a bank (`bank.rs`); one of them is in the loop. None of them
//! can tell whether an attack is on, nor see the truth.

pub mod aiding;
pub mod bank;
pub mod complementary;
pub mod constant_acceleration;
pub mod ekf_bias;
pub mod fdir;
pub mod filter;
pub mod secure;
pub mod twelve_state;
pub mod vqf;
pub mod yaw_mixture;

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::{ids::SensorId, time::FlightTime};

pub use plumbline_proto::v1::{Channel, Health};

use crate::sensor::measure::Kinematics;
use crate::sensor::{MAX_HEIGHTS, MAX_IMUS, SensorFrame};
use crate::types::{EstimatorKind, MotorCommand};

/// Most residuals one step can produce: five IMUs with seven channels, and every other sensor.
pub const MAX_RESIDUALS: usize = 64;

/// Residuals of one step.
pub type Residuals = ArrayVec<Residual, MAX_RESIDUALS>;

/// Median of the readings of one kind of sensor, the mean of the middle two for an even number; NaN of nothing.
pub(crate) fn median(readings: impl Iterator<Item = f64>) -> f64 {
    const MOST: usize = if MAX_IMUS > MAX_HEIGHTS { MAX_IMUS } else { MAX_HEIGHTS };
    let mut sorted: ArrayVec<f64, MOST> = readings.take(MOST).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 { f64::NAN } else { 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]) }
}

/// Innovation of one scalar measurement, kept per sensor instance and never merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// The sensor.
    pub sensor: SensorId,
    /// Which of its scalars.
    pub channel: Channel,
    /// y − ŷ before the update, in the channel's unit.
    pub innovation: f64,
    /// One-sigma predicted for it.
    pub sigma: f64,
    /// |innovation| above this is rejected.
    pub gate: f64,
    /// Was it used?
    pub accepted: bool,
}

impl Residual {
    /// The innovation of one scalar against its `gate` in sigmas.
    pub fn gated(sensor: SensorId, channel: Channel, innovation: f64, sigma: f64, gate: f64) -> Self {
        let gate = gate * sigma;
        Self { sensor, channel, innovation, sigma, gate, accepted: innovation.abs() <= gate }
    }

    /// |innovation| / gate: above 1 is rejected.
    pub fn ratio(&self) -> f64 {
        self.innovation.abs() / self.gate
    }
}

/// What an estimator knows after one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Time of the frame it belongs to.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
    /// Angular rate in the body frame FLU, bias removed, rad/s.
    pub body_rates_radps: Vector3<f64>,
    /// Accelerometer bias, m/s²; `None` where it is not estimated, here and below.
    pub accel_bias_mps2: Option<Vector3<f64>>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_radps: Option<Vector3<f64>>,
    /// One-sigma of the position, m.
    pub position_sigma_m: Option<Vector3<f64>>,
    /// One-sigma of the velocity, m/s.
    pub velocity_sigma_mps: Option<Vector3<f64>>,
    /// One-sigma of the attitude error about the world axes, rad.
    pub attitude_sigma_rad: Option<Vector3<f64>>,
    /// Is the horizontal position known (GNSS or motion capture lately)?
    pub horizontal_known: bool,
    /// Is the altitude known (lasers, barometer, motion capture or GNSS lately)?
    pub altitude_known: bool,
    /// Can it be trusted?
    pub health: Health,
    /// Residuals of the samples used in this step.
    pub residuals: Residuals,
}

impl Estimate {
    /// Altitude, m; `None` where no sensor has said it lately, although a filter carries its prediction on.
    pub fn altitude_m(&self) -> Option<f64> {
        self.altitude_known.then_some(self.position_enu_m.z)
    }

    /// Climb, m/s; `None` where the altitude is not known.
    pub fn climb_mps(&self) -> Option<f64> {
        self.altitude_known.then_some(self.velocity_enu_mps.z)
    }

    /// Position, velocity, attitude.
    pub fn kinematics(&self) -> Kinematics {
        Kinematics {
            position_enu_m: self.position_enu_m,
            velocity_enu_mps: self.velocity_enu_mps,
            world_from_body: self.world_from_body,
        }
    }
}

impl Default for Estimate {
    fn default() -> Self {
        Self {
            time: FlightTime::default(),
            position_enu_m: Vector3::zeros(),
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: UnitQuaternion::identity(),
            body_rates_radps: Vector3::zeros(),
            accel_bias_mps2: None,
            gyro_bias_radps: None,
            position_sigma_m: None,
            velocity_sigma_mps: None,
            attitude_sigma_rad: None,
            horizontal_known: false,
            altitude_known: false,
            health: Health::Initialising,
            residuals: Residuals::new(),
        }
    }
}

/// An estimator that takes one frame at a time. A Kalman filter predicts and corrects inside
/// `step`; a secure estimator slides its window.
pub trait Estimator: std::any::Any + Send {
    /// Which one it is.
    fn kind(&self) -> EstimatorKind;

    /// Takes the samples received at this tick and the command applied since the last one.
    ///
    /// Never fails and never allocates: numerical trouble is reported as [`Health::Degraded`], and
    /// samples that are not finite are skipped.
    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate;

    /// The estimate of the last step.
    fn estimate(&self) -> &Estimate;

    /// Starts again from `estimate` (switching in flight without a bump).
    fn reset_to(&mut self, estimate: &Estimate);

    /// How far from `truth` for the covariance it claims; `None` for estimators without one. For tests and
    /// offline scores: nothing in flight knows the truth.
    fn nees(&self, _truth: &Kinematics) -> Option<filter::consistency::Nees> {
        None
    }
}

impl dyn Estimator {
    /// The secure estimator, where it is one.
    pub fn secure(&self) -> Option<&secure::Secure> {
        (self as &dyn std::any::Any).downcast_ref()
    }

    /// The secure estimator, where it is one.
    pub fn secure_mut(&mut self) -> Option<&mut secure::Secure> {
        (self as &mut dyn std::any::Any).downcast_mut()
    }
}

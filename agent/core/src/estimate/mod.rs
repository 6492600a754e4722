//! Estimators: the state of the vehicle from the samples received and the motor commands applied.
//!
//! Several run side by side in a bank (`bank.rs`); one of them is in the loop. None of them
//! can tell whether an attack is on, nor see the truth.

pub mod aiding;
pub mod attitude;
pub mod attitude_ekf;
pub mod bank;
pub mod complementary;
pub mod constant_acceleration;
pub mod ekf_bias;
pub mod fdir;
pub mod filter;
pub mod lanes;
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

/// Position and velocity in the world frame ENU.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Position, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// One-sigma of the position, m; `None` for an estimator without covariance.
    pub position_sigma_m: Option<Vector3<f64>>,
    /// One-sigma of the velocity, m/s.
    pub velocity_sigma_mps: Option<Vector3<f64>>,
    /// One-sigma of what all heights together are off by, m; `None` for an estimator that does not learn what each of them is off by:
    /// their innovations tell it then.
    pub heights_off_sigma_m: Option<f64>,
    /// Is the horizontal position known (GNSS or motion capture lately)? If not, x and y are a prediction.
    pub horizontal_known: bool,
    /// Is the altitude known (lasers, barometer, motion capture or GNSS lately)? If not, z is a prediction.
    pub altitude_known: bool,
}

/// What an estimator knows after one step; `None` where it does not estimate something at all.
#[derive(Debug, PartialEq)]
pub struct Estimate {
    /// Time of the frame it belongs to.
    pub time: FlightTime,
    /// Position and velocity; `None` for an attitude filter.
    pub motion: Option<Motion>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
    /// Angular rate in the body frame FLU, bias removed, rad/s.
    pub body_rates_radps: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub accel_bias_mps2: Option<Vector3<f64>>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_radps: Option<Vector3<f64>>,
    /// One-sigma of the attitude error about the world axes, rad.
    pub attitude_sigma_rad: Option<Vector3<f64>>,
    /// Can it be trusted?
    pub health: Health,
    /// Residuals of the samples used in this step.
    pub residuals: Residuals,
}

impl Estimate {
    /// The motion, or rest at the origin where none is estimated: for laws and displays that need numbers although
    /// nothing closes a loop on them.
    pub fn motion_or_rest(&self) -> Motion {
        self.motion.unwrap_or_default()
    }

    /// Is the horizontal position known? See [`Motion::horizontal_known`].
    pub fn horizontal_known(&self) -> bool {
        self.motion.is_some_and(|motion| motion.horizontal_known)
    }

    /// Is the altitude known? See [`Motion::altitude_known`].
    pub fn altitude_known(&self) -> bool {
        self.motion.is_some_and(|motion| motion.altitude_known)
    }

    /// Altitude, m; `None` where it is not known, although a filter carries its prediction on.
    pub fn altitude_m(&self) -> Option<f64> {
        self.motion.filter(|motion| motion.altitude_known).map(|motion| motion.position_enu_m.z)
    }

    /// Climb, m/s; `None` where the altitude is not known.
    pub fn climb_mps(&self) -> Option<f64> {
        self.motion.filter(|motion| motion.altitude_known).map(|motion| motion.velocity_enu_mps.z)
    }

    /// Position, velocity, attitude; the first two as [`Estimate::motion_or_rest`].
    pub fn kinematics(&self) -> Kinematics {
        let Motion { position_enu_m, velocity_enu_mps, .. } = self.motion_or_rest();
        Kinematics { position_enu_m, velocity_enu_mps, world_from_body: self.world_from_body }
    }
}

impl Default for Estimate {
    fn default() -> Self {
        Self {
            time: FlightTime::default(),
            motion: None,
            world_from_body: UnitQuaternion::identity(),
            body_rates_radps: Vector3::zeros(),
            accel_bias_mps2: None,
            gyro_bias_radps: None,
            attitude_sigma_rad: None,
            health: Health::Initialising,
            residuals: Residuals::new(),
        }
    }
}

impl Clone for Estimate {
    fn clone(&self) -> Self {
        let mut copy = Self::default();
        copy.clone_from(self);
        copy
    }

    /// Copies only the residuals there are: room for all of them is 3 kB, and a tick copies several estimates.
    fn clone_from(&mut self, source: &Self) {
        let Self {
            time,
            motion,
            world_from_body,
            body_rates_radps,
            accel_bias_mps2,
            gyro_bias_radps,
            attitude_sigma_rad,
            health,
            residuals,
        } = source;
        (self.time, self.motion, self.health) = (*time, *motion, *health);
        (self.world_from_body, self.body_rates_radps) = (*world_from_body, *body_rates_radps);
        (self.accel_bias_mps2, self.gyro_bias_radps) = (*accel_bias_mps2, *gyro_bias_radps);
        self.attitude_sigma_rad = *attitude_sigma_rad;
        self.residuals.clone_from(residuals);
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

    /// The same, for whoever knows better how uncertain it is.
    fn estimate_mut(&mut self) -> &mut Estimate;

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

    /// The estimator by lanes, where it is one.
    pub fn lanes(&self) -> Option<&lanes::Lanes> {
        (self as &dyn std::any::Any).downcast_ref()
    }

    /// The secure estimator, where it is one.
    pub fn secure_mut(&mut self) -> Option<&mut secure::Secure> {
        (self as &mut dyn std::any::Any).downcast_mut()
    }
}

//! Attitude filters as estimators, on the consensus of the IMUs: attitude and rates, no position.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::fdir::consensus::{self, Consensus};
use super::{Channel, Estimate, Estimator, EstimatorKind, Health, Residual};
use crate::sensor::SensorFrame;
use crate::sensor::imu::ImuModel;
use crate::types::MotorCommand;

/// No IMU for this long is degraded, s.
const SILENCE_S: f64 = 0.1;
/// Attitude is settled after this long, s.
const SETTLED_S: f64 = 1.0;

/// Attitude from one gyroscope, one accelerometer and one magnetometer.
pub trait AttitudeFilter: Send + 'static {
    /// Its name as an estimator.
    const KIND: EstimatorKind;

    /// Before the first sample, where the magnetic declination is `declination_rad`, east positive.
    fn with_declination(declination_rad: f64) -> Self;

    /// One IMU sample, `dt_s` after the one before: rad/s, m/s² and µT in the body frame.
    fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>);

    /// World ENU ← body.
    fn world_from_body(&self) -> UnitQuaternion<f64>;

    /// Gyroscope bias, rad/s.
    fn gyro_bias_radps(&self) -> Vector3<f64>;

    /// The angular rate that a gyroscope sample means, rad/s.
    fn rate_radps(&self, gyro: &Vector3<f64>) -> Vector3<f64> {
        gyro - self.gyro_bias_radps()
    }

    /// Magnetic heading less estimated heading at the last magnetometer sample, rad.
    fn heading_disagreement_rad(&self) -> f64;

    /// Is the field unlike the reference field?
    fn field_disturbed(&self) -> bool;
}

/// A filter as an estimator.
pub struct AttitudeEstimator<F> {
    filter: F,
    gyro_consensus: Consensus,
    accel_consensus: Consensus,
    last: Option<FlightTime>,
    force_mps2: Vector3<f64>,
    trusted: bool,
    age_s: f64,
    estimate: Estimate,
}

impl<F: AttitudeFilter> AttitudeEstimator<F> {
    /// On the consensus of these IMUs.
    pub fn new(imus: &ImuModel) -> Self {
        Self {
            filter: F::with_declination(imus.mag.declination_rad),
            gyro_consensus: Consensus::of_gyros(imus),
            accel_consensus: Consensus::of_accels(imus),
            last: None,
            force_mps2: Vector3::zeros(),
            trusted: true,
            age_s: 0.0,
            estimate: Estimate::default(),
        }
    }

    /// The last consensus of the accelerometers, m/s² in the body frame, and its time; `None` before the first.
    pub fn specific_force_mps2(&self) -> Option<(FlightTime, Vector3<f64>)> {
        self.last.map(|time| (time, self.force_mps2))
    }

    /// The filter inside.
    pub fn filter(&self) -> &F {
        &self.filter
    }
}

/// The shortest rotation that brings the unit vector `up` to the vertical.
pub(super) fn levelling(up: &Vector3<f64>) -> UnitQuaternion<f64> {
    let w = (0.5 * (up.z + 1.0)).max(0.0).sqrt();
    UnitQuaternion::from_quaternion(if w > 1e-6 {
        Quaternion::new(w, 0.5 * up.y / w, -0.5 * up.x / w, 0.0)
    } else {
        Quaternion::new(0.0, 1.0, 0.0, 0.0)
    })
}

/// Mean of the magnetometers of this frame, µT.
fn mean_field(received: &SensorFrame) -> Option<Vector3<f64>> {
    let fields = received.imus.iter().flatten().filter_map(|imu| imu.mag_ut);
    let (sum, count) = fields
        .filter(|m| m.iter().all(|x| x.is_finite()))
        .fold((Vector3::zeros(), 0.0), |(sum, count), field| (sum + field, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

impl<F: AttitudeFilter> Estimator for AttitudeEstimator<F> {
    fn kind(&self) -> EstimatorKind {
        F::KIND
    }

    fn step(&mut self, received: &SensorFrame, _applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        self.estimate.time = now;
        self.estimate.residuals.clear();
        let residuals = &mut self.estimate.residuals;
        let gyro = self.gyro_consensus.take(now, &consensus::gyros(received), residuals);
        let accel = self.accel_consensus.take(now, &consensus::accels(received), residuals);
        if let (Some(gyro), Some(accel)) = (gyro, accel) {
            let dt_s = self.last.map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, 0.2);
            self.last = Some(now);
            self.force_mps2 = accel.value;
            self.age_s += dt_s;
            self.trusted = gyro.trusted && accel.trusted;
            let field = mean_field(received);
            self.filter.push(dt_s, &gyro.value, &accel.value, field.as_ref());
            if field.is_some() {
                // Between the noise of a magnetometer and a field that points elsewhere.
                let sigma = 0.1;
                let innovation = self.filter.heading_disagreement_rad();
                let _ = self.estimate.residuals.try_push(Residual {
                    sensor: SensorId::new(SensorKind::Imu, 1),
                    channel: Channel::Heading,
                    innovation,
                    sigma,
                    gate: 5.0 * sigma,
                    accepted: !self.filter.field_disturbed(),
                });
            }
            self.estimate.body_rates_radps = self.filter.rate_radps(&gyro.value);
        }
        self.estimate.world_from_body = self.filter.world_from_body();
        self.estimate.gyro_bias_radps = Some(self.filter.gyro_bias_radps());
        let silent = self.last.is_none_or(|t| now.seconds_since(t) > SILENCE_S);
        self.estimate.health = if self.age_s < SETTLED_S {
            Health::Initialising
        } else if silent || !self.trusted {
            Health::Degraded
        } else {
            Health::Healthy
        };
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

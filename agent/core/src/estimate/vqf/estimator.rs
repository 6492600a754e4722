//! The filter as an estimator, on the consensus of the IMUs.

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::{Vqf, VqfOptions};
use crate::estimate::fdir::consensus::{self, Consensus};
use crate::estimate::{Channel, Estimate, Estimator, EstimatorKind, Health, Residual};
use crate::sensor::SensorFrame;
use crate::sensor::imu::ImuModel;
use crate::types::MotorCommand;

/// No IMU for this long is degraded, s.
const SILENCE_S: f64 = 0.1;
/// Attitude is settled after this long, s.
const SETTLED_S: f64 = 1.0;

/// The filter as an estimator: attitude and rates, no position.
pub struct VqfEstimator {
    filter: Vqf,
    gyro_consensus: Consensus,
    accel_consensus: Consensus,
    last: Option<FlightTime>,
    force_mps2: Vector3<f64>,
    trusted: bool,
    age_s: f64,
    estimate: Estimate,
}

impl VqfEstimator {
    /// On the consensus of these IMUs.
    pub fn new(imus: &ImuModel) -> Self {
        Self {
            filter: Vqf::new(VqfOptions { declination_rad: imus.mag.declination_rad, ..VqfOptions::default() }),
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
    pub fn filter(&self) -> &Vqf {
        &self.filter
    }
}

impl Estimator for VqfEstimator {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Vqf
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
            let mut sum = Vector3::zeros();
            let mut fields = 0.0;
            for imu in received.imus.iter().flatten() {
                if let Some(field) = imu.mag_ut.filter(|m| m.iter().all(|x| x.is_finite())) {
                    sum += field;
                    fields += 1.0;
                }
            }
            let field = (fields > 0.0).then(|| sum / fields);
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
            self.estimate.body_rates_radps = gyro.value - self.filter.gyro_bias_radps();
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
}

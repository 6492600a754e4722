//! Attitude of a recording from both directions: the attitude EKF forwards, then backwards, and the mean of the two.
//!
//! Two-filter smoothing (Fraser & Potter 1969): each pass knows one side of a moment, and their errors are taken for
//! independent. Tilt and heading are averaged apart, each by the inverse of its variance.
//!
//! Deviation from Fraser & Potter: the backward pass starts from the attitude and the calibration that the forward one
//! ended with, as uncertain as at a start, rather than from no information at all.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::estimate::attitude::{AttitudeEstimator, AttitudeFilter};
use plumbline_core::estimate::attitude_ekf::AttitudeEkf;
use plumbline_core::estimate::{Estimate, Estimator};
use plumbline_core::frames::wrap_pi;
use plumbline_core::sensor::SensorFrame;
use plumbline_core::types::{EstimatorKind, MotorCommand};

/// An attitude and its variances about the level axes and about the vertical, rad².
#[derive(Debug, Clone, Copy)]
struct Known {
    world_from_body: UnitQuaternion<f64>,
    tilt: f64,
    heading: f64,
}

impl Known {
    fn by(filter: &AttitudeEkf) -> Self {
        let least = f64::MIN_POSITIVE;
        Self {
            world_from_body: filter.world_from_body(),
            tilt: filter.tilt_sigma_rad().powi(2).max(least),
            heading: filter.heading_sigma_rad().powi(2).max(least),
        }
    }

    /// The mean of the two.
    fn and(&self, other: &Self) -> UnitQuaternion<f64> {
        let between = other.world_from_body * self.world_from_body.inverse();
        let about_vertical = |angle: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
        let heading = wrap_pi(2.0 * between.k.atan2(between.w));
        let tilt = (about_vertical(-heading) * between).scaled_axis();
        about_vertical(heading * self.heading / (self.heading + other.heading))
            * UnitQuaternion::from_scaled_axis(tilt * (self.tilt / (self.tilt + other.tilt)))
            * self.world_from_body
    }
}

/// One sample, and what the forward pass knew after it.
struct Row {
    dt_s: f64,
    gyro: Vector3<f64>,
    force: Vector3<f64>,
    field: Option<Vector3<f64>>,
    known: Known,
}

/// The attitude EKF, and all that it was given.
pub(super) struct Forward {
    filter: AttitudeEkf,
    rows: Vec<Row>,
}

impl AttitudeFilter for Forward {
    const KIND: EstimatorKind = EstimatorKind::AttitudeEkf;

    fn with_declination(declination_rad: f64) -> Self {
        Self { filter: AttitudeEkf::new(declination_rad), rows: Vec::new() }
    }

    fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>) {
        self.filter.push(dt_s, gyro, force, field);
        let known = Known::by(&self.filter);
        self.rows.push(Row { dt_s, gyro: *gyro, force: *force, field: field.copied(), known });
    }

    fn world_from_body(&self) -> UnitQuaternion<f64> {
        self.filter.world_from_body()
    }

    fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.filter.gyro_bias_radps()
    }

    fn heading_disagreement_rad(&self) -> f64 {
        self.filter.heading_disagreement_rad()
    }

    fn field_disturbed(&self) -> bool {
        self.filter.field_disturbed()
    }
}

impl Forward {
    /// Attitudes after each sample, from both passes.
    pub fn smoothed(&self) -> Vec<UnitQuaternion<f64>> {
        let mut backward = self.filter.reversed();
        let mut attitudes = Vec::with_capacity(self.rows.len());
        for (k, row) in self.rows.iter().enumerate().rev() {
            attitudes.push(row.known.and(&Known::by(&backward)));
            // From this sample to the one before: its rate lasted that long.
            if let Some(before) = k.checked_sub(1).and_then(|before| self.rows.get(before)) {
                backward.push(row.dt_s, &-row.gyro, &before.force, before.field.as_ref());
            }
        }
        attitudes.reverse();
        attitudes
    }

    /// Samples so far.
    pub fn samples(&self) -> usize {
        self.rows.len()
    }
}

/// The estimator of a second time over the same recording: the attitude EKF with its attitudes from both passes.
pub(super) struct Smoothed {
    causal: AttitudeEstimator<Forward>,
    attitudes: Vec<UnitQuaternion<f64>>,
    estimate: Estimate,
}

impl Smoothed {
    /// `causal` before its first frame; `attitudes` after each of its samples.
    pub fn new(causal: AttitudeEstimator<Forward>, attitudes: Vec<UnitQuaternion<f64>>) -> Self {
        Self { causal, attitudes, estimate: Estimate::default() }
    }
}

impl Estimator for Smoothed {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::AttitudeEkf
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        self.estimate.clone_from(self.causal.step(received, applied));
        let last = self.causal.filter().samples().checked_sub(1);
        if let Some(attitude) = last.and_then(|sample| self.attitudes.get(sample)) {
            self.estimate.world_from_body = *attitude;
        }
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

//! Yaw without magnetometer and motion capture, where GNSS shows it: a mixture over yaw (`yaw_mixture.rs`).
//!
//! There the filter itself uses no horizontal fix: linearised about a yaw that may be wrong by 180° it would take
//! the difference for tilt and bias, and become sure of them. Horizontal position, velocity and yaw are those of
//! the mixture, tilt and gyroscope bias those of its attitude filter; the vertical is the filter's own. It stays
//! so for as long as nothing else measures the yaw: a filter that took over from a mixture which agrees with itself
//! was tried and did worse (Phantom 4, 1 Hz: 1.8 m instead of 1.1 m), since it cannot open its yaw again.

use nalgebra::{UnitQuaternion, Vector2};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::covariance::{Covariance, ix};
use super::{EkfBias, Inertial};
use crate::estimate::aiding::idle::UNKNOWN_YAW_SIGMA_RAD;
use crate::estimate::filter::kalman::forget;
use crate::estimate::yaw_mixture::Horizontal;
use crate::estimate::{Channel, Residual};
use crate::sensor::measure::Kinematics;
use crate::sensor::{Accuracy, SensorFrame};

/// One-sigma of roll and pitch as the attitude filter has them, rad.
const TILT_SIGMA_RAD: f64 = 0.06;

/// Horizontal state and attitude are those of the mixture: `found`, with its attitude `world_from_body`.
pub fn follow(found: &Horizontal, world_from_body: &UnitQuaternion<f64>, at: &mut Kinematics, p: &mut Covariance) {
    at.world_from_body = *world_from_body;
    for axis in 0..2 {
        at.position_enu_m[axis] = found.position_m[axis];
        at.velocity_enu_mps[axis] = found.velocity_mps[axis];
        forget(p, ix::POSITION + axis, found.position_variance[axis]);
        forget(p, ix::VELOCITY + axis, found.velocity_variance[axis]);
        forget(p, ix::ATTITUDE + axis, TILT_SIGMA_RAD * TILT_SIGMA_RAD);
    }
    let yaw_rad = found.yaw_sigma_rad.min(UNKNOWN_YAW_SIGMA_RAD);
    forget(p, ix::ATTITUDE + 2, yaw_rad * yaw_rad);
}

impl EkfBias {
    /// Shows the mixture what arrived in `frame`, `dt_s` after the IMU sample before: from the first sample on, since
    /// start-up itself takes a second.
    pub(super) fn feed_mixture(&mut self, frame: &SensorFrame, inertial: Option<&Inertial>, dt_s: f64) {
        if self.yaw_known {
            return;
        }
        if let Some(inertial) = inertial {
            self.mixture.push(dt_s.clamp(0.0, 0.2), &inertial.gyro_radps, &inertial.accel_mps2);
        }
        let Some(sample) = frame.gnss.filter(|s| s.position_enu_m.iter().all(|x| x.is_finite())) else { return };
        let (position, velocity) = (self.model.gnss.position(&sample, 0), self.model.gnss.velocity);
        let before = self.mixture.horizontal();
        self.mixture.take(frame.time, &sample, position.sigma, velocity.sigma);
        if let Some(found) = before {
            self.show(&found, &sample.position_enu_m.xy(), position);
        }
        self.aided.horizontal.note(frame.time, true);
    }

    /// In a tick in which nothing but the mixture measures the yaw.
    pub(super) fn follow_mixture(&mut self) {
        let Some(found) = self.mixture.horizontal().filter(|_| !self.yaw_known) else { return };
        self.state.gyro_bias_radps = self.mixture.gyro_bias_radps();
        follow(&found, &self.mixture.world_from_body(), &mut self.state.kinematics, &mut self.p);
    }

    /// Residuals of a fix that only the mixture has used.
    fn show(&mut self, before: &Horizontal, place: &Vector2<f64>, noise: Accuracy) {
        for (axis, channel) in [Channel::X, Channel::Y].into_iter().enumerate() {
            let sigma = (before.position_variance[axis] + noise.sigma * noise.sigma).sqrt();
            let innovation = place[axis] - before.position_m[axis];
            let sensor = SensorId::new(SensorKind::Gnss, 1);
            let residual = Residual::gated(sensor, channel, innovation, sigma, noise.gate);
            let _ = self.estimate.residuals.try_push(residual);
        }
    }
}

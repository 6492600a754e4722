//! What arrived in a frame, as rows of the filter; and what is known without a sensor.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::{MEMORY_S, START_SIGMA, TwelveStateEstimator};
use crate::estimate::aiding::freshness::RECOVERY_S;
use crate::estimate::aiding::idle::{
    POSITION_CORRELATION_S, POSITION_SIGMA_M, UNKNOWN_YAW_SIGMA_RAD, VELOCITY_CORRELATION_S, VELOCITY_SIGMA_MPS,
    whitening,
};
use crate::estimate::aiding::{ANGLES, RANGES, VELOCITY, XYZ};
use crate::estimate::filter::kalman::forget;
use crate::estimate::filter::measurement::{Measurement, TwelveState, What};
use crate::estimate::filter::mocap_recipe::ANGLE_SIGMA_RAD;
use crate::estimate::{Channel, Estimator, Residuals};
use crate::frames::roll_pitch_yaw;
use crate::model::euler_body::ix;
use crate::sensor::camera_ranges::{self, CameraRangesModel};
use crate::sensor::{Accuracy, SensorFrame};

/// A motion-capture attitude replaces that of the attitude filter this long, s.
const POSE_MEMORY_S: f64 = 0.5;
const fn first(kind: SensorKind) -> SensorId {
    SensorId { kind, instance: 1 }
}
const IMU: SensorId = first(SensorKind::Imu);
const BAROMETER: SensorId = first(SensorKind::Barometer);
const GNSS: SensorId = first(SensorKind::Gnss);
const MOCAP_POSE: SensorId = first(SensorKind::MocapPose);
const CAMERA_RANGES: SensorId = first(SensorKind::CameraRanges);
const RATES: [Channel; 3] = [Channel::GyroX, Channel::GyroY, Channel::GyroZ];

impl<F: TwelveState> TwelveStateEstimator<F> {
    /// One more row; the rows so far are used up when there is no room.
    fn take(&mut self, sensor: SensorId, channel: Channel, what: What, value: f64, noise: Accuracy) {
        if !value.is_finite() {
            return;
        }
        if self.rows.is_full() {
            self.flush();
        }
        self.rows.push(Measurement { of: Some((sensor, channel)), what, value, noise });
    }

    /// Corrects with the rows gathered; notes which axes were corrected.
    pub(super) fn flush(&mut self) {
        let now = self.now.unwrap_or_default();
        let before = self.estimate.residuals.len();
        self.filter.correct(&self.rows, &mut self.estimate.residuals);
        self.rows.clear();
        let (mut ranges, mut ranged) = (0, false);
        let mut heights = None;
        for r in self.estimate.residuals.iter().skip(before) {
            match r.channel {
                Channel::X => self.aided.axes[0].note(now, r.accepted),
                Channel::Y => self.aided.axes[1].note(now, r.accepted),
                Channel::Z | Channel::PressureAltitude => self.aided.axes[2].note(now, r.accepted),
                Channel::Height => heights = Some(heights.unwrap_or(false) | r.accepted),
                Channel::Range1 | Channel::Range2 | Channel::Range3 | Channel::Range4 => {
                    ranged = true;
                    ranges += u8::from(r.accepted);
                }
                _ => {}
            }
        }
        if ranged {
            self.aided.axes.iter_mut().for_each(|axis| axis.note(now, ranges >= 3));
        }
        // One accepted height of several is enough.
        if let Some(accepted) = heights {
            self.aided.axes[2].note(now, accepted);
        }
        // The rates are an inner matter: the deviation of each IMU from the consensus is shown instead.
        self.estimate.residuals.retain(|r| !RATES.contains(&r.channel) || r.gate.is_finite());
    }

    /// Does motion capture tell the attitude?
    fn posed(&self, now: FlightTime) -> bool {
        self.aided.pose_seen.is_some_and(|t| now.seconds_since(t) <= POSE_MEMORY_S)
    }

    /// One-sigma of what the attitude filter is off by for long, rad: zero where motion capture tells the attitude.
    pub(super) fn lasting_sigma_rad(&self, now: FlightTime) -> f64 {
        if self.posed(now) {
            return 0.0;
        }
        let imus = self.aided.imus_seen.iter().filter(|seen| **seen).count().max(1) as f64;
        let model = &self.model.imus;
        let accel = (model.accel.bias_prior / imus.sqrt()).hypot(self.vibration.lasting_mps2());
        ANGLE_SIGMA_RAD.hypot(accel / model.gravity_mps2)
    }

    /// Gyroscopes and attitude.
    pub(super) fn take_attitude(&mut self, frame: &SensorFrame, fresh: bool) {
        for (seen, sample) in self.aided.imus_seen.iter_mut().zip(&frame.imus) {
            *seen |= sample.is_some();
        }
        self.aided.field_seen |= frame.imus.iter().flatten().any(|s| s.mag_ut.is_some());
        if let Some(pose) = frame.mocap_pose.filter(|s| s.world_from_body.coords.iter().all(|x| x.is_finite())) {
            self.aided.pose_seen = Some(frame.time);
            let (noise, angles) = (self.model.mocap_pose.attitude, roll_pitch_yaw(&pose.world_from_body));
            for i in 0..3 {
                self.take(MOCAP_POSE, ANGLES[i], What::Angle(ix::ROLL + i), angles[i], noise);
            }
        }
        if !fresh {
            return;
        }
        let (attitude, rates) = (self.attitude.estimate().world_from_body, self.attitude.estimate().body_rates_radps);
        let noise = Accuracy::ungated(self.model.imus.gyro.sigma);
        for i in 0..3 {
            self.take(IMU, RATES[i], What::State(ix::P + i), rates[i], noise);
        }
        if self.posed(frame.time) {
            return;
        }
        let angles = roll_pitch_yaw(&attitude);
        let noise = Accuracy::ungated(ANGLE_SIGMA_RAD);
        for i in 0..3 {
            self.take(IMU, ANGLES[i], What::Angle(ix::ROLL + i), angles[i], noise);
        }
    }

    pub(super) fn take_positions(&mut self, frame: &SensorFrame) {
        let (x, _) = self.filter.moments();
        let velocity = Vector3::new(x[ix::VX], x[ix::VY], x[ix::VZ]);
        // A late sample, brought forward by the velocity.
        let late = |time: FlightTime| velocity * frame.time.seconds_since(time).clamp(0.0, 0.5);
        if let Some(sample) = frame.camera_ranges {
            let CameraRangesModel { cameras_enu_m: cameras, sigma_m: sigmas, gate } = self.model.camera_ranges;
            if self.aided.axes[0].lost(frame.time, RECOVERY_S)
                && let Some(place) = camera_ranges::trilaterate(&cameras, &sample.range_m, &sigmas)
            {
                (0..3).for_each(|axis| self.relocate(axis, place[axis], 0.1));
            }
            let moved = late(sample.time);
            for (i, range_m) in sample.range_m.into_iter().enumerate() {
                let toward = camera_ranges::predict(&Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]), &cameras[i]).1;
                let noise = Accuracy { sigma: sigmas[i], gate };
                let value = range_m + toward.dot(&moved);
                self.take(CAMERA_RANGES, RANGES[i], What::Range(cameras[i]), value, noise);
            }
        }
        if let Some(sample) = frame.mocap_pose {
            let noise = self.model.mocap_pose.position;
            let place = sample.position_enu_m + late(sample.time);
            for axis in 0..3 {
                self.recover(frame.time, axis, place[axis], noise.sigma);
                self.take(MOCAP_POSE, XYZ[axis], What::State(axis), place[axis], noise);
            }
        }
        for (i, sample) in frame.heights.iter().enumerate() {
            let Some(sample) = sample.filter(|s| s.height_m.is_finite()) else { continue };
            self.aided.heights_present = true;
            let height_m = sample.height_m + late(sample.time).z;
            self.recover(frame.time, 2, height_m, self.model.heights.sigma);
            let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
            self.take(sensor, Channel::Height, What::State(ix::Z), height_m, self.model.heights);
        }
        let yaw_measured = self.yaw_measured();
        if let Some(sample) = frame.gnss {
            let place = sample.position_enu_m + late(sample.time);
            for axis in if yaw_measured { 0..3 } else { 2..3 } {
                let noise = self.model.gnss.position(&sample, axis);
                // A laser has the floor as its zero: it alone tells the height where there is one.
                if axis < 2 || !self.aided.heights_present {
                    self.recover(frame.time, axis, place[axis], noise.sigma);
                    self.take(GNSS, XYZ[axis], What::State(axis), place[axis], noise);
                }
                let speed = sample.velocity_enu_mps[axis];
                self.take(GNSS, VELOCITY[axis], What::State(ix::VX + axis), speed, self.model.gnss.velocity);
            }
        }
        let measured = self.aided.heights_present || frame.gnss.is_some() || self.aided.axes[2].ever();
        if let Some(sample) = frame.barometers[0].filter(|_| !measured || self.aided.barometer_origin_m.is_some()) {
            let altitude = self.model.barometers.altitude_m(&sample);
            if altitude.is_finite() && !self.aided.heights_present {
                let origin = *self.aided.barometer_origin_m.get_or_insert(altitude - x[ix::Z]);
                self.take(
                    BAROMETER,
                    Channel::PressureAltitude,
                    What::State(ix::Z),
                    altitude - origin,
                    self.model.barometers.altitude,
                );
            }
        }
    }

    /// Does anything but position fixes measure the yaw?
    fn yaw_measured(&self) -> bool {
        self.aided.field_seen || self.aided.pose_seen.is_some()
    }

    /// Shows the mixture what arrived, from the first sample on.
    pub(super) fn feed_mixture(&mut self, frame: &SensorFrame, force: Option<Vector3<f64>>) {
        if self.yaw_measured() {
            return;
        }
        let now = frame.time;
        if let Some(force) = force {
            let since = self.force.map_or(0.0, |(before, _)| now.seconds_since(before)).clamp(0.0, 0.2);
            let gyro = self.attitude.estimate().body_rates_radps + self.attitude.filter().gyro_bias_radps();
            self.mixture.push(since, &gyro, &force);
        }
        let Some(sample) = frame.gnss.filter(|s| s.position_enu_m.iter().all(|x| x.is_finite())) else { return };
        let gnss = &self.model.gnss;
        self.mixture.take(now, &sample, gnss.position(&sample, 0).sigma, gnss.velocity.sigma);
        (0..2).for_each(|axis| self.aided.axes[axis].note(now, true));
    }

    /// Takes yaw, tilt and everything horizontal from the mixture where nothing else tells the yaw.
    pub(super) fn follow_mixture(&mut self) {
        let Some(found) = self.mixture.horizontal().filter(|_| !self.yaw_measured()) else { return };
        let (mut x, mut p) = self.filter.moments();
        let angles = roll_pitch_yaw(&self.mixture.world_from_body());
        let mut set = |i: usize, value: f64, variance: f64| {
            x[i] = value;
            forget(&mut p, i, variance);
        };
        for axis in 0..2 {
            set(ix::X + axis, found.position_m[axis], found.position_variance[axis]);
            set(ix::VX + axis, found.velocity_mps[axis], found.velocity_variance[axis]);
            set(ix::ROLL + axis, angles[axis], START_SIGMA[2].powi(2));
        }
        let yaw_sigma = found.yaw_sigma_rad.min(UNKNOWN_YAW_SIGMA_RAD);
        set(ix::YAW, angles.z, yaw_sigma * yaw_sigma);
        self.filter.restart(x, p);
    }

    /// Moves to `value` on `axis` where nothing has been accepted for long, or ever.
    fn recover(&mut self, now: FlightTime, axis: usize, value: f64, sigma: f64) {
        if value.is_finite() && self.aided.axes[axis].lost(now, RECOVERY_S) {
            self.relocate(axis, value, 3.0 * sigma);
            self.aided.axes[axis].note(now, true);
        }
    }

    fn relocate(&mut self, axis: usize, value: f64, sigma: f64) {
        let (mut x, mut p) = self.filter.moments();
        x[axis] = value;
        forget(&mut p, axis, sigma * sigma);
        p[(axis + 3, axis + 3)] += 1.0;
        self.filter.restart(x, p);
    }

    /// Without aiding: on average it goes nowhere, and not far (as in `ekf_bias`, where the reasons are).
    pub(super) fn take_idle(&mut self, now: FlightTime) {
        let Some(since_s) = self.aided.idle.due(now) else { return };
        let velocity = VELOCITY_SIGMA_MPS * whitening(VELOCITY_CORRELATION_S, since_s).sqrt();
        let position = POSITION_SIGMA_M * whitening(POSITION_CORRELATION_S, since_s).sqrt();
        let (x, _) = self.filter.moments();
        let mut rows: ArrayVec<Measurement, 6> = ArrayVec::new();
        let still = |i: usize, value: f64, sigma: f64| Measurement {
            of: None,
            what: What::State(i),
            value,
            noise: Accuracy::ungated(sigma),
        };
        for axis in 0..3 {
            if self.aided.axes[axis].within(now, MEMORY_S) {
                self.aided.idle.anchor[axis] = x[axis];
            } else {
                rows.push(still(ix::VX + axis, 0.0, velocity));
                rows.push(still(axis, self.aided.idle.anchor[axis], position));
            }
        }
        if !rows.is_empty() {
            self.filter.correct(&rows, &mut Residuals::new());
        }
    }
}

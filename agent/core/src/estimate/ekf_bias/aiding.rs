//! Corrections, one sensor after the other: rows only for what arrived, each scalar with its own gate.
//!
//! Where several instances measure the same thing (heights in `vertical.rs`, headings in `heading.rs`), they are taken in
//! the order of their agreement with the median. An attacked one comes last and meets a state that the healthy ones have
//! already corrected and sharpened: it cannot win by having arrived first, nor while P is wide.

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::EkfBias;
use super::covariance::{ErrorState, N, ix};
use crate::estimate::Channel;
use crate::estimate::aiding::freshness::RECOVERY_S;
use crate::estimate::aiding::{ANGLES, RANGES, VELOCITY, XYZ};
use crate::estimate::filter::kalman::forget;
use crate::estimate::filter::row::ScalarRow;
use crate::sensor::camera_ranges::CameraRangesModel;
use crate::sensor::measure::{self, Row};
use crate::sensor::{Accuracy, SensorFrame};
use crate::sensor::{camera_ranges, mocap_pose};

/// Horizontal position stays known this long after the last accepted sample, s.
pub const HORIZONTAL_MEMORY_S: f64 = 3.0;
/// Vertical position stays known this long after the last accepted sample, s.
pub const VERTICAL_MEMORY_S: f64 = 2.0;

/// The row over the error states of a scalar `of` a sensor, `delay_s` old.
pub fn row(of: (SensorId, Channel), measured: &Row, noise: Accuracy, delay_s: f64) -> ScalarRow<N> {
    let mut h = ErrorState::zeros();
    h.fixed_rows_mut::<3>(ix::POSITION).copy_from(&measured.d_position);
    // A sample of age τ saw p(t − τ) ≈ p − τ v.
    h.fixed_rows_mut::<3>(ix::VELOCITY).copy_from(&(measured.d_velocity - delay_s * measured.d_position));
    h.fixed_rows_mut::<3>(ix::ATTITUDE).copy_from(&measured.d_attitude);
    let bare = ScalarRow::new(measured.innovation, h, noise.sigma * noise.sigma);
    ScalarRow { of: Some(of), gate: noise.gate, ..bare }
}

impl EkfBias {
    /// Everything that arrived in `frame`.
    pub(super) fn aid(&mut self, frame: &SensorFrame) {
        self.aid_mocap_pose(frame);
        self.aid_gnss(frame);
        self.aid_camera_ranges(frame);
        self.aid_heights(frame);
        self.aid_barometers(frame);
        self.aid_headings(frame);
    }

    /// One scalar: x ← x ⊕ k (y − ŷ) and P where its row is accepted. True when it was.
    pub(super) fn correct(&mut self, row: &ScalarRow<N>) -> bool {
        let correction = row.correct(&mut self.p, &mut self.estimate.residuals);
        self.take(correction)
    }

    /// Corrects by `row`, whose pull is limited beyond its gate.
    pub(super) fn correct_past_gate(&mut self, row: &ScalarRow<N>) -> bool {
        let correction = row.correct_past_gate(&mut self.p, &mut self.estimate.residuals);
        self.take(correction)
    }

    fn take(&mut self, correction: Option<nalgebra::SVector<f64, N>>) -> bool {
        if let Some(dx) = &correction {
            self.inject(dx);
        }
        correction.is_some()
    }

    fn aid_mocap_pose(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.mocap_pose else { return };
        let position = sample.position_enu_m;
        if !finite(&position) || !sample.world_from_body.coords.iter().all(|x| x.is_finite()) {
            return;
        }
        let sensor = SensorId::new(SensorKind::MocapPose, 1);
        let noise = self.model.mocap_pose.position;
        let past = self.past(sample.time, frame.time).0;
        self.allow_horizontal_reset(frame.time, position - past.position_enu_m, noise.sigma);
        let mut used = [false; 3];
        for axis in 0..3 {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let measured = measure::position(&past, axis, position[axis]);
            used[axis] = self.correct(&row((sensor, XYZ[axis]), &measured, noise, delay_s));
        }
        self.aided.horizontal.note(frame.time, used[0] && used[1]);
        if used[2] {
            self.aided.vertical.note(frame.time, true);
        }

        let noise = self.model.mocap_pose.attitude;
        if !self.yaw_known || self.aided.pose_yaw.rejected_s(frame.time) > RECOVERY_S {
            let past = self.past(sample.time, frame.time).0;
            self.turn(mocap_pose::attitude(&past, &sample.world_from_body)[2].innovation);
            forget(&mut self.p, ix::ATTITUDE + 2, noise.sigma * noise.sigma);
            self.yaw_known = true;
        }
        for (i, channel) in ANGLES.into_iter().enumerate() {
            let (past, _) = self.past(sample.time, frame.time);
            let measured = mocap_pose::attitude(&past, &sample.world_from_body)[i];
            let used = self.correct(&row((sensor, channel), &measured, noise, 0.0));
            if i == 2 {
                self.aided.pose_yaw.note(frame.time, used);
            }
        }
    }

    fn aid_gnss(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.gnss else { return };
        if !finite(&sample.position_enu_m) {
            return;
        }
        let (sensor, model) = (SensorId::new(SensorKind::Gnss, 1), self.model.gnss);
        let [horizontal, vertical] = [0, 2].map(|axis| model.position(&sample, axis));
        // Horizontally the mixture has had it already where nothing else tells the yaw.
        let yaw_known = self.yaw_known;
        if yaw_known {
            let past = self.past(sample.time, frame.time).0;
            self.allow_horizontal_reset(frame.time, sample.position_enu_m - past.position_enu_m, horizontal.sigma);
        } else if !self.aided.vertical.ever() {
            self.shift(Vector3::new(0.0, 0.0, sample.position_enu_m.z - self.state.kinematics.position_enu_m.z));
            forget(&mut self.p, ix::POSITION + 2, vertical.sigma * vertical.sigma);
        }
        let height_m = self.gnss_height_m(frame, sample.position_enu_m.z);
        let mut used = [false; 3];
        for axis in if yaw_known { 0..3 } else { 2..3 } {
            // GNSS altitude is not height above this floor: only where no laser or barometer says more.
            let lasers = self.aided.heights.freshness.within(frame.time, VERTICAL_MEMORY_S);
            let (place_m, noise) = if axis < 2 {
                (sample.position_enu_m[axis], horizontal)
            } else if let Some(height_m) = height_m.filter(|_| !lasers) {
                (height_m, vertical)
            } else {
                continue;
            };
            let (past, delay_s) = self.past(sample.time, frame.time);
            let measured = measure::position(&past, axis, place_m);
            used[axis] = self.correct(&row((sensor, XYZ[axis]), &measured, noise, delay_s));
        }
        for (axis, channel) in VELOCITY.into_iter().enumerate().skip(if yaw_known { 0 } else { 2 }) {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let v = sample.velocity_enu_mps[axis];
            if v.is_finite() {
                let measured = measure::velocity(&past, axis, v);
                self.correct(&row((sensor, channel), &measured, model.velocity, delay_s));
            }
        }
        if yaw_known {
            self.aided.horizontal.note(frame.time, used[0] && used[1]);
        }
        if used[2] {
            self.aided.vertical.note(frame.time, true);
        }
    }

    /// The height over the floor by a fix, m; beside a barometer from where the vehicle stood last, and none while it stands.
    fn gnss_height_m(&mut self, frame: &SensorFrame, gnss_m: f64) -> Option<f64> {
        if !self.aided.barometers.present && frame.barometers.iter().flatten().next().is_none() {
            return Some(gnss_m);
        }
        let resting = self.rests();
        self.aided.floor.height_m(gnss_m, self.state.kinematics.position_enu_m.z, resting)
    }

    /// Does it stand, and has for a while?
    pub(super) fn rests(&self) -> bool {
        self.rest.lasts_s() > 1.0
    }

    fn aid_camera_ranges(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.camera_ranges else { return };
        let CameraRangesModel { cameras_enu_m, sigma_m, gate } = self.model.camera_ranges;
        if self.horizontal_lost(frame.time)
            && let Some(position) = camera_ranges::trilaterate(&cameras_enu_m, &sample.range_m, &sigma_m)
        {
            let past = self.past(sample.time, frame.time).0;
            self.reset_horizontal(frame.time, position - past.position_enu_m, 0.1);
        }
        let sensor = SensorId::new(SensorKind::CameraRanges, 1);
        let mut used = 0;
        for (i, range_m) in sample.range_m.into_iter().enumerate() {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let measured = camera_ranges::range(&past, &cameras_enu_m[i], range_m);
            let noise = Accuracy { sigma: sigma_m[i], gate };
            used += usize::from(self.correct(&row((sensor, RANGES[i]), &measured, noise, delay_s)));
        }
        self.aided.horizontal.note(frame.time, used >= 3);
        if used >= 3 {
            self.aided.vertical.note(frame.time, true);
        }
    }

    /// Nothing horizontal has been accepted for `recovery_s`, or ever.
    fn horizontal_lost(&self, now: FlightTime) -> bool {
        self.aided.horizontal.lost(now, RECOVERY_S)
    }

    fn allow_horizontal_reset(&mut self, now: FlightTime, shift: Vector3<f64>, sigma: f64) {
        if self.horizontal_lost(now) {
            self.reset_horizontal(now, shift, sigma);
        }
    }

    /// Moves the position by what a sample differs from the place at *its* time: moved to where a late sample was, the
    /// rows of that sample would take the way since for an error of the velocity, and stop it.
    fn reset_horizontal(&mut self, now: FlightTime, mut shift: Vector3<f64>, sigma: f64) {
        let vertical = self.aided.vertical.within(now, VERTICAL_MEMORY_S);
        if vertical {
            shift.z = 0.0;
        }
        self.shift(shift);
        for axis in 0..if vertical { 2 } else { 3 } {
            forget(&mut self.p, ix::POSITION + axis, sigma * sigma);
            let v = ix::VELOCITY + axis;
            self.p[(v, v)] += if axis == 2 { 0.25 } else { 4.0 };
        }
        self.aided.horizontal.note(now, true);
    }
}

pub fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}

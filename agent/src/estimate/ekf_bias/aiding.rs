//! Corrections, one sensor after the other: rows only for what arrived, each scalar with its own gate.
//!
//! Where several instances measure the same thing (heights, headings), they are taken in the order of
//! their agreement with the median. A liar comes last and meets a state that the honest ones have already
//! corrected and sharpened: it cannot win by having arrived first, nor while P is wide.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::EkfBias;
use super::covariance::{ErrorState, augment_barometer, forget, ix};
use crate::estimate::{Channel, Residual, kalman, median};
use crate::frames::wrap_pi;
use crate::model::measure::{self, Row, barometer, camera_range};
use crate::vehicle::{CAMERAS, MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS, SensorFrame};

const XYZ: [Channel; 3] = [Channel::X, Channel::Y, Channel::Z];
const VELOCITY: [Channel; 3] = [Channel::VelocityX, Channel::VelocityY, Channel::VelocityZ];
const ANGLES: [Channel; 3] = [Channel::Roll, Channel::Pitch, Channel::Yaw];
const RANGES: [Channel; CAMERAS] = [Channel::Range1, Channel::Range2, Channel::Range3, Channel::Range4];
/// Heights older than this do not take part in deciding where the floor is, s.
const HEIGHT_FRESH_S: f64 = 0.3;
/// Horizontal position stays known this long after the last accepted sample, s.
pub const HORIZONTAL_MEMORY_S: f64 = 3.0;
/// Vertical position stays known this long after the last accepted sample, s.
pub const VERTICAL_MEMORY_S: f64 = 2.0;
/// Period of the pseudo-measurements, s.
const IDLE_PERIOD_S: f64 = 0.1;

/// One scalar on its way into the filter.
struct Scalar {
    sensor: SensorId,
    channel: Channel,
    row: Row,
    /// Error state seen with coefficient 1 beside the row (a barometer's offset).
    offset: Option<usize>,
    /// Variance of the noise.
    r: f64,
    /// Gate, sigmas.
    gate: f64,
    /// Age of the sample, s.
    delay_s: f64,
    /// Leave roll and pitch alone (their error enters the variance instead).
    yaw_only: bool,
    /// Refused for a reason of its own, whatever the gate says.
    refused: bool,
}

impl Scalar {
    fn new(kind: SensorKind, instance: usize, channel: Channel, row: Row, sigma: f64, gate: f64, delay_s: f64) -> Self {
        Self {
            sensor: SensorId::new(kind, instance as u8),
            channel,
            row,
            offset: None,
            r: sigma * sigma,
            gate,
            delay_s,
            yaw_only: false,
            refused: false,
        }
    }
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

    /// One scalar: innovation, gate, residual, correction. True when it was used.
    fn correct(&mut self, scalar: &Scalar) -> bool {
        let row = &scalar.row;
        let mut h = ErrorState::zeros();
        h.fixed_rows_mut::<3>(ix::POSITION).copy_from(&row.d_position);
        // A sample of age τ saw p(t − τ) ≈ p − τ v.
        h.fixed_rows_mut::<3>(ix::VELOCITY).copy_from(&(row.d_velocity - scalar.delay_s * row.d_position));
        h.fixed_rows_mut::<3>(ix::ATTITUDE).copy_from(&row.d_attitude);
        if let Some(i) = scalar.offset {
            h[i] = 1.0;
        }
        let mut r = scalar.r;
        if scalar.yaw_only {
            let tilt = Vector3::new(row.d_attitude.x, row.d_attitude.y, 0.0);
            let p_tilt = self.p.fixed_view::<3, 3>(ix::ATTITUDE, ix::ATTITUDE);
            r += (tilt.transpose() * p_tilt * tilt).x;
            h[ix::ATTITUDE] = 0.0;
            h[ix::ATTITUDE + 1] = 0.0;
        }
        let (ph, s) = kalman::innovation_variance(&self.p, &h, r);
        if !(row.innovation.is_finite() && s.is_finite() && s > 0.0) {
            return false;
        }
        let sigma = s.sqrt();
        let gate = scalar.gate * sigma;
        let accepted = row.innovation.abs() <= gate && !scalar.refused;
        let _ = self.estimate.residuals.try_push(Residual {
            sensor: scalar.sensor,
            channel: scalar.channel,
            innovation: row.innovation,
            sigma,
            gate,
            accepted,
        });
        if accepted {
            self.apply(&h, r, &(ph / s), row.innovation);
        }
        accepted
    }

    /// x ← x ⊕ k (y − ŷ), P in Joseph's form.
    fn apply(&mut self, h: &ErrorState, r: f64, k: &ErrorState, innovation: f64) {
        kalman::correct_scalar(&mut self.p, h, r, k);
        self.inject(&(k * innovation));
    }

    fn aid_mocap_pose(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.mocap_pose else { return };
        let position = sample.position_enu_m;
        if !finite(&position) || !sample.world_from_body.coords.iter().all(|x| x.is_finite()) {
            return;
        }
        let (sigma, gate) = (self.options.mocap_position_sigma_m, self.options.gates.mocap_pose);
        self.allow_horizontal_reset(frame.time, &position, sigma);
        let mut used = [false; 3];
        for axis in 0..3 {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let row = measure::gnss::position(&past, axis, position[axis]);
            used[axis] = self.correct(&Scalar::new(SensorKind::MocapPose, 1, XYZ[axis], row, sigma, gate, delay_s));
        }
        self.horizontal.note(frame.time, used[0] && used[1]);
        if used[2] {
            self.vertical.note(frame.time, true);
        }

        let sigma = self.options.mocap_attitude_sigma_rad;
        if !self.yaw_known || self.pose_yaw.rejected(frame.time) > self.options.recovery_s {
            let past = self.past(sample.time, frame.time).0;
            self.turn(measure::pose::attitude(&past, &sample.world_from_body)[2].innovation);
            forget(&mut self.p, ix::ATTITUDE + 2, sigma * sigma);
            self.yaw_known = true;
        }
        for (i, channel) in ANGLES.into_iter().enumerate() {
            let (past, _) = self.past(sample.time, frame.time);
            let row = measure::pose::attitude(&past, &sample.world_from_body)[i];
            let used = self.correct(&Scalar::new(SensorKind::MocapPose, 1, channel, row, sigma, gate, 0.0));
            if i == 2 {
                self.pose_yaw.note(frame.time, used);
            }
        }
    }

    /// The one-sigma believed of a position that claims `claimed_m`.
    pub(super) fn gnss_sigma_m(&self, claimed_m: f64) -> f64 {
        if claimed_m.is_finite() { claimed_m.max(self.options.gnss_floor_m) } else { 10.0 }
    }

    fn aid_gnss(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.gnss else { return };
        if !finite(&sample.position_enu_m) {
            return;
        }
        let gate = self.options.gates.gnss;
        let horizontal = self.gnss_sigma_m(sample.horizontal_sigma_m);
        let vertical = self.gnss_sigma_m(sample.vertical_sigma_m);
        let velocity_sigma = self.options.gnss_velocity_sigma_mps;
        // Horizontally the mixture has had it already where nothing else tells the yaw.
        let yaw_known = self.yaw_known;
        if yaw_known {
            self.allow_horizontal_reset(frame.time, &sample.position_enu_m, horizontal);
        } else if !self.vertical.ever() {
            self.shift(Vector3::new(0.0, 0.0, sample.position_enu_m.z - self.state.kinematics.position_enu_m.z));
            forget(&mut self.p, ix::POSITION + 2, vertical * vertical);
        }
        let mut used = [false; 3];
        for axis in if yaw_known { 0..3 } else { 2..3 } {
            // GNSS altitude is not height above this floor: only where no laser or barometer says more.
            if axis == 2 && self.heights.within(frame.time, VERTICAL_MEMORY_S) {
                continue;
            }
            let (past, delay_s) = self.past(sample.time, frame.time);
            let s = if axis == 2 { vertical } else { horizontal };
            let row = measure::gnss::position(&past, axis, sample.position_enu_m[axis]);
            used[axis] = self.correct(&Scalar::new(SensorKind::Gnss, 1, XYZ[axis], row, s, gate, delay_s));
        }
        for (axis, channel) in VELOCITY.into_iter().enumerate().skip(if yaw_known { 0 } else { 2 }) {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let v = sample.velocity_enu_mps[axis];
            if v.is_finite() {
                let row = measure::velocity::velocity(&past, axis, v);
                let s = Scalar::new(SensorKind::Gnss, 1, channel, row, velocity_sigma, gate, delay_s);
                self.correct(&s);
            }
        }
        if yaw_known {
            self.horizontal.note(frame.time, used[0] && used[1]);
        }
        if used[2] {
            self.vertical.note(frame.time, true);
        }
    }

    fn aid_camera_ranges(&mut self, frame: &SensorFrame) {
        let Some(sample) = frame.camera_ranges else { return };
        if self.horizontal_lost(frame.time)
            && let Some(position) =
                camera_range::trilaterate(&self.options.cameras_enu_m, &sample.range_m, &self.options.camera_sigma_m)
        {
            self.reset_horizontal(frame.time, &position, 0.1);
        }
        let gate = self.options.gates.camera_ranges;
        let mut used = 0;
        for (i, range_m) in sample.range_m.into_iter().enumerate() {
            let (past, delay_s) = self.past(sample.time, frame.time);
            let row = measure::camera_range::range(&past, &self.options.cameras_enu_m[i], range_m);
            let sigma = self.options.camera_sigma_m[i];
            let scalar = Scalar::new(SensorKind::CameraRanges, 1, RANGES[i], row, sigma, gate, delay_s);
            used += usize::from(self.correct(&scalar));
        }
        self.horizontal.note(frame.time, used >= 3);
        if used >= 3 {
            self.vertical.note(frame.time, true);
        }
    }

    /// Innovations of the heights that arrived; kept, so that while aligning it is heard which of them agree.
    pub(super) fn hear_heights(&mut self, frame: &SensorFrame) -> ArrayVec<(usize, f64), MAX_HEIGHTS> {
        let mut arrived: ArrayVec<(usize, f64), MAX_HEIGHTS> = ArrayVec::new();
        for (i, sample) in frame.heights.iter().enumerate() {
            let Some(sample) = sample.filter(|s| s.height_m.is_finite()) else { continue };
            let innovation = sample.height_m - self.past(sample.time, frame.time).0.position_enu_m.z;
            arrived.push((i, innovation));
            // Kept against the sum of corrections, so that it stays comparable after more of them.
            self.last_height[i] = Some((frame.time, innovation + self.corrected_z));
        }
        if !arrived.is_empty() {
            self.heights_present = true;
            self.heights_since.get_or_insert(frame.time);
        }
        arrived
    }

    fn aid_heights(&mut self, frame: &SensorFrame) {
        let mut arrived = self.hear_heights(frame);
        if arrived.is_empty() {
            return;
        }
        if !self.heights.ever() {
            // Listen to all of them before believing one: instances may report in turns.
            if self.heights_since.is_none_or(|since| frame.time.seconds_since(since) < HEIGHT_FRESH_S) {
                return;
            }
            self.recover_height(frame.time, true);
        }
        let centre = if arrived.len() == 2 { 0.0 } else { median(arrived.iter().map(|(_, y)| *y)) };
        arrived.sort_unstable_by(|a, b| (a.1 - centre).abs().total_cmp(&(b.1 - centre).abs()));
        let (sigma, gate) = (self.options.height_sigma_m, self.options.gates.height);
        let mut used = false;
        for (i, _) in arrived {
            let Some(sample) = frame.heights[i] else { continue };
            let (past, delay_s) = self.past(sample.time, frame.time);
            let mut row = measure::height::height(&past, sample.height_m);
            row.innovation -= self.beyond_reach(i, frame.time);
            let mut scalar = Scalar::new(SensorKind::Height, i + 1, Channel::Height, row, sigma, gate, delay_s);
            scalar.refused = self.outvoted(i, frame.time);
            used |= self.correct(&scalar);
        }
        self.heights.note(frame.time, used);
        if used {
            self.vertical.note(frame.time, true);
        } else if self.heights.rejected(frame.time) > self.options.recovery_s {
            self.recover_height(frame.time, false);
        }
    }

    /// Innovations of the heights heard lately, as they would be now.
    fn fresh_heights(&self, now: FlightTime) -> ArrayVec<(usize, f64), MAX_HEIGHTS> {
        let fresh = |(i, last): (usize, &Option<(FlightTime, f64)>)| {
            last.filter(|(time, _)| now.seconds_since(*time) < HEIGHT_FRESH_S).map(|(_, y)| (i, y - self.corrected_z))
        };
        self.last_height.iter().enumerate().filter_map(fresh).collect()
    }

    /// How far two honest heights of the last moments may lie apart, m.
    fn heights_apart_m(&self) -> f64 {
        // Samples up to 0.3 s apart in a climb predicted to 0.2 m/s: another 6 cm.
        std::f64::consts::SQRT_2 * self.options.gates.height * self.options.height_sigma_m + 0.06
    }

    /// How much further height `i` lies from the median of at least three than it can reach, m.
    fn beyond_reach(&self, i: usize, now: FlightTime) -> f64 {
        let reach = self.options.height_reach * self.options.height_sigma_m;
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        let own = fresh.iter().find(|(k, _)| *k == i).filter(|_| fresh.len() >= 3 && reach.is_finite());
        own.map_or(0.0, |(_, y)| (y - centre) - (y - centre).clamp(-reach, reach))
    }

    /// Does height `i` contradict the median of at least three? It is then refused even where the gate,
    /// wide after a silence or already dragged along, would let it in.
    fn outvoted(&self, i: usize, now: FlightTime) -> bool {
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        fresh.len() >= 3 && fresh.iter().any(|(k, y)| *k == i && (y - centre).abs() > self.heights_apart_m())
    }

    /// Every height has been rejected for long (or none has been used yet): the floor is where most of them
    /// agree that it is. One alone is believed only if nothing else knows the altitude.
    fn recover_height(&mut self, now: FlightTime, first: bool) {
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        let near = self.heights_apart_m();
        let agree = fresh.iter().filter(|(_, y)| (y - centre).abs() <= near).count();
        let majority = agree >= 2 && 2 * agree > fresh.len();
        let alone =
            fresh.len() == 1 && (first || !(self.vertical.within(now, VERTICAL_MEMORY_S) || self.barometer_present));
        // Two that differ from the first sample on: nothing can choose; take the middle and be degraded by
        // their rejections.
        if majority || alone || first {
            self.shift(Vector3::new(0.0, 0.0, centre));
            forget(&mut self.p, ix::POSITION + 2, near * near);
            if !first {
                let v = ix::VELOCITY + 2;
                self.p[(v, v)] += 0.5;
            }
            self.barometer_known = [false; MAX_BAROMETERS];
            self.heights.note(now, true);
            self.vertical.note(now, true);
        }
    }

    fn aid_barometers(&mut self, frame: &SensorFrame) {
        for (i, sample) in frame.barometers.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let altitude = barometer::pressure_altitude_m(sample.pressure_pa, self.options.reference_pressure_pa);
            if !altitude.is_finite() {
                continue;
            }
            self.barometer_present = true;
            let (past, delay_s) = self.past(sample.time, frame.time);
            let sigma = self.options.barometer_sigma_m;
            let state = ix::BAROMETER + i;
            if !self.barometer_known[i] {
                self.barometer_known[i] = true;
                self.state.barometer_offset_m[i] = altitude - past.position_enu_m.z;
                augment_barometer(&mut self.p, state, sigma * sigma);
                continue;
            }
            let row = barometer::altitude(&past, altitude, self.state.barometer_offset_m[i]);
            let gate = self.options.gates.barometer;
            let mut scalar =
                Scalar::new(SensorKind::Barometer, i + 1, Channel::PressureAltitude, row, sigma, gate, delay_s);
            scalar.offset = Some(state);
            let used = self.correct(&scalar);
            self.barometers[i].note(frame.time, used);
            if used {
                if !self.heights_present {
                    self.vertical.note(frame.time, true);
                }
            } else if self.barometers[i].rejected(frame.time) > self.options.recovery_s {
                // A door opened: the offset is new, the altitude is not.
                self.state.barometer_offset_m[i] = altitude - past.position_enu_m.z;
                augment_barometer(&mut self.p, state, sigma * sigma);
                self.barometers[i].note(frame.time, true);
            }
        }
    }

    fn aid_headings(&mut self, frame: &SensorFrame) {
        let mut arrived: ArrayVec<(usize, f64), MAX_IMUS> = ArrayVec::new();
        for (i, imu) in frame.imus.iter().enumerate() {
            let Some(field) = imu.and_then(|s| s.mag_ut).filter(finite) else { continue };
            if self.last_heading[i].is_some_and(|t| frame.time.seconds_since(t) < self.options.heading_period_s - 1e-4)
            {
                continue;
            }
            let at = &self.state.kinematics;
            if let Some(heading) = measure::heading::heading(at, &field, self.options.declination_rad) {
                self.last_heading[i] = Some(frame.time);
                arrived.push((i, heading.row.innovation));
            }
        }
        if arrived.is_empty() {
            return;
        }
        if !self.yaw_known {
            // The first magnetometer after a start without one.
            self.turn(median(arrived.iter().map(|(_, y)| *y)));
            forget(&mut self.p, ix::ATTITUDE + 2, super::align::YAW_SIGMA_FIELD_RAD.powi(2));
            self.yaw_known = true;
        }
        let centre = if arrived.len() == 2 { 0.0 } else { median(arrived.iter().map(|(_, y)| *y)) };
        arrived.sort_unstable_by(|a, b| wrap_pi(a.1 - centre).abs().total_cmp(&wrap_pi(b.1 - centre).abs()));
        let mut used = false;
        let mut undisturbed = false;
        for (i, _) in arrived {
            let Some(field) = frame.imus[i].and_then(|s| s.mag_ut) else { continue };
            let at = &self.state.kinematics;
            let Some(heading) = measure::heading::heading(at, &field, self.options.declination_rad) else { continue };
            let strength = *self.field_ut[i].get_or_insert_with(|| field.norm());
            let disturbed = (field.norm() / strength - 1.0).abs() > self.options.field_tolerance;
            let sigma = (self.options.mag_sigma_ut / heading.horizontal_ut).hypot(self.options.heading_floor_rad);
            let gate = self.options.gates.heading;
            let mut scalar = Scalar::new(SensorKind::Imu, i + 1, Channel::Heading, heading.row, sigma, gate, 0.0);
            scalar.yaw_only = true;
            scalar.refused = disturbed;
            undisturbed |= !disturbed;
            used |= self.correct(&scalar);
        }
        if used || undisturbed {
            self.headings.note(frame.time, used);
        }
        if !used && undisturbed && self.headings.rejected(frame.time) > 5.0 * self.options.recovery_s {
            // A field of the right strength that has pointed elsewhere for long: let yaw's variance
            // grow by 1°/√s until the gate lets it in. Gyroscopes hold yaw much longer than an iron
            // shelf passes by.
            let z = ix::ATTITUDE + 2;
            self.p[(z, z)] += 0.0175f64.powi(2) * self.options.heading_period_s;
        }
    }

    /// Without any horizontal aiding ([Paternain]: indoors there is none) tilt and velocity are bounded by
    /// what is known of a vehicle in a lab or on strings: on average it goes nowhere, and not far.
    ///
    /// This is also the levelling aid: the mean of the specific force over many seconds is gravity. It is
    /// better than correcting tilt by each accelerometer sample, which on a multirotor always points along
    /// body z whatever the tilt; velocity variance limits how fast an acceleration can be taken for tilt.
    /// Where the vertical is not aided either (attitude recordings), the same holds for it.
    pub(super) fn aid_idle(&mut self, now: FlightTime) {
        if self.idle_last.is_some_and(|t| now.seconds_since(t) < IDLE_PERIOD_S - 1e-4) {
            return;
        }
        let since = self.idle_last.map_or(IDLE_PERIOD_S, |t| now.seconds_since(t).min(1.0));
        self.idle_last = Some(now);
        // Correlated over τ, sampled every T: as informative as white noise of variance σ² 2τ/T.
        let white = |sigma: f64, tau: f64| sigma * sigma * (2.0 * tau / since).max(1.0);
        let resting = self.rest_s > 1.0;
        let o = &self.options;
        let velocity_r =
            if resting { 0.05f64.powi(2) } else { white(o.idle_velocity_sigma_mps, o.idle_velocity_correlation_s) };
        let position_r = white(o.idle_position_sigma_m, 10.0);
        let horizontal = self.horizontal.within(now, HORIZONTAL_MEMORY_S);
        let vertical = self.vertical.within(now, VERTICAL_MEMORY_S);
        for axis in 0..3 {
            let aided = if axis == 2 { vertical } else { horizontal };
            if resting || !aided {
                self.pseudo(ix::VELOCITY + axis, -self.state.kinematics.velocity_enu_mps[axis], velocity_r);
            }
            if aided {
                self.anchor[axis] = self.state.kinematics.position_enu_m[axis];
            } else {
                let innovation = self.anchor[axis] - self.state.kinematics.position_enu_m[axis];
                self.pseudo(ix::POSITION + axis, innovation, position_r);
            }
        }
    }

    fn pseudo(&mut self, i: usize, innovation: f64, r: f64) {
        let mut h = ErrorState::zeros();
        h[i] = 1.0;
        let (ph, s) = kalman::innovation_variance(&self.p, &h, r);
        if s.is_finite() && s > 0.0 {
            self.apply(&h, r, &(ph / s), innovation);
        }
    }

    /// Nothing horizontal has been accepted for `recovery_s`, or ever.
    fn horizontal_lost(&self, now: FlightTime) -> bool {
        !self.horizontal.ever() || self.horizontal.rejected(now) > self.options.recovery_s
    }

    fn allow_horizontal_reset(&mut self, now: FlightTime, position: &Vector3<f64>, sigma: f64) {
        if self.horizontal_lost(now) {
            self.reset_horizontal(now, position, sigma);
        }
    }

    fn reset_horizontal(&mut self, now: FlightTime, position: &Vector3<f64>, sigma: f64) {
        let mut shift = position - self.state.kinematics.position_enu_m;
        let vertical = self.vertical.within(now, VERTICAL_MEMORY_S);
        if vertical {
            shift.z = 0.0;
        }
        self.shift(shift);
        for axis in 0..if vertical { 2 } else { 3 } {
            forget(&mut self.p, ix::POSITION + axis, sigma * sigma);
            let v = ix::VELOCITY + axis;
            self.p[(v, v)] += if axis == 2 { 0.25 } else { 4.0 };
        }
        self.horizontal.note(now, true);
    }
}

fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}

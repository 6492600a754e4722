//! The twelve-state filters of \[Umasankar\] as estimators: what feeds the hybrid EKF and the UKF in flight and
//! over recordings.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | x | x y z, vx vy vz (world ENU), φ θ ψ, p q r (body FLU) | m, m/s, rad, rad/s |
//! | f | specific force, consensus of the accelerometers | m/s² |
//! | τ | torque of the motors as commanded: curve, lag, allocation of the airframe | N m |
//!
//! Deviations from \[Umasankar\], which flies in the open with known thrust and four cameras:
//! - Translation is driven by the specific force measured, not by T/m: strings, ground and drag then need no
//!   model. Without accelerometers for 0.1 s the commanded thrust takes over, as in the source. An
//!   accelerometer's bias, which the twelve states do not hold, enters as process noise.
//! - The gyroscopes measure p, q, r (bias taken off); the source has them inside its attitude alone.
//! - The three angles are those of the attitude filter (`attitude.rs`) with the 5 mrad of the recipe: tilt
//!   straight from an accelerometer is wrong on anything that accelerates. Motion-capture attitude, where
//!   there is one, takes their place. With GNSS and neither of a magnetometer and a pose, yaw and everything
//!   horizontal are those of a mixture over yaw, as in `ekf_bias`.
//! - Where cameras are missing: motion-capture pose, laser heights, GNSS, or a barometer from its first
//!   reading. Where nothing tells the horizontal position it stays put as it does in `ekf_bias`.
//!
//! Roll, pitch and yaw are singular at pitch ±90°. Nearer than 10° to it the angles are taken from the
//! attitude filter and the estimate is degraded.

use arrayvec::ArrayVec;
use nalgebra::{Matrix4, Vector3, Vector4};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::aiding::freshness::{Freshness, RECOVERY_S};
use super::aiding::idle::{
    Idle, POSITION_CORRELATION_S, POSITION_SIGMA_M, UNKNOWN_YAW_SIGMA_RAD, VELOCITY_CORRELATION_S, VELOCITY_SIGMA_MPS,
    whitening,
};
use super::filter::consistency::{self, Nees};
use super::filter::kalman::forget;
use super::filter::measurement::{MAX_ROWS, Measurement, TwelveState, What};
use super::filter::mocap_recipe::ANGLE_SIGMA_RAD;
use super::vqf::VqfEstimator;
use super::yaw_mixture::YawMixture;
use super::{Channel, Estimate, Estimator, EstimatorKind, Health, Residuals};
use crate::frames::{from_roll_pitch_yaw, roll_pitch_yaw, wrap_pi};
use crate::model::airframe::Airframe;
use crate::model::euler_body::{Action, EulerBody, M, X, ix, process_noise};
use crate::model::motor::Rotors;
use crate::sensor::camera_ranges;
use crate::sensor::camera_ranges::CameraRangesModel;
use crate::sensor::measure::Kinematics;
use crate::sensor::{Accuracy, SensorFrame, SensorModel};
use crate::types::{CAMERAS, MotorCommand};

/// Longest step integrated at once, s.
const LONGEST_STEP_S: f64 = 0.02;
/// A gap longer than this is not integrated across, s.
const LONGEST_GAP_S: f64 = 1.0;
/// Accelerometers silent for longer than this: the commanded thrust takes over, s.
const FORCE_SILENCE_S: f64 = 0.1;
/// An accelerometer's bias as process noise: constant for about this long, s.
const BIAS_CORRELATION_S: f64 = 1.0;
/// Angular acceleration that the torque does not explain, rad/s²/√Hz: strings, gusts, a hand.
const TURN_DENSITY: f64 = 5.0;
/// Position is known this long after the last accepted sample, s.
const MEMORY_S: f64 = 3.0;
/// A motion-capture attitude replaces that of the attitude filter this long, s.
const POSE_MEMORY_S: f64 = 0.5;
/// cos(pitch) below which roll and yaw mean little (80°).
const COS_PITCH_MIN: f64 = 0.17;
/// One-sigma at start: position m, velocity m/s, angles and rates rad, rad/s.
const START_SIGMA: [f64; 4] = [10.0, 2.0, 0.05, 0.05];

const fn first(kind: SensorKind) -> SensorId {
    SensorId { kind, instance: 1 }
}
const IMU: SensorId = first(SensorKind::Imu);
const BAROMETER: SensorId = first(SensorKind::Barometer);
const GNSS: SensorId = first(SensorKind::Gnss);
const MOCAP_POSE: SensorId = first(SensorKind::MocapPose);
const CAMERA_RANGES: SensorId = first(SensorKind::CameraRanges);
const XYZ: [Channel; 3] = [Channel::X, Channel::Y, Channel::Z];
const VELOCITY: [Channel; 3] = [Channel::VelocityX, Channel::VelocityY, Channel::VelocityZ];
const ANGLES: [Channel; 3] = [Channel::Roll, Channel::Pitch, Channel::Yaw];
const RATES: [Channel; 3] = [Channel::GyroX, Channel::GyroY, Channel::GyroZ];
const RANGES: [Channel; CAMERAS] = [Channel::Range1, Channel::Range2, Channel::Range3, Channel::Range4];

/// The wrench that the commands and the motors' lag make.
#[derive(Debug, Clone)]
struct Propulsion {
    airframe: Airframe,
    allocation: Matrix4<f64>,
    rotors: Rotors,
    voltage_ratio: f64,
}

impl Propulsion {
    fn new(airframe: &Airframe) -> Self {
        let allocation = airframe.allocation();
        Self { airframe: airframe.clone(), allocation, rotors: Rotors::default(), voltage_ratio: 1.0 }
    }

    /// Thrust (N) and torques (N m) after `dt_s` of `applied`.
    fn push(&mut self, applied: &MotorCommand, battery_v: Option<f64>, dt_s: f64) -> Vector4<f64> {
        if let Some(ratio) = battery_v.map(|v| v / self.airframe.battery.nominal_v()).filter(|r| r.is_finite()) {
            self.voltage_ratio += (dt_s / 0.2).min(1.0) * (ratio.clamp(0.7, 1.25) - self.voltage_ratio);
        }
        self.rotors.step(&self.airframe, &applied.throttle, self.voltage_ratio, dt_s);
        let thrust = |speed: f64| self.airframe.thrust_coefficient_ns2 * speed * speed;
        self.allocation * Vector4::from_iterator(self.rotors.speed_radps().iter().map(|s| thrust(*s)))
    }
}

/// A twelve-state filter in flight. See the module.
pub struct TwelveStateEstimator<F> {
    model: SensorModel,
    filter: F,
    attitude: VqfEstimator,
    propulsion: Propulsion,
    accel_density: f64,
    now: Option<FlightTime>,
    started: bool,
    force: Option<(FlightTime, Vector3<f64>)>,
    rows: ArrayVec<Measurement, MAX_ROWS>,
    axes: [Freshness; 3],
    pose_seen: Option<FlightTime>,
    field_seen: bool,
    mixture: YawMixture,
    heights_present: bool,
    barometer_origin_m: Option<f64>,
    idle: Idle,
    estimate: Estimate,
}

impl<F: TwelveState> TwelveStateEstimator<F> {
    /// On `airframe`, with sensors like these.
    pub fn new(airframe: &Airframe, model: SensorModel) -> Self {
        let body = EulerBody {
            mass_kg: airframe.mass_kg,
            inertia_kgm2: airframe.inertia_kgm2,
            gravity_mps2: model.imus.gravity_mps2,
        };
        let accel = &model.imus.accel;
        let bias = accel.bias_prior * (2.0 * BIAS_CORRELATION_S).sqrt();
        let accel_density = accel.noise_density.hypot(accel.common_noise_density).hypot(bias);
        Self {
            filter: F::new(body, X::zeros(), M::identity()),
            attitude: VqfEstimator::new(&model.imus),
            propulsion: Propulsion::new(airframe),
            accel_density,
            model,
            now: None,
            started: false,
            force: None,
            rows: ArrayVec::new(),
            axes: [Freshness::default(); 3],
            pose_seen: None,
            field_seen: false,
            mixture: YawMixture::new(),
            heights_present: false,
            barometer_origin_m: None,
            idle: Idle::default(),
            estimate: Estimate::default(),
        }
    }

    /// State and covariance now, for consistency tests.
    pub fn moments(&self) -> (X, M) {
        self.filter.moments()
    }

    fn start(&mut self) {
        let e = self.attitude.estimate();
        let mut x = X::zeros();
        x.fixed_rows_mut::<3>(ix::X).copy_from(&self.idle.anchor);
        x.fixed_rows_mut::<3>(ix::ROLL).copy_from(&roll_pitch_yaw(&e.world_from_body));
        x.fixed_rows_mut::<3>(ix::P).copy_from(&e.body_rates_radps);
        let mut p = M::identity();
        for i in 0..12 {
            p[(i, i)] = START_SIGMA[i / 3].powi(2);
        }
        if !self.field_seen {
            p[(ix::YAW, ix::YAW)] = UNKNOWN_YAW_SIGMA_RAD.powi(2);
        }
        self.filter.restart(x, p);
        self.axes = [Freshness::default(); 3];
        self.started = true;
    }

    /// What acts now: the specific force measured lately, else that of the motors; their torque.
    fn action(&self, now: FlightTime, wrench: &Vector4<f64>) -> Action {
        let measured = self.force.filter(|(time, _)| now.seconds_since(*time) <= FORCE_SILENCE_S).map(|(_, f)| f);
        let thrust = Vector3::new(0.0, 0.0, wrench.x / self.propulsion.airframe.mass_kg);
        Action { force_mps2: measured.unwrap_or(thrust), torque_nm: Vector3::new(wrench.y, wrench.z, wrench.w) }
    }

    fn propagate(&mut self, dt_s: f64, action: &Action) {
        let steps = (dt_s / LONGEST_STEP_S).ceil().clamp(1.0, 64.0);
        let h = dt_s / steps;
        let q = process_noise(self.accel_density, TURN_DENSITY, h);
        for _ in 0..steps as usize {
            self.filter.predict(action, h, &q);
        }
    }

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
    fn flush(&mut self) {
        let now = self.now.unwrap_or_default();
        let before = self.estimate.residuals.len();
        self.filter.correct(&self.rows, &mut self.estimate.residuals);
        self.rows.clear();
        let (mut ranges, mut ranged) = (0, false);
        let mut heights = None;
        for r in self.estimate.residuals.iter().skip(before) {
            match r.channel {
                Channel::X => self.axes[0].note(now, r.accepted),
                Channel::Y => self.axes[1].note(now, r.accepted),
                Channel::Z | Channel::PressureAltitude => self.axes[2].note(now, r.accepted),
                Channel::Height => heights = Some(heights.unwrap_or(false) | r.accepted),
                Channel::Range1 | Channel::Range2 | Channel::Range3 | Channel::Range4 => {
                    ranged = true;
                    ranges += u8::from(r.accepted);
                }
                _ => {}
            }
        }
        if ranged {
            self.axes.iter_mut().for_each(|axis| axis.note(now, ranges >= 3));
        }
        // One accepted height of several is enough.
        if let Some(accepted) = heights {
            self.axes[2].note(now, accepted);
        }
        // The rates are an inner matter: the deviation of each IMU from the consensus is shown instead.
        self.estimate.residuals.retain(|r| !RATES.contains(&r.channel) || r.gate.is_finite());
    }

    /// Gyroscopes and attitude.
    fn take_attitude(&mut self, frame: &SensorFrame, fresh: bool) {
        self.field_seen |= frame.imus.iter().flatten().any(|s| s.mag_ut.is_some());
        if let Some(pose) = frame.mocap_pose.filter(|s| s.world_from_body.coords.iter().all(|x| x.is_finite())) {
            self.pose_seen = Some(frame.time);
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
        if self.pose_seen.is_some_and(|t| frame.time.seconds_since(t) <= POSE_MEMORY_S) {
            return;
        }
        let angles = roll_pitch_yaw(&attitude);
        let noise = Accuracy::ungated(ANGLE_SIGMA_RAD);
        for i in 0..3 {
            self.take(IMU, ANGLES[i], What::Angle(ix::ROLL + i), angles[i], noise);
        }
    }

    fn take_positions(&mut self, frame: &SensorFrame) {
        let (x, _) = self.filter.moments();
        let velocity = Vector3::new(x[ix::VX], x[ix::VY], x[ix::VZ]);
        // A late sample, brought forward by the velocity.
        let late = |time: FlightTime| velocity * frame.time.seconds_since(time).clamp(0.0, 0.5);
        let model = self.model.clone();
        if let Some(sample) = frame.camera_ranges {
            let CameraRangesModel { cameras_enu_m: cameras, sigma_m: sigmas, gate } = model.camera_ranges;
            if self.axes[0].lost(frame.time, RECOVERY_S)
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
            let noise = model.mocap_pose.position;
            let place = sample.position_enu_m + late(sample.time);
            for axis in 0..3 {
                self.recover(frame.time, axis, place[axis], noise.sigma);
                self.take(MOCAP_POSE, XYZ[axis], What::State(axis), place[axis], noise);
            }
        }
        for (i, sample) in frame.heights.iter().enumerate() {
            let Some(sample) = sample.filter(|s| s.height_m.is_finite()) else { continue };
            self.heights_present = true;
            let height_m = sample.height_m + late(sample.time).z;
            self.recover(frame.time, 2, height_m, model.heights.sigma);
            let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
            self.take(sensor, Channel::Height, What::State(ix::Z), height_m, model.heights);
        }
        let yaw_measured = self.yaw_measured();
        if let Some(sample) = frame.gnss {
            let place = sample.position_enu_m + late(sample.time);
            for axis in if yaw_measured { 0..3 } else { 2..3 } {
                let claimed_m = if axis < 2 { sample.horizontal_sigma_m } else { sample.vertical_sigma_m };
                let noise = model.gnss.position(claimed_m);
                // A laser has the floor as its zero: it alone tells the height where there is one.
                if axis < 2 || !self.heights_present {
                    self.recover(frame.time, axis, place[axis], noise.sigma);
                    self.take(GNSS, XYZ[axis], What::State(axis), place[axis], noise);
                }
                let speed = sample.velocity_enu_mps[axis];
                self.take(GNSS, VELOCITY[axis], What::State(ix::VX + axis), speed, model.gnss.velocity);
            }
        }
        let measured = self.heights_present || frame.gnss.is_some() || self.axes[2].ever();
        if let Some(sample) = frame.barometers[0].filter(|_| !measured || self.barometer_origin_m.is_some()) {
            let altitude = model.barometers.altitude_m(&sample);
            if altitude.is_finite() && !self.heights_present {
                let origin = *self.barometer_origin_m.get_or_insert(altitude - x[ix::Z]);
                self.take(
                    BAROMETER,
                    Channel::PressureAltitude,
                    What::State(ix::Z),
                    altitude - origin,
                    model.barometers.altitude,
                );
            }
        }
    }

    /// Does anything but position fixes measure the yaw?
    fn yaw_measured(&self) -> bool {
        self.field_seen || self.pose_seen.is_some()
    }

    /// Shows the mixture what arrived, from the first sample on.
    fn feed_mixture(&mut self, frame: &SensorFrame, force: Option<Vector3<f64>>) {
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
        self.mixture.take(now, &sample, gnss.position(sample.horizontal_sigma_m).sigma, gnss.velocity.sigma);
        (0..2).for_each(|axis| self.axes[axis].note(now, true));
    }

    /// Takes yaw, tilt and everything horizontal from the mixture where nothing else tells the yaw.
    fn follow_mixture(&mut self) {
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
        if value.is_finite() && self.axes[axis].lost(now, RECOVERY_S) {
            self.relocate(axis, value, 3.0 * sigma);
            self.axes[axis].note(now, true);
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
    fn take_idle(&mut self, now: FlightTime) {
        let Some(since_s) = self.idle.due(now) else { return };
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
            if self.axes[axis].within(now, MEMORY_S) {
                self.idle.anchor[axis] = x[axis];
            } else {
                rows.push(still(ix::VX + axis, 0.0, velocity));
                rows.push(still(axis, self.idle.anchor[axis], position));
            }
        }
        if !rows.is_empty() {
            self.filter.correct(&rows, &mut Residuals::new());
        }
    }

    /// Wraps the angles, and keeps away from the singularity and from numbers that are none.
    fn tidy(&mut self) -> bool {
        let (mut x, mut p) = self.filter.moments();
        if !(x.iter().all(|v| v.is_finite()) && p.diagonal().iter().all(|v| v.is_finite() && *v >= 0.0)) {
            self.start();
            return false;
        }
        let singular = x[ix::PITCH].cos() < COS_PITCH_MIN;
        if singular {
            let angles = roll_pitch_yaw(&self.attitude.estimate().world_from_body);
            x.fixed_rows_mut::<3>(ix::ROLL).copy_from(&angles);
            for i in ix::ROLL..=ix::YAW {
                forget(&mut p, i, START_SIGMA[2].powi(2));
            }
        }
        let wrapped = singular || (ix::ROLL..=ix::YAW).any(|i| x[i].abs() > std::f64::consts::PI);
        if wrapped {
            (ix::ROLL..=ix::YAW).for_each(|i| x[i] = wrap_pi(x[i]));
            self.filter.restart(x, p);
        }
        !singular
    }

    fn publish(&mut self, now: FlightTime, sound: bool) {
        let (x, p) = self.filter.moments();
        let part = |i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
        let sigma = |i: usize| Vector3::from_fn(|a, _| p[(i + a, i + a)].max(0.0).sqrt());
        let attitude = self.attitude.estimate();
        let e = &mut self.estimate;
        e.time = now;
        e.position_enu_m = part(ix::X);
        e.velocity_enu_mps = part(ix::VX);
        e.world_from_body = from_roll_pitch_yaw(&part(ix::ROLL));
        e.body_rates_radps = part(ix::P);
        e.gyro_bias_radps = attitude.gyro_bias_radps;
        e.position_sigma_m = Some(sigma(ix::X));
        e.velocity_sigma_mps = Some(sigma(ix::VX));
        e.attitude_sigma_rad = Some(sigma(ix::ROLL));
        e.horizontal_known = self.axes[0].within(now, MEMORY_S) && self.axes[1].within(now, MEMORY_S);
        e.altitude_known = self.axes[2].within(now, MEMORY_S);
        let altitude_lost = self.axes[2].lapsed(now, MEMORY_S);
        e.health = if altitude_lost || !sound || attitude.health != Health::Healthy {
            Health::Degraded
        } else {
            Health::Healthy
        };
    }
}

impl<F: TwelveState> Estimator for TwelveStateEstimator<F> {
    fn kind(&self) -> EstimatorKind {
        F::KIND
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        let dt_s = self.now.map_or(0.0, |t| now.seconds_since(t)).max(0.0);
        self.now = Some(now);
        self.estimate.residuals.clear();
        let ready = self.attitude.step(received, applied).health != Health::Initialising;
        // Rows of the attitude filter's own innovations: each IMU against the others, and the heading.
        self.estimate.residuals.extend(self.attitude.estimate().residuals.iter().copied());
        let fresh = self.attitude.specific_force_mps2().filter(|(time, _)| *time == now);
        self.feed_mixture(received, fresh.map(|(_, force)| force));
        let wrench = self.propulsion.push(applied, received.battery_v, dt_s);
        let action = self.action(now, &wrench);
        self.force = fresh.or(self.force);
        if self.started && dt_s > LONGEST_GAP_S {
            self.started = false;
        }
        if !self.started {
            if !ready {
                self.estimate.time = now;
                self.estimate.health = Health::Initialising;
                return &self.estimate;
            }
            self.start();
        } else if dt_s > 0.0 {
            self.propagate(dt_s, &action);
        }
        self.take_attitude(received, fresh.is_some());
        self.take_positions(received);
        self.flush();
        self.take_idle(now);
        self.follow_mixture();
        let sound = self.tidy();
        self.publish(now, sound);
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn reset_to(&mut self, estimate: &Estimate) {
        self.attitude.reset_to(estimate);
        self.idle.anchor = estimate.position_enu_m;
        self.start();
        let (mut x, mut p) = self.filter.moments();
        x.fixed_rows_mut::<3>(ix::VX).copy_from(&estimate.velocity_enu_mps);
        let sigmas = [estimate.position_sigma_m, estimate.velocity_sigma_mps, estimate.attitude_sigma_rad];
        for (block, sigma) in sigmas.iter().enumerate() {
            for axis in 0..3 {
                if let Some(sigma) = sigma.map(|s| s[axis]).filter(|s| *s > 0.0 && s.is_finite()) {
                    p[(3 * block + axis, 3 * block + axis)] = sigma * sigma;
                }
            }
        }
        self.filter.restart(x, p);
        self.now = Some(estimate.time);
        self.estimate = estimate.clone();
        self.estimate.residuals.clear();
    }

    fn nees(&self, truth: &Kinematics) -> Option<Nees> {
        let (x, p) = self.filter.moments();
        let mut error = consistency::error(truth, &self.estimate.kinematics());
        // Its attitude errors are those of the angles, not about the world axes.
        let angles = roll_pitch_yaw(&truth.world_from_body);
        for i in 0..3 {
            error[ix::ROLL + i] = wrap_pi(angles[i] - x[ix::ROLL + i]);
        }
        consistency::nees(&error, &p.fixed_view::<9, 9>(0, 0).into_owned())
    }
}

//! Error-state EKF with accelerometer- and gyroscope-bias states (\[Paternain\] V, on the corrected model).
//!
//! The IMUs are the process input, not measurements: their errors are the biases and the noise in Q.
//! \[Paternain\] feeds velocities integrated from the accelerometer back as measurements, which counts the
//! same noise twice (errata 8); here velocity is predicted by them and corrected by what really measures it.
//! Q has what data sheets say, and what vibration leaves of it, measured from sample to sample.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | p, v | position and velocity in the world frame ENU | m, m/s |
//! | R | world_from_body; error δφ about the world axes, R = exp(δφ×)R̂ | rad |
//! | b_a, b_g | biases: f = f_m − b_a, ω = ω_m − b_g | m/s², rad/s |
//! | o | offset of each of two barometers: y = z + o | m |
//! | f, ω | specific force and angular rate in the body frame, consensus of the IMUs | m/s², rad/s |
//!
//! ```text
//! ṗ = v     v̇ = R f + g     Ṙ = R ω×                       [Paternain] Eq. 2 in the world frame
//! ```
//!
//! One tick: consensus of the IMUs, propagate, remember, correct with what arrived (`aiding.rs`), and bound
//! what nothing measures. Without horizontal aiding the accelerometer's horizontal bias cannot be distinguished from
//! tilt (rank 8 of the 15 error states before o, errata 8): its variance then simply stays at its prior.
//!
//! Assumes: a flat, still world (no Earth rate), IMUs near the centre of mass.

pub(super) mod aiding;
pub(super) mod align;
pub(super) mod covariance;
pub(super) mod heading;
mod history;
mod idle;
mod imus;
#[cfg(test)]
pub(super) mod tests;
mod vertical;
pub mod yaw;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use self::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use self::align::{Aligned, Alignment};
use self::covariance::{Covariance, ErrorState, Noise, ix};
use self::heading::Headings;
use self::history::History;
use self::imus::{Imus, Inertial, Rest};
use self::vertical::{Barometers, Heights};
use super::aiding::floor::Floor;
use super::aiding::freshness::Freshness;
use super::aiding::idle::{Idle, POSITION_SIGMA_M, UNKNOWN_YAW_SIGMA_RAD};
use super::aiding::vibration::Vibration;
use super::filter::consistency::{self, Nees};
use super::yaw_mixture::YawMixture;
use super::{Estimate, Estimator, EstimatorKind, Health, Motion};
use crate::sensor::imu::{ImuModel, TriaxialModel};
use crate::sensor::measure::Kinematics;
use crate::sensor::{Accuracy, MAX_BAROMETERS, MocapPoseSample, SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// Longest step integrated at once, s; longer ones are divided.
const LONGEST_STEP_S: f64 = 0.02;
/// A gap longer than this is not integrated across, s: the attitude is found again.
const LONGEST_GAP_S: f64 = 1.0;
/// No IMU for this long is degraded, s.
const IMU_SILENCE_S: f64 = 0.1;
/// Specific force that changes by more than this between two samples, which no vibration does, was a blow, and not seen
/// whole, m/s².
const BLOW_MPS2: f64 = 60.0;
/// A tilt less certain than this is degraded, rad.
const TILT_SIGMA_DEGRADED_RAD: f64 = 0.15;

/// The estimated state.
#[derive(Debug, Clone)]
struct State {
    kinematics: Kinematics,
    accel_bias_mps2: Vector3<f64>,
    gyro_bias_radps: Vector3<f64>,
    barometer_offset_m: [f64; MAX_BAROMETERS],
}

/// The filter. See the module.
#[derive(Clone)]
pub struct EkfBias {
    model: SensorModel,
    state: State,
    p: Covariance,
    history: History,
    imus: Imus,
    estimate: Estimate,

    aligned: bool,
    alignment: Alignment,
    now: Option<FlightTime>,
    /// The last consensus of the IMUs.
    inertial: Option<Inertial>,
    vibration: Vibration,
    rest: Rest,
    /// Over the floor it stands on, m.
    standing_m: f64,

    aided: Aided,
    /// Measured by a magnetometer or motion capture.
    yaw_known: bool,
    mixture: YawMixture,
}

/// What has been corrected by which sensors, and when.
#[derive(Debug, Clone, Copy, Default)]
struct Aided {
    horizontal: Freshness,
    vertical: Freshness,
    heights: Heights,
    barometers: Barometers,
    headings: Headings,
    pose_yaw: Freshness,
    /// Beside a barometer only.
    floor: Floor,
    idle: Idle,
}

impl EkfBias {
    /// Nothing known yet; it aligns itself on the first second of samples.
    pub fn new(model: SensorModel) -> Self {
        Self {
            imus: Imus::new(&model.imus),
            model,
            state: State {
                kinematics: Kinematics {
                    position_enu_m: Vector3::zeros(),
                    velocity_enu_mps: Vector3::zeros(),
                    world_from_body: UnitQuaternion::identity(),
                },
                accel_bias_mps2: Vector3::zeros(),
                gyro_bias_radps: Vector3::zeros(),
                barometer_offset_m: [0.0; MAX_BAROMETERS],
            },
            p: Covariance::zeros(),
            history: History::new(),
            estimate: Estimate::default(),
            aligned: false,
            alignment: Alignment::new(),
            now: None,
            inertial: None,
            vibration: Vibration::default(),
            rest: Rest::default(),
            standing_m: 0.0,
            aided: Aided::default(),
            yaw_known: false,
            mixture: YawMixture::new(),
        }
    }

    /// Begun where no laser or pose tells the altitude, it is `height_m` over the floor, m: it stands on its feet.
    pub fn standing_at(mut self, height_m: f64) -> Self {
        self.standing_m = height_m;
        self
    }

    /// A height further than so many sigmas from the median of those of the last moments (at least three) moves the
    /// state as if it were so far (Huber).
    #[must_use]
    pub fn with_height_reach(mut self, sigmas: f64) -> Self {
        self.aided.heights.reach = Some(sigmas);
        self
    }

    /// Covariance of the error state: δp, δv, δφ (about the world axes), δb_a, δb_g, barometer offsets.
    /// For consistency tests (NEES) and plots.
    pub fn covariance(&self) -> &nalgebra::SMatrix<f64, 17, 17> {
        &self.p
    }

    /// Sums of all corrections of height (m) and climb (m/s) so far: what lies between its path and the one that
    /// the IMUs alone would have given.
    pub fn vertical_corrections(&self) -> (f64, f64) {
        self.history.vertical_corrections()
    }

    /// From now on a height's noise is taken for `sigma_m`; its gate and its reach stay what they are in metres.
    pub fn assume_height_sigma(&mut self, sigma_m: f64) {
        let factor = self.model.heights.sigma / sigma_m;
        self.model.heights = Accuracy { sigma: sigma_m, gate: self.model.heights.gate * factor };
        self.aided.heights.reach.iter_mut().for_each(|reach| *reach *= factor);
    }

    /// An attacked IMU was used: up to half a gate of its attack may have been taken for a bias. Opens the
    /// variance of the accelerometer's bias again where something measures it: upward, and in the plane while the
    /// horizontal position is known.
    pub fn open_accel_bias(&mut self) {
        let accel = &self.model.imus.accel;
        let sigma = 0.5 * accel.gate * accel.sigma;
        let up = self.state.kinematics.world_from_body.inverse() * Vector3::z();
        let plane = self.now.is_some_and(|now| self.aided.horizontal.within(now, HORIZONTAL_MEMORY_S));
        let measured = if plane { Matrix3::identity() } else { up * up.transpose() };
        let mut block = self.p.fixed_view_mut::<3, 3>(ix::ACCEL_BIAS, ix::ACCEL_BIAS);
        block += measured * (sigma * sigma);
    }

    /// Specific force at the last IMU sample, biases removed, body FLU, m/s²; `None` before the first.
    pub fn specific_force_mps2(&self) -> Option<Vector3<f64>> {
        self.inertial.map(|i| i.accel_mps2 - self.state.accel_bias_mps2)
    }

    /// The state when a sample of `time` was taken, and its age, s.
    fn past(&self, time: FlightTime, now: FlightTime) -> (Kinematics, f64) {
        self.history.at(time, now, &self.state.kinematics)
    }

    /// x ← x ⊕ δx.
    fn inject(&mut self, dx: &ErrorState) {
        let block = |i: usize| Vector3::new(dx[i], dx[i + 1], dx[i + 2]);
        let (position, velocity, attitude) = (block(ix::POSITION), block(ix::VELOCITY), block(ix::ATTITUDE));
        let k = &mut self.state.kinematics;
        k.position_enu_m += position;
        k.velocity_enu_mps += velocity;
        k.world_from_body = UnitQuaternion::from_scaled_axis(attitude) * k.world_from_body;
        self.state.accel_bias_mps2 += block(ix::ACCEL_BIAS);
        self.state.gyro_bias_radps += block(ix::GYRO_BIAS);
        for (i, offset) in self.state.barometer_offset_m.iter_mut().enumerate() {
            *offset += dx[ix::BAROMETER + i];
        }
        self.history.corrected(&position, &velocity, &attitude);
    }

    /// Moves the position without touching P.
    fn shift(&mut self, by: Vector3<f64>) {
        self.state.kinematics.position_enu_m += by;
        self.history.corrected(&by, &Vector3::zeros(), &Vector3::zeros());
    }

    /// Turns yaw without touching P. Position and velocity stay: what measures them does so in the world.
    fn turn(&mut self, yaw_rad: f64) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw_rad);
        let k = &mut self.state.kinematics;
        k.world_from_body = turn * k.world_from_body;
        self.history.corrected(&Vector3::zeros(), &Vector3::zeros(), &(Vector3::z() * yaw_rad));
    }

    /// Attitude from the first samples; the rest of the state starts around it.
    fn align(&mut self, frame: &SensorFrame, dt_s: f64, inertial: &Inertial) {
        let mut field = Vector3::zeros();
        let mut fields = 0.0;
        for mag in frame.imus.iter().flatten().filter_map(|s| s.mag_ut).filter(|m| m.iter().all(|x| x.is_finite())) {
            field += mag;
            fields += 1.0;
        }
        let field = (fields > 0.0).then(|| field / fields);
        let (gravity, declination) = (self.model.imus.gravity_mps2, self.model.imus.mag.declination_rad);
        let (gyro, accel) = (&inertial.gyro_radps, &inertial.accel_mps2);
        if let Some(found) = self.alignment.push(dt_s, gyro, accel, field.as_ref(), gravity, declination) {
            self.begin(&found);
        }
    }

    /// Motion capture says where the vehicle is before the attitude is known: a start in motion begins there.
    fn wait_at_pose(&mut self, frame: &SensorFrame) {
        let finite = |pose: &MocapPoseSample| pose.position_enu_m.iter().all(|x| x.is_finite());
        if let Some(pose) = frame.mocap_pose.filter(finite) {
            self.state.kinematics.position_enu_m = pose.position_enu_m;
        }
    }

    fn begin(&mut self, found: &Aligned) {
        let imus = &self.model.imus;
        self.state.kinematics.world_from_body = found.world_from_body;
        self.state.gyro_bias_radps = found.gyro_bias_radps;
        let z_m = &mut self.state.kinematics.position_enu_m.z;
        if !self.aided.heights.present && *z_m == 0.0 {
            *z_m = self.standing_m;
            self.aided.idle.anchor.z = self.standing_m;
        }
        let (tilt, gyro_bias, velocity) = if found.at_rest {
            (align::TILT_SIGMA_REST_RAD, align::GYRO_BIAS_SIGMA_REST_RADPS, 0.1)
        } else {
            (align::TILT_SIGMA_MOVING_RAD, imus.gyro.bias_prior, 3.0)
        };
        self.yaw_known = found.field_ut.is_some();
        let yaw = if self.yaw_known { align::YAW_SIGMA_FIELD_RAD } else { UNKNOWN_YAW_SIGMA_RAD };
        let accel_bias = self.accel_bias_variance();
        self.p = Covariance::zeros();
        for i in 0..3 {
            self.p[(ix::POSITION + i, ix::POSITION + i)] = POSITION_SIGMA_M.powi(2);
            self.p[(ix::VELOCITY + i, ix::VELOCITY + i)] = velocity * velocity;
            self.p[(ix::ATTITUDE + i, ix::ATTITUDE + i)] = if i == 2 { yaw * yaw } else { tilt * tilt };
            self.p[(ix::ACCEL_BIAS + i, ix::ACCEL_BIAS + i)] = accel_bias;
            self.p[(ix::GYRO_BIAS + i, ix::GYRO_BIAS + i)] = gyro_bias * gyro_bias;
        }
        self.aligned = true;
        self.aided.vertical = Freshness::default();
        if self.yaw_known || self.mixture.horizontal().is_none() {
            self.aided.horizontal = Freshness::default();
        }
        self.aided.heights.freshness = Freshness::default();
        self.aided.barometers.forget();
        self.history.clear();
    }

    /// Of the bias that the mean of the accelerometers has, before more is known, (m/s²)².
    fn accel_bias_variance(&self) -> f64 {
        self.model.imus.accel.bias_prior.powi(2) / self.imus.used() as f64
    }

    /// Propagates state and covariance over `dt_s`; `unseen_mps` is the velocity that a blow may have given unseen.
    fn propagate(&mut self, dt_s: f64, rate_radps: &Vector3<f64>, force_mps2: &Vector3<f64>, unseen_mps: f64) {
        let ImuModel { gyro, accel, gravity_mps2, .. } = &self.model.imus;
        let share = 1.0 / self.imus.used() as f64;
        let density =
            |of: &TriaxialModel| Vector3::repeat(of.noise_density.powi(2) * share + of.common_noise_density.powi(2));
        let squares = self.state.kinematics.world_from_body.to_rotation_matrix().matrix().map(|x| x * x);
        let [shaken, turned] = self.vibration.densities().map(|density| squares * density);
        let noise = Noise {
            accel: density(accel).add_scalar(unseen_mps * unseen_mps / dt_s) + shaken,
            gyro: density(gyro) + turned,
            accel_bias: self.vibration.widens(accel.bias_walk.powi(2), self.accel_bias_variance()),
            gyro_bias: (gyro.bias_walk.powi(2), gyro.bias_prior.powi(2)),
            barometer: self.model.barometers.walk.powi(2),
        };
        let rate = rate_radps - self.state.gyro_bias_radps;
        let force = force_mps2 - self.state.accel_bias_mps2;
        let gravity = Vector3::new(0.0, 0.0, -gravity_mps2);
        let steps = (dt_s / LONGEST_STEP_S).ceil().clamp(1.0, 64.0);
        let dt = dt_s / steps;
        for _ in 0..steps as usize {
            let k = &mut self.state.kinematics;
            let middle = (k.world_from_body * UnitQuaternion::from_scaled_axis(rate * (0.5 * dt))).to_rotation_matrix();
            let force_world = middle * force;
            let acceleration = force_world + gravity;
            k.position_enu_m += k.velocity_enu_mps * dt + acceleration * (0.5 * dt * dt);
            k.velocity_enu_mps += acceleration * dt;
            k.world_from_body *= UnitQuaternion::from_scaled_axis(rate * dt);
            covariance::propagate(&mut self.p, &force_world, middle.matrix(), dt, &noise);
        }
        self.state.kinematics.world_from_body.renormalize_fast();
    }

    /// Rate and force that, held over the last `dt_s`, make the whole interval between two IMU samples a
    /// trapezoid. Ticks without an IMU sample hold the last one; the next sample makes up for it.
    fn bridge(&self, previous: &Inertial, current: &Inertial, dt_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let whole = current.time.seconds_since(previous.time);
        let held = (whole - dt_s).max(0.0);
        let mean = |a: &Vector3<f64>, b: &Vector3<f64>| {
            let trapezoid = (a + b) * 0.5;
            if held > 1e-6 && held < 4.0 * dt_s { (trapezoid * whole - a * held) / dt_s } else { trapezoid }
        };
        (mean(&previous.gyro_radps, &current.gyro_radps), mean(&previous.accel_mps2, &current.accel_mps2))
    }

    fn health(&self, now: FlightTime) -> Health {
        if !self.aligned {
            return Health::Initialising;
        }
        let tilt = self.p[(ix::ATTITUDE, ix::ATTITUDE)].max(self.p[(ix::ATTITUDE + 1, ix::ATTITUDE + 1)]);
        let silent = self.inertial.is_none_or(|i| now.seconds_since(i.time) > IMU_SILENCE_S);
        // Altitude was measured once and is not any more.
        let altitude_lost = (self.aided.heights.present || self.aided.vertical.ever()) && !self.altitude_known(now);
        let tilted = tilt.is_nan() || tilt > TILT_SIGMA_DEGRADED_RAD.powi(2);
        if silent || !self.imus.trusted() || altitude_lost || tilted { Health::Degraded } else { Health::Healthy }
    }

    /// Measured lately; by lasers, where there are any.
    fn altitude_known(&self, now: FlightTime) -> bool {
        self.aided.vertical.within(now, VERTICAL_MEMORY_S)
            && (!self.aided.heights.present || self.aided.heights.freshness.within(now, VERTICAL_MEMORY_S))
    }

    fn publish(&mut self, now: FlightTime) {
        let altitude_known = self.altitude_known(now);
        let k = &self.state.kinematics;
        let sigma = |i: usize| Vector3::from_fn(|a, _| self.p[(i + a, i + a)].max(0.0).sqrt());
        let e = &mut self.estimate;
        e.time = now;
        e.motion = Some(Motion {
            position_enu_m: k.position_enu_m,
            velocity_enu_mps: k.velocity_enu_mps,
            position_sigma_m: Some(sigma(ix::POSITION)),
            velocity_sigma_mps: Some(sigma(ix::VELOCITY)),
            horizontal_known: self.aided.horizontal.within(now, HORIZONTAL_MEMORY_S),
            heights_off_sigma_m: None,
            altitude_known,
        });
        e.world_from_body = k.world_from_body;
        e.accel_bias_mps2 = Some(self.state.accel_bias_mps2);
        e.gyro_bias_radps = Some(self.state.gyro_bias_radps);
        if let Some(i) = &self.inertial {
            e.body_rates_radps = i.gyro_radps - self.state.gyro_bias_radps;
        }
        let mut attitude_sigma_rad = sigma(ix::ATTITUDE);
        // Nothing corrects what accelerometers in the plane rectify of vibration: tilt takes it for gravity.
        let lasting_rad = self.vibration.lasting_mps2() / self.model.imus.gravity_mps2;
        attitude_sigma_rad.iter_mut().take(2).for_each(|sigma| *sigma = sigma.hypot(lasting_rad));
        e.attitude_sigma_rad = Some(attitude_sigma_rad);
        self.estimate.health = self.health(now);
    }

    /// Starts again from `estimate`: at rest at the origin where that holds no motion, with the biases' prior. A yaw that
    /// nothing has measured stays so.
    pub fn reset_to(&mut self, estimate: &Estimate) {
        let accel_bias = self.accel_bias_variance();
        let imus = &self.model.imus;
        let variance = |sigma: &Option<Vector3<f64>>, i: usize, default: f64| {
            let sigma = sigma.map(|s| s[i]).filter(|s| s.is_finite() && *s > 0.0).unwrap_or(default);
            sigma * sigma
        };
        let motion = estimate.motion_or_rest();
        self.p = Covariance::zeros();
        for i in 0..3 {
            self.p[(ix::POSITION + i, ix::POSITION + i)] = variance(&motion.position_sigma_m, i, 0.5);
            self.p[(ix::VELOCITY + i, ix::VELOCITY + i)] = variance(&motion.velocity_sigma_mps, i, 0.5);
            self.p[(ix::ATTITUDE + i, ix::ATTITUDE + i)] = variance(&estimate.attitude_sigma_rad, i, 0.1);
            self.p[(ix::ACCEL_BIAS + i, ix::ACCEL_BIAS + i)] = accel_bias;
            self.p[(ix::GYRO_BIAS + i, ix::GYRO_BIAS + i)] = imus.gyro.bias_prior.powi(2);
        }
        self.state.kinematics = estimate.kinematics();
        self.state.accel_bias_mps2 = estimate.accel_bias_mps2.unwrap_or_default();
        self.state.gyro_bias_radps = estimate.gyro_bias_radps.unwrap_or_default();
        self.aided.barometers.forget();
        self.history.clear();
        self.aided.idle.anchor = motion.position_enu_m;
        self.aligned = estimate.health != Health::Initialising;
        self.alignment = Alignment::new();
        self.now = Some(estimate.time.max(self.now.unwrap_or_default()));
        self.estimate = estimate.clone();
        self.estimate.residuals.clear();
    }

    /// Starts over where it last made sense: numbers that are not finite must never fly.
    fn recover_from_numbers(&mut self) {
        let kept = std::mem::take(&mut self.estimate);
        self.reset_to(&kept);
        self.estimate.health = Health::Degraded;
    }
}

/// Half of what the change of specific force makes of the time between two samples, m/s, where it was a blow.
fn unseen(previous: &Inertial, current: &Inertial) -> f64 {
    let change_mps2 = (current.accel_mps2 - previous.accel_mps2).norm();
    if change_mps2 > BLOW_MPS2 { 0.5 * change_mps2 * current.time.seconds_since(previous.time) } else { 0.0 }
}

impl Estimator for EkfBias {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::EkfBias
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        let dt_s = self.now.map_or(0.0, |t| now.seconds_since(t)).max(0.0);
        self.now = Some(now.max(self.now.unwrap_or_default()));
        self.estimate.residuals.clear();
        if self.aligned && dt_s > LONGEST_GAP_S {
            self.aligned = false;
            self.alignment = Alignment::new();
            self.inertial = None;
            self.aided.heights.since = None;
        }

        let previous = self.inertial;
        let current = self.imus.take(received, &self.state.gyro_bias_radps, &mut self.estimate.residuals);
        let since = previous.map_or(0.0, |p| now.seconds_since(p.time));
        self.feed_mixture(received, current.as_ref(), since);
        if !self.aligned {
            self.wait_at_pose(received);
            if let Some(inertial) = current {
                let dt_s = previous.map_or(0.0, |p| inertial.time.seconds_since(p.time));
                self.inertial = Some(inertial);
                self.align(received, dt_s, &inertial);
                self.follow_mixture();
            }
            self.take_heights(received);
            self.publish(now);
            return &self.estimate;
        }

        let input = match (&previous, &current) {
            (Some(p), Some(c)) if dt_s > 0.0 => self.bridge(p, c, dt_s),
            (_, Some(i)) | (Some(i), None) => (i.gyro_radps, i.accel_mps2),
            (None, None) => (self.state.gyro_bias_radps, self.gravity_in_body()),
        };
        if dt_s > 0.0 {
            let unseen_mps = previous.zip(current).map_or(0.0, |(p, c)| unseen(&p, &c));
            self.propagate(dt_s, &input.0, &input.1, unseen_mps);
        }
        if let Some(inertial) = current {
            if let Some(before) = &previous {
                let since_s = inertial.time.seconds_since(before.time);
                let [accel, gyro] = [inertial.accel_mps2 - before.accel_mps2, inertial.gyro_radps - before.gyro_radps];
                self.vibration.take(since_s, &accel, &gyro);
            }
            self.inertial = Some(inertial);
            self.rest.take(dt_s, &inertial, &self.state.gyro_bias_radps, applied, &self.model.imus);
        }
        self.history.push(now, &self.state.kinematics);
        self.aid(received);
        self.follow_mixture();
        self.aid_idle(now);

        let good = self.state.kinematics.position_enu_m.iter().all(|x| x.is_finite())
            && self.state.kinematics.velocity_enu_mps.iter().all(|x| x.is_finite())
            && self.state.kinematics.world_from_body.coords.iter().all(|x| x.is_finite())
            && self.p.diagonal().iter().all(|x| x.is_finite() && *x >= 0.0);
        if good {
            self.publish(now);
        } else {
            self.recover_from_numbers();
        }
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }

    fn nees(&self, truth: &Kinematics) -> Option<Nees> {
        let error = consistency::error(truth, &self.state.kinematics);
        consistency::nees(&error, &self.p.fixed_view::<9, 9>(0, 0).into_owned())
    }
}

impl EkfBias {
    /// The specific force of a vehicle that does not accelerate: held when there has never been a sample.
    fn gravity_in_body(&self) -> Vector3<f64> {
        let up = self.state.kinematics.world_from_body.inverse() * Vector3::new(0.0, 0.0, self.model.imus.gravity_mps2);
        up + self.state.accel_bias_mps2
    }
}

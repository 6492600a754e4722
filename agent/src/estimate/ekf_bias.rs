//! Error-state EKF with accelerometer- and gyroscope-bias states ([Paternain] V, on the corrected model).
//!
//! The IMUs are the process input, not measurements: their errors are the biases and the noise in Q.
//! [Paternain] feeds velocities integrated from the accelerometer back as measurements, which counts the
//! same noise twice (errata 8); here velocity is predicted by them and corrected by what really measures it.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | p, v | position and velocity in the world frame ENU | m, m/s |
//! | R | world_from_body; error δφ about the world axes, R = exp(δφ×)R̂ | rad |
//! | b_a, b_g | biases: f = f_m − b_a, ω = ω_m − b_g | m/s², rad/s |
//! | f, ω | specific force and angular rate in the body frame, consensus of the IMUs | m/s², rad/s |
//!
//! ```text
//! ṗ = v     v̇ = R f + g     Ṙ = R ω×                       [Paternain] Eq. 2 in the world frame
//! ```
//!
//! One tick: vote among the IMUs, propagate, remember, correct with what arrived (`aiding.rs`), and bound
//! what nothing measures. Without horizontal aiding the accelerometer's horizontal bias cannot be told from
//! tilt (rank 8 of 15, errata 8): its variance then simply stays at its prior.
//!
//! Assumes: a flat, still world (no Earth rate), IMUs near the centre of mass.

mod aiding;
mod align;
mod covariance;
mod history;
mod options;
#[cfg(test)]
mod tests;
mod yaw;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

pub use options::{EkfOptions, Gates};

use self::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use self::align::{Aligned, Alignment};
use self::covariance::{Covariance, ErrorState, Noise, ix};
use self::history::History;
use super::consistency::{self, Nees};
use super::imu_vote::{self, Vote};
use super::yaw_mixture::YawMixture;
use super::{Channel, Estimate, Estimator, EstimatorKind, Health};
use crate::model::measure::Kinematics;
use crate::vehicle::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS, MotorCommand, SensorFrame};

/// Longest step integrated at once, s; longer ones are divided.
const LONGEST_STEP_S: f64 = 0.02;
/// A gap longer than this is not integrated across, s: the attitude is found again.
const LONGEST_GAP_S: f64 = 1.0;
/// No IMU for this long is degraded, s.
const IMU_SILENCE_S: f64 = 0.1;
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

/// When a group of sensors was last accepted, and since when it has been refused without a break.
#[derive(Debug, Clone, Copy, Default)]
struct Since {
    accepted: Option<FlightTime>,
    refused: Option<FlightTime>,
}

impl Since {
    fn note(&mut self, now: FlightTime, used: bool) {
        if used {
            *self = Self { accepted: Some(now), refused: None };
        } else if self.refused.is_none() {
            self.refused = Some(now);
        }
    }

    fn ever(&self) -> bool {
        self.accepted.is_some()
    }

    fn within(&self, now: FlightTime, seconds: f64) -> bool {
        self.accepted.is_some_and(|t| now.seconds_since(t) <= seconds)
    }

    /// How long it has been refused, s; zero when the last sample was accepted.
    fn rejected(&self, now: FlightTime) -> f64 {
        self.refused.map_or(0.0, |t| now.seconds_since(t))
    }
}

/// Consensus of the IMUs at one time.
#[derive(Debug, Clone, Copy)]
struct Inertial {
    time: FlightTime,
    gyro_radps: Vector3<f64>,
    accel_mps2: Vector3<f64>,
}

/// The filter. See the module.
#[derive(Clone)]
pub struct EkfBias {
    options: EkfOptions,
    state: State,
    p: Covariance,
    history: History,
    gyro_vote: Vote,
    accel_vote: Vote,
    estimate: Estimate,

    aligned: bool,
    alignment: Alignment,
    now: Option<FlightTime>,
    inertial: Option<Inertial>,
    turning_radps2: Vector3<f64>,
    imus_used: usize,
    vote_trusted: bool,

    horizontal: Since,
    vertical: Since,
    heights: Since,
    headings: Since,
    pose_yaw: Since,
    barometers: [Since; MAX_BAROMETERS],
    barometer_known: [bool; MAX_BAROMETERS],
    barometer_present: bool,
    heights_present: bool,
    heights_since: Option<FlightTime>,
    last_height: [Option<(FlightTime, f64)>; MAX_HEIGHTS],
    corrected_z: f64,
    corrected_vz: f64,
    last_heading: [Option<FlightTime>; MAX_IMUS],
    field_ut: [Option<f64>; MAX_IMUS],
    /// Told by a magnetometer or motion capture.
    yaw_known: bool,
    mixture: YawMixture,
    idle_last: Option<FlightTime>,
    anchor: Vector3<f64>,
    rest_s: f64,
    slow_force: Option<Vector3<f64>>,
}

impl EkfBias {
    /// Nothing known yet; it aligns itself on the first second of samples.
    pub fn new(options: EkfOptions) -> Self {
        let gyro_vote = Vote::new(options.gyro_vote, [Channel::GyroX, Channel::GyroY, Channel::GyroZ]);
        let accel_vote = Vote::new(options.accel_vote, [Channel::AccelX, Channel::AccelY, Channel::AccelZ]);
        Self {
            options,
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
            gyro_vote,
            accel_vote,
            estimate: Estimate::default(),
            aligned: false,
            alignment: Alignment::new(),
            now: None,
            inertial: None,
            turning_radps2: Vector3::zeros(),
            imus_used: 1,
            vote_trusted: true,
            horizontal: Since::default(),
            vertical: Since::default(),
            heights: Since::default(),
            headings: Since::default(),
            pose_yaw: Since::default(),
            barometers: [Since::default(); MAX_BAROMETERS],
            barometer_known: [false; MAX_BAROMETERS],
            barometer_present: false,
            heights_present: false,
            heights_since: None,
            last_height: [None; MAX_HEIGHTS],
            corrected_z: 0.0,
            corrected_vz: 0.0,
            last_heading: [None; MAX_IMUS],
            field_ut: [None; MAX_IMUS],
            yaw_known: false,
            mixture: YawMixture::new(),
            idle_last: None,
            anchor: Vector3::zeros(),
            rest_s: 0.0,
            slow_force: None,
        }
    }

    /// Covariance of the error state: δp, δv, δφ (about the world axes), δb_a, δb_g, barometer offsets.
    /// For consistency tests (NEES) and plots.
    pub fn covariance(&self) -> &nalgebra::SMatrix<f64, 17, 17> {
        &self.p
    }

    /// Sums of all corrections of height (m) and climb (m/s) so far: what lies between its path and the one that
    /// the IMUs alone would have given.
    pub fn vertical_corrections(&self) -> (f64, f64) {
        (self.corrected_z, self.corrected_vz)
    }

    /// From now on a height's noise is taken for `sigma_m`; its gate and its reach stay what they are in metres.
    pub fn assume_height_sigma(&mut self, sigma_m: f64) {
        let o = &mut self.options;
        let factor = o.height_sigma_m / sigma_m;
        (o.height_sigma_m, o.gates.height, o.height_reach) =
            (sigma_m, o.gates.height * factor, o.height_reach * factor);
    }

    /// An IMU that was believed has lied: up to half a gate of its lie may have been taken for a bias. Opens the
    /// variance of the accelerometer's bias again where something measures it: upward, and in the plane while the
    /// horizontal position is known.
    pub fn doubt_accel_bias(&mut self) {
        let vote = &self.options.accel_vote;
        let sigma = 0.5 * vote.gate * vote.sigma;
        let up = self.state.kinematics.world_from_body.inverse() * Vector3::z();
        let plane = self.now.is_some_and(|now| self.horizontal.within(now, HORIZONTAL_MEMORY_S));
        let measured = if plane { Matrix3::identity() } else { up * up.transpose() };
        let mut block = self.p.fixed_view_mut::<3, 3>(ix::ACCEL_BIAS, ix::ACCEL_BIAS);
        block += measured * (sigma * sigma);
    }

    /// Specific force at the last IMU sample, biases removed, body FLU, m/s²; `None` before the first.
    pub fn specific_force_mps2(&self) -> Option<Vector3<f64>> {
        self.inertial.map(|i| i.accel_mps2 - self.state.accel_bias_mps2)
    }

    /// The options in use.
    pub fn options(&self) -> &EkfOptions {
        &self.options
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
        self.corrected_z += position.z;
        self.corrected_vz += velocity.z;
        self.history.corrected(&position, &velocity, &attitude);
    }

    /// Moves the position without touching P.
    fn shift(&mut self, by: Vector3<f64>) {
        self.state.kinematics.position_enu_m += by;
        self.corrected_z += by.z;
        self.history.corrected(&by, &Vector3::zeros(), &Vector3::zeros());
    }

    /// Turns yaw without touching P. Horizontal velocity turns with it.
    fn turn(&mut self, yaw_rad: f64) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw_rad);
        let k = &mut self.state.kinematics;
        k.world_from_body = turn * k.world_from_body;
        self.history.corrected(&Vector3::zeros(), &Vector3::zeros(), &(Vector3::z() * yaw_rad));
    }

    /// The consensus of this frame's IMUs, if any; deviations become residuals.
    fn vote(&mut self, frame: &SensorFrame) -> Option<Inertial> {
        let residuals = &mut self.estimate.residuals;
        let gyro = self.gyro_vote.vote(frame.time, &imu_vote::gyros(frame), residuals)?;
        self.watch_turning(frame.time, &gyro.value);
        let rate = gyro.value - self.state.gyro_bias_radps;
        let mut accels = imu_vote::accels(frame);
        for (accel, place) in accels.iter_mut().zip(&self.options.imu_position_flu_m) {
            // An accelerometer at r feels ω̇ × r + ω × (ω × r) on top of the centre's specific force.
            if let Some(a) = accel {
                *a -= self.turning_radps2.cross(place) + rate.cross(&rate.cross(place));
            }
        }
        let accel = self.accel_vote.vote(frame.time, &accels, &mut self.estimate.residuals)?;
        self.imus_used = gyro.used.min(accel.used).max(1);
        self.vote_trusted = gyro.trusted && accel.trusted;
        Some(Inertial { time: frame.time, gyro_radps: gyro.value, accel_mps2: accel.value })
    }

    /// Angular acceleration: the rate of change of the gyroscopes, smoothed over 5 ms: later it would lag
    /// behind, and accelerometers away from the centre would contradict each other, whenever a turn begins.
    fn watch_turning(&mut self, now: FlightTime, gyro_radps: &Vector3<f64>) {
        if let Some(before) = &self.inertial {
            let dt_s = now.seconds_since(before.time);
            if dt_s > 0.0 && dt_s < 0.1 {
                let turning = (gyro_radps - before.gyro_radps) / dt_s;
                self.turning_radps2 += (turning - self.turning_radps2) * (dt_s / (0.005 + dt_s));
            } else {
                self.turning_radps2 = Vector3::zeros();
            }
        }
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
        let (gravity, declination) = (self.options.gravity_mps2, self.options.declination_rad);
        let (gyro, accel) = (&inertial.gyro_radps, &inertial.accel_mps2);
        if let Some(found) = self.alignment.push(dt_s, gyro, accel, field.as_ref(), gravity, declination) {
            self.begin(&found);
        }
    }

    fn begin(&mut self, found: &Aligned) {
        let o = &self.options;
        self.state.kinematics.world_from_body = found.world_from_body;
        self.state.gyro_bias_radps = found.gyro_bias_radps;
        let (tilt, gyro_bias, velocity) = if found.at_rest {
            (align::TILT_SIGMA_REST_RAD, align::GYRO_BIAS_SIGMA_REST_RADPS, 0.1)
        } else {
            (align::TILT_SIGMA_MOVING_RAD, o.gyro_bias_prior_radps, 3.0)
        };
        self.yaw_known = found.field_ut.is_some();
        let yaw = if self.yaw_known { align::YAW_SIGMA_FIELD_RAD } else { o.unknown_yaw_sigma_rad };
        self.p = Covariance::zeros();
        for i in 0..3 {
            self.p[(ix::POSITION + i, ix::POSITION + i)] = o.idle_position_sigma_m.powi(2);
            self.p[(ix::VELOCITY + i, ix::VELOCITY + i)] = velocity * velocity;
            self.p[(ix::ATTITUDE + i, ix::ATTITUDE + i)] = if i == 2 { yaw * yaw } else { tilt * tilt };
            self.p[(ix::ACCEL_BIAS + i, ix::ACCEL_BIAS + i)] = o.accel_bias_prior_mps2.powi(2);
            self.p[(ix::GYRO_BIAS + i, ix::GYRO_BIAS + i)] = gyro_bias * gyro_bias;
        }
        self.aligned = true;
        self.vertical = Since::default();
        if self.yaw_known || self.mixture.horizontal().is_none() {
            self.horizontal = Since::default();
        }
        self.heights = Since::default();
        self.barometer_known = [false; MAX_BAROMETERS];
        self.history.clear();
    }

    /// Propagates state and covariance to `frame.time`.
    fn propagate(&mut self, dt_s: f64, rate_radps: &Vector3<f64>, force_mps2: &Vector3<f64>) {
        let o = &self.options;
        let share = 1.0 / self.imus_used as f64;
        let noise = Noise {
            accel: o.accel_noise_density.powi(2) * share + o.common_accel_noise_density.powi(2),
            gyro: o.gyro_noise_density.powi(2) * share + o.common_gyro_noise_density.powi(2),
            accel_bias: (o.accel_bias_walk.powi(2), o.accel_bias_prior_mps2.powi(2)),
            gyro_bias: (o.gyro_bias_walk.powi(2), o.gyro_bias_prior_radps.powi(2)),
            barometer: o.barometer_walk.powi(2),
        };
        let rate = rate_radps - self.state.gyro_bias_radps;
        let force = force_mps2 - self.state.accel_bias_mps2;
        let gravity = Vector3::new(0.0, 0.0, -o.gravity_mps2);
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

    /// At rest: motors told to stand, and nothing moving for a while.
    fn watch_rest(&mut self, dt_s: f64, inertial: &Inertial, applied: &MotorCommand) {
        let slow = self.slow_force.get_or_insert(inertial.accel_mps2);
        *slow += (inertial.accel_mps2 - *slow) * (dt_s / 0.5).min(1.0);
        let still = (inertial.accel_mps2 - *slow).amax() < 3.0 * self.options.accel_vote.sigma
            && (inertial.gyro_radps - self.state.gyro_bias_radps).amax() < 0.03 + 3.0 * self.options.gyro_vote.sigma
            && (slow.norm() - self.options.gravity_mps2).abs() < 0.6;
        let standing = applied.throttle.iter().all(|t| t.abs() < 1e-3);
        self.rest_s = if still && standing { self.rest_s + dt_s } else { 0.0 };
    }

    fn health(&self, now: FlightTime) -> Health {
        if !self.aligned {
            return Health::Initialising;
        }
        let tilt = self.p[(ix::ATTITUDE, ix::ATTITUDE)].max(self.p[(ix::ATTITUDE + 1, ix::ATTITUDE + 1)]);
        let silent = self.inertial.is_none_or(|i| now.seconds_since(i.time) > IMU_SILENCE_S);
        // Altitude was measured once and is not any more.
        let altitude_lost = (self.heights_present && !self.heights.within(now, VERTICAL_MEMORY_S))
            || (self.vertical.ever() && !self.vertical.within(now, VERTICAL_MEMORY_S));
        let tilted = tilt.is_nan() || tilt > TILT_SIGMA_DEGRADED_RAD.powi(2);
        if silent || !self.vote_trusted || altitude_lost || tilted { Health::Degraded } else { Health::Healthy }
    }

    fn publish(&mut self, now: FlightTime) {
        let k = &self.state.kinematics;
        let sigma = |i: usize| Vector3::from_fn(|a, _| self.p[(i + a, i + a)].max(0.0).sqrt());
        let e = &mut self.estimate;
        e.time = now;
        e.position_enu_m = k.position_enu_m;
        e.velocity_enu_mps = k.velocity_enu_mps;
        e.world_from_body = k.world_from_body;
        e.accel_bias_mps2 = self.state.accel_bias_mps2;
        e.gyro_bias_radps = self.state.gyro_bias_radps;
        if let Some(i) = &self.inertial {
            e.body_rates_radps = i.gyro_radps - self.state.gyro_bias_radps;
        }
        e.position_sigma_m = sigma(ix::POSITION);
        e.velocity_sigma_mps = sigma(ix::VELOCITY);
        e.attitude_sigma_rad = sigma(ix::ATTITUDE);
        e.horizontal_known = self.horizontal.within(now, HORIZONTAL_MEMORY_S);
        self.estimate.health = self.health(now);
    }

    /// Starts over where it last made sense: numbers that are not finite must never fly.
    fn recover_from_numbers(&mut self) {
        let kept = std::mem::take(&mut self.estimate);
        self.reset_to(&kept);
        self.estimate.health = Health::Degraded;
    }
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
            self.heights_since = None;
        }

        let previous = self.inertial;
        let current = self.vote(received);
        let since = previous.map_or(0.0, |p| now.seconds_since(p.time));
        self.feed_mixture(received, current.as_ref(), since);
        if !self.aligned {
            if let Some(inertial) = current {
                let dt_s = previous.map_or(0.0, |p| inertial.time.seconds_since(p.time));
                self.inertial = Some(inertial);
                self.align(received, dt_s, &inertial);
                self.follow_mixture();
            }
            self.hear_heights(received);
            self.publish(now);
            return &self.estimate;
        }

        let input = match (&previous, &current) {
            (Some(p), Some(c)) if dt_s > 0.0 => self.bridge(p, c, dt_s),
            (_, Some(i)) | (Some(i), None) => (i.gyro_radps, i.accel_mps2),
            (None, None) => (self.state.gyro_bias_radps, self.gravity_in_body()),
        };
        if dt_s > 0.0 {
            self.propagate(dt_s, &input.0, &input.1);
        }
        if let Some(inertial) = current {
            self.inertial = Some(inertial);
            self.watch_rest(dt_s, &inertial, applied);
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

    fn reset_to(&mut self, estimate: &Estimate) {
        let o = &self.options;
        let or =
            |given: f64, default: f64| if given.is_finite() && given > 0.0 { given * given } else { default * default };
        self.p = Covariance::zeros();
        for i in 0..3 {
            self.p[(ix::POSITION + i, ix::POSITION + i)] = or(estimate.position_sigma_m[i], 0.5);
            self.p[(ix::VELOCITY + i, ix::VELOCITY + i)] = or(estimate.velocity_sigma_mps[i], 0.5);
            self.p[(ix::ATTITUDE + i, ix::ATTITUDE + i)] = or(estimate.attitude_sigma_rad[i], 0.1);
            self.p[(ix::ACCEL_BIAS + i, ix::ACCEL_BIAS + i)] = o.accel_bias_prior_mps2.powi(2);
            self.p[(ix::GYRO_BIAS + i, ix::GYRO_BIAS + i)] = o.gyro_bias_prior_radps.powi(2);
        }
        self.state.kinematics = Kinematics {
            position_enu_m: estimate.position_enu_m,
            velocity_enu_mps: estimate.velocity_enu_mps,
            world_from_body: estimate.world_from_body,
        };
        self.state.accel_bias_mps2 = estimate.accel_bias_mps2;
        self.state.gyro_bias_radps = estimate.gyro_bias_radps;
        self.barometer_known = [false; MAX_BAROMETERS];
        self.history.clear();
        self.anchor = estimate.position_enu_m;
        self.yaw_known = true;
        self.aligned = estimate.health != Health::Initialising;
        self.alignment = Alignment::new();
        self.now = Some(estimate.time.max(self.now.unwrap_or_default()));
        self.estimate = estimate.clone();
        self.estimate.residuals.clear();
    }

    fn nees(&self, truth: &Kinematics) -> Option<Nees> {
        let error = consistency::error(truth, &self.state.kinematics);
        consistency::nees(&error, &self.p.fixed_view::<9, 9>(0, 0).into_owned())
    }
}

impl EkfBias {
    /// The specific force of a vehicle that does not accelerate: held when there has never been a sample.
    fn gravity_in_body(&self) -> Vector3<f64> {
        let up = self.state.kinematics.world_from_body.inverse() * Vector3::new(0.0, 0.0, self.options.gravity_mps2);
        up + self.state.accel_bias_mps2
    }
}

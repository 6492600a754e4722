//! Attitude from gyroscope, accelerometer and magnetometer alone: the independent watchdog.
//!
//! After D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and
//! magnetic disturbance rejection", Information Fusion 91 (2023), written anew from its description. It
//! shares no state, no position sensor and, when told which IMU to use, no IMU with the filter in the loop:
//! an attack on heights, GNSS or motion capture cannot reach it.
//!
//! 1. The gyroscope is integrated: almost inertial frame ← body.
//! 2. The specific force, turned into that frame, is low-passed over several seconds: accelerations of a
//!    vehicle that stays in a room average out, and turning does not smear. Its direction corrects tilt.
//! 3. The magnetometer corrects heading alone, slowly, and not at all while the field's strength and dip
//!    differ from those of the reference field. Deviation: before there is one (the paper wants fast turning, which
//!    a vehicle on strings never does) a field that has been steady for five seconds is followed, at half the speed.
//! 4. Gyroscope bias: from the corrections in motion, from the gyroscope itself at rest.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | q_g | integrated gyroscope | |
//! | q_a | tilt correction, almost inertial → level | |
//! | δ | heading of the level frame | rad |
//! | b | gyroscope bias and its covariance P | rad/s |
//! | τ | time constants | s |

use nalgebra::{Matrix3, Quaternion, SVector, UnitQuaternion, Vector2, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::imu_vote::{self, Vote, VoteOptions};
use super::low_pass::LowPass;
use super::{Channel, Estimate, Estimator, EstimatorKind, Health, Residual};
use crate::frames::wrap_pi;
use crate::vehicle::{MAX_IMUS, MotorCommand, SensorFrame};

/// One degree, rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Time constants and thresholds; the defaults are those of the paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeOptions {
    /// Nominal time between IMU samples, s; what really arrives is measured and used.
    pub period_s: f64,
    /// Low-pass of the specific force, s.
    pub tau_accel_s: f64,
    /// Heading correction, s.
    pub tau_mag_s: f64,
    /// Gyroscope bias at start, one-sigma, rad/s.
    pub bias_sigma_radps: f64,
    /// Time in which an uncorrected bias becomes 0.1 °/s uncertain, s.
    pub bias_forgetting_s: f64,
    /// Largest bias believed, rad/s.
    pub bias_limit_radps: f64,
    /// Use the magnetometer.
    pub use_mag: bool,
    /// Magnetic declination, rad, east positive.
    pub declination_rad: f64,
    /// Use only this IMU (index from 0); `None` votes among all.
    pub imu: Option<usize>,
    /// Vote among gyroscopes.
    pub gyro_vote: VoteOptions,
    /// Vote among accelerometers.
    pub accel_vote: VoteOptions,
}

impl Default for AttitudeOptions {
    fn default() -> Self {
        let ekf = super::ekf_bias::EkfOptions::default();
        Self {
            period_s: 0.005,
            tau_accel_s: 3.0,
            tau_mag_s: 9.0,
            bias_sigma_radps: 0.5 * DEGREE,
            bias_forgetting_s: 100.0,
            bias_limit_radps: 2.0 * DEGREE,
            use_mag: true,
            declination_rad: 0.0,
            imu: None,
            gyro_vote: ekf.gyro_vote,
            accel_vote: ekf.accel_vote,
        }
    }
}

/// Bias uncertainty reached in motion, rad/s.
const BIAS_SIGMA_MOTION: f64 = 0.1 * DEGREE;
/// Bias uncertainty reached at rest, rad/s.
const BIAS_SIGMA_REST: f64 = 0.03 * DEGREE;
/// How much slower the vertical bias, invisible in motion, is drawn to zero.
const BIAS_VERTICAL_FORGETTING: f64 = 1e-4;
/// Rest: for this long, s …
const REST_S: f64 = 1.5;
/// … the rate stays this close to its low-pass, rad/s …
const REST_RATE_RADPS: f64 = 2.0 * DEGREE;
/// … and the specific force too, m/s² …
const REST_FORCE_MPS2: f64 = 0.5;
/// … low-passed over this, s.
const REST_TAU_S: f64 = 0.5;
/// Low-pass of the field's strength and dip before they are judged, s.
const FIELD_TAU_S: f64 = 0.05;
/// Time constant of the reference field, s.
const FIELD_REFERENCE_TAU_S: f64 = 20.0;
/// Strength may differ by this fraction …
const FIELD_STRENGTH: f64 = 0.1;
/// … and dip by this, rad.
const FIELD_DIP_RAD: f64 = 10.0 * DEGREE;
/// A field becomes the reference after agreeing with itself this long while turning, s …
const FIELD_NEW_S: f64 = 20.0;
/// … at first this long, s …
const FIELD_FIRST_S: f64 = 5.0;
/// … counting only times of turning at least this fast, rad/s.
const FIELD_TURNING_RADPS: f64 = 20.0 * DEGREE;
/// The field must fit for this long before it is trusted again, s.
const FIELD_FIT_S: f64 = 0.5;
/// A disturbed field is rejected altogether this long, then followed more slowly by `FIELD_SLOWER`, s.
const FIELD_REJECT_S: f64 = 60.0;
const FIELD_SLOWER: f64 = 2.0;

/// The filter proper: one gyroscope, one accelerometer, one magnetometer.
#[derive(Debug, Clone)]
pub struct AttitudeFilter {
    options: AttitudeOptions,
    period_s: f64,
    measured_period_s: f64,
    samples: u32,
    inertial_from_body: UnitQuaternion<f64>,
    level_from_inertial: UnitQuaternion<f64>,
    delta_rad: f64,

    bias: Vector3<f64>,
    bias_p: Matrix3<f64>,
    force: LowPass<3>,
    turn: LowPass<9>,
    turned_bias: LowPass<2>,
    rest_rate: LowPass<3>,
    rest_force: LowPass<3>,
    rest_s: f64,
    slow_rate: Vector3<f64>,

    field: LowPass<2>,
    reference: Vector2<f64>,
    candidate: Vector2<f64>,
    candidate_s: f64,
    steady_s: f64,
    fit_s: f64,
    disturbed: bool,
    rejected_s: f64,
    start_gain: f64,
    disagreement_rad: f64,
    mag_period_s: f64,
    since_mag_s: f64,
}

impl AttitudeFilter {
    /// Level, heading zero, until the first samples.
    pub fn new(options: AttitudeOptions) -> Self {
        let t = options.period_s;
        Self {
            options,
            period_s: t,
            measured_period_s: t,
            samples: 0,
            inertial_from_body: UnitQuaternion::identity(),
            level_from_inertial: UnitQuaternion::identity(),
            delta_rad: 0.0,
            bias: Vector3::zeros(),
            bias_p: Matrix3::identity() * options.bias_sigma_radps.powi(2),
            force: LowPass::new(options.tau_accel_s, t),
            turn: LowPass::new(options.tau_accel_s, t),
            turned_bias: LowPass::new(options.tau_accel_s, t),
            rest_rate: LowPass::new(REST_TAU_S, t),
            rest_force: LowPass::new(REST_TAU_S, t),
            rest_s: 0.0,
            slow_rate: Vector3::zeros(),
            field: LowPass::new(FIELD_TAU_S, t),
            reference: Vector2::zeros(),
            candidate: Vector2::zeros(),
            candidate_s: 0.0,
            steady_s: 0.0,
            fit_s: 0.0,
            disturbed: true,
            rejected_s: 0.0,
            start_gain: 1.0,
            disagreement_rad: 0.0,
            mag_period_s: t,
            since_mag_s: 0.0,
        }
    }

    /// One IMU sample, `dt_s` after the one before.
    pub fn push(&mut self, dt_s: f64, gyro: &Vector3<f64>, force: &Vector3<f64>, field: Option<&Vector3<f64>>) {
        self.measure_period(dt_s);
        self.push_gyro(dt_s, gyro);
        self.push_force(dt_s, force);
        self.since_mag_s += dt_s;
        if let Some(field) = field.filter(|_| self.options.use_mag) {
            self.push_field(field);
        }
    }

    /// World ENU ← body.
    pub fn world_from_body(&self) -> UnitQuaternion<f64> {
        let heading = UnitQuaternion::from_scaled_axis(Vector3::z() * (self.delta_rad - self.options.declination_rad));
        heading * self.level_from_inertial * self.inertial_from_body
    }

    /// Gyroscope bias, rad/s.
    pub fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.bias
    }

    /// One-sigma of the bias, rad/s.
    pub fn gyro_bias_sigma_radps(&self) -> Vector3<f64> {
        self.bias_p.diagonal().map(|v| v.max(0.0).sqrt())
    }

    /// Is the field unlike the reference field?
    pub fn field_disturbed(&self) -> bool {
        self.disturbed
    }

    /// Magnetic heading less estimated heading at the last magnetometer sample, rad.
    pub fn heading_disagreement_rad(&self) -> f64 {
        self.disagreement_rad
    }

    /// Nothing has moved for a while.
    pub fn at_rest(&self) -> bool {
        self.rest_s >= REST_S
    }

    /// Starts again at an attitude and bias.
    pub fn reset_to(&mut self, world_from_body: &UnitQuaternion<f64>, gyro_bias_radps: &Vector3<f64>) {
        *self =
            Self { period_s: self.period_s, ..Self::new(AttitudeOptions { period_s: self.period_s, ..self.options }) };
        self.inertial_from_body = *world_from_body;
        self.delta_rad = self.options.declination_rad;
        self.bias = *gyro_bias_radps;
        self.start_gain = 0.0;
    }

    /// The low-passes want the real sample rate.
    fn measure_period(&mut self, dt_s: f64) {
        if dt_s > 0.0 && dt_s < 0.1 {
            self.samples = self.samples.saturating_add(1);
            let gain = (1.0 / f64::from(self.samples)).max(0.002);
            self.measured_period_s += gain * (dt_s - self.measured_period_s);
        }
        if (self.measured_period_s / self.period_s - 1.0).abs() > 0.05 && self.samples > 4 {
            self.period_s = self.measured_period_s;
            let t = self.period_s;
            self.force.retune(t);
            self.turn.retune(t);
            self.turned_bias.retune(t);
            self.rest_rate.retune(t);
            self.rest_force.retune(t);
        }
    }

    fn push_gyro(&mut self, dt_s: f64, gyro: &Vector3<f64>) {
        self.slow_rate = self.rest_rate.push(*gyro);
        let moving =
            (gyro - self.slow_rate).norm() >= REST_RATE_RADPS || self.slow_rate.amax() > self.options.bias_limit_radps;
        if moving {
            self.rest_s = 0.0;
        }
        self.inertial_from_body *= UnitQuaternion::from_scaled_axis((gyro - self.bias) * dt_s);
        self.inertial_from_body.renormalize_fast();
    }

    fn push_force(&mut self, dt_s: f64, force: &Vector3<f64>) {
        if force.norm_squared() == 0.0 || dt_s <= 0.0 {
            return;
        }
        let slow = self.rest_force.push(*force);
        if (force - slow).norm() >= REST_FORCE_MPS2 {
            self.rest_s = 0.0;
        } else {
            self.rest_s += dt_s;
        }
        let up = self.level_from_inertial * self.force.push(self.inertial_from_body * force);
        let Some(up) = up.try_normalize(1e-9) else { return };
        // The shortest rotation that brings `up` to the vertical.
        let w = (0.5 * (up.z + 1.0)).max(0.0).sqrt();
        let correction = if w > 1e-6 {
            UnitQuaternion::from_quaternion(Quaternion::new(w, 0.5 * up.y / w, -0.5 * up.x / w, 0.0))
        } else {
            UnitQuaternion::from_quaternion(Quaternion::new(0.0, 1.0, 0.0, 0.0))
        };
        self.level_from_inertial = correction * self.level_from_inertial;
        self.level_from_inertial.renormalize_fast();
        self.estimate_bias(&up);
    }

    /// A Kalman filter over b: in motion the tilt corrections of one sample, divided by its length, are the
    /// bias seen through the low-pass; at rest the slow rate is the bias.
    fn estimate_bias(&mut self, up: &Vector3<f64>) {
        let t = self.period_s;
        let rotation = (self.level_from_inertial * self.inertial_from_body).to_rotation_matrix().into_inner();
        let turned = rotation * self.bias;
        let turn = self.turn.push(SVector::<f64, 9>::from_column_slice(rotation.as_slice()));
        let slow_turn = Matrix3::from_column_slice(turn.as_slice());
        let slow_bias = self.turned_bias.push(Vector2::new(turned.x, turned.y));

        let walk = BIAS_SIGMA_MOTION.powi(2) * t / self.options.bias_forgetting_s;
        // The measurement noise whose steady state, against this walk, has the wanted variance.
        let noise = |sigma: f64| sigma.powi(4) / walk + sigma * sigma;
        let (h, mut error, r) = if self.at_rest() {
            (Matrix3::identity(), self.slow_rate - self.bias, Vector3::repeat(noise(BIAS_SIGMA_REST)))
        } else {
            let seen = slow_turn * self.bias;
            let error = Vector3::new(-up.y / t + slow_bias.x - seen.x, up.x / t + slow_bias.y - seen.y, -seen.z);
            let r = noise(BIAS_SIGMA_MOTION);
            (slow_turn, error, Vector3::new(r, r, r / BIAS_VERTICAL_FORGETTING))
        };
        let most = self.options.bias_sigma_radps.powi(2);
        for i in 0..3 {
            if self.bias_p[(i, i)] < most {
                self.bias_p[(i, i)] += walk;
            }
        }
        let limit = self.options.bias_limit_radps;
        error = error.map(|e| e.clamp(-limit, limit));
        let s = h * self.bias_p * h.transpose() + Matrix3::from_diagonal(&r);
        let Some(cholesky) = s.cholesky() else { return };
        let k = cholesky.solve(&(h * self.bias_p)).transpose();
        self.bias = (self.bias + k * error).map(|b| b.clamp(-limit, limit));
        self.bias_p -= k * h * self.bias_p;
        super::kalman::symmetrise(&mut self.bias_p);
    }

    fn push_field(&mut self, field: &Vector3<f64>) {
        let level = self.level_from_inertial * self.inertial_from_body * field;
        let strength = level.norm();
        if strength == 0.0 || !strength.is_finite() {
            return;
        }
        let t = self.since_mag_s.clamp(1e-4, 1.0);
        self.since_mag_s = 0.0;
        self.mag_period_s += 0.05 * (t - self.mag_period_s);
        let now = self.field.push(Vector2::new(strength, -(level.z / strength).clamp(-1.0, 1.0).asin()));
        self.judge_field(&now, t);

        self.disagreement_rad = wrap_pi(level.x.atan2(level.y) - self.delta_rad);
        let mut gain = 1.0 - (-t / self.options.tau_mag_s).exp();
        if self.disturbed {
            // A vehicle that never turns fast finds no reference: it follows what has been steady from the start.
            let steady = self.reference.x == 0.0 && self.steady_s >= FIELD_FIRST_S;
            if self.rejected_s <= FIELD_REJECT_S && !steady {
                self.rejected_s += t;
                gain = 0.0;
            } else {
                gain /= FIELD_SLOWER;
            }
        } else {
            self.rejected_s = (self.rejected_s - FIELD_SLOWER * t).max(0.0);
        }
        // At start a plain mean: 1, 1/2, 1/3, … until that is slower than the time constant.
        if self.start_gain > 0.0 {
            gain = gain.max(self.start_gain);
            self.start_gain = self.start_gain / (self.start_gain + 1.0);
            if self.start_gain * self.options.tau_mag_s < t {
                self.start_gain = 0.0;
            }
        }
        self.delta_rad = wrap_pi(self.delta_rad + gain * self.disagreement_rad);
    }

    /// Does the field fit the reference field, or another that has been steady for long?
    fn judge_field(&mut self, now: &Vector2<f64>, t: f64) {
        let fits = |other: &Vector2<f64>| {
            (now.x - other.x).abs() < FIELD_STRENGTH * other.x && (now.y - other.y).abs() < FIELD_DIP_RAD
        };
        let gain = 1.0 - (-t / FIELD_REFERENCE_TAU_S).exp();
        if fits(&self.reference) {
            self.fit_s += t;
            if self.fit_s >= FIELD_FIT_S {
                self.disturbed = false;
                self.reference += gain * (now - self.reference);
            }
        } else {
            self.fit_s = 0.0;
            self.disturbed = true;
        }
        if fits(&self.candidate) {
            self.steady_s += t;
            if self.slow_rate.norm() >= FIELD_TURNING_RADPS {
                self.candidate_s += t;
            }
            self.candidate += gain * (now - self.candidate);
            let wait = if self.reference.x == 0.0 { FIELD_FIRST_S } else { FIELD_NEW_S };
            if self.disturbed && self.candidate_s >= wait {
                self.reference = self.candidate;
                self.disturbed = false;
                self.fit_s = FIELD_FIT_S;
            }
        } else {
            self.candidate_s = 0.0;
            self.steady_s = 0.0;
            self.candidate = *now;
        }
    }
}

/// The filter as an estimator: attitude and rates, no position.
pub struct Attitude {
    filter: AttitudeFilter,
    gyro_vote: Vote,
    accel_vote: Vote,
    last: Option<FlightTime>,
    force_mps2: Vector3<f64>,
    fields: [Option<Vector3<f64>>; MAX_IMUS],
    trusted: bool,
    age_s: f64,
    estimate: Estimate,
}

/// No IMU for this long is degraded, s.
const SILENCE_S: f64 = 0.1;
/// Attitude is settled after this long, s.
const SETTLED_S: f64 = 1.0;

impl Attitude {
    /// With `options`.
    pub fn new(options: AttitudeOptions) -> Self {
        Self {
            filter: AttitudeFilter::new(options),
            gyro_vote: Vote::new(options.gyro_vote, [Channel::GyroX, Channel::GyroY, Channel::GyroZ]),
            accel_vote: Vote::new(options.accel_vote, [Channel::AccelX, Channel::AccelY, Channel::AccelZ]),
            last: None,
            force_mps2: Vector3::zeros(),
            fields: [None; MAX_IMUS],
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
    pub fn filter(&self) -> &AttitudeFilter {
        &self.filter
    }
}

impl Estimator for Attitude {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Attitude
    }

    fn step(&mut self, received: &SensorFrame, _applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        self.estimate.time = now;
        self.estimate.residuals.clear();
        let (mut gyros, mut accels) = (imu_vote::gyros(received), imu_vote::accels(received));
        if let Some(only) = self.filter.options.imu {
            for i in (0..MAX_IMUS).filter(|i| *i != only) {
                (gyros[i], accels[i]) = (None, None);
            }
        }
        let gyro = self.gyro_vote.vote(now, &gyros, &mut self.estimate.residuals);
        let accel = self.accel_vote.vote(now, &accels, &mut self.estimate.residuals);
        if let (Some(gyro), Some(accel)) = (gyro, accel) {
            let dt_s = self.last.map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, 0.2);
            self.last = Some(now);
            self.force_mps2 = accel.value;
            self.age_s += dt_s;
            self.trusted = gyro.trusted && accel.trusted;
            let wanted = |i: usize| self.filter.options.imu.is_none_or(|only| only == i);
            let mut sum = Vector3::zeros();
            let mut fields = 0.0;
            for (i, imu) in received.imus.iter().enumerate().filter(|(i, _)| wanted(*i)) {
                if let Some(field) = imu.and_then(|s| s.mag_ut).filter(|m| m.iter().all(|x| x.is_finite())) {
                    self.fields[i] = Some(field);
                    sum += field;
                    fields += 1.0;
                }
            }
            let field = (fields > 0.0).then(|| sum / fields);
            self.filter.push(dt_s, &gyro.value, &accel.value, field.as_ref());
            if field.is_some() && self.filter.options.use_mag {
                // Between the noise of a magnetometer and a field that points elsewhere.
                let sigma = 0.1;
                let innovation = self.filter.heading_disagreement_rad();
                let _ = self.estimate.residuals.try_push(Residual {
                    sensor: SensorId::new(SensorKind::Imu, self.filter.options.imu.unwrap_or(0) as u8 + 1),
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
        self.estimate.gyro_bias_radps = self.filter.gyro_bias_radps();
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

    fn reset_to(&mut self, estimate: &Estimate) {
        self.filter.reset_to(&estimate.world_from_body, &estimate.gyro_bias_radps);
        self.estimate = estimate.clone();
        self.estimate.residuals.clear();
        self.age_s = SETTLED_S;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::from_roll_pitch_yaw;

    const FIELD: Vector3<f64> = Vector3::new(0.0, 20.0, -42.0);

    /// Turns slowly with a gyroscope bias; the errors of heading and inclination at the end, rad.
    fn fly(seconds: f64, bias: Vector3<f64>, disturb_after_s: f64) -> (f64, f64, AttitudeFilter) {
        let mut filter = AttitudeFilter::new(AttitudeOptions { period_s: 0.01, ..AttitudeOptions::default() });
        let attitude =
            |t: f64| from_roll_pitch_yaw(&Vector3::new(0.5 * (0.8 * t).sin(), 0.4 * (0.5 * t).cos(), 0.6 * t));
        let h = 0.01;
        let mut t = 0.0;
        while t < seconds {
            let q = attitude(t);
            let rate = (attitude(t - h).inverse() * q).scaled_axis() / h;
            let sway = Vector3::new((3.0 * t).sin(), (2.3 * t).cos(), 0.5 * (4.0 * t).sin());
            let force = q.inverse() * (Vector3::new(0.0, 0.0, 9.81) + sway);
            let iron = if t > disturb_after_s { Vector3::new(40.0, 0.0, 10.0) } else { Vector3::zeros() };
            let field = q.inverse() * (FIELD + iron);
            filter.push(h, &(rate + bias), &force, Some(&field));
            t += h;
        }
        let error = attitude(t - h) * filter.world_from_body().inverse();
        let heading = 2.0 * error.k.atan2(error.w);
        let inclination = 2.0 * error.w.hypot(error.k).min(1.0).acos();
        (wrap_pi(heading), inclination, filter)
    }

    #[test]
    fn attitude_and_bias_are_found_in_motion() {
        let bias = Vector3::new(0.01, -0.008, 0.0);
        let (heading, inclination, filter) = fly(120.0, bias, f64::INFINITY);
        assert!(heading.abs() < 1.0 * DEGREE && inclination < 0.7 * DEGREE, "{heading} {inclination}");
        assert!((filter.gyro_bias_radps() - bias).amax() < 0.15 * DEGREE, "{}", filter.gyro_bias_radps());
        assert!(!filter.field_disturbed());
    }

    #[test]
    fn iron_nearby_is_rejected_and_heading_holds() {
        let (heading, inclination, filter) = fly(55.0, Vector3::zeros(), 40.0);
        assert!(filter.field_disturbed());
        // The iron turns the field by 63°; 15 s on the gyroscope alone cost about 3°.
        assert!(heading.abs() < 3.5 * DEGREE && inclination < 0.7 * DEGREE, "{heading} {inclination}");
    }

    #[test]
    fn at_rest_the_bias_is_the_mean_rate() {
        let bias = Vector3::new(0.005, 0.01, -0.012);
        let mut filter = AttitudeFilter::new(AttitudeOptions::default());
        for _ in 0..4000 {
            filter.push(0.005, &bias, &Vector3::new(0.0, 0.0, 9.81), Some(&FIELD));
        }
        assert!(filter.at_rest() && (filter.gyro_bias_radps() - bias).amax() < 0.05 * DEGREE);
    }

    #[test]
    fn reset_keeps_the_attitude_it_is_given() {
        let q = from_roll_pitch_yaw(&Vector3::new(0.3, -0.2, 1.0));
        let mut filter = AttitudeFilter::new(AttitudeOptions { declination_rad: 0.1, ..AttitudeOptions::default() });
        filter.reset_to(&q, &Vector3::zeros());
        assert!(filter.world_from_body().angle_to(&q) < 1e-6);
    }
}

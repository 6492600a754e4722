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
//! What the attitude filter is off by lasts for seconds, and no number of its angles averages it out: it is no part of P, and counts in
//! the uncertainty told beside P.
//!
//! Roll, pitch and yaw are singular at pitch ±90°. Nearer than 10° to it the angles are taken from the
//! attitude filter and the estimate is degraded.

mod measured;

use arrayvec::ArrayVec;
use nalgebra::{Matrix4, Vector3, Vector4};
use plumbline_proto::time::FlightTime;

use super::aiding::freshness::Freshness;
use super::aiding::idle::{Idle, UNKNOWN_YAW_SIGMA_RAD};
use super::aiding::vibration::Vibration;
use super::filter::consistency::{self, Nees};
use super::filter::kalman::forget;
use super::filter::measurement::{MAX_ROWS, Measurement, TwelveState};
use super::vqf::VqfEstimator;
use super::yaw_mixture::YawMixture;
use super::{Estimate, Estimator, EstimatorKind, Health, Motion};
use crate::frames::{from_roll_pitch_yaw, roll_pitch_yaw, wrap_pi};
use crate::model::airframe::Airframe;
use crate::model::euler_body::{Action, EulerBody, M, X, ix, process_noise};
use crate::model::motor::Rotors;
use crate::sensor::measure::Kinematics;
use crate::sensor::{MAX_IMUS, SensorFrame, SensorModel};
use crate::types::MotorCommand;

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
/// cos(pitch) below which roll and yaw mean little (80°).
const COS_PITCH_MIN: f64 = 0.17;
/// One-sigma at start: position m, velocity m/s, angles and rates rad, rad/s.
const START_SIGMA: [f64; 4] = [10.0, 2.0, 0.05, 0.05];

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
    vibration: Vibration,
    rows: ArrayVec<Measurement, MAX_ROWS>,
    aided: Aided,
    mixture: YawMixture,
    estimate: Estimate,
}

/// What has been measured so far, and when.
#[derive(Debug, Clone, Copy, Default)]
struct Aided {
    axes: [Freshness; 3],
    imus_seen: [bool; MAX_IMUS],
    pose_seen: Option<FlightTime>,
    field_seen: bool,
    heights_present: bool,
    barometer_origin_m: Option<f64>,
    idle: Idle,
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
            vibration: Vibration::default(),
            rows: ArrayVec::new(),
            aided: Aided::default(),
            mixture: YawMixture::new(),
            // At the origin until it starts, with a covariance only from then on.
            estimate: Estimate { motion: Some(Motion::default()), ..Estimate::default() },
        }
    }

    /// State and covariance now, for consistency tests.
    pub fn moments(&self) -> (X, M) {
        self.filter.moments()
    }

    fn start(&mut self) {
        let e = self.attitude.estimate();
        let mut x = X::zeros();
        x.fixed_rows_mut::<3>(ix::X).copy_from(&self.aided.idle.anchor);
        x.fixed_rows_mut::<3>(ix::ROLL).copy_from(&roll_pitch_yaw(&e.world_from_body));
        x.fixed_rows_mut::<3>(ix::P).copy_from(&e.body_rates_radps);
        let mut p = M::identity();
        for i in 0..12 {
            p[(i, i)] = START_SIGMA[i / 3].powi(2);
        }
        if !self.aided.field_seen {
            p[(ix::YAW, ix::YAW)] = UNKNOWN_YAW_SIGMA_RAD.powi(2);
        }
        self.filter.restart(x, p);
        self.aided.axes = [Freshness::default(); 3];
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
        let lasting = self.lasting_sigma_rad(now);
        let e = &mut self.estimate;
        e.time = now;
        e.motion = Some(Motion {
            position_enu_m: part(ix::X),
            velocity_enu_mps: part(ix::VX),
            position_sigma_m: Some(sigma(ix::X)),
            velocity_sigma_mps: Some(sigma(ix::VX)),
            horizontal_known: self.aided.axes[0].within(now, MEMORY_S) && self.aided.axes[1].within(now, MEMORY_S),
            heights_off_sigma_m: None,
            altitude_known: self.aided.axes[2].within(now, MEMORY_S),
        });
        e.world_from_body = from_roll_pitch_yaw(&part(ix::ROLL));
        e.body_rates_radps = part(ix::P);
        e.gyro_bias_radps = attitude.gyro_bias_radps;
        e.attitude_sigma_rad = Some(sigma(ix::ROLL).map(|sigma| sigma.hypot(lasting)));
        let altitude_lost = self.aided.axes[2].lapsed(now, MEMORY_S);
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
        if let Some(((before, was), (time, is))) = self.force.zip(fresh) {
            self.vibration.take(time.seconds_since(before), &(is - was), &Vector3::zeros());
        }
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

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }

    fn nees(&self, truth: &Kinematics) -> Option<Nees> {
        let (x, mut p) = self.filter.moments();
        let lasting = self.lasting_sigma_rad(self.now.unwrap_or_default());
        (ix::ROLL..=ix::YAW).for_each(|i| p[(i, i)] += lasting * lasting);
        let mut error = consistency::error(truth, &self.estimate.kinematics());
        // Its attitude errors are those of the angles, not about the world axes.
        let angles = roll_pitch_yaw(&truth.world_from_body);
        for i in 0..3 {
            error[ix::ROLL + i] = wrap_pi(angles[i] - x[ix::ROLL + i]);
        }
        consistency::nees(&error, &p.fixed_view::<9, 9>(0, 0).into_owned())
    }
}

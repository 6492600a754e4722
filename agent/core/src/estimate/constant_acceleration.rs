//! Nine-state position filter of \[Strategies\]: a particle whose acceleration is constant between samples
//! and jumps at random ("particle" names the moving point, nothing Monte Carlo).
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | E | x y z, ẋ ẏ ż, ẍ ÿ z̈, world ENU | m, m/s, m/s² |
//! | Γ | transition over t | |
//! | Q | white jerk of density q: q [t⁵/20 t⁴/8 t³/6; t⁴/8 t³/3 t²/2; t³/6 t²/2 t] for each axis | |
//! | H, R | the rows that arrived, and their noise | |
//!
//! Deviations from \[Strategies\] (ERRATA): Γ(3,9) is t²/2 (9); the exponent of the barometer belongs to the
//! ratio (10); gravity is taken off the rotated specific force (11); H holds the rows that arrived, since
//! GNSS comes once a second (12).

use nalgebra::{SMatrix, SVector, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::aiding::freshness::{Freshness, RECOVERY_S};
use super::aiding::{VELOCITY, XYZ};
use super::filter::kalman;
use super::filter::row::ScalarRow;
use super::vqf::VqfEstimator;
use super::{Channel, Estimate, Estimator, EstimatorKind, Health, Motion, Residuals};
use crate::sensor::{Accuracy, SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// States.
pub const N: usize = 9;
type E = SVector<f64, N>;
type M = SMatrix<f64, N, N>;

/// The filter proper.
#[derive(Debug, Clone)]
pub struct ConstantAcceleration {
    /// Position, velocity, acceleration.
    pub x: E,
    /// Covariance.
    pub p: M,
    /// Jerk density, (m/s³)²/Hz.
    pub jerk_density: f64,
}

impl ConstantAcceleration {
    /// Starts at `x` with covariance `p`.
    pub fn new(x: E, p: M, jerk_density: f64) -> Self {
        Self { x, p, jerk_density }
    }

    /// Γ over `t` seconds.
    pub fn transition(t: f64) -> M {
        let mut gamma = M::identity();
        for axis in 0..3 {
            gamma[(axis, axis + 3)] = t;
            // Deviation from [Strategies], errata 9: ½t² in the third row as well.
            gamma[(axis, axis + 6)] = 0.5 * t * t;
            gamma[(axis + 3, axis + 6)] = t;
        }
        gamma
    }

    /// Q over `t` seconds.
    pub fn process_noise(&self, t: f64) -> M {
        let q = self.jerk_density;
        let mut noise = M::zeros();
        for axis in 0..3 {
            let (p, v, a) = (axis, axis + 3, axis + 6);
            let entries = [
                (p, p, t.powi(5) / 20.0),
                (p, v, t.powi(4) / 8.0),
                (p, a, t.powi(3) / 6.0),
                (v, v, t.powi(3) / 3.0),
                (v, a, t.powi(2) / 2.0),
                (a, a, t),
            ];
            for (i, j, value) in entries {
                noise[(i, j)] = q * value;
                noise[(j, i)] = q * value;
            }
        }
        noise
    }

    /// Ê⁻ = Γ Ê, P⁻ = Γ P Γᵀ + Q.
    pub fn predict(&mut self, t: f64) {
        let gamma = Self::transition(t);
        self.x = gamma * self.x;
        self.p = kalman::predict(&self.p, &gamma, &self.process_noise(t));
    }

    /// Corrects state `i` with a `value`: was it accepted?
    pub fn correct(
        &mut self,
        i: usize,
        value: f64,
        noise: Accuracy,
        of: Option<(SensorId, Channel)>,
        residuals: &mut Residuals,
    ) -> bool {
        let pseudo = ScalarRow::pseudo(i, value - self.x[i], noise.sigma * noise.sigma);
        let correction = ScalarRow { of, gate: noise.gate, ..pseudo }.correct(&mut self.p, residuals);
        if let Some(dx) = &correction {
            self.x += dx;
        }
        correction.is_some()
    }
}

/// Largest jerk of a vehicle in a lab, (m/s³)²/Hz.
const JERK_DENSITY: f64 = 4.0;
/// Of the acceleration measured: attitude error times g, and vibration, m/s².
const ACCELERATION: Accuracy = Accuracy { sigma: 0.5, gate: 10.0 };
/// Position is known this long after the last sample, s.
const MEMORY_S: f64 = 3.0;

/// The filter as an estimator: its attitude comes from the gyroscope-integrating filter, its acceleration
/// from the specific force turned by it, gravity taken off.
pub struct ConstantAccelerationEstimator {
    model: SensorModel,
    attitude: VqfEstimator,
    filter: ConstantAcceleration,
    last: Option<FlightTime>,
    axes: [Freshness; 3],
    barometer_origin_m: Option<f64>,
    heights_present: bool,
    estimate: Estimate,
}

impl ConstantAccelerationEstimator {
    /// On sensors like these.
    pub fn new(model: SensorModel) -> Self {
        let mut p = M::identity() * 100.0;
        for i in 3..N {
            p[(i, i)] = 1.0;
        }
        Self {
            attitude: VqfEstimator::new(&model.imus),
            model,
            filter: ConstantAcceleration::new(E::zeros(), p, JERK_DENSITY),
            last: None,
            axes: [Freshness::default(); 3],
            barometer_origin_m: None,
            heights_present: false,
            estimate: Estimate::default(),
        }
    }

    /// One scalar of `sensor`: state `i` is `value`.
    fn take(&mut self, sensor: SensorId, channel: Channel, i: usize, value: f64, noise: Accuracy) {
        let now = self.last.unwrap_or_default();
        if !value.is_finite() {
            return;
        }
        let axis = i % 3;
        let position = i < 3;
        if position && self.axes[axis].rejected_s(now) > RECOVERY_S {
            self.filter.x[i] = value;
            kalman::forget(&mut self.filter.p, i, noise.sigma * noise.sigma);
            self.filter.p[(i + 3, i + 3)] += 1.0;
        }
        let accepted = self.filter.correct(i, value, noise, Some((sensor, channel)), &mut self.estimate.residuals);
        if position {
            self.axes[axis].note(now, accepted);
        }
    }

    fn take_positions(&mut self, frame: &SensorFrame) {
        for (i, sample) in frame.heights.iter().enumerate() {
            if let Some(sample) = sample {
                self.heights_present = true;
                let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
                self.take(sensor, Channel::Height, 2, sample.height_m, self.model.heights);
            }
        }
        if let Some(sample) = frame.mocap_pose {
            let sensor = SensorId::new(SensorKind::MocapPose, 1);
            for (axis, channel) in XYZ.into_iter().enumerate() {
                self.take(sensor, channel, axis, sample.position_enu_m[axis], self.model.mocap_pose.position);
            }
        }
        if let Some(sample) = frame.gnss {
            let sensor = SensorId::new(SensorKind::Gnss, 1);
            for axis in 0..3 {
                if axis < 2 || !self.heights_present {
                    let noise = self.model.gnss.position(&sample, axis);
                    self.take(sensor, XYZ[axis], axis, sample.position_enu_m[axis], noise);
                }
                self.take(sensor, VELOCITY[axis], axis + 3, sample.velocity_enu_mps[axis], self.model.gnss.velocity);
            }
        }
        // Above its first reading; a laser or GNSS altitude, where there is one, has the floor as its zero.
        if let Some(sample) = frame.barometers[0].filter(|_| !self.heights_present && frame.gnss.is_none()) {
            let altitude = self.model.barometers.altitude_m(&sample);
            if altitude.is_finite() {
                let origin = *self.barometer_origin_m.get_or_insert(altitude - self.filter.x[2]);
                let sensor = SensorId::new(SensorKind::Barometer, 1);
                self.take(sensor, Channel::PressureAltitude, 2, altitude - origin, self.model.barometers.altitude);
            }
        }
    }
}

impl Estimator for ConstantAccelerationEstimator {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::ConstantAcceleration
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        let dt_s = self.last.map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, 1.0);
        self.last = Some(now);
        let attitude = self.attitude.step(received, applied);
        let (world_from_body, ready) = (attitude.world_from_body, attitude.health != Health::Initialising);
        self.estimate.body_rates_radps = attitude.body_rates_radps;
        self.estimate.gyro_bias_radps = attitude.gyro_bias_radps;
        self.estimate.residuals.clear();
        self.filter.predict(dt_s);
        let mut force = Vector3::zeros();
        let mut count = 0.0;
        for imu in received.imus.iter().flatten().filter(|s| s.accel_mps2.iter().all(|x| x.is_finite())) {
            force += imu.accel_mps2;
            count += 1.0;
        }
        if count > 0.0 && ready {
            // Deviation from [Strategies], errata 11: Q a Q* still holds gravity.
            let acceleration = world_from_body * (force / count) - Vector3::new(0.0, 0.0, self.model.imus.gravity_mps2);
            for axis in 0..3 {
                self.filter.correct(6 + axis, acceleration[axis], ACCELERATION, None, &mut self.estimate.residuals);
            }
        }
        self.take_positions(received);
        let known = |axis: usize| self.axes[axis].within(now, MEMORY_S);
        let (horizontal, vertical) = (known(0) || known(1), known(2));
        for (axis, aided) in [(0, horizontal), (1, horizontal), (2, vertical)] {
            // Where nothing is measured the double integral must not run away.
            if !aided {
                let (filter, residuals) = (&mut self.filter, &mut self.estimate.residuals);
                filter.correct(axis + 3, 0.0, Accuracy::ungated(5.0), None, residuals);
                filter.correct(axis, filter.x[axis], Accuracy::ungated(30.0), None, residuals);
            }
        }

        let (x, p) = (&self.filter.x, &self.filter.p);
        let sigma = |i: usize| Vector3::from_fn(|a, _| p[(i + a, i + a)].max(0.0).sqrt());
        let e = &mut self.estimate;
        e.time = now;
        e.motion = Some(Motion {
            position_enu_m: x.fixed_rows::<3>(0).into_owned(),
            velocity_enu_mps: x.fixed_rows::<3>(3).into_owned(),
            position_sigma_m: Some(sigma(0)),
            velocity_sigma_mps: Some(sigma(3)),
            horizontal_known: horizontal,
            heights_off_sigma_m: None,
            altitude_known: vertical,
        });
        e.world_from_body = world_from_body;
        e.health = if !ready {
            Health::Initialising
        } else if self.axes[2].lapsed(now, MEMORY_S) || self.attitude.estimate().health == Health::Degraded {
            Health::Degraded
        } else {
            Health::Healthy
        };
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{HeightSample, ImuSample};

    #[test]
    fn equals_the_independent_reference() {
        let Some(file) = crate::shared::shared("reference/point_mass_kf.csv") else { return };
        let mut filter = ConstantAcceleration::new(E::zeros(), M::identity(), 1.0);
        let sigmas = [3.0, 3.0, 0.5, 0.2, 0.2, 0.2];
        let places = [0, 1, 2, 6, 7, 8];
        let mut worst = 0.0f64;
        for record in csv::Reader::from_path(file).unwrap().records() {
            let v: Vec<f64> = record.unwrap().iter().map(|x| x.parse().unwrap()).collect();
            filter.predict(0.02);
            for k in 0..6 {
                filter.correct(places[k], v[1 + k], Accuracy::ungated(sigmas[k]), None, &mut Residuals::new());
            }
            worst = worst.max((filter.x - E::from_column_slice(&v[16..25])).amax());
        }
        println!("point_mass: largest difference {worst:.1e}");
        assert!(worst < 1e-9, "{worst}");
    }

    #[test]
    fn height_is_followed_and_horizontal_stays_bounded() {
        let mut estimator = ConstantAccelerationEstimator::new(SensorModel::default());
        for k in 0..6000u64 {
            let time = FlightTime(k * 5000);
            let t = k as f64 * 0.005;
            let (z, a) = (1.0 + 0.3 * (0.8 * t).sin(), -0.3 * 0.64 * (0.8 * t).sin());
            let mut frame = SensorFrame { time, ..SensorFrame::default() };
            frame.imus[0] = Some(ImuSample {
                time,
                gyro_radps: Vector3::zeros(),
                accel_mps2: Vector3::new(0.05, 0.0, 9.81 + a),
                mag_ut: None,
                temperature_c: 20.0,
            });
            if k % 20 == 0 {
                frame.heights[0] = Some(HeightSample { time, height_m: z });
            }
            let e = estimator.step(&frame, &MotorCommand::default());
            if k > 1000 {
                let Motion { position_enu_m: p, velocity_enu_mps: v, .. } = e.motion.unwrap();
                assert!((p.z - z).abs() < 0.03, "{} for {z} at {t}", p.z);
                assert!(p.xy().norm() < 5.0 && v.xy().norm() < 1.0, "{e:?}");
                assert_eq!(e.health, Health::Healthy);
            }
        }
    }
}

//! Complementary filter: tilt, heading and height straight from the sensors (\[Paternain\] IV), low-passed.
//!
//! No model and no memory beyond the low-pass: what \[Paternain\] feeds his filter with, flown beside the
//! Kalman filter for comparison. Tilt is that of the specific force (errata 5), so it is wrong while
//! the vehicle accelerates, and it lags by the time constant: \[Paternain\] V found 60 ms to be too much for
//! control, which is why it should not be in the loop.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | a, m | specific force and field in the body frame, median of the IMUs | m/s², µT |
//! | τ | time constant of every low-pass | s |

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::fdir::consensus::{self, Consensus};
use super::{Channel, Estimate, Estimator, EstimatorKind, Health, Motion, Residual, median};
use crate::frames::{from_roll_pitch_yaw, roll_pitch_yaw};
use crate::model::attitude;
use crate::sensor::imu::TriaxialModel;
use crate::sensor::{MAX_HEIGHTS, SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// Silence of the IMUs that is degraded, s.
const IMU_SILENCE_S: f64 = 0.1;
/// Silence of everything that gives a height that is degraded, s.
const HEIGHT_SILENCE_S: f64 = 1.0;
/// A height counts in the median this long, s.
const HEIGHT_FRESH_S: f64 = 0.25;
/// Silence after which the horizontal position is no longer known, s.
const HORIZONTAL_SILENCE_S: f64 = 3.0;
/// The specific force may differ from g by this fraction before tilt is degraded.
const FORCE_TOLERANCE: f64 = 0.2;

/// Straight from the sensors. See the module.
pub struct Complementary {
    model: SensorModel,
    time_constant_s: f64,
    gyro_consensus: Consensus,
    accel_consensus: Consensus,
    mag_consensus: Consensus,
    force: Option<Vector3<f64>>,
    field: Option<Vector3<f64>>,
    heights: [Option<(FlightTime, f64)>; MAX_HEIGHTS],
    altitude: Option<(FlightTime, f64)>,
    barometer_origin_m: Option<f64>,
    last_imu: Option<FlightTime>,
    last_horizontal: Option<FlightTime>,
    motion: Motion,
    estimate: Estimate,
}

impl Complementary {
    /// On sensors like these, low-passed over 50 ms.
    pub fn new(model: SensorModel) -> Self {
        // Magnetometers differ by iron, not noise: a wide gate that only keeps a magnet out.
        let mag = TriaxialModel { sigma: 3.0, spread: 5.0, largest_deviation: 15.0, ..model.imus.accel };
        Self {
            gyro_consensus: Consensus::of_gyros(&model.imus),
            accel_consensus: Consensus::of_accels(&model.imus),
            mag_consensus: Consensus::new(mag, [Channel::X, Channel::Y, Channel::Z]),
            model,
            time_constant_s: 0.05,
            force: None,
            field: None,
            heights: [None; MAX_HEIGHTS],
            altitude: None,
            barometer_origin_m: None,
            last_imu: None,
            last_horizontal: None,
            motion: Motion::default(),
            estimate: Estimate::default(),
        }
    }

    fn low_pass(&self, slow: Option<Vector3<f64>>, sample: Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        slow.map_or(sample, |s| s + (sample - s) * (dt_s / (self.time_constant_s + dt_s)))
    }

    fn take_imus(&mut self, frame: &SensorFrame, dt_s: f64) {
        let mut field_residuals = ArrayVec::new();
        let residuals = &mut self.estimate.residuals;
        let gyro = self.gyro_consensus.take(frame.time, &consensus::gyros(frame), residuals);
        let accel = self.accel_consensus.take(frame.time, &consensus::accels(frame), residuals);
        let mags = frame.imus.map(|imu| imu.and_then(|s| s.mag_ut));
        let field = self.mag_consensus.take(frame.time, &mags, &mut field_residuals);
        if let Some(gyro) = gyro {
            self.estimate.body_rates_radps = gyro.value;
        }
        if let Some(accel) = accel {
            self.force = Some(self.low_pass(self.force, accel.value, dt_s));
            self.last_imu = Some(frame.time);
        }
        if let Some(field) = field {
            self.field = Some(self.low_pass(self.field, field.value, dt_s));
        }
        if let Some(force) = &self.force {
            let (roll, pitch) = attitude::tilt(force);
            let heading =
                self.field.and_then(|m| attitude::heading(&m, roll, pitch, self.model.imus.mag.declination_rad));
            let yaw = heading.unwrap_or(roll_pitch_yaw(&self.estimate.world_from_body).z);
            self.estimate.world_from_body = from_roll_pitch_yaw(&Vector3::new(roll, pitch, yaw));
        }
    }

    /// Height: median of the recent lasers, else motion capture, else the barometer from its first
    /// reading, else GNSS.
    fn take_heights(&mut self, frame: &SensorFrame) {
        for (last, sample) in self.heights.iter_mut().zip(&frame.heights) {
            if let Some(sample) = sample.filter(|s| s.height_m.is_finite()) {
                *last = Some((frame.time, sample.height_m));
            }
        }
        let fresh = self.heights.iter().flatten().filter(|(t, _)| frame.time.seconds_since(*t) < HEIGHT_FRESH_S);
        let median = Some(median(fresh.map(|(_, h)| *h))).filter(|median| median.is_finite());
        if let Some(median) = median {
            let sigma = self.model.heights.sigma * std::f64::consts::SQRT_2;
            for (i, sample) in frame.heights.iter().enumerate() {
                let Some(sample) = sample.filter(|s| s.height_m.is_finite()) else { continue };
                let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
                let innovation = sample.height_m - median;
                let gate = self.model.heights.gate;
                let _ =
                    self.estimate.residuals.try_push(Residual::gated(sensor, Channel::Height, innovation, sigma, gate));
            }
        }
        let mocap = frame.mocap_pose.map(|s| s.position_enu_m.z);
        let pressure = frame.barometers.iter().flatten().next().map(|s| self.model.barometers.altitude_m(s));
        let origin = pressure.filter(|a| a.is_finite()).map(|a| a - *self.barometer_origin_m.get_or_insert(a));
        let gnss = frame.gnss.map(|s| s.position_enu_m.z);
        let had_laser = self.heights.iter().any(Option::is_some);
        // A barometer or GNSS has another zero than the floor: not mixed in once a laser has reported.
        let found = median.or(mocap).or(if had_laser { None } else { origin.or(gnss) }).filter(|z| z.is_finite());
        let Some(z) = found else { return };
        let new_sample = frame.heights.iter().any(Option::is_some) || median.is_none();
        if !new_sample {
            return;
        }
        // An alpha–beta filter: height and climb rate, both within a few time constants.
        let (time, before) = self.altitude.unwrap_or((frame.time, z));
        let dt_s = frame.time.seconds_since(time);
        if dt_s > 0.0 && dt_s < HEIGHT_SILENCE_S {
            let climb = self.motion.velocity_enu_mps.z;
            let predicted = before + climb * dt_s;
            let alpha = dt_s / (self.time_constant_s + dt_s);
            let beta = alpha * alpha / (2.0 - alpha);
            let altitude = predicted + alpha * (z - predicted);
            self.motion.velocity_enu_mps.z = climb + beta / dt_s * (z - predicted);
            self.altitude = Some((frame.time, altitude));
        } else {
            self.altitude = Some((frame.time, if dt_s > 0.0 { z } else { before }));
            if dt_s > 0.0 {
                self.motion.velocity_enu_mps.z = 0.0;
            }
        }
        if let Some((_, altitude)) = self.altitude {
            self.motion.position_enu_m.z = altitude;
        }
    }

    fn take_horizontal(&mut self, frame: &SensorFrame) {
        let mocap = frame.mocap_pose.map(|s| (s.position_enu_m, None));
        let gnss = frame.gnss.map(|s| (s.position_enu_m, Some(s.velocity_enu_mps)));
        let Some((position, velocity)) = mocap.or(gnss) else { return };
        if position.xy().iter().all(|x| x.is_finite()) {
            let m = &mut self.motion;
            (m.position_enu_m.x, m.position_enu_m.y) = (position.x, position.y);
            self.last_horizontal = Some(frame.time);
            // A receiver may tell no climb.
            if let Some(v) = velocity.map(|v| v.xy()).filter(|v| v.iter().all(|x| x.is_finite())) {
                (m.velocity_enu_mps.x, m.velocity_enu_mps.y) = (v.x, v.y);
            }
        }
    }

    fn health(&self, now: FlightTime) -> Health {
        let since = |t: Option<FlightTime>| t.map_or(f64::INFINITY, |t| now.seconds_since(t));
        let Some(force) = self.force else { return Health::Initialising };
        let off = (force.norm() / self.model.imus.gravity_mps2 - 1.0).abs();
        let altitude_lost = self.altitude.is_some() && !self.motion.altitude_known;
        if since(self.last_imu) > IMU_SILENCE_S || altitude_lost || off > FORCE_TOLERANCE {
            Health::Degraded
        } else {
            Health::Healthy
        }
    }
}

impl Estimator for Complementary {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Complementary
    }

    fn step(&mut self, received: &SensorFrame, _applied: &MotorCommand) -> &Estimate {
        let dt_s = received.time.seconds_since(self.estimate.time).clamp(0.0, 1.0);
        self.estimate.time = received.time;
        self.estimate.residuals.clear();
        self.take_imus(received, dt_s);
        self.take_heights(received);
        self.take_horizontal(received);
        let known = |t: FlightTime| received.time.seconds_since(t) <= HORIZONTAL_SILENCE_S;
        self.motion.horizontal_known = self.last_horizontal.is_some_and(known);
        let since = |(t, _): (FlightTime, f64)| received.time.seconds_since(t);
        self.motion.altitude_known = self.altitude.is_some_and(|altitude| since(altitude) <= HEIGHT_SILENCE_S);
        self.estimate.motion = Some(self.motion);
        self.estimate.health = self.health(received.time);
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
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::sensor::barometer;
    use crate::sensor::measure::Kinematics;
    use crate::sensor::{BarometerSample, GnssSample, HeightSample, ImuSample};

    fn frame(k: u64, q: &UnitQuaternion<f64>, heights: [f64; 3]) -> SensorFrame {
        let time = FlightTime(k * 5000);
        let mut frame = SensorFrame { time, ..SensorFrame::default() };
        for imu in &mut frame.imus {
            *imu = Some(ImuSample {
                time,
                gyro_radps: Vector3::zeros(),
                accel_mps2: q.inverse() * Vector3::new(0.0, 0.0, 9.81),
                mag_ut: Some(q.inverse() * Vector3::new(0.0, 22.0, -40.0)),
                temperature_c: 20.0,
            });
        }
        if k.is_multiple_of(20) {
            for (slot, height_m) in frame.heights.iter_mut().zip(heights) {
                *slot = Some(HeightSample { time, height_m });
            }
        }
        frame
    }

    #[test]
    fn attitude_and_height_are_those_of_the_sensors() {
        let q = UnitQuaternion::from_euler_angles(0.2, -0.1, 2.5);
        let mut primary = Complementary::new(SensorModel::default());
        for k in 0..400 {
            primary.step(&frame(k, &q, [1.0, 1.6, 1.01]), &MotorCommand::default());
        }
        let e = primary.estimate();
        assert!(e.world_from_body.angle_to(&q) < 1e-6);
        // The attack on height 2 does not move the median, and shows.
        assert!((e.altitude_m().unwrap() - 1.01).abs() < 1e-3);
        assert_eq!(e.health, Health::Healthy);
        assert!(!e.horizontal_known());
    }

    #[test]
    fn an_attacked_height_is_over_its_gate() {
        let mut primary = Complementary::new(SensorModel::default());
        let e = primary.step(&frame(0, &UnitQuaternion::identity(), [1.0, 1.6, 1.01]), &MotorCommand::default());
        let ratio =
            |i: u8| e.residuals.iter().find(|r| r.channel == Channel::Height && r.sensor.instance == i).unwrap();
        assert!(ratio(2).ratio() > 1.0 && !ratio(2).accepted && ratio(1).accepted && ratio(3).accepted);
    }

    #[test]
    fn a_barometer_alone_measures_height_from_its_first_reading() {
        let mut primary = Complementary::new(SensorModel::default());
        for k in 0..400u64 {
            let time = FlightTime(k * 5000);
            let mut frame = SensorFrame { time, ..SensorFrame::default() };
            let climb = if k < 100 { 0.0 } else { 2.0 };
            let pressure_pa = barometer::pressure_pa(300.0 + climb, barometer::STANDARD_PRESSURE_PA);
            frame.barometers[0] = Some(BarometerSample { time, pressure_pa, temperature_c: 20.0 });
            primary.step(&frame, &MotorCommand::default());
        }
        assert!((primary.estimate().motion.unwrap().position_enu_m.z - 2.0).abs() < 0.01);
        assert_eq!(primary.estimate().health, Health::Initialising);
    }

    #[test]
    fn not_finite_is_skipped() {
        let q = UnitQuaternion::identity();
        let mut primary = Complementary::new(SensorModel::default());
        for k in 0..100 {
            let mut f = frame(k, &q, [1.0, f64::NAN, 1.0]);
            if k % 2 == 0 {
                f.imus[0] = f.imus[0].map(|s| ImuSample { accel_mps2: Vector3::repeat(f64::NAN), ..s });
            }
            f.gnss = Some(GnssSample {
                time: f.time,
                position_enu_m: Vector3::new(3.0, 4.0, 5.0),
                velocity_enu_mps: Vector3::new(1.0, -2.0, f64::NAN),
                geodetic: [0.0; 3],
                horizontal_sigma_m: 1.0,
                vertical_sigma_m: 2.0,
                satellites: 9,
            });
            let e = primary.step(&f, &MotorCommand::default());
            let Kinematics { position_enu_m, velocity_enu_mps, world_from_body } = e.kinematics();
            let mut numbers = position_enu_m.iter().chain(velocity_enu_mps.iter()).chain(world_from_body.coords.iter());
            assert!(numbers.all(|x| x.is_finite()));
            // Where and how fast it is in the plane, with a climb that is no number.
            assert_eq!((position_enu_m.x, velocity_enu_mps.x, velocity_enu_mps.y), (3.0, 1.0, -2.0));
        }
        assert!((primary.estimate().motion.unwrap().position_enu_m.z - 1.0).abs() < 1e-9);
    }
}

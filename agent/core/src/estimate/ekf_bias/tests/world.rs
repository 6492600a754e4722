//! A small world of known motion and white noise of known size, and what the tests measure in it.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::super::EkfBias;
use crate::estimate::{Channel, Estimate, Estimator, Residual};
use crate::frames::from_roll_pitch_yaw;
use crate::sensor::{GnssSample, HeightSample, ImuSample, MocapPoseSample, SensorFrame, SensorModel};
use crate::vehicle::Truth;

pub(in crate::estimate) const RATE_HZ: f64 = 200.0;
const FIELD_ENU_UT: Vector3<f64> = Vector3::new(0.0, 22.0, -40.0);

/// What moves, and how much.
#[derive(Clone, Copy)]
pub(in crate::estimate) struct Course {
    pub(in crate::estimate) position_m: f64,
    pub(in crate::estimate) tilt_rad: f64,
    pub(in crate::estimate) yaw_radps: f64,
}

pub(in crate::estimate) const HOVER: Course = Course { position_m: 0.0, tilt_rad: 0.0, yaw_radps: 0.0 };
pub(in crate::estimate) const LIVELY: Course = Course { position_m: 1.5, tilt_rad: 0.4, yaw_radps: 0.5 };

pub(in crate::estimate) struct World {
    motion: Course,
    rng: Xoshiro256PlusPlus,
    pub(in crate::estimate) accel_bias: [Vector3<f64>; 4],
    pub(in crate::estimate) gyro_bias: [Vector3<f64>; 4],
    pub(in crate::estimate) imus: usize,
    gyro_sigma: f64,
    accel_sigma: f64,
    pub(in crate::estimate) tick: u64,
}

impl World {
    pub(in crate::estimate) fn new(motion: Course, seed: u64) -> Self {
        let o = SensorModel::default();
        let mut w = Self {
            motion,
            rng: Xoshiro256PlusPlus::seed_from_u64(seed),
            accel_bias: [Vector3::zeros(); 4],
            gyro_bias: [Vector3::zeros(); 4],
            imus: 1,
            gyro_sigma: o.imus.gyro.noise_density * RATE_HZ.sqrt(),
            accel_sigma: o.imus.accel.noise_density * RATE_HZ.sqrt(),
            tick: 0,
        };
        for i in 0..4 {
            w.accel_bias[i] = w.noise(0.1);
            w.gyro_bias[i] = w.noise(0.01);
        }
        w
    }

    pub(in crate::estimate) fn scalar(&mut self, sigma: f64) -> f64 {
        let x: f64 = StandardNormal.sample(&mut self.rng);
        sigma * x
    }

    pub(in crate::estimate) fn noise(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::new(self.scalar(sigma), self.scalar(sigma), self.scalar(sigma))
    }

    pub(in crate::estimate) fn time(&self) -> FlightTime {
        FlightTime((self.tick as f64 / RATE_HZ * 1e6).round() as u64)
    }

    pub(in crate::estimate) fn position(&self, t: f64) -> Vector3<f64> {
        let a = self.motion.position_m;
        Vector3::new(a * (0.9 * t).sin(), a * (0.7 * t + 1.0).sin(), 1.5 + 0.3 * a * (1.3 * t).cos())
    }

    pub(in crate::estimate) fn attitude(&self, t: f64) -> UnitQuaternion<f64> {
        let a = self.motion.tilt_rad;
        from_roll_pitch_yaw(&Vector3::new(a * (1.7 * t).sin(), a * (1.1 * t).cos(), 0.3 + self.motion.yaw_radps * t))
    }

    pub(in crate::estimate) fn truth(&self) -> Truth {
        let t = self.tick as f64 / RATE_HZ;
        let h = 1e-3;
        let d = |f: &dyn Fn(f64) -> Vector3<f64>| (f(t + h) - f(t - h)) / (2.0 * h);
        let acceleration = (self.position(t + h) - 2.0 * self.position(t) + self.position(t - h)) / (h * h);
        let q = self.attitude(t);
        Truth {
            time: self.time(),
            position_enu_m: self.position(t),
            velocity_enu_mps: d(&|s| self.position(s)),
            world_from_body: q,
            body_rates_radps: (self.attitude(t - h).inverse() * self.attitude(t + h)).scaled_axis() / (2.0 * h),
            specific_force_mps2: q.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.81)),
            rotor_speed_radps: [0.0; 4],
            string_tension_n: [0.0; 4],
            ground_force_n: 0.0,
        }
    }

    /// The next frame: IMUs only. The other sensors are added by the tests.
    pub(in crate::estimate) fn frame(&mut self, with_field: bool) -> (SensorFrame, Truth) {
        self.tick += 1;
        let truth = self.truth();
        let mut frame = SensorFrame { time: truth.time, ..SensorFrame::default() };
        for i in 0..self.imus {
            // Four sample in pairs, in turns.
            if self.imus == 4 && (self.tick + i as u64) % 2 == 1 {
                continue;
            }
            let (gyro_noise, accel_noise, mag_noise) =
                (self.noise(self.gyro_sigma), self.noise(self.accel_sigma), self.noise(0.5));
            frame.imus[i] = Some(ImuSample {
                time: truth.time,
                gyro_radps: truth.body_rates_radps + self.gyro_bias[i] + gyro_noise,
                accel_mps2: truth.specific_force_mps2 + self.accel_bias[i] + accel_noise,
                mag_ut: with_field.then(|| truth.world_from_body.inverse() * FIELD_ENU_UT + mag_noise),
                temperature_c: 25.0,
            });
        }
        (frame, truth)
    }

    pub(in crate::estimate) fn every(&self, hz: f64) -> bool {
        self.tick.is_multiple_of((RATE_HZ / hz).round() as u64)
    }

    pub(in crate::estimate) fn heights(&mut self, frame: &mut SensorFrame, truth: &Truth, attack: f64) {
        // In turns, as the default suite does: 10 Hz each, 35 ms apart.
        for i in 0..3 {
            if (self.tick + 7 * i as u64).is_multiple_of(20) {
                let e = self.scalar(0.01) + if i == 1 { attack } else { 0.0 };
                let height_m = truth.position_enu_m.z + e;
                frame.heights[i] = Some(HeightSample { time: truth.time, height_m });
            }
        }
    }

    pub(in crate::estimate) fn mocap(&mut self, frame: &mut SensorFrame, truth: &Truth) {
        if self.every(20.0) {
            let turn = UnitQuaternion::from_scaled_axis(self.noise(0.01));
            frame.mocap_pose = Some(MocapPoseSample {
                time: truth.time,
                position_enu_m: truth.position_enu_m + self.noise(0.005),
                world_from_body: turn * truth.world_from_body,
            });
        }
    }

    pub(in crate::estimate) fn gnss(&mut self, frame: &mut SensorFrame, truth: &Truth, sigma: f64) {
        frame.gnss = Some(GnssSample {
            time: truth.time,
            position_enu_m: truth.position_enu_m + self.noise(sigma),
            velocity_enu_mps: truth.velocity_enu_mps + self.noise(0.1),
            geodetic: [0.0; 3],
            horizontal_sigma_m: sigma,
            vertical_sigma_m: sigma,
            satellites: 12,
        });
    }
}

pub(in crate::estimate) fn tilt_error(e: &Estimate, t: &Truth) -> f64 {
    let up = |q: &UnitQuaternion<f64>| q.inverse() * Vector3::z();
    up(&e.world_from_body).angle(&up(&t.world_from_body))
}

pub(in crate::estimate) fn errors(filter: &EkfBias, world: &World, truth: &Truth) -> SVector<f64, 15> {
    let e = filter.estimate();
    let estimated = e.kinematics();
    let mut x = SVector::<f64, 15>::zeros();
    x.fixed_rows_mut::<3>(0).copy_from(&(truth.position_enu_m - estimated.position_enu_m));
    x.fixed_rows_mut::<3>(3).copy_from(&(truth.velocity_enu_mps - estimated.velocity_enu_mps));
    x.fixed_rows_mut::<3>(6).copy_from(&(truth.world_from_body * e.world_from_body.inverse()).scaled_axis());
    x.fixed_rows_mut::<3>(9).copy_from(&(world.accel_bias[0] - e.accel_bias_mps2.unwrap()));
    x.fixed_rows_mut::<3>(12).copy_from(&(world.gyro_bias[0] - e.gyro_bias_radps.unwrap()));
    x
}

pub(in crate::estimate) fn height_residual(e: &Estimate, instance: u8) -> Option<Residual> {
    e.residuals.iter().find(|r| r.channel == Channel::Height && r.sensor.instance == instance).copied()
}

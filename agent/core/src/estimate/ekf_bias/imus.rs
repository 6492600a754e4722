//! The IMUs as one: their consensus, where each sits, and whether they are at rest.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use crate::estimate::Residuals;
use crate::estimate::aiding::lever_arm::LeverArm;
use crate::estimate::fdir::consensus::{self, Consensus};
use crate::sensor::imu::ImuModel;
use crate::sensor::{MAX_IMUS, SensorFrame};
use crate::types::MotorCommand;

/// Time constant against which stillness is measured, s.
const SLOW_S: f64 = 0.5;
/// Specific force at rest differs from g by less, m/s².
const REST_FORCE_MPS2: f64 = 0.6;
/// Rates at rest are smaller, beyond the noise, rad/s.
const REST_RATE_RADPS: f64 = 0.03;
/// Throttle of motors that stand.
const STANDING: f64 = 1e-3;

/// Consensus of the IMUs at one time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inertial {
    pub time: FlightTime,
    pub gyro_radps: Vector3<f64>,
    pub accel_mps2: Vector3<f64>,
}

/// The consensus of the IMUs, at the centre of mass.
#[derive(Debug, Clone)]
pub(super) struct Imus {
    gyro: Consensus,
    accel: Consensus,
    place_flu_m: [Vector3<f64>; MAX_IMUS],
    lever_arm: LeverArm,
    used: usize,
    trusted: bool,
}

impl Imus {
    pub fn new(model: &ImuModel) -> Self {
        Self {
            gyro: Consensus::of_gyros(model),
            accel: Consensus::of_accels(model),
            place_flu_m: model.position_flu_m,
            lever_arm: LeverArm::default(),
            used: 1,
            trusted: true,
        }
    }

    /// How many were averaged last.
    pub fn used(&self) -> usize {
        self.used
    }

    /// Did a majority agree?
    pub fn trusted(&self) -> bool {
        self.trusted
    }

    /// The consensus of this frame's IMUs, if any; deviations become residuals.
    pub fn take(
        &mut self,
        frame: &SensorFrame,
        gyro_bias_radps: &Vector3<f64>,
        residuals: &mut Residuals,
    ) -> Option<Inertial> {
        let gyro = self.gyro.take(frame.time, &consensus::gyros(frame), residuals)?;
        self.lever_arm.push(frame.time, &gyro.value);
        let rate = gyro.value - gyro_bias_radps;
        let mut accels = consensus::accels(frame);
        for (accel, place) in accels.iter_mut().zip(&self.place_flu_m) {
            if let Some(a) = accel {
                *a -= self.lever_arm.acceleration_mps2(place, &rate);
            }
        }
        let accel = self.accel.take(frame.time, &accels, residuals)?;
        self.used = gyro.used.min(accel.used).max(1);
        self.trusted = gyro.trusted && accel.trusted;
        Some(Inertial { time: frame.time, gyro_radps: gyro.value, accel_mps2: accel.value })
    }
}

/// Time constant of what vibration is taken for, s.
const SHAKEN_S: f64 = 1.0;
/// Noise density of what it leaves, per one-sigma of a sample about the one before over √2, √s: so that errors are as large as said in
/// the world `datasheet` (NEES).
const SHAKEN_DENSITY: f64 = 0.01;

/// Part of the squares that an accelerometer takes for an acceleration, 1/(m/s²): clipping and its own filter; and for how long, s.
const RECTIFIES_PER_MPS2: f64 = 0.03;
const RECTIFIES_S: f64 = 2.0;

/// How much the consensus changes from sample to sample: vibration, which no data sheet tells.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shaken {
    accel: Vector3<f64>,
    gyro: Vector3<f64>,
}

impl Shaken {
    /// Takes a sample and the one before.
    pub fn take(&mut self, before: &Inertial, now: &Inertial) {
        let gain = (now.time.seconds_since(before.time) / SHAKEN_S).clamp(0.0, 1.0);
        for (mean, change) in [
            (&mut self.accel, now.accel_mps2 - before.accel_mps2),
            (&mut self.gyro, now.gyro_radps - before.gyro_radps),
        ] {
            *mean += (change.component_mul(&change) * 0.5 - *mean) * gain;
        }
    }

    /// What an accelerometer rectifies, one sigma, m/s².
    pub fn rectified_mps2(&self) -> f64 {
        RECTIFIES_PER_MPS2 * self.accel.mean()
    }

    /// Walk of each axis of an accelerometer's bias, (m/s²)²/s, and the variance beyond which it stops, of what they are at rest. Upward
    /// alone: in the plane nothing tells a bias from tilt.
    pub fn widens(&self, walk: f64, most: f64) -> [(f64, f64); 3] {
        let rectified = self.rectified_mps2().powi(2);
        [(walk, most), (walk, most), (walk + rectified / RECTIFIES_S, most + rectified)]
    }

    /// Squares of the noise densities of accelerometers and gyroscopes, body FLU, (m/s²)²/Hz and (rad/s)²/Hz.
    pub fn densities(&self) -> [Vector3<f64>; 2] {
        [self.accel, self.gyro].map(|squares| squares * (SHAKEN_DENSITY * SHAKEN_DENSITY))
    }
}

/// At rest: motors commanded to stand, and nothing moving for a while.
#[derive(Debug, Clone, Default)]
pub(super) struct Rest {
    lasts_s: f64,
    slow_force: Option<Vector3<f64>>,
}

impl Rest {
    /// For how long, s.
    pub fn lasts_s(&self) -> f64 {
        self.lasts_s
    }

    pub fn take(
        &mut self,
        dt_s: f64,
        inertial: &Inertial,
        gyro_bias_radps: &Vector3<f64>,
        applied: &MotorCommand,
        model: &ImuModel,
    ) {
        let slow = self.slow_force.get_or_insert(inertial.accel_mps2);
        *slow += (inertial.accel_mps2 - *slow) * (dt_s / SLOW_S).min(1.0);
        let rate_limit = REST_RATE_RADPS + 3.0 * model.gyro.sigma;
        let still = (inertial.accel_mps2 - *slow).amax() < 3.0 * model.accel.sigma
            && (inertial.gyro_radps - gyro_bias_radps).amax() < rate_limit
            && (slow.norm() - model.gravity_mps2).abs() < REST_FORCE_MPS2;
        let standing = applied.throttle.iter().all(|t| t.abs() < STANDING);
        self.lasts_s = if still && standing { self.lasts_s + dt_s } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shakes_from_sample_to_sample_is_noise_and_a_steady_turn_is_none() {
        let densities = |accel: fn(u64) -> f64| {
            let mut shaken = Shaken::default();
            let at = |k: u64| Inertial {
                time: FlightTime(k * 10_000),
                gyro_radps: Vector3::repeat(0.5),
                accel_mps2: Vector3::z() * accel(k),
            };
            (1..1000).for_each(|k| shaken.take(&at(k - 1), &at(k)));
            shaken.densities().map(|density| density.map(f64::sqrt))
        };
        let [accel, gyro] = densities(|k| if k.is_multiple_of(2) { 12.0 } else { 8.0 });
        assert!((accel.z - SHAKEN_DENSITY * 4.0 / std::f64::consts::SQRT_2).abs() < 1e-4, "{accel}");
        assert_eq!((accel.x, gyro.norm()), (0.0, 0.0));
        assert!(densities(|k| 9.81 + 0.001 * k as f64)[0].z < 1e-5);
    }
}

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

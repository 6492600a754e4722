//! One lane: an error-state filter of its own for one IMU, at the fusion horizon.
//!
//! States, error and propagation are those of `ekf_bias`: δp, δv, δφ about the world axes, δb_a, δb_g, barometer offsets.
//! Its input are the means of one IMU over a slot; all other sensors correct every lane (`rows.rs`), so that the lanes
//! differ by their IMUs alone.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::SLOT_S;
use super::integral::Six;
use crate::estimate::aiding::lever_arm::LeverArm;
use crate::estimate::ekf_bias::covariance::{self, Covariance, ErrorState, Noise, ix};
use crate::sensor::MAX_BAROMETERS;
use crate::sensor::SensorModel;
use crate::sensor::measure::Kinematics;

/// σ of a lane's means into noise of its input: they are means over 0.8 s.
const ACCEL_GAIN: f64 = 0.9;
const GYRO_GAIN: f64 = 0.5;
/// No bias is taken for steadier, m/s²/√s and rad/s/√s, nor known better before flight, m/s² and rad/s.
const WALKS: (f64, f64) = (5.7e-3, 3e-4);
const PRIORS: (f64, f64) = (0.1, 5e-3);
/// The walks widen no bias beyond so many times what was known before.
const WIDEST: f64 = 3.0;
/// What healing adds to the best lane's σ: m, m/s, rad, m/s², rad/s.
const HEALED: [f64; 5] = [0.02, 0.1, 0.02, 0.03, 0.002];

/// See the module.
#[derive(Debug, Clone)]
pub struct Lane {
    /// Position, velocity, attitude at the horizon.
    pub at: Kinematics,
    /// Of the accelerometer, body FLU, m/s².
    pub accel_bias: Vector3<f64>,
    /// Of the gyroscope, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Of the barometers, once known, m.
    pub barometer_offset_m: [Option<f64>; MAX_BAROMETERS],
    /// Covariance.
    pub p: Covariance,
    /// Specific force over the last slot, at the centre of mass, biases removed, body FLU, m/s².
    pub force: Vector3<f64>,
    /// Rate over the last slot, bias removed, rad/s.
    pub rate: Vector3<f64>,
    lever_arm: LeverArm,
    place_flu_m: Vector3<f64>,
    gravity_mps2: f64,
}

impl Lane {
    /// At rest at the origin; knows nothing.
    pub fn new(place_flu_m: Vector3<f64>, gravity_mps2: f64) -> Self {
        let (zero, world_from_body) = (Vector3::zeros(), UnitQuaternion::identity());
        Self {
            at: Kinematics { position_enu_m: zero, velocity_enu_mps: zero, world_from_body },
            accel_bias: zero,
            gyro_bias: zero,
            barometer_offset_m: [None; MAX_BAROMETERS],
            p: Covariance::zeros(),
            force: Vector3::z() * gravity_mps2,
            rate: zero,
            lever_arm: LeverArm::default(),
            place_flu_m,
            gravity_mps2,
        }
    }

    /// Begins at `at` with these biases; one-sigmas of position, velocity, tilt, yaw and gyroscope bias.
    pub fn begin(&mut self, at: &Kinematics, biases: &Six, sigmas: [f64; 5], model: &SensorModel) {
        let [position, velocity, tilt, yaw, gyro_bias] = sigmas;
        self.at = *at;
        self.set_biases(biases);
        self.barometer_offset_m = [None; MAX_BAROMETERS];
        self.p = Covariance::zeros();
        let accel_bias = model.imus.accel.bias_prior.max(PRIORS.0);
        for i in 0..3 {
            for (start, sigma) in [
                (ix::POSITION, position),
                (ix::VELOCITY, velocity),
                (ix::ATTITUDE, if i == 2 { yaw } else { tilt }),
                (ix::ACCEL_BIAS, accel_bias),
                (ix::GYRO_BIAS, gyro_bias.max(PRIORS.1)),
            ] {
                self.p[(start + i, start + i)] = sigma * sigma;
            }
        }
    }

    /// Begins again from `best` at `at`, with these biases.
    pub fn heal(&mut self, best: &Self, at: &Kinematics, biases: &Six) {
        self.at = *at;
        self.set_biases(biases);
        self.barometer_offset_m = best.barometer_offset_m;
        self.p = best.p;
        for (block, sigma) in HEALED.into_iter().enumerate() {
            (3 * block..3 * block + 3).for_each(|i| self.p[(i, i)] += sigma * sigma);
        }
    }

    fn set_biases(&mut self, biases: &Six) {
        self.accel_bias = biases.fixed_rows::<3>(0).into_owned();
        self.gyro_bias = biases.fixed_rows::<3>(3).into_owned();
    }

    /// Both biases.
    pub fn biases(&self) -> Six {
        let (a, g) = (self.accel_bias, self.gyro_bias);
        Six::new(a.x, a.y, a.z, g.x, g.y, g.z)
    }

    /// Over a slot that ends at `end`, with the `mean` of its IMU, whose σ is `sigma`.
    pub fn predict(&mut self, end: FlightTime, mean: &Six, sigma: &Six, model: &SensorModel) {
        let (measured, turned) = (mean.fixed_rows::<3>(0).into_owned(), mean.fixed_rows::<3>(3).into_owned());
        self.rate = turned - self.gyro_bias;
        self.lever_arm.push(end, &turned);
        let felt = self.lever_arm.acceleration_mps2(&self.place_flu_m, &self.rate);
        self.force = measured - self.accel_bias - felt;
        let k = &mut self.at;
        let middle =
            (k.world_from_body * UnitQuaternion::from_scaled_axis(self.rate * (0.5 * SLOT_S))).to_rotation_matrix();
        let force_enu = middle * self.force;
        let acceleration = force_enu - Vector3::z() * self.gravity_mps2;
        k.position_enu_m += k.velocity_enu_mps * SLOT_S + acceleration * (0.5 * SLOT_S * SLOT_S);
        k.velocity_enu_mps += acceleration * SLOT_S;
        k.world_from_body *= UnitQuaternion::from_scaled_axis(self.rate * SLOT_S);
        k.world_from_body.renormalize_fast();
        let squares = middle.matrix().map(|x| x * x);
        let of = |rows: usize, gain: f64| squares * sigma.fixed_rows::<3>(rows).map(|s| (gain * s).powi(2));
        let (accel, gyro) = (&model.imus.accel, &model.imus.gyro);
        let bias = |walk: f64, prior: f64| (walk * walk, (WIDEST * prior).powi(2));
        let noise = Noise {
            accel: of(0, ACCEL_GAIN),
            gyro: of(3, GYRO_GAIN),
            accel_bias: [bias(accel.bias_walk.max(WALKS.0), accel.bias_prior.max(PRIORS.0)); 3],
            gyro_bias: bias(gyro.bias_walk.max(WALKS.1), gyro.bias_prior.max(PRIORS.1)),
            barometer: model.barometers.walk.powi(2),
        };
        covariance::propagate(&mut self.p, &force_enu, middle.matrix(), SLOT_S, &noise);
    }

    /// Acceleration over the last slot, ENU, m/s².
    fn acceleration(&self) -> Vector3<f64> {
        self.at.world_from_body * self.force - Vector3::z() * self.gravity_mps2
    }

    /// Where it was `age_s` before the horizon.
    pub fn past(&self, age_s: f64) -> Kinematics {
        let (k, a) = (&self.at, self.acceleration());
        Kinematics {
            position_enu_m: k.position_enu_m - k.velocity_enu_mps * age_s + a * (0.5 * age_s * age_s),
            velocity_enu_mps: k.velocity_enu_mps - a * age_s,
            world_from_body: k.world_from_body * UnitQuaternion::from_scaled_axis(-self.rate * age_s),
        }
    }

    /// x ← x ⊕ δx.
    pub fn inject(&mut self, dx: &ErrorState) {
        let block = |i: usize| Vector3::new(dx[i], dx[i + 1], dx[i + 2]);
        self.at.position_enu_m += block(ix::POSITION);
        self.at.velocity_enu_mps += block(ix::VELOCITY);
        self.at.world_from_body = UnitQuaternion::from_scaled_axis(block(ix::ATTITUDE)) * self.at.world_from_body;
        self.accel_bias += block(ix::ACCEL_BIAS);
        self.gyro_bias += block(ix::GYRO_BIAS);
        for (i, offset) in self.barometer_offset_m.iter_mut().enumerate() {
            offset.iter_mut().for_each(|offset| *offset += dx[ix::BAROMETER + i]);
        }
    }

    /// Is every number one?
    pub fn is_sound(&self) -> bool {
        let k = &self.at;
        let numbers = k.position_enu_m.iter().chain(k.velocity_enu_mps.iter()).chain(k.world_from_body.coords.iter());
        numbers.chain(self.biases().iter()).all(|x| x.is_finite())
            && self.p.diagonal().iter().all(|x| x.is_finite() && *x >= 0.0)
    }
}

//! What the filter assumes of the sensors: plain data.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use crate::estimate::fdir::consensus::ConsensusOptions;
use crate::model::measure::barometer::STANDARD_PRESSURE_PA;
use crate::sensor::MAX_IMUS;
use crate::sensor::imu::Imu;
use crate::sensor::suite::{Quality, Suite};
use crate::types::CAMERAS;

/// Gate of each sensor, in sigmas of its innovation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gates {
    /// Magnetometer heading.
    pub heading: f64,
    /// Laser heights.
    pub height: f64,
    /// Barometers.
    pub barometer: f64,
    /// GNSS position and velocity.
    pub gnss: f64,
    /// Motion-capture pose.
    pub mocap_pose: f64,
    /// Motion-capture camera ranges.
    pub camera_ranges: f64,
}

impl Default for Gates {
    fn default() -> Self {
        Self { heading: 5.0, height: 5.0, barometer: 5.0, gnss: 5.0, mocap_pose: 5.0, camera_ranges: 5.0 }
    }
}

/// Noise, priors and habits of [`super::EkfBias`].
#[derive(Debug, Clone, PartialEq)]
pub struct EkfOptions {
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// Magnetic declination, rad, east of north positive; zero makes the world's north magnetic.
    pub declination_rad: f64,

    /// Gyroscope noise density of one IMU, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Accelerometer noise density of one IMU, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Process noise common to all IMUs (vibration, scale), rad/s/√Hz.
    pub common_gyro_noise_density: f64,
    /// The same for the accelerometer, m/s²/√Hz.
    pub common_accel_noise_density: f64,
    /// Random walk of the gyroscope bias, rad/s/√s.
    pub gyro_bias_walk: f64,
    /// Random walk of the accelerometer bias, m/s²/√s.
    pub accel_bias_walk: f64,
    /// One-sigma of the gyroscope bias before anything is known, rad/s; the walk never widens it further.
    pub gyro_bias_prior_radps: f64,
    /// One-sigma of the accelerometer bias before anything is known, m/s².
    pub accel_bias_prior_mps2: f64,
    /// Where each IMU sits, body FLU from the centre of mass, m: its accelerometer feels rotation.
    pub imu_position_flu_m: [Vector3<f64>; MAX_IMUS],
    /// Consensus of the gyroscopes.
    pub gyro_consensus: ConsensusOptions,
    /// Consensus of the accelerometers.
    pub accel_consensus: ConsensusOptions,

    /// Laser height, one-sigma of each instance, m.
    pub height_sigma_m: f64,
    /// A height further than so many sigmas from the median of those of the last moments (at least three) moves the state
    /// as if it were so far (Huber).
    pub height_reach: f64,
    /// Barometric altitude, one-sigma, m.
    pub barometer_sigma_m: f64,
    /// Random walk of the barometer's offset, m/√s.
    pub barometer_walk: f64,
    /// Pressure that is altitude zero, Pa; the offset state takes up the rest.
    pub reference_pressure_pa: f64,
    /// Magnetometer noise, µT.
    pub mag_sigma_ut: f64,
    /// Heading error that no noise explains (iron left over), rad.
    pub heading_floor_rad: f64,
    /// Headings of one instance are taken at most this often, s.
    pub heading_period_s: f64,
    /// A field whose strength differs by more than this fraction from the one at start is disturbed.
    pub field_tolerance: f64,
    /// Smallest one-sigma assumed of a GNSS position, m.
    pub gnss_floor_m: f64,
    /// GNSS velocity, one-sigma, m/s.
    pub gnss_velocity_sigma_mps: f64,
    /// Motion-capture position, one-sigma, m.
    pub mocap_position_sigma_m: f64,
    /// Motion-capture attitude, one-sigma, rad.
    pub mocap_attitude_sigma_rad: f64,
    /// Camera ranges, one-sigma of each, m.
    pub camera_sigma_m: [f64; CAMERAS],
    /// Cameras in the world frame, m.
    pub cameras_enu_m: [Vector3<f64>; CAMERAS],
    /// Gates.
    pub gates: Gates,

    /// After this long without an accepted sample, what is consistently rejected becomes the new truth, s.
    pub recovery_s: f64,
    /// Without horizontal aiding: how fast the vehicle may be going, one-sigma, m/s.
    pub idle_velocity_sigma_mps: f64,
    /// … for how long at a time, s.
    pub idle_velocity_correlation_s: f64,
    /// … and how far from where it was last known, one-sigma, m.
    pub idle_position_sigma_m: f64,
    /// Yaw, one-sigma at start without magnetometer and motion capture, rad. There yaw 0 is where the
    /// vehicle pointed at start, unless GNSS says better.
    pub unknown_yaw_sigma_rad: f64,
}

impl Default for EkfOptions {
    /// Consumer MEMS in a lab: figures of [Paternain] Table I and [Clinic] 5.4, cameras of [Umasankar].
    fn default() -> Self {
        Self {
            gravity_mps2: 9.81,
            declination_rad: 0.0,
            gyro_noise_density: 5e-4,
            accel_noise_density: 5e-3,
            common_gyro_noise_density: 2e-4,
            common_accel_noise_density: 1e-2,
            gyro_bias_walk: 2e-5,
            accel_bias_walk: 5e-4,
            gyro_bias_prior_radps: 0.03,
            accel_bias_prior_mps2: 0.2,
            imu_position_flu_m: [Vector3::zeros(); MAX_IMUS],
            gyro_consensus: ConsensusOptions {
                sigma: 0.02,
                spread: 0.05,
                largest_deviation: 0.1,
                learning_samples: 4000.0,
                gate: 5.0,
                memory_s: 0.015,
                hold_off_s: 0.5,
            },
            accel_consensus: ConsensusOptions {
                sigma: 0.12,
                spread: 0.4,
                largest_deviation: 0.8,
                learning_samples: 4000.0,
                gate: 5.0,
                memory_s: 0.015,
                hold_off_s: 0.5,
            },
            height_sigma_m: 0.01,
            height_reach: f64::INFINITY,
            barometer_sigma_m: 0.15,
            barometer_walk: 0.02,
            reference_pressure_pa: STANDARD_PRESSURE_PA,
            mag_sigma_ut: 0.5,
            heading_floor_rad: 0.035,
            heading_period_s: 0.1,
            field_tolerance: 0.2,
            gnss_floor_m: 0.05,
            gnss_velocity_sigma_mps: 0.1,
            mocap_position_sigma_m: 0.005,
            mocap_attitude_sigma_rad: 0.01,
            camera_sigma_m: [1.5e-3, 15e-3, 2e-3, 100e-3],
            cameras_enu_m: [
                Vector3::new(10.0, 10.0, 10.0),
                Vector3::new(-10.0, 10.0, 10.0),
                Vector3::new(-10.0, -10.0, 10.0),
                Vector3::new(10.0, -10.0, 10.0),
            ],
            gates: Gates::default(),
            recovery_s: 2.0,
            idle_velocity_sigma_mps: 0.5,
            idle_velocity_correlation_s: 2.0,
            idle_position_sigma_m: 5.0,
            unknown_yaw_sigma_rad: FRAC_PI_2,
        }
    }
}

/// Pascals for a metre of height near sea level.
const PA_PER_M: f64 = 11.8;

impl From<&Suite> for EkfOptions {
    /// Sigmas, rates, places and gates of `suite`; what a suite does not say keeps its default.
    fn from(suite: &Suite) -> Self {
        let mut o = Self::default();
        let worst = |f: &dyn Fn(&Imu) -> f64| suite.imus.iter().map(f).fold(0.0, f64::max);
        if !suite.imus.is_empty() {
            let density = |q: &Quality, imu: &Imu| q.total_sigma() / imu.timing.rate_hz.sqrt();
            o.gyro_noise_density = worst(&|i| density(&i.gyro, i));
            o.accel_noise_density = worst(&|i| density(&i.accel, i));
            o.gyro_bias_walk = worst(&|i| i.gyro.bias_walk).max(1e-5);
            o.accel_bias_walk = worst(&|i| i.accel.bias_walk).max(1e-4);
            // Twice the data sheet: a unit may be worse, and the centre of the consensus is not the mean.
            o.gyro_bias_prior_radps = (2.0 * worst(&|i| i.gyro.bias_sigma)).max(5e-3);
            o.accel_bias_prior_mps2 = (2.0 * worst(&|i| i.accel.bias_sigma)).max(0.05);
            let memory_s = 1.25 * suite.imus.iter().map(|i| i.timing.period_s()).fold(0.0, f64::max);
            let consensus = |o: &ConsensusOptions, pick: &dyn Fn(&Imu) -> Quality, floor: f64| ConsensusOptions {
                sigma: worst(&|i| pick(i).total_sigma()).max(floor),
                spread: 1.5 * worst(&|i| pick(i).bias_sigma),
                largest_deviation: 5.0 * worst(&|i| pick(i).bias_sigma),
                gate: worst(&|i| pick(i).gate_sigmas),
                memory_s,
                ..*o
            };
            // Floors: scale and mounting make healthy units differ by that much in motion.
            o.gyro_consensus = consensus(&o.gyro_consensus, &|i| i.gyro, 0.01);
            o.accel_consensus = consensus(&o.accel_consensus, &|i| i.accel, 0.08);
            for (place, imu) in o.imu_position_flu_m.iter_mut().zip(&suite.imus) {
                *place = imu.position_flu_m;
            }
            let mags = || suite.imus.iter().filter_map(|i| i.mag);
            if let Some(mag) = mags().reduce(|a, b| if a.total_sigma() > b.total_sigma() { a } else { b }) {
                o.mag_sigma_ut = mag.total_sigma().hypot(mag.bias_sigma);
                o.gates.heading = mag.gate_sigmas;
            }
        }
        if let Some(height) =
            suite.heights.iter().map(|s| s.height).reduce(|a, b| if a.sigma > b.sigma { a } else { b })
        {
            o.height_sigma_m = height.total_sigma().hypot(height.bias_sigma).max(2e-3);
            o.gates.height = height.gate_sigmas;
        }
        if let Some(pressure) = suite.barometers.first().map(|s| s.pressure) {
            o.barometer_sigma_m = pressure.total_sigma() / PA_PER_M;
            o.barometer_walk = (pressure.bias_walk / PA_PER_M).max(0.01);
            o.gates.barometer = pressure.gate_sigmas;
        }
        if let Some(gnss) = &suite.gnss {
            o.gnss_velocity_sigma_mps = gnss.velocity.total_sigma();
            o.gates.gnss = gnss.horizontal.gate_sigmas;
        }
        if let Some(mocap) = &suite.mocap_pose {
            o.mocap_position_sigma_m = mocap.position.total_sigma().max(1e-4);
            o.mocap_attitude_sigma_rad = mocap.attitude.total_sigma().max(1e-4);
            o.gates.mocap_pose = mocap.position.gate_sigmas;
        }
        if let Some(cameras) = &suite.camera_ranges {
            o.cameras_enu_m = cameras.cameras_enu_m;
            o.camera_sigma_m = [cameras.range.total_sigma().max(1e-4); CAMERAS];
            o.gates.camera_ranges = cameras.range.gate_sigmas;
        }
        o
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_makes_usable_options() {
        for name in crate::sensor::suite::PRESETS {
            let o = EkfOptions::from(&Suite::preset(name).unwrap());
            for x in [
                o.gyro_noise_density,
                o.accel_noise_density,
                o.gyro_bias_prior_radps,
                o.accel_bias_prior_mps2,
                o.gyro_consensus.sigma,
                o.accel_consensus.memory_s,
                o.height_sigma_m,
                o.barometer_sigma_m,
                o.mag_sigma_ut,
                o.mocap_position_sigma_m,
                o.camera_sigma_m[0],
            ] {
                assert!(x.is_finite() && x > 0.0, "{name}: {o:?}");
            }
        }
    }
}

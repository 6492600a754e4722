//! Inertial measurement unit: angular rate, specific force and, on a 9-DOF unit, the magnetic field.

use nalgebra::{Matrix3, Vector3};
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::MAX_IMUS;
use super::sample::{Quantity, Sample, Scalars, put, xyz};
use super::suite::{self, Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};
use crate::model::attitude::GRAVITY_MPS2;

/// One sample of an IMU, in the body frame FLU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Angular rate, rad/s.
    pub gyro_radps: Vector3<f64>,
    /// Specific force, m/s²: +9.81 along z at rest and level.
    pub accel_mps2: Vector3<f64>,
    /// Magnetic field, µT; `None` when this sample carries none.
    pub mag_ut: Option<Vector3<f64>>,
    /// Die temperature, °C.
    pub temperature_c: f64,
}

impl Sample for ImuSample {
    const TOPIC: Kind = Kind::Imu;
    const KIND: v1::SensorKind = v1::SensorKind::Imu;
    const QUANTITIES: &'static [Quantity] = &[
        Quantity { name: "gyro", unit: "rad/s", scalars: 3, named: true },
        Quantity { name: "accel", unit: "m/s²", scalars: 3, named: true },
        Quantity { name: "mag", unit: "µT", scalars: 3, named: true },
    ];
    type Sheet = Imu;
    type Model = ImuModel;

    fn model(sheets: &[Imu]) -> ImuModel {
        ImuModel::of(sheets)
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        put(&mut values, 0, &self.gyro_radps);
        put(&mut values, 3, &self.accel_mps2);
        put(&mut values, 6, &self.mag_ut.unwrap_or_default());
        values
    }

    fn scalars_after(&self, before: Option<Scalars>) -> Scalars {
        let mut values = self.scalars();
        if let Some(before) = before.filter(|_| self.mag_ut.is_none()) {
            put(&mut values, 6, &xyz(&before, 6));
        }
        values
    }

    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.gyro_radps = xyz(values, 0);
        self.accel_mps2 = xyz(values, 3);
        // A sample without a magnetometer reading stays without one.
        self.mag_ut = self.mag_ut.map(|_| xyz(values, 6));
        self
    }

    wire::message! {
        ImuSample of ImuReading,
        |s| v1::ImuReading {
            gyro_radps: wire::vector(&s.gyro_radps),
            accel_mps2: wire::vector(&s.accel_mps2),
            mag_ut: s.mag_ut.as_ref().and_then(wire::vector),
            temperature_c: s.temperature_c,
        },
        |time, r| {
            Some(Self {
                time,
                gyro_radps: wire::xyz(r.gyro_radps.as_ref()?),
                accel_mps2: wire::xyz(r.accel_mps2.as_ref()?),
                mag_ut: r.mag_ut.as_ref().map(wire::xyz),
                temperature_c: r.temperature_c,
            })
        }
    }
}

/// What estimators assume of a quantity that every IMU measures in three axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriaxialModel {
    /// Noise density of one IMU, unit/√Hz.
    pub noise_density: f64,
    /// Process noise common to all of them (vibration, scale), unit/√Hz.
    pub common_noise_density: f64,
    /// Random walk of the bias, unit/√s.
    pub bias_walk: f64,
    /// One-sigma of the bias before anything is known; the walk never widens it further.
    pub bias_prior: f64,
    /// One-sigma of one sample: noise, and what mounting and scale let instances differ in motion.
    pub sigma: f64,
    /// One-sigma between instances before anything is learned (their biases).
    pub spread: f64,
    /// Largest baseline of an instance, per axis.
    pub largest_deviation: f64,
    /// Gate of an instance against the consensus, in sigmas.
    pub gate: f64,
    /// A sample takes part in a consensus this long, s: a little more than the period of one IMU.
    pub memory_s: f64,
}

/// What estimators assume of magnetometers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MagnetometerModel {
    /// Noise, one-sigma, µT.
    pub sigma_ut: f64,
    /// Heading error that no noise explains (iron left over), rad.
    pub floor_rad: f64,
    /// A field whose strength differs by more than this fraction from the one at start is disturbed.
    pub field_tolerance: f64,
    /// Gate of a heading, in sigmas of its innovation.
    pub gate: f64,
    /// Magnetic declination, rad, east of north positive; zero makes the world's north magnetic.
    pub declination_rad: f64,
}

/// What estimators assume of IMUs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuModel {
    /// Gyroscopes, rad/s.
    pub gyro: TriaxialModel,
    /// Accelerometers, m/s².
    pub accel: TriaxialModel,
    /// Magnetometers.
    pub mag: MagnetometerModel,
    /// Where each sits, body FLU from the centre of mass, m: its accelerometer feels rotation.
    pub position_flu_m: [Vector3<f64>; MAX_IMUS],
    /// What an accelerometer at rest reads, m/s².
    pub gravity_mps2: f64,
}

impl Default for ImuModel {
    fn default() -> Self {
        let gyro = TriaxialModel {
            noise_density: 5e-4,
            common_noise_density: 2e-4,
            bias_walk: 2e-5,
            bias_prior: 0.03,
            sigma: 0.02,
            spread: 0.05,
            largest_deviation: 0.1,
            gate: 5.0,
            memory_s: 0.015,
        };
        let accel = TriaxialModel {
            noise_density: 5e-3,
            common_noise_density: 1e-2,
            bias_walk: 5e-4,
            bias_prior: 0.2,
            sigma: 0.12,
            spread: 0.4,
            largest_deviation: 0.8,
            ..gyro
        };
        let mag = MagnetometerModel {
            sigma_ut: 0.5,
            floor_rad: 0.035,
            field_tolerance: 0.2,
            gate: 5.0,
            declination_rad: 0.0,
        };
        Self { gyro, accel, mag, position_flu_m: [Vector3::zeros(); MAX_IMUS], gravity_mps2: GRAVITY_MPS2 }
    }
}

impl ImuModel {
    /// The worst of `sheets`; what they do not say keeps its default.
    fn of(sheets: &[Imu]) -> Self {
        let mut model = Self::default();
        if sheets.is_empty() {
            return model;
        }
        let worst = |f: &dyn Fn(&Imu) -> f64| sheets.iter().map(f).fold(0.0, f64::max);
        let memory_s = 1.25 * worst(&|i| i.timing.period_s());
        // Floors of σ: scale and mounting make healthy units differ by that much in motion.
        let triaxial = |typical: &TriaxialModel, of: &dyn Fn(&Imu) -> Quality, walk: f64, prior: f64, sigma: f64| {
            let bias = worst(&|i| of(i).bias_sigma);
            TriaxialModel {
                noise_density: worst(&|i| of(i).total_sigma() / i.timing.rate_hz.sqrt()),
                bias_walk: worst(&|i| of(i).bias_walk).max(walk),
                // Twice the data sheet: a unit may be worse, and the centre of the consensus is not the mean.
                bias_prior: (2.0 * bias).max(prior),
                sigma: worst(&|i| of(i).total_sigma()).max(sigma),
                spread: 1.5 * bias,
                largest_deviation: 5.0 * bias,
                gate: worst(&|i| of(i).gate_sigmas),
                memory_s,
                ..*typical
            }
        };
        model.gyro = triaxial(&model.gyro, &|i| i.gyro, 1e-5, 5e-3, 0.01);
        model.accel = triaxial(&model.accel, &|i| i.accel, 1e-4, 0.05, 0.08);
        for (place, imu) in model.position_flu_m.iter_mut().zip(sheets) {
            *place = imu.position_flu_m;
        }
        let mags = sheets.iter().filter_map(|i| i.mag);
        if let Some(mag) = mags.reduce(|a, b| if a.total_sigma() > b.total_sigma() { a } else { b }) {
            model.mag.sigma_ut = mag.total_sigma().hypot(mag.bias_sigma);
            model.mag.gate = mag.gate_sigmas;
        }
        model
    }
}

/// A 9-DOF inertial measurement unit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imu {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Where it sits, body FLU from the centre of mass, m. Off-centre accelerometers feel rotation.
    pub position_flu_m: Vector3<f64>,
    /// Roll, pitch, yaw of its axes in the body, rad. Removed from the samples before they are delivered.
    #[serde(default)]
    pub mounting_rpy_rad: Vector3<f64>,
    /// Angular rate, rad/s.
    pub gyro: Quality,
    /// Specific force, m/s².
    pub accel: Quality,
    /// Magnetic field, µT; absent on a 6-DOF unit.
    #[serde(default)]
    pub mag: Option<Quality>,
    /// What a calibration would remove; none by default.
    #[serde(default)]
    pub distortion: Distortion,
}

/// How an uncalibrated IMU distorts: reading = matrix · truth (rows), in its own axes, plus the errors of its
/// [`Quality`].
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Distortion {
    /// Scale and misalignment of the gyroscope.
    pub gyro: [[f64; 3]; 3],
    /// Scale and misalignment of the accelerometer.
    pub accel: [[f64; 3]; 3],
    /// Soft iron.
    pub mag: [[f64; 3]; 3],
    /// Hard iron, µT.
    pub hard_iron_ut: [f64; 3],
}

impl Default for Distortion {
    fn default() -> Self {
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Self { gyro: identity, accel: identity, mag: identity, hard_iron_ut: [0.0; 3] }
    }
}

impl Distortion {
    /// The rows as a matrix.
    pub fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
        Matrix3::from_fn(|i, j| rows[i][j])
    }
}

impl Sheet for Imu {
    /// IMU `instance` (1..=5) of the plate: 100 Hz and resolutions of \[Paternain\] Table I (4 mg, 0.07 °/s,
    /// 5 mGa), ranges of \[Clinic\] 5.4.1 (16 g, 2000 °/s, 2500 µT). Pairs sit 3 cm off the centre, the second
    /// of each pair turned by 180° about its yaw axis; a fifth sits in the centre. Samples of pairs interleave by half a
    /// period.
    fn typical(instance: usize) -> Self {
        let (x, y) = [(0.03, 0.03), (-0.03, 0.03), (-0.03, -0.03), (0.03, -0.03), (0.0, 0.0)][(instance - 1) % 5];
        let turned = instance.is_multiple_of(2);
        Self {
            name: format!("IMU {instance}"),
            timing: Timing { phase_s: if turned { 0.005 } else { 0.0 }, ..Timing::at(100.0) },
            position_flu_m: Vector3::new(x, y, 0.0),
            mounting_rpy_rad: Vector3::new(0.0, 0.0, if turned { std::f64::consts::PI } else { 0.0 }),
            gyro: Quality {
                sigma: 0.004,
                bias_sigma: 0.008,
                bias_walk: 1e-4,
                resolution: 0.07f64.to_radians(),
                range: 2000f64.to_radians(),
                gate_sigmas: 5.0,
            },
            accel: Quality {
                sigma: 0.10,
                bias_sigma: 0.05,
                bias_walk: 5e-4,
                resolution: 4e-3 * 9.81,
                range: 16.0 * 9.81,
                gate_sigmas: 5.0,
            },
            mag: Some(Quality {
                sigma: 0.6,
                bias_sigma: 0.5,
                bias_walk: 2e-3,
                resolution: 0.5,
                range: 2500.0,
                gate_sigmas: 5.0,
            }),
            distortion: Distortion::default(),
        }
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("gyro", &mut self.gyro);
        each("accel", &mut self.accel);
        if let Some(mag) = &mut self.mag {
            each("mag", mag);
        }
    }

    fn distort(&mut self, distortion: Distortion) {
        self.distortion = distortion;
    }

    fn check(&self, check: &Checker, key: &str) -> Result<(), SuiteError> {
        check.vector(key, "position_flu_m", &self.position_flu_m)?;
        check.vector(key, "mounting_rpy_rad", &self.mounting_rpy_rad)?;
        let d = &self.distortion;
        for value in d.gyro.iter().chain(&d.accel).chain(&d.mag).flatten() {
            check.within(key, "distortion", *value, -2.0, 2.0, "an entry within ±2")?;
        }
        for value in &d.hard_iron_ut {
            check.within(key, "distortion.hard_iron_ut", *value, -500.0, 500.0, "within ±500 µT")?;
        }
        Ok(())
    }
}

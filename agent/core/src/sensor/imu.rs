//! Inertial measurement unit: angular rate, specific force and, on a 9-DOF unit, the magnetic field.

use nalgebra::{Matrix3, Vector3};
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::sample::{Quantity, Sample, Scalars, put, xyz};
use super::suite::{Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};

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
    type Wire = v1::ImuSample;

    fn time(&self) -> FlightTime {
        self.time
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        put(&mut values, 0, &self.gyro_radps);
        put(&mut values, 3, &self.accel_mps2);
        put(&mut values, 6, &self.mag_ut.unwrap_or_default());
        values
    }

    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.gyro_radps = xyz(values, 0);
        self.accel_mps2 = xyz(values, 3);
        // A sample without a magnetometer reading stays without one.
        self.mag_ut = self.mag_ut.map(|_| xyz(values, 6));
        self
    }

    fn to_wire(&self, received: Option<&Self>, into: &mut v1::ImuSample) {
        let reading = |s: &Self| v1::ImuReading {
            gyro_radps: wire::vector(&s.gyro_radps),
            accel_mps2: wire::vector(&s.accel_mps2),
            mag_ut: s.mag_ut.as_ref().and_then(wire::vector),
            temperature_c: s.temperature_c,
        };
        let (reception, received) = wire::reception(self, received, reading);
        *into = v1::ImuSample { time_us: self.time.0, reception, sensed: Some(reading(self)), received };
    }

    fn from_wire(m: v1::ImuSample) -> Option<(Self, Received<Self>)> {
        let time = FlightTime(m.time_us);
        wire::sample(m.reception(), m.sensed, m.received, |r: v1::ImuReading| {
            Some(Self {
                time,
                gyro_radps: wire::xyz(r.gyro_radps.as_ref()?),
                accel_mps2: wire::xyz(r.accel_mps2.as_ref()?),
                mag_ut: r.mag_ut.as_ref().map(wire::xyz),
                temperature_c: r.temperature_c,
            })
        })
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
    /// IMU `instance` (1..=5) of the plate: 100 Hz and resolutions of [Paternain] Table I (4 mg, 0.07 °/s,
    /// 5 mGa), ranges of [Clinic] 5.4.1 (16 g, 2000 °/s, 2500 µT). Pairs sit 3 cm off the centre, the second
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

    fn name(&self) -> &str {
        &self.name
    }

    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn timing_mut(&mut self) -> &mut Timing {
        &mut self.timing
    }

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

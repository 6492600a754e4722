//! The sensor suite: which sensors the vehicle carries, how fast and how well they measure.
//!
//! Plain data, read by the simulator (to make samples), by the estimators (sigmas, gates, places) and by
//! telemetry (the description of the vehicle). It holds what a data sheet or a calibration would say; the
//! biases a simulated sensor really has are drawn by the simulator and are known to nobody else.
//!
//! Default rates and resolutions: IMU and barometer [Paternain] Table I, ranges [Clinic] 5.4.1, laser
//! height [Clinic] 5.4.2, cameras [Umasankar] Tables 1–2. Sigmas, biases and drifts are not in the sources
//! (beyond the accuracies they quote) and are chosen here.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use plumbline_proto::{ids::SensorId, v1::SensorKind};
use serde::Deserialize;

use crate::vehicle::{CAMERAS, MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS};

/// Most sensors of a suite.
pub const MAX_SENSORS: usize = MAX_IMUS + MAX_HEIGHTS + MAX_BAROMETERS + 3;
/// Most samples a delayed sensor may have under way.
pub const MAX_UNDER_WAY: usize = 32;

/// When a sensor samples, and how much of it arrives. Present on every sensor.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Samples a second.
    pub rate_hz: f64,
    /// Time of the first sample, s.
    #[serde(default)]
    pub phase_s: f64,
    /// From measurement to delivery, s; the sample keeps the time of its measurement.
    #[serde(default)]
    pub delay_s: f64,
    /// Probability that a sample is lost, 0..1.
    #[serde(default)]
    pub dropout: f64,
}

impl Timing {
    const fn at(rate_hz: f64) -> Self {
        Self { rate_hz, phase_s: 0.0, delay_s: 0.0, dropout: 0.0 }
    }

    /// Time between samples, s.
    pub fn period_s(&self) -> f64 {
        1.0 / self.rate_hz
    }
}

/// One measured quantity: white noise, a bias that is constant but for a slow walk, resolution, range.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quality {
    /// White noise of one sample, one sigma.
    pub sigma: f64,
    /// Turn-on bias, one sigma.
    #[serde(default)]
    pub bias_sigma: f64,
    /// Bias walk, one sigma after one second.
    #[serde(default)]
    pub bias_walk: f64,
    /// Smallest step of the reading; 0 for none.
    #[serde(default)]
    pub resolution: f64,
    /// The reading is cut to ± this.
    #[serde(default = "unlimited")]
    pub range: f64,
    /// An innovation above this many predicted sigmas is rejected.
    #[serde(default = "default_gate")]
    pub gate_sigmas: f64,
}

fn unlimited() -> f64 {
    f64::MAX
}

fn default_gate() -> f64 {
    5.0
}

impl Quality {
    const fn white(sigma: f64) -> Self {
        Self { sigma, bias_sigma: 0.0, bias_walk: 0.0, resolution: 0.0, range: f64::MAX, gate_sigmas: 5.0 }
    }

    /// One sigma of noise and rounding together.
    pub fn total_sigma(&self) -> f64 {
        // Rounding to a step d adds d²/12 of variance.
        (self.sigma * self.sigma + self.resolution * self.resolution / 12.0).sqrt()
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

/// A laser height, looking down.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Height {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Where it sits, body FLU from the centre of mass, m.
    pub position_flu_m: Vector3<f64>,
    /// Height, m. `range` is the farthest it sees.
    pub height: Quality,
    /// Nothing is measured nearer than this, m.
    #[serde(default)]
    pub nearest_m: f64,
    /// Nothing is measured with the vehicle tilted more than this, rad.
    #[serde(default = "default_tilt")]
    pub tilt_max_rad: f64,
}

fn default_tilt() -> f64 {
    1.0
}

/// A barometer with its thermometer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Barometer {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Pressure, Pa.
    pub pressure: Quality,
    /// Error of the pressure for each °C above the temperature at boot, Pa.
    #[serde(default)]
    pub drift_pa_per_c: f64,
}

/// A GNSS receiver.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gnss {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Horizontal position per axis, m. Its bias is the slow error of the satellites' ranges.
    pub horizontal: Quality,
    /// Vertical position, m.
    pub vertical: Quality,
    /// Velocity per axis, m/s.
    pub velocity: Quality,
}

/// Motion-capture pose.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MocapPose {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Position per axis, m.
    pub position: Quality,
    /// Attitude about each axis, rad.
    pub attitude: Quality,
}

/// Ranges to the motion-capture cameras ([Umasankar] Eq. 13).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRanges {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Where the cameras are, ENU, m.
    pub cameras_enu_m: [Vector3<f64>; CAMERAS],
    /// Range, m.
    pub range: Quality,
    /// Deliver the mean of the four marker ranges, as a real system does, instead of the range to the
    /// centroid: up to 2.5 mm apart (ERRATA [Umasankar] 9).
    #[serde(default)]
    pub marker_mean: bool,
}

/// Every sensor of a vehicle. Instances count from 1 in each list.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// IMUs.
    #[serde(default)]
    pub imus: ArrayVec<Imu, MAX_IMUS>,
    /// Laser heights.
    #[serde(default)]
    pub heights: ArrayVec<Height, MAX_HEIGHTS>,
    /// Barometers.
    #[serde(default)]
    pub barometers: ArrayVec<Barometer, MAX_BAROMETERS>,
    /// GNSS receiver.
    #[serde(default)]
    pub gnss: Option<Gnss>,
    /// Motion-capture pose.
    #[serde(default)]
    pub mocap_pose: Option<MocapPose>,
    /// Motion-capture ranges.
    #[serde(default)]
    pub camera_ranges: Option<CameraRanges>,
    /// Battery voltage noise, V; `None` when it is not measured.
    #[serde(default)]
    pub battery_sigma_v: Option<f64>,
}

/// Why a suite cannot be used: names the sensor's key and the value.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("suite: {key} = {value} is not {expected}")]
pub struct SuiteError {
    /// The key.
    pub key: String,
    /// The offending value.
    pub value: String,
    /// What it should be.
    pub expected: &'static str,
}

/// One line of a suite: what telemetry says about a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// The sensor.
    pub id: SensorId,
    /// For people: "height 2".
    pub name: String,
    /// Samples a second.
    pub rate_hz: f64,
    /// One sigma of its first channel.
    pub sigma: f64,
    /// Unit of the first channel.
    pub unit: &'static str,
}

/// Names accepted by [`Suite::preset`].
pub const PRESETS: [&str; 4] = ["string_rig", "clinic", "paternain", "umasankar"];

impl Suite {
    /// The suite called `name`.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "string_rig" => Some(Self::string_rig()),
            "clinic" => Some(Self::clinic()),
            "paternain" => Some(Self::paternain()),
            "umasankar" => Some(Self::umasankar()),
            _ => None,
        }
    }

    /// No sensor at all.
    pub fn empty() -> Self {
        Self {
            imus: ArrayVec::new(),
            heights: ArrayVec::new(),
            barometers: ArrayVec::new(),
            gnss: None,
            mocap_pose: None,
            camera_ranges: None,
            battery_sigma_v: Some(0.02),
        }
    }

    /// Our default: four 9-DOF IMUs on a plate near the centre, three laser heights (two guarantee nothing,
    /// DESIGN), one barometer; indoors, so no GNSS.
    pub fn string_rig() -> Self {
        let mut suite = Self::empty();
        for instance in 1..=4 {
            suite.imus.push(Self::imu_unit(instance));
        }
        for instance in 1..=3 {
            suite.heights.push(Self::laser(instance, 3));
        }
        suite.barometers.push(Self::barometer_unit());
        suite
    }

    /// The suite of [Clinic] 5.4: four 9-DOF IMUs, two laser heights.
    pub fn clinic() -> Self {
        let mut suite = Self::string_rig();
        suite.barometers.clear();
        suite.heights.clear();
        for instance in 1..=2 {
            suite.heights.push(Self::laser(instance, 2));
        }
        suite
    }

    /// The suite of [Paternain] Table I: one IMU, barometer, GNSS.
    pub fn paternain() -> Self {
        let mut suite = Self::empty();
        let mut imu = Self::imu_unit(1);
        imu.position_flu_m = Vector3::zeros();
        suite.imus.push(imu);
        suite.barometers.push(Self::barometer_unit());
        suite.gnss = Some(Self::gnss_unit());
        suite
    }

    /// The suite of [Umasankar]: one IMU at the centroid, ranges from four cameras.
    pub fn umasankar() -> Self {
        let mut suite = Self::empty();
        let mut imu = Self::imu_unit(1);
        imu.position_flu_m = Vector3::zeros();
        suite.imus.push(imu);
        suite.camera_ranges = Some(Self::camera_ranges_unit());
        suite
    }

    /// IMU `instance` (1..=5) of the plate: 100 Hz and resolutions of [Paternain] Table I (4 mg, 0.07 °/s,
    /// 5 mGa), ranges of [Clinic] 5.4.1 (16 g, 2000 °/s, 2500 µT). Pairs sit 3 cm off the centre, the second
    /// of each pair turned by 180° about its yaw axis; a fifth sits in the centre. Samples of pairs interleave by half a
    /// period.
    pub fn imu_unit(instance: usize) -> Imu {
        let (x, y) = [(0.03, 0.03), (-0.03, 0.03), (-0.03, -0.03), (0.03, -0.03), (0.0, 0.0)][(instance - 1) % 5];
        let turned = instance.is_multiple_of(2);
        Imu {
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

    /// Laser height `instance` of `of`: 10 Hz, 1 mm resolution ([Clinic] 5.4.2), the units staggered evenly
    /// over the period. The source guarantees 3 cm; sigma 7 mm and a 4 mm mounting error are chosen.
    pub fn laser(instance: usize, of: usize) -> Height {
        const RATE_HZ: f64 = 10.0;
        let angle = std::f64::consts::TAU * (instance - 1) as f64 / of as f64;
        // On the 5 ms grid of the default tick.
        let phase_s = ((instance - 1) as f64 / (of as f64 * RATE_HZ) / 0.005).round() * 0.005;
        Height {
            name: format!("height {instance}"),
            timing: Timing { phase_s, ..Timing::at(RATE_HZ) },
            position_flu_m: Vector3::new(0.08 * angle.cos(), 0.08 * angle.sin(), -0.05),
            height: Quality {
                sigma: 0.007,
                bias_sigma: 0.004,
                bias_walk: 0.0,
                resolution: 0.001,
                range: 4.0,
                gate_sigmas: 5.0,
            },
            nearest_m: 0.02,
            tilt_max_rad: default_tilt(),
        }
    }

    /// Barometer: 100 Hz, 1 Pa ([Paternain] Table I); 3 Pa of noise (25 cm) and its drifts are chosen.
    pub fn barometer_unit() -> Barometer {
        Barometer {
            name: "barometer 1".into(),
            timing: Timing::at(100.0),
            pressure: Quality {
                sigma: 3.0,
                bias_sigma: 30.0,
                bias_walk: 0.3,
                resolution: 1.0,
                range: 120_000.0,
                gate_sigmas: 5.0,
            },
            drift_pa_per_c: 1.2,
        }
    }

    /// GNSS: 1 Hz ([Paternain] Table I), 2–3 m with good sky ([Paternain] IV-B): 2 m of slow error and 0.8 m
    /// of noise per axis, 0.2 s late (chosen).
    pub fn gnss_unit() -> Gnss {
        Gnss {
            name: "GNSS 1".into(),
            timing: Timing { delay_s: 0.2, ..Timing::at(1.0) },
            horizontal: Quality { bias_sigma: 2.0, bias_walk: 0.05, ..Quality::white(0.8) },
            vertical: Quality { bias_sigma: 3.0, bias_walk: 0.08, ..Quality::white(1.5) },
            velocity: Quality::white(0.1),
        }
    }

    /// Motion-capture pose: 100 Hz, 1 mm, 2 mrad, 10 ms late (chosen).
    pub fn mocap_pose_unit() -> MocapPose {
        MocapPose {
            name: "mocap pose 1".into(),
            timing: Timing { delay_s: 0.010, ..Timing::at(100.0) },
            position: Quality::white(0.001),
            attitude: Quality::white(0.002),
        }
    }

    /// Four cameras at (±10, ±10, 10) m, 120 Hz, 1.5 mm ([Umasankar] Table 2 and its Vicon data sheet).
    pub fn camera_ranges_unit() -> CameraRanges {
        CameraRanges {
            name: "camera ranges 1".into(),
            timing: Timing::at(120.0),
            cameras_enu_m: [(10.0, 10.0), (-10.0, 10.0), (-10.0, -10.0), (10.0, -10.0)]
                .map(|(x, y)| Vector3::new(x, y, 10.0)),
            range: Quality::white(0.0015),
            marker_mean: false,
        }
    }

    /// One line for each sensor.
    pub fn descriptions(&self) -> ArrayVec<Description, MAX_SENSORS> {
        let mut list = ArrayVec::new();
        let mut add = |kind, index: usize, name: &str, timing: &Timing, quality: &Quality, unit| {
            list.push(Description {
                id: SensorId::new(kind, index as u8 + 1),
                name: name.to_owned(),
                rate_hz: timing.rate_hz,
                sigma: quality.total_sigma(),
                unit,
            });
        };
        for (i, s) in self.imus.iter().enumerate() {
            add(SensorKind::Imu, i, &s.name, &s.timing, &s.gyro, "rad/s");
        }
        for (i, s) in self.heights.iter().enumerate() {
            add(SensorKind::Height, i, &s.name, &s.timing, &s.height, "m");
        }
        for (i, s) in self.barometers.iter().enumerate() {
            add(SensorKind::Barometer, i, &s.name, &s.timing, &s.pressure, "Pa");
        }
        if let Some(s) = &self.gnss {
            add(SensorKind::Gnss, 0, &s.name, &s.timing, &s.horizontal, "m");
        }
        if let Some(s) = &self.mocap_pose {
            add(SensorKind::MocapPose, 0, &s.name, &s.timing, &s.position, "m");
        }
        if let Some(s) = &self.camera_ranges {
            add(SensorKind::CameraRanges, 0, &s.name, &s.timing, &s.range, "m");
        }
        list
    }

    /// Is `sensor` part of it?
    pub fn contains(&self, sensor: SensorId) -> bool {
        let count = match sensor.kind {
            SensorKind::Unspecified => 0,
            SensorKind::Imu => self.imus.len(),
            SensorKind::Height => self.heights.len(),
            SensorKind::Barometer => self.barometers.len(),
            SensorKind::Gnss => usize::from(self.gnss.is_some()),
            SensorKind::MocapPose => usize::from(self.mocap_pose.is_some()),
            SensorKind::CameraRanges => usize::from(self.camera_ranges.is_some()),
        };
        (1..=count).contains(&usize::from(sensor.instance))
    }

    /// Checks every value for a loop of `tick_rate_hz`; the first bad one is named.
    ///
    /// # Errors
    /// [`SuiteError`].
    pub fn validate(&self, tick_rate_hz: f64) -> Result<(), SuiteError> {
        let check = Checker { tick_rate_hz };
        for (i, s) in self.imus.iter().enumerate() {
            let key = format!("imus[{i}]");
            check.timing(&key, &s.timing)?;
            check.vector(&key, "position_flu_m", &s.position_flu_m)?;
            check.vector(&key, "mounting_rpy_rad", &s.mounting_rpy_rad)?;
            check.quality(&key, "gyro", &s.gyro)?;
            check.quality(&key, "accel", &s.accel)?;
            if let Some(mag) = &s.mag {
                check.quality(&key, "mag", mag)?;
            }
            let d = &s.distortion;
            for value in d.gyro.iter().chain(&d.accel).chain(&d.mag).flatten() {
                check.within(&key, "distortion", *value, -2.0, 2.0, "an entry within ±2")?;
            }
            for value in &d.hard_iron_ut {
                check.within(&key, "distortion.hard_iron_ut", *value, -500.0, 500.0, "within ±500 µT")?;
            }
        }
        for (i, s) in self.heights.iter().enumerate() {
            let key = format!("heights[{i}]");
            check.timing(&key, &s.timing)?;
            check.vector(&key, "position_flu_m", &s.position_flu_m)?;
            check.quality(&key, "height", &s.height)?;
            check.within(&key, "nearest_m", s.nearest_m, 0.0, s.height.range, "between 0 and its range")?;
            check.within(&key, "tilt_max_rad", s.tilt_max_rad, 0.0, 1.5, "an angle of 0 to 1.5 rad")?;
        }
        for (i, s) in self.barometers.iter().enumerate() {
            let key = format!("barometers[{i}]");
            check.timing(&key, &s.timing)?;
            check.quality(&key, "pressure", &s.pressure)?;
            check.within(&key, "drift_pa_per_c", s.drift_pa_per_c, -1e3, 1e3, "within 1000 Pa/°C")?;
        }
        if let Some(s) = &self.gnss {
            check.timing("gnss", &s.timing)?;
            check.quality("gnss", "horizontal", &s.horizontal)?;
            check.quality("gnss", "vertical", &s.vertical)?;
            check.quality("gnss", "velocity", &s.velocity)?;
        }
        if let Some(s) = &self.mocap_pose {
            check.timing("mocap_pose", &s.timing)?;
            check.quality("mocap_pose", "position", &s.position)?;
            check.quality("mocap_pose", "attitude", &s.attitude)?;
        }
        if let Some(s) = &self.camera_ranges {
            check.timing("camera_ranges", &s.timing)?;
            check.quality("camera_ranges", "range", &s.range)?;
            for (i, camera) in s.cameras_enu_m.iter().enumerate() {
                check.vector("camera_ranges", &format!("cameras_enu_m[{i}]"), camera)?;
            }
        }
        if let Some(sigma) = self.battery_sigma_v {
            check.within("suite", "battery_sigma_v", sigma, 0.0, 10.0, "0 to 10 V")?;
        }
        Ok(())
    }
}

struct Checker {
    tick_rate_hz: f64,
}

impl Checker {
    fn within(
        &self,
        sensor: &str,
        key: &str,
        value: f64,
        min: f64,
        max: f64,
        expected: &'static str,
    ) -> Result<(), SuiteError> {
        // A NaN fails both comparisons.
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(SuiteError { key: format!("{sensor}.{key}"), value: value.to_string(), expected })
        }
    }

    fn timing(&self, sensor: &str, t: &Timing) -> Result<(), SuiteError> {
        let (rate, period) = (t.rate_hz, 1.0 / t.rate_hz);
        self.within(sensor, "timing.rate_hz", rate, 0.01, self.tick_rate_hz, "between 0.01 and the tick rate")?;
        self.within(sensor, "timing.phase_s", t.phase_s, 0.0, period, "between 0 and the period")?;
        let longest = (MAX_UNDER_WAY - 2) as f64 * period;
        self.within(sensor, "timing.delay_s", t.delay_s, 0.0, longest, "between 0 and 30 periods")?;
        self.within(sensor, "timing.dropout", t.dropout, 0.0, 1.0, "a probability")
    }

    fn quality(&self, sensor: &str, name: &str, q: &Quality) -> Result<(), SuiteError> {
        for (field, value) in
            [("sigma", q.sigma), ("bias_sigma", q.bias_sigma), ("bias_walk", q.bias_walk), ("resolution", q.resolution)]
        {
            self.within(sensor, &format!("{name}.{field}"), value, 0.0, 1e6, "zero or a positive number")?;
        }
        self.within(sensor, &format!("{name}.range"), q.range, 1e-9, f64::MAX, "a positive number")?;
        self.within(sensor, &format!("{name}.gate_sigmas"), q.gate_sigmas, 0.1, 1e3, "between 0.1 and 1000")
    }

    fn vector(&self, sensor: &str, key: &str, v: &Vector3<f64>) -> Result<(), SuiteError> {
        if v.iter().all(|x| x.is_finite()) {
            return Ok(());
        }
        let value = format!("[{}, {}, {}]", v.x, v.y, v.z);
        Err(SuiteError { key: format!("{sensor}.{key}"), value, expected: "three finite numbers" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_valid() {
        for name in PRESETS {
            Suite::preset(name).unwrap().validate(200.0).unwrap();
        }
        assert!(Suite::preset("nothing").is_none());
    }

    #[test]
    fn a_suite_can_be_written_as_toml() {
        let suite: Suite = toml::from_str(
            r#"
            [[heights]]
            name = "height 1"
            timing = { rate_hz = 10, phase_s = 0.05 }
            position_flu_m = [0.08, 0, -0.05]
            height = { sigma = 0.007, resolution = 0.001, range = 4 }
            [gnss]
            name = "GNSS 1"
            timing = { rate_hz = 5, delay_s = 0.1, dropout = 0.01 }
            horizontal = { sigma = 0.8 }
            vertical = { sigma = 1.5, gate_sigmas = 4 }
            velocity = { sigma = 0.1 }
            "#,
        )
        .unwrap();
        suite.validate(200.0).unwrap();
        assert_eq!((suite.heights.len(), suite.imus.len()), (1, 0));
        assert_eq!(suite.heights[0].height.gate_sigmas, 5.0);
        assert_eq!(suite.gnss.unwrap().vertical.gate_sigmas, 4.0);
        let text = toml::from_str::<Suite>("[[heights]]\nname = \"x\"\ncolour = 3").unwrap_err().to_string();
        assert!(text.contains("colour = 3"), "{text}");
    }

    #[test]
    fn the_default_rig_has_four_imus_three_staggered_heights_and_a_barometer() {
        let suite = Suite::string_rig();
        let list = suite.descriptions();
        let count = |kind| list.iter().filter(|d| d.id.kind == kind).count();
        assert_eq!([SensorKind::Imu, SensorKind::Height, SensorKind::Barometer].map(count), [4, 3, 1], "{list:?}");
        let phases: Vec<_> = suite.heights.iter().map(|h| h.timing.phase_s).collect();
        assert!(phases.windows(2).all(|p| p[1] - p[0] >= 0.03 - 1e-12), "{phases:?}");
        assert!(suite.contains(SensorId::new(SensorKind::Height, 3)));
        assert!(!suite.contains(SensorId::new(SensorKind::Height, 4)));
        assert!(!suite.contains(SensorId::new(SensorKind::Height, 0)));
        assert!(!suite.contains(SensorId::new(SensorKind::Gnss, 1)));
        assert_eq!(Suite::clinic().heights.len(), 2);
    }

    #[test]
    fn errors_name_sensor_key_and_value() {
        type Spoil = fn(&mut Suite);
        let cases: [(&str, Spoil); 4] = [
            ("imus[2].timing.rate_hz = 400", |s| s.imus[2].timing.rate_hz = 400.0),
            ("heights[1].height.sigma = -1", |s| s.heights[1].height.sigma = -1.0),
            ("heights[0].timing.dropout = NaN", |s| s.heights[0].timing.dropout = f64::NAN),
            ("barometers[0].timing.delay_s = 9", |s| s.barometers[0].timing.delay_s = 9.0),
        ];
        for (expected, spoil) in cases {
            let mut suite = Suite::string_rig();
            spoil(&mut suite);
            let text = suite.validate(200.0).unwrap_err().to_string();
            assert!(text.contains(expected), "{text}");
        }
    }
}

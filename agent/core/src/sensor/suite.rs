//! The sensor suite: which sensors the vehicle carries, how fast and how well they measure.
//!
//! Plain data, read by the simulator (to make samples), by the estimators (sigmas, gates, places) and by
//! telemetry (the description of the vehicle). It holds what a data sheet or a calibration would say; the
//! biases a simulated sensor really has are drawn by the simulator and are known to nothing else.
//!
//! Default rates and resolutions: IMU and barometer \[Paternain\] Table I, ranges \[Clinic\] 5.4.1, laser
//! height \[Clinic\] 5.4.2, cameras \[Umasankar\] Tables 1–2. Sigmas, biases and drifts are not in the sources
//! (beyond the accuracies they quote) and are chosen here.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use serde::Deserialize;

use super::MAX_SENSORS;
pub use super::Suite;
use super::barometer::Barometer;
use super::camera_ranges::CameraRanges;
use super::gnss::Gnss;
use super::height::Height;
use super::imu::{Distortion, Imu};

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
    pub(super) const fn at(rate_hz: f64) -> Self {
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
    pub(super) const fn white(sigma: f64) -> Self {
        Self { sigma, bias_sigma: 0.0, bias_walk: 0.0, resolution: 0.0, range: f64::MAX, gate_sigmas: 5.0 }
    }

    /// One sigma of noise and rounding together.
    pub fn total_sigma(&self) -> f64 {
        // Rounding to a step d adds d²/12 of variance.
        (self.sigma * self.sigma + self.resolution * self.resolution / 12.0).sqrt()
    }
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
    /// One sigma of its first quantity.
    pub sigma: f64,
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

    /// Our default: four 9-DOF IMUs on a plate near the centre, three laser heights (two guarantee nothing,
    /// DESIGN), one barometer; indoors, so no GNSS.
    pub fn string_rig() -> Self {
        let mut suite = Self::empty();
        for instance in 1..=4 {
            suite.imus.push(Imu::typical(instance));
        }
        for instance in 1..=3 {
            suite.heights.push(Height::laser(instance, 3));
        }
        suite.barometers.push(Barometer::typical(1));
        suite
    }

    /// The suite of \[Clinic\] 5.4: four 9-DOF IMUs, two laser heights.
    pub fn clinic() -> Self {
        let mut suite = Self::string_rig();
        suite.barometers.clear();
        suite.heights.clear();
        for instance in 1..=2 {
            suite.heights.push(Height::laser(instance, 2));
        }
        suite
    }

    /// The suite of \[Paternain\] Table I: one IMU, barometer, GNSS.
    pub fn paternain() -> Self {
        let mut suite = Self::empty();
        let mut imu = Imu::typical(1);
        imu.position_flu_m = Vector3::zeros();
        suite.imus.push(imu);
        suite.barometers.push(Barometer::typical(1));
        suite.gnss = Some(Gnss::typical(1));
        suite
    }

    /// The suite of \[Umasankar\]: one IMU at the centroid, ranges from four cameras.
    pub fn umasankar() -> Self {
        let mut suite = Self::empty();
        let mut imu = Imu::typical(1);
        imu.position_flu_m = Vector3::zeros();
        suite.imus.push(imu);
        suite.camera_ranges = Some(CameraRanges::typical(1));
        suite
    }

    /// Typical sensors, as many as are told, at the rates told, Hz; a rate of zero leaves the usual one.
    pub fn at_rates(told: impl Iterator<Item = (SensorId, f64)> + Clone) -> Self {
        let mut suite = Self::empty();
        for (sensor, _) in told.clone() {
            suite.add(sensor.kind);
        }
        suite.sheets_mut(|id, sheet| {
            if let Some((_, rate_hz)) = told.clone().find(|(sensor, rate_hz)| *sensor == id && *rate_hz > 0.0) {
                sheet.timing_mut().rate_hz = rate_hz;
            }
        });
        suite
    }

    /// One line for each sensor.
    pub fn descriptions(&self) -> ArrayVec<Description, MAX_SENSORS> {
        let mut list = ArrayVec::new();
        self.clone().sheets_mut(|id, sheet| {
            let mut sigma = None;
            sheet.qualities(&mut |_, quality| sigma = sigma.or(Some(quality.total_sigma())));
            list.push(Description {
                id,
                name: sheet.name().to_owned(),
                rate_hz: sheet.timing().rate_hz,
                sigma: sigma.unwrap_or_default(),
            });
        });
        list
    }

    /// Is `sensor` part of it?
    pub fn contains(&self, sensor: SensorId) -> bool {
        let mut found = false;
        self.sheets(|id, _, _| found |= id == sensor);
        found
    }

    /// Checks every value for a loop of `tick_rate_hz`; the first bad one is named.
    ///
    /// # Errors
    /// [`SuiteError`].
    pub fn validate(&self, tick_rate_hz: f64) -> Result<(), SuiteError> {
        let check = Checker { tick_rate_hz };
        let mut verdict = Ok(());
        let mut keys = Vec::new();
        self.sheets(|_, key, sheet| {
            if verdict.is_ok() {
                verdict = check.timing(&key, sheet.timing()).and_then(|()| sheet.check(&check, &key));
            }
            keys.push(key);
        });
        let mut keys = keys.into_iter();
        self.clone().sheets_mut(|_, sheet| {
            let key = keys.next().unwrap_or_default();
            sheet.qualities(&mut |name, quality| {
                if verdict.is_ok() {
                    verdict = check.quality(&key, name, quality);
                }
            });
        });
        verdict?;
        if let Some(sigma) = self.battery_sigma_v {
            check.within("suite", "battery_sigma_v", sigma, 0.0, 10.0, "0 to 10 V")?;
        }
        Ok(())
    }
}

/// The key of the sheet at `index` of `list` in a suite's file.
pub(super) fn key(list: &str, many: bool, index: usize) -> String {
    if many { format!("{list}[{index}]") } else { list.to_owned() }
}

/// Takes one more sheet; one that has no room is given up.
pub trait Fill<S> {
    /// Takes `sheet`.
    fn fill(&mut self, sheet: S);
}

impl<S, const N: usize> Fill<S> for ArrayVec<S, N> {
    fn fill(&mut self, sheet: S) {
        let _ = self.try_push(sheet);
    }
}

impl<S> Fill<S> for Option<S> {
    fn fill(&mut self, sheet: S) {
        *self = Some(sheet);
    }
}

/// What a suite knows of a sensor, whatever its kind.
pub trait Sheet {
    /// The data sheet of a common unit.
    fn typical(instance: usize) -> Self
    where
        Self: Sized;

    /// For people.
    fn name(&self) -> &str;

    /// When it samples.
    fn timing(&self) -> &Timing;

    /// The same, to alter.
    fn timing_mut(&mut self) -> &mut Timing;

    /// Shows the quality of each quantity, that of the first one first.
    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality));

    /// Takes over a distortion; only IMUs have one.
    fn distort(&mut self, _distortion: Distortion) {}

    /// Checks what only this kind has.
    ///
    /// # Errors
    /// [`SuiteError`], naming the value below `key`.
    fn check(&self, _check: &Checker, _key: &str) -> Result<(), SuiteError> {
        Ok(())
    }
}

/// Name and timing of a data sheet that has fields of these names, in its `impl Sheet`.
macro_rules! named_and_timed {
    () => {
        fn name(&self) -> &str {
            &self.name
        }

        fn timing(&self) -> &Timing {
            &self.timing
        }

        fn timing_mut(&mut self) -> &mut Timing {
            &mut self.timing
        }
    };
}
pub(super) use named_and_timed;

/// Checks the values of a suite, for one tick rate.
#[derive(Debug, Clone, Copy)]
pub struct Checker {
    tick_rate_hz: f64,
}

impl Checker {
    pub(super) fn within(
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

    pub(super) fn vector(&self, sensor: &str, key: &str, v: &Vector3<f64>) -> Result<(), SuiteError> {
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
    use crate::sensor::imu::TriaxialModel;
    use crate::sensor::{GnssSample, SensorModel};
    use plumbline_proto::time::FlightTime;
    use plumbline_proto::v1::SensorKind;

    #[test]
    fn every_preset_is_valid() {
        for name in PRESETS {
            Suite::preset(name).unwrap().validate(200.0).unwrap();
        }
        assert!(Suite::preset("nothing").is_none());
    }

    #[test]
    fn every_preset_makes_a_usable_model() {
        for name in PRESETS {
            let m = SensorModel::from(&Suite::preset(name).unwrap());
            let triaxial = |q: &TriaxialModel| [q.noise_density, q.bias_prior, q.sigma, q.memory_s];
            let others = [
                m.heights.sigma,
                m.barometers.altitude.sigma,
                m.imus.mag.sigma_ut,
                m.gnss.velocity.sigma,
                m.mocap_pose.position.sigma,
                m.camera_ranges.sigma_m[0],
            ];
            let all = [&triaxial(&m.imus.gyro)[..], &triaxial(&m.imus.accel), &others].concat();
            assert!(all.iter().all(|x| x.is_finite() && *x > 0.0), "{name}: {m:?}");
        }
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
            velocity = { sigma = 0.1, gate_sigmas = 6 }
            [mocap_pose]
            name = "mocap pose 1"
            timing = { rate_hz = 100 }
            position = { sigma = 0.001, gate_sigmas = 3 }
            attitude = { sigma = 0.002, gate_sigmas = 7 }
            "#,
        )
        .unwrap();
        suite.validate(200.0).unwrap();
        assert_eq!((suite.heights.len(), suite.imus.len()), (1, 0));
        assert_eq!(suite.heights[0].height.gate_sigmas, 5.0);
        let model = SensorModel::from(&suite);
        let fix = GnssSample {
            time: FlightTime(0),
            position_enu_m: Vector3::zeros(),
            velocity_enu_mps: Vector3::zeros(),
            geodetic: [0.0; 3],
            horizontal_sigma_m: 0.8,
            vertical_sigma_m: 1.5,
            satellites: 9,
        };
        assert_eq!([0, 1, 2].map(|axis| model.gnss.position(&fix, axis).gate), [5.0, 5.0, 4.0]);
        assert_eq!(model.gnss.velocity.gate, 6.0);
        assert_eq!((model.mocap_pose.position.gate, model.mocap_pose.attitude.gate), (3.0, 7.0));
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

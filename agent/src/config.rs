//! The agent's configuration: TOML, read once into valid types.
//!
//! Every key has a default; unknown keys and values out of range are errors that name the key and
//! its value. What is set here limits what any ground may ask for.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use arrayvec::ArrayString;

use plumbline_proto::ids::{FlightId, SensorId};
use serde::Deserialize;

use crate::control::policy::MarginPolicy;
use crate::control::tuning::{Design, kind_by_name};
use crate::estimate::secure::Decoder;
use crate::estimate::secure::{SLOTS_MAX, SLOTS_MIN};
use crate::flight::FlightConfig;
use crate::model::declination::{DeclinationError, day, declination_rad};
use crate::model::geodesy::Geodetic;
use crate::sensor::SensorModel;
use crate::sensor::suite::{Suite, SuiteError};
use crate::types::{ControllerKind, EstimatorKind};
use crate::{link, log};

/// Slowest and fastest flight loop, Hz.
pub const TICK_RATE_HZ: std::ops::RangeInclusive<f64> = 50.0..=1000.0;

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong type; the message shows the line.
    #[error("configuration: {0}")]
    Syntax(String),
    /// No declination for this place or day.
    #[error("configuration: site: {0}")]
    Site(#[from] DeclinationError),
    /// A data sheet among `sensors`.
    #[error("configuration: sensors: {0}")]
    Sensors(#[from] SuiteError),
    /// A value is out of its range.
    #[error("configuration: {key} = {value} is not {expected}")]
    Value {
        /// The key.
        key: String,
        /// The offending value.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
}

/// The agent's configuration, valid.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgentConfig {
    /// Name of this agent: letters, digits, `-` and `_`.
    pub id: String,
    /// `host:port` of the ground; empty for none.
    pub ground: String,
    /// Flight loop, Hz; a scenario brings its own.
    pub tick_rate_hz: Option<f64>,
    /// Airframe by name; a scenario brings its own.
    pub airframe: String,
    /// Folder of the link identity.
    pub identity: PathBuf,
    /// Ask for real-time priority.
    pub real_time: bool,
    /// Limits of setpoints.
    pub limits: Limits,
    /// Attacks.
    pub attacks: Attacks,
    /// What the failsafes rely on.
    pub failsafe: Failsafe,
    /// Estimators.
    pub estimators: Estimators,
    /// Calibration files, applied to every frame sensed and to the airframe.
    pub calibrations: Vec<PathBuf>,
    /// Weights of the gains to start with.
    pub weights: Option<Weights>,
    /// Where and when it flies, for the magnetic declination; left out, yaw counts from magnetic north.
    pub site: Option<Site>,
    /// Data sheets of the sensors, as estimators are to assume them; left out, those of the vehicle. Only what is
    /// assumed: a simulation goes on with the sensors of its scenario.
    pub sensors: Option<Suite>,
    /// The controller to start with.
    pub controller: Controller,
    /// What gains must forgive before they fly.
    pub margins: Margins,
    /// Onboard log.
    pub log: Log,
    /// Radio.
    pub link: Link,
}

/// Limits of setpoints; what is left out keeps its default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Lowest altitude setpoint, m.
    pub altitude_min_m: Option<f64>,
    /// Highest altitude setpoint, m.
    pub altitude_max_m: Option<f64>,
    /// Largest |x| and |y|, m.
    pub lateral_max_m: Option<f64>,
    /// Fastest climb, m/s.
    pub climb_max_mps: Option<f64>,
    /// Fastest descent, m/s.
    pub descent_max_mps: Option<f64>,
    /// Largest roll and pitch setpoint, rad.
    pub tilt_max_rad: Option<f64>,
    /// Highest collective throttle in stabilise mode, fraction of the weight.
    pub throttle_max: Option<f64>,
}

/// May sensors be attacked, and how far?
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Attacks {
    /// Off unless set; on in the simulator and in replays, where nothing can fall.
    pub enabled: Option<bool>,
    /// Longest duration, s.
    pub duration_max_s: Option<f64>,
    /// Largest offset of a length, m.
    pub length_max_m: Option<f64>,
    /// Largest offset of an angular rate, rad/s.
    pub rate_max_radps: Option<f64>,
    /// Largest offset of a specific force, m/s².
    pub accel_max_mps2: Option<f64>,
}

/// What the failsafes rely on.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Failsafe {
    /// Sensors on a wire of their own, as "height 3": the watchdog reads only these of their kind, and they cannot be attacked.
    pub independent: Vec<String>,
}

/// Which estimators run.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Estimators {
    /// Side by side, by name.
    pub run: Option<Vec<String>>,
    /// The one in the loop.
    pub in_loop: Option<String>,
    /// The program that the secure estimator solves: l2, l1, l2_split or l1_split.
    pub decoder: Option<String>,
    /// Slots of 40 ms in its window, 5 to 50.
    pub window: Option<usize>,
}

/// Diagonals of the LQR weights.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// x y z vx vy vz roll pitch yaw p q r, integrals of x y z yaw.
    pub state: [f64; 16],
    /// Thrust, torque x y z.
    pub input: [f64; 4],
}

/// A place and a day: the World Magnetic Model gives the declination there.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// Latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Altitude, m.
    #[serde(default)]
    pub altitude_m: f64,
    /// Day, as 2026-11-21; the declination changes by about a tenth of a degree a year.
    pub date: String,
}

impl Site {
    fn declination_rad(&self) -> Result<f64, DeclinationError> {
        let place = Geodetic::from_degrees(self.latitude_deg, self.longitude_deg, self.altitude_m);
        declination_rad(&place, day(&self.date)?)
    }
}

/// The controller to start with.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// `lqr_integral`, `lqr`, `lqg`, `hinf` or `pid`.
    pub kind: Option<String>,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, f64>,
}

/// A named margin policy, and what of it is changed.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Margins {
    /// `standard`, `careful` or `experimental`.
    pub policy: Option<String>,
    /// Least factor by which the gain of each loop may rise.
    pub gain_up_min: Option<f64>,
    /// Largest factor to which it may have to fall.
    pub gain_down_max: Option<f64>,
    /// Least phase margin, rad.
    pub phase_min_rad: Option<f64>,
    /// Least delay margin, s.
    pub delay_min_s: Option<f64>,
    /// Largest sensitivity.
    pub sensitivity_max: Option<f64>,
    /// The slowest pole, 1/s (negative).
    pub slowest_pole_per_s: Option<f64>,
    /// Largest change of a row of K while armed, of the one in use.
    pub change_max: Option<f64>,
    /// Largest share of the motors' room that a unit step may ask for.
    pub unit_step_max: Option<f64>,
}

impl Margins {
    fn policy(&self) -> Result<MarginPolicy, ConfigError> {
        let name = self.policy.as_deref().unwrap_or(MarginPolicy::STANDARD.name);
        let mut policy = MarginPolicy::by_name(name).ok_or_else(|| ConfigError::Value {
            key: "margins.policy".to_owned(),
            value: format!("{name:?}"),
            expected: "standard, careful or experimental",
        })?;
        let named = policy;
        for (into, value) in [
            (&mut policy.gain_up_min, self.gain_up_min),
            (&mut policy.gain_down_max, self.gain_down_max),
            (&mut policy.phase_min_rad, self.phase_min_rad),
            (&mut policy.delay_min_s, self.delay_min_s),
            (&mut policy.sensitivity_max, self.sensitivity_max),
            (&mut policy.slowest_pole_per_s, self.slowest_pole_per_s),
            (&mut policy.change_max, self.change_max),
            (&mut policy.unit_step_max, self.unit_step_max),
        ] {
            if let Some(value) = value {
                *into = value;
            }
        }
        if policy != named {
            policy.name = "custom";
        }
        Ok(policy)
    }
}

/// The onboard log.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Log {
    /// Its folder.
    pub folder: PathBuf,
    /// The folder stays below this, MiB.
    pub max_mib: u64,
}

/// The radio.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Link {
    /// Telemetry cap, kB/s.
    pub telemetry_kb_per_s: f64,
    /// Backfill, kB/s.
    pub backfill_kb_per_s: f64,
}

impl Default for AgentConfig {
    fn default() -> Self {
        Self {
            id: "iris-1".to_owned(),
            ground: "127.0.0.1:4748".to_owned(),
            tick_rate_hz: None,
            airframe: "iris".to_owned(),
            identity: PathBuf::from("data/agent/identity"),
            real_time: true,
            limits: Limits::default(),
            attacks: Attacks::default(),
            failsafe: Failsafe::default(),
            estimators: Estimators::default(),
            calibrations: Vec::new(),
            weights: None,
            site: None,
            sensors: None,
            controller: Controller::default(),
            margins: Margins::default(),
            log: Log::default(),
            link: Link::default(),
        }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self { folder: PathBuf::from("data/agent/log"), max_mib: log::DEFAULT_MAX_BYTES >> 20 }
    }
}

impl Default for Link {
    fn default() -> Self {
        Self {
            telemetry_kb_per_s: link::TELEMETRY_BYTES_PER_S * 1e-3,
            backfill_kb_per_s: link::BACKFILL_BYTES_PER_S * 1e-3,
        }
    }
}

/// The estimator called `name`: the lower-snake-case name of the wire, or a former one.
///
/// # Errors
/// [`ConfigError::Value`] for `key`.
pub fn estimator(key: &str, name: &str) -> Result<EstimatorKind, ConfigError> {
    EstimatorKind::named(name).ok_or_else(|| ConfigError::Value {
        key: key.to_owned(),
        value: format!("{name:?}"),
        expected: "ekf_bias, complementary, ekf_hybrid, ukf, constant_acceleration, vqf or secure",
    })
}

/// The decoder called `name`: the lower-snake-case name of the wire.
///
/// # Errors
/// [`ConfigError::Value`] for `key`.
pub fn decoder(key: &str, name: &str) -> Result<Decoder, ConfigError> {
    Decoder::from_str_name(&format!("DECODER_{}", name.to_uppercase()))
        .filter(|decoder| *decoder != Decoder::Unspecified)
        .ok_or_else(|| ConfigError::Value {
            key: key.to_owned(),
            value: format!("{name:?}"),
            expected: "l2, l1, l2_split or l1_split",
        })
}

impl AgentConfig {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Io { path: path.to_owned(), source })?;
        Self::from_toml(&text)
    }

    /// Reads and checks a text.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let config: Self =
            toml::from_str(text).map_err(|e| ConfigError::Syntax(e.to_string().trim_end().to_owned()))?;
        config.validate()?;
        Ok(config)
    }

    /// Checks every value; to be repeated after the command line has changed some.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for the first bad one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let bad = |key: &str, value: String, expected| Err(ConfigError::Value { key: key.to_owned(), value, expected });
        if FlightId::new(self.id.as_str()).is_err() {
            return bad("id", format!("{:?}", self.id), "1 to 64 letters, digits, '-' or '_'");
        }
        if !self.ground.is_empty() && self.ground.rsplit_once(':').is_none_or(|(_, port)| port.parse::<u16>().is_err())
        {
            return bad("ground", format!("{:?}", self.ground), "host:port");
        }
        let limits = &self.limits;
        let attacks = &self.attacks;
        for (key, value, min, max, expected) in [
            ("tick_rate_hz", self.tick_rate_hz, *TICK_RATE_HZ.start(), *TICK_RATE_HZ.end(), "50 to 1000 Hz"),
            ("limits.altitude_min_m", limits.altitude_min_m, -10.0, 100.0, "-10 to 100 m"),
            ("limits.altitude_max_m", limits.altitude_max_m, 0.0, 100.0, "0 to 100 m"),
            ("limits.lateral_max_m", limits.lateral_max_m, 0.0, 1000.0, "0 to 1000 m"),
            ("limits.climb_max_mps", limits.climb_max_mps, 0.01, 10.0, "0.01 to 10 m/s"),
            ("limits.descent_max_mps", limits.descent_max_mps, 0.01, 10.0, "0.01 to 10 m/s"),
            ("limits.tilt_max_rad", limits.tilt_max_rad, 0.0, 1.0, "0 to 1 rad"),
            ("limits.throttle_max", limits.throttle_max, 0.0, 4.0, "0 to 4"),
            ("margins.gain_up_min", self.margins.gain_up_min, 1.0, 100.0, "1 to 100"),
            ("margins.gain_down_max", self.margins.gain_down_max, 0.0, 1.0, "0 to 1"),
            ("margins.phase_min_rad", self.margins.phase_min_rad, 0.0, 1.5, "0 to 1.5 rad"),
            ("margins.delay_min_s", self.margins.delay_min_s, 0.0, 1.0, "0 to 1 s"),
            ("margins.sensitivity_max", self.margins.sensitivity_max, 1.0, 100.0, "1 to 100"),
            ("margins.slowest_pole_per_s", self.margins.slowest_pole_per_s, -100.0, 0.0, "-100 to 0 1/s"),
            ("margins.change_max", self.margins.change_max, 0.0, 1e6, "0 to 1e6"),
            ("margins.unit_step_max", self.margins.unit_step_max, 0.0, 1e6, "0 to 1e6"),
            ("attacks.duration_max_s", attacks.duration_max_s, 0.001, 3600.0, "0.001 to 3600 s"),
            ("attacks.length_max_m", attacks.length_max_m, 0.0, 100.0, "0 to 100 m"),
            ("attacks.rate_max_radps", attacks.rate_max_radps, 0.0, 100.0, "0 to 100 rad/s"),
            ("attacks.accel_max_mps2", attacks.accel_max_mps2, 0.0, 200.0, "0 to 200 m/s²"),
            ("log.max_mib", Some(self.log.max_mib as f64), 16.0, 16e6, "16 to 16000000 MiB"),
            ("link.telemetry_kb_per_s", Some(self.link.telemetry_kb_per_s), 10.0, 1e5, "10 to 100000 kB/s"),
            ("link.backfill_kb_per_s", Some(self.link.backfill_kb_per_s), 1.0, 1e5, "1 to 100000 kB/s"),
        ] {
            // A NaN fails both comparisons.
            if let Some(value) = value
                && !(value >= min && value <= max)
            {
                return bad(key, value.to_string(), expected);
            }
        }
        if let (Some(min), Some(max)) = (limits.altitude_min_m, limits.altitude_max_m)
            && min >= max
        {
            return bad("limits.altitude_min_m", min.to_string(), "below limits.altitude_max_m");
        }
        if let Some(site) = &self.site {
            site.declination_rad()?;
        }
        self.margins.policy()?;
        self.controller.kind.as_deref().map_or(Ok(()), |kind| controller(kind).map(|_| ()))?;
        for name in self.estimators.run.iter().flatten() {
            estimator("estimators.run", name)?;
        }
        if let Some(name) = &self.estimators.in_loop {
            estimator("estimators.in_loop", name)?;
        }
        if let Some(name) = &self.estimators.decoder {
            decoder("estimators.decoder", name)?;
        }
        if let Some(slots) = self.estimators.window.filter(|slots| !(SLOTS_MIN..=SLOTS_MAX).contains(slots)) {
            return bad("estimators.window", slots.to_string(), "5 to 50 slots");
        }
        if let Some(sensors) = &self.sensors {
            sensors.validate(*TICK_RATE_HZ.end())?;
        }
        Ok(())
    }

    /// Puts what is configured into a flight's configuration.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for an estimator that is not known.
    pub fn apply(&self, flight: &mut FlightConfig) -> Result<(), ConfigError> {
        fn put<T: Copy>(into: &mut T, value: Option<T>) {
            if let Some(value) = value {
                *into = value;
            }
        }
        put(&mut flight.tick_rate_hz, self.tick_rate_hz);
        put(&mut flight.limits.altitude_min_m, self.limits.altitude_min_m);
        put(&mut flight.limits.altitude_max_m, self.limits.altitude_max_m);
        put(&mut flight.limits.lateral_max_m, self.limits.lateral_max_m);
        put(&mut flight.limits.climb_max_mps, self.limits.climb_max_mps);
        put(&mut flight.limits.descent_max_mps, self.limits.descent_max_mps);
        put(&mut flight.limits.tilt_max_rad, self.limits.tilt_max_rad);
        put(&mut flight.limits.throttle_max, self.limits.throttle_max);
        put(&mut flight.attacks_enabled, self.attacks.enabled);
        flight.independent = self.failsafe.independent(&flight.sensors)?;
        put(&mut flight.attack_bounds.duration_max_s, self.attacks.duration_max_s);
        put(&mut flight.attack_bounds.length_max_m, self.attacks.length_max_m);
        put(&mut flight.attack_bounds.rate_max_radps, self.attacks.rate_max_radps);
        put(&mut flight.attack_bounds.accel_max_mps2, self.attacks.accel_max_mps2);
        if let Some(names) = &self.estimators.run {
            flight.estimators = names.iter().map(|name| estimator("estimators.run", name)).collect::<Result<_, _>>()?;
        }
        if let Some(name) = &self.estimators.in_loop {
            flight.in_loop = estimator("estimators.in_loop", name)?;
            if !flight.estimators.contains(&flight.in_loop) {
                flight.estimators.insert(0, flight.in_loop);
            }
        }
        if let Some(name) = &self.estimators.decoder {
            flight.decoder = Some(decoder("estimators.decoder", name)?);
        }
        put(&mut flight.window_slots, self.estimators.window);
        if let Some(sensors) = &self.sensors {
            let declination_rad = flight.sensor_model.imus.mag.declination_rad;
            flight.sensor_model = SensorModel::from(sensors);
            flight.sensor_model.imus.mag.declination_rad = declination_rad;
        }
        if let Some(site) = &self.site {
            flight.sensor_model.imus.mag.declination_rad = site.declination_rad()?;
        }
        flight.margins = self.margins.policy()?;
        if let Some(kind) = &self.controller.kind {
            flight.design = Design::new(controller(kind)?, &flight.airframe);
        }
        for (name, value) in &self.controller.parameters {
            let bad = || ConfigError::Value {
                key: format!("controller.parameters.{name}"),
                value: value.to_string(),
                expected: "a parameter of this controller",
            };
            let short = ArrayString::from(name).map_err(|_| bad())?;
            flight.design.set(&short, *value).map_err(|_| bad())?;
        }
        if let Some(weights) = &self.weights {
            flight.design.weights.state = weights.state;
            flight.design.weights.input = weights.input;
        }
        Ok(())
    }
}

impl Failsafe {
    /// The independent ones of these `sensors`.
    fn independent(&self, sensors: &[SensorId]) -> Result<Vec<SensorId>, ConfigError> {
        let read = |name: &String| {
            let sensor = name.parse::<SensorId>().ok().filter(|sensor| sensors.contains(sensor));
            sensor.ok_or_else(|| ConfigError::Value {
                key: "failsafe.independent".to_owned(),
                value: format!("{name:?}"),
                expected: "a sensor of this vehicle, as \"height 3\"",
            })
        };
        self.independent.iter().map(read).collect()
    }
}

fn controller(name: &str) -> Result<ControllerKind, ConfigError> {
    kind_by_name(name).ok_or_else(|| ConfigError::Value {
        key: "controller.kind".to_owned(),
        value: format!("{name:?}"),
        expected: "lqr_integral, lqr, lqg, hinf or pid",
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::RigKind;
    use crate::model::airframe::Airframe;
    use crate::sensor::Accuracy;
    use plumbline_proto::v1::SensorKind;

    #[test]
    fn what_is_set_reaches_the_flight_and_the_rest_keeps_its_default() {
        let config = AgentConfig::from_toml(
            "id = \"clinic-2\"\ntick_rate_hz = 400\n[limits]\naltitude_max_m = 1.5\n[attacks]\nenabled = true\n\
 [failsafe]\nindependent = [\"imu 4\"]\n\
             [estimators]\nrun = [\"primary\", \"ekf_bias\"]\nin_loop = \"ekf_bias\"\n[log]\nmax_mib = 100\n\
             [site]\nlatitude_deg = 4.6\nlongitude_deg = -74.1\naltitude_m = 2600\ndate = \"2026-11-21\"\n\
             [[sensors.heights]]\nname = \"h\"\ntiming = { rate_hz = 10 }\nposition_flu_m = [0, 0, 0]\n\
             height = { sigma = 0.2, gate_sigmas = 3 }\n",
        )
        .unwrap();
        let mut flight = FlightConfig::new(Airframe::iris(), RigKind::Free, &Suite::string_rig());
        let before = flight.limits;
        config.apply(&mut flight).unwrap();
        assert_eq!(flight.independent, [SensorId::new(SensorKind::Imu, 4)]);
        let none = AgentConfig::from_toml("[failsafe]\nindependent = [\"imu 9\"]").unwrap();
        let refused = none.apply(&mut flight.clone()).unwrap_err().to_string();
        assert!(refused.contains("failsafe.independent = \"imu 9\" is not a sensor of this vehicle"), "{refused}");
        assert_eq!((flight.tick_rate_hz, flight.limits.altitude_max_m), (400.0, 1.5));
        assert_eq!(flight.limits.lateral_max_m, before.lateral_max_m);
        assert!(flight.attacks_enabled);
        assert_eq!(flight.sensor_model.heights, Accuracy { sigma: 0.2, gate: 3.0 });
        // Bogotá: about 8° west.
        assert!(
            (flight.sensor_model.imus.mag.declination_rad.to_degrees() + 7.9).abs() < 1.0,
            "{}",
            flight.sensor_model.imus.mag.declination_rad
        );
        assert_eq!(flight.estimators, [EstimatorKind::Complementary, EstimatorKind::EkfBias]);
        assert_eq!((config.id.as_str(), config.log.max_mib), ("clinic-2", 100));
        assert_eq!(AgentConfig::from_toml("").unwrap(), AgentConfig::default());
    }

    #[test]
    fn errors_name_key_and_value() {
        for (text, expected) in [
            ("flavour = 3", "flavour"),
            ("tick_rate_hz = 20", "tick_rate_hz = 20 is not 50 to 1000 Hz"),
            ("tick_rate_hz = nan", "tick_rate_hz = NaN"),
            ("id = \"../x\"", "../x"),
            ("ground = \"nowhere\"", "ground = \"nowhere\" is not host:port"),
            ("[limits]\naltitude_max_m = -1", "limits.altitude_max_m = -1"),
            ("[limits]\naltitude_min_m = 2\naltitude_max_m = 1", "limits.altitude_min_m = 2"),
            ("[estimators]\nin_loop = \"oracle\"", "estimators.in_loop = \"oracle\""),
            ("[estimators]\ndecoder = \"l3\"", "estimators.decoder = \"l3\""),
            ("[estimators]\nwindow = 51", "estimators.window = 51 is not 5 to 50 slots"),
            ("[weights]\nstate = [1]\ninput = [1, 1, 1, 1]", "state"),
            ("[site]\nlatitude_deg = 95\nlongitude_deg = 0\ndate = \"2026-11-21\"", "latitude 95"),
            ("[site]\nlatitude_deg = 5\nlongitude_deg = 0\ndate = \"now\"", "site: \"now\" is not a day"),
            (
                "[[sensors.heights]]\nname = \"h\"\ntiming = { rate_hz = 10 }\nposition_flu_m = [0, 0, 0]\nheight = { sigma = -1 }",
                "sensors: suite: heights[0].height.sigma = -1",
            ),
            ("[controller]\nkind = \"magic\"", "controller.kind = \"magic\""),
            ("[margins]\npolicy = \"none\"", "margins.policy = \"none\""),
            ("[margins]\nphase_min_rad = 2", "margins.phase_min_rad = 2"),
            ("[log]\nmax_mib = 1", "log.max_mib = 1"),
        ] {
            let message = AgentConfig::from_toml(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text}\ngives: {message}");
        }
    }
}

//! The agent's configuration: TOML, read once into valid types.
//!
//! Every key has a default; unknown keys and values out of range are errors that name the key and
//! its value. What is set here limits what any ground may ask for.

mod hardware;
mod recorded;
mod sections;

use std::path::{Path, PathBuf};

use arrayvec::ArrayString;
use plumbline_devices::spec::{DeviceSpec, MotorsSpec, SpecError};
use plumbline_proto::ids::FlightId;
use serde::Deserialize;

use crate::control::tuning::{Design, kind_by_name};
use crate::estimate::lanes::linear::Shaken;
use crate::estimate::secure::{Decoder, SLOTS_MAX, SLOTS_MIN};
use crate::flight::{EnvelopeDemand, FlightConfig, watermark};
use crate::model::declination::DeclinationError;
use crate::sensor::SensorModel;
use crate::sensor::suite::{Suite, SuiteError};
use crate::sim::rig::Rig;
use crate::types::{ControllerKind, EstimatorKind, TICK_RATE_HZ};

pub use recorded::{RecordedError, RecordedFlight};
pub use sections::{
    Attacks, Controller, Envelope, Estimators, Failsafe, Limits, Link, Log, Margins, Site, Watermark, Weights,
};

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
    /// A `[[device]]`, or `[motors]`.
    #[error("configuration: {table}: {source}; line {line}: {text}")]
    Hardware {
        /// Which table.
        table: String,
        /// What is wrong.
        source: Box<SpecError>,
        /// Its line, from 1.
        line: usize,
        /// That line.
        text: String,
    },
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

/// The agent's configuration, valid: one field for each key or table of its file, hence so many.
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
    /// Folder of the calibrations that an operator put to use from the page; of a vehicle that is really there.
    pub kept_calibrations: PathBuf,
    /// Ask for real-time priority.
    pub real_time: bool,
    /// Limits of setpoints.
    pub limits: Limits,
    /// Attacks.
    pub attacks: Attacks,
    /// What the failsafes rely on.
    pub failsafe: Failsafe,
    /// What must be proved of the attack envelope to arm.
    pub envelope: Option<Envelope>,
    /// Noise on the thrust that tells what is replayed; none where it is left out.
    pub watermark: Option<Watermark>,
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
    /// What holds the vehicle that is really there; hanging strings when left out.
    pub rig: Option<Rig>,
    /// Devices of the vehicle that is really there.
    pub device: Vec<DeviceSpec>,
    /// Its motors.
    pub motors: Option<MotorsSpec>,
    /// Onboard log.
    pub log: Log,
    /// Radio.
    pub link: Link,
}

impl Default for AgentConfig {
    fn default() -> Self {
        Self {
            id: "iris-1".to_owned(),
            ground: "127.0.0.1:4748".to_owned(),
            tick_rate_hz: None,
            airframe: "iris".to_owned(),
            identity: PathBuf::from("data/agent/identity"),
            kept_calibrations: PathBuf::from("data/agent/calibrations"),
            real_time: true,
            limits: Limits::default(),
            attacks: Attacks::default(),
            failsafe: Failsafe::default(),
            envelope: None,
            watermark: None,
            estimators: Estimators::default(),
            calibrations: Vec::new(),
            weights: None,
            site: None,
            sensors: None,
            controller: Controller::default(),
            margins: Margins::default(),
            rig: None,
            device: Vec::new(),
            motors: None,
            log: Log::default(),
            link: Link::default(),
        }
    }
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
        hardware::check(&config, text)?;
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
            ("attacks.thrust_max", attacks.thrust_max, 0.0, 1.0, "0 to 1"),
            ("envelope.altitude_max_m", self.envelope.map(|e| e.altitude_max_m), 0.0, 10.0, "0 to 10 m"),
            ("envelope.sensors", self.envelope.map(|e| e.sensors as f64), 1.0, 3.0, "1 to 3"),
            ("envelope.noise_mps2", self.envelope.map(|e| e.noise_mps2), 0.0, 5.0, "0 to 5 m/s²"),
            ("envelope.rectified_mps2", self.envelope.map(|e| e.rectified_mps2), 0.0, 5.0, "0 to 5 m/s²"),
            ("watermark.rms_mps2", self.watermark.map(|w| w.rms_mps2), 0.001, 0.5, "0.001 to 0.5 m/s²"),
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
        put(&mut flight.attacks.enabled, self.attacks.enabled);
        flight.independent = self.failsafe.independent(&flight.sensors)?;
        flight.envelope = self.envelope.map(|of| {
            let Envelope { altitude_max_m, sensors, noise_mps2, rectified_mps2 } = of;
            EnvelopeDemand { altitude_max_m, sensors, shaken: Shaken { noise_mps2, rectified_mps2 } }
        });
        put(&mut flight.attacks.bounds.duration_max_s, self.attacks.duration_max_s);
        put(&mut flight.attacks.bounds.length_max_m, self.attacks.length_max_m);
        put(&mut flight.attacks.bounds.rate_max_radps, self.attacks.rate_max_radps);
        put(&mut flight.attacks.bounds.accel_max_mps2, self.attacks.accel_max_mps2);
        put(&mut flight.attacks.bounds.thrust_max, self.attacks.thrust_max);
        flight.watermark = self.watermark.map(|Watermark { rms_mps2, seed }| watermark::Settings { rms_mps2, seed });
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

/// The estimator called `name`: the lower-snake-case name of the wire, or a former one.
///
/// # Errors
/// [`ConfigError::Value`] for `key`.
pub fn estimator(key: &str, name: &str) -> Result<EstimatorKind, ConfigError> {
    EstimatorKind::named(name).ok_or_else(|| ConfigError::Value {
        key: key.to_owned(),
        value: format!("{name:?}"),
        expected: EstimatorKind::NAMES,
    })
}

/// The decoder called `name`: the lower-snake-case name of the wire.
///
/// # Errors
/// [`ConfigError::Value`] for `key`.
pub fn decoder(key: &str, name: &str) -> Result<Decoder, ConfigError> {
    Decoder::named(name).ok_or_else(|| ConfigError::Value {
        key: key.to_owned(),
        value: format!("{name:?}"),
        expected: "l2, l1, l2_split or l1_split",
    })
}

fn controller(name: &str) -> Result<ControllerKind, ConfigError> {
    kind_by_name(name).ok_or_else(|| ConfigError::Value {
        key: "controller.kind".to_owned(),
        value: format!("{name:?}"),
        expected: "lqr_integral, lqr, lqg, hinf or pid",
    })
}

#[cfg(test)]
mod tests;

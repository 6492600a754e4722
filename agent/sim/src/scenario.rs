//! A scenario file: the single source of truth of a simulated flight.
//!
//! TOML, read once into valid types. Unknown keys are errors; every error names the key and its value.
//! Everything but `name` has a default. Times in `[[script]]`, `[[push]]`, `[[outage]]`, `[[broken]]` and `[[attack]]` are
//! seconds since boot. `reading.rs` turns the file's words into the agent's types.

use nalgebra::Vector3;
use serde::Deserialize;

use super::conditions::{Conditions, TICK_RATE_MIN_HZ};
use super::devices::Outage;
use super::reading::{RawScenario, read};
use super::rig::{HangingStrings, Rig, RigError};
use super::script::Script;
use super::site::Site;
use super::world::{Beginning, Disturbance};
use plumbline_core::attack::{Bounds, Schedule};
use plumbline_core::flight::FlightConfig;
use plumbline_core::model::airframe::{Airframe, AirframeError};
use plumbline_core::sensor::suite::{Suite, SuiteError};
use plumbline_core::types::{ROTORS, TICK_RATE_HZ};
use plumbline_proto::v1::SensorKind;

/// Text of the default scenario: altitude steps on the string rig.
pub const ALTITUDE_STEP_TOML: &str = include_str!("../../../tests/scenarios/altitude_step.toml");

/// Why a scenario cannot be flown.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScenarioError {
    /// Not TOML, an unknown key, or a value of the wrong type; the message shows the line.
    #[error("scenario: {0}")]
    Syntax(String),
    /// A value is out of its range.
    #[error("scenario: {key} = {value} is not {expected}")]
    Value {
        /// The key.
        key: String,
        /// The offending value.
        value: String,
        /// What it should be.
        expected: String,
    },
    /// The airframe.
    #[error("scenario: {0}")]
    Airframe(#[from] AirframeError),
    /// The suite.
    #[error("scenario: {0}")]
    Suite(#[from] SuiteError),
    /// The rig.
    #[error("scenario: {0}")]
    Rig(#[from] RigError),
}

/// Reads an attack schedule: `[[attack]]` tables as in a scenario and nothing else. Bounds and sensors are
/// checked when it is uploaded.
///
/// # Errors
/// [`ScenarioError`], naming the key and its value.
pub fn attacks_from_toml(text: &str) -> Result<Schedule, ScenarioError> {
    super::reading::attacks_alone(text)
}

/// Departure from the rig's resting state.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Initial {
    /// Added to the resting position, ENU, m.
    pub offset_enu_m: Vector3<f64>,
    /// Velocity, ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Roll, pitch, yaw, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Body rates, FLU, rad/s.
    pub body_rates_radps: Vector3<f64>,
}

/// A simulated flight, valid: one field for each key or table of its file, hence so many.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Short name.
    pub name: String,
    /// For people.
    pub description: String,
    /// The file as it was written, for the recording.
    pub text: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Length of a scripted flight, s. An interactive one goes on until it is stopped.
    pub duration_s: f64,
    /// Flight loop, Hz.
    pub tick_rate_hz: f64,
    /// The vehicle.
    pub airframe: Airframe,
    /// What holds it.
    pub rig: Rig,
    /// Its sensors.
    pub suite: Suite,
    /// Where it is.
    pub site: Site,
    /// How rough the world is.
    pub disturbance: Disturbance,
    /// The named world it flies in; `None` on the bench, where sensors and airframe are what they are said to be.
    pub conditions: Option<Conditions>,
    /// Are the simulated sensors all but exact, whatever `suite` says of them? The agent goes by the suite.
    pub ideal: bool,
    /// Battery charge at the start, 0..1; `None` holds the nominal voltage for ever.
    pub battery_charge: Option<f64>,
    /// How it starts.
    pub initial: Initial,
    /// What happens by itself in a scripted flight; its first step uploads `attacks`, if there are any.
    /// Pushes happen in every flight.
    pub script: Script,
    /// Attacks, with onsets counted from boot.
    pub attacks: Schedule,
    /// Sensors falling silent.
    pub outages: Vec<Outage>,
    /// Propellers that break; nobody but the vehicle feels it.
    pub broken: Vec<BrokenRotor>,
}

/// A propeller that breaks, for good.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrokenRotor {
    /// Which, from 1, in the order of the motor commands.
    pub rotor: usize,
    /// When, s.
    pub at_s: f64,
    /// The part that is left of its thrust and drag torque, 0 to 1.
    #[serde(default)]
    pub left: f64,
}

impl Scenario {
    /// Reads and validates a scenario.
    ///
    /// # Errors
    /// [`ScenarioError`], naming the key and its value.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        let raw: RawScenario =
            toml::from_str(text).map_err(|e| ScenarioError::Syntax(e.to_string().trim_end().to_owned()))?;
        let scenario = read(raw, text)?;
        scenario.validate()?;
        Ok(scenario)
    }

    /// Altitude steps on the string rig: what `cargo xtask run` flies.
    pub fn default_string_rig() -> Self {
        // The embedded file is read by a test of its own; were it broken, a bare string rig is flown.
        Self::from_toml(ALTITUDE_STEP_TOML).unwrap_or_else(|_| Self::bare())
    }

    /// How a flight of it is configured: its airframe, rig, rate and sensors; attacks enabled.
    pub fn flight_config(&self) -> FlightConfig {
        let mut config = FlightConfig {
            tick_rate_hz: self.tick_rate_hz,
            ..FlightConfig::new(self.airframe.clone(), self.rig.kind(&self.airframe), &self.suite)
        };
        config.attacks.enabled = true;
        // Known of a place, as a map would say it.
        config.sensor_model.imus.mag.declination_rad = self.site.declination_rad();
        config
    }

    /// An undisturbed-by-script Iris with the default suite on the default string rig.
    pub fn bare() -> Self {
        Self {
            name: "bare".into(),
            description: String::new(),
            text: "name = \"bare\"\n".into(),
            seed: 1,
            duration_s: 30.0,
            tick_rate_hz: 200.0,
            airframe: Airframe::iris(),
            rig: Rig::HangingStrings(HangingStrings::default()),
            suite: Suite::string_rig(),
            site: Site::default(),
            disturbance: Disturbance::default(),
            conditions: None,
            ideal: false,
            battery_charge: Some(0.95),
            initial: Initial::default(),
            script: Script::default(),
            attacks: Schedule::default(),
            outages: Vec::new(),
            broken: Vec::new(),
        }
    }

    /// Part of its thrust that is left of each rotor at flight time `t_s`.
    pub fn rotors_left(&self, t_s: f64) -> [f64; ROTORS] {
        std::array::from_fn(|i| {
            let of = self.broken.iter().filter(|broken| broken.rotor == i + 1 && t_s >= broken.at_s);
            of.map(|broken| broken.left).fold(1.0, f64::min)
        })
    }

    /// The world this scenario begins with.
    pub fn beginning(&self) -> Beginning {
        Beginning {
            airframe: self.airframe.clone(),
            rig: self.rig,
            disturbance: self.disturbance,
            conditions: self.conditions.clone(),
            battery_charge: self.battery_charge,
            offset_enu_m: self.initial.offset_enu_m,
            velocity_enu_mps: self.initial.velocity_enu_mps,
            roll_pitch_yaw_rad: self.initial.roll_pitch_yaw_rad,
            body_rates_radps: self.initial.body_rates_radps,
            seed: self.seed,
        }
    }

    /// Time between ticks, s.
    pub fn tick_s(&self) -> f64 {
        1.0 / self.tick_rate_hz
    }

    /// Checks every value; the first bad one is named. Done by [`Scenario::from_toml`]; to be repeated
    /// after a change made in code.
    ///
    /// # Errors
    /// [`ScenarioError`].
    pub fn validate(&self) -> Result<(), ScenarioError> {
        let bad = |key: String, value: String, expected: &str| {
            Err(ScenarioError::Value { key, value, expected: expected.to_owned() })
        };
        let named = |text: &str| {
            !text.is_empty()
                && text.len() <= 64
                && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
        };
        if !named(&self.name) {
            return bad("name".into(), format!("{:?}", self.name), "1 to 64 letters, digits, '_' or '-'");
        }
        for (key, value, min, max, expected) in [
            ("tick_rate_hz", self.tick_rate_hz, *TICK_RATE_HZ.start(), *TICK_RATE_HZ.end(), "50 to 1000 Hz"),
            ("duration_s", self.duration_s, 0.1, 86_400.0, "0.1 s to a day"),
            ("disturbance.accel_noise", self.disturbance.accel_noise, 0.0, 10.0, "0 to 10"),
            ("disturbance.angular_noise", self.disturbance.angular_noise, 0.0, 100.0, "0 to 100"),
            ("disturbance.wind_sigma_mps", self.disturbance.wind_sigma_mps, 0.0, 30.0, "0 to 30 m/s"),
            ("disturbance.wind_time_constant_s", self.disturbance.wind_time_constant_s, 0.01, 1000.0, "0.01 to 1000 s"),
            ("disturbance.motor_spread", self.disturbance.motor_spread, 0.0, 0.2, "0 to 0.2"),
            ("battery.charge", self.battery_charge.unwrap_or(1.0), 0.0, 1.0, "0 to 1"),
        ] {
            // A NaN fails both comparisons.
            if !(value >= min && value <= max) {
                return bad(key.into(), value.to_string(), expected);
            }
        }
        if self.conditions.is_some() && self.tick_rate_hz < TICK_RATE_MIN_HZ {
            return bad("tick_rate_hz".into(), self.tick_rate_hz.to_string(), "150 Hz or more, which its world needs");
        }
        if let Some((key, value, expected)) = self.site.fault() {
            return bad(key.into(), value.to_string(), expected);
        }
        self.airframe.validate()?;
        self.rig.validate(&self.airframe)?;
        self.suite.validate(self.tick_rate_hz)?;
        for (key, v, limit) in [
            ("initial.offset_enu_m", self.initial.offset_enu_m, 1000.0),
            ("initial.velocity_enu_mps", self.initial.velocity_enu_mps, 100.0),
            ("initial.roll_pitch_yaw_rad", self.initial.roll_pitch_yaw_rad, 3.2),
            ("initial.body_rates_radps", self.initial.body_rates_radps, 50.0),
        ] {
            if !v.iter().all(|x| x.is_finite() && x.abs() <= limit) {
                let value = format!("[{}, {}, {}]", v.x, v.y, v.z);
                return bad(key.into(), value, &format!("three numbers within ±{limit}"));
            }
        }
        for outage in &self.outages {
            if !self.suite.contains(outage.sensor) {
                return bad("outage.sensor".into(), outage.sensor.to_string(), "a sensor of the suite");
            }
        }
        for broken in &self.broken {
            if !(1..=ROTORS).contains(&broken.rotor) {
                return bad("broken.rotor".into(), broken.rotor.to_string(), "1 to 4");
            }
            for (key, value, most) in [("broken.at_s", broken.at_s, 86_400.0), ("broken.left", broken.left, 1.0)] {
                if !(value >= 0.0 && value <= most) {
                    return bad(key.into(), value.to_string(), &format!("0 to {most}"));
                }
            }
        }
        self.validate_attacks()
    }

    /// The injector's own check, with its own bounds, before the flight instead of in it.
    fn validate_attacks(&self) -> Result<(), ScenarioError> {
        let sensors: Vec<_> = self.suite.descriptions().iter().map(|d| d.id).collect();
        let mut injector = plumbline_core::attack::Injector::new(Bounds::default(), true, &sensors);
        let refused = |expected: String| ScenarioError::Value {
            key: "attack".into(),
            value: format!("{} attacks", self.attacks.attacks.len()),
            expected,
        };
        for attack in &self.attacks.attacks {
            if attack.sensor.kind != SensorKind::Rotor && !self.suite.contains(attack.sensor) {
                return Err(ScenarioError::Value {
                    key: "attack.sensor".into(),
                    value: attack.sensor.to_string(),
                    expected: "a sensor of the suite".into(),
                });
            }
        }
        injector
            .upload(&self.attacks, plumbline_proto::time::FlightTime::default())
            .map_err(|e| refused(format!("acceptable: {e}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::{ids::SensorId, v1::SensorKind};

    fn error(text: &str) -> String {
        Scenario::from_toml(text).unwrap_err().to_string()
    }

    #[test]
    fn the_embedded_default_is_the_string_rig_of_the_design() {
        let scenario = Scenario::from_toml(ALTITUDE_STEP_TOML).unwrap();
        assert_eq!(scenario, Scenario::default_string_rig());
        assert_eq!(scenario.text, ALTITUDE_STEP_TOML);
        assert_eq!(scenario.airframe, Airframe::iris());
        assert_eq!(scenario.rig.name(), "hanging_strings");
        let suite = &scenario.suite;
        assert_eq!((suite.imus.len(), suite.heights.len(), suite.barometers.len()), (4, 3, 1));
        assert_eq!(scenario.tick_rate_hz, 200.0);
        Scenario::bare().validate().unwrap();
    }

    #[test]
    fn every_scenario_of_the_repository_is_valid() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenarios");
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "toml") {
                let text = std::fs::read_to_string(&path).unwrap();
                let scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
                assert_eq!(path.file_stem().unwrap().to_str().unwrap(), scenario.name);
                names.push(scenario.name);
            }
        }
        for name in [
            "hover",
            "circle",
            "sine",
            "square",
            "altitude_step",
            "string_yaw",
            "single_axis_roll",
            "takeoff",
            "height_attack",
        ] {
            assert!(names.iter().any(|n| n == name), "{name} is missing from {names:?}");
        }
    }

    #[test]
    fn errors_name_key_and_value() {
        for (text, expected) in [
            ("name = \"a\"\ntick_rate_hz = 20", "tick_rate_hz = 20"),
            ("name = \"a\"\nduration_s = nan", "duration_s = NaN"),
            ("name = \"a b\"", "a b"),
            ("name = \"a\"\nairframe = \"concorde\"", "concorde"),
            ("name = \"a\"\nflavour = 3", "flavour = 3"),
            ("name = \"a\"\nseed = \"x\"", "seed = \"x\""),
            ("name = \"a\"\n[rig.hanging_strings]\nstrings = 3", "strings = 3"),
            ("name = \"a\"\n[rig.trapeze]", "trapeze"),
            ("name = \"a\"\n[rig.free]\nheight_m = -1", "free.height_m = -1"),
            ("name = \"a\"\n[suite]\npreset = \"lots\"", "lots"),
            ("name = \"a\"\n[[sensor]]\nkind = \"height\"\ninstance = 9", "height 9"),
            ("name = \"a\"\n[[sensor]]\nkind = \"height\"\nrate_hz = 900", "timing.rate_hz = 900"),
            ("name = \"a\"\n[[outage]]\nsensor = \"gnss\"\nstart_s = 1\nduration_s = 1", "gnss 1"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"dance\"", "dance"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"arm\"\naltitude_m = 2", "altitude_m = 2"),
            ("name = \"a\"\n[[script]]\nat_s = -1\ndo = \"arm\"", "at_s = -1"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"mode\"\nmode = \"loop\"", "loop"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"setpoint\"\naltitude_m = inf", "altitude_m = inf"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"circle\"\nduration_s = 1", "radius_m"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"setpoint\"\nflavour = 3", "script.flavour = 3"),
            ("name = \"a\"\n[[script]]\nat_s = 1\ndo = \"setpoint\"\nx_m = \"far\"", "script.x_m = \"far\""),
            ("name = \"a\"\n[[push]]\nat_s = 1\nduration_s = 0\ntorque_flu_nm = [1, 0, 0]", "duration_s = 0"),
            ("name = \"a\"\n[site]\nlatitude_deg = 100", "latitude_deg = 100"),
            ("name = \"a\"\n[battery]\ncharge = 2", "battery.charge = 2"),
            ("name = \"a\"\n[battery]\ncapacity_ah = 0", "battery.capacity_ah"),
            ("name = \"a\"\n[initial]\nroll_pitch_yaw_rad = [9, 0, 0]", "[9, 0, 0]"),
        ] {
            let message = error(text);
            assert!(message.contains(expected), "{text}\ngives: {message}");
        }
        let attack = |fields: &str| {
            error(&format!("name = \"a\"\n[[attack]]\nsensor = \"height\"\nstart_s = 1\nduration_s = 1\n{fields}"))
        };
        assert!(attack("kind = \"tickle\"").contains("tickle"));
        assert!(attack("kind = \"bias\"\nmagnitude = 99").contains("99"));
        assert!(attack("kind = \"bias\"\ninstance = 7").contains("height 7"));
        assert!(attack("kind = \"bias\"\nchannel = \"smell\"").contains("smell"));
    }

    #[test]
    fn words_become_types() {
        let scenario = Scenario::from_toml(
            r#"
            name = "words"
            [suite]
            preset = "clinic"
            add = ["gnss", "mocap_pose", "camera_ranges", "barometer"]
            [[sensor]]
            kind = "height"
            instance = 2
            dropout = 0.25
            noise_scale = 2.0
            [[sensor]]
            kind = "imu"
            bias_scale = 0.0
            [[attack]]
            sensor = "height"
            instance = 2
            kind = "bias"
            start_s = 5
            duration_s = 10
            magnitude = 0.5
            [[script]]
            at_s = 1
            do = "arm"
            "#,
        )
        .unwrap();
        let suite = &scenario.suite;
        assert!(suite.gnss.is_some() && suite.mocap_pose.is_some() && suite.camera_ranges.is_some());
        assert_eq!((suite.heights.len(), suite.barometers.len()), (2, 1));
        assert_eq!([0, 1].map(|i| suite.heights[i].timing.dropout), [0.0, 0.25]);
        assert_eq!(suite.heights[1].height.sigma, 2.0 * suite.heights[0].height.sigma);
        assert!(suite.imus.iter().all(|i| i.gyro.bias_sigma == 0.0 && i.accel.bias_walk == 0.0));
        let attack = &scenario.attacks.attacks[0];
        assert_eq!(attack.sensor, SensorId::new(SensorKind::Height, 2));
        assert_eq!(attack.magnitude, 0.5);
        // The upload is the first step.
        assert!(matches!(scenario.script.steps[0].command, plumbline_core::command::Command::Attack(_)));
        assert_eq!(scenario.script.steps.len(), 2);
    }
}

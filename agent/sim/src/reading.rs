//! The words of a scenario file, and what they mean. Only [`super::scenario`] uses it.

mod steps;

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::{ids::SensorId, v1::SensorKind};
use serde::Deserialize;

use super::conditions::{Conditions, IDEAL};
use super::devices::Outage;
use super::rig::{Axis, HangingStrings, Rig};
use super::scenario::{BrokenRotor, Initial, Scenario, ScenarioError};
use super::script::{PushEvent, Script, Step};
use super::site::Site;
use super::world::{Disturbance, Push};
use plumbline_core::attack::{Attack, Channel, Kind, MAX_ATTACKS, Schedule};
use plumbline_core::command::Command;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::sensor::imu::Distortion;
use plumbline_core::sensor::suite::{PRESETS, Suite};

use steps::{RawStep, read_step};

/// A scenario as written: one field for each key or table of the file, hence so many.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawScenario {
    name: String,
    #[serde(default)]
    description: String,
    #[serde(default = "one_u64")]
    seed: u64,
    #[serde(default = "half_a_minute")]
    duration_s: f64,
    #[serde(default = "two_hundred")]
    tick_rate_hz: f64,
    /// A name, or a whole airframe.
    airframe: Option<toml::Value>,
    rig: Option<Rig>,
    #[serde(default)]
    suite: RawSuite,
    #[serde(default)]
    sensor: Vec<RawSensor>,
    #[serde(default)]
    site: Site,
    /// `bench`, [`IDEAL`], or one of the worlds of [`Conditions`].
    world: Option<String>,
    disturbance: Option<Disturbance>,
    #[serde(default)]
    battery: RawBattery,
    #[serde(default)]
    initial: Initial,
    #[serde(default)]
    script: Vec<RawStep>,
    #[serde(default)]
    push: Vec<RawPush>,
    #[serde(default)]
    outage: Vec<RawOutage>,
    #[serde(default)]
    broken: Vec<BrokenRotor>,
    #[serde(default)]
    attack: Vec<RawAttack>,
}

fn one_u64() -> u64 {
    1
}

fn half_a_minute() -> f64 {
    30.0
}

fn two_hundred() -> f64 {
    200.0
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSuite {
    /// One of [`PRESETS`].
    preset: Option<String>,
    /// Sensors added to the preset: gnss, mocap_pose, camera_ranges, barometer.
    #[serde(default)]
    add: Vec<String>,
    /// A whole suite, instead of a preset.
    custom: Option<Suite>,
}

/// A change to one sensor, or to all of a kind.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSensor {
    kind: String,
    instance: Option<u8>,
    rate_hz: Option<f64>,
    phase_s: Option<f64>,
    delay_s: Option<f64>,
    dropout: Option<f64>,
    /// Multiplies every sigma.
    noise_scale: Option<f64>,
    /// Multiplies every bias and its walk.
    bias_scale: Option<f64>,
    /// What a calibration of an IMU would remove.
    distortion: Option<Distortion>,
}

#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct RawBattery {
    charge: f64,
    /// Held at its nominal voltage when false.
    sags: bool,
    /// Instead of the airframe's.
    capacity_ah: Option<f64>,
}

impl Default for RawBattery {
    fn default() -> Self {
        Self { charge: 0.95, sags: true, capacity_ah: None }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPush {
    at_s: f64,
    duration_s: f64,
    #[serde(default)]
    force_enu_n: Vector3<f64>,
    #[serde(default)]
    torque_flu_nm: Vector3<f64>,
    /// Holds the rotation about `axis` at `angle_rad`.
    axis: Option<Axis>,
    angle_rad: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawOutage {
    sensor: String,
    #[serde(default = "one_u8")]
    instance: u8,
    start_s: f64,
    duration_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAttack {
    sensor: String,
    #[serde(default = "one_u8")]
    instance: u8,
    #[serde(default = "all")]
    channel: String,
    kind: Kind,
    start_s: f64,
    duration_s: f64,
    #[serde(default)]
    magnitude: f64,
    #[serde(default)]
    seed: u64,
}

fn one_u8() -> u8 {
    1
}

fn all() -> String {
    "all".into()
}

type Read<T> = Result<T, ScenarioError>;

fn bad<T>(key: impl Into<String>, value: impl ToString, expected: impl Into<String>) -> Read<T> {
    Err(ScenarioError::Value { key: key.into(), value: value.to_string(), expected: expected.into() })
}

fn within(key: &str, value: f64, min: f64, max: f64) -> Read<f64> {
    // A NaN fails both comparisons.
    if value >= min && value <= max { Ok(value) } else { bad(key, value, format!("{min} to {max}")) }
}

/// Turns words into types; ranges that concern one key alone are checked here, the rest by the scenario.
pub(super) fn read(raw: RawScenario, text: &str) -> Read<Scenario> {
    let mut airframe = match raw.airframe {
        None => Airframe::iris(),
        Some(toml::Value::String(name)) => Airframe::by_name(&name)?,
        Some(table) => table.try_into::<Airframe>().map_err(|e| ScenarioError::Syntax(format!("airframe: {e}")))?,
    };
    airframe.battery.capacity_ah = raw.battery.capacity_ah.unwrap_or(airframe.battery.capacity_ah);
    let mut suite = read_suite(raw.suite)?;
    for change in &raw.sensor {
        change_sensor(&mut suite, change)?;
    }
    let conditions = raw.world.as_deref().map(Conditions::of_world).transpose()?.flatten();
    let ideal = raw.world.as_deref() == Some(IDEAL);
    let own = conditions.as_ref().map(|conditions| conditions.world.as_str()).or(ideal.then_some(IDEAL));
    if let (Some(world), Some(_)) = (own, &raw.disturbance) {
        return bad("disturbance", "given", format!("beside world = {world:?}, which has its own"));
    }
    let usual = if ideal { Disturbance::NONE } else { Disturbance::default() };
    let attacks = read_attacks(&raw.attack)?;
    let mut script = Script::default();
    if !attacks.attacks.is_empty() {
        script.steps.push(Step { at_s: 0.0, command: Command::Attack(attacks.clone()) });
    }
    let mut steps = raw.script;
    steps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    for step in steps {
        read_step(step, &mut script)?;
    }
    script.pushes = raw.push.iter().map(read_push).collect::<Read<_>>()?;
    Ok(Scenario {
        name: raw.name,
        description: raw.description,
        text: text.to_owned(),
        seed: raw.seed,
        duration_s: raw.duration_s,
        tick_rate_hz: raw.tick_rate_hz,
        airframe,
        rig: raw.rig.unwrap_or_else(|| Rig::HangingStrings(HangingStrings::default())),
        suite,
        site: raw.site,
        disturbance: raw.disturbance.unwrap_or(usual),
        conditions,
        ideal,
        battery_charge: raw.battery.sags.then_some(raw.battery.charge),
        initial: raw.initial,
        script,
        attacks,
        outages: raw.outage.iter().map(read_outage).collect::<Read<_>>()?,
        broken: raw.broken,
    })
}

fn read_suite(raw: RawSuite) -> Read<Suite> {
    let mut suite = match (raw.preset, raw.custom) {
        (Some(name), Some(_)) => {
            return bad("suite.preset", name, "given beside suite.custom: give one of them");
        }
        (None, None) => Suite::string_rig(),
        (None, Some(custom)) => custom,
        (Some(name), None) => match Suite::preset(&name) {
            Some(suite) => suite,
            None => return bad("suite.preset", name, format!("one of {}", PRESETS.join(", "))),
        },
    };
    for name in &raw.add {
        if !suite.add(sensor_kind("suite.add", name)?) {
            return bad("suite.add", name, "possible: the suite has as many as it can hold");
        }
    }
    Ok(suite)
}

fn change_sensor(suite: &mut Suite, change: &RawSensor) -> Read<()> {
    let kind = sensor_kind("sensor.kind", &change.kind)?;
    let id = SensorId::new(kind, change.instance.unwrap_or(1));
    if !suite.contains(id) {
        return bad("sensor", id, "a sensor of the suite");
    }
    let scale = |key, value: Option<f64>| within(key, value.unwrap_or(1.0), 0.0, 1000.0);
    let noise = scale("sensor.noise_scale", change.noise_scale)?;
    let bias = scale("sensor.bias_scale", change.bias_scale)?;
    suite.sheets_mut(|sensor, sheet| {
        if sensor.kind != kind || change.instance.is_some_and(|instance| instance != sensor.instance) {
            return;
        }
        let t = sheet.timing_mut();
        t.rate_hz = change.rate_hz.unwrap_or(t.rate_hz);
        t.phase_s = change.phase_s.unwrap_or(t.phase_s);
        t.delay_s = change.delay_s.unwrap_or(t.delay_s);
        t.dropout = change.dropout.unwrap_or(t.dropout);
        sheet.qualities(&mut |_, quality| {
            quality.sigma *= noise;
            quality.bias_sigma *= bias;
            quality.bias_walk *= bias;
        });
        if let Some(distortion) = change.distortion {
            sheet.distort(distortion);
        }
    });
    Ok(())
}

/// A kind by its name in scenarios: `mocap_pose`.
fn sensor_kind(key: &str, name: &str) -> Read<SensorKind> {
    match SensorKind::from_str_name(&format!("SENSOR_KIND_{}", name.to_ascii_uppercase())) {
        Some(kind) if kind != SensorKind::Unspecified => Ok(kind),
        _ => {
            let rotor = (key == "attack.sensor").then_some(SensorKind::Rotor);
            let names: Vec<_> =
                Suite::kinds().chain(rotor).map(|kind| kind.as_str_name().to_ascii_lowercase()).collect();
            bad(key, name, format!("one of {}", names.join(", ").replace("sensor_kind_", "")))
        }
    }
}

fn read_outage(raw: &RawOutage) -> Read<Outage> {
    Ok(Outage {
        sensor: SensorId::new(sensor_kind("outage.sensor", &raw.sensor)?, raw.instance),
        start_s: within("outage.start_s", raw.start_s, 0.0, 86_400.0)?,
        duration_s: within("outage.duration_s", raw.duration_s, 0.0, 86_400.0)?,
    })
}

fn read_push(raw: &RawPush) -> Read<PushEvent> {
    for (key, v) in [("push.force_enu_n", raw.force_enu_n), ("push.torque_flu_nm", raw.torque_flu_nm)] {
        for value in v.iter() {
            within(key, *value, -1000.0, 1000.0)?;
        }
    }
    let deflect = match (raw.axis, raw.angle_rad) {
        (Some(axis), Some(angle)) => Some((axis.unit(), within("push.angle_rad", angle, -3.2, 3.2)?)),
        (None, None) => None,
        (Some(axis), None) => return bad("push.axis", format!("{axis:?}"), "alone: push.angle_rad goes with it"),
        (None, Some(angle)) => return bad("push.angle_rad", angle, "alone: push.axis goes with it"),
    };
    Ok(PushEvent {
        at_s: within("push.at_s", raw.at_s, 0.0, 86_400.0)?,
        duration_s: within("push.duration_s", raw.duration_s, 1e-3, 3600.0)?,
        push: Push { force_enu_n: raw.force_enu_n, torque_flu_nm: raw.torque_flu_nm, deflect },
    })
}

/// Only the attacks of a file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAttacks {
    attack: Vec<RawAttack>,
}

/// Reads a file that holds nothing but `[[attack]]` tables.
pub(super) fn attacks_alone(text: &str) -> Read<Schedule> {
    let raw: RawAttacks =
        toml::from_str(text).map_err(|e| ScenarioError::Syntax(e.to_string().trim_end().to_owned()))?;
    read_attacks(&raw.attack)
}

fn read_attacks(raw: &[RawAttack]) -> Read<Schedule> {
    let mut attacks = ArrayVec::new();
    for (index, a) in raw.iter().enumerate() {
        let attack = Attack {
            id: index as u32 + 1,
            sensor: SensorId::new(sensor_kind("attack.sensor", &a.sensor)?, a.instance),
            channel: attack_channel(&a.channel)?,
            kind: a.kind,
            start_s: a.start_s,
            duration_s: a.duration_s,
            magnitude: a.magnitude,
            seed: a.seed,
        };
        if attacks.try_push(attack).is_err() {
            return bad("attack", format!("{} attacks", raw.len()), format!("{MAX_ATTACKS} at most"));
        }
    }
    Ok(Schedule { id: u32::from(!attacks.is_empty()), attacks, ..Schedule::default() })
}

fn attack_channel(name: &str) -> Read<Channel> {
    Ok(match name {
        "all" => Channel::All,
        "gyro" => Channel::Gyro,
        "accel" => Channel::Accel,
        "mag" => Channel::Mag,
        "x" => Channel::Axis(0),
        "y" => Channel::Axis(1),
        "z" => Channel::Axis(2),
        "gyro_x" => Channel::GyroAxis(0),
        "gyro_y" => Channel::GyroAxis(1),
        "gyro_z" => Channel::GyroAxis(2),
        "accel_x" => Channel::AccelAxis(0),
        "accel_y" => Channel::AccelAxis(1),
        "accel_z" => Channel::AccelAxis(2),
        other => {
            return bad("attack.channel", other, "one of all, gyro, accel, mag, x, y, z, gyro_x … accel_z");
        }
    })
}

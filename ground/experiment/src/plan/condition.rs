//! One condition: its tables, read as what they are elsewhere (a scenario, an agent's configuration, an attack).

use plumbline_agent::attack::{Attack, AttackError, Injector, Schedule};
use plumbline_agent::command::Command;
use plumbline_agent::config::AgentConfig;
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::scenario::attacks_from_toml;
use plumbline_agent::sim::script::Step;
use plumbline_agent::types::Mode;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use serde::Deserialize;
use toml::{Table, Value};

use crate::attacked::{Attacked, Given};
use crate::flight::Setup;
use crate::judge::STEADY_S;
use crate::reception::Reception;
use crate::recordings::{Recorded, Recordings};

/// What an onset is drawn for when nothing is given.
const DRAWN: [&str; 3] = ["any", "imu_and_height", "none"];

/// Keys of an agent's configuration that a flight of an experiment does not read: what would be varied in them changes nothing.
const ELSEWHERE: [&str; 10] =
    ["id", "ground", "identity", "real_time", "calibrations", "rig", "device", "motors", "log", "link"];

/// Of a complaint, what it is about.
pub(super) fn in_section(section: &'static str) -> impl FnOnce(String) -> Wrong {
    move |complaint| Wrong { section, complaint }
}

/// Why a condition cannot be flown.
pub(super) struct Wrong {
    /// Which of its tables.
    pub(super) section: &'static str,
    /// In the words of whoever reads such a table.
    pub(super) complaint: String,
}

/// A condition that can be flown with any seed.
#[derive(Debug, Clone)]
pub struct Condition {
    scenario: Scenario,
    /// What is flown instead of it.
    recording: Option<Recorded>,
    table: Table,
    config: FlightConfig,
    reception: Reception,
    attacked: Attacked,
    words: [String; 3],
    /// Only the onset is drawn: the same part of the flight is judged as with the attack.
    off: bool,
}

#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct RawAttack {
    /// `none`, `any`, `imu_and_height`, or a kind of sensor.
    sensor: String,
    instance: Option<u8>,
    channel: Option<String>,
    /// `none`: only the onset counts; `drawn`: anything that the vehicle takes; `colluding`: the same bias on each; or a kind.
    kind: String,
    magnitude: f64,
    /// `given`: a bias or ramp has the sign of its magnitude; else that of one above zero is drawn.
    sign: Sign,
    start_s: Option<f64>,
    duration_s: Option<f64>,
    /// How many sensors, where attacks are drawn, or collude.
    count: Option<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Sign {
    Drawn,
    Given,
}

impl Default for RawAttack {
    fn default() -> Self {
        let (sensor, kind) = ("none".into(), "drawn".into());
        Self {
            sensor,
            instance: None,
            channel: None,
            kind,
            magnitude: 0.0,
            sign: Sign::Drawn,
            start_s: None,
            duration_s: None,
            count: None,
        }
    }
}

impl RawAttack {
    /// Only its onset counts.
    fn is_off(&self) -> bool {
        self.kind == "none"
    }
}

impl Condition {
    /// Reads and tries it: what it needs is built, its first attacks are checked.
    pub(super) fn read(table: &Table, recordings: &Recordings) -> Result<Self, Wrong> {
        let part = |key: &str| table.get(key).and_then(Value::as_table).cloned().unwrap_or_default();
        let agent_table = part("agent");
        if let Some(key) = ELSEWHERE.into_iter().find(|key| agent_table.contains_key(*key)) {
            return Err(in_section("agent")(format!("{key}: flights of an experiment do not read it, leave it out")));
        }
        let agent = AgentConfig::from_toml(&agent_table.to_string())
            .map_err(|error| in_section("agent")(error.to_string().trim_start_matches("configuration: ").to_owned()))?;
        let mut scenario_table = part("scenario");
        let named = table.get("recording").map(|name| name.as_str().unwrap_or_default());
        let recording = match named {
            Some(name) => {
                if !scenario_table.is_empty() {
                    let complaint = "a recording is flown instead: leave this out".into();
                    return Err(Wrong { section: "scenario", complaint });
                }
                let again = part("attack").is_empty();
                let recorded = Recorded::new(recordings, name, again, &agent.airframe);
                Some(recorded.map_err(in_section("recording"))?)
            }
            None => None,
        };
        let (scenario, mut config) = match &recording {
            Some(recorded) => (recorded.scenario(), recorded.flown.flight.clone()),
            None => {
                scenario_table.entry("name").or_insert_with(|| Value::String("experiment".into()));
                let scenario = Scenario::from_toml(&scenario_table.to_string()).map_err(|error| {
                    in_section("scenario")(error.to_string().trim_start_matches("scenario: ").to_owned())
                })?;
                let config = scenario.flight_config();
                (scenario, config)
            }
        };
        agent.apply(&mut config).map_err(|error| in_section("agent")(error.to_string()))?;
        config.tick_rate_hz = scenario.tick_rate_hz;
        // Nobody looks at the others: one estimator is a third of the time.
        if agent.estimators.run.is_none() {
            config.estimators = vec![config.in_loop];
        }
        let reception = reception(table)?;
        let raw = raw_attack(table).map_err(in_section("attack"))?;
        let off = raw.is_off();
        let attacked = attacked(&raw).map_err(in_section("attack"))?;
        let words = [raw.sensor, raw.channel.unwrap_or_else(|| "all".into()), raw.kind];
        let condition = Self { scenario, recording, table: scenario_table, config, reception, attacked, words, off };
        Flight::new(condition.config.clone()).map_err(|error| in_section("agent")(error.to_string()))?;
        condition.check_length()?;
        condition.check_attacks()?;
        Ok(condition)
    }

    /// The flight of this seed.
    pub fn setup(&self, seed: u64) -> Setup {
        let drawn = self.attacked.attacks(&self.config.sensors, seed);
        let then = self.recording.iter().flat_map(|recorded| &recorded.attacked).map(|(_, onset_s)| *onset_s);
        let onset_s = drawn.iter().map(|attack| attack.start_s).chain(then).fold(f64::INFINITY, f64::min);
        let mut scenario = self.scenario.clone();
        scenario.seed = seed;
        let attacks = if self.off { Vec::new() } else { drawn };
        let judged_from_s = if onset_s.is_finite() { onset_s } else { 0.0 };
        Setup {
            scenario,
            recording: self.recording.clone(),
            config: self.config.clone(),
            reception: self.reception,
            attacks,
            sequences: Vec::new(),
            judged_from_s,
            comes_down: self.attacked.colludes(),
        }
    }

    /// Sensor, channel and kind of its attack in the plan's words, where that is one kind of attack on one sensor.
    pub(crate) fn one_attack(&self) -> Option<&[String; 3]> {
        matches!(self.attacked, Attacked::Given(_)).then_some(&self.words)
    }

    /// Length of a flight that is not lost, s.
    pub fn duration_s(&self) -> f64 {
        self.scenario.duration_s
    }

    /// Its scenario file, for a flight file; of a recording the one in it.
    pub fn scenario_text(&self, seed: u64) -> String {
        if let Some(recorded) = &self.recording {
            return recorded.flown.scenario.as_ref().map(|scenario| scenario.text.clone()).unwrap_or_default();
        }
        let mut table = self.table.clone();
        table.insert("seed".into(), Value::Integer(seed.cast_signed()));
        table.to_string()
    }

    /// Something of every flight must be judged, whatever is drawn.
    fn check_length(&self) -> Result<(), Wrong> {
        let (lasts_s, onset_s) = (self.scenario.duration_s, self.attacked.latest_onset_s());
        let Some(Recorded { name, .. }) = &self.recording else {
            return self.check_script(onset_s).map_err(in_section("scenario"));
        };
        let complaint = if lasts_s <= STEADY_S {
            format!("recording {name:?} lasts {lasts_s:.1} s, and flights are judged from {STEADY_S} s on")
        } else if lasts_s <= onset_s {
            format!("recording {name:?} lasts {lasts_s:.1} s, and an onset may be at {onset_s} s: give attack.start_s")
        } else {
            return Ok(());
        };
        Err(Wrong { section: "recording", complaint })
    }

    /// A simulated flight is in the air at every onset that may be drawn.
    fn check_script(&self, onset_s: f64) -> Result<(), String> {
        if self.attacked == Attacked::None {
            return Ok(());
        }
        let Scenario { duration_s, script, .. } = &self.scenario;
        if *duration_s <= onset_s {
            return Err(format!("duration_s = {duration_s} ends before an onset, which may be at {onset_s} s"));
        }
        let orders = |command: &Command| matches!(command, Command::Arm | Command::Disarm | Command::SetMode(_));
        let mut before = script.steps.iter().rev().filter(|step| step.at_s <= onset_s);
        match before.find(|step| orders(&step.command)) {
            Some(Step { at_s, command: Command::Disarm | Command::SetMode(Mode::Land) }) => {
                Err(format!("the script ends the flight at {at_s} s, before an onset, which may be at {onset_s} s"))
            }
            _ => Ok(()),
        }
    }

    fn check_attacks(&self) -> Result<(), Wrong> {
        let Setup { attacks, config, .. } = self.setup(1);
        if self.attacked != Attacked::None && self.attacked.attacks(&config.sensors, 1).is_empty() {
            return Err(Wrong { section: "attack", complaint: "sensor: the vehicle has none of this kind".into() });
        }
        let schedule = Schedule { id: 1, attacks: attacks.into_iter().collect(), ..Schedule::default() };
        let mut injector = Injector::new(config.attacks.bounds, true, &config.sensors).sparing(&config.independent);
        let refused = |error: AttackError| {
            let of = |recorded: &Recorded| format!("recording {:?}: {error}", recorded.name);
            let complaint = self.recording.as_ref().map_or_else(|| error.to_string(), of);
            Wrong { section: "attack", complaint }
        };
        injector.upload(&schedule, FlightTime(0)).map_err(refused)
    }
}

fn reception(table: &Table) -> Result<Reception, Wrong> {
    let named = table.get("reception").and_then(Value::as_str);
    let found = Reception::NAMED.into_iter().find(|(name, _)| Some(*name) == named);
    found.map(|(_, reception)| reception).ok_or_else(|| {
        let names: Vec<_> = Reception::NAMED.iter().map(|(name, _)| *name).collect();
        let complaint = format!("{} is not one of {}", named.unwrap_or("what is given"), names.join(", "));
        Wrong { section: "reception", complaint }
    })
}

/// What is attacked in a condition, and whether only its onset counts.
pub(super) fn attack_of(table: &Table) -> Result<(Attacked, bool), String> {
    let raw = raw_attack(table)?;
    Ok((attacked(&raw)?, raw.is_off()))
}

fn raw_attack(table: &Table) -> Result<RawAttack, String> {
    let part = table.get("attack").and_then(Value::as_table).cloned().unwrap_or_default();
    Value::Table(part).try_into().map_err(|error: toml::de::Error| error.message().to_owned())
}

fn attacked(raw: &RawAttack) -> Result<Attacked, String> {
    let free = raw.instance.is_none() && raw.channel.is_none() && raw.magnitude == 0.0;
    let drawn = matches!(raw.kind.as_str(), "drawn" | "colluding" | "none");
    if drawn && !(free && raw.start_s.is_none() && raw.duration_s.is_none()) && raw.kind != "none" {
        return Err(format!(
            "kind = {:?} draws instance, channel, magnitude, start_s and duration_s: leave them out",
            raw.kind
        ));
    }
    let count = raw.count.unwrap_or(1);
    if !(1..=5).contains(&count) || (count > 1 && !drawn) {
        return Err(format!("count = {count} is not 1 to 5 sensors of drawn or colluding attacks"));
    }
    match (raw.sensor.as_str(), raw.kind.as_str()) {
        ("none", _) => Ok(Attacked::None),
        ("any", "drawn" | "none") => Ok(Attacked::One),
        ("imu_and_height", "drawn" | "none") => Ok(Attacked::ImuAndHeight),
        (sensor, kind) if DRAWN.contains(&sensor) => {
            Err(format!("kind = {kind:?} needs one kind of sensor, not {sensor:?}"))
        }
        ("height", "colluding") => Ok(Attacked::Colluding(count)),
        (sensor, "colluding") => Err(format!("sensor = {sensor:?}: only attacks on height collude")),
        ("height", "drawn") => Ok(Attacked::Several(SensorKind::Height, count)),
        ("imu", "drawn") => Ok(Attacked::Several(SensorKind::Imu, count)),
        (sensor, "drawn") => Err(format!("sensor = {sensor:?}: attacks are drawn for imu and height")),
        _ => given(raw).map(Attacked::Given),
    }
}

/// Read by whoever reads the attacks of a scenario.
fn given(raw: &RawAttack) -> Result<Given, String> {
    let mut table = Table::new();
    table.insert("sensor".into(), Value::String(raw.sensor.clone()));
    table.insert("instance".into(), Value::Integer(raw.instance.unwrap_or(1).into()));
    table.insert("channel".into(), Value::String(raw.channel.clone().unwrap_or_else(|| "all".into())));
    let kind = if raw.kind == "none" { "zero" } else { &raw.kind };
    table.insert("kind".into(), Value::String(kind.to_owned()));
    table.insert("magnitude".into(), Value::Float(raw.magnitude));
    table.insert("start_s".into(), Value::Float(0.0));
    table.insert("duration_s".into(), Value::Float(1.0));
    let text = Table::from_iter([("attack".to_owned(), Value::Array(vec![Value::Table(table)]))]).to_string();
    let schedule =
        attacks_from_toml(&text).map_err(|error| error.to_string().trim_start_matches("scenario: ").to_owned())?;
    let Some(Attack { sensor, channel, kind, magnitude, .. }) = schedule.attacks.first().copied() else {
        return Err("no attack".into());
    };
    let RawAttack { instance, start_s, duration_s, .. } = *raw;
    let count = raw.count.unwrap_or(1);
    let sign_drawn = raw.sign == Sign::Drawn;
    Ok(Given { sensor: sensor.kind, instance, channel, kind, magnitude, sign_drawn, start_s, count, duration_s })
}

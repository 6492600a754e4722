//! A flight by hand: what an operator is led through on a vehicle, and how its recording is judged.

use std::ops::RangeInclusive;

use plumbline_agent::attack::MAX_ATTACKS;
use plumbline_agent::config::AgentConfig;
use plumbline_agent::control::trajectory::MAX_ALTITUDES;
use plumbline_agent::sim::Scenario;
use plumbline_agent::telemetry::wire_attack;
use plumbline_agent::types::EstimatorKind;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1;
use serde::Deserialize;
use toml::{Table, Value};

use super::condition::{Condition, Wrong, attack_of, in_section};
use crate::attacked::{Attacked, Given};
use crate::flight::Setup;
use crate::judge::STEADY_S;
use crate::recordings::Recordings;

/// The table of a plan.
pub(super) const SECTION: &str = "by_hand";
/// Most flights of such a plan.
pub(super) const MOST: u64 = 1000;
const HOLD_S: RangeInclusive<f64> = 1.0..=600.0;
const REST_S: RangeInclusive<f64> = 0.0..=3600.0;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    vehicle: String,
    altitude_m: Vec<f64>,
    #[serde(default = "hold_s")]
    hold_s: f64,
    #[serde(default)]
    rest_s: f64,
    gains: Option<u32>,
}

fn hold_s() -> f64 {
    10.0
}

/// One condition of a plan that is flown by hand.
#[derive(Debug, Clone)]
pub struct ByHand {
    /// Who flies.
    pub vehicle: String,
    /// The altitudes that are flown one after the other, m.
    pub altitude_m: Vec<f64>,
    /// Each for so long, s.
    pub hold_s: f64,
    /// Least time between two flights, s.
    pub rest_s: f64,
    /// Revision of the ground's book to be used; `None` leaves what is in use.
    pub gains: Option<u32>,
    /// In the loop.
    pub estimator: EstimatorKind,
    agent: Table,
    attacked: Attacked,
    off: bool,
}

impl ByHand {
    /// Of the tables of a condition.
    pub(super) fn read(table: &Table) -> Result<Self, Wrong> {
        let part = |key: &str| table.get(key).and_then(Value::as_table).cloned().unwrap_or_default();
        for section in ["scenario", super::RECORDING] {
            if table.get(section).is_some_and(|value| value.as_table().is_none_or(|table| !table.is_empty())) {
                return Err(Wrong { section, complaint: "flown by hand instead: leave this out".into() });
            }
        }
        if table.get("reception").and_then(Value::as_str) != Some("all") {
            let complaint = "nothing stands before the estimator of a vehicle: leave this out".into();
            return Err(Wrong { section: "reception", complaint });
        }
        let raw: Raw = Value::Table(part(SECTION))
            .try_into()
            .map_err(|error: toml::de::Error| in_section(SECTION)(error.message().to_owned()))?;
        raw.check().map_err(in_section(SECTION))?;
        let agent = part("agent");
        let other = |(key, value): &(&String, &Value)| {
            *key != "estimators" || value.as_table().is_none_or(|table| table.keys().any(|key| key != "in_loop"))
        };
        if let Some((key, _)) = agent.iter().find(other) {
            let complaint = format!("`{key}`: of a vehicle only estimators.in_loop is set, and by_hand.gains");
            return Err(Wrong { section: "agent", complaint });
        }
        let read = AgentConfig::from_toml(&agent.to_string());
        let mut config = Scenario::bare().flight_config();
        read.and_then(|agent| agent.apply(&mut config)).map_err(|error| in_section("agent")(error.to_string()))?;
        let (attacked, off) = attack_of(table).map_err(in_section("attack"))?;
        if matches!(attacked, Attacked::Given(Given { sensor: v1::SensorKind::Rotor, .. })) {
            let complaint =
                "sensor = \"rotor\": the reader of recordings finds no rotor's onset, so nothing could be judged";
            return Err(in_section("attack")(complaint.into()));
        }
        let by_hand = Self {
            vehicle: raw.vehicle,
            altitude_m: raw.altitude_m,
            hold_s: raw.hold_s,
            rest_s: raw.rest_s,
            gains: raw.gains,
            estimator: config.in_loop,
            agent,
            attacked,
            off,
        };
        let (lasts_s, onset_s) = (by_hand.lasts_s(), by_hand.attacked.latest_onset_s());
        let why = if lasts_s <= STEADY_S {
            format!("flights are judged from {STEADY_S} s on")
        } else if lasts_s <= onset_s {
            format!("an onset may be at {onset_s} s: give attack.start_s")
        } else {
            return Ok(by_hand);
        };
        let (count, hold_s) = (by_hand.altitude_m.len(), by_hand.hold_s);
        Err(Wrong {
            section: SECTION,
            complaint: format!("`altitude_m`: {count} of {hold_s} s are {lasts_s} s, and {why}"),
        })
    }

    /// From the first altitude to the end of the last, s.
    pub fn lasts_s(&self) -> f64 {
        self.altitude_m.len() as f64 * self.hold_s
    }

    fn attacks_something(&self) -> bool {
        !self.off && self.attacked != Attacked::None
    }

    /// The attacks of the flight of this `seed` on a vehicle with these sensors, from the first altitude on.
    ///
    /// # Errors
    /// A sentence: the vehicle has none of what is to be attacked.
    pub fn attacks(&self, sensors: &[SensorId], seed: u64) -> Result<Vec<v1::Attack>, String> {
        if !self.attacks_something() {
            return Ok(Vec::new());
        }
        let drawn = self.attacked.attacks(sensors, seed);
        match drawn.iter().find(|attack| !sensors.contains(&attack.sensor)) {
            Some(attack) => Err(format!("{} has no {} to be attacked", self.vehicle, attack.sensor)),
            None if drawn.is_empty() => Err(format!("{} has no sensor of the kind to be attacked", self.vehicle)),
            None => Ok(drawn.iter().take(MAX_ATTACKS).map(wire_attack).collect()),
        }
    }

    /// What its recording is flown through to be judged: the estimator that was in the loop, given what it was given then.
    ///
    /// # Errors
    /// A sentence: no estimator could start on it, it is too short, or nothing is attacked in it that was to be.
    pub(crate) fn judged(&self, flight: &str, recordings: &Recordings, seed: u64) -> Result<Setup, String> {
        let table = Table::from_iter([
            ("agent".to_owned(), Value::Table(self.agent.clone())),
            ("reception".to_owned(), Value::String("all".into())),
            (super::RECORDING.to_owned(), Value::String(flight.into())),
        ]);
        let condition = Condition::read(&table, recordings).map_err(|wrong| wrong.complaint)?;
        let setup = Setup { comes_down: self.attacked.colludes(), ..condition.setup(seed) };
        let clean = setup.recording.iter().all(|recorded| recorded.attacked.is_empty());
        // One that alters nothing leaves no trace.
        if clean && self.attacks_something() && self.attacked.alters() {
            return Err("nothing is attacked in it: it ended before the onset, or the attack was never sent".into());
        }
        Ok(setup)
    }
}

impl Raw {
    fn check(&self) -> Result<(), String> {
        if self.vehicle.is_empty() {
            return Err("vehicle = \"\" is the id of none".into());
        }
        let count = self.altitude_m.len();
        if !(1..=MAX_ALTITUDES).contains(&count) {
            return Err(format!("altitude_m has {count} altitudes, not 1 to {MAX_ALTITUDES}"));
        }
        if let Some(odd) = self.altitude_m.iter().find(|altitude| **altitude <= 0.0) {
            return Err(format!("altitude_m = {odd} is not above 0"));
        }
        for (name, value, range) in [("hold_s", self.hold_s, HOLD_S), ("rest_s", self.rest_s, REST_S)] {
            if !range.contains(&value) {
                return Err(format!("{name} = {value} is not {} to {}", range.start(), range.end()));
            }
        }
        Ok(())
    }
}

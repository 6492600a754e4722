//! Experiments: plans of many flights, simulated or of recordings flown again, below `/api/v1/experiments`.
//!
//! | request | answer |
//! |---|---|
//! | `GET` | [`Experiments`] |
//! | `POST …/size` [`Asked`] | [`Size`]: nothing is kept |
//! | `POST` [`Asked`] | [`State`]: kept and started |
//! | `GET …/{id}` | [`Results`] of what is there |
//! | `POST …/{id}/start`, `POST …/{id}/stop` | [`State`] |
//! | `GET …/{id}/flights?from=0&count=100[&condition=N]` | [`Flights`] |
//! | `POST …/{id}/flights/{index}` | [`Opened`]: flown again from its seed and recorded |
//! | `GET …/{id}/flights/{index}/open` | the same, then the page of that flight |
//! | `GET …/{id}/by-hand` | [`ByHand`]: the next flight of an operator, and what was said of those before |
//! | `POST …/{id}/by-hand` [`Said`] | [`ByHand`]: a flight is accepted, or void |
//! | `GET …/{id}/plan.toml`, `report.html`, `flights.parquet` | files |
//! | `GET …/{id}/against/{second}` | what the second differs from it in, HTML |

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::command::{PlannedAttack, Trajectory};

/// A plan, TOML.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Its text.
    pub plan: String,
}

/// What a plan comes to.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Size {
    /// Id that it has, or will have.
    pub id: String,
    /// Combinations of levels.
    pub conditions: u64,
    /// Flights of each.
    pub repeats: u64,
    /// Flights in all.
    pub flights: u64,
    /// How many of them are there already.
    pub done: u64,
    /// How long the others will take here, s.
    pub expected_s: f64,
    /// Does an operator fly them, on a vehicle?
    pub by_hand: bool,
}

/// How an experiment stands.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct State {
    /// Id.
    pub id: String,
    /// Name of the plan.
    pub name: String,
    /// What the plan says of itself.
    pub description: String,
    /// When it was made, µs since 1970.
    pub made_unix_us: u64,
    /// Flights of the plan.
    pub flights: u64,
    /// Flights that are there.
    pub done: u64,
    /// Is it being flown?
    pub running: bool,
    /// Flights a second since it was started last.
    pub per_s: Option<f64>,
    /// Until all are there, s.
    pub left_s: Option<f64>,
    /// Does an operator fly it, on a vehicle?
    pub by_hand: bool,
    /// Was it begun by the program that answers? Only that one goes on with it.
    pub own: bool,
    /// Why its last run ended before its end, as far as this ground knows.
    pub error: Option<String>,
}

/// `GET /api/v1/experiments`, newest first.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Experiments {
    /// One page.
    pub experiments: Vec<State>,
    /// Experiments on all pages.
    pub total: u64,
}

/// A column of numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Measure {
    /// Name, with its unit.
    pub name: String,
    /// For people.
    pub about: String,
}

/// What is there of an experiment, condition by condition.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Results {
    /// How it stands.
    pub state: State,
    /// Keys of what is varied.
    pub factors: Vec<String>,
    /// What is measured.
    pub measures: Vec<Measure>,
    /// In the order of the plan; those without a flight are left out.
    pub conditions: Vec<Condition>,
    /// What measures are of recordings: against what, and which of them are not known.
    pub notes: Vec<String>,
}

/// The flights of one condition.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Condition {
    /// Which of the plan.
    pub number: u64,
    /// A level for each factor; empty where a list leaves it as it is.
    pub levels: Vec<String>,
    /// Flights that are there.
    pub flights: u64,
    /// How many of them were lost, and why; the measures are of the others.
    pub lost: BTreeMap<String, u64>,
    /// In the order of [`Results::measures`]; `None` where nothing was measured.
    pub measures: Vec<Option<Spread>>,
    /// Of the flights in which something was attacked, those in which all of it was excluded; `None` where nothing was.
    pub detected: Option<Part>,
    /// What the model expects of that; `None` where nothing was attacked, or it was never asked.
    pub expected: Option<Expectation>,
    /// Median and 99 of 100 of the agent's ticks on the machine that flew it, µs; `None` where nobody measured.
    pub tick_us: Option<[f64; 2]>,
    /// Against the condition it is compared with, flight by flight of the same seed: [`Results::measures`] again.
    pub differences: Vec<Option<Difference>>,
}

impl Condition {
    /// What is expected beside what was flown, for people; `None` where nothing is.
    pub fn beside(&self) -> Option<String> {
        let (Expectation { probability, note, differs }, flown) = (self.expected.as_ref()?, self.detected?);
        let Some(probability) = probability else { return Some(format!("expected: not known, {note}")) };
        let ([low, high], part) = (flown.interval, flown.count as f64 / flown.of.max(1) as f64);
        let differs = if *differs { ": differs by more than the interval" } else { "" };
        let note = if note.is_empty() { String::new() } else { format!("; {note}") };
        Some(format!("expected {probability:.2}, flown {part:.2} ({low:.2} to {high:.2}){differs}{note}"))
    }
}

/// What the model of the lanes expects of an attack on one sensor, by the flights of the condition as planned. Of several sensors it
/// says nothing: the model has any of them excluded, [`Condition::detected`] all.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Expectation {
    /// Part of flights in which the attacked sensor is excluded, 0 to 1; `None` where the model cannot tell.
    pub probability: Option<f64>,
    /// Why it cannot; or by what else than drawn flights it can.
    pub note: String,
    /// Does it lie outside the 95 % interval of the flights flown?
    pub differs: bool,
}

impl Expectation {
    /// One of which nothing is known, and why.
    pub fn unknown(note: impl Into<String>) -> Self {
        Self { note: note.into(), ..Self::default() }
    }

    /// Beside what was flown.
    #[must_use]
    pub fn against(self, flown: &Part) -> Self {
        let [low, high] = flown.interval;
        // Ends that are 0 or 1 are so up to rounding.
        let differs = self.probability.is_some_and(|p| p < low - 1e-9 || p > high + 1e-9);
        Self { differs, ..self }
    }
}

/// Values of many flights.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Spread {
    /// How many.
    pub count: u64,
    /// Smallest.
    pub least: f64,
    /// A quarter is below.
    pub quarter: f64,
    /// Median.
    pub median: f64,
    /// Three quarters are below.
    pub three_quarters: f64,
    /// 95 of 100 are below.
    pub of_95: f64,
    /// Largest.
    pub most: f64,
    /// 95 % interval of the median; `None` of fewer than six values.
    pub interval: Option<[f64; 2]>,
}

/// So many of so many.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Part {
    /// So many.
    pub count: u64,
    /// Of so many.
    pub of: u64,
    /// 95 % interval of the part (Wilson).
    pub interval: [f64; 2],
}

/// Differences of pairs of flights of the same seed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Difference {
    /// The condition compared with.
    pub baseline: u64,
    /// Pairs of which neither was lost.
    pub pairs: u64,
    /// Median of this less that.
    pub median: f64,
    /// Its 95 % interval; `None` of fewer than six pairs.
    pub interval: Option<[f64; 2]>,
    /// Mean difference by its standard deviation (Cohen's d of pairs).
    pub effect: Option<f64>,
}

/// Flights of an experiment, some of them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = ExperimentFlights))]
#[serde(default)]
pub struct Flights {
    /// How many there are that were asked for.
    pub total: u64,
    /// Those from the place asked for on.
    pub flights: Vec<Flight>,
}

/// One flight.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = ExperimentFlight))]
#[serde(default)]
pub struct Flight {
    /// Which of the plan.
    pub index: u64,
    /// Its condition.
    pub condition: u64,
    /// Its seed.
    pub seed: u64,
    /// Why it was lost; empty when it was not.
    pub lost: String,
    /// In the order of [`Results::measures`].
    pub values: Vec<Option<f64>>,
}

/// A flight of an experiment, recorded.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Opened {
    /// Its id among the flights.
    pub flight: String,
}

/// An experiment that an operator flies.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct ByHand {
    /// What is to be flown now; `None` when all is.
    pub next: Option<NextByHand>,
    /// What was said of flights, the oldest first; the last word counts.
    pub said: Vec<FlownByHand>,
}

/// What an operator is led through.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct NextByHand {
    /// Which of the plan.
    pub index: u64,
    /// Its place in the order of flights, from 1.
    pub place: u64,
    /// How many there are in all.
    pub flights: u64,
    /// What is varied, and its level here.
    pub levels: Vec<String>,
    /// The vehicle.
    pub vehicle: String,
    /// Time left to rest since the flight before, s.
    pub rest_left_s: f64,
    /// To be in the loop.
    pub estimator: String,
    /// Revision of the gains to be in use; `None` leaves those that are.
    pub gains: Option<u32>,
    /// To be uploaded when the path begins; empty for none.
    pub attacks: Vec<PlannedAttack>,
    /// The path.
    pub path: Trajectory,
    /// From its begin to its end, s.
    pub lasts_s: f64,
    /// Why it cannot be flown as things are; empty where it can.
    pub lacks: String,
}

/// What is said of a flight.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Said {
    /// Which of the plan.
    pub index: u64,
    /// What it was flown as: the id of a recording.
    pub flight: String,
    /// Does it count?
    pub accepted: bool,
    /// Why; needed where it does not.
    #[serde(default)]
    pub reason: String,
}

/// What was said of a flight, and by whom.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct FlownByHand {
    /// Which of the plan.
    pub index: u64,
    /// The recording.
    pub flight: String,
    /// Does it count?
    pub accepted: bool,
    /// Why.
    pub reason: String,
    /// Who said it.
    pub who: String,
    /// When, µs since 1970.
    pub unix_us: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 12 of 20 flown, with their interval.
    fn beside(expected: Expectation) -> Condition {
        let flown = Part { count: 12, of: 20, interval: [0.387, 0.781] };
        Condition { detected: Some(flown), expected: Some(expected.against(&flown)), ..Condition::default() }
    }

    #[test]
    fn an_expectation_differs_where_it_lies_outside_the_interval() {
        let of = |p: f64| beside(Expectation { probability: Some(p), ..Expectation::default() });
        let says = |p: f64| of(p).beside().unwrap();
        assert_eq!(says(0.95), "expected 0.95, flown 0.60 (0.39 to 0.78): differs by more than the interval");
        assert_eq!(says(0.5), "expected 0.50, flown 0.60 (0.39 to 0.78)");
        assert_eq!([0.3, 0.387, 0.781, 0.8].map(|p| of(p).expected.unwrap().differs), [true, false, false, true]);
        let whole = Part { count: 9, of: 9, interval: [0.7, 1.0 - 1e-16] };
        assert!(!Expectation { probability: Some(1.0), ..Expectation::default() }.against(&whole).differs);
    }

    #[test]
    fn what_is_not_known_says_why_and_what_was_never_asked_says_nothing() {
        let unknown = beside(Expectation::unknown("several sensors are attacked"));
        assert_eq!(unknown.beside().unwrap(), "expected: not known, several sensors are attacked");
        assert!(!unknown.expected.unwrap().differs);
        // As results were before there was an expectation.
        let old: Condition = serde_json::from_str(r#"{"number":1,"detected":{"count":1,"of":2}}"#).unwrap();
        assert!(old.expected.is_none() && old.beside().is_none());
    }
}

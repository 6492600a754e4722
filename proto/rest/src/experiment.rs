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
//! | `GET …/{id}/plan.toml`, `report.html`, `flights.parquet` | files |
//! | `GET …/{id}/against/{second}` | what the second differs from it in, HTML |

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

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
    /// Flights whose attacked sensors were all excluded; `None` where nothing was attacked.
    pub detected: Option<Part>,
    /// Against the condition it is compared with, flight by flight of the same seed: [`Results::measures`] again.
    pub differences: Vec<Option<Difference>>,
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
    /// 95 % interval of the median.
    pub interval: [f64; 2],
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
    /// Its 95 % interval.
    pub interval: [f64; 2],
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

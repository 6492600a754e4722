//! Recorded flights: `GET /api/v1/flights`, `GET` and `PATCH /api/v1/flights/{id}`.

mod figures;
mod listing;
mod signal;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::command::PlannedAttack;
use crate::ground::Storage;
pub use figures::{AttackEffect, EstimatorError, Figures, Followed};
pub use listing::{Column, Listing, MAX_PAGE, PAGE, finds, page};
pub use signal::{Samples, Signal, Signals, Spectrum};

/// What `GET /api/v1/flights/{id}/frames` is asked for by charts of a long flight as a whole; the ground keeps the answer.
pub const OVERVIEW_KINDS: &str =
    "estimate,control,residuals,truth,height,status,attacks,event,step,description,secure,gains";
/// Stretches of time that it is thinned to: charts are some 700 pixels wide.
pub const OVERVIEW_COLUMNS: u64 = 600;

/// `GET /api/v1/flights`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Flights {
    /// One page, in the order asked for.
    pub flights: Vec<Flight>,
    /// Flights on all pages.
    pub total: u64,
    /// How full the storage is.
    pub storage: Storage,
    /// Is the list whole? Not while the files are still being read after a start.
    pub ready: bool,
}

/// Is everything there that the agent sent?
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Completeness {
    /// It goes on.
    #[default]
    Recording,
    /// Every message of the flight is in the file.
    Complete,
    /// Messages are missing and the agent may still have them.
    Filling,
    /// Messages are missing for good, or the end of the flight was never seen.
    Truncated,
}

impl Completeness {
    /// As JSON and people name it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Recording => "recording",
            Self::Complete => "complete",
            Self::Filling => "filling",
            Self::Truncated => "truncated",
        }
    }
}

/// One setpoint step of a flight.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Step {
    /// Since the start of the flight, s.
    pub start_s: f64,
    /// From, m.
    pub from_m: f64,
    /// To, m.
    pub to_m: f64,
    /// 10 % to 90 %, s.
    pub rise_time_s: Option<f64>,
    /// Overshoot, %.
    pub overshoot_percent: f64,
    /// Into the band for good, s.
    pub settling_time_s: Option<f64>,
    /// Mean error of the last second, m.
    pub steady_error_m: Option<f64>,
    /// The next step began before this one was inside the band.
    pub interrupted: bool,
}

/// One attack of a flight; `start_s` counts from the start of the flight.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FlownAttack {
    /// The attack.
    #[serde(flatten)]
    pub planned: PlannedAttack,
    /// How far it came.
    #[serde(default)]
    pub phase: String,
}

/// One flight: one field for each key of the answer, hence so many.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Flight {
    /// Id, safe as a file name.
    pub id: String,
    /// Given by people.
    pub name: String,
    /// Written by people.
    pub notes: String,
    /// Agent that flew.
    pub vehicle_id: String,
    /// Boot of that agent.
    pub boot_id: u64,
    /// `sim`, `replay` or `hardware`.
    pub vehicle: String,
    /// Rig.
    pub rig: String,
    /// Airframe.
    pub airframe: String,
    /// Seed of the scenario.
    pub seed: u64,
    /// Version of the agent.
    pub agent_version: String,
    /// Start, µs since the Unix epoch, by the agent's clock.
    pub started_unix_us: u64,
    /// Length, s.
    pub duration_s: f64,
    /// Messages in the file.
    pub messages: u64,
    /// Of them, received live by this recording.
    pub live: u64,
    /// Of them, sent again by the agent.
    pub filled: u64,
    /// Messages of the flight that are not in the file.
    pub missing: u64,
    /// First sequence number.
    pub first_sequence: Option<u64>,
    /// Last sequence number; absent while unknown.
    pub last_sequence: Option<u64>,
    /// Is everything there?
    pub completeness: Completeness,
    /// Size of its files, bytes.
    pub size_bytes: u64,
    /// RMS of altitude setpoint minus altitude while altitude was held, m: against truth where the
    /// flight has it, else against the estimate in the loop.
    pub tracking_rms_m: Option<f64>,
    /// Setpoint steps.
    pub steps: Vec<Step>,
    /// Attacks.
    pub attacks: Vec<FlownAttack>,
    /// Messages of each topic.
    pub counts: BTreeMap<String, u64>,
    /// Its altitude at a glance; absent where none is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outline: Option<Outline>,
    /// When the ground's retention deletes it as things are, µs since the Unix epoch; absent where it is kept.
    pub deleted_unix_us: Option<u64>,
    /// The ground that recorded it; absent where no archive is shared.
    pub ground: Option<String>,
    /// Is it only in the archive that grounds share? It is fetched when it is opened.
    pub away: bool,
}

impl Flight {
    /// Its name, or the id where it has none.
    pub fn title(&self) -> &str {
        if self.name.trim().is_empty() { &self.id } else { &self.name }
    }
}

/// The altitude of a flight, for a picture of some hundred pixels: true where truth is recorded, else as estimated in the
/// loop.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Outline {
    /// Where the first stretch of time begins, s since the start of the flight.
    pub from_s: f64,
    /// How long each is, s.
    pub step_s: f64,
    /// Least and greatest altitude of each, cm; absent where nothing is known.
    pub altitude_cm: Vec<Option<[i32; 2]>>,
}

/// One of `GET /api/v1/archive/due`: a flight that retention will delete.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Due {
    /// Its id.
    pub id: String,
    /// Size of its files, bytes.
    pub bytes: u64,
    /// Which limit it is beyond.
    pub why: String,
    /// From when on it is deleted, µs since the Unix epoch; absent until it has been told to be due.
    pub deleted_unix_us: Option<u64>,
}

/// `PATCH /api/v1/flights/{id}`; what is absent stays.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Labels {
    /// Its name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Notes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
}

/// `POST /api/v1/flights`: a recording from elsewhere is a flight now.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Imported {
    /// Its id among the flights.
    pub flight: String,
    /// It was here already, and nothing was changed.
    pub already: bool,
    /// What one should know of it: what was repaired, rows skipped, sensors left out.
    pub notes: Vec<String>,
}

/// `GET /api/v1/flights/{id}/estimate`: the curves of a recording estimated again, columns of equal length. Beside them the
/// answer has the estimator and its score, as the agent's own command prints it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Curves {
    /// Flight time, s.
    pub time_s: Vec<f64>,
    /// Altitude, m; absent where the estimator knows none.
    pub altitude_m: Vec<Option<f32>>,
    /// Roll, rad.
    pub roll_rad: Vec<Option<f32>>,
    /// Pitch, rad.
    pub pitch_rad: Vec<Option<f32>>,
    /// Yaw, rad.
    pub yaw_rad: Vec<Option<f32>>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_are_read_with_whatever_is_absent() {
        let text = r#"{"flights":[{"id":"a","name":"","duration_s":42.5,"completeness":"complete","seed":7,
            "steps":[{"start_s":1,"from_m":0.5,"to_m":0.8,"rise_time_s":null,"overshoot_percent":3.0}],
            "counts":{"/estimate/1":1234},"new_field":1}],"storage":{"used_bytes":10,"free_bytes":20,"flights":1}}"#;
        let flights: Flights = serde_json::from_str(text).unwrap();
        let flight = &flights.flights[0];
        assert_eq!((flight.title(), flight.completeness), ("a", Completeness::Complete));
        assert_eq!(flight.steps[0].rise_time_s, None);
        assert_eq!(flight.counts["/estimate/1"], 1234);
        for state in [Completeness::Recording, Completeness::Complete, Completeness::Filling, Completeness::Truncated] {
            assert_eq!(serde_json::to_value(state).unwrap(), state.name());
        }
    }
}

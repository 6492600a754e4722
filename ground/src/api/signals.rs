//! Signals of a recorded flight: what there is, one of them over time, its spectrum. Read in turn with everything that
//! computes; given up when nobody waits for it any more.

use axum::Json;
use axum::extract::State;
use plumbline_analysis::offline::spectrum::{folded_hz, welch};
use plumbline_rest::flight::{Samples, Signals, Spectrum};
use serde::Deserialize;

use super::App;
use super::compute::Waited;
use super::error::ApiError;
use super::extract::{Path, Query};
use crate::recorder::{SignalReader, thinned};

/// Stretches of time, where nothing is said, and at most.
const COLUMNS: usize = 1000;
const MAX_COLUMNS: usize = 10_000;
/// Multiples of the rotors' speed that are marked.
const HARMONICS: u32 = 4;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Asked {
    name: String,
    from_s: Option<f64>,
    to_s: Option<f64>,
    columns: Option<usize>,
}

impl Asked {
    fn range_s(&self) -> (f64, f64) {
        (self.from_s.unwrap_or(0.0), self.to_s.unwrap_or(f64::INFINITY))
    }

    fn read(&self, flight: &SignalReader, waited: &Waited) -> Result<Vec<(f64, f64)>, ApiError> {
        let samples = flight.read(&self.name, self.range_s(), || waited.check().is_ok())?;
        waited.check()?;
        Ok(samples)
    }
}

pub(crate) async fn list(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Signals>, ApiError> {
    let recorder = app.recorder.clone();
    let work = move |_: &Waited| {
        let flight = SignalReader::open(recorder.open(&id)?)?;
        Ok(Signals { start_s: flight.start_s(), signals: flight.list()? })
    };
    Ok(Json(app.computing.run(work).await?))
}

pub(crate) async fn samples(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Samples>, ApiError> {
    let columns = asked.columns.unwrap_or(COLUMNS);
    if !(1..=MAX_COLUMNS).contains(&columns) {
        return Err(ApiError::Invalid(format!("columns {columns} is outside 1 to {MAX_COLUMNS}")));
    }
    let recorder = app.recorder.clone();
    let work = move |waited: &Waited| {
        let all = asked.read(&SignalReader::open(recorder.open(&id)?)?, waited)?;
        let (time_s, value) = thinned(&all, columns).into_iter().unzip();
        Ok(Samples { samples: all.len() as u64, time_s, value })
    };
    Ok(Json(app.computing.run(work).await?))
}

pub(crate) async fn spectrum(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Spectrum>, ApiError> {
    if asked.columns.is_some() {
        return Err(ApiError::Invalid("a spectrum has no columns: name, from_s and to_s only".into()));
    }
    let recorder = app.recorder.clone();
    let work = move |waited: &Waited| {
        let flight = SignalReader::open(recorder.open(&id)?)?;
        let samples = asked.read(&flight, waited)?;
        let short = || ApiError::Invalid(format!("{} samples without a gap are too few for a spectrum", samples.len()));
        let found = welch(&samples).ok_or_else(short)?;
        let rotor_hz = flight.rotor_hz(asked.range_s())?;
        let harmonics = (1..=HARMONICS).filter_map(|n| Some(folded_hz(rotor_hz? * f64::from(n), found.rate_hz)));
        Ok(Spectrum {
            rate_hz: found.rate_hz,
            windows: found.windows as u64,
            harmonics_hz: harmonics.collect(),
            frequency_hz: found.frequency_hz,
            density: found.density,
            rotor_hz,
        })
    };
    Ok(Json(app.computing.run(work).await?))
}

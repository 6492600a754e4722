//! Signals of a recorded flight: what there is, one of them over time, its spectrum, and what a report says of all. Read in turn with everything that
//! computes; given up when nobody waits for it any more. The same of a vehicle that flies, from what the hub keeps of the last
//! two minutes; times are flight times there.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use plumbline_analysis::offline::spectrum::{folded_hz, welch};
use plumbline_proto::codec::{self, Frame};
use plumbline_rest::flight::{Figures, Samples, Signals, Spectrum};
use serde::Deserialize;

use super::App;
use super::compute::Waited;
use super::error::ApiError;
use super::extract::{Path, Query};
use crate::hub::{MAX_HISTORY_SECONDS, Shared};
use crate::recorder::{self, SignalReader, live_signal, thinned};

/// Stretches of time, where nothing is said, and at most.
const COLUMNS: usize = 1000;
const MAX_COLUMNS: usize = 10_000;
/// What a vehicle sends is looked for in so long, s.
const LOOK_S: f64 = 2.0;
/// So much more of the past than was asked for is read, s.
const SLACK_S: f64 = 1.0;
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

    fn columns(&self) -> Result<usize, ApiError> {
        let columns = self.columns.unwrap_or(COLUMNS);
        if (1..=MAX_COLUMNS).contains(&columns) {
            return Ok(columns);
        }
        Err(ApiError::Invalid(format!("columns {columns} is outside 1 to {MAX_COLUMNS}")))
    }

    fn no_columns(&self) -> Result<(), ApiError> {
        let refused = || ApiError::Invalid("a spectrum has no columns: name, from_s and to_s only".into());
        if self.columns.is_some() { Err(refused()) } else { Ok(()) }
    }

    /// Flight times, µs.
    fn range_us(&self) -> Result<(u64, u64), ApiError> {
        let (from_s, to_s) = self.range_s();
        if from_s.is_nan() || to_s.is_nan() || from_s > to_s {
            return Err(ApiError::Invalid(format!("from_s {from_s} to to_s {to_s} is no range of time")));
        }
        Ok(((from_s * 1e6).ceil() as u64, (to_s * 1e6).floor() as u64))
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
    let columns = asked.columns()?;
    let recorder = app.recorder.clone();
    let work = move |waited: &Waited| {
        let all = asked.read(&SignalReader::open(recorder.open(&id)?)?, waited)?;
        Ok(told(&all, columns))
    };
    Ok(Json(app.computing.run(work).await?))
}

pub(crate) async fn spectrum(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Spectrum>, ApiError> {
    asked.no_columns()?;
    let recorder = app.recorder.clone();
    let work = move |waited: &Waited| {
        let flight = SignalReader::open(recorder.open(&id)?)?;
        let samples = asked.read(&flight, waited)?;
        spectrum_of(&samples, flight.rotor_hz(asked.range_s())?)
    };
    Ok(Json(app.computing.run(work).await?))
}

pub(crate) async fn figures(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Figures>, ApiError> {
    let recorder = app.recorder.clone();
    let work = move |waited: &Waited| {
        let found = recorder::figures(recorder.open(&id)?, || waited.check().is_ok())?;
        waited.check()?;
        Ok(found)
    };
    Ok(Json(app.computing.run(work).await?))
}

/// Samples, thinned to so many stretches of time.
fn told(all: &[(f64, f64)], columns: usize) -> Samples {
    let (time_s, value) = thinned(all, columns).into_iter().unzip();
    Samples { samples: all.len() as u64, time_s, value }
}

fn spectrum_of(samples: &[(f64, f64)], rotor_hz: Option<f64>) -> Result<Spectrum, ApiError> {
    let short = || ApiError::Invalid(format!("{} samples without a gap are too few for a spectrum", samples.len()));
    let found = welch(samples).ok_or_else(short)?;
    let harmonics = (1..=HARMONICS).filter_map(|n| Some(folded_hz(rotor_hz? * f64::from(n), found.rate_hz)));
    let mean_of = |of: &dyn Fn(f64) -> f64| samples.iter().map(|(_, x)| of(*x)).sum::<f64>() / samples.len() as f64;
    let mean = mean_of(&|x| x);
    Ok(Spectrum {
        mean,
        rms: mean_of(&|x| (x - mean).powi(2)).sqrt(),
        rate_hz: found.rate_hz,
        windows: found.windows as u64,
        harmonics_hz: harmonics.collect(),
        frequency_hz: found.frequency_hz,
        density: found.density,
        rotor_hz,
    })
}

pub(crate) async fn live_list(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Signals>, ApiError> {
    let work = |past: &[Shared]| Ok(Signals { start_s: 0.0, signals: live_signal::list(frames(past)) });
    Ok(Json(of_past(&app, &id, |_| LOOK_S, work).await?))
}

pub(crate) async fn live_samples(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Samples>, ApiError> {
    let (columns, range_us) = (asked.columns()?, asked.range_us()?);
    let work = move |past: &[Shared]| {
        let all = live_signal::samples(&asked.name, range_us, frames(past))?;
        Ok(told(&all, columns))
    };
    Ok(Json(of_past(&app, &id, since(range_us.0), work).await?))
}

pub(crate) async fn live_spectrum(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Spectrum>, ApiError> {
    asked.no_columns()?;
    let range_us = asked.range_us()?;
    let work = move |past: &[Shared]| {
        let samples = live_signal::samples(&asked.name, range_us, frames(past))?;
        spectrum_of(&samples, live_signal::rotor_hz(range_us, frames(past)))
    };
    Ok(Json(of_past(&app, &id, since(range_us.0), work).await?))
}

/// How long ago a flight time was, s, when another is the newest, and a little more: of a recording that is flown again time may
/// stand still.
fn since(from_us: u64) -> impl FnOnce(u64) -> f64 {
    move |newest_us| newest_us.saturating_sub(from_us) as f64 / 1e6 + SLACK_S
}

/// Reads what the hub keeps of the last `seconds`, said by the newest flight time, µs; in turn with other such work.
async fn of_past<T: Send + 'static>(
    app: &App,
    id: &str,
    seconds: impl FnOnce(u64) -> f64,
    work: impl FnOnce(&[Shared]) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let _turn = app.thinning.acquire().await.map_err(|_| ApiError::Unavailable("the ground is stopping".into()))?;
    // Only now: whoever waited would else be given too little.
    let seconds = seconds(app.hub.link_status(id).map_or(0, |link| link.newest_time_us));
    let past = app.hub.past(id, Duration::from_secs_f64(seconds.clamp(0.0, MAX_HISTORY_SECONDS as f64)))?;
    tokio::task::spawn_blocking(move || work(&past)).await.map_err(|e| ApiError::Broken(e.to_string()))?
}

/// The messages of batches.
pub(super) fn frames(past: &[Shared]) -> impl Iterator<Item = Frame<'_>> {
    past.iter().filter_map(|shared| codec::decode_batch(&shared.batch).ok()).flatten().map_while(Result::ok)
}

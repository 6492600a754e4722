//! Calibrations: fitted by the agent's library from a flight or an uploaded table, and kept.
//!
//! `POST /api/v1/calibrations` with
//! ```json
//! { "kind": "magnetometer", "flight": "20260131T120000-iris-1-1", "imu": 1, "from_s": 5.0, "to_s": 60.0 }
//! { "kind": "thrust", "csv": "rpm,thrust_n\n3000,1.6\n…", "name": "bench.csv" }
//! ```
//! `kind`: accelerometer, gyroscope, magnetometer, thermal, motor-curve, thrust, mass, allan. Exactly one of `flight`
//! and `csv` (columns: `agent/src/offline/table.rs`). Optional: `imu` (from 1), `from_s`, `to_s` (flight time),
//! `first_half`, `gravity_mps2`, `propeller` (a tunnel's table), `air_density_kgpm3`, `accelerometer` (id of a kept
//! calibration, for a gyroscope). Answer 201: the file (`agent/src/calibration/file.rs`) with its `id`:
//! ```json
//! { "id": "magnetometer-20260131T120000Z", "schema": 1, "kind": "magnetometer", "date": "…", "input": "…",
//!   "sensor": 1, "span_s": [5.0, 60.0], "samples": 1109, "residual": { "value": 0.6, "unit": "µT" },
//!   "parameters": [ { "name": "hard_x", "value": -1.4, "sigma": 0.3, "unit": "µT" } ], "covariance": [[…]],
//!   "notes": ["14 of 18 sectors of the sphere seen"],
//!   "picture": [ { "title": "Field in x and y", "x": "µT", "y": "µT", "log": false, "series": [
//!       { "name": "before", "line": false, "points": [[1.0, 2.0]] } ] } ] }
//! ```
//! or 422 `{ "error": "magnetometer calibration refused: 3 of 18 sectors of the sphere seen (turn the vehicle about all
//! axes), at least 9 are needed" }`. `GET /api/v1/calibrations` → `{ "calibrations": [ … ] }`, newest first, without
//! covariance and picture; `GET /api/v1/calibrations/ID` → the whole file. On disk: `calibrations/ID.json`, as the
//! agent's `calibrations = […]` takes it.

use std::time::Duration;

use axum::Json;
use axum::body::{Bytes, to_bytes};
use axum::extract::{Path, Request as HttpRequest, State};
use axum::http::StatusCode;
use plumbline_agent::calibration::{CalibrationFile, Kind};
use plumbline_agent::offline::calibrate::{CalibrateError, Request, from_recording, from_table, iso_8601};
use plumbline_agent::recordings;
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::body::number;
use super::compute::Waited;
use super::error::ApiError;
use crate::calibrations::{Calibrations, with_id};
use crate::recorder::RecorderHandle;
use crate::sync::wall_time_us;

/// Largest table: half an hour of one IMU at 200 Hz as text.
pub(crate) const MAX_TABLE: usize = 64 << 20;
/// Longest time that its upload may take, once it is its turn.
const UPLOAD_WITHIN: Duration = Duration::from_secs(60);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    kind: String,
    flight: Option<String>,
    csv: Option<String>,
    name: Option<String>,
    imu: Option<usize>,
    #[serde(default, deserialize_with = "number")]
    from_s: Option<f64>,
    #[serde(default, deserialize_with = "number")]
    to_s: Option<f64>,
    #[serde(default)]
    first_half: bool,
    #[serde(default, deserialize_with = "number")]
    gravity_mps2: Option<f64>,
    propeller: Option<String>,
    #[serde(default, deserialize_with = "number")]
    air_density_kgpm3: Option<f64>,
    accelerometer: Option<String>,
}

impl Asked {
    fn request(&self, kept: &Calibrations) -> Result<Request, ApiError> {
        let kind = Kind::by_name(&self.kind).map_err(|e| ApiError::Invalid(e.to_string()))?;
        let standard = Request::new(kind, iso_8601(wall_time_us() / 1_000_000));
        let positive = |name: &str, value: Option<f64>, default: f64| match value {
            Some(value) if value <= 0.0 => Err(ApiError::Invalid(format!("{name} is {value}, not above 0"))),
            value => Ok(value.unwrap_or(default)),
        };
        let accelerometer = match &self.accelerometer {
            None => None,
            Some(id) => Some(kept.read(id).ok_or_else(|| unknown(id))?),
        };
        Ok(Request {
            imu: self.imu.unwrap_or(1),
            from_s: self.from_s,
            to_s: self.to_s,
            first_half: self.first_half,
            gravity_mps2: positive("gravity_mps2", self.gravity_mps2, standard.gravity_mps2)?,
            accelerometer,
            propeller: self.propeller.clone(),
            air_density_kgpm3: positive("air_density_kgpm3", self.air_density_kgpm3, standard.air_density_kgpm3)?,
            ..standard
        })
    }

    fn fit(self, request: &Request, recorder: &RecorderHandle, waited: &Waited) -> Result<CalibrationFile, ApiError> {
        match (&self.flight, self.csv) {
            (Some(id), None) => {
                let bytes = recorder.open(id)?.bytes();
                let bytes = bytes.map_err(|e| ApiError::Broken(format!("{}: {e}", crate::names::clip(id))))?;
                waited.check()?;
                let recording = recordings::open_flight(&bytes, std::path::Path::new(id));
                let recording = recording.map_err(|e| ApiError::Invalid(e.to_string()))?;
                from_recording(recording, id, request).map_err(refused)
            }
            (None, Some(text)) => {
                let name = self.name.as_deref().map_or_else(|| "uploaded.csv".to_owned(), crate::names::clip);
                // Read to its end and gone before anything is fitted.
                from_table(waited.reading(std::io::Cursor::new(text)), &name, request).map_err(refused)
            }
            _ => Err(ApiError::Invalid("one of flight and csv, not both and not neither".into())),
        }
    }
}

fn unknown(id: &str) -> ApiError {
    ApiError::NotFound(format!("there is no calibration {:?}", crate::names::clip(id)))
}

fn refused(error: CalibrateError) -> ApiError {
    match error {
        CalibrateError::Io { .. } => ApiError::Broken(error.to_string()),
        other => ApiError::Invalid(other.to_string()),
    }
}

/// Runs `work`, which reads the disk and computes for up to seconds, off the server's threads.
async fn aside<T: Send + 'static>(work: impl FnOnce() -> Result<T, ApiError> + Send + 'static) -> Result<T, ApiError> {
    tokio::task::spawn_blocking(work).await.map_err(|error| ApiError::Broken(error.to_string()))?
}

pub(crate) async fn create(
    State(app): State<App>,
    request: HttpRequest,
) -> Result<(StatusCode, Json<Value>), ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    let recorder = app.recorder.clone();
    // A table waits outside until it is its turn: only so many are in memory at a time.
    let answer = app.uploads.after(upload(request), move |bytes, waited| {
        let asked: Asked = serde_json::from_slice(&bytes).map_err(|e| ApiError::Invalid(e.to_string()))?;
        drop(bytes);
        let wanted = asked.request(&kept)?;
        let file = asked.fit(&wanted, &recorder, waited)?;
        waited.check()?;
        let id = kept.keep(&file).map_err(|e| ApiError::Broken(format!("calibrations: {e}")))?;
        Ok(with_id(&id, file.to_value()))
    });
    Ok((StatusCode::CREATED, Json(answer.await?)))
}

async fn upload(request: HttpRequest) -> Result<Bytes, ApiError> {
    let body = tokio::time::timeout(UPLOAD_WITHIN, to_bytes(request.into_body(), MAX_TABLE)).await;
    let slow = || ApiError::Invalid(format!("the table did not come within {} s", UPLOAD_WITHIN.as_secs()));
    body.map_err(|_| slow())?.map_err(|_| ApiError::TooLarge(format!("the body is larger than {MAX_TABLE} bytes")))
}

pub(crate) async fn list(State(app): State<App>) -> Result<Json<Value>, ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    Ok(Json(json!({ "calibrations": aside(move || Ok(kept.list())).await? })))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Value>, ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    let answer = aside(move || Ok(with_id(&id, kept.read(&id).ok_or_else(|| unknown(&id))?.to_value())));
    Ok(Json(answer.await?))
}

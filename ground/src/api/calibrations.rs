//! Calibrations: fitted by the agent's library from a flight or an uploaded table, and kept.
//!
//! Asked and answered as [`plumbline_rest::calibration`] says; 201 is the file that was fitted, 422 tells why none was:
//! "magnetometer calibration refused: 3 of 18 sectors of the sphere seen (turn the vehicle about all axes), at least 9 are
//! needed". Columns of a table: `plumbline_analysis::offline::table`. On disk: `calibrations/ID.json`, as the agent's
//! `calibrations = […]` takes it.

use std::time::Duration;

use axum::Json;
use axum::body::{Bytes, to_bytes};
use axum::extract::{Request as HttpRequest, State};
use axum::http::StatusCode;
use plumbline_analysis::offline::calibrate::{
    CalibrateError, Request, from_recording, from_samples, from_table, iso_8601,
};
use plumbline_analysis::recordings;
use plumbline_core::calibration::{CalibrationFile, Kind};
use plumbline_proto::time::WallTime;
use plumbline_proto::v1::{self, command};
use plumbline_rest::calibration::{self as rest, Calibration, Fit};

use super::App;
use super::body::Body;
use super::compute::Waited;
use super::control::{Answer, send};
use super::error::ApiError;
use super::extract::{Page, Path, Query};
use super::operator::Operator;
use crate::calibrations::{self, Calibrations};
use crate::sync::wall_time_us;

/// Largest table: half an hour of one IMU at 200 Hz as text.
pub(crate) const MAX_TABLE: usize = 64 << 20;
/// Longest time that its upload may take, once it is its turn.
const UPLOAD_WITHIN: Duration = Duration::from_secs(60);

fn request(asked: &Fit, kept: &Calibrations) -> Result<Request, ApiError> {
    let kind = Kind::by_name(&asked.kind).map_err(|e| ApiError::Invalid(e.to_string()))?;
    let standard = Request::new(kind, iso_8601(WallTime(wall_time_us())));
    let positive = |name: &str, value: Option<f64>, default: f64| match value {
        Some(value) if value <= 0.0 => Err(ApiError::Invalid(format!("{name} is {value}, not above 0"))),
        value => Ok(value.unwrap_or(default)),
    };
    let accelerometer = match &asked.accelerometer {
        None => None,
        Some(id) => Some(kept.read(id).ok_or_else(|| unknown(id))?),
    };
    Ok(Request {
        imu: asked.imu.unwrap_or(1),
        from_s: asked.from_s,
        to_s: asked.to_s,
        first_half: asked.first_half,
        gravity_mps2: positive("gravity_mps2", asked.gravity_mps2, standard.gravity_mps2)?,
        accelerometer,
        propeller: asked.propeller.clone(),
        air_density_kgpm3: positive("air_density_kgpm3", asked.air_density_kgpm3, standard.air_density_kgpm3)?,
        ..standard
    })
}

fn fit(asked: Fit, request: &Request, app: &App, waited: &Waited) -> Result<CalibrationFile, ApiError> {
    match (&asked.flight, asked.csv, &asked.vehicle) {
        (Some(id), None, None) => {
            let bytes = app.recorder.open(id)?.bytes();
            let bytes = bytes.map_err(|e| ApiError::Broken(format!("{}: {e}", crate::names::clip(id))))?;
            waited.check()?;
            let recording = recordings::open_flight(&bytes, std::path::Path::new(id));
            let recording = recording.map_err(|e| ApiError::Invalid(e.to_string()))?;
            from_recording(recording, id, request).map_err(refused)
        }
        (None, Some(text), None) => {
            let name = asked.name.as_deref().map_or_else(|| "uploaded.csv".to_owned(), crate::names::clip);
            // Read to its end and gone before anything is fitted.
            from_table(waited.reading(std::io::Cursor::new(text)), &name, request).map_err(refused)
        }
        (None, None, Some(vehicle)) => {
            let (imu, samples) = app.guided.taken(vehicle, request.kind)?;
            let request = Request { imu, ..request.clone() };
            from_samples(samples, &format!("{vehicle}, by hand"), &request).map_err(refused)
        }
        _ => Err(ApiError::Invalid("one of flight, csv and vehicle, not several and not none".into())),
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
    body: HttpRequest,
) -> Result<(StatusCode, Json<Calibration>), ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    let reached = app.clone();
    // A table waits outside until it is its turn: only so many are in memory at a time.
    let answer = app.uploads.after(upload(body), move |bytes, waited| {
        let asked: Fit = serde_json::from_slice(&bytes).map_err(|e| ApiError::Invalid(e.to_string()))?;
        drop(bytes);
        let wanted = request(&asked, &kept)?;
        let file = fit(asked, &wanted, &reached, waited)?;
        waited.check()?;
        let id = kept.keep(&file).map_err(|e| ApiError::Broken(format!("calibrations: {e}")))?;
        Ok(calibrations::answer(&id, file))
    });
    Ok((StatusCode::CREATED, Json(answer.await?)))
}

async fn upload(request: HttpRequest) -> Result<Bytes, ApiError> {
    let body = tokio::time::timeout(UPLOAD_WITHIN, to_bytes(request.into_body(), MAX_TABLE)).await;
    let slow = || ApiError::Invalid(format!("the table did not come within {} s", UPLOAD_WITHIN.as_secs()));
    body.map_err(|_| slow())?.map_err(|_| ApiError::TooLarge(format!("the body is larger than {MAX_TABLE} bytes")))
}

pub(crate) async fn list(
    State(app): State<App>,
    Query(page): Query<Page>,
) -> Result<Json<rest::Calibrations>, ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    let all = aside(move || Ok(kept.list())).await?;
    let (calibrations, total) = page.of(all, |c| format!("{} {} {} {}", c.id, c.kind, c.date, c.input))?;
    Ok(Json(rest::Calibrations { calibrations, total }))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Calibration>, ApiError> {
    let kept = Calibrations::open(&app.config.data_folder);
    let answer = aside(move || Ok(calibrations::answer(&id, kept.read(&id).ok_or_else(|| unknown(&id))?)));
    Ok(Json(answer.await?))
}

/// Gives the vehicle what an agent reads of a file; what is for people stays here.
pub(crate) async fn put_to_use(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Using>,
) -> Answer {
    let kept = Calibrations::open(&app.config.data_folder);
    let name = asked.calibration;
    let file = aside(move || kept.read(&name).ok_or_else(|| unknown(&name))).await?;
    let file = CalibrationFile { covariance: Vec::new(), picture: Vec::new(), ..file };
    let body = command::Body::UseCalibration(v1::UseCalibration { file: file.to_value().to_string() });
    send(&app, &id, &who, body).await
}

pub(crate) async fn stop_using(
    State(app): State<App>,
    Path((id, kind, imu)): Path<(String, String, u32)>,
    who: Operator,
) -> Answer {
    let kind = Kind::by_name(&kind).map_err(|e| ApiError::Invalid(e.to_string()))?.name().to_owned();
    send(&app, &id, &who, command::Body::DropCalibration(v1::DropCalibration { kind, imu })).await
}

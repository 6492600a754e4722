//! Recorded flights: list, read, annotate, delete, download.

use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plumbline_rest::flight::{Flights, Labels};
use serde::Deserialize;

use super::App;
use super::body::Body;
use super::download;
use super::error::ApiError;
use super::operator::Operator;
use crate::recorder::{Export, Flight, RecordingError};

/// Runs `work`, which waits for the disk, off the server's threads.
async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, RecordingError> + Send + 'static,
) -> Result<T, ApiError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => Ok(result?),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

pub(crate) async fn list(State(app): State<App>) -> Result<Json<Flights>, ApiError> {
    let recorder = app.recorder.clone();
    // Asked before the list: a list that says it is ready lacks nothing.
    let ready = recorder.ready();
    let (flights, storage) = on_disk(move || Ok((recorder.flights()?, recorder.storage()))).await?;
    Ok(Json(Flights { flights, storage, ready }))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Flight>, ApiError> {
    let recorder = app.recorder.clone();
    Ok(Json(on_disk(move || recorder.flight(&id)).await?))
}

pub(crate) async fn annotate(
    State(app): State<App>,
    Path(id): Path<String>,
    Body(labels): Body<Labels>,
) -> Result<Json<Flight>, ApiError> {
    let recorder = app.recorder.clone();
    Ok(Json(on_disk(move || recorder.label(&id, labels.name, labels.notes)).await?))
}

pub(crate) async fn delete(State(app): State<App>, Path(id): Path<String>) -> Result<StatusCode, ApiError> {
    let recorder = app.recorder.clone();
    on_disk(move || recorder.delete(&id)).await?;
    Ok(StatusCode::NO_CONTENT)
}

pub(crate) async fn mcap(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let name = attachment(&id, "mcap");
    let flight = on_disk(move || recorder.open(&id)).await?;
    Ok(([name], download::file(flight, &headers, place, app.work.clone())).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Topic {
    topic: Option<String>,
}

pub(crate) async fn csv(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Query(asked): Query<Topic>,
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let name = attachment(&id, "csv");
    let export = on_disk(move || {
        let flight = recorder.open(&id)?;
        match asked.topic {
            Some(topic) => Export::topic(flight, &topic),
            None => Export::wide(flight),
        }
    })
    .await?;
    let kind = [(header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()), name];
    Ok((kind, download::export(place, move |sink| export.write(sink))).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Kinds {
    kinds: Option<String>,
}

pub(crate) async fn frames(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Query(asked): Query<Kinds>,
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let export = on_disk(move || Export::frames(recorder.open(&id)?, asked.kinds.as_deref())).await?;
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((kind, download::export(place, move |sink| export.write(sink))).into_response())
}

fn attachment(id: &str, extension: &str) -> (HeaderName, String) {
    // The id becomes part of a header only where it is a flight id, which is safe.
    let safe = plumbline_proto::ids::FlightId::new(id).map_or_else(|_| "flight".to_owned(), |id| id.to_string());
    (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{safe}.{extension}\""))
}

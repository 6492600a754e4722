//! Recorded flights: list, read, annotate, delete, download.

use axum::Json;
use axum::body::Body as HttpBody;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::mpsc;

use super::App;
use super::body::Body;
use super::error::ApiError;
use crate::recorder::{Export, Flight, RecordingError};

/// Pieces of a download made ahead of the client.
const AHEAD: usize = 8;

/// Runs `work`, which waits for the disk, off the server's threads.
async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, RecordingError> + Send + 'static,
) -> Result<T, ApiError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => Ok(result?),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

pub(crate) async fn list(State(app): State<App>) -> Result<Json<Value>, ApiError> {
    let recorder = app.recorder.clone();
    // Asked before the list: a list that says it is ready lacks nothing.
    let ready = recorder.ready();
    let (flights, storage) = on_disk(move || Ok((recorder.flights()?, recorder.storage()))).await?;
    Ok(Json(json!({ "flights": flights, "storage": storage, "ready": ready })))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Flight>, ApiError> {
    let recorder = app.recorder.clone();
    Ok(Json(on_disk(move || recorder.flight(&id)).await?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Labels {
    name: Option<String>,
    notes: Option<String>,
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

pub(crate) async fn mcap(State(app): State<App>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let recorder = app.recorder.clone();
    let name = attachment(&id, "mcap");
    let (file, length) = on_disk(move || {
        let file = recorder.open(&id)?;
        let length =
            file.metadata().map(|m| m.len()).map_err(|source| RecordingError::Io { path: id.into(), source })?;
        Ok((file, length))
    })
    .await?;
    let body = piecewise(move |sink| {
        let mut file = file;
        loop {
            let mut piece = vec![0; 256 << 10];
            match std::io::Read::read(&mut file, &mut piece) {
                Ok(0) => return Ok(()),
                Ok(got) => {
                    piece.truncate(got);
                    if !sink(piece) {
                        return Ok(());
                    }
                }
                Err(source) => return Err(RecordingError::Io { path: "flight file".into(), source }),
            }
        }
    });
    let kind = [(header::CONTENT_TYPE, "application/octet-stream".to_owned()), name];
    Ok((kind, [(header::CONTENT_LENGTH, length.to_string())], body).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Topic {
    topic: Option<String>,
}

pub(crate) async fn csv(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Topic>,
) -> Result<Response, ApiError> {
    let recorder = app.recorder.clone();
    let name = attachment(&id, "csv");
    let export = on_disk(move || {
        let file = recorder.open(&id)?;
        match asked.topic {
            Some(topic) => Export::topic(file, &topic),
            None => Export::wide(file),
        }
    })
    .await?;
    let kind = [(header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()), name];
    Ok((kind, piecewise(move |sink| export.write(sink))).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Kinds {
    kinds: Option<String>,
}

pub(crate) async fn frames(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Kinds>,
) -> Result<Response, ApiError> {
    let recorder = app.recorder.clone();
    let export = on_disk(move || Export::frames(recorder.open(&id)?, asked.kinds.as_deref())).await?;
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((kind, piecewise(move |sink| export.write(sink))).into_response())
}

fn attachment(id: &str, extension: &str) -> (HeaderName, String) {
    // The id becomes part of a header only where it is a flight id, which is safe.
    let safe = plumbline_proto::ids::FlightId::new(id).map_or_else(|_| "flight".to_owned(), |id| id.to_string());
    (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{safe}.{extension}\""))
}

/// A body that `write` produces on a thread of its own, at most [`AHEAD`] pieces ahead of the client.
fn piecewise(
    write: impl FnOnce(&mut dyn FnMut(Vec<u8>) -> bool) -> Result<(), RecordingError> + Send + 'static,
) -> HttpBody {
    let (sender, receiver) = mpsc::channel::<Result<Vec<u8>, std::io::Error>>(AHEAD);
    tokio::task::spawn_blocking(move || {
        let mut sink = |piece: Vec<u8>| sender.blocking_send(Ok(piece)).is_ok();
        if let Err(error) = write(&mut sink) {
            tracing::error!(%error, "download broke off");
            // The client sees a broken body, not a short one.
            let _ = sender.blocking_send(Err(std::io::Error::other(error.to_string())));
        }
    });
    HttpBody::from_stream(stream::unfold(receiver, |mut receiver| async move {
        receiver.recv().await.map(|piece| (piece, receiver))
    }))
}

//! Recorded flights: list, read, annotate, delete, download.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plumbline_rest::flight::{Flights, Labels, Listing, page};
use serde::Deserialize;

use super::App;
use super::body::Body;
use super::download;
use super::error::ApiError;
use super::extract::{Path, Query, page_limit};
use super::operator::Operator;
use super::tag::{self, Known};
use crate::recorder::{Export, Flight, Format, RecorderHandle, RecordingError, Selection, Snapshot, WRITTEN};
use crate::sync::wall_time_us;

/// Runs `work`, which waits for the disk, off the server's threads.
pub(super) async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, RecordingError> + Send + 'static,
) -> Result<T, ApiError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => Ok(result?),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

pub(crate) async fn list(State(app): State<App>, Query(asked): Query<Listing>) -> Result<Json<Flights>, ApiError> {
    page_limit(asked.limit)?;
    let (recorder, retention) = (app.recorder.clone(), app.retention.clone());
    // Asked before the list: a list that says it is ready lacks nothing.
    let ready = recorder.ready();
    let read = on_disk(move || {
        let (mut flights, total) = page(recorder.flights()?, &asked);
        retention.date(&mut flights, wall_time_us())?;
        Ok((flights, total, recorder.storage()))
    });
    let (flights, total, storage) = read.await?;
    Ok(Json(Flights { flights, total, storage, ready }))
}

/// The flight that `find` has the recorder give, with when it is due for deletion.
async fn one(
    app: &App,
    find: impl FnOnce(&RecorderHandle) -> Result<Flight, RecordingError> + Send + 'static,
) -> Result<Json<Flight>, ApiError> {
    let (recorder, retention) = (app.recorder.clone(), app.retention.clone());
    let read = on_disk(move || {
        let mut flight = find(&recorder)?;
        retention.date(std::slice::from_mut(&mut flight), wall_time_us())?;
        Ok(flight)
    });
    Ok(Json(read.await?))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Flight>, ApiError> {
    one(&app, move |recorder| recorder.flight(&id)).await
}

pub(crate) async fn annotate(
    State(app): State<App>,
    Path(id): Path<String>,
    Body(labels): Body<Labels>,
) -> Result<Json<Flight>, ApiError> {
    one(&app, move |recorder| recorder.label(&id, labels.name, labels.notes)).await
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
    Ok(([name], download::file(flight, &headers, place, app.work.clone())?).into_response())
}

/// What of a flight is put into a table.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Range {
    from_s: Option<f64>,
    to_s: Option<f64>,
    columns: Option<String>,
    rate_hz: Option<f64>,
    /// Every message of one topic instead; CSV only.
    topic: Option<String>,
}

pub(crate) async fn csv(
    app: State<App>,
    id: Path<String>,
    who: Operator,
    asked: Query<Range>,
    known: Known,
) -> Result<Response, ApiError> {
    table(app, id, who, asked, known, Format::Csv).await
}

pub(crate) async fn parquet(
    app: State<App>,
    id: Path<String>,
    who: Operator,
    asked: Query<Range>,
    known: Known,
) -> Result<Response, ApiError> {
    table(app, id, who, asked, known, Format::Parquet).await
}

pub(crate) async fn mat(
    app: State<App>,
    id: Path<String>,
    who: Operator,
    asked: Query<Range>,
    known: Known,
) -> Result<Response, ApiError> {
    table(app, id, who, asked, known, Format::Mat).await
}

pub(crate) async fn ros2(
    app: State<App>,
    id: Path<String>,
    who: Operator,
    asked: Query<Range>,
    known: Known,
) -> Result<Response, ApiError> {
    table(app, id, who, asked, known, Format::Ros2).await
}

pub(crate) async fn foxglove(
    app: State<App>,
    id: Path<String>,
    who: Operator,
    asked: Query<Range>,
    known: Known,
) -> Result<Response, ApiError> {
    table(app, id, who, asked, known, Format::Foxglove).await
}

async fn table(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Query(asked): Query<Range>,
    known: Known,
    format: Format,
) -> Result<Response, ApiError> {
    let what = format!("{format:?} {asked:?}");
    let standard = Selection::default();
    let selection = Selection {
        from_s: asked.from_s.unwrap_or(standard.from_s),
        to_s: asked.to_s.unwrap_or(standard.to_s),
        columns: asked.columns.map_or_else(Vec::new, |names| names.split(',').map(str::to_owned).collect()),
        rate_hz: asked.rate_hz.unwrap_or(standard.rate_hz),
    };
    if asked.topic.is_some() && (format != Format::Csv || selection != standard) {
        return Err(ApiError::Invalid("topic is for CSV alone, without from_s, to_s, columns and rate_hz".into()));
    }
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let name = attachment(&id, format.ending());
    let made = on_disk(move || {
        let flight = recorder.open(&id)?;
        let tag = tag_of(&flight, &what);
        let export = match asked.topic {
            Some(topic) => Export::topic(flight, &topic),
            None => Export::wide(flight, selection, format),
        };
        Ok((export?, tag))
    });
    let (export, tag) = made.await?;
    if known.has(&tag) {
        return Ok(tag::unchanged(tag));
    }
    let kind = match format {
        Format::Csv => "text/csv; charset=utf-8",
        Format::Parquet => "application/vnd.apache.parquet",
        Format::Mat => "application/x-matlab-data",
        Format::Ros2 | Format::Foxglove => "application/octet-stream",
    };
    let kind = [(header::CONTENT_TYPE, kind.to_owned()), (header::ETAG, tag), name];
    Ok((kind, download::export(place, move |sink| export.write(sink))).into_response())
}

/// Says which flight an export is of, what of it, and by which program.
fn tag_of(flight: &Snapshot, what: &str) -> String {
    tag::of(format!("{} {what} {WRITTEN}", flight.tag()).as_bytes())
}

/// Which of a flight's messages.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Messages {
    kinds: Option<String>,
    from_s: Option<f64>,
    to_s: Option<f64>,
    /// What charts so many columns wide show, instead of every message.
    columns: Option<u64>,
}

pub(crate) async fn frames(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Query(asked): Query<Messages>,
    known: Known,
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let made = on_disk(move || {
        let flight = recorder.open(&id)?;
        let tag = tag_of(&flight, &format!("frames {asked:?}"));
        let range_s = (asked.from_s.unwrap_or(0.0), asked.to_s.unwrap_or(f64::INFINITY));
        Ok((Export::frames(flight, asked.kinds.as_deref(), range_s, asked.columns)?, tag))
    });
    let (export, tag) = made.await?;
    if known.has(&tag) {
        return Ok(tag::unchanged(tag));
    }
    let kind = [(header::CONTENT_TYPE, "application/octet-stream".to_owned()), (header::ETAG, tag)];
    Ok((kind, download::export(place, move |sink| export.write(sink))).into_response())
}

fn attachment(id: &str, extension: &str) -> (HeaderName, String) {
    // The id becomes part of a header only where it is a flight id, which is safe.
    let safe = plumbline_proto::ids::FlightId::new(id).map_or_else(|_| "flight".to_owned(), |id| id.to_string());
    (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{safe}.{extension}\""))
}

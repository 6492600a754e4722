//! Many flights at once: one tar of them, and those that retention will delete.

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{AppendHeaders, IntoResponse as _, Response};
use plumbline_rest::flight::Due;
use serde::Deserialize;

use super::App;
use super::error::ApiError;
use super::extract::Query;
use super::flights::on_disk;
use super::tag::{self, Known};
use super::{download, operator::Operator};
use crate::recorder::WRITTEN;
use crate::recorder::archive::Tar;
use crate::sync::wall_time_us;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Which {
    ids: String,
    format: Option<String>,
}

pub(crate) async fn tar(
    State(app): State<App>,
    who: Operator,
    Query(Which { ids, format }): Query<Which>,
    known: Known,
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let made = on_disk(move || {
        let tar = Tar::new(recorder, &ids, format.as_deref())?;
        let flights = tar.tag()?;
        let text = |flights| format!("tar {format:?} {flights} {WRITTEN}");
        Ok((tar, flights.map(|flights| tag::of(text(flights).as_bytes()))))
    });
    let (tar, tag) = made.await?;
    if let Some(tag) = tag.as_ref().filter(|tag| known.has(tag)) {
        return Ok(tag::unchanged(tag.clone()));
    }
    let kind = [
        (header::CONTENT_TYPE, "application/x-tar"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"flights.tar\""),
    ];
    let tag = tag.map(|tag| AppendHeaders([(header::ETAG, tag)]));
    Ok((kind, tag, download::export(place, move |sink| tar.write(sink))).into_response())
}

pub(crate) async fn due(State(app): State<App>) -> Result<Json<Vec<Due>>, ApiError> {
    let retention = app.retention.clone();
    Ok(Json(on_disk(move || retention.due(wall_time_us())).await?))
}

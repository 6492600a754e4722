//! Many flights at once: one tar of them, and those that retention will delete.

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse as _, Response};
use plumbline_rest::flight::Due;
use serde::Deserialize;

use super::App;
use super::error::ApiError;
use super::extract::Query;
use super::flights::on_disk;
use super::{download, operator::Operator};
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
) -> Result<Response, ApiError> {
    let place = app.downloads.begin(who.name())?;
    let recorder = app.recorder.clone();
    let tar = on_disk(move || Tar::new(recorder, &ids, format.as_deref())).await?;
    let kind = [
        (header::CONTENT_TYPE, "application/x-tar"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"flights.tar\""),
    ];
    Ok((kind, download::export(place, move |sink| tar.write(sink))).into_response())
}

pub(crate) async fn due(State(app): State<App>) -> Result<Json<Vec<Due>>, ApiError> {
    let retention = app.retention.clone();
    Ok(Json(on_disk(move || retention.due(wall_time_us())).await?))
}

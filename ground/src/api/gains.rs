//! `GET` shows the gains in use and every revision; `PUT` pushes new weights.

use axum::Json;
use axum::extract::{Path, State};
use plumbline_proto::Kind;
use plumbline_proto::v1::{self, command};
use serde_json::{Value, json};

use super::App;
use super::body::Body;
use super::control::{Answer, answer};
use super::error::ApiError;
use super::operator::Operator;
use crate::gains_book::Weights;
use crate::hub::VehicleError;
use crate::names::JsonName;
use crate::sync::wall_time_us;

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Value>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    let in_use: Option<v1::GainsInUse> = app.hub.latest(&id, Kind::Gains);
    let weights = in_use.as_ref().and_then(|g| g.weights.clone());
    let k = in_use.as_ref().and_then(|g| g.k.as_ref());
    Ok(Json(json!({
        "state_weight": weights.as_ref().map(|w| &w.state_weight),
        "input_weight": weights.as_ref().map(|w| &w.input_weight),
        "revision": in_use.as_ref().map(|g| g.revision),
        "sha256": in_use.as_ref().map(|g| &g.sha256),
        "controller": in_use.as_ref().map(|g| &g.controller),
        "slowest_pole_per_s": in_use.as_ref().map(|g| g.slowest_pole_per_s),
        "k": k.map(|k| json!({ "rows": k.rows, "columns": k.columns, "values": k.values })),
        "revisions": app.gains.revisions(&id),
    })))
}

pub(crate) async fn push(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(weights): Body<Weights>,
) -> Answer {
    let checked = weights.check().map_err(ApiError::Invalid)?;
    let sender = app.controlled(&id, &who)?;
    let in_use = app.hub.latest::<v1::GainsInUse>(&id, Kind::Gains).map_or(0, |gains| gains.revision);
    let revision = app.gains.begin(&id, in_use, weights, who.name(), wall_time_us());
    let body = command::Body::PushGains(v1::PushGains { revision, weights: Some(checked) });
    let ack = app.command(&id, &sender, &who, body).await?;
    app.gains.answered(&id, revision, &v1::AckStage::json_name_of(ack.stage), &ack.reason);
    let (status, Json(mut body)) = answer(&ack);
    if let Some(body) = body.as_object_mut() {
        body.insert("revision".into(), revision.into());
    }
    Ok((status, Json(body)))
}

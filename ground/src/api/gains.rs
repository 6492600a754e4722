//! Gains of a vehicle, as JSON of the agent's own reader (`plumbline_agent::design::file`).
//!
//! - `GET …/gains`: those in use and every revision.
//! - `PUT …/gains`: pushes a design, or exported gains; the agent solves, examines, applies or refuses.
//! - `GET …/gains/export`: those in use as a file, with units and certificate; `?revision=N` an earlier design.
//! - `POST …/gains/revert`: pushes an earlier revision again, `{"revision": N}` or the last accepted one.

use axum::Json;
use axum::extract::{Path, Query, State};
use plumbline_agent::design::DesignError;
use plumbline_agent::design::file::{DesignFile, export, push_message};
use plumbline_proto::Kind;
use plumbline_proto::v1::{self, command};
use plumbline_rest::command::{self as rest, Which};
use serde_json::{Map, Value, json};

use super::App;
use super::body::{Body, Raw};
use super::control::{Answer, answer};
use super::error::ApiError;
use super::operator::Operator;
use crate::hub::VehicleError;
use crate::names::JsonName;
use crate::sync::wall_time_us;

impl From<DesignError> for ApiError {
    fn from(error: DesignError) -> Self {
        Self::Invalid(error.to_string())
    }
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Value>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    let in_use: Option<v1::GainsInUse> = app.hub.latest(&id, Kind::Gains);
    let in_use = in_use.as_ref();
    let weights = in_use.and_then(|g| g.weights.clone());
    let k = in_use.and_then(|g| g.k.as_ref());
    let exported = in_use.map(|gains| exported(&app, &id, gains));
    Ok(Json(json!({
        "state_weight": weights.as_ref().map(|w| &w.state_weight),
        "input_weight": weights.as_ref().map(|w| &w.input_weight),
        "revision": in_use.map(|g| g.revision),
        "sha256": in_use.map(|g| &g.sha256),
        "controller": in_use.map(|g| &g.controller),
        "slowest_pole_per_s": in_use.map(|g| g.slowest_pole_per_s),
        "parameters": exported.as_ref().map(|e| &e["parameters"]),
        "certificate": exported.as_ref().map(|e| &e["certificate"]),
        "k": k.map(|k| json!({ "rows": k.rows, "columns": k.columns, "values": k.values })),
        "revisions": app.gains.revisions(&id),
    })))
}

fn exported(app: &App, id: &str, gains: &v1::GainsInUse) -> Value {
    let description: v1::Description = app.hub.latest(id, Kind::Description).unwrap_or_default();
    export(gains, &description.airframe, description.tick_rate_hz)
}

pub(crate) async fn download(
    State(app): State<App>,
    Path(id): Path<String>,
    which: Result<Query<Which>, axum::extract::rejection::QueryRejection>,
) -> Result<Json<Value>, ApiError> {
    let Query(which) = which.map_err(|e| ApiError::Invalid(e.body_text()))?;
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    if let Some(revision) = which.revision {
        let found = app.gains.earlier(&id, Some(revision), 0).map_err(ApiError::NotFound)?;
        return Ok(Json(Value::Object(found.design)));
    }
    let in_use: Option<v1::GainsInUse> = app.hub.latest(&id, Kind::Gains);
    let in_use = in_use.ok_or_else(|| ApiError::NotFound(format!("{id} has not told its gains yet")))?;
    Ok(Json(exported(&app, &id, &in_use)))
}

pub(crate) async fn push(State(app): State<App>, Path(id): Path<String>, who: Operator, body: Raw) -> Answer {
    let text = body.json();
    let mut design: Map<String, Value> = serde_json::from_slice(text).map_err(|e| ApiError::Invalid(e.to_string()))?;
    // What exported gains carry beside their design is not kept: the agent certifies anew.
    let file = DesignFile::from_json(text)?;
    design.retain(|key, _| !["format", "airframe", "tick_rate_hz", "units", "certificate"].contains(&key.as_str()));
    send(&app, &id, &who, &file, design).await
}

pub(crate) async fn revert(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(which): Body<Which>,
) -> Answer {
    let in_use = app.hub.latest::<v1::GainsInUse>(&id, Kind::Gains).map_or(0, |gains| gains.revision);
    let earlier = app.gains.earlier(&id, which.revision, in_use).map_err(ApiError::NotFound)?;
    let text = serde_json::to_vec(&earlier.design).map_err(|e| ApiError::Broken(e.to_string()))?;
    send(&app, &id, &who, &DesignFile::from_json(&text)?, earlier.design).await
}

async fn send(app: &App, id: &str, who: &Operator, file: &DesignFile, design: Map<String, Value>) -> Answer {
    let proposal = file.proposal()?;
    let sender = app.controlled(id, who)?;
    let in_use = app.hub.latest::<v1::GainsInUse>(id, Kind::Gains).map_or(0, |gains| gains.revision);
    let revision = app.gains.begin(id, in_use, design, who.name(), wall_time_us());
    let body = command::Body::PushGains(push_message(&proposal, revision));
    let ack = app.command(id, &sender, who, body).await?;
    app.gains.answered(id, revision, &v1::AckStage::json_name_of(ack.stage), &ack.reason);
    let (status, Json(body)) = answer(&ack);
    Ok((status, Json(rest::Answer { revision: Some(revision), ..body })))
}

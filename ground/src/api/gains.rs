//! Gains of a vehicle, as JSON of the agent's own reader (`plumbline_analysis::design::file`).
//!
//! - `GET …/gains`: those in use and every revision.
//! - `PUT …/gains`: pushes a design, or exported gains; the agent solves, examines, applies or refuses.
//! - `GET …/gains/export`: those in use as a file, with units and certificate; `?revision=N` an earlier design.
//! - `POST …/gains/revert`: pushes an earlier revision again, `{"revision": N}` or the last accepted one.

use axum::Json;
use axum::extract::State;
use plumbline_analysis::design::DesignError;
use plumbline_analysis::design::file::{export, proposal, push_message, read};
use plumbline_proto::Kind;
use plumbline_proto::v1::{self, command};
use plumbline_rest::command::Which;
use plumbline_rest::design::{Design, Gains, Matrix};
use serde_json::{Map, Value};

use super::App;
use super::body::{Body, Raw};
use super::control::{Answer, answer};
use super::error::ApiError;
use super::extract::{Path, Query};
use super::operator::Operator;
use crate::hub::VehicleError;
use crate::names::JsonName;
use crate::sync::wall_time_us;

impl From<DesignError> for ApiError {
    fn from(error: DesignError) -> Self {
        Self::Invalid(error.to_string())
    }
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Gains>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    let in_use: Option<v1::GainsInUse> = app.hub.latest(&id, Kind::Gains);
    let revisions = app.gains.revisions(&id);
    let Some(gains) = in_use else { return Ok(Json(Gains { revisions, ..Gains::default() })) };
    let certificate = exported(&app, &id, &gains).get("certificate").cloned();
    let (state_weight, input_weight) = gains.weights.map(|w| (w.state_weight, w.input_weight)).unzip();
    Ok(Json(Gains {
        revision: Some(gains.revision),
        sha256: Some(gains.sha256),
        controller: Some(gains.controller),
        state_weight,
        input_weight,
        parameters: Some(gains.parameters.into_iter().map(|p| (p.name, p.value)).collect()),
        slowest_pole_per_s: Some(gains.slowest_pole_per_s),
        certificate,
        k: gains.k.map(|k| Matrix { rows: k.rows, columns: k.columns, values: k.values }),
        revisions,
    }))
}

fn exported(app: &App, id: &str, gains: &v1::GainsInUse) -> Value {
    let description: v1::Description = app.hub.latest(id, Kind::Description).unwrap_or_default();
    export(gains, &description.airframe, description.tick_rate_hz)
}

pub(crate) async fn download(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(which): Query<Which>,
) -> Result<Json<Value>, ApiError> {
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
    let file = read(text)?;
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
    send(&app, &id, &who, &read(&text)?, earlier.design).await
}

async fn send(app: &App, id: &str, who: &Operator, file: &Design, design: Map<String, Value>) -> Answer {
    let proposal = proposal(file)?;
    let sender = app.controlled(id, who)?;
    let in_use = app.hub.latest::<v1::GainsInUse>(id, Kind::Gains).map_or(0, |gains| gains.revision);
    let revision = app.gains.begin(id, in_use, design, who.name(), wall_time_us());
    let body = command::Body::PushGains(push_message(&proposal, revision));
    let ack = app.command(id, &sender, who, body).await?;
    app.gains.answered(id, revision, &v1::AckStage::json_name_of(ack.stage), &ack.reason);
    answer(ack, Some(revision))
}

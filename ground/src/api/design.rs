//! `POST /api/v1/design/preview[?vehicle=ID]`: what a design would do. With a vehicle, its airframe, tick rate, margin
//! policy and K in use stand in for what the question leaves out. `GET
//! /api/v1/design/controllers[?airframe=NAME|vehicle=ID]`: every controller with its parameters and defaults.
//! `plumbline_analysis` answers; nothing is sent to a vehicle.

use axum::Json;
use axum::extract::State;
use plumbline_analysis::design::preview::{self, Around};
use plumbline_core::control::gains::Gain;
use plumbline_core::control::policy::MarginPolicy;
use plumbline_proto::Kind;
use plumbline_proto::v1;
use plumbline_rest::design::{Controllers, Preview};
use serde::Deserialize;

use super::App;
use super::body::Raw;
use super::error::ApiError;
use super::extract::Query;
use crate::hub::VehicleError;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct For {
    vehicle: Option<String>,
    airframe: Option<String>,
}

type Asked = Query<For>;

/// What is known of the vehicle asked about.
fn around(app: &App, Query(asked): Asked) -> Result<Around, ApiError> {
    let mut around = Around::default();
    if let Some(id) = asked.vehicle {
        if !app.hub.knows(&id) {
            return Err(VehicleError::Unknown(id).into());
        }
        if let Some(description) = app.hub.latest::<v1::Description>(&id, Kind::Description) {
            around.airframe = description.airframe;
            around.tick_rate_hz = description.tick_rate_hz;
        }
        let gains: Option<v1::GainsInUse> = app.hub.latest(&id, Kind::Gains);
        if let Some(policy) = gains.as_ref().and_then(|gains| MarginPolicy::by_name(&gains.margin_policy)) {
            around.policy = policy;
        }
        let k = gains.and_then(|gains| gains.k).filter(|k| k.values.len() == 64);
        around.in_use = k.map(|k| Gain::from_row_slice(&k.values));
    }
    if let Some(airframe) = asked.airframe {
        around.airframe = airframe;
    }
    Ok(around)
}

pub(crate) async fn preview(State(app): State<App>, asked: Asked, body: Raw) -> Result<Json<Preview>, ApiError> {
    let around = around(&app, asked)?;
    // A preview is tens of milliseconds of computing: not on the threads that answer everybody.
    Ok(Json(app.computing.run(move |_| Ok(preview::answer(body.json(), &around)?)).await?))
}

pub(crate) async fn controllers(State(app): State<App>, asked: Asked) -> Result<Json<Controllers>, ApiError> {
    Ok(Json(preview::controllers(&around(&app, asked)?.airframe)?))
}

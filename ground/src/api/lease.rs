//! Who holds control: `GET`, `PUT` takes it, `DELETE` gives it back.

use axum::Json;
use axum::extract::State;
use plumbline_proto::{Kind, v1};
use plumbline_rest::ground::Lease;

use super::App;
use super::error::ApiError;
use super::extract::Path;
use super::operator::Operator;
use crate::hub::VehicleError;

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Lease>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    let holder = match app.hub.ground_of(&id) {
        // As that ground passes it on.
        Some(_) => app.hub.latest::<v1::ControlLease>(&id, Kind::Lease).map(|lease| lease.holder),
        None => app.leases.holder(&id),
    };
    Ok(Json(Lease { holder: holder.filter(|holder| !holder.is_empty()), taken_from: None }))
}

pub(crate) async fn take(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
) -> Result<Json<Lease>, ApiError> {
    app.hub.commanded_here(&id)?;
    let before = app.leases.take(&id, who.name());
    if before.as_deref() != Some(who.name()) {
        tracing::info!(vehicle = %id, operator = who.name(), from = ?before, "control taken");
        app.show_lease(&id, before.as_deref().unwrap_or_default());
    }
    Ok(Json(Lease { holder: Some(who.name().into()), taken_from: before.filter(|b| b != who.name()) }))
}

pub(crate) async fn release(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
) -> Result<Json<Lease>, ApiError> {
    app.hub.commanded_here(&id)?;
    app.leases.release(&id, who.name())?;
    app.show_lease(&id, "");
    Ok(Json(Lease::default()))
}

//! `GET /api/v1/vehicles`.

use axum::Json;
use axum::extract::State;
use plumbline_proto::v1;
use plumbline_rest::ground::Vehicle;

use super::App;
use crate::names::JsonName;

pub(crate) async fn list(State(app): State<App>) -> Json<Vec<Vehicle>> {
    let vehicle = |info: crate::hub::VehicleInfo| {
        let description = info.description.unwrap_or_default();
        let status = info.status.as_ref();
        Vehicle {
            id: info.id,
            connected: info.connected,
            ground: info.ground,
            boot_id: info.boot_id,
            version: info.version,
            vehicle: description.vehicle,
            rig: description.rig,
            mode: status.map(|s| v1::Mode::json_name_of(s.mode)),
            armed: status.map(|s| s.armed),
        }
    };
    Json(app.hub.list().into_iter().map(vehicle).collect())
}

//! `GET /api/v1/ground`: what this ground is and how it fares.

use axum::Json;
use axum::extract::State;
use plumbline_rest::ground::Ground;

use super::App;

pub(crate) async fn show(State(app): State<App>) -> Json<Ground> {
    let recorder = app.recorder.clone();
    let storage = tokio::task::spawn_blocking(move || recorder.storage()).await.unwrap_or_default();
    let identity = app.config.link_identity.as_ref();
    Json(Ground {
        version: env!("CARGO_PKG_VERSION").into(),
        schema: plumbline_proto::SCHEMA.into(),
        address: app.address.to_string(),
        uptime_s: app.started.elapsed().as_secs_f64(),
        data_folder: app.config.data_folder.display().to_string(),
        storage,
        recording_error: app.recorder.error(),
        set_aside: app.recorder.set_aside(),
        refused_peers: identity.map_or(0, |identity| identity.refused()),
        identity_error: identity.and_then(|identity| identity.trouble()),
        handshakes_broken_off: identity.map_or(0, |identity| identity.broken_off()),
        fleet: app.fleet.shown().map(Box::new),
    })
}

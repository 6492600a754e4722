//! `GET /api/ground`: what this ground is and how it fares.

use axum::Json;
use axum::extract::State;
use serde_json::{Value, json};

use super::App;

pub(crate) async fn show(State(app): State<App>) -> Json<Value> {
    let recorder = app.recorder.clone();
    let storage = tokio::task::spawn_blocking(move || recorder.storage()).await.unwrap_or_default();
    Json(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "schema": plumbline_proto::SCHEMA,
        "address": app.address.to_string(),
        "uptime_s": app.started.elapsed().as_secs_f64(),
        "data_folder": app.config.data_folder.display().to_string(),
        "storage": storage,
        "recording_error": app.recorder.error(),
        "set_aside": app.recorder.set_aside(),
        "refused_peers": app.config.link_identity.as_ref().map_or(0, |identity| identity.refused()),
        "identity_error": app.config.link_identity.as_ref().and_then(|identity| identity.trouble()),
        "handshakes_broken_off": app.config.link_identity.as_ref().map_or(0, |identity| identity.broken_off()),
    }))
}

//! `GET /api/v1/audit?limit=N`: the last deeds, oldest first.

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::error::ApiError;
use super::extract::Query;

#[derive(Deserialize)]
pub(crate) struct Asked {
    limit: Option<usize>,
}

pub(crate) async fn show(State(app): State<App>, Query(asked): Query<Asked>) -> Result<Json<Value>, ApiError> {
    let audit = app.audit.clone();
    let count = asked.limit.unwrap_or(200);
    let deeds = tokio::task::spawn_blocking(move || audit.last(count)).await;
    match deeds {
        Ok(Ok(deeds)) => Ok(Json(json!({ "deeds": deeds }))),
        Ok(Err(error)) => Err(ApiError::Broken(format!("audit log: {error}"))),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

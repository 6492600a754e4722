//! `GET /api/v1/audit?offset=N&limit=N&search=WORDS`: the last deeds before the last N, oldest first, of those with every
//! word.

use axum::Json;
use axum::extract::State;
use plumbline_rest::flight::finds;
use serde_json::{Value, json};

use super::App;
use super::error::ApiError;
use super::extract::{Page, Query};

/// Deeds on a page, where nothing else is asked for.
const PAGE: usize = 200;

pub(crate) async fn show(State(app): State<App>, Query(page): Query<Page>) -> Result<Json<Value>, ApiError> {
    let (audit, limit, found) = (app.audit.clone(), page.limit(PAGE)?, finds(&page.search));
    let deeds = tokio::task::spawn_blocking(move || audit.page(page.offset, limit, found)).await;
    match deeds {
        Ok(Ok(deeds)) => Ok(Json(json!({ "deeds": deeds }))),
        Ok(Err(error)) => Err(ApiError::Broken(format!("audit log: {error}"))),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

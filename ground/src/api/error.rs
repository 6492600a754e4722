//! The only place that knows status codes of failures.

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;

use crate::attack_plan::PlanError;
use crate::commands::CommandError;
use crate::hub::VehicleError;
use crate::lease::Held;
use crate::recorder::RecordingError;

/// A request that cannot be answered as asked: a kind, and a sentence with the offending value.
#[derive(Debug)]
pub(crate) enum ApiError {
    NotFound(String),
    Method(String),
    /// Nobody is signed in.
    SignIn(String),
    /// Too many attempts; how long to wait, s.
    Throttled(u64, String),
    /// Wrong Origin or Host, or a role that may not.
    Foreign(String),
    TooLarge(String),
    /// The rest of a request did not come.
    Late(String),
    Invalid(String),
    Held(Held),
    Conflict(String),
    Unavailable(String),
    Unanswered(String),
    Broken(String),
}

impl ApiError {
    /// Status code and text, where the body is nothing more.
    pub(crate) fn status_and_text(self) -> (StatusCode, String) {
        match self {
            Self::NotFound(text) => (StatusCode::NOT_FOUND, text),
            Self::Method(text) => (StatusCode::METHOD_NOT_ALLOWED, text),
            Self::SignIn(text) => (StatusCode::UNAUTHORIZED, text),
            Self::Throttled(_, text) => (StatusCode::TOO_MANY_REQUESTS, text),
            Self::Foreign(text) => (StatusCode::FORBIDDEN, text),
            Self::TooLarge(text) => (StatusCode::PAYLOAD_TOO_LARGE, text),
            Self::Late(text) => (StatusCode::REQUEST_TIMEOUT, text),
            Self::Invalid(text) => (StatusCode::UNPROCESSABLE_ENTITY, text),
            Self::Held(held) => (StatusCode::LOCKED, held.to_string()),
            Self::Conflict(text) => (StatusCode::CONFLICT, text),
            Self::Unavailable(text) => (StatusCode::SERVICE_UNAVAILABLE, text),
            Self::Unanswered(text) => (StatusCode::GATEWAY_TIMEOUT, text),
            Self::Broken(text) => {
                tracing::error!(error = %text, "request failed");
                (StatusCode::INTERNAL_SERVER_ERROR, text)
            }
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        if let Self::Held(held) = self {
            let body = json!({ "error": held.to_string(), "holder": held.holder });
            return (StatusCode::LOCKED, Json(body)).into_response();
        }
        let wait = match &self {
            Self::Throttled(seconds, _) => Some([(header::RETRY_AFTER, seconds.to_string())]),
            _ => None,
        };
        let (status, text) = self.status_and_text();
        (status, wait.map(axum::response::AppendHeaders), Json(json!({ "error": text }))).into_response()
    }
}

impl From<VehicleError> for ApiError {
    fn from(error: VehicleError) -> Self {
        match error {
            VehicleError::Unknown(_) => Self::NotFound(error.to_string()),
            VehicleError::Disconnected(_) => Self::Unavailable(error.to_string()),
        }
    }
}

impl From<CommandError> for ApiError {
    fn from(error: CommandError) -> Self {
        match error {
            CommandError::Disconnected | CommandError::Flooded { .. } => Self::Unavailable(error.to_string()),
            CommandError::TimedOut { .. } => Self::Unanswered(error.to_string()),
        }
    }
}

impl From<Held> for ApiError {
    fn from(held: Held) -> Self {
        Self::Held(held)
    }
}

impl From<PlanError> for ApiError {
    fn from(error: PlanError) -> Self {
        Self::Invalid(error.to_string())
    }
}

impl From<RecordingError> for ApiError {
    fn from(error: RecordingError) -> Self {
        match error {
            RecordingError::Unknown(_) | RecordingError::NoTopic(_) => Self::NotFound(error.to_string()),
            RecordingError::InProgress(_) => Self::Conflict(error.to_string()),
            RecordingError::Invalid(_) => Self::Invalid(error.to_string()),
            RecordingError::Stopped | RecordingError::NotReady | RecordingError::Busy => {
                Self::Unavailable(error.to_string())
            }
            RecordingError::Io { .. } | RecordingError::Damaged { .. } | RecordingError::Index(_) => {
                Self::Broken(error.to_string())
            }
        }
    }
}

//! The only place that knows status codes of failures.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plumbline_rest::Problem;

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
    /// Nothing of the range asked for is there; how many bytes there are.
    Range(u64),
    /// The rest of a request did not come.
    Late(String),
    Invalid(String),
    Held(Held),
    Conflict(String),
    /// The vehicle refused a command; its number, that of gains it was to carry, and why.
    Rejected {
        command_id: u64,
        revision: Option<u32>,
        reason: String,
    },
    /// A socket is served here, and nothing else.
    Upgrade(String),
    Unavailable(String),
    Unanswered(String),
    Broken(String),
}

/// Media type of every error.
pub(crate) const PROBLEM: &str = "application/problem+json";

impl ApiError {
    /// Status code, and the code of the problem, which never changes its meaning.
    pub(crate) const fn kind(&self) -> (StatusCode, &'static str) {
        match self {
            Self::NotFound(_) => (StatusCode::NOT_FOUND, "not_found"),
            Self::Method(_) => (StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed"),
            Self::SignIn(_) => (StatusCode::UNAUTHORIZED, "sign_in"),
            Self::Throttled(..) => (StatusCode::TOO_MANY_REQUESTS, "throttled"),
            Self::Foreign(_) => (StatusCode::FORBIDDEN, "forbidden"),
            Self::TooLarge(_) => (StatusCode::PAYLOAD_TOO_LARGE, "too_large"),
            Self::Range(_) => (StatusCode::RANGE_NOT_SATISFIABLE, "range_not_satisfiable"),
            Self::Late(_) => (StatusCode::REQUEST_TIMEOUT, "late"),
            Self::Invalid(_) => (StatusCode::UNPROCESSABLE_ENTITY, "invalid"),
            Self::Held(_) => (StatusCode::LOCKED, "held"),
            Self::Conflict(_) => (StatusCode::CONFLICT, "conflict"),
            Self::Rejected { .. } => (StatusCode::CONFLICT, "rejected"),
            Self::Upgrade(_) => (StatusCode::UPGRADE_REQUIRED, "upgrade_required"),
            Self::Unavailable(_) => (StatusCode::SERVICE_UNAVAILABLE, "unavailable"),
            Self::Unanswered(_) => (StatusCode::GATEWAY_TIMEOUT, "unanswered"),
            Self::Broken(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
        }
    }

    /// What a person is told.
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Held(held) => held.to_string(),
            Self::Range(length) => format!("the range lies beyond the end: there are {length} bytes"),
            Self::NotFound(text)
            | Self::Method(text)
            | Self::SignIn(text)
            | Self::Throttled(_, text)
            | Self::Foreign(text)
            | Self::TooLarge(text)
            | Self::Late(text)
            | Self::Invalid(text)
            | Self::Conflict(text)
            | Self::Rejected { reason: text, .. }
            | Self::Upgrade(text)
            | Self::Unavailable(text)
            | Self::Unanswered(text)
            | Self::Broken(text) => text.clone(),
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let ((status, code), detail) = (self.kind(), self.text());
        if matches!(self, Self::Broken(_)) {
            tracing::error!(error = %detail, "request failed");
        }
        let problem = Problem {
            kind: "about:blank".into(),
            title: status.canonical_reason().unwrap_or_default().into(),
            status: status.as_u16(),
            detail,
            code: code.into(),
            ..Problem::default()
        };
        let (more, problem) = match self {
            Self::Throttled(seconds, _) => (Some([(header::RETRY_AFTER, seconds.to_string())]), problem),
            Self::Range(length) => (Some([(header::CONTENT_RANGE, format!("bytes */{length}"))]), problem),
            Self::Held(held) => (None, Problem { holder: Some(held.holder), ..problem }),
            Self::Rejected { command_id, revision, .. } => {
                (None, Problem { command_id: Some(command_id), revision, ..problem })
            }
            _ => (None, problem),
        };
        let mut response = (status, more.map(axum::response::AppendHeaders), Json(problem)).into_response();
        response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM));
        response
    }
}

impl From<VehicleError> for ApiError {
    fn from(error: VehicleError) -> Self {
        match error {
            VehicleError::Unknown(_) => Self::NotFound(error.to_string()),
            VehicleError::Disconnected(_) => Self::Unavailable(error.to_string()),
            VehicleError::Elsewhere { .. } => Self::Conflict(error.to_string()),
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
            RecordingError::Stopped | RecordingError::NotReady | RecordingError::Busy | RecordingError::Archive(_) => {
                Self::Unavailable(error.to_string())
            }
            RecordingError::Io { ref source, .. } if source.kind() == std::io::ErrorKind::StorageFull => {
                Self::Unavailable(error.to_string())
            }
            RecordingError::Io { .. } | RecordingError::Damaged { .. } | RecordingError::Index(_) => {
                Self::Broken(error.to_string())
            }
        }
    }
}

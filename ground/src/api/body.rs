//! JSON bodies, with the API's own errors. An empty body is `{}`.

use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use serde::de::DeserializeOwned;

use super::error::ApiError;

/// A body as it came.
pub(crate) struct Raw(Bytes);

impl Raw {
    /// The bytes; `{}` when there are none.
    pub(crate) fn json(&self) -> &[u8] {
        if self.0.is_empty() { b"{}" } else { &self.0 }
    }
}

impl<S: Send + Sync> FromRequest<S> for Raw {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        Bytes::from_request(request, state).await.map(Self).map_err(|rejection| {
            if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
                ApiError::TooLarge(format!("the body is larger than {} bytes", super::MAX_BODY))
            } else {
                ApiError::Invalid(rejection.body_text())
            }
        })
    }
}

/// A parsed body.
pub(crate) struct Body<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        let raw = Raw::from_request(request, state).await?;
        serde_json::from_slice(raw.json()).map(Self).map_err(|e| ApiError::Invalid(e.to_string()))
    }
}

//! An ETag for every answer in JSON to a `GET`: whoever has it already is told so, and is sent nothing. Handlers of what is
//! long give tags of their own, and ask [`Known`] before they do the work.

use std::convert::Infallible;

use axum::body::{Body, to_bytes};
use axum::extract::{FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use ring::digest::{SHA256, digest};

use super::error::ApiError;

/// Largest answer that is tagged; beyond it there is none.
const MOST: usize = 64 << 20;

/// What a client has already, by `If-None-Match`.
pub(crate) struct Known(Vec<HeaderValue>);

impl Known {
    /// As these headers say.
    pub(crate) fn of(headers: &HeaderMap) -> Self {
        Self(headers.get_all(header::IF_NONE_MATCH).iter().cloned().collect())
    }

    /// Is what has this tag among it?
    pub(crate) fn has(&self, tag: &str) -> bool {
        let mut tags = self.0.iter().filter_map(|value| value.to_str().ok()).flat_map(|line| line.split(','));
        tags.any(|known| matches!(known.trim(), known if known == "*" || known.trim_start_matches("W/") == tag))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Known {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(Self::of(&parts.headers))
    }
}

/// The tag of what these bytes determine.
pub(crate) fn of(bytes: &[u8]) -> String {
    let hash: String = digest(&SHA256, bytes).as_ref().iter().take(12).map(|byte| format!("{byte:02x}")).collect();
    format!("\"{hash}\"")
}

/// The client has it already.
pub(crate) fn unchanged(tag: String) -> Response {
    (StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response()
}

/// Tags the answer to a `GET`, or replaces it by 304.
pub(crate) async fn tag(request: Request, next: Next) -> Response {
    let known = Known::of(request.headers());
    let get = request.method() == Method::GET;
    let response = next.run(request).await;
    let json = response.headers().get(header::CONTENT_TYPE).is_some_and(|kind| kind == "application/json");
    if !get || !json || response.status() != StatusCode::OK || response.headers().contains_key(header::ETAG) {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let bytes = match to_bytes(body, MOST).await {
        Ok(bytes) => bytes,
        Err(error) => return ApiError::Broken(format!("the answer cannot be sent: {error}")).into_response(),
    };
    let tag = of(&bytes);
    if let Ok(value) = HeaderValue::from_str(&tag) {
        parts.headers.insert(header::ETAG, value);
    }
    parts.headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    if known.has(&tag) {
        parts.status = StatusCode::NOT_MODIFIED;
        parts.headers.remove(header::CONTENT_TYPE);
        parts.headers.remove(header::CONTENT_LENGTH);
        return Response::from_parts(parts, Body::empty());
    }
    Response::from_parts(parts, Body::from(bytes))
}

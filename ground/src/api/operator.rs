//! Who asks: the account that signed in, or, where no accounts are needed, what the page calls itself.

use axum::extract::FromRequestParts;
use axum::http::HeaderMap;
use axum::http::request::Parts;
use plumbline_proto::v1::command;

use super::error::ApiError;
use crate::people::Person;

/// The name a page gave itself; with a session, a proof that the request is the page's own.
pub(crate) const HEADER: &str = "x-plumbline-operator";
/// Flight time of the newest message a page showed when its operator asked, µs: the agent refuses what was asked on an
/// old picture, and so a command that waited in the socket of a ground that stood still.
const SEEN: &str = "x-plumbline-seen";
const MAX_LEN: usize = 64;
/// Whoever cuts the motors under a name that cannot be used.
pub(crate) const UNNAMED: &str = "unnamed";

/// The operator of one request.
#[derive(Debug, Clone)]
pub(crate) struct Operator {
    pub(crate) name: String,
    /// What of [`SEEN`] is passed on, or why it cannot be.
    seen_us: Result<Option<u64>, String>,
}

impl Operator {
    /// `name`, with the rest of a request's `headers`.
    pub(crate) fn new(name: String, headers: &HeaderMap) -> Self {
        let seen_us = headers.get(SEEN).map(|value| {
            let number = value.to_str().ok().and_then(|text| text.parse().ok());
            number.ok_or_else(|| format!("{SEEN} is {value:?}: a flight time in whole microseconds is needed"))
        });
        Self { name, seen_us: seen_us.transpose() }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Flight time of the picture on which `body` was asked, µs; a cut is refused for no odd header.
    pub(crate) fn seen_us(&self, body: &command::Body) -> Result<Option<u64>, ApiError> {
        match &self.seen_us {
            Ok(seen_us) => Ok(*seen_us),
            Err(_) if matches!(body, command::Body::CutMotors(_)) => Ok(None),
            Err(odd) => Err(ApiError::Invalid(odd.clone())),
        }
    }
}

/// Who sent a request.
#[derive(Debug, Clone)]
pub(crate) struct Signed(pub(crate) Person);

impl<S: Sync> FromRequestParts<S> for Signed {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let signed = parts.extensions.get::<Self>().cloned();
        signed.ok_or_else(|| ApiError::SignIn("sign in first".into()))
    }
}

/// What the request calls its operator; scripts that send no header are one operator together.
///
/// # Errors
/// [`ApiError::Invalid`] for a name that is empty, too long or not printable.
pub(crate) fn called(headers: &HeaderMap) -> Result<String, ApiError> {
    let Some(value) = headers.get(HEADER) else { return Ok("script".into()) };
    match value.to_str() {
        Ok(name) if !name.is_empty() && name.len() <= MAX_LEN => Ok(name.to_owned()),
        _ => Err(ApiError::Invalid(format!("{HEADER} is {value:?}: 1 to {MAX_LEN} printable characters are needed"))),
    }
}

/// What a socket's address calls its operator, else `otherwise`.
///
/// # Errors
/// [`ApiError::Invalid`] as for [`called`].
pub(crate) fn named(said: Option<String>, otherwise: String) -> Result<String, ApiError> {
    match said {
        Some(name) if !usable(&name) => Err(ApiError::Invalid(format!(
            "operator is {:?}: 1 to {MAX_LEN} printable characters are needed",
            crate::names::clip(&name)
        ))),
        said => Ok(said.unwrap_or(otherwise)),
    }
}

/// As a header could say it.
fn usable(name: &str) -> bool {
    (1..=MAX_LEN).contains(&name.len()) && name.bytes().all(|byte| (b' '..=b'~').contains(&byte))
}

impl<S: Sync> FromRequestParts<S> for Operator {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let admitted = parts.extensions.get::<Self>().cloned();
        admitted.ok_or_else(|| ApiError::Broken("a route is not in the table of routes".into()))
    }
}

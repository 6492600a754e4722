//! Who asks: the account that signed in, or, where no accounts are needed, what the page calls itself.

use axum::extract::FromRequestParts;
use axum::http::HeaderMap;
use axum::http::request::Parts;

use super::error::ApiError;
use crate::people::Person;

/// The name a page gave itself; with a session, a proof that the request is the page's own.
pub(crate) const HEADER: &str = "x-plumbline-operator";
const MAX_LEN: usize = 64;

/// The operator of one request.
#[derive(Debug, Clone)]
pub(crate) struct Operator(pub(crate) String);

impl Operator {
    pub(crate) fn name(&self) -> &str {
        &self.0
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
pub(crate) fn called(headers: &HeaderMap) -> Result<String, ApiError> {
    let Some(value) = headers.get(HEADER) else { return Ok("script".into()) };
    match value.to_str() {
        Ok(name) if !name.is_empty() && name.len() <= MAX_LEN => Ok(name.to_owned()),
        _ => Err(ApiError::Invalid(format!("{HEADER} is {value:?}: 1 to {MAX_LEN} printable characters are needed"))),
    }
}

impl<S: Sync> FromRequestParts<S> for Operator {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let admitted = parts.extensions.get::<Self>().cloned();
        admitted.ok_or_else(|| ApiError::Broken("a route is not in the table of routes".into()))
    }
}

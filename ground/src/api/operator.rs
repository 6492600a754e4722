//! Who asks: the session id that the page chose for itself.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;

use super::error::ApiError;

const HEADER: &str = "x-plumbline-operator";
const MAX_LEN: usize = 64;

/// The operator of one request; scripts that send no header are one operator together.
pub(crate) struct Operator(String);

impl Operator {
    pub(crate) fn name(&self) -> &str {
        &self.0
    }
}

impl<S: Sync> FromRequestParts<S> for Operator {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let Some(value) = parts.headers.get(HEADER) else { return Ok(Self("script".into())) };
        match value.to_str() {
            Ok(name) if !name.is_empty() && name.len() <= MAX_LEN => Ok(Self(name.to_owned())),
            _ => {
                Err(ApiError::Invalid(format!("{HEADER} is {value:?}: 1 to {MAX_LEN} printable characters are needed")))
            }
        }
    }
}

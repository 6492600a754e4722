//! `POST /api/v1/pairing`: the code that an agent shows.

use axum::extract::State;
use axum::http::StatusCode;
use plumbline_link::pairing::{Code, PairingError, expect};
use plumbline_rest::people;

use super::App;
use super::body::Body;
use super::error::ApiError;

pub(crate) async fn begin(State(app): State<App>, Body(asked): Body<people::Code>) -> Result<StatusCode, ApiError> {
    let Some(identity) = &app.config.link_identity else {
        return Err(ApiError::Unavailable("this ground has no link to agents".into()));
    };
    let code = Code::parse(&asked.code).map_err(|error| ApiError::Invalid(error.to_string()))?;
    let folder = identity.folder().to_owned();
    let expected = tokio::task::spawn_blocking(move || expect(&folder, &code)).await;
    match expected.unwrap_or(Err(PairingError::System)) {
        Ok(()) => Ok(StatusCode::ACCEPTED),
        Err(error) => Err(ApiError::Broken(error.to_string())),
    }
}

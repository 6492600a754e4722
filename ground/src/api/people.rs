//! Accounts and sessions: admins manage them all, everybody sees and ends their own sessions.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::body::Body;
use super::error::ApiError;
use super::operator::Signed;
use crate::people::{AccountError, Role};

pub(crate) async fn list(State(app): State<App>) -> Result<Json<Value>, ApiError> {
    let accounts = app.people.accounts().all()?;
    let accounts: Vec<_> =
        accounts.iter().map(|a| json!({ "name": a.name, "role": a.role, "two_steps": a.two_steps() })).collect();
    Ok(Json(json!({ "accounts": accounts, "sessions": app.people.sessions(None) })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Added {
    name: String,
    role: Role,
    password: String,
}

pub(crate) async fn add(State(app): State<App>, Body(asked): Body<Added>) -> Result<StatusCode, ApiError> {
    app.people.change(move |accounts| accounts.add(&asked.name, asked.role, &asked.password)).await?;
    Ok(StatusCode::CREATED)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Changed {
    role: Option<Role>,
    password: Option<String>,
    /// `false` takes the authenticator away, as from somebody who lost it. Nobody sets one up for another.
    two_steps: Option<bool>,
}

pub(crate) async fn change(
    State(app): State<App>,
    Path(name): Path<String>,
    Body(asked): Body<Changed>,
) -> Result<StatusCode, ApiError> {
    if asked.two_steps == Some(true) {
        return Err(ApiError::Invalid("whoever is to sign in by two steps sets it up themselves".into()));
    }
    app.people
        .change(move |accounts| {
            accounts.change(&name, asked.role, asked.password.as_deref())?;
            asked.two_steps.map_or(Ok(()), |_| accounts.set_totp(&name, None))
        })
        .await?;
    Ok(StatusCode::NO_CONTENT)
}

pub(crate) async fn remove(State(app): State<App>, Path(name): Path<String>) -> Result<StatusCode, ApiError> {
    app.people.change(move |accounts| accounts.remove(&name)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The sessions of whoever asks.
pub(crate) async fn sessions(State(app): State<App>, Signed(person): Signed) -> Json<Value> {
    let sessions = person.account.map_or_else(Vec::new, |account| app.people.sessions(Some(&account)));
    Json(json!({ "sessions": sessions }))
}

/// Ends a session: one's own, or for an admin anybody's.
pub(crate) async fn end(
    State(app): State<App>,
    Path(id): Path<String>,
    Signed(person): Signed,
) -> Result<StatusCode, ApiError> {
    let account = person.account.filter(|_| person.role < Role::Admin);
    if app.people.end_session(&id, account.as_deref()).await {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(ApiError::NotFound(format!("there is no session {:?}", crate::names::clip(&id))))
    }
}

impl From<AccountError> for ApiError {
    fn from(error: AccountError) -> Self {
        match error {
            AccountError::Unknown(_) => Self::NotFound(error.to_string()),
            AccountError::Exists(_) | AccountError::LastAdmin => Self::Conflict(error.to_string()),
            AccountError::Name(_)
            | AccountError::Password(_)
            | AccountError::Full
            | AccountError::Secret
            | AccountError::Code => Self::Invalid(error.to_string()),
            AccountError::Io { .. } | AccountError::Malformed { .. } | AccountError::Random => {
                Self::Broken(error.to_string())
            }
        }
    }
}

//! Accounts and sessions: admins manage them all, everybody sees and ends their own sessions.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use plumbline_rest::people::{Account, AccountChange, NewAccount, People};

use super::App;
use super::body::Body;
use super::error::ApiError;
use super::extract::Path;
use super::operator::Signed;
use crate::people::{self, AccountError, Role};

pub(crate) async fn list(State(app): State<App>) -> Json<People> {
    let accounts = app.people.accounts().known().unwrap_or_default();
    let shown =
        |known: &people::Account| Account { name: known.name.clone(), role: known.role, two_steps: known.two_steps() };
    Json(People { accounts: accounts.iter().map(shown).collect(), sessions: app.people.sessions(None) })
}

pub(crate) async fn add(State(app): State<App>, Body(asked): Body<NewAccount>) -> Result<StatusCode, ApiError> {
    app.people.change(move |accounts| accounts.add(&asked.name, asked.role, &asked.password)).await?;
    Ok(StatusCode::CREATED)
}

pub(crate) async fn change(
    State(app): State<App>,
    Path(name): Path<String>,
    Body(asked): Body<AccountChange>,
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
pub(crate) async fn sessions(State(app): State<App>, Signed(person): Signed) -> Json<People> {
    let sessions = person.account.map_or_else(Vec::new, |account| app.people.sessions(Some(&account)));
    Json(People { sessions, ..People::default() })
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
            AccountError::Exists(_) | AccountError::TwoSteps | AccountError::LastAdmin => {
                Self::Conflict(error.to_string())
            }
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

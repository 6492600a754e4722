//! Who may do what: `/api/v1/session`, `/api/v1/sessions`, `/api/v1/people`, `/api/v1/pairing`.

use serde::{Deserialize, Serialize};

/// Role of an account; each may do what the one before may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Watches, and reads recordings.
    Viewer,
    /// Flies, pushes gains, annotates flights.
    Operator,
    /// Attacks sensors.
    Attacker,
    /// Deletes flights, pairs agents, reads the audit log.
    Admin,
}

impl Role {
    /// Every role, the least first.
    pub const ALL: [Self; 4] = [Self::Viewer, Self::Operator, Self::Attacker, Self::Admin];

    /// As JSON and people name it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Attacker => "attacker",
            Self::Admin => "admin",
        }
    }

    /// The role of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }
}

/// `GET /api/v1/session`: who asks.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Session {
    /// Must people sign in?
    pub sign_in_needed: bool,
    /// Has whoever asks done so, or need they not?
    pub signed_in: bool,
    /// Account; `None` where none is needed.
    pub name: Option<String>,
    /// What it may do.
    pub role: Option<Role>,
    /// Does it sign in by two steps?
    pub two_steps: bool,
}

/// `POST /api/v1/session`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Credentials {
    /// Account.
    pub name: String,
    /// Its password.
    pub password: String,
    /// Of its authenticator, where it has one.
    #[serde(default)]
    pub code: String,
}

/// `POST /api/v1/session/authenticator`: a new one, which counts once a code of it has come back.
#[derive(Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct NewAuthenticator {
    /// To be typed, base 32.
    pub secret: String,
    /// To be opened by an authenticator on this device.
    pub url: String,
    /// To be scanned by one on another.
    pub svg: String,
}

/// `PUT /api/v1/session/authenticator`: its code is the proof that it works.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Confirmation {
    /// As it was offered.
    pub secret: String,
    /// What it shows now.
    pub code: String,
}

/// `DELETE /api/v1/session/authenticator`, and `POST /api/v1/pairing`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Code {
    /// What the authenticator, or the agent, shows.
    pub code: String,
}

/// `POST /api/v1/vehicles/{id}/foxglove`: where a program that cannot sign in sees a vehicle live.
#[derive(Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LiveAddress {
    /// Of a WebSocket; with a ticket, which opens it once, where people sign in.
    pub url: String,
    /// So long it can be opened, s; `None` where nobody signs in: always.
    pub valid_s: Option<u64>,
}

/// `GET /api/v1/people`, and `GET /api/v1/sessions` without accounts.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct People {
    /// Every account.
    pub accounts: Vec<Account>,
    /// Who is signed in.
    pub sessions: Vec<SignedIn>,
}

/// One account.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Account {
    /// Name to sign in with.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// Does it sign in by two steps?
    #[serde(default)]
    pub two_steps: bool,
}

/// One session.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct SignedIn {
    /// By which it is ended; says nothing about its token.
    pub id: String,
    /// Whose.
    pub account: String,
    /// Address it began from.
    pub from: String,
    /// When it began, s since the Unix epoch.
    pub begun_s: u64,
    /// When it was in use last, to about ten minutes.
    pub seen_s: u64,
}

/// `POST /api/v1/people`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewAccount {
    /// Name to sign in with.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// Its password.
    pub password: String,
}

/// `PATCH /api/v1/people/{name}`.
#[derive(Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct AccountChange {
    /// What it may do from now on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// Its new password.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub password: Option<String>,
    /// `false` takes the authenticator away, as from somebody who lost it. Nobody sets one up for another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub two_steps: Option<bool>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_have_the_names_of_their_json() {
        for role in Role::ALL {
            assert_eq!(serde_json::to_value(role).unwrap(), role.name());
            assert_eq!(Role::named(role.name()), Some(role));
        }
        assert_eq!(Role::named("root"), None);
    }
}

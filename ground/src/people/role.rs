//! What each role may do.

use serde::{Deserialize, Serialize};

/// Role of an account; each may do what the one before may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, clap::ValueEnum)]
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

/// What a route needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Access {
    /// Nothing: the page's own files, signing in.
    Open,
    /// To be signed in.
    View,
    /// Command the vehicle; for all but the motor cut also its lease.
    Operate,
    /// Attack sensors.
    Attack,
    /// Run the ground.
    Admin,
}

impl Role {
    /// May someone of this role use a route that needs `access`?
    pub fn may(self, access: Access) -> bool {
        match access {
            Access::Open | Access::View => true,
            Access::Operate => self >= Role::Operator,
            Access::Attack => self >= Role::Attacker,
            Access::Admin => self >= Role::Admin,
        }
    }

    /// For messages.
    pub fn name(self) -> &'static str {
        match self {
            Role::Viewer => "viewer",
            Role::Operator => "operator",
            Role::Attacker => "attacker",
            Role::Admin => "admin",
        }
    }
}

impl Access {
    /// The least role that may.
    pub fn least(self) -> Role {
        match self {
            Access::Open | Access::View => Role::Viewer,
            Access::Operate => Role::Operator,
            Access::Attack => Role::Attacker,
            Access::Admin => Role::Admin,
        }
    }
}

//! What each role may do.

pub use plumbline_rest::people::Role;

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

impl Access {
    /// May someone of this role use a route that needs this?
    pub fn open_to(self, role: Role) -> bool {
        self == Self::Open || role >= self.least()
    }

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

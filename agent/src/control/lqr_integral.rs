//! LQR with integrals of the tracking error.

/// Diagonal weights. State order: x y z vx vy vz roll pitch yaw p q r, then the integrals of
/// x y z yaw. Input order: thrust (N), torque x y z (N m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// ≥ 0; 1/(largest acceptable deviation)² by Bryson's rule.
    pub state: [f64; 16],
    /// > 0; 1/(largest acceptable use)².
    pub input: [f64; 4],
}

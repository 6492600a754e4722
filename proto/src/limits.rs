//! Bounds that agent, ground and page keep alike.

/// Most attacks in one schedule.
pub const MAX_ATTACKS: usize = 32;
/// Fastest replay that can be asked for, times real time.
pub const MAX_REPLAY_SPEED: f64 = 1000.0;

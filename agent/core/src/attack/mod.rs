//! Attacks on sensors: what lies between the samples sensed and the samples received (\[Clinic\] 2, 4.2).
//!
//! A schedule is uploaded whole and runs on flight time, so the radio's delay never shifts an onset.
//! Attacks are off unless the agent's own configuration enables them, bounded in size and time
//! ([`Bounds`]), and aborted on link loss by the flight code. Nothing downstream can know that an
//! attack is on: estimators and controllers only see the received frame.

mod injector;
mod kinds;
mod schedule;

pub use injector::{Injector, Phase, Progress};
pub use kinds::{Channel, Kind};
pub use schedule::{Attack, AttackError, Bounds, MAX_ATTACKS, Schedule, Sequence, offered};

//! Attacks: what lies between the samples sensed and the samples received (\[Clinic\] 2, 4.2), and between the commands that
//! the mixer gives and those that reach the motors.
//!
//! A schedule is uploaded whole and runs on flight time, so the radio's delay never shifts an onset.
//! Attacks are off unless the agent's own configuration enables them, bounded in size and time
//! ([`Bounds`]), and aborted on link loss by the flight code. Nothing downstream can know that an
//! attack is on: estimators and controllers only see the received frame and the commands as they were given.

mod injector;
mod kinds;
mod schedule;

pub use injector::{Injector, Phase, Progress};
pub use kinds::{Channel, Kind};
pub use schedule::{Attack, AttackError, Bounds, MAX_ATTACKS, Schedule, Sequence, offered};

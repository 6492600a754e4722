//! The request to end: once lands the vehicle, twice cuts its motors.

use std::sync::atomic::{AtomicU8, Ordering};

/// How often the program was asked to end.
#[derive(Debug, Default)]
pub struct Stop(AtomicU8);

impl Stop {
    /// Asks once more; returns how often it was asked now.
    pub fn ask(&self) -> u8 {
        // A count that cannot be raised stands at its most.
        self.0.try_update(Ordering::AcqRel, Ordering::Acquire, |asked| asked.checked_add(1)).map_or(u8::MAX, |n| n + 1)
    }

    /// How often it was asked.
    pub fn asked(&self) -> u8 {
        self.0.load(Ordering::Acquire)
    }
}

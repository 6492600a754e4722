//! The request to end: once lands the vehicle, twice cuts its motors.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// How often the program was asked to end.
#[derive(Debug, Default)]
pub struct Stop {
    asked: AtomicU8,
    hung_up: AtomicBool,
}

impl Stop {
    /// Asks once more; returns how often it was asked now.
    pub fn ask(&self) -> u8 {
        // A count that cannot be raised stands at its most.
        let once_more = |asked: u8| asked.checked_add(1);
        self.asked.try_update(Ordering::AcqRel, Ordering::Acquire, once_more).map_or(u8::MAX, |n| n + 1)
    }

    /// Its terminal is gone: lands, and is not counted, so that whoever asks next does not cut. True where nothing was asked before.
    pub fn hang_up(&self) -> bool {
        let first = self.asked() == 0;
        self.hung_up.store(true, Ordering::Release);
        first
    }

    /// How often it was asked; at least once where its terminal is gone.
    pub fn asked(&self) -> u8 {
        self.asked.load(Ordering::Acquire).max(u8::from(self.hung_up.load(Ordering::Acquire)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_that_goes_asks_for_a_landing_and_never_for_a_cut() {
        let stop = Stop::default();
        assert_eq!([stop.hang_up(), stop.hang_up()], [true, false]);
        assert_eq!((stop.asked(), stop.ask(), stop.asked()), (1, 1, 1), "who asks next asks for a landing, too");
        assert_eq!((stop.ask(), stop.asked()), (2, 2));
        assert!(!stop.hang_up() && stop.asked() == 2, "nor takes one back");
    }
}

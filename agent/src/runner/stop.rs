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

    /// Asks, unless it was asked already: for what lands, and never cuts. True where that was the first time.
    pub fn ask_first(&self) -> bool {
        self.0.compare_exchange(0, 1, Ordering::AcqRel, Ordering::Acquire).is_ok()
    }

    /// How often it was asked.
    pub fn asked(&self) -> u8 {
        self.0.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_that_goes_asks_for_a_landing_and_never_for_a_cut() {
        let stop = Stop::default();
        assert_eq!([stop.ask_first(), stop.ask_first()], [true, false]);
        assert_eq!((stop.asked(), stop.ask()), (1, 2));
        assert!(!stop.ask_first() && stop.asked() == 2, "nor takes one back");
    }
}

//! Which messages of a flight are held, written or refused, by their sequence numbers.

use super::intervals::IntervalSet;

/// The numbers of one flight.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    /// Flushed.
    have: IntervalSet,
    /// Written, not flushed.
    pending: IntervalSet,
    /// `have`, `pending` and what the agent's log does not hold (any more).
    covered: IntervalSet,
}

impl Numbers {
    /// Takes in what the files from before hold.
    pub(super) fn absorb(&mut self, past: &IntervalSet) {
        self.pending = self.pending.without(past);
        self.covered.absorb(past);
        self.have.absorb(past);
    }

    /// This message was written.
    pub(super) fn written(&mut self, sequence: u64) {
        self.pending.insert(sequence, sequence);
        self.covered.insert(sequence, sequence);
    }

    /// What was written is durable.
    pub(super) fn flushed(&mut self) {
        self.have.absorb(&self.pending);
        self.pending = IntervalSet::default();
    }

    /// What was written and not flushed is lost.
    pub(super) fn fall_back(&mut self) {
        let unavailable = self.unavailable();
        self.pending = IntervalSet::default();
        self.covered = self.have.clone();
        self.covered.absorb(&unavailable);
    }

    /// The agent's log does not hold these.
    pub(super) fn refuse(&mut self, first: u64, last: u64) {
        self.covered.insert(first, last);
    }

    /// What was refused may be there after all.
    pub(super) fn recheck(&mut self) {
        self.covered = self.have.clone();
        self.covered.absorb(&self.pending);
    }

    fn unavailable(&self) -> IntervalSet {
        self.covered.without(&self.have).without(&self.pending)
    }

    /// Is the message of this number held?
    pub(super) fn holds(&self, sequence: u64) -> bool {
        self.have.contains(sequence) || self.pending.contains(sequence)
    }

    /// Smallest number held.
    pub(super) fn oldest(&self) -> Option<u64> {
        self.have.min().or(self.pending.min())
    }

    /// Largest number held.
    pub(super) fn newest(&self) -> Option<u64> {
        self.have.max().max(self.pending.max())
    }

    /// How many of `first..=last` are not held.
    pub(super) fn missing(&self, first: u64, last: u64) -> u64 {
        // Pending numbers are few and disjoint from `have`.
        self.have.missing(first, last).saturating_sub(self.pending.count())
    }

    /// Ranges of `first..=last` that are neither held nor refused, in order, at most `limit`.
    pub(super) fn gaps(&self, first: u64, last: u64, limit: usize) -> Vec<(u64, u64)> {
        self.covered.gaps(first, last, limit)
    }

    /// Is everything of `first..=last` held or refused?
    pub(super) fn settled(&self, first: u64, last: u64) -> bool {
        self.covered.missing(first, last) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_is_what_is_covered_and_not_held() {
        let mut numbers = Numbers::default();
        (10..20).for_each(|sequence| numbers.written(sequence));
        numbers.flushed();
        (30..40).for_each(|sequence| numbers.written(sequence));
        numbers.refuse(22, 24);
        assert_eq!(numbers.unavailable().gaps(20, 26, 9), [(20, 21), (25, 26)]);
        assert_eq!((numbers.oldest(), numbers.newest(), numbers.missing(10, 39)), (Some(10), Some(39), 10));
        numbers.fall_back();
        assert_eq!((numbers.newest(), numbers.gaps(10, 39, 9)), (Some(19), vec![(20, 21), (25, 39)]));
        numbers.recheck();
        assert_eq!(numbers.gaps(10, 39, 9), [(20, 39)]);
    }
}

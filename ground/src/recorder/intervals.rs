//! A set of sequence numbers, kept as inclusive ranges: what a recording has, and what it lacks.

use std::ops::RangeInclusive;

use rangemap::RangeInclusiveSet;

/// Disjoint, non-touching, inclusive ranges of `u64`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IntervalSet {
    ranges: RangeInclusiveSet<u64>,
    /// How many numbers: asked for fifty times a second, however many ranges there are.
    count: u64,
}

impl IntervalSet {
    /// Adds `first..=last`; answers how many numbers were new.
    pub fn insert(&mut self, first: u64, last: u64) -> u64 {
        let new = self.missing(first, last);
        if new > 0 {
            self.ranges.insert(first..=last);
            self.count = self.count.saturating_add(new);
        }
        new
    }

    /// Adds everything of `other`.
    pub fn absorb(&mut self, other: &Self) {
        for range in other.ranges.iter() {
            self.insert(*range.start(), *range.end());
        }
    }

    /// What is in this set and not in `other`.
    pub fn without(&self, other: &Self) -> Self {
        let mut left = Self::default();
        for gap in self.ranges.iter().flat_map(|range| other.ranges.gaps(range)) {
            left.insert(*gap.start(), *gap.end());
        }
        left
    }

    /// Is `number` in the set?
    pub fn contains(&self, number: u64) -> bool {
        self.ranges.contains(&number)
    }

    /// How many numbers.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Smallest number.
    pub fn min(&self) -> Option<u64> {
        self.ranges.first().map(|range| *range.start())
    }

    /// Largest number.
    pub fn max(&self) -> Option<u64> {
        self.ranges.last().map(|range| *range.end())
    }

    /// The ranges of `first..=last` that are not in the set, in order, at most `limit`.
    pub fn gaps(&self, first: u64, last: u64, limit: usize) -> Vec<(u64, u64)> {
        let asked = first..=last;
        if asked.is_empty() {
            return Vec::new();
        }
        self.ranges.gaps(&asked).take(limit).map(RangeInclusive::into_inner).collect()
    }

    /// How many numbers of `first..=last` are not in the set.
    pub fn missing(&self, first: u64, last: u64) -> u64 {
        let asked = first..=last;
        if asked.is_empty() {
            return 0;
        }
        if self.min().is_none_or(|min| min >= first) && self.max().is_none_or(|max| max <= last) {
            // The usual question, and cheap however many ranges there are.
            return length(&asked) - self.count;
        }
        self.ranges.gaps(&asked).map(|gap| length(&gap)).fold(0, u64::saturating_add)
    }
}

fn length(range: &RangeInclusive<u64>) -> u64 {
    (range.end() - range.start()).saturating_add(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn agrees_with_a_plain_set_whatever_the_order() {
        // A small linear congruential generator: the same 4000 insertions every time.
        let mut state = 12345_u64;
        let mut random = move |n: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % n
        };
        let mut set = IntervalSet::default();
        let mut plain = BTreeSet::new();
        for _ in 0..4000 {
            let first = random(2000);
            let last = first + random(7);
            let new = (first..=last).filter(|n| plain.insert(*n)).count() as u64;
            assert_eq!(set.insert(first, last), new);
            assert_eq!(set.count(), plain.len() as u64);
            let (a, b) = (random(2000), random(2000));
            let (a, b) = (a.min(b), a.max(b));
            let lacking: Vec<u64> = (a..=b).filter(|n| !plain.contains(n)).collect();
            assert_eq!(set.missing(a, b), lacking.len() as u64);
            let gaps: Vec<u64> = set.gaps(a, b, usize::MAX).into_iter().flat_map(|(s, e)| s..=e).collect();
            assert_eq!(gaps, lacking, "{a}..={b}");
            assert_eq!(set.contains(a), plain.contains(&a));
        }
        let (mut even, mut whole) = (IntervalSet::default(), IntervalSet::default());
        (0..2100).step_by(2).for_each(|n| assert_eq!(even.insert(n, n), 1));
        whole.insert(0, 2100);
        let odd = set.without(&even);
        assert!((0..2100).all(|n| odd.contains(n) == (n % 2 == 1 && plain.contains(&n))));
        assert_eq!(set.without(&whole), IntervalSet::default());
        assert_eq!(set.missing(0, 3000), 3001 - plain.len() as u64);
        assert_eq!((set.min(), set.max()), (plain.first().copied(), plain.last().copied()));
    }

    #[test]
    fn the_largest_number_is_no_special_case() {
        let mut set = IntervalSet::default();
        set.insert(u64::MAX, u64::MAX);
        set.insert(5, 9);
        assert_eq!(set.gaps(0, u64::MAX, 9), [(0, 4), (10, u64::MAX - 1)]);
        assert_eq!(set.insert(u64::MAX - 1, u64::MAX), 1);
    }
}

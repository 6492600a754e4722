//! A set of sequence numbers, kept as inclusive ranges: what a recording has, and what it lacks.

use std::collections::BTreeMap;

/// Disjoint, non-touching, inclusive ranges of `u64`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IntervalSet {
    /// start → end
    ranges: BTreeMap<u64, u64>,
    count: u64,
}

impl IntervalSet {
    /// Adds `first..=last`; answers how many numbers were new.
    pub fn insert(&mut self, first: u64, last: u64) -> u64 {
        if first > last {
            return 0;
        }
        let before = self.count;
        let (mut start, mut end) = (first, last);
        // Ranges that overlap or touch: at most one begins before `first`, the others begin inside.
        if let Some((&s, &e)) = self.ranges.range(..=first).next_back()
            && e.saturating_add(1) >= first
        {
            if e >= last {
                return 0;
            }
            self.take(s, e);
            start = s;
        }
        while let Some((&s, &e)) = self.ranges.range(first..=last.saturating_add(1)).next() {
            self.take(s, e);
            end = end.max(e);
        }
        self.ranges.insert(start, end);
        self.count = self.count.saturating_add((end - start).saturating_add(1));
        self.count - before
    }

    fn take(&mut self, start: u64, end: u64) {
        self.ranges.remove(&start);
        self.count -= end - start + 1;
    }

    /// Adds everything of `other`.
    pub fn absorb(&mut self, other: &Self) {
        for (&start, &end) in &other.ranges {
            self.insert(start, end);
        }
    }

    /// What is in this set and not in `other`.
    pub fn without(&self, other: &Self) -> Self {
        let mut left = Self::default();
        for (&start, &end) in &self.ranges {
            for (first, last) in other.gaps(start, end, usize::MAX) {
                left.insert(first, last);
            }
        }
        left
    }

    /// Is `number` in the set?
    pub fn contains(&self, number: u64) -> bool {
        self.ranges.range(..=number).next_back().is_some_and(|(_, &end)| end >= number)
    }

    /// How many numbers.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Smallest number.
    pub fn min(&self) -> Option<u64> {
        self.ranges.first_key_value().map(|(&start, _)| start)
    }

    /// Largest number.
    pub fn max(&self) -> Option<u64> {
        self.ranges.last_key_value().map(|(_, &end)| end)
    }

    /// The ranges of `first..=last` that are not in the set, in order, at most `limit`.
    pub fn gaps(&self, first: u64, last: u64, limit: usize) -> Vec<(u64, u64)> {
        let mut gaps = Vec::new();
        let mut next = first;
        if let Some((_, &end)) = self.ranges.range(..=first).next_back()
            && end >= first
        {
            next = end.saturating_add(1);
        }
        for (&start, &end) in self.ranges.range(first.saturating_add(1)..) {
            if start > last || gaps.len() >= limit || next > last {
                break;
            }
            if start > next {
                gaps.push((next, start - 1));
            }
            next = next.max(end.saturating_add(1));
        }
        if next <= last && gaps.len() < limit && !self.contains(last) {
            gaps.push((next, last));
        }
        gaps
    }

    /// How many numbers of `first..=last` are not in the set.
    pub fn missing(&self, first: u64, last: u64) -> u64 {
        if first > last {
            return 0;
        }
        if self.min().is_none_or(|min| min >= first) && self.max().is_none_or(|max| max <= last) {
            // The usual question, and cheap however many ranges there are.
            return (last - first).saturating_add(1) - self.count;
        }
        let mut held: u64 = 0;
        if let Some((_, &end)) = self.ranges.range(..first).next_back()
            && end >= first
        {
            held += end.min(last) - first + 1;
        }
        for (&start, &end) in self.ranges.range(first..=last) {
            held += end.min(last) - start + 1;
        }
        (last - first).saturating_add(1) - held
    }
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

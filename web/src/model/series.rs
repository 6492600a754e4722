//! A bounded ring of samples with a min/max pyramid over it.
//!
//! Appending keeps a pyramid of blocks of 16, 256, 4096, … samples up to date (one merge per
//! level), so that the extent of any stretch of samples costs a few dozen comparisons, however long
//! the stretch is. A chart of 800 columns over 100 000 samples then reads some thousands of blocks
//! per frame instead of 100 000 samples, and nothing has to be invalidated when the window moves.
//!
//! Samples carry an absolute *number*, counted from the first sample ever appended, which stays
//! valid while the ring turns over; `first()..end()` are the numbers still held.
//!
//! Times are seconds as `f64` (an `f32` loses a millisecond after hours), values `f32`.

use std::ops::Range;

/// Samples (or blocks of the level below) per block of the pyramid.
const FAN: u64 = 16;

/// Smallest and largest finite value of some samples; empty when there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Smallest value; +∞ when empty.
    pub min: f32,
    /// Largest value; −∞ when empty.
    pub max: f32,
}

impl Extent {
    /// The extent of nothing.
    pub const EMPTY: Self = Self { min: f32::INFINITY, max: f32::NEG_INFINITY };

    /// Does it hold no value at all?
    pub fn is_empty(self) -> bool {
        self.min > self.max
    }

    /// Widened by one value; NaN and infinities are left out.
    pub fn with(self, value: f32) -> Self {
        if value.is_finite() { Self { min: self.min.min(value), max: self.max.max(value) } } else { self }
    }

    /// The extent of both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }
}

/// Blocks of one size, as a ring indexed by block number.
#[derive(Debug, Clone)]
struct Level {
    samples_per_block: u64,
    /// Most blocks it ever holds.
    room: u64,
    blocks: Vec<Extent>,
}

impl Level {
    fn slot(&self, block: u64) -> usize {
        (block % self.room) as usize
    }
}

/// A bounded ring of `(time in seconds, value)`, oldest dropped first. See the module documentation.
#[derive(Debug, Clone)]
pub struct Series {
    times_s: Vec<f64>,
    values: Vec<f32>,
    capacity: usize,
    /// Numbers of the samples held.
    held: Range<u64>,
    levels: Vec<Level>,
    max_gap_s: f64,
    /// Once the oldest sample is older, s, it takes no more memory.
    span_s: f64,
}

impl Series {
    /// An empty ring for `capacity` samples (at least one). Memory is taken as samples arrive.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        let mut levels = Vec::new();
        let mut samples_per_block = FAN;
        while samples_per_block < capacity as u64 {
            // Two more than fit: the blocks at both ends may be held in part.
            let room = capacity as u64 / samples_per_block + 2;
            levels.push(Level { samples_per_block, room, blocks: Vec::new() });
            samples_per_block *= FAN;
        }
        let (max_gap_s, span_s) = (f64::INFINITY, f64::INFINITY);
        Self { times_s: Vec::new(), values: Vec::new(), capacity, held: 0..0, levels, max_gap_s, span_s }
    }

    /// The same for as many samples as come within `span_s`, if those are fewer.
    pub fn with_span(self, span_s: f64) -> Self {
        Self { span_s, ..self }
    }

    /// The same, drawn with a gap wherever two neighbours are further apart than `max_gap_s`.
    pub fn with_max_gap(mut self, max_gap_s: f64) -> Self {
        self.max_gap_s = max_gap_s;
        self
    }

    /// A ring just large enough for these samples.
    pub fn from_samples(samples: impl IntoIterator<Item = (f64, f32)>) -> Self {
        let samples: Vec<_> = samples.into_iter().collect();
        let mut series = Self::new(samples.len());
        for (time_s, value) in samples {
            series.push(time_s, value);
        }
        series
    }

    /// Append a sample. NaN is kept and shows as a gap. A time that is not finite, or before the
    /// newest held, is refused (`false`).
    pub fn push(&mut self, time_s: f64, value: f32) -> bool {
        if !time_s.is_finite() || self.last().is_some_and(|(last_s, _)| time_s < last_s) {
            return false;
        }
        let number = self.held.end;
        // As long as it grows, numbers are places.
        let grows = number == self.times_s.len() as u64 && self.times_s.len() < self.capacity;
        if grows && self.times_s.first().is_some_and(|first_s| time_s - first_s > self.span_s) {
            self.capacity = self.times_s.len();
        }
        let slot = (number % self.capacity as u64) as usize;
        if slot == self.times_s.len() {
            self.times_s.push(time_s);
            self.values.push(value);
        } else {
            self.times_s[slot] = time_s;
            self.values[slot] = value;
        }
        self.held.end += 1;
        if self.len() > self.capacity {
            self.held.start += 1;
        }
        for level in &mut self.levels {
            let slot = level.slot(number / level.samples_per_block);
            if slot == level.blocks.len() {
                level.blocks.push(Extent::EMPTY);
            } else if number.is_multiple_of(level.samples_per_block) {
                level.blocks[slot] = Extent::EMPTY;
            }
            level.blocks[slot] = level.blocks[slot].with(value);
        }
        true
    }

    /// Takes away the samples from this number on, oldest first; their numbers are given anew.
    pub fn split_off(&mut self, number: u64) -> Vec<(f64, f32)> {
        let number = number.clamp(self.held.start, self.held.end);
        let taken = self.samples(number..self.held.end).collect();
        self.held.end = number;
        for i in 0..self.levels.len() {
            let level = &self.levels[i];
            let block = number / level.samples_per_block;
            let (slot, begin) = (level.slot(block), block * level.samples_per_block);
            // Of the block that is cut, what stays.
            if begin < number {
                self.levels[i].blocks[slot] = self.extent(begin..number);
            }
        }
        taken
    }

    /// Samples held.
    pub fn len(&self) -> usize {
        (self.held.end - self.held.start) as usize
    }

    /// Holds no sample?
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Neighbours further apart than this (s) are not joined by a line.
    pub fn max_gap_s(&self) -> f64 {
        self.max_gap_s
    }

    /// Number of the oldest sample held.
    pub fn first(&self) -> u64 {
        self.held.start
    }

    /// One past the number of the newest sample.
    pub fn end(&self) -> u64 {
        self.held.end
    }

    /// The sample with this number, if still held.
    pub fn get(&self, number: u64) -> Option<(f64, f32)> {
        self.held.contains(&number).then(|| self.sample(number))
    }

    /// The newest sample.
    pub fn last(&self) -> Option<(f64, f32)> {
        self.get(self.held.end.checked_sub(1)?)
    }

    /// The newest sample at or before a time: what a cursor there reads.
    pub fn at(&self, time_s: f64) -> Option<(f64, f32)> {
        self.get(self.upper_bound(time_s).checked_sub(1)?)
    }

    /// Times of the oldest and newest sample.
    pub fn time_span_s(&self) -> Option<(f64, f64)> {
        Some((self.get(self.held.start)?.0, self.last()?.0))
    }

    /// Number of the first sample at or after a time; [`Series::end`] if there is none.
    pub fn lower_bound(&self, time_s: f64) -> u64 {
        self.partition(self.held.clone(), |t| t < time_s)
    }

    /// Number of the first sample after a time; [`Series::end`] if there is none.
    pub fn upper_bound(&self, time_s: f64) -> u64 {
        self.partition(self.held.clone(), |t| t <= time_s)
    }

    /// [`Series::lower_bound`] for a time known to lie at or after sample `from`, found by doubling
    /// steps: walking the columns of a chart costs a few comparisons each.
    pub fn lower_bound_from(&self, from: u64, time_s: f64) -> u64 {
        let mut low = from.max(self.held.start);
        let mut step = 1;
        while low + step < self.held.end && self.time(low + step) < time_s {
            low += step;
            step *= 2;
        }
        self.partition(low..(low + step).min(self.held.end), |t| t < time_s)
    }

    /// Smallest and largest finite value among these samples; numbers no longer held are left out.
    pub fn extent(&self, range: Range<u64>) -> Extent {
        let mut start = range.start.max(self.held.start);
        let end = range.end.min(self.held.end);
        let mut extent = Extent::EMPTY;
        while start < end {
            // The largest block that begins here and ends in time: they are of FAN, FAN², … samples.
            let aligned = (start.trailing_zeros() / FAN.trailing_zeros()) as usize;
            let begins = self.levels.iter().take(aligned).rev();
            if let Some(level) = begins.into_iter().find(|level| start + level.samples_per_block <= end) {
                extent = extent.union(level.blocks[level.slot(start / level.samples_per_block)]);
                start += level.samples_per_block;
            } else {
                // Samples up to the next block border, in one go.
                let border = ((start / FAN + 1) * FAN).min(end);
                extent = self.values(start..border).fold(extent, |extent, value| extent.with(*value));
                start = border;
            }
        }
        extent
    }

    /// Smallest and largest finite value in `start_s..=end_s`.
    pub fn extent_between(&self, start_s: f64, end_s: f64) -> Extent {
        self.extent(self.lower_bound(start_s)..self.upper_bound(end_s))
    }

    /// The samples with these numbers that are still held, oldest first.
    pub fn samples(&self, range: Range<u64>) -> impl Iterator<Item = (f64, f32)> + '_ {
        (range.start.max(self.held.start)..range.end.min(self.held.end)).map(|number| self.sample(number))
    }

    /// When, after `from_s`, it came within `tolerance` of `value` and left it again; never is infinite.
    pub fn leaves(&self, value: f64, tolerance: f64, from_s: f64) -> f64 {
        let there = |sample: f32| (f64::from(sample) - value).abs() < tolerance;
        let mut after = self.samples(self.lower_bound(from_s)..u64::MAX).skip_while(|(_, sample)| !there(*sample));
        after.find(|(_, sample)| !there(*sample)).map_or(f64::INFINITY, |(t, _)| t)
    }

    /// Values of samples that are held, oldest first.
    fn values(&self, range: Range<u64>) -> impl Iterator<Item = &f32> {
        let slot = (range.start % self.capacity as u64) as usize;
        let count = (range.end - range.start) as usize;
        let straight = count.min(self.capacity - slot);
        self.values[slot..slot + straight].iter().chain(&self.values[..count - straight])
    }

    fn time(&self, number: u64) -> f64 {
        self.times_s[(number % self.capacity as u64) as usize]
    }

    /// `number` must be held.
    fn sample(&self, number: u64) -> (f64, f32) {
        let slot = (number % self.capacity as u64) as usize;
        (self.times_s[slot], self.values[slot])
    }

    fn partition(&self, range: Range<u64>, before: impl Fn(f64) -> bool) -> u64 {
        let (mut low, mut high) = (range.start, range.end);
        while low < high {
            let middle = low + (high - low) / 2;
            if before(self.time(middle)) { low = middle + 1 } else { high = middle }
        }
        low
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small deterministic generator (xorshift), so that tests need no crate.
    fn noise(seed: u64) -> impl FnMut() -> u64 {
        let mut state = seed.max(1);
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        }
    }

    fn brute_extent(series: &Series, range: Range<u64>) -> Extent {
        series.samples(range).fold(Extent::EMPTY, |extent, (_, value)| extent.with(value))
    }

    #[test]
    fn extents_equal_brute_force_while_the_ring_turns_over() {
        let mut next = noise(7);
        for capacity in [1, 5, 16, 17, 300, 5000] {
            let mut series = Series::new(capacity);
            for i in 0..12_000_u64 {
                let value = if next().is_multiple_of(50) { f32::NAN } else { (next() % 10_000) as f32 - 5000.0 };
                assert!(series.push(i as f64 * 0.01, value));
                if i % 97 == 0 {
                    let a = next() % (i + 2);
                    let b = a + next() % (capacity as u64 * 2);
                    assert_eq!(
                        series.extent(a..b),
                        brute_extent(&series, a..b),
                        "capacity {capacity}, {a}..{b} of {i}"
                    );
                }
            }
            assert_eq!(series.len(), capacity);
            assert_eq!(series.end(), 12_000);
        }
    }

    #[test]
    fn what_comes_rarely_is_held_for_its_span_only() {
        let mut series = Series::new(5000).with_span(60.0);
        for i in 0..3000_u64 {
            assert!(series.push(i as f64 * 0.5, (i % 700) as f32));
            let first = series.first();
            assert_eq!(series.extent(first..i + 1), brute_extent(&series, first..i + 1), "{i}");
        }
        let (from_s, to_s) = series.time_span_s().unwrap();
        assert_eq!((series.len(), series.end(), to_s - from_s), (121, 3000, 60.0));
    }

    #[test]
    fn what_was_taken_off_the_end_is_in_no_extent() {
        let mut next = noise(3);
        for capacity in [5, 16, 300, 5000] {
            let mut series = Series::new(capacity);
            for round in 0..40_u64 {
                for _ in 0..next() % 400 {
                    let value = (next() % 10_000) as f32 - 5000.0;
                    assert!(series.push(series.end() as f64, value));
                }
                let (first, end) = (series.first(), series.end());
                let cut = first + next() % (series.len() as u64 + 1);
                let expected: Vec<_> = series.samples(cut..end).collect();
                assert_eq!(series.split_off(cut), expected);
                assert_eq!((series.first(), series.end()), (first, cut));
                for (time_s, value) in expected.into_iter().take(3) {
                    assert!(series.push(time_s, -value));
                }
                for range in [first..series.end(), cut.saturating_sub(20)..cut + 2, first..cut] {
                    let brute = brute_extent(&series, range.clone());
                    assert_eq!(series.extent(range.clone()), brute, "capacity {capacity}, round {round}, {range:?}");
                }
            }
        }
    }

    #[test]
    fn memory_is_taken_as_samples_arrive() {
        let mut series = Series::new(1 << 20);
        let blocks = |series: &Series| series.levels.iter().map(|level| level.blocks.len()).collect::<Vec<_>>();
        assert_eq!(blocks(&series), [0; 4]);
        for i in 0..100 {
            series.push(f64::from(i), 1.0);
        }
        assert_eq!(blocks(&series), [7, 1, 1, 1]);
    }

    #[test]
    fn bounds_find_times_also_with_repeats_and_after_turning_over() {
        let mut series = Series::new(64);
        for i in 0..200_u64 {
            series.push((i / 3) as f64, i as f32);
        }
        let naive = |t: f64, inclusive: bool| {
            (series.first()..series.end())
                .find(|n| series.get(*n).is_some_and(|(s, _)| if inclusive { s > t } else { s >= t }))
                .unwrap_or(series.end())
        };
        for tenth in 0..700 {
            let t = f64::from(tenth) / 10.0;
            assert_eq!(series.lower_bound(t), naive(t, false), "{t}");
            assert_eq!(series.upper_bound(t), naive(t, true), "{t}");
            let from = series.lower_bound(t - 5.0);
            assert_eq!(series.lower_bound_from(from, t), naive(t, false), "{t} from {from}");
        }
    }

    #[test]
    fn a_value_is_left_after_it_was_reached() {
        let mut series = Series::new(64);
        for (t, value) in [(0.0, 0.3), (1.0, 0.5), (2.0, 0.8), (3.0, 0.8), (4.0, 0.7), (5.0, 0.8)] {
            series.push(t, value);
        }
        assert_eq!(series.leaves(0.8, 0.01, 0.5), 4.0);
        assert_eq!(series.leaves(0.8, 0.01, 4.5), f64::INFINITY);
        assert_eq!(series.leaves(0.9, 0.01, 0.0), f64::INFINITY);
    }

    #[test]
    fn times_never_run_backwards() {
        let mut series = Series::new(8);
        assert!(series.push(1.0, 1.0));
        assert!(series.push(1.0, 2.0));
        assert!(!series.push(0.5, 3.0));
        assert!(!series.push(f64::NAN, 3.0));
        assert_eq!((series.len(), series.last()), (2, Some((1.0, 2.0))));
        assert_eq!(series.at(0.9), None);
        assert_eq!(series.at(7.0), Some((1.0, 2.0)));
    }
}

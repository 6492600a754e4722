//! Constant deviations of one instance from its kind, learned in flight.
//!
//! A recursive mean first, whose gain is 1/n, then an exponential window: d ← d + γ (y − ŷ − d) with
//! γ = max(1/n, 1/N). Bounded, so that a slow ramp of an attack is not learned away for ever.

/// Learned offsets of `N` channels and the number of values they come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Baseline<const N: usize> {
    offset: [f64; N],
    values: u32,
}

impl<const N: usize> Baseline<N> {
    /// Zero, with the weight of so many values.
    pub const fn after(values: u32) -> Self {
        Self { offset: [0.0; N], values }
    }

    /// The offsets.
    pub fn offset(&self) -> &[f64; N] {
        &self.offset
    }

    /// Values counted so far.
    pub fn values(&self) -> u32 {
        self.values
    }

    /// Keeps the offsets, with the weight of so many values.
    pub fn weigh(&mut self, values: u32) {
        self.values = values;
    }

    /// Counts one more value.
    pub fn count(&mut self) {
        self.values = self.values.saturating_add(1);
    }

    /// γ: 1/n, where n is at least `fewest`, and at least `window` = 1/N.
    pub fn gain(&self, fewest: u32, window: f64) -> f64 {
        (1.0 / f64::from(self.values.max(fewest))).max(window)
    }

    /// Moves by `gain` times what is left of each deviation, to `limit` at most.
    pub fn learn(&mut self, rest: &[f64; N], gain: f64, limit: f64) {
        for (offset, rest) in self.offset.iter_mut().zip(rest) {
            *offset = (*offset + gain * rest).clamp(-limit, limit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_mean_first_then_a_window_and_stays_within_its_limit() {
        let mut baseline = Baseline::<1>::after(0);
        let mut take = |value: f64| {
            baseline.count();
            let gain = baseline.gain(1, 0.01);
            baseline.learn(&[value - baseline.offset()[0]], gain, 2.0);
            baseline.offset()[0]
        };
        assert!([1.0, 0.0, 0.5].map(&mut take).last().is_some_and(|mean| (mean - 0.5).abs() < 1e-12));
        let after_many = (0..1000).map(|_| take(1.0)).last().unwrap();
        assert!((after_many - 1.0).abs() < 1e-3);
        assert_eq!((0..2000).map(|_| take(9.0)).last(), Some(2.0));
    }
}

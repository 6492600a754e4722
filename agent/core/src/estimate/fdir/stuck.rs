//! Sensors that repeat themselves: equal samples in a row.

/// Counts equal samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stuck<const N: usize> {
    last: Option<[f64; N]>,
    repeats: u32,
}

impl<const N: usize> Stuck<N> {
    /// Takes a sample.
    pub fn take(&mut self, sample: [f64; N]) {
        // The same bits: no tolerance is meant.
        self.repeats = if self.last.is_some_and(|last| last == sample) { self.repeats.saturating_add(1) } else { 0 };
        self.last = Some(sample);
    }

    /// How many samples before the last one were the same in a row.
    pub fn repeats(&self) -> u32 {
        self.repeats
    }
}

/// How many equal samples in a row noise of `sigma`, read in steps of `resolution`, does not explain (once in
/// 10⁸). The chance of one is resolution / 2√π σ.
pub fn stuck_limit(sigma: f64, resolution: f64) -> u32 {
    let chance = (resolution / (3.545 * sigma)).clamp(1e-6, 0.5);
    ((1e-8f64).ln() / chance.ln()).ceil().clamp(3.0, 30.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_samples_are_counted() {
        let mut stuck = Stuck::<2>::default();
        let take = |sample| {
            stuck.take(sample);
            stuck.repeats()
        };
        assert_eq!([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 3.0]].map(take), [0, 1, 2, 0]);
        // 1 mm steps, 7 mm of noise: one in 25 is equal to the one before.
        assert_eq!(stuck_limit(0.007, 0.001), 6);
        assert_eq!(stuck_limit(1.0, 0.0), 3);
    }
}

//! How long the agent's tick took while flights were flown, condition by condition: of the machine that flew them, and so in a file of
//! its own and no part of any row.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::store::{Experiment, StoreError};

const FILE: &str = "ticks.json";
/// The first bin ends here, µs; each of the others is a quarter of an octave wide, so that what is read of them is 9 % off at most.
const FIRST_US: f64 = 0.5;
const PER_OCTAVE: f64 = 4.0;
/// Up to half a second.
const BINS: usize = 80;

/// Ticks by how long they took.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Ticks(Vec<u64>);

impl Ticks {
    pub(crate) fn add(&mut self, took: Duration) {
        let octaves = (took.as_secs_f64() * 1e6 / FIRST_US).max(1.0).log2();
        self.0.resize(BINS, 0);
        if let Some(count) = self.0.get_mut(((octaves * PER_OCTAVE).ceil() as usize).min(BINS - 1)) {
            *count += 1;
        }
    }

    fn absorb(&mut self, other: &Self) {
        self.0.resize(BINS, 0);
        self.0.iter_mut().zip(&other.0).for_each(|(count, theirs)| *count += theirs);
    }

    /// What `part` of them, 0 to 1, did not exceed, µs; `None` of none.
    fn quantile_us(&self, part: f64) -> Option<f64> {
        let wanted = part * self.0.iter().sum::<u64>() as f64;
        let mut below = 0;
        let bin = self.0.iter().position(|count| {
            below += count;
            below > 0 && below as f64 >= wanted
        })?;
        // The middle of the bin.
        Some(FIRST_US * 2_f64.powf((bin as f64 - 0.5) / PER_OCTAVE))
    }

    /// Median and 99 of 100, µs; `None` of none.
    pub fn figures_us(&self) -> Option<[f64; 2]> {
        Some([self.quantile_us(0.5)?, self.quantile_us(0.99)?])
    }
}

/// Those of every condition, as far as they were flown here.
pub(crate) fn kept(experiment: &Experiment) -> BTreeMap<u64, Ticks> {
    experiment.read_beside(FILE)
}

/// Ticks that are being gathered.
#[derive(Debug)]
pub(crate) struct Gathered(BTreeMap<u64, Ticks>);

impl Gathered {
    pub(crate) fn of(experiment: &Experiment) -> Self {
        Self(kept(experiment))
    }

    pub(crate) fn take(&mut self, condition: u64, ticks: &Ticks) {
        self.0.entry(condition).or_default().absorb(ticks);
    }

    /// # Errors
    /// [`StoreError::Io`].
    pub(crate) fn keep(&self, experiment: &Experiment) -> Result<(), StoreError> {
        experiment.keep_beside(FILE, &self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_the_ticks_within_a_bin() {
        let mut ticks = Ticks::default();
        assert_eq!(ticks.figures_us(), None);
        (1..=100).for_each(|n| ticks.add(Duration::from_micros(if n > 98 { 400 } else { 40 })));
        let [median, of_99] = ticks.figures_us().unwrap();
        assert!((36.4..44.0).contains(&median) && (364.0..440.0).contains(&of_99), "{median} {of_99}");
        let mut both = Ticks::default();
        both.absorb(&ticks);
        both.add(Duration::from_secs(9));
        assert_eq!(both.quantile_us(0.5), ticks.quantile_us(0.5));
        assert!(both.quantile_us(1.0).unwrap() > 4e5);
    }
}

//! A small vote of the IMUs: which of them differs from the median of all, over 0.2 s, by more than they usually do.
//!
//! Physical evidence takes a second to tell a false lane; the vote counts against one at once, and never alone for long.

use super::integral::Six;
use super::{LANES, PerLane, median_six};

/// Slots compared.
pub(super) const SLOTS: usize = 5;
/// Mean, and root mean square, beyond so many times the usual deviation count.
pub(super) const LIMITS: (f64, f64) = (2.2, 2.6);
/// No usual deviation is taken for smaller, m/s² and rad/s.
pub(super) const FLOOR: (f64, f64) = (0.06, 0.006);
/// Part of the vote kept from slot to slot, and what one slot adds.
const KEPT: f64 = 0.92;
const ADDED: f64 = 0.25;
/// Part of a bias learned from slot to slot, at first and later.
pub(super) const GAINS: (f64, f64) = (0.05, 0.01);

/// See the module.
#[derive(Debug, Clone)]
pub struct Vote {
    deviations: [PerLane<Option<Six>>; SLOTS],
    next: usize,
    usual: Option<Six>,
    against: PerLane<f64>,
    biases: PerLane<Option<Six>>,
}

impl Vote {
    /// Nothing against any.
    pub fn new() -> Self {
        Self { deviations: [[None; LANES]; SLOTS], next: 0, usual: None, against: [0.0; LANES], biases: [None; LANES] }
    }

    /// What is held against each lane, 0..1, less what is held against all.
    pub fn against(&self, present: &PerLane<bool>) -> PerLane<f64> {
        let of = self.against.iter().zip(present).filter(|(_, present)| **present);
        let least = of.map(|(against, _)| *against).fold(f64::INFINITY, f64::min);
        self.against.map(|against| (against - least).clamp(0.0, 1.0))
    }

    /// The biases of `lane` as they were before anything was held against it.
    pub fn bias(&self, lane: usize) -> Option<Six> {
        self.biases.get(lane).copied().flatten()
    }

    /// Follows the biases of the lanes, but for those in doubt: the step of a bias is never learned.
    pub fn learn(&mut self, biases: &PerLane<Option<Six>>, doubted: &PerLane<bool>, learning: bool) {
        let gain = if learning { GAINS.0 } else { GAINS.1 };
        for ((kept, bias), doubted) in self.biases.iter_mut().zip(biases).zip(doubted) {
            let Some(bias) = bias else { continue };
            let gain = if *doubted { 0.0 } else { gain };
            let kept = kept.get_or_insert(*bias);
            *kept += (bias - *kept) * gain;
        }
    }

    /// Takes the means of one slot.
    pub fn take(&mut self, means: &PerLane<Option<Six>>) {
        let known = || self.biases.iter().flatten();
        let count = known().count().max(1) as f64;
        let common = known().sum::<Six>() / count;
        let less = |i: usize| means[i].map(|mean| mean - self.biases[i].map_or_else(Six::zeros, |bias| bias - common));
        let means: PerLane<Option<Six>> = std::array::from_fn(less);
        let centre = median_six(means.iter().flatten());
        if let Some(place) = self.deviations.get_mut(self.next) {
            *place = means.map(|mean| mean.map(|mean| mean - centre));
        }
        self.next = (self.next + 1) % SLOTS;
        let (mut sizes, mut shifts) = ([None; LANES], [None; LANES]);
        for (i, (size, shift)) in sizes.iter_mut().zip(&mut shifts).enumerate() {
            let of = || self.deviations.iter().filter_map(|slot| slot[i]);
            let n = of().count() as f64;
            if n >= 3.0 {
                *size = Some((of().map(|d| d.component_mul(&d)).sum::<Six>() / n).map(f64::sqrt));
                *shift = Some(of().sum::<Six>() / n);
            }
        }
        if sizes.iter().flatten().count() < 2 {
            return;
        }
        let now = median_six(sizes.iter().flatten());
        let before = self.usual.unwrap_or(now);
        let usual = before.zip_map(&now, |b, n| b + (n - b) * if n > b { 0.05 } else { 0.01 });
        self.usual = Some(usual);
        let (a, g) = FLOOR;
        let scale = usual.sup(&now).sup(&Six::new(a, a, a, g, g, g));
        for ((against, size), shift) in self.against.iter_mut().zip(&sizes).zip(&shifts) {
            let ratio = size.zip(*shift).map_or(0.0, |(size, shift)| {
                let most = |v: &Six, limit: f64| v.component_div(&scale).amax() / limit;
                most(&shift, LIMITS.0).max(most(&size, LIMITS.1))
            });
            *against = (KEPT * *against + ADDED * (ratio - 1.0).clamp(0.0, 2.0)).clamp(0.0, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_differs_is_voted_against_and_one_that_always_did_is_not() {
        let mut vote = Vote::new();
        let noise = |k: usize, i: usize| 0.03 * ((k * 37 + i * 101) as f64 * 1.618).sin();
        let own = [0.3, -0.2, 0.1, 0.0];
        let bias = |i: usize| (i < 4).then(|| Six::new(0.0, 0.0, own[i], 0.0, 0.0, 0.0));
        vote.learn(&std::array::from_fn(bias), &[false; LANES], true);
        let mut run = |from: usize, attack: f64| {
            for k in from..from + 30 {
                let mean = |i: usize| {
                    let z = 9.81 + own[i.min(3)] + noise(k, i) + if i == 1 { attack } else { 0.0 };
                    (i < 4).then(|| Six::new(0.0, 0.0, z, 0.0, 0.0, 0.0))
                };
                vote.take(&std::array::from_fn(mean));
            }
            vote.against(&[true, true, true, true, false])
        };
        assert!(run(0, 0.0).iter().all(|a| *a < 0.2));
        let against = run(30, 1.0);
        assert!(against[1] > 0.9 && against[0] < 0.2 && against[2] < 0.2 && against[3] < 0.2, "{against:?}");
    }
}

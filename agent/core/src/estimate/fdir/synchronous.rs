//! IMUs that sample at the same instants, against one another.
//!
//! They feel the same vibration, which is what hides a slow attack from those that sample at other times
//! (`inertial.rs`): what they differ by is their own noise, a quarter of it in flight. Of three and more the one that
//! leaves the median is diverging. Of two that drift from each other, the one that has drifted further from all IMUs
//! since is diverging. It is excluded while enough others remain; none is isolated for this.
//!
//! | symbol | meaning |
//! |---|---|
//! | d | slot mean of one IMU, its constant offset removed, less the median of those that sample with it |
//! | σ_d | rms of d over `SPREAD_S`, at least what d changed by since the slot before; scale errors in motion on top |
//!
//! A CUSUM of d/σ_d above `DIVERGING` of its limit begins a divergence: with independent values once in some minutes
//! for all axes of four IMUs (Wald). It ends where noise takes the sum.

use super::baseline::Baseline;
use super::cusum::Cusum;
use crate::estimate::median;
use crate::sensor::MAX_IMUS;

/// Part of a CUSUM's limit at which a divergence begins.
const DIVERGING: f64 = 0.5;
/// Over which the spread is measured, s.
const SPREAD_S: f64 = 10.0;
/// Time constant of the offsets, s.
const OFFSET_S: f64 = 20.0;
/// Offset and spread are the mean of what was seen before, the first of it of so many values.
const FIRST_WEIGHS: u32 = 10;
/// Slot means this near to one another in time are of the same instants, s.
const SAME_S: f64 = 1e-4;
/// Larger differences are no larger, rad/s and m/s²: their squares must stay numbers.
const LARGEST: f64 = 1e3;
/// Slots without peers after which what was found against them is forgotten.
const ALONE_SLOTS: u32 = 4;

/// Slot mean of one IMU.
#[derive(Debug, Clone, Copy)]
pub struct SlotMean {
    /// Gyroscope x y z, rad/s, accelerometer x y z, m/s².
    pub value: [f64; 6],
    /// Mean time of its samples, s.
    pub middle_s: f64,
    /// How many.
    pub samples: u32,
}

#[derive(Debug, Clone, Copy)]
struct Unit {
    baseline: Baseline<6>,
    /// Mean square of d.
    square: [f64; 6],
    before: Option<[f64; 6]>,
    cusum: [Cusum; 6],
    /// Its drift from the median of all IMUs, summed up since the divergence began.
    drift: [f64; 6],
    /// With which it was compared last, one bit each.
    peers: u32,
    /// Slots without peers.
    alone: u32,
    diverging: bool,
}

impl Default for Unit {
    fn default() -> Self {
        Self {
            baseline: Baseline::after(0),
            square: [0.0; 6],
            before: None,
            cusum: [Cusum::default(); 6],
            drift: [0.0; 6],
            peers: 0,
            alone: 0,
            diverging: false,
        }
    }
}

impl Unit {
    /// Its worst axis, and what that says.
    fn worst(&self) -> (usize, Cusum) {
        let worst = self.cusum.into_iter().enumerate().max_by(|a, b| a.1.ratio().total_cmp(&b.1.ratio()));
        worst.unwrap_or_default()
    }

    fn take(&mut self, d: &[f64; 6], from_all: &[f64; 6], scale: &[f64; 6], slot_s: f64, learning: bool) {
        self.baseline.count();
        let calm = learning || self.worst().1.is_calm();
        for axis in 0..6 {
            let now = d[axis] * d[axis];
            let changed = self.before.map_or(0.0, |before| 0.5 * (d[axis] - before[axis]).powi(2));
            let variance = self.square[axis].max(changed) + scale[axis] * scale[axis];
            if !learning && variance > 0.0 {
                self.cusum[axis].take(d[axis] / variance.sqrt());
            }
            if self.cusum[axis].lasts() == 0 {
                self.drift[axis] = 0.0;
            } else if from_all[axis].is_finite() {
                self.drift[axis] += from_all[axis];
            }
            if calm {
                self.square[axis] += self.baseline.gain(FIRST_WEIGHS, slot_s / SPREAD_S) * (now - self.square[axis]);
            }
        }
        if calm {
            self.baseline.learn(d, self.baseline.gain(FIRST_WEIGHS, slot_s / OFFSET_S), f64::INFINITY);
        }
        self.before = Some(*d);
        let worst = self.worst().1;
        self.diverging = if self.diverging { !worst.is_calm() } else { worst.ratio() > DIVERGING };
    }
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Synchronous {
    units: [Unit; MAX_IMUS],
}

impl Synchronous {
    /// Takes a slot of `slot_s`, with what each IMU differs `from_all` by, constants removed: `isolated` IMUs are no peers;
    /// `scale` is what scale errors let healthy ones differ by now. While `learning`, none diverges.
    pub fn take(
        &mut self,
        slots: &[Option<SlotMean>; MAX_IMUS],
        from_all: &[[f64; 6]; MAX_IMUS],
        isolated: impl Fn(usize) -> bool,
        scale: &[f64; 6],
        slot_s: f64,
        learning: bool,
    ) {
        let before = self.units;
        let healthy = |i: usize| slots[i].filter(|_| !isolated(i));
        for (i, unit) in self.units.iter_mut().enumerate() {
            let own = healthy(i);
            let with = |j: usize| {
                own.zip(healthy(j))
                    .is_some_and(|(a, b)| a.samples == b.samples && (a.middle_s - b.middle_s).abs() < SAME_S)
            };
            let peers = || (0..MAX_IMUS).filter(|j| with(*j));
            if peers().count() < 2 {
                unit.before = None;
                unit.alone = unit.alone.saturating_add(1);
                if unit.alone >= ALONE_SLOTS {
                    (unit.cusum, unit.diverging) = (Default::default(), false);
                }
                continue;
            }
            (unit.alone, unit.peers) = (0, peers().map(|j| 1 << j).sum());
            let less_offset = |j: usize, axis: usize| {
                slots[j].map_or(f64::NAN, |s| s.value[axis] - before[j].baseline.offset()[axis])
            };
            let d: [f64; 6] = std::array::from_fn(|axis| {
                let d = less_offset(i, axis) - median(peers().map(|j| less_offset(j, axis)));
                d.clamp(-LARGEST, LARGEST)
            });
            if d.iter().all(|d| d.is_finite()) {
                unit.take(&d, &from_all[i], scale, slot_s, learning);
            }
        }
    }

    /// For how long an IMU that diverges has done so, slots.
    pub fn diverging_for(&self, imu: usize) -> Option<u32> {
        let unit = self.units.get(imu).filter(|unit| unit.diverging)?;
        let (axis, drift) = unit.worst();
        let suspects = self.units.iter().enumerate().filter(|(j, other)| other.diverging && unit.peers & (1 << j) != 0);
        let furthest = suspects.map(|(_, other)| other.drift[axis].abs()).fold(0.0, f64::max);
        (unit.drift[axis].abs() >= furthest).then(|| drift.lasts())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOT_S: f64 = 0.04;

    /// Pairs 1, 3 and 2, 4 that sample in turns: a vibration for each pair, noise a tenth of it, and IMU 2's attack.
    fn slots(k: u64, attack: f64) -> [Option<SlotMean>; MAX_IMUS] {
        std::array::from_fn(|i| {
            let constant = 0.3 * (i as f64 - 1.5);
            let value = std::array::from_fn(|axis| constant + axis as f64 + differs(k, i, axis, attack));
            (i < 4).then_some(SlotMean { value, middle_s: 0.02 + 0.005 * (i % 2) as f64, samples: 4 })
        })
    }

    fn differs(k: u64, i: usize, axis: usize, attack: f64) -> f64 {
        // White: uniform of unit variance, from the bits of both numbers (splitmix64).
        let noise = |k: u64, i: usize| {
            let mut z = (1000 * k + i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            3.464 * ((z ^ (z >> 31)) as f64 / u64::MAX as f64 - 0.5)
        };
        noise(k, 100 + i % 2) + 0.1 * noise(k, 10 * i + axis) + if i == 1 { attack } else { 0.0 }
    }

    fn take(synchronous: &mut Synchronous, k: u64, attack: f64, isolated: impl Fn(usize) -> bool) {
        let from_all = std::array::from_fn(|i| std::array::from_fn(|axis| differs(k, i, axis, attack)));
        synchronous.take(&slots(k, attack), &from_all, isolated, &[0.0; 6], SLOT_S, k < 50);
    }

    fn flown(attack: impl Fn(u64) -> f64, slot_count: u64) -> Synchronous {
        let mut synchronous = Synchronous::default();
        (0..slot_count).for_each(|k| take(&mut synchronous, k, attack(k), |_| false));
        synchronous
    }

    fn diverging(synchronous: &Synchronous) -> [bool; 4] {
        std::array::from_fn(|i| synchronous.diverging_for(i).is_some())
    }

    #[test]
    fn a_pair_that_diverges_is_found_long_before_its_vibration_is_reached() {
        assert_eq!(diverging(&flown(|_| 0.0, 15_000)), [false; 4]);
        // The attack comes to half of the vibration.
        let ramp = |k: u64| 0.03 * k.saturating_sub(300) as f64;
        assert_eq!(diverging(&flown(ramp, 300)), [false; 4]);
        let drifted = flown(ramp, 317);
        assert_eq!(diverging(&drifted), [false, true, false, false]);
        assert!(drifted.units[3].diverging, "a suspect as well");
        assert!((5..=17).contains(&drifted.diverging_for(1).unwrap()), "{:?}", drifted.diverging_for(1));
    }

    #[test]
    fn a_divergence_ends_with_the_drift_and_without_peers() {
        let mut synchronous = flown(|k| 0.03 * k.saturating_sub(300) as f64, 317);
        let mut healthy = synchronous.clone();
        (317..322).for_each(|k| take(&mut synchronous, k, 1.0, |i| i == 1));
        assert!(diverging(&synchronous) == [false; 4] && !synchronous.units[3].diverging);
        (317..345).for_each(|k| take(&mut healthy, k, 0.0, |_| false));
        assert_eq!(diverging(&healthy), [false; 4]);
    }

    #[test]
    fn a_shock_and_values_that_are_not_finite_exclude_nothing() {
        let mut synchronous = flown(|_| 0.0, 300);
        for k in 300..600 {
            let mut now = slots(k, if k % 100 == 0 { 3.0 } else { 0.0 });
            if k % 7 == 0 {
                now[2].as_mut().unwrap().value = [[f64::NAN, 1e300][k as usize % 2]; 6];
            }
            synchronous.take(&now, &[[f64::NAN; 6]; MAX_IMUS], |_| false, &[0.0; 6], SLOT_S, false);
            assert_eq!(diverging(&synchronous), [false; 4], "{k}");
        }
        let numbers = |unit: &Unit| unit.baseline.offset().iter().chain(&unit.square).all(|v| v.is_finite());
        assert!(synchronous.units.iter().all(numbers));
    }
}

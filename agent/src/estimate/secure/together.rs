//! IMUs that sample at the same instants, against one another.
//!
//! They feel the same vibration, which is what hides a slow lie from those that sample at other times (`inertial.rs`):
//! what they differ by is their own noise, a quarter of it in flight. Of three and more the one that leaves the median is
//! doubted. Two that drift apart accuse each other: the one that has come further from all IMUs since they do is doubted.
//! Who is doubted is left out while enough others remain; nobody is flagged for this.
//!
//! | symbol | meaning |
//! |---|---|
//! | d | slot mean of one IMU, its constant offset removed, less the median of those that sample with it |
//! | σ_d | rms of d over [`SPREAD_S`], at least what d changed by since the slot before; scale errors in motion on top |
//!
//! A CUSUM of d/σ_d (Page 1954) above [`DOUBT`] of its limit begins the doubt: with independent values once in some minutes
//! for all axes of four IMUs (Wald). It ends where noise takes the sum.

use super::identify::Cusum;
use crate::estimate::median;
use crate::vehicle::MAX_IMUS;

/// Part of a CUSUM's limit at which a doubt begins.
const DOUBT: f64 = 0.5;
/// Over which the spread is measured, s.
const SPREAD_S: f64 = 10.0;
/// Time constant of the offsets, s.
const OFFSET_S: f64 = 20.0;
/// Offset and spread are the mean of what was seen before, the first of it of so many values.
const FEWEST_LESSONS: u32 = 10;
/// Slot means this near to one another in time are of the same instants, s.
const SAME_S: f64 = 1e-4;
/// Larger differences are no larger, rad/s and m/s²: their squares must stay numbers.
const LARGEST: f64 = 1e3;
/// Slots without company after which what company told is forgotten.
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

#[derive(Debug, Clone, Copy, Default)]
struct Unit {
    offset: [f64; 6],
    square: [f64; 6],
    before: Option<[f64; 6]>,
    lessons: u32,
    cusum: [Cusum; 6],
    /// What it has come from the median of all IMUs since the drift began.
    come: [f64; 6],
    /// With whom it was compared last, one bit each.
    company: u32,
    alone: u32,
    apart: bool,
}

impl Unit {
    /// Its worst axis, and what that says.
    fn worst(&self) -> (usize, Cusum) {
        let worst = self.cusum.into_iter().enumerate().max_by(|a, b| a.1.ratio().total_cmp(&b.1.ratio()));
        worst.unwrap_or_default()
    }

    fn take(&mut self, d: &[f64; 6], from_all: &[f64; 6], scale: &[f64; 6], slot_s: f64, learning: bool) {
        self.lessons = self.lessons.saturating_add(1);
        let first = 1.0 / f64::from(self.lessons.max(FEWEST_LESSONS));
        let calm = learning || self.worst().1.is_calm();
        for axis in 0..6 {
            let now = d[axis] * d[axis];
            let changed = self.before.map_or(0.0, |before| 0.5 * (d[axis] - before[axis]).powi(2));
            let variance = self.square[axis].max(changed) + scale[axis] * scale[axis];
            if !learning && variance > 0.0 {
                self.cusum[axis].take(d[axis] / variance.sqrt());
            }
            if self.cusum[axis].lasts() == 0 {
                self.come[axis] = 0.0;
            } else if from_all[axis].is_finite() {
                self.come[axis] += from_all[axis];
            }
            if calm {
                self.square[axis] += first.max(slot_s / SPREAD_S) * (now - self.square[axis]);
                self.offset[axis] += first.max(slot_s / OFFSET_S) * d[axis];
            }
        }
        self.before = Some(*d);
        let worst = self.worst().1;
        self.apart = if self.apart { !worst.is_calm() } else { worst.ratio() > DOUBT };
    }
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Together {
    units: [Unit; MAX_IMUS],
}

impl Together {
    /// Takes a slot of `slot_s`, with what each IMU differs `from_all` by, constants removed: `flagged` IMUs are no company;
    /// `scale` is what scale errors let honest ones differ by now. While `learning`, nobody is doubted.
    pub fn take(
        &mut self,
        slots: &[Option<SlotMean>; MAX_IMUS],
        from_all: &[[f64; 6]; MAX_IMUS],
        flagged: impl Fn(usize) -> bool,
        scale: &[f64; 6],
        slot_s: f64,
        learning: bool,
    ) {
        let before = self.units;
        let honest = |i: usize| slots[i].filter(|_| !flagged(i));
        for (i, unit) in self.units.iter_mut().enumerate() {
            let own = honest(i);
            let with = |j: usize| {
                own.zip(honest(j))
                    .is_some_and(|(a, b)| a.samples == b.samples && (a.middle_s - b.middle_s).abs() < SAME_S)
            };
            let company = || (0..MAX_IMUS).filter(|j| with(*j));
            if company().count() < 2 {
                unit.before = None;
                unit.alone = unit.alone.saturating_add(1);
                if unit.alone >= ALONE_SLOTS {
                    (unit.cusum, unit.apart) = (Default::default(), false);
                }
                continue;
            }
            (unit.alone, unit.company) = (0, company().map(|j| 1 << j).sum());
            let less_offset =
                |j: usize, axis: usize| slots[j].map_or(f64::NAN, |s| s.value[axis] - before[j].offset[axis]);
            let d: [f64; 6] = std::array::from_fn(|axis| {
                let d = less_offset(i, axis) - median(company().map(|j| less_offset(j, axis)));
                d.clamp(-LARGEST, LARGEST)
            });
            if d.iter().all(|d| d.is_finite()) {
                unit.take(&d, &from_all[i], scale, slot_s, learning);
            }
        }
    }

    /// For how long the drift of an IMU that is doubted has lasted, slots.
    pub fn doubted_for(&self, imu: usize) -> Option<u32> {
        let unit = self.units.get(imu).filter(|unit| unit.apart)?;
        let (axis, drift) = unit.worst();
        let accused = self.units.iter().enumerate().filter(|(j, other)| other.apart && unit.company & (1 << j) != 0);
        let furthest = accused.map(|(_, other)| other.come[axis].abs()).fold(0.0, f64::max);
        (unit.come[axis].abs() >= furthest).then(|| drift.lasts())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOT_S: f64 = 0.04;

    /// Pairs 1, 3 and 2, 4 that sample in turns: a vibration for each pair, noise a tenth of it, and IMU 2's lie.
    fn slots(k: u64, lie: f64) -> [Option<SlotMean>; MAX_IMUS] {
        std::array::from_fn(|i| {
            let constant = 0.3 * (i as f64 - 1.5);
            let value = std::array::from_fn(|axis| constant + axis as f64 + differs(k, i, axis, lie));
            (i < 4).then_some(SlotMean { value, middle_s: 0.02 + 0.005 * (i % 2) as f64, samples: 4 })
        })
    }

    fn differs(k: u64, i: usize, axis: usize, lie: f64) -> f64 {
        // White: uniform of unit variance, from the bits of both numbers (splitmix64).
        let noise = |k: u64, i: usize| {
            let mut z = (1000 * k + i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            3.464 * ((z ^ (z >> 31)) as f64 / u64::MAX as f64 - 0.5)
        };
        noise(k, 100 + i % 2) + 0.1 * noise(k, 10 * i + axis) + if i == 1 { lie } else { 0.0 }
    }

    fn take(together: &mut Together, k: u64, lie: f64, flagged: impl Fn(usize) -> bool) {
        let from_all = std::array::from_fn(|i| std::array::from_fn(|axis| differs(k, i, axis, lie)));
        together.take(&slots(k, lie), &from_all, flagged, &[0.0; 6], SLOT_S, k < 50);
    }

    fn flown(lie: impl Fn(u64) -> f64, slot_count: u64) -> Together {
        let mut together = Together::default();
        (0..slot_count).for_each(|k| take(&mut together, k, lie(k), |_| false));
        together
    }

    fn doubted(together: &Together) -> [bool; 4] {
        std::array::from_fn(|i| together.doubted_for(i).is_some())
    }

    #[test]
    fn a_pair_that_drifts_apart_is_doubted_long_before_its_vibration_is_reached() {
        assert_eq!(doubted(&flown(|_| 0.0, 15_000)), [false; 4]);
        // The lie comes to half of the vibration.
        let ramp = |k: u64| 0.03 * k.saturating_sub(300) as f64;
        assert_eq!(doubted(&flown(ramp, 300)), [false; 4]);
        let drifted = flown(ramp, 317);
        assert_eq!(doubted(&drifted), [false, true, false, false]);
        assert!(drifted.units[3].apart, "accused as well");
        assert!((5..=17).contains(&drifted.doubted_for(1).unwrap()), "{:?}", drifted.doubted_for(1));
    }

    #[test]
    fn a_doubt_ends_with_the_drift_and_without_company() {
        let mut together = flown(|k| 0.03 * k.saturating_sub(300) as f64, 317);
        let mut honest = together.clone();
        (317..322).for_each(|k| take(&mut together, k, 1.0, |i| i == 1));
        assert!(doubted(&together) == [false; 4] && !together.units[3].apart);
        (317..345).for_each(|k| take(&mut honest, k, 0.0, |_| false));
        assert_eq!(doubted(&honest), [false; 4]);
    }

    #[test]
    fn a_shock_and_values_that_are_not_finite_accuse_nobody() {
        let mut together = flown(|_| 0.0, 300);
        for k in 300..600 {
            let mut now = slots(k, if k % 100 == 0 { 3.0 } else { 0.0 });
            if k % 7 == 0 {
                now[2].as_mut().unwrap().value = [[f64::NAN, 1e300][k as usize % 2]; 6];
            }
            together.take(&now, &[[f64::NAN; 6]; MAX_IMUS], |_| false, &[0.0; 6], SLOT_S, false);
            assert_eq!(doubted(&together), [false; 4], "{k}");
        }
        let numbers = |unit: &Unit| unit.offset.iter().chain(&unit.square).all(|v| v.is_finite());
        assert!(together.units.iter().all(numbers));
    }
}

//! The integral of one IMU's samples, on its own clock: what it says of a slot does not depend on when in the slot it
//! sampled, nor on how often.

use nalgebra::SVector;
use plumbline_proto::time::FlightTime;

use super::SLOT_US;
use crate::estimate::fdir::stuck::Stuck;
use crate::sensor::ImuSample;

/// Specific force (m/s²) and angular rate (rad/s), body FLU; or their integrals.
pub type Six = SVector<f64, 6>;

/// A longer interval between two samples says nothing of what was between them, s.
const GAP_S: f64 = 0.03;
/// After a longer one the integral begins anew, s.
const LOST_S: f64 = 0.25;
/// Slots kept: more than the fusion horizon is back.
const KEPT: usize = 16;
/// Equal samples in a row that no noise makes.
const STUCK: u32 = 12;

/// Integral from the first sample to a boundary between two slots.
#[derive(Debug, Clone, Copy)]
struct Boundary {
    slot: u64,
    total: Six,
    /// Was the slot that begins here sampled without a gap?
    whole: bool,
    /// Sum of squared changes from sample to sample up to here, and their number.
    changes: (Six, f64),
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Integral {
    last: Option<(FlightTime, Six)>,
    /// Mean of the last two specific forces and the last rate: what is held until the next sample.
    held: Six,
    total: Six,
    changes: (Six, f64),
    boundaries: [Option<Boundary>; KEPT],
    /// Time of the sample after the last gap.
    gap_end: FlightTime,
    stuck: Stuck<6>,
}

impl Integral {
    /// Of nothing.
    pub fn new() -> Self {
        Self {
            last: None,
            held: Six::zeros(),
            total: Six::zeros(),
            changes: (Six::zeros(), 0.0),
            boundaries: [None; KEPT],
            gap_end: FlightTime(0),
            stuck: Stuck::default(),
        }
    }

    /// Takes a sample; one that is not finite, or not newer than the last, is skipped.
    pub fn take(&mut self, sample: &ImuSample) {
        let (f, w) = (sample.accel_mps2, sample.gyro_radps);
        let value = Six::new(f.x, f.y, f.z, w.x, w.y, w.z);
        if !value.iter().all(|v| v.is_finite()) || self.last.is_some_and(|(time, _)| sample.time <= time) {
            return;
        }
        self.stuck.take(value.into());
        let since_s = self.last.map_or(f64::INFINITY, |(time, _)| sample.time.seconds_since(time));
        match self.last {
            Some((from, before)) if since_s <= LOST_S => self.extend(from, &before, sample.time, &value),
            _ => {
                *self = Self { stuck: self.stuck, held: value, gap_end: sample.time, ..Self::new() };
            }
        }
        self.last = Some((sample.time, value));
    }

    fn extend(&mut self, from: FlightTime, before: &Six, to: FlightTime, value: &Six) {
        let whole_s = to.seconds_since(from);
        let gap = whole_s > GAP_S;
        let (first, last) = (from.0 / SLOT_US, to.0 / SLOT_US);
        if gap {
            self.gap_end = to;
            self.mark_broken(first);
        }
        for slot in first + 1..=last {
            let part_s = FlightTime(slot * SLOT_US).seconds_since(from);
            let there = before + (value - before) * (part_s / whole_s);
            let total = self.total + (before + there) * (0.5 * part_s);
            if let Some(place) = self.boundaries.get_mut((slot % KEPT as u64) as usize) {
                *place = Some(Boundary { slot, total, whole: !gap, changes: self.changes });
            }
        }
        self.total += (before + value) * (0.5 * whole_s);
        let change = value - before;
        self.changes = (self.changes.0 + change.component_mul(&change), self.changes.1 + 1.0);
        self.held = *value;
        self.held.fixed_rows_mut::<3>(0).copy_from(&((before + value) * 0.5).fixed_rows::<3>(0));
    }

    fn mark_broken(&mut self, slot: u64) {
        if let Some(Some(boundary)) = self.boundaries.get_mut((slot % KEPT as u64) as usize)
            && boundary.slot == slot
        {
            boundary.whole = false;
        }
    }

    fn boundary(&self, slot: u64) -> Option<&Boundary> {
        self.boundaries.get((slot % KEPT as u64) as usize)?.as_ref().filter(|boundary| boundary.slot == slot)
    }

    /// Mean over `slot`; `None` where it was not sampled from end to end.
    pub fn mean(&self, slot: u64) -> Option<Six> {
        let begin = self.boundary(slot).filter(|boundary| boundary.whole)?;
        let end = self.boundary(slot + 1)?;
        Some((end.total - begin.total) / (1e-6 * SLOT_US as f64))
    }

    /// One-sigma of a sample in `slot` about the one before, over √2: noise, and how much it is shaken.
    pub fn roughness(&self, slot: u64) -> Option<Six> {
        let (begin, end) = (self.boundary(slot)?.changes, self.boundary(slot + 1)?.changes);
        let count = end.1 - begin.1;
        (count > 0.0).then(|| ((end.0 - begin.0).map(|x| x.max(0.0)) / (2.0 * count)).map(f64::sqrt))
    }

    /// Integral up to the beginning of `slot`, where that was sampled.
    pub fn total_at(&self, slot: u64) -> Option<Six> {
        self.boundary(slot).map(|boundary| boundary.total)
    }

    /// Integral up to `now`, the last sample held, and when its present stretch without a gap began; `None` in a gap.
    pub fn total_now(&self, now: FlightTime) -> Option<(Six, FlightTime)> {
        let age_s = now.seconds_since(self.last?.0);
        (age_s <= GAP_S).then(|| (self.total + self.held * age_s.max(0.0), self.gap_end))
    }

    /// The last sample and its time, where it is recent.
    pub fn latest(&self, now: FlightTime) -> Option<(FlightTime, Six)> {
        self.last.filter(|(time, _)| now.seconds_since(*time) <= GAP_S)
    }

    /// Does it repeat itself?
    pub fn is_stuck(&self) -> bool {
        self.stuck.repeats() >= STUCK
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn sample(us: u64, x: f64) -> ImuSample {
        let v = Vector3::new(x, 0.0, 9.81);
        ImuSample { time: FlightTime(us), gyro_radps: v * 0.1, accel_mps2: v, mag_ut: None, temperature_c: 25.0 }
    }

    #[test]
    fn the_mean_of_a_slot_does_not_depend_on_the_clock() {
        // A ramp of 1 m/s³, sampled every 9.7 ms from 3.3 ms on: the mean over a slot is its middle.
        let mut integral = Integral::new();
        for k in 0..40 {
            let us = 3_300 + k * 9_700;
            integral.take(&sample(us, us as f64 * 1e-6));
        }
        assert!(integral.mean(0).is_none(), "the first slot was not sampled from its beginning");
        for slot in 1..8 {
            let mean = integral.mean(slot).unwrap();
            assert!((mean[0] - (slot as f64 + 0.5) * 0.04).abs() < 1e-9 && (mean[2] - 9.81).abs() < 1e-9, "{mean}");
        }
        let now = FlightTime(3_300 + 39 * 9_700 + 5_000);
        let (total, _) = integral.total_now(now).unwrap();
        assert!((total[2] - 9.81 * now.seconds_since(FlightTime(3_300))).abs() < 1e-9);
    }

    #[test]
    fn a_slot_with_a_gap_has_no_mean_and_a_repeating_sensor_is_stuck() {
        let mut integral = Integral::new();
        let times = (0..100u64).map(|k| k * 10_000).filter(|us| !(130_000..=190_000).contains(us));
        for us in times {
            integral.take(&sample(us, (us as f64).sin()));
        }
        let means: Vec<u64> = (0..24).filter(|slot| integral.mean(*slot).is_some()).collect();
        assert!(means.iter().all(|slot| !(3..=4).contains(slot)) && means.contains(&23), "{means:?}");
        assert!(!integral.is_stuck());
        (100..115u64).for_each(|k| integral.take(&sample(k * 10_000, 1.0)));
        assert!(integral.is_stuck());
    }
}

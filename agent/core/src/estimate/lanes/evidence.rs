//! Which lanes are healthy: by what they predicted of the sensors that all of them share.
//!
//! | symbol | meaning |
//! |---|---|
//! | r²/s | squared innovation of a lane over its variance |
//! | L | L ← e^(−0.04/1 s) L + Σ (min(r²/s, 12) − 1), the evidence against a lane, forgotten within a second |
//! | a | average r²/s of the second-best lane, at least 1: under vibration innovations are coloured and too large for all |
//!
//! A lane's weight falls with its evidence over a²; excluded is one far behind the second-best for 8 slots, or one that
//! repeats itself. It comes back when it has been near for a second and its tilt and altitude are those of the lanes in
//! use: a false accelerometer tilts its lane until gravity hides it, and then predicts everything well; one that reads
//! upside down flies its lane hundreds of metres away, all of whose innovations count as little as large ones do.

use nalgebra::Vector3;

use super::{LANES, PerLane, SLOT_S};
use crate::estimate::median;

/// Evidence is forgotten within this, s.
pub(super) const MEMORY_S: f64 = 1.0;
/// One innovation counts at most so much.
const MOST: f64 = 12.0;
/// Part of a slot in the average of r²/s.
const AVERAGE_GAIN: f64 = 0.02;
/// Weights: share of the evidence that counts, what counts little, and how little.
pub(super) const SHARE: f64 = 0.05;
pub(super) const DEAD: f64 = 2.0;
const DEAD_SLOPE: f64 = 0.15;
/// How much the vote, and a tilt apart from the others', count against a lane.
const VOTE: f64 = 4.0;
const TILT_VOTE: f64 = 3.0;
/// Tilts that differ by less count nothing, °.
pub(super) const TILT_DEG: f64 = 1.0;
/// Beyond this, for so many slots, a lane is excluded; below this part of it, for so many, it comes back.
const FAR: f64 = 35.0;
const FAR_SLOTS: u32 = 8;
const NEAR: f64 = 0.4;
const NEAR_SLOTS: u32 = 25;
/// Evidence further than this part of `FAR` is a doubt.
const DOUBT: f64 = 0.3;
/// Lanes excluded for so many slots are healed.
const HEAL_SLOTS: u32 = 50;
/// A lane is excluded, or stays so, with a tilt further from those in use, rad (2.5°).
const TILT_RAD: f64 = 0.0436;
/// It stays so, too, this far from their altitude, m.
const APART_M: f64 = 0.3;
/// Weight of an excluded lane.
const EXCLUDED: f64 = 1e-3;
/// Slots in a row in which a sensor repeats itself: doubted, excluded.
const STUCK_SLOTS: (u32, u32) = (4, 8);
/// What a sensor that repeats itself is held to be surprised by in a slot.
const STUCK_SURPRISE: f64 = 8.0;
/// After healing, evidence above the best lane's.
const HEALED: f64 = 30.0;

/// What a lane made of one slot.
#[derive(Debug, Clone, Copy, Default)]
pub struct Heard {
    /// Σ min(r²/s, 12).
    pub surprise: f64,
    /// Over so many rows.
    pub rows: f64,
    /// Does its sensor repeat itself?
    pub stuck: bool,
    /// Its body z axis, ENU.
    pub up: Vector3<f64>,
    /// Its altitude, m.
    pub z_m: f64,
}

impl Heard {
    /// An innovation of squared ratio `ratio` = r²/s.
    pub fn hear(&mut self, ratio: f64) {
        self.surprise += ratio.min(MOST);
        self.rows += 1.0;
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Judged {
    present: bool,
    against: f64,
    average: f64,
    far: u32,
    near: u32,
    stuck: u32,
    excluded: bool,
    up: Vector3<f64>,
    z_m: f64,
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    lanes: PerLane<Judged>,
}

/// The second smallest of some numbers; the smallest of one; 0 of none.
fn second(values: impl Iterator<Item = f64>) -> f64 {
    let (least, second) =
        values.fold((f64::INFINITY, f64::INFINITY), |(a, b), x| if x < a { (x, a) } else { (a, b.min(x)) });
    [second, least, 0.0].into_iter().find(|x| x.is_finite()).unwrap_or_default()
}

impl Evidence {
    fn present(&self) -> impl Iterator<Item = &Judged> + Clone {
        self.lanes.iter().filter(|lane| lane.present)
    }

    /// a: see the module.
    pub fn average(&self) -> f64 {
        second(self.present().map(|lane| lane.average)).max(1.0)
    }

    /// Takes what every lane made of a slot; `None` for one that is not there.
    pub fn take(&mut self, heard: &PerLane<Option<Heard>>) {
        for (lane, heard) in self.lanes.iter_mut().zip(heard) {
            lane.present = heard.is_some();
            let Some(heard) = heard else { continue };
            (lane.up, lane.z_m) = (heard.up, heard.z_m);
            lane.stuck = if heard.stuck { lane.stuck.saturating_add(1) } else { 0 };
            if heard.rows > 0.0 {
                let first = lane.average == 0.0;
                lane.average = if first { 1.0 } else { lane.average };
                lane.average += AVERAGE_GAIN * (heard.surprise / heard.rows - lane.average);
            }
        }
        let average = self.average();
        let stuck = |lane: &Judged| if lane.stuck > STUCK_SLOTS.0 { STUCK_SURPRISE } else { 0.0 };
        let of = |lane: &Judged, heard: &Heard| (heard.surprise - heard.rows + stuck(lane)) / average.powf(1.5);
        let all = self.lanes.iter().zip(heard).filter_map(|(lane, heard)| Some(of(lane, heard.as_ref()?)));
        let common = if average > 1.3 { second(all) } else { 0.0 };
        let keep = (-SLOT_S / MEMORY_S).exp();
        for (lane, heard) in self.lanes.iter_mut().zip(heard) {
            lane.against *= keep;
            if let Some(heard) = heard {
                lane.against += of(lane, heard) - common;
            }
        }
        self.judge(average * average);
    }

    fn judge(&mut self, scale: f64) {
        let best = second(self.present().map(|lane| lane.against));
        let up = self.up_in_use();
        let z_m = median(self.present().filter(|lane| !lane.excluded).map(|lane| lane.z_m));
        for lane in &mut self.lanes {
            let excess = 0.5 * (lane.against - best) / scale;
            let apart = up.is_some_and(|up| lane.up.angle(&up) > TILT_RAD) || (lane.z_m - z_m).abs() > APART_M;
            lane.far = if excess > FAR || lane.excluded && apart { lane.far.saturating_add(1) } else { 0 };
            lane.near = if excess < NEAR * FAR && !apart { lane.near.saturating_add(1) } else { 0 };
            let out = lane.excluded || lane.far > FAR_SLOTS || lane.stuck > STUCK_SLOTS.1;
            lane.excluded = lane.present && out && (lane.near <= NEAR_SLOTS || lane.stuck > STUCK_SLOTS.1);
        }
    }

    /// Mean body z axis of the lanes in use.
    fn up_in_use(&self) -> Option<Vector3<f64>> {
        let used = || self.present().filter(|lane| !lane.excluded);
        let sum: Vector3<f64> = used().map(|lane| lane.up).sum();
        sum.try_normalize(0.1)
    }

    /// Weights of the lanes, summing to one where any is there; `votes` are what is held against each beside this.
    pub fn weights(&self, votes: &PerLane<f64>) -> PerLane<f64> {
        let scale = self.average().powi(2);
        let least = self.present().map(|lane| lane.against).fold(f64::INFINITY, f64::min);
        let all = self.present().all(|lane| lane.excluded);
        let tilts = self.tilt_votes();
        // A vote against most of them is no majority's.
        let excluded = self.present().filter(|lane| lane.excluded).count();
        let voting = 2 * excluded <= self.present().count();
        let mut weights = [0.0; LANES];
        for (i, (weight, lane)) in weights.iter_mut().zip(&self.lanes).enumerate() {
            if !lane.present {
                continue;
            }
            let excess = SHARE * (lane.against - least) / scale;
            let vote = if voting { VOTE * votes[i] + TILT_VOTE * tilts[i] } else { 0.0 };
            let out = if lane.excluded && !all { EXCLUDED } else { 1.0 };
            *weight = out * (-(excess - DEAD).max(0.0) - DEAD_SLOPE * excess.min(DEAD) - vote).exp();
        }
        let sum: f64 = weights.iter().sum();
        if sum > 0.0 { weights.map(|weight| weight / sum) } else { weights }
    }

    /// How far each lane's tilt is from the median one, beyond what is usual: 0..3, less what is held against all.
    fn tilt_votes(&self) -> PerLane<f64> {
        let centre = Vector3::from_fn(|axis, _| median(self.present().map(|lane| lane.up[axis])));
        let apart = |lane: &Judged| (lane.up - centre).norm().to_degrees();
        let usual = median(self.present().map(apart));
        let votes =
            self.lanes.map(|lane| if lane.present { apart(&lane) / (2.0 * usual).max(TILT_DEG) - 1.0 } else { 0.0 });
        let of = votes.iter().zip(&self.lanes).filter(|(_, lane)| lane.present).map(|(vote, _)| vote.max(0.0));
        let least = of.fold(f64::INFINITY, f64::min);
        votes.map(|vote| (vote.max(0.0) - least).clamp(0.0, 3.0))
    }

    /// Nothing is held against any lane.
    pub fn forgive(&mut self) {
        self.lanes = PerLane::default();
    }

    /// Is this lane excluded?
    pub fn is_excluded(&self, lane: usize) -> bool {
        self.lanes.get(lane).is_some_and(|lane| lane.excluded)
    }

    /// Does its sensor repeat itself?
    pub fn is_stuck(&self, lane: usize) -> bool {
        self.lanes.get(lane).is_some_and(|lane| lane.stuck > STUCK_SLOTS.1)
    }

    /// Evidence against it over the limit; 1 is far.
    pub fn ratio(&self, lane: usize) -> f64 {
        let best = second(self.present().map(|lane| lane.against));
        let of = self.lanes.get(lane).filter(|lane| lane.present);
        of.map_or(0.0, |lane| (0.5 * (lane.against - best) / self.average().powi(2) / FAR).max(0.0))
    }

    /// Is there doubt about it?
    pub fn is_doubted(&self, lane: usize) -> bool {
        self.is_excluded(lane) || self.ratio(lane) > DOUBT
    }

    /// Should this lane begin again from the others?
    pub fn is_to_heal(&self, lane: usize) -> bool {
        self.lanes.get(lane).is_some_and(|lane| lane.present && lane.excluded && lane.far > HEAL_SLOTS)
    }

    /// It began again from the others: on probation.
    pub fn healed(&mut self, lane: usize) {
        let least = self.present().map(|lane| lane.against).fold(f64::INFINITY, f64::min);
        if let Some(lane) = self.lanes.get_mut(lane) {
            lane.far = HEAL_SLOTS / 2 + 1;
            // Where no lane is present there is only its own.
            lane.against = if least.is_finite() { least } else { lane.against } + HEALED;
        }
    }

    /// The present lanes.
    pub fn are_present(&self) -> PerLane<bool> {
        self.lanes.map(|lane| lane.present)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slot(surprise: [f64; 4], tilt: [f64; 4], stuck: usize) -> PerLane<Option<Heard>> {
        std::array::from_fn(|i| {
            (i < 4).then(|| Heard {
                surprise: surprise[i],
                rows: 8.0,
                stuck: i == stuck,
                up: Vector3::new(tilt[i].sin(), 0.0, tilt[i].cos()),
                z_m: 1.0,
            })
        })
    }

    const NO_VOTE: PerLane<f64> = [0.0; LANES];

    #[test]
    fn a_lane_that_predicts_badly_loses_weight_and_is_excluded() {
        let mut evidence = Evidence::default();
        (0..50).for_each(|_| evidence.take(&slot([8.0; 4], [0.0; 4], 9)));
        let even = evidence.weights(&NO_VOTE);
        assert!(even.iter().take(4).all(|w| (w - 0.25).abs() < 1e-9) && even[4] == 0.0);
        (0..30).for_each(|_| evidence.take(&slot([8.0, 40.0, 8.0, 8.0], [0.0; 4], 9)));
        assert!(evidence.is_excluded(1) && evidence.weights(&NO_VOTE)[1] < 1e-3);
        // Good again: back after a second and the memory, not before.
        (0..20).for_each(|_| evidence.take(&slot([8.0; 4], [0.0; 4], 9)));
        assert!(evidence.is_excluded(1));
        (0..120).for_each(|_| evidence.take(&slot([8.0; 4], [0.0; 4], 9)));
        assert!(!evidence.is_excluded(1));
    }

    #[test]
    fn a_lane_with_another_tilt_or_altitude_is_not_readmitted_although_it_predicts_well() {
        let mut evidence = Evidence::default();
        (0..50).for_each(|_| evidence.take(&slot([8.0, 40.0, 8.0, 8.0], [0.0; 4], 9)));
        // Upside down is as far as any.
        for tilt in [[0.0, 0.1, 0.0, 0.0], [0.0, std::f64::consts::PI, 0.0, 0.0]] {
            (0..200).for_each(|_| evidence.take(&slot([8.0; 4], tilt, 9)));
            assert!(evidence.is_excluded(1) && evidence.is_to_heal(1));
        }
        let mut away = slot([8.0; 4], [0.0; 4], 9);
        away[1].iter_mut().for_each(|heard| heard.z_m = -200.0);
        (0..200).for_each(|_| evidence.take(&away));
        assert!(evidence.is_excluded(1) && evidence.is_to_heal(1));
        evidence.healed(1);
        assert!(!evidence.is_to_heal(1));
        (0..200).for_each(|_| evidence.take(&slot([8.0; 4], [0.0; 4], 9)));
        assert!(!evidence.is_excluded(1));
    }

    #[test]
    fn what_surprises_all_lanes_excludes_none_and_what_repeats_itself_is() {
        let mut evidence = Evidence::default();
        (0..300).for_each(|_| evidence.take(&slot([60.0, 64.0, 58.0, 66.0], [0.0; 4], 2)));
        assert_eq!([0, 1, 2, 3].map(|i| evidence.is_excluded(i)), [false, false, true, false]);
        assert!(evidence.is_stuck(2));
    }
}

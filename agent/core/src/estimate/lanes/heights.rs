//! The laser heights as one group: which of them are healthy, and what each is off by.
//!
//! Residuals against the altitude of all lanes, as means over five samples and over the whole memory, about a centre that a
//! minority cannot move far; their scatter apart from their means. Each laser's offset and scale are learned slowly, about
//! the mean of all, so that the altitude does not move when one is excluded.

use arrayvec::ArrayVec;
use plumbline_proto::time::FlightTime;

use super::split::{GAP_M, Split};
use crate::estimate::filter::innovations::mean_off_sigma_m;
use crate::estimate::median;
use crate::sensor::MAX_HEIGHTS;

/// Residuals of each laser kept: 2.4 s at 10 Hz.
pub(super) const KEPT: usize = 24;
/// Of which the last are a test of their own.
pub(super) const SHORT: usize = 5;
/// Slots between two decodes.
pub(super) const EVERY: u32 = 5;
/// One-sigma of the means over a short and the whole memory, m; while offsets are learned.
pub(super) const SIGMA_M: [f64; 2] = [0.015, 0.010];
const SIGMA_LEARNING_M: [f64; 2] = [0.026, 0.020];
/// Beyond so many sigmas a mean is bad, and twice that it excludes at once.
pub(super) const LIMIT: f64 = 3.5;
/// Beyond so many sigmas a laser weighs less.
pub(super) const SOFT: f64 = 2.2;
/// Scatter beyond so many times the median laser's is bad; no laser is taken for steadier, m.
const SCATTER: f64 = 4.5;
const STEADY_M: f64 = 0.017;
/// A mean further from the centre than so many sigmas pulls no more.
pub(super) const PULL: f64 = 2.0;
/// Part of the offset that is learned as scale.
pub(super) const SCALE_SHARE: f64 = 0.6;
/// What is known of the centre without a laser, m.
pub(super) const PRIOR_M: f64 = 0.05;
/// Altitude at which scale is no offset, m.
pub(super) const PIVOT_M: f64 = 1.4;
/// Most that offset (m) and scale are learned to.
pub(super) const OFFSET_MAX_M: f64 = 0.06;
pub(super) const SCALE_MAX: f64 = 0.03;
/// Parts learned of a deviation at each decode, at first and later.
pub(super) const GAINS: (f64, f64) = (0.08, 0.01);
/// Decodes within 0.8 of every limit after which one comes back.
const CALM: u32 = 10;
/// One further from the median of those of the last moments counts as if it were so far, m: a step reaches no further.
pub(super) const REACH_M: f64 = 0.025;
/// Those of the last moments, s.
const RECENT_S: f64 = 0.3;
/// Samples in a row that a laser reads further than the gap of `split.rs` from the altitude predicted before they are heard: a beam
/// meets a string, a leg or a net for a scan or two. Fewer where another laser reads the same.
const SPURIOUS: u32 = 3;
const SPURIOUS_ALIKE: u32 = 2;
/// Such samples are no evidence against a laser before there are more than so many of them of late, each of which counts this much less
/// from sample to sample.
const MANY: f64 = 4.0;
const FADES: f64 = 0.97;
/// Without a sample for so long one is not there, s.
const SILENT_S: f64 = 1.0;

#[derive(Debug, Clone, Copy, Default)]
struct Laser {
    residuals: [f64; KEPT],
    seen: usize,
    latest: Option<(FlightTime, f64)>,
    /// Samples in a row that were far from the altitude predicted; is the last of them not heard, and how many of late were not.
    far: u32,
    unheard: bool,
    /// Is it alone in that, and another one near?
    outvoted: bool,
    spurious: f64,
    offset_m: f64,
    scale: f64,
    weight: f64,
    ratio: f64,
    bad: u32,
    calm: u32,
    excluded: bool,
}

impl Laser {
    /// Mean of its last `n` residuals about their median, one far off counting little.
    fn mean(&self, n: usize) -> f64 {
        let of = || (1..=n.min(KEPT)).filter_map(|k| self.residuals.get((self.seen + KEPT - k) % KEPT).copied());
        let mut sorted: ArrayVec<f64, KEPT> = of().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let m = sorted.len();
        let middle = sorted.get(m / 2).zip(sorted.get(m.saturating_sub(1) / 2)).map_or(0.0, |(a, b)| 0.5 * (a + b));
        middle + of().map(|x| (x - middle).clamp(-0.05, 0.05)).sum::<f64>() / m.max(1) as f64
    }

    fn scatter(&self, mean: f64) -> f64 {
        self.residuals.iter().map(|x| (x - mean).powi(2).min(0.0036)).sum::<f64>() / KEPT as f64
    }

    fn ready(&self, now: FlightTime) -> bool {
        self.seen >= KEPT && self.latest.is_some_and(|(time, _)| now.seconds_since(time) < SILENT_S)
    }
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Heights {
    lasers: [Laser; MAX_HEIGHTS],
    slots: u32,
    /// Those that step, against the accelerometers.
    pub split: Split,
}

/// The lasers that can be compared, with the mean of each.
type Means = ArrayVec<(usize, f64), MAX_HEIGHTS>;

impl Heights {
    /// Lasers that weigh so much, whatever they measure.
    pub(super) fn weighing(weights: &[f64]) -> Self {
        let mut heights = Self::default();
        for (laser, weight) in heights.lasers.iter_mut().zip(weights) {
            (laser.weight, laser.seen) = (*weight, KEPT);
        }
        heights
    }

    /// What laser `index` is off by at altitude `z_m`, m.
    pub fn off_m(&self, index: usize, z_m: f64) -> f64 {
        self.lasers.get(index).map_or(0.0, |laser| laser.offset_m + laser.scale * (z_m - PIVOT_M))
    }

    /// One-sigma of what the mean of the lasers is off by at altitude `z_m`, m ([`mean_off_sigma_m`]).
    pub fn mean_off_sigma_m(&self, z_m: f64) -> f64 {
        let used = self.lasers.iter().enumerate().filter(|(_, laser)| laser.seen >= KEPT && !laser.excluded);
        mean_off_sigma_m(used.map(|(i, _)| self.off_m(i, z_m)))
    }

    /// How much laser `index` counts, 0..1; an excluded one does not, nor one that steps, nor one whose last residual was not admitted or
    /// is outvoted.
    pub fn weight(&self, index: usize) -> f64 {
        if self.split.refuses(index) {
            return 0.0;
        }
        self.lasers.get(index).map_or(1.0, |laser| match laser {
            Laser { excluded: true, .. } | Laser { unheard: true, .. } | Laser { outvoted: true, .. } => 0.0,
            Laser { weight, seen, .. } if *seen >= KEPT && *weight > 0.0 => *weight,
            _ => 1.0,
        })
    }

    /// Is laser `index` excluded?
    pub fn is_excluded(&self, index: usize) -> bool {
        self.lasers.get(index).is_some_and(|laser| laser.excluded)
    }

    /// Its worst statistic over its limit.
    pub fn ratio(&self, index: usize) -> f64 {
        self.lasers.get(index).map_or(0.0, |laser| laser.ratio)
    }

    /// A residual of laser `index`, what it is off by taken from it, after [`Self::admit`] was asked.
    pub fn take(&mut self, index: usize, time: FlightTime, residual_m: f64) {
        if let Some(laser) = self.lasers.get_mut(index) {
            laser.latest = Some((time, residual_m));
            if laser.unheard && laser.spurious < MANY {
                return;
            }
            laser.residuals[laser.seen % KEPT] = residual_m;
            laser.seen += 1;
            // Counts on from where the ring is full, so that it never runs over.
            laser.seen = if laser.seen >= 4 * KEPT { 2 * KEPT } else { laser.seen };
        }
    }

    /// May a residual of laser `index` correct anything and be judged beside the accelerometers? Not one far from what was predicted,
    /// unless it lasts.
    pub fn admit(&mut self, index: usize, residual_m: f64, now: FlightTime) -> bool {
        let far =
            if residual_m.abs() > GAP_M { self.lasers.get(index).map_or(0, |l| l.far).saturating_add(1) } else { 0 };
        let recent = |laser: &Laser| {
            laser.latest.filter(|(time, _)| !laser.excluded && now.seconds_since(*time).abs() < RECENT_S)
        };
        let alike = |laser: &Laser| {
            recent(laser).is_some_and(|(_, value)| (value - residual_m).abs() < GAP_M)
                && far >= SPURIOUS_ALIKE
                && (!laser.unheard || laser.far >= SPURIOUS_ALIKE)
        };
        let others = || self.lasers.iter().enumerate().filter(|(i, _)| *i != index);
        let alone = !others().any(|(_, laser)| alike(laser));
        let near = |(i, laser): (usize, &Laser)| laser.far == 0 && recent(laser).is_some() && !self.split.refuses(i);
        let outvoted = alone && far > 0 && others().any(near);
        self.lasers.get_mut(index).is_none_or(|laser| {
            laser.far = far;
            laser.unheard = alone && (1..SPURIOUS).contains(&far);
            laser.outvoted = outvoted;
            laser.spurious = FADES * laser.spurious + f64::from(u8::from(laser.unheard));
            !laser.unheard
        })
    }

    /// What laser `index` reads further than it can reach from the median of at least three, m; of two what was predicted is the third.
    pub fn beyond_reach_m(&self, index: usize, residual_m: f64, now: FlightTime) -> f64 {
        let mut recent: ArrayVec<f64, MAX_HEIGHTS> = ArrayVec::new();
        for (i, laser) in self.lasers.iter().enumerate() {
            let latest = laser.latest.filter(|(time, _)| now.seconds_since(*time).abs() < RECENT_S);
            // In the place of one that is not heard stands what was predicted.
            let value = latest.map(|(_, value)| if laser.unheard { 0.0 } else { value });
            let value = if i == index { Some(residual_m) } else { value };
            recent.extend(value.filter(|_| i == index || !laser.excluded && !self.split.refuses(i)));
        }
        if recent.len() == 2 {
            let _ = recent.try_push(0.0);
        }
        if recent.len() < 3 {
            return 0.0;
        }
        let from_centre = residual_m - median(recent.iter().copied());
        from_centre - from_centre.clamp(-REACH_M, REACH_M)
    }

    /// A slot is over: every fifth decodes, at altitude `z_m`; returns whether one was newly excluded. While `learning`
    /// offsets are learned fast, and unless `judging` none is excluded.
    pub fn decode(&mut self, now: FlightTime, z_m: f64, learning: bool, judging: bool) -> bool {
        self.slots = (self.slots + 1) % EVERY;
        if self.slots != 0 {
            return false;
        }
        let ready = |n: usize| -> Means {
            let of = self.lasers.iter().enumerate().filter(|(_, laser)| laser.ready(now));
            of.map(|(i, laser)| (i, laser.mean(n))).collect()
        };
        let (short, long) = (ready(SHORT), ready(KEPT));
        if long.len() < 2 {
            return false;
        }
        let sigmas = if learning { SIGMA_LEARNING_M } else { SIGMA_M };
        for laser in &mut self.lasers {
            (laser.ratio, laser.weight) = (0.0, 1.0);
        }
        let mut centre_m = 0.0;
        for (means, sigma) in [&short, &long].into_iter().zip(sigmas) {
            centre_m = self.centre(means, sigma);
            for (i, mean) in means {
                let Some(laser) = self.lasers.get_mut(*i) else { continue };
                let off = (mean - centre_m).abs() / sigma;
                laser.ratio = laser.ratio.max(off / LIMIT);
                laser.weight = laser.weight.min((SOFT / off.max(1e-6)).powi(2));
            }
        }
        let scatters: Means = long.iter().filter_map(|(i, m)| Some((*i, self.lasers.get(*i)?.scatter(*m)))).collect();
        let usual = median(scatters.iter().map(|(_, s)| *s)).max(STEADY_M * STEADY_M);
        for (i, scatter) in &scatters {
            if let Some(laser) = self.lasers.get_mut(*i) {
                laser.ratio = laser.ratio.max(scatter / usual / SCATTER);
            }
        }
        if self.split.is_open() {
            // Their own majority says nothing now.
            return false;
        }
        let new = self.exclude(&long, judging);
        self.learn(&long, centre_m, z_m, if learning { GAINS.0 } else { GAINS.1 }, judging);
        new
    }

    /// c = argmin Σ huber₂((m − c)/σ) + (c/5 cm)²/2 over those not excluded.
    fn centre(&self, means: &Means, sigma: f64) -> f64 {
        let mut centre = median(means.iter().map(|(_, mean)| *mean));
        for _ in 0..12 {
            let (mut sum, mut weights) = (0.0, (sigma / PRIOR_M).powi(2));
            for (_, mean) in means.iter().filter(|(i, _)| !self.is_excluded(*i)) {
                let weight = (PULL * sigma / (mean - centre).abs().max(1e-6)).min(1.0);
                sum += weight * mean;
                weights += weight;
            }
            centre = sum / weights;
        }
        centre
    }

    /// At most a minority, the worst of those that should be; true when one is new.
    fn exclude(&mut self, present: &Means, judging: bool) -> bool {
        let mut wanted: ArrayVec<(usize, bool, f64), MAX_HEIGHTS> = ArrayVec::new();
        for (i, _) in present {
            let Some(laser) = self.lasers.get_mut(*i) else { continue };
            laser.bad = if laser.ratio > 1.0 { laser.bad.saturating_add(1) } else { 0 };
            let out = laser.excluded && laser.calm < CALM || laser.bad >= 2 || laser.ratio > 2.0;
            laser.calm = if laser.ratio < 0.8 { laser.calm.saturating_add(1) } else { 0 };
            if out && judging {
                wanted.push((*i, laser.excluded, laser.ratio));
            }
            if !out {
                laser.excluded = false;
            }
        }
        wanted.sort_unstable_by(|a, b| b.1.cmp(&a.1).then(b.2.total_cmp(&a.2)));
        let mut new = false;
        for (rank, (i, was, _)) in wanted.iter().enumerate() {
            if let Some(laser) = self.lasers.get_mut(*i) {
                laser.excluded = rank < (present.len() - 1) / 2;
                new |= laser.excluded && !was;
            }
        }
        new
    }

    fn learn(&mut self, means: &Means, centre_m: f64, z_m: f64, gain: f64, judging: bool) {
        let calm = |laser: &Laser| !judging || laser.ratio < 0.7 && !laser.excluded;
        let used = || means.iter().filter(|(i, _)| self.lasers.get(*i).is_some_and(calm));
        let count = used().count();
        if count < 2 {
            return;
        }
        // What counts as if it were at its reach is learned as if it were there.
        let middle = median(used().map(|(_, mean)| *mean));
        let reached = |mean: f64| middle + (mean - middle).clamp(-REACH_M, REACH_M) - centre_m;
        let common = used().map(|(_, mean)| reached(*mean)).sum::<f64>() / count as f64;
        for (i, mean) in means {
            let Some(laser) = self.lasers.get_mut(*i).filter(|laser| calm(laser)) else { continue };
            let off = reached(*mean) - common;
            laser.offset_m = (laser.offset_m + gain * off).clamp(-OFFSET_MAX_M, OFFSET_MAX_M);
            laser.scale = (laser.scale + SCALE_SHARE * gain * off * (z_m - PIVOT_M)).clamp(-SCALE_MAX, SCALE_MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three lasers at 10 Hz with noise of some mm and these offsets, 4 of 5 slots empty for each.
    fn run(heights: &mut Heights, from: u32, slots: u32, off_m: [f64; 3]) {
        for k in from..from + slots {
            let now = FlightTime(u64::from(k) * 40_000);
            for (i, off) in off_m.iter().enumerate() {
                if (k as usize + i).is_multiple_of(3) {
                    let noise = 0.007 * f64::from(k * 37 + i as u32 * 101).sin();
                    heights.take(i, now, off + noise - heights.off_m(i, 1.0));
                }
            }
            heights.decode(now, 1.0, from < 200, from >= 200);
        }
    }

    #[test]
    fn constant_differences_are_learned_and_a_step_is_excluded_and_forgiven() {
        let mut heights = Heights::default();
        let own = [0.012, -0.01, 0.0];
        run(&mut heights, 0, 400, own);
        let learned: Vec<f64> = (0..3).map(|i| heights.off_m(i, 1.0)).collect();
        assert!((learned[0] - learned[1] - 0.022).abs() < 0.005, "{learned:?}");
        run(&mut heights, 400, 100, own);
        assert!((0..3).all(|i| !heights.is_excluded(i)));
        run(&mut heights, 500, 100, [0.112, -0.01, 0.0]);
        assert_eq!([0, 1, 2].map(|i| heights.is_excluded(i)), [true, false, false]);
        assert!(heights.weight(0) == 0.0 && heights.weight(1) > 0.9);
        run(&mut heights, 600, 200, own);
        assert!(!heights.is_excluded(0));
    }

    /// GIVEN three lasers WHEN one reads further than its reach, and is not yet in doubt, THEN no more is learned than of one at its reach.
    #[test]
    fn beyond_its_reach_no_more_is_learned() {
        let learned = |reads_m: f64| {
            let mut heights = Heights::default();
            for k in 0..KEPT as u64 {
                let now = FlightTime(k * 40_000);
                [reads_m, 0.0, 0.0]
                    .into_iter()
                    .enumerate()
                    .for_each(|(i, residual_m)| heights.take(i, now, residual_m));
            }
            for _ in 0..EVERY {
                heights.decode(FlightTime(KEPT as u64 * 40_000), 1.0, false, true);
            }
            assert!(heights.ratio(0) < 0.7, "{}", heights.ratio(0));
            [0, 1, 2].map(|i| heights.off_m(i, 1.0))
        };
        let [within, at, beyond] = [0.02, REACH_M, 0.03].map(learned);
        assert!(within[0] > 0.0 && at[0] > 1.2 * within[0] && at[1] < 0.0, "{within:?} {at:?}");
        assert!(at.iter().zip(&beyond).all(|(a, b)| (a - b).abs() < 1e-12), "{at:?} {beyond:?}");
    }

    /// GIVEN three lasers WHEN a beam meets something for a scan or two THEN it is not heard, and costs its laser nothing; what lasts is
    /// heard, and earlier what another laser reads as well.
    #[test]
    fn a_beam_in_the_way_is_heard_when_it_lasts() {
        let mut heights = Heights::default();
        run(&mut heights, 0, 300, [0.0; 3]);
        let mut reads = |k: u32, index: usize, residual_m: f64| {
            let now = FlightTime(u64::from(300 + k) * 40_000);
            let heard = heights.admit(index, residual_m, now);
            heights.take(index, now, residual_m);
            heard
        };
        assert_eq!([0, 2, 4, 6].map(|k| reads(k, 0, -0.5)), [false, false, true, true]);
        assert_eq!([7, 9].map(|k| reads(k, 1, -0.45)), [false, true], "another is heard that reads the same");
        assert!(reads(10, 0, 0.0) && reads(10, 1, 0.0), "back");
        // Two that are not heard are one for the other from their second sample on.
        assert_eq!(
            [reads(40, 0, 0.3), reads(41, 1, 0.35), reads(42, 0, 0.3), reads(43, 1, 0.35)],
            [false, false, false, true]
        );
        let mut heights = Heights::default();
        run(&mut heights, 0, 300, [0.0; 3]);
        for k in 300..600 {
            let now = FlightTime(u64::from(k) * 40_000);
            for i in 0..3 {
                let residual_m = if k % 20 == 6 * i as u32 { -0.6 } else { 0.001 };
                assert_eq!(heights.admit(i, residual_m, now), residual_m > 0.0);
                heights.take(i, now, residual_m);
            }
            assert!(!heights.decode(now, 1.0, false, true) && (0..3).all(|i| heights.ratio(i) < 0.8), "{k}");
        }
    }

    /// GIVEN one of three lasers excluded WHEN the beam of another meets something for long THEN it counts for nothing while the third reads
    /// as predicted; where that reads the same, both count.
    #[test]
    fn a_beam_in_the_way_does_not_outvote_one_that_reads_as_predicted() {
        for third_m in [0.01, -0.8] {
            let mut heights = Heights::default();
            run(&mut heights, 0, 300, [0.0; 3]);
            heights.lasers[0].excluded = true;
            let mut counts = [0.0; 2];
            for scan in 0..6_u64 {
                for (i, residual_m) in [-1.2, -0.8, third_m].into_iter().enumerate() {
                    let now = FlightTime((300 + 3 * scan + i as u64) * 40_000);
                    heights.admit(i, residual_m, now);
                    heights.take(i, now, residual_m);
                }
                counts = [heights.weight(1), heights.weight(2)];
                assert!(third_m < 0.0 || counts[0] == 0.0, "{scan}: {counts:?}");
            }
            assert_eq!(counts.map(|count| count > 0.0), [third_m < 0.0, true], "{counts:?}");
        }
    }

    #[test]
    fn a_step_reaches_no_further_than_its_reach_before_it_is_excluded() {
        let mut heights = Heights::default();
        run(&mut heights, 0, 30, [0.0; 3]);
        let now = FlightTime(29 * 40_000);
        assert!((heights.beyond_reach_m(0, 0.3, now) - 0.275).abs() < 0.01);
        assert_eq!(heights.beyond_reach_m(0, 0.01, now), 0.0);
        // Of two that are left what was predicted is the third; what both read counts in full.
        heights.lasers[2].excluded = true;
        assert!((heights.beyond_reach_m(0, -0.09, now) + 0.065).abs() < 0.01);
        heights.take(1, now, -0.08);
        assert_eq!(heights.beyond_reach_m(0, -0.09, now), 0.0);
    }
}

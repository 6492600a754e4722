//! Heights that part from each other, against the accelerometers: beside the lasers these have one voice.
//!
//! Two of three lasers that step together outvote the third. Only what the IMUs felt since says which of them moved with
//! the vehicle: from the moment they part the altitude coasts on accelerations alone, and lasers far from the one nearest to
//! it are off, or from most of them where these are three or more and as near as it can tell. Unless those of them that read the same are
//! more than the others and the accelerometers together, they are held back until they return; otherwise nobody has a majority, the
//! heights contradict each other, and none is used until they agree again. Where all of them have
//! left the coasted altitude the floor is another, or the accelerometers know too little: nothing is said.
//!
//! Slow drifts of a majority stay unseen: an accelerometer's bias explains them.

use arrayvec::ArrayVec;
use plumbline_proto::time::FlightTime;

use super::SLOT_S;
use super::slot::age_s;
use crate::sensor::MAX_HEIGHTS;

/// Healthy lasers differ by less, m: offsets, scale, slant, stamps and the motion within a scan.
pub(super) const GAP_M: f64 = 0.12;
/// Samples of each laser before it is judged, and the longest that is waited for them, s.
const SAMPLES: u32 = 2;
const LONGEST_S: f64 = 0.5;
/// The coasted altitude is right to so much at first, m, and for each second, m/s.
const COAST: (f64, f64) = (0.1, 0.2);
/// Fewer lasers than so many are not taken for most of them against the accelerometers.
const MOST: usize = 3;
/// One that is held back returns within this part of the gap.
const BACK: f64 = 0.8;
/// A laser is there so long after its last sample, s.
const FRESH_S: f64 = 0.35;
/// With so much of the acceleration from the thrust as commanded, in the mean, accelerometers have no voice; and part of that
/// mean that a slot is.
const VOICELESS: f64 = 0.6;
const THRUST_GAIN: f64 = 0.04;
/// Agreement that ends a contradiction, s.
const AGREED_S: f64 = 1.0;

/// Altitude and climb by accelerations alone, m and m/s, since the lasers parted.
#[derive(Debug, Clone, Copy)]
struct Coast {
    since: FlightTime,
    z_m: f64,
    climb_mps: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Laser {
    /// Its last sample, and how far that is from the altitude predicted, or coasted, m.
    last: Option<(FlightTime, f64)>,
    /// Samples since the lasers parted.
    samples: u32,
    held: bool,
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Split {
    lasers: [Laser; MAX_HEIGHTS],
    coast: Option<Coast>,
    /// When the lasers that contradict each other last did.
    contradicted: Option<FlightTime>,
    /// Part of the acceleration that was the thrust as commanded, lately.
    by_thrust: f64,
}

impl Split {
    /// Is laser `index` not to be used?
    pub fn refuses(&self, index: usize) -> bool {
        let apart = |laser: &Laser| self.coast.is_some() && laser.last.is_some_and(|(_, off_m)| off_m.abs() > GAP_M);
        self.contradicted.is_some() || self.lasers.get(index).is_some_and(|laser| laser.held || apart(laser))
    }

    /// Have the lasers parted, and is it not settled which of them are off?
    pub fn is_open(&self) -> bool {
        self.coast.is_some()
    }

    /// Do the heights contradict each other, without a majority?
    pub fn is_contradicted(&self) -> bool {
        self.contradicted.is_some()
    }

    /// A slot that ends at `end`. Uncorrected, altitude and climb would be `predicted` there, m and m/s; felt was so much
    /// upward, m/s², this part of it the thrust as commanded. `samples`: when each laser measured what, its offset
    /// removed, m.
    pub fn take(
        &mut self,
        end: FlightTime,
        predicted: (f64, f64),
        (up_mps2, by_thrust): (f64, f64),
        samples: &[Option<(FlightTime, f64)>; MAX_HEIGHTS],
    ) {
        if let Some(coast) = &mut self.coast {
            coast.z_m += (coast.climb_mps + 0.5 * up_mps2 * SLOT_S) * SLOT_S;
            coast.climb_mps += up_mps2 * SLOT_S;
        }
        let (z_m, climb_mps) = self.coast.map_or(predicted, |coast| (coast.z_m, coast.climb_mps));
        for (laser, sample) in self.lasers.iter_mut().zip(samples) {
            if let Some((time, height_m)) = *sample {
                let off_m = height_m - (z_m - climb_mps * age_s(end, time));
                laser.last = Some((time, off_m));
                laser.samples = laser.samples.saturating_add(1);
                laser.held &= off_m.abs() > BACK * GAP_M;
            }
        }
        self.by_thrust += THRUST_GAIN * (by_thrust - self.by_thrust);
        if self.by_thrust > VOICELESS && self.contradicted.is_none() {
            self.coast = None;
        } else if let Some(coast) = self.coast {
            self.judge(end, end.seconds_since(coast.since));
        } else if self.have_parted(end) {
            self.coast = Some(Coast { since: end, z_m, climb_mps });
            for (laser, sample) in self.lasers.iter_mut().zip(samples) {
                laser.samples = u32::from(sample.is_some());
            }
        }
    }

    /// How far the lasers that are there are off, m.
    fn off_m(&self, now: FlightTime) -> impl Iterator<Item = (&Laser, f64)> + Clone {
        let there = move |laser: &'_ Laser| laser.last.filter(|(time, _)| now.seconds_since(*time) < FRESH_S);
        self.lasers.iter().filter_map(move |laser| Some((laser, there(laser)?.1)))
    }

    /// Do lasers that are used differ?
    fn have_parted(&self, now: FlightTime) -> bool {
        let used = self.off_m(now).filter(|(laser, _)| !laser.held).map(|(_, off_m)| off_m);
        let (least, most) = used.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), off| (a.min(off), b.max(off)));
        most - least > GAP_M
    }

    /// Which of them are off, `coasted_s` after they parted.
    fn judge(&mut self, now: FlightTime, coasted_s: f64) {
        let waits = self.off_m(now).any(|(laser, _)| laser.samples < SAMPLES);
        if waits && coasted_s < LONGEST_S {
            return;
        }
        let all: ArrayVec<f64, MAX_HEIGHTS> = self.off_m(now).map(|(_, off_m)| off_m).collect();
        let near = |one: f64| all.iter().filter(|off_m| (*off_m - one).abs() <= GAP_M).count();
        let nearest = |of: &[f64]| of.iter().copied().min_by(|a, b| a.abs().total_cmp(&b.abs()));
        // Within what the coasted altitude is right to, most of the lasers are more than the one that is nearest to it by chance; two that
        // collude against a third are not meant.
        let reach_m = COAST.0 + COAST.1 * coasted_s;
        let most = |off_m: &f64| off_m.abs() <= reach_m && near(*off_m) >= MOST && 2 * near(*off_m) > all.len();
        let by_most: ArrayVec<f64, MAX_HEIGHTS> = all.iter().copied().filter(most).collect();
        let anchor_m = nearest(&by_most).or(nearest(&all)).unwrap_or_default();
        let is_off = |off_m: f64| (off_m - anchor_m).abs() > GAP_M;
        let off: ArrayVec<f64, MAX_HEIGHTS> = all.iter().copied().filter(|off_m| is_off(*off_m)).collect();
        if let Some(last) = self.contradicted {
            if !off.is_empty() {
                self.contradicted = Some(now);
            } else if now.seconds_since(last) > AGREED_S {
                *self = Self { by_thrust: self.by_thrust, ..Self::default() };
            }
            return;
        }
        // Those that read each something else are no other truth together.
        let alike = |one: &f64| off.iter().filter(|off_m| (*off_m - one).abs() <= GAP_M).count();
        let rivals = off.iter().map(alike).max().unwrap_or_default();
        if anchor_m.abs() > reach_m {
            *self = Self { by_thrust: self.by_thrust, ..Self::default() };
        } else if rivals > all.len() - off.len() {
            // One voice more for those that the accelerometers agree with: as many rivals as near + 1 leave no majority.
            self.contradicted = Some(now);
        } else {
            self.coast = None;
            for laser in &mut self.lasers {
                laser.held = laser.last.is_some_and(|(_, off_m)| is_off(off_m));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lasers in turns at 10 Hz on a vehicle that climbs with 0.2 m/s, off by these.
    fn run<const N: usize>(split: &mut Split, from: u32, slots: u32, off_m: [f64; N]) {
        run_by((0.0, 0.0), split, from, slots, off_m);
    }

    /// So much by the thrust as commanded, and predicted too high by so much, m.
    fn run_by<const N: usize>(
        (by_thrust, high_m): (f64, f64),
        split: &mut Split,
        from: u32,
        slots: u32,
        off_m: [f64; N],
    ) {
        for k in from..from + slots {
            let end = FlightTime(u64::from(k + 1) * 40_000);
            let (mut samples, z_m) = ([None; MAX_HEIGHTS], 0.2 * end.as_seconds());
            for (i, off_m) in off_m.into_iter().enumerate() {
                if (k as usize + i).is_multiple_of(3) {
                    samples[i] = Some((end, z_m + off_m + 0.01 * f64::from(k * 37 + i as u32 * 101).sin()));
                }
            }
            split.take(end, (z_m + high_m, 0.2), (0.0, by_thrust), &samples);
        }
    }

    fn refused(split: &Split) -> [bool; 3] {
        [0, 1, 2].map(|i| split.refuses(i))
    }

    #[test]
    fn one_of_three_is_held_back_from_its_first_sample_until_it_returns() {
        let mut split = Split::default();
        run(&mut split, 0, 50, [0.0; 3]);
        assert_eq!(refused(&split), [false; 3]);
        for k in 50..80 {
            run(&mut split, k, 1, [0.0, 0.4, 0.0]);
            let seen = k >= 52;
            assert!(!split.is_contradicted() && !split.refuses(0) && (!seen || split.refuses(1)), "slot {k}");
        }
        run(&mut split, 80, 4, [0.0; 3]);
        assert_eq!(refused(&split), [false; 3]);
    }

    #[test]
    fn two_of_three_contradict_the_accelerometers_within_half_a_second_until_all_agree() {
        for off_m in [0.3, -1.5] {
            let mut split = Split::default();
            run(&mut split, 0, 50, [0.0; 3]);
            run(&mut split, 50, 13, [off_m, 0.0, off_m]);
            assert!(split.is_contradicted() && refused(&split) == [true; 3], "{off_m}");
            run(&mut split, 63, 50, [off_m, 0.0, off_m]);
            assert!(split.is_contradicted());
            run(&mut split, 113, 40, [0.0; 3]);
            assert_eq!(refused(&split), [false; 3]);
        }
    }

    #[test]
    fn accelerometers_that_the_thrust_stands_in_for_have_no_voice() {
        let mut split = Split::default();
        run_by((0.9, 0.0), &mut split, 0, 50, [0.0; 3]);
        run_by((0.9, 0.0), &mut split, 50, 30, [0.3, 0.0, 0.3]);
        assert!(!split.is_contradicted());
        assert_eq!(refused(&split), [false; 3]);
    }

    /// GIVEN five lasers, one far off and one by a little more than the gap, WHEN the coasted altitude lies nearer to the latter than to
    /// the three others THEN these are used.
    #[test]
    fn most_of_five_are_more_than_the_one_nearest_to_a_coasted_altitude() {
        let mut split = Split::default();
        for k in 0..40 {
            let off_m = if k < 20 { [0.0; 5] } else { [0.139, 0.0, 0.0, 0.7, 0.0] };
            run_by((0.0, 0.08), &mut split, k, 1, off_m);
            assert!(!split.is_contradicted(), "slot {k}");
        }
        assert_eq!([1, 2, 3, 4].map(|i| split.refuses(i)), [false, false, true, false]);
    }

    /// GIVEN five lasers, two of them held back, WHEN a third is off as well, each by something else, THEN the other two and the
    /// accelerometers are used; of three that read the same they are no majority.
    #[test]
    fn lasers_that_read_each_something_else_are_no_other_truth() {
        for (second_m, third_m, contradicted) in [(0.145, -0.955, false), (0.7, 0.7, true)] {
            let mut split = Split::default();
            run(&mut split, 0, 20, [0.0; 5]);
            run(&mut split, 20, 20, [second_m, 0.0, 0.0, 0.7, 0.0]);
            run(&mut split, 40, 20, [second_m, 0.0, 0.0, 0.7, third_m]);
            assert_eq!(split.is_contradicted(), contradicted, "{third_m}");
        }
    }

    #[test]
    fn another_floor_is_taken_by_all_of_them() {
        let mut split = Split::default();
        run(&mut split, 0, 50, [0.0; 3]);
        run(&mut split, 50, 1, [0.5, 0.0, 0.0]);
        run(&mut split, 51, 20, [0.5; 3]);
        assert!(!split.is_contradicted());
        assert_eq!(refused(&split), [false; 3]);
    }
}

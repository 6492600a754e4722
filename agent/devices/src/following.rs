//! Ticks that follow a device which talks when it wants to: flight time is set back or forth, little by little, until each of its
//! samples is there just before a tick. Else it waits half a tick on average, and another time in every flight.
//!
//! Flight time then runs by that device's crystal instead of ours. It is left alone where nothing would be won, as where the
//! device's period is no whole number of ticks; a clock that is off by more than [`RATE_MAX`] is followed no faster than that, and in vain.

use arrayvec::ArrayVec;

use crate::asking::SPARE_S;

/// Samples that are looked at before flight time is moved.
const SAMPLES: usize = 128;
/// So fast is flight time moved: of physics it changes nothing, and crystals are off by less than 100 ppm.
const RATE_MAX: f64 = 500e-6;
/// Moves of less than this share of a tick tell of the clock's rate, and that much of it is taken over at once.
const STEADY: f64 = 0.1;
const LEARNT: f64 = 0.5;
/// Followed if the root mean square age of its samples becomes less than this share of a tick; it is 0.58 of one where they
/// come at any time.
const WON: f64 = 0.3;

/// The device that is followed, and what is known of it.
#[derive(Debug)]
pub(crate) struct Following {
    tick_s: f64,
    /// The first in the configuration that gives samples without being asked.
    device: usize,
    /// Since their arrival, at the tick that took them, s.
    ages_s: ArrayVec<f64, SAMPLES>,
    /// Ticks since that began.
    ticks: u32,
    /// By which flight time is still to be set back, s, and by which it is in each tick because the clocks differ.
    rest_s: f64,
    drift_s: f64,
}

impl Following {
    /// Nothing yet, for ticks of this period.
    pub(crate) fn new(tick_s: f64) -> Self {
        Self { tick_s, device: usize::MAX, ages_s: ArrayVec::new(), ticks: 0, rest_s: 0.0, drift_s: 0.0 }
    }

    /// A sample of device number `device` was taken so long after it had arrived.
    pub(crate) fn sample(&mut self, device: usize, age_s: f64) {
        if device > self.device || self.rest_s != 0.0 {
            return;
        }
        if device < self.device {
            *self = Self { device, ..Self::new(self.tick_s) };
        }
        if self.ages_s.is_empty() {
            self.ticks = 0;
        }
        self.ages_s.push(age_s.rem_euclid(self.tick_s));
        if !self.ages_s.is_full() {
            return;
        }
        match later(&mut self.ages_s, self.tick_s) {
            Some(by_s) => {
                self.rest_s = by_s + SPARE_S;
                if self.rest_s.abs() < STEADY * self.tick_s {
                    self.drift_s += LEARNT * self.rest_s / f64::from(self.ticks.max(1));
                }
            }
            None => self.drift_s = 0.0,
        }
        self.ages_s.clear();
    }

    /// By how much flight time is to be set back before the next tick, ns.
    pub(crate) fn step_ns(&mut self) -> i64 {
        self.ticks = self.ticks.saturating_add(1);
        let most = RATE_MAX * self.tick_s;
        // Half of it is left for where it has to go.
        self.drift_s = self.drift_s.clamp(-0.5 * most, 0.5 * most);
        let step_s = (self.drift_s + self.rest_s).clamp(-most, most);
        self.rest_s -= step_s - self.drift_s;
        // What is too little for a step is none: it is looked at again.
        if self.rest_s.abs() < 1e-9 {
            self.rest_s = 0.0;
        }
        (step_s * 1e9).round() as i64
    }
}

/// How much later ticks have to come so that the mean square age of samples is the smallest, s, between −½ and ½ of a tick;
/// `None` where that is not small. Sorts `ages_s`, each from 0 to `tick_s`.
fn later(ages_s: &mut [f64], tick_s: f64) -> Option<f64> {
    ages_s.sort_unstable_by(f64::total_cmp);
    let n = ages_s.len() as f64;
    let (mut sum, mut squares) = ages_s.iter().fold((0.0, 0.0), |(sum, squares), age| (sum + age, squares + age * age));
    let (mut best, mut by_s) = ((WON * tick_s).powi(2), None);
    for age in ages_s.iter() {
        // Of ticks that come so much earlier: those that arrived later than that wait for the next.
        let square = (squares - 2.0 * age * sum) / n + age * age;
        if square < best {
            (best, by_s) = (square, Some(-age));
        }
        sum += tick_s;
        squares += tick_s * (2.0 * age + tick_s);
    }
    by_s.map(|by_s| if by_s < -0.5 * tick_s { by_s + tick_s } else { by_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_S: f64 = 0.005;

    /// Ages of the samples that came every `period_s` of a clock that runs `fast`, each late by `late_s(k)`, in the last minute of
    /// two, and by how much flight time was set back in it, s.
    fn flown(period_s: f64, fast: f64, late_s: impl Fn(usize) -> f64) -> (Vec<f64>, f64) {
        let mut following = Following::new(TICK_S);
        let (mut ages, mut set_back_s, mut moved_s) = (Vec::new(), 0.0, 0.0);
        let mut k = 0;
        let arrives = |k: usize| 0.0032 + k as f64 * period_s / (1.0 + fast) + late_s(k);
        for tick in 0..24_000 {
            let at = tick as f64 * TICK_S + set_back_s;
            while arrives(k) <= at {
                following.sample(3, at - arrives(k));
                if tick >= 12_000 {
                    ages.push(at - arrives(k));
                }
                k += 1;
            }
            let step_s = following.step_ns() as f64 * 1e-9;
            set_back_s += step_s;
            if tick >= 12_000 {
                moved_s += step_s;
            }
        }
        (ages, moved_s)
    }

    fn rms(ages: &[f64]) -> f64 {
        (ages.iter().map(|age| age * age).sum::<f64>() / ages.len() as f64).sqrt()
    }

    /// GIVEN samples at 100 Hz by a clock 80 ppm fast or slow, up to 0.3 ms late WHEN they are followed THEN they are taken
    /// within 0.5 ms of their arrival, all but a few, and flight time runs as their clock does.
    #[test]
    fn samples_are_there_just_before_a_tick() {
        for fast in [80e-6, -80e-6, 0.0] {
            let (ages, moved_s) = flown(0.01, fast, |k| (k as u64 * 7919 % 300) as f64 * 1e-6);
            let long = ages.iter().filter(|age| **age > 0.5e-3).count();
            assert!(long <= ages.len() / 20, "{fast}: {long} of {}", ages.len());
            assert!((moved_s + 60.0 * fast).abs() < 0.5e-3, "{fast}: {moved_s} s");
        }
    }

    /// GIVEN one sample in seven that is 2 ms late WHEN they are followed THEN the others do not wait for it.
    #[test]
    fn a_few_late_ones_keep_the_others_from_nothing() {
        let (ages, _) = flown(0.01, 50e-6, |k| if k.is_multiple_of(7) { 2e-3 } else { 0.0 });
        let short = ages.iter().filter(|age| **age < 0.5e-3).count();
        assert!(short > ages.len() * 3 / 4, "{short} of {}, rms {}", ages.len(), rms(&ages));
    }

    /// GIVEN a period that is no number of ticks, or a clock that is off by half a per cent WHEN it cannot be followed THEN
    /// flight time is left alone, or moves by no more than the bound.
    #[test]
    fn what_cannot_be_followed_moves_little_or_nothing() {
        for period_s in [0.0083, 0.0125, 0.0096] {
            let (_, moved_s) = flown(period_s, 0.0, |_| 0.0);
            assert_eq!(moved_s, 0.0, "{period_s}");
        }
        let (_, moved_s) = flown(0.01, 5e-3, |_| 0.0);
        assert!(moved_s.abs() <= 60.0 * RATE_MAX, "{moved_s} s");
    }

    /// GIVEN two that talk WHEN both are heard THEN the first of the configuration is followed.
    #[test]
    fn the_first_of_the_configuration_is_followed() {
        let mut following = Following::new(TICK_S);
        for _ in 0..4 * SAMPLES {
            following.sample(5, 4e-3);
            following.sample(2, 1e-3);
        }
        assert!((following.rest_s + 1e-3 - SPARE_S).abs() < 1e-12, "{}", following.rest_s);
        let steps: i64 = (0..1_000).map(|_| following.step_ns()).sum();
        assert!((steps + 900_000).abs() < 1_000, "{steps} ns");
    }
}

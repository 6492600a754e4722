//! When a device that says nothing by itself is asked: so that its answer is there just before a tick of the flight thread, which
//! else takes it half a tick later on average.

use std::time::{Duration, Instant};

use crate::reader::Zero;

/// How many of the last answers tell how long the next takes.
const ANSWERS: usize = 128;
/// After so many it is looked at anew.
const AGAIN: usize = 16;
/// So much sooner than the last answers say, s: a little too late costs a whole tick.
pub(crate) const SPARE_S: f64 = 100e-6;
/// What an answer takes before any came, s.
const FIRST_S: f64 = 2e-3;

/// Questions to one device.
#[derive(Debug)]
pub(crate) struct Asking {
    period: Duration,
    /// When the next would be asked if there were no ticks.
    even: Instant,
    due: Instant,
    /// What the last answers took, s, and how many there were.
    took_s: [f64; ANSWERS],
    answers: usize,
    lead: Duration,
}

impl Asking {
    /// From `now` on, every `period`.
    pub(crate) fn new(period: Duration, now: Instant) -> Self {
        let lead = Duration::from_secs_f64(FIRST_S);
        Self { period, even: now, due: now, took_s: [FIRST_S; ANSWERS], answers: 0, lead }
    }

    /// How long until the next question.
    pub(crate) fn wait(&self, now: Instant) -> Duration {
        self.due.saturating_duration_since(now)
    }

    /// Its answer was there at `answered`, and by `now` there is nothing more to ask: when is it asked next?
    pub(crate) fn answered(&mut self, answered: Instant, now: Instant, zero: &Zero) {
        if let Some(oldest) = self.took_s.get_mut(self.answers % ANSWERS) {
            *oldest = answered.saturating_duration_since(self.due).as_secs_f64();
        }
        self.answers = self.answers.wrapping_add(1);
        self.even = (self.even + self.period).max(now);
        self.due = self.even;
        let Some((taken, tick)) = zero.nearest_tick(self.even + self.lead).filter(|(_, tick)| *tick <= self.period)
        else {
            return;
        };
        let before = taken.checked_sub(self.lead).unwrap_or(self.even);
        self.due = if before < now { before + tick } else { before };
        if self.answers.is_multiple_of(AGAIN) {
            let lead_s = youngest(self.took_s, tick.as_secs_f64()) + SPARE_S;
            self.lead = Duration::from_secs_f64(lead_s.min(self.period.as_secs_f64()));
        }
    }
}

/// The time before a tick, s, at which a question's answer has the smallest mean square age when it is taken, if answers take
/// `took_s`: one that comes later waits for another tick.
fn youngest(mut took_s: [f64; ANSWERS], tick_s: f64) -> f64 {
    took_s.sort_unstable_by(f64::total_cmp);
    let square = |(index, lead_s): (usize, &f64)| {
        let late = (ANSWERS - 1 - index) as f64 / ANSWERS as f64;
        ((1.0 - late) * lead_s.powi(2) + late * (lead_s + tick_s).powi(2), *lead_s)
    };
    took_s.iter().enumerate().map(square).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(FIRST_S, |(_, lead_s)| lead_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(5);

    /// When each of `count` questions was asked and answered, s after zero; the answer takes `takes(k)`.
    fn asked(period: Duration, count: usize, takes: impl Fn(usize) -> Duration) -> Vec<[f64; 2]> {
        let begun = Instant::now();
        let zero = Zero::ticking(1.0 / TICK.as_secs_f64());
        zero.set(begun);
        let mut now = begun + Duration::from_micros(1234);
        let mut asking = Asking::new(period, now);
        let mut all = Vec::new();
        for k in 0..count {
            let due = now + asking.wait(now);
            now = due + takes(k);
            all.push([due, now].map(|at| (at - begun).as_secs_f64()));
            asking.answered(now, now, &zero);
        }
        all
    }

    /// How long what is there at `at` waits for its tick, s.
    fn waits(at: f64) -> f64 {
        let tick = TICK.as_secs_f64();
        (at / tick).ceil() * tick - at
    }

    /// GIVEN answers that take 0.4 to 0.8 ms WHEN a device is asked at 100 Hz THEN they wait for their ticks for less than
    /// 0.5 ms, all but a few, and none is left out.
    #[test]
    fn answers_are_there_just_before_a_tick() {
        let all = asked(2 * TICK, 20_000, |k| Duration::from_micros(400 + (k as u64 * 7919) % 400));
        let (_, later) = all.split_at(1_000);
        let long = later.iter().filter(|[_, answered]| waits(*answered) > 0.5e-3).count();
        assert!(long <= later.len() / 50, "{long} of {}", later.len());
        let span = later[later.len() - 1][0] - later[0][0];
        assert!((span / (later.len() - 1) as f64 - 0.01).abs() < 1e-5, "{span}");
    }

    /// GIVEN an answer in seven that takes 2 ms more WHEN it is asked THEN the other six do not wait for that.
    #[test]
    fn answers_in_pieces_keep_the_others_from_nothing() {
        let all = asked(2 * TICK, 5_000, |k| Duration::from_micros(if k.is_multiple_of(7) { 2_500 } else { 500 }));
        let mean = all[1_000..].iter().map(|[due, answered]| answered + waits(*answered) - due).sum::<f64>() / 4_000.0;
        assert!((0.0005..0.0014).contains(&mean), "{mean} s");
    }

    /// GIVEN a period that is no number of ticks, or less than one WHEN it is asked THEN it is as often as that says.
    #[test]
    fn a_device_is_asked_as_often_as_it_is_to_be() {
        for micros in [2_500, 7_000, 25_000, 9_900] {
            let period = Duration::from_micros(micros);
            let all = asked(period, 4_000, |_| Duration::from_micros(300));
            let mean = (all[3_999][0] - all[999][0]) / 3_000.0;
            assert!((mean / period.as_secs_f64() - 1.0).abs() < 0.002, "{micros} µs: every {mean} s");
        }
    }

    /// GIVEN a device that answers after more than its period WHEN it is asked THEN nothing is asked before it answered.
    #[test]
    fn one_that_is_slow_is_asked_when_it_has_answered() {
        let all = asked(2 * TICK, 500, |_| Duration::from_millis(23));
        assert!(all.windows(2).all(|pair| pair[1][0] >= pair[0][1]), "{:?}", all.first_chunk::<4>());
        assert!(all[499][0] - all[0][0] < 499.0 * 0.029, "{}", all[499][0]);
    }
}

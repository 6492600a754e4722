//! The measured response to a setpoint step: rise time, overshoot, settling time, steady error.
//!
//! Measures the operator's step, not the rate-limited profile that the controller is given.
//! With s = sign(to − from), progress is (z − from)/(to − from):
//! - rise time: first passage of 10 % to first passage of 90 %, interpolated between ticks;
//! - overshoot: largest s(z − to), in per cent of the step;
//! - settling time: from the step until |z − to| enters the band for good, so far;
//! - steady error: mean of z − to over the last second;
//! - tracking: root mean square of z minus the profiled setpoint, since the step.
//!
//! A step that is replaced, or ended by another mode, while z is still outside the band is *interrupted*: told
//! once more, as it stood. The next one is measured from its own change of the setpoint. Where z is then already past
//! 10 % no rise time is told, and what lies beyond the target counts as overshoot only after z has been
//! on the near side: both belong to the step before.
//!
//! Bound: `BINS` bins of 0.1 s for the steady error, whatever the tick rate; nothing allocates.

use plumbline_proto::time::FlightTime;

/// Half-width of the settling band, m; 5 % of the step where that is more, half of it at most.
const BAND_M: f64 = 0.05;
/// Smaller changes of the setpoint are no step, m.
const SMALLEST_STEP_M: f64 = 0.02;
/// In the band this long: settled, and the measurement ends, s.
const SETTLED_FOR_S: f64 = 3.0;
/// The measurement ends after this long whatever happens, s.
const LONGEST_S: f64 = 30.0;
/// Bins that cover the last second.
const BINS: usize = 10;

/// What is known about a step so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepResponse {
    /// Counts from 1 in each flight.
    pub step: u32,
    /// When the operator's setpoint changed.
    pub start: FlightTime,
    /// Altitude asked for before, m.
    pub from_m: f64,
    /// Altitude asked for, m.
    pub to_m: f64,
    /// 10 % to 90 %, s.
    pub rise_time_s: Option<f64>,
    /// In per cent of the step, never negative.
    pub overshoot_percent: f64,
    /// Into the band for good, so far, s.
    pub settling_time_s: Option<f64>,
    /// Half-width of the band, m.
    pub band_m: f64,
    /// Mean of z − to over the last second, m; once a second has passed.
    pub steady_error_m: Option<f64>,
    /// Is the measurement over?
    pub finished: bool,
    /// Another step or mode began before the altitude was inside the band.
    pub interrupted: bool,
    /// Root mean square of z minus the profiled setpoint since the step, m.
    pub tracking_rms_m: f64,
}

/// Measures one step after another.
#[derive(Debug, Default)]
pub struct StepMeter {
    current: Option<Measurement>,
    /// Ended from outside, not told yet.
    ended: Option<StepResponse>,
    steps: u32,
}

#[derive(Debug)]
struct Measurement {
    response: StepResponse,
    last: (FlightTime, f64),
    passed_10: Option<f64>,
    /// Was z past 10 % when the step began?
    begun_past_10: bool,
    /// Has z been on the near side of the target?
    near_side: bool,
    outside_until_s: f64,
    squared_error_sum: f64,
    samples: u64,
    bins: [(i64, f64, u32); BINS],
}

impl StepMeter {
    /// A step of the operator's altitude setpoint; ends the measurement of the one before.
    /// Changes under 2 cm are not measured.
    pub fn begin(&mut self, time: FlightTime, from_m: f64, to_m: f64, altitude_m: f64) {
        let size = (to_m - from_m).abs();
        if size.is_nan() || size < SMALLEST_STEP_M {
            return;
        }
        self.steps += 1;
        self.end();
        let progress = (altitude_m - from_m) / (to_m - from_m);
        self.current = Some(Measurement {
            response: StepResponse {
                step: self.steps,
                start: time,
                from_m,
                to_m,
                rise_time_s: None,
                overshoot_percent: 0.0,
                settling_time_s: None,
                band_m: BAND_M.max(0.05 * size).min(0.5 * size),
                steady_error_m: None,
                finished: false,
                interrupted: false,
                tracking_rms_m: 0.0,
            },
            last: (time, altitude_m),
            passed_10: None,
            begun_past_10: progress > 0.1,
            near_side: progress <= 1.0,
            outside_until_s: 0.0,
            squared_error_sum: 0.0,
            samples: 0,
            bins: [(-1, 0.0, 0); BINS],
        });
    }

    /// Ends the measurement as it stands: another step, another mode.
    pub fn end(&mut self) {
        if let Some(r) = self.current.take().map(|m| m.response).filter(|r| !r.finished) {
            self.ended = Some(StepResponse { finished: true, interrupted: r.settling_time_s.is_none(), ..r });
        }
    }

    /// What was ended so, once.
    pub fn ended(&mut self) -> Option<StepResponse> {
        self.ended.take()
    }

    /// Forgets the measurement (disarmed) and starts counting again with the next flight.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The response so far, finished or not.
    pub fn response(&self) -> Option<&StepResponse> {
        self.current.as_ref().map(|m| &m.response)
    }

    /// Takes the altitude and the profiled setpoint of one tick; `Some` while a step is measured,
    /// and once more when it ends, by itself or from outside.
    pub fn update(&mut self, time: FlightTime, altitude_m: f64, profiled_m: f64) -> Option<StepResponse> {
        let measured = self.current.as_mut().filter(|m| !m.response.finished).map(|m| {
            m.take(time, altitude_m, profiled_m);
            m.response
        });
        self.ended().or(measured)
    }
}

impl Measurement {
    fn take(&mut self, time: FlightTime, z: f64, profiled: f64) {
        let r = &mut self.response;
        let t = time.seconds_since(r.start);
        let step = r.to_m - r.from_m;
        let progress = |z: f64| (z - r.from_m) / step;
        let (before_s, before) = (self.last.0.seconds_since(r.start), progress(self.last.1));
        let now = progress(z);
        // First passage of `level`, interpolated between the two ticks.
        let passage = |level: f64| {
            (now >= level).then(|| {
                if before < level { before_s + (level - before) / (now - before) * (t - before_s) } else { before_s }
            })
        };
        if self.passed_10.is_none() && !self.begun_past_10 {
            self.passed_10 = passage(0.1);
        }
        if let (Some(low), None) = (self.passed_10, r.rise_time_s) {
            r.rise_time_s = passage(0.9).map(|high| high - low);
        }
        self.near_side |= now <= 1.0;
        if self.near_side {
            r.overshoot_percent = r.overshoot_percent.max(100.0 * (now - 1.0));
        }

        let error = z - r.to_m;
        if error.abs() > r.band_m {
            self.outside_until_s = t;
            r.settling_time_s = None;
        } else {
            r.settling_time_s = Some(self.outside_until_s);
        }

        let bin = (t * BINS as f64).floor() as i64;
        let slot = &mut self.bins[bin.rem_euclid(BINS as i64) as usize];
        *slot = if slot.0 == bin { (bin, slot.1 + error, slot.2 + 1) } else { (bin, error, 1) };
        if t >= 1.0 {
            let (sum, count) = self
                .bins
                .iter()
                .filter(|b| bin - b.0 < BINS as i64)
                .fold((0.0, 0_u32), |(sum, count), b| (sum + b.1, count + b.2));
            r.steady_error_m = Some(sum / f64::from(count.max(1)));
        }

        self.squared_error_sum += (z - profiled).powi(2);
        self.samples += 1;
        r.tracking_rms_m = (self.squared_error_sum / self.samples as f64).sqrt();
        r.finished = r.settling_time_s.is_some_and(|s| t - s >= SETTLED_FOR_S) || t >= LONGEST_S;
        self.last = (time, z);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// z = 1 − e^(−ζωt)(cos ωd t + ζ/√(1−ζ²) sin ωd t): a second-order response with known figures.
    fn second_order(t: f64, zeta: f64, omega: f64) -> f64 {
        let damped = omega * (1.0 - zeta * zeta).sqrt();
        let decay = (-zeta * omega * t).exp();
        1.0 - decay * ((damped * t).cos() + zeta / (1.0 - zeta * zeta).sqrt() * (damped * t).sin())
    }

    fn measure(from: f64, to: f64, response: impl Fn(f64) -> f64) -> StepResponse {
        let mut meter = StepMeter::default();
        let start = FlightTime::from_seconds(3.0);
        meter.begin(start, from, to, from);
        for k in 1..=2000 {
            let t = f64::from(k) * 0.005;
            meter.update(FlightTime::from_seconds(3.0 + t), from + (to - from) * response(t), to);
        }
        *meter.response().unwrap()
    }

    #[test]
    fn a_second_order_step_has_the_textbook_figures() {
        for (from, to) in [(0.5, 1.0), (1.0, 0.5)] {
            let r = measure(from, to, |t| second_order(t, 0.5, 4.0));
            // Overshoot e^(−πζ/√(1−ζ²)) = 16.30 %; rise time 10–90 % is 1.6384/ω for ζ = 0.5.
            assert!((r.overshoot_percent - 16.303).abs() < 0.02, "{r:?}");
            assert!((r.rise_time_s.unwrap() - 1.6384 / 4.0).abs() < 2e-3, "{r:?}");
            // ±10 % of the step (5 cm of 0.5 m): last leaves the band on the way down at 1.1.
            let leaves =
                (1..2000).map(|k| f64::from(k) * 0.005).filter(|&t| (second_order(t, 0.5, 4.0) - 1.0).abs() > 0.1);
            assert!((r.settling_time_s.unwrap() - leaves.fold(0.0, f64::max)).abs() < 1e-9, "{r:?}");
            assert!(r.finished && r.steady_error_m.unwrap().abs() < 1e-3, "{r:?}");
        }
    }

    #[test]
    fn a_step_that_never_arrives_ends_unsettled() {
        let mut meter = StepMeter::default();
        meter.begin(FlightTime(0), 0.0, 1.0, 0.0);
        let mut seen = 0;
        for k in 1..=700 {
            if meter.update(FlightTime(k * 50_000), 0.5, 1.0).is_some() {
                seen = k;
            }
        }
        let r = meter.response().unwrap();
        assert_eq!(seen, 600, "measured for 30 s");
        assert!(r.finished && r.settling_time_s.is_none() && r.rise_time_s.is_none());
        assert!((r.steady_error_m.unwrap() + 0.5).abs() < 1e-12 && (r.tracking_rms_m - 0.5).abs() < 1e-12);
    }

    #[test]
    fn tiny_changes_are_no_step_and_a_new_step_replaces_the_old() {
        let mut meter = StepMeter::default();
        meter.begin(FlightTime(0), 0.5, 0.51, 0.5);
        assert!(meter.response().is_none());
        meter.begin(FlightTime(0), 0.5, 0.8, 0.5);
        meter.begin(FlightTime(9), 0.8, 1.0, 0.6);
        assert_eq!(meter.response().unwrap().step, 2);
    }

    #[test]
    fn an_interrupted_step_is_told_and_lends_nothing_to_the_next() {
        let mut meter = StepMeter::default();
        let second = |s: f64| FlightTime::from_seconds(s);
        meter.begin(second(0.0), 1.0, 0.5, 1.0);
        meter.update(second(0.5), 0.8, 0.7);
        // Back up while z is at 0.8: past 10 %, and soon beyond nothing.
        meter.begin(second(0.6), 0.5, 1.0, 0.8);
        let first = meter.update(second(0.61), 0.8, 0.7).unwrap();
        assert!((first.step, first.finished, first.interrupted) == (1, true, true), "{first:?}");
        let mut last = first;
        for k in 1..=500 {
            let t = f64::from(k) * 0.01;
            last = meter.update(second(0.61 + t), 1.0 - 0.2 * (-4.0 * t).exp(), 1.0).unwrap_or(last);
        }
        assert!((last.step, last.finished, last.interrupted) == (2, true, false), "{last:?}");
        assert_eq!((last.rise_time_s, last.overshoot_percent), (None, 0.0));
        // 0.2 e^(−4t) enters ±0.05 at t = ln(4)/4.
        assert!((last.settling_time_s.unwrap() - (0.01 + 4.0_f64.ln() / 4.0)).abs() < 0.011, "{last:?}");

        // Down from 1.2 towards 0.5, then 1.0: what was above 1.0 is no overshoot of this step.
        let mut meter = StepMeter::default();
        meter.begin(second(0.0), 1.2, 0.5, 1.2);
        meter.begin(second(0.1), 0.5, 1.0, 1.2);
        for k in 1..=600 {
            meter.update(second(0.1 + f64::from(k) * 0.01), 1.0 + 0.2 * (-f64::from(k) * 0.05).exp(), 1.0);
        }
        assert_eq!(meter.response().unwrap().overshoot_percent, 0.0);
    }

    #[test]
    fn a_step_replaced_inside_the_band_was_not_interrupted() {
        let mut meter = StepMeter::default();
        meter.begin(FlightTime(0), 0.5, 0.8, 0.5);
        meter.update(FlightTime::from_seconds(1.0), 0.79, 0.8);
        meter.begin(FlightTime::from_seconds(2.0), 0.8, 1.0, 0.8);
        let first = meter.update(FlightTime::from_seconds(2.01), 0.8, 0.8).unwrap();
        assert!(first.finished && !first.interrupted && first.settling_time_s.is_some(), "{first:?}");
        // Another mode ends the second one as it stood.
        meter.end();
        let second = meter.update(FlightTime::from_seconds(2.02), 0.2, 0.2).unwrap();
        assert!(second.finished && second.interrupted && second.to_m == 1.0, "{second:?}");
        assert!(second.overshoot_percent == 0.0 && second.tracking_rms_m == 0.0, "{second:?}");
        assert_eq!(meter.update(FlightTime::from_seconds(2.03), 0.2, 0.2), None);
    }
}

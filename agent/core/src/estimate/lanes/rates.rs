//! Angular rate and attitude now, although gyroscopes tell them late: brought on by the torque as commanded.
//!
//! m' = J⁻¹ (τ − ω × J ω) − m/T     ω = ω_m + a (m(now) − m(t_s − δ))     lead of the attitude: ∫ ω − ω_m from t_s − δ to now, and ω_m δ
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | ω_m, t_s | rate measured, bias removed, and when | rad/s, s |
//! | δ | what stamps and motor model do not tell: filters in the gyroscopes, motors that obey late | s |
//! | τ | torque of the rotors as commanded, their lag included | N m |
//! | m | rate that the torques alone give, forgotten within T | rad/s |
//! | a | part of it about each axis that gyroscopes confirm: 1 in free flight, less on a pivot or in a hand | – |
//!
//! Only differences of m over some 10 ms are used, so that neither inertia nor torques need be known well. Without them a rate
//! 20 ms late costs an attitude loop its phase margin. On a pivot, whose friction and inertia take half of what the torques give, all of
//! m would lead too far.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

/// T, s.
pub(super) const FORGOTTEN_S: f64 = 0.5;
/// δ, s. A choice: from 30 ms on the world `harsh` is flown at all, and 40 ms cost 0.05° of tilt on a bench that delays nothing.
pub(super) const LATE_S: f64 = 0.04;
/// Most the attitude is led by, rad, and the rate, rad/s.
const LEAD_MAX_RAD: f64 = 0.15;
const RATE_LEAD_MAX_RADPS: f64 = 3.0;
/// Changes of m and of the rate are compared within this, s, over this, s, …
const CHANGE_S: f64 = 0.1;
const COMPARED_S: f64 = 2.0;
/// … and count from this square of them on, rad²/s²: more than a hover makes.
const COUNTS: f64 = 0.02;
/// Ticks kept: 96 ms at 1000 Hz.
const KEPT: usize = 96;

/// See the module.
#[derive(Debug, Clone)]
pub struct Rates {
    /// m, the newest first at `next − 1`.
    past: [(FlightTime, Vector3<f64>); KEPT],
    next: usize,
    model: Vector3<f64>,
    rate: Vector3<f64>,
    lead: Vector3<f64>,
    confirmed: Confirmed,
}

/// How far gyroscopes confirm what the torques say, about each axis.
#[derive(Debug, Clone, Copy, Default)]
struct Confirmed {
    /// Of m and of the rate: what they are on average within [`CHANGE_S`].
    slow: [Vector3<f64>; 2],
    /// Product of their changes, and the square of that of m.
    both: Vector3<f64>,
    square: Vector3<f64>,
}

impl Confirmed {
    /// After m and the rate at one time, `dt_s` after the last ones: a.
    fn take(&mut self, model: &Vector3<f64>, measured: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        let mut change = |now: &Vector3<f64>, place: usize| {
            self.slow[place] += (now - self.slow[place]) * (dt_s / CHANGE_S).min(1.0);
            now - self.slow[place]
        };
        let (model, measured) = (change(model, 0), change(measured, 1));
        let gain = (dt_s / COMPARED_S).min(1.0);
        self.both += (model.component_mul(&measured) - self.both) * gain;
        self.square += (model.component_mul(&model) - self.square) * gain;
        self.both.zip_map(&self.square, |both, square| ((both + COUNTS) / (square + COUNTS)).clamp(0.0, 1.0))
    }
}

impl Rates {
    /// At rest.
    pub fn new() -> Self {
        let zero = Vector3::zeros();
        Self {
            past: [(FlightTime(0), zero); KEPT],
            next: 0,
            model: zero,
            rate: zero,
            lead: zero,
            confirmed: Confirmed::default(),
        }
    }

    /// Rate now, body FLU, rad/s.
    pub fn rate_radps(&self) -> Vector3<f64> {
        self.rate
    }

    /// From the body as the gyroscopes have it to the body now.
    pub fn lead(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(self.lead)
    }

    /// A tick: `turning` is the angular acceleration of the torques, rad/s², `None` where the rotors do not fly: then only
    /// stamps tell what is late. `measured` is the last rate and when it was.
    pub fn step(
        &mut self,
        now: FlightTime,
        dt_s: f64,
        turning: Option<&Vector3<f64>>,
        measured: Option<(FlightTime, Vector3<f64>)>,
    ) {
        let late_s = if turning.is_some() { LATE_S } else { 0.0 };
        self.model += (turning.copied().unwrap_or_default() - self.model / FORGOTTEN_S) * dt_s;
        self.past[self.next] = (now, self.model);
        self.next = (self.next + 1) % KEPT;
        let Some((time, measured)) = measured else { return };
        let seen = FlightTime(time.0.saturating_sub((1e6 * late_s) as u64));
        let (then, area) = self.since(seen, now);
        let part = self.confirmed.take(&then, &measured, dt_s);
        self.rate = measured + part.component_mul(&(self.model - then)).cap_magnitude(RATE_LEAD_MAX_RADPS);
        self.lead = (measured * late_s + part.component_mul(&area)).cap_magnitude(LEAD_MAX_RAD);
    }

    /// m at `time`, and the integral of m less that from there to `now`.
    fn since(&self, time: FlightTime, now: FlightTime) -> (Vector3<f64>, Vector3<f64>) {
        let back = |n: usize| self.past[(self.next + KEPT - n) % KEPT];
        let oldest = (1..=KEPT).find(|n| back(*n).0 <= time || back(*n).0 == FlightTime(0)).unwrap_or(KEPT);
        let (mut from, then) = back(oldest);
        from = from.max(time).min(now);
        let mut area = Vector3::zeros();
        for n in (1..oldest).rev() {
            let (at, model) = back(n);
            area += (model - then) * at.seconds_since(from).max(0.0);
            from = at.max(from);
        }
        (then, area)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A swing at 1.5 Hz, measured 20 ms late; torques are told as `told` times what they do. Once it has gone on for a while: most that
    /// the rate is off by as measured and as told now, rad/s, and the attitude, rad.
    fn swung(told: f64) -> [f64; 3] {
        let (amplitude, w) = (2.0, 9.4);
        let truth = |t: f64| amplitude * (w * t).sin();
        let mut rates = Rates::new();
        let (mut late, mut led, mut angle) = (0.0f64, 0.0f64, 0.0f64);
        for k in 1..4000u64 {
            let t = k as f64 * 0.005;
            let turning = Vector3::x() * (told * amplitude * w * (w * (t - 0.0025)).cos());
            let measured = truth(t - 0.02 - LATE_S);
            rates.step(
                FlightTime(k * 5000),
                0.005,
                Some(&turning),
                Some((FlightTime(k * 5000 - 20_000.min(k * 5000)), Vector3::x() * measured)),
            );
            if t > 5.0 {
                late = late.max((measured - truth(t)).abs());
                led = led.max((rates.rate_radps().x - truth(t)).abs());
                // The attitude of the gyroscopes, the last rate held, against the one now.
                let integral = |t: f64| -amplitude / w * (w * t).cos();
                let held = integral(t - 0.02 - LATE_S) + measured * 0.02;
                angle = angle.max((held + rates.lead().scaled_axis().x - integral(t)).abs());
            }
        }
        [late, led, angle]
    }

    #[test]
    fn a_late_gyroscope_is_brought_to_now_by_torques_known_roughly() {
        let [late, led, angle] = swung(1.2);
        assert!(led < 0.35 * late && angle < 0.015, "{led} against {late}, {angle} rad");
    }

    /// GIVEN a pivot that takes most of what the torques give WHEN the vehicle swings THEN it is led no further than the gyroscopes say; and
    /// a hand that holds it takes the lead away.
    #[test]
    fn a_lead_that_gyroscopes_do_not_confirm_is_taken_back() {
        let [late, led, angle] = swung(2.5);
        assert!(led < 0.35 * late && angle < 0.015, "{led} against {late}, {angle} rad");
        let mut rates = Rates::new();
        let held = |k: u64, rates: &mut Rates| {
            let turning = Vector3::x() * (30.0 * (k as f64 * 0.05).sin());
            let now = FlightTime(k * 5000);
            rates.step(now, 0.005, Some(&turning), Some((now, Vector3::zeros())));
            rates.rate_radps().norm()
        };
        let most = |from: u64, rates: &mut Rates| (from..from + 100).map(|k| held(k, rates)).fold(0.0, f64::max);
        let (first, last) = (most(1, &mut rates), most(600, &mut rates));
        assert!(first > 0.5 && last < 0.1, "{first} {last}");
    }
}

//! Is something else than its rotors holding the vehicle up: strings, the ground, a hand?
//!
//! s = m f_z − T is what the accelerometers feel along the thrust axis beyond the thrust of the applied commands. Thrust is
//! known to some percent only, and its error stays; what holds the vehicle up comes at once. So s counts from its
//! least value of the last 5 to 10 s on, and only as far as vibration does not make it rise as well. Whoever integrates against
//! a support, or between two bounces on one, sags when it lets go; whoever takes vibration for one never comes down to his
//! setpoint.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | f_z | specific force along body z, median of all IMUs, which may sample in turns: a minority that lies does not move it | m/s² |
//! | T | thrust of the applied commands, through motor lag and battery | N |

use plumbline_proto::time::FlightTime;

use crate::estimate::median;
use crate::model::airframe::Airframe;
use crate::model::motor::Rotors;
use crate::sensor::{MAX_IMUS, SensorFrame};
use crate::types::MotorCommand;

/// A sample takes part in the median this long, s: IMUs sample in turns at 100 Hz and faster.
const MEMORY_S: f64 = 0.015;
/// Time constant against vibration, s.
const SMOOTH_S: f64 = 0.025;
/// The least value is that of the present span of this length and of the one before, s.
const SPAN_S: f64 = 5.0;
/// Time constants of the mean that vibration is counted from, and of what is usual of it, s.
const MEAN_S: f64 = 0.2;
const USUAL_S: f64 = 3.0;
/// Further from the mean than so many times the usual, and this part of the weight, counts as if it were there: what comes once is no
/// vibration. Nor is that part of the weight.
const VIBRATES: f64 = 3.0;
const QUIET: f64 = 0.005;
/// How far above its least value of some seconds vibration brings s, in its mean absolute values: ±3 σ of a normal one.
const RISES: f64 = 7.5;
/// Held up from this part of the weight on …
const HELD: f64 = 0.06;
/// … until below this.
const RELEASED: f64 = 0.03;
/// What held it up for longer than this, s, counts for so much longer, s: on strings a vehicle bounces. Vibration does not last as long, unless it
/// is strong: not where its usual is more than this part of the weight.
const LASTS_S: f64 = 0.1;
const BOUNCES_S: f64 = 1.0;
const SHAKEN: f64 = 0.04;

/// The observer.
#[derive(Debug, Clone, Default)]
pub struct Support {
    rotors: Rotors,
    latest: [Option<(FlightTime, f64)>; MAX_IMUS],
    smooth_n: Option<f64>,
    /// Mean of it, N, and its usual distance from there, N.
    mean_n: f64,
    vibrates_n: f64,
    /// Of the present span and of the one before.
    least_n: [Option<f64>; 2],
    span_s: f64,
    /// Held for so long in a row, s; and for so long yet it counts, s.
    held_s: f64,
    counts_s: f64,
    force_n: f64,
}

impl Support {
    /// Takes a tick; `flying`, or else nothing is known of it.
    pub fn step(
        &mut self,
        airframe: &Airframe,
        received: &SensorFrame,
        applied: &MotorCommand,
        voltage_ratio: f64,
        flying: bool,
        dt_s: f64,
    ) {
        self.rotors.step(airframe, &applied.throttle, voltage_ratio, dt_s);
        for (latest, imu) in self.latest.iter_mut().zip(&received.imus) {
            let sample = imu.filter(|imu| imu.accel_mps2.z.is_finite());
            *latest = sample.map(|imu| (received.time, imu.accel_mps2.z)).or(*latest);
        }
        if !flying {
            *self = Self { rotors: self.rotors, latest: self.latest, ..Self::default() };
            return;
        }
        let fresh = |at: &FlightTime| (0.0..=MEMORY_S).contains(&received.time.seconds_since(*at));
        let force = median(self.latest.iter().flatten().filter(|(at, _)| fresh(at)).map(|(_, force)| *force));
        if !force.is_finite() {
            return;
        }
        let now_n = airframe.mass_kg * force - airframe.wrench(self.rotors.speed_radps()).thrust_n;
        let part = |of_s: f64| dt_s / (of_s + dt_s);
        let (before_n, mean_n) = self.smooth_n.map_or((now_n, now_n), |before_n| (before_n, self.mean_n));
        let smooth_n = before_n + (now_n - before_n) * part(SMOOTH_S);
        self.smooth_n = Some(smooth_n);
        self.mean_n = mean_n + (smooth_n - mean_n) * part(MEAN_S);
        let most_n = VIBRATES * self.vibrates_n + QUIET * airframe.weight_n();
        let off_n = (smooth_n - self.mean_n).abs().min(most_n);
        self.vibrates_n += (off_n - self.vibrates_n) * part(USUAL_S);
        self.span_s += dt_s;
        if self.span_s > SPAN_S {
            self.span_s = 0.0;
            self.least_n = [None, self.least_n[0]];
        }
        self.least_n[0] = Some(self.least_n[0].map_or(smooth_n, |least| least.min(smooth_n)));
        let limit = if self.held_s > 0.0 { RELEASED } else { HELD };
        let vibrates_n = (self.vibrates_n - QUIET * airframe.weight_n()).max(0.0);
        let risen_n = self.risen_n();
        let held = risen_n > limit * airframe.weight_n() + RISES * vibrates_n;
        self.held_s = if held { self.held_s + dt_s } else { 0.0 };
        let bounces = self.held_s > LASTS_S && self.vibrates_n < SHAKEN * airframe.weight_n();
        self.counts_s = if bounces { BOUNCES_S } else { (self.counts_s - dt_s).max(0.0) };
        self.force_n = match held {
            true => risen_n,
            false if self.counts_s > 0.0 => RELEASED * airframe.weight_n(),
            false => 0.0,
        };
    }

    /// Force that holds the vehicle up, N; zero while nothing does, and least between two bounces.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    fn risen_n(&self) -> f64 {
        let least = self.least_n.into_iter().flatten().fold(f64::INFINITY, f64::min);
        self.smooth_n.filter(|_| least.is_finite()).map_or(0.0, |s| s - least)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::ImuSample;
    use crate::types::ROTORS;
    use nalgebra::Vector3;

    const DT_S: f64 = 0.005;

    /// Ticks with specific force `f_z` at a throttle. Of four IMUs that sample in turns one says always zero.
    fn run(support: &mut Support, seconds: f64, f_z: f64, throttle: f64, flying: bool) {
        let airframe = Airframe::iris();
        for k in 0..(seconds / DT_S) as u64 {
            let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
            for (i, imu) in frame.imus.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
                *imu = Some(ImuSample {
                    time: FlightTime(k * 5000),
                    gyro_radps: Vector3::zeros(),
                    accel_mps2: Vector3::new(0.0, 0.0, if i == 1 { 0.0 * f_z } else { f_z }),
                    mag_ut: None,
                    temperature_c: 20.0,
                });
            }
            support.step(&airframe, &frame, &MotorCommand { throttle: [throttle; ROTORS] }, 1.0, flying, DT_S);
        }
    }

    #[test]
    fn a_support_is_felt_at_once_and_a_wrong_thrust_curve_is_none() {
        let mut support = Support::default();
        // Hovers at a throttle that should lift a little more or less: no support.
        for throttle in [0.4, 0.6] {
            run(&mut support, 1.0, 9.81, throttle, false);
            run(&mut support, 12.0, 9.81, throttle, true);
            assert_eq!(support.force_n(), 0.0);
        }
        // A string takes a fifth of the weight: the same force is felt at less thrust.
        run(&mut support, 0.2, 9.81 * 1.2, 0.6, true);
        let force_n = support.force_n();
        assert!((force_n / (0.2 * Airframe::iris().weight_n()) - 1.0).abs() < 0.05, "{force_n} N");
        // It counts a little while longer: strings are met again.
        run(&mut support, 0.2, 9.81, 0.6, true);
        let force_n = support.force_n() / Airframe::iris().weight_n();
        assert!(force_n > 0.0 && force_n < 0.05, "{force_n}");
        run(&mut support, 1.0, 9.81, 0.6, true);
        assert_eq!(support.force_n(), 0.0);
        // What lasts is taken for thrust.
        run(&mut support, 11.0, 9.81 * 1.2, 0.6, true);
        assert_eq!(support.force_n(), 0.0);
    }

    /// GIVEN a vehicle that hovers and is shaken by 2 m/s² WHEN nothing else holds it THEN no support is felt, and one of half the weight is.
    #[test]
    fn vibration_is_no_support() {
        let mut support = Support::default();
        let held = |support: &mut Support, seconds: f64, f_z: f64| {
            let ticks = (seconds / DT_S) as u64;
            let held = (0..ticks).filter(|k| {
                let shaken = 2.0 * std::f64::consts::SQRT_2 * (*k as f64 * *k as f64 * 0.377).sin();
                run(support, DT_S, f_z + shaken, 0.6, true);
                support.force_n() > 0.0
            });
            held.count() as f64 / ticks as f64
        };
        run(&mut support, 1.0, 9.81, 0.6, false);
        held(&mut support, 5.0, 9.81);
        let free = held(&mut support, 30.0, 9.81);
        assert!(free < 0.01, "{free}");
        let on_a_string = held(&mut support, 1.0, 9.81 * 1.5);
        assert!(on_a_string > 0.8, "{on_a_string}");
    }

    #[test]
    fn nothing_is_known_of_a_vehicle_that_does_not_fly_or_senses_nothing() {
        let mut support = Support::default();
        run(&mut support, 1.0, 9.81, 0.0, false);
        run(&mut support, 1.0, f64::NAN, 0.6, true);
        assert_eq!(support.force_n(), 0.0);
        run(&mut support, 1.0, 9.81, f64::NAN, true);
        run(&mut support, 1.0, 9.81, 0.6, true);
        assert!(support.force_n().is_finite());
    }
}

//! Failsafes: what the agent does by itself, whatever a browser or the ground says.
//!
//! | event | action |
//! |---|---|
//! | no authenticated heartbeat for 0.5 s | freeze the setpoint, abort attacks |
//! | for 2 s | descend at 0.3 m/s, then disarm |
//! | no sign of the operator, once given, for 3 s | freeze the setpoint, abort attacks |
//! | for 10 s | descend, then disarm |
//! | tilt > 60° for 0.3 s, or rate > 1000 °/s | cut, latched |
//! | outside the box | hold at the edge, then descend |
//! | estimator degraded for longer than `degraded_ticks` | descend on attitude alone (the watchdog's) |
//! | K deadlines missed within a second | warn, then descend |
//!
//! Time-outs of take-off and landing, and the operator's cut, are in `flight.rs`. Tilt, rate and raw
//! height come from the [`Watchdog`], which sees the samples from before any attack and none of the
//! estimators.

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use crate::control::setpoint::Limits;
use crate::estimate::attitude::{AttitudeFilter, AttitudeOptions};
use crate::estimate::median;
use crate::event::{Text, text};
use crate::frames::tilt_rad;
use crate::model::GRAVITY_MPS2;
use crate::vehicle::{MAX_HEIGHTS, MAX_IMUS, SensorFrame};

pub use plumbline_proto::v1::Failsafe;

/// Thresholds; the defaults are DESIGN's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Without a heartbeat for this long the setpoint freezes, s.
    pub link_freeze_s: f64,
    /// For this long: descend, s.
    pub link_descend_s: f64,
    /// Without a sign of the operator, once given, for this long the setpoint freezes, s: longer than a reload.
    pub operator_freeze_s: f64,
    /// For this long: descend, s.
    pub operator_descend_s: f64,
    /// Tilt that cuts the motors, rad.
    pub tilt_cut_rad: f64,
    /// After this long, s.
    pub tilt_cut_s: f64,
    /// Rate that cuts the motors, rad/s.
    pub rate_cut_radps: f64,
    /// How far outside the limits the box ends, m.
    pub box_margin_m: f64,
    /// Time at the edge before descending, s.
    pub box_hold_s: f64,
    /// Ticks with a degraded estimator before descending on attitude alone; five times as many while
    /// the watchdog, which shares nothing with it, agrees on the attitude.
    pub degraded_ticks: u32,
    /// Deadline misses within a second that warn.
    pub deadline_warn: usize,
    /// Deadline misses within a second that descend; at most [`MAX_MISSES`].
    pub deadline_descend: usize,
    /// Armed without take-off, s: disarm.
    pub takeoff_timeout_s: f64,
    /// Landed, s: disarm.
    pub landed_s: f64,
    /// Descent of a failsafe, m/s.
    pub descend_mps: f64,
    /// A descent on attitude alone ends with the motors off after this long, s.
    pub blind_descend_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            link_freeze_s: 0.5,
            link_descend_s: 2.0,
            operator_freeze_s: 3.0,
            operator_descend_s: 10.0,
            tilt_cut_rad: 60.0_f64.to_radians(),
            tilt_cut_s: 0.3,
            rate_cut_radps: 1000.0_f64.to_radians(),
            box_margin_m: 0.3,
            box_hold_s: 2.0,
            degraded_ticks: 40,
            deadline_warn: 5,
            deadline_descend: 20,
            takeoff_timeout_s: 10.0,
            landed_s: 2.0,
            descend_mps: 0.3,
            blind_descend_s: 8.0,
        }
    }
}

/// How many times longer a degraded estimator flies on while the watchdog agrees with it.
const CORROBORATED_PATIENCE: u32 = 5;
/// Most deadline misses remembered.
pub const MAX_MISSES: usize = 64;

/// Tilt, rate and height straight from the sensors: the median over instances, an attitude filter of its own
/// (`estimate/attitude.rs`, without magnetometer), no estimator.
///
/// It shares no sample under attack: it sees the frames from before the injector, where every attack of this project
/// happens. Of an IMU that really lies the median of the others is what counts.
#[derive(Debug, Clone)]
pub struct Watchdog {
    filter: AttitudeFilter,
    rates_radps: Vector3<f64>,
    since_imu_s: f64,
    imu_time: Option<FlightTime>,
    heights: [Option<(FlightTime, f64)>; MAX_HEIGHTS],
}

/// Heights older than this are forgotten, s.
const HEIGHT_MAX_AGE_S: f64 = 0.5;

/// Specific forces further from 1 g than this fraction say nothing of the vertical.
const ACCEL_TRUST: f64 = 0.2;

impl Default for Watchdog {
    fn default() -> Self {
        Self {
            filter: AttitudeFilter::new(AttitudeOptions { use_mag: false, ..AttitudeOptions::default() }),
            rates_radps: Vector3::zeros(),
            since_imu_s: 0.0,
            imu_time: None,
            heights: [None; MAX_HEIGHTS],
        }
    }
}

impl Watchdog {
    /// Takes the frame from before any attack.
    pub fn step(&mut self, sensed: &SensorFrame, dt_s: f64) {
        let mut gyro: [ArrayVec<f64, MAX_IMUS>; 3] = Default::default();
        let mut accel: [ArrayVec<f64, MAX_IMUS>; 3] = Default::default();
        for imu in sensed.imus.iter().flatten() {
            for axis in 0..3 {
                gyro[axis].push(imu.gyro_radps[axis]);
                accel[axis].push(imu.accel_mps2[axis]);
            }
        }
        let vector = |parts: [ArrayVec<f64, MAX_IMUS>; 3]| {
            let [x, y, z] = parts.map(|p| median_of_finite(&p));
            Some(Vector3::new(x?, y?, z?))
        };
        self.since_imu_s += dt_s;
        if let (Some(gyro), Some(accel)) = (vector(gyro), vector(accel)) {
            let since_s = if self.imu_time.is_some() { self.since_imu_s } else { 0.0 };
            // In a flip the thrust is along body z and far from 1 g: the gyroscope alone is right then.
            let near_1_g = (accel.norm() / GRAVITY_MPS2 - 1.0).abs() < ACCEL_TRUST;
            let force = if near_1_g { accel } else { Vector3::zeros() };
            self.filter.push(since_s, &gyro, &force, None);
            (self.rates_radps, self.imu_time, self.since_imu_s) = (gyro, Some(sensed.time), 0.0);
        }
        for (kept, new) in self.heights.iter_mut().zip(&sensed.heights) {
            if let Some(new) = new.filter(|h| h.height_m.is_finite()) {
                *kept = Some((sensed.time, new.height_m));
            }
            if kept.is_some_and(|(time, _)| sensed.time.seconds_since(time) > HEIGHT_MAX_AGE_S) {
                *kept = None;
            }
        }
    }

    /// Angle between body z and the vertical, rad; zero before the first sample.
    pub fn tilt_rad(&self) -> f64 {
        tilt_rad(&self.filter.world_from_body())
    }

    /// Angle between its vertical and that of `attitude`, rad; zero before the first sample.
    pub fn disagreement_rad(&self, attitude: &UnitQuaternion<f64>) -> f64 {
        if self.imu_time.is_none() {
            return 0.0;
        }
        self.up_flu().angle(&(attitude.inverse() * Vector3::z()))
    }

    /// World z seen from the body.
    fn up_flu(&self) -> Vector3<f64> {
        self.filter.world_from_body().inverse() * Vector3::z()
    }

    /// Body rates, median over the IMUs, rad/s.
    pub fn rates_radps(&self) -> Vector3<f64> {
        self.rates_radps
    }

    /// Attitude with yaw zero, for a descent without estimator.
    pub fn attitude(&self) -> UnitQuaternion<f64> {
        let up = self.up_flu();
        UnitQuaternion::from_euler_angles(up.y.atan2(up.z), (-up.x).clamp(-1.0, 1.0).asin(), 0.0)
    }

    /// Median of the heights of the last half second, m.
    pub fn height_m(&self) -> Option<f64> {
        let heights: ArrayVec<f64, MAX_HEIGHTS> = self.heights.iter().flatten().map(|h| h.1).collect();
        median_of_finite(&heights)
    }

    /// When an IMU sample last arrived.
    pub fn imu_time(&self) -> Option<FlightTime> {
        self.imu_time
    }

    /// How many laser heights arrived within the last half second.
    pub fn heights_fresh(&self) -> usize {
        self.heights.iter().flatten().count()
    }
}

/// Median of the finite values, if there is one.
fn median_of_finite(values: &[f64]) -> Option<f64> {
    Some(median(values.iter().copied().filter(|v| v.is_finite()))).filter(|m| m.is_finite())
}

/// What the monitor looks at in one tick.
#[derive(Debug, Clone, Copy)]
pub struct Inputs {
    /// Time of the tick.
    pub now: FlightTime,
    /// Is the vehicle off its idle, under control?
    pub flying: bool,
    /// Tilt by the watchdog, rad.
    pub tilt_rad: f64,
    /// Largest body rate by the watchdog, rad/s.
    pub rate_radps: f64,
    /// Median raw height, m.
    pub raw_height_m: Option<f64>,
    /// Altitude by the estimator in the loop, m.
    pub altitude_m: f64,
    /// Largest of |x|, |y|, m, where known.
    pub lateral_m: Option<f64>,
    /// Is the estimator in the loop degraded?
    pub degraded: bool,
    /// Do estimator and watchdog agree on where up is?
    pub corroborated: bool,
    /// Time since the last heartbeat, s; infinite before the first.
    pub link_age_s: f64,
    /// Time since the last sign of the operator, s; zero where none was ever given.
    pub operator_age_s: f64,
    /// Highest altitude allowed, m.
    pub altitude_max_m: f64,
    /// Largest lateral distance allowed, m.
    pub lateral_max_m: f64,
}

/// Watches and judges; acts on nothing itself.
#[derive(Debug, Clone)]
pub struct Monitor {
    settings: Settings,
    tilted_since: Option<FlightTime>,
    outside_since: Option<FlightTime>,
    degraded_ticks: u32,
    misses: ArrayVec<FlightTime, MAX_MISSES>,
}

impl Monitor {
    /// With these thresholds.
    pub fn new(settings: Settings) -> Self {
        Self { settings, tilted_since: None, outside_since: None, degraded_ticks: 0, misses: ArrayVec::new() }
    }

    /// Forgets what led to the last verdict (disarmed).
    pub fn reset(&mut self) {
        (self.tilted_since, self.outside_since, self.degraded_ticks) = (None, None, 0);
        self.misses.clear();
    }

    /// A control tick missed its deadline. Only the last second counts; the oldest is forgotten when full.
    pub fn deadline_missed(&mut self, now: FlightTime) {
        self.misses.retain(|t| now.seconds_since(*t) < 1.0);
        if self.misses.is_full() {
            self.misses.remove(0);
        }
        self.misses.push(now);
    }

    /// The most severe failsafe that applies to an armed vehicle now.
    pub fn judge(&mut self, i: &Inputs) -> Failsafe {
        let s = self.settings;
        if i.rate_radps > s.rate_cut_radps {
            return Failsafe::RateCut;
        }
        if over_for(&mut self.tilted_since, i.tilt_rad > s.tilt_cut_rad, i.now) > s.tilt_cut_s {
            return Failsafe::TiltCut;
        }
        self.degraded_ticks = if i.degraded { self.degraded_ticks.saturating_add(1) } else { 0 };
        let patience = if i.corroborated { CORROBORATED_PATIENCE } else { 1 };
        if i.flying && self.degraded_ticks > s.degraded_ticks.saturating_mul(patience) {
            return Failsafe::EstimatorDescend;
        }
        self.misses.retain(|t| i.now.seconds_since(*t) < 1.0);
        if self.misses.len() >= s.deadline_descend.min(MAX_MISSES) {
            return Failsafe::DeadlineDescend;
        }
        if i.link_age_s > s.link_descend_s {
            return Failsafe::LinkDescend;
        }
        if i.operator_age_s > s.operator_descend_s {
            return Failsafe::OperatorDescend;
        }
        // The raw heights have a veto beside the estimate.
        let altitude = i.raw_height_m.map_or(i.altitude_m, |raw| raw.max(i.altitude_m));
        let outside = i.flying
            && (altitude > i.altitude_max_m + s.box_margin_m
                || i.lateral_m.is_some_and(|d| d > i.lateral_max_m + s.box_margin_m));
        let outside_for = over_for(&mut self.outside_since, outside, i.now);
        if outside_for > s.box_hold_s {
            return Failsafe::BoxDescend;
        }
        if i.link_age_s > s.link_freeze_s {
            return Failsafe::LinkFreeze;
        }
        if i.operator_age_s > s.operator_freeze_s {
            return Failsafe::OperatorFreeze;
        }
        if outside {
            return Failsafe::BoxHold;
        }
        if self.misses.len() >= s.deadline_warn {
            return Failsafe::DeadlineWarn;
        }
        Failsafe::None
    }

    /// Why `failsafe` applies, with the values.
    pub fn reason(&self, failsafe: Failsafe, i: &Inputs) -> Text {
        let s = &self.settings;
        match failsafe {
            Failsafe::None => Text::new(),
            Failsafe::LinkFreeze => text(format_args!(
                "no heartbeat for {:.2} s (limit {} s): setpoint frozen, attacks aborted",
                i.link_age_s, s.link_freeze_s
            )),
            Failsafe::LinkDescend => text(format_args!(
                "no heartbeat for {:.2} s (limit {} s): descending at {} m/s",
                i.link_age_s, s.link_descend_s, s.descend_mps
            )),
            Failsafe::OperatorFreeze => text(format_args!(
                "no sign of the operator's page for {:.1} s (limit {} s): setpoint frozen, attacks aborted",
                i.operator_age_s, s.operator_freeze_s
            )),
            Failsafe::OperatorDescend => text(format_args!(
                "no sign of the operator's page for {:.1} s (limit {} s): descending at {} m/s",
                i.operator_age_s, s.operator_descend_s, s.descend_mps
            )),
            Failsafe::TiltCut => text(format_args!(
                "tilt {:.0}° above {:.0}° for {} s: motors cut",
                i.tilt_rad.to_degrees(),
                s.tilt_cut_rad.to_degrees(),
                s.tilt_cut_s
            )),
            Failsafe::RateCut => text(format_args!(
                "rate {:.0} °/s above {:.0} °/s: motors cut",
                i.rate_radps.to_degrees(),
                s.rate_cut_radps.to_degrees()
            )),
            Failsafe::BoxHold | Failsafe::BoxDescend => text(format_args!(
                "outside the box: altitude {:.2} m (raw {:.2} m, limit {:.2} m), lateral {:.2} m (limit {:.2} m){}",
                i.altitude_m,
                i.raw_height_m.unwrap_or(f64::NAN),
                i.altitude_max_m,
                i.lateral_m.unwrap_or(f64::NAN),
                i.lateral_max_m,
                if failsafe == Failsafe::BoxHold { ": holding at the edge" } else { ": descending" }
            )),
            Failsafe::EstimatorDescend => text(format_args!(
                "estimator degraded for {} ticks (limit {}): descending on attitude alone",
                self.degraded_ticks, s.degraded_ticks
            )),
            Failsafe::DeadlineWarn => text(format_args!("{} deadlines missed within a second", self.misses.len())),
            Failsafe::DeadlineDescend => text(format_args!(
                "{} deadlines missed within a second (limit {}): descending",
                self.misses.len(),
                s.deadline_descend
            )),
            Failsafe::OperatorCut => text(format_args!("motors cut by the operator")),
            Failsafe::TakeoffTimeout => {
                text(format_args!("armed for {} s without take-off: disarmed", s.takeoff_timeout_s))
            }
        }
    }
}

/// How long `condition` has held, s.
fn over_for(since: &mut Option<FlightTime>, condition: bool, now: FlightTime) -> f64 {
    if condition {
        now.seconds_since(*since.get_or_insert(now))
    } else {
        *since = None;
        0.0
    }
}

/// How severe: a more severe failsafe replaces a less severe one, never the other way round.
pub fn severity(failsafe: Failsafe) -> u8 {
    match failsafe {
        Failsafe::None => 0,
        Failsafe::DeadlineWarn => 1,
        Failsafe::BoxHold => 2,
        Failsafe::LinkFreeze | Failsafe::OperatorFreeze => 3,
        Failsafe::BoxDescend | Failsafe::LinkDescend | Failsafe::OperatorDescend | Failsafe::DeadlineDescend => 4,
        Failsafe::EstimatorDescend => 5,
        Failsafe::TakeoffTimeout => 6,
        Failsafe::RateCut | Failsafe::TiltCut | Failsafe::OperatorCut => 7,
    }
}

/// Limits as they stand while a failsafe descends.
pub fn descent_limits(limits: &Limits, settings: &Settings) -> Limits {
    Limits { descent_max_mps: limits.descent_max_mps.min(settings.descend_mps), ..*limits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{HeightSample, ImuSample};

    fn fine(now_s: f64) -> Inputs {
        Inputs {
            now: FlightTime::from_seconds(now_s),
            flying: true,
            tilt_rad: 0.1,
            rate_radps: 1.0,
            raw_height_m: Some(1.0),
            altitude_m: 1.0,
            lateral_m: None,
            degraded: false,
            corroborated: false,
            link_age_s: 0.1,
            operator_age_s: 0.0,
            altitude_max_m: 2.0,
            lateral_max_m: 2.0,
        }
    }

    /// Runs `change` from 1 s on and returns when each verdict first appears.
    fn first_seen(change: impl Fn(f64, &mut Inputs)) -> Vec<(Failsafe, f64)> {
        let mut monitor = Monitor::new(Settings::default());
        let mut seen: Vec<(Failsafe, f64)> = Vec::new();
        for k in 0..1200 {
            let t = f64::from(k) * 0.005;
            let mut inputs = fine(t);
            if t >= 1.0 {
                change(t - 1.0, &mut inputs);
            }
            let verdict = monitor.judge(&inputs);
            if seen.last().is_none_or(|s| s.0 != verdict) {
                seen.push((verdict, t - 1.0));
            }
        }
        seen
    }

    fn expect(seen: &[(Failsafe, f64)], expected: &[(Failsafe, f64)]) {
        assert_eq!(seen.len(), expected.len() + 1, "{seen:?}");
        for (s, e) in seen.iter().skip(1).zip(expected) {
            assert!(s.0 == e.0 && (s.1 - e.1).abs() < 0.011, "{seen:?}, expected {expected:?}");
        }
    }

    #[test]
    fn every_row_of_the_table_comes_at_its_time() {
        expect(&first_seen(|t, i| i.link_age_s = t), &[(Failsafe::LinkFreeze, 0.5), (Failsafe::LinkDescend, 2.0)]);
        expect(
            &first_seen(|t, i| i.operator_age_s = 4.0 * t),
            &[(Failsafe::OperatorFreeze, 0.75), (Failsafe::OperatorDescend, 2.5)],
        );
        expect(&first_seen(|_, i| i.tilt_rad = 61.0_f64.to_radians()), &[(Failsafe::TiltCut, 0.3)]);
        expect(&first_seen(|_, i| i.tilt_rad = 59.0_f64.to_radians()), &[]);
        expect(&first_seen(|_, i| i.rate_radps = 1001.0_f64.to_radians()), &[(Failsafe::RateCut, 0.0)]);
        expect(&first_seen(|_, i| i.altitude_m = 2.4), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
        // The estimate lies, the raw heights do not.
        expect(
            &first_seen(|_, i| i.raw_height_m = Some(2.4)),
            &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)],
        );
        expect(&first_seen(|_, i| i.lateral_m = Some(2.4)), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
        expect(&first_seen(|_, i| i.degraded = true), &[(Failsafe::EstimatorDescend, 0.2)]);
        expect(&first_seen(|_, i| (i.degraded, i.corroborated) = (true, true)), &[(Failsafe::EstimatorDescend, 1.0)]);
        // A short tilt is forgiven.
        expect(&first_seen(|t, i| i.tilt_rad = if t < 0.28 { 1.2 } else { 0.0 }), &[]);
    }

    #[test]
    fn deadline_misses_warn_then_descend_and_are_forgotten_after_a_second() {
        let mut monitor = Monitor::new(Settings::default());
        for k in 0..4 {
            monitor.deadline_missed(FlightTime(k * 5000));
        }
        assert_eq!(monitor.judge(&fine(0.02)), Failsafe::None);
        monitor.deadline_missed(FlightTime(25_000));
        assert_eq!(monitor.judge(&fine(0.03)), Failsafe::DeadlineWarn);
        (0..20).for_each(|k| monitor.deadline_missed(FlightTime(30_000 + k)));
        assert_eq!(monitor.judge(&fine(0.04)), Failsafe::DeadlineDescend);
        assert_eq!(monitor.judge(&fine(1.2)), Failsafe::None);
        // Far more than are remembered.
        (0..1000).for_each(|k| monitor.deadline_missed(FlightTime(2_000_000 + k)));
        assert_eq!(monitor.judge(&fine(2.1)), Failsafe::DeadlineDescend);
    }

    #[test]
    fn the_watchdog_follows_a_roll_and_outvotes_one_bad_imu() {
        let mut watchdog = Watchdog::default();
        let (dt, rate) = (0.005, 1.0);
        let mut tilt = 0.0;
        for k in 0..200_u64 {
            let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
            for (n, imu) in frame.imus.iter_mut().enumerate() {
                let lie = if n == 2 { 50.0 } else { 0.0 };
                *imu = Some(ImuSample {
                    time: frame.time,
                    gyro_radps: Vector3::new(rate + lie, 0.0, lie),
                    // In flight only the thrust is felt: along body z, whatever the tilt.
                    accel_mps2: Vector3::new(lie, 0.0, 14.0),
                    mag_ut: None,
                    temperature_c: 20.0,
                });
            }
            frame.heights[0] = Some(HeightSample { time: frame.time, height_m: 1.0 });
            frame.heights[1] = Some(HeightSample { time: frame.time, height_m: 9.0 });
            frame.heights[2] = Some(HeightSample { time: frame.time, height_m: 1.1 });
            watchdog.step(&frame, dt);
            tilt += rate * dt;
        }
        assert!((watchdog.tilt_rad() - tilt).abs() < 0.02, "{} after {tilt}", watchdog.tilt_rad());
        let (roll, pitch, _) = watchdog.attitude().euler_angles();
        assert!((roll - tilt).abs() < 0.02 && pitch.abs() < 1e-6);
        assert_eq!(watchdog.height_m(), Some(1.1));
        watchdog.step(&SensorFrame { time: FlightTime(3_000_000), ..SensorFrame::default() }, dt);
        assert_eq!((watchdog.height_m(), watchdog.heights_fresh()), (None, 0));
    }
}

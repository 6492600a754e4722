//! Which row of the failsafe table applies now.

use std::fmt;

use plumbline_proto::time::FlightTime;

use super::{Failsafe, Settings};
use crate::event::{Text, text};

/// How many times longer a degraded estimator flies on while the watchdog agrees with it.
const CORROBORATED_PATIENCE: u32 = 5;
/// What a climb is stopped with once altitude control has it, m/s²; a vehicle at idle falls with more.
const BRAKE_UP_MPS2: f64 = 6.0;
/// What stops a sideways motion, m/s²: 0.6 of the default tilt limit.
const BRAKE_SIDE_MPS2: f64 = 2.0;
/// Control and motors answer after this long, s.
const BRAKE_DELAY_S: f64 = 0.12;
/// The same without an estimator: a descent on attitude alone brakes less, and raw heights come late.
const BLIND_BRAKE_MPS2: f64 = 3.0;
const BLIND_DELAY_S: f64 = 0.3;
/// An estimator that takes it to be so much lower than the raw heights do, m, is in doubt as soon as the watchdog disagrees.
const FOOLED_M: f64 = 0.1;
/// Lost ticks are counted in parts of a second …
const BIN_S: f64 = 0.1;
/// … as many as make one.
const BINS: usize = 10;

/// What the monitor looks at in one tick. Flat: a fact for each row of the failsafe table, and nothing that belongs together
/// beyond that.
#[derive(Debug, Clone, Copy)]
pub struct Inputs {
    /// Time of the tick.
    pub now: FlightTime,
    /// Is the vehicle off its idle, under control?
    pub flying: bool,
    /// Time since a fresh IMU sample, s.
    pub imu_age_s: f64,
    /// Tilt by the watchdog, rad.
    pub tilt_rad: f64,
    /// The smaller of that and the tilt by the estimator in the loop, rad: an attacked gyroscope leads only one of them astray.
    pub tilt_agreed_rad: f64,
    /// Largest tilt that may be asked for, rad.
    pub tilt_max_rad: f64,
    /// Largest body rate by the watchdog, rad/s.
    pub rate_radps: f64,
    /// Median raw height, m.
    pub raw_height_m: Option<f64>,
    /// Altitude by the estimator in the loop, m, where known.
    pub altitude_m: Option<f64>,
    /// The larger of its climb rate and that of the raw heights, m/s.
    pub climb_mps: f64,
    /// Acceleration upwards that the present thrust gives, m/s².
    pub lift_mps2: f64,
    /// Does the mode close a loop on the altitude?
    pub altitude_needed: bool,
    /// Along that of x and y on which the vehicle would come to rest farther out, where known.
    pub lateral: Option<Outward>,
    /// Was the mode left because the horizontal position was lost, and is it still?
    pub position_lost: bool,
    /// Is the estimator in the loop degraded, or the controller's output no number?
    pub degraded: bool,
    /// Do estimator and watchdog, both with fresh samples, agree on where up is, and how fast it climbs?
    pub corroborated: bool,
    /// More thrust is commanded than hovers, and the vehicle does not follow.
    pub not_moving: bool,
    /// Charge left, 0..1, where measured.
    pub charge: Option<f64>,
    /// Time since the last heartbeat, s; infinite before the first.
    pub link_age_s: f64,
    /// Time since the last sign of the operator, s; zero where none was ever given.
    pub operator_age_s: f64,
    /// Highest altitude allowed, m.
    pub altitude_max_m: f64,
    /// Largest lateral distance allowed, m.
    pub lateral_max_m: f64,
}

/// Motion away from the middle of the box along one horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outward {
    /// |x| or |y|, m.
    pub distance_m: f64,
    /// Of its change, m/s.
    pub speed_mps: f64,
    /// Acceleration that the present tilt gives, m/s²: it lasts until the tilt is turned round.
    pub pull_mps2: f64,
}

impl Outward {
    /// Distance at which it can be brought to rest, m, beside a climb of `climb_mps`: while that is braked there is hardly
    /// a thrust to lean on.
    pub fn stops_m(&self, climb_mps: f64) -> f64 {
        let wait_s = climb_mps.max(0.0) / BRAKE_UP_MPS2;
        self.distance_m + stopping_m(self.speed_mps, self.pull_mps2, BRAKE_SIDE_MPS2, (BRAKE_DELAY_S, wait_s))
    }
}

/// Times since when conditions hold.
#[derive(Debug, Clone, Copy, Default)]
struct Since {
    tilted: Option<FlightTime>,
    beyond: Option<FlightTime>,
    outside: Option<FlightTime>,
    position_lost: Option<FlightTime>,
    not_moving: Option<FlightTime>,
    battery_warn: Option<FlightTime>,
    battery_land: Option<FlightTime>,
}

/// Watches and judges; acts on nothing itself.
#[derive(Debug, Clone)]
pub struct Monitor {
    settings: Settings,
    since: Since,
    degraded_ticks: u32,
    /// Control was taken over at the edge of the box, and the operator has not acted since.
    taken_over: bool,
    /// In the last tick the vehicle was outside its box, or about to leave it.
    leaving: bool,
    /// The verdict of the last tick.
    verdict: Failsafe,
    /// Lost ticks of the last second: when a part began, and how many.
    lost: [(FlightTime, u32); BINS],
}

impl Monitor {
    /// With these thresholds.
    pub fn new(settings: Settings) -> Self {
        let lost = [(FlightTime(0), 0); BINS];
        Self {
            settings,
            since: Since::default(),
            degraded_ticks: 0,
            taken_over: false,
            leaving: false,
            verdict: Failsafe::None,
            lost,
        }
    }

    /// Forgets what led to the last verdict (disarmed).
    pub fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// Control was taken over at the edge of the box: it is held, then left downwards, until the operator acts.
    pub fn took_over(&mut self) {
        self.taken_over = true;
    }

    /// Is the vehicle outside its box, or about to leave it?
    pub fn leaving(&self) -> bool {
        self.leaving
    }

    /// Does the cause of a descent on attitude alone last?
    pub fn blinded(&self) -> bool {
        matches!(self.verdict, Failsafe::EstimatorDescend | Failsafe::AltitudeDescend)
    }

    /// The operator chose a mode or a setpoint.
    pub fn operator_acted(&mut self) {
        self.taken_over = false;
    }

    /// `count` control ticks were lost: not begun in time, or not at all.
    pub fn ticks_lost(&mut self, now: FlightTime, count: u32) {
        let bin = ((now.as_seconds() / BIN_S) as usize) % BINS;
        if let Some((begun, lost)) = self.lost.get_mut(bin) {
            if now.seconds_since(*begun) >= BIN_S {
                (*begun, *lost) = (now, 0);
            }
            *lost = lost.saturating_add(count);
        }
    }

    fn lost_within_a_second(&self, now: FlightTime) -> u32 {
        let recent = self.lost.iter().filter(|(begun, _)| now.seconds_since(*begun) < 1.0);
        recent.fold(0, |sum: u32, (_, lost)| sum.saturating_add(*lost))
    }

    /// The most severe failsafe that applies to an armed vehicle now.
    pub fn judge(&mut self, i: &Inputs) -> Failsafe {
        let s = self.settings;
        let tilted_s = over_for(&mut self.since.tilted, i.tilt_rad > s.tilt_cut_rad, i.now);
        let beyond = i.flying && i.tilt_agreed_rad > i.tilt_max_rad + s.tilt_beyond_rad;
        let beyond_s = over_for(&mut self.since.beyond, beyond, i.now);
        let (above, aside) = self.leaves_box(i);
        self.leaving = above || aside;
        let outside_s = over_for(&mut self.since.outside, self.taken_over || self.leaving, i.now);
        let lost_s = over_for(&mut self.since.position_lost, i.position_lost, i.now);
        let not_moving_s = over_for(&mut self.since.not_moving, i.flying && i.not_moving, i.now);
        let below = |level: f64| i.charge.is_some_and(|charge| charge < level);
        let low_s = over_for(&mut self.since.battery_warn, below(s.battery_warn), i.now);
        let empty_s = over_for(&mut self.since.battery_land, below(s.battery_land), i.now);
        self.degraded_ticks = if i.degraded { self.degraded_ticks.saturating_add(1) } else { 0 };
        let patience = if i.corroborated { CORROBORATED_PATIENCE } else { 1 };
        // What is about to leave its box upwards is not held there by an estimator in doubt that takes it to be lower.
        let lower_m = i.raw_height_m.zip(i.altitude_m).map_or(0.0, |(raw_m, altitude_m)| raw_m - altitude_m);
        let in_doubt = i.degraded && lower_m > 0.0 || !i.corroborated && lower_m > FOOLED_M;
        let fooled = above && in_doubt;
        let degraded = self.degraded_ticks > s.degraded_ticks.saturating_mul(patience) || fooled;
        let lost = self.lost_within_a_second(i.now);
        // Within one severity the first row counts.
        let rows = [
            (Failsafe::ImuCut, i.flying && i.imu_age_s > s.imu_silent_s),
            (Failsafe::RateCut, i.rate_radps > s.rate_cut_radps),
            (Failsafe::TiltCut, tilted_s > self.tilt_patience_s(i) || beyond_s > s.tilt_beyond_s),
            (Failsafe::AltitudeDescend, i.flying && i.altitude_needed && i.altitude_m.is_none()),
            (Failsafe::EstimatorDescend, i.flying && degraded),
            (Failsafe::DeadlineDescend, lost >= s.deadline_descend),
            (Failsafe::ThrustDescend, not_moving_s > s.thrust_deficit_s),
            (Failsafe::BatteryDescend, empty_s > s.battery_s),
            (Failsafe::LinkDescend, i.link_age_s > s.link_descend_s),
            (Failsafe::OperatorDescend, i.operator_age_s > s.operator_descend_s),
            (Failsafe::BoxDescend, outside_s > s.box_hold_s),
            (Failsafe::PositionDescend, lost_s > s.position_lost_s),
            (Failsafe::LinkFreeze, i.link_age_s > s.link_freeze_s),
            (Failsafe::OperatorFreeze, i.operator_age_s > s.operator_freeze_s),
            (Failsafe::BoxHold, self.since.outside.is_some()),
            (Failsafe::PositionHold, i.position_lost),
            (Failsafe::BatteryLow, low_s > s.battery_s),
            (Failsafe::DeadlineWarn, lost >= s.deadline_warn),
        ];
        let applying = rows.into_iter().filter(|(_, applies)| *applies).map(|(failsafe, _)| failsafe);
        self.verdict = applying.fold(Failsafe::None, |worst, f| if severity(f) > severity(worst) { f } else { worst });
        self.verdict
    }

    /// Outside (above, aside), or so fast towards the edge that it cannot stop in time. The raw heights have a veto beside
    /// the estimate.
    fn leaves_box(&self, i: &Inputs) -> (bool, bool) {
        let margin_m = self.settings.box_margin_m;
        let altitude = [i.raw_height_m, i.altitude_m].into_iter().flatten().reduce(f64::max);
        // Without a height measured it is the descent on attitude alone that will have to stop it.
        let stops_m = if i.degraded || i.raw_height_m.is_none() {
            stopping_m(i.climb_mps, i.lift_mps2, BLIND_BRAKE_MPS2, (BLIND_DELAY_S, 0.0))
        } else {
            climb_stops_m(i.climb_mps, i.lift_mps2)
        };
        let above = altitude.is_some_and(|z| z + stops_m > i.altitude_max_m + margin_m);
        let aside = i.lateral.is_some_and(|outward| outward.stops_m(i.climb_mps) > i.lateral_max_m + margin_m);
        (i.flying && above, i.flying && aside)
    }

    /// How long a tilt may last, s. Near the floor a vehicle on its side drives along it, and has no room to recover.
    fn tilt_patience_s(&self, i: &Inputs) -> f64 {
        let low = i.raw_height_m.is_some_and(|height_m| height_m < self.settings.tilt_low_m);
        if low { self.settings.tilt_low_s } else { self.settings.tilt_cut_s }
    }

    /// Why `failsafe` applies, with the values.
    pub fn reason(&self, failsafe: Failsafe, i: &Inputs) -> Text {
        let s = &self.settings;
        match failsafe {
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
            Failsafe::ImuCut => text(format_args!(
                "no fresh IMU sample for {:.0} ms (limit {:.0} ms): motors cut",
                1e3 * i.imu_age_s,
                1e3 * s.imu_silent_s
            )),
            Failsafe::TiltCut if i.tilt_rad <= s.tilt_cut_rad => text(format_args!(
                "tilt {:.0}° for {} s, where {:.0}° may be asked for: motors cut",
                i.tilt_agreed_rad.to_degrees(),
                s.tilt_beyond_s,
                i.tilt_max_rad.to_degrees()
            )),
            Failsafe::TiltCut => text(format_args!(
                "tilt {:.0}° above {:.0}° for {} s: motors cut",
                i.tilt_rad.to_degrees(),
                s.tilt_cut_rad.to_degrees(),
                self.tilt_patience_s(i)
            )),
            Failsafe::RateCut => text(format_args!(
                "rate {:.0} °/s above {:.0} °/s: motors cut",
                i.rate_radps.to_degrees(),
                s.rate_cut_radps.to_degrees()
            )),
            Failsafe::BoxHold | Failsafe::BoxDescend => box_reason(failsafe, i),
            Failsafe::AltitudeDescend => {
                text(format_args!("no height any more, which this mode needs: descending on attitude alone"))
            }
            Failsafe::PositionHold => text(format_args!("horizontal position lost: altitude hold")),
            Failsafe::PositionDescend => text(format_args!(
                "horizontal position lost for {} s: descending at {} m/s",
                s.position_lost_s, s.descend_mps
            )),
            Failsafe::EstimatorDescend => text(format_args!(
                "estimator degraded for {} ticks (limit {}): descending on attitude alone",
                self.degraded_ticks, s.degraded_ticks
            )),
            Failsafe::ThrustDescend => text(format_args!(
                "more thrust than hovers commanded for {} s, and the vehicle does not follow: descending",
                s.thrust_deficit_s
            )),
            Failsafe::BatteryLow | Failsafe::BatteryDescend => {
                let charge = 100.0 * i.charge.unwrap_or(f64::NAN);
                let (limit, act) = if failsafe == Failsafe::BatteryLow {
                    (s.battery_warn, "land soon")
                } else {
                    (s.battery_land, "descending")
                };
                text(format_args!("battery at {charge:.0} % (limit {:.0} %): {act}", 100.0 * limit))
            }
            Failsafe::DeadlineWarn => {
                text(format_args!("{} control ticks lost within a second", self.lost_within_a_second(i.now)))
            }
            Failsafe::DeadlineDescend => text(format_args!(
                "{} control ticks lost within a second (limit {}): descending",
                self.lost_within_a_second(i.now),
                s.deadline_descend
            )),
            // Nothing that is seen here leads to them: their reasons come with them.
            Failsafe::None
            | Failsafe::StallCut
            | Failsafe::ShutdownDescend
            | Failsafe::ShutdownCut
            | Failsafe::RotorDescend
            | Failsafe::RotorCut
            | Failsafe::OperatorCut
            | Failsafe::TakeoffTimeout => Text::new(),
        }
    }
}

fn box_reason(failsafe: Failsafe, i: &Inputs) -> Text {
    let aside = i.lateral.map(|outward| (outward.distance_m, outward.speed_mps));
    text(format_args!(
        "edge of the box: altitude {} (raw {}, limit {:.2} m) at {:.1} m/s, lateral {}: {}",
        Metres(i.altitude_m),
        Metres(i.raw_height_m),
        i.altitude_max_m,
        i.climb_mps,
        Lateral(aside, i.lateral_max_m),
        if failsafe == Failsafe::BoxHold { "holding at the edge" } else { "descending" }
    ))
}

/// A distance, m, where one is measured.
struct Metres(Option<f64>);

impl fmt::Display for Metres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(metres) => write!(f, "{metres:.2} m"),
            None => f.write_str("not measured"),
        }
    }
}

/// Distance, m, and speed, m/s, aside where they are measured; and the limit, m.
struct Lateral(Option<(f64, f64)>, f64);

impl fmt::Display for Lateral {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(aside, limit_m) = self;
        match aside {
            Some((m, mps)) => write!(f, "{m:.2} m (limit {limit_m:.2} m) at {mps:.1} m/s"),
            None => f.write_str("not measured"),
        }
    }
}

/// Distance on which a motion of `speed_mps` can be stopped, m; zero for one that goes back. Control answers after the
/// first of `delays_s`, and until then the motion is accelerated by `pull_mps2`; it brakes after the second.
fn stopping_m(speed_mps: f64, pull_mps2: f64, brake_mps2: f64, delays_s: (f64, f64)) -> f64 {
    let (answers_s, pull) = (delays_s.0, pull_mps2.max(0.0));
    let turned = speed_mps + pull * answers_s;
    if turned <= 0.0 {
        return 0.0;
    }
    let answered_m = (speed_mps * answers_s + 0.5 * pull * answers_s * answers_s).max(0.0);
    answered_m + turned * delays_s.1 + turned * turned / (2.0 * brake_mps2)
}

/// Where a climb of `speed_mps`, accelerated by `lift_mps2`, comes to rest once altitude control has it, m above the
/// present place.
pub fn climb_stops_m(speed_mps: f64, lift_mps2: f64) -> f64 {
    stopping_m(speed_mps, lift_mps2, BRAKE_UP_MPS2, (BRAKE_DELAY_S, 0.0))
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
        Failsafe::DeadlineWarn | Failsafe::BatteryLow => 1,
        Failsafe::PositionHold => 2,
        Failsafe::LinkFreeze | Failsafe::OperatorFreeze => 3,
        // A frozen setpoint may lead out of the box: its edge comes first.
        Failsafe::BoxHold => 4,
        Failsafe::BoxDescend
        | Failsafe::LinkDescend
        | Failsafe::OperatorDescend
        | Failsafe::DeadlineDescend
        | Failsafe::PositionDescend
        | Failsafe::BatteryDescend
        | Failsafe::ThrustDescend
        | Failsafe::RotorDescend
        | Failsafe::ShutdownDescend => DESCENDS,
        Failsafe::EstimatorDescend | Failsafe::AltitudeDescend => 6,
        Failsafe::TakeoffTimeout => 7,
        Failsafe::RateCut
        | Failsafe::TiltCut
        | Failsafe::ImuCut
        | Failsafe::StallCut
        | Failsafe::ShutdownCut
        | Failsafe::RotorCut
        | Failsafe::OperatorCut => 8,
    }
}

/// Severity from which on the vehicle goes down.
pub const DESCENDS: u8 = 5;

#[cfg(test)]
mod tests;

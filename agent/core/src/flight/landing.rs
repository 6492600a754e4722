//! Take-off, landing and their time-outs; the thrust of a descent on attitude alone.

use plumbline_proto::time::FlightTime;

use super::{Failsafe, Flight, Phase};
use crate::estimate::Health;
use crate::event::{EventKind, Severity, text};
use crate::mix::Mixed;
use crate::types::{GRAVITY_MPS2, Mode, Setpoint};

/// A target this far above the vehicle is a take-off, m.
const TAKEOFF_STEP_M: f64 = 0.05;
/// Throttle that puts the loops to work in stabilise mode.
const THROTTLE_ACTIVE: f64 = 0.1;
/// Less thrust than this fraction of the weight, without moving, is standing (or hanging).
const STANDING_THRUST: f64 = 0.6;
/// Slower than this is not moving, m/s.
pub(super) const STANDING_SPEED_MPS: f64 = 0.15;
/// Standing for this long is landed, s.
const STANDING_S: f64 = 0.5;
/// Raw heights within this of where it took off, or lower, m …
const TOUCHING_M: f64 = 0.05;
/// … turning slower than this, rad/s …
pub(super) const TOUCHING_RADPS: f64 = 0.2;
/// … for this long, s, and neither rising nor sinking, is landed too, whatever estimator and thrust say.
const TOUCHING_S: f64 = 1.0;
/// Thrust of a descent on attitude alone, of the hover thrust, where no height is heard, …
const BLIND_THRUST: f64 = 0.96;
/// … less so much for each m/s that it climbs by its accelerometers: 2 m/s are gone within half a metre, …
const BLIND_BRAKE_SPM: f64 = 0.5;
/// … and else so much less or more for each m/s that it sinks too slowly or too fast, …
const BLIND_GAIN_SPM: f64 = 0.2;
/// … within these: heights may be attacked, and must not make it fall or climb away.
const BLIND_RANGE: (f64, f64) = (0.5, 1.05);
/// From here on in such a descent, s, it sinks faster by so much each second, m/s²: over the floor its own wash carries it.
const SETTLING: (f64, f64) = (5.0, 0.2);
/// Such a descent ends after so many times its shortest time, whatever seems to sink: heights may be attacked.
const BLIND_MOST: f64 = 4.0;
/// The hover thrust is learned with this time constant, s …
const HOVER_TIME_CONSTANT_S: f64 = 1.0;
/// … from an altitude measured within this time, s: what coasts looks steady, whatever the thrust …
const HOVER_MAX_AGE_S: f64 = 0.25;
/// … and in a descent on attitude alone from forces above this part of the hovering ones.
const HOVER_LEAST: f64 = 0.3;
/// An estimate that moves faster than this on the ground is none to take off on, m/s.
const ASTRAY_MPS: f64 = 0.5;

impl Flight {
    /// Take-off, landing and their time-outs.
    pub(super) fn advance(&mut self, now: FlightTime) {
        let settings = self.config.failsafe;
        match self.phase {
            Phase::Idle { since } => {
                if !self.guidance.altitude_asked {
                    // What the estimate drifts by on the ground is no climb that anybody asked for.
                    self.guidance.target.position_enu_m.z = self.motion().position_enu_m.z;
                }
                if self.wants_to_fly() {
                    self.controller.reset();
                    self.guidance.profile.restart(Setpoint { throttle: 0.0, ..self.here() });
                    self.phase = Phase::Flying;
                    self.guidance.takeoff_height_m = self.supervision.watchdog.height_m();
                    (self.guidance.quiet_since, self.guidance.low_since, self.guidance.sank) = (None, None, None);
                } else if now.seconds_since(since) > settings.takeoff_timeout_s {
                    let why = text(format_args!("armed for {} s without take-off", settings.takeoff_timeout_s));
                    (self.supervision.failsafe, self.supervision.failsafe_reason) = (Failsafe::TakeoffTimeout, why);
                    self.event(Severity::Warning, EventKind::Failsafe, why);
                    self.disarm(text(format_args!("disarmed: {why}")));
                }
            }
            Phase::Flying => {
                let (blind_over, standing, touching) = (self.blind_over(now), self.standing(now), self.touching(now));
                if blind_over || standing || touching {
                    if self.mode == Mode::Stabilise {
                        self.phase = Phase::Idle { since: now };
                    } else {
                        self.phase = Phase::Landed { since: now };
                        self.event(Severity::Info, EventKind::Mode, text(format_args!("landed")));
                    }
                }
            }
            Phase::Landed { since } => {
                if now.seconds_since(since) > settings.landed_s {
                    self.disarm(text(format_args!("disarmed: landed for {} s", settings.landed_s)));
                }
            }
        }
    }

    fn wants_to_fly(&self) -> bool {
        match self.mode {
            // Nobody is there to take off for.
            _ if matches!(self.supervision.failsafe, Failsafe::LinkFreeze | Failsafe::OperatorFreeze) => false,
            Mode::Stabilise => self.guidance.target.throttle > THROTTLE_ACTIVE,
            // What an estimator makes of a landing without any measurement of the altitude is nothing to climb from.
            Mode::AltitudeHold | Mode::Hold if self.lasers() > 0 && self.supervision.watchdog.heights_fresh() == 0 => {
                false
            }
            Mode::AltitudeHold | Mode::Hold if self.motion().velocity_enu_mps.z.abs() > ASTRAY_MPS => false,
            Mode::AltitudeHold | Mode::Hold => {
                self.guidance.target.position_enu_m.z > self.motion().position_enu_m.z + TAKEOFF_STEP_M
            }
            _ => false,
        }
    }

    /// On the ground, or hanging, with nothing left to do: little thrust and no motion.
    fn standing(&mut self, now: FlightTime) -> bool {
        let down = match self.mode {
            Mode::Land => self.supervision.blind_since.is_none(),
            Mode::Stabilise => self.guidance.target.throttle < THROTTLE_ACTIVE,
            _ => false,
        };
        let light = self.report.given.thrust_n < STANDING_THRUST * self.config.airframe.weight_n();
        let still = self.motion().velocity_enu_mps.z.abs() < STANDING_SPEED_MPS;
        if !(down && light && still) {
            self.guidance.quiet_since = None;
            return false;
        }
        now.seconds_since(*self.guidance.quiet_since.get_or_insert(now)) > STANDING_S
    }

    /// A descent on attitude alone has had its time and sinks no more; or it takes far longer, whatever seems to sink.
    fn blind_over(&mut self, now: FlightTime) -> bool {
        if self.supervision.watchdog.coasting_mps().is_some_and(|climb_mps| climb_mps < -STANDING_SPEED_MPS) {
            self.guidance.sank = Some(now);
        }
        let least_s = self.config.failsafe.blind_descend_s;
        let blind_s = self.supervision.blind_since.map_or(0.0, |t| now.seconds_since(t));
        let stopped = self.guidance.sank.is_none_or(|t| now.seconds_since(t) > STANDING_S);
        blind_s > if stopped { least_s } else { BLIND_MOST * least_s }
    }

    /// As low as where it took off by the raw heights, and quiet: down, whatever the estimator says. Beside a stand it comes
    /// lower than that in the air, where it still moves.
    fn touching(&mut self, now: FlightTime) -> bool {
        let quiet = self.supervision.watchdog.rates_radps().norm() <= TOUCHING_RADPS && !self.rises_or_sinks();
        if self.mode != Mode::Land || !self.is_low() || !quiet {
            self.guidance.low_since = None;
            return false;
        }
        now.seconds_since(*self.guidance.low_since.get_or_insert(now)) > TOUCHING_S
    }

    /// Raw height above where it took off, m.
    fn above_takeoff_m(&self) -> Option<f64> {
        let watchdog = &self.supervision.watchdog;
        // Blind, it may be that most heights are wrong: only all of them together say that it is down.
        let height_m = if self.supervision.blind_since.is_some() { watchdog.highest_m() } else { watchdog.height_m() };
        height_m.zip(self.guidance.takeoff_height_m).map(|(height_m, takeoff_m)| height_m - takeoff_m)
    }

    pub(super) fn at_takeoff_height(&self) -> bool {
        self.above_takeoff_m().is_some_and(|above_m| above_m.abs() < TOUCHING_M)
    }

    /// As low as where it took off, or lower.
    fn is_low(&self) -> bool {
        self.above_takeoff_m().is_some_and(|above_m| above_m < TOUCHING_M)
    }

    /// By accelerometers and raw heights.
    fn rises_or_sinks(&self) -> bool {
        self.supervision.watchdog.coasting_mps().is_some_and(|climb_mps| climb_mps.abs() > STANDING_SPEED_MPS)
    }

    /// Throttle of a descent on attitude alone: with the slope of the raw heights where there are any.
    pub(super) fn blind_throttle(&self) -> f64 {
        let settings = &self.config.failsafe;
        let blind_s =
            self.supervision.blind_since.zip(self.liveness.ticked).map_or(0.0, |(t, now)| now.seconds_since(t));
        // From high up it goes on sinking as fast as then.
        let settling_s = (blind_s.min(settings.blind_descend_s) - SETTLING.0).max(0.0);
        let sinks_mps = settings.descend_mps + SETTLING.1 * settling_s;
        let share = match self.supervision.watchdog.climb_mps() {
            _ if self.is_low() && !self.rises_or_sinks() => BLIND_RANGE.0,
            Some(climb_mps) => (1.0 - BLIND_GAIN_SPM * (climb_mps + sinks_mps)).clamp(BLIND_RANGE.0, BLIND_RANGE.1),
            None => {
                let climb_mps = self.supervision.watchdog.coasting_mps().unwrap_or(0.0);
                (BLIND_THRUST - BLIND_BRAKE_SPM * climb_mps.max(0.0)).max(BLIND_RANGE.0)
            }
        };
        share * self.guidance.hover_thrust_n / self.config.airframe.weight_n()
    }

    /// Learns what hovering takes: while the altitude is held, the thrust itself; in a descent on attitude alone, what the
    /// thrust is worth by the accelerometers, whose force stays right where the altitude is lost.
    pub(super) fn learn_hover(&mut self, mixed: &Mixed, dt_s: f64) {
        let (estimate, watchdog) = (self.bank.in_loop(), &self.supervision.watchdog);
        let weight = self.config.airframe.weight_n();
        let unmeasured_s = watchdog.altitude_age_s(self.liveness.ticked.unwrap_or_default());
        let steady = estimate.motion_or_rest().velocity_enu_mps.z.abs() < 0.2 && estimate.health == Health::Healthy;
        let thrust_n = mixed.given.thrust_n;
        let hover_n = if self.supervision.blind_since.is_some() {
            let felt = watchdog.force_mps2().z / GRAVITY_MPS2;
            (felt > HOVER_LEAST && thrust_n > HOVER_LEAST * weight).then(|| thrust_n / felt)
        } else {
            let lately = self.lasers() == 0 || unmeasured_s < HOVER_MAX_AGE_S;
            let held = lately && self.loops().altitude && self.mode != Mode::Land;
            (held && steady && !mixed.saturated).then(|| thrust_n * watchdog.tilt_rad().cos())
        };
        if let Some(hover_n) = hover_n {
            self.guidance.hover_thrust_n += dt_s / HOVER_TIME_CONSTANT_S * (hover_n - self.guidance.hover_thrust_n);
            self.guidance.hover_thrust_n = self.guidance.hover_thrust_n.clamp(0.8 * weight, 1.25 * weight);
        }
    }
}

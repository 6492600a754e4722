//! What the flight does by itself in each tick: take-off, landing, time-outs, failsafes.

use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::status::gives_altitude;
use super::{AttackPhase, Failsafe, Flight, Phase};
use crate::control::setpoint::Limits;
use crate::estimate::Health;
use crate::event::{EventKind, Severity, Text, text};
use crate::mix::Mixed;
use crate::supervisor::monitor::{DESCENDS, Outward, climb_stops_m};
use crate::supervisor::{Inputs, descent_limits, severity};
use crate::types::{GRAVITY_MPS2, Mode, Setpoint};

/// A target this far above the vehicle is a take-off, m.
const TAKEOFF_STEP_M: f64 = 0.05;
/// Throttle that puts the loops to work in stabilise mode.
const THROTTLE_ACTIVE: f64 = 0.1;
/// Less thrust than this fraction of the weight, without moving, is standing (or hanging).
const STANDING_THRUST: f64 = 0.6;
/// Slower than this is not moving, m/s.
const STANDING_SPEED_MPS: f64 = 0.15;
/// Standing for this long is landed, s.
const STANDING_S: f64 = 0.5;
/// Raw heights within this of where it took off, m …
const TOUCHING_M: f64 = 0.05;
/// … turning slower than this, rad/s …
const TOUCHING_RADPS: f64 = 0.2;
/// … for this long, s, is landed too, whatever estimator and thrust say.
const TOUCHING_S: f64 = 1.0;
/// Thrust of at least this times the hovering one is meant to lift …
const PUSHING: f64 = 1.1;
/// … and this far below its setpoint, m, a vehicle that does not climb does not follow.
const THRUST_DEFICIT_M: f64 = 0.3;
/// How far below the vehicle the profile of a landing may run, m.
const LANDING_LEAD_M: f64 = 0.6;
/// Thrust of a descent on attitude alone, of the hover thrust, where no height is heard …
const BLIND_THRUST: f64 = 0.96;
/// … and else so much less or more for each m/s that it sinks too slowly or too fast, …
const BLIND_GAIN_SPM: f64 = 0.2;
/// … within these: heights may be attacked, and must not make it fall or climb away.
const BLIND_RANGE: (f64, f64) = (0.5, 1.05);
/// Estimator and watchdog agree within this angle, rad (8°).
const AGREEMENT_RAD: f64 = 0.14;
/// An altitude further than this from the raw heights is no estimate, m: more than any delay or slant explains.
const ASTRAY_M: f64 = 0.5;
/// The hover thrust is learned with this time constant, s.
const HOVER_TIME_CONSTANT_S: f64 = 1.0;

impl Flight {
    /// Judges the state of the vehicle and changes mode and phase accordingly.
    pub(super) fn guard(&mut self, now: FlightTime) {
        self.watch_attacks();
        let inputs = self.failsafe_inputs(now);
        let unlinked = inputs.link_age_s > self.config.failsafe.link_freeze_s;
        let unattended = inputs.operator_age_s > self.config.failsafe.operator_freeze_s;
        if (unlinked || unattended) && self.attacks.abort(now) > 0 {
            let lost = match unlinked {
                true => text(format_args!("attacks aborted: no heartbeat for {:.2} s", inputs.link_age_s)),
                false => {
                    text(format_args!("attacks aborted: no sign of the operator for {:.1} s", inputs.operator_age_s))
                }
            };
            self.event(Severity::Warning, EventKind::Attack, lost);
        }
        if !self.armed() {
            return;
        }
        let verdict = self.monitor.judge(&inputs);
        self.heed(verdict, &inputs);
        if self.armed() {
            self.advance(now);
        }
    }

    fn failsafe_inputs(&mut self, now: FlightTime) -> Inputs {
        let loops = self.loops();
        let estimate = self.bank.in_loop();
        let thrust_enu = estimate.world_from_body * nalgebra::Vector3::z();
        let outward = |axis: usize, side: f64| Outward {
            distance_m: estimate.position_enu_m[axis] * side,
            speed_mps: estimate.velocity_enu_mps[axis] * side,
            pull_mps2: GRAVITY_MPS2 * thrust_enu[axis] * side,
        };
        let imu_age_s = self.watchdog.imu_age_s(now);
        let (climb_mps, lift_mps2) = self.climb();
        // Also towards the other side of the box: what crosses its middle too fast cannot stop behind it.
        let sides = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)].map(|(axis, side)| outward(axis, side));
        let farther = |a: Outward, b: Outward| if a.stops_m(climb_mps) >= b.stops_m(climb_mps) { a } else { b };
        let raw_height_m = self.watchdog.height_m();
        let astray =
            raw_height_m.zip(estimate.altitude_m()).is_some_and(|(raw, altitude)| (raw - altitude).abs() > ASTRAY_M);
        let agree = self.watchdog.disagreement_rad(&estimate.world_from_body) < AGREEMENT_RAD;
        self.position_lost &= !estimate.horizontal_known;
        Inputs {
            now,
            flying: self.phase == Phase::Flying,
            imu_age_s,
            tilt_rad: self.watchdog.tilt_rad(),
            rate_radps: self.watchdog.rates_radps().norm(),
            raw_height_m,
            altitude_m: estimate.altitude_m(),
            climb_mps,
            lift_mps2,
            altitude_needed: (loops.altitude || self.has_box()) && self.blind_since.is_none(),
            lateral: sides.into_iter().reduce(farther).filter(|_| estimate.horizontal_known),
            position_lost: self.position_lost || (self.mode == Mode::Hold && !estimate.horizontal_known),
            degraded: estimate.health != Health::Healthy || self.wrench_invalid || astray,
            corroborated: agree && !astray && imu_age_s <= self.config.failsafe.imu_silent_s,
            not_moving: self.not_moving(),
            charge: self.charge,
            link_age_s: self.link_age_s(now),
            operator_age_s: self.operator.map_or(0.0, |t| now.seconds_since(t)),
            altitude_max_m: self.config.altitude_max_m(),
            lateral_max_m: self.config.limits.lateral_max_m,
        }
    }

    /// The larger of the climb rates by estimate and by raw heights, m/s, and what the present thrust accelerates it by, m/s².
    fn climb(&self) -> (f64, f64) {
        let estimate = self.bank.in_loop();
        let raw_mps = self.watchdog.climb_mps().unwrap_or(0.0);
        let climb_mps = estimate.climb_mps().map_or(raw_mps, |climb| climb.max(raw_mps));
        let thrust_up = (estimate.world_from_body * nalgebra::Vector3::z()).z;
        (climb_mps, self.report.given.thrust_n / self.config.airframe.mass_kg * thrust_up - GRAVITY_MPS2)
    }

    /// More thrust is commanded than hovers, and the vehicle does not follow: an empty battery, a lost propeller, something
    /// that holds it.
    fn not_moving(&self) -> bool {
        let hover_n = self.hover_thrust_n;
        if self.phase != Phase::Flying || !self.config.rig.can_lift() || self.report.given.thrust_n < PUSHING * hover_n
        {
            return false;
        }
        let estimate = self.bank.in_loop();
        match self.mode {
            Mode::AltitudeHold | Mode::Hold => {
                let missing_m = self.profile.setpoint().position_enu_m.z - estimate.position_enu_m.z;
                missing_m > THRUST_DEFICIT_M && estimate.velocity_enu_mps.z < STANDING_SPEED_MPS
            }
            // Nothing but the throttle says what the operator wants: only where it took off.
            Mode::Stabilise => {
                let rates = self.watchdog.rates_radps().norm();
                self.at_takeoff_height()
                    && rates < TOUCHING_RADPS
                    && estimate.velocity_enu_mps.z.abs() < STANDING_SPEED_MPS
            }
            _ => false,
        }
    }

    /// Can the vehicle leave its box, and tell?
    pub(super) fn has_box(&self) -> bool {
        self.config.rig.can_lift() && self.config.sensors.iter().any(|s| gives_altitude(s.kind))
    }

    /// How many laser heights the vehicle has.
    pub(super) fn lasers(&self) -> usize {
        self.config.sensors.iter().filter(|s| s.kind == SensorKind::Height).count()
    }

    fn at_takeoff_height(&self) -> bool {
        let heights = self.watchdog.height_m().zip(self.takeoff_height_m);
        heights.is_some_and(|(height_m, takeoff_m)| height_m < takeoff_m + TOUCHING_M)
    }

    /// Acts on the verdict when it is new and at least as severe as what acts already.
    fn heed(&mut self, verdict: Failsafe, inputs: &Inputs) {
        // A descent, once begun, lasts until the operator takes over or the motors stop.
        let latched = severity(self.failsafe) >= DESCENDS;
        if verdict == self.failsafe || (latched && severity(verdict) <= severity(self.failsafe)) {
            return;
        }
        if verdict == Failsafe::None {
            self.clear_failsafe();
            return;
        }
        self.act(verdict, self.monitor.reason(verdict, inputs));
    }

    /// Does what `failsafe` asks for, and says why.
    fn act(&mut self, failsafe: Failsafe, reason: Text) {
        let severity = if severity(failsafe) >= DESCENDS { Severity::Critical } else { Severity::Warning };
        self.event(severity, EventKind::Failsafe, reason);
        (self.failsafe, self.failsafe_reason) = (failsafe, reason);
        match failsafe {
            Failsafe::None | Failsafe::DeadlineWarn | Failsafe::BatteryLow | Failsafe::TakeoffTimeout => {}
            Failsafe::LinkFreeze | Failsafe::OperatorFreeze => self.freeze(),
            Failsafe::BoxHold => self.hold_at_edge(),
            Failsafe::PositionHold => self.leave_hold(),
            Failsafe::LinkDescend
            | Failsafe::OperatorDescend
            | Failsafe::DeadlineDescend
            | Failsafe::PositionDescend
            | Failsafe::BatteryDescend
            | Failsafe::ThrustDescend
            | Failsafe::ShutdownDescend
            | Failsafe::BoxDescend => self.descend(),
            Failsafe::EstimatorDescend | Failsafe::AltitudeDescend => self.descend_blindly(),
            Failsafe::TiltCut
            | Failsafe::RateCut
            | Failsafe::ImuCut
            | Failsafe::StallCut
            | Failsafe::ShutdownCut
            | Failsafe::OperatorCut => self.cut(failsafe, reason),
        }
    }

    /// Stays at the edge of the box. A mode that does not control what leads out of it is taken over by one that does.
    fn hold_at_edge(&mut self) {
        let (estimate, mode) = (self.bank.in_loop(), self.edge_mode());
        if self.mode == mode || self.mode == Mode::Hold || self.mode == Mode::Land {
            self.freeze();
        } else if !self.config.rig.can_lift() {
            self.descend();
        } else if !estimate.altitude_known || estimate.health != Health::Healthy {
            self.descend_blindly();
        } else {
            let (climb_mps, lift_mps2) = self.climb();
            let stops_m = estimate.position_enu_m.z + climb_stops_m(climb_mps, lift_mps2);
            self.enter(mode);
            let (least, most) = (self.config.limits.altitude_min_m, self.config.altitude_max_m());
            self.target.position_enu_m.z = stops_m.clamp(least, most);
            self.monitor.took_over();
        }
    }

    /// The mode that controls whatever may lead out of the box.
    pub(super) fn edge_mode(&self) -> Mode {
        if self.bank.in_loop().horizontal_known { Mode::Hold } else { Mode::AltitudeHold }
    }

    /// Hold without a horizontal position is altitude hold at the altitude that was asked for.
    fn leave_hold(&mut self) {
        let altitude_m = self.target.position_enu_m.z;
        self.enter(Mode::AltitudeHold);
        self.target.position_enu_m.z = altitude_m;
        self.position_lost = true;
    }

    fn descend_blindly(&mut self) {
        self.blind_since = self.ticked;
        self.descend();
    }

    /// The program ends, because of `why`: lands, or cuts.
    pub fn shutdown(&mut self, cut: bool, why: &str) {
        if !self.armed() {
            return;
        }
        if cut {
            self.act(Failsafe::ShutdownCut, text(format_args!("{why}: motors cut")));
        } else if severity(self.failsafe) < DESCENDS {
            self.act(Failsafe::ShutdownDescend, text(format_args!("{why}: descending")));
        }
    }

    /// The flight thread was silent for `gap_s`: after the motors' time-out they stay cut.
    pub fn stalled(&mut self, gap_s: f64) {
        let limit_s = self.config.failsafe.stall_cut_s;
        if self.armed() && gap_s > limit_s {
            let reason = text(format_args!("flight thread silent for {gap_s:.2} s (limit {limit_s} s): motors cut"));
            self.act(Failsafe::StallCut, reason);
        }
    }

    /// The failsafe's cause is gone, or the operator took over.
    pub(super) fn clear_failsafe(&mut self) {
        if self.failsafe != Failsafe::None {
            let over = text(format_args!("over: {}", self.failsafe_reason));
            self.event(Severity::Info, EventKind::Failsafe, over);
        }
        (self.failsafe, self.failsafe_reason) = (Failsafe::None, Text::new());
        self.blind_since = None;
    }

    /// Stays where the profile is, inside the limits.
    fn freeze(&mut self) {
        self.path = None;
        let limits = self.config.limits;
        let mut here = *self.profile.setpoint();
        let p = &mut here.position_enu_m;
        p.z = p.z.clamp(limits.altitude_min_m, self.config.altitude_max_m());
        p.x = p.x.clamp(-limits.lateral_max_m, limits.lateral_max_m);
        p.y = p.y.clamp(-limits.lateral_max_m, limits.lateral_max_m);
        (here.roll_pitch_yaw_rad.x, here.roll_pitch_yaw_rad.y) = (0.0, 0.0);
        self.target = here;
    }

    /// Lands from here; a vehicle that cannot lift just stops.
    fn descend(&mut self) {
        if self.phase != Phase::Flying || !self.config.rig.can_lift() {
            let reason = self.failsafe_reason;
            self.disarm(text(format_args!("disarmed: {reason}")));
            return;
        }
        self.enter(Mode::Land);
    }

    /// Motors off, latched.
    pub(super) fn cut(&mut self, failsafe: Failsafe, reason: Text) {
        (self.failsafe, self.failsafe_reason) = (failsafe, reason);
        self.cut_latched = true;
        self.mode = Mode::Cut;
        self.stop();
        self.event(Severity::Critical, EventKind::Mode, text(format_args!("motors cut: {reason}")));
    }

    /// Motors off.
    pub(super) fn disarm(&mut self, why: Text) {
        self.mode = Mode::Disarmed;
        self.stop();
        self.event(Severity::Info, EventKind::Armed, why);
    }

    fn stop(&mut self) {
        self.phase = Phase::Idle { since: self.ticked.unwrap_or_default() };
        self.operator = None;
        self.position_lost = false;
        (self.quiet_since, self.low_since, self.blind_since) = (None, None, None);
        self.path = None;
        self.monitor.reset();
        self.meter.reset();
        self.controller.reset();
    }

    /// Changes the mode and captures where the vehicle is.
    pub(super) fn enter(&mut self, mode: Mode) {
        let flying = self.phase == Phase::Flying;
        let here = self.here();
        self.path = None;
        self.mode = mode;
        self.target = here;
        (self.quiet_since, self.low_since) = (None, None);
        if flying {
            // From rest at the present place: the integrators keep what they carry.
            self.profile.restart(here);
        }
        if !flying || mode != Mode::Stabilise {
            self.target.throttle = 0.0;
        }
        let limits = self.config.limits;
        if flying && matches!(mode, Mode::AltitudeHold | Mode::Hold) {
            let p = &mut self.target.position_enu_m;
            p.z = p.z.clamp(limits.altitude_min_m, self.config.altitude_max_m());
            p.x = p.x.clamp(-limits.lateral_max_m, limits.lateral_max_m);
            p.y = p.y.clamp(-limits.lateral_max_m, limits.lateral_max_m);
        }
        self.event(Severity::Info, EventKind::Mode, text(format_args!("mode {}", mode_name(mode))));
    }

    /// Take-off, landing and their time-outs.
    fn advance(&mut self, now: FlightTime) {
        let settings = self.config.failsafe;
        match self.phase {
            Phase::Idle { since } => {
                if self.wants_to_fly() {
                    self.controller.reset();
                    self.profile.restart(Setpoint { throttle: 0.0, ..self.here() });
                    self.phase = Phase::Flying;
                    self.takeoff_height_m = self.watchdog.height_m();
                    (self.quiet_since, self.low_since) = (None, None);
                } else if now.seconds_since(since) > settings.takeoff_timeout_s {
                    let why = text(format_args!("armed for {} s without take-off", settings.takeoff_timeout_s));
                    (self.failsafe, self.failsafe_reason) = (Failsafe::TakeoffTimeout, why);
                    self.event(Severity::Warning, EventKind::Failsafe, why);
                    self.disarm(text(format_args!("disarmed: {why}")));
                }
            }
            Phase::Flying => {
                let blind_over = self.blind_since.is_some_and(|t| now.seconds_since(t) > settings.blind_descend_s);
                let (standing, touching) = (self.standing(now), self.touching(now));
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
            Mode::Stabilise => self.target.throttle > THROTTLE_ACTIVE,
            // What an estimator makes of a landing without any measurement of the altitude is nothing to climb from.
            Mode::AltitudeHold | Mode::Hold if self.lasers() > 0 && self.watchdog.heights_fresh() == 0 => false,
            Mode::AltitudeHold | Mode::Hold => {
                self.target.position_enu_m.z > self.bank.in_loop().position_enu_m.z + TAKEOFF_STEP_M
            }
            _ => false,
        }
    }

    /// On the ground, or hanging, with nothing left to do: little thrust and no motion.
    fn standing(&mut self, now: FlightTime) -> bool {
        let down = match self.mode {
            Mode::Land => self.blind_since.is_none(),
            Mode::Stabilise => self.target.throttle < THROTTLE_ACTIVE,
            _ => false,
        };
        let light = self.report.given.thrust_n < STANDING_THRUST * self.config.airframe.weight_n();
        let still = self.bank.in_loop().velocity_enu_mps.z.abs() < STANDING_SPEED_MPS;
        if !(down && light && still) {
            self.quiet_since = None;
            return false;
        }
        now.seconds_since(*self.quiet_since.get_or_insert(now)) > STANDING_S
    }

    /// Back where it took off by the raw heights, and quiet: down, whatever the estimator says.
    fn touching(&mut self, now: FlightTime) -> bool {
        if self.mode != Mode::Land || !self.at_takeoff_height() || self.watchdog.rates_radps().norm() > TOUCHING_RADPS {
            self.low_since = None;
            return false;
        }
        now.seconds_since(*self.low_since.get_or_insert(now)) > TOUCHING_S
    }

    /// Limits of the profile in this tick.
    pub(super) fn limits_now(&self) -> Limits {
        if self.mode == Mode::Land {
            descent_limits(&self.config.limits, &self.config.failsafe)
        } else {
            self.config.limits
        }
    }

    /// Where the profile is heading in this tick.
    pub(super) fn target_now(&self) -> Setpoint {
        let (mut target, z_m) = (self.target, self.bank.in_loop().position_enu_m.z);
        let most_m = self.config.altitude_max_m();
        if self.mode == Mode::Land {
            // Down until something carries the vehicle; never far below it.
            target.position_enu_m.z = z_m - LANDING_LEAD_M;
        } else if let Some(raw_m) = self.watchdog.height_m().filter(|raw_m| *raw_m > most_m.max(z_m)) {
            // By the raw heights it is too high already: the limit is theirs then.
            target.position_enu_m.z = target.position_enu_m.z.min(most_m - (raw_m - z_m));
        }
        target
    }

    /// Throttle of a descent on attitude alone: with the slope of the raw heights where there are any.
    pub(super) fn blind_throttle(&self) -> f64 {
        let sinks_mps = self.config.failsafe.descend_mps;
        let share = match self.watchdog.climb_mps() {
            _ if self.at_takeoff_height() => BLIND_RANGE.0,
            Some(climb_mps) => (1.0 - BLIND_GAIN_SPM * (climb_mps + sinks_mps)).clamp(BLIND_RANGE.0, BLIND_RANGE.1),
            None => BLIND_THRUST,
        };
        share * self.hover_thrust_n / self.config.airframe.weight_n()
    }

    /// Learns what hovering takes while the altitude is held.
    pub(super) fn learn_hover(&mut self, mixed: &Mixed, dt_s: f64) {
        let estimate = self.bank.in_loop();
        let steady = estimate.velocity_enu_mps.z.abs() < 0.2 && estimate.health == Health::Healthy;
        if self.loops().altitude && self.mode != Mode::Land && steady && !mixed.saturated {
            let lifted = mixed.given.thrust_n * self.watchdog.tilt_rad().cos();
            let weight = self.config.airframe.weight_n();
            self.hover_thrust_n += dt_s / HOVER_TIME_CONSTANT_S * (lifted - self.hover_thrust_n);
            self.hover_thrust_n = self.hover_thrust_n.clamp(0.8 * weight, 1.25 * weight);
        }
    }

    /// Time since the last heartbeat, s; infinite before the first.
    pub(super) fn link_age_s(&self, now: FlightTime) -> f64 {
        self.heartbeat.map_or(f64::INFINITY, |t| now.seconds_since(t))
    }

    /// Makes an event of every change of the attacks' progress.
    fn watch_attacks(&mut self) {
        if self.attacks.changes() == self.attack_changes {
            return;
        }
        self.attack_changes = self.attacks.changes();
        let mut changed = arrayvec::ArrayVec::<_, { super::MAX_ATTACKS }>::new();
        for (i, progress) in self.attacks.state().iter().enumerate() {
            if self.attack_phases.get(i) != Some(&progress.phase) {
                changed.push(*progress);
            }
        }
        self.attack_phases = self.attacks.state().iter().map(|p| p.phase).collect();
        for p in changed {
            let a = p.attack;
            let phase = match p.phase {
                AttackPhase::Accepted => "accepted",
                AttackPhase::Active => "active",
                AttackPhase::Done => "done",
                AttackPhase::Aborted => "aborted",
            };
            let line = text(format_args!(
                "attack {} on {}: {phase} ({:?} {} from {} s for {} s)",
                a.id, a.sensor, a.kind, a.magnitude, a.start_s, a.duration_s
            ));
            self.event(Severity::Warning, EventKind::Attack, line);
        }
    }
}

/// For people and the log.
pub(super) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Unspecified => "unspecified",
        Mode::Disarmed => "disarmed",
        Mode::Stabilise => "stabilise",
        Mode::AltitudeHold => "altitude hold",
        Mode::Hold => "hold",
        Mode::Land => "land",
        Mode::Cut => "cut",
    }
}

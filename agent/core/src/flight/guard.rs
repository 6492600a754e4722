//! What the flight does by itself in each tick: failsafes, and what modes mean.

use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::landing::{STANDING_SPEED_MPS, TOUCHING_RADPS};
use super::status::gives_altitude;
use super::{AttackPhase, Failsafe, Flight, Phase};
use crate::control::TILT_FROM_POSITION_RAD;
use crate::control::setpoint::Limits;
use crate::estimate::Health;
use crate::event::{EventKind, Severity, Text, text};
use crate::frames::{roll_pitch_yaw, tilt_rad};
use crate::supervisor::monitor::{DESCENDS, Outward, climb_stops_m};
use crate::supervisor::{Inputs, descent_limits, severity};
use crate::types::{GRAVITY_MPS2, Mode, Setpoint};

/// Thrust of at least this times the hovering one is meant to lift …
const PUSHING: f64 = 1.1;
/// … and this far below its setpoint, m, a vehicle that does not climb does not follow.
const THRUST_DEFICIT_M: f64 = 0.3;
/// How far below the vehicle the profile of a landing may run, m.
const LANDING_LEAD_M: f64 = 0.6;
/// Estimator and watchdog agree within this angle, rad (8°).
const AGREEMENT_RAD: f64 = 0.14;
/// An altitude further than this from the raw heights is no estimate, m: more than any delay or slant explains.
const ASTRAY_M: f64 = 0.5;
/// … nor does one that climbs otherwise than the accelerometers, by this much, m/s.
const CLIMB_AGREEMENT_MPS: f64 = 0.5;

/// How long hold goes on at the speed it was taken over with, s.
const INWARDS_S: f64 = 0.5;

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
        let verdict = self.supervision.monitor.judge(&inputs);
        self.heed(verdict, &inputs);
        if self.armed() {
            self.advance(now);
        }
    }

    fn failsafe_inputs(&mut self, now: FlightTime) -> Inputs {
        let loops = self.loops();
        let (estimate, motion) = (self.bank.in_loop(), self.motion());
        let thrust_enu = estimate.world_from_body * nalgebra::Vector3::z();
        let outward = |axis: usize, side: f64, (place_m, speed_mps): (f64, f64)| Outward {
            distance_m: place_m * side,
            speed_mps: speed_mps * side,
            pull_mps2: GRAVITY_MPS2 * thrust_enu[axis] * side,
        };
        let imu_age_s = self.supervision.watchdog.imu_age_s(now);
        let (climb_mps, lift_mps2) = self.climb();
        // Also towards the other side of the box: what crosses its middle too fast cannot stop behind it.
        let farther = |a: Outward, b: Outward| if a.stops_m(climb_mps) >= b.stops_m(climb_mps) { a } else { b };
        // After a bump an estimator may refuse right measurements for a while: what is measured has a veto beside it.
        let side = |(axis, side): (usize, f64)| {
            let estimated = outward(axis, side, (motion.position_enu_m[axis], motion.velocity_enu_mps[axis]));
            let measured = self.supervision.watchdog.place(axis).map(|place| outward(axis, side, place));
            measured.map_or(estimated, |measured| farther(estimated, measured))
        };
        let lateral = if motion.horizontal_known {
            [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)].into_iter().map(side).reduce(farther)
        } else {
            None
        };
        let raw_height_m = self.supervision.watchdog.height_m();
        let away = |(raw, altitude): (f64, f64)| (raw - altitude).abs() > ASTRAY_M;
        // One that is attacked and one whose beam meets something read nothing alike: they are no majority.
        let astray =
            raw_height_m.zip(estimate.altitude_m()).is_some_and(away) && self.supervision.watchdog.heights_agree(now);
        let climbs = self.supervision.watchdog.coasting_mps().zip(estimate.climb_mps());
        let agree = self.supervision.watchdog.disagreement_rad(&estimate.world_from_body) < AGREEMENT_RAD
            && climbs.is_none_or(|(felt, estimated)| (felt - estimated).abs() < CLIMB_AGREEMENT_MPS);
        self.supervision.position_lost &= !motion.horizontal_known;
        Inputs {
            now,
            flying: self.phase == Phase::Flying,
            imu_age_s,
            tilt_rad: self.supervision.watchdog.tilt_rad(),
            tilt_agreed_rad: self.supervision.watchdog.tilt_rad().min(tilt_rad(&estimate.world_from_body)),
            tilt_max_rad: self.tilt_max_rad(),
            rate_radps: self.supervision.watchdog.rates_radps().norm(),
            raw_height_m,
            altitude_m: estimate.altitude_m(),
            climb_mps,
            lift_mps2,
            altitude_needed: (loops.altitude || self.has_box()) && self.supervision.blind_since.is_none(),
            lateral,
            position_lost: self.supervision.position_lost || (self.mode == Mode::Hold && !motion.horizontal_known),
            degraded: estimate.health != Health::Healthy || self.supervision.wrench_invalid || astray,
            corroborated: agree && !astray && imu_age_s <= self.config.failsafe.imu_silent_s,
            not_moving: self.not_moving(),
            charge: self.liveness.charge,
            link_age_s: self.link_age_s(now),
            operator_age_s: self.liveness.operator.map_or(0.0, |t| now.seconds_since(t)),
            altitude_max_m: self.config.altitude_max_m(),
            lateral_max_m: self.config.limits.lateral_max_m,
        }
    }

    /// Largest tilt that may be asked for, rad: the limit; or where that is more, what the setpoint asks for about both axes
    /// together, and what a horizontal loop may add to it about each.
    fn tilt_max_rad(&self) -> f64 {
        let loops = self.loops();
        let heading_rad = roll_pitch_yaw(&self.bank.in_loop().world_from_body).z;
        let asked = self.guidance.profile.setpoint().tilt_rad(loops, heading_rad);
        let added_rad = if loops.horizontal { TILT_FROM_POSITION_RAD } else { 0.0 };
        let cos = asked.map(|angle_rad| (angle_rad.abs() + added_rad).cos());
        (cos.x * cos.y).acos().max(self.config.limits.tilt_max_rad)
    }

    /// The larger of the climb rates by estimate and by raw heights, m/s, and what the present thrust accelerates it by, m/s².
    fn climb(&self) -> (f64, f64) {
        let estimate = self.bank.in_loop();
        let raw_mps = self.supervision.watchdog.climb_mps().unwrap_or(0.0);
        let climb_mps = estimate.climb_mps().map_or(raw_mps, |climb| climb.max(raw_mps));
        let thrust_up = (estimate.world_from_body * nalgebra::Vector3::z()).z;
        (climb_mps, self.report.given.thrust_n / self.config.airframe.mass_kg * thrust_up - GRAVITY_MPS2)
    }

    /// More thrust is commanded than hovers, and the vehicle does not follow: an empty battery, a lost propeller, something
    /// that holds it.
    fn not_moving(&self) -> bool {
        let hover_n = self.guidance.hover_thrust_n;
        // As commanded, not as the mixer could give it: a battery that is empty, or a torque that comes first, leaves less.
        if self.phase != Phase::Flying || !self.config.rig.can_lift() || self.report.wrench.thrust_n < PUSHING * hover_n
        {
            return false;
        }
        let motion = self.motion();
        match self.mode {
            Mode::AltitudeHold | Mode::Hold => {
                let missing_m = self.guidance.profile.setpoint().position_enu_m.z - motion.position_enu_m.z;
                // Where it took off it may bounce, and has not climbed.
                let climbs = motion.velocity_enu_mps.z >= STANDING_SPEED_MPS && !self.at_takeoff_height();
                missing_m > THRUST_DEFICIT_M && !climbs
            }
            // Nothing but the throttle says what the operator wants: only where it took off.
            Mode::Stabilise => {
                let rates = self.supervision.watchdog.rates_radps().norm();
                self.at_takeoff_height()
                    && rates < TOUCHING_RADPS
                    && motion.velocity_enu_mps.z.abs() < STANDING_SPEED_MPS
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

    /// Acts on the verdict when it is new and at least as severe as what acts already.
    fn heed(&mut self, verdict: Failsafe, inputs: &Inputs) {
        // A descent, once begun, lasts until the operator takes over or the motors stop.
        let latched = severity(self.supervision.failsafe) >= DESCENDS;
        if verdict == self.supervision.failsafe || (latched && severity(verdict) <= severity(self.supervision.failsafe))
        {
            return;
        }
        if verdict == Failsafe::None {
            self.clear_failsafe();
            return;
        }
        self.act(verdict, self.supervision.monitor.reason(verdict, inputs));
    }

    /// Does what `failsafe` asks for, and says why.
    pub(super) fn act(&mut self, failsafe: Failsafe, reason: Text) {
        let severity = if severity(failsafe) >= DESCENDS { Severity::Critical } else { Severity::Warning };
        self.event(severity, EventKind::Failsafe, reason);
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (failsafe, reason);
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
            | Failsafe::RotorDescend
            | Failsafe::BoxDescend => self.descend(),
            Failsafe::EstimatorDescend | Failsafe::AltitudeDescend => self.descend_blindly(),
            Failsafe::TiltCut
            | Failsafe::RateCut
            | Failsafe::ImuCut
            | Failsafe::StallCut
            | Failsafe::ShutdownCut
            | Failsafe::RotorCut
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
        } else if !estimate.altitude_known() || estimate.health != Health::Healthy {
            self.descend_blindly();
        } else {
            let (climb_mps, lift_mps2) = self.climb();
            let stops_m = self.motion().position_enu_m.z + climb_stops_m(climb_mps, lift_mps2);
            self.enter(mode);
            let (least, most) = (self.config.limits.altitude_min_m, self.config.altitude_max_m());
            self.guidance.target.position_enu_m.z = stops_m.clamp(least, most);
            self.supervision.monitor.took_over();
        }
        self.lean_inwards();
    }

    /// At the edge, hold begins at rest where the vehicle is, and not where its profile was carried to on a path; and it comes
    /// to rest behind its target by what its loop overshoots, so the target goes as far inwards.
    fn lean_inwards(&mut self) {
        if self.mode != Mode::Hold {
            return;
        }
        let here = self.here();
        self.guidance.profile.restart(here);
        let (place, velocity) = (self.motion().position_enu_m, self.motion().velocity_enu_mps);
        for axis in 0..2 {
            let (outward_m, outward_mps) = (place[axis].abs(), velocity[axis] * place[axis].signum());
            let target_m = (outward_m - INWARDS_S * outward_mps).max(0.0);
            let target = &mut self.guidance.target.position_enu_m[axis];
            if outward_mps > 0.0 && *target * place[axis].signum() > target_m {
                *target = target_m * place[axis].signum();
            }
        }
    }

    /// The mode that controls whatever may lead out of the box.
    pub(super) fn edge_mode(&self) -> Mode {
        if self.bank.in_loop().horizontal_known() { Mode::Hold } else { Mode::AltitudeHold }
    }

    /// Hold without a horizontal position is altitude hold at the altitude that was asked for.
    fn leave_hold(&mut self) {
        let asked = (self.guidance.target.position_enu_m.z, self.guidance.altitude_asked);
        self.enter(Mode::AltitudeHold);
        (self.guidance.target.position_enu_m.z, self.guidance.altitude_asked) = asked;
        self.supervision.position_lost = true;
    }

    fn descend_blindly(&mut self) {
        self.supervision.blind_since = self.liveness.ticked;
        self.descend();
    }

    /// The program ends, because of `why`: lands, or cuts.
    pub fn shutdown(&mut self, cut: bool, why: &str) {
        if !self.armed() {
            return;
        }
        if cut {
            self.act(Failsafe::ShutdownCut, text(format_args!("{why}: motors cut")));
        } else if severity(self.supervision.failsafe) < DESCENDS {
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
        if self.supervision.failsafe != Failsafe::None {
            let over = text(format_args!("over: {}", self.supervision.failsafe_reason));
            self.event(Severity::Info, EventKind::Failsafe, over);
        }
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (Failsafe::None, Text::new());
        self.supervision.blind_since = None;
    }

    /// Stays where the profile is, in flight inside the limits.
    fn freeze(&mut self) {
        self.guidance.path = None;
        let mut here = *self.guidance.profile.setpoint();
        (here.roll_pitch_yaw_rad.x, here.roll_pitch_yaw_rad.y) = (0.0, 0.0);
        (self.guidance.target, self.guidance.altitude_asked) = (here, false);
        if self.phase == Phase::Flying {
            self.limit_target();
        } else {
            self.guidance.meter.reset();
        }
    }

    /// Moves the target inside the limits.
    fn limit_target(&mut self) {
        let limits = self.config.limits;
        let p = &mut self.guidance.target.position_enu_m;
        p.z = p.z.clamp(limits.altitude_min_m, self.config.altitude_max_m());
        p.x = p.x.clamp(-limits.lateral_max_m, limits.lateral_max_m);
        p.y = p.y.clamp(-limits.lateral_max_m, limits.lateral_max_m);
    }

    /// Lands from here; a vehicle that cannot lift just stops.
    fn descend(&mut self) {
        if self.phase != Phase::Flying || !self.config.rig.can_lift() {
            let reason = self.supervision.failsafe_reason;
            self.disarm(text(format_args!("disarmed: {reason}")));
            return;
        }
        self.enter(Mode::Land);
    }

    /// Motors off, latched.
    pub(super) fn cut(&mut self, failsafe: Failsafe, reason: Text) {
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (failsafe, reason);
        self.supervision.cut_latched = true;
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
        self.phase = Phase::Idle { since: self.liveness.ticked.unwrap_or_default() };
        self.liveness.operator = None;
        self.supervision.position_lost = false;
        (self.guidance.quiet_since, self.guidance.low_since, self.supervision.blind_since) = (None, None, None);
        self.guidance.path = None;
        self.supervision.monitor.reset();
        self.guidance.meter.reset();
        self.controller.reset();
    }

    /// Changes the mode and captures where the vehicle is.
    pub(super) fn enter(&mut self, mode: Mode) {
        let flying = self.phase == Phase::Flying;
        let here = self.here();
        self.guidance.path = None;
        self.guidance.meter.end();
        self.mode = mode;
        (self.guidance.target, self.guidance.altitude_asked) = (here, false);
        (self.guidance.quiet_since, self.guidance.low_since) = (None, None);
        if flying {
            // From rest at the present place: the integrators keep what they carry.
            self.guidance.profile.restart(here);
        }
        if !flying || mode != Mode::Stabilise {
            self.guidance.target.throttle = 0.0;
        }
        if flying && matches!(mode, Mode::AltitudeHold | Mode::Hold) {
            self.limit_target();
        }
        self.event(Severity::Info, EventKind::Mode, text(format_args!("mode {}", mode_name(mode))));
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
        let (mut target, z_m) = (self.guidance.target, self.motion().position_enu_m.z);
        let most_m = self.config.altitude_max_m();
        if self.mode == Mode::Land {
            // Down until something carries the vehicle; never far below it.
            target.position_enu_m.z = z_m - LANDING_LEAD_M;
        } else if let Some(raw_m) = self.supervision.watchdog.height_m().filter(|raw_m| *raw_m > most_m.max(z_m)) {
            // By the raw heights it is too high already: the limit is theirs then.
            target.position_enu_m.z = target.position_enu_m.z.min(most_m - (raw_m - z_m));
        }
        // The same for a place that is measured too far out.
        let side_m = self.config.limits.lateral_max_m;
        for axis in 0..2 {
            let measured = self.supervision.watchdog.place(axis);
            if let Some((place_m, _)) = measured.filter(|(place_m, _)| place_m.abs() > side_m) {
                let astray_m = place_m - self.motion().position_enu_m[axis];
                let along = &mut target.position_enu_m[axis];
                *along = along.max(-side_m - astray_m).min(side_m - astray_m);
            }
        }
        target
    }

    /// Time since the last heartbeat, s; infinite before the first.
    pub(super) fn link_age_s(&self, now: FlightTime) -> f64 {
        self.liveness.heartbeat.map_or(f64::INFINITY, |t| now.seconds_since(t))
    }

    /// Makes an event of every change of the attacks' progress.
    fn watch_attacks(&mut self) {
        if self.attacks.changes() == self.told.attack_changes {
            return;
        }
        self.told.attack_changes = self.attacks.changes();
        let mut changed = arrayvec::ArrayVec::<_, { super::MAX_ATTACKS }>::new();
        for (i, progress) in self.attacks.state().iter().enumerate() {
            if self.told.attack_phases.get(i) != Some(&(progress.accepted, progress.phase)) {
                changed.push(*progress);
            }
        }
        self.told.attack_phases = self.attacks.state().iter().map(|p| (p.accepted, p.phase)).collect();
        for p in changed {
            let a = p.attack;
            let phase = match p.phase {
                AttackPhase::Accepted => "accepted",
                AttackPhase::Active => "active",
                AttackPhase::Done => "done",
                AttackPhase::Aborted => "aborted",
            };
            let line = text(format_args!(
                "attack {} on {}: {phase} ({a}, from {} s for {} s)",
                a.id, a.sensor, a.start_s, a.duration_s
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

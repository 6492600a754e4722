//! Commands, carried out between ticks: checked, done whole, or refused with the offending value.

#![allow(clippy::result_large_err, reason = "bounded text on the stack: commands do not allocate")]

use plumbline_proto::time::FlightTime;

use super::guard::mode_name;
use super::rotors::RotorWatch;
use super::status::IMU_MAX_AGE_S;
use super::support::Support;
use super::{Failsafe, Flight, Phase};
use crate::attack::Schedule;
use crate::command::{Ack, Command, SetpointChange};
use crate::control::gains::{Certified, GainsError, refusal};
use crate::estimate::bank::{Bank, build};
use crate::estimate::secure::Decoder;
use crate::estimate::{Estimate, Health};
use crate::event::{EventKind, Severity, Text, text};
use crate::frames::wrap_pi;
use crate::supervisor::Watchdog;
use crate::types::{Actuation, EstimatorKind, Mode};

/// Body rate below which a vehicle stands still, rad/s (10 °/s).
const STILL_RADPS: f64 = 0.175;

/// Altitude control is not begun on an altitude that was measured longer ago, s.
const ALTITUDE_MAX_AGE_S: f64 = 0.5;

/// A field of a setpoint: name, unit, new value, least, most, controlled in this mode?
type Field = (&'static str, &'static str, Option<f64>, f64, f64, bool);
/// Setpoint events come at most this often, s.
const SETPOINT_EVENT_S: f64 = 0.2;

/// What was done, or why not.
type Outcome = Result<Text, Text>;

impl Flight {
    /// Carries out one command. `now` is the time of the last tick, or later.
    pub fn apply(&mut self, command: &Command, now: FlightTime) -> Ack {
        // Who commands is there, page or not.
        if self.liveness.operator.is_some() {
            self.operator_alive(now);
        }
        let outcome = match command {
            Command::Arm => self.arm(now),
            Command::Disarm => self.order_disarm(),
            Command::CutMotors => self.order_cut(),
            Command::ReleaseCut => self.release_cut(),
            Command::BeginAnew => self.begin_anew(),
            Command::Recalibrated => self.estimators_anew().map(|()| text(format_args!("estimators begun anew"))),
            Command::SetMode(mode) => self.set_mode(*mode),
            Command::Setpoint(change) => self.set_setpoint(change, now),
            Command::Trajectory(trajectory) => self.set_trajectory(trajectory.as_ref(), now),
            Command::Attack(schedule) => self.set_attacks(schedule, now),
            Command::AbortAttacks => {
                let aborted = self.attacks.abort(now);
                Ok(text(format_args!("{aborted} attacks aborted")))
            }
            Command::SelectEstimator(kind) => self.select_estimator(*kind),
            Command::SelectDecoder(decoder) => self.select_decoder(*decoder),
            Command::UseGains(gains) => self.use_gains(gains),
        };
        match outcome {
            Ok(reason) => Ack { accepted: true, reason },
            Err(reason) => Ack { accepted: false, reason },
        }
    }

    fn arm(&mut self, now: FlightTime) -> Outcome {
        if self.armed() {
            return Err(text(format_args!("already armed, mode {}", mode_name(self.mode))));
        }
        let checks = self.checks(now);
        if let Some(failed) = checks.iter().find(|c| !c.passed) {
            let others = checks.iter().filter(|c| !c.passed).count() - 1;
            return Err(match others {
                0 => text(format_args!("{}: {}", failed.name, failed.reason)),
                _ => text(format_args!("{}: {}; and {others} more checks fail", failed.name, failed.reason)),
            });
        }
        self.supervision.monitor.reset();
        self.rotors = RotorWatch::new(&self.config.airframe);
        self.mixer.weaken(self.rotors.effectiveness());
        self.guidance.meter.reset();
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (Failsafe::None, Text::new());
        self.liveness.operator = None;
        self.phase = Phase::Idle { since: self.liveness.ticked.unwrap_or(now) };
        self.event(Severity::Info, EventKind::Armed, text(format_args!("armed, {}", self.config.rig.name())));
        self.enter(Mode::Stabilise);
        Ok(text(format_args!("armed, mode stabilise")))
    }

    fn order_disarm(&mut self) -> Outcome {
        if !self.armed() {
            return Ok(text(format_args!("already {}", mode_name(self.mode))));
        }
        if self.phase == Phase::Flying && !self.config.rig.catches() {
            let z = self.motion().position_enu_m.z;
            return Err(text(format_args!("in the air at {z:.2} m: land first, or cut the motors")));
        }
        let done = text(format_args!("disarmed by the operator"));
        self.disarm(done);
        Ok(done)
    }

    fn order_cut(&mut self) -> Outcome {
        let reason = text(format_args!("motors cut by the operator"));
        if !self.supervision.cut_latched {
            self.cut(Failsafe::OperatorCut, reason);
        }
        Ok(reason)
    }

    fn release_cut(&mut self) -> Outcome {
        if !self.supervision.cut_latched {
            return Err(text(format_args!("no cut is latched")));
        }
        let imu_age_s = self.supervision.watchdog.imu_age_s(self.liveness.ticked.unwrap_or_default());
        if imu_age_s > IMU_MAX_AGE_S {
            return Err(text(format_args!("no IMU sample for {imu_age_s:.2} s: whether it stands is not known")));
        }
        let rate = self.supervision.watchdog.rates_radps().norm();
        if rate > STILL_RADPS {
            return Err(text(format_args!("still turning at {:.0} °/s, wait until it stands", rate.to_degrees())));
        }
        self.supervision.cut_latched = false;
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (Failsafe::None, Text::new());
        let done = text(format_args!("cut released, disarmed"));
        self.disarm(done);
        Ok(done)
    }

    fn begin_anew(&mut self) -> Outcome {
        self.estimators_anew()?;
        self.supervision.cut_latched = false;
        (self.supervision.failsafe, self.supervision.failsafe_reason) = (Failsafe::None, Text::new());
        let done = text(format_args!("begun anew, disarmed"));
        self.disarm(done);
        Ok(done)
    }

    /// Builds the estimators again: disarmed, and so outside the rules of a tick.
    fn estimators_anew(&mut self) -> Result<(), Text> {
        if self.armed() {
            return Err(text(format_args!("armed, mode {}: land or cut first", mode_name(self.mode))));
        }
        let assumed = self.config.assumptions();
        let built = self.config.estimators.iter().map(|&kind| build(kind, &assumed)).collect::<Result<Vec<_>, _>>();
        let mut bank = built
            .and_then(|estimators| Bank::new(estimators, self.bank.in_loop_kind()))
            .map_err(|error| text(format_args!("{error}")))?;
        self.config
            .decoder
            .map_or(Ok(()), |decoder| bank.use_decoder(decoder))
            .map_err(|e| text(format_args!("{e}")))?;
        self.bank = bank;
        (self.supervision.watchdog, self.support) = (Watchdog::new(&self.config.independent), Support::default());
        Ok(())
    }

    fn set_mode(&mut self, mode: Mode) -> Outcome {
        match mode {
            Mode::Disarmed => return self.order_disarm(),
            Mode::Cut => return self.order_cut(),
            Mode::Unspecified => return Err(text(format_args!("no mode given"))),
            _ if !self.armed() => return Err(text(format_args!("{}: arm first", mode_name(self.mode)))),
            _ => {}
        }
        if mode == self.mode {
            return Ok(text(format_args!("mode is {} already", mode_name(mode))));
        }
        if mode == Mode::Stabilise && self.config.actuation == Actuation::Pose {
            return Err(text(format_args!("stabilise: by pose the autopilot controls attitude and thrust")));
        }
        // What stands, or is held by a rig in which it cannot lift, has nothing to come down from.
        if mode == Mode::Land && (self.phase != Phase::Flying || !self.config.rig.can_lift()) {
            let place = if self.phase == Phase::Flying { self.config.rig.name() } else { "on the ground" };
            self.disarm(text(format_args!("disarmed: asked to land, {place}")));
            return Ok(text(format_args!("{place}: disarmed")));
        }
        if mode != Mode::Stabilise && !self.config.rig.can_lift() {
            let rig = self.config.rig.name();
            return Err(text(format_args!("{rig}: no {}, only stabilise", mode_name(mode))));
        }
        let (kind, estimate) = (self.bank.in_loop_kind(), self.bank.in_loop());
        if matches!(mode, Mode::AltitudeHold | Mode::Hold) && estimate.health != Health::Healthy {
            return Err(text(format_args!("estimator {} is {}", kind.title(), estimate.health.word())));
        }
        let unmeasured_s = self.supervision.watchdog.altitude_age_s(self.liveness.ticked.unwrap_or_default());
        let closes_altitude = matches!(mode, Mode::AltitudeHold | Mode::Hold);
        if self.phase == Phase::Flying && closes_altitude && self.lasers() > 0 && unmeasured_s > ALTITUDE_MAX_AGE_S {
            return Err(text(format_args!("no altitude was measured for {unmeasured_s:.2} s")));
        }
        // Landing without a height is a descent on attitude alone.
        if mode != Mode::Land {
            can_fly(kind, estimate, mode)?;
        }
        // Handed over and taken back in turns, a vehicle would be in neither mode.
        if self.supervision.monitor.blinded() && mode != Mode::Land {
            return Err(text(format_args!(
                "{}; the cause lasts: {} is refused",
                self.supervision.failsafe_reason,
                mode_name(mode)
            )));
        }
        if self.supervision.monitor.leaving() && ![self.edge_mode(), Mode::Hold, Mode::Land].contains(&mode) {
            let (asked, keeps) = (mode_name(mode), mode_name(self.edge_mode()));
            return Err(text(format_args!("at the edge of the box: {asked} is refused there, {keeps} keeps it")));
        }
        // The operator takes over from a failsafe; if its cause lasts, it acts again.
        self.supervision.monitor.operator_acted();
        self.supervision.position_lost = false;
        self.clear_failsafe();
        if let Phase::Landed { .. } = self.phase {
            self.phase = Phase::Idle { since: self.liveness.ticked.unwrap_or_default() };
        }
        self.enter(mode);
        Ok(text(format_args!("mode {}", mode_name(mode))))
    }

    fn set_setpoint(&mut self, change: &SetpointChange, now: FlightTime) -> Outcome {
        if !self.armed() {
            return Err(text(format_args!("{}: arm first", mode_name(self.mode))));
        }
        if self.mode == Mode::Land {
            return Err(text(format_args!("landing: choose another mode first")));
        }
        if self.supervision.failsafe == Failsafe::LinkFreeze {
            return Err(text(format_args!("{}", self.supervision.failsafe_reason)));
        }
        let limits = self.config.limits;
        let altitude_modes = matches!(self.mode, Mode::AltitudeHold | Mode::Hold);
        let fields: [Field; 7] = [
            ("altitude", "m", change.altitude_m, limits.altitude_min_m, self.config.altitude_max_m(), altitude_modes),
            ("x", "m", change.x_m, -limits.lateral_max_m, limits.lateral_max_m, self.mode == Mode::Hold),
            ("y", "m", change.y_m, -limits.lateral_max_m, limits.lateral_max_m, self.mode == Mode::Hold),
            ("roll", "rad", change.roll_rad, -limits.tilt_max_rad, limits.tilt_max_rad, self.mode != Mode::Hold),
            ("pitch", "rad", change.pitch_rad, -limits.tilt_max_rad, limits.tilt_max_rad, self.mode != Mode::Hold),
            ("yaw", "rad", change.yaw_rad, -std::f64::consts::TAU, std::f64::consts::TAU, true),
            ("throttle", "of the weight", change.throttle, 0.0, limits.throttle_max, self.mode == Mode::Stabilise),
        ];
        if fields.iter().all(|f| f.2.is_none()) {
            return Err(text(format_args!("the setpoint changes nothing")));
        }
        // Everything is checked before anything is changed.
        for (name, unit, value, least, most, allowed) in fields {
            let Some(value) = value else { continue };
            if !value.is_finite() {
                return Err(text(format_args!("{name} {value} is not a number")));
            }
            if value < least {
                return Err(text(format_args!("{name} {value} {unit} below limit {least} {unit}")));
            }
            if value > most {
                return Err(text(format_args!("{name} {value} {unit} above limit {most} {unit}")));
            }
            if self.config.actuation == Actuation::Pose && matches!(name, "roll" | "pitch" | "throttle") {
                return Err(text(format_args!("{name} {value} {unit}: by pose the autopilot controls it")));
            }
            if !allowed {
                return Err(text(format_args!("{name} is not controlled in mode {}", mode_name(self.mode))));
            }
        }
        self.supervision.monitor.operator_acted();
        if change.altitude_m.is_some() || change.x_m.is_some() || change.y_m.is_some() {
            self.end_path();
        }
        if let Some(z) = change.altitude_m {
            self.climb_to(z, now);
        }
        let target = &mut self.guidance.target;
        let set = |field: &mut f64, value: Option<f64>| {
            if let Some(value) = value {
                *field = value;
            }
        };
        set(&mut target.position_enu_m.x, change.x_m);
        set(&mut target.position_enu_m.y, change.y_m);
        set(&mut target.roll_pitch_yaw_rad.x, change.roll_rad);
        set(&mut target.roll_pitch_yaw_rad.y, change.pitch_rad);
        set(&mut target.roll_pitch_yaw_rad.z, change.yaw_rad.map(wrap_pi));
        set(&mut target.throttle, change.throttle);
        let mut done = Text::new();
        for (name, unit, value, ..) in fields {
            if let Some(value) = value {
                let separator = if done.is_empty() { "" } else { ", " };
                let value = (value * 1e4).round() / 1e4;
                done = text(format_args!("{done}{separator}{name} {value} {unit}"));
            }
        }
        // A trajectory changes the setpoint at every tick: one event in a while says so.
        if now.seconds_since(self.told.setpoint_told) > SETPOINT_EVENT_S {
            self.told.setpoint_told = now;
            self.event(Severity::Info, EventKind::Setpoint, done);
        }
        Ok(done)
    }

    fn set_attacks(&mut self, schedule: &Schedule, now: FlightTime) -> Outcome {
        let age = self.link_age_s(now);
        if age > self.config.failsafe.link_freeze_s {
            return Err(text(format_args!("no heartbeat for {age:.2} s: no attacks without a link")));
        }
        self.attacks.upload(schedule, now).map_err(|e| text(format_args!("{e}")))?;
        Ok(text(format_args!("schedule {} with {} attacks", schedule.id, schedule.attacks.len())))
    }

    fn select_estimator(&mut self, kind: EstimatorKind) -> Outcome {
        let Some(estimate) = self.bank.estimate_of(kind) else {
            return Err(text(format_args!("estimator {} does not run on this vehicle", kind.title())));
        };
        if self.armed() && estimate.health != Health::Healthy {
            return Err(text(format_args!(
                "estimator {} is {}: not put in the loop while armed",
                kind.title(),
                estimate.health.word()
            )));
        }
        if self.armed() {
            can_fly(kind, estimate, self.mode)?;
        }
        self.bank.select(kind).map_err(|e| text(format_args!("{e}")))?;
        let done = text(format_args!("estimator {} in the loop", kind.title()));
        self.event(Severity::Info, EventKind::Estimator, done);
        Ok(done)
    }

    fn select_decoder(&mut self, decoder: Decoder) -> Outcome {
        self.bank.use_decoder(decoder).map_err(|e| text(format_args!("{e}")))?;
        let done = text(format_args!("decoder {} from the next full window on", decoder.title()));
        self.event(Severity::Info, EventKind::Estimator, done);
        Ok(done)
    }

    /// Switches between ticks. Nothing is solved here: a comparison with the gains in use, and copies.
    fn use_gains(&mut self, new: &Certified) -> Outcome {
        let (row, change) = new.change_from(&self.gains).unwrap_or(("no row of K", 0.0));
        let period_s = 1.0 / self.config.tick_rate_hz;
        let limit = self.config.margins.change_max;
        let error = if (new.period_s - period_s).abs() > 1e-9 {
            Some(GainsError::Period { certified_s: new.period_s, period_s })
        } else if self.armed() && change > limit {
            Some(GainsError::Jump { row, change, limit })
        } else {
            None
        };
        if let Some(error) = error {
            let refused = refusal(new.revision, &error);
            self.event(Severity::Warning, EventKind::Gains, refused);
            return Err(refused);
        }
        self.controller.replace(&new.law);
        let done = text(format_args!(
            "gains {} in use ({}): slowest pole {:.2} 1/s, largest change {:.0} % ({row})",
            new.revision.0,
            new.controller(),
            new.margins.slowest_pole_per_s,
            100.0 * change
        ));
        self.gains = new.clone();
        self.supervision.envelope = None;
        self.event(Severity::Info, EventKind::Gains, done);
        Ok(done)
    }
}

/// Does `estimate` hold what `mode` closes a loop on?
pub(super) fn can_fly(kind: EstimatorKind, estimate: &Estimate, mode: Mode) -> Result<(), Text> {
    let name = mode_name(mode);
    if matches!(mode, Mode::AltitudeHold | Mode::Hold | Mode::Land) && !estimate.altitude_known() {
        return Err(text(format_args!("{name} needs the altitude, which estimator {} does not know", kind.title())));
    }
    if mode == Mode::Hold && !estimate.horizontal_known() {
        return Err(text(format_args!(
            "{name} needs the horizontal position, which estimator {} does not know",
            kind.title()
        )));
    }
    Ok(())
}

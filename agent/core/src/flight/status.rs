//! The flight as a whole: pre-arm checks, status, gains in use.

use arrayvec::ArrayVec;
use plumbline_proto::ids::GainsRevision;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::report::MAX_CHECKS;
use super::{Check, EnvelopeDemand, Flight, FlightStatus, Phase, RigKind};
use crate::control::gains::Certified;
use crate::estimate::Health;
use crate::event::{EventKind, Severity, Text, text};
use crate::model::motor;
use crate::types::{Actuation, EstimatorKind};

/// Most tilt at arming, rad (15°); on a single axis the vehicle may lean as far as that lets it.
const TILT_MAX_RAD: f64 = 0.262;
/// Most body rate at arming, rad/s (30 °/s).
const RATE_MAX_RADPS: f64 = 0.524;
/// Least charge at arming, above the one that warns.
const CHARGE_RESERVE: f64 = 0.05;
/// The charge is averaged over this long, s: its voltage sags in every manoeuvre.
const CHARGE_TIME_CONSTANT_S: f64 = 1.0;
/// A voltage older than this says nothing of the charge, s.
const VOLTAGE_MAX_AGE_S: f64 = 3.0;
/// An IMU sample older than this is not fresh, s.
pub(super) const IMU_MAX_AGE_S: f64 = 0.1;

impl Flight {
    /// The pre-arm checks, each with its reason and value.
    pub fn checks(&self, now: FlightTime) -> ArrayVec<Check, MAX_CHECKS> {
        let mut out = ArrayVec::new();
        let mut check = |name: &'static str, passed: bool, reason: Text| {
            let _ = out.try_push(Check { name, passed, reason });
        };
        let estimate = self.bank.in_loop();
        let title = self.bank.in_loop_kind().title();
        check(
            "estimator",
            estimate.health == Health::Healthy,
            text(format_args!("{title} is {}", estimate.health.word())),
        );

        if self.has_box() {
            let known = if estimate.altitude_known() { "known" } else { "not known" };
            check(
                "altitude",
                estimate.altitude_known(),
                text(format_args!("{known} to {title}, which is in the loop")),
            );
        }

        if self.config.actuation == Actuation::Pose {
            let carries = self.guide().is_some();
            let known = if carries { "known" } else { "not known" };
            let line = text(format_args!("place {known} to {title}: an autopilot flies by it"));
            check("pose", carries, line);
        }

        let tilt = self.supervision.watchdog.tilt_rad();
        let tilt_max = if self.config.rig == RigKind::SingleAxis { 0.9 } else { TILT_MAX_RAD };
        let degrees = (tilt.to_degrees(), tilt_max.to_degrees());
        check("tilt", tilt <= tilt_max, text(format_args!("{:.1}°, at most {:.0}°", degrees.0, degrees.1)));

        let rate = self.supervision.watchdog.rates_radps().norm();
        let degrees = (rate.to_degrees(), RATE_MAX_RADPS.to_degrees());
        check(
            "still",
            rate <= RATE_MAX_RADPS,
            text(format_args!("turning {:.0} °/s, at most {:.0} °/s", degrees.0, degrees.1)),
        );

        let age = self.supervision.watchdog.imu_age_s(now);
        check("imu", age <= IMU_MAX_AGE_S, text(format_args!("last sample {age:.2} s ago, at most {IMU_MAX_AGE_S} s")));

        if let Some((count, silent)) = self.liveness.devices {
            check(
                "devices",
                silent.is_none(),
                silent.unwrap_or_else(|| text(format_args!("all {count} give readings"))),
            );
        }

        let heights = self.lasers();
        if heights > 0 {
            let fresh = self.supervision.watchdog.heights_fresh();
            check("height", fresh > 0, text(format_args!("{fresh} of {heights} lasers measured in the last 0.5 s")));
        }

        let (passed, line) = self.supervision.agreement.told(now);
        check("agreement", passed, line);

        match (self.liveness.battery, self.charge(now)) {
            (Some((_, v)), Some(charge)) => {
                let least = self.config.failsafe.battery_warn + CHARGE_RESERVE;
                let line = text(format_args!("{v:.2} V, {:.0} %, at least {:.0} %", 100.0 * charge, 100.0 * least));
                check("battery", charge >= least, line);
            }
            (Some((measured, _)), None) => {
                let age_s = now.seconds_since(measured);
                check("battery", false, text(format_args!("not measured any more, for {age_s:.0} s")));
            }
            (None, _) => check("battery", true, text(format_args!("not measured"))),
        }

        let link = self.link_age_s(now);
        let line =
            text(format_args!("last heartbeat {link:.2} s ago, at most {} s", self.config.failsafe.link_freeze_s));
        check("link", link <= self.config.failsafe.link_freeze_s, line);

        let (motion, side) = (estimate.motion_or_rest(), self.config.limits.lateral_max_m);
        let (z, most) = (motion.position_enu_m.z, self.config.altitude_max_m());
        // As in flight, what is measured has a veto beside the estimate.
        let estimated = motion.horizontal_known.then_some(motion.position_enu_m.xy().amax());
        let measured = (0..2).filter_map(|axis| self.supervision.watchdog.place(axis)).map(|(m, _)| m.abs());
        let outside = measured.chain(estimated).reduce(f64::max).filter(|aside| *aside > side);
        let mut line = text(format_args!("altitude {z:.2} m, at most {most:.2} m"));
        if let Some(aside) = outside {
            line = text(format_args!("{line}; {aside:.2} m aside, at most {side:.2} m"));
        }
        check("box", z <= most && outside.is_none(), line);

        match &self.liveness.log_error {
            None => check("log", true, text(format_args!("writing"))),
            Some(error) => check("log", false, *error),
        }
        if let Some(demand) = self.config.envelope {
            let (passed, line) = self.envelope_check(demand);
            check("envelope", passed, line);
        }
        check(
            "cut",
            !self.supervision.cut_latched,
            text(format_args!(
                "{}",
                if self.supervision.cut_latched { "motor cut latched: release it first" } else { "not latched" }
            )),
        );
        out
    }

    /// The flight as a whole.
    pub fn status(&self) -> FlightStatus {
        let now = self.report.sensed.time;
        let (checks, charge) = (self.checks(now), self.charge(now));
        FlightStatus {
            time: now,
            mode: self.mode,
            armed: self.armed(),
            cut_latched: self.supervision.cut_latched,
            failsafe: self.supervision.failsafe,
            failsafe_reason: self.supervision.failsafe_reason,
            disarms_in_s: self.disarms_in_s(now),
            ready_to_arm: !self.armed() && checks.iter().all(|c| c.passed),
            checks,
            battery_v: charge.and(self.liveness.battery).map(|(_, v)| v),
            battery_fraction: charge,
            estimator_in_loop: self.bank.in_loop_kind(),
            deadline_misses: self.liveness.deadline_misses,
            gains_revision: self.gains.revision,
        }
    }

    /// Bound of the attack envelope with the gains of `revision`, m: `None` where there is none; or why it is not known.
    /// A condition for arming where one is demanded.
    pub fn envelope_bounded(&mut self, revision: GainsRevision, bound_m: Result<Option<f64>, Text>) {
        if revision == self.gains.revision {
            self.supervision.envelope = Some(bound_m);
        }
    }

    /// Is the attack envelope of the gains in use as small as demanded?
    fn envelope_check(&self, demand: EnvelopeDemand) -> (bool, Text) {
        let kind = self.bank.in_loop_kind();
        let EnvelopeDemand { altitude_max_m, sensors, .. } = demand;
        let most_cm = 100.0 * altitude_max_m;
        match &self.supervision.envelope {
            _ if kind != EstimatorKind::Lanes => (
                false,
                text(format_args!(
                    "its bounds are those of {}, {} is in the loop",
                    EstimatorKind::Lanes.title(),
                    kind.title()
                )),
            ),
            None => (false, text(format_args!("not bounded yet for the gains in use"))),
            Some(Err(reason)) => (false, *reason),
            Some(Ok(None)) => {
                (false, text(format_args!("no bound with {sensors} sensors attacked, at most {most_cm:.1} cm asked")))
            }
            Some(Ok(Some(bound_m))) => {
                let line = text(format_args!(
                    "{sensors} sensors attacked move it {:.1} cm unseen, at most {most_cm:.1} cm",
                    100.0 * bound_m
                ));
                (*bound_m <= altitude_max_m, line)
            }
        }
    }

    /// Armed on the ground: it disarms itself for want of a take-off, or once it has landed.
    fn disarms_in_s(&self, now: FlightTime) -> Option<f64> {
        let settings = self.config.failsafe;
        let (since, limit_s) = match self.phase {
            _ if !self.armed() => return None,
            Phase::Idle { since } => (since, settings.takeoff_timeout_s),
            Phase::Landed { since } => (since, settings.landed_s),
            Phase::Flying => return None,
        };
        Some((limit_s - now.seconds_since(since)).max(0.0))
    }

    /// The gains in use.
    pub fn gains_in_use(&self) -> &Certified {
        &self.gains
    }

    /// Charge left, 0..1; `None` while it is not measured, or not any more.
    fn charge(&self, now: FlightTime) -> Option<f64> {
        let (measured, _) = self.liveness.battery?;
        self.liveness.charge.filter(|_| now.seconds_since(measured) <= VOLTAGE_MAX_AGE_S)
    }

    /// Follows the charge left: the voltage with the sag of what the motors draw taken out. Failsafes go on by the last that was known.
    pub(super) fn follow_charge(&mut self, now: FlightTime, dt_s: f64) {
        let Some((measured, voltage_v)) = self.liveness.battery else { return };
        let silent = now.seconds_since(measured) > VOLTAGE_MAX_AGE_S;
        if silent != std::mem::replace(&mut self.told.battery_silent, silent) && silent {
            let line = text(format_args!("battery not measured for {VOLTAGE_MAX_AGE_S} s: charge not known"));
            self.event(Severity::Warning, EventKind::Warning, line);
        }
        if silent {
            return;
        }
        let airframe = &self.config.airframe;
        let ratio = voltage_v / airframe.battery.nominal_v();
        let speeds = motor::steady_speed(airframe, &self.report.applied.throttle, ratio);
        let current_a = airframe.battery.current_a(airframe.induced_power_w(&speeds), voltage_v);
        let now = airframe.battery.charge_from_voltage(voltage_v, current_a);
        let before = self.liveness.charge.unwrap_or(now);
        self.liveness.charge = Some(before + (now - before) * (dt_s / (CHARGE_TIME_CONSTANT_S + dt_s)));
    }
}

/// Does a sensor of this kind tell an altitude?
pub(super) fn gives_altitude(kind: SensorKind) -> bool {
    matches!(kind, SensorKind::Height | SensorKind::Barometer | SensorKind::Gnss | SensorKind::MocapPose)
}

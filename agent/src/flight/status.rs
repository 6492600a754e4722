//! The flight as a whole: pre-arm checks, status, gains in use.

use arrayvec::ArrayVec;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::report::MAX_CHECKS;
use super::{Check, Flight, FlightStatus, RigKind};
use crate::control::gains::Certified;
use crate::estimate::Health;
use crate::event::{Text, text};
use crate::model::motor;

/// Most tilt at arming, rad (15°); on a single axis the vehicle may lean as far as that lets it.
const TILT_MAX_RAD: f64 = 0.262;
/// Most body rate at arming, rad/s (30 °/s).
const RATE_MAX_RADPS: f64 = 0.524;
/// Least charge at arming.
const CHARGE_MIN: f64 = 0.15;
/// An IMU sample older than this is not fresh, s.
const IMU_MAX_AGE_S: f64 = 0.1;

impl Flight {
    /// The pre-arm checks, each with its reason and value.
    pub fn checks(&self, now: FlightTime) -> ArrayVec<Check, MAX_CHECKS> {
        let mut out = ArrayVec::new();
        let mut check = |name: &'static str, passed: bool, reason: Text| {
            let _ = out.try_push(Check { name, passed, reason });
        };
        let estimate = self.bank.in_loop();
        let kind = self.bank.in_loop_kind();
        check("estimator", estimate.health == Health::Healthy, text(format_args!("{kind:?} is {:?}", estimate.health)));

        let tilt = self.watchdog.tilt_rad();
        let tilt_max = if self.config.rig == RigKind::SingleAxis { 0.9 } else { TILT_MAX_RAD };
        let degrees = (tilt.to_degrees(), tilt_max.to_degrees());
        check("tilt", tilt <= tilt_max, text(format_args!("{:.1}°, at most {:.0}°", degrees.0, degrees.1)));

        let rate = self.watchdog.rates_radps().norm();
        let degrees = (rate.to_degrees(), RATE_MAX_RADPS.to_degrees());
        check(
            "still",
            rate <= RATE_MAX_RADPS,
            text(format_args!("turning {:.0} °/s, at most {:.0} °/s", degrees.0, degrees.1)),
        );

        let age = self.watchdog.imu_time().map_or(f64::INFINITY, |t| now.seconds_since(t));
        check("imu", age <= IMU_MAX_AGE_S, text(format_args!("last sample {age:.2} s ago, at most {IMU_MAX_AGE_S} s")));

        let heights = self.config.sensors.iter().filter(|s| s.kind == SensorKind::Height).count();
        if heights > 0 {
            let fresh = self.watchdog.heights_fresh();
            check("height", fresh > 0, text(format_args!("{fresh} of {heights} lasers measured in the last 0.5 s")));
        }

        match self.battery_v {
            None => check("battery", true, text(format_args!("not measured"))),
            Some(v) => {
                let charge = self.charge(v);
                let line =
                    text(format_args!("{v:.2} V, {:.0} %, at least {:.0} %", 100.0 * charge, 100.0 * CHARGE_MIN));
                check("battery", charge >= CHARGE_MIN, line);
            }
        }

        let link = self.link_age_s(now);
        let line =
            text(format_args!("last heartbeat {link:.2} s ago, at most {} s", self.config.failsafe.link_freeze_s));
        check("link", link <= self.config.failsafe.link_freeze_s, line);

        let (z, most) = (estimate.position_enu_m.z, self.config.altitude_max_m());
        check("box", z <= most, text(format_args!("altitude {z:.2} m, at most {most:.2} m")));

        match &self.log_error {
            None => check("log", true, text(format_args!("writing"))),
            Some(error) => check("log", false, *error),
        }
        check(
            "cut",
            !self.cut_latched,
            text(format_args!(
                "{}",
                if self.cut_latched { "motor cut latched: release it first" } else { "not latched" }
            )),
        );
        out
    }

    /// The flight as a whole.
    pub fn status(&self) -> FlightStatus {
        let now = self.report.sensed.time;
        let checks = self.checks(now);
        FlightStatus {
            time: now,
            mode: self.mode,
            armed: self.armed(),
            cut_latched: self.cut_latched,
            failsafe: self.failsafe,
            failsafe_reason: self.failsafe_reason,
            ready_to_arm: !self.armed() && checks.iter().all(|c| c.passed),
            checks,
            battery_v: self.battery_v,
            battery_fraction: self.battery_v.map(|v| self.charge(v)),
            estimator_in_loop: self.bank.in_loop_kind(),
            deadline_misses: self.deadline_misses,
            gains_revision: self.gains.revision,
        }
    }

    /// The gains in use.
    pub fn gains_in_use(&self) -> &Certified {
        &self.gains
    }

    /// Charge left (0..1): the voltage with the sag of what the motors draw taken out.
    fn charge(&self, voltage_v: f64) -> f64 {
        let airframe = &self.config.airframe;
        let ratio = voltage_v / airframe.battery.nominal_v();
        let speeds = motor::steady_speed(airframe, &self.report.applied.throttle, ratio);
        let power_w = airframe.drag_torque_coefficient_nms2 * speeds.iter().map(|w| w * w * w).sum::<f64>();
        airframe.battery.charge_from_voltage(voltage_v, airframe.battery.current_a(power_w, voltage_v))
    }
}

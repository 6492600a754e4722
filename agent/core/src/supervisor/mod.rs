//! Supervisor: what the agent does by itself, whatever a browser or the ground says.
//!
//! | event | action |
//! |---|---|
//! | no authenticated heartbeat for 0.5 s | freeze the setpoint, abort attacks |
//! | for 2 s | descend at 0.3 m/s, then disarm |
//! | no sign of life of the operator, once given while armed, for 3 s | freeze the setpoint, abort attacks |
//! | for 10 s | descend, then disarm |
//! | no fresh IMU sample for 80 ms in flight | cut, latched |
//! | flight thread silent for 100 ms | cut, latched; the motors' own time-out has stopped them |
//! | tilt > 60° for 0.3 s, or rate > 1000 °/s | cut, latched |
//! | in flight, tilt > 10° more than may be asked for in this mode, by watchdog and estimator, for 0.5 s | cut, latched |
//! | about to leave the box, in any mode | take over with altitude control, hold at the edge, then descend |
//! | no height where the mode needs one | descend on attitude alone |
//! | no horizontal position in hold | altitude hold, then descend |
//! | estimator degraded for longer than `degraded_ticks` | descend on attitude alone (the watchdog's) |
//! | thrust commanded, vehicle not moving | descend |
//! | battery low / empty | warn / descend |
//! | K control ticks lost within a second | warn, then descend |
//! | a rotor gives too little to hover on / to come down on | descend / cut, latched |
//! | program asked to end, once / twice | descend / cut |
//!
//! Three parts: the [`Watchdog`] (tilt, rate and height without any estimator), the [`Monitor`] (which row applies now)
//! and `flight/guard.rs` (which acts on it). Before take-off [`Agreement`] holds sensors of a kind against each other. Time-outs of take-off and landing, and the operator's cut, are in `flight/`.

pub mod agreement;
pub mod monitor;
pub mod watchdog;

pub use agreement::Agreement;
pub use monitor::{Inputs, Monitor, severity};
pub use plumbline_proto::v1::Failsafe;
pub use watchdog::Watchdog;

use crate::control::setpoint::Limits;

/// Thresholds; the defaults are DESIGN's. Flat: one line for each threshold of the table above, as in the configuration.
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
    /// In flight, without a fresh IMU sample for this long the motors are cut, s.
    pub imu_silent_s: f64,
    /// After the flight thread was silent for this long the motors stay cut, s; their own time-out is the same.
    pub stall_cut_s: f64,
    /// Tilt that cuts the motors, rad.
    pub tilt_cut_rad: f64,
    /// After this long, s.
    pub tilt_cut_s: f64,
    /// Below this height, m …
    pub tilt_low_m: f64,
    /// … after this long already, s.
    pub tilt_low_s: f64,
    /// Tilt beyond the largest that may be asked for, rad, at which a vehicle in flight is out of control …
    pub tilt_beyond_rad: f64,
    /// … after this long, s.
    pub tilt_beyond_s: f64,
    /// Rate that cuts the motors, rad/s.
    pub rate_cut_radps: f64,
    /// How far outside the limits the box ends, m.
    pub box_margin_m: f64,
    /// Time at the edge before descending, s.
    pub box_hold_s: f64,
    /// In hold without a horizontal position for this long: descend, s.
    pub position_lost_s: f64,
    /// Ticks with a degraded estimator before descending on attitude alone; five times as many while
    /// the watchdog, which shares no state with it, agrees on the attitude and the climb.
    pub degraded_ticks: u32,
    /// Charge that warns, 0..1.
    pub battery_warn: f64,
    /// Charge that lands, 0..1: enough for a descent from the highest limit, and some more.
    pub battery_land: f64,
    /// The charge must be that low for this long, s: voltage sags in every manoeuvre.
    pub battery_s: f64,
    /// Thrust commanded without the motion it should give, for this long: descend, s.
    pub thrust_deficit_s: f64,
    /// Lost control ticks within a second that warn.
    pub deadline_warn: u32,
    /// Lost control ticks within a second that descend.
    pub deadline_descend: u32,
    /// Armed without take-off, s: disarm.
    pub takeoff_timeout_s: f64,
    /// Landed, s: disarm.
    pub landed_s: f64,
    /// Descent of a failsafe, m/s.
    pub descend_mps: f64,
    /// A descent on attitude alone ends with the motors off after this long, s, or later, once it sinks no more.
    pub blind_descend_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            link_freeze_s: 0.5,
            link_descend_s: 2.0,
            operator_freeze_s: 3.0,
            operator_descend_s: 10.0,
            imu_silent_s: 0.08,
            stall_cut_s: 0.1,
            tilt_cut_rad: 60.0_f64.to_radians(),
            tilt_cut_s: 0.3,
            tilt_low_m: 0.5,
            tilt_low_s: 0.1,
            tilt_beyond_rad: 10.0_f64.to_radians(),
            tilt_beyond_s: 0.5,
            rate_cut_radps: 1000.0_f64.to_radians(),
            box_margin_m: 0.3,
            box_hold_s: 2.0,
            position_lost_s: 5.0,
            degraded_ticks: 40,
            battery_warn: 0.25,
            battery_land: 0.15,
            battery_s: 3.0,
            thrust_deficit_s: 1.5,
            deadline_warn: 5,
            deadline_descend: 20,
            takeoff_timeout_s: 10.0,
            landed_s: 2.0,
            descend_mps: 0.3,
            blind_descend_s: 8.0,
        }
    }
}

/// Limits as they stand while a failsafe descends.
pub fn descent_limits(limits: &Limits, settings: &Settings) -> Limits {
    Limits { descent_max_mps: limits.descent_max_mps.min(settings.descend_mps), ..*limits }
}

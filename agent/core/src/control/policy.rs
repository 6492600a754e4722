//! What a loop must forgive before it may fly: a named policy of the agent's own configuration.

use super::gains::{GainsError, INPUT_NAMES};
use super::margins::Margins;

/// Limits of [`Margins`]; motor lag and one tick of delay are in the figures they are compared with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginPolicy {
    /// Name in reports; `custom` when a limit of a named one is changed.
    pub name: &'static str,
    /// The gain of each loop may rise by this factor at least.
    pub gain_up_min: f64,
    /// And fall to this one at least.
    pub gain_down_max: f64,
    /// Least phase margin of each loop, rad.
    pub phase_min_rad: f64,
    /// Least delay margin of each loop, s.
    pub delay_min_s: f64,
    /// Largest |S_ii|.
    pub sensitivity_max: f64,
    /// The slowest pole must decay at least this fast, 1/s.
    pub slowest_pole_per_s: f64,
    /// Largest ‖ΔK‖/‖K‖ of one row accepted while armed.
    pub change_max: f64,
    /// Largest share of the actuators' room that a unit step may ask for, uncut.
    pub unit_step_max: f64,
}

impl MarginPolicy {
    /// For everyday flying: 1.8 up, 0.6 down, 20°, 15 ms. The default of every controller keeps it on every airframe
    /// at 100 Hz and more, and on the Iris at 50 Hz; a thousand random LQR designs with weights within a factor of four
    /// of the default keep 2.7, 27° and a peak of 2.3 at 200 Hz (`bench control`).
    pub const STANDARD: Self = Self {
        name: "standard",
        gain_up_min: 1.8,
        gain_down_max: 0.6,
        phase_min_rad: 0.35,
        delay_min_s: 0.015,
        sensitivity_max: 3.1,
        slowest_pole_per_s: -0.02,
        change_max: 4.0,
        unit_step_max: 60.0,
    };
    /// For a vehicle near people: 2 either way, 35°, 15 ms.
    pub const CAREFUL: Self = Self {
        name: "careful",
        gain_up_min: 2.0,
        gain_down_max: 0.5,
        phase_min_rad: 0.61,
        delay_min_s: 0.015,
        sensitivity_max: 2.0,
        slowest_pole_per_s: -0.05,
        change_max: 1.0,
        unit_step_max: 30.0,
    };
    /// For the simulator and the strings: stable with lag and delay is enough, and 5° to spare.
    pub const EXPERIMENTAL: Self = Self {
        name: "experimental",
        gain_up_min: 1.1,
        gain_down_max: 0.95,
        phase_min_rad: 0.08,
        delay_min_s: 0.001,
        sensitivity_max: 15.0,
        slowest_pole_per_s: -0.005,
        change_max: 20.0,
        unit_step_max: 1000.0,
    };

    /// The policy called `name`.
    pub fn by_name(name: &str) -> Option<Self> {
        [Self::STANDARD, Self::CAREFUL, Self::EXPERIMENTAL].into_iter().find(|policy| policy.name == name)
    }

    /// Judges the `margins` of the loop `what` (`position` or `attitude`).
    ///
    /// # Errors
    /// The first figure that breaks a limit, with both numbers.
    pub fn judge(&self, what: &'static str, margins: &Margins) -> Result<(), GainsError> {
        let pole_per_s = margins.slowest_pole_per_s;
        if pole_per_s.is_nan() || pole_per_s > self.slowest_pole_per_s {
            return Err(GainsError::Unstable { what, pole_per_s, limit: self.slowest_pole_per_s });
        }
        for (input, found) in INPUT_NAMES.into_iter().zip(&margins.loops) {
            let limits = [
                ("gain margin up", found.gain_up, self.gain_up_min, true, ""),
                ("gain margin down", found.gain_down, self.gain_down_max, false, ""),
                ("phase margin", found.phase_rad.to_degrees(), self.phase_min_rad.to_degrees(), true, "°"),
                ("delay margin", 1e3 * found.delay_s, 1e3 * self.delay_min_s, true, " ms"),
                ("peak sensitivity", found.peak_sensitivity, self.sensitivity_max, false, ""),
            ];
            for (margin, value, limit, least, unit) in limits {
                if value.is_nan() || (least && value < limit) || (!least && value > limit) {
                    let side = if least { "at least" } else { "at most" };
                    return Err(GainsError::Margin {
                        what,
                        input,
                        margin,
                        value,
                        limit,
                        side,
                        unit,
                        policy: self.name,
                    });
                }
            }
        }
        Ok(())
    }
}

impl Default for MarginPolicy {
    fn default() -> Self {
        Self::STANDARD
    }
}

//! What is known of a vehicle in a lab or on strings without any sensor: on average it goes nowhere, and not far.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

/// How fast it may be going, one-sigma, m/s …
pub const VELOCITY_SIGMA_MPS: f64 = 0.5;
/// … for how long at a time, s …
pub const VELOCITY_CORRELATION_S: f64 = 2.0;
/// … and how far from where it was last known, one-sigma, m …
pub const POSITION_SIGMA_M: f64 = 5.0;
/// … for how long at a time, s.
pub const POSITION_CORRELATION_S: f64 = 10.0;
/// How far a vehicle that stands may be from where it stood when it began to, one-sigma, m.
pub const STANDING_SIGMA_M: f64 = 0.05;
/// Yaw without magnetometer and motion capture, one-sigma at start, rad. There yaw 0 is where the vehicle pointed at
/// start, unless GNSS says better.
pub const UNKNOWN_YAW_SIGMA_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Period of the pseudo-measurements, s.
const PERIOD_S: f64 = 0.1;

/// When pseudo-measurements were taken last, and about which place.
#[derive(Debug, Clone, Copy, Default)]
pub struct Idle {
    last: Option<FlightTime>,
    /// Where the position was last known, ENU, m.
    pub anchor: Vector3<f64>,
}

impl Idle {
    /// Is the next one due? Then the time since the last one, s.
    pub fn due(&mut self, now: FlightTime) -> Option<f64> {
        if self.last.is_some_and(|t| now.seconds_since(t) < PERIOD_S - 1e-4) {
            return None;
        }
        let since_s = self.last.map_or(PERIOD_S, |t| now.seconds_since(t).min(1.0));
        self.last = Some(now);
        Some(since_s)
    }
}

/// Factor on the variance of what is correlated over `tau_s` and taken every `since_s`, to be as informative as white noise.
pub fn whitening(tau_s: f64, since_s: f64) -> f64 {
    (2.0 * tau_s / since_s).max(1.0)
}

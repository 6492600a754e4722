//! Two clocks that must not be mixed up.
use std::fmt;
use std::ops::{Add, Sub};
use std::time::Duration;

/// Microseconds since the agent's boot. The only time the flight code knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct FlightTime(pub u64);

impl FlightTime {
    /// From seconds since boot; negative and non-finite values become zero.
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * 1e6).round().max(0.0) as u64)
    }

    /// Seconds since boot.
    pub fn as_seconds(self) -> f64 {
        self.0 as f64 * 1e-6
    }

    /// Seconds from `earlier` to `self`; negative when `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-6
    }
}

impl Add<Duration> for FlightTime {
    type Output = Self;
    fn add(self, rhs: Duration) -> Self {
        Self(self.0.saturating_add(rhs.as_micros() as u64))
    }
}

impl Sub for FlightTime {
    type Output = Duration;
    /// Saturates at zero.
    fn sub(self, rhs: Self) -> Duration {
        Duration::from_micros(self.0.saturating_sub(rhs.0))
    }
}

impl fmt::Display for FlightTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6} s", self.as_seconds())
    }
}

/// Microseconds since the Unix epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct WallTime(pub u64);

impl WallTime {
    /// The wall time of `flight_time` for an agent that booted at `self`.
    pub fn at(self, flight_time: FlightTime) -> Self {
        Self(self.0.saturating_add(flight_time.0))
    }

    /// Nanoseconds since the epoch, as MCAP wants them.
    pub fn as_nanos(self) -> u64 {
        self.0.saturating_mul(1000)
    }

    /// Year, month, day and hour, minute, second, UTC.
    /// Days to date after Howard Hinnant, "chrono-compatible low-level date algorithms".
    pub fn utc(self) -> ((u64, u64, u64), (u64, u64, u64)) {
        let unix_s = self.0 / 1_000_000;
        let (days, second) = (unix_s / 86_400, unix_s % 86_400);
        let z = days + 719_468;
        let (era, doe) = (z / 146_097, z % 146_097);
        let yoe = (doe - doe / 1_460 + doe / 36_524 - doe / 146_096) / 365;
        let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
        let mp = (5 * doy + 2) / 153;
        let day = doy - (153 * mp + 2) / 5 + 1;
        let month = if mp < 10 { mp + 3 } else { mp - 9 };
        let year = yoe + era * 400 + u64::from(month <= 2);
        ((year, month, day), (second / 3600, second / 60 % 60, second % 60))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        for (unix_s, date, time) in [
            (0, (1970, 1, 1), (0, 0, 0)),
            (951_782_399, (2000, 2, 28), (23, 59, 59)),
            (951_782_400, (2000, 2, 29), (0, 0, 0)),
            (1_795_262_400, (2026, 11, 21), (12, 0, 0)),
        ] {
            assert_eq!(WallTime(unix_s * 1_000_000).utc(), (date, time), "{unix_s} s");
        }
    }
}

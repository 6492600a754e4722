//! Two-sided CUSUM (Page 1954): slow deviations, summed up.
//!
//! S⁺ ← max(0, S⁺ + e − k) and S⁻ ← max(0, S⁻ − e − k) with e in sigmas of one value.

/// Slack k of a CUSUM, in sigmas of one value.
const CUSUM_SLACK: f64 = 0.75;
/// Below this part of its limit a CUSUM is where noise takes it.
const CALM_RATIO: f64 = 0.125;
/// Part of its limit from which the sensor is in doubt: where several measure the same, going without one for a moment
/// costs less than an attack that is not yet certain.
pub(super) const DOUBT: f64 = 0.3;
/// Limit of a CUSUM, in sigmas: a mean time between false alarms of weeks for independent values (Wald:
/// exp(2 k h) / 2 k² values).
pub const CUSUM_LIMIT: f64 = 16.0;

/// Cumulative sums in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cusum {
    up: f64,
    down: f64,
    /// Values since each was last zero: Page's estimate of how long the drift has lasted.
    up_for: u32,
    down_for: u32,
}

impl Cusum {
    /// Takes one deviation, in sigmas; what is not finite is skipped.
    pub fn take(&mut self, deviation: f64) {
        if deviation.is_finite() {
            // A single outlier is found by the window's test; a cap lets the sum fall again when the attack ends.
            let d = deviation.clamp(-4.0, 4.0);
            let sum = |before: f64, d: f64| (before + d - CUSUM_SLACK).clamp(0.0, 1.5 * CUSUM_LIMIT);
            (self.up, self.down) = (sum(self.up, d), sum(self.down, -d));
            let length = |before: u32, sum: f64| if sum > 0.0 { before.saturating_add(1) } else { 0 };
            (self.up_for, self.down_for) = (length(self.up_for, self.up), length(self.down_for, self.down));
        }
    }

    /// Is it so large that its sensor is in doubt?
    pub fn is_in_doubt(&self) -> bool {
        self.ratio() > DOUBT
    }

    /// Is it where noise alone takes it?
    pub fn is_calm(&self) -> bool {
        self.ratio() < CALM_RATIO
    }

    /// The larger sum over its limit.
    pub fn ratio(&self) -> f64 {
        self.up.max(self.down) / CUSUM_LIMIT
    }

    /// Values since the larger sum was zero.
    pub fn lasts(&self) -> u32 {
        if self.up > self.down { self.up_for } else { self.down_for }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cusum_rises_for_a_drift_and_not_for_noise() {
        let mut cusum = Cusum::default();
        for k in 0..20_000_u32 {
            // Bounded pseudo-noise of unit variance.
            cusum.take(1.414 * (f64::from(k * k % 9973) * 0.7).sin());
            assert!(cusum.ratio() < 1.0, "at {k}");
        }
        let mut taken = 0;
        while cusum.ratio() <= 1.0 && taken < 1000 {
            cusum.take(1.5 + 1.414 * (f64::from(taken * taken % 997) * 0.7).sin());
            taken += 1;
        }
        assert!(taken < 60, "{taken}");
        cusum.take(f64::NAN);
        assert!(cusum.ratio().is_finite());
    }
}

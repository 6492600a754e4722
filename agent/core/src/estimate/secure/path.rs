//! The filter's own vertical path without its corrections, from which the window counts; and the rule that brings
//! filter and decoder together again.

use nalgebra::SVector;

use super::model::{STATES, ix};
use crate::estimate::Estimate;

/// Height decoded further than this from the filter …
const RESET_M: f64 = 0.06;
/// … in so many windows in a row resets the filter to it: 0.6 s.
const RESET_WINDOWS: u32 = 15;

/// How far the path that the IMUs alone would have continued since the slot began is below the filter.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Path {
    /// Corrections of the filter already taken, m and m/s.
    corrections: (f64, f64),
    /// Distance and its rate, m and m/s.
    below: (f64, f64),
}

impl Path {
    /// Begins where the filter, with these sums of `corrections`, is.
    pub fn begin(&mut self, corrections: (f64, f64)) {
        (self.corrections, self.below) = (corrections, (0.0, 0.0));
    }

    /// `dt_s` later the filter's corrections sum up to these.
    pub fn follow(&mut self, corrections: (f64, f64), dt_s: f64) {
        let (dz, dv) = (corrections.0 - self.corrections.0, corrections.1 - self.corrections.1);
        self.corrections = corrections;
        self.below.0 += self.below.1 * dt_s + dz;
        self.below.1 += dv;
    }

    /// Distance, m.
    pub fn below_m(&self) -> f64 {
        self.below.0
    }

    /// The next slot counts from the filter: where that is in the window's states.
    pub fn rebase(&mut self) -> SVector<f64, STATES> {
        let mut by = SVector::zeros();
        (by[ix::Z], by[ix::VZ]) = std::mem::take(&mut self.below);
        by
    }
}

/// The reset rule: a filter that diverges from a decoder which has a majority is moved to it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ResetRule {
    diverged: u32,
    resets: u32,
}

impl ResetRule {
    /// Windows count anew.
    pub fn restart(&mut self) {
        self.diverged = 0;
    }

    /// Resets so far.
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// The decoded state is `x` away from `estimate`, with the height certain to `bound_m`: where the filter is to begin
    /// again, if it has diverged for long.
    pub fn take(&mut self, x: &SVector<f64, STATES>, bound_m: Option<f64>, estimate: &Estimate) -> Option<Estimate> {
        let limit = bound_m.map_or(f64::INFINITY, |bound| bound.max(RESET_M));
        self.diverged = if x[ix::Z].abs() > limit { self.diverged + 1 } else { 0 };
        if self.diverged < RESET_WINDOWS {
            return None;
        }
        self.diverged = 0;
        self.resets += 1;
        let mut to = estimate.clone();
        let motion = to.motion.get_or_insert_default();
        motion.position_enu_m.z += x[ix::Z];
        motion.velocity_enu_mps.z += x[ix::VZ];
        motion.position_sigma_m.get_or_insert_default().z = bound_m.unwrap_or(0.1);
        motion.velocity_sigma_mps.get_or_insert_default().z = 0.2;
        Some(to)
    }
}

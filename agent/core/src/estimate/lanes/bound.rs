//! How far the altitude can be off while fewer than half of the lasers are attacked, and what that takes for granted.
//!
//! n lasers are there, f of them excluded, q = ⌊(n − 1)/2⌋ may be attacked: u = q − f of those in use without having been
//! noticed. What moves the altitude z and stays unseen by `heights.rs`:
//!
//! | part | most, m |
//! |---|---|
//! | offsets and scales learned of q lasers, about the mean of all | (o + s·\|z − z₀\|)·q/(n − q) |
//! | a deviation from the centre just where a laser begins to count less (2.2 σ), of u of m = n − f in use | 2.2 σ·u/(m − u) |
//! | noise: that of the filter, and what healthy lasers are off by for long | z₉₉₉·√(P_zz + σ_h²/(n − q)) |
//!
//! The bound is their sum. It takes for granted that healthy lasers are as their data sheet says, that no more than q are
//! attacked, and that the accelerations brought in since are right; it is checked against the truth in simulated flights.

use plumbline_proto::v1::SensorKind;

use super::Lanes;
use super::heights::{OFFSET_MAX_M, PIVOT_M, SCALE_MAX, SIGMA_M, SOFT};
use crate::estimate::Health;
use crate::estimate::ekf_bias::covariance::ix;
use crate::estimate::fdir::isolation::Z_999;

/// Without a height used for so long nothing is promised, s.
const USED_S: f64 = 0.5;

impl Lanes {
    /// Most that the altitude is off by, m, while fewer than half of the lasers are attacked; `None` where nothing is
    /// promised: fewer than three lasers, no majority among them, heights unused, estimate degraded. See the module.
    pub fn height_bound_m(&self) -> Option<f64> {
        let margin = self.isolation.margin(SensorKind::Height);
        let (n, excluded) = (margin.present, margin.flagged);
        let attacked = n.saturating_sub(1) / 2;
        let now = self.clock.now?;
        let split = &self.judges.heights.split;
        let used = self.aided.heights.within(now, USED_S) && !split.is_open() && !split.is_contradicted();
        if attacked == 0 || excluded > attacked || !used || self.estimate.health != Health::Healthy {
            return None;
        }
        let (unseen, in_use) = (attacked - excluded, n - excluded);
        let part = |q: usize, m: usize| q as f64 / (m - q) as f64;
        let learned_m = OFFSET_MAX_M + SCALE_MAX * (self.fused.at.position_enu_m.z - PIVOT_M).abs();
        let variance = self.lanes[self.fused.best].p[(ix::POSITION + 2, ix::POSITION + 2)].max(0.0)
            + self.model.heights.sigma.powi(2) / (n - attacked) as f64;
        let [_, sigma_m] = SIGMA_M;
        Some(learned_m * part(attacked, n) + SOFT * sigma_m * part(unseen, in_use) + Z_999 * variance.sqrt())
    }
}

//! The magnetometer: gate, what a disturbance makes uncertain, and the correction.
//!
//! ```text
//! m' = m − m_b     c = ω × m'     y = R (m' − τ c)     y − h = θ × y − R δm_b − R c δτ − δh + noise
//! ```
//! A field that does not fit is weighed down, and meanwhile hard iron and field become uncertain: iron on the vehicle
//! ends up in m_b, which turns with it, and another place in h, which does not.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::covariance::{Covariance, ErrorState, N, ix};
use super::{State, correct_scalar};
use crate::frames::skew;

/// Magnetometer, one-sigma, µT …
const SIGMA_UT: f64 = 3.2;
/// … correlated over this, s.
const CORRELATION_S: f64 = 1.0;
/// Gate of the Mahalanobis distance d …
const GATE: f64 = 1.75;
/// … whose covariance has this much noise, µT …
const GATE_SIGMA_UT: f64 = 1.5;
/// … beyond which the least weight is this.
const WEIGHT_MIN: f64 = 0.01;
/// Each second beyond the gate makes hard iron this uncertain, µT …
const HARD_IRON_DISTURBED_UT: f64 = 4.0;
/// … the field this …
const FIELD_DISTURBED_UT: f64 = 0.3;
/// … or, until it has fitted for long, this …
const FIELD_UNSETTLED_UT: f64 = 6.0;
/// … up to this.
const DISTURBED_MAX_UT: f64 = 40.0;
/// The field has to fit for so long before it is settled, s; each second beyond the gate takes off two.
const SETTLED_S: f64 = 10.0;

/// The gate.
#[derive(Debug, Clone, Default)]
pub(super) struct Gate {
    /// For how long the field has fitted.
    fitting_s: f64,
    disturbed: bool,
    /// y.
    measured_ut: Vector3<f64>,
}

impl Gate {
    /// Was the last field beyond it?
    pub fn disturbed(&self) -> bool {
        self.disturbed
    }

    /// The last field in L, lag and hard iron removed, µT.
    pub fn measured_ut(&self) -> &Vector3<f64> {
        &self.measured_ut
    }

    /// Corrects `p` and `x` by the magnetometer sample `field`, which stands for `t` seconds; R and ω are those of now.
    pub fn correct(
        &mut self,
        p: &mut Covariance,
        x: &mut ErrorState,
        state: &State,
        (rotation, rate): (&Matrix3<f64>, &Vector3<f64>),
        field: &Vector3<f64>,
        t: f64,
    ) {
        let iron_free = field - state.hard_iron_ut;
        let change = rate.cross(&iron_free);
        let y = rotation * (iron_free - state.lag_s * change);
        let innovation = state.field_ut - y;

        let mut h = SMatrix::<f64, 3, N>::zeros();
        // θ × y = −[y]× θ, and θ_z = 0.
        h.fixed_view_mut::<3, 2>(0, ix::TILT).copy_from(&(-skew(&y)).fixed_columns::<2>(0));
        h.fixed_view_mut::<3, 3>(0, ix::HARD_IRON).copy_from(&-rotation);
        h.fixed_view_mut::<3, 1>(0, ix::LAG).copy_from(&-(rotation * change));
        h.fixed_view_mut::<3, 3>(0, ix::FIELD).copy_from(&-Matrix3::identity());

        let weight = self.weigh(p, &h, &innovation, t);
        self.measured_ut = y;
        let r = 2.0 * SIGMA_UT.powi(2) * CORRELATION_S / (t * weight);
        for i in 0..3 {
            correct_scalar(p, x, &h.row(i).transpose(), innovation[i], r, ix::GYRO_BIAS);
        }
    }

    /// Weight of a sample of this `innovation`; a disturbed one makes hard iron and field uncertain.
    fn weigh(&mut self, p: &mut Covariance, h: &SMatrix<f64, 3, N>, innovation: &Vector3<f64>, t: f64) -> f64 {
        let s = h * *p * h.transpose() + Matrix3::identity() * GATE_SIGMA_UT.powi(2);
        let distance = s.cholesky().map_or(f64::INFINITY, |s| innovation.dot(&s.solve(innovation)));
        let gate = GATE * GATE;
        self.disturbed = distance > gate;
        if !self.disturbed {
            self.fitting_s += t;
            return 1.0;
        }
        let mut walk = FIELD_DISTURBED_UT;
        if self.fitting_s < SETTLED_S {
            self.fitting_s = (self.fitting_s - 2.0 * t).max(0.0);
            walk = FIELD_UNSETTLED_UT;
        }
        for i in 0..3 {
            for (place, walk) in [(ix::HARD_IRON + i, HARD_IRON_DISTURBED_UT), (ix::FIELD + i, walk)] {
                let variance = &mut p[(place, place)];
                *variance = (*variance + t * walk * walk).min(DISTURBED_MAX_UT.powi(2));
            }
        }
        (gate / distance).powi(2).max(WEIGHT_MIN)
    }
}

//! One scalar correction of a Kalman filter: innovation, gate, residual, update.

use nalgebra::{SMatrix, SVector};
use plumbline_proto::ids::SensorId;

use super::kalman;
use crate::estimate::{Channel, Residual, Residuals};

/// A scalar measurement, linearised: y − ŷ = h δx + noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarRow<const N: usize> {
    /// Whose, and which of its scalars; a pseudo-measurement is no sensor's, leaves no residual and has no gate.
    pub of: Option<(SensorId, Channel)>,
    /// y − ŷ, angles wrapped.
    pub innovation: f64,
    /// h, its row of H.
    pub h: SVector<f64, N>,
    /// r, variance of the noise.
    pub variance: f64,
    /// Gate in sigmas of the innovation; infinite for none.
    pub gate: f64,
    /// Rejected for a reason of its own, whatever the gate says.
    pub refused: bool,
}

impl<const N: usize> ScalarRow<N> {
    /// A pseudo-measurement of state `i`: what is known without a sensor. It has no gate.
    pub fn pseudo(i: usize, innovation: f64, variance: f64) -> Self {
        let mut h = SVector::zeros();
        h[i] = 1.0;
        Self { of: None, innovation, h, variance, gate: f64::INFINITY, refused: false }
    }

    /// Corrects `p` and returns the correction δx = k (y − ŷ) of the state; `None` where the row is rejected or not
    /// finite. A finite one leaves its residual either way.
    #[must_use]
    pub fn correct(&self, p: &mut SMatrix<f64, N, N>, residuals: &mut Residuals) -> Option<SVector<f64, N>> {
        let (ph, s) = self.predicted(p)?;
        let accepted = !self.refused && self.innovation.abs() <= self.gate * s.sqrt();
        self.leave(s, accepted, residuals);
        accepted.then(|| self.update(p, &ph, s, 0.0))
    }

    /// As [`Self::correct`], but no gate rejects: beyond `knee` sigmas the noise counts as larger, so that the correction
    /// grows no further than with the square root of the innovation (after Huber 1964). Beside δx, the squared ratio
    /// (y − ŷ)² / s.
    #[must_use]
    pub fn correct_robustly(
        &self,
        knee: f64,
        p: &mut SMatrix<f64, N, N>,
        residuals: &mut Residuals,
    ) -> Option<(SVector<f64, N>, f64)> {
        let (ph, s) = self.predicted(p)?;
        self.leave(s, !self.refused, residuals);
        let ratio = self.innovation.abs() / s.sqrt();
        let widened = s * (ratio / knee - 1.0).max(0.0);
        (!self.refused).then(|| (self.update(p, &ph, s, widened), ratio * ratio))
    }

    /// As [`Self::correct_robustly`], with the gate as the knee and r alone as what grows: where the state is uncertain, what
    /// is far off still moves it far.
    #[must_use]
    pub fn correct_past_gate(&self, p: &mut SMatrix<f64, N, N>, residuals: &mut Residuals) -> Option<SVector<f64, N>> {
        let (ph, s) = self.predicted(p)?;
        self.leave(s, !self.refused, residuals);
        let widened = self.variance * (self.innovation.abs() / (self.gate * s.sqrt()) - 1.0).max(0.0);
        (!self.refused).then(|| self.update(p, &ph, s, widened))
    }

    /// P hᵀ and s, where the row is finite.
    fn predicted(&self, p: &SMatrix<f64, N, N>) -> Option<(SVector<f64, N>, f64)> {
        let (ph, s) = kalman::innovation_variance(p, &self.h, self.variance);
        (self.innovation.is_finite() && s.is_finite() && s > 0.0).then_some((ph, s))
    }

    fn leave(&self, s: f64, accepted: bool, residuals: &mut Residuals) {
        if let Some((sensor, channel)) = self.of {
            let residual = Residual::gated(sensor, channel, self.innovation, s.sqrt(), self.gate);
            let _ = residuals.try_push(Residual { accepted, ..residual });
        }
    }

    fn update(&self, p: &mut SMatrix<f64, N, N>, ph: &SVector<f64, N>, s: f64, widened: f64) -> SVector<f64, N> {
        let k = ph / (s + widened);
        kalman::correct_scalar(p, &self.h, self.variance + widened, &k);
        k * self.innovation
    }
}

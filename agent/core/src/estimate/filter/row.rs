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
    /// The states it corrects, where not all of them; the others are left alone, and P is what it is then (Schmidt 1966).
    pub corrects: Option<&'static [usize]>,
}

impl<const N: usize> ScalarRow<N> {
    /// No sensor's, without a gate; it corrects all states.
    pub fn new(innovation: f64, h: SVector<f64, N>, variance: f64) -> Self {
        Self { of: None, innovation, h, variance, gate: f64::INFINITY, refused: false, corrects: None }
    }

    /// A pseudo-measurement of state `i`: what is known without a sensor. It has no gate.
    pub fn pseudo(i: usize, innovation: f64, variance: f64) -> Self {
        let mut h = SVector::zeros();
        h[i] = 1.0;
        Self::new(innovation, h, variance)
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
        let mut k = ph / (s + widened);
        if let Some(corrects) = self.corrects {
            (0..N).filter(|i| !corrects.contains(i)).for_each(|i| k[i] = 0.0);
        }
        kalman::correct_scalar(p, &self.h, self.variance + widened, &k);
        k * self.innovation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// GIVEN a row that corrects the first of two states that err together WHEN it corrects THEN the other stays, P is that of the gain
    /// taken, and no smaller than with the best one.
    #[test]
    fn a_state_that_a_row_leaves_alone_keeps_its_variance() {
        let before = SMatrix::<f64, 2, 2>::new(4.0, 1.5, 1.5, 1.0);
        let h = SVector::<f64, 2>::new(1.0, 0.0);
        let all = ScalarRow { gate: 3.0, ..ScalarRow::new(2.0, h, 0.5) };
        let corrected = |row: ScalarRow<2>| {
            let mut p = before;
            let dx = row.correct(&mut p, &mut Residuals::new()).unwrap();
            (dx, p)
        };
        let (best, smallest) = corrected(all);
        let (dx, p) = corrected(ScalarRow { corrects: Some(&[0]), ..all });
        assert_eq!(dx, SVector::<f64, 2>::new(best[0], 0.0));
        assert!(best[1] > 0.5 && (p[(0, 0)] - smallest[(0, 0)]).abs() < 1e-12);
        assert_eq!(p[(1, 1)], before[(1, 1)]);
        assert!((p - smallest).symmetric_eigenvalues().min() > -1e-12 && p.symmetric_eigenvalues().min() > 0.0);
    }
}

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

    /// The same with Huber's weight in the place of the gate: beyond it the noise grows with the innovation, so that what
    /// the row adds to the state grows no further, but is not lost.
    #[must_use]
    pub fn huber(self, p: &SMatrix<f64, N, N>) -> Self {
        let (_, s) = kalman::innovation_variance(p, &self.h, self.variance);
        let beyond = self.innovation.abs() / (self.gate * s.sqrt());
        if beyond > 1.0 { Self { variance: self.variance * beyond, gate: f64::INFINITY, ..self } } else { self }
    }

    /// Corrects `p` and returns the correction δx = k (y − ŷ) of the state; `None` where the row is rejected or not
    /// finite. A finite one leaves its residual either way.
    #[must_use]
    pub fn correct(&self, p: &mut SMatrix<f64, N, N>, residuals: &mut Residuals) -> Option<SVector<f64, N>> {
        let (ph, s) = kalman::innovation_variance(p, &self.h, self.variance);
        if !(self.innovation.is_finite() && s.is_finite() && s > 0.0) {
            return None;
        }
        let sigma = s.sqrt();
        let accepted = !self.refused && self.innovation.abs() <= self.gate * sigma;
        if let Some((sensor, channel)) = self.of {
            let residual = Residual::gated(sensor, channel, self.innovation, sigma, self.gate);
            let _ = residuals.try_push(Residual { accepted, ..residual });
        }
        if !accepted {
            return None;
        }
        let k = ph / s;
        kalman::correct_scalar(p, &self.h, self.variance, &k);
        Some(k * self.innovation)
    }
}

//! Hybrid extended Kalman filter: continuous propagation, discrete update (\[Umasankar\] Algorithm 1).
//!
//! | symbol | meaning |
//! |---|---|
//! | x̂, P | the twelve states of [`EulerBody`] and their covariance |
//! | Φ, Q_d | transition and process noise of one step of h |
//! | y, h(x), H, R | measurements of one instant, prediction, Jacobian, noise |
//!
//! Deviations from \[Umasankar\] Alg. 1 (ERRATA 7): P ← ΦPΦᵀ + Q_d instead of P + dt(AP + PAᵀ + Q), which
//! loses positivity; line 14 adds K R Kᵀ, not R. Rows are taken one at a time against one linearisation,
//! which equals the batch update for uncorrelated noise and gives every scalar its own gate.

use super::kalman;
use super::measurement::{Measurement, TwelveState};
use crate::estimate::{EstimatorKind, Residuals};
use crate::model::euler_body::{EulerBody, Input, M, X};

/// State, covariance and model.
#[derive(Debug, Clone)]
pub struct EkfHybrid {
    /// The model.
    pub body: EulerBody,
    /// x̂.
    pub x: X,
    /// P.
    pub p: M,
}

impl TwelveState for EkfHybrid {
    const KIND: EstimatorKind = EstimatorKind::EkfHybrid;

    fn new(body: EulerBody, x: X, p: M) -> Self {
        Self { body, x, p }
    }

    fn restart(&mut self, x: X, p: M) {
        (self.x, self.p) = (x, p);
    }

    /// Alg. 1, lines 6–11.
    fn predict(&mut self, u: &impl Input, h: f64, q: &M) {
        let u = &u.action(&self.body);
        let next = self.body.step(&self.x, u, h);
        let phi = self.body.transition(&self.x, &next, u, h);
        self.p = kalman::predict(&self.p, &phi, q);
        self.x = next;
    }

    /// Alg. 1, lines 10–14.
    fn correct(&mut self, rows: &[Measurement], residuals: &mut Residuals) {
        let predicted = self.x;
        for row in rows {
            if let Some(dx) = row.row(&predicted, &self.x).correct(&mut self.p, residuals) {
                self.x += dx;
            }
        }
    }

    fn moments(&self) -> (X, M) {
        (self.x, self.p)
    }
}

#[cfg(test)]
mod tests {
    use super::super::mocap_recipe::{self, Golden};
    use super::*;

    #[test]
    fn equals_the_independent_reference() {
        mocap_recipe::check("ekf", || EkfHybrid::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6));
    }

    #[test]
    fn p_stays_symmetric_and_positive_at_one_hertz() {
        let Some(golden) = Golden::load() else { return };
        let mut filter = EkfHybrid::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
        mocap_recipe::run(&golden.log("circle"), 1, &mut filter);
        assert_eq!(filter.p, filter.p.transpose());
        assert!(filter.p.symmetric_eigenvalues().min() > 0.0);
    }
}

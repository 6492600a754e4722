//! Hybrid extended Kalman filter: continuous propagation, discrete update ([Umasankar] Algorithm 1).
//!
//! | symbol | meaning |
//! |---|---|
//! | x̂, P | the twelve states of [`EulerBody`] and their covariance |
//! | Φ, Q_d | transition and process noise of one step of h |
//! | y, h(x), H, R | measurements of one instant, prediction, Jacobian, noise |
//!
//! Deviations from [Umasankar] Alg. 1 (ERRATA 7): P ← ΦPΦᵀ + Q_d instead of P + dt(AP + PAᵀ + Q), which
//! loses positivity; line 14 adds K R Kᵀ, not R. Rows are taken one at a time against one linearisation,
//! which equals the batch update for uncorrelated noise and gives every scalar its own gate.

use arrayvec::ArrayVec;

use super::kalman;
use super::scalar_row::ScalarRow;
use super::{MAX_RESIDUALS, Residual};
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

impl EkfHybrid {
    /// Starts at `x` with covariance `p`.
    pub fn new(body: EulerBody, x: X, p: M) -> Self {
        Self { body, x, p }
    }

    /// Propagates by `h` seconds under the held input `u`; `q` is Q_d of such a step. Alg. 1, lines 6–11.
    pub fn predict(&mut self, u: &impl Input, h: f64, q: &M) {
        let u = &u.action(&self.body);
        let next = self.body.step(&self.x, u, h);
        let phi = self.body.transition(&self.x, &next, u, h);
        self.p = kalman::predict(&self.p, &phi, q);
        self.x = next;
    }

    /// Corrects with the rows of one instant; each leaves a residual. Alg. 1, lines 10–14.
    pub fn correct(&mut self, rows: &[ScalarRow], residuals: &mut ArrayVec<Residual, MAX_RESIDUALS>) {
        let predicted = self.x;
        for row in rows {
            let h = row.jacobian(&predicted);
            // y − ŷ − H δx: what the rows before have already explained is taken off.
            let innovation = row.difference(row.value, row.predict(&predicted)) - h.dot(&(self.x - predicted));
            let r = row.sigma * row.sigma;
            let (ph, s) = kalman::innovation_variance(&self.p, &h, r);
            if !(innovation.is_finite() && s.is_finite() && s > 0.0) {
                continue;
            }
            let residual = Residual::gated(row.sensor, row.channel, innovation, s.sqrt(), row.gate);
            let _ = residuals.try_push(residual);
            if residual.accepted {
                let k = ph / s;
                self.x += k * innovation;
                kalman::correct_scalar(&mut self.p, &h, r, &k);
            }
        }
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

//! Gyroscope bias: a Kalman filter over b.
//!
//! In motion the tilt correction of one sample, divided by the sample period, is the bias seen through the low-pass; at
//! rest the slow rate is the bias (Laidig & Seel 2023, sections 3.4 and 3.5).

use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use super::{BIAS_FORGETTING_S, BIAS_LIMIT_RADPS, BIAS_SIGMA_RADPS, DEGREE, TAU_ACCEL_S};
use crate::estimate::filter::kalman;
use crate::estimate::filter::low_pass::LowPass;

/// Bias uncertainty reached in motion, rad/s.
const BIAS_SIGMA_MOTION: f64 = 0.1 * DEGREE;
/// Bias uncertainty reached at rest, rad/s.
const BIAS_SIGMA_REST: f64 = 0.03 * DEGREE;
/// How much slower the vertical bias, invisible in motion, is drawn to zero.
const BIAS_VERTICAL_FORGETTING: f64 = 1e-4;

/// b and P.
#[derive(Debug, Clone)]
pub(super) struct Bias {
    b: Vector3<f64>,
    p: Matrix3<f64>,
    turn: LowPass<9>,
    turned: LowPass<2>,
}

impl Bias {
    pub fn new(period_s: f64) -> Self {
        Self {
            b: Vector3::zeros(),
            p: Matrix3::identity() * BIAS_SIGMA_RADPS.powi(2),
            turn: LowPass::new(TAU_ACCEL_S, period_s),
            turned: LowPass::new(TAU_ACCEL_S, period_s),
        }
    }

    pub fn retune(&mut self, period_s: f64) {
        self.turn.retune(period_s);
        self.turned.retune(period_s);
    }

    pub fn radps(&self) -> Vector3<f64> {
        self.b
    }

    pub fn sigma_radps(&self) -> Vector3<f64> {
        self.p.diagonal().map(|v| v.max(0.0).sqrt())
    }

    /// Takes the direction `up` that one sample corrected, the `rotation` level ← body, and the rate where the vehicle
    /// is at rest.
    pub fn update(
        &mut self,
        up: &Vector3<f64>,
        rotation: &Matrix3<f64>,
        rate_at_rest: Option<&Vector3<f64>>,
        period_s: f64,
    ) {
        let t = period_s;
        let turned = rotation * self.b;
        let turn = self.turn.push(SVector::<f64, 9>::from_column_slice(rotation.as_slice()));
        let slow_turn = Matrix3::from_column_slice(turn.as_slice());
        let slow_bias = self.turned.push(Vector2::new(turned.x, turned.y));

        let walk = BIAS_SIGMA_MOTION.powi(2) * t / BIAS_FORGETTING_S;
        // The measurement noise whose steady state, against this walk, has the wanted variance.
        let noise = |sigma: f64| sigma.powi(4) / walk + sigma * sigma;
        let (h, mut innovation, r) = if let Some(rate) = rate_at_rest {
            (Matrix3::identity(), rate - self.b, Vector3::repeat(noise(BIAS_SIGMA_REST)))
        } else {
            let seen = slow_turn * self.b;
            let error = Vector3::new(-up.y / t + slow_bias.x - seen.x, up.x / t + slow_bias.y - seen.y, -seen.z);
            let r = noise(BIAS_SIGMA_MOTION);
            (slow_turn, error, Vector3::new(r, r, r / BIAS_VERTICAL_FORGETTING))
        };
        let most = BIAS_SIGMA_RADPS.powi(2);
        for i in 0..3 {
            if self.p[(i, i)] < most {
                self.p[(i, i)] += walk;
            }
        }
        let limit = BIAS_LIMIT_RADPS;
        innovation = innovation.map(|e| e.clamp(-limit, limit));
        let s = h * self.p * h.transpose() + Matrix3::from_diagonal(&r);
        let Some(cholesky) = s.cholesky() else { return };
        let k = cholesky.solve(&(h * self.p)).transpose();
        self.b = (self.b + k * innovation).map(|b| b.clamp(-limit, limit));
        self.p -= k * h * self.p;
        kalman::symmetrise(&mut self.p);
    }
}

//! Steady-state Kalman gain (LQE), the estimator half of LQG (\[Strategies\]).
//!
//! The filter's Riccati equation is the regulator's with A → Aᵀ, B → Cᵀ: one solver serves both.
//!
//! | symbol | meaning |
//! |---|---|
//! | A, C | model and outputs |
//! | Q, R | process and measurement noise |
//! | P | steady covariance of the error: continuous, or before the measurement (discrete) |
//! | L | gain: x̂̇ = A x̂ + B u + L (y − C x̂), or x̂⁺ = x̂⁻ + L (y − C x̂⁻) |

use nalgebra::DMatrix;

use crate::linalg::{LinalgError, care, dare};

/// A steady-state gain.
#[derive(Debug, Clone, PartialEq)]
pub struct SteadyGain {
    /// L. \[Strategies\] writes F_e = −L.
    pub gain: DMatrix<f64>,
    /// P.
    pub covariance: DMatrix<f64>,
}

/// Continuous time: L = P Cᵀ R⁻¹ with A P + P Aᵀ − P Cᵀ R⁻¹ C P + Q = 0.
///
/// # Errors
/// As [`care`]: shapes, values that are not finite, R not positive definite, or a mode that is neither seen
/// nor stable.
pub fn continuous(
    a: &DMatrix<f64>,
    c: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<SteadyGain, LinalgError> {
    let dual = care(&a.transpose(), &c.transpose(), q, r)?;
    Ok(SteadyGain { gain: dual.k.transpose(), covariance: dual.p })
}

/// Discrete time: P is the covariance before the measurement, L = P Cᵀ (C P Cᵀ + R)⁻¹ the gain of the
/// update; the predictor's gain is A L.
///
/// # Errors
/// As [`dare`].
pub fn discrete(
    a: &DMatrix<f64>,
    c: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<SteadyGain, LinalgError> {
    let p = dare(&a.transpose(), &c.transpose(), q, r)?.p;
    let s = c * &p * c.transpose() + r;
    let singular = LinalgError::NotPositiveDefinite { what: "C P C' + R", pivot: 0.0 };
    // L = P Cᵀ S⁻¹, by solving S Lᵀ = C P.
    let gain = s.cholesky().ok_or(singular)?.solve(&(c * &p)).transpose();
    Ok(SteadyGain { gain, covariance: p })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCE: f64 = 1e-8;

    fn reference(name: &str) -> Option<serde_json::Value> {
        let text = std::fs::read_to_string(crate::shared::shared(&format!("reference/{name}"))?).unwrap();
        Some(serde_json::from_str(&text).unwrap())
    }

    fn matrix(value: &serde_json::Value) -> DMatrix<f64> {
        let rows: Vec<Vec<f64>> = value
            .as_array()
            .unwrap()
            .iter()
            .map(|r| r.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect())
            .collect();
        DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
    }

    fn check(what: &str, found: &DMatrix<f64>, expected: &DMatrix<f64>) {
        let error = (found - expected).amax() / expected.amax();
        println!("{what}: relative error {error:.1e}");
        assert!(error < TOLERANCE, "{what}: {error}");
    }

    #[test]
    fn point_mass_gain_equals_the_reference() {
        let Some(json) = reference("point_mass_kf.json") else { return };
        let [gamma, h, q, r] = ["Gamma", "H", "Q", "R"].map(|k| matrix(&json[k]));
        let found = discrete(&gamma, &h, &q, &r).unwrap();
        check("P", &found.covariance, &matrix(&json["P_prior_ss"]));
        check("K", &found.gain, &matrix(&json["K_filter_ss"]));
    }

    #[test]
    fn lqg_gains_equal_the_reference() {
        let Some(json) = reference("lqg.json") else { return };
        // The linear model of the hovering Iris: a double integrator behind each angle.
        let (m, g) = (json["params"]["m"].as_f64().unwrap(), json["params"]["g"].as_f64().unwrap());
        assert!(m > 0.0);
        let mut a = DMatrix::zeros(12, 12);
        for i in 0..3 {
            a[(i, i + 3)] = 1.0;
            a[(i + 6, i + 9)] = 1.0;
        }
        (a[(3, 7)], a[(4, 6)]) = (g, -g);
        let [c, q, r] = ["C", "Qe", "Re"].map(|k| matrix(&json[k]));
        let found = continuous(&a, &c, &q, &r).unwrap();
        check("Fe", &found.gain, &-matrix(&json["Fe"]));
        check("Pe", &found.covariance, &matrix(&json["Pe"]));

        let d = &json["discrete_100Hz"];
        let [ad, qd, rd] = ["Ad", "Qe_d", "Re_d"].map(|k| matrix(&d[k]));
        let found = discrete(&ad, &c, &qd, &rd).unwrap();
        check("Lf", &found.gain, &matrix(&d["filter_gain_Lf"]));
        check("Lp", &(&ad * &found.gain), &matrix(&d["predictor_gain_Lp"]));
    }
}

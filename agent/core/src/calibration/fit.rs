//! Nonlinear least squares: Gauss–Newton with Levenberg's damping, Jacobian by central differences. Own code, since the crate
//! `levenberg-marquardt` (0.15) is built on another nalgebra (0.34) and gives neither covariance nor an account of what is free.
//!
//! | symbol | meaning |
//! |---|---|
//! | x, s | parameters and the natural size of a change of each |
//! | r(x) | residuals |
//! | J | ∂r/∂(x/s): scaled, so that the normal equations are well conditioned |
//! | P | covariance σ²(JᵀJ)⁻¹ of x, with σ² = rᵀr / (m − n) |

use nalgebra::{DMatrix, DVector};

use super::CalibrationError;

/// Most iterations.
const ITERATIONS_MAX: usize = 60;
/// Central differences step this fraction of the natural size.
const DIFFERENCE: f64 = 1e-4;
/// A step below this fraction of the natural sizes ends the search.
const STEP_DONE: f64 = 1e-9;
/// So does a relative decrease of the cost below this.
const COST_DONE: f64 = 1e-14;

/// A minimum and its surroundings.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The parameters.
    pub x: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Root mean square of the residuals.
    pub rms: f64,
    /// Iterations it took.
    pub iterations: usize,
    converged: bool,
}

impl Fit {
    /// One-sigma of parameter `i`.
    pub fn sigma(&self, i: usize) -> f64 {
        self.covariance.get((i, i)).map_or(f64::INFINITY, |v| v.max(0.0).sqrt())
    }

    /// Is it a minimum? To be asked after the sigmas: along a parameter that the data hardly determine the search creeps, and
    /// that they do not is what a user can mend.
    ///
    /// # Errors
    /// [`CalibrationError::NotConverged`].
    pub fn converged(&self) -> Result<(), CalibrationError> {
        let Self { iterations, rms: residual, .. } = *self;
        if self.converged { Ok(()) } else { Err(CalibrationError::NotConverged { iterations, residual }) }
    }
}

/// Minimises |r(x)|² from `start`; `sizes` are natural sizes of changes, `residuals` clears and fills its list
/// with the same number of values every time.
///
/// # Errors
/// [`CalibrationError::TooFew`] residuals, [`CalibrationError::Singular`]; whether it ended at a minimum is
/// [`Fit::converged`].
pub fn least_squares(
    start: &[f64],
    sizes: &[f64],
    mut residuals: impl FnMut(&[f64], &mut Vec<f64>),
) -> Result<Fit, CalibrationError> {
    let n = start.len();
    let mut x = start.to_vec();
    let (mut r, mut trial_r) = (Vec::new(), Vec::new());
    residuals(&x, &mut r);
    let m = r.len();
    if m <= n {
        return Err(CalibrationError::TooFew { what: "residuals", found: m, needed: n + 1 });
    }
    let cost = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
    let mut now = cost(&r);
    let mut damping = 1e-6;
    let (mut plus, mut minus) = (Vec::new(), Vec::new());
    let mut jacobian = DMatrix::zeros(m, n);
    let mut iteration = 0;
    loop {
        iteration += 1;
        for j in 0..n {
            let h = DIFFERENCE * sizes[j];
            let centre = x[j];
            x[j] = centre + h;
            residuals(&x, &mut plus);
            x[j] = centre - h;
            residuals(&x, &mut minus);
            x[j] = centre;
            for (i, (a, b)) in plus.iter().zip(&minus).enumerate() {
                jacobian[(i, j)] = (a - b) / (2.0 * DIFFERENCE);
            }
        }
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&DVector::from_column_slice(&r));
        if !normal.iter().chain(gradient.iter()).all(|v| v.is_finite()) {
            return Err(CalibrationError::Singular("the residuals are not finite"));
        }
        let mut improved = false;
        let mut done = false;
        // Bounded: the damping grows tenfold each time.
        for _ in 0..20 {
            let mut damped = normal.clone();
            for i in 0..n {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-300);
            }
            let Some(cholesky) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let step = cholesky.solve(&gradient);
            let trial: Vec<f64> = (0..n).map(|j| x[j] - step[j] * sizes[j]).collect();
            residuals(&trial, &mut trial_r);
            let then = cost(&trial_r);
            if then <= now {
                done = step.amax() < STEP_DONE || now - then <= COST_DONE * now;
                x = trial;
                std::mem::swap(&mut r, &mut trial_r);
                now = then;
                damping = (damping * 0.1).max(1e-12);
                improved = true;
                break;
            }
            if step.amax() < STEP_DONE {
                done = true;
                break;
            }
            damping *= 10.0;
        }
        // A minimum to rounding: no step improves.
        let converged = done || !improved;
        if converged || iteration == ITERATIONS_MAX {
            let covariance = covariance(&normal, sizes, now / (m - n) as f64)?;
            return Ok(Fit {
                x: DVector::from_vec(x),
                covariance,
                rms: (now / m as f64).sqrt(),
                iterations: iteration,
                converged,
            });
        }
    }
}

/// σ²(JᵀJ)⁻¹, back in the parameters' own units.
fn covariance(normal: &DMatrix<f64>, sizes: &[f64], variance: f64) -> Result<DMatrix<f64>, CalibrationError> {
    let n = sizes.len();
    let cholesky = normal.clone().cholesky().ok_or(CalibrationError::Singular("the data leave a parameter free"))?;
    let inverse = cholesky.inverse();
    Ok(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * sizes[i] * sizes[j] * variance))
}

/// The middle value; `None` of nothing.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let half = values.len() / 2;
    Some(*values.select_nth_unstable_by(half, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_parameters_of_a_curve_with_their_sigma() {
        // y = a exp(−b t), noise of a fixed pattern with sigma about 0.01.
        let truth = [2.0, 0.7];
        let noise = |i: usize| 0.01 * ((i as f64 * 12.9898).sin() * 43758.5453).fract();
        let points: Vec<_> =
            (0..200).map(|i| (i as f64 * 0.02, truth[0] * (-truth[1] * i as f64 * 0.02).exp() + noise(i))).collect();
        let fit = least_squares(&[1.0, 0.1], &[1.0, 1.0], |x, r| {
            r.clear();
            r.extend(points.iter().map(|(t, y)| x[0] * (-x[1] * t).exp() - y));
        })
        .unwrap();
        for (i, expected) in truth.iter().enumerate() {
            assert!((fit.x[i] - expected).abs() < 5.0 * fit.sigma(i).max(1e-4), "{fit:?}");
        }
        assert!(fit.sigma(0) > 1e-4 && fit.sigma(0) < 1e-2);
    }

    #[test]
    fn what_the_data_leave_free_is_refused() {
        let free = least_squares(&[1.0, 1.0], &[1.0, 1.0], |x, r| {
            r.clear();
            r.extend((0..5).map(|i| x[0] * f64::from(i) - 1.0));
        });
        assert!(matches!(free, Err(CalibrationError::Singular(_))), "{free:?}");
        let few = least_squares(&[1.0, 1.0], &[1.0, 1.0], |x, r| {
            r.clear();
            r.push(x[0] - x[1]);
        });
        assert!(matches!(few, Err(CalibrationError::TooFew { found: 1, needed: 3, .. })), "{few:?}");
    }
}

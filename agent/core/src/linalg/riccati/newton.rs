//! Newton corrections of a solution: a Lyapunov or Stein equation in the closed loop, each kept only when it lowers the
//! residual.

use nalgebra::DMatrix;

use crate::linalg::{LinalgError, lyapunov, stein, symmetrised};

/// Corrections at most.
const MAX_CORRECTIONS: usize = 3;
/// A relative residual above this is no solution.
const WORST_RESIDUAL: f64 = 1e-9;

/// A Riccati equation as a Newton iteration sees it.
pub(super) trait Equation {
    /// What is left of the equation at X, and its norm over that of its terms.
    fn residual(&self, x: &DMatrix<f64>) -> Option<(DMatrix<f64>, f64)>;
    /// The correction that what is left asks for, by the linear equation of the closed loop at X.
    fn correction(&self, x: &DMatrix<f64>, left: &DMatrix<f64>) -> Option<DMatrix<f64>>;
}

/// AᵀX + XA − XGX + Q = 0; the closed loop is A − GX.
pub(super) struct Continuous<'a> {
    pub a: &'a DMatrix<f64>,
    pub g: &'a DMatrix<f64>,
    pub q: &'a DMatrix<f64>,
}

/// AᵀX(I + GX)⁻¹A + Q − X = 0; the closed loop is (I + GX)⁻¹A.
pub(super) struct Sampled<'a> {
    pub a: &'a DMatrix<f64>,
    pub g: &'a DMatrix<f64>,
    pub q: &'a DMatrix<f64>,
}

impl Equation for Continuous<'_> {
    fn residual(&self, x: &DMatrix<f64>) -> Option<(DMatrix<f64>, f64)> {
        let (linear, quadratic) = (self.a.transpose() * x, x * self.g * x);
        let terms = 2.0 * linear.norm() + quadratic.norm() + self.q.norm();
        let left = symmetrised(&(&linear + linear.transpose() - quadratic + self.q));
        let relative = left.norm() / terms.max(f64::MIN_POSITIVE);
        Some((left, relative))
    }

    fn correction(&self, x: &DMatrix<f64>, left: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        lyapunov(&(self.a - self.g * x), left).ok()
    }
}

impl Sampled<'_> {
    fn closed(&self, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        (DMatrix::identity(x.nrows(), x.nrows()) + self.g * x).lu().solve(self.a)
    }
}

impl Equation for Sampled<'_> {
    fn residual(&self, x: &DMatrix<f64>) -> Option<(DMatrix<f64>, f64)> {
        let left = symmetrised(&(self.a.transpose() * x * self.closed(x)? + self.q - x));
        let relative = left.norm() / (2.0 * x.norm() + self.q.norm()).max(f64::MIN_POSITIVE);
        Some((left, relative))
    }

    fn correction(&self, x: &DMatrix<f64>, left: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        stein(&self.closed(x)?, left).ok()
    }
}

/// Newton corrections, each kept only when it lowers the residual.
pub(super) fn refine(mut x: DMatrix<f64>, equation: &impl Equation) -> (DMatrix<f64>, f64) {
    let Some((mut left, mut r)) = equation.residual(&x) else { return (x, f64::INFINITY) };
    for _ in 0..MAX_CORRECTIONS {
        if r <= 4.0 * f64::EPSILON {
            break;
        }
        let Some(step) = equation.correction(&x, &left) else { break };
        let next = symmetrised(&(&x + step));
        let Some((next_left, next_r)) = equation.residual(&next) else { break };
        if next_r.is_nan() || next_r >= r {
            break;
        }
        (x, left, r) = (next, next_left, next_r);
    }
    (x, r)
}

pub(super) fn accept(
    what: &'static str,
    (x, residual): (DMatrix<f64>, f64),
    iterations: usize,
) -> Result<(DMatrix<f64>, f64), LinalgError> {
    if residual <= WORST_RESIDUAL {
        Ok((x, residual))
    } else {
        Err(LinalgError::NotConverged { what, iterations, change: f64::NAN, residual })
    }
}

//! The CARE by the scaled matrix sign function of its Hamiltonian (Roberts 1971, determinantal scaling of Byers 1987).

use nalgebra::DMatrix;

use super::newton::{Continuous, accept, refine};
use crate::linalg::{LinalgError, check, eigenvalues, norm_1, symmetric, symmetrised};

/// Iterations at most.
const MAX_SIGN_ITERATIONS: usize = 100;

/// The CARE's solution from the matrix sign function of its Hamiltonian: an independent check.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or the iteration does not converge (eigenvalues
/// on the imaginary axis).
pub fn care_by_sign(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let n = a.nrows();
    check("A", a, n, n)?;
    let g = symmetric("G", g, n)?;
    let q = symmetric("Q", q, n)?;
    let mut s = DMatrix::zeros(2 * n, 2 * n);
    s.view_mut((0, 0), (n, n)).copy_from(a);
    s.view_mut((0, n), (n, n)).copy_from(&-&g);
    s.view_mut((n, 0), (n, n)).copy_from(&-&q);
    s.view_mut((n, n), (n, n)).copy_from(&-a.transpose());
    let mut change = f64::INFINITY;
    let mut converged = false;
    for _ in 0..MAX_SIGN_ITERATIONS {
        let lu = s.clone().lu();
        // log |det| from the factors: the determinant itself overflows.
        let log_det: f64 = lu.u().diagonal().iter().map(|d| d.abs().ln()).sum();
        let inverse =
            lu.try_inverse().ok_or(LinalgError::Singular { what: "Hamiltonian", condition: f64::INFINITY })?;
        // Scaling hurts close to the limit.
        let c = if change > 1e-2 { (-log_det / (2 * n) as f64).exp() } else { 1.0 };
        let next = (&s * c + inverse / c) * 0.5;
        change = norm_1(&(&next - &s)) / norm_1(&next);
        s = next;
        if converged || !change.is_finite() {
            break;
        }
        // One more after the threshold: the convergence is quadratic.
        converged = change < 1e-9;
    }
    if !converged {
        return Err(LinalgError::NotConverged {
            what: "matrix sign of the Hamiltonian",
            iterations: MAX_SIGN_ITERATIONS,
            change,
            residual: change,
        });
    }
    // (S + I)[I; X] = 0.
    let mut left = s.view((0, n), (2 * n, n)).into_owned();
    let mut right = -s.view((0, 0), (2 * n, n)).into_owned();
    for i in 0..n {
        left[(n + i, i)] += 1.0;
        right[(i, i)] -= 1.0;
    }
    // Householder QR, no pivoting: the stabilising solution makes the columns well conditioned.
    let qr = left.qr();
    let mut rhs = right;
    qr.q_tr_mul(&mut rhs);
    let x = qr.r().solve_upper_triangular(&rhs.rows(0, n).into_owned());
    x.map(|x| symmetrised(&x))
        .ok_or(LinalgError::Singular { what: "basis of the stable subspace", condition: f64::INFINITY })
}

/// Stabilising solution of AᵀX + XA − XGX + Q = 0 with G and Q symmetric, possibly indefinite, by the matrix
/// sign and a few Newton corrections: the equation of H∞ synthesis, where the parameter
/// of a Cayley transform may meet a pole.
///
/// # Errors
/// As [`care_by_sign`], and when A − GX is not stable or the residual is large: there is no stabilising solution.
pub fn care_indefinite(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let x = care_by_sign(a, g, q)?;
    let equation = Continuous { a, g, q };
    let (x, residual) = refine(x, &equation);
    let value = eigenvalues(&(a - g * &x))?.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max);
    if value.is_nan() || value >= 0.0 {
        return Err(LinalgError::NotStabilising { what: "CARE", measure: "largest real part", value });
    }
    Ok(accept("CARE", (x, residual), MAX_SIGN_ITERATIONS)?.0)
}

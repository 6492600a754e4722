//! Lyapunov and Stein equations by doubling.
//!
//! - Stein: X = AᵀXA + Q, spectral radius of A below one: X ← X + AₖᵀXAₖ, Aₖ₊₁ = Aₖ² (Smith 1968).
//! - Lyapunov: AᵀX + XA + Q = 0, A Hurwitz: the Cayley transform with γ > 0 turns it into a Stein
//!   equation with A_d = I + 2γ(A − γI)⁻¹ and Q_d = 2γ(A − γI)⁻ᵀ Q (A − γI)⁻¹.

use nalgebra::DMatrix;

use super::{LinalgError, check, inverse, symmetrised};

/// Doublings at most: a spectral radius of 1 − 2⁻⁵⁰ would need this many.
const MAX_DOUBLINGS: usize = 60;

/// Solves X = AᵀXA + Q.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or A is not stable (spectral radius ≥ 1).
pub fn stein(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let n = a.nrows();
    check("A", a, n, n)?;
    check("Q", q, n, n)?;
    let mut x = q.clone();
    let mut a_k = a.clone();
    let mut change = f64::INFINITY;
    for _ in 0..MAX_DOUBLINGS {
        let step = a_k.transpose() * &x * &a_k;
        let size = x.norm();
        x += &step;
        change = step.norm() / x.norm().max(f64::MIN_POSITIVE);
        if change <= f64::EPSILON || (size == 0.0 && step.norm() == 0.0) {
            return Ok(symmetrised(&x));
        }
        if !change.is_finite() {
            break;
        }
        a_k = &a_k * &a_k;
    }
    let residual = (a.transpose() * &x * a + q - &x).norm() / x.norm();
    Err(LinalgError::NotConverged {
        what: "Stein equation (A not stable?)",
        iterations: MAX_DOUBLINGS,
        change,
        residual,
    })
}

/// Solves AᵀX + XA + Q = 0.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or A is not Hurwitz.
pub fn lyapunov(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let n = a.nrows();
    check("A", a, n, n)?;
    check("Q", q, n, n)?;
    let gamma = (a.norm() / (n.max(1) as f64).sqrt()).max(f64::MIN_POSITIVE.sqrt());
    let inverse = inverse("A - gamma I", &(a - DMatrix::identity(n, n) * gamma))?;
    let a_d = DMatrix::identity(n, n) + &inverse * (2.0 * gamma);
    let q_d = inverse.transpose() * q * &inverse * (2.0 * gamma);
    stein(&a_d, &q_d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn solutions_satisfy_their_equations() {
        let a = dmatrix![-1.0, 20.0, 0.0; -3.0, -2.0, 1.0; 0.0, 0.1, -100.0];
        let q = dmatrix![2.0, 0.1, 0.0; 0.1, 1.0, 0.0; 0.0, 0.0, 3.0];
        let x = lyapunov(&a, &q).unwrap();
        assert!((a.transpose() * &x + &x * &a + &q).norm() < 1e-12 * (a.norm() * x.norm()));
        let a = dmatrix![0.5, 0.9; -0.4, 0.3];
        let q = DMatrix::identity(2, 2);
        let x = stein(&a, &q).unwrap();
        assert!((a.transpose() * &x * &a + &q - &x).norm() < 1e-13 * x.norm());
    }

    #[test]
    fn unstable_is_an_error_not_a_hang() {
        assert!(lyapunov(&dmatrix![0.1], &dmatrix![1.0]).is_err());
        assert!(stein(&dmatrix![1.0], &dmatrix![1.0]).is_err());
        assert!(lyapunov(&DMatrix::zeros(3, 3), &DMatrix::identity(3, 3)).is_err());
    }
}

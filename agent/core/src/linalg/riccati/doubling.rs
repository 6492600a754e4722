//! Structure-preserving doubling (Chu, Fan, Lin, Wang 2004; Chu, Fan, Lin 2005): the first solution of either equation.

use nalgebra::DMatrix;

use super::newton::{Continuous, Sampled, refine};
use super::{Matrix, Started};
use crate::linalg::{LinalgError, inverse, symmetrised};

/// Doublings at most; the convergence is quadratic, 7 to 13 are usual.
const MAX_DOUBLINGS: usize = 60;
/// A relative residual below this needs no further parameter of the Cayley transform.
const GOOD_RESIDUAL: f64 = 1e-14;
/// Parameters of the Cayley transform that are tried, relative to the Hamiltonian's scale.
pub(super) const CAYLEY_FACTORS: [f64; 6] = [1.0, 0.2, 5.0, 0.03, 30.0, 0.003];

/// Scale of the Hamiltonian [[A, −G], [−Q, −Aᵀ]] after its off-diagonal blocks are balanced.
pub(super) fn cayley_scale(a: &Matrix, g_norm: f64, q_norm: f64) -> f64 {
    let scale = (a.norm_squared() + g_norm * q_norm).sqrt() / (a.nrows().max(1) as f64).sqrt();
    if scale > 0.0 { scale } else { 1.0 }
}

/// The best solution that doubling and plain corrections reach.
pub(super) fn care_start(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Started {
    let scale = cayley_scale(a, g.norm(), q.norm());
    let equation = Continuous { a, g, q };
    let mut best: Option<(DMatrix<f64>, usize, f64)> = None;
    let mut error = LinalgError::NotConverged { what: "CARE", iterations: 0, change: f64::NAN, residual: f64::NAN };
    for factor in CAYLEY_FACTORS {
        let attempt = cayley(a, g, q, factor * scale).and_then(|[a, g, h]| doubling("CARE", a, g, h));
        match attempt {
            Ok((x, iterations)) => {
                let (x, r) = refine(x, &equation);
                if best.as_ref().is_none_or(|b| r < b.2) {
                    best = Some((x, iterations, r));
                }
            }
            Err(e) => error = e,
        }
        if best.as_ref().is_some_and(|b| b.2 < GOOD_RESIDUAL) {
            break;
        }
    }
    best.ok_or(error)
}

/// What doubling and plain corrections reach.
pub(super) fn dare_start(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Started {
    let (x, iterations) = doubling("DARE", a.clone(), g.clone(), q.clone())?;
    let (x, r) = refine(x, &Sampled { a, g, q });
    Ok((x, iterations, r))
}

/// Cayley transform of the Hamiltonian into the first symplectic pair (Chu, Fan, Lin 2005, Eq. 2.6–2.9).
fn cayley(a: &DMatrix<f64>, g: &DMatrix<f64>, h: &DMatrix<f64>, gamma: f64) -> Result<[DMatrix<f64>; 3], LinalgError> {
    let n = a.nrows();
    let identity = DMatrix::identity(n, n);
    let a_gamma_inverse = inverse("A - gamma I", &(a - &identity * gamma))?;
    let w = a.transpose() - &identity * gamma + h * &a_gamma_inverse * g;
    let w_inverse = inverse("Cayley transform", &w)?;
    let a_0 = identity + w_inverse.transpose() * (2.0 * gamma);
    let g_0 = symmetrised(&(&a_gamma_inverse * g * &w_inverse * (2.0 * gamma)));
    let h_0 = symmetrised(&(&w_inverse * h * &a_gamma_inverse * (2.0 * gamma)));
    Ok([a_0, g_0, h_0])
}

/// Structure-preserving doubling (SDA): H → X.
fn doubling(
    what: &'static str,
    mut a: DMatrix<f64>,
    mut g: DMatrix<f64>,
    mut h: DMatrix<f64>,
) -> Result<(DMatrix<f64>, usize), LinalgError> {
    let n = a.nrows();
    let mut change = f64::INFINITY;
    for iteration in 1..=MAX_DOUBLINGS {
        let w = DMatrix::identity(n, n) + &g * &h;
        let lu = w.lu();
        let singular = || LinalgError::Singular { what: "I + GH", condition: f64::INFINITY };
        // W⁻¹A and W⁻¹G; H W⁻¹ = (W⁻ᵀ H)ᵀ by symmetry of H(I + GH)⁻¹.
        let w_a = lu.solve(&a).ok_or_else(singular)?;
        let w_g = lu.solve(&g).ok_or_else(singular)?;
        let h_step = symmetrised(&(a.transpose() * &h * &w_a));
        g += symmetrised(&(&a * w_g * a.transpose()));
        a = &a * w_a;
        h += &h_step;
        change = h_step.norm() / h.norm().max(f64::MIN_POSITIVE);
        if !change.is_finite() {
            break;
        }
        if change <= f64::EPSILON || h_step.norm() == 0.0 {
            return Ok((h, iteration));
        }
    }
    Err(LinalgError::NotConverged { what, iterations: MAX_DOUBLINGS, change, residual: f64::NAN })
}

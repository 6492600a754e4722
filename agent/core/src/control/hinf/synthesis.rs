//! H∞ synthesis: bisection on γ over two Riccati equations, then the central controller.
//!
//! Source: K. Glover, J. C. Doyle, State-space formulae for all stabilizing controllers that satisfy an
//! H∞-norm bound, Systems & Control Letters 11 (1988), as in K. Zhou, J. C. Doyle, K. Glover, Robust and
//! Optimal Control (1996), Theorem 17.1, for D₁₁ whose only block is that from reference to performance
//! (mixed sensitivity), so that the controller has no direct part.
//!
//! | symbol | meaning |
//! |---|---|
//! | γ | bound on ‖T_zw‖∞ |
//! | X, Y | stabilising solutions of the control and filter Riccati equations |
//! | F, L | state feedback and output injection |
//!
//! γ is possible exactly when X ⪰ 0, Y ⪰ 0 and ρ(XY) < γ². The Riccati equations have an indefinite
//! quadratic term: they are solved by the matrix sign of their Hamiltonian and corrected by Newton.

use nalgebra::DMatrix;

use super::weights::Generalised;
use crate::linalg::{LinalgError, care_indefinite, eigenvalues, symmetric_eigen};
use crate::model::state_space::StateSpace;

/// Doublings and bisections at most.
const MAX_STEPS: usize = 200;
/// An eigenvalue of X or Y above minus this part of the largest counts as zero.
const SEMIDEFINITE: f64 = 1e-9;

/// The central controller for one γ.
#[derive(Debug, Clone, PartialEq)]
pub struct Central {
    /// u = K v.
    pub controller: StateSpace,
    /// Solution of the control Riccati equation.
    pub x: DMatrix<f64>,
    /// Solution of the filter Riccati equation.
    pub y: DMatrix<f64>,
    /// The bound it keeps.
    pub gamma: f64,
}

/// The central controller that keeps ‖T_zw‖∞ below `gamma`; `Ok(None)` when there is none.
///
/// # Errors
/// When D₁₂ has no full column rank.
pub fn central(plant: &Generalised, gamma: f64) -> Result<Option<Central>, LinalgError> {
    let Generalised { a, b1, b2, c1, c2, d11, d12, d21 } = plant;
    let (n, m1, m2) = (a.nrows(), b1.ncols(), b2.ncols());
    let (p1, p2) = (c1.nrows(), c2.nrows());
    // R = D₁•ᵀD₁• − diag(γ²I, 0), R̃ = D•₁D•₁ᵀ − diag(γ²I, 0).
    let across = |p: &DMatrix<f64>, q: &DMatrix<f64>| {
        let mut out = DMatrix::zeros(p.nrows(), p.ncols() + q.ncols());
        out.view_mut((0, 0), p.shape()).copy_from(p);
        out.view_mut((0, p.ncols()), q.shape()).copy_from(q);
        out
    };
    let down = |p: &DMatrix<f64>, q: &DMatrix<f64>| across(&p.transpose(), &q.transpose()).transpose();
    let (b, c) = (across(b1, b2), down(c1, c2));
    let (d_row, d_column) = (across(d11, d12), down(d11, d21));
    let squared = gamma * gamma;
    let less = |mut m: DMatrix<f64>, first: usize| {
        (0..first).for_each(|i| m[(i, i)] -= squared);
        m
    };
    let r = crate::linalg::inverse("R of the control problem", &less(d_row.transpose() * &d_row, m1))?;
    let r_filter = crate::linalg::inverse("R of the filter problem", &less(&d_column * d_column.transpose(), p1))?;
    // The condition γ > σ(D₁₁) is that R's first block is negative definite.
    let direct = d11.transpose() * d11;
    if nalgebra::Cholesky::new(DMatrix::identity(m1, m1) * squared - direct).is_none() {
        return Ok(None);
    }
    let dc = d_row.transpose() * c1;
    let x = care_indefinite(
        &(a - &b * &r * &dc),
        &(&b * &r * b.transpose()),
        &(c1.transpose() * c1 - dc.transpose() * &r * &dc),
    );
    let bd = b1 * d_column.transpose();
    let y = care_indefinite(
        &(a - &bd * &r_filter * &c).transpose(),
        &(c.transpose() * &r_filter * &c),
        &(b1 * b1.transpose() - &bd * &r_filter * bd.transpose()),
    );
    // No stabilising solution at this γ is an answer, not a failure.
    let (Ok(x), Ok(y)) = (x, y) else { return Ok(None) };
    if !(semidefinite(&x)? && semidefinite(&y)?) {
        return Ok(None);
    }
    let radius = eigenvalues(&(&x * &y))?.iter().map(|e| e.norm()).fold(0.0, f64::max);
    if radius.is_nan() || radius >= squared {
        return Ok(None);
    }
    let f = -&r * (dc + b.transpose() * &x);
    let l = -(bd + &y * c.transpose()) * &r_filter;
    let z = (DMatrix::identity(n, n) - &y * &x / squared).lu();
    let singular = LinalgError::Singular { what: "I - YX/gamma^2", condition: f64::INFINITY };
    let bk = -z.solve(&l.columns(p1, p2).into_owned()).ok_or(singular)?;
    let ck = f.rows(m1, m2).into_owned();
    // F₁₂: the worst reference.
    let seen = c2 + f.rows(m1 - p2, p2);
    let ak = a + &b * f - &bk * seen;
    let controller = StateSpace { a: ak, b: bk, c: ck, d: DMatrix::zeros(m2, p2) };
    Ok(Some(Central { controller, x, y, gamma }))
}

/// The smallest γ, to the relative `tolerance`, from above.
///
/// # Errors
/// When no γ up to 10⁶ is possible.
pub fn optimal_gamma(plant: &Generalised, tolerance: f64) -> Result<f64, LinalgError> {
    let mut high = 1.0;
    let mut steps = 0;
    while central(plant, high)?.is_none() {
        high *= 4.0;
        steps += 1;
        if steps > 10 {
            return Err(LinalgError::NotConverged {
                what: "H-infinity synthesis (no gamma is possible)",
                iterations: steps,
                change: f64::NAN,
                residual: high,
            });
        }
    }
    let mut low = high / 4.0;
    while steps < MAX_STEPS && central(plant, low)?.is_some() {
        high = low;
        low /= 4.0;
        steps += 1;
    }
    while high > low * (1.0 + tolerance) && steps < MAX_STEPS {
        let middle = 0.5 * (low + high);
        if central(plant, middle)?.is_some() {
            high = middle;
        } else {
            low = middle;
        }
        steps += 1;
    }
    Ok(high)
}

fn semidefinite(m: &DMatrix<f64>) -> Result<bool, LinalgError> {
    let eigen = symmetric_eigen("eigenvalues of X", m.clone())?.eigenvalues;
    Ok(eigen.min() >= -SEMIDEFINITE * eigen.amax())
}

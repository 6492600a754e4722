//! Fewer states: Hankel singular values, balanced truncation and residualisation, and residualisation of one
//! fast pole.
//!
//! Deviation from \[Strategies\]: its Hankel matrix does not fit (ERRATA 4). With Gramians P and Q the values are
//! √λ(PQ); here Q = R Rᵀ and RᵀPR = U Σ² Uᵀ, so that T = Σ^−½ Uᵀ Rᵀ balances. Truncating the last four of the
//! twenty states, as the source does, destabilises the loop (ERRATA 5): each channel's own fast pole is
//! residualised instead, which keeps the response at low frequencies.

use nalgebra::{DMatrix, DVector};

use crate::linalg::{Complex, LinalgError, eigenvalues, lyapunov, symmetric_eigen};
use crate::model::state_space::StateSpace;

/// A system in balanced coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Balanced {
    /// Its states ordered by their Hankel singular values.
    pub system: StateSpace,
    /// The values, largest first.
    pub values: DVector<f64>,
}

/// Balances a stable system.
///
/// # Errors
/// When it is not stable, or a state is unobservable to working precision.
pub fn balance(system: &StateSpace) -> Result<Balanced, LinalgError> {
    let StateSpace { a, b, c, d } = system;
    // A P + P Aᵀ + B Bᵀ = 0, Aᵀ Q + Q A + Cᵀ C = 0.
    let p = lyapunov(&a.transpose(), &(b * b.transpose()))?;
    let q = lyapunov(a, &(c.transpose() * c))?;
    let r = factor(&q)?;
    let product = symmetric_eigen("Hankel singular values", r.transpose() * p * &r)?;
    let mut order: Vec<usize> = (0..a.nrows()).collect();
    order.sort_by(|&i, &j| product.eigenvalues[j].total_cmp(&product.eigenvalues[i]));
    let values = DVector::from_iterator(order.len(), order.iter().map(|&i| product.eigenvalues[i].max(0.0).sqrt()));
    let u = product.eigenvectors.select_columns(&order);
    let root = DMatrix::from_diagonal(&values.map(|v| v.sqrt()));
    let root_inverse = DMatrix::from_diagonal(&values.map(|v| 1.0 / v.sqrt()));
    let t = root_inverse * u.transpose() * r.transpose();
    let singular = LinalgError::Singular { what: "square root of the observability Gramian", condition: f64::INFINITY };
    let t_inverse = r.transpose().lu().solve(&(u * root)).ok_or(singular)?;
    let system = StateSpace { a: &t * a * &t_inverse, b: t * b, c: c * t_inverse, d: d.clone() };
    if system.a.iter().chain(&system.b).chain(&system.c).any(|v| !v.is_finite()) {
        return Err(LinalgError::Singular { what: "balancing transformation", condition: f64::INFINITY });
    }
    Ok(Balanced { system, values })
}

/// R with R Rᵀ = Q, by Cholesky, else by eigenvalues where rounding made Q indefinite.
fn factor(q: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    if let Some(cholesky) = nalgebra::Cholesky::new(q.clone()) {
        return Ok(cholesky.l());
    }
    let eigen = symmetric_eigen("Gramian", q.clone())?;
    let floor = f64::EPSILON * eigen.eigenvalues.amax();
    let roots = DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(floor).sqrt()));
    Ok(eigen.eigenvectors * roots)
}

impl Balanced {
    /// The first `order` states; the others are dropped.
    pub fn truncated(&self, order: usize) -> StateSpace {
        let StateSpace { a, b, c, d } = &self.system;
        StateSpace {
            a: a.view((0, 0), (order, order)).into_owned(),
            b: b.rows(0, order).into_owned(),
            c: c.columns(0, order).into_owned(),
            d: d.clone(),
        }
    }

    /// The first `order` states; the others follow at once (the response at zero frequency is kept).
    ///
    /// # Errors
    /// When the dropped part has a pole at zero.
    pub fn residualised(&self, order: usize) -> Result<StateSpace, LinalgError> {
        let StateSpace { a, b, c, d } = &self.system;
        let rest = a.nrows() - order;
        let a22 = a.view((order, order), (rest, rest)).into_owned().lu();
        let singular = || LinalgError::Singular { what: "fast part", condition: f64::INFINITY };
        let fast_a = a22.solve(&a.view((order, 0), (rest, order)).into_owned()).ok_or_else(singular)?;
        let fast_b = a22.solve(&b.rows(order, rest).into_owned()).ok_or_else(singular)?;
        let a12 = a.view((0, order), (order, rest)).into_owned();
        let c2 = c.columns(order, rest).into_owned();
        Ok(StateSpace {
            a: a.view((0, 0), (order, order)) - &a12 * &fast_a,
            b: b.rows(0, order) - a12 * &fast_b,
            c: c.columns(0, order) - &c2 * fast_a,
            d: d - c2 * fast_b,
        })
    }
}

/// The fastest pole (real) made to follow at once: one state less. The pole that went, 1/s.
///
/// # Errors
/// When the fastest pole is not real.
pub fn residualise_fastest(system: &StateSpace) -> Result<(StateSpace, f64), LinalgError> {
    let pole = extreme_pole(system, |e, other| e.norm() > other.norm())?;
    let Split { b, c, mut rest } = split(system, pole)?;
    rest.d -= c * b / pole;
    Ok((rest, pole))
}

/// The slowest pole (real) set apart: the pole, its part, and the system without it.
///
/// # Errors
/// When the slowest pole is not real.
pub fn split_slowest(system: &StateSpace) -> Result<(f64, Split), LinalgError> {
    let pole = extreme_pole(system, |e, other| e.norm() < other.norm())?;
    Ok((pole, split(system, pole)?))
}

/// A system as c b/(s − pole) + the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// One row: the pole's state from the inputs.
    pub b: DMatrix<f64>,
    /// One column: the outputs from the pole's state.
    pub c: DMatrix<f64>,
    /// Everything else.
    pub rest: StateSpace,
}

/// The pole that `beats` every other.
fn extreme_pole(system: &StateSpace, beats: impl Fn(Complex, Complex) -> bool) -> Result<f64, LinalgError> {
    let poles = eigenvalues(&system.a)?;
    let found = poles.into_iter().reduce(|best, e| if beats(e, best) { e } else { best });
    match found {
        Some(pole) if pole.im == 0.0 => Ok(pole.re),
        other => Err(LinalgError::NotConverged {
            what: "setting a pole apart (it is not real)",
            iterations: 0,
            change: other.map_or(f64::NAN, |p| p.im),
            residual: other.map_or(f64::NAN, |p| p.re),
        }),
    }
}

fn split(system: &StateSpace, pole: f64) -> Result<Split, LinalgError> {
    let StateSpace { a, b, c, d } = system;
    let n = a.nrows();
    // Inverse iteration a little off the pole; the others are far away.
    let shift = pole * (1.0 + 1e-10) + f64::MIN_POSITIVE;
    let near = |m: &DMatrix<f64>| -> Result<DVector<f64>, LinalgError> {
        let lu = (m - DMatrix::identity(n, n) * shift).lu();
        let mut v = DVector::from_fn(n, |i, _| 1.0 + i as f64 / n as f64);
        for _ in 0..6 {
            let singular = LinalgError::Singular { what: "A - pole", condition: f64::INFINITY };
            v = lu.solve(&v).ok_or(singular)?.normalize();
        }
        Ok(v)
    };
    let right = near(a)?;
    let left = near(&a.transpose())?;
    let left = &left / left.dot(&right);
    // An orthonormal basis of what the left eigenvector does not see, invariant under A: the other columns of
    // the Householder reflection that takes it to the first axis.
    let mut mirror = left.normalize();
    mirror[0] += 1.0_f64.copysign(mirror[0]);
    let reflection = DMatrix::identity(n, n) - &mirror * mirror.transpose() * (2.0 / mirror.norm_squared());
    let basis = reflection.columns(1, n - 1).into_owned();
    let left_b = left.transpose() * b;
    let others_b = b - &right * &left_b;
    Ok(Split {
        c: DMatrix::from_columns(&[c * &right]),
        b: DMatrix::from_rows(&[left_b.row(0).into_owned()]),
        rest: StateSpace {
            a: basis.transpose() * a * &basis,
            b: basis.transpose() * others_b,
            c: c * &basis,
            d: d.clone(),
        },
    })
}

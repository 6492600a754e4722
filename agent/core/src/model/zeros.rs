//! Invariant zeros, and the inputs that they stand for: what can be fed to x⁺ = Ax + Bu, y = Cx + Du while y stays 0.
//!
//! An attack along a zero dynamics \[Teixeira et al. 2015, A secure control framework, IV\] is such an input: where the zero lies
//! outside the unit circle it grows from next to nothing.
//!
//! | symbol | meaning | size |
//! |---|---|---|
//! | V | basis of V*, the largest set of states from which some u keeps y = 0 for ever \[Basile & Marro 1969\] | n × r |
//! | N | how they go on: x = Vξ, ξ⁺ = Nξ | r × r |
//! | G | that u: u = Gξ | m × r |
//!
//! V₀ = ℝⁿ, Vₖ₊₁ = {x ∈ Vₖ : Ax + Bu ∈ Vₖ and Cx + Du = 0 for some u} ends after n steps at most. With a basis of it
//! \[V −B; 0 −D\]\[N; G\] = \[AV; CV\], of which the least squares are exact; where that matrix has less than full rank some input is unseen
//! whatever the state (the system is not left invertible), and every λ is a zero. Otherwise the eigenvalues of N are the λ at which
//! Rosenbrock's matrix \[A − λI, B; C, D\] loses rank. The same numbers come of pencils \[Emami-Naeini & Van Dooren 1982\]; V* has
//! chains of a repeated zero as well, which grow although none of them lies outside.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::state_space::StateSpace;
use crate::linalg::{Complex, LinalgError, check, eigenvalues};

/// A direction whose square is less than this part of that of the largest element of A, B, C and D counts as none.
const NONE: f64 = 1e-12;
/// Sweeps of the symmetric eigenvalue iteration.
const SWEEPS: usize = 10_000;

/// What leaves the outputs at 0.
#[derive(Debug, Clone, PartialEq)]
pub enum Nulling {
    /// Inputs in so many directions are unseen, whatever the state: any sequence of them.
    Free(usize),
    /// Only these dynamics; of none where there is no zero.
    Dynamics(ZeroDynamics),
}

/// The states that no output sees, and how they go on.
#[derive(Debug, Clone, PartialEq)]
pub struct ZeroDynamics {
    /// V, n × r.
    pub basis: DMatrix<f64>,
    /// N, r × r.
    pub next: DMatrix<f64>,
    /// G, m × r.
    pub input: DMatrix<f64>,
    /// Eigenvalues of N: the invariant zeros, the largest first.
    pub zeros: Vec<Complex>,
}

/// What leaves the outputs of the sampled `system` at 0.
///
/// # Errors
/// [`LinalgError`] for matrices that do not fit or are not finite, and where an iteration does not converge.
pub fn nulling(system: &StateSpace) -> Result<Nulling, LinalgError> {
    let StateSpace { a, b, c, d } = system;
    let (n, m, p) = (a.nrows(), b.ncols(), c.nrows());
    for (what, matrix, rows, columns) in [("A", a, n, n), ("B", b, n, m), ("C", c, p, n), ("D", d, p, m)] {
        check(what, matrix, rows, columns)?;
    }
    // Outputs have units: each counts with its largest part as one.
    let scale = |row: usize| {
        let most = c.row(row).amax().max(if m > 0 { d.row(row).amax() } else { 0.0 });
        if most > 0.0 { 1.0 / most } else { 0.0 }
    };
    let scales = DMatrix::from_diagonal(&DVector::from_fn(p, |row, _| scale(row)));
    let (c, d) = (&scales * c, &scales * d);
    // So large is one, where a zero is what rounding left.
    let one = [a, b, &c, &d].iter().filter(|of| !of.is_empty()).map(|of| of.amax()).fold(1.0, f64::max);
    let mut basis = DMatrix::identity(n, n);
    loop {
        let r = basis.ncols();
        let outside = DMatrix::identity(n, n) - &basis * basis.transpose();
        let leaves = stacked(&[&[&(&outside * a * &basis), &(&outside * b)], &[&(&c * &basis), &d]]);
        let kept = null_space(&leaves, one)?.rows(0, r).into_owned();
        let smaller = &basis * range(&kept)?;
        if smaller.ncols() == r {
            break;
        }
        basis = smaller;
    }
    let r = basis.ncols();
    let whole = stacked(&[&[&basis, &(-b)], &[&DMatrix::zeros(p, r), &(-&d)]]);
    let free = null_space(&whole, one)?.ncols();
    if free > 0 {
        return Ok(Nulling::Free(free));
    }
    let wanted = stacked(&[&[&(a * &basis)], &[&(&c * &basis)]]);
    let gram = whole.tr_mul(&whole);
    let unsolved = || LinalgError::NotPositiveDefinite { what: "the matrix of a zero dynamics", pivot: 0.0 };
    let found = if r + m == 0 {
        DMatrix::zeros(0, 0)
    } else {
        gram.cholesky().ok_or_else(unsolved)?.solve(&whole.tr_mul(&wanted))
    };
    let (next, input) = (found.rows(0, r).into_owned(), found.rows(r, m).into_owned());
    let mut zeros = eigenvalues(&next)?;
    zeros.sort_by(|x, y| y.norm().total_cmp(&x.norm()));
    Ok(Nulling::Dynamics(ZeroDynamics { basis, next, input, zeros }))
}

/// One matrix of blocks: rows of them.
fn stacked(rows: &[&[&DMatrix<f64>]]) -> DMatrix<f64> {
    let height: usize = rows.iter().filter_map(|row| row.first()).map(|block| block.nrows()).sum();
    let width = rows.first().map_or(0, |row| row.iter().map(|block| block.ncols()).sum());
    let mut out = DMatrix::zeros(height, width);
    let mut top = 0;
    for row in rows {
        let mut left = 0;
        for block in *row {
            out.view_mut((top, left), block.shape()).copy_from(block);
            left += block.ncols();
        }
        top += row.first().map_or(0, |block| block.nrows());
    }
    out
}

/// Orthonormal basis of the x with Mx = 0, next to elements as large as `one`.
fn null_space(m: &DMatrix<f64>, one: f64) -> Result<DMatrix<f64>, LinalgError> {
    directions(m.tr_mul(m), |square| square <= NONE * one * one)
}

/// Orthonormal basis of what M, of orthonormal columns in part, makes of any x.
fn range(m: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    directions(m * m.transpose(), |square| square > NONE)
}

/// Eigenvectors of a positive semidefinite matrix whose eigenvalues are `wanted`.
fn directions(gram: DMatrix<f64>, wanted: impl Fn(f64) -> bool) -> Result<DMatrix<f64>, LinalgError> {
    let n = gram.nrows();
    if n == 0 {
        return Ok(gram);
    }
    let residual = gram.amax();
    let unsolved =
        LinalgError::NotConverged { what: "QR iteration of a Gram matrix", iterations: SWEEPS, change: 0.0, residual };
    let found = SymmetricEigen::try_new(gram, f64::EPSILON, SWEEPS).ok_or(unsolved)?;
    let chosen: Vec<usize> = (0..n).filter(|i| wanted(found.eigenvalues[*i])).collect();
    Ok(found.eigenvectors.select_columns(&chosen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::discretize::zero_order_hold;

    fn sampled(a: &[f64], b: &[f64], c: &[f64], period_s: f64) -> StateSpace {
        let n = b.len();
        let held =
            zero_order_hold(&DMatrix::from_row_slice(n, n, a), &DMatrix::from_row_slice(n, 1, b), period_s).unwrap();
        let c = DMatrix::from_row_slice(c.len() / n, n, c);
        StateSpace { a: held.a, b: held.b, d: DMatrix::zeros(c.nrows(), 1), c }
    }

    fn zeros(system: &StateSpace) -> Vec<f64> {
        let Nulling::Dynamics(found) = nulling(system).unwrap() else { panic!("{system:?}") };
        // Rosenbrock's matrix has the input in its kernel: (A − λ)Vξ + BGξ = 0 and CVξ + DGξ = 0.
        let left = &system.a * &found.basis + &system.b * &found.input - &found.basis * &found.next;
        let seen = &system.c * &found.basis + &system.d * &found.input;
        assert!(left.amax().max(seen.amax()) < 1e-9 || found.basis.ncols() == 0, "{left} {seen}");
        assert!(found.zeros.iter().all(|zero| zero.im.abs() < 1e-9), "{:?}", found.zeros);
        found.zeros.iter().map(|zero| zero.re).collect()
    }

    #[test]
    fn sampled_integrators_have_the_zeros_of_the_textbook() {
        // [Åström, Hagander & Sternby 1984]: 1/s² held has z + 1, 1/s³ z² + 4z + 1.
        let two = zeros(&sampled(&[0.0, 1.0, 0.0, 0.0], &[0.0, 1.0], &[1.0, 0.0], 0.1));
        assert!(two.len() == 1 && (two[0] + 1.0).abs() < 1e-9, "{two:?}");
        let a = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        let three = zeros(&sampled(&a, &[0.0, 0.0, 1.0], &[1.0, 0.0, 0.0], 0.1));
        let root = 3.0_f64.sqrt();
        assert!((three[0] + 2.0 + root).abs() < 1e-8 && (three[1] + 2.0 - root).abs() < 1e-8, "{three:?}");
        // The speed measured as well: no zero in common.
        assert!(zeros(&sampled(&[0.0, 1.0, 0.0, 0.0], &[0.0, 1.0], &[1.0, 0.0, 0.0, 1.0], 0.1)).is_empty());
    }

    #[test]
    fn zeros_are_those_that_scipy_finds() {
        // 1/(s²(0.01875 s + 1)) held for 0.1 s: SciPy 1.17, `cont2discrete` and the generalised eigenvalues of Rosenbrock's pencil.
        let lag = 1.0 / 0.01875;
        let a = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -lag];
        let found = zeros(&sampled(&a, &[0.0, 0.0, lag], &[1.0, 0.0, 0.0], 0.1));
        let expected = [-1.719_792_74, -0.052_990_37];
        assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-8), "{found:?}");
    }

    #[test]
    fn unseen_states_are_zeros_and_what_nobody_measures_is_free() {
        // Position, speed, force behind a double integrator; only the force is measured: a chain of two at 1.
        let chain = StateSpace {
            a: DMatrix::from_row_slice(3, 3, &[1.0, 0.1, 0.005, 0.0, 1.0, 0.1, 0.0, 0.0, 0.5]),
            b: DMatrix::zeros(3, 0),
            c: DMatrix::from_row_slice(1, 3, &[0.0, 0.0, 1.0]),
            d: DMatrix::zeros(1, 0),
        };
        let Nulling::Dynamics(found) = nulling(&chain).unwrap() else { panic!() };
        assert_eq!(found.basis.ncols(), 2);
        assert!(found.zeros.iter().all(|zero| (zero - Complex::new(1.0, 0.0)).norm() < 1e-6), "{:?}", found.zeros);
        // It does grow.
        assert!((found.next.pow(100).amax() - 10.0).abs() < 0.1, "{}", found.next.pow(100));
        let unseen = StateSpace {
            b: DMatrix::from_row_slice(3, 2, &[0.0, 0.0, 0.1, 0.0, 0.0, 1.0]),
            d: DMatrix::zeros(1, 2),
            ..chain
        };
        assert_eq!(nulling(&unseen).unwrap(), Nulling::Free(1));
        let shapeless = StateSpace { c: DMatrix::zeros(1, 2), ..unseen };
        assert!(nulling(&shapeless).unwrap_err().to_string().contains("C is 1 x 2, expected 1 x 3"));
    }
}

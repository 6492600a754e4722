//! What nalgebra lacks: matrix exponential, Riccati, Lyapunov and Stein equations, eigenvalues with
//! an iteration limit.
//!
//! Everything here is bounded: a solve that fails is a [`LinalgError`] with the figures that show why.

mod eigen;
mod expm;
mod hinf_norm;
mod lyapunov;
mod riccati;
mod wide;

use nalgebra::{DMatrix, Dyn, SymmetricEigen};

pub use eigen::{Complex, eigenvalues};
pub use expm::{expm, expm_with_integral};
pub use hinf_norm::{hinf_norm, largest_singular_value};
pub use lyapunov::{lyapunov, stein};
pub use riccati::{RiccatiSolution, care, care_by_sign, care_general, care_indefinite, dare, dare_general};

/// Iterations for the eigenvalues of a symmetric matrix.
const EIGEN_ITERATIONS: usize = 1000;

/// Why a solve failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LinalgError {
    /// The shapes do not fit.
    #[error("{what} is {rows} x {columns}, expected {expected_rows} x {expected_columns}")]
    Shape {
        /// Which matrix.
        what: &'static str,
        /// Rows found.
        rows: usize,
        /// Columns found.
        columns: usize,
        /// Rows expected.
        expected_rows: usize,
        /// Columns expected.
        expected_columns: usize,
    },
    /// An entry is NaN or infinite.
    #[error("{what}[{row}, {column}] is {value}")]
    NotFinite {
        /// Which matrix.
        what: &'static str,
        /// Row of the entry, from 0.
        row: usize,
        /// Column of the entry, from 0.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// A matrix that must be symmetric is not.
    #[error("{what} is not symmetric: largest |M - M'| is {asymmetry:.3e}")]
    Asymmetric {
        /// Which matrix.
        what: &'static str,
        /// Largest difference to the transpose.
        asymmetry: f64,
    },
    /// A matrix that must be positive definite is not.
    #[error("{what} is not positive definite: its smallest pivot is {pivot:.3e}")]
    NotPositiveDefinite {
        /// Which matrix.
        what: &'static str,
        /// Smallest pivot of its factorisation.
        pivot: f64,
    },
    /// A matrix to invert is singular to working precision.
    #[error("{what} is singular to working precision (condition {condition:.1e})")]
    Singular {
        /// Which matrix.
        what: &'static str,
        /// Estimate of its condition in the 1-norm.
        condition: f64,
    },
    /// The iteration did not converge within its limit.
    #[error(
        "{what} did not converge in {iterations} iterations: last relative change {change:.1e}, residual {residual:.1e}"
    )]
    NotConverged {
        /// Which iteration.
        what: &'static str,
        /// Iterations done.
        iterations: usize,
        /// Relative change of the last one.
        change: f64,
        /// Relative residual of what it reached.
        residual: f64,
    },
    /// The solution found does not stabilise: the problem has no stabilising solution.
    #[error("{what} has no stabilising solution: closed-loop {measure} {value:.6}")]
    NotStabilising {
        /// Which equation.
        what: &'static str,
        /// `largest real part` or `spectral radius`.
        measure: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Checks that `matrix` is `rows` × `columns` and finite.
pub(crate) fn check(what: &'static str, matrix: &DMatrix<f64>, rows: usize, columns: usize) -> Result<(), LinalgError> {
    if matrix.shape() != (rows, columns) {
        return Err(LinalgError::Shape {
            what,
            rows: matrix.nrows(),
            columns: matrix.ncols(),
            expected_rows: rows,
            expected_columns: columns,
        });
    }
    for column in 0..columns {
        for row in 0..rows {
            let value = matrix[(row, column)];
            if !value.is_finite() {
                return Err(LinalgError::NotFinite { what, row, column, value });
            }
        }
    }
    Ok(())
}

/// Checks that `matrix` is square, finite and symmetric to rounding; returns its symmetric part.
pub(crate) fn symmetric(what: &'static str, matrix: &DMatrix<f64>, n: usize) -> Result<DMatrix<f64>, LinalgError> {
    check(what, matrix, n, n)?;
    let asymmetry = (matrix - matrix.transpose()).amax();
    if asymmetry > 1e-9 * matrix.amax() {
        return Err(LinalgError::Asymmetric { what, asymmetry });
    }
    Ok(symmetrised(matrix))
}

/// (M + Mᵀ)/2.
pub(crate) fn symmetrised(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// Eigenvalues and eigenvectors of a symmetric matrix; `what` names it in the error.
pub(crate) fn symmetric_eigen(
    what: &'static str,
    matrix: DMatrix<f64>,
) -> Result<SymmetricEigen<f64, Dyn>, LinalgError> {
    SymmetricEigen::try_new(matrix, f64::EPSILON, EIGEN_ITERATIONS).ok_or(LinalgError::NotConverged {
        what,
        iterations: EIGEN_ITERATIONS,
        change: f64::NAN,
        residual: f64::NAN,
    })
}

/// Largest column sum of absolute values.
pub(crate) fn norm_1(matrix: &DMatrix<f64>) -> f64 {
    matrix.column_iter().map(|c| c.iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max)
}

/// Inverse by LU with partial pivoting; refuses what is singular to working precision.
pub(crate) fn inverse(what: &'static str, matrix: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let singular = |condition| LinalgError::Singular { what, condition };
    let inverse = matrix.clone().lu().try_inverse().ok_or(singular(f64::INFINITY))?;
    let condition = norm_1(matrix) * norm_1(&inverse);
    if condition.is_finite() && condition < 1e18 { Ok(inverse) } else { Err(singular(condition)) }
}

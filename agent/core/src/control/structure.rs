//! Can every state be moved, and seen? Ranks, modes and finite-horizon Gramians.
//!
//! Deviation from \[Strategies\]: the Gramians over [0, ∞) diverge, because every pole of the hovering vehicle is
//! at zero (ERRATA 1); here they run to a finite horizon, and rank and PBH tests answer the question.
//!
//! | symbol | meaning |
//! |---|---|
//! | 𝒪 | [C; CA; …; CAⁿ⁻¹] |
//! | W_c, W_o | ∫₀ᵀ e^{At}BBᵀe^{Aᵀt} dt, ∫₀ᵀ e^{Aᵀt}CᵀCe^{At} dt |

use nalgebra::DMatrix;

use crate::linalg::{Complex, LinalgError, eigenvalues, expm_with_integral};

/// Singular directions below this part of the largest count as none.
const RANK_TOLERANCE: f64 = 1e-9;

/// Rank by QR with column pivoting; rows are scaled to length one first.
pub fn rank(m: &DMatrix<f64>) -> usize {
    let mut scaled = m.clone();
    for mut row in scaled.row_iter_mut() {
        let norm = row.norm();
        if norm > 0.0 {
            row /= norm;
        }
    }
    let r = scaled.col_piv_qr().r();
    let diagonal = r.diagonal();
    let limit = RANK_TOLERANCE * diagonal.amax();
    diagonal.iter().filter(|v| v.abs() > limit && v.abs() > 0.0).count()
}

/// [C; CA; …; CAⁿ⁻¹].
pub fn observability_matrix(a: &DMatrix<f64>, c: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, p) = (a.nrows(), c.nrows());
    let mut out = DMatrix::zeros(n * p, n);
    let mut block = c.clone();
    for k in 0..n {
        out.view_mut((k * p, 0), (p, n)).copy_from(&block);
        block = &block * a;
        // Only directions matter.
        let size = block.amax();
        if size > 0.0 {
            block /= size;
        }
    }
    out
}

/// Rank of [B AB … Aⁿ⁻¹B].
pub fn controllable_rank(a: &DMatrix<f64>, b: &DMatrix<f64>) -> usize {
    observable_rank(&a.transpose(), &b.transpose())
}

/// Rank of [C; CA; …].
pub fn observable_rank(a: &DMatrix<f64>, c: &DMatrix<f64>) -> usize {
    rank(&observability_matrix(a, c))
}

/// Rank of [λI − A; C] (Popov, Belevitch, Hautus): n when the mode λ is seen.
pub fn pbh_rank(a: &DMatrix<f64>, c: &DMatrix<f64>, lambda: Complex) -> usize {
    // As a real matrix of twice the size, whose rank is twice that of the complex one.
    let (n, p) = (a.nrows(), c.nrows());
    let mut m = DMatrix::zeros(2 * (n + p), 2 * n);
    for block in 0..2 {
        let (row, column) = (block * (n + p), block * n);
        m.view_mut((row, column), (n, n)).copy_from(&(DMatrix::identity(n, n) * lambda.re - a));
        m.view_mut((row + n, column), (p, n)).copy_from(c);
        let sign = if block == 0 { -1.0 } else { 1.0 };
        m.view_mut((row, (1 - block) * n), (n, n)).copy_from(&(DMatrix::identity(n, n) * (sign * lambda.im)));
    }
    rank(&m) / 2
}

/// The first of the modes that are `lasting` which no output shows.
///
/// # Errors
/// When an eigenvalue does not converge.
pub fn unseen_mode(
    a: &DMatrix<f64>,
    c: &DMatrix<f64>,
    lasting: impl Fn(&Complex) -> bool,
) -> Result<Option<Complex>, LinalgError> {
    Ok(eigenvalues(a)?.into_iter().filter(lasting).find(|mode| pbh_rank(a, c, *mode) < a.nrows()))
}

/// Does every mode that is not seen die away by itself?
///
/// # Errors
/// When an eigenvalue does not converge.
pub fn detectable(a: &DMatrix<f64>, c: &DMatrix<f64>) -> Result<bool, LinalgError> {
    Ok(unseen_mode(a, c, |mode| mode.re >= 0.0)?.is_none())
}

/// States (unit vectors) that no output ever shows.
pub fn unobservable_states(a: &DMatrix<f64>, c: &DMatrix<f64>) -> Vec<usize> {
    let o = observability_matrix(a, c);
    (0..a.nrows()).filter(|&i| o.column(i).amax() <= RANK_TOLERANCE * o.amax()).collect()
}

/// W_c to the horizon `t_s`; W_o is that of Aᵀ and Cᵀ.
///
/// # Errors
/// When the exponential overflows.
pub fn gramian(a: &DMatrix<f64>, b: &DMatrix<f64>, t_s: f64) -> Result<DMatrix<f64>, LinalgError> {
    Ok(expm_with_integral(&a.transpose(), &(b * b.transpose()), t_s)?.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn a_double_integrator_is_seen_through_its_position_only() {
        let a = dmatrix![0.0, 1.0; 0.0, 0.0];
        assert_eq!(observable_rank(&a, &dmatrix![1.0, 0.0]), 2);
        assert_eq!(observable_rank(&a, &dmatrix![0.0, 1.0]), 1);
        assert_eq!(unobservable_states(&a, &dmatrix![0.0, 1.0]), [0]);
        assert_eq!(pbh_rank(&a, &dmatrix![0.0, 1.0], Complex::new(0.0, 0.0)), 1);
        assert!(!detectable(&a, &dmatrix![0.0, 1.0]).unwrap());
        assert_eq!(controllable_rank(&a, &dmatrix![0.0; 1.0]), 2);
        let w = gramian(&a, &dmatrix![0.0; 1.0], 2.0).unwrap();
        assert!((w - dmatrix![8.0 / 3.0, 2.0; 2.0, 2.0]).amax() < 1e-12);
        // An undamped mode that is seen, and one that is not.
        let swing = dmatrix![0.0, 1.0; -4.0, 0.0];
        assert_eq!(pbh_rank(&swing, &dmatrix![1.0, 0.0], Complex::new(0.0, 2.0)), 2);
        assert_eq!(pbh_rank(&swing, &dmatrix![0.0, 0.0], Complex::new(0.0, 2.0)), 1);
    }
}

//! Continuous to sampled: zero-order hold, and the sampled equivalent of a continuous cost.

use nalgebra::DMatrix;

use crate::linalg::{LinalgError, expm, expm_with_integral};

/// x₊ = A x + B u with u held over each period.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampled {
    /// exp(A T).
    pub a: DMatrix<f64>,
    /// ∫₀ᵀ exp(A s) ds B.
    pub b: DMatrix<f64>,
}

/// Sampled plant with zero-order hold of `period_s`.
///
/// # Errors
/// When shapes do not fit or the exponential overflows.
pub fn zero_order_hold(a: &DMatrix<f64>, b: &DMatrix<f64>, period_s: f64) -> Result<Sampled, LinalgError> {
    let e = expm(&(block(a, b) * period_s))?;
    let (n, m) = (a.nrows(), b.ncols());
    Ok(Sampled { a: e.view((0, 0), (n, n)).into_owned(), b: e.view((0, n), (n, m)).into_owned() })
}

/// Σ xᵀQx + 2xᵀNu + uᵀRu over samples.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledCost {
    /// Q of the samples.
    pub q: DMatrix<f64>,
    /// Cross term.
    pub n: DMatrix<f64>,
    /// R of the samples.
    pub r: DMatrix<f64>,
}

/// The sampled plant and the sum that equals ∫ xᵀQx + uᵀRu dt between samples.
///
/// # Errors
/// As [`zero_order_hold`].
pub fn sampled_cost(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    period_s: f64,
) -> Result<(Sampled, SampledCost), LinalgError> {
    let (n, m) = (a.nrows(), b.ncols());
    let size = n + m;
    let f = block(a, b);
    let mut weight = DMatrix::zeros(size, size);
    weight.view_mut((0, 0), (n, n)).copy_from(q);
    weight.view_mut((n, n), (m, m)).copy_from(r);
    let (phi, cost) = expm_with_integral(&f, &weight, period_s)?;
    let part = |r0: usize, c0: usize, rows: usize, columns: usize| cost.view((r0, c0), (rows, columns)).into_owned();
    let plant = Sampled { a: phi.view((0, 0), (n, n)).into_owned(), b: phi.view((0, n), (n, m)).into_owned() };
    Ok((plant, SampledCost { q: part(0, 0, n, n), n: part(0, n, n, m), r: part(n, n, m, m) }))
}

/// [[A, B], [0, 0]].
fn block(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = (a.nrows(), b.ncols());
    let mut out = DMatrix::zeros(n + m, n + m);
    out.view_mut((0, 0), (n, n)).copy_from(a);
    out.view_mut((0, n), (n, m)).copy_from(b);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn double_integrator_has_closed_forms() {
        let (a, b, t) = (dmatrix![0.0, 1.0; 0.0, 0.0], dmatrix![0.0; 1.0], 0.1);
        let q = dmatrix![2.0, 0.0; 0.0, 0.0];
        let (plant, cost) = sampled_cost(&a, &b, &q, &dmatrix![3.0], t).unwrap();
        assert!((&plant.a - dmatrix![1.0, t; 0.0, 1.0]).amax() < 1e-15);
        assert!((&plant.b - dmatrix![t * t / 2.0; t]).amax() < 1e-15);
        assert_eq!(zero_order_hold(&a, &b, t).unwrap().a, plant.a);
        // ∫ 2 (x + v s + u s²/2)² + 3u² ds.
        let expected = dmatrix![2.0 * t, t * t; t * t, 2.0 * t.powi(3) / 3.0];
        assert!((&cost.q - expected).amax() < 1e-15);
        assert!((&cost.n - dmatrix![t.powi(3) / 3.0; t.powi(4) / 4.0]).amax() < 1e-15);
        assert!((cost.r[(0, 0)] - (3.0 * t + 2.0 * t.powi(5) / 20.0)).abs() < 1e-15);
    }
}

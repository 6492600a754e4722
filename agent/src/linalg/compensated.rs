//! Sums of matrix products in twice the working precision, for residuals that cancel.
//!
//! Source: T. J. Dekker, A floating-point technique for extending the available precision,
//! Numer. Math. 18 (1971): error-free products and sums. No fused multiply-add is assumed.

use nalgebra::DMatrix;

/// A matrix as the unevaluated sum of two.
#[derive(Debug, Clone)]
pub(crate) struct Pair {
    pub hi: DMatrix<f64>,
    pub lo: DMatrix<f64>,
}

/// One product of a sum: sign, left and right factor.
pub(crate) type Term<'a> = (f64, &'a DMatrix<f64>, &'a DMatrix<f64>);

/// plus + Σ sign · left · right.
pub(crate) fn sum(plus: &DMatrix<f64>, terms: &[Term<'_>]) -> Pair {
    let mut hi = plus.clone();
    let mut lo = DMatrix::zeros(plus.nrows(), plus.ncols());
    for column in 0..plus.ncols() {
        for row in 0..plus.nrows() {
            let (mut h, mut l) = (plus[(row, column)], 0.0);
            for (sign, left, right) in terms {
                for k in 0..left.ncols() {
                    let (p, e) = product(sign * left[(row, k)], right[(k, column)]);
                    let (s, f) = two_sum(h, p);
                    h = s;
                    l += e + f;
                }
            }
            let (s, f) = two_sum(h, l);
            hi[(row, column)] = s;
            lo[(row, column)] = f;
        }
    }
    Pair { hi, lo }
}

/// a + b = s + e exactly.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

/// a · b = p + e exactly, barring overflow.
fn product(a: f64, b: f64) -> (f64, f64) {
    let split = |v: f64| {
        let t = 134_217_729.0 * v;
        let high = t - (t - v);
        (high, v - high)
    };
    let p = a * b;
    let ((ah, al), (bh, bl)) = (split(a), split(b));
    (p, ((ah * bh - p) + ah * bl + al * bh) + al * bl)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn what_cancels_is_kept() {
        // 1e16 + 1 − 1e16, and (1 + 2⁻³⁰)² − 1 − 2⁻²⁹ = 2⁻⁶⁰.
        let ones = dmatrix![1.0, 1.0, 1.0];
        let s = sum(&dmatrix![0.0], &[(1.0, &ones, &dmatrix![1e16; 1.0; -1e16])]);
        assert_eq!(s.hi[(0, 0)], 1.0);
        let a = dmatrix![1.0 + 2.0_f64.powi(-30)];
        let s = sum(&dmatrix![-1.0 - 2.0_f64.powi(-29)], &[(1.0, &a, &a)]);
        assert_eq!(s.hi[(0, 0)], 2.0_f64.powi(-60));
    }
}

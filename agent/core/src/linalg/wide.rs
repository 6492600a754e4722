//! Riccati equations in twice the working precision, about 31 digits: for regulators that double precision does
//! not solve (single inputs on many unstable modes, modes hardly controllable), where the doubling loses as many
//! digits as its I + GH has condition.
//!
//! Source: T. J. Dekker, A floating-point technique for extending the available precision, Numer. Math. 18
//! (1971); D. E. Knuth, The Art of Computer Programming II, 4.2.2. No fused multiply-add is assumed. The
//! doubling is that of [`super::riccati`].

use std::ops::{Add, Div, Mul, Neg, Sub};

use nalgebra::DMatrix;

/// Doublings at most; one more than double precision needs is usual.
const MAX_DOUBLINGS: usize = 64;
/// Relative change below which the doubling has converged.
const CONVERGED: f64 = 1e-30;

/// hi + lo, |lo| at most half a unit in the last place of hi.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Twofold {
    hi: f64,
    lo: f64,
}

impl Twofold {
    /// hi + lo where |hi| ≥ |lo|.
    fn sorted(hi: f64, lo: f64) -> Self {
        let s = hi + lo;
        Self { hi: s, lo: lo - (s - hi) }
    }
}

impl Add for Twofold {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (s, e) = two_sum(self.hi, other.hi);
        let (t, f) = two_sum(self.lo, other.lo);
        let Self { hi, lo } = Self::sorted(s, e + t);
        Self::sorted(hi, lo + f)
    }
}

impl Neg for Twofold {
    type Output = Self;
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl Sub for Twofold {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Twofold {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let (p, e) = product(self.hi, other.hi);
        Self::sorted(p, e + (self.hi * other.lo + self.lo * other.hi))
    }
}

impl Div for Twofold {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let whole = |v: f64| Self { hi: v, lo: 0.0 };
        let first = self.hi / other.hi;
        let left = self - other * whole(first);
        let second = left.hi / other.hi;
        let left = left - other * whole(second);
        Self::sorted(first, second) + whole(left.hi / other.hi)
    }
}

/// A matrix of [`Twofold`], row-major.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Wide {
    rows: usize,
    columns: usize,
    values: Vec<Twofold>,
}

impl Wide {
    fn from_fn(rows: usize, columns: usize, mut value: impl FnMut(usize, usize) -> Twofold) -> Self {
        let values = (0..rows * columns).map(|i| value(i / columns, i % columns)).collect();
        Self { rows, columns, values }
    }

    /// Exactly `m`.
    pub(super) fn new(m: &DMatrix<f64>) -> Self {
        Self::from_fn(m.nrows(), m.ncols(), |r, c| Twofold { hi: m[(r, c)], lo: 0.0 })
    }

    /// v I.
    fn scalar(n: usize, v: f64) -> Self {
        Self::from_fn(n, n, |r, c| Twofold { hi: if r == c { v } else { 0.0 }, lo: 0.0 })
    }

    /// The nearest in double precision.
    pub(super) fn rounded(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.rows, self.columns, |r, c| self.at(r, c).hi)
    }

    fn at(&self, row: usize, column: usize) -> Twofold {
        self.values[row * self.columns + column]
    }

    fn transpose(&self) -> Self {
        Self::from_fn(self.columns, self.rows, |r, c| self.at(c, r))
    }

    fn plus(&self, other: &Self) -> Self {
        Self::from_fn(self.rows, self.columns, |r, c| self.at(r, c) + other.at(r, c))
    }

    pub(super) fn minus(&self, other: &Self) -> Self {
        Self::from_fn(self.rows, self.columns, |r, c| self.at(r, c) - other.at(r, c))
    }

    pub(super) fn times(&self, other: &Self) -> Self {
        Self::from_fn(self.rows, other.columns, |r, c| {
            (0..self.columns).fold(Twofold::default(), |sum, k| sum + self.at(r, k) * other.at(k, c))
        })
    }

    fn scaled(&self, factor: f64) -> Self {
        let factor = Twofold { hi: factor, lo: 0.0 };
        Self::from_fn(self.rows, self.columns, |r, c| self.at(r, c) * factor)
    }

    fn symmetrised(&self) -> Self {
        self.plus(&self.transpose()).scaled(0.5)
    }

    fn norm(&self) -> f64 {
        self.values.iter().map(|v| v.hi * v.hi).sum::<f64>().sqrt()
    }

    /// The solution of `self` X = `right`, by LU with partial pivoting; `None` when a pivot is zero.
    fn solve(&self, right: &Self) -> Option<Self> {
        let (n, m) = (self.rows, right.columns);
        let (mut a, mut x) = (self.clone(), right.clone());
        for k in 0..n {
            let pivot = (k..n).max_by(|&i, &j| a.at(i, k).hi.abs().total_cmp(&a.at(j, k).hi.abs()))?;
            let diagonal = a.at(pivot, k);
            if diagonal.hi == 0.0 || !diagonal.hi.is_finite() {
                return None;
            }
            (0..n).for_each(|c| a.values.swap(k * n + c, pivot * n + c));
            (0..m).for_each(|c| x.values.swap(k * m + c, pivot * m + c));
            for i in k + 1..n {
                let factor = a.at(i, k) / diagonal;
                if factor.hi == 0.0 {
                    continue;
                }
                (k + 1..n).for_each(|c| a.values[i * n + c] = a.at(i, c) - factor * a.at(k, c));
                (0..m).for_each(|c| x.values[i * m + c] = x.at(i, c) - factor * x.at(k, c));
            }
        }
        for k in (0..n).rev() {
            for c in 0..m {
                let known = (k + 1..n).fold(x.at(k, c), |left, j| left - a.at(k, j) * x.at(j, c));
                x.values[k * m + c] = known / a.at(k, k);
            }
        }
        Some(x)
    }
}

/// B R⁻¹ Bᵀ.
fn quadratic(b: &Wide, r: &Wide) -> Option<Wide> {
    Some(b.times(&r.solve(&b.transpose())?).symmetrised())
}

/// Stabilising solution of the CARE and its K = R⁻¹BᵀX, with γ as the parameter of the Cayley transform, 1/s.
pub(super) fn care([a, b, q, r]: [&DMatrix<f64>; 4], gamma: f64) -> Option<(Wide, Wide)> {
    let [a, b, q, r] = [a, b, q, r].map(Wide::new);
    let g = quadratic(&b, &r)?;
    let n = a.rows;
    // Chu, Fan, Lin 2005, Eq. 2.6–2.9.
    let identity = Wide::scalar(n, 1.0);
    let inverse = a.minus(&Wide::scalar(n, gamma)).solve(&identity)?;
    let w = a.transpose().minus(&Wide::scalar(n, gamma)).plus(&q.times(&inverse).times(&g));
    let w_inverse = w.solve(&identity)?;
    let x = doubling(
        identity.plus(&w_inverse.transpose().scaled(2.0 * gamma)),
        inverse.times(&g).times(&w_inverse).scaled(2.0 * gamma).symmetrised(),
        w_inverse.times(&q).times(&inverse).scaled(2.0 * gamma).symmetrised(),
    )?;
    let k = r.solve(&b.transpose().times(&x))?;
    Some((x, k))
}

/// Stabilising solution of the DARE and its K = (R + BᵀXB)⁻¹BᵀXA.
pub(super) fn dare([a, b, q, r]: [&DMatrix<f64>; 4]) -> Option<(Wide, Wide)> {
    let [a, b, q, r] = [a, b, q, r].map(Wide::new);
    let x = doubling(a.clone(), quadratic(&b, &r)?, q)?;
    let bt_x = b.transpose().times(&x);
    let k = r.plus(&bt_x.times(&b)).solve(&bt_x.times(&a))?;
    Some((x, k))
}

/// AᵀX + XA − XGX + Q for X in double precision, its norm over that of its terms.
pub(super) fn care_residual([a, b, q, r]: [&DMatrix<f64>; 4], x: &DMatrix<f64>) -> Option<f64> {
    let [a, b, q, r, x] = [a, b, q, r, x].map(Wide::new);
    let linear = a.transpose().times(&x);
    let bt_x = b.transpose().times(&x);
    let quadratic = bt_x.transpose().times(&r.solve(&bt_x)?);
    let left = linear.plus(&linear.transpose()).minus(&quadratic).plus(&q);
    Some(left.norm() / (2.0 * linear.norm() + quadratic.norm() + q.norm()).max(f64::MIN_POSITIVE))
}

/// AᵀX(A − BK) − X + Q for X in double precision, its norm over that of X and Q.
pub(super) fn dare_residual([a, b, q, r]: [&DMatrix<f64>; 4], x: &DMatrix<f64>) -> Option<f64> {
    let [a, b, q, r, x] = [a, b, q, r, x].map(Wide::new);
    let bt_x = b.transpose().times(&x);
    let k = r.plus(&bt_x.times(&b)).solve(&bt_x.times(&a))?;
    let closed = a.minus(&b.times(&k));
    let left = a.transpose().times(&x).times(&closed).minus(&x).plus(&q);
    Some(left.norm() / (2.0 * x.norm() + q.norm()).max(f64::MIN_POSITIVE))
}

/// Structure-preserving doubling: H → X.
fn doubling(mut a: Wide, mut g: Wide, mut h: Wide) -> Option<Wide> {
    let identity = Wide::scalar(a.rows, 1.0);
    for _ in 0..MAX_DOUBLINGS {
        let w = identity.plus(&g.times(&h));
        let w_a = w.solve(&a)?;
        let w_g = w.solve(&g)?;
        let step = a.transpose().times(&h).times(&w_a).symmetrised();
        g = g.plus(&a.times(&w_g).times(&a.transpose()).symmetrised());
        a = a.times(&w_a);
        h = h.plus(&step);
        let change = step.norm() / h.norm().max(f64::MIN_POSITIVE);
        if !change.is_finite() {
            return None;
        }
        if change <= CONVERGED {
            return Some(h);
        }
    }
    None
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

    #[test]
    fn what_cancels_is_kept() {
        // 1e16 + 1 − 1e16 = 1, (1 + 2⁻³⁰)² − 1 − 2⁻²⁹ = 2⁻⁶⁰, 3 (1/3) = 1.
        let sum =
            Wide::new(&nalgebra::dmatrix![1.0, 1.0, 1.0]).times(&Wide::new(&nalgebra::dmatrix![1e16; 1.0; -1e16]));
        assert_eq!(sum.rounded()[(0, 0)], 1.0);
        let whole = |v: f64| Twofold { hi: v, lo: 0.0 };
        let a = whole(1.0 + 2.0_f64.powi(-30));
        assert_eq!((a * a - whole(1.0 + 2.0_f64.powi(-29))).hi, 2.0_f64.powi(-60));
        let third = whole(1.0) / whole(3.0);
        assert!((third * whole(3.0) - whole(1.0)).hi.abs() < 1e-31);
    }

    #[test]
    fn a_hilbert_matrix_has_its_inverse_of_integers() {
        // Order 10, condition 1.6e13: double precision keeps three digits.
        let one = Twofold { hi: 1.0, lo: 0.0 };
        let hilbert = Wide::from_fn(10, 10, |r, c| one / Twofold { hi: (r + c + 1) as f64, lo: 0.0 });
        let inverse = hilbert.solve(&Wide::scalar(10, 1.0)).unwrap().rounded();
        assert_eq!((inverse[(0, 0)].round(), inverse[(9, 9)].round()), (100.0, 44_914_183_600.0));
        assert!(inverse.iter().all(|v| (v - v.round()).abs() < 1e-6), "{inverse}");
    }
}

//! Whitening and QR of one row of the window.
//!
//! Factors depend on the row and on which slots are filled, so each row keeps those of its last few masks
//! (its sampling phases): nothing is factored twice in a steady flight, and nothing is allocated after
//! construction in any.

use nalgebra::SMatrix;

use super::Row;
use crate::estimate::secure::SecureError;

/// Masks remembered for each row: more than any two rates here beat through.
const PHASES: usize = 8;
/// A column of Φ below this fraction of the largest adds nothing.
const RANK_TOLERANCE: f64 = 1e-9;

/// A row's Φ and covariance over the whole window, and its factors.
#[derive(Debug, Clone)]
pub(super) struct Phase {
    /// T × support, newest first, row-major.
    pub phi: Vec<f64>,
    /// States it sees in the window.
    pub support: Vec<usize>,
    /// T × T, row-major.
    pub covariance: Vec<f64>,
    pub factors: Vec<Factor>,
    pub next: usize,
}

/// Whitening and QR of one row for one mask.
#[derive(Debug, Clone)]
pub(super) struct Factor {
    /// Slots filled, bit k = k slots before the end; 0 for none yet.
    pub mask: u128,
    pub count: usize,
    /// Lower Cholesky factor of the covariance, count × count, row-major.
    pub l: Vec<f64>,
    /// Q, column-major, one zero below each column where a floor is needed.
    pub q: Vec<f64>,
    /// R, row-major.
    pub r: Vec<f64>,
    pub rank: usize,
    pub floor: bool,
}

impl Factor {
    pub fn samples(&self) -> usize {
        self.count + usize::from(self.floor)
    }

    /// Whitened row `k` of Φ: Q R, over `width` states.
    pub fn row<const N: usize>(&self, k: usize, width: usize) -> [f64; N] {
        let mut row = [0.0; N];
        for (j, r) in self.r.chunks_exact(width.max(1)).enumerate() {
            let q = self.q.get(j * self.samples() + k).copied().unwrap_or_default();
            row.iter_mut().zip(r).for_each(|(slot, r)| *slot += q * r);
        }
        row
    }
}

impl Phase {
    pub fn new<const N: usize>(
        index: usize,
        row: &Row<N>,
        a_inverse: &SMatrix<f64, N, N>,
        q: &SMatrix<f64, N, N>,
        slots: usize,
    ) -> Result<Self, SecureError> {
        let finite = row.c.iter().chain([&row.sigma, &row.bias_sigma]).all(|v| v.is_finite());
        if !finite || row.sigma <= 0.0 || row.bias_sigma < 0.0 {
            return Err(SecureError::Whitening { row: index, sigma: row.sigma });
        }
        // h_k = A^{−kᵀ} c.
        let mut h = Vec::with_capacity(slots + 1);
        h.push(row.c);
        for k in 0..slots {
            h.push(a_inverse.transpose() * h[k]);
        }
        let support: Vec<usize> = (0..N).filter(|j| h.iter().take(slots).any(|h| h[*j] != 0.0)).collect();
        let phi = h.iter().take(slots).flat_map(|h| support.iter().map(|j| h[*j])).collect();
        // w_j enters x_k = … − A^{−(k−j)} w_j for the transitions j < k after age k: ages count backwards.
        let mut covariance = vec![0.0; slots * slots];
        for a in 0..slots {
            for b in 0..slots {
                let common = a.min(b);
                let noise: f64 = (0..common).map(|j| h[a - j].dot(&(q * h[b - j]))).sum();
                let white = if a == b { row.sigma * row.sigma } else { 0.0 };
                covariance[a * slots + b] = noise + white + row.bias_sigma * row.bias_sigma;
            }
        }
        let rank = support.len().min(slots);
        let factor = Factor {
            mask: 0,
            count: 0,
            l: Vec::with_capacity(slots * slots),
            q: Vec::with_capacity((slots + 1) * rank),
            r: Vec::with_capacity(rank * support.len()),
            rank: 0,
            floor: false,
        };
        Ok(Self { phi, support, covariance, factors: (0..PHASES).map(|_| with_capacity(&factor)).collect(), next: 0 })
    }

    pub fn known(&self, mask: u128) -> Option<&Factor> {
        self.factors.iter().find(|factor| factor.mask == mask && mask != 0)
    }

    /// The factor for `mask`, made in the place of the oldest if there is none yet. `None` where the
    /// covariance has none (it always has: σ > 0).
    pub fn factor(&mut self, mask: u128, slots: usize, scratch: &mut [f64]) -> Option<&Factor> {
        if self.known(mask).is_none() {
            let at = self.next;
            self.next = (self.next + 1) % PHASES;
            self.make(at, mask, slots, scratch);
        }
        self.known(mask)
    }

    fn make(&mut self, at: usize, mask: u128, slots: usize, columns: &mut [f64]) {
        let width = self.support.len();
        let Some(factor) = self.factors.get_mut(at) else { return };
        let ages = || (0..slots).filter(|age| mask >> age & 1 == 1);
        let n = mask.count_ones() as usize;
        factor.mask = 0;
        factor.count = n;
        factor.l.clear();
        for a in ages() {
            factor.l.extend(ages().map(|b| self.covariance.get(a * slots + b).copied().unwrap_or_default()));
        }
        if !cholesky(&mut factor.l, n) {
            return;
        }
        // L⁻¹ Φ, column-major.
        for j in 0..width {
            for (k, age) in ages().enumerate() {
                if let (Some(slot), Some(v)) = (columns.get_mut(j * n + k), self.phi.get(age * width + j)) {
                    *slot = *v;
                }
            }
            forward(&factor.l, n, columns, 1, j * n);
        }
        orthogonalise(columns, n, width, factor);
        factor.mask = mask;
    }
}

/// A clone of an empty vector has no room: this one has.
fn with_capacity(factor: &Factor) -> Factor {
    Factor {
        l: Vec::with_capacity(factor.l.capacity()),
        q: Vec::with_capacity(factor.q.capacity()),
        r: Vec::with_capacity(factor.r.capacity()),
        ..factor.clone()
    }
}

/// Modified Gram–Schmidt with column pivoting, each column made orthogonal twice. `columns` (n × width,
/// column-major) is used up.
fn orthogonalise(columns: &mut [f64], n: usize, width: usize, factor: &mut Factor) {
    factor.q.clear();
    factor.r.clear();
    factor.rank = 0;
    let mut largest = 0.0_f64;
    let most = n.min(width);
    // Rank first (for the floor): at most `most` columns are taken.
    for _ in 0..most {
        let pivot = columns
            .chunks_exact(n)
            .take(width)
            .map(|c| c.iter().map(|v| v * v).sum::<f64>())
            .enumerate()
            .fold((0, 0.0), |best, (j, s)| if s > best.1 { (j, s) } else { best });
        let norm = pivot.1.sqrt();
        largest = largest.max(norm);
        if norm.is_nan() || norm <= RANK_TOLERANCE * largest || norm == 0.0 {
            break;
        }
        let first = factor.q.len();
        let column = columns.iter().skip(pivot.0 * n).take(n).map(|v| v / norm);
        factor.q.extend(column);
        let row = factor.r.len();
        factor.r.resize(row + width, 0.0);
        for pass in 0..2 {
            for (j, other) in columns.chunks_exact_mut(n).take(width).enumerate() {
                let q = factor.q.get(first..first + n).unwrap_or_default();
                let along: f64 = q.iter().zip(other.iter()).map(|(q, v)| q * v).sum();
                other.iter_mut().zip(q).for_each(|(v, q)| *v -= along * q);
                if let Some(r) = factor.r.get_mut(row + j) {
                    *r += along;
                }
                let _ = pass;
            }
        }
        // The pivot itself is used up, whatever rounding left of it.
        columns.iter_mut().skip(pivot.0 * n).take(n).for_each(|v| *v = 0.0);
        factor.rank += 1;
    }
    factor.floor = n <= factor.rank;
    if factor.floor {
        // One more row of zeros below each column, from the last on.
        let rank = factor.rank;
        factor.q.resize(rank * (n + 1), 0.0);
        for j in (0..rank).rev() {
            factor.q.copy_within(j * n..(j + 1) * n, j * (n + 1));
            if let Some(v) = factor.q.get_mut(j * (n + 1) + n) {
                *v = 0.0;
            }
        }
    }
}

/// Lower Cholesky factor in place (row-major n × n); false where there is none.
fn cholesky(m: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| m[i * n + k] * m[j * n + k]).sum();
            let rest = m[i * n + j] - dot;
            if i == j {
                if rest.is_nan() || rest <= 0.0 {
                    return false;
                }
                m[i * n + i] = rest.sqrt();
            } else {
                m[i * n + j] = rest / m[j * n + j];
            }
        }
    }
    true
}

/// v ← L⁻¹ v for the `n` entries of `v` from `first` on.
pub(super) fn forward(l: &[f64], n: usize, v: &mut [f64], stride: usize, first: usize) {
    for i in 0..n {
        let (mut sum, mut pivot) = (v.get(first + i * stride).copied().unwrap_or_default(), 1.0);
        for (k, factor) in l.iter().skip(i * n).take(i + 1).enumerate() {
            if k == i {
                pivot = *factor;
            } else {
                sum -= factor * v.get(first + k * stride).copied().unwrap_or_default();
            }
        }
        if let Some(slot) = v.get_mut(first + i * stride) {
            *slot = sum / pivot;
        }
    }
}

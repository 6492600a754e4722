//! Exact per-sensor rank-revealing QR: the same objective from far fewer numbers.
//!
//! With Φᵢ = Qᵢ Rᵢ (rank rᵢ), ‖Yᵢ − Φᵢx‖² = ‖Qᵢᵀ Yᵢ − Rᵢ x‖² + cᵢ², cᵢ = ‖Yᵢ − Qᵢ Qᵢᵀ Yᵢ‖: what no
//! state can explain. A height in the hover model has rank 2 of T = 10. Only the columns a sensor
//! sees (its support) are kept. For the 1-norm nothing can be compressed: every sample is a term.

use nalgebra::{DMatrix, SMatrix};

use super::{Program, SecureError};

/// Largest relative error with which Q R must reproduce Φ. nalgebra's `svd` once was wrong here;
/// pivoted QR is checked instead of trusted.
const QR_TOLERANCE: f64 = 1e-12;

/// One term of the objective: rows of the compressed problem and how to make its right-hand side.
#[derive(Debug, Clone)]
struct Term {
    /// States its rows touch.
    support: Vec<usize>,
    /// r × support.len(), row-major.
    rows: Vec<f64>,
    /// Number of rows r.
    rank: usize,
    /// Where its samples begin in the window, and how many.
    samples: (usize, usize),
    /// samples × r, column-major: Q. Empty for single samples, where Q = 1.
    q: Vec<f64>,
}

/// The compressed suite: fixed while the model and the sampling phase stay the same.
#[derive(Debug, Clone)]
pub struct Compressed<const N: usize> {
    terms: Vec<Term>,
    /// The first so many are in use; the others keep their memory for later.
    active: usize,
    samples: usize,
    /// Cholesky factor of ΣRᵢᵀRᵢ, for the least-squares start and the dual projection.
    gram: nalgebra::Cholesky<f64, nalgebra::Const<N>>,
}

/// A term as the solver sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct TermRows<'a> {
    pub support: &'a [usize],
    pub rows: &'a [f64],
    pub rank: usize,
}

impl<const N: usize> Compressed<N> {
    /// Compresses `phi`: one T × N matrix per sensor.
    ///
    /// # Errors
    /// Wrong shapes, entries that are not finite, a suite that does not observe the state.
    pub fn new(phi: &[DMatrix<f64>], program: Program) -> Result<Self, SecureError> {
        let mut terms = Vec::new();
        let mut samples = 0;
        for (sensor, phi) in phi.iter().enumerate() {
            if phi.ncols() != N {
                let what = format!("a row of sensor {sensor}");
                return Err(SecureError::Shape { what, found: phi.ncols(), expected: N });
            }
            for sample in 0..phi.nrows() {
                if let Some(value) = phi.row(sample).iter().find(|v| !v.is_finite()) {
                    return Err(SecureError::NotFinite { sensor, sample, value: *value });
                }
            }
            match program {
                Program::L2 => terms.push(Self::sensor_term(sensor, phi, samples)?),
                Program::L1 => terms.extend((0..phi.nrows()).map(|t| Self::sample_term(phi, t, samples + t))),
            }
            samples += phi.nrows();
        }
        let active = terms.len();
        let mut compressed = Self { terms, active, samples, gram: identity()? };
        compressed.settle()?;
        Ok(compressed)
    }

    /// The same problem as it stands, every sample a row: what a solver without the compression has to do. For
    /// comparisons.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn uncompressed(phi: &[DMatrix<f64>]) -> Result<Self, SecureError> {
        // The checks are those of the compressed one.
        Self::new(phi, Program::L2)?;
        let samples = phi.iter().map(DMatrix::nrows).max().unwrap_or_default();
        let mut problem = Self::with_room(phi.len(), samples, 0)?;
        let all: Vec<usize> = (0..N).collect();
        for phi in phi {
            let t = phi.nrows();
            let q = DMatrix::<f64>::identity(t, t);
            problem.push(&all, phi.transpose().as_slice(), q.as_slice(), t, t);
        }
        problem.settle()?;
        Ok(problem)
    }

    /// Room for `terms` terms of at most `samples` samples each and `singles` more of one sample, none in it: for
    /// windows whose samples come and go.
    ///
    /// # Errors
    /// Never, for any N.
    pub(super) fn with_room(terms: usize, samples: usize, singles: usize) -> Result<Self, SecureError> {
        let empty = |samples: usize| Term {
            support: Vec::with_capacity(N),
            rows: Vec::with_capacity(samples.min(N) * N),
            rank: 0,
            samples: (0, 0),
            q: Vec::with_capacity(samples * samples.min(N)),
        };
        let large = (0..terms).map(|_| empty(samples));
        Ok(Self {
            terms: large.chain((0..singles).map(|_| empty(1))).collect(),
            active: 0,
            samples: 0,
            gram: identity()?,
        })
    }

    /// Takes every term out.
    pub(super) fn clear(&mut self) {
        self.active = 0;
        self.samples = 0;
    }

    /// Adds a term of `count` samples: `rows` is R (rank × support, row-major), `q` is Q (count × rank,
    /// column-major; empty for a single sample, where Q = 1). Allocates only beyond the room made; a term too many is refused.
    pub(super) fn push(&mut self, support: &[usize], rows: &[f64], q: &[f64], rank: usize, count: usize) -> bool {
        let Some(term) = self.terms.get_mut(self.active) else { return false };
        term.support.clear();
        term.support.extend_from_slice(support);
        term.rows.clear();
        term.rows.extend_from_slice(rows);
        term.q.clear();
        term.q.extend_from_slice(q);
        term.rank = rank;
        term.samples = (self.samples, count);
        self.samples += count;
        self.active += 1;
        true
    }

    /// The same terms as `other`, in the memory that is there.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.clear();
        for term in other.terms.iter().take(other.active) {
            self.push(&term.support, &term.rows, &term.q, term.rank, term.samples.1);
        }
        self.gram = other.gram;
    }

    /// To be called after the last [`Self::push`]: factors ΣRᵢᵀRᵢ.
    ///
    /// # Errors
    /// [`SecureError::Unobservable`] naming the state at the smallest pivot.
    pub(super) fn settle(&mut self) -> Result<(), SecureError> {
        let mut gram = SMatrix::<f64, N, N>::zeros();
        for term in self.terms.iter().take(self.active) {
            for row in term.rows.chunks_exact(term.support.len().max(1)) {
                for (a, va) in term.support.iter().zip(row) {
                    for (b, vb) in term.support.iter().zip(row) {
                        gram[(*a, *b)] += va * vb;
                    }
                }
            }
        }
        let largest = gram.diagonal().max();
        let unobservable = |pivot, state| SecureError::Unobservable { pivot, largest, state };
        let smallest = gram.diagonal().argmin();
        let factor = gram.cholesky().ok_or(unobservable(smallest.1, smallest.0))?;
        let pivots = factor.l_dirty().diagonal().map(|v| v * v);
        // Each pivot against the state's own scale: below rounding, the state is not observed.
        for state in 0..N {
            if pivots[state] <= 1e-13 * gram[(state, state)] {
                return Err(unobservable(pivots[state], state));
            }
        }
        self.gram = factor;
        Ok(())
    }

    fn sensor_term(sensor: usize, phi: &DMatrix<f64>, first: usize) -> Result<Term, SecureError> {
        let support: Vec<usize> = (0..N).filter(|j| phi.column(*j).amax() > 0.0).collect();
        let compact = phi.select_columns(&support);
        let t = phi.nrows();
        if support.is_empty() {
            return Ok(Term { support, rows: Vec::new(), rank: 0, samples: (first, t), q: Vec::new() });
        }
        let qr = compact.clone().col_piv_qr();
        let (q, mut r) = (qr.q(), qr.r());
        let scale = r[(0, 0)].abs();
        let cutoff = scale * f64::EPSILON * t.max(support.len()) as f64;
        let rank = (0..r.nrows().min(r.ncols())).take_while(|i| r[(*i, *i)].abs() > cutoff).count();
        qr.p().inv_permute_columns(&mut r);
        let (q, r) = (q.columns(0, rank).into_owned(), r.rows(0, rank).into_owned());
        let error = (&compact - &q * &r).norm() / compact.norm();
        if error.is_nan() || error > QR_TOLERANCE {
            return Err(SecureError::Factorisation { sensor, error });
        }
        Ok(Term {
            rows: r.transpose().as_slice().to_vec(),
            rank,
            samples: (first, t),
            q: q.as_slice().to_vec(),
            support,
        })
    }

    fn sample_term(phi: &DMatrix<f64>, t: usize, index: usize) -> Term {
        let support: Vec<usize> = (0..N).filter(|j| phi[(t, *j)] != 0.0).collect();
        let rows: Vec<f64> = support.iter().map(|j| phi[(t, *j)]).collect();
        let rank = usize::from(!support.is_empty());
        Term { support, rows, rank, samples: (index, 1), q: Vec::new() }
    }

    /// Samples of a whole window, all sensors one after the other.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Terms of the objective.
    pub fn terms(&self) -> usize {
        self.active
    }

    /// Rows of the compressed problem.
    pub fn rows(&self) -> usize {
        self.terms.iter().take(self.active).map(|t| t.rank).sum()
    }

    pub(super) fn term_rows(&self) -> impl Iterator<Item = TermRows<'_>> {
        self.terms.iter().take(self.active).map(|t| TermRows { support: &t.support, rows: &t.rows, rank: t.rank })
    }

    /// Solves (ΣRᵢᵀRᵢ) x = v in place.
    pub(super) fn solve_gram(&self, v: &mut nalgebra::SVector<f64, N>) {
        self.gram.solve_mut(v);
    }

    /// Right-hand sides b = Qᵀ Y (all rows, term by term) and what is left, c. No allocation.
    ///
    /// # Errors
    /// A window of the wrong length, or a sample that is not finite.
    pub(super) fn right_hand_side(&self, window: &[f64], b: &mut [f64], c: &mut [f64]) -> Result<(), SecureError> {
        if window.len() != self.samples {
            let what = "the window".to_owned();
            return Err(SecureError::Shape { what, found: window.len(), expected: self.samples });
        }
        let mut b = b.iter_mut();
        for (sensor, (term, c)) in self.terms.iter().take(self.active).zip(c).enumerate() {
            let (first, count) = term.samples;
            let y = window.get(first..first + count).unwrap_or_default();
            // One pass finds every NaN and infinity: only they make this sum not finite.
            if !y.iter().map(|v| v * 0.0).sum::<f64>().is_finite() {
                let sample = y.iter().position(|v| !v.is_finite()).unwrap_or_default();
                return Err(SecureError::NotFinite {
                    sensor,
                    sample,
                    value: y.get(sample).copied().unwrap_or(f64::NAN),
                });
            }
            if term.q.is_empty() {
                // Q = 1 (a single sample), or nothing is seen at all.
                match (term.rank, y) {
                    (1, [value]) => {
                        if let Some(slot) = b.next() {
                            *slot = *value;
                        }
                        *c = 0.0;
                    }
                    _ => *c = y.iter().map(|v| v * v).sum::<f64>().sqrt(),
                }
                continue;
            }
            let mut explained = [0.0; MAX_WINDOW];
            let explained = explained.get_mut(..count).unwrap_or_default();
            for column in term.q.chunks_exact(count) {
                let projection: f64 = column.iter().zip(y).map(|(q, v)| q * v).sum();
                for (slot, q) in explained.iter_mut().zip(column) {
                    *slot += q * projection;
                }
                if let Some(slot) = b.next() {
                    *slot = projection;
                }
            }
            *c = explained.iter().zip(y).map(|(e, v)| (v - e) * (v - e)).sum::<f64>().sqrt();
        }
        Ok(())
    }
}

/// Factor of the identity: a place to keep a factor before there is one.
fn identity<const N: usize>() -> Result<nalgebra::Cholesky<f64, nalgebra::Const<N>>, SecureError> {
    let unobservable = SecureError::Unobservable { pivot: 0.0, largest: 0.0, state: 0 };
    SMatrix::<f64, N, N>::identity().cholesky().ok_or(unobservable)
}

/// Longest window of one sensor, samples.
pub const MAX_WINDOW: usize = 256;

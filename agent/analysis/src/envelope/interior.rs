//! Interior point method for max cᵀa with |Ma| ≤ 1, dense: predictor and corrector \[Mehrotra 1992\].
//!
//! | symbol | meaning |
//! |---|---|
//! | M | a row for each statistic, over its limit, then one for each column, over the most that may be added |
//! | s± | 1 ∓ Ma, kept exact: no attack at all is where it begins |
//! | z± | multipliers of either side |
//! | H | Mᵀ(z⁺/s⁺ + z⁻/s⁻)M |
//!
//! Of its own because of time: Clarabel 0.11 on the very same programs takes 0.03 s of processor with one height attacked, 1.2 s with two and 1.8 s
//! with one IMU, so that all sets of two sensors take several times the two seconds that they may; dense rows are nothing to a sparse
//! factorisation. This takes some hundredths of a second for each. Tests hold it against Clarabel and cvxpy.
//!
//! A statistic hears nothing of what is added after it. With rows and columns in the order of time M is a staircase, and so is
//! what H costs.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Steps at most.
pub(super) const STEPS: usize = 60;
/// Rows and columns multiplied at once.
const BLOCK: usize = 48;
/// Part of the way to the next wall that a step takes.
const SHORT: f64 = 0.995;
/// Part of the largest diagonal element added to all: columns that nobody hears of.
const RIDGE: f64 = 1e-13;

/// The program, and where it is.
pub(super) struct Interior {
    /// Statistics only: rows in the order of time, columns in the order in which they are first heard of.
    m: DMatrix<f64>,
    transposed: DMatrix<f64>,
    /// Columns heard of until the end of each block of rows.
    heard: Vec<usize>,
    objective: DVector<f64>,
    /// 1/u.
    per_most: DVector<f64>,
    /// a.
    pub(super) attack: DVector<f64>,
    /// Both sides of all rows, m statistics and n columns.
    slack: [DVector<f64>; 2],
    multipliers: [DVector<f64>; 2],
}

impl Interior {
    /// At rest. `m` is M without its last rows.
    pub(super) fn new(m: DMatrix<f64>, objective: DVector<f64>, most: &DVector<f64>) -> Self {
        let (rows, n) = m.shape();
        let transposed = m.transpose();
        let last = |end: usize| (0..n).rev().find(|column| m.column(*column).iter().take(end).any(|x| *x != 0.0));
        let ends = (0..rows).step_by(BLOCK).map(|from| (from + BLOCK).min(rows));
        let heard = ends.map(|end| last(end).map_or(0, |column| column + 1)).collect();
        let ones = || DVector::from_element(rows + n, 1.0);
        let mut made = Self {
            m,
            transposed,
            heard,
            per_most: most.map(|most| 1.0 / most),
            objective,
            attack: DVector::zeros(n),
            slack: [ones(), ones()],
            multipliers: [ones(), ones()],
        };
        // Within the ellipsoid |Ma|₂ ≤ 1 it reaches √(cᵀ(MᵀM)⁻¹c): the size of the multipliers.
        let reached =
            made.factored(&ones()).map_or(1.0, |h| made.objective.dot(&h.solve(&made.objective)).max(0.0).sqrt());
        made.multipliers.iter_mut().for_each(|z| z.fill(reached.max(f64::MIN_POSITIVE) / (rows as f64 + 1.0).sqrt()));
        made
    }

    /// Multipliers of the statistics, signed.
    pub(super) fn signed(&self) -> Vec<f64> {
        let [above, below] = &self.multipliers;
        above.iter().zip(below).take(self.m.nrows()).map(|(above, below)| above - below).collect()
    }

    /// All of M.
    fn rows(&self, a: &DVector<f64>) -> DVector<f64> {
        let (rows, n) = self.m.shape();
        let mut out = DVector::zeros(rows + n);
        out.rows_mut(0, rows).gemv(1.0, &self.m, a, 0.0);
        out.rows_mut(rows, n).copy_from(&a.component_mul(&self.per_most));
        out
    }

    fn transposed(&self, z: &DVector<f64>) -> DVector<f64> {
        let (rows, n) = self.m.shape();
        self.m.tr_mul(&z.rows(0, rows)) + z.rows(rows, n).component_mul(&self.per_most)
    }

    /// Mᵀ diag(`weights`) M.
    fn factored(&self, weights: &DVector<f64>) -> Option<Cholesky<f64, nalgebra::Dyn>> {
        let (rows, n) = self.m.shape();
        let mut h =
            DMatrix::from_diagonal(&weights.rows(rows, n).component_mul(&self.per_most).component_mul(&self.per_most));
        for (from, heard) in (0..rows).step_by(BLOCK).zip(&self.heard) {
            let count = BLOCK.min(rows - from);
            let mut weighted = self.m.view((from, 0), (count, *heard)).into_owned();
            for mut column in weighted.column_iter_mut() {
                column.component_mul_assign(&weights.rows(from, count));
            }
            // Below the diagonal is enough.
            for left in (0..*heard).step_by(BLOCK) {
                let wide = BLOCK.min(heard - left);
                let tall = heard - left;
                let (of, by) = (self.transposed.view((left, from), (tall, count)), weighted.columns(left, wide));
                h.view_mut((left, left), (tall, wide)).gemm(1.0, &of, &by, 1.0);
            }
        }
        let ridge = RIDGE * h.diagonal().amax();
        (0..n).for_each(|i| h[(i, i)] += ridge);
        Cholesky::new(h)
    }

    /// μ: mean of s z.
    fn gap(&self, along: f64, slack: &[DVector<f64>; 2], dual: f64, multipliers: &[DVector<f64>; 2]) -> f64 {
        let side = |side: usize| {
            let s = &self.slack[side] + &slack[side] * along;
            s.dot(&(&self.multipliers[side] + &multipliers[side] * dual))
        };
        (side(0) + side(1)) / (2.0 * self.slack[0].len() as f64)
    }

    /// Step to s z = `centre` − `second`: attack, slacks, multipliers.
    fn direction(
        &self,
        h: &Cholesky<f64, nalgebra::Dyn>,
        centre: f64,
        second: &[DVector<f64>; 2],
    ) -> (DVector<f64>, [DVector<f64>; 2], [DVector<f64>; 2]) {
        let wanted: [DVector<f64>; 2] =
            std::array::from_fn(|side| second[side].map(|second| centre - second).component_div(&self.slack[side]));
        let attack = h.solve(&(&self.objective - self.transposed(&(&wanted[0] - &wanted[1]))));
        let rows = self.rows(&attack);
        let slack = [-&rows, rows];
        let multipliers = std::array::from_fn(|side| {
            let moved = self.multipliers[side].component_div(&self.slack[side]).component_mul(&slack[side]);
            &wanted[side] - &self.multipliers[side] - moved
        });
        (attack, slack, multipliers)
    }

    /// One step. False where it can get no nearer.
    pub(super) fn step(&mut self) -> bool {
        let weights =
            self.multipliers[0].component_div(&self.slack[0]) + self.multipliers[1].component_div(&self.slack[1]);
        let Some(h) = self.factored(&weights) else { return false };
        let rows = self.slack[0].len();
        let none = [DVector::zeros(rows), DVector::zeros(rows)];
        let (_, slack, multipliers) = self.direction(&h, 0.0, &none);
        let (primal, dual) = (longest(&self.slack, &slack), longest(&self.multipliers, &multipliers));
        let now = self.gap(0.0, &none, 0.0, &none);
        let left = self.gap(primal, &slack, dual, &multipliers) / now;
        let second = std::array::from_fn(|side| slack[side].component_mul(&multipliers[side]));
        let (attack, slack, multipliers) = self.direction(&h, left.powi(3) * now, &second);
        let (primal, dual) = (longest(&self.slack, &slack), longest(&self.multipliers, &multipliers));
        if !attack.iter().all(|x| x.is_finite()) || primal.max(dual) < 1e-9 {
            return false;
        }
        self.attack.axpy(primal, &attack, 1.0);
        for side in 0..2 {
            self.slack[side].axpy(primal, &slack[side], 1.0);
            self.multipliers[side].axpy(dual, &multipliers[side], 1.0);
        }
        true
    }
}

/// How much of the step `by` keeps `of` positive, 1 at most.
fn longest(of: &[DVector<f64>; 2], by: &[DVector<f64>; 2]) -> f64 {
    let wall = |side: usize| {
        let walls = of[side].iter().zip(&by[side]).filter(|(_, by)| **by < 0.0).map(|(of, by)| -of / by);
        walls.fold(f64::INFINITY, f64::min)
    };
    (SHORT * wall(0).min(wall(1))).min(1.0)
}

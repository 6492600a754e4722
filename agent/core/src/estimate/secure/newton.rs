//! Primal-dual Newton for sums of norms, with a duality-gap certificate at every iteration.
//!
//! minimise f(x) = Σᵢ sᵢ, sᵢ = √(‖rᵢ‖² + cᵢ² + μ²), rᵢ = bᵢ − Rᵢ x.
//!
//! The dual of the problem without μ: maximise Σ (yᵢᵀ bᵢ + cᵢ √(1 − ‖yᵢ‖²)) over ‖yᵢ‖ ≤ 1 with
//! Σ Rᵢᵀ yᵢ = 0. Linearising yᵢ sᵢ = rᵢ (Andersen, Christiansen, Conn and Overton 2000) gives the
//! step and the next multipliers; these are projected onto the equality, scaled into the balls, and
//! bound the optimum from below.
//!
//! With noise every cᵢ > 0, f is smooth and about three iterations suffice. Where cᵢ ≈ 0 (no noise,
//! or the 1-norm) μ smooths the kinks and is driven to zero with the gap.
//!
//! Nothing is allocated after [`Newton::new`].

use nalgebra::{SMatrix, SVector};

use super::compress::Compressed;
use super::{Decoded, SecureError, Status};

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Stop when gap ≤ `tolerance` · f + `tolerance_abs`.
    pub tolerance: f64,
    /// Without it a window that is explained exactly (f = 0) would never stop.
    pub tolerance_abs: f64,
    /// Most iterations.
    pub max_iterations: u32,
    /// Most time; `None` for no limit (tests, offline, simulations that must repeat bit by bit).
    pub deadline: Option<Deadline>,
}

/// When to give up, by a clock from outside: estimators have none.
#[derive(Debug, Clone, Copy)]
pub struct Deadline {
    /// Counts nanoseconds.
    pub stopwatch: fn() -> u64,
    /// After this long, µs.
    pub limit_us: u64,
}

impl PartialEq for Deadline {
    fn eq(&self, other: &Self) -> bool {
        self.limit_us == other.limit_us && std::ptr::fn_addr_eq(self.stopwatch, other.stopwatch)
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self { tolerance: 1e-8, tolerance_abs: 1e-9, max_iterations: 60, deadline: None }
    }
}

/// The solver and its memory.
#[derive(Debug, Clone)]
pub struct Newton<const N: usize> {
    settings: Settings,
    b: Vec<f64>,
    c: Vec<f64>,
    r: Vec<f64>,
    y: Vec<f64>,
    trial: Vec<f64>,
    s: Vec<f64>,
}

impl<const N: usize> Newton<N> {
    /// Memory for problems as large as `compressed`.
    pub fn new(compressed: &Compressed<N>, settings: Settings) -> Self {
        Self::with_room(compressed.rows(), compressed.terms(), settings)
    }

    /// Memory for problems of up to so many rows and terms.
    pub fn with_room(rows: usize, terms: usize, settings: Settings) -> Self {
        Self {
            settings,
            b: vec![0.0; rows],
            c: vec![0.0; terms],
            r: vec![0.0; rows],
            y: vec![0.0; rows],
            trial: vec![0.0; rows],
            s: vec![0.0; terms],
        }
    }

    /// Changes when to stop.
    pub fn settle_for(&mut self, settings: Settings) {
        self.settings = settings;
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Decodes one window: the samples of all sensors one after the other. `start` is a guess (the
    /// solution before, moved on); without one it starts from least squares.
    ///
    /// # Errors
    /// Only for a window that is no window: wrong length, samples that are not finite.
    pub fn decode(
        &mut self,
        problem: &Compressed<N>,
        window: &[f64],
        start: Option<&SVector<f64, N>>,
    ) -> Result<Decoded<N>, SecureError> {
        let begun = self.settings.deadline.map(|d| (d, (d.stopwatch)()));
        let terms = problem.terms();
        problem.right_hand_side(window, &mut self.b, &mut self.c)?;
        let mut x = match start {
            Some(x) if x.iter().all(|v| v.is_finite()) => *x,
            _ => self.least_squares(problem),
        };
        // Memory may be larger than this problem.
        let c = self.c.get(..terms).unwrap_or_default();
        let terms = terms as f64;
        residual(problem, &self.b, &x, &mut self.r);
        let mut objective = norms(problem, &self.r, &self.c, 0.0, &mut self.s);
        // Kinks are rounded at first to a hundredth of a mean term; windows with noise need none of it.
        let mean = objective / terms;
        let mut mu = if c.iter().all(|c| *c > 1e-3 * mean) { 0.0 } else { 0.1 * mean };
        self.multipliers_from_residual(problem, mu);
        let mut best = Decoded { x, objective, lower_bound: 0.0, iterations: 0, status: Status::MaxIterations };
        let mut stalls = 0;
        while best.iterations < self.settings.max_iterations {
            best.iterations += 1;
            let Some(step) = self.newton_step(problem, mu) else {
                best.status = Status::Stalled;
                break;
            };
            let bound = self.next_multipliers(problem, &step);
            best.lower_bound = best.lower_bound.max(bound);
            let smooth = self.objective(problem, mu);
            let (taken, moved) = self.line_search(problem, &x, &step, smooth, mu);
            x = moved;
            objective = self.objective(problem, 0.0);
            if objective < best.objective {
                best.objective = objective;
                best.x = x;
            }
            let gap = best.objective - best.lower_bound;
            if gap <= self.settings.tolerance * best.objective + self.settings.tolerance_abs {
                best.status = Status::Solved;
                break;
            }
            if begun.is_some_and(|(d, t)| (d.stopwatch)().saturating_sub(t) >= 1000 * d.limit_us) {
                best.status = Status::MaxTime;
                break;
            }
            if mu > 0.0 {
                // As fast as the last step was good, never above a tenth of what the gap allows.
                let factor = if taken > 0.5 { 0.1 } else { 0.5 };
                mu = (mu * factor).min(0.1 * gap / terms).max(1e-14 * mean);
            } else if taken == 0.0 {
                stalls += 1;
                if stalls >= 2 {
                    best.status = Status::Stalled;
                    break;
                }
            }
        }
        Ok(best)
    }

    /// (ΣRᵀR)⁻¹ ΣRᵀb
    fn least_squares(&self, problem: &Compressed<N>) -> SVector<f64, N> {
        let mut x = SVector::zeros();
        let mut b = self.b.as_slice();
        for term in problem.term_rows() {
            let (mine, rest) = b.split_at(term.rank);
            for (row, value) in term.rows.chunks_exact(term.support.len().max(1)).zip(mine) {
                for (j, v) in term.support.iter().zip(row) {
                    x[*j] += v * value;
                }
            }
            b = rest;
        }
        problem.solve_gram(&mut x);
        x
    }

    /// Σ √(‖rᵢ‖² + cᵢ² + μ²); leaves each root in `s`.
    fn objective(&mut self, problem: &Compressed<N>, mu: f64) -> f64 {
        norms(problem, &self.r, &self.c, mu, &mut self.s)
    }

    fn multipliers_from_residual(&mut self, problem: &Compressed<N>, mu: f64) {
        self.objective(problem, mu);
        let (mut r, mut y) = (self.r.as_slice(), self.y.as_mut_slice());
        for (term, s) in problem.term_rows().zip(&self.s) {
            let (r_i, r_rest) = r.split_at(term.rank);
            let (y_i, y_rest) = y.split_at_mut(term.rank);
            for (y, r) in y_i.iter_mut().zip(r_i) {
                *y = if *s > 0.0 { r / s } else { 0.0 };
            }
            (r, y) = (r_rest, y_rest);
        }
    }

    /// H = Σ Rᵀ (I − (y rᵀ + r yᵀ) / 2s) R / s, H Δx = Σ Rᵀ r / s.
    fn newton_step(&mut self, problem: &Compressed<N>, mu: f64) -> Option<SVector<f64, N>> {
        self.objective(problem, mu);
        let mut h = SMatrix::<f64, N, N>::zeros();
        let mut g = SVector::<f64, N>::zeros();
        let (mut r, mut y) = (self.r.as_slice(), self.y.as_slice());
        for (term, s) in problem.term_rows().zip(&self.s) {
            let (r_i, r_rest) = r.split_at(term.rank);
            let (y_i, y_rest) = y.split_at(term.rank);
            (r, y) = (r_rest, y_rest);
            if term.rank == 0 || *s <= 0.0 {
                continue;
            }
            let w = 1.0 / s;
            let k = term.support.len();
            let (mut rt_r, mut rt_y) = ([0.0; N], [0.0; N]);
            for ((row, r), y) in term.rows.chunks_exact(k).zip(r_i).zip(y_i) {
                for (a, va) in row.iter().enumerate() {
                    rt_r[a] += va * r;
                    rt_y[a] += va * y;
                }
            }
            let half = 0.5 * w * w;
            for (a, ja) in term.support.iter().enumerate() {
                g[*ja] += w * rt_r[a];
                for (b, jb) in term.support.iter().enumerate().take(a + 1) {
                    let mut sum = 0.0;
                    for row in term.rows.chunks_exact(k) {
                        sum += row[a] * row[b];
                    }
                    // The support is ascending: this fills the lower triangle.
                    h[(*ja, *jb)] += w * sum - half * (rt_y[a] * rt_r[b] + rt_r[a] * rt_y[b]);
                }
            }
        }
        // A trace-relative ridge keeps H definite where all residuals of a state point one way.
        let ridge = 1e-13 * h.trace() / N as f64;
        for j in 0..N {
            h[(j, j)] += ridge;
        }
        let step = h.cholesky()?.solve(&g);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// y⁺ = (r + Δr − y Δs) / s with Δr = −R Δx, Δs = rᵀΔr / s; kept inside the balls for the next
    /// step. Returns the lower bound that y⁺ certifies.
    fn next_multipliers(&mut self, problem: &Compressed<N>, step: &SVector<f64, N>) -> f64 {
        let mut sum = SVector::<f64, N>::zeros();
        {
            let (mut r, mut y) = (self.r.as_slice(), self.y.as_mut_slice());
            for (term, s) in problem.term_rows().zip(&self.s) {
                let (r_i, r_rest) = r.split_at(term.rank);
                let (y_i, y_rest) = y.split_at_mut(term.rank);
                (r, y) = (r_rest, y_rest);
                if term.rank == 0 || *s <= 0.0 {
                    continue;
                }
                let k = term.support.len();
                let moved =
                    |row: &[f64]| -> f64 { -term.support.iter().zip(row).map(|(j, v)| v * step[*j]).sum::<f64>() };
                let ds = term.rows.chunks_exact(k).zip(r_i).map(|(row, r)| r * moved(row)).sum::<f64>() / s;
                for ((row, r), y) in term.rows.chunks_exact(k).zip(r_i).zip(y_i) {
                    *y = (r + moved(row) - *y * ds) / s;
                    for (j, v) in term.support.iter().zip(row) {
                        sum[*j] += v * *y;
                    }
                }
            }
        }
        // Projection onto Σ Rᵀ y = 0: y − R (ΣRᵀR)⁻¹ ΣRᵀy.
        problem.solve_gram(&mut sum);
        let mut largest: f64 = 1.0;
        let (mut y, mut projected) = (self.y.as_slice(), self.trial.as_mut_slice());
        for term in problem.term_rows() {
            let (y_i, y_rest) = y.split_at(term.rank);
            let (p_i, p_rest) = projected.split_at_mut(term.rank);
            (y, projected) = (y_rest, p_rest);
            let mut square = 0.0;
            for ((row, y), p) in term.rows.chunks_exact(term.support.len().max(1)).zip(y_i).zip(p_i) {
                *p = y - term.support.iter().zip(row).map(|(j, v)| v * sum[*j]).sum::<f64>();
                square += *p * *p;
            }
            largest = largest.max(square);
        }
        let scale = 1.0 / largest.sqrt();
        let mut bound = 0.0;
        let (mut b, mut projected) = (self.b.as_slice(), self.trial.as_slice());
        for (term, c) in problem.term_rows().zip(&self.c) {
            let (b_i, b_rest) = b.split_at(term.rank);
            let (p_i, p_rest) = projected.split_at(term.rank);
            (b, projected) = (b_rest, p_rest);
            let mut square = 0.0;
            for (b, p) in b_i.iter().zip(p_i) {
                let p = p * scale;
                bound += p * b;
                square += p * p;
            }
            bound += c * (1.0 - square).max(0.0).sqrt();
        }
        // The next step needs ‖y‖ ≤ 1 for a definite H.
        let mut y = self.y.as_mut_slice();
        for term in problem.term_rows() {
            let (y_i, y_rest) = y.split_at_mut(term.rank);
            y = y_rest;
            let norm = y_i.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm > 1.0 {
                y_i.iter_mut().for_each(|v| *v /= norm);
            }
        }
        bound
    }

    /// Halves the step until the smoothed objective falls; leaves the residual there in `r`.
    fn line_search(
        &mut self,
        problem: &Compressed<N>,
        x: &SVector<f64, N>,
        step: &SVector<f64, N>,
        smooth: f64,
        mu: f64,
    ) -> (f64, SVector<f64, N>) {
        let mut length = 1.0;
        for _ in 0..30 {
            let candidate = x + step * length;
            residual(problem, &self.b, &candidate, &mut self.trial);
            if norms(problem, &self.trial, &self.c, mu, &mut self.s) < smooth {
                std::mem::swap(&mut self.r, &mut self.trial);
                return (length, candidate);
            }
            length *= 0.5;
        }
        (0.0, *x)
    }
}

/// rᵢ = bᵢ − Rᵢ x
fn residual<const N: usize>(problem: &Compressed<N>, b: &[f64], x: &SVector<f64, N>, r: &mut [f64]) {
    let mut out = r.iter_mut().zip(b);
    for term in problem.term_rows() {
        for row in term.rows.chunks_exact(term.support.len().max(1)) {
            if let Some((r, b)) = out.next() {
                *r = b - term.support.iter().zip(row).map(|(j, v)| v * x[*j]).sum::<f64>();
            }
        }
    }
}

/// sᵢ = √(‖rᵢ‖² + cᵢ² + μ²) and their sum.
fn norms<const N: usize>(problem: &Compressed<N>, r: &[f64], c: &[f64], mu: f64, s: &mut [f64]) -> f64 {
    let mut r = r;
    let mut sum = 0.0;
    for ((term, c), s) in problem.term_rows().zip(c).zip(s) {
        let (r_i, rest) = r.split_at(term.rank);
        r = rest;
        *s = r_i.iter().fold(c * c + mu * mu, |acc, v| acc + v * v).sqrt();
        sum += *s;
    }
    sum
}

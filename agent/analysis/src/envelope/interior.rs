//! Interior point method for max cᵀa with |Ma| ≤ 1 and sums of squares Σₖ wₖ (Ma)ₖ² ≤ 1, dense: predictor and corrector
//! \[Mehrotra 1992\].
//!
//! | symbol | meaning |
//! |---|---|
//! | M | a row for each statistic, over its limit, then one for each column, over the most that may be added |
//! | s± | 1 ∓ Ma, kept exact: no attack at all is where it begins |
//! | z± | multipliers of either side |
//! | W | what each row counts in each sum of squares |
//! | r, y | 1 − W(Ma)², kept exact as well, and its multipliers |
//! | G | half of the gradients of the sums, W diag(Ma) M |
//! | H | Mᵀ(z⁺/s⁺ + z⁻/s⁻ + 2Wᵀy)M + 4 Gᵀ(y/r)G |
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

/// Sums of squares of some rows.
pub(super) struct Squares {
    /// Those rows of M, in the order of time.
    pub(super) rows: Vec<usize>,
    /// W: a row for each sum, in the order of time.
    pub(super) weights: DMatrix<f64>,
}

/// Some sums, and where they are.
struct Summed {
    rows: Vec<usize>,
    weights: DMatrix<f64>,
    /// The rows of M.
    m: DMatrix<f64>,
    /// Rows that count and columns that they hear of, in each block of sums.
    reach: Vec<(usize, usize)>,
    /// r, y and G.
    room: DVector<f64>,
    multipliers: DVector<f64>,
    gradients: DMatrix<f64>,
}

impl Summed {
    fn new(of: Squares, m: &DMatrix<f64>) -> Self {
        let Squares { rows, weights } = of;
        let m = m.select_rows(&rows);
        let sums = weights.nrows();
        let reach = (0..sums).step_by(BLOCK).map(|from| {
            let block = weights.rows(from, BLOCK.min(sums - from));
            let last = (0..rows.len()).rev().find(|row| block.column(*row).iter().any(|w| *w != 0.0));
            let count = last.map_or(0, |row| row + 1);
            let heard = (0..m.ncols()).rev().find(|j| m.column(*j).iter().take(count).any(|x| *x != 0.0));
            (count, heard.map_or(0, |column| column + 1))
        });
        let (room, multipliers) = (DVector::from_element(sums, 1.0), DVector::from_element(sums, 1.0));
        let gradients = DMatrix::zeros(sums, m.ncols());
        Self { reach: reach.collect(), rows, weights, m, room, multipliers, gradients }
    }

    /// To the `values` that the rows have now.
    fn at(&mut self, values: &DVector<f64>) {
        let x = values.select_rows(&self.rows);
        self.room = (&self.weights * x.component_mul(&x)).map(|sum| 1.0 - sum);
        for (from, (count, heard)) in (0..self.room.len()).step_by(BLOCK).zip(&self.reach) {
            let block = BLOCK.min(self.room.len() - from);
            let mut weighted = self.weights.view((from, 0), (block, *count)).into_owned();
            for (mut column, x) in weighted.column_iter_mut().zip(x.iter()) {
                column *= *x;
            }
            let part = self.m.view((0, 0), (*count, *heard));
            self.gradients.view_mut((from, 0), (block, *heard)).gemm(1.0, &weighted, &part, 0.0);
        }
    }

    /// Half of what the sums grow by along `by`, and what they curve by.
    fn along(&self, values: &DVector<f64>, by: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
        let (x, dx) = (values.select_rows(&self.rows), by.select_rows(&self.rows));
        (&self.weights * x.component_mul(&dx), &self.weights * dx.component_mul(&dx))
    }

    /// How far along there is room.
    fn wall(&self, values: &DVector<f64>, by: &DVector<f64>) -> f64 {
        let (grows, curves) = self.along(values, by);
        let one = |((room, grows), curves): ((&f64, &f64), &f64)| room / (grows + grows.hypot((room * curves).sqrt()));
        self.room.iter().zip(&grows).zip(&curves).map(one).filter(|wall| !wall.is_nan()).fold(f64::INFINITY, f64::min)
    }
}

/// What multipliers prove of any attack that keeps the limits: cᵀa ≤ Σ |linear| + Σ sums + Σⱼ |left|ⱼ uⱼ.
pub(super) struct Proof {
    /// Of each row of M, signed.
    pub(super) linear: DVector<f64>,
    /// Of the sums of each [`Squares`]: 2y√(1 − r), what √(1 − r)⁻¹ G at the present attack counts. By Cauchy and Schwarz no silent attack makes
    /// that larger than one.
    pub(super) sums: Vec<DVector<f64>>,
    /// What of c they leave.
    pub(super) left: DVector<f64>,
}

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
    summed: Vec<Summed>,
}

/// Where a step goes.
struct Direction {
    attack: DVector<f64>,
    /// All of M along it.
    rows: DVector<f64>,
    slack: [DVector<f64>; 2],
    multipliers: [DVector<f64>; 2],
    /// Of each sum, to first order, and its multiplier.
    room: Vec<DVector<f64>>,
    sums: Vec<DVector<f64>>,
}

impl Interior {
    /// At rest. `m` is M without its last rows.
    pub(super) fn new(m: DMatrix<f64>, objective: DVector<f64>, most: &DVector<f64>, squares: Vec<Squares>) -> Self {
        let (rows, n) = m.shape();
        let transposed = m.transpose();
        let last = |end: usize| (0..n).rev().find(|column| m.column(*column).iter().take(end).any(|x| *x != 0.0));
        let ends = (0..rows).step_by(BLOCK).map(|from| (from + BLOCK).min(rows));
        let heard = ends.map(|end| last(end).map_or(0, |column| column + 1)).collect();
        let ones = || DVector::from_element(rows + n, 1.0);
        let summed = squares.into_iter().map(|of| Summed::new(of, &m)).collect();
        let mut made = Self {
            summed,
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
        let first = reached.max(f64::MIN_POSITIVE) / (rows as f64 + 1.0).sqrt();
        made.multipliers
            .iter_mut()
            .chain(made.summed.iter_mut().map(|s| &mut s.multipliers))
            .for_each(|z| z.fill(first));
        made
    }

    /// What the present multipliers prove.
    pub(super) fn proof(&self) -> Proof {
        let [above, below] = &self.multipliers;
        let rows = self.m.nrows();
        let linear = above.rows(0, rows) - below.rows(0, rows);
        let mut left = &self.objective - self.m.tr_mul(&linear);
        let sums = self.summed.iter().map(|s| {
            left.gemv_tr(-2.0, &s.gradients, &s.multipliers, 1.0);
            s.multipliers.zip_map(&s.room, |y, room| 2.0 * y * (1.0 - room).max(0.0).sqrt())
        });
        let sums = sums.collect();
        Proof { linear, sums, left }
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

    /// H, with these `weights` of M.
    fn factored(&self, weights: &DVector<f64>) -> Option<Cholesky<f64, nalgebra::Dyn>> {
        let (rows, n) = self.m.shape();
        let mut h =
            DMatrix::from_diagonal(&weights.rows(rows, n).component_mul(&self.per_most).component_mul(&self.per_most));
        gram(&mut h, &self.m, &self.transposed, weights, &self.heard);
        for s in &self.summed {
            let heard: Vec<usize> = s.reach.iter().map(|(_, heard)| *heard).collect();
            let weights = s.multipliers.zip_map(&s.room, |y, room| 4.0 * y / room);
            gram(&mut h, &s.gradients, &s.gradients.transpose(), &weights, &heard);
        }
        let ridge = RIDGE * h.diagonal().amax();
        (0..n).for_each(|i| h[(i, i)] += ridge);
        Cholesky::new(h)
    }

    /// μ: mean of s z and r y, so far `along` the one and `dual` along the other.
    fn gap(&self, along: f64, dual: f64, by: Option<&Direction>) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        let mut add = |s: &DVector<f64>, z: &DVector<f64>, by: Option<[&DVector<f64>; 2]>| {
            count += s.len();
            sum += by.map_or_else(|| s.dot(z), |[ds, dz]| (s + ds * along).dot(&(z + dz * dual)));
        };
        for side in 0..2 {
            let by = by.map(|by| [&by.slack[side], &by.multipliers[side]]);
            add(&self.slack[side], &self.multipliers[side], by);
        }
        for (i, s) in self.summed.iter().enumerate() {
            add(&s.room, &s.multipliers, by.and_then(|by| Some([by.room.get(i)?, by.sums.get(i)?])));
        }
        sum / count as f64
    }

    /// Step to s z = `centre`, less what the `first` one was off by, to second order.
    fn direction(
        &self,
        h: &Cholesky<f64, nalgebra::Dyn>,
        centre: f64,
        values: &DVector<f64>,
        first: Option<&Direction>,
    ) -> Direction {
        let wanted: [DVector<f64>; 2] = std::array::from_fn(|side| match first {
            Some(first) => {
                let second = first.slack[side].component_mul(&first.multipliers[side]);
                second.map(|second| centre - second).component_div(&self.slack[side])
            }
            None => self.slack[side].map(|s| centre / s),
        });
        let of_sums: Vec<DVector<f64>> = self
            .summed
            .iter()
            .enumerate()
            .map(|(i, s)| match first.and_then(|first| Some((first, first.room.get(i)?, first.sums.get(i)?))) {
                Some((first, room, y)) => {
                    let (_, curves) = s.along(values, &first.rows);
                    let second = room.component_mul(y) - s.multipliers.component_mul(&curves);
                    second.map(|second| centre - second).component_div(&s.room)
                }
                None => s.room.map(|room| centre / room),
            })
            .collect();
        let mut rest = &self.objective - self.transposed(&(&wanted[0] - &wanted[1]));
        for (s, wanted) in self.summed.iter().zip(&of_sums) {
            rest.gemv_tr(-2.0, &s.gradients, wanted, 1.0);
        }
        let attack = h.solve(&rest);
        let rows = self.rows(&attack);
        let slack = [-&rows, rows.clone()];
        let multiplier = |wanted: &DVector<f64>, z: &DVector<f64>, s: &DVector<f64>, moved: &DVector<f64>| {
            wanted - z - z.component_div(s).component_mul(moved)
        };
        let multipliers = std::array::from_fn(|side| {
            multiplier(&wanted[side], &self.multipliers[side], &self.slack[side], &slack[side])
        });
        let room: Vec<DVector<f64>> = self.summed.iter().map(|s| &s.gradients * &attack * -2.0).collect();
        let sums = self.summed.iter().zip(&of_sums).zip(&room);
        let sums = sums.map(|((s, wanted), moved)| multiplier(wanted, &s.multipliers, &s.room, moved)).collect();
        Direction { attack, rows, slack, multipliers, room, sums }
    }

    /// How far each may go.
    fn longest(&self, values: &DVector<f64>, by: &Direction) -> (f64, f64) {
        let sides = |of: &[DVector<f64>; 2], by: &[DVector<f64>; 2]| wall(&of[0], &by[0]).min(wall(&of[1], &by[1]));
        let primal = self.summed.iter().map(|s| s.wall(values, &by.rows)).fold(sides(&self.slack, &by.slack), f64::min);
        let dual = self.summed.iter().zip(&by.sums).map(|(s, by)| wall(&s.multipliers, by));
        let dual = dual.fold(sides(&self.multipliers, &by.multipliers), f64::min);
        let [primal, dual] = [primal, dual].map(|wall| (SHORT * wall).min(1.0));
        // What sums leave of c is not linear in both.
        if self.summed.is_empty() { (primal, dual) } else { (primal.min(dual), primal.min(dual)) }
    }

    /// One step. False where it can get no nearer.
    pub(super) fn step(&mut self) -> bool {
        let mut weights =
            self.multipliers[0].component_div(&self.slack[0]) + self.multipliers[1].component_div(&self.slack[1]);
        for s in &self.summed {
            let counted = s.weights.tr_mul(&s.multipliers);
            s.rows.iter().zip(&counted).for_each(|(row, counted)| weights[*row] += 2.0 * counted);
        }
        let Some(h) = self.factored(&weights) else { return false };
        let values = self.rows(&self.attack);
        let first = self.direction(&h, 0.0, &values, None);
        let (primal, dual) = self.longest(&values, &first);
        let now = self.gap(0.0, 0.0, None);
        let left = self.gap(primal, dual, Some(&first)) / now;
        let by = self.direction(&h, left.powi(3) * now, &values, Some(&first));
        let (primal, dual) = self.longest(&values, &by);
        if !by.attack.iter().all(|x| x.is_finite()) || primal.max(dual) < 1e-9 {
            return false;
        }
        self.attack.axpy(primal, &by.attack, 1.0);
        for side in 0..2 {
            self.slack[side].axpy(primal, &by.slack[side], 1.0);
            self.multipliers[side].axpy(dual, &by.multipliers[side], 1.0);
        }
        let values = self.rows(&self.attack);
        for (s, by) in self.summed.iter_mut().zip(&by.sums) {
            s.multipliers.axpy(dual, by, 1.0);
            s.at(&values);
        }
        true
    }
}

/// h + mᵀ diag(`weights`) m, below the diagonal; `heard` are the columns of each block of rows that are not zero.
fn gram(h: &mut DMatrix<f64>, m: &DMatrix<f64>, transposed: &DMatrix<f64>, weights: &DVector<f64>, heard: &[usize]) {
    let rows = m.nrows();
    for (from, heard) in (0..rows).step_by(BLOCK).zip(heard) {
        let count = BLOCK.min(rows - from);
        let mut weighted = m.view((from, 0), (count, *heard)).into_owned();
        for mut column in weighted.column_iter_mut() {
            column.component_mul_assign(&weights.rows(from, count));
        }
        for left in (0..*heard).step_by(BLOCK) {
            let wide = BLOCK.min(heard - left);
            let tall = heard - left;
            let (of, by) = (transposed.view((left, from), (tall, count)), weighted.columns(left, wide));
            h.view_mut((left, left), (tall, wide)).gemm(1.0, &of, &by, 1.0);
        }
    }
}

/// How much of the step `by` keeps `of` positive.
fn wall(of: &DVector<f64>, by: &DVector<f64>) -> f64 {
    let walls = of.iter().zip(by).filter(|(_, by)| **by < 0.0).map(|(of, by)| -of / by);
    walls.fold(f64::INFINITY, f64::min)
}

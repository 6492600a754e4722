//! The last T slots of every sensor, whitened and ready to decode.
//!
//! Slots are equally long; a sensor has at most one value in a slot, or none (multi-rate masks, drop-outs).
//! The state is anchored at the window's **end**: x_k = A⁻¹(x_{k+1} − w_k − b_k), so that what the model does
//! not know (process noise w) costs the old samples, not the state that is wanted. [Clinic] Eq. 22 anchors at
//! the beginning, where the newest samples carry all of it.
//!
//! | symbol | meaning | shape |
//! |---|---|---|
//! | A | transition over one slot | N × N |
//! | b_k | forced response of slot k: B u of the applied motor commands ([Clinic] Eq. 21) | N |
//! | Q | process noise of one slot | N × N |
//! | c, σ, β | row of a sensor, noise of one value, constant bias (one-sigma) | N, 1, 1 |
//! | Φᵢ | rows c A^{−k}, newest first | T × N |
//!
//! Cov(yᵢ) = σ² I + β² 11ᵀ + what Q leaves in the row; its Cholesky factor whitens Y and Φ. The process noise
//! that sensors share is counted for each alone: no sensor's window vouches for another's.
//!
//! Factors depend on the row and on which slots are filled, so each row keeps those of its last few masks
//! (its sampling phases): nothing is factored twice in a steady flight, and nothing is allocated after
//! construction in any.

use nalgebra::{DMatrix, SMatrix, SVector};

use super::compress::Compressed;
use super::newton::{Newton, Settings};
use super::{Decoded, Program, SecureError};

/// Longest window, slots.
pub const MAX_SLOTS: usize = 128;
/// Masks remembered for each row: more than any two rates here beat through.
const PHASES: usize = 8;
/// A sensor with no more values than it sees states would leave a kink at zero residual; this much (in
/// sigmas) of constant residual rounds it off.
const FLOOR: f64 = 0.3;
/// A column of Φ below this fraction of the largest adds nothing.
const RANK_TOLERANCE: f64 = 1e-9;

/// How the state moves in one slot.
#[derive(Debug, Clone, PartialEq)]
pub struct Model<const N: usize> {
    /// Transition over one slot.
    pub a: SMatrix<f64, N, N>,
    /// Process noise of one slot.
    pub q: SMatrix<f64, N, N>,
}

/// One scalar sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Row<const N: usize> {
    /// What it sees.
    pub c: SVector<f64, N>,
    /// White noise of one value, one-sigma.
    pub sigma: f64,
    /// Bias that stays the same all window long, one-sigma.
    pub bias_sigma: f64,
}

/// A row's Φ and covariance over the whole window, and its factors.
#[derive(Debug, Clone)]
struct Phase {
    /// T × support, newest first, row-major.
    phi: Vec<f64>,
    /// States it sees in the window.
    support: Vec<usize>,
    /// T × T, row-major.
    covariance: Vec<f64>,
    factors: Vec<Factor>,
    next: usize,
}

/// Whitening and QR of one row for one mask.
#[derive(Debug, Clone)]
struct Factor {
    /// Slots filled, bit k = k slots before the end; 0 for none yet.
    mask: u128,
    count: usize,
    /// Lower Cholesky factor of the covariance, count × count, row-major.
    l: Vec<f64>,
    /// Q, column-major, one zero below each column where a floor is needed.
    q: Vec<f64>,
    /// R, row-major.
    r: Vec<f64>,
    rank: usize,
    floor: bool,
}

impl Factor {
    fn samples(&self) -> usize {
        self.count + usize::from(self.floor)
    }

    /// Whitened row `k` of Φ: Q R, over `width` states.
    fn row<const N: usize>(&self, k: usize, width: usize) -> [f64; N] {
        let mut row = [0.0; N];
        for (j, r) in self.r.chunks_exact(width.max(1)).enumerate() {
            let q = self.q.get(j * self.samples() + k).copied().unwrap_or_default();
            row.iter_mut().zip(r).for_each(|(slot, r)| *slot += q * r);
        }
        row
    }
}

/// Statistic of one sensor in the last window decoded.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Statistic {
    /// ‖whitened residual‖².
    pub square: f64,
    /// Values it had: degrees of freedom, at most.
    pub values: usize,
}

/// The window and its decoder.
#[derive(Debug, Clone)]
pub struct Window<const N: usize> {
    slots: usize,
    growing: bool,
    program: Program,
    a_inverse: SMatrix<f64, N, N>,
    phases: Vec<Phase>,
    /// Row kind of each sensor.
    kinds: Vec<usize>,
    masks: Vec<u128>,
    /// sensor × slots, by slot number modulo slots.
    values: Vec<f64>,
    /// Forced response from the slot before, by slot number modulo slots.
    forced: Vec<SVector<f64, N>>,
    is_forced: bool,
    filled: usize,
    head: usize,
    problem: Compressed<N>,
    newton: Newton<N>,
    /// Whitened values of all sensors, those decoded and those left out.
    whitened: Vec<f64>,
    samples: Vec<f64>,
    statistics: Vec<Statistic>,
    scratch: Vec<f64>,
}

impl<const N: usize> Window<N> {
    /// A window of `slots` slots over sensors that each follow one of `rows`: `kinds[i]` is the row of sensor i.
    ///
    /// # Errors
    /// A window too long or empty, an A without inverse, a row that is not finite or without noise (its
    /// whitening would be singular).
    pub fn new(
        model: &Model<N>,
        rows: &[Row<N>],
        kinds: &[usize],
        slots: usize,
        settings: Settings,
    ) -> Result<Self, SecureError> {
        if !(1..=MAX_SLOTS).contains(&slots) {
            return Err(SecureError::Slots { slots, least: 1, most: MAX_SLOTS });
        }
        let a_inverse = model.a.try_inverse().ok_or(SecureError::Transition)?;
        let mut phases = Vec::with_capacity(rows.len());
        for (index, row) in rows.iter().enumerate() {
            phases.push(Phase::new(index, row, &a_inverse, &model.q, slots)?);
        }
        if let Some(found) = kinds.iter().find(|k| **k >= rows.len()) {
            let what = "the list of rows".to_owned();
            return Err(SecureError::Shape { what, found: rows.len(), expected: found + 1 });
        }
        let sensors = kinds.len();
        let rank = kinds.iter().filter_map(|k| phases.get(*k)).map(|p| p.support.len().min(slots)).sum::<usize>();
        // Every value a term of its own (1-norm), or every sensor one: whichever needs more.
        let terms = sensors * slots + N;
        Ok(Self {
            slots,
            growing: false,
            program: Program::L2,
            a_inverse,
            kinds: kinds.to_vec(),
            masks: vec![0; sensors],
            values: vec![0.0; sensors * slots],
            forced: vec![SVector::zeros(); slots],
            is_forced: false,
            filled: 0,
            head: 0,
            problem: room(sensors, slots)?,
            newton: Newton::with_room(rank.max(sensors * slots) + N, terms, settings),
            whitened: vec![0.0; sensors * slots],
            samples: Vec::with_capacity(sensors * (slots + 1) + 2 * N),
            statistics: vec![Statistic::default(); sensors],
            scratch: vec![0.0; slots * (N + 1)],
            phases,
        })
    }

    /// Decodes from the first slot on, while it is not yet full ([Clinic] 3.4.2: the window that grows).
    #[must_use]
    pub fn growing(mut self) -> Self {
        self.growing = true;
        self
    }

    /// The norm over time that is minimised from now on.
    pub fn use_program(&mut self, program: Program) {
        self.program = program;
    }

    /// Slots of a full window.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// Is it full?
    pub fn is_full(&self) -> bool {
        self.filled >= self.slots
    }

    /// May it be decoded: full, or growing with something in it?
    pub fn is_ready(&self) -> bool {
        self.is_full() || (self.growing && self.filled > 0)
    }

    /// Forgets every value.
    pub fn clear(&mut self) {
        self.filled = 0;
        self.masks.fill(0);
        self.is_forced = false;
        self.forced.fill(SVector::zeros());
    }

    /// Begins a new slot; `forced` is B u of the step into it. A response that is not finite counts as none.
    pub fn advance(&mut self, forced: Option<&SVector<f64, N>>) {
        self.head = (self.head + 1) % self.slots;
        self.filled = (self.filled + 1).min(self.slots);
        let keep = if self.slots == MAX_SLOTS { u128::MAX } else { (1 << self.slots) - 1 };
        self.masks.iter_mut().for_each(|mask| *mask = (*mask << 1) & keep);
        if let Some(slot) = self.forced.get_mut(self.head) {
            *slot = forced.copied().filter(|b| b.iter().all(|v| v.is_finite())).unwrap_or_else(SVector::zeros);
        }
        self.is_forced |= forced.is_some();
    }

    /// Value of `sensor` in the newest slot; what is not finite is left out.
    pub fn put(&mut self, sensor: usize, value: f64) {
        let at = sensor * self.slots + self.head;
        if let (Some(mask), Some(slot), true) =
            (self.masks.get_mut(sensor), self.values.get_mut(at), value.is_finite() && self.filled > 0)
        {
            *slot = value;
            *mask |= 1;
        }
    }

    /// Takes the newest value of `sensor` back.
    pub fn withdraw(&mut self, sensor: usize) {
        if let Some(mask) = self.masks.get_mut(sensor) {
            *mask &= !1;
        }
    }

    /// Takes every value of `sensor` back.
    pub fn forget(&mut self, sensor: usize) {
        if let Some(mask) = self.masks.get_mut(sensor) {
            *mask = 0;
        }
    }

    /// Values of `sensor` in the window.
    pub fn count(&self, sensor: usize) -> usize {
        self.masks.get(sensor).map_or(0, |mask| mask.count_ones() as usize)
    }

    /// Moves the trajectory from which values are counted: its state at the window's end changes by `by`.
    pub fn rebase(&mut self, by: &SVector<f64, N>) {
        for (sensor, mask) in self.masks.iter().enumerate().filter(|(_, mask)| **mask != 0) {
            let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { continue };
            for (age, phi) in phase.phi.chunks_exact(phase.support.len().max(1)).enumerate() {
                let at = sensor * self.slots + (self.head + self.slots - age) % self.slots;
                if mask >> age & 1 == 1
                    && let Some(value) = self.values.get_mut(at)
                {
                    *value -= phase.support.iter().zip(phi).map(|(j, v)| v * by[*j]).sum::<f64>();
                }
            }
        }
    }

    /// Decodes: the state at the window's end. Sensors of which `excluded` is true are only judged. `prior`
    /// lists states known from elsewhere, around zero, with their one-sigma (infinite: not known): one more term each, as robust as
    /// the others.
    ///
    /// # Errors
    /// What is left does not determine the state.
    pub fn decode(
        &mut self,
        excluded: impl Fn(usize) -> bool,
        prior: &[(usize, f64)],
        start: Option<&SVector<f64, N>>,
    ) -> Result<Decoded<N>, SecureError> {
        self.whiten();
        self.problem.clear();
        self.samples.clear();
        for (sensor, mask) in self.masks.iter().enumerate().filter(|(_, mask)| **mask != 0) {
            if excluded(sensor) {
                continue;
            }
            let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { continue };
            let Some(factor) = phase.known(*mask) else { continue };
            let first = sensor * self.slots;
            self.samples.extend(self.whitened.iter().skip(first).take(factor.count));
            if self.program == Program::L1 {
                for k in 0..factor.count {
                    let row = factor.row::<N>(k, phase.support.len());
                    self.problem.push(&phase.support, row.get(..phase.support.len()).unwrap_or_default(), &[], 1, 1);
                }
                continue;
            }
            if factor.floor {
                self.samples.push(FLOOR);
            }
            self.problem.push(&phase.support, &factor.r, &factor.q, factor.rank, factor.samples());
        }
        self.push_prior(prior);
        self.problem.settle()?;
        let decoded = self.newton.decode(&self.problem, &self.samples, start)?;
        self.judge(&decoded.x);
        Ok(decoded)
    }

    /// Statistic of `sensor` in the last window decoded.
    pub fn statistic(&self, sensor: usize) -> Statistic {
        self.statistics.get(sensor).copied().unwrap_or_default()
    }

    /// The compressed problem last decoded and its samples, for an audit.
    pub fn problem(&self) -> (&Compressed<N>, &[f64]) {
        (&self.problem, &self.samples)
    }

    /// The decoder, to change when it stops.
    pub fn newton(&mut self) -> &mut Newton<N> {
        &mut self.newton
    }

    /// Φ of `sensor` over a full window, newest first.
    pub fn phi(&self, sensor: usize) -> DMatrix<f64> {
        let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { return DMatrix::zeros(0, N) };
        let mut phi = DMatrix::zeros(self.slots, N);
        for (k, row) in phase.phi.chunks_exact(phase.support.len().max(1)).enumerate() {
            for (j, v) in phase.support.iter().zip(row) {
                phi[(k, *j)] = *v;
            }
        }
        phi
    }

    /// Forced response removed, newest first, then L⁻¹.
    fn whiten(&mut self) {
        let Self { slots, head, values, whitened, phases, kinds, masks, forced, is_forced, a_inverse, scratch, .. } =
            self;
        for (sensor, mask) in masks.iter().enumerate().filter(|(_, mask)| **mask != 0) {
            let Some(phase) = kinds.get(sensor).and_then(|k| phases.get_mut(*k)) else { continue };
            let Some(factor) = phase.factor(*mask, *slots, scratch) else { continue };
            let first = sensor * *slots;
            let Some(out) = whitened.get_mut(first..first + *slots) else { continue };
            let mut filled = 0;
            for age in (0..*slots).filter(|age| mask >> age & 1 == 1) {
                let at = first + (*head + *slots - age) % *slots;
                if let (Some(value), Some(slot)) = (values.get(at), out.get_mut(filled)) {
                    *slot = *value;
                    filled += 1;
                }
            }
            forward(&factor.l, factor.count, out, 1, 0);
        }
        if !*is_forced {
            return;
        }
        // y_k − c g_k, g_0 = 0, g_{k+1} = A⁻¹ (g_k − b_k): whitened like the values, and subtracted.
        for (sensor, mask) in masks.iter().enumerate().filter(|(_, mask)| **mask != 0) {
            let Some(phase) = kinds.get(sensor).and_then(|k| phases.get(*k)) else { continue };
            let Some(factor) = phase.known(*mask) else { continue };
            let Some(out) = whitened.get_mut(sensor * *slots..(sensor + 1) * *slots) else { continue };
            let mut g = SVector::<f64, N>::zeros();
            let mut filled = 0;
            for age in 0..*slots {
                if mask >> age & 1 == 1
                    && let (Some(slot), Some(newest)) = (scratch.get_mut(filled), phase.phi.get(..phase.support.len()))
                {
                    // The newest row of Φ is c itself.
                    *slot = phase.support.iter().zip(newest).map(|(j, v)| v * g[*j]).sum();
                    filled += 1;
                }
                if let Some(b) = forced.get((*head + *slots - age) % *slots) {
                    g = *a_inverse * (g - b);
                }
            }
            forward(&factor.l, factor.count, scratch, 1, 0);
            out.iter_mut().zip(scratch.iter()).take(factor.count).for_each(|(y, g)| *y -= g);
        }
    }

    /// One term for each state: (x_j / σ)² + 1, where the constant residual keeps it smooth.
    fn push_prior(&mut self, prior: &[(usize, f64)]) {
        for (state, sigma) in prior {
            if *state < N
                && *sigma > 0.0
                && sigma.is_finite()
                && self.problem.push(&[*state], &[1.0 / sigma], &[1.0, 0.0], 1, 2)
            {
                self.samples.extend([0.0, 1.0]);
            }
        }
    }

    /// ‖L⁻¹(Y − Φx)‖² = ‖whitened − Q R x‖² of every sensor.
    fn judge(&mut self, x: &SVector<f64, N>) {
        for (sensor, mask) in self.masks.iter().enumerate() {
            let Some(statistic) = self.statistics.get_mut(sensor) else { continue };
            *statistic = Statistic::default();
            let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { continue };
            let Some(factor) = phase.known(*mask) else { continue };
            let mut rx = [0.0; N];
            for (slot, row) in rx.iter_mut().zip(factor.r.chunks_exact(phase.support.len().max(1))) {
                *slot = phase.support.iter().zip(row).map(|(j, v)| v * x[*j]).sum();
            }
            let stride = factor.samples();
            let y = self.whitened.iter().skip(sensor * self.slots).take(factor.count);
            let square = y.enumerate().fold(0.0, |sum, (k, y)| {
                let column = |j: usize| factor.q.get(j * stride + k).copied().unwrap_or_default();
                let explained: f64 = rx.iter().take(factor.rank).enumerate().map(|(j, v)| v * column(j)).sum();
                sum + (y - explained) * (y - explained)
            });
            *statistic = Statistic { square, values: factor.count };
        }
    }
}

impl Phase {
    fn new<const N: usize>(
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

    fn known(&self, mask: u128) -> Option<&Factor> {
        self.factors.iter().find(|factor| factor.mask == mask && mask != 0)
    }

    /// The factor for `mask`, made in the place of the oldest if there is none yet. `None` where the
    /// covariance has none (it always has: σ > 0).
    fn factor(&mut self, mask: u128, slots: usize, scratch: &mut [f64]) -> Option<&Factor> {
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

/// Room for the problem of any window of `sensors` sensors over `slots` slots, with a term for each state beside.
///
/// # Errors
/// Never, for any N.
pub(super) fn room<const N: usize>(sensors: usize, slots: usize) -> Result<Compressed<N>, SecureError> {
    Compressed::with_room(sensors + N, (slots + 1).max(2), sensors * slots.saturating_sub(1))
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
fn forward(l: &[f64], n: usize, v: &mut [f64], stride: usize, first: usize) {
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

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.04;

    /// Height and climb, three heights, climb noise.
    fn window(slots: usize) -> Window<2> {
        let model = Model {
            a: SMatrix::from([[1.0, 0.0], [DT_S, 1.0]]),
            q: SMatrix::from_diagonal(&SVector::from([1e-12, 1e-4])),
        };
        let row = Row { c: SVector::from([1.0, 0.0]), sigma: 0.007, bias_sigma: 0.004 };
        Window::new(&model, &[row], &[0, 0, 0], slots, Settings::default()).unwrap()
    }

    #[test]
    fn a_lie_is_recovered_under_masks_drop_outs_and_thrust() {
        let mut w = window(10);
        let (mut z, mut v) = (0.5, 0.0_f64);
        let thrust = 1.5;
        for k in 0..40_usize {
            let forced = SVector::from([0.5 * thrust * DT_S * DT_S, thrust * DT_S]);
            z += v * DT_S + forced[0];
            v += forced[1];
            w.advance(Some(&forced));
            for sensor in 0..3 {
                // Staggered, every second or third slot, one sample lost.
                if (k + sensor) % (2 + sensor % 2) == 0 && !(k == 35 && sensor == 0) {
                    w.put(sensor, if sensor == 1 { 2.0 } else { z });
                }
            }
            assert_eq!(w.is_ready(), k >= 9);
        }
        let got = w.decode(|_| false, &[], None).unwrap();
        assert!((got.x - SVector::from([z, v])).norm() < 1e-5, "{got:?} against {z} {v}");
        assert!(w.statistic(1).square > 1e3 && w.statistic(0).square < 1e-3, "{:?}", w.statistic(1));
        assert_eq!(w.statistic(0).values, w.count(0));
        // Left out, it is judged all the same.
        let without = w.decode(|sensor| sensor == 1, &[], Some(&got.x)).unwrap();
        assert!((without.x - got.x).norm() < 1e-5 && w.statistic(1).square > 1e3);
        // The 1-norm over time recovers it as well, each value a term of its own.
        w.use_program(Program::L1);
        let got = w.decode(|_| false, &[], None).unwrap();
        let values: usize = (0..3).map(|sensor| w.count(sensor)).sum();
        assert_eq!(w.problem().0.terms(), values);
        assert!((got.x - SVector::from([z, v])).norm() < 1e-5, "{got:?} against {z} {v}");
    }

    #[test]
    fn factors_whiten_exactly() {
        // GIVEN any mask, THEN ‖whitened residual‖² is the quadratic form with the inverse covariance.
        let mut w = window(10);
        let y: Vec<f64> = (0..10).map(|k| 0.01 * f64::from(k * k % 7)).collect();
        for (k, value) in y.iter().enumerate() {
            w.advance(None);
            if [0, 3, 4, 8, 9].contains(&k) {
                w.put(0, *value);
            }
            w.put(1, 0.0);
        }
        w.decode(|_| false, &[(0, 1e-9), (1, 1e-9)], None).unwrap();
        let ages = [0, 1, 5, 6, 9];
        let phase = &w.phases[0];
        let c = DMatrix::from_fn(5, 5, |a, b| phase.covariance[ages[a] * 10 + ages[b]]);
        let v = nalgebra::DVector::from_fn(5, |a, _| y[9 - ages[a]]);
        let expected = v.dot(&c.cholesky().unwrap().solve(&v));
        assert!((w.statistic(0).square / expected - 1.0).abs() < 1e-6, "{} {expected}", w.statistic(0).square);
    }

    #[test]
    fn moving_the_reference_moves_the_state() {
        let mut w = window(10);
        for k in 0..12 {
            w.advance(None);
            (0..3).for_each(|s| w.put(s, 0.1 * f64::from(k) * DT_S));
        }
        let before = w.decode(|_| false, &[], None).unwrap().x;
        let by = SVector::from([0.3, -0.2]);
        w.rebase(&by);
        let after = w.decode(|_| false, &[], None).unwrap().x;
        assert!((before - after - by).norm() < 1e-6);
    }

    #[test]
    fn what_is_not_finite_is_left_out_and_bad_suites_are_refused() {
        let mut w = window(4).growing();
        assert!(!w.is_ready());
        w.advance(None);
        w.put(0, f64::NAN);
        w.put(1, f64::INFINITY);
        w.put(9, 1.0);
        assert_eq!((w.count(0), w.count(1)), (0, 0));
        assert!(w.is_ready());
        // One height in one slot says nothing of the climb.
        w.put(0, 1.0);
        assert!(matches!(w.decode(|_| false, &[], None), Err(SecureError::Unobservable { state: 1, .. })));
        let model = Model::<1> { a: SMatrix::from([[1.0]]), q: SMatrix::zeros() };
        let row = |sigma| Row { c: SVector::from([1.0]), sigma, bias_sigma: 0.0 };
        for sigma in [0.0, -1.0, f64::NAN] {
            let error = Window::new(&model, &[row(sigma)], &[0], 4, Settings::default()).unwrap_err();
            assert!(error.to_string().contains("whitening"), "{error}");
        }
        let flat = Model::<1> { a: SMatrix::zeros(), q: SMatrix::zeros() };
        assert!(Window::new(&flat, &[row(1.0)], &[0], 4, Settings::default()).is_err());
        assert!(Window::new(&model, &[row(1.0)], &[0], 0, Settings::default()).is_err());
        assert!(Window::new(&model, &[row(1.0)], &[1], 4, Settings::default()).is_err());
    }
}

//! The last T slots of every sensor, whitened and ready to decode.
//!
//! Slots are equally long; a sensor has at most one value in a slot, or none (multi-rate masks, drop-outs).
//! The state is anchored at the window's **end**: x_k = A⁻¹(x_{k+1} − w_k − b_k), so that what the model does
//! not know (process noise w) costs the old samples, not the state that is wanted. \[Clinic\] Eq. 22 anchors at
//! the beginning, where the newest samples carry all of it.
//!
//! | symbol | meaning | shape |
//! |---|---|---|
//! | A | transition over one slot | N × N |
//! | b_k | forced response of slot k: B u of the applied motor commands (\[Clinic\] Eq. 21) | N |
//! | Q | process noise of one slot | N × N |
//! | c, σ, β | row of a sensor, noise of one value, constant bias (one-sigma) | N, 1, 1 |
//! | Φᵢ | rows c A^{−k}, newest first | T × N |
//!
//! Cov(yᵢ) = σ² I + β² 11ᵀ + what Q leaves in the row; its Cholesky factor whitens Y and Φ. The process noise
//! that sensors share is counted for each alone: no sensor's window vouches for another's.
//!
//! The values are in `window/ring.rs`, the factors in `window/whiten.rs`.

mod ring;
#[cfg(test)]
mod tests;
mod whiten;

use nalgebra::{DMatrix, SMatrix, SVector};

use self::ring::Ring;
use self::whiten::{Phase, forward};
use super::compress::Compressed;
use super::newton::{Newton, Settings};
use super::{Decoded, Program, SecureError};

/// Longest window, slots.
pub const MAX_SLOTS: usize = 128;
/// A sensor with no more values than it sees states would leave a kink at zero residual; this much (in
/// sigmas) of constant residual rounds it off.
const FLOOR: f64 = 0.3;

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
    ring: Ring<N>,
    growing: bool,
    program: Program,
    a_inverse: SMatrix<f64, N, N>,
    phases: Vec<Phase>,
    /// Row kind of each sensor.
    kinds: Vec<usize>,
    problem: Compressed<N>,
    newton: Newton<N>,
    /// Whitened values of all sensors, those decoded and those excluded.
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
            ring: Ring::new(sensors, slots),
            growing: false,
            program: Program::L2,
            a_inverse,
            kinds: kinds.to_vec(),
            problem: room(sensors, slots)?,
            newton: Newton::with_room(rank.max(sensors * slots) + N, terms, settings),
            whitened: vec![0.0; sensors * slots],
            samples: Vec::with_capacity(sensors * (slots + 1) + 2 * N),
            statistics: vec![Statistic::default(); sensors],
            scratch: vec![0.0; slots * (N + 1)],
            phases,
        })
    }

    /// Decodes from the first slot on, while it is not yet full (\[Clinic\] 3.4.2: the window that grows).
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
        self.ring.slots()
    }

    /// Is it full?
    pub fn is_full(&self) -> bool {
        self.ring.filled() >= self.ring.slots()
    }

    /// May it be decoded: full, or growing with something in it?
    pub fn is_ready(&self) -> bool {
        self.is_full() || (self.growing && self.ring.filled() > 0)
    }

    /// Forgets every value.
    pub fn clear(&mut self) {
        self.ring.clear();
    }

    /// Begins a new slot; `forced` is B u of the step into it. A response that is not finite counts as none.
    pub fn advance(&mut self, forced: Option<&SVector<f64, N>>) {
        self.ring.advance(forced);
    }

    /// Value of `sensor` in the newest slot; what is not finite is skipped.
    pub fn put(&mut self, sensor: usize, value: f64) {
        self.ring.put(sensor, value);
    }

    /// Values of `sensor` in the window.
    pub fn count(&self, sensor: usize) -> usize {
        self.ring.mask(sensor).count_ones() as usize
    }

    /// Moves the trajectory from which values are counted: its state at the window's end changes by `by`.
    pub fn rebase(&mut self, by: &SVector<f64, N>) {
        for (sensor, kind) in self.kinds.iter().enumerate() {
            let mask = self.ring.mask(sensor);
            let Some(phase) = self.phases.get(*kind).filter(|_| mask != 0) else { continue };
            for (age, phi) in phase.phi.chunks_exact(phase.support.len().max(1)).enumerate() {
                if mask >> age & 1 == 1
                    && let Some(value) = self.ring.value_mut(sensor, age)
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
        for (sensor, mask) in self.ring.present() {
            if excluded(sensor) {
                continue;
            }
            let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { continue };
            let Some(factor) = phase.known(mask) else { continue };
            let first = sensor * self.ring.slots();
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
        let mut phi = DMatrix::zeros(self.slots(), N);
        for (k, row) in phase.phi.chunks_exact(phase.support.len().max(1)).enumerate() {
            for (j, v) in phase.support.iter().zip(row) {
                phi[(k, *j)] = *v;
            }
        }
        phi
    }

    /// Forced response removed, newest first, then L⁻¹.
    fn whiten(&mut self) {
        let Self { ring, whitened, phases, kinds, a_inverse, scratch, .. } = self;
        let slots = ring.slots();
        for (sensor, mask) in ring.present() {
            let Some(phase) = kinds.get(sensor).and_then(|k| phases.get_mut(*k)) else { continue };
            let Some(factor) = phase.factor(mask, slots, scratch) else { continue };
            let first = sensor * slots;
            let Some(out) = whitened.get_mut(first..first + slots) else { continue };
            let mut filled = 0;
            for age in (0..slots).filter(|age| mask >> age & 1 == 1) {
                if let (Some(value), Some(slot)) = (ring.value(sensor, age), out.get_mut(filled)) {
                    *slot = value;
                    filled += 1;
                }
            }
            forward(&factor.l, factor.count, out, 1, 0);
        }
        if !ring.is_forced() {
            return;
        }
        // y_k − c g_k, g_0 = 0, g_{k+1} = A⁻¹ (g_k − b_k): whitened like the values, and subtracted.
        for (sensor, mask) in ring.present() {
            let Some(phase) = kinds.get(sensor).and_then(|k| phases.get(*k)) else { continue };
            let Some(factor) = phase.known(mask) else { continue };
            let Some(out) = whitened.get_mut(sensor * slots..(sensor + 1) * slots) else { continue };
            let mut g = SVector::<f64, N>::zeros();
            let mut filled = 0;
            for age in 0..slots {
                if mask >> age & 1 == 1
                    && let (Some(slot), Some(newest)) = (scratch.get_mut(filled), phase.phi.get(..phase.support.len()))
                {
                    // The newest row of Φ is c itself.
                    *slot = phase.support.iter().zip(newest).map(|(j, v)| v * g[*j]).sum();
                    filled += 1;
                }
                if let Some(b) = ring.forced(age) {
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
        for (sensor, statistic) in self.statistics.iter_mut().enumerate() {
            *statistic = Statistic::default();
            let Some(phase) = self.kinds.get(sensor).and_then(|k| self.phases.get(*k)) else { continue };
            let Some(factor) = phase.known(self.ring.mask(sensor)) else { continue };
            let mut rx = [0.0; N];
            for (slot, row) in rx.iter_mut().zip(factor.r.chunks_exact(phase.support.len().max(1))) {
                *slot = phase.support.iter().zip(row).map(|(j, v)| v * x[*j]).sum();
            }
            let stride = factor.samples();
            let y = self.whitened.iter().skip(sensor * self.ring.slots()).take(factor.count);
            let square = y.enumerate().fold(0.0, |sum, (k, y)| {
                let column = |j: usize| factor.q.get(j * stride + k).copied().unwrap_or_default();
                let explained: f64 = rx.iter().take(factor.rank).enumerate().map(|(j, v)| v * column(j)).sum();
                sum + (y - explained) * (y - explained)
            });
            *statistic = Statistic { square, values: factor.count };
        }
    }
}

/// Room for the problem of any window of `sensors` sensors over `slots` slots, with a term for each state beside.
///
/// # Errors
/// Never, for any N.
pub(super) fn room<const N: usize>(sensors: usize, slots: usize) -> Result<Compressed<N>, SecureError> {
    Compressed::with_room(sensors + N, (slots + 1).max(2), sensors * slots.saturating_sub(1))
}

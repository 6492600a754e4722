//! The flying decoder: the window of every signal, solved slot by slot, in either coupling.

use nalgebra::SVector;
use plumbline_proto::time::FlightTime;

use super::compress::Compressed;
use super::model::{Quantity, STATES, rows, transition};
use super::newton::{Deadline, Settings};
use super::signals::{SIGNALS, Signals};
use super::window::{Statistic, Window, room};
use super::{Decoded, Decoder, SLOTS_MAX, SLOTS_MIN, SecureError, parts};
use crate::sensor::SensorModel;

/// Gap at which the flying decoder stops.
pub(super) const GAP: f64 = 1e-6;

/// A window to be solved again elsewhere.
#[derive(Debug, Clone)]
pub struct AuditCase {
    /// Its time.
    pub time: FlightTime,
    /// The problem.
    pub problem: Compressed<STATES>,
    /// Its samples.
    pub samples: Vec<f64>,
    /// Objective that flew.
    pub objective: f64,
}

impl AuditCase {
    /// Memory for any window.
    ///
    /// # Errors
    /// Never for this number of states.
    pub fn with_room() -> Result<Self, SecureError> {
        Ok(Self {
            time: FlightTime::default(),
            problem: room(SIGNALS, SLOTS_MAX)?,
            samples: Vec::with_capacity(SIGNALS * (SLOTS_MAX + 1) + 2 * STATES),
            objective: 0.0,
        })
    }
}

/// The window and its solver.
pub(super) struct FlyingDecoder {
    decoder: Decoder,
    window: Window<STATES>,
    /// That of the other coupling, empty: changed over without allocating.
    spare: Window<STATES>,
    /// Where the next solve starts.
    start: Option<SVector<f64, STATES>>,
}

impl FlyingDecoder {
    /// An empty window of `slots` slots over `signals`.
    ///
    /// # Errors
    /// Sensors without noise, which cannot be whitened; less than [`SLOTS_MIN`] or more than [`SLOTS_MAX`] slots.
    pub fn new(signals: &Signals, model: &SensorModel, slots: usize) -> Result<Self, SecureError> {
        if !(SLOTS_MIN..=SLOTS_MAX).contains(&slots) {
            return Err(SecureError::Slots { slots, least: SLOTS_MIN, most: SLOTS_MAX });
        }
        let settings = Settings { tolerance: GAP, ..Settings::default() };
        let kinds: Vec<usize> = signals.iter().map(|signal| signal.quantity.row()).collect();
        let rows: [_; Quantity::ALL.len()] = rows(model);
        let window = |split| Window::new(&transition(model, split), &rows, &kinds, slots, settings);
        Ok(Self { decoder: Decoder::L2, window: window(false)?, spare: window(true)?, start: None })
    }

    /// The program being solved.
    pub fn decoder(&self) -> Decoder {
        self.decoder
    }

    /// T of the window.
    pub fn slots(&self) -> usize {
        self.window.slots()
    }

    /// Values of a signal in the window.
    pub fn count(&self, signal: usize) -> usize {
        self.window.count(signal)
    }

    /// Statistic of a signal in the last window decoded.
    pub fn statistic(&self, signal: usize) -> Statistic {
        self.window.statistic(signal)
    }

    /// Is there a whole window?
    pub fn is_ready(&self) -> bool {
        self.window.is_ready()
    }

    /// Solves another program from now on; true where its coupling is another one, and the window empty again.
    /// Allocates nothing.
    ///
    /// [Clinic] 3.4.1 solves position and orientation apart because two programs are smaller than one. Without the
    /// coupling no sensor's term holds states of both, so the minimum of the sum is the sum of the minima: both
    /// are found by one solve here.
    pub fn select(&mut self, decoder: Decoder) -> bool {
        let (program, split) = parts(decoder);
        let changed = split != parts(self.decoder).1;
        if changed {
            std::mem::swap(&mut self.window, &mut self.spare);
        }
        self.window.use_program(program);
        self.start = None;
        self.decoder = decoder;
        changed
    }

    /// One more slot: the whitened values of `signals`, then counted from a path that lies `by` from the one before.
    pub fn push(&mut self, signals: &Signals, by: &SVector<f64, STATES>) {
        self.window.advance(None);
        for (index, value) in signals.iter().enumerate().filter_map(|(i, signal)| Some((i, signal.whitened()?))) {
            self.window.put(index, value);
        }
        self.window.rebase(by);
    }

    /// Empties the window.
    pub fn clear(&mut self) {
        self.window.clear();
        self.start = None;
    }

    /// The next solve starts from nothing.
    pub fn forget_start(&mut self) {
        self.start = None;
    }

    /// The state at the window's end without the signals that are `excluded`.
    ///
    /// # Errors
    /// What is left does not determine the state.
    pub fn decode(
        &mut self,
        excluded: impl Fn(usize) -> bool,
        prior: &[(usize, f64)],
    ) -> Result<Decoded<STATES>, SecureError> {
        let decoded = self.window.decode(excluded, prior, self.start.as_ref())?;
        self.start = Some(decoded.x);
        Ok(decoded)
    }

    /// The problem last decoded and its samples.
    pub fn problem(&self) -> (&Compressed<STATES>, &[f64]) {
        self.window.problem()
    }

    /// Gives up after `deadline`.
    pub fn limit(&mut self, deadline: Option<Deadline>) {
        for window in [&mut self.window, &mut self.spare] {
            let settings = Settings { deadline, ..*window.newton().settings() };
            window.newton().settle_for(settings);
        }
    }
}

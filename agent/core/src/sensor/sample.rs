//! What every kind of sensor is made of: a sample, its scalars, its quantities and its form on the wire.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::{Kind, Message, time::FlightTime, v1};

use super::suite::{Fill, Sheet};
use super::wire::Received;

/// A sample as scalars, in the order of its quantities; zero beyond them.
pub type Scalars = [f64; 9];

/// One measured quantity of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quantity {
    /// In lower case: "gyro".
    pub name: &'static str,
    /// SI unit; empty where it has none.
    pub unit: &'static str,
    /// How many scalars of the sample it takes.
    pub scalars: usize,
    /// An attack that adds to it must name it, for the sensor's quantities are equals; otherwise the first one is meant.
    pub named: bool,
}

/// What an estimator assumes of one scalar: the one-sigma of its noise, and the gate of its innovation, in sigmas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// One-sigma, in the scalar's unit.
    pub sigma: f64,
    /// An innovation of more sigmas is rejected; infinite for no gate.
    pub gate: f64,
}

impl Accuracy {
    /// Whatever its innovation, it is taken.
    pub const fn ungated(sigma: f64) -> Self {
        Self { sigma, gate: f64::INFINITY }
    }
}

/// A sample of one kind of sensor: the seam between a kind and everything that handles samples of any kind.
pub trait Sample: Copy + PartialEq + std::fmt::Debug {
    /// The kind.
    const KIND: v1::SensorKind;
    /// Its topic.
    const TOPIC: Kind;
    /// What it measures, in the order of [`Sample::scalars`].
    const QUANTITIES: &'static [Quantity];
    /// Its message: sensed and received.
    type Wire: Message + Default;
    /// Its data sheet.
    type Sheet: Sheet;
    /// What estimators assume of the sensors of this kind.
    type Model: Clone + PartialEq + std::fmt::Debug;

    /// What estimators assume of sensors with these data sheets; of sensors of which nothing is known, where there are
    /// none.
    fn model(sheets: &[Self::Sheet]) -> Self::Model;

    /// When it was measured.
    fn time(&self) -> FlightTime;

    /// The same sample, stamped with another time.
    #[must_use]
    fn with_time(self, time: FlightTime) -> Self;

    /// Its scalars.
    fn scalars(&self) -> Scalars;

    /// Its scalars; those of what it does not carry are what they were in the sample `before`.
    fn scalars_after(&self, _before: Option<Scalars>) -> Scalars {
        self.scalars()
    }

    /// Is it the very sample that `other` is, by its stamp and scalars, which are all that can be altered?
    fn is_same(&self, other: &Self) -> bool {
        self.time() == other.time() && same(&self.scalars(), &other.scalars())
    }

    /// The same sample with other scalars.
    #[must_use]
    fn with_scalars(self, values: &Scalars) -> Self;

    /// A message with room for what it owns, so that filling it allocates nothing.
    fn wire_with_room() -> Self::Wire {
        Self::Wire::default()
    }

    /// Fills a message with this sample as sensed and with what the estimators received of it.
    fn to_wire(&self, received: Option<&Self>, into: &mut Self::Wire);

    /// Sensed and received; `None` when a part is missing.
    fn from_wire(message: Self::Wire) -> Option<(Self, Received<Self>)>;
}

/// Where a frame keeps the samples of one kind: one place, or one for each instance.
pub trait Places<S: Sample> {
    /// As many data sheets, at most.
    type Sheets: Fill<S::Sheet>;
    /// How many.
    const LEN: usize;
    /// Is it a list?
    const MANY: bool;
    /// All of them; index 0 is instance 1.
    fn places(&self) -> &[Option<S>];
    /// The same, to alter.
    fn places_mut(&mut self) -> &mut [Option<S>];
}

impl<S: Sample> Places<S> for Option<S> {
    type Sheets = Option<S::Sheet>;
    const LEN: usize = 1;
    const MANY: bool = false;
    fn places(&self) -> &[Option<S>] {
        std::slice::from_ref(self)
    }
    fn places_mut(&mut self) -> &mut [Option<S>] {
        std::slice::from_mut(self)
    }
}

impl<S: Sample, const N: usize> Places<S> for [Option<S>; N] {
    type Sheets = ArrayVec<S::Sheet, N>;
    const LEN: usize = N;
    const MANY: bool = true;
    fn places(&self) -> &[Option<S>] {
        self
    }
    fn places_mut(&mut self) -> &mut [Option<S>] {
        self
    }
}

/// Are they the same scalars? What is no number in both is.
pub fn same(a: &Scalars, b: &Scalars) -> bool {
    a.iter().zip(b).all(|(a, b)| a == b || a.is_nan() && b.is_nan())
}

/// Three of the scalars as a vector.
pub(super) fn xyz(values: &Scalars, from: usize) -> Vector3<f64> {
    Vector3::from_fn(|i, _| values.get(from + i).copied().unwrap_or_default())
}

/// A vector as three of the scalars.
pub(super) fn put(values: &mut Scalars, from: usize, v: &Vector3<f64>) {
    for (slot, value) in values.iter_mut().skip(from).zip(v.iter()) {
        *slot = *value;
    }
}

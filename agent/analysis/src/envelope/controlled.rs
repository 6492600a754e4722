//! A vehicle about hover and its law, sampled: what the loops of all axes share.

use nalgebra::DMatrix;
use plumbline_core::control::law::Law;
use plumbline_core::control::margins::Plant;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::discretize::zero_order_hold;
use plumbline_core::model::linearize::hover;
use plumbline_core::model::state_space::StateSpace;

use super::bank::weighted;
use super::{EnvelopeError, Signal};

/// Some states of the vehicle, one input behind the motors' lag, and what the law makes of those states.
#[derive(Debug, Clone)]
pub(super) struct Controlled {
    law: StateSpace,
    vehicle: (DMatrix<f64>, DMatrix<f64>),
    pub(super) tick_s: f64,
    /// How much of the way to what is asked the motors go in a tick.
    pub(super) lags: f64,
}

impl Controlled {
    /// The states `kept` and the `input`, as places in `linearize::ix`; `horizontal`: with x and y controlled.
    ///
    /// # Errors
    /// [`EnvelopeError::Unstable`], [`EnvelopeError::Linalg`].
    pub(super) fn new(
        airframe: &Airframe,
        law: &Law,
        tick_s: f64,
        kept: &[usize],
        input: usize,
        horizontal: bool,
    ) -> Result<Self, EnvelopeError> {
        let linear = law.linear(tick_s, horizontal);
        let slowest = Plant::new(airframe, tick_s, horizontal)?.examine(&linear)?.margins.slowest_pole_per_s;
        if slowest.is_nan() || slowest >= 0.0 {
            return Err(EnvelopeError::Unstable { pole_per_s: slowest });
        }
        let (about, n) = (hover(airframe), kept.len());
        let lag_s = 0.5 * (airframe.motor_rise_time_constant_s + airframe.motor_fall_time_constant_s);
        // The last state is the input behind its lag.
        let a = DMatrix::from_fn(n + 1, n + 1, |r, c| match (kept.get(r), kept.get(c)) {
            (Some(r), Some(c)) => about.a[(*r, *c)],
            (Some(r), None) => about.b[(*r, input)],
            (None, Some(_)) => 0.0,
            (None, None) => -1.0 / lag_s,
        });
        let b = DMatrix::from_fn(n + 1, 1, |r, _| if r == n { 1.0 / lag_s } else { 0.0 });
        let sampled = zero_order_hold(&a, &b, tick_s)?;
        let law = StateSpace {
            a: linear.a,
            b: linear.b.select_columns(kept),
            c: linear.c.select_rows(&[input]),
            d: linear.d.select_rows(&[input]).select_columns(kept),
        };
        let lags = 1.0 - (-tick_s / lag_s).exp();
        Ok(Self { law, vehicle: (sampled.a, sampled.b), tick_s, lags })
    }
}

/// It, tick by tick.
pub(super) struct Motion<'a> {
    of: &'a Controlled,
    /// The states kept, then the input behind its lag.
    pub(super) x: Vec<Signal>,
    law: Vec<Signal>,
}

impl<'a> Motion<'a> {
    /// At rest.
    pub(super) fn new(of: &'a Controlled, width: usize) -> Self {
        let rest = |count: usize| (0..count).map(|_| Signal::zeros(width)).collect();
        Self { of, x: rest(of.vehicle.0.nrows()), law: rest(of.law.a.nrows()) }
    }

    /// A tick with this estimate of the states.
    pub(super) fn step(&mut self, estimate: &[Signal], width: usize) {
        let law = &self.of.law;
        let seen = |m: &DMatrix<f64>, k: &DMatrix<f64>, row: usize, states: &[Signal]| {
            let own = weighted(m.row(row).iter().copied(), states.iter(), width);
            own + weighted(k.row(row).iter().copied(), estimate.iter(), width)
        };
        let asked = seen(&law.c, &law.d, 0, &self.law);
        let next = (0..law.a.nrows()).map(|row| seen(&law.a, &law.b, row, &self.law)).collect();
        self.law = next;
        let (a, b) = &self.of.vehicle;
        let moved = |row: usize| {
            let mut x = weighted(a.row(row).iter().copied(), self.x.iter(), width);
            x.axpy(b[(row, 0)], &asked, 1.0);
            x
        };
        self.x = (0..self.x.len()).map(moved).collect();
    }
}

//! The bank of lanes about hover, linear: the lane of all healthy IMUs, and what each attacked one differs from it by.

use plumbline_core::estimate::lanes::linear::{SLOT, STATES, SlotMap, cycle};
use plumbline_core::sensor::MAX_HEIGHTS;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::flying::{ALTITUDE_M, Attacked};
use super::judges::Innovation;
use super::{EnvelopeError, Signal};

/// The bank of lanes: the one of all healthy IMUs, and what those attacked differ by.
pub(super) struct Bank<'a> {
    pub(super) maps: &'a [SlotMap],
    pub(super) healthy: [Signal; STATES],
    pub(super) differ: Vec<[Signal; STATES]>,
    pub(super) share: f64,
}

impl Bank<'_> {
    /// Takes slot `number`: mean specific force, what is added to each attacked IMU, heights with their offsets removed. The
    /// innovations.
    pub(super) fn take(
        &mut self,
        number: usize,
        force: &Signal,
        added: &[Signal],
        heights: &[Option<Signal>],
        width: usize,
    ) -> Vec<Innovation> {
        let mut innovations = Vec::new();
        let Some(slot) = self.maps.get(number % self.maps.len().max(1)) else { return innovations };
        let none = Signal::zeros(width);
        let row = |row: usize, states: &[Signal; STATES], force: &Signal, heights: &[Option<Signal>]| {
            let measured = heights.iter().map(|height| height.as_ref().unwrap_or(&none));
            let inputs = states.iter().chain(std::iter::once(force)).chain(measured);
            weighted(slot.map.row(row).iter().copied(), inputs, width)
        };
        for (i, sigma) in slot.sigma_m.iter().enumerate() {
            let Some(sigma) = sigma else { continue };
            let own = row(STATES + i, &self.healthy, force, heights);
            let others = self.differ.iter().zip(added).map(|(lane, added)| row(STATES + i, lane, added, &[])).collect();
            innovations.push((i, *sigma, own, others));
        }
        self.healthy = std::array::from_fn(|r| row(r, &self.healthy, force, heights));
        for (lane, added) in self.differ.iter_mut().zip(added) {
            *lane = std::array::from_fn(|r| row(r, lane, added, &[]));
        }
        innovations
    }

    /// Weighted mean of a state.
    pub(super) fn fused(&self, state: usize) -> Signal {
        self.differ.iter().fold(self.healthy[state].clone(), |sum, lane| sum + &lane[state] * self.share)
    }
}

/// What the lanes of the attacked IMUs differ from the others by in a slot.
#[derive(Debug, Clone, Default)]
pub(super) struct Differs {
    /// One-sigma of the innovation of each height that was sampled, m.
    pub(super) sigma_m: [Option<f64>; MAX_HEIGHTS],
    /// Of each attacked IMU: what is added, its lane's innovations, m, and bias, m/s².
    pub(super) lanes: Vec<(f64, [f64; MAX_HEIGHTS], f64)>,
}

impl Attacked<'_> {
    /// What `attack` (of one column) makes the attacked lanes differ by, slot by slot. No other part of the loop has a say in it.
    pub(super) fn differs(
        &self,
        horizon_s: f64,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Vec<Differs>, EnvelopeError> {
        let of = self.flying;
        let maps = cycle(&of.model, &of.schedule()?, &[1.0; MAX_HEIGHTS], of.noise_mps2, ALTITUDE_M);
        let none = || Signal::zeros(1);
        let mut bank = Bank {
            maps: &maps,
            healthy: std::array::from_fn(|_| none()),
            differ: self.imus.iter().map(|_| std::array::from_fn(|_| none())).collect(),
            share: 0.0,
        };
        let slot = |number: usize| {
            let id = |i: &usize| SensorId::new(SensorKind::Imu, *i as u8 + 1);
            let added: Vec<Signal> = self.imus.iter().map(|i| attack(id(i), number)).collect();
            let mut out = Differs::default();
            out.lanes.resize(added.len(), Default::default());
            for (i, sigma_m, _, lanes) in bank.take(number, &none(), &added, &[], 1) {
                if let Some(place) = out.sigma_m.get_mut(i) {
                    *place = Some(sigma_m);
                }
                for (lane, innovation) in out.lanes.iter_mut().zip(&lanes) {
                    lane.1[i] = innovation[0];
                }
            }
            for ((lane, added), [_, _, bias]) in out.lanes.iter_mut().zip(&added).zip(&bank.differ) {
                (lane.0, lane.2) = (added[0], bias[0]);
            }
            out
        };
        Ok((0..(horizon_s / SLOT).ceil() as usize).map(slot).collect())
    }
}

/// Σ weight · signal.
pub(super) fn weighted<'s>(
    row: impl Iterator<Item = f64>,
    of: impl Iterator<Item = &'s Signal>,
    width: usize,
) -> Signal {
    row.zip(of).filter(|(weight, _)| *weight != 0.0).fold(Signal::zeros(width), |mut sum, (weight, signal)| {
        sum.axpy(weight, signal, 1.0);
        sum
    })
}

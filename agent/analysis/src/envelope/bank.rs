//! The bank of lanes about hover, linear: the lane of all healthy IMUs, and what each attacked one differs from it by.

use plumbline_core::estimate::lanes::linear::{Differing, Measured, SLOT, STATES, SlotMap, differing};
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
    /// Takes slot `number`: mean specific force, what the lane of each attacked IMU takes of what is added to that, what each row measured, of heights
    /// with their offsets removed. The innovations.
    pub(super) fn take(
        &mut self,
        number: usize,
        force: &Signal,
        added: &[Signal],
        measured: &[Option<Signal>],
        width: usize,
    ) -> Vec<Innovation> {
        let mut innovations = Vec::new();
        let Some(slot) = self.maps.get(number % self.maps.len().max(1)) else { return innovations };
        let none = Signal::zeros(width);
        let row = |row: usize, states: &[Signal; STATES], force: &Signal, measured: &[Option<Signal>]| {
            let measured = measured.iter().map(|one| one.as_ref().unwrap_or(&none));
            let inputs = states.iter().chain(std::iter::once(force)).chain(measured);
            weighted(slot.map.row(row).iter().copied(), inputs, width)
        };
        for (i, sigma) in slot.sigma_m.iter().enumerate() {
            let Some(sigma) = sigma else { continue };
            let own = row(STATES + i, &self.healthy, force, measured);
            let others = self.differ.iter().zip(added).map(|(lane, added)| row(STATES + i, lane, added, &[])).collect();
            innovations.push((i, *sigma, own, others));
        }
        self.healthy = std::array::from_fn(|r| row(r, &self.healthy, force, measured));
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

/// What is added to each attacked IMU in a slot, m/s², and what its lane differs from the others by.
pub(super) type Differs = Vec<(f64, Differing)>;

impl Attacked<'_> {
    /// What `attack` (of one column) makes the attacked lanes differ by, slot by slot, for each of `begun`: of IMUs whose
    /// noise was measured as that part of that of the others, so many slots after the begin of a mean. No other part of the loop has a say in it.
    pub(super) fn differs(
        &self,
        horizon_s: f64,
        attack: &dyn Fn(SensorId, usize) -> Signal,
        begun: &[(f64, u32)],
    ) -> Result<Vec<Vec<Differs>>, EnvelopeError> {
        let of = self.flying;
        let (schedule, weights) = (of.schedule()?, [1.0; MAX_HEIGHTS]);
        let slots = (horizon_s / SLOT).ceil() as usize;
        let added = |i: &usize| -> Vec<f64> {
            let id = SensorId::new(SensorKind::Imu, *i as u8 + 1);
            (0..slots).map(|number| attack(id, number)[0]).collect()
        };
        let added: Vec<_> = self.imus.iter().map(added).collect();
        let differs = |&(part, begin): &(f64, u32)| -> Vec<Differs> {
            let measured = Measured { shaken: of.shaken, noise_mps2: part * of.shaken.noise_mps2, begin };
            let lane = |added: &Vec<f64>| differing(&of.model, &schedule, &weights, &measured, ALTITUDE_M, added);
            let lanes: Vec<_> = added.iter().map(lane).collect();
            let slot = |number: usize| {
                let of = added.iter().zip(&lanes);
                of.filter_map(|(added, of)| Some((*added.get(number)?, *of.get(number)?))).collect()
            };
            (0..slots).map(slot).collect()
        };
        Ok(begun.iter().map(differs).collect())
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

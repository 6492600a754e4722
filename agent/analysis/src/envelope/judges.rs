//! The judges of the lanes as linear statistics: what would make a sensor weigh less or be excluded, were it further off.
//!
//! Each is a necessary condition of silence, so that the bound stays one:
//! - A mean mᵢ of residuals is within L σ of the robust centre c where Σ ψ((mⱼ − mᵢ)/σ + L) ≥ ρ (mᵢ/σ − L), ψ clipped at κ. With
//!   ψ(x) ≤ x for the healthy and ψ ≤ κ for the attacked, (h + ρ) mᵢ − Σ_healthy m ≤ σ (κ s + (h + ρ) L); likewise for a healthy
//!   one that is outvoted, the parts exchanged. h healthy, s attacked, ρ = (σ/prior)².
//! - Evidence Σ wₖ eₖ² ≤ L s², forgotten as wₖ, and the mean square of the vote are sums of squares ([`SQUARES`]).

use std::collections::VecDeque;

use plumbline_core::estimate::lanes::linear::{SLOT, STATES, of_heights, of_imus};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::Signal;
use super::flying::{Attacked, Regime, usual_mps2};
use super::program::{Memory, Statistic};

/// Names of the detectors that sum squares.
pub const EVIDENCE: &str = "IMU evidence";
const VOTE: &str = "IMU vote, one slot";
/// Names of the vote over an accelerometer.
pub(super) const ALONG: (&str, &str) = ("IMU vote", VOTE);
/// Those, and how long a square counts.
pub(super) const SQUARES: [(&str, Memory); 2] =
    [(EVIDENCE, Memory::Forgotten(of_imus::MEMORY_S)), (VOTE, Memory::Last(of_imus::SLOTS as f64 * SLOT))];

/// Names of the vote over a gyroscope.
pub(super) const TURNING: (&str, &str) = ("IMU vote, turning", "IMU vote, turning, one slot");

/// Innovations of a slot: height, its σ, of the healthy lanes, and what those attacked differ by.
pub(super) type Innovation = (usize, f64, Signal, Vec<Signal>);

/// What a height is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Excluded,
    Healthy,
    Attacked,
}

/// State of all judges.
pub(super) struct Judges {
    heights: Vec<Role>,
    imus: Vec<usize>,
    of_imus: usize,
    regime: Regime,
    reach_m: f64,
    width: usize,
    /// What was learned of each height: an offset, m, and a scale.
    offsets: Vec<[Signal; 2]>,
    /// The last residuals of each height, the newest first.
    residuals: Vec<VecDeque<Signal>>,
    votes: Vec<Voted>,
}

/// The vote over one axis of an attacked IMU.
pub(super) struct Voted {
    /// Of the mean, and of a single slot.
    names: (&'static str, &'static str),
    usual: f64,
    learned: Signal,
    kept: VecDeque<Signal>,
}

impl Voted {
    /// Nothing heard; deviations of `usual` size are usual.
    pub(super) fn new(names: (&'static str, &'static str), usual: f64, width: usize) -> Self {
        let kept = VecDeque::from(vec![Signal::zeros(width); of_imus::SLOTS]);
        Self { names, usual, learned: Signal::zeros(width), kept }
    }

    /// What was `added` in a slot, and what the `bias` of its lane differs by; `add` takes detector, limit and row.
    pub(super) fn hear(&mut self, added: &Signal, bias: &Signal, add: &mut dyn FnMut(&'static str, f64, Signal)) {
        let deviation = added - &self.learned;
        self.kept.pop_back();
        self.kept.push_front(deviation.clone());
        let ((shift, size), n) = (of_imus::LIMITS, of_imus::SLOTS);
        add(self.names.0, shift * self.usual, mean(self.kept.iter().cloned(), n, deviation.len()));
        add(self.names.1, size * self.usual * (n as f64).sqrt(), deviation);
        let towards = bias - &self.learned;
        self.learned.axpy(of_imus::LEARNED, &towards, 1.0);
    }
}

fn mean(of: impl Iterator<Item = Signal>, count: usize, width: usize) -> Signal {
    of.fold(Signal::zeros(width), |sum, x| sum + x) / count.max(1) as f64
}

impl Judges {
    /// Nothing heard yet; `rates_hz` of the heights, `None` of one that is excluded.
    pub(super) fn new(of: &Attacked, rates_hz: &[Option<f64>], imus: usize, measured_mps2: f64, width: usize) -> Self {
        let zero = || Signal::zeros(width);
        let longest = of_heights::MEANS.iter().map(|(n, _)| *n).max().unwrap_or(1);
        let role = |(i, rate_hz): (usize, &Option<f64>)| match rate_hz {
            None => Role::Excluded,
            Some(_) if of.heights.contains(&i) => Role::Attacked,
            Some(_) => Role::Healthy,
        };
        Self {
            heights: rates_hz.iter().enumerate().map(role).collect(),
            imus: of.imus.clone(),
            of_imus: imus,
            regime: of.regime,
            reach_m: of_heights::REACH_M + of.near_m,
            width,
            offsets: rates_hz.iter().map(|_| [zero(), zero()]).collect(),
            residuals: rates_hz.iter().map(|_| VecDeque::from(vec![zero(); longest])).collect(),
            votes: of.imus.iter().map(|_| Voted::new(ALONG, usual_mps2(measured_mps2), width)).collect(),
        }
    }

    /// What a healthy height weighs just before its exclusion by `attacked` others, of `healthy`: its weight, and how little of
    /// it its reach leaves.
    pub(super) fn outvoted(attacked: usize, healthy: usize) -> f64 {
        let (_, sigma_m) = of_heights::MEANS[1];
        let apart_m = sigma_m * (of_heights::LIMIT + of_heights::PULL * healthy as f64 / attacked.max(1) as f64);
        (of_heights::SOFT / of_heights::LIMIT).powi(2) * (of_heights::REACH_M / apart_m).min(1.0)
    }

    /// Heights as measured at altitude `z_m`, what was learned of each taken off.
    pub(super) fn without_offsets(&self, measured: &[Option<Signal>], z_m: f64) -> Vec<Option<Signal>> {
        let one = |(y, [off, scale]): (&Option<Signal>, &[Signal; 2])| {
            y.as_ref().map(|y| y - off - scale * (z_m - of_heights::PIVOT_M))
        };
        measured.iter().zip(&self.offsets).map(one).collect()
    }

    fn height(i: usize) -> Option<SensorId> {
        Some(SensorId::new(SensorKind::Height, i as u8 + 1))
    }

    /// Attacked and healthy heights.
    fn counts(&self) -> (usize, usize) {
        let count = |role: Role| self.heights.iter().filter(|of| **of == role).count();
        (count(Role::Attacked), count(Role::Healthy))
    }

    /// Mean of the last residuals of the healthy heights.
    fn healthy(&self) -> Option<Signal> {
        let (_, healthy) = self.counts();
        let last = self.residuals.iter().zip(&self.heights).filter(|(_, role)| **role == Role::Healthy);
        let last = last.filter_map(|(residuals, _)| residuals.front().cloned());
        (healthy > 0).then(|| mean(last, healthy, self.width))
    }

    /// How far each healthy height, as last heard, is from the mean of them.
    pub(super) fn apart(&self) -> Vec<Signal> {
        let Some(mean) = self.healthy() else { return Vec::new() };
        let of = self.residuals.iter().zip(&self.heights).filter(|(_, role)| **role == Role::Healthy);
        of.filter_map(|(residuals, _)| Some(residuals.front()? - &mean)).collect()
    }

    /// Slot `number` that ends at `time_s`, at altitude `z_m`: innovations, and residuals after the correction.
    pub(super) fn hear_heights(
        &mut self,
        (time_s, z_m): (f64, f64),
        number: usize,
        innovations: &[Innovation],
        residuals: &[Option<Signal>],
        out: &mut Vec<Statistic>,
    ) {
        let (attacked, healthy) = self.counts();
        let others = self.healthy();
        let share = 1.0 / self.of_imus as f64;
        for (i, sigma_m, own, differ) in innovations {
            if self.heights.get(*i) != Some(&Role::Attacked) {
                continue;
            }
            let innovation = differ.iter().fold(own.clone(), |sum, other| sum + other * share);
            let mut add = |detector, limit, row| {
                out.push(Statistic { detector, sensor: Self::height(*i), time_s, limit, row });
            };
            let reaches = attacked < healthy && attacked + healthy > 2 && self.reach_m.is_finite();
            if let Some(others) = others.as_ref().filter(|_| reaches) {
                // Beyond it a sample counts as if it were there.
                add("height reach", self.reach_m, &innovation - others);
            }
            if let Some((others, Some(residual))) = others.as_ref().zip(residuals.get(*i)) {
                add("height split", of_heights::GAP_M, residual - others);
            }
            add("height knee", of_heights::KNEE * sigma_m, innovation);
        }
        for (kept, residual) in self.residuals.iter_mut().zip(residuals) {
            if let Some(residual) = residual {
                kept.pop_back();
                kept.push_front(residual.clone());
            }
        }
        if (number + 1).is_multiple_of(of_heights::EVERY) && attacked > 0 {
            self.decode(time_s, z_m, out);
        }
    }

    fn decode(&mut self, time_s: f64, z_m: f64, out: &mut Vec<Statistic>) {
        let (attacked, healthy) = self.counts();
        for ((n, sigma_m), detector) in of_heights::MEANS.into_iter().zip(["height mean, short", "height mean, long"]) {
            let means: Vec<Signal> =
                self.residuals.iter().map(|kept| mean(kept.iter().take(n).cloned(), n, self.width)).collect();
            let prior = (sigma_m / of_heights::PRIOR_M).powi(2);
            let level = if self.regime == Regime::Full { of_heights::SOFT } else { of_heights::LIMIT };
            let sum = |of: Role| {
                let these = means.iter().zip(&self.heights).filter(|(_, role)| **role == of);
                these.fold(Signal::zeros(self.width), |sum, (mean, _)| sum + mean)
            };
            let (sums, mut add) = ([sum(Role::Healthy), sum(Role::Attacked)], |i: usize, limit: f64, row: Signal| {
                out.push(Statistic { detector, sensor: Self::height(i), time_s, limit, row });
            });
            // At most a minority is ever excluded: of two none.
            let excludes = attacked + healthy > 2;
            for (i, (mean, role)) in means.iter().zip(&self.heights).enumerate().filter(|_| excludes) {
                let (is_attacked, count, against, sum) = match role {
                    Role::Attacked => (true, attacked, healthy, &sums[0]),
                    Role::Healthy => (false, healthy, attacked, &sums[1]),
                    Role::Excluded => continue,
                };
                // Attacked ones in a majority are near the centre; healthy ones in a majority too.
                let far = if is_attacked { self.regime == Regime::Full } else { 2 * attacked >= attacked + healthy };
                if far && against > 0 {
                    let weight = against as f64 + prior;
                    let limit = sigma_m * (of_heights::PULL * count as f64 + weight * level);
                    add(i, limit, mean * weight - sum);
                }
            }
            if n == of_heights::MEANS[1].0 && self.regime == Regime::Full {
                let used = || means.iter().zip(&self.heights).filter(|(_, role)| **role != Role::Excluded);
                let common = mean(used().map(|(mean, _)| mean.clone()), attacked + healthy, self.width);
                for ([offset, scale], mean) in self.offsets.iter_mut().zip(&means) {
                    let off = mean - &common;
                    offset.axpy(of_heights::LEARNED, &off, 1.0);
                    scale.axpy(of_heights::LEARNED * of_heights::SCALE_SHARE * (z_m - of_heights::PIVOT_M), &off, 1.0);
                }
            }
        }
    }

    /// What was `added` to the IMUs attacked, and what their lanes `differ` by.
    pub(super) fn hear_imus(
        &mut self,
        time_s: f64,
        added: &[Signal],
        innovations: &[Innovation],
        differ: &[[Signal; STATES]],
        out: &mut Vec<Statistic>,
    ) {
        let attacked = self.imus.len();
        for (place, (imu, added)) in self.imus.iter().zip(added).enumerate() {
            let sensor = Some(SensorId::new(SensorKind::Imu, *imu as u8 + 1));
            let mut add = |detector, limit, row| {
                out.push(Statistic { detector, sensor, time_s, limit, row });
            };
            // A vote needs a majority.
            let voting = 2 * attacked < self.of_imus;
            if let (true, Some(vote), Some([_, _, bias])) = (voting, self.votes.get_mut(place), differ.get(place)) {
                vote.hear(added, bias, &mut add);
            }
            // Evidence is held against the second-best lane: two healthy ones.
            if self.of_imus >= attacked + 2 {
                for (_, sigma, _, differ) in innovations {
                    let Some(innovation) = differ.get(place) else { continue };
                    add(EVIDENCE, sigma * of_imus::EVIDENCE.sqrt(), innovation.clone());
                }
            }
        }
    }
}

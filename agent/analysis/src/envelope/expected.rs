//! What an attack that adds to heights and accelerometers is expected to be seen with: the lanes' own judges, fed with what it
//! adds and with drawn noise, many times.
//!
//! Heights are heard as the residuals that the linear loop has of them. A lane is heard as its linear map has it, with noise of its own IMU
//! and that of the heights, which all lanes share; one with an attacked IMU also by what it differs from the others, the very lane that
//! flies, its own noise behind the gains of a healthy one. Noise is white: of heights as the data sheets have it, of accelerometers at least as
//! it was measured, each by itself, though IMUs that sample together share some. Offsets that are not learned and what the vehicle does are
//! left out.

use nalgebra::SVector;
use plumbline_core::estimate::lanes::judged::{Judged, LaneHeard};
use plumbline_core::estimate::lanes::linear::{Differing, HORIZON_S, INPUTS, ROWS, SLOT, STATES, SlotMap, cycle};
use plumbline_core::sensor::{MAX_HEIGHTS, MAX_IMUS};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::bank::Differs;
use super::flying::{ALTITUDE_M, Attacked, Loop, Regime};
use super::{EnvelopeError, Model, Signal};

/// Flights drawn.
pub const DRAWN: u64 = 200;
/// Judges have heard so long of nothing but noise before the onset, s.
pub(super) const BEFORE_S: f64 = 8.0;
/// What the noise of an attacked IMU is measured as at the onset, of that of the others, and how many slots since the begin of a mean:
/// flights take them by turns. Means of |Δ|, whose deviation is 0.76 of its mean, forgotten by 0.08, scatter by 0.15: quarters of a
/// normal distribution.
pub(super) const BEGUN: [(f64, u32); 4] = [(0.95, 0), (1.2, 5), (0.8, 10), (1.05, 15)];

/// What is added to one sensor over time: seconds since the onset to m or m/s².
#[allow(missing_debug_implementations, reason = "a function")]
pub struct Added<'a> {
    /// Its sensor.
    pub sensor: SensorId,
    /// What is added.
    pub at: &'a dyn Fn(f64) -> f64,
}

/// What is expected of an attack.
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Of each of [`DRAWN`] flights the most that the statistic of an attacked sensor reached, of its limit; infinite where it was seen: a
    /// sensor was excluded, or the heights were found to contradict each other.
    pub scores: Vec<f64>,
    /// Furthest that it moves the altitude in the linear loop, m: in each of those flights until it is seen or no longer followed, of all of them
    /// the most.
    pub altitude_m: f64,
    /// Furthest that it moves the linear loop along a horizontal axis: tilt (rad), velocity (m/s) and position (m); 0 along z.
    pub aside: [f64; 3],
}

impl Expected {
    /// Part of the flights in which it is seen.
    pub fn probability(&self) -> f64 {
        self.seen() as f64 / DRAWN as f64
    }

    /// Flights of [`DRAWN`] in which it is seen.
    pub fn seen(&self) -> u64 {
        self.scores.iter().filter(|score| score.is_infinite()).count() as u64
    }
}

/// What is expected of `added` for `horizon_s`; `seed` of the noise. The judges hear the loop of accelerometers that rectify nothing, which is
/// as they are flown: with what is rectified heights would be followed, and seen later than they are.
///
/// # Errors
/// [`EnvelopeError`].
pub fn expected(shaken: &Loop, added: &[Added<'_>], horizon_s: f64, seed: u64) -> Result<Expected, EnvelopeError> {
    let sensors: Vec<SensorId> = added.iter().map(|one| one.sensor).collect();
    let flying = &shaken.at_rest();
    let attacked = flying.attacked(&sensors, Regime::Full)?;
    let every = attacked.attacked();
    let value = |sensor: SensorId, k: usize| {
        let period = every.iter().find(|(of, ..)| *of == sensor).map(|(_, period_s, _)| *period_s);
        let one = added.iter().find(|one| one.sensor == sensor);
        // Of a slot its middle counts.
        let late = if sensor.kind == SensorKind::Imu { 0.5 } else { 0.0 };
        let at = one.zip(period).map_or(0.0, |(one, period_s)| (one.at)((k as f64 + late) * period_s));
        Signal::from_element(1, at)
    };
    // The last slots are closed behind the horizon of the lanes.
    let response = attacked.respond(horizon_s + HORIZON_S + SLOT, 1, &value)?;
    let is_shaken = shaken.shaken != flying.shaken;
    let moved =
        is_shaken.then(|| shaken.attacked(&sensors, Regime::Full)?.respond(horizon_s, 1, &value)).transpose()?;
    let within = (horizon_s / SLOT).round() as usize;
    let places = moved.as_ref().unwrap_or(&response).place_m.iter();
    let differs = attacked.differs(horizon_s, &value, &BEGUN)?;
    let schedule = flying.schedule()?;
    let maps = cycle(&flying.model, &schedule, &[1.0; MAX_HEIGHTS], &flying.shaken, ALTITUDE_M);
    let mut residuals_m = vec![[0.0; MAX_HEIGHTS]; (horizon_s / SLOT).ceil() as usize + 1];
    for (number, i, residual) in &response.residuals_m {
        if let Some(place) = residuals_m.get_mut(*number).and_then(|slot| slot.get_mut(*i)) {
            *place = residual[0];
        }
    }
    let (attacked, residuals_m, differs) = (&attacked, &residuals_m[..], &differs[..]);
    let heard = Heard { attacked, added, residuals_m, differs, schedule: &schedule, maps: &maps, horizon_s };
    let (scores, unseen): (Vec<f64>, Vec<usize>) =
        (0..DRAWN).map(|number| heard.score(number, &mut dice(seed, number))).unzip();
    let longest = unseen.into_iter().max().unwrap_or_default().min(within);
    let altitude_m = places.take(longest).map(|z| z[0].abs()).fold(0.0, f64::max);
    Ok(Expected { scores, altitude_m, aside: [0.0; 3] })
}

/// The noise of flight `number` of those drawn.
pub(super) fn dice(seed: u64, number: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed ^ (number << 20))
}

/// When each height was sampled, and what it read, m.
type Read = [Option<(FlightTime, f64)>; MAX_HEIGHTS];

struct Heard<'a> {
    attacked: &'a Attacked<'a>,
    added: &'a [Added<'a>],
    /// Of the heights, slot by slot, without noise.
    residuals_m: &'a [[f64; MAX_HEIGHTS]],
    /// For each of [`BEGUN`], slot by slot.
    differs: &'a [Vec<Differs>],
    schedule: &'a [[Option<f64>; ROWS]],
    /// Of a healthy lane.
    maps: &'a [SlotMap],
    horizon_s: f64,
}

impl Heard<'_> {
    /// See [`Expected::scores`], with noise of these `dice`; and for how many slots the attack is followed.
    fn score(&self, flight: u64, dice: &mut Xoshiro256PlusPlus) -> (f64, usize) {
        let (mut judges, mut most) = (Judged::default(), 0.0);
        let differs = self.differs.get(flight as usize % BEGUN.len()).map_or(&[][..], Vec::as_slice);
        // The attack begins with the cycle of the heights.
        let before = ((BEFORE_S / SLOT) as usize).next_multiple_of(self.schedule.len().max(1));
        let slots = before + (self.horizon_s / SLOT).ceil() as usize;
        let mut states = vec![[0.0; STATES]; self.attacked.flying.white.1.len()];
        // Heights that have parted are not followed.
        let mut parted = None;
        for number in 0..slots {
            let (heights, coasted, noises) = self.heights(number, before, dice);
            let attacked = number.checked_sub(before).and_then(|number| differs.get(number));
            let lanes = self.lanes(attacked.map_or(&[], Vec::as_slice), number, &mut states, &noises, dice);
            judges.take(FlightTime::from_seconds((number + 1) as f64 * SLOT), ALTITUDE_M, &heights, &coasted, &lanes);
            let Some(under) = number.checked_sub(before) else { continue };
            let refused = self.attacked.heights.iter().any(|i| judges.refuses(*i));
            parted = if refused { parted.or(Some(under)) } else { None };
            most = f64::max(most, self.ratio(&judges));
            if most.is_infinite() {
                // The lanes judge that far back.
                return (most, parted.unwrap_or(under + 1 + (HORIZON_S / SLOT).ceil() as usize));
            }
        }
        (most, slots)
    }

    fn ratio(&self, judges: &Judged) -> f64 {
        if judges.contradicted() || (0..MAX_HEIGHTS).any(|i| judges.height(i)) || (0..MAX_IMUS).any(|i| judges.imu(i)) {
            return f64::INFINITY;
        }
        let height = |i: &usize| judges.height_ratio(*i);
        let imu = |i: &usize| judges.imu_ratio(*i);
        self.attacked.heights.iter().map(height).chain(self.attacked.imus.iter().map(imu)).fold(0.0, f64::max)
    }

    /// What the heights read in slot `number` from where the lanes have the altitude, and from the altitude as it is, which accelerations
    /// alone follow; and the noise in both.
    fn heights(&self, number: usize, before: usize, dice: &mut Xoshiro256PlusPlus) -> (Read, Read, [f64; ROWS]) {
        let end_s = (number + 1) as f64 * SLOT;
        let ages = self.schedule.get(number % self.schedule.len().max(1)).copied().unwrap_or_default();
        let (mut heights, mut coasted, mut noises) = ([None; MAX_HEIGHTS], [None; MAX_HEIGHTS], [0.0; ROWS]);
        for (noise, (age_s, sigma)) in noises.iter_mut().zip(ages.iter().zip(&self.attacked.flying.white.0)) {
            if age_s.is_some() {
                let draw: f64 = StandardNormal.sample(dice);
                *noise = sigma * draw;
            }
        }
        let places = heights.iter_mut().zip(&mut coasted).zip(&noises).zip(ages).enumerate();
        for (i, (((height, coasted), noise), age_s)) in places {
            let Some(age_s) = age_s else { continue };
            let slot = number.checked_sub(before).and_then(|number| self.residuals_m.get(number));
            let residual_m = slot.and_then(|slot| slot.get(i)).copied().unwrap_or_default();
            let since_s = end_s - age_s - before as f64 * SLOT;
            let is_its =
                |one: &&Added<'_>| one.sensor.kind == SensorKind::Height && usize::from(one.sensor.instance) == i + 1;
            let added = self.added.iter().filter(is_its).filter(|_| since_s >= 0.0);
            let added_m: f64 = added.map(|one| (one.at)(since_s)).sum();
            let time = FlightTime::from_seconds(end_s - age_s);
            (*height, *coasted) = (Some((time, *noise + residual_m)), Some((time, *noise + added_m)));
        }
        (heights, coasted, noises)
    }

    /// What the lanes make of slot `number`, whose heights have this noise, from what noise made of their `states` before; of those attacked
    /// `differs` tells what they differ by.
    fn lanes(
        &self,
        differs: &[(f64, Differing)],
        number: usize,
        states: &mut [[f64; STATES]],
        noises: &[f64; ROWS],
        dice: &mut Xoshiro256PlusPlus,
    ) -> [Option<LaneHeard>; MAX_IMUS] {
        let mut lanes = [None; MAX_IMUS];
        let Some(slot) = self.maps.get(number % self.maps.len().max(1)) else { return lanes };
        let each = lanes.iter_mut().zip(states).zip(&self.attacked.flying.white.1).enumerate();
        for (i, ((lane, state), sigma_mps2)) in each {
            let own = self.attacked.imus.iter().position(|imu| *imu == i);
            let attacked = own.and_then(|own| differs.get(own));
            let draw: f64 = StandardNormal.sample(dice);
            let read_mps2 = sigma_mps2 * draw;
            let inputs = state.iter().chain(std::iter::once(&read_mps2)).chain(noises).copied();
            let out = slot.map * SVector::<f64, INPUTS>::from_iterator(inputs);
            state.iter_mut().zip(out.iter()).for_each(|(state, out)| *state = *out);
            let of = |j: usize| {
                let healthy = slot.sigma_m.get(j).copied().flatten().map(|sigma_m| (0.0, sigma_m));
                let (off_m, sigma_m) =
                    attacked.map_or(healthy, |(_, lane)| lane.innovations.get(j).copied().flatten())?;
                Some((out.get(STATES + j)? + off_m) / sigma_m)
            };
            let innovations = std::array::from_fn(of);
            let (added, learned) = attacked.map_or((0.0, 0.0), |(added, lane)| (*added, lane.bias_mps2));
            let bias_mps2 = learned + state[STATES - 1];
            *lane = Some(LaneHeard { innovations, force_mps2: added + read_mps2, bias_mps2 });
        }
        lanes
    }
}

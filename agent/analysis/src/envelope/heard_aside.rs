//! What an attack along a horizontal axis is expected to be seen with: the lanes' own judges, fed with what it adds and with drawn
//! noise, many times.
//!
//! Every lane is followed as one: its linear map takes what its IMU reads, the vehicle's motion by the linear loop and white noise
//! included (of accelerometers at least as it was measured, of the rest as on the data sheets), and what motion capture or GNSS reads, whose noise all lanes share. What the lanes are surprised by, and
//! what their IMUs differ by, goes to the judges that fly. The step of an accelerometer's bias is taken for noise for a while, as along z. Their vote knows no axis: an accelerometer's x is heard as its z would be, a
//! gyroscope in units of the deviation that is taken for usual. Each is heard by itself, in flight the worse of both counts, slot by slot.
//!
//! Rotor drag and the field are not heard, so that less is seen here than in flight: little beside motion capture, which tells lanes apart
//! long before. Where nothing measures, or GNSS does once a second, drag does most of it, and whoever asks is told nothing.
//! Tilts apart exclude nobody by themselves.

use nalgebra::SVector;
use plumbline_core::estimate::lanes::judged::{Judged, LaneHeard};
use plumbline_core::estimate::lanes::lateral::{INPUTS, ROWS, STATES};
use plumbline_core::estimate::lanes::linear::{self, Measured, SLOT, Shaken, noise_course, of_imus};
use plumbline_core::sensor::{MAX_HEIGHTS, MAX_IMUS};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::expected::{BEFORE_S, BEGUN, DRAWN, Expected, dice};
use super::flying::ALTITUDE_M;
use super::lateral::{Course, Lateral, RAISED};

/// What is added to: its unit is that of what is added.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// The accelerometer's reading along the axis, m/s².
    Force,
    /// The gyroscope's about the other horizontal axis, rad/s.
    Rate,
    /// The position along the axis as motion capture or GNSS measures it, m.
    Place,
}

/// What is added to one quantity of one sensor over time.
#[allow(missing_debug_implementations, reason = "a function")]
pub struct Pushed<'a> {
    /// Its sensor.
    pub sensor: SensorId,
    /// Of it.
    pub quantity: Quantity,
    /// What is added, in the unit of the quantity, so many seconds after the onset.
    pub at: &'a dyn Fn(f64) -> f64,
}

/// Flights to be drawn under one attack along a horizontal axis.
pub(super) struct Heard<'a> {
    lateral: &'a Lateral,
    course: Course,
    /// Added to the accelerometer and the gyroscope of each IMU in each slot, m/s² and rad/s.
    added: Vec<Vec<[f64; 2]>>,
    /// Place among [`RAISED`] of what each IMU's lane takes it for, in each slot: for each of [`BEGUN`].
    raised: Vec<Vec<Vec<usize>>>,
    /// Places of those attacked among the IMUs.
    attacked: Vec<usize>,
    slots: usize,
}

impl<'a> Heard<'a> {
    /// Follows the linear loop under `pushed` for `horizon_s`.
    pub(super) fn new(lateral: &'a Lateral, pushed: &[Pushed<'_>], horizon_s: f64) -> Self {
        let sum = |sensor: Option<SensorId>, quantity: Quantity, time_s: f64| -> f64 {
            let of = pushed.iter().filter(|one| Some(one.sensor) == sensor && one.quantity == quantity);
            of.map(|one| (one.at)(time_s)).sum()
        };
        // Of a slot its middle counts.
        let middle_s = |number: usize| (number as f64 + 0.5) * SLOT;
        let of = |imu: SensorId, number: usize| {
            [Quantity::Force, Quantity::Rate].map(|quantity| sum(Some(imu), quantity, middle_s(number)))
        };
        let measuring = lateral.measuring();
        let course = lateral.course(horizon_s, &of, &|time_s| sum(measuring, Quantity::Place, time_s));
        let slots = (horizon_s / SLOT).ceil() as usize;
        let added: Vec<Vec<_>> = lateral.imus().map(|imu| (0..slots).map(|number| of(imu, number)).collect()).collect();
        let raised =
            BEGUN.iter().map(|begun| added.iter().map(|added| raised(lateral, *begun, added)).collect()).collect();
        let is_attacked = |imu: &SensorId| pushed.iter().any(|one| one.sensor == *imu);
        let attacked = lateral.imus().enumerate().filter(|(_, imu)| is_attacked(imu)).map(|(place, _)| place);
        Self { lateral, course, added, raised, attacked: attacked.collect(), slots }
    }

    /// Furthest that the linear loop is moved: tilt (rad), velocity (m/s), position (m).
    pub(super) fn furthest(&self) -> [f64; 3] {
        std::array::from_fn(|i| self.course.aside.iter().take(self.slots).map(|of| of[i].abs()).fold(0.0, f64::max))
    }

    /// Largest acceleration of the vehicle in the linear loop, mean over a slot, m/s².
    pub(super) fn accelerated_mps2(&self) -> f64 {
        let two = self.course.aside.windows(2).take(self.slots);
        two.map(|of| ((of[1][1] - of[0][1]) / SLOT).abs()).fold(0.0, f64::max)
    }

    /// What is expected of it; `seed` of the noise.
    pub(super) fn expected(&self, seed: u64) -> Expected {
        let scores = (0..DRAWN).map(|number| self.score(number, &mut dice(seed, number))).collect();
        Expected { scores, altitude_m: 0.0, aside: self.furthest() }
    }

    /// Is it seen in more than this part of the flights? Draws no more of them than that takes.
    pub(super) fn is_seen_in_more(&self, part: f64, seed: u64) -> bool {
        let (most, mut seen) = ((part * DRAWN as f64).floor() as u64, 0);
        for number in 0..DRAWN {
            seen += u64::from(self.score(number, &mut dice(seed, number)).is_infinite());
            if seen > most || seen + (DRAWN - number - 1) <= most {
                break;
            }
        }
        seen > most
    }

    /// See [`Expected::scores`], with noise of these `dice`.
    fn score(&self, flight: u64, dice: &mut Xoshiro256PlusPlus) -> f64 {
        let (maps, raised) = (&self.lateral.maps, self.raised.get(flight as usize % BEGUN.len()));
        let mut lanes = vec![[0.0; STATES]; self.added.len()];
        // One for the accelerometers, one for the gyroscopes.
        let (mut judges, mut most) = ([Judged::default(), Judged::default()], 0.0);
        // The attack begins with the cycle of what measures.
        let before = ((BEFORE_S / SLOT) as usize).next_multiple_of(maps.len().max(1));
        for number in 0..before + self.slots {
            let Some(map) = maps.get(number % maps.len().max(1)) else { break };
            let under = number.checked_sub(before);
            let measured = self.measured(number, under, dice);
            let felt = under.and_then(|under| self.course.felt.get(under)).copied().unwrap_or_default();
            let mut heard = [[None; MAX_IMUS]; 2];
            for (i, lane) in lanes.iter_mut().enumerate() {
                let added = under.and_then(|under| self.added.get(i)?.get(under)).copied().unwrap_or_default();
                let sigma = self.lateral.white.imus.get(i).copied().unwrap_or_default();
                let [force, rate, lift] = felt;
                let read =
                    [force + added[0] + sigma[0] * normal(dice), rate + added[1] + sigma[1] * normal(dice), lift];
                let place = measured.unwrap_or_default();
                let inputs = lane.iter().chain(&read).chain(&place).copied();
                let level = under.and_then(|under| raised?.get(i)?.get(under)).filter(|level| **level > 0);
                let own = level.and_then(|level| {
                    let maps = self.lateral.raised().get(*level)?;
                    maps.get(number % maps.len().max(1))
                });
                let out = own.unwrap_or(map) * SVector::<f64, INPUTS>::from_iterator(inputs);
                lane.iter_mut().zip(out.iter()).for_each(|(state, out)| *state = *out);
                let innovations = std::array::from_fn::<_, { linear::ROWS }, _>(|row| {
                    measured.filter(|_| row < ROWS).and_then(|_| out.get(STATES + row).copied())
                });
                for (of, (heard, unit)) in heard.iter_mut().zip(UNITS).enumerate() {
                    if let Some(place) = heard.get_mut(i) {
                        let (force_mps2, bias_mps2) = (unit * read[of], unit * lane[STATES - 2 + of]);
                        *place = Some(LaneHeard { innovations, force_mps2, bias_mps2 });
                    }
                }
            }
            let end = FlightTime::from_seconds((number + 1) as f64 * SLOT);
            for (judges, heard) in judges.iter_mut().zip(&heard) {
                judges.take(end, ALTITUDE_M, &[None; MAX_HEIGHTS], &[None; MAX_HEIGHTS], heard);
            }
            if under.is_some() {
                let ratio = |(judges, i): (&Judged, usize)| {
                    if judges.imu(i) { f64::INFINITY } else { judges.imu_ratio(i) }
                };
                let all = judges.iter().flat_map(|judges| self.attacked.iter().map(move |i| (judges, *i)));
                most = all.map(ratio).fold(most, f64::max);
            }
            if most.is_infinite() {
                break;
            }
        }
        most
    }

    /// What the aid reads in slot `number`, `under` slots after the onset.
    fn measured(&self, number: usize, under: Option<usize>, dice: &mut Xoshiro256PlusPlus) -> Option<[f64; 3]> {
        let own = under.and_then(|under| self.course.received.get(under)).copied().flatten().unwrap_or_default();
        let sigma = self.lateral.white.aid;
        self.lateral.measured(number).then(|| std::array::from_fn(|i| own[i] + sigma[i] * normal(dice)))
    }
}

/// The judges take an accelerometer's deviation: a gyroscope's counts as the one that is as many times what is usual.
const UNITS: [f64; 2] = [1.0, of_imus::USUAL_MPS2 / of_imus::USUAL_RADPS];

/// Place among [`RAISED`] of what a lane takes its accelerometer for under what is `added`, slot by slot.
fn raised(lateral: &Lateral, (part, begin): (f64, u32), added: &[[f64; 2]]) -> Vec<usize> {
    let force: Vec<f64> = added.iter().map(|[force, _]| *force).collect();
    if force.iter().all(|force| *force == 0.0) {
        return Vec::new();
    }
    let (taken, measured) = lateral.noise;
    let step = RAISED[1] - RAISED[0];
    let level = |noise: f64| ((noise / taken - 1.0) / step).round().clamp(0.0, (RAISED.len() - 1) as f64) as usize;
    let shaken = Shaken { noise_mps2: measured, rectified_mps2: 0.0 };
    noise_course(&Measured { shaken, noise_mps2: part * measured, begin }, &force).into_iter().map(level).collect()
}

fn normal(dice: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(dice)
}

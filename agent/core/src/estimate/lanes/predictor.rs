//! From the fusion horizon to now: the integrals of all IMUs, weighted as their lanes, biases removed, each no further than a reach from
//! their median: nobody has judged these samples yet.
//!
//! Every tick the state moves on by what the integrals grew since the tick before. When the horizon moves on, the way from
//! there to now is gone again with the weights and biases of then: an exclusion counts for the last moments too.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::integral::{Integral, Six};
use super::{LANES, PerLane, median_six};
use crate::sensor::measure::Kinematics;

/// Ticks kept: the horizon and a slot at 1000 Hz, and a little more.
const KEPT: usize = 160;

/// Integrals at one tick; `None` in a gap.
#[derive(Debug, Clone, Copy)]
struct Tick {
    time: FlightTime,
    totals: PerLane<Option<(Six, FlightTime)>>,
    /// Thrust as commanded, over the mass, m/s².
    thrust_mps2: f64,
}

/// No IMU is limited that is nearer to the median of all, m/s² and rad/s; nor one within so many times what they are shaken by.
pub(super) const REACH: (f64, f64) = (2.0, 0.3);
pub(super) const SHAKEN: f64 = 6.0;
/// A lane that weighs less has no say in the median.
const LITTLE: f64 = 0.02;

/// How much each lane counts, and what is taken from its IMU.
#[derive(Debug, Clone, Copy)]
pub struct Mixture {
    /// Sum to one.
    pub weights: PerLane<f64>,
    /// Biases.
    pub biases: PerLane<Six>,
    /// How far one counts from the median of all.
    pub reach: Six,
    /// Part of the thrust as commanded in the specific force along body z, 0..1.
    pub thrust: f64,
}

impl Mixture {
    /// Of nobody.
    pub fn new() -> Self {
        let mixture = Self { weights: [0.0; LANES], biases: [Six::zeros(); LANES], reach: Six::zeros(), thrust: 0.0 };
        mixture.shaken(&Six::zeros())
    }

    /// With a reach for IMUs that are shaken so: one-sigma of a sample about the one before, over √2.
    pub fn shaken(self, shaken: &Six) -> Self {
        let (a, g) = REACH;
        Self { reach: Six::new(a, a, a, g, g, g).sup(&(shaken * SHAKEN)), ..self }
    }

    /// Weighted mean of what IMUs tell, biases removed, integrated over `over_s`, or not where that is 1: of three and more none counts
    /// beyond its reach from their median. `None` where none tells.
    pub fn mean(&self, told: &PerLane<Option<Six>>, over_s: f64) -> Option<Six> {
        let heard = || {
            told.iter().zip(&self.weights).filter(|(_, weight)| **weight > LITTLE).filter_map(|(one, _)| one.as_ref())
        };
        let reach = self.reach * over_s;
        let apart = || {
            let spread = |i: usize| {
                let (low, high) = heard()
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), one| (low.min(one[i]), high.max(one[i])));
                high - low > reach[i]
            };
            (0..reach.len()).any(spread)
        };
        let centre = (heard().count() > 2 && apart()).then(|| median_six(heard()));
        let near = |one: &Six| {
            let Some(centre) = &centre else { return *one };
            let within = |i: usize, _| {
                let (value, middle, reach) = (one[i], centre[i], reach[i]);
                if (value - middle).abs() > reach { middle + reach.copysign(value - middle) } else { value }
            };
            Six::from_fn(within)
        };
        let (mut sum, mut weights) = (Six::zeros(), 0.0);
        for (one, weight) in told.iter().zip(self.weights) {
            if let Some(one) = one {
                sum += near(one) * weight;
                weights += weight;
            }
        }
        (weights > 1e-6).then(|| sum / weights)
    }
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Predictor {
    ticks: [Tick; KEPT],
    next: usize,
    filled: usize,
    mixture: Mixture,
    now: Kinematics,
    gravity_mps2: f64,
}

impl Predictor {
    /// At rest at the origin.
    pub fn new(gravity_mps2: f64) -> Self {
        let (zero, world_from_body) = (Vector3::zeros(), UnitQuaternion::identity());
        Self {
            ticks: [Tick { time: FlightTime(0), totals: [None; LANES], thrust_mps2: 0.0 }; KEPT],
            next: 0,
            filled: 0,
            mixture: Mixture::new(),
            now: Kinematics { position_enu_m: zero, velocity_enu_mps: zero, world_from_body },
            gravity_mps2,
        }
    }

    /// The state now.
    pub fn now(&self) -> &Kinematics {
        &self.now
    }

    /// Moves on to the tick at `now`, before which the thrust over the mass was `thrust_mps2`.
    pub fn follow(&mut self, now: FlightTime, integrals: &PerLane<Integral>, thrust_mps2: f64) {
        let totals = std::array::from_fn(|i| integrals.get(i).and_then(|integral| integral.total_now(now)));
        let tick = Tick { time: now, totals, thrust_mps2 };
        if self.filled > 0 {
            let before = self.ticks[(self.next + KEPT - 1) % KEPT];
            self.advance(&before, &tick);
        }
        self.ticks[self.next] = tick;
        self.next = (self.next + 1) % KEPT;
        self.filled = (self.filled + 1).min(KEPT);
    }

    /// The horizon has moved on to `time`, where the state is `at` and the integrals are `totals`.
    pub fn rebase(&mut self, time: FlightTime, at: &Kinematics, totals: &PerLane<Option<Six>>, mixture: &Mixture) {
        self.mixture = *mixture;
        self.now = *at;
        // The stretch is that of the first tick: a gap in between is found there.
        let totals = totals.map(|total| total.map(|total| (total, FlightTime(0))));
        let mut before = Tick { time, totals, thrust_mps2: 0.0 };
        for back in (1..=self.filled).rev() {
            let tick = self.ticks[(self.next + KEPT - back) % KEPT];
            if tick.time > time {
                self.advance(&before, &tick);
                before = tick;
            }
        }
    }

    /// By what the integrals grew between two ticks.
    fn advance(&mut self, from: &Tick, to: &Tick) {
        let dt = to.time.seconds_since(from.time);
        if !(dt > 0.0 && dt < 1.0) {
            return;
        }
        let Mixture { biases, thrust, .. } = self.mixture;
        let grown = |i: usize| {
            let ((before, _), (after, stretch)) = from.totals[i].zip(to.totals[i])?;
            // Before its stretch began there was a gap: what lies across it is no growth.
            (stretch <= from.time).then(|| after - before - biases[i] * dt)
        };
        let grown = self.mixture.mean(&std::array::from_fn(grown), dt);
        let k = &mut self.now;
        let (force, turned) = if let Some(mut grown) = grown {
            grown[2] += thrust * (to.thrust_mps2 * dt - grown[2]);
            (grown.fixed_rows::<3>(0).into_owned(), grown.fixed_rows::<3>(3).into_owned())
        } else {
            // No IMU: it goes on as it goes.
            (k.world_from_body.inverse() * Vector3::z() * (self.gravity_mps2 * dt), Vector3::zeros())
        };
        let middle = k.world_from_body * UnitQuaternion::from_scaled_axis(turned * 0.5);
        let gained = middle * force - Vector3::z() * (self.gravity_mps2 * dt);
        k.position_enu_m += (k.velocity_enu_mps + gained * 0.5) * dt;
        k.velocity_enu_mps += gained;
        k.world_from_body *= UnitQuaternion::from_scaled_axis(turned);
        k.world_from_body.renormalize_fast();
    }

    /// Forgets the ticks.
    pub fn clear(&mut self) {
        self.filled = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_jumps_counts_as_far_as_its_reach_and_the_others_as_they_are() {
        let told = |x: [f64; 4]| -> PerLane<Option<Six>> {
            std::array::from_fn(|i| x.get(i).map(|x| Six::new(*x, 0.0, 9.8, 0.0, *x, 0.0)))
        };
        let equal = Mixture { weights: std::array::from_fn(|i| if i < 4 { 0.25 } else { 0.0 }), ..Mixture::new() };
        let mean = |mixture: &Mixture, x: [f64; 4]| mixture.mean(&told(x), 1.0).map(|mean| (mean[0], mean[4]));
        // Within reach nothing changes.
        let near = [0.01, 0.02, -0.05, 0.06];
        let (accel, gyro) = mean(&equal, near).unwrap();
        assert!((accel - 0.01).abs() < 1e-12 && (gyro - 0.01).abs() < 1e-12, "{accel} {gyro}");
        let (accel, gyro) = mean(&equal, [0.0, 20.0, 0.0, 0.0]).unwrap();
        assert!((accel - 0.25 * REACH.0).abs() < 1e-12 && (gyro - 0.25 * REACH.1).abs() < 1e-12, "{accel} {gyro}");
        // Over a tick of 5 ms as much of it, and further where all are shaken.
        let tick = equal.mean(&told([0.0, 20.0, 0.0, 0.0]), 0.005).unwrap();
        assert!((tick[0] - 0.005 * 0.25 * REACH.0).abs() < 1e-12, "{tick}");
        let shaken = equal.shaken(&Six::repeat(1.0));
        assert_eq!(mean(&shaken, [0.0, 20.0, 0.0, 0.0]).map(|(accel, _)| accel), Some(0.25 * SHAKEN));
        // Two say nothing of each other; one that weighs nothing says nothing of the rest.
        let two = Mixture { weights: std::array::from_fn(|i| if i < 2 { 0.5 } else { 0.0 }), ..Mixture::new() };
        assert_eq!(mean(&two, [0.0, 20.0, 0.0, 0.0]), Some((10.0, 10.0)));
    }
}

//! From the fusion horizon to now: the integrals of all IMUs, weighted as their lanes, biases removed.
//!
//! Every tick the state moves on by what the integrals grew since the tick before. When the horizon moves on, the way from
//! there to now is gone again with the weights and biases of then: an exclusion counts for the last moments too.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::integral::{Integral, Six};
use super::{LANES, PerLane};
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

/// How much each lane counts, and what is taken from its IMU.
#[derive(Debug, Clone, Copy)]
pub struct Mixture {
    /// Sum to one.
    pub weights: PerLane<f64>,
    /// Biases.
    pub biases: PerLane<Six>,
    /// Part of the thrust as commanded in the specific force along body z, 0..1.
    pub thrust: f64,
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
            mixture: Mixture { weights: [0.0; LANES], biases: [Six::zeros(); LANES], thrust: 0.0 },
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
        let (mut grown, mut weights) = (Six::zeros(), 0.0);
        let Mixture { weights: all, biases, thrust } = self.mixture;
        for (((before, after), weight), bias) in from.totals.iter().zip(&to.totals).zip(all).zip(&biases) {
            let Some(((before, _), (after, stretch))) = before.zip(*after) else { continue };
            // Before its stretch began there was a gap: what lies across it is no growth.
            if stretch <= from.time {
                grown += (after - before - bias * dt) * weight;
                weights += weight;
            }
        }
        let k = &mut self.now;
        let (force, turned) = if weights > 1e-6 {
            let mut grown = grown / weights;
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

//! Pseudo-measurements that bound what nothing measures.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use super::EkfBias;
use super::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use super::covariance::ix;
use crate::estimate::filter::row::ScalarRow;

/// Period of the pseudo-measurements, s.
const IDLE_PERIOD_S: f64 = 0.1;

/// When they were taken last, and about which place.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Idle {
    last: Option<FlightTime>,
    /// Where the position was last known, ENU, m.
    pub anchor: Vector3<f64>,
}

impl EkfBias {
    /// Without any horizontal aiding ([Paternain]: indoors there is none) tilt and velocity are bounded by
    /// what is known of a vehicle in a lab or on strings: on average it goes nowhere, and not far.
    ///
    /// This is also the levelling aid: the mean of the specific force over many seconds is gravity. It is
    /// better than correcting tilt by each accelerometer sample, which on a multirotor always points along
    /// body z whatever the tilt; velocity variance limits how fast an acceleration can be taken for tilt.
    /// Where the vertical is not aided either (attitude recordings), the same holds for it.
    pub(super) fn aid_idle(&mut self, now: FlightTime) {
        if self.idle.last.is_some_and(|t| now.seconds_since(t) < IDLE_PERIOD_S - 1e-4) {
            return;
        }
        let since = self.idle.last.map_or(IDLE_PERIOD_S, |t| now.seconds_since(t).min(1.0));
        self.idle.last = Some(now);
        // Correlated over τ, sampled every T: as informative as white noise of variance σ² 2τ/T.
        let white = |sigma: f64, tau: f64| sigma * sigma * (2.0 * tau / since).max(1.0);
        let resting = self.rest.lasts_s() > 1.0;
        let o = &self.options;
        let velocity_r =
            if resting { 0.05f64.powi(2) } else { white(o.idle_velocity_sigma_mps, o.idle_velocity_correlation_s) };
        let position_r = white(o.idle_position_sigma_m, 10.0);
        let horizontal = self.horizontal.within(now, HORIZONTAL_MEMORY_S);
        let vertical = self.vertical.within(now, VERTICAL_MEMORY_S);
        for axis in 0..3 {
            let aided = if axis == 2 { vertical } else { horizontal };
            if resting || !aided {
                self.pseudo(ix::VELOCITY + axis, -self.state.kinematics.velocity_enu_mps[axis], velocity_r);
            }
            if aided {
                self.idle.anchor[axis] = self.state.kinematics.position_enu_m[axis];
            } else {
                let innovation = self.idle.anchor[axis] - self.state.kinematics.position_enu_m[axis];
                self.pseudo(ix::POSITION + axis, innovation, position_r);
            }
        }
    }

    fn pseudo(&mut self, i: usize, innovation: f64, variance: f64) {
        self.correct(&ScalarRow::pseudo(i, innovation, variance));
    }
}

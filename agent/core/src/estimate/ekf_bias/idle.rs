//! Pseudo-measurements that bound what nothing measures.

use plumbline_proto::time::FlightTime;

use super::EkfBias;
use super::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use super::covariance::ix;
use crate::estimate::aiding::idle::{
    POSITION_CORRELATION_S, POSITION_SIGMA_M, STANDING_SIGMA_M, VELOCITY_CORRELATION_S, VELOCITY_SIGMA_MPS, whitening,
};
use crate::estimate::filter::row::ScalarRow;

impl EkfBias {
    /// Without any horizontal aiding ([Paternain]: indoors there is none) tilt and velocity are bounded by
    /// what is known of a vehicle in a lab or on strings: on average it goes nowhere, and not far.
    ///
    /// This is also the levelling aid: the mean of the specific force over many seconds is gravity. It is
    /// better than correcting tilt by each accelerometer sample, which on a multirotor always points along
    /// body z whatever the tilt; velocity variance limits how fast an acceleration can be taken for tilt.
    /// Where the vertical is not aided either (attitude recordings), the same holds for it.
    pub(super) fn aid_idle(&mut self, now: FlightTime) {
        let Some(since_s) = self.aided.idle.due(now) else { return };
        let resting = self.rests();
        // A floor does not move: at rest it is the barometer's offset that does.
        let standing = resting && self.aided.barometers.present && !self.aided.heights.present;
        let velocity_r = if resting {
            0.05f64.powi(2)
        } else {
            VELOCITY_SIGMA_MPS * VELOCITY_SIGMA_MPS * whitening(VELOCITY_CORRELATION_S, since_s)
        };
        let position_r = POSITION_SIGMA_M * POSITION_SIGMA_M * whitening(POSITION_CORRELATION_S, since_s);
        let horizontal = self.aided.horizontal.within(now, HORIZONTAL_MEMORY_S);
        let vertical = self.aided.vertical.within(now, VERTICAL_MEMORY_S);
        for axis in 0..3 {
            let aided = if axis == 2 { vertical } else { horizontal };
            if resting || !aided {
                self.pseudo(ix::VELOCITY + axis, -self.state.kinematics.velocity_enu_mps[axis], velocity_r);
            }
            let innovation = self.aided.idle.anchor[axis] - self.state.kinematics.position_enu_m[axis];
            if axis == 2 && standing {
                self.pseudo(ix::POSITION + axis, innovation, STANDING_SIGMA_M * STANDING_SIGMA_M);
            } else if aided {
                self.aided.idle.anchor[axis] = self.state.kinematics.position_enu_m[axis];
            } else {
                self.pseudo(ix::POSITION + axis, innovation, position_r);
            }
        }
    }

    fn pseudo(&mut self, i: usize, innovation: f64, variance: f64) {
        self.correct(&ScalarRow::pseudo(i, innovation, variance));
    }
}

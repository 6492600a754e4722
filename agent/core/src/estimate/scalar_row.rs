//! Measurements of the twelve-state filters: what is measured, and h(x) and its row of H for each
//! ([Umasankar] Eq. 13 with errata 5: seven rows, roll included).

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;

use super::Channel;
use crate::frames::wrap_pi;
use crate::model::euler_body::{X, ix};
use crate::model::measure::camera_range;

/// Most rows of one update: four ranges, three angles, three positions, four heights, three rates.
pub const MAX_ROWS: usize = 17;

/// What a row measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// Distance to a camera at this place (ENU, m).
    Range(Vector3<f64>),
    /// One state.
    State(usize),
    /// One state that is an angle: the innovation is wrapped.
    Angle(usize),
}

/// One scalar measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarRow {
    /// Whose.
    pub sensor: SensorId,
    /// Which of its scalars.
    pub channel: Channel,
    /// Of what.
    pub what: What,
    /// The value, m or rad.
    pub value: f64,
    /// One-sigma of its noise.
    pub sigma: f64,
    /// Gate in sigmas; infinite for none.
    pub gate: f64,
}

impl ScalarRow {
    /// ŷ = h(x).
    pub fn predict(&self, x: &X) -> f64 {
        match self.what {
            What::Range(camera) => camera_range::predict(&Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]), &camera).0,
            What::State(i) | What::Angle(i) => x[i],
        }
    }

    /// H = ∂h/∂x.
    pub fn jacobian(&self, x: &X) -> X {
        let mut row = X::zeros();
        match self.what {
            What::Range(camera) => {
                let gradient = camera_range::predict(&Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]), &camera).1;
                row.fixed_rows_mut::<3>(ix::X).copy_from(&gradient);
            }
            What::State(i) | What::Angle(i) => row[i] = 1.0,
        }
        row
    }

    /// A difference of two values of this measurement; of angles, the short way round.
    pub fn difference(&self, a: f64, b: f64) -> f64 {
        match self.what {
            What::Angle(_) => wrap_pi(a - b),
            _ => a - b,
        }
    }
}

//! Measurements of the twelve-state filters, h(x) and its row of H for each (\[Umasankar\] Eq. 13 with errata 5: seven
//! rows, roll included); and what these filters have in common.

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;

use super::row::ScalarRow;
use crate::estimate::{Channel, EstimatorKind, Residuals};
use crate::frames::wrap_pi;
use crate::model::euler_body::{EulerBody, Input, M, N, X, ix};
use crate::sensor::Accuracy;
use crate::sensor::camera_ranges;

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
pub struct Measurement {
    /// Whose, and which of its scalars; a pseudo-measurement is no sensor's and leaves no residual.
    pub of: Option<(SensorId, Channel)>,
    /// Of what.
    pub what: What,
    /// The value, m or rad.
    pub value: f64,
    /// Its noise and gate.
    pub noise: Accuracy,
}

impl Measurement {
    /// ŷ = h(x).
    pub fn predict(&self, x: &X) -> f64 {
        match self.what {
            What::Range(camera) => camera_ranges::predict(&Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]), &camera).0,
            What::State(i) | What::Angle(i) => x[i],
        }
    }

    /// H = ∂h/∂x.
    pub fn jacobian(&self, x: &X) -> X {
        let mut row = X::zeros();
        match self.what {
            What::Range(camera) => {
                let gradient = camera_ranges::predict(&Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]), &camera).1;
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

    /// Linearised at `predicted`: y − ŷ − H δx, what the rows before have explained since (up to `x`) taken off.
    pub fn row(&self, predicted: &X, x: &X) -> ScalarRow<N> {
        let h = self.jacobian(predicted);
        let innovation = self.difference(self.value, self.predict(predicted)) - h.dot(&(x - predicted));
        let bare = ScalarRow::new(innovation, h, self.noise.sigma * self.noise.sigma);
        ScalarRow { of: self.of, gate: self.noise.gate, ..bare }
    }
}

/// A filter over the twelve states of [`EulerBody`].
pub trait TwelveState: Send + 'static {
    /// Its name.
    const KIND: EstimatorKind;
    /// Starts at `x` with covariance `p`.
    fn new(body: EulerBody, x: X, p: M) -> Self;
    /// Starts again at `x` with covariance `p`.
    fn restart(&mut self, x: X, p: M);
    /// Propagates by `h` seconds under the held input `u`; `q` is the process noise of such a step.
    fn predict(&mut self, u: &impl Input, h: f64, q: &M);
    /// Corrects with the measurements of one instant; each that has a sensor leaves a residual.
    fn correct(&mut self, rows: &[Measurement], residuals: &mut Residuals);
    /// State and covariance now.
    fn moments(&self) -> (X, M);
}

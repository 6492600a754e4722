//! The start: tilt and field by their means over the first moments, and the way back from upside down.

use nalgebra::{UnitQuaternion, Vector3};

use super::State;
use crate::estimate::attitude::levelling;

/// The start lasts this long, s.
const START_S: f64 = 0.3;
/// Time constant of the mean specific force afterwards, s.
const MEAN_S: f64 = 1.0;
/// The filter starts again where the mean specific force points up by less than this part of it.
const UPRIGHT: f64 = 0.5;

/// The means, in L.
#[derive(Debug, Clone, Default)]
pub(super) struct Start {
    age_s: f64,
    samples: f64,
    force: Vector3<f64>,
    fields: f64,
    field: Vector3<f64>,
}

impl Start {
    /// Takes the specific force in L; true when the filter is upside down and starts again.
    pub fn push(&mut self, dt_s: f64, force: &Vector3<f64>) -> bool {
        self.samples += 1.0;
        self.force += (1.0 / self.samples).max(dt_s / MEAN_S).min(1.0) * (force - self.force);
        let again = !self.lasts() && self.force.z < UPRIGHT * self.force.norm();
        if again {
            *self = Self { samples: 1.0, force: *force, ..Self::default() };
        }
        self.age_s += dt_s;
        again
    }

    /// Is it still the start?
    pub fn lasts(&self) -> bool {
        self.age_s < START_S
    }

    /// Levels the state by the mean so far; `field` is a magnetometer sample, body frame, µT.
    pub fn settle(&mut self, state: &mut State, field: Option<&Vector3<f64>>) {
        if let Some(field) = field {
            self.fields += 1.0;
            self.field += (state.level_from_body * field - self.field) / self.fields;
        }
        state.velocity_mps.fill(0.0);
        if let Some(up) = self.force.try_normalize(1e-9) {
            let turn = levelling(&up);
            state.level_from_body = turn * state.level_from_body;
            self.turn(&turn);
            self.field = turn * self.field;
        }
        state.field_ut = self.field;
    }

    /// L was turned: so is the mean.
    pub fn turn(&mut self, turn: &UnitQuaternion<f64>) {
        self.force = turn * self.force;
    }
}

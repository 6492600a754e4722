//! Pose of the body by motion capture.
//!
//! Attitude given whole (motion capture): three angles about the heading frame's axes.
//!
//! δφ = log(R_measured R̂ᵀ) is the rotation, about world axes, from the estimate to the measurement. Its
//! components along the vehicle's heading, to its left and up are, for small errors, the errors of roll,
//! pitch and yaw.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::measure::{Kinematics, Row};
use super::sample::{Accuracy, Quantity, Sample, Scalars, put, xyz};
use super::suite::{self, Quality, Sheet, Timing};
use super::wire::{self, Received};
use crate::frames::roll_pitch_yaw;

/// One motion-capture pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MocapPoseSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
}

impl Sample for MocapPoseSample {
    const TOPIC: Kind = Kind::MocapPose;
    const KIND: v1::SensorKind = v1::SensorKind::MocapPose;
    const QUANTITIES: &'static [Quantity] = &[
        Quantity { name: "position", unit: "m", scalars: 3, named: false },
        Quantity { name: "attitude", unit: "", scalars: 4, named: false },
    ];
    type Sheet = MocapPose;
    type Model = MocapPoseModel;

    fn model(sheets: &[MocapPose]) -> MocapPoseModel {
        let of = |q: &Quality| Accuracy { sigma: q.total_sigma().max(1e-4), gate: q.gate_sigmas };
        sheets.first().map_or(
            MocapPoseModel {
                position: Accuracy { sigma: 0.005, gate: 5.0 },
                attitude: Accuracy { sigma: 0.01, gate: 5.0 },
            },
            |s| MocapPoseModel { position: of(&s.position), attitude: of(&s.attitude) },
        )
    }

    /// Position and the attitude as a quaternion (w, x, y, z).
    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        put(&mut values, 0, &self.position_enu_m);
        let q = self.world_from_body;
        values[3..7].copy_from_slice(&[q.w, q.i, q.j, q.k]);
        values
    }

    /// A quaternion that an attack made zero becomes the identity; scaled ones keep their attitude.
    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.position_enu_m = xyz(values, 0);
        let q = nalgebra::Quaternion::new(values[3], values[4], values[5], values[6]);
        self.world_from_body = UnitQuaternion::try_new(q, 1e-6).unwrap_or_default();
        self
    }

    wire::message! {
        MocapPoseSample of MocapPoseReading,
        |s| v1::MocapPoseReading {
            position_enu_m: wire::vector(&s.position_enu_m),
            world_from_body: wire::quaternion(&s.world_from_body),
        },
        |time, r| {
            Some(Self {
                time,
                position_enu_m: wire::xyz(r.position_enu_m.as_ref()?),
                world_from_body: wire::unit_quaternion(r.world_from_body.as_ref()?)?,
            })
        }
    }
}

/// What estimators assume of motion-capture poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MocapPoseModel {
    /// Position per axis, m.
    pub position: Accuracy,
    /// Attitude about each axis, rad.
    pub attitude: Accuracy,
}

/// Rows of roll, pitch and yaw.
pub fn attitude(state: &Kinematics, measured: &UnitQuaternion<f64>) -> [Row; 3] {
    let error = (measured * state.world_from_body.inverse()).scaled_axis();
    let (sin_yaw, cos_yaw) = roll_pitch_yaw(&state.world_from_body).z.sin_cos();
    let axes = [Vector3::new(cos_yaw, sin_yaw, 0.0), Vector3::new(-sin_yaw, cos_yaw, 0.0), Vector3::z()];
    axes.map(|axis| Row::new(axis.dot(&error)).attitude(axis))
}

/// Motion-capture pose.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MocapPose {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Position per axis, m.
    pub position: Quality,
    /// Attitude about each axis, rad.
    pub attitude: Quality,
}

impl Sheet for MocapPose {
    /// Motion-capture pose: 100 Hz, 1 mm, 2 mrad, 10 ms late (chosen).
    fn typical(_instance: usize) -> Self {
        Self {
            name: "mocap pose 1".into(),
            timing: Timing { delay_s: 0.010, ..Timing::at(100.0) },
            position: Quality::white(0.001),
            attitude: Quality::white(0.002),
        }
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("position", &mut self.position);
        each("attitude", &mut self.attitude);
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences_at_the_estimate() {
        // The row is linearised at zero error, where an update that is accepted lands.
        let measured = check::state().world_from_body;
        for i in 0..3 {
            check::jacobian(&check::state(), |s| attitude(s, &measured)[i], 1e-6);
        }
    }

    #[test]
    fn a_pure_yaw_error_is_seen_by_yaw_alone() {
        let state = check::state();
        let measured = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.05) * state.world_from_body;
        let rows = attitude(&state, &measured);
        assert!(rows[0].innovation.abs() < 1e-12 && rows[1].innovation.abs() < 1e-12);
        assert!((rows[2].innovation - 0.05).abs() < 1e-12);
    }
}

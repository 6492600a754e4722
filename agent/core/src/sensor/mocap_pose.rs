//! Pose of the body by motion capture.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::sample::{Accuracy, Quantity, Sample, Scalars, put, xyz};
use super::suite::{Quality, Sheet, Timing};
use super::wire::{self, Received};

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
    type Wire = v1::MocapPoseSample;
    type Sheet = MocapPose;
    type Model = MocapPoseModel;

    fn model(sheets: &[MocapPose]) -> MocapPoseModel {
        let (position, attitude, gate) = sheets.first().map_or((0.005, 0.01, 5.0), |s| {
            (s.position.total_sigma().max(1e-4), s.attitude.total_sigma().max(1e-4), s.position.gate_sigmas)
        });
        MocapPoseModel { position: Accuracy { sigma: position, gate }, attitude: Accuracy { sigma: attitude, gate } }
    }

    fn time(&self) -> FlightTime {
        self.time
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

    fn to_wire(&self, received: Option<&Self>, into: &mut v1::MocapPoseSample) {
        let reading = |s: &Self| v1::MocapPoseReading {
            position_enu_m: wire::vector(&s.position_enu_m),
            world_from_body: wire::quaternion(&s.world_from_body),
        };
        let (reception, received) = wire::reception(self, received, reading);
        *into = v1::MocapPoseSample { time_us: self.time.0, reception, sensed: Some(reading(self)), received };
    }

    fn from_wire(m: v1::MocapPoseSample) -> Option<(Self, Received<Self>)> {
        let time = FlightTime(m.time_us);
        wire::sample(m.reception(), m.sensed, m.received, |r: v1::MocapPoseReading| {
            Some(Self {
                time,
                position_enu_m: wire::xyz(r.position_enu_m.as_ref()?),
                world_from_body: wire::unit_quaternion(r.world_from_body.as_ref()?)?,
            })
        })
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

    fn name(&self) -> &str {
        &self.name
    }

    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn timing_mut(&mut self) -> &mut Timing {
        &mut self.timing
    }

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("position", &mut self.position);
        each("attitude", &mut self.attitude);
    }
}

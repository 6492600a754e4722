//! Simulated motion capture: the pose.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::sensor::MocapPoseSample;
use plumbline_core::sensor::mocap_pose;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, read3, triple};

#[derive(Debug, Clone)]
pub(super) struct MocapPose {
    position: [ScalarError; 3],
    attitude: [ScalarError; 3],
}

impl Device for MocapPose {
    type Sample = MocapPoseSample;

    fn new(s: &mocap_pose::MocapPose, stream: &mut Stream) -> Self {
        let position = triple(s.position, &s.timing, stream);
        let attitude = triple(s.attitude, &s.timing, stream);
        Self { position, attitude }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<MocapPoseSample> {
        let x = now.world.body();
        let error = read3(&mut self.attitude, &Vector3::zeros(), stream);
        Some(MocapPoseSample {
            time: now.time,
            position_enu_m: read3(&mut self.position, &x.position_enu_m, stream),
            world_from_body: UnitQuaternion::from_scaled_axis(error) * x.attitude(),
        })
    }
}

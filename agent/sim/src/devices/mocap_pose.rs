//! Simulated motion capture: the pose.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::sensor::MocapPoseSample;
use plumbline_core::sensor::mocap_pose;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, Surroundings, Transport, read3, triple};
use crate::conditions::Conditions;
use plumbline_core::sensor::suite::Quality;

#[derive(Debug, Clone)]
pub(super) struct MocapPose {
    position: [ScalarError; 3],
    attitude: [ScalarError; 3],
    /// Of distances; one but for the calibration of the cameras.
    scale: f64,
    period_s: f64,
}

impl Device for MocapPose {
    type Sample = MocapPoseSample;

    fn new(s: &mocap_pose::MocapPose, stream: &mut Stream) -> Self {
        let position = triple(s.position, &s.timing, stream);
        let attitude = triple(s.attitude, &s.timing, stream);
        Self { position, attitude, scale: 1.0, period_s: s.timing.period_s() }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.mocap;
        let with = |of: &ScalarError, sigma: f64| Quality { sigma, bias_sigma: 0.0, bias_walk: 0.0, ..*of.quality() };
        let (position, attitude) =
            (with(&self.position[0], c.position_sigma_m), with(&self.attitude[0], c.attitude_sigma_rad));
        self.position = std::array::from_fn(|_| ScalarError::new(position, self.period_s, stream));
        self.attitude = std::array::from_fn(|_| ScalarError::new(attitude, self.period_s, stream));
        self.scale += c.calibration_scale_sigma * stream.normal();
        self
    }

    fn transport(conditions: &Conditions) -> Option<Transport> {
        let c = &conditions.mocap;
        Some(Transport {
            delay_s: c.delay_s,
            jitter_s: c.delay_jitter_s,
            gap_rate_per_s: c.dropout_rate_per_s,
            // Uniform lengths up to twice the mean.
            gap_max_s: 2.0 * c.dropout_mean_s,
            ..Transport::default()
        })
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<MocapPoseSample> {
        let x = now.world.body();
        let error = read3(&mut self.attitude, &Vector3::zeros(), stream);
        Some(MocapPoseSample {
            time: now.time,
            position_enu_m: read3(&mut self.position, &(x.position_enu_m * self.scale), stream),
            world_from_body: UnitQuaternion::from_scaled_axis(error) * x.attitude(),
        })
    }
}

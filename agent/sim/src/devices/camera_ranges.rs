//! Simulated motion capture: ranges to the cameras ([Umasankar] Eq. 13).

use nalgebra::Vector3;
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::CameraRangesSample;
use plumbline_core::sensor::camera_ranges;
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::types::CAMERAS;

use super::{Device, Now};

/// Reflective markers, FLU from the centroid, m ([Umasankar] Table 1).
const MARKERS_FLU_M: [[f64; 3]; 4] = [[0.105, 0.0, 0.0], [0.0, 0.060, 0.0], [-0.115, 0.0, 0.0], [0.0, -0.060, 0.0]];
#[derive(Debug, Clone)]
pub(super) struct CameraRanges {
    spec: camera_ranges::CameraRanges,
    error: [ScalarError; CAMERAS],
}

impl Device for CameraRanges {
    type Sample = CameraRangesSample;

    fn new(s: &camera_ranges::CameraRanges, stream: &mut Stream) -> Self {
        let period_s = s.timing.period_s();
        Self { error: std::array::from_fn(|_| ScalarError::new(s.range, period_s, stream)), spec: s.clone() }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<CameraRangesSample> {
        let (spec, x) = (&self.spec, now.world.body());
        let mut range_m = [0.0; CAMERAS];
        for ((range, camera), error) in range_m.iter_mut().zip(&spec.cameras_enu_m).zip(&mut self.error) {
            let to_camera = x.position_enu_m - camera;
            let truth = if spec.marker_mean {
                let marker = |m: &[f64; 3]| (to_camera + rotate(&x.world_from_body, &Vector3::from(*m))).norm();
                MARKERS_FLU_M.iter().map(marker).sum::<f64>() / 4.0
            } else {
                to_camera.norm()
            };
            *range = error.read(truth, stream);
        }
        Some(CameraRangesSample { time: now.time, range_m })
    }
}

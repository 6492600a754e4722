//! A simulated laser height.

use plumbline_core::frames::tilt_rad;
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::HeightSample;
use plumbline_core::sensor::height;
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::suite::Quality;

use super::{Device, Now};

#[derive(Debug, Clone)]
pub(super) struct Height {
    spec: height::Height,
    error: ScalarError,
}

impl Device for Height {
    type Sample = HeightSample;

    fn new(s: &height::Height, stream: &mut Stream) -> Self {
        // Its range is checked before the reading, not cut.
        let quality = Quality { range: f64::MAX, ..s.height };
        Self { error: ScalarError::new(quality, s.timing.period_s(), stream), spec: s.clone() }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<HeightSample> {
        let (spec, x) = (&self.spec, now.world.body());
        // The scan finds the vertical, so the unit's own height is measured; the driver adds its
        // mounting as if level. The lever's share of a tilt (millimetres) stays in.
        let own_m = x.position_enu_m.z + rotate(&x.world_from_body, &spec.position_flu_m).z;
        let reading_m = self.error.read(own_m, stream);
        let seen =
            (spec.nearest_m..=spec.height.range).contains(&reading_m) && tilt_rad(&x.attitude()) <= spec.tilt_max_rad;
        seen.then(|| HeightSample { time: now.time, height_m: reading_m - spec.position_flu_m.z })
    }
}

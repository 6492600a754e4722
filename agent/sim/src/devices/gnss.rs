//! A simulated GNSS receiver.

use plumbline_core::sensor::GnssSample;
use plumbline_core::sensor::gnss;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, read3, triple};

#[derive(Debug, Clone)]
pub(super) struct Gnss {
    spec: gnss::Gnss,
    position: [ScalarError; 3],
    velocity: [ScalarError; 3],
}

impl Device for Gnss {
    type Sample = GnssSample;

    fn new(s: &gnss::Gnss, stream: &mut Stream) -> Self {
        let [x, y, _] = triple(s.horizontal, &s.timing, stream);
        let z = ScalarError::new(s.vertical, s.timing.period_s(), stream);
        let velocity = triple(s.velocity, &s.timing, stream);
        Self { position: [x, y, z], velocity, spec: s.clone() }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<GnssSample> {
        let (spec, x) = (&self.spec, now.world.body());
        let position_enu_m = read3(&mut self.position, &x.position_enu_m, stream);
        Some(GnssSample {
            time: now.time,
            position_enu_m,
            velocity_enu_mps: read3(&mut self.velocity, &x.velocity_enu_mps, stream),
            geodetic: now.site.geodetic(&position_enu_m),
            horizontal_sigma_m: spec.horizontal.sigma.hypot(spec.horizontal.bias_sigma),
            vertical_sigma_m: spec.vertical.sigma.hypot(spec.vertical.bias_sigma),
            satellites: 11,
        })
    }
}

//! A simulated barometer: it drifts as it warms up.

use plumbline_core::sensor::BarometerSample;
use plumbline_core::sensor::barometer;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now};

#[derive(Debug, Clone)]
pub(super) struct Barometer {
    drift_pa_per_c: f64,
    error: ScalarError,
}

impl Device for Barometer {
    type Sample = BarometerSample;

    fn new(s: &barometer::Barometer, stream: &mut Stream) -> Self {
        let error = ScalarError::new(s.pressure, s.timing.period_s(), stream);
        Self { error, drift_pa_per_c: s.drift_pa_per_c }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<BarometerSample> {
        let truth_pa = now.site.pressure_pa(now.world.body().position_enu_m.z) + self.drift_pa_per_c * now.warm_c;
        let pressure_pa = self.error.read(truth_pa, stream);
        Some(BarometerSample { time: now.time, pressure_pa, temperature_c: now.temperature_c() })
    }
}

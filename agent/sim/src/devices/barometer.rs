//! A simulated barometer: it drifts as it warms up.

use plumbline_core::sensor::BarometerSample;
use plumbline_core::sensor::barometer;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, Surroundings};
use crate::conditions;
use crate::vibration::Slow;
use plumbline_core::model::airframe::AIR_DENSITY_KGPM3;
use plumbline_core::sensor::suite::Quality;
use plumbline_core::types::ROTORS;

#[derive(Debug, Clone)]
pub(super) struct Barometer {
    drift_pa_per_c: f64,
    error: ScalarError,
    period_s: f64,
    real: Option<Real>,
}

/// What a world makes of a barometer: it drifts, and sits in the rotors' wash.
#[derive(Debug, Clone)]
struct Real {
    conditions: conditions::Barometer,
    stream: Stream,
    slow: Slow,
    turbulence: Slow,
    /// Near the ground the wash raises or lowers the pressure, by where it sits.
    wash_sign: f64,
}

/// Band of the wash's turbulence, s: its upper end is 10 Hz.
const TURBULENCE_S: f64 = 0.016;

impl Real {
    fn error_pa(&mut self, now: &Now<'_>, period_s: f64) -> f64 {
        let (c, world) = (&self.conditions, now.world);
        let (airframe, x) = (world.airframe(), world.body());
        let radius_m = 0.5 * airframe.propeller_diameter_m;
        let discs_m2 = ROTORS as f64 * std::f64::consts::PI * radius_m * radius_m;
        let thrust_n = airframe.wrench(world.rotor_speed_radps()).thrust_n;
        let (loading_pa, hover_pa) = (thrust_n / discs_m2, airframe.weight_n() / discs_m2);
        let height_m = x.position_enu_m.z.max(0.0);
        let near = (-height_m / (c.ground_wash_decay_rotor_radii * radius_m)).exp();
        let flying = (loading_pa / hover_pa).min(1.0);
        let dynamic_pa = 0.5 * AIR_DENSITY_KGPM3 * x.velocity_enu_mps.norm_squared();
        c.slow_sigma_pa * self.slow.step(period_s, c.slow_time_constant_s, &mut self.stream)
            + self.wash_sign * c.ground_wash_fraction_of_disk_loading * loading_pa * near
            + c.thrust_fraction_of_disk_loading * (loading_pa - hover_pa) * flying
            + c.airspeed_pressure_coefficient * dynamic_pa
            + c.wash_turbulence_pa * flying * self.turbulence.step(period_s, TURBULENCE_S, &mut self.stream)
    }
}

impl Device for Barometer {
    type Sample = BarometerSample;

    fn new(s: &barometer::Barometer, stream: &mut Stream) -> Self {
        let error = ScalarError::new(s.pressure, s.timing.period_s(), stream);
        Self { error, drift_pa_per_c: s.drift_pa_per_c, period_s: s.timing.period_s(), real: None }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.barometer;
        let quality =
            Quality { sigma: c.noise_pa, resolution: c.resolution_pa, bias_walk: 0.0, ..*self.error.quality() };
        self.error = ScalarError::new(quality, self.period_s, stream);
        self.drift_pa_per_c = c.warm_up_pa_per_k;
        let reads_high = stream.uniform() < c.ground_wash_sign_probability_reads_high;
        self.real = Some(Real {
            slow: Slow::begun(stream),
            turbulence: Slow::default(),
            // A higher pressure reads as a lower height.
            wash_sign: if reads_high { -1.0 } else { 1.0 },
            stream: stream.clone(),
            conditions: c.clone(),
        });
        self
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<BarometerSample> {
        let truth_pa = now.site.pressure_pa(now.world.body().position_enu_m.z) + self.drift_pa_per_c * now.warm_c;
        let truth_pa = truth_pa + self.real.as_mut().map_or(0.0, |real| real.error_pa(now, self.period_s));
        let pressure_pa = self.error.read(truth_pa, stream);
        Some(BarometerSample { time: now.time, pressure_pa, temperature_c: now.temperature_c() })
    }
}

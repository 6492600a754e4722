//! A simulated GNSS receiver.

use plumbline_core::sensor::GnssSample;
use plumbline_core::sensor::gnss;
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, Surroundings, Transport, read3, triple};
use crate::conditions::{self, Conditions};
use crate::vibration::Slow;
use nalgebra::Vector3;
use plumbline_core::sensor::suite::Quality;

#[derive(Debug, Clone)]
pub(super) struct Gnss {
    spec: gnss::Gnss,
    position: [ScalarError; 3],
    velocity: [ScalarError; 3],
    period_s: f64,
    real: Option<Real>,
}

/// What a world makes of a receiver: hardly any white noise, and an error that wanders.
#[derive(Debug, Clone)]
struct Real {
    conditions: conditions::Gnss,
    stream: Stream,
    fast: [Slow; 3],
    slow: [Slow; 3],
    jumped_m: Vector3<f64>,
}

impl Real {
    fn error_m(&mut self, period_s: f64) -> Vector3<f64> {
        let (c, stream) = (&self.conditions, &mut self.stream);
        let jumps = stream.uniform() < c.jump_rate_per_s * period_s;
        let jump_m = Vector3::from_fn(|_, _| c.jump_sigma_m * stream.normal());
        if jumps {
            self.jumped_m = jump_m;
        }
        let sigma = |horizontal: f64, vertical: f64, axis: usize| if axis < 2 { horizontal } else { vertical };
        self.jumped_m
            + Vector3::from_fn(|axis, _| {
                let fast = self.fast[axis].step(period_s, c.fast_time_constant_s, stream);
                let slow = self.slow[axis].step(period_s, c.slow_time_constant_s, stream);
                sigma(c.fast_sigma_horizontal_m, c.fast_sigma_vertical_m, axis) * fast
                    + sigma(c.slow_sigma_horizontal_m, c.slow_sigma_vertical_m, axis) * slow
                    + sigma(c.white_horizontal_m, c.white_vertical_m, axis) * stream.normal()
            })
    }
}

impl Device for Gnss {
    type Sample = GnssSample;

    fn new(s: &gnss::Gnss, stream: &mut Stream) -> Self {
        let [x, y, _] = triple(s.horizontal, &s.timing, stream);
        let z = ScalarError::new(s.vertical, s.timing.period_s(), stream);
        let velocity = triple(s.velocity, &s.timing, stream);
        Self { position: [x, y, z], velocity, spec: s.clone(), period_s: s.timing.period_s(), real: None }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.gnss;
        // All of its error is the world's.
        let exact = |of: &ScalarError| Quality { sigma: 0.0, bias_sigma: 0.0, bias_walk: 0.0, ..*of.quality() };
        let velocity = Quality { sigma: c.velocity_sigma_mps, ..exact(&self.velocity[0]) };
        let position = exact(&self.position[0]);
        self.position = std::array::from_fn(|_| ScalarError::new(position, self.period_s, stream));
        self.velocity = std::array::from_fn(|_| ScalarError::new(velocity, self.period_s, stream));
        // The wander began long ago.
        let begun = |stream: &mut Stream| std::array::from_fn(|_| Slow::begun(stream));
        self.real = Some(Real {
            fast: begun(stream),
            slow: begun(stream),
            jumped_m: Vector3::zeros(),
            stream: stream.clone(),
            conditions: c.clone(),
        });
        self
    }

    fn transport(conditions: &Conditions) -> Option<Transport> {
        Some(Transport { delay_s: conditions.gnss.delay_s, ..Transport::default() })
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<GnssSample> {
        let (spec, x) = (&self.spec, now.world.body());
        let error_m = self.real.as_mut().map_or_else(Vector3::zeros, |real| real.error_m(self.period_s));
        let position_enu_m = read3(&mut self.position, &(x.position_enu_m + error_m), stream);
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

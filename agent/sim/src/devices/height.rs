//! A simulated laser height.

use nalgebra::Vector3;
use plumbline_core::frames::{roll_pitch_yaw, tilt_rad};
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::HeightSample;
use plumbline_core::sensor::height;
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::suite::Quality;

use super::field::Field;
use super::{Device, Now, Surroundings, Transport};
use crate::conditions::{Conditions, Laser};
use plumbline_proto::time::FlightTime;

#[derive(Debug, Clone)]
pub(super) struct Height {
    spec: height::Height,
    error: ScalarError,
    real: Option<Real>,
}

/// What a world makes of a laser.
#[derive(Debug, Clone)]
struct Real {
    conditions: Laser,
    stream: Stream,
    scale: f64,
    bias_m: f64,
    warm_up_m_per_c: f64,
    /// How far its scan is from the vertical plane it should be in, rad.
    mounting_rad: f64,
    /// Those of its beams that are noisier, by their angle about the middle of the scan.
    bad_beams: [bool; BEAMS],
    /// What colour and material of the floor add, m.
    surface: Field,
    /// What stands between it and the floor, of the way there; `None` for nothing. Drawn apart from everything else.
    spurious: (Stream, Option<f64>),
    /// The beam that pointed down last: only what turns meets something else.
    beam: i64,
}

/// How far the floor is alike (chosen), m.
const SURFACE_M: f64 = 0.5;

/// Beams that may point down: 45° of the scan. Beyond them they repeat.
const BEAMS: usize = 128;
/// From one beam to the next: 360° / 1024.
const BEAM_RAD: f64 = std::f64::consts::TAU / 1024.0;

/// Nothing is nearer in the beam than this part of the way to the floor (chosen).
const NEAREST: f64 = 0.05;

impl Real {
    /// Part of the way to the floor after which this scan's beam ends: at a string, a leg, a net.
    fn obstructed(&mut self, beam: i64) -> f64 {
        let c = &self.conditions;
        let (stream, at) = &mut self.spurious;
        let (met, place) = (stream.uniform(), stream.uniform());
        let turned = std::mem::replace(&mut self.beam, beam) != beam;
        *at = match *at {
            Some(place) => Some(place).filter(|_| met < c.spurious_again_fraction),
            None => (turned && met < c.spurious_fraction).then_some(NEAREST + (1.0 - NEAREST) * place),
        };
        at.unwrap_or(1.0)
    }

    /// Reading of a height of `own_m` over `place_m` with the vehicle rolled and pitched by these angles, rad, and by how much its stamp is
    /// too early, s; `None` for a beam without echo. Draws the same numbers either way.
    fn read(
        &mut self,
        own_m: f64,
        place_m: &Vector3<f64>,
        (roll_rad, pitch_rad): (f64, f64),
        warm_c: f64,
    ) -> (Option<f64>, f64) {
        // The scan finds the vertical in its own plane, which is another beam as the vehicle rolls; out of it the distance is
        // slant.
        let beam = (roll_rad / BEAM_RAD).round() as i64;
        let clear = self.obstructed(beam);
        let c = &self.conditions;
        let invalid = self.stream.uniform();
        let (noise, jitter) = (self.stream.normal(), self.stream.normal());
        let bad = self.bad_beams.get(beam.rem_euclid(BEAMS as i64) as usize).is_some_and(|bad| *bad);
        let slant_m = clear * own_m / (pitch_rad + self.mounting_rad).cos().max(0.1);
        let sigma_m = if slant_m < 2.0 { c.beam_sigma_m } else { c.beam_sigma_beyond_2m_m };
        let sigma_m = if bad { c.bad_beam_gain * sigma_m } else { sigma_m };
        let bias_m = self.bias_m + self.warm_up_m_per_c * warm_c + self.surface.at(place_m).x;
        let reading_m = slant_m * (1.0 + self.scale) + bias_m + sigma_m * noise;
        let early_s = c.nadir_after_scan_start_s - c.host_stamp_jitter_s * jitter.abs();
        (Some(reading_m).filter(|_| invalid >= c.intermittent_invalid_fraction), early_s)
    }
}

impl Device for Height {
    type Sample = HeightSample;

    fn new(s: &height::Height, stream: &mut Stream) -> Self {
        // Its range is checked before the reading, not cut.
        let quality = Quality { range: f64::MAX, ..s.height };
        Self { error: ScalarError::new(quality, s.timing.period_s(), stream), spec: s.clone(), real: None }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.laser;
        self.spec.height.range = self.spec.height.range.min(c.range_max_m);
        self.real = Some(Real {
            scale: c.scale_error_sigma * stream.normal(),
            bias_m: c.bias_sigma_m * stream.normal(),
            warm_up_m_per_c: c.warm_up_drift_m * stream.normal() / around.warm_up().0,
            mounting_rad: c.mounting_tilt_sigma_rad * stream.normal(),
            bad_beams: {
                let mut beams = Stream::new(stream.clone().uniform().to_bits(), "beams");
                std::array::from_fn(|_| beams.uniform() < c.bad_beam_fraction)
            },
            spurious: (Stream::new(stream.clone().uniform().to_bits(), "spurious"), None),
            beam: 0,
            // One floor for all.
            surface: Field::new(c.surface_bias_sigma_m, SURFACE_M, &mut Stream::new(around.seed, "floor")),
            stream: stream.clone(),
            conditions: c.clone(),
        });
        self
    }

    fn transport(conditions: &Conditions) -> Option<Transport> {
        let c = &conditions.laser;
        Some(Transport { delay_s: c.delivery_delay_s, jitter_s: c.host_stamp_jitter_s, ..Transport::default() })
    }

    fn period_s(conditions: &Conditions) -> Option<f64> {
        Some(conditions.laser.scan_period_s)
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<HeightSample> {
        let (spec, x) = (&self.spec, now.world.body());
        // The scan finds the vertical, so the unit's own height is measured; the driver adds its
        // mounting as if level. The lever's share of a tilt (millimetres) stays in.
        let place_m = x.position_enu_m + rotate(&x.world_from_body, &spec.position_flu_m);
        let (reading_m, early_s) = match &mut self.real {
            Some(real) => {
                let rpy = roll_pitch_yaw(&x.attitude());
                let below_m = Vector3::new(place_m.x, place_m.y, 0.0);
                real.read(place_m.z, &below_m, (rpy.x, rpy.y), now.warm_c)
            }
            None => (Some(self.error.read(place_m.z, stream)), 0.0),
        };
        let reading_m = reading_m?;
        let seen =
            (spec.nearest_m..=spec.height.range).contains(&reading_m) && tilt_rad(&x.attitude()) <= spec.tilt_max_rad;
        let time = FlightTime(now.time.0.saturating_sub((1e6 * early_s.max(0.0)) as u64));
        seen.then(|| HeightSample { time, height_m: reading_m - spec.position_flu_m.z })
    }
}

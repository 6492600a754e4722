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
    swaps: Option<Swaps>,
}

/// One sigma of a vehicle at rest, measured, m; the world's is that of one that moves.
const AT_REST_M: f64 = 2e-5;
/// Slower than this, m/s, and with less than this part of its weight on the rotors, it is at rest.
const STILL: (f64, f64) = (0.01, 0.1);

/// Shortest and longest that markers stay taken for each other, s.
const SWAPPED_S: (f64, f64) = (0.1, 1.0);
/// Markers sit on the corners of a square: one for another is a turn by 90°, 180° or 270°, and the centre of the body that
/// they are held to be moves by as much of this, m.
const OFF_M: f64 = 0.05;

/// Markers taken for each other now and then.
#[derive(Debug, Clone)]
struct Swaps {
    /// Of its own, so that a world with swaps has all other errors of one without.
    stream: Stream,
    rate_per_s: f64,
    until_s: f64,
    /// Turn about the body's z axis and shift, ENU, m.
    pose: (UnitQuaternion<f64>, Vector3<f64>),
}

impl Swaps {
    /// What is made of a pose measured at `t_s`.
    fn of(&mut self, t_s: f64, period_s: f64, sample: MocapPoseSample) -> MocapPoseSample {
        let begins = self.stream.uniform() < self.rate_per_s * period_s;
        if begins && t_s >= self.until_s {
            let (short_s, long_s) = SWAPPED_S;
            self.until_s = t_s + short_s + (long_s - short_s) * self.stream.uniform();
            let quarters = (1.0 + 3.0 * self.stream.uniform()).floor();
            let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), quarters * std::f64::consts::FRAC_PI_2);
            self.pose = (turned, Vector3::from_fn(|_, _| OFF_M * (2.0 * self.stream.uniform() - 1.0)));
        }
        if t_s >= self.until_s {
            return sample;
        }
        let (turned, off_m) = self.pose;
        let (position_enu_m, world_from_body) = (sample.position_enu_m + off_m, sample.world_from_body * turned);
        MocapPoseSample { position_enu_m, world_from_body, ..sample }
    }
}

impl Device for MocapPose {
    type Sample = MocapPoseSample;

    fn new(s: &mocap_pose::MocapPose, stream: &mut Stream) -> Self {
        let position = triple(s.position, &s.timing, stream);
        let attitude = triple(s.attitude, &s.timing, stream);
        Self { position, attitude, scale: 1.0, period_s: s.timing.period_s(), swaps: None }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.mocap;
        let with = |of: &ScalarError, sigma: f64| Quality { sigma, bias_sigma: 0.0, bias_walk: 0.0, ..*of.quality() };
        let (position, attitude) =
            (with(&self.position[0], c.position_sigma_m), with(&self.attitude[0], c.attitude_sigma_rad));
        self.position = std::array::from_fn(|_| ScalarError::new(position, self.period_s, stream));
        self.attitude = std::array::from_fn(|_| ScalarError::new(attitude, self.period_s, stream));
        self.scale += c.calibration_scale_sigma * stream.normal();
        self.swaps = Some(Swaps {
            stream: Stream::new(around.seed, "swapped markers"),
            rate_per_s: c.swap_rate_per_s,
            until_s: 0.0,
            pose: (UnitQuaternion::identity(), Vector3::zeros()),
        });
        self
    }

    fn transport(conditions: &Conditions) -> Option<Transport> {
        let (c, clocks) = (&conditions.mocap, &conditions.clocks);
        Some(Transport {
            delay_s: c.delay_s,
            jitter_s: c.delay_jitter_s,
            gap_rate_per_s: c.dropout_rate_per_s,
            // Uniform lengths up to twice the mean.
            gap_max_s: 2.0 * c.dropout_mean_s,
            jump_rate_per_s: clocks.delay_jump_rate_per_s,
            jump_s: clocks.delay_jump_s,
            ..Transport::default()
        })
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<MocapPoseSample> {
        let x = now.world.body();
        let error = read3(&mut self.attitude, &Vector3::zeros(), stream);
        let (slow_mps, light) = STILL;
        let airframe = now.world.airframe();
        let carried = airframe.wrench(now.world.rotor_speed_radps()).thrust_n / airframe.weight_n();
        let still = now.around.is_some() && x.velocity_enu_mps.norm() < slow_mps && carried < light;
        let sigma_m = self.position[0].quality().sigma;
        let part = if still && sigma_m > AT_REST_M { AT_REST_M / sigma_m } else { 1.0 };
        let error_m = read3(&mut self.position, &Vector3::zeros(), stream) * part;
        let sample = MocapPoseSample {
            time: now.time,
            position_enu_m: x.position_enu_m * self.scale + error_m,
            world_from_body: UnitQuaternion::from_scaled_axis(error) * x.attitude(),
        };
        let (t_s, period_s) = (now.time.as_seconds(), self.period_s);
        Some(self.swaps.as_mut().map_or(sample, |swaps| swaps.of(t_s, period_s, sample)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::time::FlightTime;

    #[test]
    fn swapped_markers_turn_the_pose_by_quarters_for_a_while_and_as_often_as_asked() {
        let mut swaps = Swaps {
            stream: Stream::new(7, "swapped markers"),
            rate_per_s: 0.02,
            until_s: 0.0,
            pose: (UnitQuaternion::identity(), Vector3::zeros()),
        };
        let sample = MocapPoseSample {
            time: FlightTime(0),
            position_enu_m: Vector3::new(1.0, 2.0, 3.0),
            world_from_body: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3),
        };
        let (period_s, count) = (0.01, 1_000_000);
        let (mut swapped, mut begun, mut before) = (0, 0, false);
        for k in 0..count {
            let seen = swaps.of(f64::from(k) * period_s, period_s, sample);
            let turned = seen.world_from_body.angle_to(&sample.world_from_body);
            let quarter = turned / std::f64::consts::FRAC_PI_2;
            assert!(
                (quarter - quarter.round()).abs() < 1e-9 && (quarter.round() > 0.5) == (seen != sample),
                "{turned}"
            );
            assert!((seen.position_enu_m - sample.position_enu_m).amax() <= OFF_M);
            let now = seen != sample;
            (swapped, begun, before) = (swapped + u32::from(now), begun + u32::from(now && !before), now);
        }
        // 10 000 s: 200 ± 14 swaps of 0.55 s.
        assert!((155..245).contains(&begun), "{begun}");
        let mean_s = f64::from(swapped) * period_s / f64::from(begun);
        assert!((0.48..0.62).contains(&mean_s), "{mean_s}");
    }
}

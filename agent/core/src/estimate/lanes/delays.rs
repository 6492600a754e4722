//! How late the stamps of heights and of motion capture are, learned in flight: an accelerometer notices at once that the vehicle moves.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | d | delay: a sample stamped t was measured at t − d | s |
//! | w(t) | upward acceleration felt, integrated twice over the stretch | m |
//! | τ | time from the middle of the stretch | s |
//! | r | y − w(t − d), y the altitude measured | m |
//!
//! Over a stretch of two seconds r = z₀ + v₀ τ + ½ b τ² − δ ẇ, δ what d is off by, as in the calibration of recorded flights: altitude,
//! climb and bias are left free (variable projection, Golub and Pereyra 1973). What a stretch tells weighs by how much the vehicle
//! moved in it; one at rest or hovering tells nothing. Each sensor is asked by itself. The delay of the heights, which are alike, is the
//! median of theirs: one that is attacked does not move it beyond the others'.

use nalgebra::SMatrix;
use plumbline_proto::time::FlightTime;

use super::SLOT_S;
use super::slot::Slot;
use crate::estimate::median;
use crate::sensor::MAX_HEIGHTS;

/// Slots of a stretch: 2 s.
const STRETCH: u32 = 50;
/// Samples in a stretch that counts.
const SAMPLES_MIN: f64 = 8.0;
/// Σ ẇ² of a stretch below which it is one of a vehicle that hovers, m²/s².
const MOVED_MIN: f64 = 0.1;
/// Largest residual of a stretch, rms, m: beyond it the accelerometers did not follow the vehicle, or the sensor measured something else.
const RESIDUAL_MAX_M: f64 = 0.015;
/// One-sigma of an altitude in a stretch, m, as if samples were independent, which what a laser is off by is not.
const SIGMA_M: f64 = 0.01;
/// One-sigma of a delay before anything is known, s, and the largest that is taken off.
const PRIOR_S: f64 = 0.02;
const MOST_S: f64 = 0.05;
/// A stretch that tells of more was measured by accelerometers that did not follow, s; one further than so many sigmas from what was known
/// counts as if it were so far.
const IMPOSSIBLE_S: f64 = 0.1;
const KNEE: f64 = 2.0;
/// Accelerometers that the thrust as commanded stands in for by more than this part, in the mean of a stretch, tell no delay.
const VOICELESS: f64 = 0.4;

/// Motion capture's place behind the heights'.
const POSE: usize = MAX_HEIGHTS;

/// What has been learned: by how much stamps are late, s.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Learned {
    /// Of the heights.
    pub heights_s: Option<f64>,
    /// Of motion capture.
    pub pose_s: Option<f64>,
}

/// One sensor's sums over a stretch of products of 1, τ, τ², ẇ and r.
type Sums = SMatrix<f64, 5, 5>;

/// What is known of one sensor's delay.
#[derive(Debug, Clone, Copy, Default)]
struct Known {
    sums: Sums,
    /// Σ 1/σ², 1/s², and Σ d/σ², 1/s, over all stretches.
    information: f64,
    weighted: f64,
}

impl Known {
    /// With the prior.
    fn delay_s(&self) -> f64 {
        self.weighted / (self.information + PRIOR_S.powi(-2))
    }

    /// What a stretch of these sums tells, in which samples were taken for `applied_s` late.
    fn learn(&mut self, mut s: Sums, applied_s: f64) {
        let count = s[(0, 0)];
        if count < SAMPLES_MIN {
            return;
        }
        // What 1, τ and τ² explain is taken out (Gauss).
        for pivot in 0..3 {
            if s[(pivot, pivot)] < 1e-9 {
                return;
            }
            let column = s.column(pivot).into_owned();
            s -= column * column.transpose() / column[pivot];
        }
        let (moved, along, left) = (s[(3, 3)], s[(3, 4)], s[(4, 4)]);
        let told_s = applied_s - along / moved;
        let residual = (left - along * along / moved) / count;
        let counts = moved >= MOVED_MIN && residual <= RESIDUAL_MAX_M * RESIDUAL_MAX_M && told_s.abs() <= IMPOSSIBLE_S;
        if !counts {
            return;
        }
        let information = moved / (SIGMA_M * SIGMA_M);
        let sigma_s = (1.0 / information + 1.0 / (self.information + PRIOR_S.powi(-2))).sqrt();
        let known_s = self.delay_s();
        let reach_s = KNEE * sigma_s;
        self.weighted += information * (known_s + (told_s - known_s).clamp(-reach_s, reach_s));
        self.information += information;
    }
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Delays {
    sensors: [Known; MAX_HEIGHTS + 1],
    /// Of the heights, and of motion capture, as taken off since the stretch began, s.
    heights_s: f64,
    pose_s: f64,
    /// End of the last slot, and how many the stretch has.
    last: Option<FlightTime>,
    slots: u32,
    /// Climb and altitude by what was felt since the stretch began, m/s and m.
    climb_mps: f64,
    rise_m: f64,
    /// Part of the acceleration for which the thrust as commanded stood in elsewhere, summed over its slots.
    by_thrust: f64,
}

impl Delays {
    /// What is taken off the stamps of heights and of motion capture, s; `None` before anything is known.
    pub fn learned(&self) -> Learned {
        let known = |of: &[Known]| of.iter().any(|known| known.information > 0.0);
        let (heights, pose) = self.sensors.split_at(POSE);
        Learned {
            heights_s: Some(self.heights_s).filter(|_| known(heights)),
            pose_s: Some(self.pose_s).filter(|_| known(pose)),
        }
    }

    /// The slot with stamps of when it was measured.
    pub fn restamp(&self, slot: &Slot) -> Slot {
        let moved = |time: FlightTime, late_s: f64| {
            let late_us = (1e6 * late_s).round() as i64;
            FlightTime(time.0.saturating_add_signed(-late_us))
        };
        let mut slot = *slot;
        for (time, _) in slot.heights.iter_mut().flatten() {
            *time = moved(*time, self.heights_s);
        }
        if let Some(pose) = &mut slot.pose {
            pose.time = moved(pose.time, self.pose_s);
        }
        slot
    }

    /// A slot that ends at `end`, in which the IMUs felt an upward acceleration of `up_mps2`, this part of which is taken from the thrust as
    /// commanded elsewhere; altitudes measured in it by those of the `heights` that are in no doubt, and by motion capture: restamped, m.
    pub fn take(
        &mut self,
        end: FlightTime,
        (up_mps2, by_thrust): (f64, f64),
        heights: &[Option<(FlightTime, f64)>; MAX_HEIGHTS],
        pose: Option<(FlightTime, f64)>,
    ) {
        let follows = self.last.is_some_and(|last| (end.seconds_since(last) - SLOT_S).abs() < 1e-3);
        if !follows || self.slots == STRETCH {
            self.end(follows && self.by_thrust < VOICELESS * f64::from(STRETCH));
        }
        self.last = Some(end);
        self.slots += 1;
        self.by_thrust += by_thrust;
        self.rise_m += (self.climb_mps + 0.5 * up_mps2 * SLOT_S) * SLOT_S;
        self.climb_mps += up_mps2 * SLOT_S;
        let middle_s = (f64::from(self.slots) - 0.5 * f64::from(STRETCH)) * SLOT_S;
        for (known, sample) in self.sensors.iter_mut().zip(heights.iter().chain([&pose])) {
            let Some((time, altitude_m)) = sample else { continue };
            let age_s = end.seconds_since(*time);
            let climb_mps = self.climb_mps - up_mps2 * age_s;
            let rise_m = self.rise_m - (self.climb_mps - 0.5 * up_mps2 * age_s) * age_s;
            let tau = middle_s - age_s;
            let row = nalgebra::SVector::<f64, 5>::from([1.0, tau, tau * tau, climb_mps, altitude_m - rise_m]);
            known.sums += row * row.transpose();
        }
    }

    /// A stretch is over, and begins; `whole`: what it tells counts.
    fn end(&mut self, whole: bool) {
        let (heights_s, pose_s) = (self.heights_s, self.pose_s);
        for (i, known) in self.sensors.iter_mut().enumerate() {
            let sums = std::mem::take(&mut known.sums);
            if whole {
                known.learn(sums, if i == POSE { pose_s } else { heights_s });
            }
        }
        let told = |known: &&Known| known.information > 0.0;
        let heights = self.sensors.iter().take(POSE).filter(told);
        let limited = |delay_s: f64| if delay_s.is_finite() { delay_s.clamp(-MOST_S, MOST_S) } else { 0.0 };
        self.heights_s = limited(median(heights.map(Known::delay_s)));
        self.pose_s = limited(self.sensors.last().map_or(0.0, Known::delay_s));
        (self.slots, self.climb_mps, self.rise_m, self.by_thrust) = (0, 0.0, 0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Altitude and upward acceleration of a vehicle that swings up and down by this far.
    fn moved(time_s: f64, by_m: f64) -> [f64; 2] {
        let w = 3.0;
        [0.5 * by_m * (1.0 - (w * time_s).cos()), 0.5 * by_m * w * w * (w * time_s).cos()]
    }

    fn noise(k: u64, salt: f64) -> f64 {
        ((k as f64 * 12.9898 + salt).sin() * 43758.5453).fract()
    }

    /// A minute's flight with stamps late by these, s; accelerometers are off by 0.2 m/s².
    fn flown(late_s: [f64; 3], by_m: f64, by_thrust: f64) -> Delays {
        let mut delays = Delays::default();
        for k in 0..1500_u64 {
            let end = FlightTime((k + 1) * 40_000);
            let up = moved(end.as_seconds() - 0.5 * SLOT_S, by_m)[1] + 0.2 + 0.1 * noise(k, 0.5);
            let mut slot = Slot { number: k, ..Slot::default() };
            for (i, late_s) in late_s.into_iter().enumerate() {
                if (k as usize + i).is_multiple_of(3) {
                    let stamp_s = end.as_seconds() - 0.01 * (i as f64 + 1.0);
                    let height_m = 0.3 + moved(stamp_s - late_s, by_m)[0] + 0.01 * noise(k, i as f64);
                    slot.heights[i] = Some((FlightTime((1e6 * stamp_s) as u64), height_m));
                }
            }
            let slot = delays.restamp(&slot);
            delays.take(end, (up, by_thrust), &slot.heights, None);
        }
        delays
    }

    /// GIVEN three lasers stamped 33 ms too early WHEN the vehicle moves THEN that is learned; one that is stamped as of another time moves
    /// it no further than the others differ; a vehicle that hovers tells nothing, nor do accelerometers that the thrust stands in for.
    #[test]
    fn what_stamps_are_late_by_is_learned_from_a_vehicle_that_moves() {
        let early = flown([-0.033; 3], 0.4, 0.0).heights_s;
        assert!((early + 0.033).abs() < 0.004, "{early}");
        let attacked = flown([-0.033, 0.2, -0.033], 0.4, 0.0).heights_s;
        assert!((attacked + 0.033).abs() < 0.006, "{attacked}");
        assert_eq!(flown([-0.033; 3], 0.02, 0.0).heights_s, 0.0);
        assert_eq!(flown([-0.033; 3], 0.4, 0.5).heights_s, 0.0);
    }

    #[test]
    fn what_is_taken_off_stamps_has_an_end() {
        let late = flown([0.1; 3], 0.3, 0.0).heights_s;
        assert_eq!(late, MOST_S);
    }
}

//! Is a filter surprised by more than it expects, or by less? What it says of its altitude is scaled by as much.
//!
//! | symbol | meaning |
//! |---|---|
//! | ν/σ | innovation of a sensor's altitude over its one-sigma: white and of variance 1 where the filter's assumptions hold |
//! | w | mean of (ν/σ)² |
//! | l | mean of the square of the mean of ν/σ over a shorter time, over what it is for white ones: errors that last show here |
//!
//! One-sigmas of altitude and climb are told √max(w, l) times as large, by the median of the lasers, so that a minority of
//! attacked ones does not count; by motion capture or a barometer where there is no laser. A sensor that repeats itself surprises
//! nobody: less than [`LEAST`] is never taken. Nor does what all heights are off by together, which is added where an estimator
//! knows it. Nothing else follows from it: no
//! gate, no gain. That innovations tell what the noise really is: R. K. Mehra, "On the identification of variances and
//! adaptive Kalman filtering", IEEE TAC 15, 1970; here only its scale.

use arrayvec::ArrayVec;
use plumbline_proto::time::FlightTime;

use crate::estimate::{Channel, Estimate, Residual, median};
use crate::sensor::MAX_HEIGHTS;

/// Part of an innovation in the means of squares: 70 samples, 7 s of a laser.
const GAIN: f64 = 0.015;
/// Part of one in the shorter mean …
const SHORT_GAIN: f64 = 0.15;
/// … whose square is, for white ones, so much.
const SHORT_VARIANCE: f64 = SHORT_GAIN / (2.0 - SHORT_GAIN);
/// One-sigmas are never told smaller than by this factor.
const LEAST: f64 = 0.3;
/// Lasers, motion capture, a barometer.
const TRACKS: usize = MAX_HEIGHTS + 2;

#[derive(Debug, Clone, Copy, Default)]
struct Track {
    seen: bool,
    refused: bool,
    white: f64,
    mean: f64,
    lasting: f64,
}

impl Track {
    fn take(&mut self, normalised: f64, accepted: bool) {
        // One alone was the sensor's.
        let before = std::mem::replace(&mut self.refused, !accepted);
        if !accepted && !before {
            return;
        }
        if !self.seen {
            *self = Self { seen: true, white: 1.0, lasting: 1.0, ..*self };
        }
        self.white += GAIN * (normalised * normalised - self.white);
        self.mean += SHORT_GAIN * (normalised - self.mean);
        self.lasting += GAIN * (self.mean * self.mean / SHORT_VARIANCE - self.lasting);
    }
}

/// See the module.
#[derive(Debug, Clone, Copy, Default)]
pub struct Innovations {
    tracks: [Track; TRACKS],
    scaled: Option<FlightTime>,
}

/// Where a residual's sensor is kept.
fn index(residual: &Residual) -> Option<usize> {
    match residual.channel {
        Channel::Height => Some(usize::from(residual.sensor.instance).checked_sub(1)?).filter(|i| *i < MAX_HEIGHTS),
        Channel::Z => Some(MAX_HEIGHTS),
        Channel::PressureAltitude => Some(MAX_HEIGHTS + 1),
        _ => None,
    }
}

impl Innovations {
    /// Takes the residuals of `estimate`, those refused as well where several in a row are, and scales it; once, however often it is shown the same.
    pub fn scale(&mut self, estimate: &mut Estimate) {
        if self.scaled == Some(estimate.time) {
            return;
        }
        self.scaled = Some(estimate.time);
        for residual in &estimate.residuals {
            let normalised = residual.innovation / residual.sigma;
            let track = index(residual).and_then(|index| self.tracks.get_mut(index));
            if let Some(track) = track.filter(|_| normalised.is_finite()) {
                track.take(normalised, residual.accepted);
            }
        }
        let scale = self.surprise();
        if let Some(motion) = &mut estimate.motion {
            for sigma in [&mut motion.position_sigma_m, &mut motion.velocity_sigma_mps].into_iter().flatten() {
                sigma.z *= scale;
            }
            if let Some(sigma) = &mut motion.position_sigma_m {
                sigma.z = sigma.z.hypot(motion.heights_off_sigma_m);
            }
        }
    }

    fn surprise(&self) -> f64 {
        let (lasers, others) = self.tracks.split_at(MAX_HEIGHTS);
        let of = |tracks: &[Track]| -> ArrayVec<f64, TRACKS> {
            tracks.iter().filter(|track| track.seen).map(|track| track.white.max(track.lasting)).collect()
        };
        let lasers = of(lasers);
        let squared =
            if lasers.is_empty() { of(others).first().copied() } else { Some(median(lasers.iter().copied())) };
        squared.unwrap_or(1.0).sqrt().max(LEAST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Motion, Residual};
    use nalgebra::Vector3;
    use plumbline_proto::ids::SensorId;
    use plumbline_proto::v1::SensorKind;

    /// Altitude one-sigma told after 30 s of innovations of three lasers at 10 Hz, 0.01 m each in the filter's eyes.
    fn told_m(innovation_m: fn(u32, u8) -> f64) -> f64 {
        let mut innovations = Innovations::default();
        let mut told_m = f64::NAN;
        for k in 0..300 {
            let mut estimate = Estimate { time: FlightTime(u64::from(k) * 100_000), ..Estimate::default() };
            let sigma = Some(Vector3::repeat(0.01));
            estimate.motion = Some(Motion { position_sigma_m: sigma, velocity_sigma_mps: sigma, ..Motion::default() });
            for laser in 1..=3 {
                let of = (SensorId::new(SensorKind::Height, laser), Channel::Height);
                let residual = Residual::gated(of.0, of.1, innovation_m(k, laser), 0.01, 5.0);
                estimate.residuals.try_push(residual).unwrap();
            }
            innovations.scale(&mut estimate);
            innovations.scale(&mut estimate);
            told_m = estimate.motion.and_then(|m| m.position_sigma_m).map_or(f64::NAN, |sigma| sigma.z);
        }
        told_m
    }

    #[test]
    fn the_surprise_of_the_majority_scales() {
        assert!((told_m(|k, _| if k.is_multiple_of(2) { 0.008 } else { -0.008 }) - 0.008).abs() < 1e-3);
        assert!((told_m(|_, _| 0.0) - 0.003).abs() < 1e-9, "what repeats itself is not certain");
        assert!((told_m(|k, _| if k.is_multiple_of(2) { 0.03 } else { -0.03 }) - 0.03).abs() < 2e-3);
        // A mean that stays for seconds is no white noise; one laser of three far off changes little.
        assert!(told_m(|k, _| if (k / 50).is_multiple_of(2) { 0.009 } else { -0.009 }) > 0.025);
        // All of them now and then far off, for one sample: none was used, and nothing follows.
        let spurious = told_m(|k, laser| match k % 40 {
            at if at == 10 * u32::from(laser) => -0.5,
            at if at.is_multiple_of(2) => 0.008,
            _ => -0.008,
        });
        assert!(spurious < 0.009, "{spurious}");
        assert!(
            told_m(|k, laser| if laser == 2 {
                0.5
            } else if k.is_multiple_of(2) {
                0.008
            } else {
                -0.008
            }) < 0.011
        );
    }
}

//! Is a filter off by more than it expects, or by less? What it says of its altitude and climb is scaled by as much.
//!
//! | symbol | meaning |
//! |---|---|
//! | u | innovation of a sensor's altitude, its own mean taken from it, over its one-sigma √s |
//! | κ | gain of the altitude by it: p⁺ = κ(1 − κ)s is the variance of the altitude after it |
//! | m | mean of the u used of all sensors of a kind over half a second, by g |
//! | w | mean of u², what s really is: s′ = w s |
//! | p′ | variance of the altitude before it, as it really is |
//!
//! Innovations of a filter that is right are white. Otherwise those that are j apart have the covariance (1 − κ)ʲ⁻¹(p′ − κ s′)
//! (R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE TAC 15, 1970, here for one state), so that
//!
//! ```text
//! p′/p = w + E[u m] (g + κ − gκ)/(gκ)     r′/r = (w − κ p′/p)/(1 − κ)
//! ```
//!
//! Of what altitude and climb are off by, measurements tell ¾ and ¼ and the accelerations that nobody measured the rest, in a double
//! integrator driven by white noise (Lyapunov's equation with Kalman's gains, whatever both noises are):
//!
//! ```text
//! p′/p = ¾ r′/r + ¼ q′/q     of the climb ¼ r′/r + ¾ q′/q
//! ```
//!
//! The median of the lasers counts, so that a minority of attacked ones does not; motion capture or a barometer where there is no
//! laser. A sensor that repeats itself is not certain: less than [`LEAST`] is never taken. To the altitude's is added what the mean
//! of the lasers may be off by, from how far they are apart, and what all of them say that it is off by. Nothing else follows: no gate, no gain.

use arrayvec::ArrayVec;
use plumbline_proto::time::FlightTime;

use crate::estimate::{Channel, Estimate, Residual, median};
use crate::sensor::MAX_HEIGHTS;

/// Part of an innovation in the means: 70 samples, 7 s of a laser.
const GAIN: f64 = 0.015;
/// g.
const RECENT_GAIN: f64 = 0.05;
/// One counts as at most so many of its one-sigmas in m.
const RECENT_MOST: f64 = 2.0;
/// Most of κ(1 − κ): what an estimate that was predicted since says of p⁺ is too much.
const GAINED_MOST: f64 = 0.2;
/// No variance is told smaller than by this factor.
const LEAST: f64 = 0.15;
/// What lasers are off by before more is known of them, m.
const USUAL_M: f64 = 0.0035;
/// Lasers, motion capture, barometers.
const KINDS: usize = 3;
/// A track for each laser and each other kind.
const TRACKS: usize = MAX_HEIGHTS + KINDS - 1;

/// One-sigma of what the mean of heights is off by that are off by `off_m` each, m, were they off independently: from how far they are
/// apart, and as if two more were [`USUAL_M`] apart: three that agree by chance say little. 0 for one, of which nothing is known.
pub fn mean_off_sigma_m(off_m: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = off_m.clone().count() as f64;
    if n < 2.0 {
        return 0.0;
    }
    let mean = off_m.clone().sum::<f64>() / n;
    let apart = off_m.map(|off| (off - mean).powi(2)).sum::<f64>();
    ((apart + 2.0 * USUAL_M * USUAL_M) / ((n - 1.0) * n)).sqrt()
}

#[derive(Debug, Clone, Copy, Default)]
struct Track {
    seen: u32,
    refused: bool,
    mean_m: f64,
    gain: f64,
    /// w, and p′/p.
    white: f64,
    altitude: f64,
}

impl Track {
    fn take(&mut self, residual: &Residual, altitude_sigma_m: f64, recent: &mut f64) {
        // One alone was the sensor's.
        let before = std::mem::replace(&mut self.refused, !residual.accepted);
        if !residual.accepted && !before {
            return;
        }
        if self.seen == 0 {
            (self.white, self.altitude) = (1.0, 1.0);
        }
        self.seen = self.seen.saturating_add(1);
        let learned = GAIN.max(1.0 / (1.0 + f64::from(self.seen)));
        self.mean_m += learned * (residual.innovation - self.mean_m);
        let u = (residual.innovation - self.mean_m) / residual.sigma;
        let gained = (altitude_sigma_m / residual.sigma).powi(2).min(GAINED_MOST);
        self.gain = 0.5 * (1.0 - (1.0 - 4.0 * gained).sqrt());
        let (g, k) = (RECENT_GAIN, self.gain);
        self.white += GAIN * (u * u - self.white);
        self.altitude += GAIN * (u * u + u * *recent * (g + k - g * k) / (g * k) - self.altitude);
        if residual.accepted {
            *recent += g * (u.clamp(-RECENT_MOST, RECENT_MOST) - *recent);
        }
    }
}

/// Factors of the variances of altitude and climb, and one-sigma of what the heights are off by together, m.
struct Surprise {
    altitude: f64,
    climb: f64,
    off_m: f64,
}

/// See the module.
#[derive(Debug, Clone, Copy, Default)]
pub struct Innovations {
    tracks: [Track; TRACKS],
    /// m of each kind.
    recent: [f64; KINDS],
    scaled: Option<FlightTime>,
}

/// Where a residual's sensor and its kind are kept.
fn index(residual: &Residual) -> Option<(usize, usize)> {
    match residual.channel {
        Channel::Height => {
            let laser = usize::from(residual.sensor.instance).checked_sub(1)?;
            (laser < MAX_HEIGHTS).then_some((laser, 0))
        }
        Channel::Z => Some((MAX_HEIGHTS, 1)),
        Channel::PressureAltitude => Some((MAX_HEIGHTS + 1, 2)),
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
        let Some(motion) = &mut estimate.motion else { return };
        let Some(position) = motion.position_sigma_m.as_mut().filter(|sigma| sigma.z > 0.0) else { return };
        for residual in estimate.residuals.iter().filter(|r| (r.innovation / r.sigma).is_finite()) {
            let Some((track, kind)) = index(residual) else { continue };
            if let Some((track, recent)) = self.tracks.get_mut(track).zip(self.recent.get_mut(kind)) {
                track.take(residual, position.z, recent);
            }
        }
        let Surprise { altitude, climb, off_m } = self.surprise();
        position.z = (position.z * altitude.sqrt()).hypot(motion.heights_off_sigma_m.unwrap_or(off_m));
        if let Some(velocity) = &mut motion.velocity_sigma_mps {
            velocity.z *= climb.sqrt();
        }
    }

    fn surprise(&self) -> Surprise {
        let (lasers, others) = self.tracks.split_at(MAX_HEIGHTS);
        let seen = |tracks: &[Track]| -> ArrayVec<Track, MAX_HEIGHTS> {
            tracks.iter().filter(|track| track.seen > 0).copied().take(MAX_HEIGHTS).collect()
        };
        let heights = seen(lasers);
        let used = if heights.is_empty() { seen(others).into_iter().take(1).collect() } else { heights.clone() };
        if used.is_empty() {
            return Surprise { altitude: 1.0, climb: 1.0, off_m: 0.0 };
        }
        let of = |value: fn(&Track) -> f64| median(used.iter().map(value));
        let (white, gain) = (of(|track| track.white), of(|track| track.gain));
        let altitude = of(|track| track.altitude).max(LEAST);
        let noise = ((white - gain * altitude) / (1.0 - gain)).max(LEAST);
        let acceleration = (4.0 * altitude - 3.0 * noise).max(LEAST);
        let all_refused = heights.iter().all(|track| track.refused);
        let told = heights.iter().filter(|track| all_refused || !track.refused).map(|track| track.mean_m);
        let told: ArrayVec<f64, MAX_HEIGHTS> = told.collect();
        let common_m = if told.is_empty() { 0.0 } else { median(told.iter().copied()) };
        Surprise {
            altitude: 0.75 * noise + 0.25 * acceleration,
            climb: 0.25 * noise + 0.75 * acceleration,
            off_m: mean_off_sigma_m(told.iter().copied()).hypot(common_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2, Vector3};
    use plumbline_proto::ids::SensorId;
    use plumbline_proto::v1::SensorKind;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::estimate::Motion;

    /// One-sigma that the filter has of a laser, m, and of the acceleration, (m/s²)²/Hz.
    const LASER_M: f64 = 0.01;
    const DENSITY: f64 = 0.01;

    /// What is told of altitude and climb, and what they are off by, rms over 20 flights of a filter of altitude and climb with lasers in
    /// turns, 30 in a second, their noise and that of the acceleration other than it takes them for by these factors.
    fn flown(laser: f64, acceleration: f64, off_m: [f64; 3], spoilt: fn(u32, usize) -> f64) -> [(f64, f64); 2] {
        let mut squares = [(0.0, 0.0); 2];
        for seed in 0..20 {
            let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
            let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
            let dt: f64 = 1.0 / 30.0;
            let step = Matrix2::new(1.0, dt, 0.0, 1.0);
            let driven = Matrix2::new(dt.powi(3) / 3.0, dt * dt / 2.0, dt * dt / 2.0, dt) * DENSITY;
            let root = driven.cholesky().unwrap().l();
            let (mut truth, mut known, mut p) = (Vector2::zeros(), Vector2::zeros(), Matrix2::identity() * 1e-4);
            let mut innovations = Innovations::default();
            for k in 0..1200 {
                truth = step * truth + root * Vector2::new(draw(), draw()) * acceleration;
                known = step * known;
                p = step * p * step.transpose() + driven;
                let i = k as usize % 3;
                let read = truth[0] + off_m[i] + LASER_M * laser * draw() + spoilt(k, i);
                let (innovation, s) = (read - known[0], p[(0, 0)] + LASER_M * LASER_M);
                let of = (SensorId::new(SensorKind::Height, i as u8 + 1), Channel::Height);
                let residual = Residual::gated(of.0, of.1, innovation, s.sqrt(), 8.0);
                if residual.accepted {
                    let gain = p.column(0) / s;
                    known += gain * innovation;
                    p -= gain * p.row(0);
                }
                let mut estimate = Estimate { time: FlightTime(u64::from(k + 1) * 33_333), ..Estimate::default() };
                let sigma = |axis: usize| Some(Vector3::repeat(p[(axis, axis)].sqrt()));
                let motion = Motion { position_sigma_m: sigma(0), velocity_sigma_mps: sigma(1), ..Motion::default() };
                estimate.motion = Some(motion);
                estimate.residuals.try_push(residual).unwrap();
                innovations.scale(&mut estimate);
                innovations.scale(&mut estimate);
                let told = estimate.motion.unwrap();
                for (axis, sigma) in [told.position_sigma_m, told.velocity_sigma_mps].into_iter().enumerate() {
                    if k > 300 {
                        squares[axis].0 += sigma.unwrap().z.powi(2);
                        squares[axis].1 += (known[axis] - truth[axis]).powi(2);
                    }
                }
            }
        }
        squares.map(|(told, off)| (told.sqrt(), off.sqrt()))
    }

    /// GIVEN a filter that takes its noises for larger or smaller than they are THEN what it tells is what it is off by, within a third.
    #[test]
    fn what_is_told_is_what_the_filter_is_off_by() {
        for (laser, acceleration) in [(1.0, 1.0), (3.0, 1.0), (1.0, 3.0), (3.0, 3.0), (0.6, 1.0)] {
            for (quantity, (told, off)) in flown(laser, acceleration, [0.0; 3], |_, _| 0.0).into_iter().enumerate() {
                let ratio = told / off;
                assert!((0.75..1.4).contains(&ratio), "{laser} {acceleration} {quantity}: {ratio}");
            }
        }
    }

    /// GIVEN lasers that are off by a constant each THEN the climb is as certain as without; the altitude is told as off by what their mean is.
    #[test]
    fn constant_differences_are_no_noise() {
        let [none, apart] = [[0.0; 3], [0.03, -0.03, 0.0]].map(|off_m| flown(1.0, 1.0, off_m, |_, _| 0.0));
        assert!((apart[1].0 / none[1].0 - 1.0).abs() < 0.15, "{apart:?} {none:?}");
        let off_m = ((apart[0].0 / none[0].0).powi(2) - 1.0).sqrt();
        assert!(off_m > 2.0, "{apart:?} {none:?}");
        assert!((mean_off_sigma_m([0.03, -0.03, 0.0].into_iter()) - 0.0174).abs() < 1e-4);
        assert_eq!(mean_off_sigma_m(std::iter::once(0.1)), 0.0);
    }

    /// GIVEN one laser of three far off for good, or each now and then for one sample THEN what is told is right: they are not used.
    #[test]
    fn what_is_refused_is_no_surprise() {
        let without = flown(1.0, 1.0, [0.0; 3], |_, _| 0.0);
        let attacked = flown(1.0, 1.0, [0.0; 3], |k, i| if i == 1 && k > 200 { 0.5 } else { 0.0 });
        let spurious = flown(1.0, 1.0, [0.0; 3], |k, i| if k % 120 == 10 * i as u32 { -0.5 } else { 0.0 });
        for (quantity, (told, _)) in without.into_iter().enumerate() {
            let ratio = attacked[quantity].0 / attacked[quantity].1;
            assert!((0.75..1.4).contains(&ratio), "{attacked:?} {without:?}");
            assert!((spurious[quantity].0 / told - 1.0).abs() < 0.1, "{spurious:?} {without:?}");
        }
    }

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
            told_m = estimate.motion.and_then(|m| m.position_sigma_m).map_or(f64::NAN, |sigma| sigma.z);
        }
        told_m
    }

    /// GIVEN lasers that repeat themselves, or that all say the same for seconds THEN no filter is certain of its altitude.
    #[test]
    fn what_repeats_itself_is_not_certain_and_what_lasts_is_no_noise() {
        assert!(told_m(|_, _| 0.0) >= 0.003);
        assert!(told_m(|k, _| if (k / 50).is_multiple_of(2) { 0.009 } else { -0.009 }) > 0.025);
        assert!(told_m(|_, _| 0.04) > 0.04, "what all of them say that it is off by");
    }
}

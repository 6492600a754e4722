//! How much each IMU differs from the others from moment to moment: the noise of its lane, measured.
//!
//! Means over 0.8 s, less the median of all IMUs; how far they change from one to the next is the noise, its mean
//! absolute value kept with forgetting. Vibration therefore widens what a lane takes for noise instead of blinding it. At most
//! twice the median IMU, so that a faulty sensor cannot make room for itself.

use super::integral::Six;
use super::{LANES, PerLane, median_six};

/// Slots of one mean: 0.8 s.
pub(super) const SLOTS: u32 = 20;
/// E|x − y| of two normal numbers is 1.128 σ.
const SIGMA_OF_CHANGE: f64 = 1.25 / std::f64::consts::SQRT_2;
/// Part of a new change in the mean, at first and later.
const GAINS: (f64, f64) = (0.3, 0.08);
/// No IMU is taken for better, m/s² and rad/s.
pub(super) const FLOOR: (f64, f64) = (0.05, 0.003);
/// What is assumed before anything is measured, m/s² and rad/s.
const FIRST: (f64, f64) = (0.15, 0.01);
/// A sensor's own noise counts up to so many times the median one.
const MOST: f64 = 2.0;

/// Part of what an IMU is shaken that it takes for motion: clipping, filters, aliasing.
const RECTIFIED: f64 = 0.1;
/// The same along the thrust, per m/s² shaken: there gravity and thrust bring it near its range, whose one end cuts off.
const RECTIFIED_UP_PER_MPS2: f64 = 0.08;
/// One-sigma of the thrust as commanded, over the mass, beside what is learned to be off (`thrust.rs`), m/s².
const THRUST_SIGMA_MPS2: f64 = 0.8;

/// What accelerometers in the plane rectify for good, per (m/s²)² shaken, as tilt takes it for gravity: found in 100 flights each of
/// `datasheet` and `harsh`.
const RECTIFIED_TILT_PER_MPS2: f64 = 0.035;

/// One-sigma of the acceleration in the plane that accelerometers tell for good which are shaken so that they usually rectify `rectified`,
/// squared (m²/s⁴), m/s².
pub(super) fn lasting_mps2(rectified_square: f64) -> f64 {
    RECTIFIED_TILT_PER_MPS2 * rectified_square / (RECTIFIED * RECTIFIED)
}

/// What sensors that are `shaken` rectify of it, all of them alike: no comparison shows it.
pub(super) fn rectified(shaken: &Six) -> Six {
    let mut rectified = shaken * RECTIFIED;
    rectified[2] *= (RECTIFIED_UP_PER_MPS2 / RECTIFIED * shaken[2]).max(1.0);
    rectified
}

/// How accelerometers are shaken along z that rectify so much of it, m/s²: the inverse of [`rectified`].
pub(super) fn shaken_mps2(rectified_mps2: f64) -> f64 {
    (rectified_mps2 / RECTIFIED).min((rectified_mps2 / RECTIFIED_UP_PER_MPS2).sqrt())
}

/// Part of the specific force along the thrust that is taken from the thrust as commanded, where accelerometers rectify `rectified_mps2` of
/// it, and tell `beside_mps2` beside that thrust: the less they say, the more. Beyond what either is off by something else holds the
/// vehicle, a tether or strings, and counts as noise of the thrust.
pub(super) fn share(rectified_mps2: f64, beside_mps2: f64) -> f64 {
    let (rectified, thrust) = (rectified_mps2.powi(2), THRUST_SIGMA_MPS2.powi(2));
    rectified / (rectified + thrust).max(beside_mps2.powi(2))
}

/// One-sigma of the specific force along the thrust, `share` of it as commanded and the rest of an accelerometer of `sigma`, m/s².
pub(super) fn mixed(sigma: f64, share: f64) -> f64 {
    ((1.0 - share) * sigma).hypot(share * THRUST_SIGMA_MPS2)
}

/// σ of an accelerometer after a mean that an attack changed by `change_mps2`, beside its noise of `typical`, which is that of the others.
pub(super) fn followed(sigma: f64, typical: f64, change_mps2: f64) -> f64 {
    sigma + ((change_mps2.abs() * SIGMA_OF_CHANGE).hypot(typical) - sigma) * GAINS.1
}

/// What of σ a lane takes for its noise beside others of `typical`.
pub(super) fn taken(sigma: f64, typical: f64) -> f64 {
    sigma.min(typical * MOST).max(FLOOR.0)
}

/// What the lanes measure of their accelerometers along the thrust.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shaken {
    /// By which they differ from each other over means of 0.8 s, m/s²: what the vote goes by, and a lane's noise unless that is less than
    /// `of_imus::NOISE_MPS2`.
    pub noise_mps2: f64,
    /// What all of them may be off by alike as they are shaken, m/s²: a lane takes it for noise as well, and the less of the force from
    /// its accelerometer the more it is.
    pub rectified_mps2: f64,
}

impl Shaken {
    /// Part of the specific force along the thrust that is an accelerometer's; the rest is commanded.
    pub fn own(&self) -> f64 {
        1.0 - share(self.rectified_mps2, 0.0)
    }

    /// What a lane takes the specific force for of which it measures `noise_mps2`, m/s².
    pub(super) fn taken(&self, noise_mps2: f64) -> f64 {
        mixed(noise_mps2.max(FLOOR.0).hypot(self.rectified_mps2), share(self.rectified_mps2, 0.0))
    }
}

fn six(of: (f64, f64)) -> Six {
    Six::new(of.0, of.0, of.0, of.1, of.1, of.1)
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Noise {
    sums: PerLane<Six>,
    counts: PerLane<u32>,
    slots: u32,
    deviations: PerLane<Option<Six>>,
    sigmas: PerLane<Six>,
    own: PerLane<Six>,
}

impl Noise {
    /// As assumed.
    pub fn new() -> Self {
        Self {
            sums: [Six::zeros(); LANES],
            counts: [0; LANES],
            slots: 0,
            deviations: [None; LANES],
            sigmas: [six(FIRST); LANES],
            own: [six(FIRST); LANES],
        }
    }

    /// One-sigma of each lane's means, per axis: m/s² and rad/s.
    pub fn of(&self, lane: usize) -> Six {
        self.measured(lane).sup(&six(FLOOR))
    }

    /// The same as it is measured, which may be less than what any IMU is taken for.
    pub fn measured(&self, lane: usize) -> Six {
        self.own.get(lane).copied().unwrap_or_else(|| six(FIRST))
    }

    /// Takes the means of one slot.
    pub fn take(&mut self, means: &PerLane<Option<Six>>, learning: bool) {
        for ((sum, count), mean) in self.sums.iter_mut().zip(&mut self.counts).zip(means) {
            if let Some(mean) = mean {
                *sum += mean;
                *count += 1;
            }
        }
        self.slots += 1;
        if self.slots < SLOTS {
            return;
        }
        let known = |i: usize| (2 * self.counts[i] >= SLOTS).then(|| self.sums[i] / f64::from(self.counts[i]));
        let means: PerLane<Option<Six>> = std::array::from_fn(known);
        let centre = median_six(means.iter().flatten());
        let gain = if learning { GAINS.0 } else { GAINS.1 };
        for ((mean, before), sigma) in means.iter().zip(&mut self.deviations).zip(&mut self.sigmas) {
            let deviation = mean.map(|mean| mean - centre);
            if let (Some(now), Some(before)) = (deviation, *before) {
                *sigma += ((now - before).abs() * SIGMA_OF_CHANGE - *sigma) * gain;
            }
            *before = deviation;
        }
        self.slots = 0;
        (self.sums, self.counts) = ([Six::zeros(); LANES], [0; LANES]);
        let present = self.sigmas.iter().zip(&self.deviations).filter(|(_, d)| d.is_some()).map(|(sigma, _)| sigma);
        let typical = median_six(present);
        for (own, sigma) in self.own.iter_mut().zip(&self.sigmas) {
            *own = if typical.iter().all(|t| t.is_finite()) { sigma.inf(&(typical * MOST)) } else { *sigma };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// GIVEN accelerometers that rectify WHEN they tell no more beside the thrust as commanded than both are off by THEN it stands in for
    /// them; not where a tether pulls.
    #[test]
    fn the_thrust_as_commanded_stands_in_where_nothing_else_holds_the_vehicle() {
        let [free, off, tethered, clipping] =
            [(0.4, 0.0), (0.4, -0.8), (0.4, -6.0), (3.5, 3.0)].map(|(rectified, beside)| share(rectified, beside));
        assert!(
            (free - 0.2).abs() < 1e-9 && free == off && tethered < 0.005 && clipping > 0.9,
            "{free} {off} {tethered}"
        );
    }

    #[test]
    fn vibration_widens_all_and_a_faulty_one_not_itself_alone() {
        let run = |size: [f64; 4]| {
            let mut noise = Noise::new();
            for k in 0..2000usize {
                let x = |i: usize| size[i] * ((k * 7919 + i * 104_729) as f64 * 0.618).sin() * 1.41;
                let mean = |i: usize| (i < 4).then(|| Six::new(x(i), 0.0, 9.81, 0.0, 0.0, 0.0));
                noise.take(&std::array::from_fn(mean), false);
            }
            std::array::from_fn::<f64, 4, _>(|i| noise.of(i)[0])
        };
        let quiet = run([0.1; 4]);
        let shaken = run([20.0; 4]);
        assert!(quiet.iter().all(|s| *s == 0.05) && shaken.iter().all(|s| *s > 0.1), "{quiet:?} {shaken:?}");
        let one = run([20.0, 20.0, 20.0, 2000.0]);
        assert!(one[3] < 2.01 * one.iter().copied().fold(f64::INFINITY, f64::min).max(one[0]), "{one:?}");
    }
}

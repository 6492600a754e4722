//! How noisy a recording's IMUs are, vibration included, judged by their own samples.
//!
//! Second differences of successive samples hold little of the motion and six times the variance of white
//! noise; their median is not moved by the few that do. σ = median|x₊ − 2x + x₋| / (0.6745 √6).

use nalgebra::Vector3;
use plumbline_core::sensor::{AnySample, MAX_IMUS};

use super::ImuNoise;
use super::timeline::Item;

/// Median of |x| over σ for a normal x.
const NORMAL_MEDIAN: f64 = 0.6745;
/// Fewer samples say nothing.
const SAMPLES_MIN: usize = 100;

/// The worst axis of the worst IMU; `None` for a recording too short to tell.
pub(super) fn of<'a>(items: impl Iterator<Item = &'a Item> + Clone) -> Option<ImuNoise> {
    let of_imu = |index: usize| {
        let samples: Vec<_> = items
            .clone()
            .filter_map(|item| match item {
                Item::Sensed(i, AnySample::Imu(sample)) if *i == index => Some((sample.gyro_radps, sample.accel_mps2)),
                _ => None,
            })
            .collect();
        Some((sigma(samples.iter().map(|s| s.0))?, sigma(samples.iter().map(|s| s.1))?))
    };
    (0..MAX_IMUS).filter_map(of_imu).fold(None, |worst: Option<ImuNoise>, (gyro, accel)| {
        let worst = worst.unwrap_or_default();
        Some(ImuNoise {
            gyro_sigma_radps: worst.gyro_sigma_radps.max(gyro),
            accel_sigma_mps2: worst.accel_sigma_mps2.max(accel),
        })
    })
}

/// One-sigma of the noise of the worst axis.
fn sigma(samples: impl Iterator<Item = Vector3<f64>> + Clone) -> Option<f64> {
    let middle = samples.clone().skip(1);
    let after = samples.clone().skip(2);
    let differences: Vec<_> = samples.zip(middle).zip(after).map(|((a, b), c)| a - 2.0 * b + c).collect();
    (0..3)
        .map(|axis| {
            let mut sizes: Vec<f64> = differences.iter().map(|d| d[axis].abs()).filter(|d| d.is_finite()).collect();
            let half = sizes.len() / 2;
            if sizes.len() < SAMPLES_MIN {
                return None;
            }
            let (_, median, _) = sizes.select_nth_unstable_by(half, f64::total_cmp);
            Some(*median / (NORMAL_MEDIAN * 6.0_f64.sqrt()))
        })
        .try_fold(0.0_f64, |worst, axis| Some(worst.max(axis?)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::sensor::ImuSample;
    use plumbline_proto::time::FlightTime;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn noise_is_told_from_motion() {
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(1);
        let items: Vec<Item> = (0..20_000)
            .map(|k| {
                let t = f64::from(k) * 0.005;
                let mut noise = |sigma: f64| {
                    Vector3::from_fn(|_, _| sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng))
                };
                let imu = ImuSample {
                    time: FlightTime::from_seconds(t),
                    // A quick swing of 2 rad/s, and of 5 m/s², three times in two seconds.
                    gyro_radps: Vector3::new(2.0 * (9.4 * t).sin(), 0.0, 0.0) + noise(0.05),
                    accel_mps2: Vector3::new(0.0, 5.0 * (9.4 * t).cos(), 9.81) + noise(0.5),
                    mag_ut: None,
                    temperature_c: 25.0,
                };
                Item::Sensed(0, AnySample::Imu(imu))
            })
            .collect();
        let noise = of(items.iter()).unwrap();
        assert!((noise.gyro_sigma_radps / 0.05 - 1.0).abs() < 0.05, "{noise:?}");
        assert!((noise.accel_sigma_mps2 / 0.5 - 1.0).abs() < 0.05, "{noise:?}");
        assert_eq!(of(items[..50].iter()), None);
    }
}

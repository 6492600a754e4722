//! Seeded noise. Every sensor and every disturbance has a stream of its own, named after it, so that adding
//! one sensor to a suite changes no other's noise.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::sensor::suite::Quality;

/// One stream of random numbers.
#[derive(Debug, Clone)]
pub struct Stream(Xoshiro256PlusPlus);

impl Stream {
    /// The stream called `name` of a scenario's `seed`.
    pub fn new(seed: u64, name: &str) -> Self {
        // FNV-1a of the name, begun from the seed; xoshiro's own seeding spreads the bits.
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325 ^ seed.rotate_left(32), |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        Self(Xoshiro256PlusPlus::seed_from_u64(hash ^ seed))
    }

    /// Normal, mean 0, sigma 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Uniform in 0..1.
    pub fn uniform(&mut self) -> f64 {
        StandardUniform.sample(&mut self.0)
    }
}

/// The errors one measured scalar really has: [`Quality`] says how large they may be, this draws them.
#[derive(Debug, Clone)]
pub struct ScalarError {
    quality: Quality,
    bias: f64,
    walk_per_sample: f64,
}

impl ScalarError {
    /// Draws the turn-on bias; samples come every `period_s`.
    pub fn new(quality: Quality, period_s: f64, stream: &mut Stream) -> Self {
        let bias = quality.bias_sigma * stream.normal();
        Self { quality, bias, walk_per_sample: quality.bias_walk * period_s.sqrt() }
    }

    /// One reading of `truth`: bias (walked on), noise, range, resolution.
    pub fn read(&mut self, truth: f64, stream: &mut Stream) -> f64 {
        self.bias += self.walk_per_sample * stream.normal();
        let q = &self.quality;
        let raw = truth + self.bias + q.sigma * stream.normal();
        let cut = raw.clamp(-q.range, q.range);
        if q.resolution > 0.0 { (cut / q.resolution).round() * q.resolution } else { cut }
    }

    /// How large its errors may be.
    pub fn quality(&self) -> &Quality {
        &self.quality
    }

    /// The bias it has now.
    pub fn bias(&self) -> f64 {
        self.bias
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let first = |seed, name| Stream::new(seed, name).normal();
        assert_eq!(first(1, "imu 1"), first(1, "imu 1"));
        let all = [first(1, "imu 1"), first(1, "imu 2"), first(2, "imu 1"), first(2, "imu 2"), first(0, "")];
        for (i, a) in all.iter().enumerate() {
            assert!(all.iter().skip(i + 1).all(|b| a != b), "{all:?}");
        }
    }

    #[test]
    fn readings_have_the_statistics_of_their_quality() {
        let quality =
            Quality { sigma: 0.5, bias_sigma: 2.0, bias_walk: 0.0, resolution: 0.0, range: f64::MAX, gate_sigmas: 5.0 };
        const N: usize = 20_000;
        // Bias: drawn once for each of many sensors.
        let mut squares = 0.0;
        for seed in 0..N {
            squares += ScalarError::new(quality, 0.01, &mut Stream::new(seed as u64, "x")).bias().powi(2);
        }
        // The relative error of a sample sigma is 1/sqrt(2N) = 0.5 %: 3 % is six sigmas.
        assert!(((squares / N as f64).sqrt() / 2.0 - 1.0).abs() < 0.03);
        // Noise: of one sensor.
        let mut stream = Stream::new(7, "y");
        let mut error = ScalarError::new(quality, 0.01, &mut stream);
        let readings: Vec<f64> = (0..N).map(|_| error.read(3.0, &mut stream)).collect();
        let mean = readings.iter().sum::<f64>() / N as f64;
        let sigma = (readings.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / N as f64).sqrt();
        assert!((mean - 3.0 - error.bias()).abs() < 6.0 * 0.5 / (N as f64).sqrt());
        assert!((sigma / 0.5 - 1.0).abs() < 0.03, "{sigma}");
    }

    #[test]
    fn bias_walks_with_the_square_root_of_time() {
        let quality =
            Quality { sigma: 0.0, bias_sigma: 0.0, bias_walk: 0.1, resolution: 0.0, range: f64::MAX, gate_sigmas: 5.0 };
        let mut squares = 0.0;
        for seed in 0..2000 {
            let mut stream = Stream::new(seed, "walk");
            let mut error = ScalarError::new(quality, 0.01, &mut stream);
            for _ in 0..400 {
                error.read(0.0, &mut stream);
            }
            squares += error.bias().powi(2);
        }
        // 4 s: 0.1 · √4 = 0.2; sample sigma good to 1.6 %.
        assert!(((squares / 2000.0).sqrt() / 0.2 - 1.0).abs() < 0.08);
    }

    #[test]
    fn readings_are_rounded_and_cut() {
        let quality =
            Quality { sigma: 1.0, bias_sigma: 0.0, bias_walk: 0.0, resolution: 0.25, range: 2.0, gate_sigmas: 5.0 };
        let mut stream = Stream::new(1, "z");
        let mut error = ScalarError::new(quality, 0.01, &mut stream);
        let readings: Vec<f64> = (0..1000).map(|_| error.read(1.0, &mut stream)).collect();
        assert!(readings.iter().all(|r| (r * 4.0).fract() == 0.0 && r.abs() <= 2.0));
        assert!(readings.contains(&2.0));
    }
}

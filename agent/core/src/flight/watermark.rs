//! A watermark on the thrust, and whether the accelerometers carry it: what is replayed carries that of then.
//!
//! | symbol | meaning |
//! |---|---|
//! | w | normal noise between 2 and 5 Hz of rms A, m/s², added to the thrust over the mass |
//! | x | what of it the motors' lag leaves: w behind the lag, through the same band |
//! | r | an accelerometer's z less the thrust commanded behind the lag, both through the band |
//! | σ² | mean of (Σ x'(r − x Σxr/Σx²))²/Σ x'² over decoys x', drawn as x and never flown: what correlates by chance, however coloured r is |
//!
//! After 10 s of flight t = Σ xr / (σ √Σx²): standard normal where the watermark is carried; about −√Σx²/σ where what is received
//! is from another time. Below −3.1 (one in a thousand by chance) it is told. What is told excludes no sensor.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Flight, Phase};
use crate::event::{EventKind, Severity, text};
use crate::mix::Mixed;
use crate::sensor::{MAX_IMUS, SensorFrame};

/// Band, Hz.
const BAND_HZ: (f64, f64) = (2.0, 5.0);
/// Judged after so long, s.
pub const BLOCK_S: f64 = 10.0;
/// So much is not carried: exceeded by chance once in a thousand blocks.
pub const LIMIT: f64 = 3.09;
/// Watermarks that are never flown.
const DECOYS: usize = 16;
/// Part of σ² learned from a block.
const LEARNED: f64 = 0.3;

/// What is added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// A, m/s².
    pub rms_mps2: f64,
    /// Of the noise: the same seed, the same watermark.
    pub seed: u64,
}

/// One band pass of second order.
#[derive(Debug, Clone, Copy, Default)]
struct Band {
    b: f64,
    a: [f64; 2],
    inputs: [f64; 2],
    outputs: [f64; 2],
}

impl Band {
    fn new(rate_hz: f64) -> Self {
        let (low, high) = BAND_HZ;
        let centre = std::f64::consts::TAU * (low * high).sqrt() / rate_hz;
        let alpha = centre.sin() * (high - low) / (2.0 * (low * high).sqrt());
        let a = [-2.0 * centre.cos() / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha)];
        Self { b: alpha / (1.0 + alpha), a, ..Self::default() }
    }

    fn pass(&mut self, input: f64) -> f64 {
        let [before, last] = self.inputs;
        let output = self.b * (input - last) - self.a[0] * self.outputs[0] - self.a[1] * self.outputs[1];
        (self.inputs, self.outputs) = ([input, before], [output, self.outputs[0]]);
        output
    }

    /// rms of what white noise of one becomes.
    fn rms(mut self) -> f64 {
        let first = self.pass(1.0);
        (0..4000).map(|_| self.pass(0.0)).fold(first * first, |sum, x| sum + x * x).sqrt()
    }
}

/// A watermark drawn: the noise, and what of it reaches the accelerometers.
#[derive(Debug, Clone)]
struct Drawn {
    dice: Xoshiro256PlusPlus,
    shape: Band,
    lagged: f64,
    band: Band,
    x: f64,
}

impl Drawn {
    fn new(seed: u64, band: Band) -> Self {
        Self { dice: Xoshiro256PlusPlus::seed_from_u64(seed), shape: band, lagged: 0.0, band, x: 0.0 }
    }

    /// The next value; `keep` of the lag's state is kept.
    fn draw(&mut self, scale: f64, keep: f64) -> f64 {
        let white: f64 = StandardNormal.sample(&mut self.dice);
        let value = scale * self.shape.pass(white);
        self.lagged = keep * self.lagged + (1.0 - keep) * value;
        self.x = self.band.pass(self.lagged);
        value
    }
}

/// Sums of one accelerometer.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    latest: Option<f64>,
    band: Band,
    with_x: f64,
    with_decoys: [f64; DECOYS],
}

/// What a block told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Block {
    /// t of each accelerometer; `None` for one that is not there.
    pub carried: [Option<f64>; MAX_IMUS],
    /// What t is expected at where nothing is carried, the least of them (negative).
    pub missing: f64,
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Watermark {
    scale: f64,
    keep: f64,
    period_s: f64,
    own: Drawn,
    decoys: [Drawn; DECOYS],
    thrust: (f64, Band),
    sums: [Sums; MAX_IMUS],
    /// Σx² of the own one, Σx'² of each decoy, and Σxx'.
    powers: (f64, [f64; DECOYS], [f64; DECOYS]),
    variance: [Option<f64>; MAX_IMUS],
    elapsed_s: f64,
}

impl Watermark {
    /// For ticks of `period_s` and motors with this lag, s.
    pub fn new(settings: Settings, period_s: f64, lag_s: f64) -> Self {
        let band = Band::new(1.0 / period_s);
        let decoy = |n: usize| Drawn::new(settings.seed ^ (0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(n as u64 + 1)), band);
        Self {
            scale: settings.rms_mps2 / band.rms(),
            keep: (-period_s / lag_s.max(1e-6)).exp(),
            period_s,
            own: Drawn::new(settings.seed, band),
            decoys: std::array::from_fn(decoy),
            thrust: (0.0, band),
            sums: std::array::from_fn(|_| Sums { band, ..Sums::default() }),
            powers: (0.0, [0.0; DECOYS], [0.0; DECOYS]),
            variance: [None; MAX_IMUS],
            elapsed_s: 0.0,
        }
    }

    /// What is added to the thrust over the mass in this tick, m/s².
    pub fn draw(&mut self) -> f64 {
        let (scale, keep) = (self.scale, self.keep);
        for decoy in &mut self.decoys {
            decoy.draw(scale, keep);
        }
        self.own.draw(scale, keep)
    }

    /// The frame received, and the thrust over the mass commanded in this tick, m/s². What a block told, at its end.
    pub fn hear(&mut self, received: &SensorFrame, thrust_mps2: f64) -> Option<Block> {
        self.thrust.0 = self.keep * self.thrust.0 + (1.0 - self.keep) * thrust_mps2;
        let expected = self.thrust.1.pass(self.thrust.0);
        for (sums, sample) in self.sums.iter_mut().zip(&received.imus) {
            let along_z = |accel: &Vector3<f64>| Some(accel.z).filter(|z| z.is_finite());
            sums.latest = sample.as_ref().and_then(|sample| along_z(&sample.accel_mps2)).or(sums.latest);
            let Some(latest) = sums.latest else { continue };
            let innovation = sums.band.pass(latest) - expected;
            sums.with_x += self.own.x * innovation;
            for (sum, decoy) in sums.with_decoys.iter_mut().zip(&self.decoys) {
                *sum += decoy.x * innovation;
            }
        }
        self.powers.0 += self.own.x * self.own.x;
        let (_, powers, crosses) = &mut self.powers;
        for ((power, cross), decoy) in powers.iter_mut().zip(crosses).zip(&self.decoys) {
            *power += decoy.x * decoy.x;
            *cross += decoy.x * self.own.x;
        }
        self.elapsed_s += self.period_s;
        (self.elapsed_s >= BLOCK_S).then(|| self.judge())
    }

    fn judge(&mut self) -> Block {
        let mut block = Block::default();
        let (power, powers, crosses) = self.powers;
        for ((sums, variance), carried) in self.sums.iter().zip(&mut self.variance).zip(&mut block.carried) {
            if sums.latest.is_none() {
                continue;
            }
            // What r lacks of the own watermark is no noise: it is taken off.
            let lacks = sums.with_x / power.max(1e-12);
            let decoys = sums.with_decoys.iter().zip(&powers).zip(&crosses);
            let squares = decoys.map(|((sum, power), cross)| (sum - lacks * cross).powi(2) / power.max(1e-12));
            let now = squares.sum::<f64>() / DECOYS as f64;
            // As it was before this block: what is replayed brings its own.
            let sigma = variance.unwrap_or(now).max(1e-12).sqrt();
            let t = sums.with_x / (sigma * power.max(1e-12).sqrt());
            *carried = Some(t);
            block.missing = block.missing.min(-power.sqrt() / sigma);
            if variance.is_some() && t < -LIMIT {
                continue;
            }
            *variance = Some(variance.map_or(now, |before| before + LEARNED * (now - before)));
        }
        self.begin();
        block
    }

    /// A block begins: nothing was heard of it.
    pub fn begin(&mut self) {
        for sums in &mut self.sums {
            (sums.with_x, sums.with_decoys) = (0.0, [0.0; DECOYS]);
        }
        (self.powers, self.elapsed_s) = ((0.0, [0.0; DECOYS], [0.0; DECOYS]), 0.0);
    }
}

impl Flight {
    /// Do the accelerometers carry the watermark? While altitude is controlled.
    pub(super) fn hear_watermark(&mut self, received: &SensorFrame, mixed: &Mixed) {
        let flying = self.phase == Phase::Flying && self.loops().altitude;
        let Some(watermark) = &mut self.watermark else { return };
        if !flying {
            watermark.begin();
            return;
        }
        let thrust_mps2 = mixed.given.thrust_n / self.config.airframe.mass_kg;
        let Some(block) = watermark.hear(received, thrust_mps2) else { return };
        self.told.watermark = Some((received.time, block));
        for (imu, carried) in (1..).zip(&block.carried) {
            if let Some(t) = carried.filter(|t| *t < -LIMIT) {
                let line = text(format_args!(
                    "imu {imu} does not carry the watermark of the last 10 s: {t:.1} σ, limit -{:.1}: replayed?",
                    LIMIT
                ));
                self.event(Severity::Warning, EventKind::Estimator, line);
            }
        }
    }

    /// What the last block of the watermark told, and when it ended.
    pub fn watermark(&self) -> Option<(FlightTime, Block)> {
        self.told.watermark
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::ImuSample;

    const SETTINGS: Settings = Settings { rms_mps2: 0.1, seed: 3 };
    const PERIOD_S: f64 = 0.005;

    /// Thrust that follows the watermark behind the lag and two accelerometers with noise; the second replays 10 s.
    fn run(seconds: usize, replayed: bool) -> Vec<Block> {
        let mut watermark = Watermark::new(SETTINGS, PERIOD_S, 0.05);
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(9);
        let (mut lagged, mut heard, mut blocks) = (9.81, Vec::new(), Vec::new());
        for k in 0..seconds * 200 {
            let thrust = 9.81 + watermark.draw();
            lagged += (1.0 - watermark.keep) * (thrust - lagged);
            let noise: f64 = StandardNormal.sample(&mut dice);
            heard.push(lagged + 0.3 * noise);
            let second = if replayed && k >= 4000 { heard[k - 2000] } else { heard[k] };
            let mut frame = SensorFrame::default();
            for (place, z) in frame.imus.iter_mut().zip([heard[k], second]) {
                *place = Some(ImuSample {
                    time: FlightTime(0),
                    gyro_radps: Vector3::zeros(),
                    accel_mps2: Vector3::new(0.0, 0.0, z),
                    mag_ut: None,
                    temperature_c: 25.0,
                });
            }
            blocks.extend(watermark.hear(&frame, thrust));
        }
        blocks
    }

    #[test]
    fn the_watermark_has_its_size_and_repeats_with_its_seed() {
        let mut of = [Watermark::new(SETTINGS, PERIOD_S, 0.05), Watermark::new(SETTINGS, PERIOD_S, 0.05)];
        let values: Vec<f64> = (0..40_000).map(|_| of[0].draw()).collect();
        let rms = (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
        assert!((rms / 0.1 - 1.0).abs() < 0.1, "{rms}");
        assert!(values.iter().all(|value| *value == of[1].draw()));
    }

    #[test]
    fn what_is_replayed_does_not_carry_it_and_the_rest_does() {
        let blocks = run(60, true);
        assert_eq!(blocks.len(), 6);
        let of = |block: &Block, i: usize| block.carried[i].unwrap();
        // The first block still hears the filters begin.
        for block in &blocks[1..] {
            println!("{:?} {:?}, missing {}", block.carried[0], block.carried[1], block.missing);
            assert!(of(block, 0).abs() < LIMIT && block.carried[2].is_none());
        }
        assert!(of(&blocks[1], 1).abs() < LIMIT);
        assert!(blocks[2..4].iter().all(|block| of(block, 1) < -LIMIT), "{blocks:?}");
    }
}

//! Power spectral densities by Welch's method.
//!
//! Source: P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans. Audio and
//! Electroacoustics 15 (1967): Hann windows, half overlapping, the mean of each taken out, one-sided.

use std::f64::consts::TAU;

use nalgebra::Complex;
use rustfft::FftPlanner;

/// Samples of the shortest and the longest window; powers of two.
const WINDOWS: [usize; 2] = [64, 4096];
/// A window is at most this share of the samples: a mean over fewer windows is mostly their scatter.
const WINDOWS_AT_LEAST: usize = 4;
/// Samples further apart than so many periods are not joined.
const GAP_PERIODS: f64 = 5.0;

/// A density of the power of a signal over frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Samples a second; the highest frequency is half of it.
    pub rate_hz: f64,
    /// Windows that were averaged.
    pub windows: usize,
    /// Frequencies, Hz, evenly from 0 to half the rate.
    pub frequency_hz: Vec<f64>,
    /// Density at each, unit² / Hz; its sum times the spacing is the variance.
    pub density: Vec<f64>,
}

/// The spectrum of `samples`: time, s, rising, and value. They are put on an even grid of their median period by
/// straight lines; what lies beside a gap stays apart. `None` where no stretch without a gap holds a window.
pub fn welch(samples: &[(f64, f64)]) -> Option<Spectrum> {
    let period_s = median_period_s(samples)?;
    let runs = even(samples, period_s);
    let longest = runs.iter().map(Vec::len).max()?;
    let count: usize = runs.iter().map(Vec::len).sum();
    let [least, most] = WINDOWS;
    let wanted = (count / WINDOWS_AT_LEAST).clamp(least, most).min(longest);
    // The largest power of two within.
    let window = (wanted.checked_ilog2().map(|bits| 1_usize << bits)).filter(|window| *window >= least)?;
    let hann: Vec<f64> = (0..window).map(|k| 0.5 - 0.5 * (TAU * k as f64 / window as f64).cos()).collect();
    let scale = 2.0 * period_s / hann.iter().map(|w| w * w).sum::<f64>();
    let transform = FftPlanner::new().plan_fft_forward(window);
    let mut density = vec![0.0; window / 2 + 1];
    let mut windows = 0_u32;
    for piece in runs.iter().flat_map(|run| run.windows(window).step_by(window / 2)) {
        let mean = piece.iter().sum::<f64>() / window as f64;
        let mut x: Vec<_> = piece.iter().zip(&hann).map(|(x, w)| Complex::new((x - mean) * w, 0.0)).collect();
        transform.process(&mut x);
        density.iter_mut().zip(&x).for_each(|(sum, x)| *sum += scale * x.norm_sqr());
        windows += 1;
    }
    density.iter_mut().for_each(|sum| *sum /= f64::from(windows).max(1.0));
    // 0 and half the rate are their own mirror.
    for end in [0, window / 2] {
        density[end] *= 0.5;
    }
    let rate_hz = 1.0 / period_s;
    let frequency_hz = (0..=window / 2).map(|k| k as f64 * rate_hz / window as f64).collect();
    Some(Spectrum { rate_hz, windows: windows as usize, frequency_hz, density })
}

/// Where a frequency of `frequency_hz` appears among samples taken `rate_hz` times a second.
pub fn folded_hz(frequency_hz: f64, rate_hz: f64) -> f64 {
    let rest = frequency_hz.rem_euclid(rate_hz);
    rest.min(rate_hz - rest)
}

fn median_period_s(samples: &[(f64, f64)]) -> Option<f64> {
    let mut steps: Vec<f64> = samples.windows(2).map(|pair| pair[1].0 - pair[0].0).filter(|s| *s > 0.0).collect();
    let middle = steps.len() / 2;
    let at = |steps: &mut Vec<f64>| *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    (!steps.is_empty()).then(|| at(&mut steps))
}

/// Evenly spaced values of each stretch without a gap.
fn even(samples: &[(f64, f64)], period_s: f64) -> Vec<Vec<f64>> {
    let finite: Vec<(f64, f64)> = samples.iter().copied().filter(|(t, x)| t.is_finite() && x.is_finite()).collect();
    let joined = finite.chunk_by(|a, b| b.0 >= a.0 && b.0 - a.0 <= GAP_PERIODS * period_s);
    joined.map(|run| resampled(run, period_s)).collect()
}

fn resampled(run: &[(f64, f64)], period_s: f64) -> Vec<f64> {
    let [(begin_s, _), .., (end_s, _)] = run else { return run.iter().map(|(_, x)| *x).collect() };
    let count = ((end_s - begin_s) / period_s + 1e-6) as usize + 1;
    let mut after = 1;
    let at = |k: usize| {
        let t = begin_s + k as f64 * period_s;
        while after + 1 < run.len() && run[after].0 < t {
            after += 1;
        }
        let ((t0, x0), (t1, x1)) = (run[after - 1], run[after]);
        let share = if t1 > t0 { ((t - t0) / (t1 - t0)).clamp(0.0, 1.0) } else { 1.0 };
        x0 + share * (x1 - x0)
    };
    (0..count).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    fn peak(spectrum: &Spectrum) -> f64 {
        let best = (0..spectrum.density.len()).max_by(|a, b| spectrum.density[*a].total_cmp(&spectrum.density[*b]));
        spectrum.frequency_hz[best.unwrap()]
    }

    #[test]
    fn a_tone_in_noise_is_where_it_is_and_the_power_is_the_variance() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let samples: Vec<_> = (0..20_000)
            .map(|k| {
                let t = f64::from(k) / 200.0;
                let noise: f64 = StandardNormal.sample(&mut random);
                (t, 9.81 + 2.0 * (TAU * 31.0 * t).sin() + noise)
            })
            .collect();
        let spectrum = welch(&samples).unwrap();
        assert!((spectrum.rate_hz - 200.0).abs() < 1e-6 && spectrum.windows > 7);
        assert!((peak(&spectrum) - 31.0).abs() < 0.1, "{}", peak(&spectrum));
        let power = spectrum.density.iter().sum::<f64>() * spectrum.frequency_hz[1];
        // 2²/2 of the tone and 1 of the noise; gravity is none of it.
        assert!((power / 3.0 - 1.0).abs() < 0.03, "{power}");
        // Above 39 Hz there is nothing but noise.
        let above = &spectrum.density[800..];
        let noise = above.iter().sum::<f64>() / above.len() as f64;
        assert!((noise * 100.0 - 1.0).abs() < 0.1, "flat at variance / half the rate: {noise}");
    }

    #[test]
    fn lost_and_late_samples_move_no_tone_and_gaps_are_not_bridged() {
        let all = (0..8000).map(|k| f64::from(k) / 100.0).filter(|t| !(20.0..25.0).contains(t));
        let some: Vec<_> =
            all.enumerate().filter(|(k, _)| k % 17 != 0).map(|(_, t)| (t, (TAU * 7.0 * t).sin())).collect();
        let spectrum = welch(&some).unwrap();
        assert!((spectrum.rate_hz - 100.0).abs() < 1e-6 && (peak(&spectrum) - 7.0).abs() < 0.1);
        let runs = even(&some, 0.01);
        assert_eq!(runs.len(), 2, "before the gap and after it");
    }

    #[test]
    fn too_little_has_no_spectrum() {
        let few: Vec<_> = (0..63).map(|k| (f64::from(k), 1.0)).collect();
        assert_eq!((welch(&few), welch(&[]), welch(&[(1.0, 2.0)])), (None, None, None));
        assert_eq!(welch(&[(1.0, 2.0); 500]), None, "all at one time");
    }

    #[test]
    fn what_is_above_half_the_rate_folds_back() {
        let folded = [30.0, 100.0, 130.0, 200.0, 230.0].map(|hz| folded_hz(hz, 200.0));
        assert_eq!(folded, [30.0, 100.0, 70.0, 0.0, 30.0]);
    }
}

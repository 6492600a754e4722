//! Noise of an IMU at rest: overlapping Allan deviation, and the coefficients it is made of (IEEE Std 952).
//!
//! | symbol | meaning | unit (gyroscope; accelerometer) |
//! |---|---|---|
//! | σ²(τ) | Allan variance of means over τ | |
//! | N | angle (velocity) random walk, slope −½, read at τ = 1 s | rad/s/√Hz; m/s²/√Hz |
//! | B | bias instability, slope 0: floor / 0.664 | rad/s; m/s² |
//! | K | rate (acceleration) random walk, slope +½, read at τ = 3 s | rad/s²/√Hz; m/s³/√Hz |
//! | Q | quantisation, slope −1 | rad; m/s |
//!
//! σ²(τ) = 3Q²/τ² + N²/τ + (2 ln 2/π) B² + K²τ/3, fitted to all τ with weights by how well each is known and
//! without negative terms: a term that the recording does not show is zero, and said to be.

use nalgebra::{DMatrix, DVector, Vector3};

use super::samples::{Channel, Sample, channel};
use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};

/// Shortest recording, s.
const DURATION_MIN_S: f64 = 30.0;
/// Samples for a fit.
const SAMPLES_MIN: usize = 1000;
/// The longest τ leaves this many means.
const MEANS_MIN: usize = 9;
/// Values of τ for each decade.
const PER_DECADE: f64 = 8.0;
/// Largest spread of a recording at rest: rad/s, m/s².
const REST: [f64; 2] = [0.2, 1.0];
/// The step between samples may vary by this fraction.
const JITTER_MAX: f64 = 0.5;

/// (2 ln 2)/π.
const FLICKER: f64 = 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI;

/// The coefficients of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Coefficients {
    /// N.
    pub random_walk: f64,
    /// B.
    pub bias_instability: f64,
    /// K.
    pub rate_random_walk: f64,
    /// Q.
    pub quantisation: f64,
    /// One-sigma of N, B, K, Q.
    pub sigma: [f64; 4],
    /// Relative residual of the fit to σ(τ).
    pub residual: f64,
}

/// Overlapping Allan deviation of a rate sampled every `period_s`: (τ, σ(τ), how many independent differences).
pub fn deviation(rate: &[f64], period_s: f64) -> Vec<(f64, f64, f64)> {
    let mut sums = Vec::with_capacity(rate.len() + 1);
    let mut sum = 0.0;
    sums.push(0.0);
    // A mean taken off first keeps the sums small.
    let mean = rate.iter().sum::<f64>() / rate.len().max(1) as f64;
    for value in rate {
        sum += (value - mean) * period_s;
        sums.push(sum);
    }
    let n = rate.len();
    let longest = n / MEANS_MIN;
    let mut found = Vec::new();
    let mut exponent = 0.0;
    let mut m = 1;
    while m <= longest {
        let tau = m as f64 * period_s;
        let count = n + 1 - 2 * m;
        let total: f64 = (0..count).map(|k| (sums[k + 2 * m] - 2.0 * sums[k + m] + sums[k]).powi(2)).sum();
        found.push((tau, (total / (2.0 * tau * tau * count as f64)).sqrt(), n as f64 / m as f64));
        while (10.0_f64.powf(exponent / PER_DECADE)).round() as usize <= m {
            exponent += 1.0;
        }
        m = (10.0_f64.powf(exponent / PER_DECADE)).round() as usize;
    }
    found
}

/// The coefficients of a curve of [`deviation`].
///
/// # Errors
/// [`CalibrationError::Singular`] for too short a curve.
pub fn coefficients(curve: &[(f64, f64, f64)]) -> Result<Coefficients, CalibrationError> {
    // Relative errors of σ²: weights 1/σ⁴ times the number of differences.
    let rows: Vec<_> = curve.iter().filter(|(_, s, _)| *s > 0.0).collect();
    if rows.len() < 5 {
        return Err(CalibrationError::TooFew { what: "averaging times", found: rows.len(), needed: 5 });
    }
    let mut active = vec![0, 1, 2, 3];
    let term = |j: usize, tau: f64| match j {
        0 => 1.0 / tau,
        1 => FLICKER,
        2 => tau / 3.0,
        _ => 3.0 / (tau * tau),
    };
    // Bounded: each round drops one term or ends.
    for _ in 0..4 {
        let design = DMatrix::from_fn(rows.len(), active.len(), |i, j| {
            let (tau, sigma, count) = rows[i];
            term(active[j], *tau) * count.sqrt() / (sigma * sigma)
        });
        let y = DVector::from_iterator(rows.len(), rows.iter().map(|(_, _, count)| count.sqrt()));
        // Columns of one size: τ spans many decades.
        let scale: Vec<f64> = (0..active.len()).map(|j| design.column(j).norm().max(1e-300)).collect();
        let scaled = DMatrix::from_fn(rows.len(), active.len(), |i, j| design[(i, j)] / scale[j]);
        let cholesky = scaled
            .tr_mul(&scaled)
            .cholesky()
            .ok_or(CalibrationError::Singular("the averaging times do not tell the noises apart"))?;
        let x = cholesky.solve(&scaled.tr_mul(&y));
        if let Some((worst, _)) = x.iter().enumerate().filter(|(_, v)| **v < 0.0).min_by(|a, b| a.1.total_cmp(b.1)) {
            active.remove(worst);
            if active.is_empty() {
                return Err(CalibrationError::Singular("no noise model describes the curve"));
            }
            continue;
        }
        let inverse = cholesky.inverse();
        let freedom = rows.len().saturating_sub(active.len()).max(1) as f64;
        let chi = ((&y - &scaled * &x).norm_squared() / freedom).max(1.0);
        let mut found = Coefficients::default();
        for (j, which) in active.iter().enumerate() {
            let square: f64 = x[j] / scale[j];
            let value = square.max(0.0).sqrt();
            // d√v = dv / 2√v.
            let sigma = (inverse[(j, j)] * chi).max(0.0).sqrt() / scale[j] / (2.0 * value.max(1e-300));
            found.sigma[*which] = sigma;
            *[
                &mut found.random_walk,
                &mut found.bias_instability,
                &mut found.rate_random_walk,
                &mut found.quantisation,
            ][*which] = value;
        }
        let model = |tau: f64| active.iter().enumerate().map(|(j, w)| x[j] / scale[j] * term(*w, tau)).sum::<f64>();
        let misfit: f64 = rows.iter().map(|(tau, s, _)| (model(*tau).max(0.0).sqrt() / s - 1.0).powi(2)).sum();
        found.residual = (misfit / rows.len() as f64).sqrt();
        return Ok(found);
    }
    Err(CalibrationError::Singular("no noise model describes the curve"))
}

const UNITS: [[&str; 4]; 2] = [["rad/s/√Hz", "rad/s", "rad/s²/√Hz", "rad"], ["m/s²/√Hz", "m/s²", "m/s³/√Hz", "m/s"]];
const COEFFICIENTS: [&str; 4] = ["random_walk", "bias_instability", "rate_random_walk", "quantisation"];

/// Noise of gyroscope and accelerometer (whichever there is) of a recording at rest.
///
/// # Errors
/// [`CalibrationError`]: NaN, too short, uneven samples, motion.
pub fn allan(samples: &[Sample]) -> Result<CalibrationFile, CalibrationError> {
    let mut file = CalibrationFile::new(Kind::Allan, samples.len(), 0.0, "of σ(τ), rms, worst axis");
    let mut variances = Vec::new();
    let mut any = false;
    for (which, (sensor, name)) in
        [(Channel::Gyroscope, "gyro"), (Channel::Accelerometer, "accel")].into_iter().enumerate()
    {
        let present = samples.iter().any(|s| match sensor {
            Channel::Gyroscope => s.gyro_radps.is_some(),
            _ => s.accel_mps2.is_some(),
        });
        if !present {
            continue;
        }
        any = true;
        let values = channel(samples, sensor, "samples of one sensor", SAMPLES_MIN)?;
        let period_s = even_period(&values)?;
        let mean = values.iter().map(|v| v.1).sum::<Vector3<f64>>() / values.len() as f64;
        let spread = (values.iter().map(|v| (v.1 - mean).norm_squared()).sum::<f64>() / values.len() as f64).sqrt();
        if spread > REST[which] {
            let (what, unit) = [("the angular rate", "rad/s"), ("the specific force", "m/s²")][which];
            return Err(CalibrationError::Moving { what, found: spread, limit: REST[which], unit });
        }
        let mut plot = Plot {
            title: format!("Allan deviation, {}", ["gyroscope", "accelerometer"][which]),
            x: "τ, s".into(),
            y: format!("σ(τ), {}", UNITS[which][1]),
            log: true,
            series: Vec::new(),
        };
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let rate: Vec<f64> = values.iter().map(|v| v.1[axis]).collect();
            let curve = deviation(&rate, period_s);
            let found = coefficients(&curve)?;
            let of = [found.random_walk, found.bias_instability, found.rate_random_walk, found.quantisation];
            for j in 0..4 {
                let parameter = format!("{name}_{letter}_{}", COEFFICIENTS[j]);
                file.push(&parameter, of[j], (of[j] > 0.0).then_some(found.sigma[j]), UNITS[which][j]);
                variances.push(found.sigma[j].powi(2));
            }
            file.residual.value = file.residual.value.max(found.residual);
            plot.series.push(Series::new(letter, true, curve.iter().map(|(tau, s, _)| [*tau, *s])));
        }
        file.picture.push(plot);
    }
    if !any {
        return Err(CalibrationError::TooFew { what: "samples of an IMU", found: 0, needed: SAMPLES_MIN });
    }
    let n = variances.len();
    file.covariance = (0..n).map(|i| (0..n).map(|j| if i == j { variances[i] } else { 0.0 }).collect()).collect();
    file.notes.push("a coefficient of 0 without sigma is not seen in this recording".into());
    Ok(file)
}

/// The sample period; refused where samples are missing or the recording is short.
fn even_period(values: &[(f64, Vector3<f64>)]) -> Result<f64, CalibrationError> {
    let duration = values.last().map_or(0.0, |v| v.0) - values.first().map_or(0.0, |v| v.0);
    if duration < DURATION_MIN_S {
        let what = "length of the recording";
        return Err(CalibrationError::TooSmall { what, found: duration, needed: DURATION_MIN_S, unit: "s" });
    }
    let period_s = duration / (values.len() - 1) as f64;
    for (index, pair) in values.windows(2).enumerate() {
        let step = pair[1].0 - pair[0].0;
        // A gap of a few samples in a long recording is filled by the mean without harm; a long one is not.
        if step > period_s * (20.0 + JITTER_MAX) {
            let what = format!("step after sample {index} (s)");
            return Err(CalibrationError::Value { what, value: step, expected: "shorter than 20 sample periods" });
        }
    }
    Ok(period_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::noise::{ScalarError, Stream};
    use crate::sensor::suite::Quality;

    /// Ten minutes at 100 Hz of the simulator's own error model.
    fn at_rest(sigma: f64, walk: f64) -> Vec<f64> {
        let quality =
            Quality { sigma, bias_sigma: 0.01, bias_walk: walk, resolution: 0.0, range: f64::MAX, gate_sigmas: 5.0 };
        let mut stream = Stream::new(5, "allan");
        let mut error = ScalarError::new(quality, 0.01, &mut stream);
        (0..60_000).map(|_| error.read(0.0, &mut stream)).collect()
    }

    #[test]
    fn white_noise_has_its_density_at_one_second() {
        let found = coefficients(&deviation(&at_rest(0.004, 0.0), 0.01)).unwrap();
        // σ √Δt.
        assert!((found.random_walk / 4e-4 - 1.0).abs() < 0.03, "{found:?}");
        // A walk this small is hidden below the white noise for the whole recording.
        assert!(found.rate_random_walk < 5e-6, "{found:?}");
        assert!(found.residual < 0.2, "{found:?}");
    }

    #[test]
    fn a_walking_bias_is_found_beside_it() {
        let found = coefficients(&deviation(&at_rest(0.004, 1e-3), 0.01)).unwrap();
        assert!((found.random_walk / 4e-4 - 1.0).abs() < 0.2, "{found:?}");
        // 600 s hold few long means: the walk is known to some 30 %.
        assert!((found.rate_random_walk / 1e-3 - 1.0).abs() < 0.35, "{found:?}");
    }

    #[test]
    fn a_file_of_both_sensors_and_what_is_refused() {
        let (rate, force) = (at_rest(0.004, 0.0), at_rest(0.1, 0.0));
        let mut samples: Vec<Sample> = rate
            .iter()
            .zip(&force)
            .enumerate()
            .map(|(k, (w, f))| Sample {
                time_s: k as f64 * 0.01,
                gyro_radps: Some(Vector3::new(*w, -w, *w)),
                accel_mps2: Some(Vector3::new(*f, *f, 9.81 + f)),
                ..Sample::default()
            })
            .collect();
        let file = allan(&samples).unwrap();
        assert!((file.value("accel_z_random_walk").unwrap() / 0.01 - 1.0).abs() < 0.03);
        assert_eq!(file.picture.len(), 2);
        let short = allan(&samples[..2000]).unwrap_err().to_string();
        assert!(short.contains("length of the recording is 19.990 s"), "{short}");
        for (k, sample) in samples.iter_mut().enumerate() {
            sample.gyro_radps = Some(Vector3::x() * (k as f64 * 0.1).sin());
        }
        assert!(allan(&samples).unwrap_err().to_string().contains("not at rest: the angular rate"));
        assert!(allan(&[]).is_err());
    }
}

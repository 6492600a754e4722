//! Temperature compensation: how the readings of an IMU at rest follow its die temperature.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | T, T₀ | die temperature, and the mean of the recording | °C |
//! | b(T) | drift of one axis: c₁ (T − T₀) + c₂ (T − T₀)² | rad/s, m/s² |
//!
//! c₂ is fitted only over a span of `SPAN_SQUARE_C` and more. The drift is zero at T₀: the bias there belongs to
//! the accelerometer's and the gyroscope's own calibration.

use nalgebra::{DMatrix, DVector, Vector3};

use super::samples::{Channel, Sample, channel};
use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};

/// Least span of temperature, °C.
const SPAN_MIN_C: f64 = 5.0;
/// From here on a square term, °C.
const SPAN_SQUARE_C: f64 = 15.0;
/// Samples for a fit.
const SAMPLES_MIN: usize = 500;
/// Means are taken over stretches of this many per recording.
const STRETCHES: usize = 200;
/// Standard deviation within a stretch at rest: rad/s, m/s².
const REST: [f64; 2] = [0.05, 0.5];

/// Drift of one IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// T₀, °C.
    pub reference_c: f64,
    /// c₁ and c₂ of the gyroscope, rad/s per °C and °C².
    pub gyro: [Vector3<f64>; 2],
    /// c₁ and c₂ of the accelerometer, m/s² per °C and °C².
    pub accel: [Vector3<f64>; 2],
}

impl Drift {
    /// Drift of gyroscope and accelerometer at `temperature_c`.
    pub fn at(&self, temperature_c: f64) -> (Vector3<f64>, Vector3<f64>) {
        let dt = temperature_c - self.reference_c;
        let of = |c: &[Vector3<f64>; 2]| c[0] * dt + c[1] * (dt * dt);
        (of(&self.gyro), of(&self.accel))
    }
}

const AXES: [(&str, &str); 6] = [
    ("gyro_x", "rad/s"),
    ("gyro_y", "rad/s"),
    ("gyro_z", "rad/s"),
    ("accel_x", "m/s²"),
    ("accel_y", "m/s²"),
    ("accel_z", "m/s²"),
];

/// The drift of a file.
///
/// # Errors
/// [`CalibrationError::File`] where a parameter is missing.
pub fn thermal_of(file: &CalibrationFile) -> Result<Drift, CalibrationError> {
    let mut linear = [0.0; 6];
    let mut square = [0.0; 6];
    for (i, (axis, _)) in AXES.iter().enumerate() {
        linear[i] = file.value(&format!("{axis}_per_c"))?;
        square[i] = file.value(&format!("{axis}_per_c2")).unwrap_or(0.0);
    }
    let three = |v: &[f64; 6], at: usize| Vector3::new(v[at], v[at + 1], v[at + 2]);
    Ok(Drift {
        reference_c: file.value("reference")?,
        gyro: [three(&linear, 0), three(&square, 0)],
        accel: [three(&linear, 3), three(&square, 3)],
    })
}

/// One sensor's reading and its time, s.
type Reading = (f64, Vector3<f64>);
/// Mean temperature of a stretch and the mean of each axis in it.
type Stretch = (f64, [f64; 6]);

/// Fits the drift of gyroscope and accelerometer to a recording at rest while the unit warms up or cools down.
///
/// # Errors
/// [`CalibrationError`]: NaN, too few samples, too small a span of temperature, motion.
pub fn thermal(samples: &[Sample]) -> Result<CalibrationFile, CalibrationError> {
    let warm: Vec<Sample> = samples.iter().filter(|s| s.temperature_c.is_some_and(f64::is_finite)).copied().collect();
    if warm.len() < SAMPLES_MIN {
        let what = "samples with a temperature";
        return Err(CalibrationError::TooFew { what, found: warm.len(), needed: SAMPLES_MIN });
    }
    let gyro = channel(&warm, Channel::Gyroscope, "gyroscope samples with a temperature", SAMPLES_MIN)?;
    let accel = channel(&warm, Channel::Accelerometer, "accelerometer samples with a temperature", SAMPLES_MIN)?;
    if gyro.len() != accel.len() || gyro.len() != warm.len() {
        let found = gyro.len().min(accel.len());
        return Err(CalibrationError::TooFew { what: "samples of both sensors", found, needed: warm.len() });
    }
    let temperature: Vec<f64> = warm.iter().filter_map(|s| s.temperature_c).collect();
    let (low, high) = temperature.iter().fold((f64::MAX, f64::MIN), |(l, h), t| (l.min(*t), h.max(*t)));
    let span = high - low;
    if span < SPAN_MIN_C {
        let what = "span of temperature";
        return Err(CalibrationError::TooSmall { what, found: span, needed: SPAN_MIN_C, unit: "°C" });
    }
    let rows = stretches(&temperature, &gyro, &accel)?;
    let reference = rows.iter().map(|r| r.0).sum::<f64>() / rows.len() as f64;
    let square = span >= SPAN_SQUARE_C;
    let unknowns = if square { 3 } else { 2 };
    let design = DMatrix::from_fn(rows.len(), unknowns, |i, j| (rows[i].0 - reference).powi(j as i32));
    let cholesky = design
        .tr_mul(&design)
        .cholesky()
        .ok_or(CalibrationError::Singular("the temperatures do not determine a drift"))?;
    let inverse = cholesky.inverse();
    let mut file = CalibrationFile::new(Kind::Thermal, rows.len(), 0.0, "relative to the spread before");
    file.push("reference", reference, None, "°C");
    let (mut left, mut before) = (0.0, 0.0);
    let mut variances = vec![0.0];
    for (axis, (name, unit)) in AXES.iter().enumerate() {
        let y = DVector::from_iterator(rows.len(), rows.iter().map(|r| r.1[axis]));
        let c = &inverse * design.tr_mul(&y);
        let residual = &y - &design * &c;
        let variance = residual.norm_squared() / (rows.len() - unknowns).max(1) as f64;
        let spread = y.add_scalar(-y.mean());
        left += residual.norm_squared() / variance.max(1e-300);
        before += spread.norm_squared() / variance.max(1e-300);
        for j in 1..unknowns {
            let of = variance * inverse[(j, j)];
            let suffix = if j == 1 { "per_c" } else { "per_c2" };
            let per = if j == 1 { "°C" } else { "°C²" };
            file.push(&format!("{name}_{suffix}"), c[j], Some(of.max(0.0).sqrt()), &format!("{unit}/{per}"));
            variances.push(of);
        }
        let fit = |t: f64| -> f64 { (0..unknowns).map(|j| c[j] * (t - reference).powi(j as i32)).sum() };
        file.picture.push(picture(name, unit, rows.iter().map(|r| [r.0, r.1[axis]]), fit));
    }
    file.residual.value = (left / before.max(1e-300)).sqrt();
    let n = variances.len();
    // Axes are independent; the coefficients of one axis nearly so about the mean temperature.
    file.covariance = (0..n).map(|i| (0..n).map(|j| if i == j { variances[i] } else { 0.0 }).collect()).collect();
    file.notes.push(format!("temperature from {low:.1} to {high:.1} °C"));
    if !square {
        file.notes.push(format!("a square term takes {SPAN_SQUARE_C} °C"));
    }
    Ok(file)
}

/// The recording in stretches, each of them at rest.
fn stretches(temperature: &[f64], gyro: &[Reading], accel: &[Reading]) -> Result<Vec<Stretch>, CalibrationError> {
    let samples = temperature.len();
    let per = samples.div_ceil(STRETCHES);
    let mut rows = Vec::new();
    for first in (0..samples).step_by(per) {
        let end = (first + per).min(samples);
        if end - first < per.min(3) {
            continue;
        }
        let n = (end - first) as f64;
        let mean = |list: &[Reading]| list[first..end].iter().map(|v| v.1).sum::<Vector3<f64>>() / n;
        let (g, a) = (mean(gyro), mean(accel));
        for (list, centre, limit, what, unit) in
            [(gyro, g, REST[0], "the angular rate", "rad/s"), (accel, a, REST[1], "the specific force", "m/s²")]
        {
            let spread = (list[first..end].iter().map(|v| (v.1 - centre).norm_squared()).sum::<f64>() / n).sqrt();
            if spread > limit {
                return Err(CalibrationError::Moving { what, found: spread, limit, unit });
            }
        }
        rows.push((temperature[first..end].iter().sum::<f64>() / n, [g.x, g.y, g.z, a.x, a.y, a.z]));
    }
    Ok(rows)
}

/// What one axis read at each temperature, and the fit through it.
fn picture(name: &str, unit: &str, readings: impl Iterator<Item = [f64; 2]> + Clone, fit: impl Fn(f64) -> f64) -> Plot {
    let mut line: Vec<[f64; 2]> = readings.clone().map(|[t, _]| [t, fit(t)]).collect();
    line.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Plot {
        title: format!("{name} at rest"),
        x: "temperature, °C".into(),
        y: unit.to_owned(),
        log: false,
        series: vec![Series::new("reading", false, readings), Series::new("fit", true, line)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::noise::Stream;

    fn warming(span_c: f64, shaken: f64) -> Vec<Sample> {
        let mut stream = Stream::new(3, "thermal");
        (0..20_000)
            .map(|k| {
                let t = f64::from(k) * 0.01;
                let dt = span_c * (1.0 - (-t / 60.0).exp());
                let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * stream.normal());
                Sample {
                    time_s: t,
                    gyro_radps: Some(
                        Vector3::new(1e-3, -2e-3, 5e-4) * dt
                            + Vector3::new(0.01, 0.0, 0.0)
                            + noise(0.004)
                            + Vector3::x() * (shaken * (7.0 * t).sin()),
                    ),
                    accel_mps2: Some(Vector3::new(0.0, 4e-4 * dt * dt, 9.81 + 0.02 * dt) + noise(0.1)),
                    temperature_c: Some(22.0 + dt),
                    ..Sample::default()
                }
            })
            .collect()
    }

    #[test]
    fn drift_is_found_and_taken_off() {
        let samples = warming(20.0, 0.0);
        let drift = thermal_of(&thermal(&samples).unwrap()).unwrap();
        let (start, end) = (drift.at(22.0), drift.at(42.0));
        // Between the ends the known drift, whatever the reference.
        assert!((end.0 - start.0 - Vector3::new(0.02, -0.04, 0.01)).amax() < 5e-4, "{}", end.0 - start.0);
        assert!((end.1 - start.1 - Vector3::new(0.0, 0.16, 0.4)).amax() < 0.02, "{}", end.1 - start.1);
        assert_eq!(drift.at(drift.reference_c), (Vector3::zeros(), Vector3::zeros()));
    }

    #[test]
    fn a_constant_temperature_and_motion_are_refused() {
        let text = thermal(&warming(2.0, 0.0)).unwrap_err().to_string();
        assert!(text.contains("span of temperature is 1.9"), "{text}");
        let text = thermal(&warming(20.0, 1.0)).unwrap_err().to_string();
        assert!(text.contains("not at rest: the angular rate"), "{text}");
        assert!(thermal(&[Sample::default(); 600]).unwrap_err().to_string().contains("with a temperature"));
    }
}

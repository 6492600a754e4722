//! Thrust and drag torque of a propeller, from a static test: T = k ω², Q = b ω².
//!
//! Least squares in thrust (and torque), over all points: full speed weighs most, as it does in flight. This is
//! how k = 1.616e-5 N s² was obtained for an APC Slow Flyer 10x4.7 from the UIUC static data, at the density of the
//! standard atmosphere; the coefficient really grows with speed, which leaves a relative residual of 9 %. Points
//! more than `OUTLIER` sigmas off are left out (a slipped belt, a gust), and said so.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | ω, n | speed, in rad/s and in rev/s | |
//! | C_T, C_P | coefficients of the tunnel: T = C_T ρ n² D⁴, P = C_P ρ n³ D⁵ | |

use super::fit::median;
use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};

/// Points for a fit.
const POINTS_MIN: usize = 4;
/// Fastest over slowest point.
const SPEED_RATIO_MIN: f64 = 1.3;
/// A point is left out beyond this many sigmas (1.4826 median).
const OUTLIER: f64 = 6.0;
/// Largest relative residual.
const RESIDUAL_MAX: f64 = 0.25;
/// Density of the standard atmosphere at sea level, kg/m³.
pub const AIR_DENSITY_KGPM3: f64 = 1.225;

/// One point of a static test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Speed, rad/s.
    pub speed_radps: f64,
    /// Thrust, N.
    pub thrust_n: f64,
    /// Torque about the axis, N m, where measured.
    pub torque_nm: Option<f64>,
}

impl Point {
    /// From the coefficients of a tunnel: `rpm`, diameter, air density.
    pub fn from_coefficients(rpm: f64, ct: f64, cp: Option<f64>, diameter_m: f64, density_kgpm3: f64) -> Self {
        let n = rpm / 60.0;
        let speed_radps = n * std::f64::consts::TAU;
        let power = |cp: f64| cp * density_kgpm3 * n.powi(3) * diameter_m.powi(5);
        Self {
            speed_radps,
            thrust_n: ct * density_kgpm3 * n * n * diameter_m.powi(4),
            torque_nm: cp.map(|cp| power(cp) / speed_radps),
        }
    }
}

/// What y = c ω² leaves.
struct Coefficient {
    value: f64,
    sigma: f64,
    /// Root mean square of the residuals over y.
    relative: f64,
    left_out: usize,
}

fn coefficient(points: &[(f64, f64)], what: &'static str) -> Result<Coefficient, CalibrationError> {
    let mut kept: Vec<(f64, f64)> = points.to_vec();
    let of = |list: &[(f64, f64)]| {
        let (xy, xx) = list.iter().fold((0.0, 0.0), |(xy, xx), (x, y)| (xy + x * y, xx + x * x));
        (xy / xx, xx)
    };
    for _ in 0..3 {
        // Judged by y/ω²: the same for every point but for noise.
        let mut ratios: Vec<f64> = kept.iter().map(|(x, y)| y / x).collect();
        let middle = median(&mut ratios).unwrap_or(0.0);
        let mut off: Vec<f64> = kept.iter().map(|(x, y)| (y / x - middle).abs()).collect();
        let sigma = (1.4826 * median(&mut off).unwrap_or(0.0)).max(1e-3 * middle.abs());
        let before = kept.len();
        kept.retain(|(x, y)| (y / x - middle).abs() <= OUTLIER * sigma);
        if kept.len() == before {
            break;
        }
    }
    if kept.len() < POINTS_MIN {
        return Err(CalibrationError::TooFew { what, found: kept.len(), needed: POINTS_MIN });
    }
    let (value, xx) = of(&kept);
    let n = kept.len() as f64;
    let variance = kept.iter().map(|(x, y)| (y - value * x).powi(2)).sum::<f64>() / (n - 1.0);
    let relative = (kept.iter().map(|(x, y)| (1.0 - value * x / y).powi(2)).sum::<f64>() / n).sqrt();
    Ok(Coefficient { value, sigma: (variance / xx).sqrt(), relative, left_out: points.len() - kept.len() })
}

/// Fits k and, where torques are given, b.
///
/// # Errors
/// [`CalibrationError`]: a value that is not finite or not positive, too few points, one speed only, a bad fit.
pub fn thrust(points: &[Point]) -> Result<CalibrationFile, CalibrationError> {
    for (index, point) in points.iter().enumerate() {
        let torque = point.torque_nm.unwrap_or(1.0);
        for (what, value) in [("speed", point.speed_radps), ("thrust", point.thrust_n), ("torque", torque)] {
            if !value.is_finite() {
                return Err(CalibrationError::NotFinite { channel: what, index, value });
            }
            if value <= 0.0 {
                let what = format!("{what} of point {index}");
                return Err(CalibrationError::Value { what, value, expected: "above 0" });
            }
        }
    }
    if points.len() < POINTS_MIN {
        return Err(CalibrationError::TooFew { what: "points", found: points.len(), needed: POINTS_MIN });
    }
    let speeds = points.iter().map(|p| p.speed_radps);
    let ratio = speeds.clone().fold(0.0, f64::max) / speeds.fold(f64::MAX, f64::min);
    if ratio < SPEED_RATIO_MIN {
        let what = "fastest over slowest speed";
        return Err(CalibrationError::TooSmall { what, found: ratio, needed: SPEED_RATIO_MIN, unit: "" });
    }
    let squares: Vec<(f64, f64)> = points.iter().map(|p| (p.speed_radps.powi(2), p.thrust_n)).collect();
    let k = coefficient(&squares, "points that agree")?;
    if k.relative > RESIDUAL_MAX {
        return Err(CalibrationError::BadFit { found: k.relative, limit: RESIDUAL_MAX, unit: "of the thrust" });
    }
    let mut file = CalibrationFile::new(Kind::Thrust, points.len() - k.left_out, k.relative, "of the thrust, rms");
    file.push("thrust_coefficient", k.value, Some(k.sigma), "N s²");
    file.covariance = vec![vec![k.sigma * k.sigma]];
    if k.left_out > 0 {
        file.notes.push(format!("{} points left out: more than {OUTLIER} sigmas off", k.left_out));
    }
    picture(&mut file, "Thrust", "thrust, N", &squares, k.value);
    let torques: Vec<(f64, f64)> = points.iter().filter_map(|p| Some((p.speed_radps.powi(2), p.torque_nm?))).collect();
    if torques.len() >= POINTS_MIN {
        let b = coefficient(&torques, "torques that agree")?;
        file.push("drag_torque_coefficient", b.value, Some(b.sigma), "N m s²");
        file.covariance = vec![vec![k.sigma * k.sigma, 0.0], vec![0.0, b.sigma * b.sigma]];
        file.notes.push(format!("torque: residual {:.1} % rms", 100.0 * b.relative));
        picture(&mut file, "Drag torque", "torque, N m", &torques, b.value);
    }
    Ok(file)
}

fn picture(file: &mut CalibrationFile, title: &str, y: &str, points: &[(f64, f64)], slope: f64) {
    let most = points.iter().map(|p| p.0).fold(0.0, f64::max);
    file.picture.push(Plot {
        title: title.to_owned(),
        x: "speed squared, rad²/s²".into(),
        y: y.to_owned(),
        log: false,
        series: vec![
            Series::new("measured", false, points.iter().map(|(x, y)| [*x, *y])),
            Series::new("fit", true, [[0.0, 0.0], [most, slope * most]]),
        ],
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bench(k: f64, b: f64) -> Vec<Point> {
        (4..=12)
            .map(|i| f64::from(i) * 80.0)
            .map(|w| Point { speed_radps: w, thrust_n: k * w * w, torque_nm: Some(b * w * w) })
            .collect()
    }

    #[test]
    fn coefficients_of_a_bench_and_an_outlier_left_out() {
        let mut points = bench(1.5e-5, 2.4e-7);
        points[3].thrust_n *= 3.0;
        let file = thrust(&points).unwrap();
        assert!((file.value("thrust_coefficient").unwrap() / 1.5e-5 - 1.0).abs() < 1e-9);
        assert!((file.value("drag_torque_coefficient").unwrap() / 2.4e-7 - 1.0).abs() < 1e-9);
        assert!(file.notes[0].contains("1 points left out"), "{:?}", file.notes);
    }

    #[test]
    fn bad_points_are_refused() {
        let refuse = |points: &[Point], expected: &str| {
            let text = thrust(points).unwrap_err().to_string();
            assert!(text.contains(expected), "{text}");
        };
        refuse(&bench(1e-5, 1e-7)[..3], "3 points");
        let mut nan = bench(1e-5, 1e-7);
        nan[2].thrust_n = f64::NAN;
        refuse(&nan, "sample 2: thrust is NaN");
        nan[2].thrust_n = -1.0;
        refuse(&nan, "thrust of point 2 is -1, not above 0");
        let same = vec![bench(1e-5, 1e-7)[0]; 9];
        refuse(&same, "fastest over slowest speed");
    }
}

//! Command ─► rotor speed ─► speed squared, and back.
//!
//! \[Clinic\] 5.5 measures propeller speed against the pulse width with a tachometer and fits a straight
//! line through eight points: speed = offset + slope · command. The command here is the pulse width
//! scaled to 0..1 (1000..2000 µs). A motor told 0 stands still, so the line holds above 0 only.
//! The line is measured at the battery's nominal voltage; a brushless motor's speed at a given command
//! is proportional to the voltage, hence `voltage_ratio` = voltage / nominal voltage.

use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};
use crate::model::motor_curve::MotorCurve;

/// Points for a line with a residual.
const POINTS_MIN: usize = 3;
/// Least span of the commands.
const SPAN_MIN: f64 = 0.2;
/// Largest residual, as a fraction of the fastest speed.
const RESIDUAL_MAX: f64 = 0.1;

/// Least-squares line through `(command 0..1, speed rad/s)` points, all taken at nominal voltage (\[Clinic\] Fig. 27).
///
/// # Errors
/// [`CalibrationError`]: a value that is not finite or out of range, too few points, commands too near to each
/// other, a slope that is not positive, points that lie on no line.
pub fn motor_curve(points: &[(f64, f64)]) -> Result<CalibrationFile, CalibrationError> {
    for (index, &(command, speed)) in points.iter().enumerate() {
        for (channel, value) in [("command", command), ("speed", speed)] {
            if !value.is_finite() {
                return Err(CalibrationError::NotFinite { channel, index, value });
            }
        }
        if !(0.0..=1.0).contains(&command) {
            let what = format!("command of point {index}");
            return Err(CalibrationError::Value { what, value: command, expected: "0 to 1" });
        }
        if speed < 0.0 {
            let what = format!("speed of point {index}");
            return Err(CalibrationError::Value { what, value: speed, expected: "0 or above" });
        }
    }
    // A motor that stands still is not on its line.
    let running: Vec<(f64, f64)> = points.iter().copied().filter(|(c, s)| *c > 0.0 && *s > 0.0).collect();
    if running.len() < POINTS_MIN {
        let what = "points of a turning motor";
        return Err(CalibrationError::TooFew { what, found: running.len(), needed: POINTS_MIN });
    }
    let commands = running.iter().map(|p| p.0);
    let span = commands.clone().fold(0.0, f64::max) - commands.fold(1.0, f64::min);
    if span < SPAN_MIN {
        let what = "span of the commands";
        return Err(CalibrationError::TooSmall { what, found: span, needed: SPAN_MIN, unit: "" });
    }
    let n = running.len() as f64;
    let mean_command = running.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_speed = running.iter().map(|p| p.1).sum::<f64>() / n;
    let spread: f64 = running.iter().map(|p| (p.0 - mean_command).powi(2)).sum();
    let slope = running.iter().map(|p| (p.0 - mean_command) * (p.1 - mean_speed)).sum::<f64>() / spread;
    let curve = MotorCurve { offset_radps: mean_speed - slope * mean_command, slope_radps: slope };
    let line = |c: f64| curve.offset_radps + slope * c;
    let left = running.iter().map(|(c, s)| (s - line(*c)).powi(2)).sum::<f64>();
    let rms = (left / n).sqrt();
    let fastest = running.iter().map(|p| p.1).fold(0.0, f64::max);
    if slope <= 0.0 {
        let what = "slope (rad/s)".to_owned();
        return Err(CalibrationError::Value { what, value: slope, expected: "above 0" });
    }
    if rms > RESIDUAL_MAX * fastest {
        return Err(CalibrationError::BadFit { found: rms, limit: RESIDUAL_MAX * fastest, unit: "rad/s" });
    }
    let variance = left / (n - 2.0);
    let (slope_variance, cross) = (variance / spread, -variance * mean_command / spread);
    let offset_variance = variance / n + mean_command.powi(2) * slope_variance;
    let mut file = CalibrationFile::new(Kind::MotorCurve, running.len(), rms, "rad/s");
    file.push("offset", curve.offset_radps, Some(offset_variance.sqrt()), "rad/s");
    file.push("slope", slope, Some(slope_variance.sqrt()), "rad/s");
    file.covariance = vec![vec![offset_variance, cross], vec![cross, slope_variance]];
    let squared = |w: f64| w * w;
    file.picture.push(Plot {
        title: "Motor".into(),
        x: "command".into(),
        y: "speed, rad/s".into(),
        log: false,
        series: vec![
            Series::new("measured", false, running.iter().map(|(c, s)| [*c, *s])),
            Series::new("fit", true, [[0.0, line(0.0)], [1.0, line(1.0)]]),
        ],
    });
    file.picture.push(Plot {
        title: "Motor, as thrust sees it".into(),
        x: "command".into(),
        y: "speed squared, rad²/s²".into(),
        log: false,
        series: vec![
            Series::new("measured", false, running.iter().map(|(c, s)| [*c, squared(*s)])),
            Series::new("fit", true, (0..=50).map(|k| f64::from(k) / 50.0).map(|c| [c, squared(line(c))])),
        ],
    });
    Ok(file)
}

/// The curve of a file.
///
/// # Errors
/// [`CalibrationError::File`] where a parameter is missing.
pub fn motor_curve_of(file: &CalibrationFile) -> Result<MotorCurve, CalibrationError> {
    Ok(MotorCurve { offset_radps: file.value("offset")?, slope_radps: file.value("slope")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVE: MotorCurve = MotorCurve { offset_radps: 100.0, slope_radps: 1000.0 };

    #[test]
    fn command_inverts_speed_at_any_voltage() {
        for voltage_ratio in [0.8, 1.0, 1.1] {
            for command in [0.001, 0.3, 0.7, 1.0] {
                let speed = CURVE.speed_radps(command, voltage_ratio);
                assert!((CURVE.command(speed, voltage_ratio) - command).abs() < 1e-12);
            }
        }
        assert_eq!(CURVE.speed_radps(0.0, 1.0), 0.0);
        assert_eq!(CURVE.command(0.0, 1.0), 0.0);
        assert_eq!(CURVE.command(5000.0, 1.0), 1.0);
        assert_eq!(CURVE.speed_radps(2.0, 1.0), 1100.0);
    }

    #[test]
    fn fit_finds_the_line_and_names_bad_points() {
        let mut points: Vec<_> = (1..=8).map(|i| f64::from(i) / 10.0).map(|c| (c, 100.0 + 1000.0 * c)).collect();
        points.push((0.0, 0.0));
        let fitted = motor_curve_of(&motor_curve(&points).unwrap()).unwrap();
        assert!((fitted.offset_radps - 100.0).abs() < 1e-9 && (fitted.slope_radps - 1000.0).abs() < 1e-9);
        let text = |points: &[(f64, f64)]| motor_curve(points).unwrap_err().to_string();
        assert!(text(&[(0.5, 1.0)]).contains("1 points of a turning motor"));
        assert!(text(&[(0.5, 1.0), (0.5, 2.0), (0.5, 3.0)]).contains("span of the commands is 0.000"));
        assert_eq!(text(&[(0.5, 1.0), (0.6, f64::NAN)]), "sample 1: speed is NaN, not a finite number");
        assert!(text(&[(1.5, 1.0)]).contains("command of point 0 is 1.5, not 0 to 1"));
        assert!(text(&[(0.1, 900.0), (0.5, 500.0), (0.9, 100.0)]).contains("slope (rad/s) is -"));
        assert!(text(&[(0.1, 10.0), (0.5, 900.0), (0.9, 100.0)]).contains("the model does not fit"));
    }
}

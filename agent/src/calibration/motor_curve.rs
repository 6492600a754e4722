//! Command ─► rotor speed ─► speed squared, and back.
//!
//! [Clinic] 5.5 measures propeller speed against the pulse width with a tachometer and fits a straight
//! line through eight points: speed = offset + slope · command. The command here is the pulse width
//! scaled to 0..1 (1000..2000 µs). A motor told 0 stands still, so the line holds above 0 only.
//! The line is measured at the battery's nominal voltage; a brushless motor's speed at a given command
//! is proportional to the voltage, hence `voltage_ratio` = voltage / nominal voltage.

use serde::Deserialize;

/// A motor's measured line, at nominal voltage.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorCurve {
    /// Speed just above command 0, rad/s.
    pub offset_radps: f64,
    /// Speed gained from command 0 to command 1, rad/s.
    pub slope_radps: f64,
}

/// Why no line can be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// A line needs two points.
    #[error("{0} points are too few for a line, 2 are needed")]
    TooFewPoints(usize),
    /// Every point has the same command.
    #[error("all commands are {0}, the slope is unknown")]
    SameCommand(f64),
    /// A point is not finite.
    #[error("point {index} is not finite: command {command}, speed {speed_radps} rad/s")]
    NotFinite {
        /// Which point, from 0.
        index: usize,
        /// Its command.
        command: f64,
        /// Its speed, rad/s.
        speed_radps: f64,
    },
}

impl MotorCurve {
    /// Least-squares line through `(command 0..1, speed rad/s)` points ([Clinic] Fig. 27).
    ///
    /// # Errors
    /// When the points do not define a line.
    pub fn fit(points: &[(f64, f64)]) -> Result<Self, FitError> {
        if let Some((index, &(command, speed_radps))) =
            points.iter().enumerate().find(|(_, (c, s))| !c.is_finite() || !s.is_finite())
        {
            return Err(FitError::NotFinite { index, command, speed_radps });
        }
        let Some(&(first, _)) = points.first().filter(|_| points.len() >= 2) else {
            return Err(FitError::TooFewPoints(points.len()));
        };
        let n = points.len() as f64;
        let mean_command = points.iter().map(|p| p.0).sum::<f64>() / n;
        let mean_speed = points.iter().map(|p| p.1).sum::<f64>() / n;
        let spread: f64 = points.iter().map(|p| (p.0 - mean_command).powi(2)).sum();
        if spread <= 0.0 {
            return Err(FitError::SameCommand(first));
        }
        let slope_radps = points.iter().map(|p| (p.0 - mean_command) * (p.1 - mean_speed)).sum::<f64>() / spread;
        Ok(Self { offset_radps: mean_speed - slope_radps * mean_command, slope_radps })
    }

    /// Steady speed for `command` (clipped to 0..1), rad/s. 0 stands still.
    pub fn speed_radps(&self, command: f64, voltage_ratio: f64) -> f64 {
        if command > 0.0 {
            (self.offset_radps + self.slope_radps * command.min(1.0)).max(0.0) * voltage_ratio
        } else {
            0.0
        }
    }

    /// The command (0..1) that gives `speed_radps`; below the line's start the smallest running
    /// command, 0 only when asked to stand still.
    pub fn command(&self, speed_radps: f64, voltage_ratio: f64) -> f64 {
        if speed_radps <= 0.0 || voltage_ratio <= 0.0 || self.slope_radps <= 0.0 {
            return 0.0;
        }
        ((speed_radps / voltage_ratio - self.offset_radps) / self.slope_radps).clamp(SMALLEST_RUNNING_COMMAND, 1.0)
    }

    /// Fastest steady speed at nominal voltage, rad/s.
    pub fn full_speed_radps(&self) -> f64 {
        self.speed_radps(1.0, 1.0)
    }
}

/// A command that keeps a motor turning at the foot of its line.
pub const SMALLEST_RUNNING_COMMAND: f64 = 1e-6;

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
        let points: Vec<_> = (1..=8).map(|i| f64::from(i) / 10.0).map(|c| (c, 100.0 + 1000.0 * c)).collect();
        let fitted = MotorCurve::fit(&points).unwrap();
        assert!((fitted.offset_radps - 100.0).abs() < 1e-9 && (fitted.slope_radps - 1000.0).abs() < 1e-9);
        assert_eq!(MotorCurve::fit(&[(0.5, 1.0)]), Err(FitError::TooFewPoints(1)));
        assert_eq!(MotorCurve::fit(&[(0.5, 1.0), (0.5, 2.0)]), Err(FitError::SameCommand(0.5)));
        let text = MotorCurve::fit(&[(0.5, 1.0), (0.6, f64::NAN)]).unwrap_err().to_string();
        assert!(text.contains("point 1") && text.contains("NaN"), "{text}");
    }
}

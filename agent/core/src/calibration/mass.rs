//! Mass and inertia: the mass from scales, the inertia from a bifilar pendulum or entered as known.
//!
//! Hung level on two parallel strings of length L, D apart, a body turning about the vertical swings with period
//! P, and its inertia about that axis is I = m g D² P² / (16 π² L) (small swings, strings to both sides of the
//! centre of mass; e.g. Jardin & Mueller, "Optimized measurements of unmanned-air-vehicle mass moment of inertia
//! with a bifilar pendulum", 2009).

use super::{CalibrationError, CalibrationFile, Kind};
use crate::types::GRAVITY_MPS2;

/// What is known of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Axis {
    /// Inertia, kg m².
    Known(f64),
    /// Swings of a bifilar pendulum.
    Pendulum {
        /// Period, s.
        period_s: f64,
        /// Length of the strings, m.
        length_m: f64,
        /// Between the strings, m.
        separation_m: f64,
    },
}

/// Relative one-sigma of a period timed by hand over many swings (chosen).
const PERIOD_SIGMA: f64 = 0.01;
/// Relative one-sigma of lengths and masses read off (chosen).
const READ_SIGMA: f64 = 0.005;

/// Mass and the three principal inertias.
///
/// # Errors
/// [`CalibrationError`] for a value that is not finite or not positive, or inertias no body has.
pub fn mass(mass_kg: f64, axes: &[Axis; 3]) -> Result<CalibrationFile, CalibrationError> {
    let positive = |what: &str, value: f64| {
        if value.is_finite() && value > 0.0 {
            Ok(value)
        } else {
            Err(CalibrationError::Value { what: what.to_owned(), value, expected: "a number above 0" })
        }
    };
    positive("mass (kg)", mass_kg)?;
    let mut file = CalibrationFile::new(Kind::Mass, 1, 0.0, "kg");
    file.push("mass", mass_kg, Some(READ_SIGMA * mass_kg), "kg");
    let mut inertia = [0.0; 3];
    for ((axis, name), slot) in axes.iter().zip(["x", "y", "z"]).zip(&mut inertia) {
        let (value, sigma) = match *axis {
            Axis::Known(value) => (positive(&format!("inertia {name} (kg m²)"), value)?, None),
            Axis::Pendulum { period_s, length_m, separation_m } => {
                let p = positive(&format!("period {name} (s)"), period_s)?;
                let l = positive(&format!("length {name} (m)"), length_m)?;
                let d = positive(&format!("separation {name} (m)"), separation_m)?;
                let i = mass_kg * GRAVITY_MPS2 * d * d * p * p / (16.0 * std::f64::consts::PI.powi(2) * l);
                // Periods and distances count twice, mass and length once.
                let relative = (2.0 * PERIOD_SIGMA).hypot(6.0_f64.sqrt() * READ_SIGMA);
                (i, Some(relative * i))
            }
        };
        *slot = value;
        file.push(&format!("inertia_{name}"), value, sigma, "kg m²");
    }
    let [x, y, z] = inertia;
    // No distribution of mass breaks the triangle inequality.
    for (name, one, others) in [("x", x, y + z), ("y", y, x + z), ("z", z, x + y)] {
        if one > others * 1.02 {
            let what = format!("inertia {name} (kg m²)");
            return Err(CalibrationError::Value { what, value: one, expected: "at most the sum of the other two" });
        }
    }
    let variance = |s: Option<f64>| s.map_or(0.0, |s| s * s);
    let n = file.parameters.len();
    let diagonal: Vec<f64> = file.parameters.iter().map(|p| variance(p.sigma)).collect();
    file.covariance = (0..n).map(|i| (0..n).map(|j| if i == j { diagonal[i] } else { 0.0 }).collect()).collect();
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rod_on_two_strings_has_the_inertia_of_a_rod() {
        // A rod of 1.2 kg and 1 m has I = mL²/12 = 0.1; on strings 0.8 m apart and 2 m long it swings with this period.
        let inertia: f64 = 0.1;
        let period_s = (16.0 * std::f64::consts::PI.powi(2) * 2.0 * inertia / (1.2 * GRAVITY_MPS2 * 0.64)).sqrt();
        let pendulum = Axis::Pendulum { period_s, length_m: 2.0, separation_m: 0.8 };
        let file = mass(1.2, &[Axis::Known(0.01), pendulum, pendulum]).unwrap();
        assert!((file.value("inertia_y").unwrap() - inertia).abs() < 1e-12);
        assert!(file.parameters[3].sigma.unwrap() > 0.0);
    }

    #[test]
    fn impossible_values_are_named() {
        let text = |kg: f64, axes: [f64; 3]| mass(kg, &axes.map(Axis::Known)).unwrap_err().to_string();
        assert!(text(-1.0, [0.1; 3]).contains("mass (kg) is -1"));
        assert!(text(1.0, [0.1, f64::NAN, 0.1]).contains("inertia y (kg m²) is NaN"));
        assert!(text(1.0, [0.1, 0.1, 0.3]).contains("inertia z (kg m²) is 0.3, not at most the sum"));
    }
}

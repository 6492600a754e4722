//! Barometer: altitude above the level where the pressure is p₀.
//!
//! [Strategies], errata 10: h = 44330 (1 − (p/p₀)^(1/5.255)); the exponent belongs to the ratio alone.
//! The altitude of a barometer wanders with the weather, with the room's doors and with every unit, so an
//! estimator carries an offset: y = z + offset.

use nalgebra::Vector3;

use super::{Kinematics, Row};

/// Standard pressure at sea level, Pa.
pub const STANDARD_PRESSURE_PA: f64 = 101_325.0;

/// Altitude (m) above the level of pressure `reference_pa` at which the pressure is `pressure_pa`.
/// NaN when either is not positive.
pub fn pressure_altitude_m(pressure_pa: f64, reference_pa: f64) -> f64 {
    if pressure_pa > 0.0 && reference_pa > 0.0 {
        44_330.0 * (1.0 - (pressure_pa / reference_pa).powf(1.0 / 5.255))
    } else {
        f64::NAN
    }
}

/// Pressure (Pa) at `altitude_m` above the level of `reference_pa`: the inverse.
pub fn pressure_pa(altitude_m: f64, reference_pa: f64) -> f64 {
    reference_pa * (1.0 - altitude_m / 44_330.0).max(0.0).powf(5.255)
}

/// Row of one barometric altitude; the offset's own row is 1.
pub fn altitude(state: &Kinematics, altitude_m: f64, offset_m: f64) -> Row {
    Row::new(altitude_m - state.position_enu_m.z - offset_m).position(Vector3::z())
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn altitude_of_900_hpa_is_that_of_the_errata() {
        // ERRATA [Strategies] 10: 900 hPa gives 988.65 m.
        assert!((pressure_altitude_m(90_000.0, STANDARD_PRESSURE_PA) - 988.65).abs() < 0.01);
        for altitude_m in [-100.0, 0.0, 1.0, 2500.0] {
            let back = pressure_altitude_m(pressure_pa(altitude_m, 100_000.0), 100_000.0);
            assert!((back - altitude_m).abs() < 1e-6, "{altitude_m}: {back}");
        }
        assert!(pressure_altitude_m(-1.0, STANDARD_PRESSURE_PA).is_nan());
    }

    #[test]
    fn jacobian_matches_differences() {
        check::jacobian(&check::state(), |s| altitude(s, 101.0, 99.0), 1e-8);
    }
}

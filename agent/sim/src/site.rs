//! The place where the vehicle flies: what GNSS, barometer, thermometer and magnetometer see of it.

use nalgebra::Vector3;
use serde::Deserialize;

use plumbline_core::sensor::barometer::{STANDARD_PRESSURE_PA, pressure_pa};

/// Semi-major axis of WGS 84, m.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// First eccentricity squared of WGS 84.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_141e-3;

/// A laboratory somewhere on the Earth. The world's origin is its floor.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Site {
    /// Latitude of the origin, degrees.
    pub latitude_deg: f64,
    /// Longitude of the origin, degrees.
    pub longitude_deg: f64,
    /// Altitude of the floor, m.
    pub altitude_m: f64,
    /// The Earth's field, ENU, µT.
    pub magnetic_field_enu_ut: Vector3<f64>,
    /// Room temperature, °C.
    pub temperature_c: f64,
}

impl Default for Site {
    /// Montevideo, where [Paternain] flew, without its declination: magnetic north is true north, so that
    /// yaw zero is east in every default. The field is 22.6 µT, dipping 38° upwards as it does there.
    fn default() -> Self {
        Self {
            latitude_deg: -34.918,
            longitude_deg: -56.167,
            altitude_m: 30.0,
            magnetic_field_enu_ut: Vector3::new(0.0, 17.8, 13.9),
            temperature_c: 22.0,
        }
    }
}

impl Site {
    /// Declination of its field, rad, east of north positive.
    pub fn declination_rad(&self) -> f64 {
        self.magnetic_field_enu_ut.x.atan2(self.magnetic_field_enu_ut.y)
    }

    /// Standard pressure at `height_m` above the floor, Pa.
    pub fn pressure_pa(&self, height_m: f64) -> f64 {
        pressure_pa(self.altitude_m + height_m, STANDARD_PRESSURE_PA)
    }

    /// Latitude, longitude (deg) and altitude (m) of a place near the origin, to second order: the
    /// horizontal error is millimetres within a kilometre. Altitude is counted from the tangent plane.
    pub fn geodetic(&self, position_enu_m: &Vector3<f64>) -> [f64; 3] {
        let latitude_rad = self.latitude_deg.to_radians();
        let (sin, cos) = latitude_rad.sin_cos();
        let w2 = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let prime_vertical = SEMI_MAJOR_M / w2.sqrt() + self.altitude_m;
        let meridian = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / (w2 * w2.sqrt()) + self.altitude_m;
        let (x, y) = (position_enu_m.x, position_enu_m.y);
        // The parallel bends away from the east line; the meridians converge.
        let north = (y - x * x * sin / cos / (2.0 * prime_vertical)) / meridian;
        let east = x / (prime_vertical * (latitude_rad + north).cos());
        [
            self.latitude_deg + north.to_degrees(),
            self.longitude_deg + east.to_degrees(),
            self.altitude_m + position_enu_m.z,
        ]
    }

    /// The first value that makes no sense: key, value, what it should be.
    pub fn fault(&self) -> Option<(&'static str, f64, &'static str)> {
        let f = self.magnetic_field_enu_ut;
        [
            ("site.latitude_deg", self.latitude_deg, 89.0, "within ±89°"),
            ("site.longitude_deg", self.longitude_deg, 180.0, "within ±180°"),
            ("site.altitude_m", self.altitude_m, 9000.0, "within ±9000 m"),
            ("site.temperature_c", self.temperature_c, 60.0, "within ±60 °C"),
            ("site.magnetic_field_enu_ut[0]", f.x, 100.0, "within ±100 µT"),
            ("site.magnetic_field_enu_ut[1]", f.y, 100.0, "within ±100 µT"),
            ("site.magnetic_field_enu_ut[2]", f.z, 100.0, "within ±100 µT"),
        ]
        .into_iter()
        .find(|(_, value, limit, _)| !(value.is_finite() && value.abs() <= *limit))
        .map(|(key, value, _, expected)| (key, value, expected))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::model::geodesy::{Geodetic, Projection, TangentPlane};

    #[test]
    fn places_near_the_origin_are_projected_back_to_themselves() {
        let site = Site::default();
        let plane = TangentPlane::new(Geodetic::from_degrees(site.latitude_deg, site.longitude_deg, site.altitude_m));
        for position in [Vector3::new(10.0, -20.0, 3.0), Vector3::new(-300.0, 400.0, 30.0)] {
            let [latitude, longitude, altitude] = site.geodetic(&position);
            let back = plane.enu_m(&Geodetic::from_degrees(latitude, longitude, altitude));
            // The Earth falls away by d²/2R: 2 cm at 500 m.
            assert!((back - position).norm() < 0.03, "{position} {back}");
            assert!((back - position).xy().norm() < 0.01, "{position} {back}");
        }
    }

    #[test]
    fn magnetic_north_is_north_by_default() {
        assert_eq!(Site::default().declination_rad(), 0.0);
        assert!(Site::default().fault().is_none());
        let site = Site { latitude_deg: f64::NAN, ..Site::default() };
        assert_eq!(site.fault().unwrap().0, "site.latitude_deg");
    }
}

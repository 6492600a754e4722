//! The projection that makes local metres of degrees.
//!
//! The local frame is the tangent plane at an origin (ENU), through ECEF on the WGS 84 ellipsoid: exact,
//! no small-area approximation. GRS 80 (SIRGAS 2000, the datum of MAGNA-SIRGAS) differs from WGS 84 by
//! less than 0.1 mm in its axes, so the same code serves an origin given in either.

use nalgebra::Vector3;

/// Semi-major axis of WGS 84, m.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Flattening of WGS 84.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared.
const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);

/// A place on the Earth.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Geodetic {
    /// Latitude, rad, north positive.
    pub latitude_rad: f64,
    /// Longitude, rad, east positive.
    pub longitude_rad: f64,
    /// Height above the ellipsoid (or any surface, used consistently), m.
    pub altitude_m: f64,
}

impl Geodetic {
    /// From degrees.
    pub fn from_degrees(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Self {
        Self { latitude_rad: latitude_deg.to_radians(), longitude_rad: longitude_deg.to_radians(), altitude_m }
    }

    /// Origin of the MAGNA-SIRGAS / Colombia Bogotá grid, as an example of a national origin.
    pub fn magna_sirgas_bogota() -> Self {
        Self::from_degrees(4.596_200_417, -74.077_507_917, 0.0)
    }

    /// Earth-centred, Earth-fixed coordinates, m.
    fn ecef_m(&self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = self.latitude_rad.sin_cos();
        let (sin_lon, cos_lon) = self.longitude_rad.sin_cos();
        // Radius of curvature in the prime vertical.
        let n = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat).sqrt();
        let h = self.altitude_m;
        Vector3::new(
            (n + h) * cos_lat * cos_lon,
            (n + h) * cos_lat * sin_lon,
            (n * (1.0 - ECCENTRICITY_SQUARED) + h) * sin_lat,
        )
    }
}

/// Turns a place into local metres; another projection implements this trait.
pub trait Projection {
    /// Local coordinates ENU, m.
    fn enu_m(&self, place: &Geodetic) -> Vector3<f64>;
}

/// The tangent plane at an origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TangentPlane {
    origin: Geodetic,
    origin_ecef_m: Vector3<f64>,
}

impl TangentPlane {
    /// With its `origin`.
    pub fn new(origin: Geodetic) -> Self {
        Self { origin, origin_ecef_m: origin.ecef_m() }
    }
}

impl Projection for TangentPlane {
    fn enu_m(&self, place: &Geodetic) -> Vector3<f64> {
        let d = place.ecef_m() - self.origin_ecef_m;
        let (sin_lat, cos_lat) = self.origin.latitude_rad.sin_cos();
        let (sin_lon, cos_lon) = self.origin.longitude_rad.sin_cos();
        Vector3::new(
            -sin_lon * d.x + cos_lon * d.y,
            -sin_lat * cos_lon * d.x - sin_lat * sin_lon * d.y + cos_lat * d.z,
            cos_lat * cos_lon * d.x + cos_lat * sin_lon * d.y + sin_lat * d.z,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_of_arc_is_a_nautical_mile() {
        let plane = TangentPlane::new(Geodetic::from_degrees(0.0, 0.0, 0.0));
        let minute = 1.0 / 60.0;
        // On the equator: 1855.325 m along it, 1842.905 m along the meridian (WGS 84).
        let east = plane.enu_m(&Geodetic::from_degrees(0.0, minute, 0.0));
        let north = plane.enu_m(&Geodetic::from_degrees(minute, 0.0, 0.0));
        assert!((east.x - 1855.325).abs() < 0.01 && east.y.abs() < 1e-9, "{east}");
        assert!((north.y - 1842.905).abs() < 0.01 && north.x.abs() < 1e-9, "{north}");
        let up = plane.enu_m(&Geodetic::from_degrees(0.0, 0.0, 12.5));
        assert!((up - Vector3::new(0.0, 0.0, 12.5)).norm() < 1e-6);
        let bogota = TangentPlane::new(Geodetic::magna_sirgas_bogota());
        assert!(bogota.enu_m(&Geodetic::magna_sirgas_bogota()).norm() < 1e-9);
    }
}

//! Magnetic declination by the World Magnetic Model (WMM2020 and WMM2025, through the crate `world_magnetic_model`).
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | D | declination: magnetic north is D east of true north | rad |
//!
//! The model is the Earth's core field: iron in a building may turn it by more than D itself.

use world_magnetic_model::GeomagneticField;
use world_magnetic_model::time::Month;
use world_magnetic_model::uom::si::angle::{degree, radian};
use world_magnetic_model::uom::si::f32::{Angle, Length};
use world_magnetic_model::uom::si::length::meter;

pub use world_magnetic_model::time::Date;

use crate::model::geodesy::Geodetic;

/// Why there is no declination for a place and a day.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeclinationError {
    /// Not a day.
    #[error("\"{0}\" is not a day written as 2026-11-21")]
    Day(String),
    /// The model does not reach there.
    #[error("latitude {latitude_deg}°, longitude {longitude_deg}°, altitude {altitude_m} m on {date}: {source}")]
    Model {
        /// Latitude, degrees.
        latitude_deg: f64,
        /// Longitude, degrees.
        longitude_deg: f64,
        /// Altitude, m.
        altitude_m: f64,
        /// Day.
        date: Date,
        /// Cause.
        source: world_magnetic_model::Error,
    },
}

/// The day written `year-month-day`.
///
/// # Errors
/// [`DeclinationError::Day`].
pub fn day(text: &str) -> Result<Date, DeclinationError> {
    let bad = || DeclinationError::Day(text.to_owned());
    let mut parts = text.split('-');
    let mut next = || parts.next().and_then(|part| part.parse::<u16>().ok()).ok_or_else(bad);
    let (year, month, day) = (next()?, next()?, next()?);
    let month = u8::try_from(month).ok().and_then(|m| Month::try_from(m).ok()).ok_or_else(bad)?;
    let day = u8::try_from(day).map_err(|_| bad())?;
    if parts.next().is_some() {
        return Err(bad());
    }
    Date::from_calendar_date(i32::from(year), month, day).map_err(|_| bad())
}

/// The day of a time in seconds since 1970, UTC; `None` before the model and where it is no time.
pub fn day_of_unix(time_s: f64) -> Option<Date> {
    /// 1970-01-01.
    const JULIAN_DAY: i32 = 2_440_588;
    let days = (time_s / 86_400.0).floor();
    if !(0.0..1e6).contains(&days) {
        return None;
    }
    Date::from_julian_day(JULIAN_DAY + days as i32).ok().filter(|date| date.year() >= 2020)
}

/// D at `place` on `date`, rad, east positive.
///
/// # Errors
/// [`DeclinationError::Model`], with the offending values.
pub fn declination_rad(place: &Geodetic, date: Date) -> Result<f64, DeclinationError> {
    let (latitude_deg, longitude_deg) = (place.latitude_rad.to_degrees(), place.longitude_rad.to_degrees());
    let field = GeomagneticField::new(
        Length::new::<meter>(place.altitude_m as f32),
        Angle::new::<degree>(latitude_deg as f32),
        Angle::new::<degree>(longitude_deg as f32),
        date,
    );
    let altitude_m = place.altitude_m;
    let field =
        field.map_err(|source| DeclinationError::Model { latitude_deg, longitude_deg, altitude_m, date, source })?;
    Ok(f64::from(field.declination().get::<radian>()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::shared;

    #[test]
    fn equals_the_test_values_of_the_model() {
        // The file rounds to 0.01°; the crate computes in single precision and in whole days, which matters close
        // to the magnetic poles only.
        const TOLERANCE_DEG: f64 = 0.02;
        let Some(path) = shared("data/wmm_test_values/WMM2020_TEST_VALUES.txt") else { return };
        let text = std::fs::read_to_string(path).unwrap();
        let mut checked = 0;
        for line in text.lines().filter(|l| !l.starts_with('#') && !l.trim().is_empty()) {
            let v: Vec<f64> = line.split_whitespace().map(|x| x.parse().unwrap()).collect();
            let (year, part) = (v[0].trunc() as i32, v[0].fract());
            let days = if year % 4 == 0 { 366.0 } else { 365.0 };
            let place = Geodetic::from_degrees(v[2], v[3], v[1] * 1000.0);
            let date = Date::from_ordinal_date(year, (part * days) as u16 + 1).unwrap();
            let found = declination_rad(&place, date).unwrap().to_degrees();
            let off = crate::frames::wrap_pi((found - v[4]).to_radians()).to_degrees().abs();
            // dD/dt reaches 2.6° a year at the pole; a day is the resolution of the date.
            assert!(off < TOLERANCE_DEG + v[11].abs() / 365.0, "{line}: {found:.3}°");
            checked += 1;
        }
        assert!(checked > 50, "{checked} values");
    }

    #[test]
    fn a_day_of_a_clock_that_was_set() {
        assert_eq!(day_of_unix(1_651_221_928.162), Some(day("2022-04-29").unwrap()));
        assert_eq!([0.0, -1.0, f64::NAN, 1e300].map(day_of_unix), [None; 4]);
    }

    #[test]
    fn what_the_model_does_not_know_is_refused_with_the_values() {
        let bogota = Geodetic::magna_sirgas_bogota();
        let now = day("2026-11-21").unwrap();
        let west = declination_rad(&bogota, now).unwrap().to_degrees();
        assert!((-9.0..-6.0).contains(&west), "{west}");
        let early = declination_rad(&bogota, day("1990-01-01").unwrap()).unwrap_err().to_string();
        assert!(early.contains("on 1990-01-01"), "{early}");
        let nowhere = Geodetic::from_degrees(f64::NAN, 0.0, 0.0);
        assert!(declination_rad(&nowhere, now).unwrap_err().to_string().contains("NaN"));
        for bad in ["", "2026", "2026-13-01", "2026-02-30", "2026-1-1-1", "today"] {
            assert_eq!(day(bad).unwrap_err(), DeclinationError::Day(bad.to_owned()));
        }
    }
}

//! Barometer with its thermometer.
//!
//! Barometer: altitude above the level where the pressure is p₀.
//!
//! \[Strategies\], errata 10: h = 44330 (1 − (p/p₀)^(1/5.255)); the exponent belongs to the ratio alone.
//! The altitude of a barometer wanders with the weather, with the room's doors and with every unit, so an
//! estimator carries an offset: y = z + offset.

use nalgebra::Vector3;
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::measure::{Kinematics, Row};
use super::sample::{Accuracy, Quantity, Sample, Scalars};
use super::suite::{self, Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};

/// One barometer sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BarometerSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Pressure, Pa.
    pub pressure_pa: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
}

impl Sample for BarometerSample {
    const TOPIC: Kind = Kind::Barometer;
    const KIND: v1::SensorKind = v1::SensorKind::Barometer;
    const QUANTITIES: &'static [Quantity] = &[
        Quantity { name: "pressure", unit: "Pa", scalars: 1, named: false },
        Quantity { name: "temperature", unit: "°C", scalars: 1, named: false },
    ];
    type Sheet = Barometer;
    type Model = BarometerModel;

    /// The first of them.
    fn model(sheets: &[Barometer]) -> BarometerModel {
        let reference_pressure_pa = STANDARD_PRESSURE_PA;
        let Some(pressure) = sheets.first().map(|s| s.pressure) else {
            return BarometerModel { altitude: Accuracy { sigma: 0.15, gate: 5.0 }, walk: 0.02, reference_pressure_pa };
        };
        BarometerModel {
            altitude: Accuracy { sigma: pressure.total_sigma() / PA_PER_M, gate: pressure.gate_sigmas },
            walk: (pressure.bias_walk / PA_PER_M).max(WALK_LEAST),
            reference_pressure_pa,
        }
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        values[0] = self.pressure_pa;
        values[1] = self.temperature_c;
        values
    }

    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.pressure_pa = values[0];
        self.temperature_c = values[1];
        self
    }

    wire::message! {
        BarometerSample of BarometerReading,
        |s| v1::BarometerReading { pressure_pa: s.pressure_pa, temperature_c: s.temperature_c },
        |time, r| Some(Self { time, pressure_pa: r.pressure_pa, temperature_c: r.temperature_c })
    }
}

/// Least random walk of an offset, m/√s: weather and rooms add 15 Pa within ten minutes to what a data sheet counts.
const WALK_LEAST: f64 = 0.07;
/// Pascals for a metre of height near sea level.
const PA_PER_M: f64 = 11.8;

/// What estimators assume of barometers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BarometerModel {
    /// Pressure altitude, m.
    pub altitude: Accuracy,
    /// Random walk of its offset, m/√s.
    pub walk: f64,
    /// Pressure that is altitude zero, Pa; an offset takes up the rest.
    pub reference_pressure_pa: f64,
}

impl BarometerModel {
    /// Altitude of `sample` above the level of the reference pressure, m; NaN where the pressure is not positive.
    pub fn altitude_m(&self, sample: &BarometerSample) -> f64 {
        pressure_altitude_m(sample.pressure_pa, self.reference_pressure_pa)
    }
}

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

/// A barometer with its thermometer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Barometer {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Pressure, Pa.
    pub pressure: Quality,
    /// Error of the pressure for each °C above the temperature at boot, Pa.
    #[serde(default)]
    pub drift_pa_per_c: f64,
}

impl Sheet for Barometer {
    /// Barometer: 100 Hz, 1 Pa (\[Paternain\] Table I); 3 Pa of noise (25 cm) and its drifts are chosen.
    fn typical(_instance: usize) -> Self {
        Self {
            name: "barometer 1".into(),
            timing: Timing::at(100.0),
            pressure: Quality {
                sigma: 3.0,
                bias_sigma: 30.0,
                bias_walk: 0.3,
                resolution: 1.0,
                range: 120_000.0,
                gate_sigmas: 5.0,
            },
            drift_pa_per_c: 1.2,
        }
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("pressure", &mut self.pressure);
    }

    fn check(&self, check: &Checker, key: &str) -> Result<(), SuiteError> {
        check.within(key, "drift_pa_per_c", self.drift_pa_per_c, -1e3, 1e3, "within 1000 Pa/°C")
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::check;
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

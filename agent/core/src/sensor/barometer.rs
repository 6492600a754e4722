//! Barometer with its thermometer.

use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::sample::{Accuracy, Quantity, Sample, Scalars};
use super::suite::{Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};
use crate::model::measure::barometer::{STANDARD_PRESSURE_PA, pressure_altitude_m};

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
    type Wire = v1::BarometerSample;
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
            walk: (pressure.bias_walk / PA_PER_M).max(0.01),
            reference_pressure_pa,
        }
    }

    fn time(&self) -> FlightTime {
        self.time
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

    fn to_wire(&self, received: Option<&Self>, into: &mut v1::BarometerSample) {
        let reading = |s: &Self| v1::BarometerReading { pressure_pa: s.pressure_pa, temperature_c: s.temperature_c };
        let (reception, received) = wire::reception(self, received, reading);
        *into = v1::BarometerSample { time_us: self.time.0, reception, sensed: Some(reading(self)), received };
    }

    fn from_wire(m: v1::BarometerSample) -> Option<(Self, Received<Self>)> {
        let time = FlightTime(m.time_us);
        wire::sample(m.reception(), m.sensed, m.received, |r: v1::BarometerReading| {
            Some(Self { time, pressure_pa: r.pressure_pa, temperature_c: r.temperature_c })
        })
    }
}

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
    /// Barometer: 100 Hz, 1 Pa ([Paternain] Table I); 3 Pa of noise (25 cm) and its drifts are chosen.
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

    fn name(&self) -> &str {
        &self.name
    }

    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn timing_mut(&mut self) -> &mut Timing {
        &mut self.timing
    }

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("pressure", &mut self.pressure);
    }

    fn check(&self, check: &Checker, key: &str) -> Result<(), SuiteError> {
        check.within(key, "drift_pa_per_c", self.drift_pa_per_c, -1e3, 1e3, "within 1000 Pa/°C")
    }
}

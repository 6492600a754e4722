//! Laser height above the floor.
//!
//! Laser height: the sample is already the distance along the world's vertical, so y = z.

use nalgebra::Vector3;
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::measure::{Kinematics, Row};
use super::sample::{Accuracy, Quantity, Sample, Scalars};
use super::suite::{self, Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};

/// Distance to the floor along the world's vertical, mounting removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeightSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Height, m.
    pub height_m: f64,
}

impl Sample for HeightSample {
    const TOPIC: Kind = Kind::Height;
    const KIND: v1::SensorKind = v1::SensorKind::Height;
    const QUANTITIES: &'static [Quantity] = &[Quantity { name: "height", unit: "m", scalars: 1, named: false }];
    type Wire = v1::HeightSample;
    type Sheet = Height;
    type Model = Accuracy;

    /// The worst of them.
    fn model(sheets: &[Height]) -> Accuracy {
        let worst = sheets.iter().map(|s| s.height).reduce(|a, b| if a.sigma > b.sigma { a } else { b });
        worst.map_or(Accuracy { sigma: 0.01, gate: 5.0 }, |height| Accuracy {
            sigma: height.total_sigma().hypot(height.bias_sigma).max(2e-3),
            gate: height.gate_sigmas,
        })
    }

    fn time(&self) -> FlightTime {
        self.time
    }

    fn with_time(self, time: FlightTime) -> Self {
        Self { time, ..self }
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        values[0] = self.height_m;
        values
    }

    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.height_m = values[0];
        self
    }

    fn to_wire(&self, received: Option<&Self>, into: &mut v1::HeightSample) {
        let received_time_us = wire::received_time_us(self, received);
        let (reception, received_m) = wire::reception(self, received, |s| s.height_m);
        let (time_us, sensed_m) = (self.time.0, self.height_m);
        *into = v1::HeightSample { time_us, reception, sensed_m, received_m, received_time_us };
    }

    fn from_wire(m: v1::HeightSample) -> Option<(Self, Received<Self>)> {
        let time = FlightTime(m.time_us);
        let both =
            wire::sample(m.reception(), Some(m.sensed_m), m.received_m, |height_m| Some(Self { time, height_m }))?;
        Some(wire::stamped(both, m.received_time_us))
    }
}

/// Row of one height `height_m` above the floor.
pub fn height(state: &Kinematics, height_m: f64) -> Row {
    Row::new(height_m - state.position_enu_m.z).position(Vector3::z())
}

/// A laser height, looking down.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Height {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Where it sits, body FLU from the centre of mass, m.
    pub position_flu_m: Vector3<f64>,
    /// Height, m. `range` is the farthest it sees.
    pub height: Quality,
    /// Nothing is measured nearer than this, m.
    #[serde(default)]
    pub nearest_m: f64,
    /// Nothing is measured with the vehicle tilted more than this, rad.
    #[serde(default = "default_tilt")]
    pub tilt_max_rad: f64,
}

fn default_tilt() -> f64 {
    1.0
}

impl Sheet for Height {
    fn typical(instance: usize) -> Self {
        Self::laser(instance, instance)
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("height", &mut self.height);
    }

    fn check(&self, check: &Checker, key: &str) -> Result<(), SuiteError> {
        check.vector(key, "position_flu_m", &self.position_flu_m)?;
        check.within(key, "nearest_m", self.nearest_m, 0.0, self.height.range, "between 0 and its range")?;
        check.within(key, "tilt_max_rad", self.tilt_max_rad, 0.0, 1.5, "an angle of 0 to 1.5 rad")
    }
}

impl Height {
    /// Laser height `instance` of `of`: 10 Hz, 1 mm resolution (\[Clinic\] 5.4.2), the units staggered evenly
    /// over the period. The source guarantees 3 cm; sigma 7 mm and a 4 mm mounting error are chosen.
    pub fn laser(instance: usize, of: usize) -> Self {
        const RATE_HZ: f64 = 10.0;
        let angle = std::f64::consts::TAU * (instance - 1) as f64 / of as f64;
        // On the 5 ms grid of the default tick.
        let phase_s = ((instance - 1) as f64 / (of as f64 * RATE_HZ) / 0.005).round() * 0.005;
        Self {
            name: format!("height {instance}"),
            timing: Timing { phase_s, ..Timing::at(RATE_HZ) },
            position_flu_m: Vector3::new(0.08 * angle.cos(), 0.08 * angle.sin(), -0.05),
            height: Quality {
                sigma: 0.007,
                bias_sigma: 0.004,
                bias_walk: 0.0,
                resolution: 0.001,
                range: 4.0,
                gate_sigmas: 5.0,
            },
            nearest_m: 0.02,
            tilt_max_rad: default_tilt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        check::jacobian(&check::state(), |s| height(s, 1.5), 1e-8);
        assert!((height(&check::state(), 1.9).innovation - 0.2).abs() < 1e-12);
    }
}

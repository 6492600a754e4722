//! GNSS receiver: position and velocity in local metres about the configured origin.

use nalgebra::Vector3;
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::sample::{Accuracy, Quantity, Sample, Scalars, put, xyz};
use super::suite::{self, Quality, Sheet, Timing};
use super::wire::{self, Received};

/// One GNSS fix, in local metres about the configured origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Geodetic latitude, longitude (deg) and altitude above mean sea level (m).
    pub geodetic: [f64; 3],
    /// One-sigma of the horizontal position, m.
    pub horizontal_sigma_m: f64,
    /// One-sigma of the vertical position, m.
    pub vertical_sigma_m: f64,
    /// Satellites used.
    pub satellites: u32,
}

impl Sample for GnssSample {
    const TOPIC: Kind = Kind::Gnss;
    const KIND: v1::SensorKind = v1::SensorKind::Gnss;
    const QUANTITIES: &'static [Quantity] = &[
        Quantity { name: "position", unit: "m", scalars: 3, named: false },
        Quantity { name: "velocity", unit: "m/s", scalars: 3, named: false },
    ];
    type Sheet = Gnss;
    type Model = GnssModel;

    fn model(sheets: &[Gnss]) -> GnssModel {
        let (gates, velocity) = sheets.first().map_or(([5.0; 2], Accuracy { sigma: 0.1, gate: 5.0 }), |s| {
            let velocity = Accuracy { sigma: s.velocity.total_sigma(), gate: s.velocity.gate_sigmas };
            ([s.horizontal.gate_sigmas, s.vertical.gate_sigmas], velocity)
        });
        let [horizontal_gate, vertical_gate] = gates;
        GnssModel { floor_m: 0.05, horizontal_gate, vertical_gate, velocity }
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        put(&mut values, 0, &self.position_enu_m);
        put(&mut values, 3, &self.velocity_enu_mps);
        values
    }

    /// `geodetic` is kept: estimators use the local metres.
    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.position_enu_m = xyz(values, 0);
        self.velocity_enu_mps = xyz(values, 3);
        self
    }

    wire::message! {
        GnssSample of GnssReading,
        |s| {
            let [latitude_deg, longitude_deg, altitude_m] = s.geodetic;
            v1::GnssReading {
                position_enu_m: wire::vector(&s.position_enu_m),
                velocity_enu_mps: wire::vector(&s.velocity_enu_mps),
                latitude_deg,
                longitude_deg,
                altitude_m,
                horizontal_sigma_m: s.horizontal_sigma_m,
                vertical_sigma_m: s.vertical_sigma_m,
                satellites: s.satellites,
            }
        },
        |time, r| {
            Some(Self {
                time,
                position_enu_m: wire::xyz(r.position_enu_m.as_ref()?),
                velocity_enu_mps: wire::xyz(r.velocity_enu_mps.as_ref()?),
                geodetic: [r.latitude_deg, r.longitude_deg, r.altitude_m],
                horizontal_sigma_m: r.horizontal_sigma_m,
                vertical_sigma_m: r.vertical_sigma_m,
                satellites: r.satellites,
            })
        }
    }
}

/// One-sigma of a position that does not say how good it is, m.
const UNKNOWN_SIGMA_M: f64 = 10.0;

/// What estimators assume of GNSS.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssModel {
    /// Smallest one-sigma assumed of a position, m.
    pub floor_m: f64,
    /// Gate of a horizontal position, per axis, in sigmas of its innovation.
    pub horizontal_gate: f64,
    /// Gate of a vertical one.
    pub vertical_gate: f64,
    /// Velocity per axis, m/s.
    pub velocity: Accuracy,
}

impl GnssModel {
    /// Of the position in `sample`; `axis` 0, 1, 2 is east, north, up.
    pub fn position(&self, sample: &GnssSample, axis: usize) -> Accuracy {
        let (claimed_m, gate) = match axis {
            0 | 1 => (sample.horizontal_sigma_m, self.horizontal_gate),
            _ => (sample.vertical_sigma_m, self.vertical_gate),
        };
        let sigma = if claimed_m.is_finite() { claimed_m.max(self.floor_m) } else { UNKNOWN_SIGMA_M };
        Accuracy { sigma, gate }
    }
}

/// A GNSS receiver.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gnss {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Horizontal position per axis, m. Its bias is the slow error of the satellites' ranges.
    pub horizontal: Quality,
    /// Vertical position, m.
    pub vertical: Quality,
    /// Velocity per axis, m/s.
    pub velocity: Quality,
}

impl Sheet for Gnss {
    /// GNSS: 1 Hz (\[Paternain\] Table I), 2–3 m with good sky (\[Paternain\] IV-B): 2 m of slow error and 0.8 m
    /// of noise per axis, 0.2 s late (chosen).
    fn typical(_instance: usize) -> Self {
        Self {
            name: "GNSS 1".into(),
            timing: Timing { delay_s: 0.2, ..Timing::at(1.0) },
            horizontal: Quality { bias_sigma: 2.0, bias_walk: 0.05, ..Quality::white(0.8) },
            vertical: Quality { bias_sigma: 3.0, bias_walk: 0.08, ..Quality::white(1.5) },
            velocity: Quality::white(0.1),
        }
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("horizontal", &mut self.horizontal);
        each("vertical", &mut self.vertical);
        each("velocity", &mut self.velocity);
    }
}

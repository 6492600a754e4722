//! Signals of a recorded flight, or of a vehicle that flies: one number of one topic over time, and its spectrum.

use serde::{Deserialize, Serialize};

/// `GET /api/v1/flights/{id}/signals`, `GET /api/v1/vehicles/{id}/signals`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Signals {
    /// Flight time at the start of the flight, s: messages count from the agent's boot, answers from here. Of a vehicle 0.
    pub start_s: f64,
    /// Every number that was recorded, by topic.
    pub signals: Vec<Signal>,
}

/// One number of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Signal {
    /// As in tables: `imu_1.gyro_radps.x`; of messages with rows, `residuals_1[height 2 altitude].innovation`.
    pub name: String,
    /// Unit; empty for none.
    pub unit: String,
}

/// `GET /api/v1/flights/{id}/signal`, `GET /api/v1/vehicles/{id}/signal`: samples, or of each stretch of time the least and the greatest, in their order.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Samples {
    /// Samples in the range; more than are told where they were thinned.
    pub samples: u64,
    /// Since the start of the flight, s; of a vehicle, flight time.
    pub time_s: Vec<f64>,
    /// Values, columns of equal length.
    pub value: Vec<f64>,
}

/// `GET /api/v1/flights/{id}/spectrum`, `GET /api/v1/vehicles/{id}/spectrum`: Welch's method, Hann windows that overlap by half, one-sided.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Spectrum {
    /// Samples a second.
    pub rate_hz: f64,
    /// Windows that were averaged.
    pub windows: u64,
    /// Mean of the samples in the range.
    pub mean: f64,
    /// Root of their mean square about it.
    pub rms: f64,
    /// Frequencies, Hz.
    pub frequency_hz: Vec<f64>,
    /// Density at each, unit² / Hz.
    pub density: Vec<f64>,
    /// Mean speed of the rotors in the range, Hz, where it was recorded.
    pub rotor_hz: Option<f64>,
    /// Where its first multiples appear among samples of this rate, Hz.
    pub harmonics_hz: Vec<f64>,
}

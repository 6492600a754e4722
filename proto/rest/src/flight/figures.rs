//! What a report says of a flight beyond its steps: figures that take every message of it.

use serde::{Deserialize, Serialize};

use super::Samples;

/// `GET /api/v1/flights/{id}/figures`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Figures {
    /// Flight time at the start of the flight, s: messages count from the agent's boot, curves from here.
    pub start_s: f64,
    /// Are estimators measured against truth? Else against the setpoint.
    pub truth: bool,
    /// Each estimator, by its number.
    pub estimators: Vec<EstimatorError>,
    /// Each attack that altered a sample.
    pub attacks: Vec<AttackEffect>,
    /// What an autopilot was asked for while armed: rates of roll, pitch and yaw, and thrust; empty where the motors are commanded.
    pub autopilot: Vec<Followed>,
}

/// What an estimator was off by, from its first estimate on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct EstimatorError {
    /// Number of the estimator.
    pub estimator: u16,
    /// RMS and largest error of the altitude while armed, mm.
    pub altitude_mm: Option<[f64; 2]>,
    /// RMS of the errors of roll, pitch and yaw while armed, mrad.
    pub attitude_mrad: Option<[f64; 3]>,
    /// Error of the altitude over the whole flight, mm, thinned for a chart.
    pub altitude_error_mm: Samples,
}

/// What an attack did.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct AttackEffect {
    /// When its schedule was accepted, µs of flight time.
    pub accepted_time_us: u64,
    /// Its number in that schedule.
    pub id: u32,
    /// Onset to isolation by the secure estimator, s.
    pub isolated_after_s: Option<f64>,
    /// Onset to the first sample that the estimator in the loop rejected, s.
    pub rejected_after_s: Option<f64>,
    /// Largest and RMS deviation of the altitude from its setpoint while it was on and two seconds after, m.
    pub deviation_m: Option<[f64; 2]>,
    /// RMS of that deviation in as long a time before, m.
    pub rms_before_m: Option<f64>,
    /// Sensors that the secure estimator excluded meanwhile, by kind and instance.
    pub excluded: Vec<[u32; 2]>,
}

/// How an autopilot took over what it was asked for, rad/s or 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Followed {
    /// RMS of what was asked; absent where nothing was.
    pub asked_rms: Option<f64>,
    /// Largest and RMS of what it said it aims at, less what was asked in the same tick; absent where it never said.
    pub off: Option<[f64; 2]>,
}

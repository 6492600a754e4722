//! What an operator asks of a vehicle, below `/api/v1/vehicles/{id}/`, and the answer. Names (modes, estimators, sensors,
//! kinds and channels of attacks, shapes) are those of the schema in lower snake case.

use serde::{Deserialize, Serialize};

use crate::number;

/// The answer to a command that the vehicle accepted; one that it rejected is a [`crate::Problem`] of status 409.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Answer {
    /// Number of the command.
    pub command_id: u64,
    /// `accepted`.
    pub stage: String,
    /// What was done.
    pub reason: String,
    /// Number of the gains that were pushed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revision: Option<u32>,
}

/// `POST mode`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// Which.
    pub mode: String,
}

/// `POST estimator`: which is in the loop.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Estimator {
    /// Which.
    pub estimator: String,
}

/// `POST decoder`: what solves the secure estimator's program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Decoder {
    /// Which.
    pub decoder: String,
}

/// `POST recording`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// Begin or end.
    pub on: bool,
}

/// `POST replay`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// Times real time, 0 to 1000; 0 stands still.
    pub speed: f64,
    /// So many ticks, then stand still.
    #[serde(default)]
    pub step: u32,
}

/// `POST simulator`: what only a simulated vehicle can be given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Simulator {
    /// A new battery.
    pub battery: bool,
    /// Back to where it began.
    pub reset: bool,
}

/// `POST setpoint`. Absent fields keep their value.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Setpoint {
    /// Altitude, m.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub altitude_m: Option<f64>,
    /// East, m.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub x_m: Option<f64>,
    /// North, m.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub y_m: Option<f64>,
    /// Roll, rad.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub roll_rad: Option<f64>,
    /// Pitch, rad.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub pitch_rad: Option<f64>,
    /// Yaw, rad.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub yaw_rad: Option<f64>,
    /// Thrust over weight, in Stabilise.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub throttle: Option<f64>,
}

/// `POST trajectory` flies a path from where the setpoint is; `DELETE` stops it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Trajectory {
    /// Which shape.
    pub shape: String,
    /// Radius, amplitude or half a side, m.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub size_m: Option<f64>,
    /// Once around, s.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub period_s: Option<f64>,
    /// Along a sine, m/s.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<f64>,
    /// How long, s; 0 until it is stopped.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// A list of altitudes, m.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub altitude_m: Vec<f64>,
    /// At each of them, s.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub hold_s: Option<f64>,
}

/// `PUT attacks`: a schedule.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AttackPlan {
    /// Attacks, in any order.
    pub attacks: Vec<PlannedAttack>,
}

/// One attack.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PlannedAttack {
    /// Kind of sensor, or `rotor` for the command of a motor, as a part of its full thrust.
    pub sensor: String,
    /// Instance, from 1.
    pub instance: u32,
    /// Channels covered.
    #[serde(default = "all_channels")]
    pub channel: String,
    /// What it does.
    pub kind: String,
    /// After the schedule is accepted, s.
    pub start_s: f64,
    /// How long, s.
    pub duration_s: f64,
    /// As `kind` says.
    #[serde(default)]
    pub magnitude: f64,
    /// Of its random numbers.
    #[serde(default)]
    pub seed: u64,
    /// A bias that follows a table: within ±1, times the magnitude.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sequence: Vec<f64>,
    /// Each of its values for so long, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence_period_s: Option<f64>,
}

fn all_channels() -> String {
    "all".into()
}

/// `POST gains/revert`, and `GET gains/export?revision=N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Which {
    /// Number of the revision; absent for the last accepted one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revision: Option<u32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_misspelt_or_null_is_refused_and_what_is_absent_is_not() {
        assert_eq!(serde_json::from_str::<Setpoint>("{}").unwrap(), Setpoint::default());
        for wrong in [r#"{"altitude":1}"#, r#"{"altitude_m":null}"#, r#"{"altitude_m":"1"}"#] {
            assert!(serde_json::from_str::<Setpoint>(wrong).is_err(), "{wrong}");
        }
        let asked = Setpoint { altitude_m: Some(0.5), ..Setpoint::default() };
        assert_eq!(serde_json::to_string(&asked).unwrap(), r#"{"altitude_m":0.5}"#);
    }
}

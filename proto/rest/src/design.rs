//! Designs of gains: asked what they would do (`POST /api/v1/design/preview`), chosen from
//! (`GET /api/v1/design/controllers`), pushed (`PUT /api/v1/vehicles/{id}/gains`) and kept (`GET` of the same).
//!
//! Weights and K are in the order x y z vx vy vz roll pitch yaw p q r, integrals of x y z yaw; inputs are thrust, torque
//! x, torque y, torque z. Numbers of an answer that are absent are infinite: no limit.

use std::collections::BTreeMap;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

/// A design, or exported gains: those carry what came of their design beside it, which is read past.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// Kind of controller, by name: `lqr_integral` (or `lqi`, or nothing), `lqr`, `lqg`, `hinf`, `pid`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<String>,
    /// 16 values, each 1/(largest deviation)².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_weight: Option<Vec<f64>>,
    /// 4 values, each 1/(largest use)².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_weight: Option<Vec<f64>>,
    /// What the controller has beyond weights, by name; the rest keep their defaults.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Gains outright, used where there are no weights: 4 rows of 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k: Option<Vec<Vec<f64>>>,
    /// The same while the horizontal position is not controlled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_attitude: Option<Vec<Vec<f64>>>,
    /// What exported gains call themselves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub format: Option<String>,
    /// Name of the airframe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub airframe: Option<String>,
    /// Ticks of the agent, Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tick_rate_hz: Option<f64>,
    /// Read past.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Object>))]
    pub units: Option<Value>,
    /// Read past.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Object>))]
    pub certificate: Option<Value>,
}

/// `POST /api/v1/design/preview`: a design, and the steps to fly under it, in one object.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Question {
    /// What is asked about.
    #[serde(flatten)]
    pub design: Design,
    /// Steps to fly; 0.5 m and 0.5 rad where left out.
    pub step: Steps,
    /// How long each is flown, s; 8 when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
}

/// Sizes of the steps.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Steps {
    /// East, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_m: Option<f64>,
    /// North, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_m: Option<f64>,
    /// Up, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_m: Option<f64>,
    /// Heading, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub yaw_rad: Option<f64>,
}

impl<'de> Deserialize<'de> for Question {
    /// By hand: serde does not refuse unknown fields of what is flattened.
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let mut object = Map::<String, Value>::deserialize(from)?;
        let step = object.remove("step").map(serde_json::from_value).transpose().map_err(D::Error::custom)?;
        let duration_s =
            object.remove("duration_s").map(serde_json::from_value).transpose().map_err(D::Error::custom)?;
        let design = serde_json::from_value(Value::Object(object)).map_err(D::Error::custom)?;
        Ok(Self { design, step: step.unwrap_or_default(), duration_s })
    }
}

/// The answer of `GET /api/v1/design/controllers`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Controllers {
    /// Name of the airframe that the defaults are for.
    pub airframe: String,
    /// Every controller there is.
    pub controllers: Vec<Controller>,
}

/// One controller that can be chosen.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Controller {
    /// Its name.
    pub controller: String,
    /// Does it come from weights?
    pub weighted: bool,
    /// What it has beyond them.
    pub parameters: Vec<Parameter>,
    /// Bryson's rule for the airframe.
    pub state_weight: Option<Vec<f64>>,
    /// Bryson's rule for the airframe.
    pub input_weight: Option<Vec<f64>>,
}

/// A parameter and what it may be.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Unit; empty for a pure number.
    pub unit: String,
    /// Least value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// As designed, or by default.
    pub value: f64,
}

/// The answer of `POST /api/v1/design/preview`. A design that cannot be solved is refused; one whose margins do not
/// suffice is answered, with `accepted` false.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Preview {
    /// Kind of controller.
    pub controller: String,
    /// Name of the airframe.
    pub airframe: String,
    /// Ticks it was sampled for, Hz.
    pub tick_rate_hz: f64,
    /// Would an agent with this policy fly it?
    pub accepted: bool,
    /// Why not.
    pub refusal: Option<String>,
    /// What it was judged by.
    pub policy: Policy,
    /// The loop with x and y controlled.
    pub position: Examined,
    /// The loop without them.
    pub attitude: Examined,
    /// For x, y, z and yaw.
    pub unit_step: Vec<Share>,
    /// Against the gains in use; absent where one of the two is not a K.
    pub change: Option<Change>,
    /// K, rows of inputs, columns of states. Absent where the law has none.
    pub k: Option<Vec<Vec<f64>>>,
    /// The one in use, the same way.
    pub k_in_use: Option<Vec<Vec<f64>>>,
    /// Flown on the nonlinear vehicle.
    pub steps: Vec<Flown>,
    /// As they would be exported; only when accepted.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Object>))]
    pub gains: Option<Value>,
    /// Of the controller, as designed.
    pub parameters: Vec<Parameter>,
}

/// What the vehicle's loops must forgive.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Policy {
    /// Its name.
    pub name: String,
    /// Least factor up.
    pub gain_up_min: f64,
    /// Largest factor down.
    pub gain_down_max: f64,
    /// Least phase margin, rad.
    pub phase_min_rad: f64,
    /// Least delay margin, s.
    pub delay_min_s: f64,
    /// Largest peak of the sensitivity.
    pub sensitivity_max: f64,
    /// Largest real part of the slowest pole, 1/s.
    pub slowest_pole_per_s: f64,
    /// Largest ‖ΔK‖/‖K‖ in flight.
    pub change_max: f64,
    /// Largest share of the motors' room for a unit step.
    pub unit_step_max: f64,
}

/// Poles and margins of one loop. Continuous poles are those of the design (no lag, no delay); the rest has the motors'
/// lag and one tick of delay in it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Examined {
    /// Real and imaginary part, 1/s: ln(z)/T.
    pub continuous_poles_per_s: Vec<[Option<f64>; 2]>,
    /// Real and imaginary part of z.
    pub sampled_poles: Vec<[Option<f64>; 2]>,
    /// Real part of the slowest pole, 1/s.
    pub slowest_pole_per_s: Option<f64>,
    /// Largest of the sensitivity.
    pub peak_sensitivity: Option<f64>,
    /// Of each input.
    pub margins: Vec<Margin>,
}

/// Margins of one input.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Margin {
    /// Its name.
    pub input: String,
    /// Factor up.
    pub gain_up: Option<f64>,
    /// Factor down.
    pub gain_down: Option<f64>,
    /// Phase, rad.
    pub phase_rad: Option<f64>,
    /// Delay, s.
    pub delay_s: Option<f64>,
    /// Where the loop gain is one, rad/s.
    pub crossover_radps: Option<f64>,
    /// Largest of the input's sensitivity.
    pub peak_sensitivity: Option<f64>,
}

/// Largest command of an uncut step of 1 m or 1 rad.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Share {
    /// `x`, `y`, `z` or `yaw`.
    pub output: String,
    /// `m` or `rad`.
    pub unit: String,
    /// Of the motors' room; above 1 they saturate.
    pub share: Option<f64>,
}

/// ‖ΔK‖/‖K‖ against the gains in use.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Change {
    /// Of the row that changes most.
    pub largest: Option<f64>,
    /// Name of that row.
    pub row: Option<String>,
    /// Of every row, by its input.
    pub rows: BTreeMap<String, Option<f64>>,
}

/// A step flown on the nonlinear vehicle; curves are columns of equal length.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Flown {
    /// `x`, `y`, `z` or `yaw`.
    pub output: String,
    /// `m` or `rad`.
    pub unit: String,
    /// In that unit.
    pub size: f64,
    /// Since the step, s.
    pub t_s: Vec<Option<f64>>,
    /// Profile that the controller is given.
    pub setpoint: Vec<Option<f64>>,
    /// The output.
    pub response: Vec<Option<f64>>,
    /// Largest motor command, 0 to 1.
    pub largest_command: Vec<Option<f64>>,
    /// 10 % to 90 %, s.
    pub rise_time_s: Option<f64>,
    /// Overshoot, %.
    pub overshoot_percent: Option<f64>,
    /// Into the band for good, s.
    pub settling_time_s: Option<f64>,
    /// How long the motors could not give what was asked for, s.
    pub saturated_s: Option<f64>,
    /// Did the vehicle stay near its setpoint?
    pub stayed: Option<bool>,
}

/// `GET /api/v1/vehicles/{id}/gains`: those in use, absent until the agent has reported them, and every push.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Gains {
    /// Number; 0 is the set the agent started with.
    pub revision: Option<u32>,
    /// SHA-256 of the numbers of the law, hexadecimal.
    pub sha256: Option<String>,
    /// Kind of controller.
    pub controller: Option<String>,
    /// 16 values; none where K was given outright.
    pub state_weight: Option<Vec<f64>>,
    /// 4 values; none where K was given outright.
    pub input_weight: Option<Vec<f64>>,
    /// What the controller has beyond weights, by name.
    pub parameters: Option<BTreeMap<String, f64>>,
    /// Real part of the slowest pole, 1/s.
    pub slowest_pole_per_s: Option<f64>,
    /// As exported gains carry it.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Object>))]
    pub certificate: Option<Value>,
    /// With the horizontal position controlled.
    pub k: Option<Matrix>,
    /// The oldest first.
    pub revisions: Vec<Revision>,
}

/// A matrix, row by row.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Matrix {
    /// How many.
    pub rows: u32,
    /// How many.
    pub columns: u32,
    /// Row-major.
    pub values: Vec<f64>,
}

/// One push of gains, as the ground keeps it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Revision {
    /// From 1.
    pub revision: u32,
    /// Who pushed it.
    pub operator: String,
    /// When, µs since the Unix epoch.
    pub pushed_unix_us: u64,
    /// `accepted`, `rejected` or `unanswered`.
    pub stage: String,
    /// What the agent said.
    pub reason: String,
    /// What was pushed: the fields of a [`Design`], as they came.
    #[serde(flatten)]
    #[cfg_attr(feature = "openapi", schema(value_type = Object))]
    pub design: Map<String, Value>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_is_one_object_and_refuses_what_it_does_not_know() {
        let question = Question {
            design: Design { controller: Some("pid".into()), ..Design::default() },
            step: Steps { z_m: Some(0.4), ..Steps::default() },
            duration_s: Some(6.0),
        };
        let text = serde_json::to_string(&question).unwrap();
        assert_eq!(text, r#"{"controller":"pid","parameters":{},"step":{"z_m":0.4},"duration_s":6.0}"#);
        assert_eq!(serde_json::from_str::<Question>(&text).unwrap(), question);
        assert_eq!(serde_json::from_str::<Question>("{}").unwrap(), Question::default());
        for wrong in [r#"{"flavour":1}"#, r#"{"step":{"w_m":9}}"#, r#"{"parameters":{"tilt_p":null}}"#, "[]"] {
            assert!(serde_json::from_str::<Question>(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_answer_is_read_with_its_infinities() {
        let text = r#"{"controller":"lqr","accepted":false,"refusal":"phase 12° below 30°","tick_rate_hz":200,
            "position":{"continuous_poles_per_s":[[-3.0,1.0]],"sampled_poles":[[0.98,0.0]],"slowest_pole_per_s":-0.4,
              "margins":[{"input":"thrust","gain_up":null,"gain_down":0.1,"phase_rad":1.0}]},
            "unit_step":[{"output":"x","unit":"m","share":0.4}],
            "steps":[{"output":"x","unit":"m","size":0.5,"t_s":[0,0.1],"setpoint":[0.5,0.5],"response":[0,null]}]}"#;
        let preview: Preview = serde_json::from_str(text).unwrap();
        assert_eq!(preview.position.margins[0].gain_up, None);
        assert_eq!(preview.steps[0].response, [Some(0.0), None]);
    }
}

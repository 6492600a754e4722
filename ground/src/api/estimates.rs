//! `GET /api/v1/flights/{id}/estimate?estimator=ukf[&sensors=imu,height]`: a recorded flight estimated again, by the agent's
//! library, from what the estimators received in flight. Nothing is kept and nothing is sent to a vehicle.
//! ```json
//! { "estimator": "ukf",
//!   "score": { "position_rmse_m": 0.02, "velocity_rmse_mps": 0.03, "heading_rmse_deg": 0.8, "inclination_rmse_deg": 0.3,
//!              "nees": 11.8, "nees_states": 12, … },
//!   "time_s": [0.005, 0.045], "altitude_m": [null, 0.5], "roll_rad": […], "pitch_rad": […], "yaw_rad": […] }
//! ```
//! `estimator` is named as in telemetry, `sensors` as in `plumbline-agent estimate --sensors`. Errors without truth are
//! null, as is everything while the estimator initialises; at most 25 samples a second.

use std::path::Path as FilePath;

use axum::Json;
use axum::extract::State;
use plumbline_analysis::offline::{ArgumentError, EstimateArgs, OfflineError, run_flight};
use plumbline_core::estimate::{Estimate, Health};
use plumbline_core::frames::roll_pitch_yaw;
use plumbline_proto::v1;
use plumbline_rest::flight::Curves;
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::compute::Waited;
use super::error::ApiError;
use super::extract::{Path, Query};
use crate::names::JsonName as _;
use crate::recorder::RecorderHandle;

/// Least time between two samples of the answer, s; half a tick of slack.
const PERIOD_S: f64 = 0.0375;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Asked {
    estimator: String,
    sensors: Option<String>,
}

/// Adds an estimate, unless it follows the last one too closely.
fn push(curves: &mut Curves, estimate: &Estimate) {
    let time_s = estimate.time.as_seconds();
    if curves.time_s.last().is_some_and(|last| time_s - last < PERIOD_S) {
        return;
    }
    let told = |value: f64| (estimate.health != Health::Initialising && value.is_finite()).then_some(value as f32);
    let angles = roll_pitch_yaw(&estimate.world_from_body);
    curves.time_s.push(time_s);
    curves.altitude_m.push(estimate.altitude_m().and_then(told));
    curves.roll_rad.push(told(angles.x));
    curves.pitch_rad.push(told(angles.y));
    curves.yaw_rad.push(told(angles.z));
}

pub(crate) async fn again(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Value>, ApiError> {
    let estimator = v1::EstimatorKind::from_json_name(&asked.estimator).map_err(ApiError::Invalid)?;
    let recorder = app.recorder.clone();
    // Seconds of computing for a long flight: in turn, and not on the threads that answer everybody.
    let work = move |waited: &Waited| estimate(&recorder, &id, estimator, asked.sensors.as_deref(), waited);
    Ok(Json(app.computing.run(work).await?))
}

fn estimate(
    recorder: &RecorderHandle,
    id: &str,
    estimator: v1::EstimatorKind,
    sensors: Option<&str>,
    waited: &Waited,
) -> Result<Value, ApiError> {
    let bytes = recorder.open(id)?.bytes();
    let bytes = bytes.map_err(|e| ApiError::Broken(format!("{}: {e}", crate::names::clip(id))))?;
    let name = estimator.json_name();
    // The command line has dashes where JSON has underscores.
    let mut args = EstimateArgs::new(FilePath::new(id), &name.replace('_', "-"), FilePath::new(""));
    args.sensors = sensors.map(|s| s.split(',').map(str::to_owned).collect()).unwrap_or_default();
    let mut curves = Curves::default();
    let each = |estimate: &Estimate| {
        push(&mut curves, estimate);
        waited.check().map_err(|_| OfflineError::GivenUp)
    };
    let score = run_flight(&bytes, &args, each).map_err(refused)?;
    let mut answer = json!(curves);
    answer["estimator"] = json!(name);
    answer["score"] = score.to_value();
    Ok(answer)
}

fn refused(error: OfflineError) -> ApiError {
    match error {
        OfflineError::Argument(ArgumentError { argument, value, reason }) => {
            ApiError::Invalid(format!("{argument} {}: {reason}", crate::names::clip(&value)))
        }
        other => ApiError::Invalid(other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_agent::estimate::Motion;
    use plumbline_proto::time::FlightTime;

    #[test]
    fn samples_are_thinned_and_what_is_not_known_is_null() {
        let mut curves = Curves::default();
        for tick in 0..200_u64 {
            let health = if tick < 100 { Health::Initialising } else { Health::Healthy };
            let mut motion = Motion { altitude_known: true, ..Motion::default() };
            motion.position_enu_m.z = 1.5;
            let time = FlightTime(tick * 5_000);
            let estimate = Estimate { time, health, motion: Some(motion), ..Estimate::default() };
            push(&mut curves, &estimate);
        }
        assert_eq!(curves.time_s.len(), 25);
        assert_eq!((curves.altitude_m.first(), curves.altitude_m.last()), (Some(&None), Some(&Some(1.5))));
    }
}

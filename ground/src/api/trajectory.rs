//! `POST /api/v1/vehicles/{id}/trajectory` flies a path from where the setpoint is; `DELETE` stops it.
//!
//! `{"shape": "circle" | "sine" | "square" | "heave", "size_m": 1, "period_s": 10, "speed_mps": 0.2,
//! "duration_s": 60}`, or `{"shape": "altitudes", "altitude_m": [0.5, 1, 0.5], "hold_s": 8}`.

use axum::extract::State;
use plumbline_proto::v1::{self, command};
use plumbline_rest::command::Trajectory;

use super::App;
use super::body::Body;
use super::control::{Answer, send};
use super::error::ApiError;
use super::extract::Path;
use super::operator::Operator;
use crate::names::JsonName;

pub(crate) async fn fly(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<Trajectory>,
) -> Answer {
    use v1::TrajectoryShape::{Altitudes, Sine, Unspecified};
    let shape = v1::TrajectoryShape::from_json_name(&asked.shape).map_err(ApiError::Invalid)?;
    if shape == Unspecified {
        return Err(ApiError::Invalid(format!("shape {:?} cannot be flown; DELETE stops a path", asked.shape)));
    }
    let needed = |name: &str, value: Option<f64>, used: bool| match (value, used) {
        (Some(value), true) => Ok(value),
        (None, false) => Ok(0.0),
        (None, true) => Err(ApiError::Invalid(format!("{} needs {name}", asked.shape))),
        (Some(_), false) => Err(ApiError::Invalid(format!("{} has no {name}", asked.shape))),
    };
    let list = shape == Altitudes;
    if list == asked.altitude_m.is_empty() {
        let text = if list { "altitudes needs altitude_m" } else { "altitude_m is for the shape altitudes" };
        return Err(ApiError::Invalid(text.into()));
    }
    let body = v1::SetTrajectory {
        shape: shape as i32,
        size_m: needed("size_m", asked.size_m, !list)?,
        period_s: needed("period_s", asked.period_s, !list)?,
        speed_mps: needed("speed_mps", asked.speed_mps, shape == Sine)?,
        duration_s: needed("duration_s", asked.duration_s.or(Some(0.0).filter(|_| !list)), !list)?,
        altitude_m: asked.altitude_m.clone(),
        hold_s: needed("hold_s", asked.hold_s, list)?,
    };
    send(&app, &id, &who, command::Body::SetTrajectory(body)).await
}

pub(crate) async fn stop(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    send(&app, &id, &who, command::Body::SetTrajectory(v1::SetTrajectory::default())).await
}

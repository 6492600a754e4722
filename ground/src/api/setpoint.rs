//! `POST /api/v1/vehicles/{id}/setpoint`. Absent fields keep their value.

use axum::extract::State;
use plumbline_proto::v1::{self, command};
use plumbline_rest::command::Setpoint;

use super::App;
use super::body::Body;
use super::control::{Answer, send};
use super::error::ApiError;
use super::extract::Path;
use super::operator::Operator;

pub(crate) async fn set(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<Setpoint>,
) -> Answer {
    let Setpoint { altitude_m, x_m, y_m, roll_rad, pitch_rad, yaw_rad, throttle } = asked;
    let fields = [
        ("altitude_m", altitude_m),
        ("x_m", x_m),
        ("y_m", y_m),
        ("roll_rad", roll_rad),
        ("pitch_rad", pitch_rad),
        ("yaw_rad", yaw_rad),
        ("throttle", throttle),
    ];
    if fields.iter().all(|(_, value)| value.is_none()) {
        return Err(ApiError::Invalid("the setpoint has no field".into()));
    }
    for (name, value) in fields {
        if let Some(value) = value
            && !value.is_finite()
        {
            return Err(ApiError::Invalid(format!("{name} is {value}, a finite number is needed")));
        }
    }
    let setpoint = v1::Setpoint { altitude_m, x_m, y_m, roll_rad, pitch_rad, yaw_rad, throttle };
    send(&app, &id, &who, command::Body::Setpoint(setpoint)).await
}

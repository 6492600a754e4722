//! Short commands: arm, disarm, cut, mode, estimator, decoder, recording, replay, simulator.

use axum::Json;
use axum::extract::State;
use plumbline_proto::limits::MAX_REPLAY_SPEED;
use plumbline_proto::v1::{self, command};
use plumbline_rest::command as rest;

use super::App;
use super::body::Body;
use super::error::ApiError;
use super::extract::Path;
use super::operator::Operator;
use crate::names::JsonName;

/// Modes that can be asked for.
pub(crate) const MODES: [v1::Mode; 4] = [v1::Mode::Stabilise, v1::Mode::AltitudeHold, v1::Mode::Hold, v1::Mode::Land];

/// The answer to a command: 200 accepted, 409 rejected.
pub(crate) type Answer = Result<Json<rest::Answer>, ApiError>;

/// The HTTP form of an acknowledgement, of a command that carried gains where they have a number.
pub(crate) fn answer(ack: v1::Ack, revision: Option<u32>) -> Answer {
    let v1::Ack { command_id, stage, reason, .. } = ack;
    if stage == v1::AckStage::Accepted as i32 {
        Ok(Json(rest::Answer { command_id, stage: v1::AckStage::json_name_of(stage), reason, revision }))
    } else {
        Err(ApiError::Rejected { command_id, revision, reason })
    }
}

/// Sends `body` as the operator in control.
pub(crate) async fn send(app: &App, id: &str, operator: &Operator, body: command::Body) -> Answer {
    let sender = app.controlled(id, operator)?;
    answer(app.command(id, &sender, operator, body).await?, None)
}

/// A flight that cannot be recorded is not begun; one that goes on is not disturbed.
pub(crate) async fn arm(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    if let Some(error) = app.recorder.error() {
        return Err(ApiError::Conflict(format!("recording: {error}")));
    }
    send(&app, &id, &who, command::Body::Arm(v1::Arm {})).await
}

pub(crate) async fn disarm(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    send(&app, &id, &who, command::Body::Disarm(v1::Disarm {})).await
}

/// Open to everyone, whoever holds control.
pub(crate) async fn cut(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    let sender = app.hub.commands(&id)?;
    let ack = app.command(&id, &sender, &who, command::Body::CutMotors(v1::CutMotors {})).await?;
    answer(ack, None)
}

pub(crate) async fn release_cut(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    send(&app, &id, &who, command::Body::ReleaseCut(v1::ReleaseCut {})).await
}

pub(crate) async fn mode(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Mode>,
) -> Answer {
    let mode = v1::Mode::from_json_name(&asked.mode).map_err(ApiError::Invalid)?;
    // Disarmed and cut are left and entered by their own commands, which say what they do.
    if !MODES.contains(&mode) {
        let text = format!("mode {:?} cannot be asked for: stabilise, altitude_hold, hold or land", asked.mode);
        return Err(ApiError::Invalid(text));
    }
    send(&app, &id, &who, command::Body::SetMode(v1::SetMode { mode: mode as i32 })).await
}

pub(crate) async fn estimator(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Estimator>,
) -> Answer {
    let kind = v1::EstimatorKind::from_json_name(&asked.estimator).map_err(ApiError::Invalid)?;
    if kind == v1::EstimatorKind::Unspecified {
        return Err(ApiError::Invalid(format!("estimator {:?} cannot fly", asked.estimator)));
    }
    let body = command::Body::SelectEstimator(v1::SelectEstimator { estimator: kind as i32 });
    send(&app, &id, &who, body).await
}

pub(crate) async fn decoder(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Decoder>,
) -> Answer {
    let decoder = v1::Decoder::from_json_name(&asked.decoder).map_err(ApiError::Invalid)?;
    if decoder == v1::Decoder::Unspecified {
        return Err(ApiError::Invalid(format!("decoder {:?} solves nothing", asked.decoder)));
    }
    let body = command::Body::SelectDecoder(v1::SelectDecoder { decoder: decoder as i32 });
    send(&app, &id, &who, body).await
}

/// What only a simulated vehicle can be given; the agent refuses it for any other.
pub(crate) async fn simulator(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Simulator>,
) -> Answer {
    let rest::Simulator { battery, reset } = asked;
    if !battery && !reset {
        return Err(ApiError::Invalid("nothing is asked for: battery or reset".into()));
    }
    let body = command::Body::SetSimulator(v1::SetSimulator { new_battery: battery, reset });
    send(&app, &id, &who, body).await
}

pub(crate) async fn recording(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Recording>,
) -> Answer {
    send(&app, &id, &who, command::Body::SetRecording(v1::SetRecording { on: asked.on })).await
}

pub(crate) async fn replay(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(asked): Body<rest::Replay>,
) -> Answer {
    if !asked.speed.is_finite() || !(0.0..=MAX_REPLAY_SPEED).contains(&asked.speed) {
        return Err(ApiError::Invalid(format!("speed {} is outside 0 to {MAX_REPLAY_SPEED}", asked.speed)));
    }
    let body = command::Body::SetReplay(v1::SetReplay { speed: asked.speed, step: asked.step });
    send(&app, &id, &who, body).await
}

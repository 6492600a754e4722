//! `PUT` uploads a schedule whole; `DELETE` aborts what runs.

use axum::extract::State;
use plumbline_proto::Kind;
use plumbline_proto::v1::{self, command};

use plumbline_rest::command::AttackPlan;

use super::App;
use super::body::Body;
use super::control::{Answer, send};
use super::extract::Path;
use super::operator::Operator;
use crate::attack_plan::to_schedule;

pub(crate) async fn upload(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(plan): Body<AttackPlan>,
) -> Answer {
    let description: Option<v1::Description> = app.hub.latest(&id, Kind::Description);
    let targets: Option<Vec<_>> = description.map(|d| d.sensors.into_iter().chain(d.actuators).collect());
    let running: Option<v1::AttackState> = app.hub.latest(&id, Kind::Attacks);
    let schedule_id = running.map_or(0, |state| state.schedule_id).wrapping_add(1);
    let schedule = to_schedule(&plan, schedule_id, targets.as_deref())?;
    send(&app, &id, &who, command::Body::AttackSchedule(schedule)).await
}

pub(crate) async fn abort(State(app): State<App>, Path(id): Path<String>, who: Operator) -> Answer {
    send(&app, &id, &who, command::Body::AbortAttacks(v1::AbortAttacks {})).await
}

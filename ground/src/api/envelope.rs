//! `GET /api/v1/vehicles/{id}/envelope`: how far an attacker who is not seen can push this vehicle, with the gains in use, for every
//! set of one or two sensors. `POST /api/v1/envelope[?vehicle=ID]`: another question; what it leaves out is as with the vehicle.
//!
//! `plumbline_analysis` answers; nothing is sent to a vehicle. Answers are kept by everything they depend on: the question, whole, and
//! the suite; the thresholds are constants of this program. `POST /api/v1/envelope/attack` prepares and judges attacks.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use axum::Json;
use axum::extract::State;
use plumbline_analysis::design::file::{export, read};
use plumbline_analysis::envelope::EnvelopeError;
use plumbline_analysis::envelope::prepare::prepared;
use plumbline_analysis::envelope::sets::Asked;
use plumbline_core::sensor::suite::Suite;
use plumbline_experiment::flight::suite_of;
use plumbline_proto::Kind;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1;
use plumbline_rest::envelope::{AttackQuestion, Envelope, EnvelopeQuestion, PreparedAttack};
use serde::Deserialize;

use super::App;
use super::body::Body;
use super::compute::Waited;
use super::error::ApiError;
use super::extract::{Path, Query};
use crate::hub::VehicleError;

/// Answers kept; the oldest goes.
const KEPT: usize = 512;

/// What an answer follows from.
type Key = (EnvelopeQuestion, Option<Suite>);

/// Answers by their questions, the latest first.
#[derive(Debug, Default)]
pub(crate) struct Envelopes(Mutex<VecDeque<(Key, Envelope)>>);

impl Envelopes {
    fn find(&self, key: &Key) -> Option<Envelope> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|(of, _)| of == key).map(|(_, answer)| answer.clone())
    }

    fn keep(&self, key: Key, answer: Envelope) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push_front((key, answer));
        kept.truncate(KEPT);
    }
}

impl From<EnvelopeError> for ApiError {
    fn from(error: EnvelopeError) -> Self {
        match error {
            EnvelopeError::Solver { .. } | EnvelopeError::Linalg(_) => Self::Broken(error.to_string()),
            _ => Self::Invalid(error.to_string()),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct For {
    vehicle: Option<String>,
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Envelope>, ApiError> {
    answer(&app, EnvelopeQuestion::default(), Some(id)).await
}

pub(crate) async fn ask(
    State(app): State<App>,
    Query(asked): Query<For>,
    Body(question): Body<EnvelopeQuestion>,
) -> Result<Json<Envelope>, ApiError> {
    answer(&app, question, asked.vehicle).await
}

/// What is expected of an attack, or the attack itself: `POST /api/v1/envelope/attack[?vehicle=ID]`.
pub(crate) async fn attack(
    State(app): State<App>,
    Query(asked): Query<For>,
    Body(mut question): Body<AttackQuestion>,
) -> Result<Json<PreparedAttack>, ApiError> {
    let suite = asked.vehicle.map(|id| stand_in(&app, &mut question.of, &id)).transpose()?.flatten();
    let work = move |_: &Waited| Ok(prepared(&question, suite)?);
    Ok(Json(app.computing.run(work).await?))
}

async fn answer(
    app: &App,
    mut question: EnvelopeQuestion,
    vehicle: Option<String>,
) -> Result<Json<Envelope>, ApiError> {
    let suite = vehicle.map(|id| stand_in(app, &mut question, &id)).transpose()?.flatten();
    let key = (question, suite);
    if let Some(known) = app.envelopes.find(&key) {
        return Ok(Json(known));
    }
    let (question, suite) = key.clone();
    let work = move |waited: &Waited| Ok(Asked::new(&question, suite)?.answer(|_| waited.check().is_ok())?);
    let answer = app.computing.run(work).await?;
    app.envelopes.keep(key, answer.clone());
    Ok(Json(answer))
}

/// Puts what is known of vehicle `id` in the place of what is left out; its suite, where the question names none.
fn stand_in(app: &App, question: &mut EnvelopeQuestion, id: &str) -> Result<Option<Suite>, ApiError> {
    if !app.hub.knows(id) {
        return Err(VehicleError::Unknown(id.to_owned()).into());
    }
    let description: Option<v1::Description> = app.hub.latest(id, Kind::Description);
    let untold = || ApiError::NotFound(format!("{id} has not told its sensors yet"));
    let description = description.ok_or_else(untold)?;
    let asked = &mut question.design;
    if asked.controller.is_none()
        && asked.state_weight.is_none()
        && asked.k.is_none()
        && asked.parameters.is_empty()
        && let Some(gains) = app.hub.latest::<v1::GainsInUse>(id, Kind::Gains)
    {
        let mut in_use = export(&gains, &description.airframe, description.tick_rate_hz);
        // The certificate counts revisions: the same gains are the same question.
        in_use.as_object_mut().into_iter().for_each(|gains| {
            gains.remove("certificate");
        });
        let (airframe, tick_rate_hz) = (asked.airframe.take(), asked.tick_rate_hz.take());
        *asked = read(in_use.to_string().as_bytes())?;
        (asked.airframe, asked.tick_rate_hz) = (airframe, tick_rate_hz);
    }
    let known = |name: &String| !name.is_empty();
    asked.airframe = asked.airframe.take().or(Some(description.airframe.clone()).filter(known));
    asked.tick_rate_hz = asked.tick_rate_hz.or(Some(description.tick_rate_hz).filter(|rate_hz| *rate_hz > 0.0));
    if question.suite.is_some() {
        return Ok(None);
    }
    question.suite = Some(id.to_owned());
    suite(&description).map(Some)
}

/// The sensors of a vehicle: those of its scenario, or typical ones at the rates told.
fn suite(description: &v1::Description) -> Result<Suite, ApiError> {
    if !description.scenario.is_empty() {
        return suite_of(&description.scenario).map_err(|e| ApiError::Invalid(format!("its scenario: {e}")));
    }
    let told = description.sensors.iter();
    Ok(Suite::at_rates(told.map(|sensor| (SensorId::new(sensor.kind(), sensor.instance as u8), sensor.rate_hz))))
}

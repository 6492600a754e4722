//! Experiments that an operator flies, `…/experiments/{id}/by-hand`: what is next, and what is said of what was flown. The page, or
//! a script, sends the commands; the vehicle examines each as ever.

use axum::Json;
use axum::extract::State;
use plumbline_experiment::by_hand::{self, ByHandError};
use plumbline_experiment::store::Experiment;
use plumbline_experiment::summary::shown;
use plumbline_proto::ids::SensorId;
use plumbline_proto::{Kind, v1};
use plumbline_rest::command::Trajectory;
use plumbline_rest::experiment::{ByHand, FlownByHand, NextByHand, Said};

use super::App;
use super::body::Body;
use super::error::ApiError;
use super::experiments::{aside, one};
use super::extract::Path;
use super::operator::Operator;
use crate::attack_plan::planned;
use crate::names::JsonName as _;
use crate::recorder::Completeness;
use crate::sync::wall_time_us;

impl From<ByHandError> for ApiError {
    fn from(error: ByHandError) -> Self {
        match error {
            ByHandError::Store(error) => error.into(),
            ByHandError::Unknown(_) => Self::NotFound(error.to_string()),
            ByHandError::Taken { .. } | ByHandError::Used { .. } => Self::Conflict(error.to_string()),
            ByHandError::NoReason | ByHandError::Recording(_) | ByHandError::Judged { .. } | ByHandError::Fly(_) => {
                Self::Invalid(error.to_string())
            }
        }
    }
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<ByHand>, ApiError> {
    Ok(Json(aside(app, move |app| told(app, &one(app, &id)?)).await?))
}

pub(crate) async fn say(
    State(app): State<App>,
    Path(id): Path<String>,
    who: Operator,
    Body(Said { index, flight, accepted, reason }): Body<Said>,
) -> Result<Json<ByHand>, ApiError> {
    let within = app.clone();
    let told = FlownByHand { index, flight, accepted, reason, who: who.name().to_owned(), unix_us: wall_time_us() };
    let answer = app.computing.run(move |_| {
        let experiment = one(&within, &id)?;
        if told.accepted {
            recorded(&within, &experiment, &told)?;
        }
        by_hand::keep(&experiment, &told, within.experiments.library())?;
        note(&within, &experiment, &told)?;
        self::told(&within, &experiment)
    });
    Ok(Json(answer.await?))
}

/// Writes it into the notes of the flight, too: what counts is read again when its dot is opened, and retention keeps what has notes.
fn note(app: &App, experiment: &Experiment, told: &FlownByHand) -> Result<(), ApiError> {
    // A flight that was never recorded can be void.
    let Ok(flight) = app.recorder.flight(&told.flight) else { return Ok(()) };
    let word = if told.accepted { "accepted".to_owned() } else { format!("void, {}", told.reason) };
    let line = format!("{}, flight {}: {word}", experiment.id, told.index);
    let notes = [flight.notes.as_str(), line.as_str()].into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>();
    app.recorder.label(&told.flight, None, Some(notes.join("\n")))?;
    Ok(())
}

/// Is the recording whole, and one of the plan's vehicle?
fn recorded(app: &App, experiment: &Experiment, told: &FlownByHand) -> Result<(), ApiError> {
    let (condition, _) = experiment.plan.place(told.index);
    let vehicle = experiment.plan.by_hand(condition).map_err(ApiError::Invalid)?.vehicle;
    let flight = app.recorder.flight(&told.flight)?;
    if flight.vehicle_id != vehicle {
        let text = format!("{} was flown by {}, the plan is of {vehicle}", flight.id, flight.vehicle_id);
        return Err(ApiError::Invalid(text));
    }
    if matches!(flight.completeness, Completeness::Recording | Completeness::Filling) {
        return Err(ApiError::Conflict(format!(
            "{} is {}: wait until it is complete",
            flight.id,
            flight.completeness.name()
        )));
    }
    Ok(())
}

fn told(app: &App, experiment: &Experiment) -> Result<ByHand, ApiError> {
    if !experiment.plan.is_by_hand() {
        return Err(ApiError::NotFound(format!("{} is not flown by hand", experiment.id)));
    }
    let next = match by_hand::next(experiment)? {
        Some((at, index)) => Some(next(app, experiment, at as u64 + 1, index)?),
        None => None,
    };
    Ok(ByHand { next, said: by_hand::said(experiment)? })
}

fn next(app: &App, experiment: &Experiment, place: u64, index: u64) -> Result<NextByHand, ApiError> {
    let plan = &experiment.plan;
    let (condition, repeat) = plan.place(index);
    let by_hand = plan.by_hand(condition).map_err(ApiError::Invalid)?;
    let named = plan.factors.iter().zip(plan.levels(condition));
    let levels = named.map(|(factor, level)| format!("{} = {}", factor.key, shown(level.as_ref()))).collect();
    let description: Option<v1::Description> = app.hub.latest(&by_hand.vehicle, Kind::Description);
    let known = description.map(|description| {
        let id = |sensor: &v1::SensorDescription| {
            Some(SensorId::new(sensor.kind.try_into().ok()?, sensor.instance.try_into().ok()?))
        };
        description.sensors.iter().filter_map(id).collect::<Vec<_>>()
    });
    let (attacks, lacks) = match known.map(|sensors| by_hand.attacks(&sensors, plan.seed_of(repeat))) {
        None => (Vec::new(), format!("vehicle {} was not seen yet", by_hand.vehicle)),
        Some(Err(lacks)) => (Vec::new(), lacks),
        Some(Ok(attacks)) => (attacks.iter().map(planned).collect(), String::new()),
    };
    let path = Trajectory {
        shape: v1::TrajectoryShape::Altitudes.json_name(),
        altitude_m: by_hand.altitude_m.clone(),
        hold_s: Some(by_hand.hold_s),
        ..Trajectory::default()
    };
    Ok(NextByHand {
        index,
        place,
        flights: plan.flights(),
        levels,
        rest_left_s: rest_left_s(app, experiment, by_hand.rest_s)?,
        estimator: by_hand.estimator.json_name(),
        gains: by_hand.gains,
        attacks,
        path,
        lasts_s: by_hand.lasts_s(),
        lacks,
        vehicle: by_hand.vehicle,
    })
}

/// Since the end of the flight that something was said of last, s.
fn rest_left_s(app: &App, experiment: &Experiment, rest_s: f64) -> Result<f64, ApiError> {
    let Some(last) = by_hand::said(experiment)?.pop() else { return Ok(0.0) };
    let ended_us = app
        .recorder
        .flight(&last.flight)
        .map_or(last.unix_us, |flight| flight.started_unix_us.saturating_add((flight.duration_s * 1e6) as u64));
    Ok((rest_s - wall_time_us().saturating_sub(ended_us) as f64 * 1e-6).max(0.0))
}

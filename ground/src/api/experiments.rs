//! Experiments: asked and answered as [`plumbline_rest::experiment`] says. A plan that cannot be flown is a 422 with its line.

use std::path::PathBuf;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse as _, Redirect, Response};
use plumbline_experiment::by_hand;
use plumbline_experiment::flight::FlyError;
use plumbline_experiment::open::{OpenError, RecordError, open};
use plumbline_experiment::plan::Plan;
use plumbline_experiment::recordings::Library;
use plumbline_experiment::run::expected_s;
use plumbline_experiment::store::{Experiment, StoreError};
use plumbline_experiment::{parquet, report, summary};
use plumbline_rest::experiment::{self as rest, Asked, Opened, Results, Size};
use serde::Deserialize;

use super::App;
use super::access;
use super::body::Body;
use super::error::ApiError;
use super::extract::{Page, Path, Query};
use super::operator::{Operator, Signed};
use super::tag::{self, Known};
use crate::audit::Deed;
use crate::experiments::Experiments;
use crate::recorder::WRITTEN;

/// Most flights of one answer.
const PAGE: usize = 1000;

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Unknown(_) => Self::NotFound(error.to_string()),
            StoreError::Plan(_) | StoreError::Traces(_) => Self::Invalid(error.to_string()),
            StoreError::Foreign { .. } | StoreError::ByHand(_) | StoreError::Running(_) | StoreError::Recording(_) => {
                Self::Conflict(error.to_string())
            }
            StoreError::Io { .. } => Self::Broken(error.to_string()),
        }
    }
}

impl From<OpenError> for ApiError {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::Store(error) => error.into(),
            OpenError::Unknown { .. } => Self::NotFound(error.to_string()),
            OpenError::Record(RecordError::Fly(ref fly)) if matches!(**fly, FlyError::Recording(_)) => {
                Self::Conflict(error.to_string())
            }
            OpenError::Condition { .. } | OpenError::Nothing(_) => Self::Invalid(error.to_string()),
            other => Self::Broken(other.to_string()),
        }
    }
}

/// Runs `work`, which asks the disk, off the server's threads.
pub(super) async fn aside<T: Send + 'static>(
    app: App,
    work: impl FnOnce(&App) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let done = tokio::task::spawn_blocking(move || work(&app)).await;
    done.map_err(|error| ApiError::Broken(error.to_string()))?
}

pub(super) fn one(app: &App, id: &str) -> Result<Experiment, ApiError> {
    Ok(Experiment::open(app.experiments.root(), id)?)
}

/// Over the network a plan names flights of this ground, and no files.
fn read(text: &str, library: &Library) -> Result<Plan, ApiError> {
    Plan::over(text, library).map_err(|error| ApiError::Invalid(error.to_string()))
}

pub(crate) async fn list(
    State(app): State<App>,
    Query(page): Query<Page>,
) -> Result<Json<rest::Experiments>, ApiError> {
    let listed = aside(app, move |app| {
        let (all, total) = page.of(Experiment::all(app.experiments.root()), |e| format!("{} {}", e.id, e.plan.name))?;
        let experiments = all.iter().map(|experiment| app.experiments.state(experiment)).collect();
        Ok(rest::Experiments { experiments, total })
    });
    Ok(Json(listed.await?))
}

pub(crate) async fn size(State(app): State<App>, Body(asked): Body<Asked>) -> Result<Json<Size>, ApiError> {
    let (root, library) = (app.experiments.root().to_owned(), app.experiments.library().clone());
    // Some flights are begun, to see how long they take.
    let size = app.computing.run(move |waited| {
        let plan = read(&asked.plan, &library)?;
        waited.check()?;
        let id = Experiment::id_of(&plan);
        let done = Experiment::open(&root, &id).map_or(0, |experiment| experiment.done());
        let (conditions, repeats, flights) = (plan.conditions(), plan.repeats, plan.flights());
        let expected_s = expected_s(&plan, flights.saturating_sub(done), Experiments::threads());
        let by_hand = plan.is_by_hand();
        Ok(Size { id, conditions, repeats, flights, done, expected_s: expected_s.map_err(ApiError::Invalid)?, by_hand })
    });
    Ok(Json(size.await?))
}

pub(crate) async fn create(
    State(app): State<App>,
    Body(asked): Body<Asked>,
) -> Result<(StatusCode, Json<rest::State>), ApiError> {
    let made = aside(app, move |app| {
        let experiment = Experiment::create(app.experiments.root(), read(&asked.plan, app.experiments.library())?)?;
        if !experiment.plan.is_by_hand() {
            app.experiments.start(experiment.clone())?;
        }
        Ok(app.experiments.state(&experiment))
    });
    Ok((StatusCode::CREATED, Json(made.await?)))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Results>, ApiError> {
    let shown = aside(app, move |app| {
        let experiment = one(app, &id)?;
        Ok(Results { state: app.experiments.state(&experiment), ..summary::results(&experiment)? })
    });
    Ok(Json(shown.await?))
}

pub(crate) async fn start(State(app): State<App>, Path(id): Path<String>) -> Result<Json<rest::State>, ApiError> {
    let started = aside(app, move |app| {
        let experiment = one(app, &id)?;
        app.experiments.start(experiment.clone())?;
        Ok(app.experiments.state(&experiment))
    });
    Ok(Json(started.await?))
}

pub(crate) async fn stop(State(app): State<App>, Path(id): Path<String>) -> Result<Json<rest::State>, ApiError> {
    let stopped = aside(app, move |app| {
        let experiment = one(app, &id)?;
        experiment.ask_to_stop()?;
        Ok(app.experiments.state(&experiment))
    });
    Ok(Json(stopped.await?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Which {
    #[serde(default)]
    from: usize,
    count: Option<usize>,
    condition: Option<u64>,
}

pub(crate) async fn flights(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(which): Query<Which>,
) -> Result<Json<rest::Flights>, ApiError> {
    let count = which.count.unwrap_or(PAGE).min(PAGE);
    let flights = aside(app, move |app| Ok(summary::flights(&one(app, &id)?, which.from, count, which.condition)?));
    Ok(Json(flights.await?))
}

pub(crate) async fn fly_again(
    State(app): State<App>,
    Path((id, index)): Path<(String, u64)>,
) -> Result<Json<Opened>, ApiError> {
    Ok(Json(opened(app, id, index).await?))
}

/// What a dot of a report leads to. It adds a flight to the list, so a person must have asked for it: a click, or an address
/// that was typed. Reading is not written down, this is.
pub(crate) async fn go(
    State(app): State<App>,
    Path((id, index)): Path<(String, u64)>,
    Signed(person): Signed,
    operator: Operator,
    request: Request,
) -> Result<Redirect, ApiError> {
    let asked = {
        let told = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
        let own = matches!(told("sec-fetch-site"), None | Some("none" | "same-origin"));
        own || told("sec-fetch-user") == Some("?1")
    };
    if !asked {
        return Err(ApiError::Foreign("a flight is opened by a click, not by another page".into()));
    }
    let deed = Deed { who: operator.name, role: person.role.name(), status: 303, ..access::deed(&request) };
    let Opened { flight } = opened(app.clone(), id, index).await?;
    app.audit.record(deed);
    Ok(Redirect::to(&format!("/flights/{flight}")))
}

async fn opened(app: App, id: String, index: u64) -> Result<Opened, ApiError> {
    let within = app.clone();
    app.computing
        .run(move |_| {
            let experiment = one(&within, &id)?;
            if let Some(flight) = by_hand::accepted(&experiment)?.remove(&index) {
                return Ok(Opened { flight });
            }
            let file = open(&experiment, index)?;
            let taken = within.recorder.take_in(&file);
            if let Some(emptied) = file.parent() {
                let _ = std::fs::remove_dir_all(emptied);
            }
            Ok(Opened { flight: taken?.id })
        })
        .await
}

pub(crate) async fn plan(State(app): State<App>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let text = aside(app, move |app| Ok(one(app, &id)?.plan.text)).await?;
    Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
}

pub(crate) async fn page(State(app): State<App>, Path(id): Path<String>) -> Result<Response, ApiError> {
    // Links without an address lead to the ground that the page comes from.
    let text = aside(app, move |app| Ok(report::page(&one(app, &id)?, "")?)).await?;
    Ok(([(header::CONTENT_TYPE, "text/html; charset=utf-8")], text).into_response())
}

pub(crate) async fn compare(
    State(app): State<App>,
    Path((first, second)): Path<(String, String)>,
) -> Result<Response, ApiError> {
    let text = aside(app, move |app| Ok(report::compare(&one(app, &first)?, &one(app, &second)?, "")?)).await?;
    Ok(([(header::CONTENT_TYPE, "text/html; charset=utf-8")], text).into_response())
}

pub(crate) async fn table(State(app): State<App>, Path(id): Path<String>, known: Known) -> Result<Response, ApiError> {
    let name = format!("attachment; filename=\"{}.parquet\"", crate::names::clip(&id));
    let made = aside(app, move |app| {
        let experiment = one(app, &id)?;
        // Rows are only ever added, and what is said of a flight by hand: how many there are says which.
        let (identity, said) = (&experiment.identity, by_hand::said(&experiment)?.len());
        let tag = (&identity.hash, &identity.program, identity.made_unix_us, experiment.done(), said, WRITTEN);
        let tag = tag::of(format!("{tag:?}").as_bytes());
        if known.has(&tag) {
            return Ok((tag, None));
        }
        let path: PathBuf = parquet::export(&experiment)?;
        let bytes = std::fs::read(&path).map_err(|error| ApiError::Broken(format!("{}: {error}", path.display())))?;
        Ok((tag, Some(bytes)))
    });
    let (tag, bytes) = made.await?;
    let Some(bytes) = bytes else { return Ok(tag::unchanged(tag)) };
    let kind = "application/vnd.apache.parquet".to_owned();
    let head = [(header::CONTENT_TYPE, kind), (header::ETAG, tag), (header::CONTENT_DISPOSITION, name)];
    Ok((head, bytes).into_response())
}

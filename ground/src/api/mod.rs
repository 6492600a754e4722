//! The HTTP API: one file per resource. Handlers translate; decisions live elsewhere.

mod assets;
mod attacks;
mod body;
mod calibrations;
mod control;
mod design;
mod error;
mod flights;
mod gains;
mod ground;
mod guard;
mod lease;
mod live;
mod operator;
mod setpoint;
mod trajectory;
mod vehicles;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post, put};
use plumbline_proto::v1::{self, command};
use tokio::sync::{Semaphore, watch};

use crate::agent_link::CommandSender;
use crate::commands::Commands;
use crate::config::GroundConfig;
use crate::gains_book::GainsBook;
use crate::hub::Hub;
use crate::lease::Leases;
use crate::recorder::RecorderHandle;
use crate::sync::wall_time_us;
use error::ApiError;
use operator::Operator;

/// Largest body of a request. A plan of 64 attacks is about 10 kB.
const MAX_BODY: usize = 256 << 10;
/// Previews of designs computed at a time; more wait.
const PREVIEWS: usize = 2;
/// Most viewers, all vehicles together; more are answered 503.
const MAX_VIEWERS: usize = 256;

/// What every handler can reach. Cheap to clone.
#[derive(Clone)]
pub(crate) struct App(Arc<Inner>);

pub(crate) struct Inner {
    config: GroundConfig,
    address: SocketAddr,
    started: Instant,
    hub: Arc<Hub>,
    commands: Arc<Commands>,
    leases: Arc<Leases>,
    gains: Arc<GainsBook>,
    recorder: RecorderHandle,
    viewers: Arc<Semaphore>,
    previews: Semaphore,
    stopped: watch::Receiver<bool>,
}

impl std::ops::Deref for App {
    type Target = Inner;
    fn deref(&self) -> &Inner {
        &self.0
    }
}

impl App {
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn new(
        config: GroundConfig,
        address: SocketAddr,
        hub: Arc<Hub>,
        commands: Arc<Commands>,
        leases: Arc<Leases>,
        gains: Arc<GainsBook>,
        recorder: RecorderHandle,
        stopped: watch::Receiver<bool>,
    ) -> Self {
        let viewers = Arc::new(Semaphore::new(MAX_VIEWERS));
        let started = Instant::now();
        let previews = Semaphore::new(PREVIEWS);
        Self(Arc::new(Inner {
            config,
            address,
            started,
            hub,
            commands,
            leases,
            gains,
            recorder,
            viewers,
            previews,
            stopped,
        }))
    }

    /// The way down to `vehicle`, for `operator`, who now holds control of it.
    fn controlled(&self, vehicle: &str, operator: &Operator) -> Result<CommandSender, ApiError> {
        let sender = self.hub.commands(vehicle)?;
        if self.leases.claim(vehicle, operator.name())? {
            self.show_lease(vehicle);
        }
        Ok(sender)
    }

    /// Sends a command and waits for its answer.
    async fn command(
        &self,
        vehicle: &str,
        to: &CommandSender,
        operator: &Operator,
        body: command::Body,
    ) -> Result<v1::Ack, ApiError> {
        let timeout = self.config.command_timeout;
        Ok(self.commands.send(vehicle, to, operator.name(), body, timeout).await?)
    }

    /// Tells every viewer who holds control.
    fn show_lease(&self, vehicle: &str) {
        let holder = self.leases.holder(vehicle).unwrap_or_default();
        let lease = v1::ControlLease { wall_time_us: wall_time_us(), holder };
        self.hub.publish(vehicle, plumbline_proto::Kind::Lease, &lease);
    }
}

pub(crate) fn router(app: App) -> Router {
    let vehicle = Router::new()
        .route("/live", get(live::live))
        .route("/arm", post(control::arm))
        .route("/disarm", post(control::disarm))
        .route("/cut", post(control::cut))
        .route("/release-cut", post(control::release_cut))
        .route("/mode", post(control::mode))
        .route("/estimator", post(control::estimator))
        .route("/recording", post(control::recording))
        .route("/replay", post(control::replay))
        .route("/setpoint", post(setpoint::set))
        .route("/attacks", put(attacks::upload).delete(attacks::abort))
        .route("/trajectory", post(trajectory::fly).delete(trajectory::stop))
        .route("/gains", get(gains::show).put(gains::push))
        .route("/gains/export", get(gains::download))
        .route("/gains/revert", post(gains::revert))
        .route("/lease", get(lease::show).put(lease::take).delete(lease::release));
    let flight = Router::new()
        .route("/", get(flights::show).patch(flights::annotate).delete(flights::delete))
        .route("/mcap", get(flights::mcap))
        .route("/csv", get(flights::csv))
        .route("/frames", get(flights::frames));
    Router::new()
        .route("/api/ground", get(ground::show))
        .route("/api/vehicles", get(vehicles::list))
        .route("/api/v1/design/preview", post(design::preview))
        .route("/api/v1/design/controllers", get(design::controllers))
        .nest("/api/vehicles/{id}", vehicle)
        .route("/api/flights", get(flights::list))
        .nest("/api/flights/{id}", flight)
        .route(
            "/api/v1/calibrations",
            get(calibrations::list).post(calibrations::create).layer(DefaultBodyLimit::max(calibrations::MAX_TABLE)),
        )
        .route("/api/v1/calibrations/{id}", get(calibrations::show))
        .route("/api/{*rest}", axum::routing::any(unknown))
        .fallback(assets::serve)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(app.clone(), guard::guard))
        .with_state(app)
}

async fn unknown(uri: axum::http::Uri) -> ApiError {
    ApiError::NotFound(format!("there is no {}", crate::names::clip(uri.path())))
}

async fn method_not_allowed(method: axum::http::Method, uri: axum::http::Uri) -> ApiError {
    ApiError::Method(format!("{} has no {method}", crate::names::clip(uri.path())))
}

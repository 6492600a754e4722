//! The HTTP API: one file per resource. Handlers translate; decisions live elsewhere.
//!
//! Every route stands in one table, [`routes`], with what it needs; the router is built from it, and so is the test of who
//! may do what. A route that is not in the table does not exist.

mod access;
mod archive;
mod assets;
mod attacks;
mod audit;
mod body;
mod by_hand;
mod calibrations;
mod compute;
mod control;
mod design;
mod download;
mod envelope;
mod error;
mod estimates;
mod experiments;
mod extract;
mod flights;
mod foxglove;
mod gains;
mod ground;
mod guard;
mod guided;
mod health;
mod import;
mod lease;
mod live;
pub(crate) mod mavlink;
mod openapi;
mod operations;
mod operator;
mod order;
mod pairing;
mod people;
mod session;
mod setpoint;
mod signals;
mod tag;
mod trajectory;
mod vehicles;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::handler::Handler as _;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::MethodRouter;
use plumbline_proto::v1::{self, command};
use tokio::runtime::Handle;
use tokio::sync::{Semaphore, watch};

use crate::agent_link::CommandSender;
use crate::audit::Audit;
use crate::commands::{Asked, Commands};
use crate::config::GroundConfig;
use crate::experiments::Experiments;
use crate::gains_book::GainsBook;
use crate::hub::Hub;
use crate::ingest::publish_lease;
use crate::lease::Leases;
use crate::people::{Access, People};
use crate::recorder::RecorderHandle;
use crate::recorder::archive::Pruner;
use crate::viewers::Viewers;
use crate::work;
pub use assets::page_is_built;
use download::Downloads;
pub(crate) use error::ApiError;
use operator::Operator;

/// Largest body of a request. A plan of 64 attacks is about 10 kB.
const MAX_BODY: usize = 256 << 10;
/// Path of the motor cut.
const CUT: &str = "/api/v1/vehicles/{id}/cut";
/// Path of the Foxglove link.
const FOXGLOVE: &str = "/api/v1/vehicles/{id}/foxglove";
/// Histories thinned at a time; more wait.
const THINNING: usize = 1;

/// What every handler can reach. Cheap to clone.
#[derive(Clone)]
pub(crate) struct App(Arc<Inner>);

/// What the API is made of.
pub(crate) struct Parts {
    pub(crate) config: GroundConfig,
    pub(crate) fleet: crate::sharing::Shared,
    pub(crate) address: SocketAddr,
    pub(crate) hub: Arc<Hub>,
    pub(crate) commands: Arc<Commands>,
    pub(crate) leases: Arc<Leases>,
    pub(crate) gains: Arc<GainsBook>,
    pub(crate) people: Arc<People>,
    pub(crate) audit: Audit,
    pub(crate) recorder: RecorderHandle,
    pub(crate) retention: Arc<Pruner>,
    pub(crate) experiments: Arc<Experiments>,
    /// Threads for whatever takes long.
    pub(crate) work: Handle,
    pub(crate) stopped: watch::Receiver<bool>,
}

pub(crate) struct Inner {
    parts: Parts,
    started: Instant,
    viewers: Arc<Viewers>,
    downloads: Arc<Downloads>,
    counts: health::Counts,
    computing: compute::Turns,
    uploads: compute::Turns,
    envelopes: envelope::Envelopes,
    guided: guided::Guided,
    thinning: Semaphore,
}

impl std::ops::Deref for Inner {
    type Target = Parts;
    fn deref(&self) -> &Parts {
        &self.parts
    }
}

impl std::ops::Deref for App {
    type Target = Inner;
    fn deref(&self) -> &Inner {
        &self.0
    }
}

impl App {
    pub(crate) fn new(parts: Parts) -> Self {
        Self(Arc::new(Inner {
            parts,
            started: Instant::now(),
            viewers: Arc::default(),
            downloads: Arc::default(),
            counts: health::Counts::default(),
            computing: compute::Turns::new(),
            uploads: compute::Turns::new(),
            envelopes: envelope::Envelopes::default(),
            guided: guided::Guided::default(),
            thinning: Semaphore::new(THINNING),
        }))
    }

    /// Is the page served by TLS?
    fn secure(&self) -> bool {
        self.config.tls.is_some()
    }

    /// The way down to `vehicle`, for `operator`, who now holds control of it.
    fn controlled(&self, vehicle: &str, operator: &Operator) -> Result<CommandSender, ApiError> {
        self.hub.commanded_here(vehicle)?;
        let sender = self.hub.commands(vehicle)?;
        if self.leases.claim(vehicle, operator.name())? {
            self.show_lease(vehicle, "");
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
        let asked = Asked { operator: operator.name(), seen_us: operator.seen_us(&body)?, body };
        Ok(self.commands.send(vehicle, to, asked, timeout).await?)
    }

    /// Tells every viewer who holds control, and who lost it to them.
    fn show_lease(&self, vehicle: &str, taken_from: &str) {
        publish_lease(&self.hub, &self.leases, vehicle, taken_from);
    }
}

/// One route.
struct Route {
    method: &'static str,
    path: &'static str,
    need: Access,
    handler: MethodRouter<App>,
    /// Largest body.
    limit: usize,
}

macro_rules! table {
    ($($method:ident $path:literal $need:ident $handler:path $(, $limit:expr)?;)*) => {
        vec![$(Route {
            method: stringify!($method),
            path: $path,
            need: Access::$need,
            handler: axum::routing::$method($handler),
            limit: [MAX_BODY $(, $limit)?].into_iter().max().unwrap_or(MAX_BODY),
        }),*]
    };
}

/// Every route, and what it needs.
fn routes() -> Vec<Route> {
    table! {
        get    "/healthz"                            Open    health::alive;
        get    "/readyz"                             Open    health::ready;
        get    "/metrics"                            Open    health::metrics;
        get    "/login"                              Open    session::page;
        post   "/login"                              Open    session::page_in;
        post   "/logout"                             Open    session::page_out;
        get    "/api/v1/openapi.json"                View    openapi::show;
        get    "/api/v1/docs"                        View    openapi::docs;
        get    "/api/v1/session"                        Open    session::show;
        post   "/api/v1/session"                        Open    session::begin;
        delete "/api/v1/session"                        Open    session::end;
        post   "/api/v1/session/authenticator"          View    session::offer;
        put    "/api/v1/session/authenticator"          View    session::confirm;
        delete "/api/v1/session/authenticator"          View    session::one_step;
        get    "/api/v1/sessions"                       View    people::sessions;
        delete "/api/v1/sessions/{id}"                  View    people::end;
        get    "/api/v1/people"                         Admin   people::list;
        post   "/api/v1/people"                         Admin   people::add;
        patch  "/api/v1/people/{id}"                    Admin   people::change;
        delete "/api/v1/people/{id}"                    Admin   people::remove;
        get    "/api/v1/audit"                          Admin   audit::show;
        post   "/api/v1/pairing"                        Admin   pairing::begin;
        get    "/api/v1/ground"                         View    ground::show;
        get    "/api/v1/vehicles"                       View    vehicles::list;
        get    "/api/v1/vehicles/{id}/live"             View    live::live;
        get    "/api/v1/vehicles/{id}/foxglove"      View    foxglove::live;
        post   "/api/v1/vehicles/{id}/foxglove"      View    foxglove::address;
        get    "/api/v1/vehicles/{id}/history"          View    live::history;
        get    "/api/v1/vehicles/{id}/signals"          View    signals::live_list;
        get    "/api/v1/vehicles/{id}/signal"           View    signals::live_samples;
        get    "/api/v1/vehicles/{id}/spectrum"         View    signals::live_spectrum;
        post   "/api/v1/vehicles/{id}/cut"              Operate control::cut;
        post   "/api/v1/vehicles/{id}/arm"              Operate control::arm;
        post   "/api/v1/vehicles/{id}/disarm"           Operate control::disarm;
        post   "/api/v1/vehicles/{id}/release-cut"      Operate control::release_cut;
        post   "/api/v1/vehicles/{id}/mode"             Operate control::mode;
        post   "/api/v1/vehicles/{id}/estimator"        Operate control::estimator;
        post   "/api/v1/vehicles/{id}/decoder"          Operate control::decoder;
        post   "/api/v1/vehicles/{id}/recording"        Operate control::recording;
        post   "/api/v1/vehicles/{id}/replay"           Operate control::replay;
        post   "/api/v1/vehicles/{id}/simulator"        Operate control::simulator;
        post   "/api/v1/vehicles/{id}/setpoint"         Operate setpoint::set;
        put    "/api/v1/vehicles/{id}/attacks"          Attack  attacks::upload;
        delete "/api/v1/vehicles/{id}/attacks"          Operate attacks::abort;
        get    "/api/v1/vehicles/{id}/gains"            View    gains::show;
        put    "/api/v1/vehicles/{id}/gains"            Operate gains::push;
        get    "/api/v1/vehicles/{id}/gains/export"     View    gains::download;
        post   "/api/v1/vehicles/{id}/gains/revert"     Operate gains::revert;
        post   "/api/v1/vehicles/{id}/trajectory"       Operate trajectory::fly;
        delete "/api/v1/vehicles/{id}/trajectory"       Operate trajectory::stop;
        get    "/api/v1/vehicles/{id}/envelope"         View    envelope::show;
        get    "/api/v1/vehicles/{id}/calibration"      View    guided::show;
        post   "/api/v1/vehicles/{id}/calibration"      Operate guided::begin;
        delete "/api/v1/vehicles/{id}/calibration"      Operate guided::end;
        post   "/api/v1/vehicles/{id}/calibrations"     Operate calibrations::put_to_use;
        delete "/api/v1/vehicles/{id}/calibrations/{kind}/{imu}" Operate calibrations::stop_using;
        get    "/api/v1/vehicles/{id}/lease"            View    lease::show;
        put    "/api/v1/vehicles/{id}/lease"            Operate lease::take;
        delete "/api/v1/vehicles/{id}/lease"            Operate lease::release;
        post   "/api/v1/design/preview"              View    design::preview;
        get    "/api/v1/design/controllers"          View    design::controllers;
        post   "/api/v1/envelope"                    View    envelope::ask;
        post   "/api/v1/envelope/attack"             View    envelope::attack;
        get    "/api/v1/calibrations"                View    calibrations::list;
        post   "/api/v1/calibrations"                Operate calibrations::create, calibrations::MAX_TABLE;
        get    "/api/v1/calibrations/{id}"           View    calibrations::show;
        get    "/api/v1/experiments"                 View    experiments::list;
        post   "/api/v1/experiments"                 Operate experiments::create;
        post   "/api/v1/experiments/size"            View    experiments::size;
        get    "/api/v1/experiments/{id}"            View    experiments::show;
        post   "/api/v1/experiments/{id}/start"      Operate experiments::start;
        post   "/api/v1/experiments/{id}/stop"       Operate experiments::stop;
        get    "/api/v1/experiments/{id}/flights"    View    experiments::flights;
        post   "/api/v1/experiments/{id}/flights/{index}" Operate experiments::fly_again;
        get    "/api/v1/experiments/{id}/flights/{index}/open" Operate experiments::go;
        get    "/api/v1/experiments/{id}/by-hand"    View    by_hand::show;
        post   "/api/v1/experiments/{id}/by-hand"    Operate by_hand::say;
        get    "/api/v1/experiments/{id}/plan.toml"  View    experiments::plan;
        get    "/api/v1/experiments/{id}/report.html" View   experiments::page;
        get    "/api/v1/experiments/{id}/flights.parquet" View experiments::table;
        get    "/api/v1/experiments/{id}/against/{second}" View experiments::compare;
        get    "/api/v1/archive"                        View    archive::tar;
        get    "/api/v1/archive/due"                    View    archive::due;
        get    "/api/v1/flights"                        View    flights::list;
        post   "/api/v1/flights"                        Operate import::import, import::MAX_FORM;
        get    "/api/v1/flights/{id}"                   View    flights::show;
        patch  "/api/v1/flights/{id}"                   Operate flights::annotate;
        delete "/api/v1/flights/{id}"                   Admin   flights::delete;
        get    "/api/v1/flights/{id}/mcap"              View    flights::mcap;
        get    "/api/v1/flights/{id}/csv"               View    flights::csv;
        get    "/api/v1/flights/{id}/parquet"        View    flights::parquet;
        get    "/api/v1/flights/{id}/mat"            View    flights::mat;
        get    "/api/v1/flights/{id}/ros2"           View    flights::ros2;
        get    "/api/v1/flights/{id}/foxglove"       View    flights::foxglove;
        get    "/api/v1/flights/{id}/frames"            View    flights::frames;
        get    "/api/v1/flights/{id}/estimate"          View    estimates::again;
        get    "/api/v1/flights/{id}/signals"           View    signals::list;
        get    "/api/v1/flights/{id}/signal"            View    signals::samples;
        get    "/api/v1/flights/{id}/spectrum"          View    signals::spectrum;
        get    "/api/v1/flights/{id}/figures"           View    signals::figures;
    }
}

/// Method, path and need of every route, for tests and for people.
pub fn access_table() -> Vec<(&'static str, &'static str, Access)> {
    routes().into_iter().map(|route| (route.method, route.path, route.need)).collect()
}

pub(crate) fn router(app: App) -> Router {
    let mut router = Router::new();
    for Route { path, need, handler, limit, .. } in routes() {
        let admit = from_fn_with_state((app.clone(), need, limit), access::admit);
        let mut handler = handler.route_layer(DefaultBodyLimit::max(limit)).route_layer(from_fn(tag::tag));
        if !at_once(path) {
            handler = handler.route_layer(from_fn_with_state(app.work.clone(), work::there));
        }
        router = router.route(path, handler.route_layer(admit));
    }
    let assets = assets::serve.layer(from_fn_with_state(app.work.clone(), work::there));
    router
        .route("/api/{*rest}", axum::routing::any(unknown))
        .fallback(assets)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(app.clone(), guard::guard))
        .with_state(app)
}

/// Is this a command, or whatever else flying needs? Then it is answered by the threads that serve connections; its
/// handler computes nothing and waits for no disk. Everything else is answered by threads of its own.
fn at_once(path: &str) -> bool {
    const NEEDED: [&str; 14] = [
        "cut",
        "arm",
        "disarm",
        "release-cut",
        "mode",
        "estimator",
        "decoder",
        "recording",
        "replay",
        "setpoint",
        "attacks",
        "trajectory",
        "lease",
        "live",
    ];
    path.strip_prefix("/api/v1/vehicles/{id}/").is_some_and(|command| NEEDED.contains(&command))
}

async fn unknown(uri: axum::http::Uri) -> ApiError {
    let path = crate::names::clip(uri.path());
    let hint = if path.starts_with("/api/v1/") { "" } else { ": the API is below /api/v1/, and told at /api/v1/docs" };
    ApiError::NotFound(format!("there is no {path}{hint}"))
}

async fn method_not_allowed(method: axum::http::Method, uri: axum::http::Uri) -> ApiError {
    ApiError::Method(format!("{} has no {method}", crate::names::clip(uri.path())))
}

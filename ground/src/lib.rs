//! The ground server: records flights, passes commands, serves the page.
//!
//! ```text
//! agent_link ─► ingest ─┬─► hub ─► viewers (WebSocket)
//!                       └─► recorder ─► flight files (MCAP), index (SQLite)
//! api ─► commands ─► agent_link            (acknowledgements come back through ingest)
//! ```
//! Start reading at [`hub`]: it is the only fan-out. [`run`] puts the parts together.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod agent_link;
mod api;
pub mod attack_plan;
pub mod audit;
pub mod calibrations;
pub mod commands;
pub mod config;
mod error;
pub mod front;
pub mod gains_book;
pub mod hub;
mod ingest;
pub mod lease;
pub mod names;
pub mod people;
pub mod recorder;
mod sync;

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};

pub use api::access_table;
pub use config::GroundConfig;
pub use error::GroundError;

use agent_link::LinkEvent;

/// How long requests in progress may take to end at shutdown.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(5);

/// Serves until `shutdown` completes, then finishes every open recording.
///
/// `link` is where the agents' events come from: [`agent_link`], or a test.
///
/// # Errors
/// [`GroundError`] when the data folder cannot be used at all, the listener fails, or a network is to be served without
/// TLS or without an account.
pub async fn run(
    config: GroundConfig,
    listener: TcpListener,
    link: mpsc::Receiver<LinkEvent>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), GroundError> {
    let address = listener.local_addr().map_err(GroundError::Listener)?;
    let people = people::People::open(&config.data_folder, address);
    if !address.ip().is_loopback() {
        if config.tls.is_none() {
            return Err(GroundError::NoTls { address });
        }
        if people.accounts().all()?.is_empty() {
            return Err(GroundError::NoAccounts { address });
        }
    }
    let recorder = recorder::start(&config)?;
    let audit = audit::Audit::open(&config.data_folder).map_err(GroundError::Thread)?;
    let hub = Arc::new(hub::Hub::default());
    let commands = Arc::new(commands::Commands::default());
    let leases = Arc::new(lease::Leases::default());
    let gains = Arc::new(gains_book::GainsBook::open(&config.data_folder));
    let (stop, stopped) = watch::channel(false);

    let front = front::Front::new(listener, config.tls.clone()).map_err(GroundError::Listener)?;
    let idle = config.lease_idle;
    let app = api::App::new(api::Parts {
        config,
        address,
        hub: hub.clone(),
        commands: commands.clone(),
        leases: leases.clone(),
        gains,
        people,
        audit,
        recorder: recorder.handle(),
        stopped: stopped.clone(),
    });
    let ground = ingest::Ground { hub, commands, leases, recorder: recorder.handle(), lease_idle: idle };
    let ingest = tokio::spawn(ingest::run(link, ground, stopped.clone()));
    tokio::spawn(async move {
        shutdown.await;
        stop.send_replace(true);
    });

    let mut until = stopped.clone();
    let server = axum::serve(front, api::router(app).into_make_service_with_connect_info::<front::Peer>())
        .with_graceful_shutdown(async move {
            sync::stopping(&mut until).await;
        });
    let mut overdue = stopped.clone();
    let served = tokio::select! {
        served = server => served.map_err(GroundError::Serve),
        // A download that never ends must not keep the recordings open.
        () = async move {
            sync::stopping(&mut overdue).await;
            tokio::time::sleep(SHUTDOWN_GRACE).await;
        } => Ok(()),
    };
    if ingest.await.is_err() {
        tracing::error!("the ingest task panicked");
    }
    // The recorder finishes its files last: everything received before the stop is in them.
    if tokio::task::spawn_blocking(move || recorder.finish()).await.is_err() {
        tracing::error!("the recorder could not be finished");
    }
    served
}

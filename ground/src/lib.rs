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
mod experiments;
#[cfg(feature = "many")]
mod fleet;
pub mod front;
pub mod gains_book;
pub mod hub;
mod ingest;
pub mod lease;
#[cfg(feature = "many")]
pub mod many;
pub mod metrics;
pub mod names;
#[cfg(feature = "many")]
mod objects;
pub mod people;
pub mod recorder;
mod retention;
mod scene;
mod sharing;
mod sync;
mod viewers;
mod work;

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};

pub use api::mavlink::understood;
pub use api::{access_table, page_is_built};
pub use config::{Fleet, GroundConfig, Mavlink};
pub use error::GroundError;
#[cfg(feature = "many")]
pub use fleet::examine as examine_fleet;

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
    let standing = config.mavlink.as_ref().and_then(|mavlink| mavlink.account.clone());
    let people = Arc::new(people::People::open(&config.data_folder, address).with_standing(standing));
    if !address.ip().is_loopback() {
        if config.tls.is_none() {
            return Err(GroundError::NoTls { address });
        }
        if people.accounts().all()?.is_empty() {
            return Err(GroundError::NoAccounts { address });
        }
    }
    let work = work::Work::start().map_err(GroundError::Thread)?;
    let fleet = sharing::Shared::of(&config, work.handle())?;
    let recorder = recorder::start(&config, fleet.archive())?;
    let audit = audit::Audit::open(&config.data_folder).map_err(GroundError::Thread)?;
    let hub = Arc::new(hub::Hub::default());
    let commands = Arc::new(commands::Commands::default());
    let leases = Arc::new(lease::Leases::default());
    let gains = Arc::new(gains_book::GainsBook::open(&config.data_folder));
    let (stop, stopped) = watch::channel(false);

    let limits = front::Limits::of(descriptors());
    let (tls, mavlink) = (config.tls.clone(), config.mavlink.clone());
    let idle = config.lease_idle;
    let experiments = Arc::new(experiments::Experiments::open(&config.data_folder, recorder.handle()));
    let retention = recorder::archive::Pruner::open(&config.data_folder, config.retention.clone(), recorder.handle());
    let retention = Arc::new(retention);
    work.handle().spawn(retention::run(retention.clone(), audit.clone(), stopped.clone()));
    fleet.keep_in_line(&recorder, &work, &stopped);
    let app = api::App::new(api::Parts {
        config,
        fleet: fleet.clone(),
        address,
        hub: hub.clone(),
        commands: commands.clone(),
        leases: leases.clone(),
        gains,
        people: people.clone(),
        audit: audit.clone(),
        recorder: recorder.handle(),
        retention,
        experiments: experiments.clone(),
        work: work.handle(),
        stopped: stopped.clone(),
    });
    if let Some(mavlink) = mavlink {
        let app = app.clone();
        tokio::spawn(async move {
            if let Err(error) = api::mavlink::serve(app, mavlink).await {
                tracing::error!(%error, "no MAVLink");
            }
        });
    }
    fleet.be_live(&app, &stopped);
    let ground = ingest::Ground { hub, commands, leases, people, recorder: recorder.handle(), lease_idle: idle };
    let ingest = tokio::spawn(ingest::run(link, ground, stopped.clone()));
    tokio::spawn(async move {
        shutdown.await;
        stop.send_replace(true);
    });

    let server = front::serve(listener, tls, api::router(app), limits, stopped.clone());
    let mut overdue = stopped.clone();
    tokio::select! {
        () = server => {}
        // A download that never ends must not keep the recordings open.
        () = async move {
            sync::stopping(&mut overdue).await;
            tokio::time::sleep(SHUTDOWN_GRACE).await;
        } => {}
    }
    if ingest.await.is_err() {
        tracing::error!("the ingest task panicked");
    }
    // The recorder finishes its files last: everything received before the stop is in them.
    let finish = move || {
        experiments.finish();
        recorder.finish();
        audit.flush();
    };
    if tokio::task::spawn_blocking(finish).await.is_err() {
        tracing::error!("the recorder could not be finished");
    }
    Ok(())
}

/// How many files this process may open: as many as the system lets it, not the small number it begins with.
fn descriptors() -> usize {
    let raised = rlimit::increase_nofile_limit(u64::MAX).inspect_err(|error| {
        tracing::warn!(%error, "the number of open files cannot be raised");
    });
    raised.map_or(front::RESERVED_DESCRIPTORS, |count| usize::try_from(count).unwrap_or(usize::MAX))
}

//! The radio: telemetry down, commands up, by QUIC, on a thread of its own.
//!
//! Two connections, so that live data never waits behind a repeated command: *telemetry* carries
//! unreliable datagrams under a fixed window and a rate cap, *commands* carries reliable streams.
//! Both are mutually authenticated with pinned certificates ([`identity`]). The flight thread is
//! never waited for and never made to wait: it writes frames into a ring and reads commands from a
//! queue, and nothing here can slow it down.
//!
//! Whatever ends a session, the link tries again for ever. How soon it is back after a fade:
//!
//! | fade | what happens | commands again after |
//! |---|---|---|
//! | up to 8 s ([`transport::IDLE_TIMEOUT_MS`]) | both connections live; heartbeats were sent all the time | 0.1 s |
//! | the same, the window full of backfill | given up when silent for 1.5 s beside telemetry (`stall.rs`) | 2 s |
//! | up to a minute | a new attempt every 0.25 s (`connect.rs`) | 0.25 s and a handshake |
//! | longer | a new attempt every second | 1 s and a handshake |
//!
//! A greeting that the radio swallows costs 2 s ([`hello::HELLO_TIMEOUT`]) and is repeated at once; only whom the ground
//! refuses waits longer each time.

use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use plumbline_proto::time::WallTime;
use quinn::Endpoint;
use rtrb::{Consumer, Producer};
use tokio::sync::watch;

pub use plumbline_link::{hello, identity, pairing, tls, transport};

pub mod backfill;
pub mod clock;
mod connect;
pub mod headroom;
pub mod inbound;
pub mod lateness;
mod pump;
pub mod rate;
mod session;
mod stall;

use backfill::Archive;
use clock::FlightClock;
use identity::{Identity, IdentityError};
use inbound::Inbound;

/// Commands that may wait for the flight thread; beyond them the ground waits.
pub const INBOUND_QUEUE: usize = 64;
/// Default telemetry cap, bytes a second.
pub const TELEMETRY_BYTES_PER_S: f64 = 1.5e6;
/// Default cap of backfill, bytes a second.
pub const BACKFILL_BYTES_PER_S: f64 = 500e3;

/// Longest wait between two sessions that the ground refuses.
const MAX_BACKOFF: Duration = Duration::from_secs(5);

/// What the link needs to know.
#[derive(Debug, Clone)]
pub struct LinkConfig {
    /// `host:port` of the ground; resolved anew before each session.
    pub ground: String,
    /// Name of this agent.
    pub agent_id: String,
    /// Version of this agent.
    pub version: String,
    /// Schema spoken; [`plumbline_proto::SCHEMA`] outside of tests.
    pub schema: u32,
    /// Changes with every start.
    pub boot_id: u64,
    /// Wall time at flight time zero.
    pub boot_wall_time: WallTime,
    /// Who we are and whom we trust.
    pub identity: Identity,
    /// What the radio carries: cap of live telemetry, and of both together, bytes a second.
    pub telemetry_bytes_per_s: f64,
    /// Most for backfill, which gets what live telemetry leaves, bytes a second.
    pub backfill_bytes_per_s: f64,
}

/// Where the link meets the flight thread and the log.
pub struct LinkPorts {
    /// Codec frames, written whole by the flight thread.
    pub telemetry: Consumer<u8>,
    /// Commands for the flight thread.
    pub inbound: Producer<Inbound>,
    /// Flight time, for heartbeats.
    pub clock: Arc<FlightClock>,
    /// What answers backfill requests.
    pub archive: Arc<dyn Archive>,
}

/// Counters shared with the flight thread.
#[derive(Debug, Default)]
pub struct LinkState {
    /// Is a ground connected?
    pub connected: AtomicBool,
    /// Sessions since the start; telemetry repeats its descriptions when it changes.
    pub connections: AtomicU64,
    /// Authenticated heartbeats since the start.
    pub heartbeats: AtomicU64,
    /// The last challenge that the operator's page has answered.
    pub answered: AtomicU64,
    /// Messages handed to the radio.
    pub sent: AtomicU64,
    /// Bytes handed to the radio.
    pub sent_bytes: AtomicU64,
    /// Messages given up while connected.
    pub dropped: AtomicU64,
    /// Messages sent again from the onboard log.
    pub backfilled: AtomicU64,
    /// Commands refused because they came too late.
    pub late: AtomicU64,
    reason: Mutex<String>,
}

impl LinkState {
    /// Why there is no link, or why the last one ended; empty before the first trouble.
    pub fn reason(&self) -> String {
        self.reason.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Keeps the reason, and logs it when it is another one than before.
    fn tell(&self, reason: &str) {
        let mut last = self.reason.lock().unwrap_or_else(PoisonError::into_inner);
        if *last != reason {
            tracing::warn!(reason, "no link to the ground");
            reason.clone_into(&mut last);
        }
    }
}

/// Why the link could not start.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The identity is not usable.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The thread or its runtime could not be made.
    #[error("link thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// The running link; stops when asked or dropped.
#[derive(Debug)]
pub struct LinkHandle {
    state: Arc<LinkState>,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl LinkHandle {
    /// Counters.
    pub fn state(&self) -> &Arc<LinkState> {
        &self.state
    }

    /// Says goodbye to the ground and waits for the thread.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.stop.send_replace(true);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the link thread died");
        }
    }
}

impl Drop for LinkHandle {
    fn drop(&mut self) {
        self.end();
    }
}

/// Everything one session borrows.
struct Link {
    config: LinkConfig,
    pump: pump::Pump,
    inbound: Producer<Inbound>,
    clock: Arc<FlightClock>,
    archive: Arc<dyn Archive>,
    state: Arc<LinkState>,
}

/// Starts the link on its own thread.
///
/// # Errors
/// [`LinkError`] when the identity is not usable or no thread can be made.
pub fn spawn(config: LinkConfig, ports: LinkPorts) -> Result<LinkHandle, LinkError> {
    let state = Arc::new(LinkState::default());
    let mut link = Link {
        pump: pump::Pump::new(ports.telemetry, config.telemetry_bytes_per_s),
        inbound: ports.inbound,
        clock: ports.clock,
        archive: ports.archive,
        state: state.clone(),
        config,
    };
    let configs = session::Configs::new(&link)?;
    let (stop, mut stopped) = watch::channel(false);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let thread = std::thread::Builder::new().name("link".into()).spawn(move || {
        runtime.block_on(async {
            let endpoints = Endpoints::default();
            // The goodbye is said while the connections still live: dropping them would say nothing.
            let stopping = async {
                let _ = stopped.wait_for(|stop| *stop).await;
                endpoints.close();
                endpoints.wait_idle().await;
            };
            tokio::select! {
                never = forever(&mut link, &configs, &endpoints) => match never {},
                () = stopping => {}
            }
            link.state.connected.store(false, std::sync::atomic::Ordering::Release);
        });
    })?;
    Ok(LinkHandle { state, stop, thread: Some(thread) })
}

/// One UDP socket, of the address family of the ground.
#[derive(Default)]
struct Endpoints {
    endpoint: Mutex<Option<(bool, Endpoint)>>,
}

impl Endpoints {
    fn get(&self, ground: SocketAddr) -> std::io::Result<Endpoint> {
        let mut kept = self.endpoint.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((ipv6, endpoint)) = &*kept
            && *ipv6 == ground.is_ipv6()
        {
            return Ok(endpoint.clone());
        }
        let endpoint = Endpoint::client(transport::any_port(ground))?;
        *kept = Some((ground.is_ipv6(), endpoint.clone()));
        Ok(endpoint)
    }

    fn current(&self) -> Option<Endpoint> {
        self.endpoint.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|(_, endpoint)| endpoint.clone())
    }

    fn close(&self) {
        if let Some(endpoint) = self.current() {
            endpoint.close(quinn::VarInt::from_u32(transport::CloseCode::Shutdown as u32), b"the agent shuts down");
        }
    }

    async fn wait_idle(&self) {
        if let Some(endpoint) = self.current() {
            let _ = tokio::time::timeout(Duration::from_millis(500), endpoint.wait_idle()).await;
        }
    }
}

async fn forever(link: &mut Link, configs: &session::Configs, endpoints: &Endpoints) -> std::convert::Infallible {
    let mut backoff = Duration::from_millis(100);
    loop {
        let ended = match resolve(&link.config.ground).await.and_then(|ground| Ok((ground, endpoints.get(ground)?))) {
            Ok((ground, endpoint)) => session::run(link, &endpoint, configs, ground).await,
            Err(error) => {
                let reason = format!("ground address {:?}: {error}", link.config.ground);
                session::Ended { reason, again: false }
            }
        };
        link.state.tell(&ended.reason);
        if ended.again {
            backoff = Duration::from_millis(100);
            continue;
        }
        // Keeps the ring empty while waiting.
        let wait = tokio::time::sleep(backoff);
        tokio::pin!(wait);
        while tokio::time::timeout(Duration::from_millis(20), &mut wait).await.is_err() {
            link.pump.discard();
        }
        backoff = (backoff * 2).min(MAX_BACKOFF);
    }
}

async fn resolve(ground: &str) -> std::io::Result<SocketAddr> {
    // A literal address needs no thread.
    if let Ok(address) = ground.parse() {
        return Ok(address);
    }
    let ground = ground.to_owned();
    let found = tokio::task::spawn_blocking(move || ground.to_socket_addrs().map(|mut all| all.next()))
        .await
        .map_err(std::io::Error::other)??;
    found.ok_or_else(|| std::io::Error::new(std::io::ErrorKind::NotFound, "no address"))
}

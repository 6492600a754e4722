//! The listening end of the link.

use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plumbline_link::identity::{Fingerprint, Identity, IdentityError};
use plumbline_link::tls::{self, Purpose};
use plumbline_link::transport::{self, CloseCode, FrameReader, FrameWriter};
use plumbline_link::{hello, pairing};
use plumbline_proto::SCHEMA;
use plumbline_proto::v1::{Hello, command_frame::Body};
use quinn::{Connection, Endpoint, Incoming, ServerConfig, VarInt};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::registry::{Registry, Who};
use super::{LinkEvent, session};
use crate::people::throttle::Throttle;
use crate::sync::lock;

/// Connections that may be in their handshake or alive at once; more are turned away.
pub const MAX_CONNECTIONS: usize = 64;

/// Wrong proofs of a pairing code that one address may make …
pub const PROOFS: u32 = 5;
/// … within this time; more are not looked at.
const PROOFS_WITHIN: Duration = Duration::from_secs(60);

/// What the listening end needs to know.
#[derive(Debug, Clone)]
pub struct AgentLinkConfig {
    /// Where to listen; port 0 takes any that is free.
    pub listen: SocketAddr,
    /// Who we are and whom we trust.
    pub identity: Identity,
    /// Name of this ground.
    pub ground_id: String,
    /// Version of this ground.
    pub version: String,
    /// Schema spoken; [`plumbline_proto::SCHEMA`] outside of tests.
    pub schema: u32,
}

impl AgentLinkConfig {
    /// With this build's version and schema.
    pub fn new(listen: SocketAddr, identity: Identity) -> Self {
        Self {
            listen,
            identity,
            ground_id: "ground".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            schema: u32::from(SCHEMA),
        }
    }
}

/// Why the link cannot listen.
#[derive(Debug, thiserror::Error)]
pub enum AgentLinkError {
    /// The address is not usable.
    #[error("agent link: cannot listen on udp {address}: {source}")]
    Bind {
        /// Address asked for.
        address: SocketAddr,
        /// Cause.
        source: std::io::Error,
    },
    /// The identity is not usable.
    #[error("agent link: {0}")]
    Identity(#[from] IdentityError),
    /// The hub stopped listening.
    #[error("agent link: nobody takes its events any more")]
    HubGone,
}

/// A bound socket that does not serve yet.
#[derive(Debug)]
pub struct AgentLink {
    endpoint: Endpoint,
    config: AgentLinkConfig,
    local: SocketAddr,
}

/// What every session shares.
#[derive(Debug, Clone)]
pub(super) struct Shared {
    pub config: Arc<AgentLinkConfig>,
    pub registry: Registry,
    pub events: mpsc::Sender<LinkEvent>,
    /// Batches given up because the hub was busy.
    pub dropped: Arc<AtomicU64>,
    /// Batches that were no batches.
    pub malformed: Arc<AtomicU64>,
    /// Proofs of pairing codes, by address.
    pub proofs: Arc<Mutex<Throttle<IpAddr>>>,
}

/// Listens for agents until `shutdown` completes.
///
/// # Errors
/// [`AgentLinkError`] when the address or the identity is not usable, or the events have no taker.
pub async fn run(
    config: AgentLinkConfig,
    events: mpsc::Sender<LinkEvent>,
    shutdown: impl Future<Output = ()>,
) -> Result<(), AgentLinkError> {
    AgentLink::bind(config)?.run(events, shutdown).await
}

impl AgentLink {
    /// Takes the socket; must be called within a tokio runtime.
    ///
    /// # Errors
    /// [`AgentLinkError`] when the address or the identity is not usable.
    pub fn bind(config: AgentLinkConfig) -> Result<Self, AgentLinkError> {
        let mut server = ServerConfig::with_crypto(Arc::new(tls::server(&config.identity)?));
        server.transport_config(transport::server()).max_incoming(MAX_CONNECTIONS);
        let bind_error = |source| AgentLinkError::Bind { address: config.listen, source };
        let socket = std::net::UdpSocket::bind(config.listen).map_err(bind_error)?;
        let runtime = Arc::new(quinn::TokioRuntime);
        let endpoint = Endpoint::new(endpoint(&config.identity), Some(server), socket, runtime).map_err(bind_error)?;
        let local = endpoint.local_addr().map_err(bind_error)?;
        Ok(Self { endpoint, config, local })
    }

    /// Where it listens.
    pub fn local_addr(&self) -> SocketAddr {
        self.local
    }

    /// Serves agents until `shutdown` completes, then says goodbye to them.
    ///
    /// # Errors
    /// [`AgentLinkError::HubGone`] when the receiver of the events was dropped.
    pub async fn run(
        self,
        events: mpsc::Sender<LinkEvent>,
        shutdown: impl Future<Output = ()>,
    ) -> Result<(), AgentLinkError> {
        let Self { endpoint, config, local } = self;
        tracing::info!(address = %local, fingerprint = %config.identity.fingerprint(), "waiting for agents");
        let shared = Shared {
            config: Arc::new(config),
            registry: Registry::default(),
            events: events.clone(),
            dropped: Arc::default(),
            malformed: Arc::default(),
            proofs: Arc::new(Mutex::new(Throttle::new(PROOFS, PROOFS_WITHIN))),
        };
        let mut sessions = JoinSet::new();
        let outcome = {
            tokio::pin!(shutdown);
            loop {
                tokio::select! {
                    // In this order: who stops the ground stops the hub too, and nothing has failed then.
                    biased;
                    () = &mut shutdown => break Ok(()),
                    () = events.closed() => break Err(AgentLinkError::HubGone),
                    Some(ended) = sessions.join_next(), if !sessions.is_empty() => {
                        if let Err(error) = ended {
                            tracing::error!(%error, "an agent's session died");
                        }
                    }
                    incoming = endpoint.accept() => match incoming {
                        Some(incoming) if sessions.len() < MAX_CONNECTIONS => {
                            sessions.spawn(serve(incoming, shared.clone()));
                        }
                        Some(incoming) => incoming.refuse(),
                        None => break Ok(()),
                    },
                }
            }
        };
        endpoint.close(VarInt::from_u32(CloseCode::Shutdown as u32), b"the ground shuts down");
        // Sessions end by themselves now, telling the hub; the socket stays for the goodbyes.
        let farewell = async {
            while sessions.join_next().await.is_some() {}
            endpoint.wait_idle().await;
        };
        let _ = tokio::time::timeout(Duration::from_millis(500), farewell).await;
        outcome
    }
}

/// Settings by which a restarted ground knows connections of its former self for what they are, and tells the
/// agent so at its first packet (a stateless reset) instead of leaving it to silence.
fn endpoint(identity: &Identity) -> quinn::EndpointConfig {
    let reset = ring::hmac::Key::new(ring::hmac::HMAC_SHA256, &identity.secret("stateless reset"));
    let mut config = quinn::EndpointConfig::new(Arc::new(reset));
    let [a, b, c, d, e, f, g, h, ..] = identity.secret("connection ids");
    let key = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
    config.cid_generator(move || Box::new(quinn_proto::HashedConnectionIdGenerator::from_key(key)));
    config
}

async fn serve(incoming: Incoming, shared: Shared) {
    let peer = incoming.remote_address();
    let connection = match incoming.accept() {
        Ok(connecting) => connecting.await,
        Err(error) => Err(error),
    };
    match connection {
        Ok(connection) => {
            if let Err(Refusal { code, reason }) = greet(&connection, &shared).await {
                code.close(&connection, &reason);
                tracing::warn!(%peer, reason, "agent refused");
            }
        }
        // The identity counts and reports unpaired peers itself.
        Err(error) => {
            shared.config.identity.break_off();
            tracing::debug!(%peer, %error, "no connection");
        }
    }
}

/// Why a connection is closed again, as it is said to the other end.
struct Refusal {
    code: CloseCode,
    reason: String,
}

impl Refusal {
    fn protocol(reason: impl ToString) -> Self {
        Self { code: CloseCode::Protocol, reason: reason.to_string() }
    }
}

/// Checks who it is, answers, and serves the connection to its end.
async fn greet(connection: &Connection, shared: &Shared) -> Result<(), Refusal> {
    let (Some(purpose), Some(fingerprint)) = (Purpose::of(connection), tls::peer_fingerprint(connection)) else {
        return Err(Refusal::protocol("the handshake names no purpose or no certificate"));
    };
    if purpose == Purpose::Pairing {
        return pair(connection, fingerprint, shared).await;
    }
    // While a pairing code waits, strangers pass the handshake; for anything but pairing they get nothing.
    let identity = &shared.config.identity;
    if identity.peer(fingerprint).is_none() {
        identity.refuse(fingerprint);
        return Err(Refusal::protocol("not paired"));
    }
    let Some((reader, mut writer, theirs)) = introduced(connection).await? else { return Ok(()) };
    // Whoever is trusted is trusted under its own name: nobody else's commands, flights or revocation are its.
    match identity.peer(fingerprint) {
        Some(name) if name == theirs.id => {}
        Some(name) => {
            let id = &theirs.id;
            return Err(Refusal::protocol(format!("this certificate is paired as {name:?}, not as {id:?}")));
        }
        None => return Err(Refusal::protocol("not paired")),
    }
    let who = Who { agent_id: theirs.id.clone(), boot_id: theirs.boot_id, fingerprint };
    let mine = Hello {
        schema: shared.config.schema,
        id: shared.config.ground_id.clone(),
        version: shared.config.version.clone(),
        boot_id: 0,
        boot_wall_time_us: 0,
    };
    if purpose == Purpose::Commands {
        let claim = shared.registry.claim(who, connection).await;
        let claim = claim.map_err(|reason| Refusal { code: CloseCode::Duplicate, reason })?;
        writer.send(Body::Hello(mine)).await.map_err(Refusal::protocol)?;
        session::commands(connection.clone(), reader, writer, theirs, claim, fingerprint, shared).await;
    } else {
        shared.registry.join(&who, connection).map_err(Refusal::protocol)?;
        writer.send(Body::Hello(mine)).await.map_err(Refusal::protocol)?;
        session::telemetry(connection.clone(), &theirs.id, shared).await;
    }
    let dropped = shared.dropped.load(Ordering::Relaxed);
    if dropped > 0 {
        tracing::warn!(dropped, "batches given up since the start: the hub was busy");
    }
    Ok(())
}

/// Looks at a proof of the pairing code that waits; of one address at so many in a minute.
async fn pair(connection: &Connection, fingerprint: Fingerprint, shared: &Shared) -> Result<(), Refusal> {
    let from = crate::people::origin(Some(connection.remote_address().ip()));
    let may_try = || {
        let (mut proofs, now) = (lock(&shared.proofs), Instant::now());
        let may = proofs.wait(&from, now).is_none();
        if may {
            proofs.failed(from, now);
        }
        may
    };
    let AgentLinkConfig { identity, ground_id, .. } = &*shared.config;
    let name = pairing::serve(connection, identity, ground_id, may_try).await.map_err(Refusal::protocol)?;
    tracing::warn!(agent = name, %fingerprint, "paired");
    Ok(())
}

/// What the other end says of itself, and the stream it says it on; `None` when it left before.
async fn introduced(connection: &Connection) -> Result<Option<(FrameReader, FrameWriter, Hello)>, Refusal> {
    let (send, receive) = match tokio::time::timeout(hello::HELLO_TIMEOUT, connection.accept_bi()).await {
        Ok(Ok(streams)) => streams,
        Ok(Err(error)) => {
            // An attempt that lost the race against another one of the same agent.
            tracing::debug!(reason = transport::reason(&error), "left before hello");
            return Ok(None);
        }
        Err(_) => return Err(Refusal::protocol("no hello")),
    };
    let mut reader = FrameReader::new(receive);
    let writer = FrameWriter::new(send).priority(1);
    let theirs = hello::receive(&mut reader).await.map_err(Refusal::protocol)?;
    hello::check(&theirs).map_err(|error| Refusal { code: CloseCode::Schema, reason: error.to_string() })?;
    Ok(Some((reader, writer, theirs)))
}

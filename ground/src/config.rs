//! What the ground is told at start.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use plumbline_link::identity::Identity;
use plumbline_link::signing::Key;

use crate::recorder::archive::Retention;

/// A MAVLink ground control station.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mavlink {
    /// Where it listens, UDP. One on another machine may watch, and command only where there is a key.
    pub station: SocketAddr,
    /// The account that it commands as; without one it commands only where nobody has to sign in.
    pub account: Option<String>,
    /// Both sides sign with it; what is not signed with it is refused.
    pub key: Option<Key>,
}

/// What a ground shares with others; it takes a ground with the feature `many`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Fleet {
    /// What this ground is called among them.
    pub name: String,
    /// Where its page is, for people at other grounds.
    pub address: String,
    /// The NATS server by which live vehicles are shared.
    pub nats: Option<String>,
    /// Where files and index of the flights are that are shared: a folder or `s3://BUCKET/PREFIX`, and a PostgreSQL database.
    pub archive: Option<(String, String)>,
}

/// Settings of one ground. [`GroundConfig::new`] gives the defaults.
#[derive(Debug, Clone)]
pub struct GroundConfig {
    /// Flight files, index, gains book.
    pub data_folder: PathBuf,
    /// Host names (without port), beside `localhost` and IP addresses, under which the page may be
    /// reached. A name that is not listed is refused: it could be rebound to this machine by anyone.
    pub allowed_hosts: Vec<String>,
    /// Pages of others, by their origin as their browser says it, that may open the Foxglove link, and so command by it.
    pub allowed_origins: Vec<String>,
    /// Identity of the link, so that the page can pair agents and show who was refused.
    pub link_identity: Option<Identity>,
    /// TLS of page and API; needed on every address but the loopback.
    pub tls: Option<Arc<rustls::ServerConfig>>,
    /// Are the figures of `/metrics` for everybody who reaches this ground, and not for those signed in alone?
    pub metrics_open: bool,
    /// A MAVLink ground control station that is shown the vehicles.
    pub mavlink: Option<Mavlink>,
    /// Control of a vehicle is given up when its holder does nothing and shows no sign of life for this long.
    pub lease_idle: Duration,
    /// How long a command waits for its acknowledgement.
    pub command_timeout: Duration,
    /// Recording stops, loudly, when the data folder's disk has less than this left, bytes.
    pub reserve_bytes: u64,
    /// How long flights are kept; for ever by default.
    pub retention: Retention,
    /// What is shared with other grounds.
    pub fleet: Option<Fleet>,
    /// A message that has not come after this long is asked for again: late datagrams have arrived by
    /// then and the agent has flushed its own log.
    pub backfill_after: Duration,
    /// A flight whose gaps do not shrink for this long after its end is closed as it is and
    /// completed later, when the agent has the rest.
    pub settle_after: Duration,
}

impl GroundConfig {
    /// Defaults, recording into `data_folder`.
    pub fn new(data_folder: impl Into<PathBuf>) -> Self {
        Self {
            data_folder: data_folder.into(),
            allowed_hosts: Vec::new(),
            allowed_origins: Vec::new(),
            link_identity: None,
            tls: None,
            metrics_open: false,
            mavlink: None,
            lease_idle: Duration::from_secs(60),
            command_timeout: Duration::from_secs(2),
            reserve_bytes: 64 << 20,
            retention: Retention::default(),
            fleet: None,
            backfill_after: Duration::from_millis(1500),
            settle_after: Duration::from_secs(12),
        }
    }
}

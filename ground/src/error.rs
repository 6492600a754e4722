use std::net::SocketAddr;
use std::path::PathBuf;

/// Why the ground cannot run.
#[derive(Debug, thiserror::Error)]
pub enum GroundError {
    /// The address it should serve on.
    #[error("the listening socket failed: {0}")]
    Listener(std::io::Error),
    /// A thread could not be started.
    #[error("a thread could not be started: {0}")]
    Thread(std::io::Error),
    /// Not even an index in memory could be made.
    #[error("index of flights: {0}")]
    Index(String),
    /// Signing in over a network without TLS would show every password.
    #[error("{address} is a network address: TLS is needed there")]
    NoTls {
        /// Where it should listen.
        address: SocketAddr,
    },
    /// Nobody could sign in.
    #[error(
        "{address} is a network address and there is no account; make one first: \
         plumbline-ground account add NAME --role admin"
    )]
    NoAccounts {
        /// Where it should listen.
        address: SocketAddr,
    },
    /// The accounts cannot be read.
    #[error(transparent)]
    Accounts(#[from] crate::people::AccountError),
    /// What should be shared with other grounds.
    #[error("{0}")]
    Fleet(String),
    /// Another ground uses this data folder.
    #[error("the data folder {folder} is in use by another ground: {source}")]
    Locked {
        /// The folder.
        folder: PathBuf,
        /// What the lock said.
        source: std::io::Error,
    },
}

use std::path::PathBuf;

/// Why the ground cannot run.
#[derive(Debug, thiserror::Error)]
pub enum GroundError {
    /// The address it should serve on.
    #[error("the listening socket failed: {0}")]
    Listener(std::io::Error),
    /// The server stopped by itself.
    #[error("the server stopped: {0}")]
    Serve(std::io::Error),
    /// The recorder's thread could not be started.
    #[error("the recorder thread could not be started: {0}")]
    Thread(std::io::Error),
    /// Not even an index in memory could be made.
    #[error("index of flights: {0}")]
    Index(String),
    /// Another ground uses this data folder.
    #[error("the data folder {folder} is in use by another ground: {source}")]
    Locked {
        /// The folder.
        folder: PathBuf,
        /// What the lock said.
        source: std::io::Error,
    },
}

//! What can go wrong in a task.

use std::path::{Path, PathBuf};
use std::process::ExitStatus;

/// Why a task stopped. Each message carries the command, path or figure it is about.
#[derive(Debug, thiserror::Error)]
pub enum XtaskError {
    /// A file could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A program could not be started.
    #[error("cannot start `{command}`: {source}")]
    Start {
        /// The command line.
        command: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A program ended badly.
    #[error("`{command}` ended with {status}")]
    Failed {
        /// The command line.
        command: String,
        /// How it ended.
        status: ExitStatus,
    },
    /// Something must be installed first, and this machine does not let us do it.
    #[error("{what} is missing; install it with:\n{how}")]
    Missing {
        /// What is missing.
        what: String,
        /// The commands that install it.
        how: String,
    },
    /// Anything else, told in one sentence with the offending value.
    #[error("{0}")]
    Other(String),
}

impl XtaskError {
    /// For `map_err` on file operations.
    pub fn file(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::File { path, source }
    }
}

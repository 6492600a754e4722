//! Grounds that share vehicles and flights.
//!
//! ```text
//! hub ─► bus ─► NATS ─► bus of every other ground ─► its hub       what a vehicle sends, and its lease, to look at
//!                 ◄── motor cut, from anywhere
//! recorder ─► archive ─► bucket or folder: files    ─► every other ground, when the flight is opened there
//!                   └──► PostgreSQL: index, labels  ─► mirror (SQLite) of every other ground ─► its list of flights
//! ```
//! A ground flies and records by itself: what is shared follows, and what of NATS, PostgreSQL or the storage is away costs no flight.
//! A vehicle is commanded where its link ends, under the lease of that ground; only the motor cut goes from one ground to another.

mod archive;
mod bus;
mod index;
mod mirror;

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plumbline_rest::ground::{AtGround, Fleet as Shown};
use tokio::runtime::Handle;
use tokio::sync::watch;

use crate::config::Fleet;
use crate::sync::{lock, stopping};
use archive::Archive;
use bus::Bus;

/// Longest name of a ground, characters.
const MAX_NAME: usize = 32;

/// Why grounds do not share.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FleetError {
    /// The configuration makes no sense.
    #[error("fleet: {0}")]
    Settings(String),
    /// PostgreSQL.
    #[error("PostgreSQL at {at}: {reason}")]
    Index {
        /// Where.
        at: String,
        /// Why.
        reason: String,
    },
    /// The storage of files.
    #[error("storage {at}: {reason}")]
    Storage {
        /// Where.
        at: String,
        /// Why.
        reason: String,
    },
    /// NATS.
    #[error("NATS: {0}")]
    Nats(String),
    /// This ground's own files.
    #[error("{0}")]
    Here(String),
}

/// After something failed it is tried again.
const AGAIN: Duration = Duration::from_secs(3);

/// What is wrong with something now, which is said where it changes.
#[derive(Debug)]
struct Trouble {
    with: &'static str,
    now: Mutex<Option<String>>,
}

impl Trouble {
    fn with(with: &'static str) -> Self {
        Self { with, now: Mutex::default() }
    }

    fn now(&self) -> Option<String> {
        lock(&self.now).clone()
    }

    fn set(&self, error: Option<FleetError>) {
        let error = error.map(|error| error.to_string());
        let mut now = lock(&self.now);
        if *now != error {
            match &error {
                Some(error) => tracing::warn!(error, "{}", self.with),
                None => tracing::info!("{}: all is well again", self.with),
            }
            *now = error;
        }
    }
}

/// Does `work`, and again some time after it ended, until the ground stops.
async fn until_stopped<W: Future<Output = Result<(), FleetError>>>(
    trouble: &Trouble,
    mut stopped: watch::Receiver<bool>,
    work: impl Fn() -> W,
) {
    let again = async {
        loop {
            trouble.set(work().await.err());
            tokio::time::sleep(AGAIN).await;
        }
    };
    tokio::select! {
        () = again => {}
        () = stopping(&mut stopped) => {}
    }
}

/// Is this a name for a ground: letters, digits and `-`, so that it is a part of a subject?
///
/// # Errors
/// [`FleetError::Settings`] with the name.
fn check_name(name: &str) -> Result<(), FleetError> {
    let fits = (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-');
    let text = || format!("name {name:?} is not 1 to {MAX_NAME} letters, digits or '-'");
    if fits { Ok(()) } else { Err(FleetError::Settings(text())) }
}

/// Are its servers reached? For each what it is, or why not.
pub async fn examine(fleet: &Fleet) -> Vec<Result<String, String>> {
    let mut found = Vec::new();
    if let Err(error) = check_name(&fleet.name) {
        return vec![Err(error.to_string())];
    }
    if let Some((storage, index)) = &fleet.archive {
        found.push(archive::reached(storage).await.map_err(|error| error.to_string()));
        let database = match index::Database::parse(index) {
            Ok(database) => database.connect().await.map(|_| format!("index at {}", database.at())),
            Err(error) => Err(error),
        };
        found.push(database.map_err(|error| error.to_string()));
    }
    if let Some(url) = &fleet.nats {
        found.push(bus::reached(url).await.map_err(|error| error.to_string()));
    }
    found
}

/// What of a fleet is configured.
#[derive(Debug, Clone)]
pub(crate) struct Parts {
    name: String,
    pub(crate) archive: Option<Arc<Archive>>,
    pub(crate) bus: Option<Arc<Bus>>,
}

impl Parts {
    /// Nothing is connected yet: what is away is waited for.
    ///
    /// # Errors
    /// [`FleetError::Settings`], and a storage or a copy that cannot be had.
    pub(crate) fn of(config: &Fleet, data_folder: &Path, runtime: Handle) -> Result<Self, FleetError> {
        check_name(&config.name)?;
        let archive = config
            .archive
            .as_ref()
            .map(|(storage, index)| Archive::open(&config.name, (storage, index), data_folder, runtime).map(Arc::new));
        let own = AtGround { name: config.name.clone(), address: config.address.clone() };
        let bus = config.nats.as_ref().map(|url| Arc::new(Bus::new(own, url)));
        Ok(Self { name: config.name.clone(), archive: archive.transpose()?, bus })
    }

    /// How it stands, for people.
    pub(crate) fn shown(&self) -> Shown {
        let mut shown = self.archive.as_ref().map(|archive| archive.shown()).unwrap_or_default();
        shown.name.clone_from(&self.name);
        if let Some(bus) = &self.bus {
            bus.show(&mut shown);
        }
        shown
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_name_is_a_part_of_a_subject() {
        assert_eq!(super::check_name("lab-2"), Ok(()));
        for name in ["", "lab.2", "lab 2", "lab>", "*", &"x".repeat(33)] {
            assert!(super::check_name(name).unwrap_err().to_string().contains(&format!("{name:?}")));
        }
    }
}

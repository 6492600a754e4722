//! An experiment on the disk: a folder that outlives a kill at any moment.
//!
//! | file | what |
//! |---|---|
//! | `plan.toml` | as it was written |
//! | `identity.json` | its hash, the program, when it was made, which recordings it flies, how it draws levels |
//! | `flights.rows` | a [`Row`] for each finished flight, appended in the order they ended |
//! | `ticks.json` | how long the agent's ticks took here, by condition |
//! | `by_hand.jsonl` | what was said of each flight of an operator |
//! | `errors.txt` | flights that could not be flown, and why |
//! | `lock` | held by whoever flies; in it, since when and from where |
//! | `stop` | asks it to end |
//!
//! A row is appended by one write. A kill can only tear the last one: it is cut off, and its flight flown again, before
//! anything else is appended.

use std::fs::{self, File, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::by_hand;
use crate::plan::{Draw, PROGRAM, Plan, PlanError};
use crate::recordings::{Named, UnusableError};
use crate::row::{FIRST, MEASURES, ROW_BYTES, Row, names, places, row_bytes};

/// A lock is tried again so often.
const TRIES: u32 = 20;

/// What went wrong with an experiment's folder.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// There is no such experiment.
    #[error("there is no experiment {0:?}")]
    Unknown(String),
    /// Its plan.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// Another program began it: its results would be mixed.
    #[error(
        "experiment {id} was begun by program {begun_by}, this is {PROGRAM}; results are not mixed: run its plan anew"
    )]
    Foreign {
        /// Its id.
        id: String,
        /// The other program.
        begun_by: String,
    },
    /// Flights that should be flown again for their traces.
    #[error("traces: {0}")]
    Traces(String),
    /// A recording is not what it was.
    #[error(transparent)]
    Recording(#[from] UnusableError),
    /// It is flown by an operator.
    #[error("experiment {0} is flown by hand: its next flight is told by the page, or at by-hand")]
    ByHand(String),
    /// Somebody flies it already.
    #[error("experiment {0} is being flown")]
    Running(String),
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Io { path, source }
}

/// What does not change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Of plan and program.
    pub hash: String,
    /// The program that may fly it.
    pub program: String,
    /// When it was made, µs since 1970.
    pub made_unix_us: u64,
    /// Flights of the whole plan.
    pub flights: u64,
    /// What its rows have, in their order.
    #[serde(default = "first")]
    pub measures: Vec<String>,
    /// The recordings that it flies again.
    #[serde(default)]
    pub recordings: Vec<Named>,
    /// How its levels follow from its seed, where they are drawn.
    #[serde(default)]
    pub draw: Draw,
}

fn first() -> Vec<String> {
    names(MEASURES.get(..FIRST).unwrap_or_default())
}

/// Since when it is flown, and how many flights were there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Since {
    /// µs since 1970.
    pub unix_us: u64,
    /// Flights.
    pub flights: u64,
}

/// An experiment in its folder.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// Its name there.
    pub id: String,
    /// The folder.
    pub folder: PathBuf,
    /// What is flown.
    pub plan: Plan,
    /// What does not change.
    pub identity: Identity,
}

/// Held while it is flown.
#[derive(Debug)]
pub struct Held {
    _lock: File,
    rows: File,
    path: PathBuf,
}

/// µs since 1970.
pub fn now_unix_us() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64)
}

impl Experiment {
    /// The folder of all experiments in a ground's data folder.
    pub fn root(data: &Path) -> PathBuf {
        data.join("experiments")
    }

    /// What a plan, flown by this program, is called.
    pub fn id_of(plan: &Plan) -> String {
        format!("{}-{}", plan.name, plan.hash().get(..10).unwrap_or_default())
    }

    /// Makes it in `root`; the same plan of the same program is the same experiment.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn create(root: &Path, plan: Plan) -> Result<Self, StoreError> {
        let (hash, id) = (plan.hash(), Self::id_of(&plan));
        let folder = root.join(&id);
        if folder.join("identity.json").exists() {
            return Self::open(root, &id);
        }
        fs::create_dir_all(&folder).map_err(io(&folder))?;
        let (program, made_unix_us, flights) = (PROGRAM.into(), now_unix_us(), plan.flights());
        let (measures, recordings) = (names(&MEASURES), plan.recordings.named().cloned().collect());
        let identity = Identity { hash, program, made_unix_us, flights, measures, recordings, draw: plan.draw };
        write_whole(&folder.join("plan.toml"), plan.text.as_bytes())?;
        // Last: an experiment is there with it.
        write_whole(&folder.join("identity.json"), &serde_json::to_vec(&identity).unwrap_or_default())?;
        Ok(Self { id, folder, plan, identity })
    }

    /// Opens one.
    ///
    /// # Errors
    /// [`StoreError`]: there is none, or its files cannot be read.
    pub fn open(root: &Path, id: &str) -> Result<Self, StoreError> {
        let plain = !id.is_empty() && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
        let folder = root.join(id);
        if !plain || !folder.join("identity.json").exists() {
            return Err(StoreError::Unknown(id.chars().take(80).collect()));
        }
        let path = folder.join("identity.json");
        let bytes = fs::read(&path).map_err(io(&path))?;
        let identity: Identity = serde_json::from_slice(&bytes).map_err(|error| io(&path)(error.into()))?;
        let path = folder.join("plan.toml");
        let mut plan = Plan::parse(&fs::read_to_string(&path).map_err(io(&path))?)?.knowing(&identity.recordings);
        plan.draw = identity.draw;
        Ok(Self { id: id.to_owned(), folder, plan, identity })
    }

    /// Every experiment in `root`, the newest first; those that cannot be read are left out.
    pub fn all(root: &Path) -> Vec<Self> {
        let entries = fs::read_dir(root).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        let mut all: Vec<_> = names.filter_map(|id| Self::open(root, &id).ok()).collect();
        all.sort_by_key(|experiment| std::cmp::Reverse(experiment.identity.made_unix_us));
        all
    }

    /// May this program fly it?
    ///
    /// # Errors
    /// [`StoreError::Foreign`].
    pub fn own(&self) -> Result<(), StoreError> {
        if self.identity.hash == self.plan.hash() {
            return Ok(());
        }
        Err(StoreError::Foreign { id: self.id.clone(), begun_by: self.identity.program.clone() })
    }

    fn rows_path(&self) -> PathBuf {
        self.folder.join("flights.rows")
    }

    /// Finished flights, without reading them.
    pub fn done(&self) -> u64 {
        if self.plan.is_by_hand() {
            return by_hand::accepted(self).map_or(0, |accepted| accepted.len() as u64);
        }
        fs::metadata(self.rows_path()).map_or(0, |meta| meta.len() / row_bytes(self.identity.measures.len()) as u64)
    }

    /// Every finished flight once, by its index.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn rows(&self) -> Result<Vec<Row>, StoreError> {
        let path = self.rows_path();
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Vec::new(),
            read => read.map_err(io(&path))?,
        };
        let places = places(&self.identity.measures);
        let whole = bytes.chunks_exact(row_bytes(places.len()));
        let mut rows: Vec<_> = whole.filter_map(|bytes| Row::decode(bytes, &places)).collect();
        rows.retain(|row| u64::from(row.index) < self.plan.flights());
        if self.plan.is_by_hand() {
            // Of one that was void once, the last counts.
            rows.reverse();
            let accepted = by_hand::accepted(self)?;
            rows.retain(|row| accepted.contains_key(&u64::from(row.index)));
        }
        rows.sort_by_key(|row| row.index);
        rows.dedup_by_key(|row| row.index);
        Ok(rows)
    }

    /// Takes it for this process alone, and cuts off what a kill has torn.
    ///
    /// # Errors
    /// [`StoreError::Running`], [`StoreError::Foreign`], [`StoreError::Io`].
    pub fn hold(&self) -> Result<Held, StoreError> {
        self.own()?;
        let path = self.folder.join("lock");
        let mut lock =
            File::options().read(true).write(true).create(true).truncate(false).open(&path).map_err(io(&path))?;
        let mut tries = 0;
        loop {
            match lock.try_lock() {
                Ok(()) => break,
                // Whoever asks how it stands holds it for a moment.
                Err(TryLockError::WouldBlock) if tries < TRIES => {
                    tries += 1;
                    std::thread::sleep(Duration::from_millis(5));
                }
                Err(TryLockError::WouldBlock) => return Err(StoreError::Running(self.id.clone())),
                Err(TryLockError::Error(error)) => return Err(io(&path)(error)),
            }
        }
        let _ = fs::remove_file(self.folder.join("stop"));
        let path = self.rows_path();
        let rows = File::options().append(true).create(true).open(&path).map_err(io(&path))?;
        let size = rows.metadata().map_err(io(&path))?.len();
        rows.set_len(size - size % ROW_BYTES as u64).map_err(io(&path))?;
        let since = Since { unix_us: now_unix_us(), flights: self.rows()?.len() as u64 };
        let told = serde_json::to_vec(&since).unwrap_or_default();
        let written = lock.set_len(0).and_then(|()| lock.write_all(&told));
        written.map_err(io(&self.folder.join("lock")))?;
        Ok(Held { _lock: lock, rows, path })
    }

    /// Since when it is flown; `None` while nobody does.
    pub fn since(&self) -> Option<Since> {
        let mut lock = File::open(self.folder.join("lock")).ok()?;
        let free = lock.try_lock_shared();
        if !matches!(free, Err(TryLockError::WouldBlock)) {
            return None;
        }
        let mut text = String::new();
        lock.read_to_string(&mut text).ok()?;
        Some(serde_json::from_str(&text).unwrap_or(Since { unix_us: now_unix_us(), flights: self.done() }))
    }

    /// Asks whoever flies it to end after the flights that are in the air.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn ask_to_stop(&self) -> Result<(), StoreError> {
        let path = self.folder.join("stop");
        fs::write(&path, b"").map_err(io(&path))
    }

    /// Was that asked?
    pub fn asked_to_stop(&self) -> bool {
        self.folder.join("stop").exists()
    }

    /// What a file of its folder has, JSON; the default where it has nothing.
    pub(crate) fn read_beside<T: Default + DeserializeOwned>(&self, file: &str) -> T {
        let read = fs::read(self.folder.join(file)).ok();
        read.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
    }

    /// Keeps something in a file of its folder, JSON.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub(crate) fn keep_beside(&self, file: &str, what: &impl Serialize) -> Result<(), StoreError> {
        write_whole(&self.folder.join(file), &serde_json::to_vec(what).unwrap_or_default())
    }

    /// Keeps why a flight could not be flown.
    pub fn keep_error(&self, index: u64, error: &str) {
        let line = format!("flight {index}: {error}\n");
        let file = File::options().append(true).create(true).open(self.folder.join("errors.txt"));
        // The row says that it was not flown, whatever becomes of the reason.
        let _ = file.and_then(|mut file| file.write_all(line.as_bytes()));
    }
}

impl Held {
    /// Adds a finished flight: all of it, or nothing that counts.
    ///
    /// # Errors
    /// [`StoreError::Io`]: nothing finished before is lost.
    pub fn append(&mut self, row: &Row) -> Result<(), StoreError> {
        self.rows.write_all(&row.encode()).map_err(io(&self.path))
    }

    /// Has the disk keep what was added.
    pub fn sync(&self) {
        let _ = self.rows.sync_data();
    }
}

/// Under another name first: there is all of it, or the file from before.
///
/// # Errors
/// [`StoreError::Io`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    plumbline_file::write_atomically(path, bytes).map_err(io(path))
}

//! The shared archive: every finished flight of every ground, its file in a bucket or folder, its entry in the shared index.
//!
//! A file is named for its flight and its content, and never changed: `ID-HASH.mcap`. So an entry always leads to a whole file, and
//! one that was begun twice is the same. Beside it lies its entry, `ID.json`: an index that is lost is made again from these.

use std::path::Path as FilePath;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures_util::TryStreamExt as _;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt as _, WriteMultipart};
use plumbline_rest::ground::Fleet as Shown;
use sha2::{Digest as _, Sha256};
use tokio::fs::File;
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _, AsyncWriteExt as _};
use tokio::runtime::Handle;
use tokio::sync::watch;

use super::index::{Connected, Database};
use super::mirror::{Entry, Mirror};
use super::{FleetError, Trouble, until_stopped};
use crate::recorder::archive::{hash_of, hex};
use crate::recorder::{Completeness, Flight, Labels, RecorderHandle, RecordingError, SharedArchive};

/// How often it is looked for what is new, here and there.
const LOOKS: Duration = Duration::from_secs(1);
/// Bytes of a file read at once, and sent as one part.
const PIECE: usize = 8 << 20;
/// Parts on their way at a time.
const ON_THE_WAY: usize = 4;
/// Characters of a hash in the name of a file.
const SHORT: usize = 16;

/// Flights of several grounds.
#[derive(Debug)]
pub(crate) struct Archive {
    ground: String,
    database: Database,
    objects: Box<dyn ObjectStore>,
    prefix: Path,
    at: String,
    mirror: Mirror,
    runtime: Handle,
    /// Flights of this ground that are not in it yet.
    waiting: AtomicU64,
    trouble: Trouble,
}

impl Archive {
    /// Of the ground called `ground`, files at `storage` and index at `index`, copy in `data_folder`; nothing is connected yet.
    ///
    /// # Errors
    /// [`FleetError`]: an address that is none, or a copy that cannot be kept.
    pub(crate) fn open(
        ground: &str,
        (storage, index): (&str, &str),
        data_folder: &FilePath,
        runtime: Handle,
    ) -> Result<Self, FleetError> {
        let (objects, prefix) =
            crate::objects::open(storage).map_err(|reason| FleetError::Storage { at: storage.to_owned(), reason })?;
        Ok(Self {
            ground: ground.to_owned(),
            database: Database::parse(index)?,
            objects,
            prefix,
            at: storage.to_owned(),
            mirror: Mirror::open(data_folder)?,
            runtime,
            waiting: AtomicU64::default(),
            trouble: Trouble::with("the archive of the fleet, for which flights wait"),
        })
    }

    pub(super) fn shown(&self) -> Shown {
        Shown {
            archive: Some(self.at.clone()),
            index: Some(self.database.at().to_owned()),
            waiting: self.waiting.load(Ordering::Relaxed),
            archive_error: self.trouble.now(),
            ..Shown::default()
        }
    }

    /// Keeps archive and ground in line until the ground stops.
    pub(crate) async fn keep_in_line(&self, recorder: RecorderHandle, stopped: watch::Receiver<bool>) {
        until_stopped(&self.trouble, stopped, || self.follow(&recorder)).await;
    }

    /// Takes in and gives what is new, for as long as all goes well.
    async fn follow(&self, recorder: &RecorderHandle) -> Result<(), FleetError> {
        let mut index = self.database.connect().await?;
        self.mirror.be_of(&index.database)?;
        if index.is_empty().await? {
            self.restore(&mut index).await?;
        }
        let mut given = None;
        loop {
            // The start sweeps the folder and knows only later what is in it.
            if recorder.ready() {
                self.take(&index, recorder).await?;
                let generation = recorder.generation();
                if given != Some(generation) {
                    self.give(&mut index, recorder).await?;
                    given = Some(generation);
                }
                self.trouble.set(None);
            }
            tokio::time::sleep(LOOKS).await;
        }
    }

    /// Takes changes of the index in, one after the other.
    async fn take(&self, index: &Connected, recorder: &RecorderHandle) -> Result<(), FleetError> {
        loop {
            let changes = index.changes(self.mirror.taken()?).await?;
            let Some(last) = changes.last().map(|last| last.revision) else { return Ok(()) };
            for entry in &changes {
                self.take_one(entry, recorder).map_err(|error| FleetError::Here(error.to_string()))?;
            }
            self.mirror.set_taken(last)?;
        }
    }

    /// The entry is kept last: what is cut off before is done again.
    fn take_one(&self, entry: &Entry, recorder: &RecorderHandle) -> Result<(), RecordingError> {
        let known = self.mirror.entry(&entry.id)?;
        match recorder.flight_here(&entry.id)? {
            Some(_) if entry.deleted => match recorder.delete_here(&entry.id) {
                // One that is recorded goes on here, and is not brought back there.
                Ok(()) | Err(RecordingError::InProgress(_) | RecordingError::Unknown(_)) => {}
                Err(error) => return Err(error),
            },
            Some(flight) => {
                let (own, theirs) = (Labels { name: flight.name, notes: flight.notes }, entry.labels());
                // What was written here since is the newer word, and is given next.
                let untouched = match known {
                    Some(known) => own == known.labels(),
                    None => theirs != Labels::default(),
                };
                if untouched && own != theirs {
                    recorder.relabel(&entry.id, &theirs)?;
                }
            }
            None => {}
        }
        Ok(self.mirror.take(entry)?)
    }

    /// Gives what the archive lacks of this ground's flights.
    async fn give(&self, index: &mut Connected, recorder: &RecorderHandle) -> Result<(), FleetError> {
        let here = |error: RecordingError| FleetError::Here(error.to_string());
        let mut lacking = Vec::new();
        for flight in recorder.flights_here().map_err(here)? {
            let known = self.mirror.entry(&flight.id)?;
            if flight.completeness != Completeness::Recording && !known.as_ref().is_some_and(|known| known.deleted) {
                let labels = Labels { name: flight.name.clone(), notes: flight.notes.clone() };
                let whole = known.as_ref().is_some_and(|known| known.messages >= messages(&flight));
                if !whole || known.is_some_and(|known| known.labels() != labels) {
                    lacking.push((flight, labels, whole));
                }
            }
        }
        // The oldest first. A file that cannot be read here holds up none of the others.
        let mut unread = None;
        while let Some((flight, labels, whole)) = lacking.pop() {
            self.waiting.store(lacking.len() as u64 + 1, Ordering::Relaxed);
            match self.give_one(index, recorder, &flight, &labels, whole).await {
                Err(FleetError::Here(error)) => unread = Some(FleetError::Here(format!("{}: {error}", flight.id))),
                given => given?,
            }
        }
        self.waiting.store(unread.is_some().into(), Ordering::Relaxed);
        unread.map_or(Ok(()), Err)
    }

    async fn give_one(
        &self,
        index: &mut Connected,
        recorder: &RecorderHandle,
        flight: &Flight,
        labels: &Labels,
        whole: bool,
    ) -> Result<(), FleetError> {
        if !whole && let Some(path) = recorder.finished(&flight.id) {
            self.give_file(index, flight, &path).await?;
        }
        if self.mirror.entry(&flight.id)?.is_some_and(|known| !known.deleted && known.labels() != *labels) {
            self.relabel(index, &flight.id, labels).await?;
        }
        Ok(())
    }

    async fn give_file(&self, index: &mut Connected, flight: &Flight, path: &FilePath) -> Result<(), FleetError> {
        let here = |error: std::io::Error| FleetError::Here(format!("{}: {error}", path.display()));
        // One descriptor: a file that is merged anew meanwhile does not change under it.
        let mut file = File::open(path).await.map_err(here)?;
        let own = file.try_clone().await.map_err(here)?.into_std().await;
        let hashed = tokio::task::spawn_blocking(move || hash_of(own)).await;
        let (sha256, size) = hashed.map_err(std::io::Error::other).and_then(|hashed| hashed).map_err(here)?;
        let object = format!("{}-{}.mcap", flight.id, sha256.get(..SHORT).unwrap_or_default());
        let place = self.prefix.clone().join(object.as_str());
        let there = self.objects.head(&place).await;
        if !there.is_ok_and(|there| there.size == size) {
            file.rewind().await.map_err(here)?;
            self.upload(&mut file, &place).await?;
        }
        let before = self.mirror.entry(&flight.id)?;
        let bare = Flight { ground: None, away: false, deleted_unix_us: None, ..flight.clone() };
        let entry = Entry {
            id: flight.id.clone(),
            ground: self.ground.clone(),
            object,
            sha256,
            size: i64::try_from(size).unwrap_or(i64::MAX),
            messages: messages(flight),
            name: flight.name.clone(),
            notes: flight.notes.clone(),
            flight: serde_json::to_string(&bare).unwrap_or_default(),
            ..Entry::default()
        };
        let kept = index.put(&entry).await?;
        self.mirror.take(&kept)?;
        self.lay_beside(&kept).await?;
        // What nothing leads to any more; a failure leaves it there.
        for old in [before.map(|before| before.object), Some(entry.object)].into_iter().flatten() {
            if kept.deleted || old != kept.object {
                let _ = self.objects.delete(&self.prefix.clone().join(old.as_str())).await;
            }
        }
        tracing::info!(flight = flight.id, bytes = size, "in the archive of the fleet");
        Ok(())
    }

    async fn upload(&self, file: &mut File, place: &Path) -> Result<(), FleetError> {
        let upload = self.objects.put_multipart(place).await.map_err(|error| self.failed(&error))?;
        let mut upload = WriteMultipart::new_with_chunk_size(upload, PIECE);
        let mut piece = vec![0; PIECE];
        loop {
            let read = file.read(&mut piece).await.map_err(|error| FleetError::Here(error.to_string()))?;
            let Some(read) = piece.get(..read).filter(|read| !read.is_empty()) else { break };
            upload.wait_for_capacity(ON_THE_WAY).await.map_err(|error| self.failed(&error))?;
            upload.write(read);
        }
        upload.finish().await.map(drop).map_err(|error| self.failed(&error))
    }

    async fn relabel(&self, index: &mut Connected, id: &str, labels: &Labels) -> Result<(), FleetError> {
        if let Some(entry) = index.label(id, labels).await? {
            self.mirror.take(&entry)?;
            self.lay_beside(&entry).await?;
        }
        Ok(())
    }

    /// What an index that is lost is made again from.
    async fn lay_beside(&self, entry: &Entry) -> Result<(), FleetError> {
        if entry.deleted {
            return Ok(());
        }
        let text = serde_json::to_vec_pretty(entry).unwrap_or_default();
        let put = self.objects.put(&self.beside(&entry.id), text.into()).await;
        put.map(drop).map_err(|error| self.failed(&error))
    }

    fn beside(&self, id: &str) -> Path {
        self.prefix.clone().join(format!("{id}.json"))
    }

    /// Makes an index that is empty again from what lies beside the files.
    async fn restore(&self, index: &mut Connected) -> Result<(), FleetError> {
        let listed = self.objects.list(Some(&self.prefix));
        let found: Vec<Path> = listed
            .try_filter_map(|meta| async move {
                Ok(meta.location.filename().is_some_and(|name| name.ends_with(".json")).then_some(meta.location))
            })
            .try_collect()
            .await
            .map_err(|error| self.failed(&error))?;
        for place in &found {
            let got = async { self.objects.get(place).await?.bytes().await };
            let bytes = got.await.map_err(|error| self.failed(&error))?;
            let Ok(entry) = serde_json::from_slice::<Entry>(&bytes) else {
                tracing::warn!(%place, "not an entry of the shared index");
                continue;
            };
            index.put(&entry).await?;
        }
        if !found.is_empty() {
            tracing::warn!(flights = found.len(), "the shared index was empty: made again from the storage");
        }
        Ok(())
    }

    fn failed(&self, error: &object_store::Error) -> FleetError {
        FleetError::Storage { at: self.at.clone(), reason: error.to_string() }
    }

    async fn copy(&self, id: &str, path: &FilePath) -> Result<(), FleetError> {
        let gone = || FleetError::Here(format!("there is no flight {id:?} in it"));
        let entry = self.mirror.entry(id)?.filter(|entry| !entry.deleted).ok_or_else(gone)?;
        let got = self.objects.get(&self.prefix.clone().join(entry.object.as_str())).await;
        let mut pieces = got.map_err(|error| self.failed(&error))?.into_stream();
        let here = |error: std::io::Error| FleetError::Here(format!("{}: {error}", path.display()));
        let mut file = File::create(path).await.map_err(here)?;
        let mut hash = Sha256::new();
        while let Some(piece) = pieces.try_next().await.map_err(|error| self.failed(&error))? {
            hash.update(&piece);
            file.write_all(&piece).await.map_err(here)?;
        }
        file.sync_all().await.map_err(here)?;
        let found = hex(hash);
        if found == entry.sha256 {
            return Ok(());
        }
        let reason = format!("{} has SHA-256 {found}, not {}", entry.object, entry.sha256);
        Err(FleetError::Storage { at: self.at.clone(), reason })
    }

    async fn remove(&self, id: &str) -> Result<(), FleetError> {
        let Some(entry) = self.database.connect().await?.delete(id).await? else { return Ok(()) };
        for place in [self.prefix.clone().join(entry.object.as_str()), self.beside(id)] {
            match self.objects.delete(&place).await {
                Ok(()) | Err(object_store::Error::NotFound { .. }) => {}
                // It is deleted all the same: nothing leads to it.
                Err(error) => tracing::warn!(%place, %error, "stays in the storage"),
            }
        }
        // A ground that has a copy hears of it, this one too; what it is told last is what it was told first.
        self.mirror.take(&entry)
    }
}

impl From<FleetError> for RecordingError {
    fn from(error: FleetError) -> Self {
        Self::Archive(error.to_string())
    }
}

impl SharedArchive for Archive {
    fn flights(&self) -> Result<Vec<Flight>, RecordingError> {
        Ok(self.mirror.flights()?)
    }

    fn flight(&self, id: &str) -> Result<Option<Flight>, RecordingError> {
        Ok(self.mirror.flight(id)?)
    }

    fn fetch(&self, id: &str, path: &FilePath) -> Result<(), RecordingError> {
        Ok(self.runtime.block_on(self.copy(id, path))?)
    }

    fn label(&self, id: &str, labels: &Labels) -> Result<(), RecordingError> {
        let labelled = async {
            let mut index = self.database.connect().await?;
            self.relabel(&mut index, id, labels).await
        };
        Ok(self.runtime.block_on(labelled)?)
    }

    fn delete(&self, id: &str) -> Result<(), RecordingError> {
        Ok(self.runtime.block_on(self.remove(id))?)
    }
}

/// Is the storage at `address` reached?
pub(super) async fn reached(address: &str) -> Result<String, FleetError> {
    let failed = |reason: String| FleetError::Storage { at: address.to_owned(), reason };
    let (objects, prefix) = crate::objects::open(address).map_err(failed)?;
    let listed = objects.list_with_delimiter(Some(&prefix)).await.map_err(|error| failed(error.to_string()))?;
    Ok(format!("{address} has {} files of flights", listed.objects.len()))
}

fn messages(flight: &Flight) -> i64 {
    i64::try_from(flight.messages).unwrap_or(i64::MAX)
}

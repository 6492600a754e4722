//! Recordings that a plan flies again: found, hashed, read once and verified whenever they are read.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use plumbline_agent::config::RecordedFlight;
use plumbline_agent::recordings::replay::{ReplayVehicle, Samples};
use plumbline_agent::recordings::{self, Recording, RecordingError, RecordingInfo};
use plumbline_agent::sensor::{MocapPoseSample, SensorFrame};
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::script::Script;
use plumbline_agent::vehicle::Truth;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Recordings of a plan that are held in memory at a time; the one that was asked for longest ago makes room.
const HELD: usize = 8;

/// Why a recording cannot be flown again.
#[derive(Debug, thiserror::Error)]
pub enum UnusableError {
    /// Nobody knows it here.
    #[error("recording {name:?}: {reason}")]
    Unknown {
        /// As it was named.
        name: String,
        /// Where it was looked for.
        reason: String,
    },
    /// It cannot be read.
    #[error("recording {name:?}: {source}")]
    Unreadable {
        /// As it was named.
        name: String,
        /// Cause.
        source: RecordingError,
    },
    /// It is not the file that the experiment was begun with.
    #[error("recording {name:?}: {} is another file than the experiment was begun with (SHA-256 {found})", path.display())]
    Changed {
        /// As it was named.
        name: String,
        /// Where it is.
        path: PathBuf,
        /// What it is now.
        found: String,
    },
}

/// What estimates of a recording are held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Against {
    /// The true state, which it carries.
    #[default]
    Truth,
    /// Motion capture as it was sensed.
    MotionCapture,
    /// Neither is known: the estimate itself is held against the setpoint.
    Setpoint,
}

/// Brings a flight that is kept elsewhere, where there is one of this id.
type Fetch = Arc<dyn Fn(&str) + Send + Sync>;

/// Where recordings are looked for.
#[derive(Clone, Default)]
pub struct Library {
    folder: Option<PathBuf>,
    files: bool,
    fetch: Option<Fetch>,
}

impl std::fmt::Debug for Library {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Library").field("folder", &self.folder).field("files", &self.files).finish_non_exhaustive()
    }
}

impl Library {
    /// The flights that a ground keeps in its data folder.
    pub fn archive(data: &Path) -> Self {
        Self { folder: Some(data.join("flights")), ..Self::default() }
    }

    /// Files as well, by their paths.
    pub fn with_files(self) -> Self {
        Self { files: true, ..self }
    }

    /// Flights that are kept elsewhere as well: `fetch` brings the one of an id into the folder, or does nothing.
    pub fn fetching(self, fetch: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { fetch: Some(Arc::new(fetch)), ..self }
    }

    fn path(&self, name: &str) -> Result<PathBuf, String> {
        let Some(folder) = &self.folder else {
            return Err("recordings are flown where they lie, by `experiment run` or a ground, not by workers".into());
        };
        let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', '\0']);
        let flight = folder.join(format!("{name}.mcap"));
        if let Some(fetch) = self.fetch.as_ref().filter(|_| plain && !flight.is_file()) {
            fetch(name);
        }
        if plain && flight.is_file() {
            return Ok(flight);
        }
        if !self.files {
            return Err("not the id of a finished flight of this ground".into());
        }
        let missing = |error| format!("neither a flight in {} nor a file ({error})", folder.display());
        std::fs::canonicalize(name).map_err(missing)
    }
}

/// A recording that a plan names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Named {
    /// As the plan does.
    pub name: String,
    /// Where it was found.
    pub path: PathBuf,
    /// Of its content.
    pub sha256: String,
    /// What its estimates are held against.
    pub against: Against,
}

#[derive(Debug)]
struct Entry {
    named: Named,
    info: OnceLock<RecordingInfo>,
}

/// Every recording that a plan names.
#[derive(Debug, Clone, Default)]
pub struct Recordings {
    entries: Arc<[Entry]>,
    /// The one asked for last is last.
    held: Arc<Mutex<Vec<(String, Recording)>>>,
}

impl Recordings {
    /// Those of a plan that was tried before; nothing is read.
    pub(crate) fn known(named: &[Named]) -> Self {
        let entry = |named: &Named| Entry { named: named.clone(), info: OnceLock::new() };
        Self { entries: named.iter().map(entry).collect(), held: Arc::default() }
    }

    /// Those of a plan that is tried now, each looked for, hashed and read once.
    ///
    /// # Errors
    /// [`UnusableError`] with the place among `names` of the first that there is not.
    pub(crate) fn find(names: &[&str], library: &Library) -> Result<Self, (usize, UnusableError)> {
        let held = Arc::<Mutex<_>>::default();
        let mut entries = Vec::new();
        for (at, name) in names.iter().enumerate() {
            let (named, recording) = Named::find(name, library).map_err(|error| (at, error))?;
            entries.push(Entry { named, info: OnceLock::from(recording.info().clone()) });
            hold(&held, name, recording);
        }
        Ok(Self { entries: entries.into(), held })
    }

    /// The one at `path`, under a name of its own.
    ///
    /// # Errors
    /// [`UnusableError`].
    pub(crate) fn one(name: &str, path: PathBuf) -> Result<Self, UnusableError> {
        let held = Arc::<Mutex<_>>::default();
        let (named, recording) = Named::at(name, path)?;
        let entry = Entry { named, info: OnceLock::from(recording.info().clone()) };
        hold(&held, name, recording);
        Ok(Self { entries: Arc::new([entry]), held })
    }

    /// What is known of each.
    pub fn named(&self) -> impl Iterator<Item = &Named> {
        self.entries.iter().map(|entry| &entry.named)
    }

    /// Is each still what it was?
    ///
    /// # Errors
    /// [`UnusableError`] of the first that is not.
    pub fn check(&self) -> Result<(), UnusableError> {
        self.entries.iter().try_for_each(|entry| entry.named.verify())
    }

    fn entry(&self, name: &str) -> Result<&Entry, UnusableError> {
        let unknown = || UnusableError::Unknown { name: name.into(), reason: "not one of this experiment's".into() };
        self.entries.iter().find(|entry| entry.named.name == name).ok_or_else(unknown)
    }

    /// One of them, at its beginning.
    fn open(&self, name: &str) -> Result<Recording, UnusableError> {
        let entry = self.entry(name)?;
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = held.iter().position(|(known, _)| known == name) {
            let found = held.remove(at);
            let recording = found.1.clone();
            held.push(found);
            return Ok(recording);
        }
        drop(held);
        entry.named.verify()?;
        let recording = entry.named.read()?;
        hold(&self.held, name, recording.clone());
        Ok(recording)
    }

    /// What one of them holds.
    ///
    /// # Errors
    /// [`UnusableError`].
    pub(crate) fn info(&self, name: &str) -> Result<&RecordingInfo, UnusableError> {
        let entry = self.entry(name)?;
        if let Some(info) = entry.info.get() {
            return Ok(info);
        }
        let read = self.open(name)?.info().clone();
        Ok(entry.info.get_or_init(|| read))
    }
}

fn hold(held: &Mutex<Vec<(String, Recording)>>, name: &str, recording: Recording) {
    let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
    if held.len() >= HELD {
        held.remove(0);
    }
    held.push((name.to_owned(), recording));
}

impl Named {
    /// Looks for a recording and reads it.
    fn find(name: &str, library: &Library) -> Result<(Self, Recording), UnusableError> {
        let path = library.path(name).map_err(|reason| UnusableError::Unknown { name: name.into(), reason })?;
        Self::at(name, path)
    }

    fn at(name: &str, path: PathBuf) -> Result<(Self, Recording), UnusableError> {
        let mut named = Self { name: name.into(), path, sha256: String::new(), against: Against::Truth };
        named.sha256 = named.hash()?;
        let recording = named.read()?;
        let info = recording.info();
        let has = |kind: SensorKind| info.sensors.iter().any(|sensor| sensor.id.kind == kind);
        if !has(SensorKind::Imu) {
            let reason = "no sample of an IMU in it: no estimator can start".into();
            return Err(UnusableError::Unknown { name: name.into(), reason });
        }
        named.against = match info.has_truth {
            true => Against::Truth,
            false if has(SensorKind::MocapPose) => Against::MotionCapture,
            false => Against::Setpoint,
        };
        Ok((named, recording))
    }

    fn read(&self) -> Result<Recording, UnusableError> {
        recordings::open(&self.path).map_err(|source| UnusableError::Unreadable { name: self.name.clone(), source })
    }

    fn verify(&self) -> Result<(), UnusableError> {
        let found = self.hash()?;
        if found == self.sha256 {
            return Ok(());
        }
        Err(UnusableError::Changed { name: self.name.clone(), path: self.path.clone(), found })
    }

    /// Of its file, or of the names and contents of the files of its folder.
    fn hash(&self) -> Result<String, UnusableError> {
        let mut hash = Sha256::new();
        let hashed = if self.path.is_dir() { of_folder(&mut hash, &self.path) } else { of_file(&mut hash, &self.path) };
        hashed.map_err(|source| UnusableError::Unreadable {
            name: self.name.clone(),
            source: RecordingError::Io { path: self.path.clone(), source },
        })?;
        Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

fn of_folder(hash: &mut Sha256, folder: &Path) -> std::io::Result<()> {
    let entries = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut files = entries.collect::<std::io::Result<Vec<PathBuf>>>()?;
    files.retain(|path| path.is_file());
    files.sort();
    files.iter().try_for_each(|path| {
        hash.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        hash.update(std::fs::metadata(path)?.len().to_le_bytes());
        of_file(hash, path)
    })
}

fn of_file(hash: &mut Sha256, path: &Path) -> std::io::Result<()> {
    let mut file = std::fs::File::open(path)?;
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(()),
            count => hash.update(bytes.get(..count).unwrap_or_default()),
        }
    }
}

/// A recording that is flown in the place of the simulator.
#[derive(Debug, Clone)]
pub struct Recorded {
    recordings: Recordings,
    /// Which of them.
    pub name: String,
    /// As received then, attacks of then included; else as sensed.
    samples: Samples,
    /// Sensors that were attacked then and are again, and when, s after its beginning.
    pub attacked: Vec<(SensorId, f64)>,
    /// What its estimates are held against.
    pub against: Against,
    /// From its first tick to its last, s.
    pub lasts_s: f64,
    /// What it says of its flight.
    pub flown: Arc<RecordedFlight>,
}

impl Recorded {
    /// `again`: nothing else is done to its sensors, so attacks of then are seen again.
    ///
    /// # Errors
    /// A sentence: it cannot be read, or flown again.
    pub(crate) fn new(recordings: &Recordings, name: &str, again: bool, airframe: &str) -> Result<Self, String> {
        let info = recordings.info(name).map_err(|error| error.to_string())?;
        let flown = RecordedFlight::new(info, airframe).map_err(|error| format!("recording {name:?}: {error}"))?;
        let since_begin = |(sensor, at): &(SensorId, FlightTime)| (*sensor, at.seconds_since(info.span.0));
        Ok(Self {
            recordings: recordings.clone(),
            name: name.to_owned(),
            samples: if again { Samples::Received } else { Samples::Sensed },
            attacked: info.attacked.iter().filter(|_| again).map(since_begin).collect(),
            against: recordings.entry(name).map_or(Against::Truth, |entry| entry.named.against),
            lasts_s: info.span.1.seconds_since(info.span.0),
            flown: Arc::new(flown),
        })
    }

    /// What is known of its vehicle; nothing of it happens again by itself.
    pub(crate) fn scenario(&self) -> Scenario {
        let known = self.flown.scenario.clone().unwrap_or_else(Scenario::bare);
        Scenario {
            duration_s: self.lasts_s,
            tick_rate_hz: self.flown.flight.tick_rate_hz,
            script: Script::default(),
            ..known
        }
    }

    /// Ready to be flown.
    ///
    /// # Errors
    /// [`UnusableError`].
    pub(crate) fn vehicle(&self) -> Result<ReplayVehicle, UnusableError> {
        Ok(ReplayVehicle::new(self.recordings.open(&self.name)?, self.samples))
    }
}

/// What a frame's motion capture says of the state; the rest is unknown.
pub(crate) fn by_motion_capture(sensed: &SensorFrame) -> Option<Truth> {
    let MocapPoseSample { position_enu_m, world_from_body, .. } = sensed.mocap_pose?;
    Some(Truth { position_enu_m, world_from_body, ..Truth::unknown(sensed.time) })
}

//! The experiments of this ground: one is flown at a time, on threads that give way to everything else.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use plumbline_experiment::recordings::Library;
use plumbline_experiment::run::{Options, run};
use plumbline_experiment::store::{Experiment, StoreError};
use plumbline_experiment::summary;
use plumbline_rest::experiment::State;

use crate::recorder::RecorderHandle;
use crate::sync::{give_way, lock};

/// Their folder, and the one that is being flown here.
#[derive(Debug)]
pub(crate) struct Experiments {
    root: PathBuf,
    library: Library,
    flown: Mutex<Option<Flown>>,
    /// Why the last run of each ended before its end.
    errors: Arc<Mutex<BTreeMap<String, String>>>,
}

#[derive(Debug)]
struct Flown {
    id: String,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Experiments {
    pub(crate) fn open(data_folder: &Path, recorder: RecorderHandle) -> Self {
        let root = Experiment::root(data_folder);
        // Opened is fetched, where it is only in the archive of the fleet.
        let library = Library::archive(data_folder).fetching(move |flight| {
            let opened = recorder.open(flight);
            if let Err(error) = opened.map(drop) {
                tracing::debug!(flight, %error, "no recording");
            }
        });
        Self { root, library, flown: Mutex::default(), errors: Arc::default() }
    }

    /// The folder of all.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// The recordings that their plans may name.
    pub(crate) fn library(&self) -> &Library {
        &self.library
    }

    /// How one stands. Asks the disk; one that is begun here runs from that moment until its thread has ended.
    pub(crate) fn state(&self, experiment: &Experiment) -> State {
        let flown = lock(&self.flown).as_ref().map(|flown| (flown.id.clone(), flown.thread.is_finished()));
        let here = flown.is_some_and(|(id, finished)| id == experiment.id && !finished);
        let told = summary::state(experiment);
        State { error: lock(&self.errors).get(&experiment.id).cloned(), running: told.running || here, ..told }
    }

    /// Is one being flown here?
    pub(crate) fn running(&self) -> bool {
        lock(&self.flown).as_ref().is_some_and(|flown| !flown.thread.is_finished())
    }

    /// How many threads an experiment gets: a core stays free for what flies for real.
    pub(crate) fn threads() -> usize {
        Options::default().threads.saturating_sub(1).max(1)
    }

    /// Flies what is missing of it.
    ///
    /// # Errors
    /// [`StoreError::Running`], that one or another; [`StoreError::Foreign`].
    pub(crate) fn start(&self, experiment: Experiment) -> Result<(), StoreError> {
        experiment.own()?;
        if experiment.plan.is_by_hand() {
            return Err(StoreError::ByHand(experiment.id));
        }
        let mut flown = lock(&self.flown);
        if let Some(other) = flown.as_ref().filter(|other| !other.thread.is_finished()) {
            return Err(StoreError::Running(other.id.clone()));
        }
        if experiment.since().is_some() {
            return Err(StoreError::Running(experiment.id));
        }
        let (id, stop) = (experiment.id.clone(), Arc::new(AtomicBool::new(false)));
        let (asked, errors) = (stop.clone(), self.errors.clone());
        lock(&self.errors).remove(&id);
        let options = Options { threads: Self::threads(), on_thread: give_way };
        let work = move || {
            if let Err(error) = run(&experiment, &options, &asked, |_, _| {}) {
                tracing::error!(experiment = experiment.id, %error, "ended");
                lock(&errors).insert(experiment.id, error.to_string());
            }
        };
        let thread = std::thread::Builder::new().name("experiment".into()).spawn(work);
        let thread = thread.map_err(|source| StoreError::Io { path: self.root.clone(), source })?;
        *flown = Some(Flown { id, stop, thread });
        Ok(())
    }

    /// Ends what is flown here after the flights in the air. Waits for them.
    pub(crate) fn finish(&self) {
        if let Some(flown) = lock(&self.flown).take() {
            flown.stop.store(true, Ordering::Release);
            if flown.thread.join().is_err() {
                tracing::error!(experiment = flown.id, "its thread panicked");
            }
        }
    }
}

//! A row becomes a flight again: flown from its seed, with the agent's own telemetry and log, into a flight file.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plumbline_agent::estimate::secure::suite::Observed;
use plumbline_agent::flight::{Flight, FlightError};
use plumbline_agent::log::{self, LogConfig, LogError, RING_BYTES};
use plumbline_agent::telemetry::{Around, Identification, Outlet, Replay, Telemetry};
use plumbline_proto::time::WallTime;

use crate::flight::{FlyError, Seen, Setup, fly_seen};
use crate::judge::Outcome;
use crate::row::Row;
use crate::store::{Experiment, StoreError};

/// The flight waits for the log while its ring takes less than this: no message is lost.
const ROOM_BYTES: usize = 256 << 10;
/// Begins the name of an opening's folder, in that of the experiment.
const FOLDER: &str = "opened-";
/// Whoever left such a folder this long ago was killed.
const KILLED_AFTER: Duration = Duration::from_secs(24 * 3600);

/// Why a flight could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The plan has fewer.
    #[error("flight {index} is not one of the {flights} of this plan")]
    Unknown {
        /// Asked for.
        index: u64,
        /// Flights of the plan.
        flights: u64,
    },
    /// The experiment.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Its condition.
    #[error("flight {index} cannot be flown: {reason}")]
    Condition {
        /// Asked for.
        index: u64,
        /// Why.
        reason: String,
    },
    /// The flight.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// It was flown, and nothing was recorded: it never armed.
    #[error("flight {0} never armed: there is nothing to record")]
    Nothing(u64),
    /// It went otherwise than its row says. Nothing explains that but another program or a broken machine.
    #[error("flight {0} went otherwise than before")]
    Otherwise(u64),
}

/// Why a flight could not be flown into a file.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The flight.
    #[error(transparent)]
    Fly(#[from] Box<FlyError>),
    /// Its set-up.
    #[error(transparent)]
    Flight(#[from] Box<FlightError>),
    /// The flight file.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// Flies flight `index` again; the flight file is in a folder of its own, and for the caller to move away.
///
/// # Errors
/// [`OpenError`].
pub fn open(experiment: &Experiment, index: u64) -> Result<PathBuf, OpenError> {
    experiment.own()?;
    let plan = &experiment.plan;
    let index_u32 = u32::try_from(index).ok().filter(|_| index < plan.flights());
    let Some(row_index) = index_u32 else { return Err(OpenError::Unknown { index, flights: plan.flights() }) };
    let (condition, repeat) = plan.place(index);
    let seed = plan.seed_of(repeat);
    let condition = plan.condition(condition).map_err(|reason| OpenError::Condition { index, reason })?;
    let setup = condition.setup(seed);
    let agent_id = format!("{}-{index}", experiment.identity.hash.get(..8).unwrap_or_default());
    let made = WallTime(experiment.identity.made_unix_us);
    let identification = identified(agent_id, made, seed, &setup, condition.scenario_text(seed));
    let folder = own_folder(experiment, index);
    let recorded = record(&setup, identification, folder.clone());
    let opened = recorded.map_err(OpenError::from).and_then(|(file, outcome)| {
        let row = Row::new(row_index, &outcome);
        let before = experiment.rows()?.into_iter().find(|before| before.index == row_index);
        if before.is_some_and(|before| before != row) {
            return Err(OpenError::Otherwise(index));
        }
        file.ok_or(OpenError::Nothing(index))
    });
    if opened.is_err() {
        let _ = std::fs::remove_dir_all(&folder);
    }
    opened
}

/// A folder that no other opening uses, here or in another process; those that killed ones left go.
fn own_folder(experiment: &Experiment, index: u64) -> PathBuf {
    static OPENINGS: AtomicU64 = AtomicU64::new(0);
    let entries = std::fs::read_dir(&experiment.folder).into_iter().flatten().flatten();
    for left in entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(FOLDER)) {
        let changed = left.metadata().and_then(|metadata| metadata.modified()).ok();
        let age = changed.and_then(|changed| changed.elapsed().ok());
        if age.is_some_and(|age| age > KILLED_AFTER) {
            let _ = std::fs::remove_dir_all(left.path());
        }
    }
    let opening = OPENINGS.fetch_add(1, Ordering::Relaxed);
    experiment.folder.join(format!("{FOLDER}{index}-{}-{opening}", std::process::id()))
}

/// Flies it into a flight file in `folder`, which is made anew: the file, unless nothing was ever armed, and how it went.
///
/// # Errors
/// [`RecordError`].
pub(crate) fn record(
    setup: &Setup,
    identification: Identification,
    folder: PathBuf,
) -> Result<(Option<PathBuf>, Outcome), RecordError> {
    // What an attempt left that was killed.
    let _ = std::fs::remove_dir_all(&folder);
    let settings = LogConfig {
        folder: folder.clone(),
        max_bytes: log::DEFAULT_MAX_BYTES,
        agent_id: identification.agent_id.clone(),
        boot_wall_time: identification.boot_wall_time,
    };
    let (ring, frames) = rtrb::RingBuffer::new(RING_BYTES);
    let kept = log::spawn(settings, frames)?;
    let described = Flight::new(setup.config.clone()).map_err(Box::new)?;
    let mut telemetry = Telemetry::new(identification, &described, None, Some(Outlet::new(ring)));
    let mut last = None;
    let flown = fly_seen(setup, |flight, seen| {
        while telemetry.log_room().is_some_and(|room| room < ROOM_BYTES) && kept.state().error().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        let now = flight.report().sensed.time;
        if last.is_none() && seen.then.is_some() {
            // Whoever only watches is never armed.
            telemetry.record(now, true, false);
        }
        telemetry.tick(flight, seen.truth.as_ref(), &around(seen));
        last = Some(now);
    });
    if let Some(last) = last {
        telemetry.shutdown(last);
    }
    kept.stop();
    let outcome = flown.map_err(Box::new)?;
    let files = std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut recorded = files.filter(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    Ok((recorded.next(), outcome))
}

/// Who flies: the simulator, or the recording, under a name.
pub(crate) fn identified(
    agent_id: String,
    boot_wall_time: WallTime,
    seed: u64,
    setup: &Setup,
    scenario: String,
) -> Identification {
    let known = match &setup.recording {
        None => Some(&setup.scenario),
        Some(recorded) => recorded.flown.scenario.as_ref(),
    };
    Identification {
        agent_id,
        boot_id: seed,
        boot_wall_time,
        vehicle: if setup.recording.is_some() { "replay" } else { "sim" },
        rig: known.map_or("recording", |scenario| scenario.rig.name()).to_owned(),
        scenario,
        seed,
        source_file: setup.recording.as_ref().map(|recorded| recorded.name.clone()).unwrap_or_default(),
        sensors: match &setup.recording {
            None => setup.scenario.suite.descriptions(),
            Some(recorded) => recorded.flown.sensors.clone(),
        },
        strings: known.map(|scenario| scenario.rig.lines(&scenario.airframe)).unwrap_or_default(),
        promise: known.map(|scenario| Observed::promise_at_hover(&scenario.suite, &scenario.airframe)),
    }
}

/// Of a recording: mode, setpoint and motors are those of then.
fn around(seen: &Seen) -> Around<'static> {
    let replay = seen.then.map(|(recorded, progress)| Replay { speed: 1.0, progress, recorded });
    Around { replay, ..Around::default() }
}

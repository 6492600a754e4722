//! Calibrations that a command put to use are kept here, on a thread of its own: no tick waits for the disk.
//!
//! ```text
//! FOLDER/KIND-IMU.json   the file whole, as the configuration takes it; the next start flies with it
//! ```
//! The flight thread hands a change over and later finds what went wrong; both queues are bounded and neither side waits for
//! the other.

use std::io;
use std::path::{Path, PathBuf};

use plumbline_file::write_atomically;
use rtrb::{Consumer, Producer, RingBuffer};

use super::worker::{Going, Worker};
use crate::calibration::applied::Correction;
use crate::calibration::{Calibration, CalibrationFile, Kind};
use crate::event::{Text, text};
use crate::link::inbound::Calibrating;

/// Changes that may wait.
const WAITING: usize = 8;

/// What is to be on the disk.
#[derive(Debug)]
struct Change {
    kind: Kind,
    imu: u8,
    asked: Calibrating,
}

/// The flight thread's end.
#[derive(Debug)]
pub struct Keeper {
    changes: Producer<Change>,
    problems: Consumer<Text>,
    worker: Worker,
}

impl Keeper {
    /// Starts the thread that keeps calibrations in `folder`.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(folder: PathBuf) -> io::Result<Self> {
        let (changes, mut asked) = RingBuffer::<Change>::new(WAITING);
        let (mut problem, problems) = RingBuffer::new(WAITING);
        let work = move |going: Going| loop {
            // Looked at before the queue: what was handed over before the end is kept.
            let ends = !going.on();
            let Ok(Change { kind, imu, asked }) = asked.pop() else {
                if ends {
                    return;
                }
                going.sleep();
                continue;
            };
            let path = path(&folder, kind, imu);
            let outcome = match asked {
                Calibrating::Use { file, .. } => write_atomically(&path, file.as_bytes()),
                Calibrating::Drop { .. } => remove(&path),
            };
            if let Err(error) = outcome {
                let what = format_args!(
                    "calibrations: {}: {error}: the next start does not know of the change",
                    path.display()
                );
                tracing::error!("{what}");
                let _ = problem.push(text(what));
            }
        };
        let worker = Worker::start("keeper", work)?;
        Ok(Self { changes, problems, worker })
    }

    /// Hands a change over. Does not wait.
    ///
    /// # Errors
    /// Why it is not kept: too many are waiting.
    pub fn keep(&mut self, kind: Kind, imu: u8, asked: Calibrating) -> Result<(), &'static str> {
        self.changes.push(Change { kind, imu, asked }).map_err(|_| "8 changes wait for the disk")?;
        self.worker.wake();
        Ok(())
    }

    /// The next thing that went wrong. Does not wait.
    pub fn problem(&mut self) -> Option<Text> {
        self.problems.pop().ok()
    }
}

/// Adds the calibrations kept in `folder` to `calibration`; one whose place the configuration has taken is passed over, and told.
///
/// # Errors
/// A folder or a file that cannot be read, with its name: what is not understood is not flown without.
pub fn load(folder: &Path, calibration: &mut Calibration) -> Result<(), String> {
    let wrong = |path: &Path, why: &dyn std::fmt::Display| format!("{}: {why}", path.display());
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(|error| wrong(folder, &error))?,
    };
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.map_err(|error| wrong(folder, &error))?.path();
        if path.extension().is_some_and(|end| end == "json") {
            paths.push(path);
        }
    }
    paths.sort();
    for path in paths {
        let text = std::fs::read_to_string(&path).map_err(|error| wrong(&path, &error))?;
        let read = CalibrationFile::from_json(&text).and_then(|file| Correction::of(&file));
        let correction = read.map_err(|error| wrong(&path, &error))?;
        if let Err(why) = calibration.put(&correction) {
            tracing::warn!(path = %path.display(), %why, "a kept calibration is passed over");
        }
    }
    Ok(())
}

fn path(folder: &Path, kind: Kind, imu: u8) -> PathBuf {
    folder.join(format!("{}-{imu}.json", kind.name()))
}

fn remove(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        outcome => outcome,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_support::calibrations::accelerometer;

    fn asked(imu: u8) -> Calibrating {
        let file = accelerometer(imu, [1.0; 3]);
        Calibrating::Use { correction: Correction::of(&file).unwrap(), file: file.to_value().to_string() }
    }

    #[test]
    fn what_is_kept_is_there_at_the_next_start_and_what_is_dropped_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let kept = folder.path().join("kept");
        let mut keeper = Keeper::start(kept.clone()).unwrap();
        keeper.keep(Kind::Accelerometer, 1, asked(1)).unwrap();
        keeper.keep(Kind::Accelerometer, 2, asked(2)).unwrap();
        keeper.keep(Kind::Accelerometer, 1, Calibrating::Drop { kind: Kind::Accelerometer, imu: 1 }).unwrap();
        // Never there: nothing to complain of.
        keeper.keep(Kind::Thermal, 3, Calibrating::Drop { kind: Kind::Thermal, imu: 3 }).unwrap();
        drop(keeper);
        let mut calibration = Calibration::default();
        load(&kept, &mut calibration).unwrap();
        let used: Vec<_> = calibration.used().iter().map(|used| (used.kind, used.imu, used.configured)).collect();
        assert_eq!(used, [(Kind::Accelerometer, 2, false)]);
        // The configuration's goes first.
        let mut configured = Calibration::default();
        configured.add(&accelerometer(2, [1.0; 3])).unwrap();
        load(&kept, &mut configured).unwrap();
        assert!(configured.used().iter().all(|used| used.configured));
        std::fs::write(kept.join("gyroscope-1.json"), "{").unwrap();
        let said = load(&kept, &mut Calibration::default()).unwrap_err();
        assert!(said.contains("gyroscope-1.json"), "{said}");
        load(&folder.path().join("none"), &mut Calibration::default()).unwrap();
    }

    #[test]
    fn a_disk_that_takes_nothing_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("file");
        std::fs::write(&taken, "").unwrap();
        let mut keeper = Keeper::start(taken).unwrap();
        keeper.keep(Kind::Accelerometer, 1, asked(1)).unwrap();
        let begun = std::time::Instant::now();
        let said = loop {
            if let Some(said) = keeper.problem() {
                break said;
            }
            assert!(begun.elapsed().as_secs() < 30);
            std::thread::sleep(std::time::Duration::from_millis(1));
        };
        assert!(said.contains("accelerometer-1.json") && said.contains("does not know"), "{said}");
    }
}

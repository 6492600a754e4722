//! A recording of another program becomes a flight: flown again through every estimator, into a flight file.

use std::path::PathBuf;

use plumbline_agent::recordings::{Format, RecordingError};
use plumbline_proto::time::WallTime;

use crate::flight::Setup;
use crate::open::{RecordError, identified, record};
use crate::reception::Reception;
use crate::recordings::{Named, Recorded, Recordings, UnusableError};

/// The airframe that a recording is taken as of, where it does not say; nothing of it is controlled with that.
const AIRFRAME: &str = "iris";
/// Longest name of a vehicle that is made of a file's.
const MAX_NAME: usize = 24;

/// Why a recording does not become a flight.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// It cannot be read.
    #[error(transparent)]
    Unreadable(RecordingError),
    /// No estimator could start on it.
    #[error(transparent)]
    Unusable(UnusableError),
    /// What is in it.
    #[error("{0}")]
    Content(String),
    /// The flight.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// It was flown, and there is no tick in it.
    #[error("there is nothing to record in it")]
    Nothing,
}

/// A recording that was found to be one, read once.
#[derive(Debug)]
pub struct Foreign {
    recordings: Recordings,
    named: Named,
    /// Whose it is.
    pub format: Format,
    /// What one should know of it: rows skipped, sensors left out.
    pub notes: Vec<String>,
}

impl Foreign {
    /// Reads the file or folder at `path`; `name` is what people call it.
    ///
    /// # Errors
    /// [`ImportError`]: it is no recording, or one that no estimator could start on.
    pub fn read(name: &str, path: PathBuf) -> Result<Self, ImportError> {
        let format = Format::detect(&path).map_err(ImportError::Unreadable)?;
        let recordings = Recordings::one(name, path)?;
        let named = recordings.named().next().cloned().ok_or(ImportError::Nothing)?;
        let notes = recordings.info(name)?.notes.clone();
        Ok(Self { recordings, named, format, notes })
    }

    /// SHA-256 of its content, in hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.named.sha256
    }

    /// Flies it through every estimator: the flight file, in `folder`, which is made anew. Its time begins at `begin`.
    ///
    /// # Errors
    /// [`ImportError`].
    pub fn fly(&self, begin: WallTime, folder: PathBuf) -> Result<PathBuf, ImportError> {
        let recorded =
            Recorded::new(&self.recordings, &self.named.name, true, AIRFRAME).map_err(ImportError::Content)?;
        let scenario = recorded.scenario();
        let text = recorded.flown.scenario.as_ref().map(|scenario| scenario.text.clone()).unwrap_or_default();
        let setup = Setup {
            config: recorded.flown.flight.clone().with_every_estimator(),
            scenario,
            recording: Some(recorded),
            reception: Reception::All,
            attacks: Vec::new(),
            sequences: Vec::new(),
            judged_from_s: 0.0,
            comes_down: false,
        };
        let boot_id = u64::from_str_radix(self.sha256().get(..16).unwrap_or_default(), 16).unwrap_or_default();
        let identification = identified(vehicle(&self.named.name), begin, boot_id, &setup, text);
        let (file, _) = record(&setup, identification, folder)?;
        file.ok_or(ImportError::Nothing)
    }
}

impl From<UnusableError> for ImportError {
    fn from(error: UnusableError) -> Self {
        match error {
            UnusableError::Unreadable { source, .. } => Self::Unreadable(source),
            other => Self::Unusable(other),
        }
    }
}

/// What a vehicle is called that is known by the name of a file alone.
fn vehicle(name: &str) -> String {
    let stem = name.split('.').next().unwrap_or_default();
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let named: String = stem.chars().map(plain).take(MAX_NAME).collect();
    if named.trim_matches('-').is_empty() { "recording".to_owned() } else { named }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_is_called_as_the_file_is_in_letters_that_an_id_may_have() {
        assert_eq!(vehicle("sample.ulg"), "sample");
        assert_eq!(vehicle("02_slow rotation/é.csv.gz"), "02-slow-rotation--");
        assert_eq!(vehicle("..."), "recording");
        assert_eq!(vehicle(&"x".repeat(80)).len(), MAX_NAME);
    }
}

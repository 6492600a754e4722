//! Calibrations kept beside the flights: one JSON file each in `calibrations/`, as the agent reads them.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use plumbline_agent::calibration::CalibrationFile;
use serde_json::{Value, json};

use crate::gains_book::write_atomically;
use crate::sync::lock;

/// One at a time: two of one second must not take one name.
static NAMING: Mutex<()> = Mutex::new(());

/// The folder of calibrations.
#[derive(Debug, Clone)]
pub struct Calibrations {
    folder: PathBuf,
}

impl Calibrations {
    /// Those kept in `data_folder`.
    pub fn open(data_folder: &Path) -> Self {
        Self { folder: data_folder.join("calibrations") }
    }

    /// Where the file called `id` is; `None` for what is no name of ours.
    fn path(&self, id: &str) -> Option<PathBuf> {
        let safe = !id.is_empty() && id.len() <= 64 && id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
        safe.then(|| self.folder.join(format!("{id}.json")))
    }

    /// Keeps `file` under a name of its own: kind and date, numbered where they are taken.
    ///
    /// # Errors
    /// The disk.
    pub fn keep(&self, file: &CalibrationFile) -> std::io::Result<String> {
        let date: String = file.date.chars().filter(char::is_ascii_alphanumeric).take(20).collect();
        let stem = format!("{}-{date}", file.kind.name());
        let _guard = lock(&NAMING);
        let free = |id: &String| !self.folder.join(format!("{id}.json")).exists();
        let id = std::iter::once(stem.clone())
            .chain((2..=1000).map(|n| format!("{stem}-{n}")))
            .find(free)
            .ok_or_else(|| std::io::Error::other(format!("{stem}: a thousand calibrations in one second")))?;
        write_atomically(&self.folder.join(format!("{id}.json")), format!("{:#}\n", file.to_value()).as_bytes())?;
        Ok(id)
    }

    /// The file called `id`; `None` where there is none, or it is damaged.
    pub fn read(&self, id: &str) -> Option<CalibrationFile> {
        let path = self.path(id)?;
        let text = fs::read_to_string(&path).ok()?;
        match CalibrationFile::from_json(&text) {
            Ok(file) => Some(file),
            Err(error) => {
                tracing::warn!(path = %path.display(), %error, "not a calibration");
                None
            }
        }
    }

    /// All of them, newest first, without covariance and picture.
    pub fn list(&self) -> Vec<Value> {
        let Ok(entries) = fs::read_dir(&self.folder) else { return Vec::new() };
        let ids = entries.flatten().filter_map(|entry| {
            let path = entry.path();
            (path.extension()? == "json").then(|| path.file_stem().map(|s| s.to_string_lossy().into_owned()))?
        });
        let mut all: Vec<(String, Value)> = ids
            .filter_map(|id| {
                let file = self.read(&id)?;
                Some((file.date.clone(), with_id(&id, file.summary())))
            })
            .collect();
        all.sort_by(|a, b| b.0.cmp(&a.0));
        all.into_iter().map(|(_, value)| value).collect()
    }
}

/// `value` with its name in it.
pub fn with_id(id: &str, mut value: Value) -> Value {
    if let Some(object) = value.as_object_mut() {
        object.insert("id".into(), json!(id));
    }
    value
}

//! Calibrations kept beside the flights: one JSON file each in `calibrations/`, as the agent reads them.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use plumbline_core::calibration::CalibrationFile;
use plumbline_core::calibration::file::{Parameter, Plot, Series};
use plumbline_file::write_atomically;
use plumbline_rest::calibration::{self as rest, Calibration};

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
    pub fn list(&self) -> Vec<Calibration> {
        let Ok(entries) = fs::read_dir(&self.folder) else { return Vec::new() };
        let ids = entries.flatten().filter_map(|entry| {
            let path = entry.path();
            (path.extension()? == "json").then(|| path.file_stem().map(|s| s.to_string_lossy().into_owned()))?
        });
        let short = |id: String| {
            let whole = answer(&id, self.read(&id)?);
            Some(Calibration { covariance: None, picture: Vec::new(), ..whole })
        };
        let mut all: Vec<Calibration> = ids.filter_map(short).collect();
        all.sort_by(|a, b| b.date.cmp(&a.date).then_with(|| a.id.cmp(&b.id)));
        all
    }
}

/// The file kept as `id`, as it is answered.
pub fn answer(id: &str, file: CalibrationFile) -> Calibration {
    let parameter = |p: Parameter| rest::Parameter { name: p.name, value: p.value, sigma: p.sigma, unit: p.unit };
    let known = |v: f64| v.is_finite().then_some(v);
    let series = |s: Series| rest::Series {
        name: s.name,
        line: s.line,
        points: s.points.into_iter().map(|point| point.map(known)).collect(),
    };
    let picture = |p: Plot| rest::Picture {
        title: p.title,
        x: p.x,
        y: p.y,
        log: p.log,
        series: p.series.into_iter().map(series).collect(),
    };
    Calibration {
        id: id.to_owned(),
        schema: file.schema,
        kind: file.kind.name().to_owned(),
        date: file.date,
        input: file.input,
        sensor: file.sensor,
        span_s: file.span_s,
        samples: file.samples as u64,
        residual: rest::Residual { value: known(file.residual.value), unit: file.residual.unit },
        parameters: file.parameters.into_iter().map(parameter).collect(),
        covariance: Some(file.covariance),
        notes: file.notes,
        picture: file.picture.into_iter().map(picture).collect(),
    }
}

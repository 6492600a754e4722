//! `POST /api/v1/flights`: a recording from elsewhere becomes a flight. The body is a form with one file, or the files of one folder, as
//! a browser or `curl -F file=@sample.ulg` sends it.
//!
//! A flight of Plumbline is kept as it is, repaired where it was cut; one that is here already stays. What another program recorded is
//! flown through every estimator first, and the notes of the flight say what it came from.

use std::path::{Path, PathBuf};

use axum::Json;
use axum::extract::multipart::{Field, MultipartError, MultipartRejection};
use axum::extract::{Multipart, State};
use axum::http::StatusCode;
use plumbline_analysis::recordings::{Format, RecordingError};
use plumbline_experiment::import::{Foreign, ImportError};
use plumbline_proto::time::WallTime;
use plumbline_rest::flight::Imported;
use tempfile::TempDir;
use tokio::fs::File;
use tokio::io::AsyncWriteExt as _;

use super::App;
use super::error::ApiError;
use super::flights::on_disk;
use super::operator::Operator;
use crate::names::clip;
use crate::recorder::{RecorderHandle, inspect};
use crate::sync::wall_time_us;

/// Largest form.
pub(crate) const MAX_FORM: usize = 2 << 30;
/// Largest recording of another program, bytes: it is read into memory.
const MAX_FOREIGN: u64 = 256 << 20;
/// Most files of a folder.
const MAX_FILES: usize = 64;
/// Whether the disk has room is asked each time that so much was written, bytes.
const ASKED_EACH: u64 = 8 << 20;
/// Name of a folder that was sent without one.
const UNNAMED: &str = "recording";

/// What was sent, on the disk of the data folder until it is dropped.
struct Upload {
    folder: TempDir,
    /// Of its folder and of itself, the files in the order they came.
    files: Vec<(Option<String>, String)>,
    bytes: u64,
}

pub(crate) async fn import(
    State(app): State<App>,
    who: Operator,
    form: Result<Multipart, MultipartRejection>,
) -> Result<(StatusCode, Json<Imported>), ApiError> {
    let _place = app.downloads.begin(who.name())?;
    if !app.recorder.ready() {
        return Err(crate::recorder::RecordingError::NotReady.into());
    }
    let form = form.map_err(|rejection| ApiError::Invalid(rejection.body_text()))?;
    let upload = Upload::receive(form, &app).await?;
    let recorder = app.recorder.clone();
    let imported = app.computing.run(move |_| upload.take_in(&recorder)).await?;
    let status = if imported.already { StatusCode::OK } else { StatusCode::CREATED };
    Ok((status, Json(imported)))
}

impl Upload {
    async fn receive(mut form: Multipart, app: &App) -> Result<Self, ApiError> {
        let recorder = app.recorder.clone();
        let folder = on_disk(move || recorder.scratch()).await?;
        let mut upload = Self { folder, files: Vec::new(), bytes: 0 };
        while let Some(field) = form.next_field().await.map_err(|error| broken_off(&error))? {
            // Fields without a file are passed over, as of a form with a button.
            let Some((inside, name)) = field.file_name().map(named).transpose()? else { continue };
            if upload.files.len() >= MAX_FILES {
                return Err(ApiError::Invalid(format!("more than {MAX_FILES} files")));
            }
            if upload.files.iter().any(|(_, known)| *known == name) {
                return Err(ApiError::Invalid(format!("{:?} is in it twice", clip(&name))));
            }
            upload.write(field, &name, &app.recorder).await?;
            upload.files.push((inside, name));
        }
        Ok(upload)
    }

    async fn write(&mut self, mut field: Field<'_>, name: &str, recorder: &RecorderHandle) -> Result<(), ApiError> {
        let path = self.path(name);
        let told = |error: std::io::Error| ApiError::Broken(format!("{}: {error}", path.display()));
        let mut file = File::create(&path).await.map_err(told)?;
        let mut asked = None;
        while let Some(piece) = field.chunk().await.map_err(|error| broken_off(&error))? {
            if asked.is_none_or(|asked| self.bytes >= asked + ASKED_EACH) {
                asked = Some(self.bytes);
                let recorder = recorder.clone();
                on_disk(move || recorder.room_for(ASKED_EACH)).await?;
            }
            file.write_all(&piece).await.map_err(told)?;
            self.bytes += piece.len() as u64;
        }
        file.flush().await.map_err(told)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// What people call it: the file, or the folder.
    fn name(&self) -> Result<&str, ApiError> {
        match self.files.as_slice() {
            [] => Err(ApiError::Invalid("there is no file in the form".into())),
            [(_, name)] => Ok(name),
            [(folder, _), ..] => Ok(folder.as_deref().unwrap_or(UNNAMED)),
        }
    }

    fn take_in(&self, recorder: &RecorderHandle) -> Result<Imported, ApiError> {
        let name = self.name()?;
        let path = if self.files.len() == 1 { self.path(name) } else { self.folder.path().to_owned() };
        let format = Format::detect(&path).map_err(|error| self.unreadable(&error))?;
        if format == Format::Plumbline {
            return own(recorder, name, &path);
        }
        if self.bytes > MAX_FOREIGN {
            let text = format!("{name:?} has {} bytes, of other programs {MAX_FOREIGN} are read", self.bytes);
            return Err(ApiError::TooLarge(text));
        }
        self.foreign(recorder, name, path)
    }

    /// A recording of another program. One that was imported before is known by its content, where its notes still say it.
    fn foreign(&self, recorder: &RecorderHandle, name: &str, path: PathBuf) -> Result<Imported, ApiError> {
        let foreign = Foreign::read(name, path).map_err(|error| self.refused(error))?;
        let content = format!("SHA-256 {}", foreign.sha256());
        if let Some(known) = recorder.flights()?.into_iter().find(|flight| flight.notes.contains(&content)) {
            return Ok(Imported { flight: known.id, already: true, notes: foreign.notes });
        }
        let flown = recorder.scratch()?;
        let file =
            foreign.fly(WallTime(wall_time_us()), flown.path().join("flown")).map_err(|error| self.refused(error))?;
        let flight = recorder.take_in(&file)?.id;
        let said = format!("imported from {name} ({}), {content}", foreign.format.name());
        let notes = std::iter::once(said).chain(foreign.notes.iter().cloned()).collect::<Vec<_>>().join("\n");
        recorder.label(&flight, Some(clip(name)), Some(notes))?;
        Ok(Imported { flight, already: false, notes: foreign.notes })
    }

    /// Without the folder that nobody knows.
    fn unreadable(&self, error: &RecordingError) -> ApiError {
        let (folder, name) = (self.folder.path().display(), self.name().unwrap_or_default());
        let text = error.to_string().replace(&format!("{folder}/"), "");
        ApiError::Invalid(text.replace(&folder.to_string(), name))
    }

    fn refused(&self, error: ImportError) -> ApiError {
        match error {
            ImportError::Unreadable(source) => self.unreadable(&source),
            ImportError::Unusable(_) | ImportError::Content(_) | ImportError::Nothing => {
                ApiError::Invalid(error.to_string())
            }
            ImportError::Record(_) => ApiError::Broken(error.to_string()),
        }
    }
}

/// A flight of Plumbline.
fn own(recorder: &RecorderHandle, name: &str, path: &Path) -> Result<Imported, ApiError> {
    let found = inspect(path).map_err(|_| ApiError::Invalid(format!("{name:?} cannot be read")))?;
    let mut notes = Vec::new();
    if let Some(damage) = found.damage {
        if found.messages == 0 {
            return Err(ApiError::Invalid(format!("no message of {name:?} can be read: {damage}")));
        }
        notes.push(format!("repaired: {damage}"));
    }
    if let Ok(known) = recorder.flight(&found.flight_id) {
        return Ok(Imported { flight: known.id, already: true, notes: Vec::new() });
    }
    let flight = recorder.take_in(path)?;
    // Flights with notes are not deleted for their age.
    recorder.label(&flight.id, None, Some(format!("imported from {name}")))?;
    Ok(Imported { flight: flight.id, already: false, notes })
}

/// Folder, if there is one, and name of a file as a browser tells them.
fn named(told: &str) -> Result<(Option<String>, String), ApiError> {
    let mut parts = told.rsplit(['/', '\\']);
    let name = parts.next().unwrap_or_default();
    if name.is_empty() || name.starts_with('.') || name.len() > 200 || name.contains(char::is_control) {
        return Err(ApiError::Invalid(format!("{:?} is no name of a file", clip(told))));
    }
    Ok((parts.next().filter(|folder| !folder.is_empty()).map(clip), name.to_owned()))
}

fn broken_off(error: &MultipartError) -> ApiError {
    match error.status() {
        StatusCode::PAYLOAD_TOO_LARGE => ApiError::TooLarge(format!("the form is larger than {MAX_FORM} bytes")),
        _ => ApiError::Invalid(format!("the form: {}", error.body_text())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_called_by_the_last_part_of_what_is_told() {
        assert_eq!(named("sample.ulg").unwrap(), (None, "sample.ulg".into()));
        assert_eq!(named("Hover_1/IMU_1.csv").unwrap(), (Some("Hover_1".into()), "IMU_1.csv".into()));
        assert_eq!(named("../../etc/passwd").unwrap(), (Some("etc".into()), "passwd".into()));
        for bad in ["", "..", "a/", "a/.hidden", "a\0b"] {
            assert!(named(bad).is_err(), "{bad:?}");
        }
    }
}

//! Samples taken of a vehicle in somebody's hands: of each vehicle those of one IMU, read from what it sends whenever it is asked how
//! far they have come, until they are fitted or given up. What is counted is what the fits count
//! (`plumbline_core::calibration::guide`).

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use plumbline_core::calibration::guide::{self, Progress};
use plumbline_core::calibration::samples::Sample;
use plumbline_core::calibration::{CalibrationError, Kind as Of};
use plumbline_core::sensor::sample::Sample as _;
use plumbline_core::sensor::{ImuSample, MAX_IMUS};
use plumbline_proto::codec::Frame;
use plumbline_proto::{Kind, v1};
use plumbline_rest::calibration::{Aim, Taken, Taking};

use super::App;
use super::body::Body;
use super::error::ApiError;
use super::extract::Path;
use super::signals::frames;
use crate::hub::{MAX_HISTORY_SECONDS, VehicleError, VehicleInfo};
use crate::sync::lock;

/// Most samples: ten minutes at 200 Hz, 15 MB.
const MAX_SAMPLES: usize = 120_000;
/// Most vehicles; the one asked about longest ago gives way.
const MAX_VEHICLES: usize = 8;
/// So much more of the past is read than went by since the last time, s.
const SLACK_S: f64 = 1.0;
/// A sensor that sends nothing for so long is told of.
const SILENT: Duration = Duration::from_secs(1);

/// What is being taken, by vehicle.
#[derive(Debug, Default)]
pub(crate) struct Guided(Mutex<BTreeMap<String, Arc<Mutex<Samples>>>>);

/// The samples of one IMU.
#[derive(Debug)]
struct Samples {
    of: Of,
    imu: usize,
    boot_id: u64,
    /// Flight time of the newest sample that was read, µs.
    read_us: u64,
    taken: Vec<Sample>,
    /// When somebody asked last.
    asked: Instant,
    /// When the newest sample was read.
    heard: Instant,
    /// The newest problem with the vehicle itself; empty where there is none.
    problem: String,
}

impl Guided {
    fn begin(&self, vehicle: &str, samples: Samples) {
        let mut all = lock(&self.0);
        // One that is being counted is being asked about.
        let asked = |one: &Mutex<Samples>| one.try_lock().map_or_else(|_| Instant::now(), |one| one.asked);
        let oldest = all.iter().min_by_key(|(_, one)| asked(one)).map(|(id, _)| id.clone());
        if let Some(oldest) = oldest.filter(|_| all.len() >= MAX_VEHICLES && !all.contains_key(vehicle)) {
            all.remove(&oldest);
        }
        all.insert(vehicle.to_owned(), Arc::new(Mutex::new(samples)));
    }

    fn of(&self, vehicle: &str) -> Result<Arc<Mutex<Samples>>, ApiError> {
        let found = lock(&self.0).get(vehicle).cloned();
        let none = || format!("no samples are taken of {:?}", crate::names::clip(vehicle));
        found.ok_or_else(|| ApiError::NotFound(none()))
    }

    /// What was taken of `vehicle` for a calibration of this kind, and of which IMU.
    ///
    /// # Errors
    /// Nothing was, or for another kind.
    pub(crate) fn taken(&self, vehicle: &str, of: Of) -> Result<(usize, Vec<Sample>), ApiError> {
        let samples = self.of(vehicle)?;
        let samples = lock(&samples);
        if samples.of != of {
            let why = format!("the samples taken are for {}, not for {}", samples.of.name(), of.name());
            return Err(ApiError::Invalid(why));
        }
        Ok((samples.imu, samples.taken.clone()))
    }
}

impl Samples {
    /// Reads the messages of this IMU that are newer than those read before. Samples of an armed vehicle are passed over: what
    /// turns and warms and bends the field is no rest.
    fn read<'a>(&mut self, frames: impl Iterator<Item = Frame<'a>>, armed: bool) {
        let ours = |frame: &Frame<'_>| frame.known_kind() == Some(Kind::Imu) && usize::from(frame.instance) == self.imu;
        for frame in frames.filter(ours) {
            let message = frame.message::<v1::ImuSample>().ok().filter(|message| message.time_us > self.read_us);
            let Some(message) = message else { continue };
            self.read_us = message.time_us;
            let Some((sample, _)) = ImuSample::from_wire(message) else { continue };
            self.heard = Instant::now();
            if !armed && self.taken.len() < MAX_SAMPLES {
                self.taken.push(Sample {
                    time_s: sample.time.as_seconds(),
                    gyro_radps: Some(sample.gyro_radps),
                    accel_mps2: Some(sample.accel_mps2),
                    mag_ut: sample.mag_ut,
                    temperature_c: Some(sample.temperature_c),
                });
            }
        }
    }

    /// Why nothing is taken now, of this vehicle; empty while something is.
    fn hindrance(&self, vehicle: Option<&VehicleInfo>) -> String {
        let Some(vehicle) = vehicle.filter(|v| v.connected) else {
            return "the link to the vehicle is lost: hold on".to_owned();
        };
        let without_field = self.of == Of::Magnetometer && self.taken.iter().all(|s| s.mag_ut.is_none());
        let span_s = self.span_s();
        if vehicle.boot_id != self.boot_id {
            "the vehicle has started again: begin anew".to_owned()
        } else if armed(vehicle) {
            "the vehicle is armed: disarm it first".to_owned()
        } else if self.taken.len() >= MAX_SAMPLES {
            format!("{MAX_SAMPLES} samples are the most: fit them, or begin anew")
        } else if self.heard.elapsed() > SILENT {
            format!("nothing comes from IMU {}", self.imu)
        } else if without_field && span_s > SILENT.as_secs_f64() {
            format!("IMU {} has no magnetometer: its samples carry no field", self.imu)
        } else {
            String::new()
        }
    }

    fn span_s(&self) -> f64 {
        self.taken.first().zip(self.taken.last()).map_or(0.0, |(first, last)| last.time_s - first.time_s)
    }

    fn answer(&self) -> Taken {
        let (progress, refused) = match guide::progress(self.of, &self.taken) {
            Ok(progress) => (progress, None),
            Err(error) => (Progress::default(), Some(refusal(&error))),
        };
        let aim = |aim: &guide::Aim| Aim {
            what: aim.what.to_owned(),
            found: aim.found as u64,
            needed: aim.needed as u64,
            best: aim.best as u64,
        };
        Taken {
            kind: self.of.name().to_owned(),
            imu: self.imu,
            samples: self.taken.len() as u64,
            span_s: self.span_s(),
            problem: refused.unwrap_or_else(|| self.problem.clone()),
            aims: progress.aims.iter().map(aim).collect(),
            ready: progress.is_ready(),
            undetermined: progress.undetermined.map_or_else(String::new, |error| error.to_string()),
            still: progress.still,
            up: progress.up.map(Into::into),
            poses: progress.poses.into_iter().map(Into::into).collect(),
            field: progress.field.map(Into::into),
            bands: progress.bands as u64,
            sectors: progress.sectors,
        }
    }
}

fn refusal(error: &CalibrationError) -> String {
    format!("{error}: begin anew")
}

fn armed(vehicle: &VehicleInfo) -> bool {
    vehicle.status.as_ref().is_some_and(|status| status.armed)
}

/// The vehicle as it is listed.
fn listed(app: &App, id: &str) -> Option<VehicleInfo> {
    app.hub.list().into_iter().find(|vehicle| vehicle.id == id)
}

pub(crate) async fn begin(
    State(app): State<App>,
    Path(id): Path<String>,
    Body(asked): Body<Taking>,
) -> Result<Json<Taken>, ApiError> {
    let invalid = |why: String| Err(ApiError::Invalid(why));
    let of = Of::by_name(&asked.kind).map_err(|e| ApiError::Invalid(e.to_string()))?;
    let imu = asked.imu.unwrap_or(1);
    if !guide::is_guided(of) {
        return invalid(format!("{} is not calibrated by hand", of.name()));
    }
    if !(1..=MAX_IMUS).contains(&imu) {
        return invalid(format!("imu {imu} is not 1 to {MAX_IMUS}"));
    }
    let vehicle = listed(&app, &id).ok_or_else(|| VehicleError::Unknown(id.clone()))?;
    if !vehicle.connected {
        return Err(VehicleError::Disconnected(id).into());
    }
    if armed(&vehicle) {
        return Err(ApiError::Conflict(format!("{id} is armed: disarm it first")));
    }
    let mut in_use = vehicle.description.iter().flat_map(|told| &told.calibrations);
    if let Some(used) = in_use.find(|used| used.kind == of.name() && used.imu as usize == imu) {
        // What it sends is corrected already: a fit of that would hold only on top of this one.
        let why = format!("IMU {imu} flies with the {} calibration of {}: stop using that first", used.kind, used.date);
        return Err(ApiError::Conflict(why));
    }
    let now = Instant::now();
    let samples = Samples {
        of,
        imu,
        boot_id: vehicle.boot_id,
        read_us: app.hub.link_status(&id).map_or(0, |link| link.newest_time_us),
        taken: Vec::new(),
        asked: now,
        heard: now,
        problem: String::new(),
    };
    let answer = samples.answer();
    app.guided.begin(&id, samples);
    Ok(Json(answer))
}

pub(crate) async fn show(State(app): State<App>, Path(id): Path<String>) -> Result<Json<Taken>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    // Nothing is taken: that is an answer, too.
    let Ok(samples) = app.guided.of(&id) else { return Ok(Json(Taken::default())) };
    let _turn = app.thinning.acquire().await.map_err(|_| ApiError::Unavailable("the ground is stopping".into()))?;
    let since_s = lock(&samples).asked.elapsed().as_secs_f64() + SLACK_S;
    let past = app.hub.past(&id, Duration::from_secs_f64(since_s.min(MAX_HISTORY_SECONDS as f64)))?;
    let vehicle = listed(&app, &id);
    let work = move || {
        let mut samples = lock(&samples);
        samples.asked = Instant::now();
        if vehicle.as_ref().is_some_and(|vehicle| vehicle.boot_id == samples.boot_id) {
            samples.read(frames(&past), vehicle.as_ref().is_some_and(armed));
        }
        samples.problem = samples.hindrance(vehicle.as_ref());
        samples.answer()
    };
    let answer = tokio::task::spawn_blocking(work).await.map_err(|e| ApiError::Broken(e.to_string()))?;
    Ok(Json(answer))
}

pub(crate) async fn end(State(app): State<App>, Path(id): Path<String>) -> Result<StatusCode, ApiError> {
    if !app.hub.knows(&id) {
        return Err(VehicleError::Unknown(id).into());
    }
    lock(&app.guided.0).remove(&id);
    Ok(StatusCode::NO_CONTENT)
}

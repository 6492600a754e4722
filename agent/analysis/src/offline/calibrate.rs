//! Calibrations from recordings and tables: what the command line and the ground's page both call.
//!
//! ```text
//! plumbline-agent calibrate magnetometer --input FILE --first-half --output mag.json
//! ```
//! Takes every recording the agent can read and plain CSV (columns in [`super::table`]).

use std::path::{Path, PathBuf};

use plumbline_core::calibration::inertial::{Triad, accelerometer, accelerometer_of, gyroscope};
use plumbline_core::calibration::samples::Sample;
use plumbline_core::calibration::{
    Calibration, CalibrationError, CalibrationFile, Kind, allan, magnetometer, mass, motor_curve, thermal, thrust,
};
use plumbline_core::sensor::MAX_IMUS;
use plumbline_core::types::GRAVITY_MPS2;
use plumbline_proto::time::WallTime;

use super::ArgumentError;
use super::delays::{Altitudes, delays};
use super::table::Table;
use crate::recordings::{self, Format, Recording, RecordingError};

/// Name of the format of plain tables.
pub const CSV: &str = "csv";

/// What to fit from what.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// What.
    pub kind: Kind,
    /// Which IMU, from 1.
    pub imu: usize,
    /// From here on, s in the recording's own time.
    pub from_s: Option<f64>,
    /// Up to here, s.
    pub to_s: Option<f64>,
    /// The first half of the recording only.
    pub first_half: bool,
    /// Gravity of the place, m/s².
    pub gravity_mps2: f64,
    /// Accelerometer's calibration, for the gyroscope.
    pub accelerometer: Option<CalibrationFile>,
    /// Which propeller of a table of many.
    pub propeller: Option<String>,
    /// Air density for a tunnel's coefficients, kg/m³.
    pub air_density_kgpm3: f64,
    /// ISO 8601, for the file.
    pub date: String,
}

impl Request {
    /// The whole recording, IMU 1, the standard atmosphere.
    pub fn new(kind: Kind, date: impl Into<String>) -> Self {
        Self {
            kind,
            imu: 1,
            from_s: None,
            to_s: None,
            first_half: false,
            gravity_mps2: GRAVITY_MPS2,
            accelerometer: None,
            propeller: None,
            air_density_kgpm3: thrust::AIR_DENSITY_KGPM3,
            date: date.into(),
        }
    }

    /// From when to when samples count, s.
    fn stretch(&self, samples: &[Sample]) -> Result<(f64, f64), ArgumentError> {
        let (first, last) = ends(samples);
        let half = if self.first_half { 0.5 * (first + last) } else { f64::INFINITY };
        let from = self.from_s.unwrap_or(f64::NEG_INFINITY);
        let to = self.to_s.unwrap_or(f64::INFINITY).min(half);
        if from.partial_cmp(&to) == Some(std::cmp::Ordering::Less) {
            return Ok((from, to));
        }
        Err(ArgumentError::new("from", from, format!("not before the end of the selection, {to} s")))
    }
}

/// First and last time, s.
fn ends(samples: &[Sample]) -> (f64, f64) {
    samples.first().zip(samples.last()).map_or((0.0, 0.0), |(first, last)| (first.time_s, last.time_s))
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A plain table.
    #[error("{name}: {reason}")]
    Table {
        /// Its name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Motors shake and warm what is to rest, and their currents bend the field; only delays are seen in flight.
    #[error(
        "{kind} calibration refused: the motors turn at {at_s:.1} s of {name}; choose a stretch (from, to) in which they are off"
    )]
    Motors {
        /// Of what.
        kind: &'static str,
        /// The recording.
        name: String,
        /// When first within the stretch, s.
        at_s: f64,
    },
    /// The data are refused.
    #[error("{kind} calibration refused: {source}")]
    Refused {
        /// Of what.
        kind: &'static str,
        /// Why, with the numbers.
        source: CalibrationError,
    },
    /// An argument.
    #[error(transparent)]
    Argument(#[from] ArgumentError),
    /// A calibration file that is to be used.
    #[error("{path}: {source}")]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        source: CalibrationError,
    },
    /// A file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
}

/// Fits from a file: a recording of a known format, or a table (`format` = [`CSV`]); judged by its content when
/// `format` is `None`.
///
/// # Errors
/// [`CalibrateError`].
pub fn from_path(path: &Path, format: Option<&str>, request: &Request) -> Result<CalibrationFile, CalibrateError> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let format = match format {
        Some(CSV) => None,
        Some(text) => Some(super::format(text, CSV)?),
        // What is no recording may be a table.
        None => match Format::detect(path) {
            Ok(format) => Some(format),
            Err(RecordingError::Unsupported { .. }) if path.is_file() => None,
            Err(error) => return Err(error.into()),
        },
    };
    match format {
        Some(format) => from_recording(recordings::open_as(path, format)?, &name, request),
        None => from_table(recordings::text(path)?, &name, request),
    }
}

/// Fits from a table.
///
/// # Errors
/// [`CalibrateError`].
pub fn from_table(text: impl std::io::Read, name: &str, request: &Request) -> Result<CalibrationFile, CalibrateError> {
    let wrong = |reason: String| CalibrateError::Table { name: name.to_owned(), reason };
    let table = Table::read(text).map_err(wrong)?;
    let fitted = match request.kind {
        Kind::MotorCurve => motor_curve::motor_curve(&table.motor().map_err(wrong)?),
        Kind::Thrust => {
            let points = table.thrust(request.propeller.as_deref(), request.air_density_kgpm3).map_err(wrong)?;
            thrust::thrust(&points)
        }
        Kind::Mass => {
            let (mass_kg, axes) = table.mass().map_err(wrong)?;
            mass::mass(mass_kg, &axes)
        }
        _ => {
            let samples = table.imu().map_err(wrong)?;
            // A large table is not kept beside its samples.
            drop(table);
            return from_samples(samples, name, request);
        }
    };
    told(fitted, name, request)
}

/// What was fitted to what is called `name`, with its date.
fn told(
    fitted: Result<CalibrationFile, CalibrationError>,
    name: &str,
    request: &Request,
) -> Result<CalibrationFile, CalibrateError> {
    let mut file = fitted.map_err(|source| CalibrateError::Refused { kind: request.kind.name(), source })?;
    request.date.clone_into(&mut file.date);
    name.clone_into(&mut file.input);
    Ok(file)
}

/// Fits from a recording.
///
/// # Errors
/// [`CalibrateError`].
pub fn from_recording(
    mut recording: Recording,
    name: &str,
    request: &Request,
) -> Result<CalibrationFile, CalibrateError> {
    if !(1..=MAX_IMUS).contains(&request.imu) {
        let reason = format!("not 1 to {MAX_IMUS}");
        return Err(ArgumentError::new("imu", request.imu, reason).into());
    }
    let mut samples = Vec::with_capacity(recording.info().ticks);
    let mut turning_s = Vec::new();
    let mut altitudes: Vec<Altitudes> = Vec::new();
    while let Some(tick) = recording.next_tick() {
        if request.kind == Kind::Delays {
            Altitudes::take(&mut altitudes, &tick.sensed);
        }
        if tick.applied.is_some_and(|command| command.throttle.iter().any(|throttle| *throttle > 0.0)) {
            turning_s.push(tick.sensed.time.as_seconds());
        }
        if let Some(Some(imu)) = tick.sensed.imus.get(request.imu - 1) {
            samples.push(Sample {
                time_s: imu.time.as_seconds(),
                gyro_radps: Some(imu.gyro_radps),
                accel_mps2: Some(imu.accel_mps2),
                mag_ut: imu.mag_ut,
                temperature_c: Some(imu.temperature_c),
            });
        }
    }
    let (from_s, to_s) = request.stretch(&samples)?;
    if request.kind == Kind::Delays {
        let (first, last) = ends(&samples);
        samples.retain(|s| !(s.time_s < from_s || s.time_s > to_s));
        let mut file = told(delays(&samples, &altitudes), name, request)?;
        file.span_s = Some([from_s.max(first), to_s.min(last)]);
        return Ok(file);
    }
    if let Some(at_s) = turning_s.into_iter().find(|at_s| (from_s..=to_s).contains(at_s)) {
        return Err(CalibrateError::Motors { kind: request.kind.name(), name: name.to_owned(), at_s });
    }
    let mut file = from_samples(samples, name, request)?;
    let info = recording.info();
    let before =
        info.calibrations.iter().find(|used| used.kind == request.kind.name() && used.imu as usize == request.imu);
    if let Some(used) = before {
        let (imu, date) = (used.imu, &used.date);
        file.notes.push(format!("IMU {imu} was calibrated already, by that of {date}: this is what that one left"));
    }
    Ok(file)
}

/// Fits from samples of one IMU.
///
/// # Errors
/// [`CalibrateError`].
pub fn from_samples(
    mut samples: Vec<Sample>,
    name: &str,
    request: &Request,
) -> Result<CalibrationFile, CalibrateError> {
    let (first, last) = ends(&samples);
    let (from, to) = request.stretch(&samples)?;
    // NaN times pass on to the checks of the fit.
    samples.retain(|s| !(s.time_s < from || s.time_s > to));
    let fitted = match request.kind {
        Kind::Accelerometer => accelerometer(&samples, request.gravity_mps2),
        Kind::Gyroscope => match request.accelerometer.as_ref().map(accelerometer_of).transpose() {
            Ok(triad) => gyroscope(&samples, &triad.unwrap_or_else(Triad::identity)),
            Err(error) => Err(error),
        },
        Kind::Magnetometer => magnetometer::magnetometer(&samples),
        Kind::Thermal => thermal::thermal(&samples),
        Kind::Allan => allan::allan(&samples),
        Kind::Delays => {
            return Err(ArgumentError::new("kind", request.kind.name(), "is fitted from a recorded flight only").into());
        }
        Kind::MotorCurve | Kind::Thrust | Kind::Mass => {
            let reason = format!("is not fitted from samples of an IMU: give a table (--format {CSV})");
            return Err(ArgumentError::new("kind", request.kind.name(), reason).into());
        }
    };
    let mut file = told(fitted, name, request)?;
    file.sensor = u8::try_from(request.imu).ok();
    file.span_s = Some([from.max(first), to.min(last)]);
    Ok(file)
}

/// Reads calibration files, in order; a later one replaces an earlier one of its kind and sensor.
///
/// # Errors
/// [`CalibrateError`] naming the file.
pub fn load(paths: &[PathBuf]) -> Result<Calibration, CalibrateError> {
    let mut calibration = Calibration::default();
    for path in paths {
        let wrong = |source| CalibrateError::File { path: path.clone(), source };
        calibration.add(&read(path)?).map_err(wrong)?;
    }
    Ok(calibration)
}

/// Reads one calibration file.
///
/// # Errors
/// [`CalibrateError`] naming the file.
pub fn read(path: &Path) -> Result<CalibrationFile, CalibrateError> {
    let text = std::fs::read_to_string(path).map_err(|source| CalibrateError::Io { path: path.to_owned(), source })?;
    CalibrationFile::from_json(&text).map_err(|source| CalibrateError::File { path: path.to_owned(), source })
}

/// Writes a calibration file.
///
/// # Errors
/// [`CalibrateError`] naming the file.
pub fn write(path: &Path, file: &CalibrationFile) -> Result<(), CalibrateError> {
    let text = format!("{:#}\n", file.to_value());
    std::fs::write(path, text).map_err(|source| CalibrateError::Io { path: path.to_owned(), source })
}

/// A wall time as ISO 8601, UTC.
pub fn iso_8601(time: WallTime) -> String {
    let ((year, month, day), (hour, minute, second)) = time.utc();
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests;

//! Recordings that can be flown or estimated again: our own flight files and those of others.
//!
//! One file per format; each turns its columns into SI, ENU and FLU and hands over a [`Recording`]:
//! ticks in time order, each with the samples that arrived, and what else the file knows (truth,
//! motor commands). Adding a format adds a file here and an arm in [`open`].

mod broad;
mod clocks;
mod flight_file;
pub mod mocap_log;
mod noise;
mod phantom4;
pub mod replay;
mod rotorpy;
mod shared;
mod tables;
mod timeline;
mod ulog;

use std::path::{Path, PathBuf};

use plumbline_core::sensor::imu::ImuModel;
use plumbline_core::sensor::{SensorFrame, SensorModel};
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::{RecordedControl, Truth};
use plumbline_proto::v1::{self, SensorKind};
use plumbline_proto::{ids::SensorId, time::FlightTime};

pub use phantom4::Phantom4Options;
pub use shared::{VARIABLE as SHARED_VARIABLE, shared, skipped};
pub use timeline::Recording;

/// One tick of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecordedTick {
    /// Samples as sensed.
    pub sensed: SensorFrame,
    /// Samples as the estimators received them, where an attack was recorded.
    pub received: Option<SensorFrame>,
    /// Motor command applied in this tick, where known.
    pub applied: Option<MotorCommand>,
    /// True state, where the file carries one for this tick.
    pub truth: Option<Truth>,
    /// Mode and setpoint of this tick, where known.
    pub control: Option<RecordedControl>,
}

/// A sensor of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedSensor {
    /// Which sensor.
    pub id: SensorId,
    /// Mean rate over the recording, Hz.
    pub rate_hz: f64,
}

/// Noise of a recording's IMUs, vibration included.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuNoise {
    /// One-sigma of one gyroscope sample, rad/s.
    pub gyro_sigma_radps: f64,
    /// One-sigma of one accelerometer sample, m/s².
    pub accel_sigma_mps2: f64,
}

/// What a recording holds.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingInfo {
    /// File or folder it comes from.
    pub source: PathBuf,
    /// Its format.
    pub format: Format,
    /// Time of its first and last tick.
    pub span: (FlightTime, FlightTime),
    /// Ticks.
    pub ticks: usize,
    /// Sensors with at least one sample.
    pub sensors: Vec<RecordedSensor>,
    /// Noise of the worst of its IMUs; `None` where there is too little to tell.
    pub imu_noise: Option<ImuNoise>,
    /// Does it carry truth?
    pub has_truth: bool,
    /// Does it carry motor commands?
    pub has_motors: bool,
    /// Sensors of which something else was received than was sensed, and since when.
    pub attacked: Vec<(SensorId, FlightTime)>,
    /// Name of the airframe, where the file says.
    pub airframe: Option<String>,
    /// Scenario of a simulated flight, TOML.
    pub scenario: Option<String>,
    /// Magnetic declination there, rad, where the recording says; else the frame's north is magnetic.
    pub declination_rad: Option<f64>,
    /// Calibrations that corrected its samples when they were recorded.
    pub calibrations: Vec<v1::CalibrationInUse>,
    /// Things a user should know: rows skipped, sensors left out.
    pub notes: Vec<String>,
}

impl RecordingInfo {
    /// What estimators assume of its sensors: the defaults, unless its own samples are noisier than that (IMUs
    /// of a motor frame vibrate by several m/s²). The same rule for every file.
    pub fn sensor_model(&self) -> SensorModel {
        let mut model = SensorModel::default();
        model.imus.mag.declination_rad = self.declination_rad.unwrap_or(model.imus.mag.declination_rad);
        let imus = self.sensors.iter().filter(|sensor| sensor.id.kind == SensorKind::Imu);
        let rate_hz = imus.map(|imu| imu.rate_hz).fold(f64::INFINITY, f64::min);
        let Some(noise) = self.imu_noise.filter(|_| rate_hz.is_finite() && rate_hz > 0.0) else { return model };
        let period_s = 1.0 / rate_hz;
        let ImuModel { gyro, accel, .. } = &mut model.imus;
        for (quantity, sigma) in [(gyro, noise.gyro_sigma_radps), (accel, noise.accel_sigma_mps2)] {
            quantity.memory_s = quantity.memory_s.max(1.25 * period_s);
            if sigma > quantity.sigma {
                quantity.sigma = sigma;
                quantity.noise_density = quantity.noise_density.max(sigma * period_s.sqrt());
            }
        }
        model
    }
}

/// Formats that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Our own flight file (MCAP).
    Plumbline,
    /// BROAD: one IMU with magnetometer and an optical reference attitude, CSV.
    Broad,
    /// Phantom 4 with four IMUs and RTK, a folder of CSV files.
    Phantom4,
    /// RotorPy simulation, CSV.
    Rotorpy,
    /// PX4 ULog.
    Px4Ulog,
}

impl Format {
    /// Every format, with its name on the command line.
    pub const ALL: &[(&str, Format)] = &[
        ("plumbline", Format::Plumbline),
        ("broad", Format::Broad),
        ("phantom4", Format::Phantom4),
        ("rotorpy", Format::Rotorpy),
        ("px4-ulog", Format::Px4Ulog),
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, format)| *format == self).map_or("unknown", |(name, _)| name)
    }

    /// The format called `name` on the command line.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, format)| *format)
    }

    /// The format of `path`, judged by its content.
    ///
    /// # Errors
    /// [`RecordingError::Unsupported`] naming what was found.
    pub fn detect(path: &Path) -> Result<Self, RecordingError> {
        if path.is_dir() {
            return if path.join("IMU_1.csv").is_file() && path.join("GT.csv").is_file() {
                Ok(Format::Phantom4)
            } else {
                Err(RecordingError::unsupported(path, "a folder without IMU_1.csv and GT.csv"))
            };
        }
        let head = tables::head(path, 512)?;
        let first_line = head.split(|b| *b == b'\n').next().map(String::from_utf8_lossy).unwrap_or_default();
        if head.starts_with(b"\x89MCAP") {
            Ok(Format::Plumbline)
        } else if head.starts_with(ulog::MAGIC) {
            Ok(Format::Px4Ulog)
        } else if first_line.starts_with("t_s,gx_rad_s") {
            Ok(Format::Broad)
        } else if first_line.starts_with("t_s,ax,ay,az,gx") {
            Ok(Format::Rotorpy)
        } else if first_line.starts_with("time,Euler_X") || first_line.starts_with("time,distance(meters)") {
            Ok(Format::Phantom4)
        } else if head.is_empty() {
            Err(RecordingError::unsupported(path, "an empty file"))
        } else {
            let shown: String = first_line.chars().take(40).flat_map(char::escape_default).collect();
            Err(RecordingError::unsupported(path, &format!("a file that begins with \"{shown}\"")))
        }
    }
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// None of the formats.
    #[error(
        "{path}: {found}; supported are Plumbline flight files (.mcap), BROAD and RotorPy CSV (also gzipped), \
         Phantom 4 folders and PX4 ULog (.ulg)"
    )]
    Unsupported {
        /// File.
        path: PathBuf,
        /// What it seems to be.
        found: String,
    },
    /// The format is known, the content is not what it should be.
    #[error("{path}: {reason}")]
    Malformed {
        /// File.
        path: PathBuf,
        /// Where and what, with the offending value.
        reason: String,
    },
}

impl RecordingError {
    fn unsupported(path: &Path, found: &str) -> Self {
        Self::Unsupported { path: path.to_owned(), found: found.to_owned() }
    }

    fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), reason: reason.into() }
    }
}

/// The text of a file that is no recording, gzip undone.
///
/// # Errors
/// [`RecordingError::Io`].
pub fn text(path: &Path) -> Result<Box<dyn std::io::Read>, RecordingError> {
    tables::reader(path)
}

/// Opens a recording, its format judged by its content.
///
/// # Errors
/// [`RecordingError`].
pub fn open(path: &Path) -> Result<Recording, RecordingError> {
    open_as(path, Format::detect(path)?)
}

/// Opens a recording of a known format.
///
/// # Errors
/// [`RecordingError`].
pub fn open_as(path: &Path, format: Format) -> Result<Recording, RecordingError> {
    match format {
        Format::Plumbline => flight_file::open(path),
        Format::Broad => broad::open(path),
        Format::Phantom4 => phantom4::open(path, Phantom4Options::default()),
        Format::Rotorpy => rotorpy::open(path),
        Format::Px4Ulog => ulog::open(path),
    }
}

/// Reads one of our own flight files that is in memory; `name` is its name in messages.
///
/// # Errors
/// [`RecordingError`].
pub fn open_flight(bytes: &[u8], name: &Path) -> Result<Recording, RecordingError> {
    flight_file::read(bytes, name)
}

/// Opens a Phantom 4 folder with its GNSS thinned and noised.
///
/// # Errors
/// [`RecordingError`].
pub fn open_phantom4(path: &Path, options: Phantom4Options) -> Result<Recording, RecordingError> {
    phantom4::open(path, options)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use std::io::Write as _;

    /// A file of the public recordings, or `None` where they are absent.
    fn public(file: &str) -> Option<PathBuf> {
        shared(&format!("data/{file}"))
    }

    fn ticks(mut recording: Recording) -> Vec<RecordedTick> {
        let mut out = Vec::new();
        while let Some(tick) = recording.next_tick() {
            out.push(tick);
        }
        assert_eq!(out.len(), recording.info().ticks);
        assert!(out.windows(2).all(|w| w[0].sensed.time <= w[1].sensed.time), "time goes backwards");
        out
    }

    /// Mean of the specific force turned into the world by the truth: (0, 0, g) whatever the frames
    /// are called, and only then, for a vehicle that ends where it began.
    fn mean_world_force(ticks: &[RecordedTick]) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        let mut n = 0.0;
        let mut attitude = None;
        for tick in ticks {
            attitude = tick.truth.map(|t| t.world_from_body).or(attitude);
            if let (Some(attitude), Some(imu)) = (attitude, tick.sensed.imus[0]) {
                sum += attitude * imu.accel_mps2;
                n += 1.0;
            }
        }
        sum / n
    }

    fn assert_gravity(force: Vector3<f64>, tolerance: f64) {
        assert!((force - Vector3::new(0.0, 0.0, 9.81)).norm() < tolerance, "mean specific force in the world: {force}");
    }

    #[test]
    fn broad_frames_agree_with_its_reference() {
        let Some(path) = public("broad_imu_mocap/02_undisturbed_slow_rotation_B.csv.gz") else { return };
        let recording = open(&path).unwrap();
        assert_eq!(recording.info().format, Format::Broad);
        assert!((recording.info().sensors[0].rate_hz - 285.7).abs() < 1.0);
        assert_gravity(mean_world_force(&ticks(recording)), 0.1);
    }

    #[test]
    fn rotorpy_frames_agree_with_its_truth() {
        let Some(path) = public("rotorpy_sim/hummingbird_lissajous.csv.gz") else { return };
        let all = ticks(open(&path).unwrap());
        assert!((all.len() as f64 - 6000.0).abs() < 5.0, "{} ticks", all.len());
        // The vehicle settles onto its path in the first second, with accelerations of 15 g.
        assert_gravity(mean_world_force(&all[400..]), 0.3);
    }

    #[test]
    fn phantom4_has_four_imus_and_frames_that_agree_with_rtk() {
        let Some(path) = public("phantom4_4imu_rtk/Horizontal_path_1") else { return };
        let recording = open(&path).unwrap();
        let sensors: Vec<_> = recording.info().sensors.iter().map(|s| (s.id.to_string(), s.rate_hz.round())).collect();
        assert_eq!(sensors.len(), 5, "{sensors:?}");
        // The devices' own attitudes lie 0.7 s apart (found with other tools).
        let notes = &recording.info().notes;
        assert!(notes.iter().any(|note| note.contains("clock of IMU 1 moved by -68")), "{notes:?}");
        let all = ticks(recording);
        // Roll and pitch are the vendor's: its own errors of a few degrees tilt gravity.
        assert_gravity(mean_world_force(&all), 1.0);
        assert!(all.len() < 2470, "{} ticks: the IMUs no longer share them", all.len());
        let thinned = open_phantom4(&path, Phantom4Options { gnss_rate_hz: 1.0, gnss_noise_m: 0.5, seed: 1 }).unwrap();
        let gnss = thinned.info().sensors.last().unwrap();
        assert!((gnss.rate_hz - 1.0).abs() < 0.1, "{} Hz", gnss.rate_hz);
    }

    #[test]
    fn ulog_holds_what_pyulog_finds_in_it() {
        // Counts of sensor_combined by pyulog 1.2 on the same files.
        let expected = [("sample.ulg", 17_070), ("test_ulog.ulg", 1_297)];
        for (file, count) in expected {
            let Some(path) = public(&format!("px4_ulog/{file}")) else { return };
            assert_eq!(ticks(open(&path).unwrap()).len(), count, "{file}");
        }
        let path = public("px4_ulog/sample_logging_tagged_and_default_params.ulg").unwrap();
        let all = ticks(open(&path).unwrap());
        assert_eq!(all.len(), 2_028);
        assert!(all.iter().filter(|t| t.truth.is_some()).count() > 1_000);
        assert_eq!(all.iter().filter(|t| t.sensed.imus[0].unwrap().mag_ut.is_some()).count(), 159);
        assert_gravity(mean_world_force(&all), 0.2);
    }

    #[test]
    fn ulog_cut_anywhere_is_read_up_to_the_cut() {
        let Some(path) = public("px4_ulog/test_ulog.ulg") else { return };
        let bytes = std::fs::read(&path).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for cut in [10, 16, 5_000, bytes.len() / 2, bytes.len() - 1] {
            let file = folder.path().join("cut.ulg");
            std::fs::write(&file, &bytes[..cut]).unwrap();
            match open(&file) {
                Ok(recording) => assert!(recording.info().ticks > 0),
                Err(error) => assert!(matches!(error, RecordingError::Malformed { .. }), "{error}"),
            }
        }
    }

    #[test]
    fn unsupported_and_malformed_files_are_named_with_what_was_found() {
        let folder = tempfile::tempdir().unwrap();
        let check = |content: &[u8], expected: &str| {
            let path = folder.path().join("file");
            std::fs::File::create(&path).unwrap().write_all(content).unwrap();
            let error = open(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        };
        check(b"", "an empty file");
        check(b"hello,world\n1,2\n", "begins with \"hello,world\"");
        check(b"t_s,gx_rad_s,gy_rad_s\n0,1,2\n", "no column \"gz_rad_s\"");
        check(b"\x89MCAP0\r\nbroken", "");
        let header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,\
                      ref_qz,ref_px_m,ref_py_m,ref_pz_m,movement\n";
        check(header.as_bytes(), "nothing to fly");
        let bad_row = format!("{header}0,0,0,zero,0,0,9.8,1,1,1,1,0,0,0,0,0,0,1\n");
        check(bad_row.as_bytes(), "line 2: gz_rad_s is \"zero\"");
        assert!(open(folder.path()).unwrap_err().to_string().contains("without IMU_1.csv"));
        assert!(open(&folder.path().join("absent")).unwrap_err().to_string().contains("absent"));
    }
}

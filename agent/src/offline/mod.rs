//! Offline estimation: any estimator over a recording, its estimates as CSV, its errors as one JSON line.
//!
//! ```text
//! plumbline-agent estimate --input FILE --format broad --estimator attitude --output OUT.csv
//! ```
//! The same estimators as in flight, stepped tick by tick; nothing is smoothed and truth is only scored.

mod errors;
mod output;

use std::path::PathBuf;

pub use errors::Score;
use output::Output;

use crate::estimate::attitude::{Attitude, AttitudeOptions};
use crate::estimate::ekf_bias::EkfBias;
use crate::estimate::ekf_hybrid::EkfHybrid;
use crate::estimate::mocap_recipe::{LOG_RATE_HZ, LogRow, run_each};
use crate::estimate::point_mass::PointMassEstimator;
use crate::estimate::primary::Primary;
use crate::estimate::ukf::Ukf;
use crate::estimate::{Estimator, EstimatorKind};
use crate::model::euler_body::{EulerBody, M, X};
use crate::recordings::{self, Format, RecordingError, mocap_log};
use crate::vehicle::{MotorCommand, SensorFrame};

/// Arguments of `plumbline-agent estimate`.
#[derive(Debug, Clone, clap::Args)]
pub struct EstimateArgs {
    /// Recording: a file, or the folder of a Phantom 4 flight.
    #[arg(long)]
    pub input: PathBuf,
    /// plumbline, broad, phantom4, rotorpy, px4-ulog or mocap-log; judged by the content when left out.
    #[arg(long)]
    pub format: Option<String>,
    /// ekf-bias, primary, ekf-hybrid, ukf, point-mass or attitude.
    #[arg(long)]
    pub estimator: String,
    /// Sensors to use, separated by commas: imu, mag, height, barometer, gnss, mocap-pose, camera-ranges. All
    /// when left out; `imu` alone leaves its magnetometer out.
    #[arg(long, value_delimiter = ',')]
    pub sensors: Vec<String>,
    /// Measurements a second of a mocap-log; a divisor of 120.
    #[arg(long, default_value_t = LOG_RATE_HZ)]
    pub rate: usize,
    /// CSV to write.
    #[arg(long)]
    pub output: PathBuf,
}

/// Why a recording could not be estimated.
#[derive(Debug, thiserror::Error)]
pub enum OfflineError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// An argument.
    #[error("--{argument} {value}: {reason}")]
    Argument {
        /// Which.
        argument: &'static str,
        /// What was given.
        value: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The output.
    #[error("{}: {source}", path.display())]
    Output {
        /// File.
        path: PathBuf,
        /// Cause.
        source: csv::Error,
    },
}

/// Name of the format that is not a recording of raw sensors.
const MOCAP_LOG: &str = "mocap-log";

/// Estimators by their name on the command line.
const ESTIMATORS: &[(&str, EstimatorKind)] = &[
    ("ekf-bias", EstimatorKind::EkfBias),
    ("primary", EstimatorKind::Primary),
    ("ekf-hybrid", EstimatorKind::EkfHybrid),
    ("ukf", EstimatorKind::Ukf),
    ("point-mass", EstimatorKind::PointMass),
    ("attitude", EstimatorKind::Attitude),
];

/// Runs the command; the score is also printed as one JSON line by the caller.
///
/// # Errors
/// [`OfflineError`], with the offending value.
pub fn run(args: &EstimateArgs) -> Result<Score, OfflineError> {
    let names: Vec<&str> = ESTIMATORS.iter().map(|(name, _)| *name).collect();
    let kind = ESTIMATORS.iter().find(|(name, _)| *name == args.estimator).map(|(_, kind)| *kind).ok_or_else(|| {
        OfflineError::Argument {
            argument: "estimator",
            value: args.estimator.clone(),
            reason: format!("not one of {}", names.join(", ")),
        }
    })?;
    let is_log = |text: &str| text == MOCAP_LOG;
    if args.format.as_deref().map_or_else(|| looks_like_mocap_log(args), is_log) {
        return run_log(args, kind);
    }
    let recording = match args.format.as_deref() {
        None => recordings::open(&args.input)?,
        Some(text) => {
            let format = Format::ALL.iter().find(|(name, _)| *name == text).map(|(_, format)| *format);
            let known: Vec<&str> = Format::ALL.iter().map(|(name, _)| *name).collect();
            recordings::open_as(
                &args.input,
                format.ok_or_else(|| OfflineError::Argument {
                    argument: "format",
                    value: text.to_owned(),
                    reason: format!("not one of {}, {MOCAP_LOG}", known.join(", ")),
                })?,
            )?
        }
    };
    run_recording(args, kind, recording)
}

fn looks_like_mocap_log(args: &EstimateArgs) -> bool {
    let Ok(file) = std::fs::File::open(&args.input) else { return false };
    let mut line = String::new();
    let _ = std::io::BufRead::read_line(&mut std::io::BufReader::new(std::io::Read::take(file, 256)), &mut line);
    line.starts_with("t,T,tx,ty,tz")
}

/// Which parts of a frame are used.
#[derive(Debug, Clone, Copy)]
struct Selection {
    mag: bool,
    height: bool,
    barometer: bool,
    gnss: bool,
    mocap_pose: bool,
    camera_ranges: bool,
}

impl Selection {
    fn new(names: &[String]) -> Result<Self, OfflineError> {
        const KNOWN: [&str; 7] = ["imu", "mag", "height", "barometer", "gnss", "mocap-pose", "camera-ranges"];
        if let Some(bad) = names.iter().find(|name| !KNOWN.contains(&name.as_str())) {
            let reason = format!("not one of {}", KNOWN.join(", "));
            return Err(OfflineError::Argument { argument: "sensors", value: bad.clone(), reason });
        }
        let on = |name: &str| names.is_empty() || names.iter().any(|n| n == name);
        Ok(Self {
            mag: on("mag"),
            height: on("height"),
            barometer: on("barometer"),
            gnss: on("gnss"),
            mocap_pose: on("mocap-pose"),
            camera_ranges: on("camera-ranges"),
        })
    }

    fn apply(&self, frame: &mut SensorFrame) {
        if !self.mag {
            frame.imus.iter_mut().flatten().for_each(|imu| imu.mag_ut = None);
        }
        if !self.height {
            frame.heights = Default::default();
        }
        if !self.barometer {
            frame.barometers = Default::default();
        }
        if !self.gnss {
            frame.gnss = None;
        }
        if !self.mocap_pose {
            frame.mocap_pose = None;
        }
        if !self.camera_ranges {
            frame.camera_ranges = None;
        }
    }
}

fn run_recording(
    args: &EstimateArgs,
    kind: EstimatorKind,
    mut recording: recordings::Recording,
) -> Result<Score, OfflineError> {
    let selection = Selection::new(&args.sensors)?;
    // One rule for every recording: nothing is tuned to a file.
    let options = recording.info().ekf_options();
    let attitude = AttitudeOptions {
        use_mag: selection.mag,
        gyro_vote: options.gyro_vote,
        accel_vote: options.accel_vote,
        ..AttitudeOptions::default()
    };
    let mut estimator: Box<dyn Estimator> = match kind {
        EstimatorKind::EkfBias => Box::new(EkfBias::new(options)),
        EstimatorKind::Primary => Box::new(Primary::new(options)),
        EstimatorKind::PointMass => Box::new(PointMassEstimator::new(options, attitude)),
        EstimatorKind::Attitude => Box::new(Attitude::new(attitude)),
        _ => {
            return Err(OfflineError::Argument {
                argument: "estimator",
                value: args.estimator.clone(),
                reason: format!("needs motor inputs: it takes --format {MOCAP_LOG} only"),
            });
        }
    };
    let mut output = Output::create(&args.output, false)?;
    let mut score = Score::new(&args.estimator, &args.input);
    // Applied in one tick, known to the estimator in the next.
    let mut applied = MotorCommand::default();
    while let Some(tick) = recording.next_tick() {
        let mut frame = tick.received.unwrap_or(tick.sensed);
        selection.apply(&mut frame);
        let estimate = estimator.step(&frame, &applied);
        applied = tick.applied.unwrap_or(applied);
        output.estimate(estimate)?;
        score.add(estimate, tick.truth.as_ref());
    }
    output.finish()?;
    Ok(score)
}

fn run_log(args: &EstimateArgs, kind: EstimatorKind) -> Result<Score, OfflineError> {
    if args.rate == 0 || !LOG_RATE_HZ.is_multiple_of(args.rate) {
        let reason = format!("does not divide the {LOG_RATE_HZ} rows a second");
        return Err(OfflineError::Argument { argument: "rate", value: args.rate.to_string(), reason });
    }
    let log = mocap_log::read(&args.input)?;
    // The recipe's start: the origin, known to 1 mm and 1 mrad.
    let (body, x, p) = (EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let mut output = Output::create(&args.output, true)?;
    let mut score = Score::new(&args.estimator, &args.input);
    let mut failed = None;
    let each = |row: &LogRow, x: &X| {
        if failed.is_none() {
            failed = output.twelve_states(row.time_s, x).err();
        }
        score.add_twelve_states(x, &row.truth);
    };
    match kind {
        EstimatorKind::EkfHybrid => run_each(&log, args.rate, &mut EkfHybrid::new(body, x, p), each),
        EstimatorKind::Ukf => run_each(&log, args.rate, &mut Ukf::new(body, x, p), each),
        _ => {
            return Err(OfflineError::Argument {
                argument: "estimator",
                value: args.estimator.clone(),
                reason: format!("{MOCAP_LOG} has no raw IMU samples: only ekf-hybrid and ukf take it"),
            });
        }
    }
    if let Some(error) = failed {
        return Err(error);
    }
    output.finish()?;
    Ok(score)
}

#[cfg(test)]
mod tests;

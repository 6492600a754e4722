//! Offline estimation: any estimator over a recording, its estimates as CSV, its errors as one JSON line.
//!
//! ```text
//! plumbline-agent estimate --input FILE --format broad --estimator vqf --output OUT.csv
//! ```
//! The same estimators as in flight, stepped tick by tick; truth is only scored. Nothing is smoothed, except attitude
//! where `--smooth` asks for it.

pub mod calibrate;
pub mod decode;
mod delays;
mod errors;
mod output;
mod smooth;
pub mod spectrum;
mod table;

use std::path::{Path, PathBuf};

use errors::Known;
pub use errors::{ErrorSample, Flagged, Score};
use output::Output;
use plumbline_core::calibration::applied::Calibration;
use plumbline_core::estimate::attitude::AttitudeEstimator;
use plumbline_core::estimate::bank::{self, Assumptions};
use plumbline_core::estimate::filter::ekf_hybrid::EkfHybrid;
use plumbline_core::estimate::filter::measurement::TwelveState;
use plumbline_core::estimate::filter::mocap_recipe::{LOG_RATE_HZ, LogRow, run_each};
use plumbline_core::estimate::filter::ukf::Ukf;
use plumbline_core::estimate::secure::{SLOTS, SLOTS_MAX, SLOTS_MIN};
use plumbline_core::estimate::{Estimate, Estimator};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::euler_body::{EulerBody, M, X};
use plumbline_core::sensor::suite::Suite;
use plumbline_core::sensor::{SensorFrame, quantities};
use plumbline_core::types::{EstimatorKind, MotorCommand};
use plumbline_proto::v1::{Decoder, SensorKind};
use smooth::{Forward, Smoothed};

use crate::recordings::{self, Format, Phantom4Options, RecordedTick, RecordingError, RecordingInfo, mocap_log};

/// Arguments of `plumbline-agent estimate`.
#[derive(Debug, Clone, clap::Args)]
pub struct EstimateArgs {
    /// Recording: a file, or the folder of a Phantom 4 flight.
    #[arg(long)]
    pub input: PathBuf,
    /// plumbline, broad, phantom4, rotorpy, px4-ulog or mocap-log; judged by the content when left out.
    #[arg(long)]
    pub format: Option<String>,
    /// Its name: ekf-bias, vqf, secure …; an unknown one is answered with all of them.
    #[arg(long)]
    pub estimator: String,
    /// Program of the secure estimator: l2 (the default), l1, l2_split or l1_split.
    #[arg(long)]
    pub decoder: Option<String>,
    /// Slots of 40 ms in the window of the secure estimator, 5 to 50; 10 when left out.
    #[arg(long)]
    pub window: Option<usize>,
    /// Sensors to use, separated by commas: imu, mag, height, barometer, gnss, mocap-pose, camera-ranges. All
    /// when left out; the IMU is always needed, and without `mag` its magnetometer is left out.
    #[arg(long, value_delimiter = ',')]
    pub sensors: Vec<String>,
    /// Measurements a second of a mocap-log, a divisor of 120; all of them when left out.
    #[arg(long)]
    pub rate: Option<usize>,
    /// Fixes a second made of the RTK of a Phantom 4 flight, at most its 10; all of them when left out.
    #[arg(long)]
    pub gnss_rate: Option<f64>,
    /// One-sigma of the noise added to each axis of those fixes, m; none when left out.
    #[arg(long)]
    pub gnss_noise: Option<f64>,
    /// Seed of that noise.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Calibration file to apply to every frame; may be given several times.
    #[arg(long)]
    pub calibration: Vec<PathBuf>,
    /// Attitude from samples after each moment as well as before it; for attitude-ekf.
    #[arg(long)]
    pub smooth: bool,
    /// CSV to write.
    #[arg(long)]
    pub output: PathBuf,
}

impl EstimateArgs {
    /// All sensors of `input`, its format judged by its content.
    pub fn new(input: &Path, estimator: &str, output: &Path) -> Self {
        Self {
            input: input.to_owned(),
            format: None,
            estimator: estimator.to_owned(),
            decoder: None,
            window: None,
            sensors: Vec::new(),
            rate: None,
            gnss_rate: None,
            gnss_noise: None,
            seed: None,
            calibration: Vec::new(),
            smooth: false,
            output: output.to_owned(),
        }
    }
}

/// An argument of the command line that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("--{argument} {value}: {reason}")]
pub struct ArgumentError {
    /// Its name, without the dashes.
    pub argument: &'static str,
    /// What was given.
    pub value: String,
    /// What is wrong with it.
    pub reason: String,
}

impl ArgumentError {
    /// `--argument value` for this `reason`.
    pub fn new(argument: &'static str, value: impl ToString, reason: impl Into<String>) -> Self {
        Self { argument, value: value.to_string(), reason: reason.into() }
    }
}

/// `--format text`: a format of recordings; `beside` is what else may stand there.
fn format(text: &str, beside: &str) -> Result<Format, ArgumentError> {
    Format::by_name(text).ok_or_else(|| {
        let known: Vec<&str> = Format::ALL.iter().map(|(name, _)| *name).collect();
        ArgumentError::new("format", text, format!("not one of {}, {beside}", known.join(", ")))
    })
}

/// Why a recording could not be estimated.
#[derive(Debug, thiserror::Error)]
pub enum OfflineError {
    /// Nobody waits for the outcome any more.
    #[error("given up")]
    GivenUp,
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A calibration file.
    #[error(transparent)]
    Calibration(#[from] calibrate::CalibrateError),
    /// An argument.
    #[error(transparent)]
    Argument(#[from] ArgumentError),
    /// The output.
    #[error("{path}: {source}")]
    Output {
        /// File.
        path: PathBuf,
        /// Cause.
        source: csv::Error,
    },
}

/// Name of the format that is not a recording of raw sensors.
const MOCAP_LOG: &str = "mocap-log";

impl EstimateArgs {
    /// `--argument value` that cannot be used.
    fn bad(argument: &'static str, value: impl ToString, reason: impl Into<String>) -> OfflineError {
        ArgumentError::new(argument, value, reason).into()
    }

    /// `--rate` is a mocap-log's; the GNSS arguments are a Phantom 4's.
    fn refuse_misplaced(&self, format: &str) -> Result<(), OfflineError> {
        let only = |wanted: &str| format!("is for --format {wanted} only; this is {format}");
        if let Some(file) = self.calibration.first().filter(|_| format == MOCAP_LOG) {
            let reason = format!("{MOCAP_LOG} has no raw samples to calibrate");
            return Err(Self::bad("calibration", file.display(), reason));
        }
        if let Some(rate) = self.rate.filter(|_| format != MOCAP_LOG) {
            return Err(Self::bad("rate", rate, only(MOCAP_LOG)));
        }
        if format == Format::Phantom4.name() {
            return Ok(());
        }
        let wanted = Format::Phantom4.name();
        match (self.gnss_rate, self.gnss_noise, self.seed) {
            (Some(rate), ..) => Err(Self::bad("gnss-rate", rate, only(wanted))),
            (_, Some(noise), _) => Err(Self::bad("gnss-noise", noise, only(wanted))),
            (.., Some(seed)) => Err(Self::bad("seed", seed, only(wanted))),
            _ => Ok(()),
        }
    }

    fn phantom4_options(&self) -> Result<Phantom4Options, OfflineError> {
        let default = Phantom4Options::default();
        if let Some(rate) = self.gnss_rate.filter(|r| !(*r > 0.0 && *r <= default.gnss_rate_hz)) {
            let reason = format!("not above 0 and at most {} Hz", default.gnss_rate_hz);
            return Err(Self::bad("gnss-rate", rate, reason));
        }
        if let Some(noise) = self.gnss_noise.filter(|n| !(0.0..=100.0).contains(n)) {
            return Err(Self::bad("gnss-noise", noise, "not 0 to 100 m"));
        }
        Ok(Phantom4Options {
            gnss_rate_hz: self.gnss_rate.unwrap_or(default.gnss_rate_hz),
            gnss_noise_m: self.gnss_noise.unwrap_or(default.gnss_noise_m),
            seed: self.seed.unwrap_or(default.seed),
        })
    }
}

fn named(estimator: &str) -> Result<EstimatorKind, OfflineError> {
    EstimatorKind::named(&estimator.replace('-', "_")).ok_or_else(|| {
        EstimateArgs::bad("estimator", estimator, format!("not one of {}", EstimatorKind::NAMES.replace('_', "-")))
    })
}

/// Estimates a flight file of our own that is in memory again, under the estimator and from the sensors of `args`, whose
/// input is its name in messages; every estimate goes to `each`, which may end it.
///
/// # Errors
/// [`OfflineError`], with the offending value, or that of `each`.
pub fn run_flight(
    bytes: &[u8],
    args: &EstimateArgs,
    each: impl FnMut(&Estimate) -> Result<(), OfflineError>,
) -> Result<Score, OfflineError> {
    let kind = named(&args.estimator)?;
    let recording = recordings::open_flight(bytes, &args.input)?;
    Run::new(args, kind, recording)?.fly(each)
}

/// Runs the command; the score is also printed as one JSON line by the caller.
///
/// # Errors
/// [`OfflineError`], with the offending value.
pub fn run(args: &EstimateArgs) -> Result<Score, OfflineError> {
    let kind = named(&args.estimator)?;
    if args.format.as_deref().map_or_else(|| looks_like_mocap_log(args), |text| text == MOCAP_LOG) {
        args.refuse_misplaced(MOCAP_LOG)?;
        return run_log(args, kind);
    }
    let format = match args.format.as_deref() {
        None => Format::detect(&args.input)?,
        Some(text) => format(text, MOCAP_LOG)?,
    };
    args.refuse_misplaced(format.name())?;
    let open = || match format {
        Format::Phantom4 => Ok(recordings::open_phantom4(&args.input, args.phantom4_options()?)?),
        other => Ok::<_, OfflineError>(recordings::open_as(&args.input, other)?),
    };
    let mut run = Run::new(args, kind, open()?)?;
    if args.smooth {
        let estimator = Box::new(run.smoothed());
        run = Run { estimator, ..Run::new(args, kind, open()?)? };
    }
    let mut output = Output::create(&args.output, false)?;
    let score = run.fly(|estimate| output.estimate(estimate))?;
    output.finish()?;
    Ok(score)
}

fn looks_like_mocap_log(args: &EstimateArgs) -> bool {
    let Ok(file) = std::fs::File::open(&args.input) else { return false };
    let mut line = String::new();
    let _ = std::io::BufRead::read_line(&mut std::io::BufReader::new(std::io::Read::take(file, 256)), &mut line);
    line.starts_with("t,T,tx,ty,tz")
}

/// Which sensors of a frame are used.
#[derive(Debug, Clone)]
struct Selection {
    kinds: Vec<SensorKind>,
    mag: bool,
}

/// A kind by its name on the command line: `mocap-pose`.
fn sensor_name(kind: SensorKind) -> String {
    kind.as_str_name().trim_start_matches("SENSOR_KIND_").to_ascii_lowercase().replace('_', "-")
}

/// The magnetometer, which is part of an IMU.
const MAG: &str = "mag";

impl Selection {
    fn new(names: &[String], info: &RecordingInfo) -> Result<Self, OfflineError> {
        let has = |kind: SensorKind| info.sensors.iter().any(|sensor| sensor.id.kind == kind);
        for name in names {
            let wanted =
                if name == MAG { Some(SensorKind::Imu) } else { Suite::kinds().find(|k| sensor_name(*k) == *name) };
            let Some(kind) = wanted else {
                let known: Vec<_> = Suite::kinds().map(sensor_name).chain([MAG.to_owned()]).collect();
                return Err(EstimateArgs::bad("sensors", name, format!("not one of {}", known.join(", "))));
            };
            if !has(kind) {
                let there: Vec<String> = info.sensors.iter().map(|sensor| sensor.id.to_string()).collect();
                let reason = format!("the recording has only {}", there.join(", "));
                return Err(EstimateArgs::bad("sensors", name, reason));
            }
        }
        if !has(SensorKind::Imu) {
            return Err(EstimateArgs::bad("input", info.source.display(), "no IMU in it: no estimator can start"));
        }
        if !names.is_empty() && !names.iter().any(|name| name == "imu") {
            return Err(EstimateArgs::bad("sensors", names.join(","), "without imu no estimator can start"));
        }
        let on = |name: &str| names.is_empty() || names.iter().any(|n| n == name);
        Ok(Self { mag: on(MAG), kinds: Suite::kinds().filter(|kind| on(&sensor_name(*kind))).collect() })
    }

    /// What of the place these sensors of a recording tell.
    fn known(&self, info: &RecordingInfo) -> Known {
        let tells = |names: &[&str]| {
            let used = info.sensors.iter().map(|sensor| sensor.id.kind).filter(|kind| self.kinds.contains(kind));
            let mut first = used.filter_map(|kind| quantities(kind).first());
            first.any(|quantity| names.contains(&quantity.name))
        };
        let horizontal = tells(&["position", "range"]);
        Known { horizontal, vertical: horizontal || tells(&["height", "pressure"]) }
    }

    fn apply(&self, frame: &mut SensorFrame) {
        if !self.mag {
            frame.imus.iter_mut().flatten().for_each(|imu| imu.mag_ut = None);
        }
        frame.withhold(|sensor| !self.kinds.contains(&sensor.kind));
    }
}

/// An estimator about to step over a recording. Everything that can be refused has been.
struct Run {
    recording: recordings::Recording,
    selection: Selection,
    calibration: Calibration,
    estimator: Box<dyn Estimator>,
    score: Score,
}

impl Run {
    fn new(args: &EstimateArgs, kind: EstimatorKind, recording: recordings::Recording) -> Result<Self, OfflineError> {
        let info = recording.info();
        let selection = Selection::new(&args.sensors, info)?;
        let calibration = calibrate::load(&args.calibration)?;
        // One rule for every recording: nothing is tuned to a file.
        let sensors = info.sensor_model();
        if let Some(slots) = args.window {
            let refused = |reason| Err(EstimateArgs::bad("window", slots, reason));
            if kind != EstimatorKind::Secure {
                return refused(format!("{} has none", args.estimator));
            }
            if !(SLOTS_MIN..=SLOTS_MAX).contains(&slots) {
                return refused(format!("not {SLOTS_MIN} to {SLOTS_MAX} slots"));
            }
        }
        if args.smooth && kind != EstimatorKind::AttitudeEkf {
            return Err(EstimateArgs::bad("smooth", &args.estimator, "only attitude-ekf can be smoothed"));
        }
        let window_slots = args.window.unwrap_or(SLOTS);
        // Of use only to estimators that know what the motors did, and where the recording says; any will do else.
        let airframe =
            info.airframe.as_deref().and_then(|name| Airframe::by_name(name).ok()).unwrap_or_else(Airframe::iris);
        let none = Known { horizontal: false, vertical: false };
        let known = if kind.attitude_only() { none } else { selection.known(info) };
        let mut estimator = bank::build(kind, &Assumptions { airframe: &airframe, sensors: &sensors, window_slots })
            .map_err(|e| EstimateArgs::bad("estimator", &args.estimator, e.to_string()))?;
        if let Some(name) = &args.decoder {
            let refused = || EstimateArgs::bad("decoder", name, "not l2, l1, l2_split or l1_split");
            let decoder = Decoder::named(name).ok_or_else(refused)?;
            let Some(secure) = estimator.secure_mut() else {
                return Err(EstimateArgs::bad("decoder", name, format!("{} solves none", args.estimator)));
            };
            secure.use_decoder(decoder);
        }
        let mut score = Score::new(&args.estimator, &args.input, known);
        score.notes.clone_from(&info.notes);
        Ok(Self { recording, selection, calibration, estimator, score })
    }

    /// Flies it once, for the estimator that knows all of it.
    fn smoothed(&mut self) -> Smoothed {
        let imus = self.recording.info().sensor_model().imus;
        let mut forward = AttitudeEstimator::<Forward>::new(&imus);
        while let Some(tick) = self.recording.next_tick() {
            forward.step(&self.frame(&tick), &MotorCommand::default());
        }
        Smoothed::new(AttitudeEstimator::new(&imus), forward.filter().smoothed())
    }

    /// What the estimator is given of a tick.
    fn frame(&mut self, tick: &RecordedTick) -> SensorFrame {
        let mut frame = tick.received.unwrap_or(tick.sensed);
        self.calibration.apply(&mut frame);
        self.selection.apply(&mut frame);
        frame
    }

    fn fly(mut self, mut each: impl FnMut(&Estimate) -> Result<(), OfflineError>) -> Result<Score, OfflineError> {
        // Applied in one tick, known to the estimator in the next.
        let mut applied = MotorCommand::default();
        while let Some(tick) = self.recording.next_tick() {
            let frame = self.frame(&tick);
            each(self.estimator.step(&frame, &applied))?;
            applied = tick.applied.unwrap_or(applied);
            self.score.add(self.estimator.as_ref(), tick.truth.as_ref());
        }
        self.score.fields = self.calibration.fields().collect();
        Ok(self.score)
    }
}

fn run_log(args: &EstimateArgs, kind: EstimatorKind) -> Result<Score, OfflineError> {
    let rate = args.rate.unwrap_or(LOG_RATE_HZ);
    if rate == 0 || !LOG_RATE_HZ.is_multiple_of(rate) {
        return Err(EstimateArgs::bad("rate", rate, format!("does not divide the {LOG_RATE_HZ} rows a second")));
    }
    if let Some(sensor) = args.sensors.iter().find(|name| !["camera-ranges", "imu"].contains(&name.as_str())) {
        let reason = format!("the recipe of {MOCAP_LOG} takes its camera-ranges and the angles of its imu, together");
        return Err(EstimateArgs::bad("sensors", sensor, reason));
    }
    let log = mocap_log::read(&args.input)?;
    // The recipe's start: the origin, known to 1 mm and 1 mrad.
    let (body, x, p) = (EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
    let mut output = Output::create(&args.output, true)?;
    let mut score = Score::new(&args.estimator, &args.input, Known { horizontal: true, vertical: true });
    let mut failed = None;
    let each = |row: &LogRow, x: &X, p: &M| {
        if failed.is_none() {
            failed = output.twelve_states(row.time_s, x).err();
        }
        score.add_twelve_states(x, p, &row.truth);
    };
    match kind {
        EstimatorKind::EkfHybrid => run_each(&log, rate, &mut EkfHybrid::new(body, x, p), each),
        EstimatorKind::Ukf => run_each(&log, rate, &mut Ukf::new(body, x, p), each),
        _ => {
            // Thrust and torque are known in it, but nothing was measured by an accelerometer or a gyroscope.
            let reason = format!(
                "works from accelerometer and gyroscope samples, and {MOCAP_LOG} has none, only motor inputs, ranges \
                 and angles: ekf-hybrid and ukf take it"
            );
            return Err(EstimateArgs::bad("estimator", &args.estimator, reason));
        }
    }
    if let Some(error) = failed {
        return Err(error);
    }
    output.finish()?;
    Ok(score)
}

#[cfg(test)]
pub(crate) mod tests;

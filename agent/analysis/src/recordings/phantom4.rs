//! Phantom 4 with four Xsens DOT IMUs and an RTK receiver: a folder of `IMU_1..4.csv` and `GT.csv`.
//!
//! The IMU files hold specific force (z up) in m/s² and rates in °/s in axes forward, left, up. Every logger was
//! started by itself: clocks are up to 0.7 s apart between IMUs and autopilot, and up to 0.1 s between IMUs. They are
//! laid onto the autopilot's by what both saw, the inclination; nothing else of the IMUs' onboard Euler angles is
//! used, heading least of all. `GT.csv` is the autopilot's log: N, E, D from RTK, attitude in
//! FRD degrees with a compass heading. RTK is both the GNSS sensor (thinned and noised as asked) and
//! the truth of position; the autopilot's attitude is taken as truth of roll and pitch.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use plumbline_core::frames::{self, Enu, Ned};
use plumbline_core::sensor::{AnySample, GnssSample, ImuSample};
use plumbline_core::vehicle::Truth;
use plumbline_proto::time::FlightTime;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::clocks::lag_s;
use super::timeline::{Builder, Item, Recording};
use super::{Format, RecordingError, tables};

/// One-sigma of the RTK position itself, m.
const RTK_SIGMA_M: f64 = 0.02;

/// What the GNSS sensor is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phantom4Options {
    /// Fixes a second, at most the 10 Hz of the file.
    pub gnss_rate_hz: f64,
    /// One-sigma of the noise added to each axis, m.
    pub gnss_noise_m: f64,
    /// Seed of that noise.
    pub seed: u64,
}

impl Default for Phantom4Options {
    /// Every RTK fix, no noise added.
    fn default() -> Self {
        Self { gnss_rate_hz: 10.0, gnss_noise_m: 0.0, seed: 0 }
    }
}

/// IMUs of the vehicle.
const IMUS: usize = 4;
const IMU_COLUMNS: &[&str] = &["time", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z", "Euler_X", "Euler_Y"];
/// Clocks of the IMUs and the autopilot are looked for within this, s.
const LARGEST_LAG_S: f64 = 2.0;
/// And those of two IMUs within this, s.
const LARGEST_LAG_BETWEEN_IMUS_S: f64 = 0.2;
const TRUTH_COLUMNS: &[&str] =
    &["time", "compass_heading(degrees)", "pitch(degrees)", "roll(degrees)", "North", "East", "Down"];

/// `path` is the folder, or any file in it.
pub(super) fn open(path: &Path, options: Phantom4Options) -> Result<Recording, RecordingError> {
    let folder: PathBuf =
        if path.is_dir() { path.to_owned() } else { path.parent().unwrap_or(Path::new(".")).to_owned() };
    let mut builder = Builder::default();
    builder.airframe = Some("phantom4".into());
    let mut units: [Vec<Row>; IMUS] = Default::default();
    for (index, unit) in units.iter_mut().enumerate() {
        let file = folder.join(format!("IMU_{}.csv", index + 1));
        if !file.is_file() {
            builder.notes.push(format!("no {}: IMU {} left out", file.display(), index + 1));
            continue;
        }
        *unit = read_imu(&file)?;
    }
    let truths = read_truth(&folder.join("GT.csv"))?;
    let lags = lags(&units, &truths);
    for (index, (unit, lag_s)) in units.iter().zip(lags).enumerate() {
        if lag_s != 0.0 {
            builder.notes.push(format!(
                "clock of IMU {} moved by {:.0} ms onto the autopilot's",
                index + 1,
                -1e3 * lag_s
            ));
        }
        for row in unit.iter().filter(|row| row.time_s >= lag_s) {
            let time = FlightTime::from_seconds(row.time_s - lag_s);
            builder.push(time, Item::Sensed(index, AnySample::Imu(ImuSample { time, ..row.sample })));
        }
    }
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(options.seed);
    let mut due = FlightTime(0);
    let period = std::time::Duration::from_secs_f64(1.0 / options.gnss_rate_hz.clamp(1e-3, 1e3));
    for truth in truths {
        builder.push(truth.time, Item::Truth(truth));
        // Half a millisecond: the file's times are sums of tenths.
        if truth.time.0 + 500 < due.0 {
            continue;
        }
        due = truth.time + period;
        let noise = Vector3::from_fn(|_, _| {
            let draw: f64 = StandardNormal.sample(&mut rng);
            options.gnss_noise_m * draw
        });
        let sigma = RTK_SIGMA_M.hypot(options.gnss_noise_m);
        let fix = GnssSample {
            time: truth.time,
            position_enu_m: truth.position_enu_m + noise,
            // The file has no velocity of the receiver: NaN, which estimators skip.
            velocity_enu_mps: Vector3::from_element(f64::NAN),
            geodetic: [f64::NAN; 3],
            horizontal_sigma_m: sigma,
            vertical_sigma_m: sigma,
            satellites: 0,
        };
        builder.push(truth.time, Item::Sensed(0, AnySample::Gnss(fix)));
    }
    builder.finish(&folder, Format::Phantom4)
}

/// One line of an IMU's file, by its own clock.
struct Row {
    time_s: f64,
    sample: ImuSample,
    /// Of the IMU's own filter, rad.
    inclination: f64,
}

fn read_imu(file: &Path) -> Result<Vec<Row>, RecordingError> {
    let mut rows = Vec::new();
    tables::for_each_row(file, IMU_COLUMNS, |row| {
        let time_s = row.get(0)?;
        let sample = ImuSample {
            time: FlightTime::from_seconds(time_s),
            accel_mps2: row.vector(1)?,
            gyro_radps: row.vector(4)?.map(f64::to_radians),
            mag_ut: None,
            temperature_c: 25.0,
        };
        let (roll, pitch) = (row.get(7)?.to_radians(), row.get(8)?.to_radians());
        rows.push(Row { time_s, sample, inclination: (roll.cos() * pitch.cos()).acos() });
        Ok(())
    })?;
    Ok(rows)
}

/// How late the clock of each IMU runs behind the autopilot's, s: that of the first by the inclination that its own
/// filter and the autopilot show, the others against the first by the size of the rate.
fn lags(units: &[Vec<Row>; IMUS], truths: &[Truth]) -> [f64; IMUS] {
    let first: &[Row] = units.iter().find(|unit| !unit.is_empty()).map_or(&[], Vec::as_slice);
    let seen: Vec<_> = first.iter().map(|row| (row.time_s, row.inclination)).collect();
    let shown: Vec<_> = truths.iter().map(|t| (t.time.as_seconds(), frames::tilt_rad(&t.world_from_body))).collect();
    // Whole samples: the IMUs' samples stay on one grid.
    let period_s = match (first.first(), first.last()) {
        (Some(a), Some(b)) if b.time_s > a.time_s => (b.time_s - a.time_s) / (first.len() - 1) as f64,
        _ => return [0.0; IMUS],
    };
    let common = lag_s(&shown, &seen, LARGEST_LAG_S, period_s);
    let rates =
        |unit: &[Row]| -> Vec<_> { unit.iter().map(|row| (row.time_s, row.sample.gyro_radps.norm())).collect() };
    let reference = rates(first);
    let mut lags = [common; IMUS];
    for (lag, unit) in lags.iter_mut().zip(units) {
        *lag += lag_s(&reference, &rates(unit), LARGEST_LAG_BETWEEN_IMUS_S, period_s);
    }
    lags
}

fn read_truth(file: &Path) -> Result<Vec<Truth>, RecordingError> {
    let mut truths: Vec<Truth> = Vec::new();
    tables::for_each_row(file, TRUTH_COLUMNS, |row| {
        let time = FlightTime::from_seconds(row.get(0)?);
        let (heading, pitch, roll) = (row.get(1)?, row.get(2)?, row.get(3)?);
        // FRD pitch is positive nose up, FLU pitch nose down.
        let yaw = frames::yaw_from_heading(heading.to_radians());
        let attitude = Vector3::new(roll.to_radians(), -pitch.to_radians(), yaw);
        let Enu(position_enu_m) = Ned(row.vector(4)?).into();
        truths.push(Truth {
            position_enu_m,
            world_from_body: frames::from_roll_pitch_yaw(&attitude),
            ..Truth::unknown(time)
        });
        Ok(())
    })?;
    // Velocity by central differences of the RTK position.
    let velocities: Vec<Vector3<f64>> = (0..truths.len())
        .map(|i| {
            let (before, after) = (truths.get(i.saturating_sub(1)), truths.get(i + 1).or(truths.get(i)));
            match (before, after) {
                (Some(a), Some(b)) if b.time > a.time => {
                    (b.position_enu_m - a.position_enu_m) / b.time.seconds_since(a.time)
                }
                _ => Vector3::zeros(),
            }
        })
        .collect();
    for (truth, velocity) in truths.iter_mut().zip(velocities) {
        truth.velocity_enu_mps = velocity;
    }
    Ok(truths)
}

//! Phantom 4 with four Xsens DOT IMUs and an RTK receiver: a folder of `IMU_1..4.csv` and `GT.csv`.
//!
//! The IMU files hold specific force (z up) in m/s² and rates in °/s in axes forward, left, up; their
//! onboard Euler angles are not used. `GT.csv` is the autopilot's log: N, E, D from RTK, attitude in
//! FRD degrees with a compass heading. RTK is both the GNSS sensor (thinned and noised as asked) and
//! the truth of position; the autopilot's attitude is taken as truth of roll and pitch.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::timeline::{Builder, Item, Recording, Sample};
use super::{Format, RecordingError, tables};
use crate::frames::{self, Enu, Ned};
use crate::vehicle::{GnssSample, ImuSample, Truth};

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
const IMU_COLUMNS: &[&str] = &["time", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"];
const TRUTH_COLUMNS: &[&str] =
    &["time", "compass_heading(degrees)", "pitch(degrees)", "roll(degrees)", "North", "East", "Down"];

/// `path` is the folder, or any file in it.
pub(super) fn open(path: &Path, options: Phantom4Options) -> Result<Recording, RecordingError> {
    let folder: PathBuf =
        if path.is_dir() { path.to_owned() } else { path.parent().unwrap_or(Path::new(".")).to_owned() };
    let mut builder = Builder::default();
    builder.airframe = Some("phantom4".into());
    for index in 0..IMUS {
        let file = folder.join(format!("IMU_{}.csv", index + 1));
        if !file.is_file() {
            builder.notes.push(format!("no {}: IMU {} left out", file.display(), index + 1));
            continue;
        }
        tables::for_each_row(&file, IMU_COLUMNS, |row| {
            let time = FlightTime::from_seconds(row.get(0)?);
            let imu = ImuSample {
                time,
                accel_mps2: row.vector(1)?,
                gyro_radps: row.vector(4)?.map(f64::to_radians),
                mag_ut: None,
                temperature_c: 25.0,
            };
            builder.push(time, Item::Sensed(Sample::Imu(index, imu)));
            Ok(())
        })?;
    }
    let truths = read_truth(&folder.join("GT.csv"))?;
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
        builder.push(truth.time, Item::Sensed(Sample::Gnss(fix)));
    }
    builder.finish(&folder, Format::Phantom4)
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

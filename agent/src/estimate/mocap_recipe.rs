//! Runs a twelve-state filter over a motion-capture log the way the references were made: prediction in
//! steps of 1/120 s with that row's input, measurements of every (120/r)-th row, the first at t = 1/r.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::Channel;
use super::ekf_hybrid::EkfHybrid;
use super::scalar_row::{ScalarRow, What};
use super::ukf::Ukf;
use super::{MAX_RESIDUALS, Residual};
use crate::model::euler_body::{U, X, ix, process_noise};

/// Rows a second.
pub const LOG_RATE_HZ: usize = 120;
/// Cameras of [Umasankar] Table 2, m.
pub const CAMERAS_ENU_M: [Vector3<f64>; 4] = [
    Vector3::new(10.0, 10.0, 10.0),
    Vector3::new(-10.0, 10.0, 10.0),
    Vector3::new(-10.0, -10.0, 10.0),
    Vector3::new(10.0, -10.0, 10.0),
];
/// One-sigma of each range, m: the rated one and three exaggerated ([Umasankar], Results).
pub const RANGE_SIGMA_M: [f64; 4] = [1.5e-3, 15e-3, 2e-3, 100e-3];
/// One-sigma of roll, pitch and yaw, rad (chosen by the reference; the source gives none).
pub const ANGLE_SIGMA_RAD: f64 = 5e-3;
/// Process noise, m/s²/√Hz and rad/s²/√Hz.
pub const PROCESS_DENSITY: (f64, f64) = (0.02, 0.1);

/// One row of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogRow {
    /// Time, s.
    pub time_s: f64,
    /// Thrust and torques, held until the next row.
    pub input: U,
    /// True state, as the columns say.
    pub truth: X,
    /// True position, m.
    pub position_m: Vector3<f64>,
    /// Ranges to the cameras, m.
    pub range_m: [f64; 4],
    /// Roll, pitch, yaw measured, rad.
    pub angle_rad: [f64; 3],
}

/// A filter that can run the recipe.
pub trait TwelveState {
    /// Propagates one step.
    fn predict(&mut self, u: &U, h: f64, q: &crate::model::euler_body::M);
    /// Corrects with the rows of one instant.
    fn correct(&mut self, rows: &[ScalarRow], residuals: &mut ArrayVec<Residual, MAX_RESIDUALS>);
    /// The state now.
    fn state(&self) -> X;
}

impl TwelveState for EkfHybrid {
    fn predict(&mut self, u: &U, h: f64, q: &crate::model::euler_body::M) {
        EkfHybrid::predict(self, u, h, q);
    }
    fn correct(&mut self, rows: &[ScalarRow], residuals: &mut ArrayVec<Residual, MAX_RESIDUALS>) {
        EkfHybrid::correct(self, rows, residuals);
    }
    fn state(&self) -> X {
        self.x
    }
}

impl TwelveState for Ukf {
    fn predict(&mut self, u: &U, h: f64, q: &crate::model::euler_body::M) {
        Ukf::predict(self, u, h, q);
    }
    fn correct(&mut self, rows: &[ScalarRow], residuals: &mut ArrayVec<Residual, MAX_RESIDUALS>) {
        Ukf::correct(self, rows, residuals);
    }
    fn state(&self) -> X {
        self.mean()
    }
}

/// The seven measurements of `row` ([Umasankar] Eq. 13, errata 5), without gates.
pub fn measurements(row: &LogRow) -> ArrayVec<ScalarRow, 7> {
    const RANGES: [Channel; 4] = [Channel::Range1, Channel::Range2, Channel::Range3, Channel::Range4];
    const ANGLES: [Channel; 3] = [Channel::Roll, Channel::Pitch, Channel::Yaw];
    let mut rows = ArrayVec::new();
    for (i, channel) in RANGES.into_iter().enumerate() {
        rows.push(ScalarRow {
            sensor: SensorId::new(SensorKind::CameraRanges, 1),
            channel,
            what: What::Range(CAMERAS_ENU_M[i]),
            value: row.range_m[i],
            sigma: RANGE_SIGMA_M[i],
            gate: f64::INFINITY,
        });
    }
    for (i, channel) in ANGLES.into_iter().enumerate() {
        rows.push(ScalarRow {
            sensor: SensorId::new(SensorKind::Imu, 1),
            channel,
            what: What::Angle(ix::ROLL + i),
            value: row.angle_rad[i],
            sigma: ANGLE_SIGMA_RAD,
            gate: f64::INFINITY,
        });
    }
    rows
}

/// Runs `filter` over `log` with measurements at `rate_hz`; the state after each row but the first is given
/// to `each`.
pub fn run_each(log: &[LogRow], rate_hz: usize, filter: &mut impl TwelveState, mut each: impl FnMut(&LogRow, &X)) {
    let every = LOG_RATE_HZ / rate_hz.clamp(1, LOG_RATE_HZ);
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(PROCESS_DENSITY.0, PROCESS_DENSITY.1, h);
    let mut residuals = ArrayVec::new();
    for (k, pair) in log.windows(2).enumerate() {
        filter.predict(&pair[0].input, h, &q);
        if (k + 1) % every == 0 {
            residuals.clear();
            filter.correct(&measurements(&pair[1]), &mut residuals);
        }
        each(&pair[1], &filter.state());
    }
}

#[cfg(test)]
pub(crate) use golden::{Golden, PATHS, run, worst};

#[cfg(test)]
mod golden {
    use std::path::{Path, PathBuf};

    use super::*;

    /// Paths of the reference logs.
    pub(crate) const PATHS: [&str; 3] = ["hover", "circle", "sine"];

    /// The folder of the references, and the estimates in it.
    pub(crate) struct Golden {
        folder: PathBuf,
        json: serde_json::Value,
    }

    impl Golden {
        /// `None`, and a word about it, where the references are absent.
        pub(crate) fn load() -> Option<Self> {
            let root = std::env::var_os("PLUMBLINE_DATA")
                .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
            let folder = root.join("reference");
            let Ok(text) = std::fs::read_to_string(folder.join("mocap_filter_golden.json")) else {
                println!("skipped: {} is absent", folder.join("mocap_filter_golden.json").display());
                return None;
            };
            Some(Self { folder, json: serde_json::from_str(&text).unwrap() })
        }

        pub(crate) fn log(&self, path: &str) -> Vec<LogRow> {
            let file = self.folder.join(format!("mocap_log_{path}.csv"));
            let mut reader = csv::Reader::from_path(file).unwrap();
            let row = |record: csv::StringRecord| {
                let v: Vec<f64> = record.iter().map(|x| x.parse().unwrap()).collect();
                LogRow {
                    time_s: v[0],
                    input: U::new(v[1], v[2], v[3], v[4]),
                    truth: X::from_column_slice(&v[5..17]),
                    position_m: Vector3::new(v[5], v[6], v[7]),
                    range_m: [v[17], v[18], v[19], v[20]],
                    angle_rad: [v[21], v[22], v[23]],
                }
            };
            reader.records().map(|r| row(r.unwrap())).collect()
        }

        pub(crate) fn estimates(&self, rate: usize, path: &str, filter: &str) -> Vec<X> {
            let list = self.json["rates"][rate.to_string()][path][filter].as_array().unwrap();
            list.iter().map(|x| X::from_iterator(x.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()))).collect()
        }
    }

    /// Estimates at t = 1, 2, … s.
    pub(crate) fn run(log: &[LogRow], rate: usize, filter: &mut impl TwelveState) -> Vec<X> {
        let mut found = Vec::new();
        let mut k = 0;
        run_each(log, rate, filter, |_, x| {
            k += 1;
            if k % LOG_RATE_HZ == 0 {
                found.push(*x);
            }
        });
        found
    }

    /// Largest difference of any state, angles wrapped.
    pub(crate) fn worst(found: &[X], expected: &[X]) -> f64 {
        assert_eq!(found.len(), expected.len());
        let difference = |(a, b): (&X, &X)| {
            let mut d = a - b;
            for i in ix::ROLL..=ix::YAW {
                d[i] = crate::frames::wrap_pi(d[i]);
            }
            d.amax()
        };
        found.iter().zip(expected).map(difference).fold(0.0, f64::max)
    }
}

//! Runs a twelve-state filter over a motion-capture log the way the references were made: prediction in
//! steps of 1/120 s with that row's input, measurements of every (120/r)-th row, the first at t = 1/r.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::measurement::{Measurement, TwelveState, What};
use crate::estimate::Residuals;
use crate::estimate::aiding::{ANGLES, RANGES};
use crate::model::euler_body::{M, U, X, ix, process_noise};
use crate::sensor::Accuracy;

/// Rows a second.
pub const LOG_RATE_HZ: usize = 120;
/// Cameras of \[Umasankar\] Table 2, m.
pub const CAMERAS_ENU_M: [Vector3<f64>; 4] = [
    Vector3::new(10.0, 10.0, 10.0),
    Vector3::new(-10.0, 10.0, 10.0),
    Vector3::new(-10.0, -10.0, 10.0),
    Vector3::new(10.0, -10.0, 10.0),
];
/// One-sigma of each range, m: the rated one and three exaggerated (\[Umasankar\], Results).
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

/// The seven measurements of `row` (\[Umasankar\] Eq. 13, errata 5), without gates.
pub fn measurements(row: &LogRow) -> ArrayVec<Measurement, 7> {
    let one = |kind, channel, what, value, sigma| Measurement {
        of: Some((SensorId::new(kind, 1), channel)),
        what,
        value,
        noise: Accuracy::ungated(sigma),
    };
    let ranges = (0..4).map(|i| {
        let what = What::Range(CAMERAS_ENU_M[i]);
        one(SensorKind::CameraRanges, RANGES[i], what, row.range_m[i], RANGE_SIGMA_M[i])
    });
    let angles =
        (0..3).map(|i| one(SensorKind::Imu, ANGLES[i], What::Angle(ix::ROLL + i), row.angle_rad[i], ANGLE_SIGMA_RAD));
    ranges.chain(angles).collect()
}

/// Runs `filter` over `log` with measurements at `rate_hz`; state and covariance after each row but the first are
/// given to `each`.
pub fn run_each(log: &[LogRow], rate_hz: usize, filter: &mut impl TwelveState, mut each: impl FnMut(&LogRow, &X, &M)) {
    let every = LOG_RATE_HZ / rate_hz.clamp(1, LOG_RATE_HZ);
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(PROCESS_DENSITY.0, PROCESS_DENSITY.1, h);
    let mut residuals = Residuals::new();
    for (k, pair) in log.windows(2).enumerate() {
        filter.predict(&pair[0].input, h, &q);
        if (k + 1) % every == 0 {
            residuals.clear();
            filter.correct(&measurements(&pair[1]), &mut residuals);
        }
        let (x, p) = filter.moments();
        each(&pair[1], &x, &p);
    }
}

#[cfg(test)]
pub(crate) use golden::{Golden, check, run};

#[cfg(test)]
mod golden {
    use std::path::PathBuf;

    use super::*;

    /// Paths of the reference logs.
    const PATHS: [&str; 3] = ["hover", "circle", "sine"];

    /// The folder of the references, and the estimates in it.
    pub(crate) struct Golden {
        folder: PathBuf,
        json: serde_json::Value,
    }

    impl Golden {
        /// `None`, and a word about it, where the references are absent.
        pub(crate) fn load() -> Option<Self> {
            let file = crate::shared::shared("reference/mocap_filter_golden.json")?;
            let text = std::fs::read_to_string(&file).unwrap();
            Some(Self { folder: file.parent().unwrap().to_owned(), json: serde_json::from_str(&text).unwrap() })
        }

        pub(crate) fn log(&self, path: &str) -> Vec<LogRow> {
            let file = self.folder.join(format!("mocap_log_{path}.csv"));
            let row = |record: csv::StringRecord| {
                let v: Vec<f64> = record.iter().map(|value| value.parse().unwrap()).collect();
                LogRow {
                    time_s: v[0],
                    input: U::from_column_slice(&v[1..5]),
                    truth: X::from_column_slice(&v[5..17]),
                    position_m: Vector3::new(v[5], v[6], v[7]),
                    range_m: [v[17], v[18], v[19], v[20]],
                    angle_rad: [v[21], v[22], v[23]],
                }
            };
            csv::Reader::from_path(file).unwrap().records().map(|record| row(record.unwrap())).collect()
        }

        fn estimates(&self, rate: usize, path: &str, filter: &str) -> Vec<X> {
            let list = self.json["rates"][rate.to_string()][path][filter].as_array().unwrap();
            list.iter().map(|x| X::from_iterator(x.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()))).collect()
        }
    }

    /// Estimates at t = 1, 2, … s.
    pub(crate) fn run(log: &[LogRow], rate: usize, filter: &mut impl TwelveState) -> Vec<X> {
        let mut found = Vec::new();
        let mut k = 0;
        run_each(log, rate, filter, |_, x, _| {
            k += 1;
            if k % LOG_RATE_HZ == 0 {
                found.push(*x);
            }
        });
        found
    }

    /// `filter`, made anew for each, over the three logs at 120, 12 and 1 Hz against the estimates of the
    /// independent reference called `name` (it agrees with its own check to 6e-8 m; the logs have 9 digits).
    pub(crate) fn check<F: TwelveState>(name: &str, filter: impl Fn() -> F) {
        const TOLERANCE: f64 = 1e-6;
        let Some(golden) = Golden::load() else { return };
        for rate in [120usize, 12, 1] {
            for path in PATHS {
                let found = run(&golden.log(path), rate, &mut filter());
                let worst = worst(&found, &golden.estimates(rate, path, name));
                println!("{name} {path} at {rate} Hz: largest difference {worst:.1e}");
                assert!(worst < TOLERANCE, "{name} {path} at {rate} Hz: {worst}");
            }
        }
    }

    /// Largest difference of any state, angles wrapped.
    fn worst(found: &[X], expected: &[X]) -> f64 {
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

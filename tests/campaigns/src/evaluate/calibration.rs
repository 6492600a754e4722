//! Calibration against recordings: magnetometers with a magnet beside them, propellers.

use plumbline_agent::calibration::Kind;
use plumbline_agent::offline::calibrate::{Request, from_path, write};
use plumbline_agent::recordings::{self, shared};

use super::scored::{Scored, Target};
use super::{entries, stem};

/// Goes into the files only; nothing depends on it.
const DATE: &str = "2026-01-31T12:00:00Z";
/// Thrust coefficient of the APC Slow Flyer 10x4.7, N s², and how close the fit must come.
const APC_10X47: (&str, f64, f64) = ("apcsf 10x4.7", 1.616e-5, 0.01);

pub fn calibration(scored: &mut Scored) {
    scored.report.heading("Calibration");
    magnetometer(scored);
    propellers(scored);
}

/// Trials with a magnet fixed to the IMU: calibrated on the first half, heading scored on the second.
fn magnetometer(scored: &mut Scored) {
    let Some(trials) = entries("data/broad_imu_mocap", |path| stem(path).contains("attached_magnet")) else {
        return scored.skipped("calibration/magnetometer", "data/broad_imu_mocap is absent");
    };
    let folder = tempfile::tempdir().unwrap();
    for trial in trials {
        let name = stem(&trial);
        let request = Request { first_half: true, ..Request::new(Kind::Magnetometer, DATE) };
        let fitted = match from_path(&trial, None, &request) {
            Ok(fitted) => fitted,
            Err(error) => {
                scored.skipped(&format!("calibration/magnetometer/{name}"), &error.to_string());
                continue;
            }
        };
        let file = folder.path().join("magnetometer.json");
        write(&file, &fitted).unwrap();
        let span = recordings::open(&trial).unwrap().info().span;
        let half_s = 0.5 * (span.0.as_seconds() + span.1.as_seconds());
        for (what, files) in [("raw", vec![]), ("calibrated", vec![file.clone()])] {
            let (score, _) = scored.estimate(&trial, "attitude", |args| args.calibration = files);
            let errors: Vec<f64> =
                score.trace().iter().filter(|s| s.time_s > half_s).map(|s| s.heading_deg * s.heading_deg).collect();
            let heading_deg = f64::sqrt(errors.iter().sum::<f64>() / errors.len() as f64);
            // A sphere fit with VQF reaches 2.33° on trial 34.
            let promised = what == "calibrated" && name.starts_with("34");
            let target = if promised { Target::Most(2.3) } else { Target::Peer(None) };
            scored.value(&format!("calibration/magnetometer/{name}/{what}"), heading_deg, "deg", target);
        }
    }
}

/// k of T = k ω² from the wind tunnel's static data.
fn propellers(scored: &mut Scored) {
    let Some(table) = shared("data/uiuc_propellers_static/uiuc_volume1_static.csv") else {
        return scored.skipped("calibration/propellers", "data/uiuc_propellers_static is absent");
    };
    let (propeller, expected, tolerance) = APC_10X47;
    let request = Request { propeller: Some(propeller.into()), ..Request::new(Kind::Thrust, DATE) };
    let fitted = from_path(&table, None, &request).unwrap();
    let k = fitted.value("thrust_coefficient").unwrap();
    let off = (k / expected - 1.0).abs();
    scored.value("calibration/propellers/apcsf_10x4.7/k_relative_error", off, "relative", Target::Most(tolerance));
}

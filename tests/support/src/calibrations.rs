//! Calibration files as a fit makes them.

use plumbline_agent::calibration::{CalibrationFile, Kind};

/// A file of `kind` for IMU `imu` with these parameters.
pub fn file(kind: Kind, imu: u8, parameters: &[(&str, f64)]) -> CalibrationFile {
    let mut file = CalibrationFile::new(kind, 1, 0.5, "");
    (file.sensor, file.date) = (Some(imu), "2026-11-26T11:00:00Z".into());
    parameters.iter().for_each(|(name, value)| file.push(name, *value, None, ""));
    file
}

/// The accelerometer of IMU `imu` that reads `scale` times the truth and no bias.
pub fn accelerometer(imu: u8, scale: [f64; 3]) -> CalibrationFile {
    let [x, y, z] = scale.map(f64::recip);
    let none = [("bias_x", 0.0), ("bias_y", 0.0), ("bias_z", 0.0)];
    file(Kind::Accelerometer, imu, &[&[("scale_x", x), ("scale_y", y), ("scale_z", z)], &none[..]].concat())
}

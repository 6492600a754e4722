//! The CSV of estimates: SI units, world ENU, quaternion world_from_body.

use std::fs::File;
use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::estimate::Estimate;
use plumbline_core::frames::{from_roll_pitch_yaw, roll_pitch_yaw};
use plumbline_core::model::euler_body::{X, ix};

use super::OfflineError;

const COLUMNS: [&str; 17] = [
    "time_s",
    "x_m",
    "y_m",
    "z_m",
    "vx_mps",
    "vy_mps",
    "vz_mps",
    "qw",
    "qx",
    "qy",
    "qz",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "abx",
    "aby",
    "abz",
];
const RATES: [&str; 3] = ["p", "q", "r"];

/// A file of estimates being written.
pub(super) struct Output {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl Output {
    /// Creates `path`; with the body rates as further columns when `rates`.
    pub fn create(path: &Path, rates: bool) -> Result<Self, OfflineError> {
        let writer =
            csv::Writer::from_path(path).map_err(|source| OfflineError::Output { path: path.to_owned(), source })?;
        let mut output = Self { path: path.to_owned(), writer };
        let header = COLUMNS.iter().chain(RATES.iter().filter(|_| rates)).copied();
        output.record(header.map(str::to_owned))?;
        Ok(output)
    }

    fn record(&mut self, fields: impl Iterator<Item = String>) -> Result<(), OfflineError> {
        let fields: Vec<String> = fields.collect();
        self.writer.write_record(&fields).map_err(|source| OfflineError::Output { path: self.path.clone(), source })
    }

    fn row(
        &mut self,
        time_s: f64,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        attitude: &UnitQuaternion<f64>,
        last: &[f64],
    ) -> Result<(), OfflineError> {
        let rpy = roll_pitch_yaw(attitude);
        let q = [attitude.w, attitude.i, attitude.j, attitude.k];
        // Rust prints the shortest text that reads back as the same double.
        let values = [time_s].into_iter().chain(position.iter().copied()).chain(velocity.iter().copied());
        let values = values.chain(q).chain(rpy.iter().copied()).chain(last.iter().copied());
        let text: Vec<String> = values.map(|v| v.to_string()).collect();
        self.record(text.into_iter())
    }

    /// One estimate.
    pub fn estimate(&mut self, e: &Estimate) -> Result<(), OfflineError> {
        let bias: [f64; 3] = e.accel_bias_mps2.unwrap_or_default().into();
        let state = e.kinematics();
        let time_s = e.time.as_seconds();
        self.row(time_s, &state.position_enu_m, &state.velocity_enu_mps, &state.world_from_body, &bias)
    }

    /// One estimate of a twelve-state filter; it has no accelerometer bias.
    pub fn twelve_states(&mut self, time_s: f64, x: &X) -> Result<(), OfflineError> {
        let part = |i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
        let attitude = from_roll_pitch_yaw(&part(ix::ROLL));
        let last = [0.0, 0.0, 0.0, x[ix::P], x[ix::Q], x[ix::R]];
        self.row(time_s, &part(ix::X), &part(ix::VX), &attitude, &last)
    }

    /// Everything on disk.
    pub fn finish(mut self) -> Result<(), OfflineError> {
        self.writer.flush().map_err(|e| OfflineError::Output { path: self.path.clone(), source: csv::Error::from(e) })
    }
}

//! Motion-capture logs of the independent references: 120 rows a second with inputs, truth, four ranges and
//! three angles.
//!
//! Columns: `t,T,tx,ty,tz` (held from a row to the next), `x…r` (true state), `r1..r4` (m), `m_phi`,
//! `m_theta`, `m_psi` (rad). World z up; roll, pitch, yaw ZYX. Not a recording of raw sensors, so it is not a
//! [`super::Recording`]: only the twelve-state filters take it.

use std::path::Path;

use nalgebra::Vector3;
use plumbline_core::estimate::filter::mocap_recipe::LogRow;
use plumbline_core::model::euler_body::{U, X};

use super::{RecordingError, tables};

const COLUMNS: &[&str] = &[
    "t", "T", "tx", "ty", "tz", "x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi", "p", "q", "r", "r1", "r2",
    "r3", "r4", "m_phi", "m_theta", "m_psi",
];

/// Reads a whole log.
///
/// # Errors
/// [`RecordingError`], naming the line and the column.
pub fn read(path: &Path) -> Result<Vec<LogRow>, RecordingError> {
    let mut rows: Vec<LogRow> = Vec::new();
    tables::for_each_row(path, COLUMNS, |row| {
        let mut v = [0.0; 24];
        for (i, value) in v.iter_mut().enumerate() {
            *value = row.get(i)?;
        }
        if let Some(last) = rows.last()
            && v[0] <= last.time_s
        {
            let reason = format!("time goes from {} to {} s", last.time_s, v[0]);
            return Err(RecordingError::malformed(path, reason));
        }
        rows.push(LogRow {
            time_s: v[0],
            input: U::new(v[1], v[2], v[3], v[4]),
            truth: X::from_column_slice(&v[5..17]),
            position_m: Vector3::new(v[5], v[6], v[7]),
            range_m: [v[17], v[18], v[19], v[20]],
            angle_rad: [v[21], v[22], v[23]],
        });
        Ok(())
    })?;
    if rows.len() < 2 {
        return Err(RecordingError::malformed(path, format!("{} rows: nothing to estimate", rows.len())));
    }
    Ok(rows)
}

//! BROAD: one IMU with magnetometer moved by hand, with an optical reference attitude.
//!
//! Sensor frame = body frame. The reference is sensor → ENU with y along *magnetic* north, so
//! declination is zero here. The reference position is that of the markers; rows the data set marks
//! `movement` = 1 are the ones its own score uses and the only ones that become truth.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline_core::sensor::{AnySample, ImuSample};
use plumbline_core::vehicle::Truth;
use plumbline_proto::time::FlightTime;

use super::timeline::{Builder, Item, Recording};
use super::{Format, RecordingError, tables};

const COLUMNS: &[&str] = &[
    "t_s", "gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2", "mx_uT", "my_uT", "mz_uT", "ref_qw",
    "ref_qx", "ref_qy", "ref_qz", "ref_px_m", "ref_py_m", "ref_pz_m", "movement",
];

pub(super) fn open(path: &Path) -> Result<Recording, RecordingError> {
    let mut builder = Builder::default();
    let (_, cut) = tables::for_each_row(path, COLUMNS, |row| {
        let time = FlightTime::from_seconds(row.get(0)?);
        let mag = row.vector(7)?;
        let imu = ImuSample {
            time,
            gyro_radps: row.vector(1)?,
            accel_mps2: row.vector(4)?,
            mag_ut: mag.iter().all(|v| v.is_finite()).then_some(mag),
            temperature_c: 25.0,
        };
        builder.push(time, Item::Sensed(0, AnySample::Imu(imu)));
        let q = Quaternion::new(row.get(10)?, row.get(11)?, row.get(12)?, row.get(13)?);
        let position = row.vector(14)?;
        if row.get(17)? == 1.0 && q.norm().is_finite() && position.iter().all(|v| v.is_finite()) {
            let truth = Truth {
                time,
                position_enu_m: position,
                // Not part of the reference.
                velocity_enu_mps: Vector3::from_element(f64::NAN),
                world_from_body: UnitQuaternion::from_quaternion(q),
                body_rates_radps: imu.gyro_radps,
                specific_force_mps2: imu.accel_mps2,
                ..Truth::unknown(time)
            };
            builder.push(time, Item::Truth(truth));
        }
        Ok(())
    })?;
    if cut {
        builder.notes.push("the file ends in the middle of a row: it was cut short".into());
    }
    builder.finish(path, Format::Broad)
}

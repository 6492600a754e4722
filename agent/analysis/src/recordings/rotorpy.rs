//! RotorPy: a simulated Hummingbird with noisy IMU and motion-capture pose, and its truth.
//!
//! World z up, taken as ENU; quaternions x, y, z, w in the file. `true_a*`/`true_g*` include the
//! sensors' constant biases and are not used as truth of the specific force.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use plumbline_core::sensor::{AnySample, ImuSample, MocapPoseSample};
use plumbline_core::vehicle::Truth;
use plumbline_proto::time::FlightTime;

use super::timeline::{Builder, Item, Recording};
use super::{Format, RecordingError, tables};

const COLUMNS: &[&str] = &[
    "t_s",
    "ax",
    "ay",
    "az",
    "gx",
    "gy",
    "gz",
    "mocap_x",
    "mocap_y",
    "mocap_z",
    "mocap_qx",
    "mocap_qy",
    "mocap_qz",
    "mocap_qw",
    "true_x",
    "true_y",
    "true_z",
    "true_vx",
    "true_vy",
    "true_vz",
    "true_qx",
    "true_qy",
    "true_qz",
    "true_qw",
    "true_wx",
    "true_wy",
    "true_wz",
    "rotor1_rad_s",
    "rotor2_rad_s",
    "rotor3_rad_s",
    "rotor4_rad_s",
];

pub(super) fn open(path: &Path) -> Result<Recording, RecordingError> {
    let mut builder = Builder::default();
    builder.airframe = Some("hummingbird".into());
    let (_, cut) = tables::for_each_row(path, COLUMNS, |row| {
        let time = FlightTime::from_seconds(row.get(0)?);
        let quaternion = |i| -> Result<_, RecordingError> {
            let q = Quaternion::new(row.get(i + 3)?, row.get(i)?, row.get(i + 1)?, row.get(i + 2)?);
            UnitQuaternion::try_new(q, 1e-3)
                .ok_or_else(|| RecordingError::malformed(path, format!("at {time}: quaternion {q} has no direction")))
        };
        let accel_mps2 = row.vector(1)?;
        let imu = ImuSample { time, gyro_radps: row.vector(4)?, accel_mps2, mag_ut: None, temperature_c: 25.0 };
        builder.push(time, Item::Sensed(0, AnySample::Imu(imu)));
        let pose = MocapPoseSample { time, position_enu_m: row.vector(7)?, world_from_body: quaternion(10)? };
        builder.push(time, Item::Sensed(0, AnySample::MocapPose(pose)));
        let truth = Truth {
            position_enu_m: row.vector(14)?,
            velocity_enu_mps: row.vector(17)?,
            world_from_body: quaternion(20)?,
            body_rates_radps: row.vector(24)?,
            specific_force_mps2: accel_mps2,
            rotor_speed_radps: [row.get(27)?, row.get(28)?, row.get(29)?, row.get(30)?],
            ..Truth::unknown(time)
        };
        builder.push(time, Item::Truth(truth));
        Ok(())
    })?;
    if cut {
        builder.notes.push("the file ends in the middle of a row: it was cut short".into());
    }
    builder.finish(path, Format::Rotorpy)
}

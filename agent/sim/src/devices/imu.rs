//! A simulated IMU: off-centre, turned, distorted.

use nalgebra::{Matrix3, Rotation3, Vector3};
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::ImuSample;
use plumbline_core::sensor::imu::{self, Distortion};
use plumbline_core::sensor::noise::{ScalarError, Stream};

use super::{Device, Now, read3, triple};

#[derive(Debug, Clone)]
pub(super) struct Imu {
    position_flu_m: Vector3<f64>,
    pub(super) body_from_sensor: Rotation3<f64>,
    pub(super) gyro: [ScalarError; 3],
    pub(super) accel: [ScalarError; 3],
    mag: Option<[ScalarError; 3]>,
    distort: Distort,
}

/// [`Distortion`] as matrices.
#[derive(Debug, Clone, Copy)]
struct Distort {
    gyro: Matrix3<f64>,
    accel: Matrix3<f64>,
    mag: Matrix3<f64>,
    hard_iron_ut: Vector3<f64>,
}

impl Device for Imu {
    type Sample = ImuSample;

    fn new(s: &imu::Imu, stream: &mut Stream) -> Self {
        let rpy = s.mounting_rpy_rad;
        Self {
            position_flu_m: s.position_flu_m,
            body_from_sensor: Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z),
            gyro: triple(s.gyro, &s.timing, stream),
            accel: triple(s.accel, &s.timing, stream),
            mag: s.mag.map(|q| triple(q, &s.timing, stream)),
            distort: Distort {
                gyro: Distortion::matrix(&s.distortion.gyro),
                accel: Distortion::matrix(&s.distortion.accel),
                mag: Distortion::matrix(&s.distortion.mag),
                hard_iron_ut: Vector3::from(s.distortion.hard_iron_ut),
            },
        }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<ImuSample> {
        let Self { position_flu_m: r, body_from_sensor, gyro, accel, mag, distort } = self;
        let x = now.world.body();
        let w = x.body_rates_radps;
        // At r from the centre of mass: a + α × r + ω × (ω × r).
        let force = now.world.specific_force_flu_mps2()
            + now.world.angular_acceleration_radps2().cross(r)
            + w.cross(&w.cross(r));
        let sensor_from_body = body_from_sensor.inverse();
        let gyro = read3(gyro, &(distort.gyro * (sensor_from_body * w)), stream);
        let accel = read3(accel, &(distort.accel * (sensor_from_body * force)), stream);
        let mag_ut = mag.as_mut().map(|errors| {
            let field = rotate(&x.world_from_body.conjugate(), &now.site.magnetic_field_enu_ut);
            let seen = distort.mag * (sensor_from_body * field) + distort.hard_iron_ut;
            *body_from_sensor * read3(errors, &seen, stream)
        });
        Some(ImuSample {
            time: now.time,
            gyro_radps: *body_from_sensor * gyro,
            accel_mps2: *body_from_sensor * accel,
            mag_ut,
            temperature_c: now.temperature_c(),
        })
    }
}

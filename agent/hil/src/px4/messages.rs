//! Samples and truth as PX4's simulator messages. NED, FRD, degrees and integers begin here.
//!
//! | message | of | units on the wire |
//! |---|---|---|
//! | HIL_SENSOR, `id` 0, 1, 2 | IMU and barometer 1, 2, 3 | m/s², rad/s (FRD), gauss, hPa, °C |
//! | HIL_GPS | GNSS | 1e-7 °, mm, cm/s, cm |
//! | DISTANCE_SENSOR | a laser height, as a beam fixed to the body measures it | cm |
//! | ODOMETRY | motion-capture pose | m |
//! | HIL_STATE_QUATERNION | the truth, for PX4's own log | 1e-7 °, mm, cm/s, mg |

use mavlink::dialects::common::{
    DISTANCE_SENSOR_DATA, HIL_GPS_DATA, HIL_SENSOR_DATA, HIL_STATE_QUATERNION_DATA, HilSensorUpdatedFlags,
    MavDistanceSensor, MavEstimatorType, MavFrame, MavSensorOrientation, ODOMETRY_DATA,
};
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::frames::{Enu, Flu, Frd, Ned};
use plumbline_core::sensor::barometer::{self, STANDARD_PRESSURE_PA};
use plumbline_core::sensor::height::Height;
use plumbline_core::sensor::mocap_pose::MocapPose;
use plumbline_core::sensor::{BarometerSample, GnssSample, HeightSample, ImuSample, MocapPoseSample};
use plumbline_core::types::GRAVITY_MPS2;
use plumbline_core::vehicle::Truth;
use plumbline_proto::time::FlightTime;
use plumbline_sim::site::Site;

use crate::{attitude_wxyz, slant_m};

/// µT in one gauss.
const UT_PER_GAUSS: f64 = 100.0;
/// A course over ground is known above this speed, m/s.
const COURSE_MPS: f64 = 0.2;
/// HIL_GPS for «course unknown».
const NO_COURSE: u16 = u16::MAX;

fn ned(v: &Vector3<f64>) -> Vector3<f64> {
    let Ned(v) = Enu(*v).into();
    v
}

fn frd(v: &Vector3<f64>) -> Vector3<f64> {
    let Frd(v) = Flu(*v).into();
    v
}

/// Latitude, longitude (1e-7 °) and altitude (mm). Numbers beyond the type are cut by the conversion.
fn place(site: &Site, position_enu_m: &Vector3<f64>) -> (i32, i32, i32) {
    let [latitude_deg, longitude_deg, altitude_m] = site.geodetic(position_enu_m);
    ((latitude_deg * 1e7).round() as i32, (longitude_deg * 1e7).round() as i32, (altitude_m * 1e3).round() as i32)
}

fn cmps(v: f64) -> i16 {
    (v * 100.0).round() as i16
}

/// What is fresh of sensor set `id`; its fields say what that is.
pub fn sensor(
    time: FlightTime,
    id: u8,
    imu: Option<&ImuSample>,
    with_mag: bool,
    barometer: Option<&BarometerSample>,
) -> HIL_SENSOR_DATA {
    use HilSensorUpdatedFlags as Fresh;
    let mut message = HIL_SENSOR_DATA { time_usec: time.0, id, ..HIL_SENSOR_DATA::DEFAULT };
    // A default of this crate is the first flag.
    message.fields_updated = Fresh::empty();
    if let Some(imu) = imu {
        let (force, rate) = (frd(&imu.accel_mps2), frd(&imu.gyro_radps));
        (message.xacc, message.yacc, message.zacc) = (force.x as f32, force.y as f32, force.z as f32);
        (message.xgyro, message.ygyro, message.zgyro) = (rate.x as f32, rate.y as f32, rate.z as f32);
        message.fields_updated |= Fresh::HIL_SENSOR_UPDATED_XACC
            | Fresh::HIL_SENSOR_UPDATED_YACC
            | Fresh::HIL_SENSOR_UPDATED_ZACC
            | Fresh::HIL_SENSOR_UPDATED_XGYRO
            | Fresh::HIL_SENSOR_UPDATED_YGYRO
            | Fresh::HIL_SENSOR_UPDATED_ZGYRO;
        if let Some(field_ut) = imu.mag_ut.filter(|_| with_mag) {
            let field = frd(&field_ut) / UT_PER_GAUSS;
            (message.xmag, message.ymag, message.zmag) = (field.x as f32, field.y as f32, field.z as f32);
            message.fields_updated |=
                Fresh::HIL_SENSOR_UPDATED_XMAG | Fresh::HIL_SENSOR_UPDATED_YMAG | Fresh::HIL_SENSOR_UPDATED_ZMAG;
        }
    }
    if let Some(barometer) = barometer {
        message.abs_pressure = (barometer.pressure_pa / 100.0) as f32;
        message.pressure_alt = barometer::pressure_altitude_m(barometer.pressure_pa, STANDARD_PRESSURE_PA) as f32;
        message.temperature = barometer.temperature_c as f32;
        message.fields_updated |= Fresh::HIL_SENSOR_UPDATED_ABS_PRESSURE
            | Fresh::HIL_SENSOR_UPDATED_PRESSURE_ALT
            | Fresh::HIL_SENSOR_UPDATED_TEMPERATURE;
    }
    message
}

/// A fix. Where an attack moved the local position, latitude and longitude move with it.
pub fn gps(time: FlightTime, sample: &GnssSample, site: &Site) -> HIL_GPS_DATA {
    let (lat, lon, alt) = place(site, &sample.position_enu_m);
    let velocity = ned(&sample.velocity_enu_mps);
    let speed = velocity.xy().norm();
    let course = velocity.y.atan2(velocity.x).to_degrees().rem_euclid(360.0);
    HIL_GPS_DATA {
        time_usec: time.0,
        fix_type: 3,
        lat,
        lon,
        alt,
        // PX4 reads both as centimetres.
        eph: (sample.horizontal_sigma_m * 100.0).round().max(1.0) as u16,
        epv: (sample.vertical_sigma_m * 100.0).round().max(1.0) as u16,
        vel: (speed * 100.0).round() as u16,
        vn: cmps(velocity.x),
        ve: cmps(velocity.y),
        vd: cmps(velocity.z),
        cog: if speed > COURSE_MPS { ((course * 100.0).round() as u16) % 36_000 } else { NO_COURSE },
        satellites_visible: sample.satellites.min(254) as u8,
        ..HIL_GPS_DATA::DEFAULT
    }
}

/// The true state.
pub fn state(truth: &Truth, site: &Site) -> HIL_STATE_QUATERNION_DATA {
    let (lat, lon, alt) = place(site, &truth.position_enu_m);
    let (velocity, rates) = (ned(&truth.velocity_enu_mps), frd(&truth.body_rates_radps));
    let mg = frd(&truth.specific_force_mps2) / GRAVITY_MPS2 * 1000.0;
    // Over the ground: the wind is no part of the truth.
    let speed = (truth.velocity_enu_mps.norm() * 100.0).round() as u16;
    HIL_STATE_QUATERNION_DATA {
        time_usec: truth.time.0,
        attitude_quaternion: attitude_wxyz(truth.world_from_body).map(|part| part as f32),
        rollspeed: rates.x as f32,
        pitchspeed: rates.y as f32,
        yawspeed: rates.z as f32,
        lat,
        lon,
        alt,
        vx: cmps(velocity.x),
        vy: cmps(velocity.y),
        vz: cmps(velocity.z),
        ind_airspeed: speed,
        true_airspeed: speed,
        xacc: mg.x.round() as i16,
        yacc: mg.y.round() as i16,
        zacc: mg.z.round() as i16,
    }
}

/// A laser height of data sheet `sheet`, looking down along the body.
pub fn distance(
    time: FlightTime,
    id: u8,
    sample: &HeightSample,
    sheet: &Height,
    world_from_body: &UnitQuaternion<f64>,
) -> DISTANCE_SENSOR_DATA {
    let cm = |m: f64| (m * 100.0).round() as u16;
    DISTANCE_SENSOR_DATA {
        time_boot_ms: (time.0 / 1000) as u32,
        min_distance: cm(sheet.nearest_m),
        max_distance: cm(sheet.height.range),
        current_distance: cm(slant_m(sample.height_m, world_from_body)),
        mavtype: MavDistanceSensor::MAV_DISTANCE_SENSOR_LASER,
        id,
        orientation: MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270,
        // cm²; 255 would mean unknown.
        covariance: (sheet.height.total_sigma() * 100.0).powi(2).ceil().min(254.0) as u8,
        ..DISTANCE_SENSOR_DATA::DEFAULT
    }
}

/// A motion-capture pose, by a system as accurate as `sheet` says.
pub fn odometry(time: FlightTime, sample: &MocapPoseSample, sheet: &MocapPose) -> ODOMETRY_DATA {
    let position = ned(&sample.position_enu_m);
    let variance = |sigma: f64| (sigma * sigma) as f32;
    let mut pose_covariance = [0.0; 21];
    // Diagonal of the upper triangle of a 6 × 6 matrix, written by rows.
    for (at, sigma) in [0, 6, 11]
        .into_iter()
        .map(|at| (at, sheet.position.total_sigma()))
        .chain([15, 18, 20].into_iter().map(|at| (at, sheet.attitude.total_sigma())))
    {
        pose_covariance[at] = variance(sigma);
    }
    ODOMETRY_DATA {
        time_usec: time.0,
        x: position.x as f32,
        y: position.y as f32,
        z: position.z as f32,
        q: attitude_wxyz(sample.world_from_body).map(|part| part as f32),
        // It measures no velocity and no rates.
        vx: f32::NAN,
        vy: f32::NAN,
        vz: f32::NAN,
        rollspeed: f32::NAN,
        pitchspeed: f32::NAN,
        yawspeed: f32::NAN,
        pose_covariance,
        velocity_covariance: [f32::NAN; 21],
        frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_MOCAP,
        ..ODOMETRY_DATA::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::sensor::suite::{Sheet as _, Suite};

    const NOW: FlightTime = FlightTime(4000);

    fn at_rest() -> ImuSample {
        ImuSample {
            time: NOW,
            gyro_radps: Vector3::new(0.1, 0.2, 0.3),
            accel_mps2: Vector3::new(1.0, 2.0, 9.81),
            mag_ut: Some(Vector3::new(20.0, -10.0, -30.0)),
            temperature_c: 25.0,
        }
    }

    #[test]
    fn fields_say_what_is_fresh_and_nothing_else() {
        let baro = BarometerSample { time: NOW, pressure_pa: 101_325.0, temperature_c: 22.0 };
        let bits = |imu: Option<&ImuSample>, with_mag, baro: Option<&BarometerSample>| {
            sensor(NOW, 0, imu, with_mag, baro).fields_updated.bits()
        };
        let without_mag = ImuSample { mag_ut: None, ..at_rest() };
        assert_eq!(bits(None, true, None), 0);
        assert_eq!(bits(Some(&at_rest()), true, Some(&baro)), 0x1bff);
        assert_eq!(bits(Some(&without_mag), true, None), 0x3f);
        assert_eq!(bits(Some(&at_rest()), false, None), 0x3f);
        assert_eq!(bits(None, true, Some(&baro)), 0x1a00);
    }

    #[test]
    fn an_imu_is_forward_right_down_and_gauss() {
        let message = sensor(NOW, 2, Some(&at_rest()), true, None);
        assert_eq!((message.id, message.time_usec), (2, 4000));
        assert_eq!((message.xacc, message.yacc, message.zacc), (1.0, -2.0, -9.81));
        assert_eq!((message.xgyro, message.ygyro, message.zgyro), (0.1, -0.2, -0.3));
        assert_eq!((message.xmag, message.ymag, message.zmag), (0.2, 0.1, 0.3));
    }

    #[test]
    fn a_fix_is_where_its_attacked_position_is() {
        let site = Site::default();
        let fix = |position_enu_m| GnssSample {
            time: NOW,
            position_enu_m,
            velocity_enu_mps: Vector3::new(0.0, -3.0, 0.5),
            geodetic: [0.0; 3],
            horizontal_sigma_m: 1.2,
            vertical_sigma_m: 2.0,
            satellites: 11,
        };
        let (here, there) =
            (gps(NOW, &fix(Vector3::zeros()), &site), gps(NOW, &fix(Vector3::new(0.0, 100.0, 3.0)), &site));
        assert_eq!((here.lat, here.lon, here.alt), (-349_180_000, -561_670_000, 30_000));
        // 100 m to the north: 0.000 90° (110.9 km a degree there); 3 m up.
        let north_deg = f64::from(there.lat - here.lat) * 1e-7;
        assert!((north_deg * 110_920.0 - 100.0).abs() < 0.1, "{north_deg}");
        assert_eq!((there.lon, there.alt), (here.lon, 33_000));
        assert_eq!((here.vn, here.ve, here.vd, here.vel, here.cog), (-300, 0, -50, 300, 18_000));
        assert_eq!((here.eph, here.epv, here.fix_type, here.satellites_visible), (120, 200, 3, 11));
    }

    #[test]
    fn truth_at_rest_facing_north_is_the_identity() {
        let facing_north = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let truth = Truth {
            position_enu_m: Vector3::new(0.0, 0.0, 1.0),
            velocity_enu_mps: Vector3::new(1.0, 2.0, 3.0),
            world_from_body: facing_north,
            body_rates_radps: Vector3::new(0.1, 0.2, 0.3),
            specific_force_mps2: Vector3::new(0.0, 0.0, GRAVITY_MPS2),
            ..Truth::unknown(NOW)
        };
        let message = state(&truth, &Site::default());
        let q = message.attitude_quaternion;
        assert!((q[0] - 1.0).abs() < 1e-6 && q[1..].iter().all(|part| part.abs() < 1e-6), "{q:?}");
        assert_eq!((message.vx, message.vy, message.vz, message.zacc), (200, 100, -300, -1000));
        assert_eq!((message.rollspeed, message.pitchspeed, message.yawspeed), (0.1, -0.2, -0.3));
        assert_eq!(message.alt, 31_000);
    }

    #[test]
    fn a_height_is_the_slant_of_a_beam_and_a_pose_is_north_east_down() {
        let suite = Suite::preset("string_rig").unwrap();
        let sample = HeightSample { time: NOW, height_m: 1.0 };
        let tilted = UnitQuaternion::from_euler_angles(0.5, 0.0, 0.0);
        let message = distance(NOW, 1, &sample, &suite.heights[1], &tilted);
        assert_eq!((message.id, message.time_boot_ms, message.current_distance), (1, 4, 114));
        let sheet = MocapPose::typical(1);
        let pose = MocapPoseSample {
            time: NOW,
            position_enu_m: Vector3::new(1.0, 2.0, 3.0),
            world_from_body: UnitQuaternion::identity(),
        };
        let message = odometry(NOW, &pose, &sheet);
        assert_eq!((message.x, message.y, message.z), (2.0, 1.0, -3.0));
        // Facing east: a quarter of a turn about down.
        assert!((message.q[0] - message.q[3]).abs() < 1e-6 && message.q[0] > 0.7, "{:?}", message.q);
    }
}

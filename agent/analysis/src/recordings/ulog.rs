//! PX4 ULog, versions 0 and 1: the topics that are sensors.
//!
//! Sensors: `sensor_combined` (IMU 1, FRD), `vehicle_magnetometer` (gauss; carried by the next IMU
//! sample), `vehicle_air_data` or the older fields of `sensor_combined` (barometer),
//! `vehicle_gps_position` (GNSS, about the first fix), `battery_status`. Motors: `actuator_motors`
//! (0 to 1; since 1.13), else that instance of `actuator_outputs` (PWM µs) whose first four outputs
//! move most: a vehicle with an IO board logs servos and motors as two instances. Told to do: mode and
//! arming of `vehicle_status` (of `vehicle_control_mode` where that is missing), and the altitude of
//! `vehicle_local_position_setpoint`, about the first `vehicle_local_position`, while it is controlled.
//! Magnetic declination: of the World Magnetic Model at the first fix, on its day.
//! Truth: the `*_groundtruth` topics of the simulation. A file cut short is read up to the cut.

mod container;

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector4};
use plumbline_core::frames::{self, Enu, Flu, Frd, Ned};
use plumbline_core::model::declination;
use plumbline_core::model::geodesy::Geodetic;
use plumbline_core::sensor::{AnySample, BarometerSample, GnssSample, ImuSample};
use plumbline_core::types::{Mode, MotorCommand};
use plumbline_core::vehicle::Truth;
use plumbline_proto::time::FlightTime;

use self::container::Message;
use super::timeline::{Builder, Item, Recording};
use super::{Format, RecordedControl, RecordingError};

pub(super) use self::container::MAGIC;

/// µT in a gauss.
const UT_PER_GAUSS: f64 = 100.0;

pub(super) fn open(path: &Path) -> Result<Recording, RecordingError> {
    let bytes = std::fs::read(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    read(path, &bytes)
}

fn read(path: &Path, bytes: &[u8]) -> Result<Recording, RecordingError> {
    let malformed = |reason: String| RecordingError::malformed(path, reason);
    let mut mapping = Mapping::new(container::start_us(bytes).map_err(malformed)?);
    if !container::each_message(bytes, |message| mapping.take(message)).map_err(malformed)? {
        mapping.builder.notes.push("the file is cut short; read up to the cut".into());
    }
    mapping.finish(path)
}

impl Message<'_> {
    /// Three fields as a vector.
    fn vector(&self, fields: [&str; 3]) -> Option<Vector3<f64>> {
        Some(Vector3::new(self.get(fields[0])?, self.get(fields[1])?, self.get(fields[2])?))
    }

    /// The first three elements of an array as a vector.
    fn triple(&self, field: &str) -> Option<Vector3<f64>> {
        self.array::<3>(field).map(Vector3::from)
    }
}

/// From topics to samples.
struct Mapping {
    builder: Builder,
    start_us: u64,
    mag_ut: Option<Vector3<f64>>,
    last_mag_gauss: Option<Vector3<f64>>,
    last_baro_m: f64,
    origin: Option<[f64; 3]>,
    truth: Option<Truth>,
    /// Commands of every source of motor commands.
    motors: HashMap<Motors, Vec<(FlightTime, MotorCommand)>>,
    told: Told,
}

/// Where motor commands come from; the order is the order of trust.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Motors {
    Commanded,
    Output(u8),
}

/// What the vehicle was told to do, as known so far.
#[derive(Debug, Clone, Copy, Default)]
struct Told {
    /// From `vehicle_status`, which knows more than `vehicle_control_mode`.
    status: Option<(Mode, bool)>,
    control_mode: Option<(Mode, bool)>,
    /// Local position at the first message, down, m.
    first_down_m: Option<f64>,
    setpoint_down_m: Option<f64>,
}

impl Told {
    fn control(&self) -> Option<RecordedControl> {
        let (mode, armed) = self.status.or(self.control_mode)?;
        let mode = if armed { mode } else { Mode::Disarmed };
        let held = matches!(mode, Mode::AltitudeHold | Mode::Hold | Mode::Land);
        let altitude_m = self.setpoint_down_m.filter(|_| held).map(|down| self.first_down_m.unwrap_or(0.0) - down);
        let mut control = RecordedControl { mode, armed, ..RecordedControl::unknown() };
        control.setpoint.position_enu_m.z = altitude_m.unwrap_or(f64::NAN);
        Some(control)
    }
}

/// Mode of a `nav_state`, whose numbers have not changed since PX4 1.4.
fn mode_of(nav_state: f64) -> Mode {
    match nav_state as u32 {
        0 | 10 | 15 | 16 => Mode::Stabilise, // manual, acro, stabilised, rattitude
        1 => Mode::AltitudeHold,
        12 | 18 | 20 => Mode::Land, // descend, land, precision land
        13 => Mode::Cut,            // termination
        _ => Mode::Hold,            // position control and everything automatic
    }
}

impl Mapping {
    fn new(start_us: u64) -> Self {
        Self {
            builder: Builder::default(),
            start_us,
            mag_ut: None,
            last_mag_gauss: None,
            last_baro_m: f64::NAN,
            origin: None,
            truth: None,
            motors: HashMap::new(),
            told: Told::default(),
        }
    }

    /// Of all sources of motor commands one is the vehicle's.
    fn finish(mut self, path: &Path) -> Result<Recording, RecordingError> {
        let mut sources: Vec<_> = self.motors.into_iter().collect();
        sources.sort_by_key(|(source, _)| *source);
        let commanded = sources.iter().position(|(source, _)| *source == Motors::Commanded);
        // The first of those that move most: `max_by` would take the last.
        let moves = |commands: &[(FlightTime, MotorCommand)]| -> f64 {
            let pairs = commands.iter().zip(commands.iter().skip(1));
            pairs.map(|((_, a), (_, b))| (Vector4::from(a.throttle) - Vector4::from(b.throttle)).abs().sum()).sum()
        };
        let most = sources.iter().enumerate().rev().max_by(|(_, a), (_, b)| moves(&a.1).total_cmp(&moves(&b.1)));
        let chosen = commanded.or(most.map(|(i, _)| i));
        if let Some((_, commands)) = chosen.and_then(|i| sources.into_iter().nth(i)) {
            for (time, command) in commands {
                self.builder.push(time, Item::Applied(command));
            }
        }
        self.builder.finish(path, Format::Px4Ulog)
    }

    fn time(&self, message: &Message<'_>) -> Option<FlightTime> {
        let stamp = message.get("timestamp")? as u64;
        Some(FlightTime(stamp.saturating_sub(self.start_us)))
    }

    /// Other instances of a topic, and topics that are no sensors, are left out.
    fn take(&mut self, message: &Message<'_>) {
        let Some(time) = self.time(message) else { return };
        if message.topic == "actuator_outputs" {
            self.outputs(time, message);
            return;
        }
        if message.instance != 0 {
            return;
        }
        // A field that a version of PX4 does not have makes the sample absent, not wrong.
        let _absent: Option<()> = match message.topic {
            "sensor_combined" => self.imu(time, message),
            "vehicle_magnetometer" => message.triple("magnetometer_ga").map(|gauss| self.magnetometer(gauss)),
            "vehicle_air_data" => self.barometer(
                time,
                message.get("baro_alt_meter"),
                message.get("baro_pressure_pa"),
                message.get("baro_temp_celcius"),
            ),
            "vehicle_gps_position" => self.gnss(time, message),
            "battery_status" => message.get("voltage_v").map(|volts| self.builder.push(time, Item::Battery(volts))),
            "actuator_motors" => self.commands(time, message),
            "vehicle_status" => self.status(message),
            "vehicle_control_mode" => self.control_mode(message),
            "vehicle_local_position" => message.get("z").map(|down| {
                self.told.first_down_m.get_or_insert(down);
            }),
            "vehicle_local_position_setpoint" => {
                self.told.setpoint_down_m = message.get("z").filter(|z| z.is_finite());
                None
            }
            "vehicle_attitude_groundtruth" => self.true_attitude(time, message),
            "vehicle_local_position_groundtruth" => self.true_position(time, message),
            _ => None,
        };
    }

    fn imu(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        // Before 2019 sensor_combined carried the magnetometer and the barometer too.
        if let Some(gauss) = message.triple("magnetometer_ga")
            && self.last_mag_gauss != Some(gauss)
        {
            self.last_mag_gauss = Some(gauss);
            self.magnetometer(gauss);
        }
        if let Some(altitude_m) = message.get("baro_alt_meter")
            && altitude_m != self.last_baro_m
        {
            self.last_baro_m = altitude_m;
            self.barometer(time, Some(altitude_m), None, message.get("baro_temp_celcius"));
        }
        let Flu(gyro_radps) = Frd(message.triple("gyro_rad")?).into();
        let Flu(accel_mps2) = Frd(message.triple("accelerometer_m_s2")?).into();
        let imu = ImuSample { time, gyro_radps, accel_mps2, mag_ut: self.mag_ut.take(), temperature_c: 25.0 };
        self.builder.push(time, Item::Sensed(0, AnySample::Imu(imu)));
        // A tick of its own: what is told in it must not be missing from the next.
        if let Some(control) = self.told.control() {
            self.builder.push(time, Item::Control(control));
        }
        Some(())
    }

    fn magnetometer(&mut self, gauss: Vector3<f64>) {
        let Flu(field) = Frd(gauss * UT_PER_GAUSS).into();
        self.mag_ut = Some(field);
    }

    fn barometer(
        &mut self,
        time: FlightTime,
        altitude_m: Option<f64>,
        pressure_pa: Option<f64>,
        temperature_c: Option<f64>,
    ) -> Option<()> {
        // Inverse of the barometric formula ([Strategies], errata 10) where only altitude is logged.
        let pressure_pa = pressure_pa.or(altitude_m.map(|h| 101_325.0 * (1.0 - h / 44_330.0).powf(5.255)))?;
        let sample = BarometerSample { time, pressure_pa, temperature_c: temperature_c.unwrap_or(25.0) };
        self.builder.push(time, Item::Sensed(0, AnySample::Barometer(sample)));
        Some(())
    }

    fn gnss(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        if message.get("fix_type")? < 3.0 {
            return None;
        }
        // Degrees · 1e7 and mm until 2023, degrees and m after.
        let (latitude_deg, longitude_deg, altitude_m) =
            match (message.get("latitude_deg"), message.get("longitude_deg"), message.get("altitude_msl_m")) {
                (Some(lat), Some(lon), Some(alt)) => (lat, lon, alt),
                _ => (message.get("lat")? * 1e-7, message.get("lon")? * 1e-7, message.get("alt")? * 1e-3),
            };
        let here = [latitude_deg, longitude_deg, altitude_m];
        if self.origin.is_none() {
            self.builder.declination_rad = declination_rad(here, message);
            if let Some(declination) = self.builder.declination_rad {
                let degrees = declination.to_degrees();
                self.builder.notes.push(format!("magnetic declination {degrees:.2}°: of the first fix, on its day"));
            }
        }
        let origin = *self.origin.get_or_insert(here);
        let Enu(velocity_enu_mps) = Ned(message.vector(["vel_n_m_s", "vel_e_m_s", "vel_d_m_s"])?).into();
        let fix = GnssSample {
            time,
            position_enu_m: local_enu_m(origin, here),
            velocity_enu_mps,
            geodetic: here,
            horizontal_sigma_m: message.get("eph")?,
            vertical_sigma_m: message.get("epv")?,
            satellites: message.get("satellites_used")? as u32,
        };
        self.builder.push(time, Item::Sensed(0, AnySample::Gnss(fix)));
        Some(())
    }

    fn outputs(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        let throttle = message.array::<4>("output")?.map(|pwm_us: f64| ((pwm_us - 1000.0) / 1000.0).clamp(0.0, 1.0));
        let command = MotorCommand { throttle };
        self.motors.entry(Motors::Output(message.instance)).or_default().push((time, command));
        Some(())
    }

    /// Normalised commands; NaN is a motor that is off.
    fn commands(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        let throttle = message
            .array::<4>("control")?
            .map(|value: f64| if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 });
        let command = MotorCommand { throttle };
        self.motors.entry(Motors::Commanded).or_default().push((time, command));
        Some(())
    }

    fn status(&mut self, message: &Message<'_>) -> Option<()> {
        // ARMING_STATE_ARMED is 2 in every version.
        let armed = message.get("arming_state")? == 2.0;
        self.told.status = Some((mode_of(message.get("nav_state")?), armed));
        Some(())
    }

    fn control_mode(&mut self, message: &Message<'_>) -> Option<()> {
        let on = |flag: &str| message.get(flag).is_some_and(|value| value != 0.0);
        let mode = if on("flag_control_termination_enabled") {
            Mode::Cut
        } else if on("flag_control_position_enabled") {
            Mode::Hold
        } else if on("flag_control_altitude_enabled") || on("flag_control_climb_rate_enabled") {
            Mode::AltitudeHold
        } else {
            Mode::Stabilise
        };
        self.told.control_mode = Some((mode, message.get("flag_armed")? != 0.0));
        Some(())
    }

    fn true_attitude(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        let [w, x, y, z] = message.array::<4>("q")?;
        let q = Quaternion::new(w, x, y, z);
        let world_from_body = frames::enu_from_flu(UnitQuaternion::try_new(q, 1e-3)?);
        let truth = Truth { time, world_from_body, ..self.truth.unwrap_or_else(|| Truth::unknown(time)) };
        self.truth = Some(truth);
        self.builder.push(time, Item::Truth(truth));
        Some(())
    }

    fn true_position(&mut self, time: FlightTime, message: &Message<'_>) -> Option<()> {
        let Enu(position_enu_m) = Ned(message.vector(["x", "y", "z"])?).into();
        let Enu(velocity_enu_mps) = Ned(message.vector(["vx", "vy", "vz"])?).into();
        // Attitude leads: position alone makes no truth.
        self.truth = self.truth.map(|truth| Truth { time, position_enu_m, velocity_enu_mps, ..truth });
        Some(())
    }
}

/// Magnetic declination `here` (degrees, degrees, metres) on the day of a fix, where its clock is set.
fn declination_rad(here: [f64; 3], fix: &Message<'_>) -> Option<f64> {
    let date = declination::day_of_unix(1e-6 * fix.get("time_utc_usec")?)?;
    declination::declination_rad(&Geodetic::from_degrees(here[0], here[1], here[2]), date).ok()
}

/// Local tangent plane about `origin` (degrees, degrees, metres) with the radii of WGS 84 there.
fn local_enu_m(origin: [f64; 3], here: [f64; 3]) -> Vector3<f64> {
    const SEMI_MAJOR_M: f64 = 6_378_137.0;
    const ECCENTRICITY_2: f64 = 6.694_379_990_14e-3;
    let latitude = origin[0].to_radians();
    let w2 = 1.0 - ECCENTRICITY_2 * latitude.sin().powi(2);
    let meridian_m = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2) / w2.powf(1.5);
    let prime_vertical_m = SEMI_MAJOR_M / w2.sqrt();
    let north = (here[0] - origin[0]).to_radians() * meridian_m;
    let east = (here[1] - origin[1]).to_radians() * prime_vertical_m * latitude.cos();
    Vector3::new(east, north, here[2] - origin[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(kind: u8, body: &[u8]) -> Vec<u8> {
        [&(body.len() as u16).to_le_bytes()[..], &[kind], body].concat()
    }

    /// A log of one IMU with two instances of outputs: servos on 0, motors on 1.
    fn log() -> Vec<u8> {
        let mut out = [MAGIC, &[1], &0_u64.to_le_bytes()].concat();
        for format in [
            "sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
            "actuator_outputs:uint64_t timestamp;float[4] output;",
            "vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;",
            "vehicle_local_position:uint64_t timestamp;float z;",
            "vehicle_local_position_setpoint:uint64_t timestamp;float z;",
        ] {
            out.extend(block(b'F', format.as_bytes()));
        }
        let names = ["sensor_combined", "actuator_outputs", "actuator_outputs", "vehicle_status"];
        let more = ["vehicle_local_position", "vehicle_local_position_setpoint"];
        for (i, name) in names.into_iter().chain(more).enumerate() {
            let multi = u8::from(i == 2);
            out.extend(block(b'A', &[&[multi, i as u8, 0][..], name.as_bytes()].concat()));
        }
        let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
        let mut data = |topic: u8, time_us: u64, body: &[u8]| {
            out.extend(block(b'D', &[&[topic, 0][..], &time_us.to_le_bytes(), body].concat()));
        };
        data(4, 0, &floats(&[-0.5]));
        for k in 0..20_u64 {
            let time_us = k * 10_000;
            data(1, time_us, &floats(&[1500.0, 1500.0, 1000.0, 1000.0]));
            data(2, time_us, &floats(&[1400.0 + k as f32, 1400.0, 1400.0, 1400.0]));
            // Armed from the tenth sample on, in altitude hold, 2 m above the start.
            data(3, time_us, &[1, if k < 10 { 1 } else { 2 }]);
            data(5, time_us, &floats(&[-2.5]));
            data(0, time_us + 1, &floats(&[0.0, 0.0, 0.0, 0.0, 0.0, -9.81]));
        }
        out
    }

    #[test]
    fn motors_are_the_outputs_that_move_and_orders_come_along() {
        let mut recording = read(Path::new("made.ulg"), &log()).unwrap();
        let ticks: Vec<_> = std::iter::from_fn(|| recording.next_tick()).collect();
        assert_eq!(ticks.len(), 20);
        assert!((ticks[10].applied.unwrap().throttle[0] - 0.41).abs() < 1e-6, "{:?}", ticks[10].applied);
        let before = ticks[5].control.unwrap();
        assert_eq!((before.mode, before.armed), (Mode::Disarmed, false));
        assert!(before.setpoint.position_enu_m.z.is_nan());
        let flying = ticks[15].control.unwrap();
        assert_eq!((flying.mode, flying.armed), (Mode::AltitudeHold, true));
        assert!((flying.setpoint.position_enu_m.z - 2.0).abs() < 1e-6, "{:?}", flying.setpoint);
    }
}

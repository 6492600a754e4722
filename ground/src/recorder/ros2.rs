//! A flight as a ROS 2 bag: MCAP of profile `ros2`, messages of `sensor_msgs`, `nav_msgs`, `geometry_msgs`, `tf2_msgs`,
//! `actuator_msgs` and `rcl_interfaces` (as of Humble) in CDR, with their definitions in the file.
//!
//! Frames need no change: ROS has the world east-north-up and the body forward-left-up as well (REP 103). The twist of an
//! odometry is in the body's frame there (nav_msgs/Odometry), so velocities are turned.
//!
//! Source of the encoding: OMG, *DDS-XTypes* 1.3, 7.4: plain CDR, little endian, alignment from the end of its header.

use std::collections::BTreeMap;

use mcap::McapResult;
use mcap::records::MessageHeader;
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::{Kind, Message as _, v1};

use super::export::{Sink, mcap_into};
use super::reader::{FlightReader, Recorded};
use crate::scene::body_from_world;

const HEADER: &str = "std_msgs/Header header";
const IMU: &str = "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
    geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
    geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance";
const RANGE: &str = "uint8 ULTRASOUND=0\nuint8 INFRARED=1\nuint8 radiation_type\nfloat32 field_of_view\n\
    float32 min_range\nfloat32 max_range\nfloat32 range";
const ODOMETRY: &str =
    "string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist";
const LOG: &str = "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
    builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line";
const PRESSURE: &str = "float64 fluid_pressure\nfloat64 variance";
const MAGNETIC_FIELD: &str = "geometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance";
const FIX: &str = "sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n\
    float64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n\
    uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\nuint8 position_covariance_type";
const SCAN: &str = "float32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\nfloat32 time_increment\n\
    float32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities";
/// Its constants are left out: nothing but "unknown", zero, is written of them.
const BATTERY: &str = "float32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\nfloat32 capacity\n\
    float32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\n\
    uint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\nfloat32[] cell_temperature\n\
    string location\nstring serial_number";
const ACTUATORS: &str = "float64[] position\nfloat64[] velocity\nfloat64[] normalized";
/// What those are made of.
const PARTS: [(&str, &str); 12] = [
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    ),
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"),
    ("sensor_msgs/NavSatStatus", "int8 status\nuint16 service"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"),
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance"),
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular"),
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance"),
];

/// Messages that are written, each with its definition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Type {
    Imu,
    Range,
    Odometry,
    PoseStamped,
    Pressure,
    MagneticField,
    Fix,
    Scan,
    Battery,
    Actuators,
    Transforms,
    Log,
}

impl Type {
    const fn name(self) -> &'static str {
        match self {
            Self::Imu => "sensor_msgs/msg/Imu",
            Self::Range => "sensor_msgs/msg/Range",
            Self::Odometry => "nav_msgs/msg/Odometry",
            Self::PoseStamped => "geometry_msgs/msg/PoseStamped",
            Self::Pressure => "sensor_msgs/msg/FluidPressure",
            Self::MagneticField => "sensor_msgs/msg/MagneticField",
            Self::Fix => "sensor_msgs/msg/NavSatFix",
            Self::Scan => "sensor_msgs/msg/LaserScan",
            Self::Battery => "sensor_msgs/msg/BatteryState",
            Self::Actuators => "actuator_msgs/msg/Actuators",
            Self::Transforms => "tf2_msgs/msg/TFMessage",
            Self::Log => "rcl_interfaces/msg/Log",
        }
    }

    /// Definition, with all it is made of.
    fn definition(self) -> String {
        let mut text = match self {
            Self::Imu => format!("{HEADER}\n{IMU}\n"),
            Self::Range => format!("{HEADER}\n{RANGE}\n"),
            Self::Odometry => format!("{HEADER}\n{ODOMETRY}\n"),
            Self::PoseStamped => format!("{HEADER}\ngeometry_msgs/Pose pose\n"),
            Self::Pressure => format!("{HEADER}\n{PRESSURE}\n"),
            Self::MagneticField => format!("{HEADER}\n{MAGNETIC_FIELD}\n"),
            Self::Fix => format!("{HEADER}\n{FIX}\n"),
            Self::Scan => format!("{HEADER}\n{SCAN}\n"),
            Self::Battery => format!("{HEADER}\n{BATTERY}\n"),
            Self::Actuators => format!("{HEADER}\n{ACTUATORS}\n"),
            Self::Transforms => "geometry_msgs/TransformStamped[] transforms\n".to_owned(),
            Self::Log => format!("{LOG}\n"),
        };
        // Parts come before what they are made of: one pass finds those of those.
        for _ in 0..PARTS.len() {
            for (name, fields) in PARTS {
                let used = text.lines().any(|line| line.split([' ', '[']).next() == Some(name));
                if used && !text.contains(&format!("MSG: {name}\n")) {
                    text += &format!("{}\nMSG: {name}\n{fields}\n", "=".repeat(80));
                }
            }
        }
        text
    }
}

/// Plain CDR, little endian.
struct Cdr(Vec<u8>);

impl Cdr {
    fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn put(&mut self, bytes: &[u8]) {
        let over = (self.0.len() - 4) % bytes.len();
        if over > 0 {
            self.0.resize(self.0.len() + bytes.len() - over, 0);
        }
        self.0.extend_from_slice(bytes);
    }

    fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.put(&value.to_le_bytes()));
    }

    fn f32(&mut self, value: f64) {
        self.put(&(value as f32).to_le_bytes());
    }

    /// A sequence of `float64`.
    fn sequence(&mut self, values: &[f64]) {
        self.put(&(values.len() as u32).to_le_bytes());
        self.f64s(values);
    }

    fn string(&mut self, text: &str) {
        self.put(&(text.len() as u32 + 1).to_le_bytes());
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    fn stamp(&mut self, time_ns: u64) {
        self.put(&((time_ns / 1_000_000_000) as i32).to_le_bytes());
        self.put(&((time_ns % 1_000_000_000) as u32).to_le_bytes());
    }

    fn header(&mut self, time_ns: u64, frame: &str) {
        self.stamp(time_ns);
        self.string(frame);
    }

    fn vector(&mut self, vector: &v1::Vector3) {
        self.f64s(&[vector.x, vector.y, vector.z]);
    }

    fn quaternion(&mut self, q: &v1::Quaternion) {
        self.f64s(&[q.x, q.y, q.z, q.w]);
    }

    /// Variances of two times three, without correlation.
    fn covariance(&mut self, sigmas: [Option<v1::Vector3>; 2]) {
        let mut covariance = [0.0; 36];
        let all = sigmas.into_iter().flat_map(|sigma| sigma.map_or([0.0; 3], |s| [s.x, s.y, s.z]));
        for (at, sigma) in all.enumerate() {
            if let Some(entry) = covariance.get_mut(at * 7) {
                *entry = sigma * sigma;
            }
        }
        self.f64s(&covariance);
    }
}

const UPRIGHT: v1::Quaternion = v1::Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 0.0 };

/// A message: where, of which type, its bytes.
type Out = (String, Type, Vec<u8>);

fn imu(topic: String, time_ns: u64, frame: &str, reading: &v1::ImuReading) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    cdr.quaternion(&UPRIGHT);
    // sensor_msgs/Imu: -1 says that there is no orientation.
    cdr.f64s(&[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    for vector in [reading.gyro_radps, reading.accel_mps2] {
        cdr.vector(&vector.unwrap_or_default());
        cdr.f64s(&[0.0; 9]);
    }
    (topic, Type::Imu, cdr.0)
}

fn range(topic: String, time_ns: u64, frame: &str, range_m: f64) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    cdr.put(&[1]);
    for value in [0.0, 0.0, f64::INFINITY, range_m] {
        cdr.f32(value);
    }
    (topic, Type::Range, cdr.0)
}

fn pose(topic: String, time_ns: u64, position: &v1::Vector3, attitude: &v1::Quaternion) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, "map");
    cdr.vector(position);
    cdr.quaternion(attitude);
    (topic, Type::PoseStamped, cdr.0)
}

/// Of a reading of motion capture.
fn captured(topic: String, time_ns: u64, reading: &v1::MocapPoseReading) -> Out {
    let (position, attitude) = (reading.position_enu_m, reading.world_from_body);
    pose(topic, time_ns, &position.unwrap_or_default(), &attitude.unwrap_or_default())
}

/// Where the vehicle is to be; what is left to itself is NaN.
fn setpoint(time_ns: u64, setpoint: &v1::Setpoint) -> Out {
    let of = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let position = v1::Vector3 { x: of(setpoint.x_m), y: of(setpoint.y_m), z: of(setpoint.altitude_m) };
    let half = |value: Option<f64>| (0.5 * value.unwrap_or_default()).sin_cos();
    let [(sr, cr), (sp, cp), (sy, cy)] = [half(setpoint.roll_rad), half(setpoint.pitch_rad), half(setpoint.yaw_rad)];
    // Turns about z, then y, then x.
    let attitude = v1::Quaternion {
        w: cr * cp * cy + sr * sp * sy,
        x: sr * cp * cy - cr * sp * sy,
        y: cr * sp * cy + sr * cp * sy,
        z: cr * cp * sy - sr * sp * cy,
    };
    pose("/setpoint".into(), time_ns, &position, &attitude)
}

fn pressure(topic: String, time_ns: u64, frame: &str, reading: &v1::BarometerReading) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    cdr.f64s(&[reading.pressure_pa, 0.0]);
    (topic, Type::Pressure, cdr.0)
}

fn magnetic_field(topic: String, time_ns: u64, frame: &str, mag_ut: &v1::Vector3) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    cdr.f64s(&[mag_ut.x, mag_ut.y, mag_ut.z].map(|microtesla| 1e-6 * microtesla));
    cdr.f64s(&[0.0; 9]);
    (topic, Type::MagneticField, cdr.0)
}

fn fix(topic: String, time_ns: u64, frame: &str, reading: &v1::GnssReading) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    // A fix without help from elsewhere; of which satellites is not known.
    cdr.put(&[0]);
    cdr.put(&0_u16.to_le_bytes());
    cdr.f64s(&[reading.latitude_deg, reading.longitude_deg, reading.altitude_m]);
    let [horizontal, vertical] = [reading.horizontal_sigma_m, reading.vertical_sigma_m].map(|sigma| sigma * sigma);
    cdr.f64s(&[horizontal, 0.0, 0.0, 0.0, horizontal, 0.0, 0.0, 0.0, vertical]);
    cdr.put(&[2]);
    (topic, Type::Fix, cdr.0)
}

fn scan(topic: String, time_ns: u64, frame: &str, scan: &v1::Scan) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, frame);
    let steps = scan.range_mm.len().saturating_sub(1) as f64;
    let last = scan.first_angle_rad + steps * scan.step_angle_rad;
    // How long it turned is not recorded. Below 20 mm the scanner's error codes stand, which are no ranges.
    for value in [scan.first_angle_rad, last, scan.step_angle_rad, 0.0, 0.0, 0.02, f64::INFINITY] {
        cdr.f32(value);
    }
    cdr.put(&(scan.range_mm.len() as u32).to_le_bytes());
    scan.range_mm.iter().for_each(|range_mm| cdr.f32(1e-3 * f64::from(*range_mm)));
    cdr.put(&0_u32.to_le_bytes());
    (topic, Type::Scan, cdr.0)
}

fn battery(time_ns: u64, status: &v1::Status) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, "base_link");
    cdr.f32(status.battery_v);
    // Temperature, current, charge and both capacities are not measured.
    (0..5).for_each(|_| cdr.f32(f64::NAN));
    cdr.f32(status.battery_fraction);
    for byte in [0, 0, 0, 1] {
        cdr.put(&[byte]);
    }
    cdr.put(&0_u32.to_le_bytes());
    cdr.put(&0_u32.to_le_bytes());
    cdr.string("");
    cdr.string("");
    ("/battery".into(), Type::Battery, cdr.0)
}

fn motors(topic: &str, time_ns: u64, commands: &[f64]) -> Out {
    let mut cdr = Cdr::new();
    cdr.header(time_ns, "base_link");
    cdr.sequence(&[]);
    cdr.sequence(&[]);
    cdr.sequence(commands);
    (topic.into(), Type::Actuators, cdr.0)
}

/// Where a frame is in another.
fn transform(time_ns: u64, [parent, child]: [&str; 2], position: &v1::Vector3, attitude: &v1::Quaternion) -> Out {
    let mut cdr = Cdr::new();
    cdr.put(&1_u32.to_le_bytes());
    cdr.header(time_ns, parent);
    cdr.string(child);
    cdr.vector(position);
    cdr.quaternion(attitude);
    ("/tf".into(), Type::Transforms, cdr.0)
}

fn odometry(topic: String, time_ns: u64, estimate: &v1::Estimate) -> Out {
    let attitude = estimate.world_from_body.unwrap_or(UPRIGHT);
    let mut cdr = Cdr::new();
    cdr.header(time_ns, "map");
    cdr.string("base_link");
    cdr.vector(&estimate.position_enu_m.unwrap_or_default());
    cdr.quaternion(&attitude);
    cdr.covariance([estimate.position_sigma_m, estimate.attitude_sigma_rad]);
    cdr.vector(&body_from_world(&attitude, &estimate.velocity_enu_mps.unwrap_or_default()));
    cdr.vector(&estimate.body_rates_radps.unwrap_or_default());
    cdr.covariance([estimate.velocity_sigma_mps, None]);
    (topic, Type::Odometry, cdr.0)
}

fn log(time_ns: u64, event: &v1::Event) -> Out {
    let mut cdr = Cdr::new();
    cdr.stamp(time_ns);
    let level = match event.severity() {
        v1::Severity::Warning => 30,
        v1::Severity::Critical => 40,
        _ => 20,
    };
    cdr.put(&[level]);
    cdr.string(&event.kind);
    cdr.string(&event.text);
    cdr.string("");
    cdr.string("");
    cdr.put(&0_u32.to_le_bytes());
    ("/rosout".into(), Type::Log, cdr.0)
}

/// Where a sample of a sensor goes as sensed, and as received unless it was withheld; each with what it read.
fn both<T: Copy>(
    (name, instance): (&str, u16),
    reception: i32,
    sensed: T,
    received: Option<T>,
) -> impl Iterator<Item = (String, T)> {
    let dropped = reception == v1::Reception::Dropped as i32;
    let received = (!dropped).then(|| received.unwrap_or(sensed));
    [("sensed", Some(sensed)), ("received", received)]
        .into_iter()
        .filter_map(move |(which, reading)| Some((format!("/{name}_{instance}/{which}"), reading?)))
}

/// What one message becomes: samples as sensed, and as received where they were.
fn convert(message: &Recorded<'_>, time_ns: u64) -> Vec<Out> {
    let Some((kind, instance)) = Kind::from_topic(&message.channel.topic) else { return Vec::new() };
    let data = message.payload;
    match kind {
        Kind::Imu => {
            let Ok(v1::ImuSample { reception, sensed: Some(sensed), received, .. }) = v1::ImuSample::decode(data)
            else {
                return Vec::new();
            };
            let frame = format!("imu_{instance}");
            let moved = both(("imu", instance), reception, sensed, received)
                .map(|(topic, reading)| imu(topic, time_ns, &frame, &reading));
            let fields = both(("mag", instance), reception, sensed, received)
                .filter_map(|(topic, reading)| Some(magnetic_field(topic, time_ns, &frame, &reading.mag_ut?)));
            moved.chain(fields).collect()
        }
        Kind::Height => {
            let Ok(v1::HeightSample { reception, sensed_m, received_m, .. }) = v1::HeightSample::decode(data) else {
                return Vec::new();
            };
            let frame = format!("height_{instance}");
            both(("height", instance), reception, sensed_m, received_m)
                .map(|(topic, range_m)| range(topic, time_ns, &frame, range_m))
                .collect()
        }
        Kind::MocapPose => {
            let Ok(v1::MocapPoseSample { reception, sensed: Some(sensed), received, .. }) =
                v1::MocapPoseSample::decode(data)
            else {
                return Vec::new();
            };
            both(("mocap_pose", instance), reception, sensed, received)
                .map(|(topic, reading)| captured(topic, time_ns, &reading))
                .collect()
        }
        Kind::Barometer => {
            let Ok(v1::BarometerSample { reception, sensed: Some(sensed), received, .. }) =
                v1::BarometerSample::decode(data)
            else {
                return Vec::new();
            };
            let frame = format!("barometer_{instance}");
            both(("barometer", instance), reception, sensed, received)
                .map(|(topic, reading)| pressure(topic, time_ns, &frame, &reading))
                .collect()
        }
        Kind::Gnss => {
            let Ok(v1::GnssSample { reception, sensed: Some(sensed), received, .. }) = v1::GnssSample::decode(data)
            else {
                return Vec::new();
            };
            let frame = format!("gnss_{instance}");
            both(("gnss", instance), reception, sensed, received)
                .map(|(topic, reading)| fix(topic, time_ns, &frame, &reading))
                .collect()
        }
        Kind::Scan => {
            let Ok(turned) = v1::Scan::decode(data) else { return Vec::new() };
            let frame = format!("scan_{instance}");
            let position = turned.position_flu_m.unwrap_or_default();
            let attitude = turned.body_from_scan.unwrap_or(UPRIGHT);
            vec![
                scan(format!("/{frame}"), time_ns, &frame, &turned),
                transform(time_ns, ["base_link", &frame], &position, &attitude),
            ]
        }
        Kind::Control => {
            let Ok(control) = v1::Control::decode(data) else { return Vec::new() };
            let mut out = vec![
                motors("/motors/commanded", time_ns, &control.motor_command),
                motors("/motors/applied", time_ns, &control.motor_applied),
            ];
            out.extend(control.setpoint.map(|asked| setpoint(time_ns, &asked)));
            out
        }
        Kind::Status => v1::Status::decode(data).map_or_else(|_| Vec::new(), |status| vec![battery(time_ns, &status)]),
        Kind::Estimate => {
            let Ok(estimate) = v1::Estimate::decode(data) else { return Vec::new() };
            let name = crate::names::JsonName::json_name(estimate.estimator());
            let mut out = vec![odometry(format!("/estimate/{name}"), time_ns, &estimate)];
            if estimate.in_loop {
                let position = estimate.position_enu_m.unwrap_or_default();
                let attitude = estimate.world_from_body.unwrap_or(UPRIGHT);
                out.push(transform(time_ns, ["map", "base_link"], &position, &attitude));
            }
            out
        }
        Kind::Truth => {
            let Ok(truth) = v1::Truth::decode(data) else { return Vec::new() };
            let v1::Truth { position_enu_m, velocity_enu_mps, world_from_body, body_rates_radps, .. } = truth;
            let known = v1::Estimate {
                position_enu_m,
                velocity_enu_mps,
                world_from_body,
                body_rates_radps,
                ..Default::default()
            };
            vec![odometry("/truth".into(), time_ns, &known)]
        }
        Kind::Event => v1::Event::decode(data).map_or_else(|_| Vec::new(), |event| vec![log(time_ns, &event)]),
        _ => Vec::new(),
    }
}

/// Writes the bag of what lies between two flight times, µs.
pub(super) fn write(reader: &FlightReader, (from, to): (u64, u64), sink: &mut Sink<'_>) -> McapResult<()> {
    let mut bag = mcap_into("ros2", sink)?;
    let mut schemas: BTreeMap<Type, u16> = BTreeMap::new();
    let mut channels: BTreeMap<String, (u16, u32)> = BTreeMap::new();
    let boot = WallTime(reader.boot_us());
    reader.for_each(None, |message| {
        if message.time_us > to {
            return Ok(false);
        }
        if message.time_us < from {
            return Ok(true);
        }
        let time_ns = boot.at(FlightTime(message.time_us)).as_nanos();
        for (topic, kind, data) in convert(message, time_ns) {
            if !channels.contains_key(&topic) {
                let schema = match schemas.get(&kind) {
                    Some(schema) => *schema,
                    None => {
                        let schema = bag.add_schema(kind.name(), "ros2msg", kind.definition().as_bytes())?;
                        schemas.insert(kind, schema);
                        schema
                    }
                };
                let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
                channels.insert(topic.clone(), (bag.add_channel(schema, &topic, "cdr", &metadata)?, 0));
            }
            let Some((channel_id, sequence)) = channels.get_mut(&topic) else { continue };
            *sequence += 1;
            let header = MessageHeader {
                channel_id: *channel_id,
                sequence: *sequence,
                log_time: time_ns,
                publish_time: time_ns,
            };
            bag.write_to_known_channel(&header, &data)?;
        }
        Ok(true)
    })?;
    bag.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_aligned_from_the_end_of_the_header() {
        let mut cdr = Cdr::new();
        cdr.string("ab");
        cdr.put(&[7]);
        cdr.f64s(&[1.0]);
        assert_eq!(cdr.0[..12], [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 7]);
        assert_eq!(cdr.0[12..], 1.0_f64.to_le_bytes());
    }

    #[test]
    fn definitions_hold_everything_they_name() {
        let text = Type::Odometry.definition();
        for part in ["std_msgs/Header", "geometry_msgs/Point", "geometry_msgs/Twist", "builtin_interfaces/Time"] {
            assert_eq!(text.matches(&format!("MSG: {part}\n")).count(), 1, "{part}");
        }
        assert!(!Type::Log.definition().contains("Header"));
    }
}

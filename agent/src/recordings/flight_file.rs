//! Our own flight files: MCAP with the messages of the downlink.
//!
//! Every `Control` message ends a tick, so a flight comes back in the very ticks it was flown in.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline_proto::{Kind, Message, ids::SensorId, time::FlightTime, v1};

use super::timeline::{Builder, Item, Recording, Sample};
use super::{Format, RecordedControl, RecordingError};
use crate::control::step_response::StepResponse;
use crate::control::{Setpoint, Wrench};
use crate::log::{MAX_RECORD, chunk_records};
use crate::vehicle::{
    BarometerSample, CameraRangesSample, GnssSample, HeightSample, ImuSample, MocapPoseSample, MotorCommand, Truth,
};

/// Reads the whole file; one that was cut short is read up to its last whole chunk.
pub(super) fn open(path: &Path) -> Result<Recording, RecordingError> {
    let bytes = std::fs::read(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    read(&bytes, path)
}

/// The same of a file in memory; `path` is its name in messages.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Recording, RecordingError> {
    let mut reader =
        Reader { path, builder: Builder::default(), unreadable: BTreeMap::new(), boot_us: None, at: FlightTime(0) };
    if let Err(error) = reader.read(bytes) {
        match error {
            Failure::File(error) => {
                reader.builder.notes.push(format!("cut short or damaged: {error}; read up to there"));
            }
            Failure::Refused(error) => return Err(error),
        }
    }
    for (topic, count) in &reader.unreadable {
        reader.builder.notes.push(format!("{count} messages of {topic} could not be read"));
    }
    // The file's times are wall time; the flight's are since boot.
    reader.builder.shift(reader.boot_us.unwrap_or(0));
    reader.builder.finish(path, Format::Plumbline)
}

/// Why reading ended early.
enum Failure {
    /// The file is cut short or damaged.
    File(McapError),
    /// It is of no use.
    Refused(RecordingError),
}

impl From<McapError> for Failure {
    fn from(error: McapError) -> Self {
        Self::File(error)
    }
}

/// One message of the file.
struct Logged<'a> {
    topic: &'a str,
    log_time: u64,
    data: &'a [u8],
}

struct Reader<'a> {
    path: &'a Path,
    builder: Builder,
    unreadable: BTreeMap<String, usize>,
    /// Wall time at flight time zero, µs.
    boot_us: Option<u64>,
    /// Wall time of the tick the message belongs to; a delayed sample was measured earlier.
    at: FlightTime,
}

impl Reader<'_> {
    /// Passes every message to [`Reader::take`]; lengths are bounded, whatever the bytes claim.
    fn read(&mut self, mut bytes: &[u8]) -> Result<(), Failure> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_RECORD);
        let mut linear = LinearReader::new_with_options(options);
        let mut topics: HashMap<u16, String> = HashMap::new();
        let mut began = false;
        while let Some(event) = linear.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let (now, later) = bytes.split_at(need.min(bytes.len()));
                    linear.insert(now.len()).copy_from_slice(now);
                    linear.notify_read(now.len());
                    bytes = later;
                }
                Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => {
                    began = true;
                    let mut refused = None;
                    chunk_records(data, |record| {
                        refused = self.record(record, &mut topics).err();
                        Ok(refused.is_none())
                    })?;
                    if let Some(refused) = refused {
                        return Err(Failure::Refused(refused));
                    }
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    began = true;
                    self.record(mcap::parse_record(opcode, data)?, &mut topics).map_err(Failure::Refused)?;
                }
                Err(error) if began => return Err(error.into()),
                Err(error) => return Err(Failure::Refused(RecordingError::malformed(self.path, error.to_string()))),
            }
        }
        Ok(())
    }

    fn record(&mut self, record: Record<'_>, topics: &mut HashMap<u16, String>) -> Result<(), RecordingError> {
        match record {
            Record::Channel(channel) => drop(topics.insert(channel.id, channel.topic)),
            Record::Message { header, data } => {
                if let Some(topic) = topics.get(&header.channel_id) {
                    self.take(&Logged { topic, log_time: header.log_time, data: &data })?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn take(&mut self, message: &Logged<'_>) -> Result<(), RecordingError> {
        let Some((kind, instance)) = Kind::from_topic(message.topic) else { return Ok(()) };
        let index = usize::from(instance.saturating_sub(1));
        self.at = FlightTime(message.log_time / 1000);
        let taken = match kind {
            Kind::Imu => self.sensor(index, message.data, imu),
            Kind::Height => self.sensor(index, message.data, height),
            Kind::Barometer => self.sensor(index, message.data, barometer),
            Kind::Gnss => self.sensor(index, message.data, gnss),
            Kind::MocapPose => self.sensor(index, message.data, mocap_pose),
            Kind::CameraRanges => self.sensor(index, message.data, camera_ranges),
            Kind::Truth => v1::Truth::decode(message.data).ok().and_then(|m| self.truth(&m)),
            Kind::Control => v1::Control::decode(message.data).ok().and_then(|m| self.control(&m)),
            Kind::StepResponse => v1::StepResponse::decode(message.data).ok().map(|m| self.step_response(&m)),
            Kind::Description => return self.description(message.data),
            _ => Some(()),
        };
        if taken.is_none() {
            *self.unreadable.entry(message.topic.to_owned()).or_default() += 1;
        }
        Ok(())
    }

    fn description(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        let Ok(message) = v1::Description::decode(bytes) else { return Ok(()) };
        if message.schema != u32::from(plumbline_proto::SCHEMA) {
            return Err(RecordingError::malformed(
                self.path,
                format!("schema {}, this build flies schema {} again", message.schema, plumbline_proto::SCHEMA),
            ));
        }
        self.builder.airframe = Some(message.airframe);
        self.builder.scenario = Some(message.scenario).filter(|s| !s.is_empty());
        Ok(())
    }

    /// `convert` turns a message into the sample sensed and, where it differs, what was received.
    fn sensor(&mut self, index: usize, bytes: &[u8], convert: Convert) -> Option<()> {
        let (sensed, received) = convert(index, bytes)?;
        self.builder.push(self.at, Item::Sensed(sensed));
        if let Some((sensor, received)) = received {
            self.builder.push(self.at, Item::Received(sensor, received));
        }
        Some(())
    }

    fn truth(&mut self, m: &v1::Truth) -> Option<()> {
        let time = FlightTime(m.time_us);
        let rotors = |values: &[f64]| std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0));
        let truth = Truth {
            time,
            position_enu_m: vector(m.position_enu_m.as_ref()?),
            velocity_enu_mps: vector(m.velocity_enu_mps.as_ref()?),
            world_from_body: quaternion(m.world_from_body.as_ref()?)?,
            body_rates_radps: vector(m.body_rates_radps.as_ref()?),
            specific_force_mps2: vector(m.specific_force_mps2.as_ref()?),
            rotor_speed_radps: rotors(&m.rotor_speed_radps),
            string_tension_n: rotors(&m.string_tension_n),
            ground_force_n: m.ground_force_n,
        };
        self.builder.push(self.at, Item::Truth(truth));
        Some(())
    }

    fn step_response(&mut self, m: &v1::StepResponse) {
        let response = StepResponse {
            step: m.step,
            start: FlightTime(m.start_time_us),
            from_m: m.from_m,
            to_m: m.to_m,
            rise_time_s: m.rise_time_s,
            overshoot_percent: m.overshoot_percent,
            settling_time_s: m.settling_time_s,
            band_m: m.band_m,
            steady_error_m: m.steady_error_m,
            finished: m.finished,
            tracking_rms_m: m.tracking_rms_m,
            interrupted: m.interrupted,
        };
        self.builder.push(self.at, Item::StepResponse(response));
    }

    fn control(&mut self, m: &v1::Control) -> Option<()> {
        self.boot_us.get_or_insert(self.at.0.saturating_sub(m.time_us));
        let s = m.setpoint.as_ref()?;
        let value = |v: Option<f64>| v.unwrap_or(f64::NAN);
        let setpoint = Setpoint {
            position_enu_m: Vector3::new(value(s.x_m), value(s.y_m), value(s.altitude_m)),
            velocity_enu_mps: Vector3::zeros(),
            acceleration_enu_mps2: Vector3::zeros(),
            roll_pitch_yaw_rad: Vector3::new(value(s.roll_rad), value(s.pitch_rad), value(s.yaw_rad)),
            throttle: value(s.throttle),
        };
        let motors = |values: &[f64]| MotorCommand { throttle: values.first_chunk().copied().unwrap_or_default() };
        self.builder.push(self.at, Item::Applied(motors(&m.motor_applied)));
        let control = RecordedControl {
            mode: m.mode(),
            armed: m.armed,
            setpoint,
            wrench: Wrench {
                thrust_n: m.thrust_n,
                torque_flu_nm: m.torque_flu_nm.as_ref().map(vector).unwrap_or_default(),
            },
            command: motors(&m.motor_command),
            saturated: m.saturated,
            integrator: m.integrator.first_chunk().copied().unwrap_or_default(),
            // Comes as a message of its own.
            step_response: None,
            motors_known: true,
        };
        self.builder.push(self.at, Item::Control(control));
        if let Some(volts) = m.battery_v {
            self.builder.push(self.at, Item::Battery(volts));
        }
        self.builder.push(self.at, Item::Tick);
        Some(())
    }
}

type Converted = (Sample, Option<(SensorId, Option<Sample>)>);
type Convert = fn(usize, &[u8]) -> Option<Converted>;

/// Sample sensed and received, from a message's parts.
fn sample<R>(
    time_us: u64,
    reception: v1::Reception,
    sensed: Option<R>,
    received: Option<R>,
    sensor: (v1::SensorKind, usize),
    make: impl Fn(FlightTime, R) -> Option<Sample>,
) -> Option<Converted> {
    let time = FlightTime(time_us);
    let id = SensorId::new(sensor.0, sensor.1 as u8 + 1);
    let received = match reception {
        v1::Reception::AsSensed => None,
        v1::Reception::Altered => Some((id, Some(make(time, received?)?))),
        v1::Reception::Dropped => Some((id, None)),
    };
    Some((make(time, sensed?)?, received))
}

fn imu(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::ImuSample::decode(bytes).ok()?;
    sample(m.time_us, m.reception(), m.sensed, m.received, (v1::SensorKind::Imu, index), |time, r| {
        let imu = ImuSample {
            time,
            gyro_radps: vector(r.gyro_radps.as_ref()?),
            accel_mps2: vector(r.accel_mps2.as_ref()?),
            mag_ut: r.mag_ut.as_ref().map(vector),
            temperature_c: r.temperature_c,
        };
        Some(Sample::Imu(index, imu))
    })
}

fn height(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::HeightSample::decode(bytes).ok()?;
    let sensor = (v1::SensorKind::Height, index);
    sample(m.time_us, m.reception(), Some(m.sensed_m), m.received_m, sensor, |time, height_m| {
        Some(Sample::Height(index, HeightSample { time, height_m }))
    })
}

fn barometer(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::BarometerSample::decode(bytes).ok()?;
    sample(m.time_us, m.reception(), m.sensed, m.received, (v1::SensorKind::Barometer, index), |time, r| {
        let sample = BarometerSample { time, pressure_pa: r.pressure_pa, temperature_c: r.temperature_c };
        Some(Sample::Barometer(index, sample))
    })
}

fn gnss(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::GnssSample::decode(bytes).ok()?;
    sample(m.time_us, m.reception(), m.sensed, m.received, (v1::SensorKind::Gnss, index), |time, r| {
        Some(Sample::Gnss(GnssSample {
            time,
            position_enu_m: vector(r.position_enu_m.as_ref()?),
            velocity_enu_mps: vector(r.velocity_enu_mps.as_ref()?),
            geodetic: [r.latitude_deg, r.longitude_deg, r.altitude_m],
            horizontal_sigma_m: r.horizontal_sigma_m,
            vertical_sigma_m: r.vertical_sigma_m,
            satellites: r.satellites,
        }))
    })
}

fn mocap_pose(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::MocapPoseSample::decode(bytes).ok()?;
    sample(m.time_us, m.reception(), m.sensed, m.received, (v1::SensorKind::MocapPose, index), |time, r| {
        Some(Sample::MocapPose(MocapPoseSample {
            time,
            position_enu_m: vector(r.position_enu_m.as_ref()?),
            world_from_body: quaternion(r.world_from_body.as_ref()?)?,
        }))
    })
}

fn camera_ranges(index: usize, bytes: &[u8]) -> Option<Converted> {
    let m = v1::CameraRangesSample::decode(bytes).ok()?;
    sample(m.time_us, m.reception(), m.sensed, m.received, (v1::SensorKind::CameraRanges, index), |time, r| {
        let range_m = r.range_m.first_chunk().copied()?;
        Some(Sample::CameraRanges(CameraRangesSample { time, range_m }))
    })
}

fn vector(v: &v1::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// The unit quaternion with exactly these components, so that a replay repeats every bit.
fn quaternion(q: &v1::Quaternion) -> Option<UnitQuaternion<f64>> {
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    ((q.norm() - 1.0).abs() < 1e-6).then(|| UnitQuaternion::new_unchecked(q))
}

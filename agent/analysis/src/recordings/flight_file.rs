//! Our own flight files: MCAP with the messages of the downlink.
//!
//! Every `Control` message ends a tick, so a flight comes back in the very ticks it was flown in.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use nalgebra::Vector3;
use plumbline_core::control::step_response::StepResponse;
use plumbline_core::sensor::AnySample;
use plumbline_core::sensor::wire::{Received, unit_quaternion, xyz};
use plumbline_core::types::{MotorCommand, Setpoint, Wrench};
use plumbline_core::vehicle::Truth;
use plumbline_file::{MAX_RECORD, chunk_records};
use plumbline_proto::{Kind, Message, ids::SensorId, time::FlightTime, v1};

use super::timeline::{Builder, Item, Recording};
use super::{Format, RecordedControl, RecordingError};

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
            Kind::Truth => v1::Truth::decode(message.data).ok().and_then(|m| self.truth(&m)),
            Kind::Control => v1::Control::decode(message.data).ok().and_then(|m| self.control(&m)),
            Kind::StepResponse => v1::StepResponse::decode(message.data).ok().map(|m| self.step_response(&m)),
            Kind::Description => return self.description(message.data),
            topic => match AnySample::decode(topic, message.data) {
                Some(sample) => sample.map(|(sensed, received)| self.sensor(index, sensed, received)),
                None => Some(()),
            },
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
        for used in message.calibrations {
            if !self.builder.calibrations.contains(&used) {
                self.builder.calibrations.push(used);
            }
        }
        self.builder.declination_rad = message.declination_rad.filter(|declination_rad| declination_rad.is_finite());
        self.builder.scenario = Some(message.scenario).filter(|s| !s.is_empty());
        Ok(())
    }

    fn sensor(&mut self, index: usize, sensed: AnySample, received: Received<AnySample>) {
        self.builder.push(self.at, Item::Sensed(index, sensed));
        if let Received::Instead(received) = received {
            let sensor = SensorId::new(sensed.kind(), index as u8 + 1);
            self.builder.push(self.at, Item::Received(sensor, received));
        }
    }

    fn truth(&mut self, m: &v1::Truth) -> Option<()> {
        let time = FlightTime(m.time_us);
        let rotors = |values: &[f64]| std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0));
        let truth = Truth {
            time,
            position_enu_m: xyz(m.position_enu_m.as_ref()?),
            velocity_enu_mps: xyz(m.velocity_enu_mps.as_ref()?),
            world_from_body: unit_quaternion(m.world_from_body.as_ref()?)?,
            body_rates_radps: xyz(m.body_rates_radps.as_ref()?),
            specific_force_mps2: xyz(m.specific_force_mps2.as_ref()?),
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
                torque_flu_nm: m.torque_flu_nm.as_ref().map(xyz).unwrap_or_default(),
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

//! Signals of a vehicle that flies, from the frames it sent last, in the order in which they came. Times are flight times.

use std::collections::BTreeMap;

use plumbline_proto::Kind;
use plumbline_proto::codec::Frame;
use plumbline_rest::flight::Signal;

use super::{Reading, Rotors, Topic, is_plotted, signals_of};
use crate::recorder::RecordingError;
use crate::recorder::flatten::Table;

/// Every number in `frames`, named and ordered as those of a recorded flight.
pub(crate) fn list<'a>(frames: impl Iterator<Item = Frame<'a>>) -> Vec<Signal> {
    let mut topics = BTreeMap::new();
    for frame in frames {
        let topic = topics.entry((frame.kind, frame.instance)).or_insert_with(|| topic_of(&frame));
        if let Some(topic) = topic {
            topic.look(frame.time_us, frame.payload);
        }
    }
    signals_of(&topics.into_values().flatten().collect::<Vec<_>>())
}

/// Samples of a signal between two flight times, µs: time, s, rising, and value. Empty where nothing of its topic is in
/// `frames`.
///
/// # Errors
/// [`RecordingError::Invalid`] where its topic is there and has no such number.
pub(crate) fn samples<'a>(
    name: &str,
    range_us: (u64, u64),
    frames: impl Iterator<Item = Frame<'a>>,
) -> Result<Vec<(f64, f64)>, RecordingError> {
    let mut known = BTreeMap::new();
    let mut reading = None;
    let mut samples: Vec<(f64, f64)> = Vec::new();
    for frame in frames {
        let ours = known.entry((frame.kind, frame.instance)).or_insert_with(|| is_of(name, &frame));
        if !*ours || !(range_us.0..=range_us.1).contains(&frame.time_us) {
            continue;
        }
        if reading.is_none() {
            reading = Some(read(name, &frame)?);
        }
        let Some((topic, reading)) = &mut reading else { continue };
        let time_s = frame.time_us as f64 / 1e6;
        if let Some(value) = reading.value(&topic.table, frame.payload)
            && samples.last().is_none_or(|(last_s, _)| *last_s < time_s)
        {
            samples.push((time_s, value));
        }
    }
    Ok(samples)
}

/// Mean speed of the rotors while they turn, Hz, between two flight times, µs; `None` where truth does not tell it.
pub(crate) fn rotor_hz<'a>(range_us: (u64, u64), frames: impl Iterator<Item = Frame<'a>>) -> Option<f64> {
    let mut rotors = Rotors::default();
    let truth = |frame: &Frame<'_>| frame.known_kind() == Some(Kind::Truth);
    let inside = |frame: &Frame<'_>| (range_us.0..=range_us.1).contains(&frame.time_us);
    frames.filter(|frame| truth(frame) && inside(frame)).for_each(|frame| rotors.take(frame.payload));
    rotors.mean_hz()
}

/// The topic of a frame as this build knows it, where it has numbers that change.
fn topic_of(frame: &Frame<'_>) -> Option<Topic> {
    let kind = frame.known_kind().filter(|kind| !kind.is_ground_made())?;
    let topic = kind.topic(frame.instance);
    is_plotted(&topic).then(|| Table::of_kind(kind).map(|table| Topic::new(topic, table))).flatten()
}

/// Is a signal of this name one of the frame's topic?
fn is_of(name: &str, frame: &Frame<'_>) -> bool {
    frame.known_kind().is_some_and(|kind| {
        let rest = name.strip_prefix(&Kind::column_prefix(&kind.topic(frame.instance)));
        rest.is_some_and(|rest| rest.starts_with(['.', '[']))
    })
}

/// Where the signal is in messages like this one. A row need not be in it: sensors that sample more seldom come in others.
fn read(name: &str, frame: &Frame<'_>) -> Result<(Topic, Reading), RecordingError> {
    let found = topic_of(frame).and_then(|mut topic| {
        topic.look(frame.time_us, frame.payload);
        let rest = name.strip_prefix(&topic.prefix)?;
        if let Some((row, _)) = rest.strip_prefix('[').and_then(|rest| rest.split_once("].")) {
            topic.rows.insert(row.to_owned());
        }
        let place = topic.signals().find(|(known, ..)| known == name)?.2;
        let reading = Reading::new(&topic, place);
        Some((topic, reading))
    });
    found.ok_or_else(|| RecordingError::Invalid(format!("the vehicle sends no signal {:?}", crate::names::clip(name))))
}

#[cfg(test)]
mod tests {
    use plumbline_proto::{Message, codec, v1};

    use super::*;

    /// A second of two IMUs, of residuals whose rows come by turns, and of truth.
    fn flown() -> Vec<u8> {
        let mut frames = Vec::new();
        let mut put = |kind: Kind, instance: u16, time_us: u64, message: &dyn Fn() -> Vec<u8>| {
            let payload = message();
            Frame { kind: kind.to_wire(), instance, sequence: time_us, time_us, payload: &payload }.encode(&mut frames);
        };
        for tick in 0..100_u64 {
            let time_us = 5_000_000 + tick * 10_000;
            let x = tick as f64 * 0.01;
            let gyro = v1::Vector3 { x, ..Default::default() };
            let sensed = v1::ImuReading { gyro_radps: Some(gyro), ..Default::default() };
            let imu = v1::ImuSample { time_us, sensed: Some(sensed), ..Default::default() };
            put(Kind::Imu, 1, time_us, &|| imu.encode_to_vec());
            put(Kind::Imu, 2, time_us, &|| imu.encode_to_vec());
            let residual = v1::Residual {
                sensor: v1::SensorKind::Height as i32,
                instance: 1 + (tick % 2) as u32,
                channel: v1::Channel::Height as i32,
                innovation: x,
                ..Default::default()
            };
            let residuals = v1::Residuals { time_us, residuals: vec![residual], ..Default::default() };
            put(Kind::Residuals, 3, time_us, &|| residuals.encode_to_vec());
            let truth = v1::Truth { time_us, rotor_speed_radps: vec![628.0, 0.0], ..Default::default() };
            put(Kind::Truth, 0, time_us, &|| truth.encode_to_vec());
        }
        frames
    }

    fn frames(bytes: &[u8]) -> impl Iterator<Item = Frame<'_>> {
        codec::decode_frames(bytes).map_while(Result::ok)
    }

    #[test]
    fn what_a_vehicle_sends_is_listed_and_read_under_the_names_that_a_recording_has() {
        let bytes = flown();
        let listed = list(frames(&bytes));
        let unit = |name: &str| listed.iter().find(|s| s.name == name).map(|s| s.unit.as_str());
        assert_eq!(unit("imu_2.sensed.gyro_radps.x"), Some("rad/s"));
        assert!(unit("residuals_3[height 2 height].innovation").is_some(), "{listed:?}");
        let all = (0, u64::MAX);
        let gyro = samples("imu_1.sensed.gyro_radps.x", (5_200_000, 5_300_000), frames(&bytes)).unwrap();
        assert_eq!((gyro.len(), gyro.first(), gyro.last()), (11, Some(&(5.2, 0.2)), Some(&(5.3, 0.3))));
        // The first of its messages has another row.
        let height = samples("residuals_3[height 2 height].innovation", all, frames(&bytes)).unwrap();
        assert_eq!((height.len(), height.first()), (50, Some(&(5.01, 0.01))));
        assert!(
            samples("imu_3.sensed.gyro_radps.x", all, frames(&bytes)).unwrap().is_empty(),
            "nothing of it has come"
        );
        for wrong in ["imu_1.sensed.gyro_radps.w", "residuals_3[height 2 height].smell", "imu_1."] {
            let refused = samples(wrong, all, frames(&bytes)).unwrap_err().to_string();
            assert!(refused.contains(wrong), "{refused}");
        }
        let hz = rotor_hz(all, frames(&bytes)).unwrap();
        assert!((hz - 99.95).abs() < 0.01, "{hz}");
        assert_eq!(rotor_hz((0, 1), frames(&bytes)), None);
    }
}

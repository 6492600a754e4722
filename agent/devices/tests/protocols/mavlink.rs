//! MAVLink frames that pymavlink packed: read, their fields compared, and written again byte for byte.

use std::sync::Arc;

use mavlink::dialects::common::{MavMessage, SYSTEM_TIME_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader, Message as _};
use plumbline_devices::fault::Fault;
use plumbline_devices::protocol::mavlink::{Frames, Signer};
use serde_json::Value;

use super::peers::bytes;
use super::read;
use crate::shared::shared;

/// Of pymavlink's vectors, whose enumerations are drawn from all numbers there are, so many name values of the dialect.
const READ_MIN: usize = 150;

#[test]
fn vectors_of_pymavlink_are_read_and_written_again() {
    let Some(file) = shared("data/mavlink_vectors/common_v2_unsigned.jsonl") else { return };
    let text = std::fs::read_to_string(file).unwrap();
    let (mut good, mut foreign, mut fields) = (0, 0, 0);
    let mut stream = Vec::new();
    for line in text.lines() {
        let vector: Value = serde_json::from_str(line).unwrap();
        let frame = bytes(vector["hex"].as_str().unwrap());
        stream.extend(&frame);
        let [outcome] = &read(Frames::default(), &frame, 7)[..] else { panic!("one frame: {line}") };
        let (header, message) = match outcome {
            Ok(found) => found,
            // Whole by its sum, with a value that the dialect does not know.
            Err(Fault::Malformed("MAVLink message")) => {
                foreign += 1;
                continue;
            }
            Err(fault) => panic!("{fault}: {line}"),
        };
        good += 1;
        let number = |key: &str| vector[key].as_u64().unwrap();
        assert_eq!(u64::from(header.system_id), number("sysid"), "{line}");
        assert_eq!((u64::from(header.component_id), u64::from(header.sequence)), (number("compid"), number("seq")));
        assert_eq!(
            (u64::from(message.message_id()), message.message_name()),
            (number("msgid"), vector["name"].as_str().unwrap())
        );
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(*header, message);
        assert_eq!(raw.raw_bytes(), frame, "{line}");
        fields += compared(message, &vector["fields"]);
    }
    println!("{good} vectors read and written again, {foreign} with values of no dialect, {fields} fields compared");
    assert!(good >= READ_MIN && fields >= 20, "{good} read, {fields} fields");
    // The same as one stream in pieces.
    let whole = read(Frames::default(), &stream, 31).iter().filter(|outcome| outcome.is_ok()).count();
    assert_eq!(whole, good);
}

#[test]
fn with_a_key_only_what_is_signed_with_it_is_read_and_only_once() {
    let header = MavHeader { system_id: 1, component_id: 1, sequence: 7 };
    let beat = MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_unix_usec: 5, time_boot_ms: 7 });
    let (ours, others) = (Arc::new(Signer::new([7; 32])), Signer::new([8; 32]));
    let with = |bytes: &[u8]| read(Frames { signer: Some(ours.clone()) }, bytes, 11);
    let signed = Signer::new([7; 32]).sign(header, &beat);
    let mut unsigned = MAVLinkV2MessageRaw::new();
    unsigned.serialize_message(header, &beat);
    assert!(matches!(&with(signed.raw_bytes())[..], [Ok((_, message))] if *message == beat));
    for refused in [signed.raw_bytes(), unsigned.raw_bytes(), others.sign(header, &beat).raw_bytes()] {
        assert_eq!(with(refused), [Err(Fault::Unsigned)]);
        assert_eq!(read(Frames::default(), refused, 11).iter().filter(|outcome| outcome.is_ok()).count(), 1);
    }
    assert_eq!(format!("{ours:?}"), "Signer");
}

/// Fields of the messages that the driver uses, against pymavlink's; how many there were.
fn compared(message: &MavMessage, fields: &Value) -> usize {
    let values: Vec<(&str, f64)> = match message {
        MavMessage::HIGHRES_IMU(m) => vec![
            ("time_usec", m.time_usec as f64),
            ("xacc", m.xacc.into()),
            ("yacc", m.yacc.into()),
            ("zgyro", m.zgyro.into()),
            ("xmag", m.xmag.into()),
            ("abs_pressure", m.abs_pressure.into()),
            ("temperature", m.temperature.into()),
        ],
        MavMessage::TIMESYNC(m) => vec![("tc1", m.tc1 as f64), ("ts1", m.ts1 as f64)],
        MavMessage::SYS_STATUS(m) => vec![("voltage_battery", m.voltage_battery.into()), ("load", m.load.into())],
        MavMessage::ATTITUDE(m) => vec![("roll", m.roll.into()), ("yawspeed", m.yawspeed.into())],
        MavMessage::DISTANCE_SENSOR(m) => vec![
            ("current_distance", m.current_distance.into()),
            ("min_distance", m.min_distance.into()),
            ("max_distance", m.max_distance.into()),
        ],
        _ => Vec::new(),
    };
    for (name, value) in &values {
        let theirs = fields[name].as_f64().unwrap();
        assert!((theirs - value).abs() <= 1e-6 * theirs.abs(), "{name}: {theirs} and {value}");
    }
    values.len()
}

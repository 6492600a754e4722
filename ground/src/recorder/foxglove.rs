//! A flight for Foxglove: its messages as they are, and beside them `/tf`, `/scene` and `/log` as the live link has them
//! ([`crate::scene`]), so that a 3D panel shows it as it is.
//!
//! It says nothing of the flight it is of: it is no flight file, and is not taken for one.

use std::collections::BTreeMap;

use mcap::McapResult;
use mcap::records::MessageHeader;
use plumbline_proto::Kind;
use plumbline_proto::codec::Frame;
use plumbline_proto::time::{FlightTime, WallTime};

use super::export::{Sink, mcap_into};
use super::reader::{FlightReader, Recorded};
use crate::scene::{Offer, Scene};

/// Writes what lies between two flight times, µs.
pub(super) fn write(reader: &FlightReader, (from, to): (u64, u64), sink: &mut Sink<'_>) -> McapResult<()> {
    let mut out = mcap_into("", sink)?;
    let mut channels = BTreeMap::new();
    for channel in reader.channels().into_values() {
        let schema = match &channel.schema {
            Some(schema) => out.add_schema(&schema.name, &schema.encoding, &schema.data)?,
            None => 0,
        };
        let id = out.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata)?;
        channels.insert(channel.topic.clone(), id);
    }
    for offer in Offer::ALL {
        let schema = out.add_schema(offer.schema_name(), "jsonschema", offer.schema().to_string().as_bytes())?;
        channels.insert(offer.topic().to_owned(), out.add_channel(schema, offer.topic(), "json", &BTreeMap::new())?);
    }
    let boot = WallTime(reader.boot_us());
    let mut scene = Scene::default();
    reader.for_each(None, |message| {
        if message.time_us > to {
            return Ok(false);
        }
        let (topic, wall) = (&message.channel.topic, boot.at(FlightTime(message.time_us)));
        let drawn = Kind::from_topic(topic).map_or_else(Vec::new, |(kind, instance)| {
            let Recorded { sequence, time_us, payload, .. } = *message;
            scene.take(kind, &Frame { kind: kind.to_wire(), instance, sequence, time_us, payload }, wall.0, |_| true)
        });
        // What came before the range is in the scene, and not in the file.
        if message.time_us < from {
            return Ok(true);
        }
        let mut put = |topic: &str, sequence: u32, data: &[u8]| {
            let Some(channel_id) = channels.get(topic).copied() else { return Ok(()) };
            let log_time = wall.as_nanos();
            out.write_to_known_channel(&MessageHeader { channel_id, sequence, log_time, publish_time: log_time }, data)
        };
        put(topic, message.sequence as u32, message.payload)?;
        for drawn in drawn {
            put(drawn.offer.topic(), 0, drawn.json.to_string().as_bytes())?;
        }
        Ok(true)
    })?;
    out.finish()?;
    Ok(())
}

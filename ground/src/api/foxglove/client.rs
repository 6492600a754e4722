//! What a client asks and is told, as the protocol writes it.

use axum::extract::ws::Message;
use plumbline_proto::descriptor::FILE_DESCRIPTOR_SET;
use serde::Deserialize;
use serde_json::{Value, json};

/// What a client asks.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum Asked {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        #[serde(rename = "subscriptionIds")]
        subscriptions: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

/// One subscription.
#[derive(Debug, Deserialize)]
pub(super) struct Subscription {
    pub(super) id: u32,
    #[serde(rename = "channelId")]
    pub(super) channel: u32,
}

/// The first thing it is told.
pub(super) fn server_info(vehicle: &str) -> String {
    let name = format!("Plumbline {} {vehicle}", env!("CARGO_PKG_VERSION"));
    json!({ "op": "serverInfo", "name": name, "capabilities": [], "supportedEncodings": [], "metadata": {} })
        .to_string()
}

fn channel(id: u32, topic: &str, encoding: &str, name: &str, schema: (&str, String)) -> Message {
    let (schema_encoding, schema) = schema;
    let channel = json!({ "id": id, "topic": topic, "encoding": encoding, "schemaName": name,
        "schemaEncoding": schema_encoding, "schema": schema });
    Message::Text(json!({ "op": "advertise", "channels": [channel] }).to_string().into())
}

/// A topic of our own schema.
pub(super) fn advertise(id: u32, topic: &str, name: &str) -> Message {
    channel(id, topic, "protobuf", name, ("protobuf", base64(FILE_DESCRIPTOR_SET)))
}

/// A topic of a schema that is Foxglove's own.
pub(super) fn advertise_json(id: u32, topic: &str, name: &str) -> Message {
    let schema = json!({ "title": name, "type": "object" });
    channel(id, topic, "json", name, ("jsonschema", schema.to_string()))
}

/// One message: opcode, subscription, time, payload.
pub(super) fn data(subscription: u32, time_ns: u64, payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(13 + payload.len());
    out.push(1);
    out.extend_from_slice(&subscription.to_le_bytes());
    out.extend_from_slice(&time_ns.to_le_bytes());
    out.extend_from_slice(payload);
    out
}

fn status(level: u8, text: &str) -> Message {
    let status: Value = json!({ "op": "status", "level": level, "message": text });
    Message::Text(status.to_string().into())
}

/// Something was not as the client may think.
pub(super) fn warning(text: &str) -> Message {
    status(1, text)
}

/// Something that was asked is not done.
pub(super) fn trouble(text: &str) -> Message {
    status(2, text)
}

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let number = (0..3).fold(0_u32, |number, at| number << 8 | u32::from(three.get(at).copied().unwrap_or(0)));
        for at in 0..4 {
            let letter = LETTERS[(number >> (18 - 6 * at)) as usize & 63];
            out.push(if at > three.len() { '=' } else { char::from(letter) });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        for (plain, encoded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }
}

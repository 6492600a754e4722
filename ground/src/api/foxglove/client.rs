//! What a client asks and is told, as the protocol writes it.

use axum::extract::ws::Message;
use plumbline_proto::descriptor::describing;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::scene::Offer;

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
    GetParameters {
        #[serde(rename = "parameterNames", default)]
        names: Vec<String>,
        id: Option<String>,
    },
    SetParameters {
        #[serde(default)]
        parameters: Vec<Named>,
        id: Option<String>,
    },
    #[serde(other)]
    Other,
}

/// A parameter that a client would set.
#[derive(Debug, Deserialize)]
pub(super) struct Named {
    pub(super) name: String,
}

/// One subscription.
#[derive(Debug, Deserialize)]
pub(super) struct Subscription {
    pub(super) id: u32,
    #[serde(rename = "channelId")]
    pub(super) channel: u32,
}

/// One call of a service.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Call {
    pub(super) service: u32,
    pub(super) id: u32,
    pub(super) encoding: String,
    pub(super) payload: Vec<u8>,
}

/// Reads a binary message: a service call is the only one there is.
///
/// # Errors
/// What is wrong with it.
pub(super) fn call(bytes: &[u8]) -> Result<Call, String> {
    match bytes.first() {
        Some(2) => {}
        Some(1) => return Err("this ground takes no messages of clients; it has services".into()),
        Some(other) => return Err(format!("binary messages of opcode {other} are not known: 2, a service call, is")),
        None => return Err("an empty binary message".into()),
    }
    let cut = || format!("a service call of {} bytes is cut short", bytes.len());
    let (service, rest) = number(bytes.get(1..).unwrap_or_default()).ok_or_else(cut)?;
    let (id, rest) = number(rest).ok_or_else(cut)?;
    let (length, rest) = number(rest).ok_or_else(cut)?;
    let (encoding, payload) = rest.split_at_checked(length as usize).ok_or_else(cut)?;
    let encoding = String::from_utf8_lossy(encoding).into_owned();
    Ok(Call { service, id, encoding, payload: payload.to_vec() })
}

fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

/// What a call comes to, in JSON.
pub(super) fn answered(call: &Call, payload: &[u8]) -> Message {
    const ENCODING: &str = "json";
    let mut out = vec![3];
    out.extend_from_slice(&call.service.to_le_bytes());
    out.extend_from_slice(&call.id.to_le_bytes());
    out.extend_from_slice(&(ENCODING.len() as u32).to_le_bytes());
    out.extend_from_slice(ENCODING.as_bytes());
    out.extend_from_slice(payload);
    Message::Binary(out.into())
}

/// Why a call was not done.
pub(super) fn failed(call: &Call, why: &str) -> Message {
    text(&json!({ "op": "serviceCallFailure", "serviceId": call.service, "callId": call.id, "message": why }))
}

/// A message as text.
pub(super) fn text(json: &Value) -> Message {
    Message::Text(json.to_string().into())
}

/// The first thing it is told.
pub(super) fn server_info(vehicle: &str) -> Message {
    let name = format!("Plumbline {} {vehicle}", env!("CARGO_PKG_VERSION"));
    text(&json!({ "op": "serverInfo", "name": name, "capabilities": ["parameters", "services"],
        "supportedEncodings": ["json"], "metadata": {} }))
}

/// Parameters that were asked for.
pub(super) fn parameters(values: Vec<Value>, id: Option<String>) -> Message {
    let mut told = json!({ "op": "parameterValues", "parameters": values });
    if let Some(id) = id {
        told["id"] = id.into();
    }
    text(&told)
}

fn channel(id: u32, topic: &str, encoding: &str, name: &str, schema: (&str, String)) -> Message {
    let (schema_encoding, schema) = schema;
    let channel = json!({ "id": id, "topic": topic, "encoding": encoding, "schemaName": name,
        "schemaEncoding": schema_encoding, "schema": schema });
    text(&json!({ "op": "advertise", "channels": [channel] }))
}

/// A topic of our own schema.
pub(super) fn advertise(id: u32, topic: &str, name: &str) -> Message {
    channel(id, topic, "protobuf", name, ("protobuf", base64(describing(name))))
}

/// A topic of a schema that is Foxglove's own.
pub(super) fn advertise_json(id: u32, offer: Offer) -> Message {
    channel(id, offer.topic(), "json", offer.schema_name(), ("jsonschema", offer.schema().to_string()))
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

fn status(level: u8, what: &str) -> Message {
    text(&json!({ "op": "status", "level": level, "message": what }))
}

/// Something was not as the client may think.
pub(super) fn warning(what: &str) -> Message {
    status(1, what)
}

/// Something that was asked is not done.
pub(super) fn trouble(what: &str) -> Message {
    status(2, what)
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
    fn a_call_is_read_whole_or_not_at_all() {
        let mut bytes = vec![2, 7, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0];
        bytes.extend_from_slice(b"json{}");
        let whole = Call { service: 7, id: 9, encoding: "json".into(), payload: b"{}".to_vec() };
        assert_eq!(call(&bytes), Ok(whole));
        for length in 1..bytes.len() - 2 {
            assert!(call(&bytes[..length]).unwrap_err().contains("cut short"), "{length}");
        }
        assert!(call(&[]).unwrap_err().contains("empty"));
        assert!(call(&[1, 2, 3]).unwrap_err().contains("services"));
        assert!(call(&[9]).unwrap_err().contains("opcode 9"));
        assert!(call(&[2, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255]).unwrap_err().contains("cut short"));
    }

    #[test]
    fn base64_is_that_of_the_rfc() {
        for (plain, encoded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }
}

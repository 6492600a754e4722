//! Well-formed values with odd content, chosen by what `arbitrary` draws.

use std::sync::OnceLock;

use arbitrary::{Result, Unstructured};
use plumbline_proto::Kind;
use plumbline_proto::codec::Frame;
use plumbline_proto::descriptor::FILE_DESCRIPTOR_SET;
use prost_reflect::prost::Message as _;
use prost_reflect::{Cardinality, DescriptorPool, DynamicMessage, FieldDescriptor, MapKey, MessageDescriptor, Value};

/// How deep messages lie in messages.
const DEEP: u32 = 4;

fn pool() -> &'static DescriptorPool {
    static POOL: OnceLock<DescriptorPool> = OnceLock::new();
    POOL.get_or_init(|| DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap())
}

/// A number, one in three of them unlikely.
pub fn number(u: &mut Unstructured<'_>) -> Result<f64> {
    Ok(match u.int_in_range(0..=8)? {
        0 => *u.choose(&[f64::NAN, f64::INFINITY, f64::NEG_INFINITY])?,
        1 => *u.choose(&[f64::MAX, f64::MIN, f64::MIN_POSITIVE, 5e-324, -0.0, 1e300])?,
        2 => f64::from_bits(u.arbitrary()?),
        _ => f64::from(u.int_in_range(-2000..=2000)?) * 1e-3,
    })
}

/// A count, one in three of them unlikely.
pub fn count(u: &mut Unstructured<'_>) -> Result<u64> {
    Ok(match u.int_in_range(0..=8)? {
        0 => *u.choose(&[u64::MAX, u64::MAX - 1, 1 << 63, 1 << 32, u64::from(u32::MAX), 1 << 31])?,
        1 => u.arbitrary()?,
        2 => 0,
        _ => u.int_in_range(0..=64)?,
    })
}

/// A text: an id that something has, or what people and programs send by mistake.
pub fn text(u: &mut Unstructured<'_>) -> Result<String> {
    const KNOWN: &[&str] = &["f-1", "f-2", "iris-1", "iris-2", "iris", "strings", "secure", "ekf_bias", "height"];
    const ODD: &[&str] =
        &["", "../../x", "a/b", "\0", "\u{202e}x", "NaN", "=1+1", "é\u{301}", "%2e%2e", "con", "\r\nX: y"];
    Ok(match u.int_in_range(0..=5)? {
        0 => (*u.choose(ODD)?).to_owned(),
        1 => "x".repeat(u.int_in_range(1..=5000)?),
        _ => (*u.choose(KNOWN)?).to_owned(),
    })
}

fn single(u: &mut Unstructured<'_>, field: &FieldDescriptor, depth: u32) -> Result<Value> {
    use prost_reflect::Kind::{
        Bool, Bytes, Double, Enum, Fixed32, Fixed64, Float, Int32, Int64, Message, Sfixed32, Sfixed64, Sint32, Sint64,
        String, Uint32, Uint64,
    };
    Ok(match field.kind() {
        Double => Value::F64(number(u)?),
        Float => Value::F32(number(u)? as f32),
        Int32 | Sint32 | Sfixed32 => Value::I32(count(u)? as i32),
        Int64 | Sint64 | Sfixed64 => Value::I64(count(u)? as i64),
        Uint32 | Fixed32 => Value::U32(count(u)? as u32),
        Uint64 | Fixed64 => Value::U64(count(u)?),
        Bool => Value::Bool(u.arbitrary()?),
        String => Value::String(text(u)?),
        Bytes => Value::Bytes(u.arbitrary::<Vec<u8>>()?.into()),
        Message(of) => Value::Message(fields(u, of, depth + 1)?),
        Enum(of) => match u.int_in_range(0..=5)? {
            0 => Value::EnumNumber(count(u)? as i32),
            _ => Value::EnumNumber(u.int_in_range(0..=of.values().len() as i32)?),
        },
    })
}

fn fields(u: &mut Unstructured<'_>, of: MessageDescriptor, depth: u32) -> Result<DynamicMessage> {
    let mut message = DynamicMessage::new(of.clone());
    for field in of.fields() {
        let deep = depth >= DEEP && matches!(field.kind(), prost_reflect::Kind::Message(_));
        if deep || u.ratio(1, 5)? {
            continue;
        }
        let value = if field.is_map() {
            let entry = field.kind();
            let value = entry.as_message().and_then(|entry| entry.get_field_by_name("value"));
            let value = value.map(|value| single(u, &value, depth)).transpose()?;
            Value::Map(value.map(|value| Ok((MapKey::String(text(u)?), value))).transpose()?.into_iter().collect())
        } else if field.cardinality() == Cardinality::Repeated {
            let length = if u.ratio(1, 8)? { u.int_in_range(0..=300)? } else { u.int_in_range(0..=6)? };
            Value::List((0..length).map(|_| single(u, &field, depth)).collect::<Result<_>>()?)
        } else {
            single(u, &field, depth)?
        };
        message.set_field(&field, value);
    }
    Ok(message)
}

/// A message of the schema, named in full, as bytes.
pub fn message(u: &mut Unstructured<'_>, name: &str) -> Result<Vec<u8>> {
    Ok(fields(u, pool().get_message_by_name(name).unwrap(), 0)?.encode_to_vec())
}

/// A frame whose header is odd at times; its payload a message of its kind. `next` counts.
pub fn frame(u: &mut Unstructured<'_>, next: &mut u64, out: &mut Vec<u8>) -> Result<()> {
    let kind = *u.choose(Kind::ALL)?;
    let payload = message(u, kind.message_name())?;
    *next = if u.ratio(1, 12)? { count(u)? } else { next.wrapping_add(1) };
    let time_us = if u.ratio(1, 12)? { count(u)? } else { next.saturating_mul(5000) };
    let instance = if kind.has_instances() { u.int_in_range(0..=3)? } else { 0 };
    let instance = if u.ratio(1, 16)? { u.arbitrary()? } else { instance };
    let wire = if u.ratio(1, 32)? { u.arbitrary()? } else { kind.to_wire() };
    Frame { kind: wire, instance, sequence: *next, time_us, payload: &payload }.encode(out);
    Ok(())
}

/// JSON like `template`: values replaced by odd ones, keys dropped, lists longer.
pub fn json(u: &mut Unstructured<'_>, template: &serde_json::Value) -> Result<serde_json::Value> {
    use serde_json::{Value as Json, json};
    if u.ratio(1, 6)? {
        return Ok(match u.int_in_range(0..=7)? {
            0 => Json::Null,
            1 => json!(u.arbitrary::<bool>()?),
            2 => json!(number(u)?),
            3 => json!(count(u)?),
            4 => json!(-(count(u)? as i64 >> 1)),
            5 => json!(text(u)?),
            6 => (0..u.int_in_range(0..=120)?).fold(json!(1), |inner, _| json!([inner])),
            _ => json!({ text(u)?: number(u)? }),
        });
    }
    Ok(match template {
        Json::Object(entries) => {
            let mut kept = serde_json::Map::new();
            for (key, value) in entries {
                if !u.ratio(1, 10)? {
                    kept.insert(key.clone(), json(u, value)?);
                }
            }
            Json::Object(kept)
        }
        Json::Array(items) => {
            let times = if u.ratio(1, 8)? { u.int_in_range(0..=40)? } else { 1 };
            let items = items.iter().cycle().take(items.len() * times);
            Json::Array(items.map(|item| json(u, item)).collect::<Result<_>>()?)
        }
        Json::Number(_) if u.ratio(1, 3)? => json!(number(u)?),
        Json::String(_) if u.ratio(1, 4)? => json!(text(u)?),
        other => other.clone(),
    })
}

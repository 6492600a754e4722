//! The contract against `tests/snapshots`: what is there may grow, what is on the wire may not change.
//!
//! `cargo xtask bless` rewrites the snapshots; the commit says why, and whether `SCHEMA` had to rise.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

use plumbline_proto::descriptor::{FILE_DESCRIPTOR_SET, describing};
use plumbline_proto::{Kind, SCHEMA};
use prost_reflect::prost::Message as _;
use prost_reflect::{Cardinality, DescriptorPool, DynamicMessage, FieldDescriptor, MapKey, MessageDescriptor, Value};

fn check(name: &str, found: &str) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots").join(name);
    if std::env::var_os("PLUMBLINE_BLESS").is_some() {
        std::fs::write(&file, found).unwrap();
        return;
    }
    let expected = std::fs::read_to_string(&file).unwrap_or_default();
    let differs = expected.lines().zip(found.lines()).find(|(a, b)| a != b);
    let first = differs.map_or_else(|| "its length".to_owned(), |(a, b)| format!("`{a}`, now `{b}`"));
    assert!(expected == found, "{} differs, first in {first}; `cargo xtask bless` accepts it", file.display());
}

fn messages() -> Vec<MessageDescriptor> {
    let pool = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
    let mut messages: Vec<_> = pool.all_messages().filter(|m| m.full_name().starts_with("plumbline.")).collect();
    messages.sort_by(|a, b| a.full_name().cmp(b.full_name()));
    messages
}

#[test]
fn names_numbers_and_types_of_every_field() {
    let mut text = format!("schema {SCHEMA}\n");
    for message in messages() {
        writeln!(text, "\nmessage {}", message.full_name()).unwrap();
        for field in message.fields() {
            let many = if field.cardinality() == Cardinality::Repeated { "repeated " } else { "" };
            let present =
                if field.supports_presence() && field.kind().as_message().is_none() { "optional " } else { "" };
            writeln!(text, "  {} {many}{present}{:?} {}", field.number(), field.kind(), field.name()).unwrap();
        }
    }
    let pool = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
    let mut enums: Vec<_> = pool.all_enums().filter(|e| e.full_name().starts_with("plumbline.")).collect();
    enums.sort_by(|a, b| a.full_name().cmp(b.full_name()));
    for e in enums {
        writeln!(text, "\nenum {}", e.full_name()).unwrap();
        for value in e.values() {
            writeln!(text, "  {} {}", value.number(), value.name()).unwrap();
        }
    }
    check("schema.txt", &text);
}

#[test]
fn kinds_topics_and_messages() {
    let pool = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
    let mut text = String::new();
    for kind in Kind::ALL {
        assert!(pool.get_message_by_name(kind.message_name()).is_some(), "{kind:?} names no message of the schema");
        writeln!(text, "{} {kind:?} {} {}", kind.to_wire(), kind.topic(2), kind.message_name()).unwrap();
    }
    check("kinds.txt", &text);
}

/// A value that differs from every other field's, so that fields that change places are seen.
fn value(field: &FieldDescriptor, depth: u32) -> Value {
    use prost_reflect::Kind::{Bool, Bytes, Double, Enum, Float, Message, String};
    let n = field.number();
    match field.kind() {
        Double => Value::F64(f64::from(n) + 0.25),
        Float => Value::F32(n as f32 + 0.5),
        Bool => Value::Bool(true),
        String => Value::String(format!("text {n}")),
        Bytes => Value::Bytes(vec![n as u8; 3].into()),
        Enum(e) => Value::EnumNumber(e.values().map(|v| v.number()).max().unwrap_or_default()),
        Message(message) => Value::Message(filled(&message, depth + 1)),
        prost_reflect::Kind::Uint64 | prost_reflect::Kind::Fixed64 => Value::U64(u64::from(n) << 33 | 7),
        prost_reflect::Kind::Uint32 | prost_reflect::Kind::Fixed32 => Value::U32(n + 300),
        prost_reflect::Kind::Int64 | prost_reflect::Kind::Sint64 | prost_reflect::Kind::Sfixed64 => {
            Value::I64(-i64::from(n))
        }
        _ => Value::I32(-(n as i32)),
    }
}

/// Every field set; of a oneof the last wins.
fn filled(message: &MessageDescriptor, depth: u32) -> DynamicMessage {
    assert!(depth < 8, "{} holds itself", message.full_name());
    let mut out = DynamicMessage::new(message.clone());
    for field in message.fields() {
        let one = value(&field, depth);
        let all = if field.is_map() {
            Value::Map(std::iter::once((MapKey::String("key".into()), one)).collect())
        } else if field.is_list() {
            Value::List(vec![one.clone(), one])
        } else {
            one
        };
        out.set_field(&field, all);
    }
    out
}

#[test]
fn bytes_of_every_message() {
    let mut text = String::new();
    for message in messages() {
        let whole = filled(&message, 0);
        let bytes = whole.encode_to_vec();
        assert_eq!(
            DynamicMessage::decode(message.clone(), bytes.as_slice()).unwrap(),
            whole,
            "{}",
            message.full_name()
        );
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        writeln!(text, "{} {hex}", message.full_name()).unwrap();
    }
    check("wire.txt", &text);
}

/// The generated types read what the descriptors write: one message of each kind, there and back.
#[test]
fn generated_types_keep_every_field() {
    macro_rules! round_trip {
        ($($name:ident),* $(,)?) => {$(
            let descriptor = messages().into_iter().find(|m| m.name() == stringify!($name)).unwrap();
            let bytes = filled(&descriptor, 0).encode_to_vec();
            let message = <plumbline_proto::v1::$name as plumbline_proto::Message>::decode(bytes.as_slice()).unwrap();
            let again = plumbline_proto::Message::encode_to_vec(&message);
            let again = DynamicMessage::decode(descriptor.clone(), again.as_slice()).unwrap();
            assert_eq!(again, filled(&descriptor, 0), stringify!($name));
        )*};
    }
    round_trip!(
        ImuSample,
        HeightSample,
        BarometerSample,
        GnssSample,
        MocapPoseSample,
        CameraRangesSample,
        Estimate,
        Residuals,
        Truth,
        Control,
        StepResponse,
        GainsInUse,
        AttackState,
        Status,
        Event,
        Ack,
        Description,
        FlightMark,
        DeviceState,
        Scan,
        LinkStatus,
        RecordingStatus,
        ControlLease,
        Command,
        CommandFrame,
        Hello,
    );
}

/// GIVEN what describes one kind's message alone WHEN a message with every field is read by it THEN it reads as by the whole schema, and
/// no type of it is described that its fields do not lead to.
#[test]
fn every_kind_is_described_by_itself() {
    let whole = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
    for kind in Kind::ALL {
        let bytes = describing(kind.message_name());
        let pool = DescriptorPool::decode(bytes).unwrap();
        let [alone, among] = [&pool, &whole].map(|pool| pool.get_message_by_name(kind.message_name()).unwrap());
        let encoded = filled(&among, 0).encode_to_vec();
        let read = DynamicMessage::decode(alone.clone(), encoded.as_slice()).unwrap();
        assert_eq!(read.unknown_fields().count(), 0, "{kind:?}");
        assert_eq!(read.to_string(), filled(&among, 0).to_string(), "{kind:?}");
        let mut led_to = BTreeSet::from([alone.full_name().to_owned()]);
        let mut next = vec![alone];
        while let Some(message) = next.pop() {
            let types = message.fields().filter_map(|field| field.kind().as_message().cloned());
            next.extend(types.filter(|message| led_to.insert(message.full_name().to_owned())));
        }
        assert_eq!(pool.all_messages().map(|m| m.full_name().to_owned()).collect::<BTreeSet<_>>(), led_to, "{kind:?}");
    }
    assert_eq!(describing("plumbline.v1.Nonsense"), FILE_DESCRIPTOR_SET);
}

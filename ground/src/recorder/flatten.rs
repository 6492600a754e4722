//! Any protobuf message as columns, from the descriptors embedded in the flight file: kinds and
//! schemas newer than this build become tables as well.
//!
//! - A field is a column, named by its path: `setpoint.altitude_m`.
//! - A repeated number is a column per element: `motor_command[0]`.
//! - A repeated message (residuals, checks) is a row per element; or, of those that name a sensor, columns per sensor:
//!   `height_2.height.innovation_m`, see [`Table::by_sensor`].
//! - An absent field is an empty cell; an enum is its name.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use mcap::Channel;
use plumbline_proto::descriptor::FILE_DESCRIPTOR_SET;
use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, ReflectMessage as _, Value,
};

/// Messages nested deeper than this are left out: a schema may be recursive.
const MAX_DEPTH: usize = 6;
/// Most fields of one table, with those of the messages inside: beyond, a small schema whose types are fields of one another would
/// take all memory.
const MAX_FIELDS: usize = 20_000;
/// Most columns of one repeated field: a scan has 682 ranges.
const MAX_WIDTH: usize = 1024;
/// Most sensors, or channels of them, that have columns of their own in one repeated message.
const MAX_SENSORS: usize = 512;
/// By which elements of a repeated message are told apart, in the order of their names.
const TELLING: [&str; 3] = ["sensor", "instance", "channel"];

#[derive(Debug, Clone)]
enum Column {
    Scalar,
    List { width: usize },
    Nested(Vec<(FieldDescriptor, Column)>),
    Rows(Vec<(FieldDescriptor, Column)>),
    BySensor { inner: Vec<(FieldDescriptor, Column)>, found: BTreeMap<Vec<i64>, Element> },
}

/// What elements of a repeated message with the same sensor, instance and channel are called.
#[derive(Debug, Clone)]
struct Element {
    /// `height_2.height`, or `height` of what has no instance.
    name: String,
    /// Ending of the names of what is in the unit of the channel: `_m`.
    unit: &'static str,
}

impl Element {
    fn of(message: &DynamicMessage) -> (Vec<i64>, Self) {
        let cells = TELLING.map(|field| {
            let field = message.descriptor().get_field_by_name(field)?;
            Some(cell(&field, message.get_field(&field).as_ref()))
        });
        let key = cells.iter().flatten().map(Cell::integer).collect();
        let [sensor, instance, channel] = cells.map(|cell| cell.map(|cell| cell.to_string()));
        let joined =
            |sign: &str, part: &Option<String>| part.as_ref().map_or_else(String::new, |p| format!("{sign}{p}"));
        let name = sensor.unwrap_or_default() + &joined("_", &instance) + &joined(".", &channel);
        (key, Self { name, unit: unit_of(channel.as_deref().unwrap_or_default()) })
    }

    /// Name of one of its columns.
    fn column(&self, field: &str) -> String {
        let unit = if ["innovation", "sigma", "gate"].contains(&field) { self.unit } else { "" };
        format!("{}.{field}{unit}", self.name)
    }
}

/// The unit of a channel of residuals, as names end by it: see `estimate.proto`.
fn unit_of(channel: &str) -> &'static str {
    match channel.split('_').next().unwrap_or_default() {
        "gyro" => "_radps",
        "accel" => "_mps2",
        "velocity" => "_mps",
        "heading" | "roll" | "pitch" | "yaw" => "_rad",
        "x" | "y" | "z" | "height" | "pressure" | "range" => "_m",
        _ => "",
    }
}

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Type {
    Flag,
    Integer,
    Double,
    Text,
    /// One of the names of an enumeration.
    Named,
}

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cell {
    Absent,
    Flag(bool),
    Signed(i64),
    Unsigned(u64),
    Single(f32),
    Double(f64),
    Text(String),
    Named(i32, String),
}

impl Cell {
    /// As a number; NaN where it is none.
    pub(super) fn number(&self) -> f64 {
        match self {
            Self::Flag(v) => f64::from(u8::from(*v)),
            Self::Signed(v) => *v as f64,
            Self::Unsigned(v) => *v as f64,
            Self::Single(v) => f64::from(*v),
            Self::Double(v) => *v,
            Self::Named(number, _) => f64::from(*number),
            Self::Absent | Self::Text(_) => f64::NAN,
        }
    }

    /// As a whole number.
    pub(super) fn integer(&self) -> i64 {
        match self {
            Self::Signed(v) => *v,
            Self::Unsigned(v) => *v as i64,
            other => other.number() as i64,
        }
    }
}

impl std::fmt::Display for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Absent => Ok(()),
            Self::Flag(v) => v.fmt(f),
            Self::Signed(v) => v.fmt(f),
            Self::Unsigned(v) => v.fmt(f),
            Self::Single(v) => v.fmt(f),
            Self::Double(v) => v.fmt(f),
            Self::Text(text) | Self::Named(_, text) => f.write_str(text),
        }
    }
}

/// Turns messages of one type into rows of cells.
#[derive(Debug, Clone)]
pub(super) struct Table {
    message: MessageDescriptor,
    columns: Vec<(FieldDescriptor, Column)>,
}

impl Table {
    /// The table for a channel; `None` when the file does not describe its messages, or they have too many fields.
    pub(super) fn of(channel: &Channel<'_>) -> Option<Self> {
        let schema = channel.schema.as_ref().filter(|s| s.encoding == "protobuf")?;
        let pool = DescriptorPool::decode(schema.data.as_ref()).ok()?;
        Self::of_message(pool.get_message_by_name(&schema.name)?)
    }

    /// The same with one row for each message: elements of its repeated messages that name a sensor have columns of their own, as soon
    /// as they are [measured](Self::measure); other repeated messages have none.
    pub(super) fn by_sensor(channel: &Channel<'_>) -> Option<Self> {
        let schema = channel.schema.as_ref().filter(|s| s.encoding == "protobuf")?;
        let pool = DescriptorPool::decode(schema.data.as_ref()).ok()?;
        let message = pool.get_message_by_name(&schema.name)?;
        let mut left = MAX_FIELDS;
        let mut found = Vec::new();
        for field in message.fields() {
            let (Kind::Message(inner), true) = (field.kind(), field.is_list()) else { continue };
            if inner.get_field_by_name("sensor").is_some() {
                let inner = columns(&inner, 1, &mut left)?.into_iter();
                let inner = inner.filter(|(field, _)| !TELLING.contains(&field.name())).collect();
                found.push((field, Column::BySensor { inner, found: BTreeMap::new() }));
            }
        }
        let own = columns(&message, 0, &mut left)?.into_iter();
        let columns = own.filter(|(field, _)| !(field.is_list() && matches!(field.kind(), Kind::Message(_))));
        Some(Self { message, columns: columns.chain(found).collect() })
    }

    /// Which of its columns belong to one sensor: a message without that sensor says nothing of them.
    pub(super) fn of_sensors(&self) -> Vec<bool> {
        let width = |(field, column): &(FieldDescriptor, Column)| {
            let mut names = Vec::new();
            header(&[(field.clone(), column.clone())], "", &mut names);
            std::iter::repeat_n(matches!(column, Column::BySensor { .. }), names.len())
        };
        self.columns.iter().flat_map(width).collect()
    }

    /// The table for messages of a kind as this build knows them; `None` where it does not describe them.
    pub(super) fn of_kind(kind: plumbline_proto::Kind) -> Option<Self> {
        static POOL: LazyLock<DescriptorPool> =
            LazyLock::new(|| DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap_or_default());
        POOL.get_message_by_name(kind.message_name()).and_then(Self::of_message)
    }

    fn of_message(message: MessageDescriptor) -> Option<Self> {
        let mut left = MAX_FIELDS;
        let columns = columns(&message, 0, &mut left)?;
        Some(Self { message, columns })
    }

    /// Is there a row per element of a repeated message?
    pub(super) fn has_rows(&self) -> bool {
        self.columns.iter().any(|(_, column)| matches!(column, Column::Rows(_)))
    }

    /// What the names of the repeated message's columns begin with.
    pub(super) fn rows_prefix(&self) -> Option<String> {
        let rows = self.columns.iter().find(|(_, column)| matches!(column, Column::Rows(_)));
        rows.map(|(field, _)| format!("{}.", field.name()))
    }

    /// Widens the columns of repeated numbers for this message.
    pub(super) fn measure(&mut self, payload: &[u8]) {
        if let Ok(message) = DynamicMessage::decode(self.message.clone(), payload) {
            measure(&mut self.columns, &message);
        }
    }

    /// Names of the columns.
    pub(super) fn header(&self) -> Vec<String> {
        let mut names = Vec::new();
        header(&self.columns, "", &mut names);
        names
    }

    /// What the columns hold.
    pub(super) fn types(&self) -> Vec<Type> {
        let mut types = Vec::new();
        kinds(&self.columns, &mut types);
        types
    }

    /// Names of the columns, of repeated numbers without their places.
    pub(super) fn fields(&self) -> Vec<String> {
        let mut names = Vec::new();
        fields(&self.columns, "", &mut names);
        names
    }

    /// The rows of one message; a message that cannot be decoded has none.
    pub(super) fn rows(&self, payload: &[u8]) -> Vec<Vec<Cell>> {
        let Some(rows) = self.read(payload) else { return Vec::new() };
        (0..rows.count()).map(|index| rows.row(index)).collect()
    }

    /// The rows of one message, made as they are asked for; `None` where it cannot be decoded.
    pub(super) fn read(&self, payload: &[u8]) -> Option<Rows<'_>> {
        Some(Rows { table: self, message: DynamicMessage::decode(self.message.clone(), payload).ok()? })
    }
}

/// See [`Table::read`].
pub(super) struct Rows<'a> {
    table: &'a Table,
    message: DynamicMessage,
}

impl Rows<'_> {
    /// How many there are, at least one.
    pub(super) fn count(&self) -> usize {
        let repeated = self.table.columns.iter().find(|(_, column)| matches!(column, Column::Rows(_)));
        repeated.map_or(1, |(field, _)| length(self.message.get_field(field).as_ref()).max(1))
    }

    /// One of them.
    pub(super) fn row(&self, index: usize) -> Vec<Cell> {
        let mut cells = Vec::new();
        row(&self.table.columns, Some(&self.message), index, &mut cells);
        cells
    }
}

fn length(value: &Value) -> usize {
    value.as_list().map_or(0, <[Value]>::len)
}

/// `None` where there are more than are `left`.
fn columns(message: &MessageDescriptor, depth: usize, left: &mut usize) -> Option<Vec<(FieldDescriptor, Column)>> {
    let mut rows_taken = depth > 0;
    let mut found = Vec::new();
    for field in message.fields() {
        *left = left.checked_sub(1)?;
        let column = match (field.kind(), field.is_list()) {
            _ if field.is_map() => continue,
            (Kind::Message(_), _) if depth >= MAX_DEPTH => continue,
            // One dimension of rows is a table; a second one is not.
            (Kind::Message(_), true) if rows_taken => continue,
            (Kind::Message(inner), true) => {
                rows_taken = true;
                Column::Rows(columns(&inner, depth + 1, left)?)
            }
            (Kind::Message(inner), false) => Column::Nested(columns(&inner, depth + 1, left)?),
            (_, true) => Column::List { width: 0 },
            (_, false) => Column::Scalar,
        };
        found.push((field, column));
    }
    Some(found)
}

fn measure(columns: &mut [(FieldDescriptor, Column)], message: &DynamicMessage) {
    for (field, column) in columns {
        match column {
            Column::Scalar => {}
            Column::List { width } => {
                *width = (*width).max(length(message.get_field(field).as_ref()).min(MAX_WIDTH));
            }
            Column::Nested(inner) => {
                if let Value::Message(nested) = message.get_field(field).as_ref() {
                    measure(inner, nested);
                }
            }
            Column::Rows(inner) => {
                for value in message.get_field(field).as_list().unwrap_or_default() {
                    if let Value::Message(nested) = value {
                        measure(inner, nested);
                    }
                }
            }
            Column::BySensor { inner, found } => {
                for value in message.get_field(field).as_list().unwrap_or_default() {
                    let Value::Message(nested) = value else { continue };
                    measure(inner, nested);
                    let (key, element) = Element::of(nested);
                    if found.len() < MAX_SENSORS {
                        found.entry(key).or_insert(element);
                    }
                }
            }
        }
    }
}

fn header(columns: &[(FieldDescriptor, Column)], prefix: &str, names: &mut Vec<String>) {
    for (field, column) in columns {
        let name = format!("{prefix}{}", field.name());
        match column {
            Column::Scalar => names.push(name),
            Column::List { width } => names.extend((0..*width).map(|i| format!("{name}[{i}]"))),
            Column::Nested(inner) | Column::Rows(inner) => header(inner, &format!("{name}."), names),
            Column::BySensor { inner, found } => by_sensor(inner, found, header, names),
        }
    }
}

fn fields(columns: &[(FieldDescriptor, Column)], prefix: &str, names: &mut Vec<String>) {
    for (field, column) in columns {
        let name = format!("{prefix}{}", field.name());
        match column {
            Column::Scalar | Column::List { .. } => names.push(name),
            Column::Nested(inner) | Column::Rows(inner) => fields(inner, &format!("{name}."), names),
            Column::BySensor { inner, found } => by_sensor(inner, found, fields, names),
        }
    }
}

/// Writes the names of columns behind what they begin with.
type Naming = fn(&[(FieldDescriptor, Column)], &str, &mut Vec<String>);

/// Names of the columns that each element has.
fn by_sensor(
    inner: &[(FieldDescriptor, Column)],
    found: &BTreeMap<Vec<i64>, Element>,
    name: Naming,
    names: &mut Vec<String>,
) {
    let mut own = Vec::new();
    name(inner, "", &mut own);
    names.extend(found.values().flat_map(|element| own.iter().map(|field| element.column(field))));
}

fn kinds(columns: &[(FieldDescriptor, Column)], types: &mut Vec<Type>) {
    for (field, column) in columns {
        let kind = match field.kind() {
            Kind::Bool => Type::Flag,
            Kind::Double | Kind::Float => Type::Double,
            Kind::String | Kind::Bytes | Kind::Message(_) => Type::Text,
            Kind::Enum(_) => Type::Named,
            _ => Type::Integer,
        };
        match column {
            Column::Scalar => types.push(kind),
            Column::List { width } => types.extend(std::iter::repeat_n(kind, *width)),
            Column::Nested(inner) | Column::Rows(inner) => kinds(inner, types),
            Column::BySensor { inner, found } => found.values().for_each(|_| kinds(inner, types)),
        }
    }
}

fn row(columns: &[(FieldDescriptor, Column)], message: Option<&DynamicMessage>, index: usize, cells: &mut Vec<Cell>) {
    for (field, column) in columns {
        // Without presence a missing field has its default; with presence it is absent.
        let present = message.filter(|m| !field.supports_presence() || m.has_field(field));
        match column {
            Column::Scalar => cells.push(present.map_or(Cell::Absent, |m| cell(field, m.get_field(field).as_ref()))),
            Column::List { width } => {
                let values = present.map(|m| m.get_field(field));
                let values = values.as_deref().and_then(Value::as_list).unwrap_or_default();
                cells.extend((0..*width).map(|i| values.get(i).map_or(Cell::Absent, |v| cell(field, v))));
            }
            Column::Nested(inner) => match present.map(|m| m.get_field(field)).as_deref() {
                Some(Value::Message(nested)) => row(inner, Some(nested), index, cells),
                _ => row(inner, None, index, cells),
            },
            Column::Rows(inner) => {
                let values = present.map(|m| m.get_field(field));
                match values.as_deref().and_then(Value::as_list).and_then(|values| values.get(index)) {
                    Some(Value::Message(nested)) => row(inner, Some(nested), index, cells),
                    _ => row(inner, None, index, cells),
                }
            }
            Column::BySensor { inner, found } => {
                let values = present.map(|m| m.get_field(field));
                let values = values.as_deref().and_then(Value::as_list).unwrap_or_default();
                let elements: BTreeMap<_, _> = values
                    .iter()
                    .filter_map(Value::as_message)
                    .map(|element| (Element::of(element).0, element))
                    .collect();
                found.keys().for_each(|key| row(inner, elements.get(key).copied(), index, cells));
            }
        }
    }
}

fn cell(field: &FieldDescriptor, value: &Value) -> Cell {
    match value {
        Value::Bool(v) => Cell::Flag(*v),
        Value::I32(v) => Cell::Signed((*v).into()),
        Value::I64(v) => Cell::Signed(*v),
        Value::U32(v) => Cell::Unsigned((*v).into()),
        Value::U64(v) => Cell::Unsigned(*v),
        Value::F32(v) => Cell::Single(*v),
        Value::F64(v) => Cell::Double(*v),
        Value::String(v) => Cell::Text(v.clone()),
        Value::Bytes(v) => Cell::Text(v.iter().map(|b| format!("{b:02x}")).collect()),
        Value::EnumNumber(number) => Cell::Named(
            *number,
            match field.kind() {
                Kind::Enum(names) => names.get_value(*number).map_or_else(
                    || number.to_string(),
                    |value| {
                        let prefix = shout(names.name());
                        value.name().strip_prefix(&prefix).unwrap_or(value.name()).to_ascii_lowercase()
                    },
                ),
                _ => number.to_string(),
            },
        ),
        Value::Message(_) | Value::List(_) | Value::Map(_) => Cell::Absent,
    }
}

/// `AttackKind` → `ATTACK_KIND_`.
fn shout(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.push(c.to_ascii_uppercase());
    }
    out.push('_');
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::{Message as _, v1};
    use std::{borrow::Cow, sync::Arc};

    fn table(message: &str) -> Table {
        described(format!("plumbline.v1.{message}"), FILE_DESCRIPTOR_SET).unwrap()
    }

    fn described(name: String, descriptors: &[u8]) -> Option<Table> {
        let schema = mcap::Schema { id: 1, name, encoding: "protobuf".into(), data: Cow::Borrowed(descriptors) };
        let channel = Channel {
            id: 1,
            topic: "/x".into(),
            schema: Some(Arc::new(schema)),
            message_encoding: "protobuf".into(),
            metadata: Default::default(),
        };
        Table::of(&channel)
    }

    #[test]
    fn fields_lists_enums_and_absence() {
        let mut table = table("Control");
        let message = v1::Control {
            time_us: 7,
            mode: v1::Mode::AltitudeHold as i32,
            setpoint: Some(v1::Setpoint { altitude_m: Some(0.8), ..Default::default() }),
            motor_command: vec![0.5, 0.25],
            ..Default::default()
        }
        .encode_to_vec();
        table.measure(&message);
        let header = table.header();
        let row = &table.rows(&message)[0];
        let get =
            |name: &str| row[header.iter().position(|h| h == name).unwrap_or_else(|| panic!("{name}"))].to_string();
        assert_eq!(header.len(), row.len());
        assert_eq!([get("time_us"), get("mode"), get("armed")], ["7", "altitude_hold", "false"]);
        assert_eq!([get("setpoint.altitude_m"), get("setpoint.x_m")], ["0.8", ""]);
        assert_eq!([get("motor_command[1]"), get("torque_flu_nm.x")], ["0.25", ""]);
        assert_eq!((table.types().len(), table.types()[0]), (header.len(), Type::Integer));
        assert!(table.fields().contains(&"motor_command".to_owned()));
    }

    #[test]
    fn a_repeated_message_is_a_row_each() {
        let table = table("Residuals");
        let residual = |instance| v1::Residual { instance, innovation: -0.5, ..Default::default() };
        let message = v1::Residuals { time_us: 3, residuals: vec![residual(1), residual(2)], ..Default::default() }
            .encode_to_vec();
        let rows = table.rows(&message);
        let instance = table.header().iter().position(|h| h == "residuals.instance").unwrap();
        assert!(table.has_rows());
        assert_eq!(rows.iter().map(|r| r[instance].to_string()).collect::<Vec<_>>(), ["1", "2"]);
        assert_eq!(rows[1][0].to_string(), "3", "the message's own fields repeat");
    }

    #[test]
    fn types_that_are_fields_of_themselves_many_times_have_no_table() {
        use prost_reflect::prost_types::field_descriptor_proto::{Label, Type};
        use prost_reflect::prost_types::{
            DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
        };
        let field = |number: i32| FieldDescriptorProto {
            name: Some(format!("f{number}")),
            number: Some(number),
            label: Some(Label::Optional as i32),
            r#type: Some(Type::Message as i32),
            type_name: Some(".x.Deep".into()),
            ..Default::default()
        };
        let of = |fields| {
            let deep = DescriptorProto {
                name: Some("Deep".into()),
                field: (1..=fields).map(field).collect(),
                ..Default::default()
            };
            let file = FileDescriptorProto {
                name: Some("x.proto".into()),
                package: Some("x".into()),
                message_type: vec![deep],
                syntax: Some("proto3".into()),
                ..Default::default()
            };
            described("x.Deep".into(), &FileDescriptorSet { file: vec![file] }.encode_to_vec())
        };
        assert!(of(2).is_some());
        assert!(of(12).is_none(), "three million columns");
    }
}

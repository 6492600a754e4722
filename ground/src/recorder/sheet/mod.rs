//! Samples of a flight as one table, and the files that hold such a table: CSV, Parquet, MATLAB.
//!
//! A row for each control tick, at most so many a second, with the latest of every sample topic beside it, and what
//! happened since the row before: events, and the attacks that are active. What the secure estimator and the supervisor say of
//! themselves is among the samples. Residuals, some hundred columns for each estimator, are there where they are asked for by name.

mod mat;
mod parquet;
mod text;

use std::collections::BTreeMap;

use mcap::McapResult;
use plumbline_proto::{Kind, Message as _, v1};

use super::RecordingError;
use super::export::{Sink, Whole, damaged};
use super::flatten::{Cell, Table, Type};
use super::reader::FlightReader;
use crate::names::JsonName as _;

/// What of a flight is asked for, and as what.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// From there on, s since the start of the flight.
    pub from_s: f64,
    /// Until there, s.
    pub to_s: f64,
    /// Columns by name, or by the beginning of it up to a dot; all but residuals where there are none.
    pub columns: Vec<String>,
    /// At most so many rows a second; 0 for every control tick.
    pub rate_hz: f64,
}

impl Default for Selection {
    fn default() -> Self {
        Self { from_s: 0.0, to_s: f64::INFINITY, columns: Vec::new(), rate_hz: 100.0 }
    }
}

impl Selection {
    /// Its range as flight times, µs.
    ///
    /// # Errors
    /// It is none.
    pub(super) fn range_us(&self, reader: &FlightReader) -> Result<(u64, u64), RecordingError> {
        let Self { from_s, to_s, .. } = self;
        if !from_s.is_finite() || *from_s < 0.0 || to_s.is_nan() || to_s <= from_s {
            return Err(RecordingError::Invalid(format!("from_s {from_s} to to_s {to_s} is no range of time")));
        }
        let at = |seconds: f64| reader.start_us().saturating_add((seconds * 1e6).min(u64::MAX as f64) as u64);
        Ok((at(*from_s), at(*to_s)))
    }
}

/// What a table is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated text.
    Csv,
    /// Parquet: typed, compressed, absent values are null, units in the metadata.
    Parquet,
    /// MATLAB 5: `data` (a row for each column of the table), `names`, `units`, `event_time_s`, `event_text`.
    Mat,
    /// No table but a ROS 2 bag: see `ros2.rs`.
    Ros2,
    /// No table but its messages with a scene beside them: see `foxglove.rs`.
    Foxglove,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 5] = [Self::Csv, Self::Parquet, Self::Mat, Self::Ros2, Self::Foxglove];

    /// Ending of a file.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Ros2 => "ros2.mcap",
            Self::Foxglove => "foxglove.mcap",
            other => other.name(),
        }
    }

    /// Name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
            Self::Mat => "mat",
            Self::Ros2 => "ros2",
            Self::Foxglove => "foxglove",
        }
    }

    /// What writes it, where it is no table.
    pub(super) fn whole(self) -> Option<Whole> {
        match self {
            Self::Csv | Self::Parquet | Self::Mat => None,
            Self::Ros2 => Some(super::ros2::write),
            Self::Foxglove => Some(super::foxglove::write),
        }
    }
}

/// Head of a column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) name: String,
    pub(super) kind: Type,
}

impl Head {
    /// Unit, as the name says it; empty for none.
    pub(super) fn unit(&self) -> &'static str {
        const UNITS: [(&str, &str); 21] = [
            ("_mm", "mm"),
            ("_ms", "ms"),
            ("_radps", "rad/s"),
            ("_rad", "rad"),
            ("_mps2", "m/s²"),
            ("_mps", "m/s"),
            ("_nm", "N m"),
            ("_hz", "Hz"),
            ("_us", "µs"),
            ("_ut", "µT"),
            ("_pa", "Pa"),
            ("_m2", "m²"),
            ("_s", "s"),
            ("_m", "m"),
            ("_n", "N"),
            ("_v", "V"),
            ("_a", "A"),
            ("_c", "°C"),
            ("_deg", "°"),
            ("_kg", "kg"),
            ("_percent", "%"),
        ];
        let field =
            |part: &&str| UNITS.iter().any(|(suffix, _)| part.split('[').next().unwrap_or(part).ends_with(suffix));
        // The component of a vector has the vector's unit.
        let Some(part) = self.name.rsplit('.').find(field) else { return "" };
        let part = part.split('[').next().unwrap_or(part);
        UNITS.iter().find(|(suffix, _)| part.ends_with(suffix)).map_or("", |(_, unit)| unit)
    }
}

/// Where rows go.
trait Sheet {
    /// `false` where nobody listens any more, as everywhere here.
    fn row(&mut self, cells: &[Cell]) -> McapResult<bool>;
    fn end(&mut self) -> McapResult<()>;
}

/// Is this column asked for?
fn chosen(columns: &[String], name: &str) -> bool {
    let rest = |wanted: &String| name.strip_prefix(wanted.as_str()).map(str::to_owned);
    columns.is_empty() || columns.iter().filter_map(rest).any(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Columns that are in no message.
const ATTACKS: [(&str, Type); 2] = [("attacks.active", Type::Integer), ("attacks.what", Type::Text)];
const EVENTS: (&str, Type) = ("events", Type::Text);

#[derive(Clone)]
struct Part {
    topic: String,
    prefix: String,
    table: Table,
    latest: Latest,
    /// Which of its columns are wanted.
    wanted: Vec<bool>,
}

/// What a topic said last.
#[derive(Clone)]
enum Latest {
    /// Its message, decoded where there is a row.
    Message(Option<Vec<u8>>),
    /// The cells of several messages, as not each names every sensor; which are so.
    Cells(Vec<Cell>, Vec<bool>),
}

impl Part {
    /// Its names of columns tell sensors apart, which messages name.
    fn by_sensor(kind: Kind) -> bool {
        matches!(kind, Kind::Residuals | Kind::Secure | Kind::Status)
    }

    /// Has it any columns where nothing is asked for by name?
    fn unasked(&self) -> bool {
        Kind::from_topic(&self.topic).is_none_or(|(kind, _)| kind != Kind::Residuals)
    }

    fn take(&mut self, payload: &[u8]) {
        match &mut self.latest {
            Latest::Message(latest) => {
                let latest = latest.get_or_insert_default();
                latest.clear();
                latest.extend_from_slice(payload);
            }
            Latest::Cells(cells, of_sensors) => {
                let Some(row) = self.table.rows(payload).into_iter().next() else { return };
                for ((held, new), of_sensor) in cells.iter_mut().zip(row).zip(of_sensors.iter()) {
                    if !of_sensor || new != Cell::Absent {
                        *held = new;
                    }
                }
            }
        }
    }

    /// The cells that are wanted.
    fn cells(&self) -> Vec<Cell> {
        let row = match &self.latest {
            Latest::Message(latest) => latest.as_ref().and_then(|latest| self.table.rows(latest).into_iter().next()),
            Latest::Cells(cells, _) => Some(cells.clone()),
        };
        let row = row.unwrap_or_else(|| vec![Cell::Absent; self.wanted.len()]);
        row.into_iter().zip(&self.wanted).filter_map(|(cell, wanted)| wanted.then_some(cell)).collect()
    }
}

/// A table that is known to be possible.
#[derive(Clone)]
pub(super) struct Wide {
    parts: Vec<Part>,
    selection: Selection,
    /// Flight time of its range, µs.
    range_us: (u64, u64),
}

impl Wide {
    /// Looks for the columns asked for.
    ///
    /// # Errors
    /// No `/control`; a column that is not there; a range or rate that is none.
    pub(super) fn new(reader: &FlightReader, selection: Selection) -> Result<Self, RecordingError> {
        let Selection { rate_hz, .. } = selection;
        let range_us = selection.range_us(reader)?;
        if !rate_hz.is_finite() || !(0.0..=1e4).contains(&rate_hz) {
            return Err(RecordingError::Invalid(format!("rate_hz {rate_hz} is outside 0 (every tick) to 10000")));
        }
        let control = Kind::Control.base_topic();
        let sampled = |topic: &str| Kind::from_topic(topic).is_some_and(|(kind, _)| kind.has_columns());
        let channels = reader.channels();
        if !channels.contains_key(control) {
            return Err(RecordingError::NoTopic(control.to_owned()));
        }
        let part = |channel: &mcap::Channel<'static>| {
            let (topic, prefix) = (channel.topic.clone(), Kind::column_prefix(&channel.topic));
            let by_sensor = Kind::from_topic(&topic).is_some_and(|(kind, _)| Part::by_sensor(kind));
            let (table, latest) = if by_sensor {
                (Table::by_sensor(channel)?, Latest::Cells(Vec::new(), Vec::new()))
            } else {
                (Table::of(channel)?, Latest::Message(None))
            };
            Some(Part { topic, prefix, table, latest, wanted: Vec::new() })
        };
        let mut parts: Vec<Part> = channels
            .values()
            .filter(|c| sampled(&c.topic))
            .filter_map(|c| part(c))
            .filter(|p| !p.table.has_rows())
            .collect();
        // Control first, then by topic.
        parts.sort_by_key(|part| (part.topic != control, part.topic.clone()));
        // Which sensors are named is known by their messages alone.
        let below = |part: &&Part| selection.columns.iter().any(|w| w.starts_with(&format!("{}.", part.prefix)));
        let named = |part: &&Part| matches!(part.latest, Latest::Cells(..)) && below(part);
        let topics: Vec<String> = parts.iter().filter(named).map(|part| part.topic.clone()).collect();
        let looked = reader.for_each_in(Some(&topics), range_us, |message| {
            if let Some(part) = parts.iter_mut().find(|part| part.topic == message.channel.topic) {
                part.table.measure(message.payload);
            }
            Ok(true)
        });
        looked.map_err(damaged)?;
        let fields = |part: &Part| {
            part.table.fields().into_iter().map(|name| format!("{}.{name}", part.prefix)).collect::<Vec<_>>()
        };
        let mut known: Vec<String> = parts.iter().flat_map(fields).collect();
        known.extend(parts.iter().map(|part| part.prefix.clone()));
        known.extend(ATTACKS.iter().chain([&EVENTS]).map(|(name, _)| (*name).to_owned()));
        for wanted in &selection.columns {
            let bare = wanted.split('[').next().unwrap_or(wanted);
            let holds =
                |name: &String| name == bare || name.strip_prefix(bare).is_some_and(|rest| rest.starts_with('.'));
            if !known.iter().any(holds) {
                let text = format!("column {:?}: the flight has none of that name", crate::names::clip(wanted));
                return Err(RecordingError::Invalid(text));
            }
        }
        // What nothing is wanted of need not be read; control says when there is a row.
        let any = |part: &Part| {
            selection.columns.contains(&part.prefix)
                || fields(part).iter().any(|name| {
                    selection
                        .columns
                        .iter()
                        .any(|w| chosen(std::slice::from_ref(w), name) || w.split('[').next() == Some(name))
                })
        };
        let unnamed = selection.columns.is_empty();
        parts.retain(|part| part.topic == control || if unnamed { part.unasked() } else { any(part) });
        Ok(Self { parts, selection, range_us })
    }

    /// Writes the table.
    ///
    /// # Errors
    /// The file is damaged, or too large for the format.
    pub(super) fn write(mut self, reader: &FlightReader, format: Format, sink: &mut Sink<'_>) -> McapResult<()> {
        let topics: Vec<String> = self.parts.iter().map(|part| part.topic.clone()).collect();
        let mut rows = 0_u64;
        let mut due = Due::new(&self);
        let (from, to) = self.range_us;
        reader.for_each(Some(&topics), |message| {
            if (from..=to).contains(&message.time_us)
                && let Some(part) = self.parts.iter_mut().find(|part| part.topic == message.channel.topic)
            {
                part.table.measure(message.payload);
            }
            rows += u64::from(due.row(&message.channel.topic, message.time_us));
            Ok(message.time_us <= to)
        })?;
        let heads = self.heads();
        let events = if format == Format::Mat { self.events(reader)? } else { Vec::new() };
        let mut sheet: Box<dyn Sheet + '_> = match format {
            Format::Csv => Box::new(text::Csv::new(sink, &heads)?),
            Format::Parquet => Box::new(parquet::Parquet::new(sink, heads)),
            Format::Mat => Box::new(mat::Mat::new(sink, &heads, rows, &events)?),
            Format::Ros2 | Format::Foxglove => {
                return format.whole().map_or(Ok(()), |whole| whole(reader, self.range_us, sink));
            }
        };
        if self.rows(reader, sheet.as_mut())? { sheet.end() } else { Ok(()) }
    }

    /// Settles which columns there are.
    fn heads(&mut self) -> Vec<Head> {
        let mut heads = vec![Head { name: "time_s".into(), kind: Type::Double }];
        for part in &mut self.parts {
            let named = |(name, kind)| Head { name: format!("{}.{name}", part.prefix), kind };
            let all: Vec<Head> = part.table.header().into_iter().zip(part.table.types()).map(named).collect();
            part.wanted = all.iter().map(|head| chosen(&self.selection.columns, &head.name)).collect();
            if let Latest::Cells(cells, of_sensors) = &mut part.latest {
                (*cells, *of_sensors) = (vec![Cell::Absent; all.len()], part.table.of_sensors());
            }
            heads.extend(all.into_iter().zip(&part.wanted).filter_map(|(head, wanted)| wanted.then_some(head)));
        }
        let more = ATTACKS.iter().chain([&EVENTS]).filter(|(name, _)| chosen(&self.selection.columns, name));
        heads.extend(more.map(|(name, kind)| Head { name: (*name).into(), kind: *kind }));
        heads
    }

    fn rows(&mut self, reader: &FlightReader, sheet: &mut dyn Sheet) -> McapResult<bool> {
        let extra: Vec<bool> =
            ATTACKS.iter().chain([&EVENTS]).map(|(name, _)| chosen(&self.selection.columns, name)).collect();
        let mut topics: Vec<String> = self.parts.iter().map(|part| part.topic.clone()).collect();
        if extra.contains(&true) {
            topics.extend([Kind::Event, Kind::Attacks].map(|kind| kind.base_topic().to_owned()));
        }
        let mut due = Due::new(self);
        let (start, to) = (reader.start_us(), self.range_us.1);
        let mut happened = Happened::default();
        let mut listening = true;
        reader.for_each(Some(&topics), |message| {
            if message.time_us > to {
                return Ok(false);
            }
            happened.observe(&message.channel.topic, message.payload);
            let Some(part) = self.parts.iter_mut().find(|part| part.topic == message.channel.topic) else {
                return Ok(true);
            };
            part.take(message.payload);
            if !due.row(&message.channel.topic, message.time_us) {
                return Ok(true);
            }
            let mut cells = vec![Cell::Double(message.time_us.saturating_sub(start) as f64 * 1e-6)];
            self.parts.iter().for_each(|part| cells.extend(part.cells()));
            let more = happened.take();
            cells.extend(more.into_iter().zip(&extra).filter_map(|(cell, wanted)| wanted.then_some(cell)));
            listening = sheet.row(&cells)?;
            Ok(listening)
        })?;
        Ok(listening)
    }

    /// Events of the range: time since the start of the flight, s, and text.
    fn events(&self, reader: &FlightReader) -> McapResult<Vec<(f64, String)>> {
        let mut events = Vec::new();
        let (from, to) = self.range_us;
        reader.for_each(Some(&[Kind::Event.base_topic().to_owned()]), |message| {
            if (from..=to).contains(&message.time_us)
                && let Ok(event) = v1::Event::decode(message.payload)
            {
                events.push((message.time_us.saturating_sub(reader.start_us()) as f64 * 1e-6, told(&event)));
            }
            Ok(message.time_us <= to)
        })?;
        Ok(events)
    }
}

/// When there is a row.
struct Due {
    range_us: (u64, u64),
    period_us: f64,
    last: Option<u64>,
}

impl Due {
    fn new(wide: &Wide) -> Self {
        let period_us = if wide.selection.rate_hz > 0.0 { 1e6 / wide.selection.rate_hz } else { 0.0 };
        Self { range_us: wide.range_us, period_us, last: None }
    }

    fn row(&mut self, topic: &str, time_us: u64) -> bool {
        if topic != Kind::Control.base_topic() || !(self.range_us.0..=self.range_us.1).contains(&time_us) {
            return false;
        }
        let bin = if self.period_us > 0.0 { (time_us as f64 / self.period_us) as u64 } else { time_us };
        self.last.replace(bin) != Some(bin)
    }
}

fn told(event: &v1::Event) -> String {
    format!("{}: {}", event.kind, event.text)
}

/// What happened since the last row.
#[derive(Default)]
struct Happened {
    events: Vec<String>,
    attacks: BTreeMap<u32, String>,
}

impl Happened {
    fn observe(&mut self, topic: &str, payload: &[u8]) {
        match Kind::from_topic(topic) {
            Some((Kind::Event, _)) => self.events.extend(v1::Event::decode(payload).map(|event| told(&event))),
            Some((Kind::Attacks, _)) => {
                let Ok(state) = v1::AttackState::decode(payload) else { return };
                let active = state.attacks.into_iter().filter(|a| a.phase == v1::AttackPhase::Active as i32);
                self.attacks = active.filter_map(|progress| progress.attack).map(|a| (a.id, attack(&a))).collect();
            }
            _ => {}
        }
    }

    fn take(&mut self) -> [Cell; 3] {
        let text = |all: Vec<String>| if all.is_empty() { Cell::Absent } else { Cell::Text(all.join("; ")) };
        let active = Cell::Unsigned(self.attacks.len() as u64);
        [active, text(self.attacks.values().cloned().collect()), text(std::mem::take(&mut self.events))]
    }
}

fn attack(attack: &v1::Attack) -> String {
    let (sensor, kind) = (v1::SensorKind::json_name_of(attack.sensor), v1::AttackKind::json_name_of(attack.kind));
    format!(
        "{sensor} {} {} {kind} {}",
        attack.instance,
        v1::AttackChannel::json_name_of(attack.channel),
        attack.magnitude
    )
}

/// Output gathered into pieces.
struct Pieces<'s, 'f> {
    sink: &'s mut Sink<'f>,
    waiting: Vec<u8>,
}

impl<'s, 'f> Pieces<'s, 'f> {
    /// Size of one piece, about.
    const PIECE: usize = 64 << 10;

    fn new(sink: &'s mut Sink<'f>) -> Self {
        Self { sink, waiting: Vec::with_capacity(Self::PIECE) }
    }

    fn put(&mut self, bytes: &[u8]) -> bool {
        self.waiting.extend_from_slice(bytes);
        self.waiting.len() < Self::PIECE || self.send()
    }

    fn send(&mut self) -> bool {
        if self.waiting.is_empty() {
            return true;
        }
        (self.sink)(std::mem::replace(&mut self.waiting, Vec::with_capacity(Self::PIECE)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_chosen_by_name_or_by_its_beginning() {
        let columns = ["control.thrust_n".to_owned(), "height_2".into(), "control.motor_command[1]".into()];
        for yes in ["control.thrust_n", "height_2.sensed_m", "control.motor_command[1]"] {
            assert!(chosen(&columns, yes), "{yes}");
        }
        for no in ["control.thrust_n2", "height_20.sensed_m", "control.motor_command[11]", "control.motor_command[0]"] {
            assert!(!chosen(&columns, no), "{no}");
        }
        assert!(chosen(&[], "anything"));
    }

    #[test]
    fn units_are_those_that_names_say() {
        let unit = |name: &str| Head { name: name.into(), kind: Type::Double }.unit();
        assert_eq!(unit("estimate_1.position_enu_m.z"), "m");
        assert_eq!(unit("imu_1.gyro_radps.x"), "rad/s");
        assert_eq!(unit("control.motor_command[1]"), "");
        assert_eq!(unit("time_s"), "s");
        assert_eq!([unit("imu_1.temperature_c"), unit("barometer_2.temperature_c")], ["°C"; 2]);
        assert_eq!([unit("gnss_1.latitude_deg"), unit("control.loss_percent")], ["°", "%"]);
    }
}

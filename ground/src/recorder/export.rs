//! Flights in other forms: tables, the messages of one topic, and the codec batch that the page replays.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use mcap::write::NoSeek;
use mcap::{McapResult, WriteOptions};
use plumbline_proto::Kind;
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::thinning::{COLUMNS, Thinner};
use plumbline_rest::flight::{OVERVIEW_COLUMNS, OVERVIEW_KINDS};

use super::RecordingError;
use super::flatten::Table;
use super::overview::Overview;
use super::reader::FlightReader;
use super::sheet::{Format, Selection, Wide};
use super::snapshot::Snapshot;

/// Takes the output piece by piece; `false` ends the export (the client is gone).
pub type Sink<'a> = dyn FnMut(Vec<u8>) -> bool + 'a;

/// What writes exports: their ETags hold for this program, and for this number of what it writes, to be raised with every
/// change of it.
pub const WRITTEN: &str = concat!(env!("CARGO_PKG_VERSION"), " 4");

/// Size of one piece of output, bytes, about.
const PIECE: usize = 64 << 10;

/// What charts show of a flight of this length is kept, s: shorter ones are read in a tenth of a second.
const OVERVIEW_FROM_S: f64 = 120.0;

/// Writes the messages that lie between two flight times, µs.
pub(super) type Whole = fn(&FlightReader, (u64, u64), &mut Sink<'_>) -> McapResult<()>;

enum Form {
    Wide(Wide, Format),
    Whole(Whole, (u64, u64)),
    Topic(String),
    Frames(Frames),
}

/// Which messages are written as a batch.
struct Frames {
    topics: Option<Vec<String>>,
    range_us: (u64, u64),
    /// Stretches of time, where not every message is wanted.
    columns: Option<u64>,
    /// Where that is kept.
    overview: Option<Overview>,
}

/// An export that is known to be possible.
pub struct Export {
    reader: FlightReader,
    form: Form,
}

impl Export {
    /// Samples as one table, see [`Selection`], or as a bag.
    ///
    /// # Errors
    /// [`RecordingError`] when the flight cannot be read, has no `/control`, or not what is selected.
    pub fn wide(flight: Snapshot, selection: Selection, format: Format) -> Result<Self, RecordingError> {
        let reader = open(flight)?;
        if let Some(whole) = format.whole() {
            let Selection { from_s, to_s, .. } = selection;
            if selection != (Selection { from_s, to_s, ..Selection::default() }) {
                let text = format!("{} has no columns and no rate: from_s and to_s only", format.name());
                return Err(RecordingError::Invalid(text));
            }
            let range_us = selection.range_us(&reader)?;
            return Ok(Self { reader, form: Form::Whole(whole, range_us) });
        }
        let wide = Wide::new(&reader, selection)?;
        Ok(Self { reader, form: Form::Wide(wide, format) })
    }

    /// Every message of one topic.
    ///
    /// # Errors
    /// [`RecordingError`] when the flight cannot be read or has no such topic.
    pub fn topic(flight: Snapshot, topic: &str) -> Result<Self, RecordingError> {
        let reader = open(flight)?;
        match reader.channels().get(topic).and_then(|channel| Table::of(channel)) {
            Some(_) => Ok(Self { reader, form: Form::Topic(topic.to_owned()) }),
            None => Err(RecordingError::NoTopic(crate::names::clip(topic))),
        }
    }

    /// The messages of some kinds (all when `None`) in a range of time as one codec batch: all in the order of time, or
    /// what charts of so many columns show of them (see [`Thinner`]), each topic in the order of time.
    /// Kinds are named by the last part of their topic: `estimate`, `imu`, `step`.
    ///
    /// # Errors
    /// [`RecordingError`] when the flight cannot be read, or a kind, the range or the number of columns is none.
    pub fn frames(
        mut flight: Snapshot,
        kinds: Option<&str>,
        (from_s, to_s): (f64, f64),
        columns: Option<u64>,
    ) -> Result<Self, RecordingError> {
        if let Some(columns) = columns.filter(|columns| !COLUMNS.contains(columns)) {
            let (least, most) = COLUMNS.into_inner();
            return Err(RecordingError::Invalid(format!("columns {columns} is outside {least} to {most}")));
        }
        let selection = Selection { from_s, to_s, ..Selection::default() };
        let overview = flight.overview.take();
        let reader = open(flight)?;
        let range_us = selection.range_us(&reader)?;
        let length_s = reader.end_us().saturating_sub(reader.start_us()) as f64 * 1e-6;
        let asked = selection == Selection::default()
            && (kinds, columns) == (Some(OVERVIEW_KINDS), Some(OVERVIEW_COLUMNS))
            && length_s >= OVERVIEW_FROM_S;
        let overview = overview.filter(|_| asked);
        let topics = match kinds {
            None => None,
            Some(names) => {
                let kinds = names.split(',').map(kind_of_name).collect::<Result<Vec<_>, _>>()?;
                let wanted = |topic: &String| Kind::from_topic(topic).is_some_and(|(kind, _)| kinds.contains(&kind));
                Some(reader.channels().into_keys().filter(wanted).collect())
            }
        };
        Ok(Self { reader, form: Form::Frames(Frames { topics, range_us, columns, overview }) })
    }

    /// What charts show of a flight as a whole.
    ///
    /// # Errors
    /// [`RecordingError`] when the flight cannot be read.
    pub(super) fn overview(flight: Snapshot) -> Result<Self, RecordingError> {
        Self::frames(flight, Some(OVERVIEW_KINDS), (0.0, f64::INFINITY), Some(OVERVIEW_COLUMNS))
    }

    /// Is what it writes kept?
    pub(super) fn is_kept(&self) -> bool {
        matches!(&self.form, Form::Frames(Frames { overview: Some(_), .. }))
    }

    /// Writes the export; the same again each time.
    ///
    /// # Errors
    /// [`RecordingError`] when the file turns out to be damaged.
    pub fn write(&self, sink: &mut Sink<'_>) -> Result<(), RecordingError> {
        let written = match &self.form {
            Form::Wide(wide, format) => wide.clone().write(&self.reader, *format, sink),
            Form::Whole(whole, range_us) => whole(&self.reader, *range_us, sink),
            Form::Topic(topic) => write_topic(&self.reader, topic, sink),
            Form::Frames(frames) => write_kept(&self.reader, frames, sink),
        };
        written.map_err(damaged)
    }
}

pub(super) fn open(flight: Snapshot) -> Result<FlightReader, RecordingError> {
    FlightReader::open(flight).map_err(damaged)
}

pub(super) fn damaged(error: mcap::McapError) -> RecordingError {
    RecordingError::Damaged { path: PathBuf::from("flight file"), reason: error.to_string() }
}

fn kind_of_name(name: &str) -> Result<Kind, RecordingError> {
    let known = Kind::ALL.iter().find(|kind| kind.base_topic().rsplit('/').next() == Some(name));
    known.copied().ok_or_else(|| RecordingError::Invalid(format!("kind {:?} is not known", crate::names::clip(name))))
}

/// Where a writer's bytes go.
pub(super) struct Onward<'s, 'f>(&'s mut Sink<'f>);

impl Write for Onward<'_, '_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if (self.0)(bytes.to_vec()) { Ok(bytes.len()) } else { Err(std::io::ErrorKind::BrokenPipe.into()) }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// An MCAP file that is written from front to back.
pub(super) fn mcap_into<'s, 'f>(
    profile: &str,
    sink: &'s mut Sink<'f>,
) -> McapResult<mcap::Writer<NoSeek<BufWriter<Onward<'s, 'f>>>>> {
    let options = WriteOptions::new()
        .profile(profile)
        .library(concat!("plumbline-ground/", env!("CARGO_PKG_VERSION")))
        .compression(Some(mcap::Compression::Zstd))
        .compression_threads(0)
        .disable_seeking(true);
    options.create(NoSeek::new(BufWriter::with_capacity(PIECE, Onward(sink))))
}

/// CSV rows gathered into pieces.
struct Pieces<'s, 'f> {
    csv: csv::Writer<Vec<u8>>,
    sink: &'s mut Sink<'f>,
}

impl<'s, 'f> Pieces<'s, 'f> {
    fn new(sink: &'s mut Sink<'f>) -> Self {
        Self { csv: csv::WriterBuilder::new().buffer_capacity(PIECE).from_writer(Vec::new()), sink }
    }

    fn row<'r>(&mut self, cells: impl IntoIterator<Item = &'r str>) -> McapResult<bool> {
        self.csv.write_record(cells).map_err(|e| mcap::McapError::Io(e.into()))?;
        if self.csv.get_ref().len() < PIECE { Ok(true) } else { self.send() }
    }

    fn send(&mut self) -> McapResult<bool> {
        self.csv.flush()?;
        let full = std::mem::replace(&mut self.csv, csv::WriterBuilder::new().from_writer(Vec::new()));
        let bytes = full.into_inner().map_err(|e| mcap::McapError::Io(std::io::Error::other(e.to_string())))?;
        Ok(bytes.is_empty() || (self.sink)(bytes))
    }
}

fn seconds(time_us: u64, start_us: u64) -> String {
    format!("{:.6}", time_us.saturating_sub(start_us) as f64 * 1e-6)
}

fn write_topic(reader: &FlightReader, topic: &str, sink: &mut Sink<'_>) -> McapResult<()> {
    let topics = [topic.to_owned()];
    let Some(mut table) = reader.channels().get(topic).and_then(|channel| Table::of(channel)) else { return Ok(()) };
    reader.for_each(Some(&topics), |message| {
        table.measure(message.payload);
        Ok(true)
    })?;
    let header = table.header();
    let mut out = Pieces::new(sink);
    out.row(["time_s", "sequence"].into_iter().chain(header.iter().map(String::as_str)))?;
    let start_us = reader.start_us();
    reader.for_each(Some(&topics), |message| {
        let (time, sequence) = (seconds(message.time_us, start_us), message.sequence.to_string());
        for row in table.rows(message.payload) {
            let row: Vec<String> = row.iter().map(ToString::to_string).collect();
            let cells = [time.as_str(), sequence.as_str()].into_iter().chain(row.iter().map(String::as_str));
            if !out.row(cells)? {
                return Ok(false);
            }
        }
        Ok(true)
    })?;
    out.send().map(|_| ())
}

/// Writes what is kept; what is not, and is to be, is kept once it is whole.
fn write_kept(reader: &FlightReader, frames: &Frames, sink: &mut Sink<'_>) -> McapResult<()> {
    let Some(overview) = &frames.overview else { return write_frames(reader, frames, sink) };
    if let Some(batch) = overview.kept() {
        batch.chunks(PIECE).all(|piece| sink(piece.to_vec()));
        return Ok(());
    }
    let (mut batch, mut whole) = (Vec::new(), true);
    write_frames(reader, frames, &mut |piece: Vec<u8>| {
        batch.extend_from_slice(&piece);
        whole = sink(piece);
        whole
    })?;
    if whole {
        overview.keep(&batch);
    }
    Ok(())
}

fn write_frames(reader: &FlightReader, frames: &Frames, sink: &mut Sink<'_>) -> McapResult<()> {
    let (from_us, to_us) = frames.range_us;
    let span_us = to_us.min(reader.end_us()).saturating_sub(from_us);
    let mut thinner = frames.columns.map(|columns| Thinner::new(span_us, columns));
    let mut batch = Vec::with_capacity(PIECE + 4096);
    codec::begin_batch(&mut batch);
    reader.for_each_in(frames.topics.as_deref(), frames.range_us, |message| {
        let (kind, instance) = match Kind::from_topic(&message.channel.topic) {
            Some((kind, instance)) => (kind.to_wire(), instance),
            None => match unknown(&message.channel.topic) {
                Some(number) => number,
                None => return Ok(true),
            },
        };
        let (sequence, time_us, payload) = (message.sequence, message.time_us, message.payload);
        let frame = Frame { kind, instance, sequence, time_us, payload };
        match &mut thinner {
            Some(thinner) => thinner.take(&frame, &mut batch),
            None => frame.encode(&mut batch),
        }
        Ok(if batch.len() >= PIECE { sink(std::mem::take(&mut batch)) } else { true })
    })?;
    if let Some(thinner) = thinner {
        thinner.finish(&mut batch);
    }
    if !batch.is_empty() {
        sink(batch);
    }
    Ok(())
}

/// Kind and instance of `/unknown/K/I`.
fn unknown(topic: &str) -> Option<(u16, u16)> {
    let (kind, instance) = topic.strip_prefix("/unknown/")?.split_once('/')?;
    Some((kind.parse().ok()?, instance.parse().ok()?))
}

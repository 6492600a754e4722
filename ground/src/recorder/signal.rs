//! One number of one topic over time, named as in tables. The rows of a message (residuals, sensors of the secure
//! estimator) are told apart by the names and numbers they carry: `residuals_1[height 2 altitude].innovation`.

pub(crate) mod live;

use std::collections::BTreeSet;

use mcap::McapResult;
use plumbline_proto::{Kind, Message as _, v1};
use plumbline_rest::flight::Signal;

use super::export::{damaged, open};
use super::flatten::{Cell, Table, Type};
use super::reader::FlightReader;
use super::sheet::Head;
use super::{RecordingError, Selection, Snapshot};

/// What a topic holds is seen in so long from its first message, µs.
const LOOK_US: u64 = 500_000;
/// A topic that has not begun by then, since the start of the flight, is not listed, µs.
const LOOK_UNTIL_US: u64 = 10_000_000;

/// A rotor that is slower stands, or runs out, rad/s.
const TURNING_RADPS: f64 = 50.0;

/// A flight whose signals are asked for.
pub(crate) struct SignalReader(FlightReader);

/// A topic with its columns.
struct Topic {
    topic: String,
    prefix: String,
    table: Table,
    begun_us: Option<u64>,
    /// Which rows its messages have.
    rows: BTreeSet<String>,
}

/// Where in a topic's messages a signal is.
struct Place {
    column: usize,
    row: Option<String>,
}

/// A signal, read from one message after another.
struct Reading {
    place: Place,
    /// Places of the columns that tell rows apart.
    keys: Vec<usize>,
    /// Rows mostly come in the same order: it is looked for where it was last.
    last: usize,
}

impl Reading {
    fn new(topic: &Topic, place: Place) -> Self {
        Self { place, keys: topic.keys(), last: 0 }
    }

    /// What a message says of it; `None` where that is no finite number.
    fn value(&mut self, table: &Table, payload: &[u8]) -> Option<f64> {
        let rows = table.read(payload)?;
        let count = rows.count();
        let mut all = (0..count).map(|k| (self.last + k) % count).map(|index| (index, rows.row(index)));
        let named = |row: &[Cell]| self.place.row.as_ref().is_none_or(|wanted| row_name(row, &self.keys) == *wanted);
        let (index, row) = all.find(|(_, row)| named(row))?;
        self.last = index;
        row.get(self.place.column).map(Cell::number).filter(|value| value.is_finite())
    }
}

/// The rotors' mean speed while they turn.
#[derive(Default)]
struct Rotors {
    sum_radps: f64,
    count: u64,
}

impl Rotors {
    fn take(&mut self, truth: &[u8]) {
        let speeds = v1::Truth::decode(truth).unwrap_or_default().rotor_speed_radps;
        for radps in speeds.into_iter().filter(|radps| *radps > TURNING_RADPS) {
            self.sum_radps += radps;
            self.count += 1;
        }
    }

    fn mean_hz(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum_radps / self.count as f64 / std::f64::consts::TAU)
    }
}

impl SignalReader {
    /// # Errors
    /// [`RecordingError::Damaged`].
    pub(crate) fn open(flight: Snapshot) -> Result<Self, RecordingError> {
        open(flight).map(Self)
    }

    /// Flight time of the first message, s.
    pub(crate) fn start_s(&self) -> f64 {
        self.0.start_us() as f64 / 1e6
    }

    /// Every signal, by topic; those of rows, of which there are hundreds, last.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`].
    pub(crate) fn list(&self) -> Result<Vec<Signal>, RecordingError> {
        Ok(signals_of(&self.look(|_| true).map_err(damaged)?))
    }

    /// Samples of a signal: time since the start of the flight, s, and value; as many as there are until `goes_on` is
    /// false. What is absent in a message is left out.
    ///
    /// # Errors
    /// [`RecordingError::Invalid`] for a range or a name that is none, [`RecordingError::Damaged`].
    pub(crate) fn read(
        &self,
        name: &str,
        range_s: (f64, f64),
        goes_on: impl Fn() -> bool,
    ) -> Result<Vec<(f64, f64)>, RecordingError> {
        let range_us = self.range_us(range_s)?;
        let of = |topic: &str| name.strip_prefix(topic).is_some_and(|rest| rest.starts_with(['.', '[']));
        let found = self.look(of).map_err(damaged)?.into_iter().find_map(|topic| {
            let place = topic.signals().find(|(known, ..)| known == name)?.2;
            Some((topic, place))
        });
        let unknown = || RecordingError::Invalid(format!("the flight has no signal {:?}", crate::names::clip(name)));
        let (topic, place) = found.ok_or_else(unknown)?;
        let mut reading = Reading::new(&topic, place);
        let start_us = self.0.start_us();
        let mut samples = Vec::new();
        let read = self.0.for_each_in(Some(std::slice::from_ref(&topic.topic)), range_us, |message| {
            if let Some(value) = reading.value(&topic.table, message.payload) {
                samples.push((message.time_us.saturating_sub(start_us) as f64 / 1e6, value));
            }
            Ok(goes_on())
        });
        read.map_err(damaged)?;
        Ok(samples)
    }

    /// Mean speed of the rotors while they turn, Hz, in a range of time since the start of the flight, s; `None` where
    /// truth does not tell it.
    ///
    /// # Errors
    /// Those of [`SignalReader::read`].
    pub(crate) fn rotor_hz(&self, range_s: (f64, f64)) -> Result<Option<f64>, RecordingError> {
        let (range_us, topic) = (self.range_us(range_s)?, Kind::Truth.base_topic().to_owned());
        let mut rotors = Rotors::default();
        let read = self.0.for_each_in(Some(&[topic]), range_us, |message| {
            rotors.take(message.payload);
            Ok(true)
        });
        read.map_err(damaged)?;
        Ok(rotors.mean_hz())
    }

    fn range_us(&self, (from_s, to_s): (f64, f64)) -> Result<(u64, u64), RecordingError> {
        Selection { from_s, to_s, ..Selection::default() }.range_us(&self.0)
    }

    /// The topics that `wanted` takes, by their prefixes, with what they hold.
    fn look(&self, wanted: impl Fn(&str) -> bool) -> McapResult<Vec<Topic>> {
        let channels = self.0.channels();
        let plotted = channels.values().filter(|channel| is_plotted(&channel.topic));
        let mut topics: Vec<Topic> = plotted
            .filter_map(|channel| {
                let topic = channel.topic.clone();
                Some(Topic::new(
                    topic,
                    wanted(&Kind::column_prefix(&channel.topic)).then(|| Table::of(channel)).flatten()?,
                ))
            })
            .collect();
        let names: Vec<String> = topics.iter().map(|topic| topic.topic.clone()).collect();
        let start_us = self.0.start_us();
        let end_us = if topics.len() == 1 { u64::MAX } else { start_us.saturating_add(LOOK_UNTIL_US) };
        self.0.for_each_in(Some(&names), (0, end_us), |message| {
            if let Some(topic) = topics.iter_mut().find(|topic| topic.topic == message.channel.topic) {
                topic.look(message.time_us, message.payload);
            }
            let done = |topic: &Topic| topic.begun_us.is_some_and(|begun| message.time_us > begun + LOOK_US);
            Ok(!topics.iter().all(done))
        })?;
        topics.retain(|topic| topic.begun_us.is_some());
        Ok(topics)
    }
}

/// Is there anything in this topic that changes from message to message, as a number?
fn is_plotted(topic: &str) -> bool {
    use Kind::{Ack, Attacks, Description, Event, Flight, Gains, StepResponse};
    let told = [Ack, Attacks, Description, Event, Flight, Gains, StepResponse];
    !Kind::from_topic(topic).is_some_and(|(kind, _)| told.contains(&kind))
}

/// What a row is called by the names and numbers it carries.
fn row_name(row: &[Cell], keys: &[usize]) -> String {
    keys.iter().filter_map(|key| row.get(*key)).map(ToString::to_string).collect::<Vec<_>>().join(" ").replace('_', " ")
}

/// Every signal of some topics; those of rows, of which there are hundreds, last.
fn signals_of(topics: &[Topic]) -> Vec<Signal> {
    let of = |topic: &Topic| topic.signals().map(|(name, unit, _)| Signal { name, unit }).collect::<Vec<_>>();
    let mut signals: Vec<Signal> = topics.iter().flat_map(of).collect();
    signals.sort_by_key(|signal| signal.name.contains('['));
    signals
}

impl Topic {
    fn new(topic: String, table: Table) -> Self {
        Self { prefix: Kind::column_prefix(&topic), topic, table, begun_us: None, rows: BTreeSet::new() }
    }

    fn look(&mut self, time_us: u64, payload: &[u8]) {
        let begun_us = *self.begun_us.get_or_insert(time_us);
        if time_us > begun_us.saturating_add(LOOK_US) {
            return;
        }
        self.table.measure(payload);
        if self.table.has_rows() {
            let keys = self.keys();
            self.rows.extend(self.table.rows(payload).iter().map(|row| row_name(row, &keys)));
        }
    }

    /// Places of the columns that tell rows apart.
    fn keys(&self) -> Vec<usize> {
        let Some(prefix) = self.table.rows_prefix() else { return Vec::new() };
        let tells = |(name, kind): (&String, Type)| {
            let field = name.strip_prefix(&prefix);
            field.is_some_and(|field| kind == Type::Named || matches!(field, "instance" | "id"))
        };
        let (header, types) = (self.table.header(), self.table.types());
        (0..header.len()).filter(|i| tells((&header[*i], types[*i]))).collect()
    }

    /// Name, unit and place of every signal.
    fn signals(&self) -> impl Iterator<Item = (String, String, Place)> {
        let (prefix, rows_prefix, keys) = (&self.prefix, self.table.rows_prefix(), self.keys());
        let mut found = Vec::new();
        for (column, (name, kind)) in self.table.header().into_iter().zip(self.table.types()).enumerate() {
            if kind == Type::Text || name == "time_us" || keys.contains(&column) {
                continue;
            }
            let unit = Head { name: name.clone(), kind }.unit().to_owned();
            match rows_prefix.as_ref().and_then(|rows| name.strip_prefix(rows.as_str())) {
                Some(field) => found.extend(self.rows.iter().map(|row| {
                    let place = Place { column, row: Some(row.clone()) };
                    (format!("{prefix}[{row}].{field}"), unit.clone(), place)
                })),
                None => found.push((format!("{prefix}.{name}"), unit, Place { column, row: None })),
            }
        }
        found.into_iter()
    }
}

/// Of each of `columns` stretches of time the least and the greatest sample, in their order; all of them where those
/// would be no fewer.
pub(crate) fn thinned(samples: &[(f64, f64)], columns: usize) -> Vec<(f64, f64)> {
    let ([(begin_s, _), .., (end_s, _)], true) = (samples, samples.len() > 2 * columns) else {
        return samples.to_vec();
    };
    let per_second = columns as f64 / (end_s - begin_s).max(f64::MIN_POSITIVE);
    let stretch =
        |(time_s, _): &(f64, f64)| (((time_s - begin_s) * per_second) as usize).min(columns.saturating_sub(1));
    let extremes = |run: &[(f64, f64)]| {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let least = run.iter().min_by(by_value).copied();
        let greatest = run.iter().max_by(by_value).copied().filter(|greatest| Some(*greatest) != least);
        let (first, second) =
            if greatest.map(|s| s.0) < least.map(|s| s.0) { (greatest, least) } else { (least, greatest) };
        first.into_iter().chain(second)
    };
    samples.chunk_by(|a, b| stretch(a) == stretch(b)).flat_map(extremes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_of_one_sample_outlives_thinning_and_time_goes_on() {
        let samples: Vec<_> =
            (0..10_000).map(|k| (f64::from(k) * 0.01, if k == 4321 { 9.0 } else { f64::from(k % 7) * 0.1 })).collect();
        let thin = thinned(&samples, 100);
        assert!(thin.len() <= 200 && thin.contains(&(43.21, 9.0)));
        assert!(thin.windows(2).all(|pair| pair[1].0 > pair[0].0));
        assert_eq!(thinned(&samples, 5000), samples, "no fewer");
        assert_eq!(thinned(&[], 10), []);
        let still = vec![(1.0, 2.0); 50];
        assert_eq!(thinned(&still, 10), [(1.0, 2.0)], "all at one time, all the same");
    }
}

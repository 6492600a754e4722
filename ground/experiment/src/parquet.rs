//! Results as a Parquet file: a row for each flight, by its index, for DuckDB, Polars and everybody else.
//!
//! The format (Apache Parquet 2, Thrift's compact protocol) as far as one flat table needs it: numbers and texts, plain, in row
//! groups, with nulls where nothing was measured. The same results give the same bytes. The `parquet` crate without any of its
//! features is sixty packages and three quarters of a minute of compiling for the same file.

use std::io::{self, Write};

use toml::Value;

use crate::row::{MEASURES, Row};
use crate::store::{Experiment, StoreError, write_whole};

const MAGIC: &[u8; 4] = b"PAR1";
/// Rows of one group.
const GROUP: usize = 100_000;

/// A column, whole.
enum Values<'a> {
    Integers(Vec<i64>),
    Numbers(Vec<Option<f64>>),
    Texts(Vec<Option<&'a str>>),
}

impl Values<'_> {
    /// Physical type: INT64, DOUBLE, BYTE_ARRAY.
    fn kind(&self) -> i64 {
        match self {
            Self::Integers(_) => 2,
            Self::Numbers(_) => 5,
            Self::Texts(_) => 6,
        }
    }

    fn optional(&self) -> bool {
        !matches!(self, Self::Integers(_))
    }

    /// One data page: which values are there, then those, plain.
    fn page(&self) -> Vec<u8> {
        let mut page = Vec::new();
        match self {
            Self::Integers(values) => values.iter().for_each(|value| page.extend(value.to_le_bytes())),
            Self::Numbers(values) => {
                there(&mut page, values);
                values.iter().flatten().for_each(|value| page.extend(value.to_le_bytes()));
            }
            Self::Texts(values) => {
                there(&mut page, values);
                for value in values.iter().flatten() {
                    page.extend((value.len() as u32).to_le_bytes());
                    page.extend(value.as_bytes());
                }
            }
        }
        page
    }
}

/// Definition levels: one run, a bit for each value.
fn there<T>(page: &mut Vec<u8>, values: &[Option<T>]) {
    let mut run = Vec::new();
    varint(&mut run, (values.len().div_ceil(8) as u64) << 1 | 1);
    let bits =
        |values: &[Option<T>]| values.iter().rev().fold(0_u8, |bits, value| bits << 1 | u8::from(value.is_some()));
    run.extend(values.chunks(8).map(bits));
    page.extend((run.len() as u32).to_le_bytes());
    page.extend(run);
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A struct of Thrift's compact protocol, being written.
#[derive(Default)]
struct Struct {
    bytes: Vec<u8>,
    last: u8,
}

impl Struct {
    fn field(&mut self, id: u8, kind: u8) {
        self.bytes.push((id - self.last) << 4 | kind);
        self.last = id;
    }

    fn integer(mut self, id: u8, value: i64) -> Self {
        self.number(id, 6, value);
        self
    }

    /// An `i32` or an enumeration.
    fn small(mut self, id: u8, value: i64) -> Self {
        self.number(id, 5, value);
        self
    }

    fn number(&mut self, id: u8, kind: u8, value: i64) {
        self.field(id, kind);
        varint(&mut self.bytes, zigzag(value));
    }

    fn text(mut self, id: u8, value: &str) -> Self {
        self.field(id, 8);
        varint(&mut self.bytes, value.len() as u64);
        self.bytes.extend(value.as_bytes());
        self
    }

    fn inner(mut self, id: u8, inner: Self) -> Self {
        self.field(id, 12);
        self.bytes.extend(inner.end());
        self
    }

    /// A list of elements of this kind, each written already.
    fn list(mut self, id: u8, kind: u8, elements: &[Vec<u8>]) -> Self {
        self.field(id, 9);
        if elements.len() < 15 {
            self.bytes.push((elements.len() as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            varint(&mut self.bytes, elements.len() as u64);
        }
        elements.iter().for_each(|element| self.bytes.extend(element));
        self
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

fn zigzag(value: i64) -> u64 {
    (value << 1 ^ value >> 63).cast_unsigned()
}

fn text(value: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(&mut bytes, value.len() as u64);
    bytes.extend(value.as_bytes());
    bytes
}

/// Writes groups of whole columns of the same names.
fn write(out: &mut impl Write, groups: &[Vec<(String, Values<'_>)>], about: &[(&str, &str)]) -> io::Result<()> {
    out.write_all(MAGIC)?;
    let mut at = MAGIC.len() as i64;
    let (mut rows, mut described) = (0, Vec::new());
    for group in groups {
        let count = group.first().map_or(0, |(_, values)| match values {
            Values::Integers(values) => values.len(),
            Values::Numbers(values) => values.len(),
            Values::Texts(values) => values.len(),
        }) as i64;
        let (mut columns, begun) = (Vec::new(), at);
        for (name, values) in group {
            let page = values.page();
            let size = page.len() as i64;
            let header = Struct::default().small(1, count).small(2, 0).small(3, 3).small(4, 3);
            let header = Struct::default().small(1, 0).small(2, size).small(3, size).inner(5, header).end();
            out.write_all(&header)?;
            out.write_all(&page)?;
            let whole = header.len() as i64 + size;
            // Encodings PLAIN and RLE; no compression.
            let encodings = [vec![0], vec![zigzag(3) as u8]];
            let column = Struct::default().small(1, values.kind()).list(2, 5, &encodings).list(3, 8, &[text(name)]);
            let column = column.small(4, 0).integer(5, count).integer(6, whole).integer(7, whole).integer(9, at);
            columns.push(Struct::default().integer(2, at).inner(3, column).end());
            at += whole;
        }
        described.push(Struct::default().list(1, 12, &columns).integer(2, at - begun).integer(3, count).end());
        rows += count;
    }
    let named = groups.first().map(Vec::as_slice).unwrap_or_default();
    let mut schema = vec![Struct::default().text(4, "flights").small(5, named.len() as i64).end()];
    schema.extend(named.iter().map(|(name, values)| {
        let element = Struct::default().small(1, values.kind()).small(3, i64::from(values.optional())).text(4, name);
        // A text is UTF-8.
        if values.kind() == 6 { element.small(6, 0).end() } else { element.end() }
    }));
    let about: Vec<_> = about.iter().map(|(key, value)| Struct::default().text(1, key).text(2, value).end()).collect();
    let footer = Struct::default().small(1, 2).list(2, 12, &schema).integer(3, rows).list(4, 12, &described);
    let footer = footer.list(5, 12, &about).text(6, concat!("plumbline ", env!("CARGO_PKG_VERSION"))).end();
    out.write_all(&footer)?;
    out.write_all(&(footer.len() as u32).to_le_bytes())?;
    out.write_all(MAGIC)
}

/// The results as they are, as `flights.parquet` in the experiment's folder.
///
/// # Errors
/// [`StoreError::Io`].
pub fn export(experiment: &Experiment) -> Result<std::path::PathBuf, StoreError> {
    let rows = experiment.rows()?;
    let plan = &experiment.plan;
    // One level for each row: what a factor shows there.
    let levels: Vec<Vec<Option<Value>>> = rows.iter().map(|row| plan.levels(plan.place(row.index.into()).0)).collect();
    let shown: Vec<Vec<String>> = levels
        .iter()
        .map(|levels| levels.iter().map(|level| crate::summary::shown(level.as_ref())).collect())
        .collect();
    // A file without a flight has its columns, too.
    let chunks = (0..rows.len().div_ceil(GROUP).max(1)).map(|n| n * GROUP..((n + 1) * GROUP).min(rows.len()));
    let mut groups = Vec::new();
    for range in chunks {
        let part = rows.get(range.clone()).unwrap_or_default();
        let mut columns = vec![];
        let whole = |of: &dyn Fn(&Row) -> u64| Values::Integers(part.iter().map(|row| of(row).cast_signed()).collect());
        columns.push(("index".to_owned(), whole(&|row| row.index.into())));
        columns.push(("condition".to_owned(), whole(&|row| plan.place(row.index.into()).0)));
        columns.push(("repeat".to_owned(), whole(&|row| plan.place(row.index.into()).1)));
        columns.push(("seed".to_owned(), whole(&|row| plan.seed_of(plan.place(row.index.into()).1))));
        for (at, factor) in plan.factors.iter().enumerate() {
            let values = if factor.is_number() {
                let level = |row: usize| levels.get(row).and_then(|levels| levels.get(at)).and_then(Option::as_ref);
                let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
                Values::Numbers(range.clone().map(|row| level(row).and_then(number)).collect())
            } else {
                let text = |row: usize| shown.get(row).and_then(|shown| shown.get(at)).map(String::as_str);
                Values::Texts(range.clone().map(|row| text(row).filter(|text| !text.is_empty())).collect())
            };
            columns.push((factor.key.clone(), values));
        }
        let lost = part.iter().map(|row| Some(row.lost()).filter(|lost| !lost.is_empty()));
        columns.push(("lost".to_owned(), Values::Texts(lost.collect())));
        for (at, measure) in MEASURES.iter().enumerate() {
            let value = |row: &Row| row.values.get(at).copied().filter(|value| value.is_finite());
            columns.push((measure.name.to_owned(), Values::Numbers(part.iter().map(value).collect())));
        }
        groups.push(columns);
    }
    let about =
        [("plan", plan.text.as_str()), ("hash", &experiment.identity.hash), ("program", &experiment.identity.program)];
    let mut bytes = Vec::new();
    let path = experiment.folder.join("flights.parquet");
    write(&mut bytes, &groups, &about).map_err(|source| StoreError::Io { path: path.clone(), source })?;
    write_whole(&path, &bytes)?;
    Ok(path)
}

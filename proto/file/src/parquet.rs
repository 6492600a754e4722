//! A table as a Parquet file: groups of rows, each column of a group one page, compressed by zstd. Absent cells are null.
//!
//! Source: the format's own description (apache/parquet-format: `README.md`, `Encodings.md`, `parquet.thrift`). Of Thrift's
//! compact protocol only what the footer needs is here. The same rows give the same bytes. Own code, because the `parquet`
//! crate without any of its features is sixty packages and three quarters of a minute of compiling for the same file.

use std::io;

const MAGIC: &[u8] = b"PAR1";
/// Rows of a group: what is kept in memory.
const GROUP: usize = 8192;
/// zstd's level: its default.
const LEVEL: i32 = 3;

/// Numbers of the format.
const BOOLEAN: i64 = 0;
const INT64: i64 = 2;
const DOUBLE: i64 = 5;
const BYTE_ARRAY: i64 = 6;
const UTF8: i64 = 0;
const OPTIONAL: i64 = 1;
const PLAIN: i64 = 0;
const RLE: i64 = 3;
const ZSTD: i64 = 6;

/// A Thrift structure in the compact protocol; fields in the order of their numbers.
#[derive(Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: u8,
}

impl Thrift {
    fn head(&mut self, field: u8, kind: u8) {
        self.bytes.push((field - self.last) << 4 | kind);
        self.last = field;
    }

    fn varint(&mut self, mut value: u64) {
        while value > 0x7f {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn zigzag(&mut self, value: i64) {
        self.varint((value << 1 ^ value >> 63) as u64);
    }

    fn i32(&mut self, field: u8, value: i64) -> &mut Self {
        self.head(field, 5);
        self.zigzag(value);
        self
    }

    fn i64(&mut self, field: u8, value: u64) -> &mut Self {
        self.head(field, 6);
        self.zigzag(value as i64);
        self
    }

    fn string(&mut self, field: u8, text: &str) -> &mut Self {
        self.head(field, 8);
        self.varint(text.len() as u64);
        self.bytes.extend_from_slice(text.as_bytes());
        self
    }

    fn structure(&mut self, field: u8, inner: &mut Self) -> &mut Self {
        self.head(field, 12);
        self.bytes.append(&mut inner.end());
        self
    }

    /// A list of elements that are encoded already, all of one kind.
    fn list(&mut self, field: u8, kind: u8, elements: &[Vec<u8>]) -> &mut Self {
        self.head(field, 9);
        if elements.len() < 15 {
            self.bytes.push((elements.len() as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            self.varint(elements.len() as u64);
        }
        elements.iter().for_each(|element| self.bytes.extend_from_slice(element));
        self
    }

    fn end(&mut self) -> Vec<u8> {
        self.bytes.push(0);
        std::mem::take(&mut self.bytes)
    }
}

fn number(value: i64) -> Vec<u8> {
    let mut thrift = Thrift::default();
    thrift.zigzag(value);
    thrift.bytes
}

fn text(value: &str) -> Vec<u8> {
    let mut thrift = Thrift::default();
    thrift.varint(value.len() as u64);
    thrift.bytes.extend_from_slice(value.as_bytes());
    thrift.bytes
}

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// True or false.
    Flag,
    /// Whole numbers.
    Integer,
    /// Numbers.
    Number,
    /// UTF-8.
    Text,
}

impl Kind {
    const fn physical(self) -> i64 {
        match self {
            Self::Flag => BOOLEAN,
            Self::Integer => INT64,
            Self::Number => DOUBLE,
            Self::Text => BYTE_ARRAY,
        }
    }
}

/// A cell, of the kind of its column; one of another kind is null.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell<'a> {
    /// Null.
    Absent,
    /// True or false.
    Flag(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Number(f64),
    /// UTF-8.
    Text(&'a str),
}

/// One column of the group being gathered.
struct Column {
    name: String,
    kind: Kind,
    present: Vec<bool>,
    flags: Vec<bool>,
    values: Vec<u8>,
}

impl Column {
    fn push(&mut self, cell: Cell<'_>) {
        let present = match (self.kind, cell) {
            (Kind::Flag, Cell::Flag(flag)) => {
                self.flags.push(flag);
                true
            }
            (Kind::Integer, Cell::Integer(value)) => {
                self.values.extend_from_slice(&value.to_le_bytes());
                true
            }
            (Kind::Number, Cell::Number(value)) => {
                self.values.extend_from_slice(&value.to_le_bytes());
                true
            }
            (Kind::Text, Cell::Text(text)) => {
                self.values.extend_from_slice(&(text.len() as u32).to_le_bytes());
                self.values.extend_from_slice(text.as_bytes());
                true
            }
            _ => false,
        };
        self.present.push(present);
    }

    /// Levels and values of a page, before they are compressed; the column is empty then.
    fn page(&mut self) -> Vec<u8> {
        // One run of bit-packed levels of one bit: (groups << 1) | 1, then a byte for each group of eight.
        let levels = bits(&self.present);
        let mut run = Thrift::default();
        run.varint((levels.len() as u64) << 1 | 1);
        run.bytes.extend_from_slice(&levels);
        let mut page = (run.bytes.len() as u32).to_le_bytes().to_vec();
        page.append(&mut run.bytes);
        page.extend_from_slice(&bits(&self.flags));
        page.append(&mut self.values);
        self.present.clear();
        self.flags.clear();
        page
    }

    /// Its line of the schema.
    fn element(&self) -> Vec<u8> {
        let mut element = Thrift::default();
        element.i32(1, self.kind.physical()).i32(3, OPTIONAL).string(4, &self.name);
        if self.kind == Kind::Text {
            element.i32(6, UTF8);
        }
        element.end()
    }
}

/// Eight to a byte, the lowest bit first.
fn bits(flags: &[bool]) -> Vec<u8> {
    let byte = |group: &[bool]| group.iter().enumerate().fold(0, |byte, (at, flag)| byte | u8::from(*flag) << at);
    flags.chunks(8).map(byte).collect()
}

/// The file being written.
pub struct Writer {
    name: &'static str,
    columns: Vec<Column>,
    rows: usize,
    total: u64,
    groups: Vec<Vec<u8>>,
    ready: Vec<u8>,
    /// Bytes before those.
    taken: u64,
}

impl Writer {
    /// A table of this name, with these columns.
    pub fn new(name: &'static str, columns: impl IntoIterator<Item = (String, Kind)>) -> Self {
        let column = |(name, kind)| Column { name, kind, present: Vec::new(), flags: Vec::new(), values: Vec::new() };
        Self {
            name,
            columns: columns.into_iter().map(column).collect(),
            rows: 0,
            total: 0,
            groups: Vec::new(),
            ready: MAGIC.to_vec(),
            taken: 0,
        }
    }

    /// One row, a cell for each column; those that are missing are null.
    ///
    /// # Errors
    /// A group that cannot be compressed.
    pub fn row<'a>(&mut self, cells: impl IntoIterator<Item = Cell<'a>>) -> io::Result<()> {
        let mut cells = cells.into_iter();
        for column in &mut self.columns {
            column.push(cells.next().unwrap_or(Cell::Absent));
        }
        self.rows += 1;
        if self.rows < GROUP { Ok(()) } else { self.group() }
    }

    /// Bytes of the file that are ready, after those that were taken.
    pub fn take(&mut self) -> Vec<u8> {
        self.taken += self.ready.len() as u64;
        std::mem::take(&mut self.ready)
    }

    fn group(&mut self) -> io::Result<()> {
        let mut chunks = Vec::with_capacity(self.columns.len());
        let mut all = 0;
        for column in &mut self.columns {
            let page = column.page();
            let packed = zstd::bulk::compress(&page, LEVEL)?;
            let mut data = Thrift::default();
            data.i32(1, self.rows as i64).i32(2, PLAIN).i32(3, RLE).i32(4, RLE);
            let mut header = Thrift::default();
            header.i32(1, 0).i32(2, page.len() as i64).i32(3, packed.len() as i64).structure(5, &mut data);
            let header = header.end();
            let at = self.taken + self.ready.len() as u64;
            self.ready.extend_from_slice(&header);
            self.ready.extend_from_slice(&packed);
            let (plain, stored) = (header.len() + page.len(), header.len() + packed.len());
            all += plain as u64;
            let mut meta = Thrift::default();
            meta.i32(1, column.kind.physical())
                .list(2, 5, &[number(PLAIN), number(RLE)])
                .list(3, 8, &[text(&column.name)])
                .i32(4, ZSTD)
                .i64(5, self.rows as u64)
                .i64(6, plain as u64)
                .i64(7, stored as u64)
                .i64(9, at);
            let mut chunk = Thrift::default();
            chunks.push(chunk.i64(2, at).structure(3, &mut meta).end());
        }
        let mut group = Thrift::default();
        self.groups.push(group.list(1, 12, &chunks).i64(2, all).i64(3, self.rows as u64).end());
        self.total += self.rows as u64;
        self.rows = 0;
        Ok(())
    }

    /// The rest of the bytes, with `about` in the file's metadata.
    ///
    /// # Errors
    /// A group that cannot be compressed.
    pub fn finish(mut self, about: &[(&str, &str)]) -> io::Result<Vec<u8>> {
        if self.rows > 0 {
            self.group()?;
        }
        let root = Thrift::default().string(4, self.name).i32(5, self.columns.len() as i64).end();
        let schema: Vec<_> = std::iter::once(root).chain(self.columns.iter().map(Column::element)).collect();
        let about: Vec<_> =
            about.iter().map(|(key, value)| Thrift::default().string(1, key).string(2, value).end()).collect();
        let footer = Thrift::default()
            .i32(1, 1)
            .list(2, 12, &schema)
            .i64(3, self.total)
            .list(4, 12, &self.groups)
            .list(5, 12, &about)
            .string(6, concat!("plumbline ", env!("CARGO_PKG_VERSION")))
            .end();
        self.ready.extend_from_slice(&footer);
        self.ready.extend_from_slice(&(footer.len() as u32).to_le_bytes());
        self.ready.extend_from_slice(MAGIC);
        Ok(self.take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thrift_is_compact() {
        // A field's number is the difference to the one before; numbers are zigzag varints; lists of 15 and more say so.
        let bytes = Thrift::default().i32(1, -1).i64(3, 300).string(4, "ab").end();
        assert_eq!(bytes, [0x15, 1, 0x26, 0xd8, 4, 0x18, 2, b'a', b'b', 0]);
        let many: Vec<_> = (0..15).map(number).collect();
        assert_eq!(Thrift::default().list(2, 5, &many).end()[..4], [0x29, 0xf5, 15, 0]);
    }

    #[test]
    fn levels_and_flags_are_packed_from_the_lowest_bit() {
        let mut table = Writer::new("t", [("flag".to_owned(), Kind::Flag)]);
        for cell in [Cell::Flag(true), Cell::Absent, Cell::Flag(false), Cell::Flag(true)] {
            table.row([cell]).unwrap();
        }
        assert_eq!(table.columns[0].page(), [2, 0, 0, 0, 3, 0b1101, 0b101]);
    }
}

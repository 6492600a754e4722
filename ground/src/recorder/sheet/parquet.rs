//! Parquet: a table in groups of rows, each column of a group one page, compressed by zstd. Absent cells are null.
//!
//! Source: the format's own description (apache/parquet-format: `README.md`, `Encodings.md`, `parquet.thrift`). Of Thrift's
//! compact protocol only what the footer needs is here.

use mcap::{McapError, McapResult};

use super::super::export::Sink;
use super::super::flatten::{Cell, Type};
use super::{Head, Pieces, Sheet};

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

/// One column of the group being gathered.
#[derive(Default)]
struct Column {
    present: Vec<bool>,
    flags: Vec<bool>,
    values: Vec<u8>,
}

impl Column {
    fn push(&mut self, kind: Type, cell: &Cell) {
        let present = !matches!(cell, Cell::Absent);
        self.present.push(present);
        if !present {
            return;
        }
        match kind {
            Type::Flag => self.flags.push(matches!(cell, Cell::Flag(true))),
            Type::Integer => self.values.extend_from_slice(&cell.integer().to_le_bytes()),
            Type::Double => self.values.extend_from_slice(&cell.number().to_le_bytes()),
            Type::Text | Type::Named => {
                let text = cell.to_string();
                self.values.extend_from_slice(&(text.len() as u32).to_le_bytes());
                self.values.extend_from_slice(text.as_bytes());
            }
        }
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
}

/// Eight to a byte, the lowest bit first.
fn bits(flags: &[bool]) -> Vec<u8> {
    let byte = |group: &[bool]| group.iter().enumerate().fold(0, |byte, (at, flag)| byte | u8::from(*flag) << at);
    flags.chunks(8).map(byte).collect()
}

/// The file being written.
pub(super) struct Parquet<'s, 'f> {
    out: Pieces<'s, 'f>,
    heads: Vec<Head>,
    columns: Vec<Column>,
    rows: usize,
    total: u64,
    groups: Vec<Vec<u8>>,
}

impl<'s, 'f> Parquet<'s, 'f> {
    pub(super) fn new(sink: &'s mut Sink<'f>, heads: Vec<Head>) -> Self {
        let mut out = Pieces::new(sink);
        out.put(MAGIC);
        let columns = heads.iter().map(|_| Column::default()).collect();
        Self { out, heads, columns, rows: 0, total: 0, groups: Vec::new() }
    }

    fn group(&mut self) -> McapResult<bool> {
        let mut chunks = Vec::with_capacity(self.heads.len());
        let (mut all, mut listening) = (0, true);
        for (head, column) in self.heads.iter().zip(&mut self.columns) {
            let page = column.page();
            let packed = zstd::bulk::compress(&page, LEVEL).map_err(McapError::Io)?;
            let mut data = Thrift::default();
            data.i32(1, self.rows as i64).i32(2, PLAIN).i32(3, RLE).i32(4, RLE);
            let mut header = Thrift::default();
            header.i32(1, 0).i32(2, page.len() as i64).i32(3, packed.len() as i64).structure(5, &mut data);
            let header = header.end();
            let at = self.out.at();
            listening &= self.out.put(&header) && self.out.put(&packed);
            let (plain, stored) = (header.len() + page.len(), header.len() + packed.len());
            all += plain as u64;
            let mut meta = Thrift::default();
            meta.i32(1, physical(head.kind))
                .list(2, 5, &[number(PLAIN), number(RLE)])
                .list(3, 8, &[text(&head.name)])
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
        Ok(listening)
    }

    fn schema(&self) -> Vec<Vec<u8>> {
        let root = Thrift::default().string(4, "flight").i32(5, self.heads.len() as i64).end();
        let column = |head: &Head| {
            let mut element = Thrift::default();
            element.i32(1, physical(head.kind)).i32(3, OPTIONAL).string(4, &head.name);
            if matches!(head.kind, Type::Text | Type::Named) {
                element.i32(6, UTF8);
            }
            element.end()
        };
        std::iter::once(root).chain(self.heads.iter().map(column)).collect()
    }
}

const fn physical(kind: Type) -> i64 {
    match kind {
        Type::Flag => BOOLEAN,
        Type::Integer => INT64,
        Type::Double => DOUBLE,
        Type::Text | Type::Named => BYTE_ARRAY,
    }
}

impl Sheet for Parquet<'_, '_> {
    fn row(&mut self, cells: &[Cell]) -> McapResult<bool> {
        for ((head, column), cell) in self.heads.iter().zip(&mut self.columns).zip(cells) {
            column.push(head.kind, cell);
        }
        self.rows += 1;
        if self.rows < GROUP { Ok(true) } else { self.group() }
    }

    fn end(&mut self) -> McapResult<()> {
        if self.rows > 0 {
            self.group()?;
        }
        let units: serde_json::Map<String, serde_json::Value> =
            self.heads.iter().filter(|h| !h.unit().is_empty()).map(|h| (h.name.clone(), h.unit().into())).collect();
        let units = Thrift::default().string(1, "units").string(2, &serde_json::Value::Object(units).to_string()).end();
        let footer = Thrift::default()
            .i32(1, 1)
            .list(2, 12, &self.schema())
            .i64(3, self.total)
            .list(4, 12, &self.groups)
            .list(5, 12, &[units])
            .string(6, concat!("plumbline-ground ", env!("CARGO_PKG_VERSION")))
            .end();
        self.out.put(&footer);
        self.out.put(&(footer.len() as u32).to_le_bytes());
        self.out.put(MAGIC);
        self.out.send();
        Ok(())
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
        let mut column = Column::default();
        for cell in [Cell::Flag(true), Cell::Absent, Cell::Flag(false), Cell::Flag(true)] {
            column.push(Type::Flag, &cell);
        }
        assert_eq!(column.page(), [2, 0, 0, 0, 3, 0b1101, 0b101]);
    }
}

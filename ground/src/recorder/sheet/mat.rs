//! MATLAB's MAT-file, level 5, uncompressed: `data` with a row for each column of the table and a column for each of its
//! rows, so that it is written as it comes; `names` and `units` of the rows; `event_time_s` and `event_text`.
//!
//! Source: MathWorks, *MAT-File Format*, R2023a. Names of modes and the like are their numbers, texts are NaN.

use mcap::{McapError, McapResult};

use super::super::export::Sink;
use super::super::flatten::Cell;
use super::{Head, Pieces, Sheet};

/// Types of data elements, and classes of arrays.
const INT8: u32 = 1;
const UINT16: u32 = 4;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;
const CELLS: u32 = 1;
const CHARS: u32 = 4;
const DOUBLES: u32 = 6;

/// Tag and data, padded to eight bytes.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut out = kind.to_le_bytes().to_vec();
    out.extend_from_slice(&(data.len() as u32).to_le_bytes());
    out.extend_from_slice(data);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

/// What stands before the values of an array: flags, dimensions, name.
fn head(class: u32, rows: u32, columns: u32, name: &str) -> Vec<u8> {
    let flags = [class.to_le_bytes(), [0; 4]].concat();
    let dimensions = [rows.to_le_bytes(), columns.to_le_bytes()].concat();
    [element(UINT32, &flags), element(INT32, &dimensions), element(INT8, name.as_bytes())].concat()
}

fn chars(text: &str) -> Vec<u8> {
    let units: Vec<u16> = text.encode_utf16().collect();
    let bytes: Vec<u8> = units.iter().flat_map(|unit| unit.to_le_bytes()).collect();
    let rows = u32::from(!units.is_empty());
    element(MATRIX, &[head(CHARS, rows, units.len() as u32, ""), element(UINT16, &bytes)].concat())
}

/// A column of texts.
fn cells<'a>(name: &str, texts: impl ExactSizeIterator<Item = &'a str>) -> Vec<u8> {
    let mut body = head(CELLS, texts.len() as u32, 1, name);
    texts.for_each(|text| body.append(&mut chars(text)));
    element(MATRIX, &body)
}

fn doubles(name: &str, values: &[f64]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    element(MATRIX, &[head(DOUBLES, values.len() as u32, 1, name), element(DOUBLE, &bytes)].concat())
}

/// The file being written.
pub(super) struct Mat<'s, 'f> {
    out: Pieces<'s, 'f>,
    /// Rows that were promised and have not come.
    left: u64,
    width: usize,
}

impl<'s, 'f> Mat<'s, 'f> {
    /// `rows` is how many will come.
    pub(super) fn new(sink: &'s mut Sink<'f>, heads: &[Head], rows: u64, events: &[(f64, String)]) -> McapResult<Self> {
        let width = heads.len() as u64;
        let body = head(DOUBLES, heads.len() as u32, rows as u32, "data");
        let bytes = rows.saturating_mul(width).saturating_mul(8);
        let whole = bytes + body.len() as u64 + 8;
        // Sizes are of 32 bits, and MATLAB reads them as signed.
        if whole > i32::MAX as u64 {
            let text = format!(
                "{rows} rows of {width} columns are more than a .mat of level 5 holds: ask for a range, a rate or columns"
            );
            return Err(McapError::Io(std::io::Error::other(text)));
        }
        let mut out = Pieces::new(sink);
        let mut header =
            format!("MATLAB 5.0 MAT-file, Platform: plumbline-ground {}", env!("CARGO_PKG_VERSION")).into_bytes();
        header.resize(116, b' ');
        header.resize(124, 0);
        header.extend_from_slice(&[0x00, 0x01, b'I', b'M']);
        out.put(&header);
        out.put(&cells("names", heads.iter().map(|head| head.name.as_str())));
        out.put(&cells("units", heads.iter().map(Head::unit)));
        out.put(&doubles("event_time_s", &events.iter().map(|(time_s, _)| *time_s).collect::<Vec<_>>()));
        out.put(&cells("event_text", events.iter().map(|(_, text)| text.as_str())));
        for number in [MATRIX, whole as u32] {
            out.put(&number.to_le_bytes());
        }
        out.put(&body);
        for number in [DOUBLE, bytes as u32] {
            out.put(&number.to_le_bytes());
        }
        Ok(Self { out, left: rows, width: heads.len() })
    }
}

impl Sheet for Mat<'_, '_> {
    fn row(&mut self, cells: &[Cell]) -> McapResult<bool> {
        if self.left == 0 {
            return Ok(false);
        }
        self.left -= 1;
        let bytes: Vec<u8> = cells.iter().flat_map(|cell| cell.number().to_le_bytes()).collect();
        Ok(self.out.put(&bytes))
    }

    fn end(&mut self) -> McapResult<()> {
        // A file shorter than it says cannot be read.
        for _ in 0..self.left {
            let nothing: Vec<u8> = (0..self.width).flat_map(|_| f64::NAN.to_le_bytes()).collect();
            self.out.put(&nothing);
        }
        self.out.send();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_padded_and_say_their_size() {
        assert_eq!(element(INT8, b"abc"), [1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', b'c', 0, 0, 0, 0, 0]);
        let text = chars("é");
        assert_eq!(text.len() % 8, 0);
        assert_eq!(text[4..8], ((text.len() - 8) as u32).to_le_bytes());
    }

    #[test]
    fn what_is_too_large_is_refused_with_what_to_do() {
        let mut sink = |_: Vec<u8>| true;
        let heads = vec![Head { name: "time_s".into(), kind: super::super::Type::Double }; 400];
        let error = crate::recorder::explain(&Mat::new(&mut sink, &heads, 1 << 20, &[]).err().unwrap());
        assert!(error.contains("rate"), "{error}");
    }
}

//! Comma-separated text.

use mcap::{McapError, McapResult};

use super::super::export::Sink;
use super::super::flatten::Cell;
use super::{Head, Pieces, Sheet};

/// One row a line.
pub(super) struct Csv<'s, 'f> {
    out: Pieces<'s, 'f>,
}

fn failed(error: impl Into<std::io::Error>) -> McapError {
    McapError::Io(error.into())
}

impl<'s, 'f> Csv<'s, 'f> {
    pub(super) fn new(sink: &'s mut Sink<'f>, heads: &[Head]) -> McapResult<Self> {
        let mut csv = Self { out: Pieces::new(sink) };
        csv.line(heads.iter().map(|head| head.name.clone()))?;
        Ok(csv)
    }

    fn line(&mut self, cells: impl Iterator<Item = String>) -> McapResult<bool> {
        let mut line = csv::Writer::from_writer(Vec::new());
        line.write_record(cells).map_err(|e| failed(std::io::Error::from(e)))?;
        let line = line.into_inner().map_err(|e| failed(std::io::Error::other(e.to_string())))?;
        Ok(self.out.put(&line))
    }
}

impl Sheet for Csv<'_, '_> {
    fn row(&mut self, cells: &[Cell]) -> McapResult<bool> {
        // Time first, to the microsecond.
        let text = |(at, cell): (usize, &Cell)| match cell {
            Cell::Double(time) if at == 0 => format!("{time:.6}"),
            other => other.to_string(),
        };
        self.line(cells.iter().enumerate().map(text))
    }

    fn end(&mut self) -> McapResult<()> {
        self.out.send();
        Ok(())
    }
}

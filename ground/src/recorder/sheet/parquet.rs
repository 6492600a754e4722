//! Parquet, with the units of the columns in its metadata.

use mcap::{McapError, McapResult};
use plumbline_file::parquet::{Cell as Field, Kind, Writer};

use super::super::export::Sink;
use super::super::flatten::{Cell, Type};
use super::{Head, Pieces, Sheet};

/// The file being written.
pub(super) struct Parquet<'s, 'f> {
    out: Pieces<'s, 'f>,
    heads: Vec<Head>,
    table: Writer,
}

impl<'s, 'f> Parquet<'s, 'f> {
    pub(super) fn new(sink: &'s mut Sink<'f>, heads: Vec<Head>) -> Self {
        let columns = heads.iter().map(|head| (head.name.clone(), kind(head.kind)));
        Self { out: Pieces::new(sink), table: Writer::new("flight", columns), heads }
    }
}

const fn kind(of: Type) -> Kind {
    match of {
        Type::Flag => Kind::Flag,
        Type::Integer => Kind::Integer,
        Type::Double => Kind::Number,
        Type::Text | Type::Named => Kind::Text,
    }
}

impl Sheet for Parquet<'_, '_> {
    fn row(&mut self, cells: &[Cell]) -> McapResult<bool> {
        let texts: Vec<String> = self
            .heads
            .iter()
            .zip(cells)
            .map(|(head, cell)| if kind(head.kind) == Kind::Text { cell.to_string() } else { String::new() })
            .collect();
        let fields =
            self.heads.iter().zip(cells).zip(&texts).map(|((head, cell), text)| match (kind(head.kind), cell) {
                (_, Cell::Absent) => Field::Absent,
                (Kind::Flag, cell) => Field::Flag(matches!(cell, Cell::Flag(true))),
                (Kind::Integer, cell) => Field::Integer(cell.integer()),
                (Kind::Number, cell) => Field::Number(cell.number()),
                (Kind::Text, _) => Field::Text(text),
            });
        self.table.row(fields).map_err(McapError::Io)?;
        Ok(self.out.put(&self.table.take()))
    }

    fn end(&mut self) -> McapResult<()> {
        let units: serde_json::Map<String, serde_json::Value> =
            self.heads.iter().filter(|h| !h.unit().is_empty()).map(|h| (h.name.clone(), h.unit().into())).collect();
        let units = serde_json::Value::Object(units).to_string();
        let table = std::mem::replace(&mut self.table, Writer::new("", []));
        let rest = table.finish(&[("units", &units)]).map_err(McapError::Io)?;
        self.out.put(&rest);
        self.out.send();
        Ok(())
    }
}

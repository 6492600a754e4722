//! A part of a plan: the flights that one job flies, wherever it is flown, and its shard of the results.
//!
//! | file of the shard | what |
//! |---|---|
//! | `ID/FIRST-COUNT.parquet` | a row for each of its flights, as in `flights.parquet` |
//! | `ID/FIRST-COUNT.rows` | the same as [`Row`]s, for whoever gathers; written last: a shard is there with it |
//!
//! The same part of the same plan by the same program has the same bytes, so flying it twice does no harm.

use plumbline_file::parquet::Writer;
use serde::{Deserialize, Serialize};

use crate::parquet;
use crate::plan::{PROGRAM, Plan};
use crate::row::{MEASURES, ROW_BYTES, Row, names, places};
use crate::run::flown;

/// Flights `first` to `first + count` of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Part {
    /// The first.
    pub first: u64,
    /// How many.
    pub count: u64,
}

impl Part {
    /// All parts of a plan of so many flights, `size` in each but the last.
    pub fn all(flights: u64, size: u64) -> impl Iterator<Item = Self> {
        let size = size.max(1);
        (0..flights.div_ceil(size)).map(move |nth| Self { first: nth * size, count: size.min(flights - nth * size) })
    }

    /// Its flights.
    pub fn indices(self) -> std::ops::Range<u64> {
        self.first..self.first.saturating_add(self.count)
    }

    /// Name of its shard, without folder and ending.
    pub fn name(self) -> String {
        format!("{:07}-{}", self.first, self.count)
    }

    /// Flies it, one flight after the other; `go_on` is asked before each.
    ///
    /// Returns its rows and why flights could not be flown; `None` when it was to end early.
    pub fn fly(self, plan: &Plan, go_on: impl Fn() -> bool) -> Option<(Vec<Row>, Vec<String>)> {
        let (mut rows, mut errors) = (Vec::new(), Vec::new());
        for index in self.indices().take_while(|index| *index < plan.flights()) {
            if !go_on() {
                return None;
            }
            let (condition, _) = plan.place(index);
            let row = flown(plan, &plan.condition(condition), index).map(|(row, _)| row);
            rows.push(row.unwrap_or_else(|error| {
                errors.push(format!("flight {index}: {error}"));
                Row::not_flown(index as u32)
            }));
        }
        Some((rows, errors))
    }
}

/// Rows as they are kept in a shard.
pub fn encode(rows: &[Row]) -> Vec<u8> {
    rows.iter().flat_map(Row::encode).collect()
}

/// Rows of a shard; `None` when any of it is damaged.
pub fn decode(bytes: &[u8]) -> Option<Vec<Row>> {
    let places = places(&names(&MEASURES));
    let whole = bytes.len().is_multiple_of(ROW_BYTES).then(|| bytes.chunks_exact(ROW_BYTES))?;
    whole.map(|bytes| Row::decode(bytes, &places)).collect()
}

/// Rows as a Parquet file.
///
/// # Errors
/// Compression.
pub fn table(plan: &Plan, rows: &[Row]) -> std::io::Result<Vec<u8>> {
    let mut table: Writer = parquet::begin(plan);
    rows.iter().try_for_each(|row| parquet::add(&mut table, plan, row))?;
    parquet::end(table, plan, &plan.hash(), PROGRAM)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Outcome;

    #[test]
    fn parts_hold_every_flight_once() {
        for (flights, size) in [(1, 50), (50, 50), (101, 50), (7, 1), (7, 0)] {
            let of: Vec<u64> = Part::all(flights, size).flat_map(Part::indices).collect();
            assert_eq!(of, (0..flights).collect::<Vec<_>>(), "{flights} by {size}");
        }
        assert_eq!(Part { first: 50, count: 7 }.name(), "0000050-7");
    }

    #[test]
    fn a_damaged_shard_is_none() {
        let rows = [1, 2, 3].map(|index| Row::new(index, &Outcome::default()));
        let bytes = encode(&rows);
        assert!(decode(&bytes).unwrap() == rows);
        assert!(decode(&bytes[1..]).is_none() && decode(&bytes[..bytes.len() - 1]).is_none());
        let mut damaged = bytes.clone();
        damaged[200] ^= 1;
        assert!(decode(&damaged).is_none());
    }
}

//! Results as a Parquet file: a row for each flight, by its index, for DuckDB, Polars and everybody else.

use std::io;

use plumbline_file::parquet::{Cell, Kind, Writer};
use toml::Value;

use crate::plan::{Factor, Plan};
use crate::row::{MEASURES, Row};
use crate::store::{Experiment, StoreError, write_whole};

/// The results as they are, as `flights.parquet` in the experiment's folder.
///
/// # Errors
/// [`StoreError::Io`].
pub fn export(experiment: &Experiment) -> Result<std::path::PathBuf, StoreError> {
    let (plan, identity) = (&experiment.plan, &experiment.identity);
    let path = experiment.folder.join("flights.parquet");
    let broken = |source| StoreError::Io { path: path.clone(), source };
    let mut table = begin(plan);
    experiment.rows()?.iter().try_for_each(|row| add(&mut table, plan, row)).map_err(broken)?;
    write_whole(&path, &end(table, plan, &identity.hash, &identity.program).map_err(broken)?)?;
    Ok(path)
}

/// A table with the columns of a plan.
pub(crate) fn begin(plan: &Plan) -> Writer {
    let factor = |factor: &Factor| (factor.key.clone(), if factor.is_number() { Kind::Number } else { Kind::Text });
    let columns = ["index", "condition", "repeat", "seed"].map(|name| (name.to_owned(), Kind::Integer)).into_iter();
    let columns = columns.chain(plan.factors.iter().map(factor)).chain([("lost".to_owned(), Kind::Text)]);
    let columns = columns.chain(MEASURES.iter().map(|measure| (measure.name.to_owned(), Kind::Number)));
    Writer::new("flights", columns)
}

/// One flight more.
pub(crate) fn add(table: &mut Writer, plan: &Plan, row: &Row) -> io::Result<()> {
    let text = |text: &'_ str| if text.is_empty() { None } else { Some(text.to_owned()) };
    let index = u64::from(row.index);
    let (condition, repeat) = plan.place(index);
    let levels = plan.levels(condition);
    let shown: Vec<_> = levels.iter().map(|level| text(&crate::summary::shown(level.as_ref()))).collect();
    let lost = text(row.lost());
    let whole = [index, condition, repeat, plan.seed_of(repeat)].map(|number| Cell::Integer(number.cast_signed()));
    let level = plan.factors.iter().zip(&levels).zip(&shown).map(|((factor, level), shown)| {
        if factor.is_number() {
            let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
            level.as_ref().and_then(number).map_or(Cell::Absent, Cell::Number)
        } else {
            shown.as_deref().map_or(Cell::Absent, Cell::Text)
        }
    });
    let lost = std::iter::once(lost.as_deref().map_or(Cell::Absent, Cell::Text));
    let value = |at: usize| row.values.get(at).copied().filter(|value| value.is_finite());
    let measures = (0..MEASURES.len()).map(|at| value(at).map_or(Cell::Absent, Cell::Number));
    table.row(whole.into_iter().chain(level).chain(lost).chain(measures))
}

/// The whole file; in it, what it is of.
pub(crate) fn end(mut table: Writer, plan: &Plan, hash: &str, program: &str) -> io::Result<Vec<u8>> {
    let mut bytes = table.take();
    bytes.extend(table.finish(&[("plan", plan.text.as_str()), ("hash", hash), ("program", program)])?);
    Ok(bytes)
}

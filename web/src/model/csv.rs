//! What a chart shows, as a table: a row per time, a column per curve, empty where a curve has no sample at that time.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::series::Series;

/// A column: its head and its curve.
pub type Column<'a> = (String, &'a Series);

/// The samples of some curves in a stretch of time, s of flight time.
pub fn csv(columns: &[Column<'_>], start_s: f64, end_s: f64) -> String {
    let mut rows: BTreeMap<u64, Vec<Option<f32>>> = BTreeMap::new();
    for (i, (_, series)) in columns.iter().enumerate() {
        for (time_s, value) in series.samples(series.lower_bound(start_s)..series.upper_bound(end_s)) {
            let row = rows.entry((time_s * 1e6).round().max(0.0) as u64).or_insert_with(|| vec![None; columns.len()]);
            if let Some(cell) = row.get_mut(i) {
                *cell = Some(value).filter(|v| v.is_finite());
            }
        }
    }
    let mut out = "time_s".to_owned();
    for (head, _) in columns {
        // A head is never a formula of a spreadsheet, nor two columns.
        let head: String = head.chars().map(|c| if matches!(c, ',' | '"' | '\n') { ' ' } else { c }).collect();
        let _ = write!(out, ",{}", head.trim_start_matches(['=', '+', '-', '@']));
    }
    out.push('\n');
    for (time_us, row) in rows {
        let _ = write!(out, "{}.{:06}", time_us / 1_000_000, time_us % 1_000_000);
        for cell in row {
            match cell {
                Some(value) => {
                    let _ = write!(out, ",{value}");
                }
                None => out.push(','),
            }
        }
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_by_time_and_blanks_where_nothing_is_known() {
        let one = Series::from_samples([(1.0, 0.5), (1.01, 0.25), (9.0, 7.0)]);
        let two = Series::from_samples([(1.0, f32::NAN), (1.005, -3.0)]);
        let text = csv(&[("a, b m".into(), &one), ("=c".into(), &two)], 0.5, 2.0);
        assert_eq!(text, "time_s,a  b m,c\n1.000000,0.5,\n1.005000,,-3\n1.010000,0.25,\n");
    }
}

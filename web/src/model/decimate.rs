//! From many samples to about one point per pixel column.
//!
//! Where a window holds more than [`DENSE`] samples per column, each column becomes the smallest and
//! largest value in it (its *envelope*); with fewer, the samples themselves are the points. Columns
//! lie on multiples of the column's width in absolute time, not on the window's edge, so that a
//! scrolling curve keeps its shape instead of shimmering.
//!
//! A run ends at a gap: a column (or sample) without finite value, or two neighbours further apart
//! than the series allows.

use std::ops::Range;

use super::series::{Extent, Series};

/// Samples per column above which a column is drawn as an envelope.
pub const DENSE: f64 = 1.5;

/// How neighbours are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Joined {
    /// By a straight line.
    Straight,
    /// By holding the old value until the new one: setpoints.
    Held,
}

/// One point of a decimated curve. For single samples `low == high`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Columns from the window's left edge (0 ..= columns; a little outside at both ends).
    pub x: f32,
    /// Smallest value.
    pub low: f32,
    /// Largest value.
    pub high: f32,
}

/// A decimated curve; kept between frames so that nothing is allocated.
#[derive(Debug, Clone, Default)]
pub struct Decimated {
    /// Every point, from left to right.
    pub points: Vec<Point>,
    /// Which points belong together: a gap lies between runs.
    pub runs: Vec<Range<usize>>,
    /// Are the points envelopes of columns (not single samples)?
    pub envelope: bool,
}

impl Decimated {
    fn clear(&mut self) {
        self.points.clear();
        self.runs.clear();
    }

    /// Close the run that began at point `from`.
    fn close(&mut self, from: usize) {
        if from < self.points.len() {
            self.runs.push(from..self.points.len());
        }
    }
}

/// Decimate the stretch `start_s..end_s` of a series to `columns` columns.
pub fn decimate(series: &Series, start_s: f64, end_s: f64, columns: usize, joined: Joined, out: &mut Decimated) {
    out.clear();
    let column_s = (end_s - start_s) / columns as f64;
    if !(column_s.is_finite() && column_s > 0.0) || series.is_empty() {
        return;
    }
    // One sample more on both sides, so that lines run on to the edges of the plot.
    let from = series.lower_bound(start_s).saturating_sub(1).max(series.first());
    let to = (series.upper_bound(end_s) + 1).min(series.end());
    out.envelope = (to - from) as f64 > DENSE * columns as f64;
    if out.envelope {
        envelope(series, from..to, start_s, column_s, columns, out);
    } else {
        samples(series, from..to, start_s, column_s, joined, out);
    }
}

fn samples(series: &Series, range: Range<u64>, start_s: f64, column_s: f64, joined: Joined, out: &mut Decimated) {
    let mut run = 0;
    let mut previous: Option<(f64, f32)> = None;
    for (time_s, value) in series.samples(range) {
        let gap = previous.is_some_and(|(last_s, _)| time_s - last_s > series.max_gap_s());
        if gap || !value.is_finite() {
            out.close(run);
            run = out.points.len();
            previous = None;
        }
        if !value.is_finite() {
            continue;
        }
        let x = ((time_s - start_s) / column_s) as f32;
        if let (Joined::Held, Some((_, held))) = (joined, previous)
            && held != value
        {
            out.points.push(Point { x, low: held, high: held });
        }
        out.points.push(Point { x, low: value, high: value });
        previous = Some((time_s, value));
    }
    out.close(run);
}

fn envelope(series: &Series, range: Range<u64>, start_s: f64, column_s: f64, columns: usize, out: &mut Decimated) {
    // What lies outside the window by more than a column is not filled in.
    let leftmost = (start_s / column_s).floor() - 1.0;
    let rightmost = leftmost + columns as f64 + 3.0;
    let mut run = 0;
    // Newest sample of the column before, if it may be joined to.
    let mut previous: Option<(f64, f32)> = None;
    let mut from = range.start;
    let Some((first_s, _)) = series.get(from) else { return };
    let mut column = (first_s / column_s).floor();
    while from < range.end {
        let to = series.lower_bound_from(from, (column + 1.0) * column_s).clamp(from, range.end);
        if to == from {
            // An empty column: go straight to the one with the next sample.
            let Some((next_s, _)) = series.get(from) else { return };
            column = (next_s / column_s).floor().max(column + 1.0);
            continue;
        }
        let extent = series.extent(from..to);
        let (first, last) = (series.get(from), series.get(to - 1));
        let gap = match (previous, first) {
            (Some((last_s, _)), Some((first_s, _))) => first_s - last_s > series.max_gap_s(),
            _ => false,
        };
        if gap || extent.is_empty() {
            out.close(run);
            run = out.points.len();
            previous = None;
        }
        if !extent.is_empty() {
            let mut before = previous;
            if let (Some(from), Some(to)) = (previous, first) {
                before = Some(bridge(from, to, leftmost..column.min(rightmost), start_s, column_s, out));
            }
            let joined = join(extent, before);
            let x = ((column + 0.5) * column_s - start_s) / column_s;
            out.points.push(Point { x: x as f32, low: joined.min, high: joined.max });
            previous = last;
        }
        from = to;
        column += 1.0;
    }
    out.close(run);
}

/// Fills those `columns` that hold no sample between `from` and `to` with the straight line
/// between them, each with its own stretch: one column that took the whole jump would become a filled wedge.
/// Returns what the next column is joined to.
fn bridge(
    from: (f64, f32),
    to: (f64, f32),
    columns: Range<f64>,
    start_s: f64,
    column_s: f64,
    out: &mut Decimated,
) -> (f64, f32) {
    let at = |time_s: f64| {
        let share = ((time_s - from.0) / (to.0 - from.0).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (time_s, from.1 + (to.1 - from.1) * share as f32)
    };
    let mut before = from;
    let mut empty = (from.0 / column_s).floor() + 1.0;
    if empty < columns.start {
        empty = columns.start;
        before = at(empty * column_s);
    }
    while empty < columns.end {
        let edge = at((empty + 1.0) * column_s);
        let extent = Extent::EMPTY.with(before.1).with(edge.1);
        let x = ((empty + 0.5) * column_s - start_s) / column_s;
        out.points.push(Point { x: x as f32, low: extent.min, high: extent.max });
        before = edge;
        empty += 1.0;
    }
    before
}

/// The segment from the column before is drawn in this column.
fn join(extent: Extent, previous: Option<(f64, f32)>) -> Extent {
    previous.map_or(extent, |(_, value)| extent.with(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: usize = 80;

    fn decimated(series: &Series, start_s: f64, end_s: f64, joined: Joined) -> Decimated {
        let mut out = Decimated::default();
        decimate(series, start_s, end_s, COLUMNS, joined, &mut out);
        out
    }

    /// What each column must hold, sample by sample, without pyramid or searching.
    fn brute(series: &Series, start_s: f64, end_s: f64) -> Vec<Point> {
        let width = (end_s - start_s) / COLUMNS as f64;
        let all: Vec<_> = series.samples(0..u64::MAX).collect();
        let inside: Vec<_> =
            all.iter().enumerate().filter(|(_, s)| s.0 >= start_s && s.0 <= end_s).map(|(i, _)| i).collect();
        let from = inside.first().map_or(0, |i| i.saturating_sub(1));
        let to = inside.last().map_or(0, |i| (i + 2).min(all.len()));
        let mut columns: Vec<(i64, Extent, f32)> = Vec::new();
        for (t, value) in &all[from..to] {
            let column = (t / width).floor() as i64;
            match columns.last_mut() {
                Some((c, extent, last)) if *c == column => {
                    *extent = extent.with(*value);
                    *last = *value;
                }
                _ => columns.push((column, Extent::EMPTY.with(*value), *value)),
            }
        }
        let mut previous = None;
        columns
            .into_iter()
            .map(|(column, extent, last)| {
                let extent = previous.map_or(extent, |p| extent.with(p));
                previous = Some(last);
                let x = ((column as f64 + 0.5) * width - start_s) / width;
                Point { x: x as f32, low: extent.min, high: extent.max }
            })
            .collect()
    }

    #[test]
    fn a_stretch_without_samples_is_a_line_and_no_wedge() {
        // 200 Hz for 2 s at 0, nothing for 0.5 s, 200 Hz at 1: 80 columns of 62.5 ms.
        let mut series = Series::new(10_000);
        for i in 0..400 {
            series.push(f64::from(i) * 0.005, 0.0);
        }
        for i in 500..900 {
            series.push(f64::from(i) * 0.005, 1.0);
        }
        let drawn = decimated(&series, 0.0, 5.0, Joined::Straight);
        assert!(drawn.envelope && drawn.runs.len() == 1);
        assert!(drawn.points.windows(2).all(|p| (p[1].x - p[0].x - 1.0).abs() < 1e-3), "columns are left out");
        let widest = drawn.points.iter().map(|p| p.high - p.low).fold(0.0, f32::max);
        // 1 over eight columns.
        assert!(widest < 0.3, "{widest}");
    }

    #[test]
    fn the_envelope_equals_brute_force_wherever_the_window_lies() {
        // Irregular times, a spike in one sample, a ring that has turned over.
        let mut series = Series::new(20_000);
        let mut time_s = 3600.0 * 5.0;
        for i in 0..50_000_u64 {
            time_s += 0.001 + 0.004 * ((i * 7919) % 11) as f64 / 11.0;
            let spike = if i == 43_210 { 100.0 } else { 0.0 };
            series.push(time_s, (i as f32 * 0.003).sin() + ((i * 31) % 17) as f32 * 0.01 + spike);
        }
        let (first_s, last_s) = series.time_span_s().unwrap();
        for (a, b) in [(0.0, 1.0), (0.3, 0.37), (-0.2, 0.5), (0.8, 1.4), (0.111, 0.9)] {
            let (start_s, end_s) = (first_s + a * (last_s - first_s), first_s + b * (last_s - first_s));
            let out = decimated(&series, start_s, end_s, Joined::Straight);
            assert!(out.envelope);
            assert_eq!(out.points, brute(&series, start_s, end_s), "{a}..{b}");
            assert_eq!(out.runs.as_slice(), std::slice::from_ref(&(0..out.points.len())));
        }
        let whole = decimated(&series, first_s, last_s, Joined::Straight);
        let top = whole.points.iter().fold(0.0, |top: f32, p| top.max(p.high));
        assert!(top > 99.0, "the spike must survive: {top}");
    }

    #[test]
    fn columns_keep_their_values_while_the_window_slides() {
        let series = Series::from_samples((0..10_000).map(|i| (f64::from(i) * 0.01, ((i * 37) % 101) as f32)));
        let a = decimated(&series, 20.0, 60.0, Joined::Straight);
        let b = decimated(&series, 20.25, 60.25, Joined::Straight);
        // Half a column further: the same envelopes, half a column to the left.
        let find = |x: f32| b.points.iter().find(|p| (p.x - x).abs() < 1e-3);
        for point in &a.points[2..a.points.len() - 2] {
            let same = find(point.x - 0.5).unwrap();
            assert_eq!((same.low, same.high), (point.low, point.high));
        }
    }

    #[test]
    fn few_samples_stay_themselves_and_setpoints_step() {
        let series = Series::from_samples([(0.0, 1.0), (1.0, 1.0), (2.0, 3.0), (3.0, 3.0)]);
        let straight = decimated(&series, 0.0, 4.0, Joined::Straight);
        assert_eq!(straight.points.iter().map(|p| p.low).collect::<Vec<_>>(), [1.0, 1.0, 3.0, 3.0]);
        assert!(!straight.envelope && straight.points.iter().all(|p| p.low == p.high));
        let held = decimated(&series, 0.0, 4.0, Joined::Held);
        let corners: Vec<_> = held.points.iter().map(|p| (p.x, p.low)).collect();
        assert_eq!(corners, [(0.0, 1.0), (20.0, 1.0), (40.0, 1.0), (40.0, 3.0), (60.0, 3.0)]);
    }

    #[test]
    fn holes_and_nan_break_the_line_dense_or_not() {
        for dense in [1, 50] {
            let n = 40 * dense;
            let mut series = Series::new(n).with_max_gap(2.5 / dense as f64);
            for i in 0..n {
                let time_s = i as f64 / dense as f64;
                // NaN for 5 s, then nothing at all for 5 s.
                if (20.0..25.0).contains(&time_s) {
                    continue;
                }
                series.push(time_s, if (10.0..15.0).contains(&time_s) { f32::NAN } else { 1.0 });
            }
            let out = decimated(&series, 0.0, 40.0, Joined::Straight);
            assert_eq!(out.envelope, dense == 50);
            assert_eq!(out.runs.len(), 3, "{:?}", out.runs);
            let ends: Vec<_> = out.runs.iter().map(|run| out.points[run.end - 1].x / 2.0).collect();
            for (end, expected) in ends.iter().zip([9.5, 19.5, 39.5]) {
                assert!((end - expected).abs() <= 0.51, "{ends:?}");
            }
        }
    }

    #[test]
    fn nothing_comes_of_nothing() {
        let mut out = decimated(&Series::new(4), 0.0, 1.0, Joined::Straight);
        assert!(out.points.is_empty() && out.runs.is_empty());
        let series = Series::from_samples([(0.0, 1.0)]);
        decimate(&series, 1.0, 1.0, 80, Joined::Straight, &mut out);
        assert!(out.points.is_empty());
        decimate(&series, 0.0, 1.0, 0, Joined::Straight, &mut out);
        assert!(out.points.is_empty());
    }
}

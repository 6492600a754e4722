//! A chart: grid, spans, curves, gates, marks and cursor.

use super::grid::{Plot, draw_cursor, draw_grid, draw_spans};
use super::line::Column;
use super::scene::{ChartView, Curve, Style};
use super::shape::Shapes;
use crate::model::axis::TimeAxis;
use crate::model::decimate::{Decimated, Joined, decimate};

/// Dots are drawn where samples are at least this far apart, CSS pixels.
const DOT_SPACING_PX: f32 = 4.0;
/// A column is left out where the straight way past it leads this close by, device pixels: a quarter of what a screen can show.
const STRAIGHT_PX: f32 = 0.25;
/// From this slope on a band is widened to keep its thickness (`Shapes::band`), so that a corner keeps its neighbours.
const STEEP: f32 = 0.35;

/// Buffers kept between frames.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    pub decimated: Decimated,
    columns: Vec<Column>,
    points: Vec<[f32; 2]>,
}

impl Style {
    fn width_px(self) -> f32 {
        match self {
            Style::Strong => 1.75,
            Style::Solid | Style::Step => 1.5,
            Style::Thin | Style::Points => 1.0,
            Style::Band => 0.0,
        }
    }
}

/// Draw a chart into its plot area.
pub(crate) fn draw_chart(shapes: &mut Shapes, scratch: &mut Scratch, plot: Plot, view: &ChartView<'_>) {
    let theme = &view.theme;
    draw_grid(shapes, plot, view.time, Some(view.value), view.time_origin_s, theme);
    draw_spans(shapes, plot, view.time, &view.spans);
    for level in &view.levels {
        let y = plot.y(view.value, level.value);
        if level.dashed {
            let y = y.round() + plot.hair() / 2.0;
            let dash = [4.0 * plot.scale, 4.0 * plot.scale];
            shapes.dashed([plot.left, y], [plot.right, y], plot.hair(), dash, level.color);
        } else {
            plot.across(shapes, y, level.color);
        }
    }
    for curve in &view.curves {
        draw_curve(shapes, scratch, plot, view, curve);
    }
    for mark in &view.marks {
        plot.down_dashed(shapes, plot.x(view.time, mark.time_s), mark.color);
    }
    draw_cursor(shapes, plot, view.time, view.cursor_s, theme);
}

fn draw_curve(shapes: &mut Shapes, scratch: &mut Scratch, plot: Plot, view: &ChartView<'_>, curve: &Curve<'_>) {
    let columns = plot.width() as usize;
    let joined = if curve.style == Style::Step { Joined::Held } else { Joined::Straight };
    decimate(curve.series, view.time.start_s, view.time.end_s, columns, joined, &mut scratch.decimated);
    let decimated = &scratch.decimated;
    let width = (curve.style.width_px() * plot.scale).max(1.0);
    let dots = curve.style == Style::Points && !decimated.envelope && sparse(decimated, plot);
    for run in &decimated.runs {
        let points = decimated.points.get(run.clone()).unwrap_or_default();
        // A negative scale swaps the borders.
        let y = |value: f32| plot.y(view.value, f64::from(value * curve.scale));
        scratch.columns.clear();
        scratch.columns.extend(points.iter().map(|point| {
            let low = if curve.style == Style::Band { -point.high } else { point.low };
            let (a, b) = (y(low), y(point.high));
            Column { x: plot.left + point.x, top: a.min(b), bottom: a.max(b) }
        }));
        let banded = decimated.envelope || curve.style == Style::Band;
        straighten(&mut scratch.columns, if banded { STEEP } else { f32::INFINITY });
        let pieces = match curve.dash.px() {
            Some(dash) => dashes(&scratch.columns, dash, view.time, plot),
            None => vec![scratch.columns.clone()],
        };
        for piece in &pieces {
            if banded {
                shapes.band(piece, width, curve.color);
                continue;
            }
            scratch.points.clear();
            scratch.points.extend(piece.iter().map(|column| [column.x, column.top]));
            let line = if dots { curve.color.alpha(0.45) } else { curve.color };
            shapes.polyline(&scratch.points, width, line);
            if dots || scratch.points.len() == 1 {
                for point in &scratch.points {
                    shapes.disc(*point, (1.75 * plot.scale).max(1.0), curve.color);
                }
            }
        }
    }
}

/// Leaves out columns past which the way between those that stay leads straight: a calm curve takes few triangles. Where it turns
/// `steep`ly the neighbours of a corner stay, too.
fn straighten(columns: &mut Vec<Column>, steep: f32) {
    // Least and greatest slope, of the upper border and of the lower, with which all since the last that stays are passed.
    const OPEN: [[f32; 2]; 2] = [[f32::NEG_INFINITY, f32::INFINITY]; 2];
    let rise = |from: Column, to: Column| {
        let run = to.x - from.x;
        (run > 0.0).then(|| ([(to.top - from.top) / run, (to.bottom - from.bottom) / run], STRAIGHT_PX / run))
    };
    let narrowed = |cone: [[f32; 2]; 2], from: Column, to: Column| {
        let (slopes, slack) = rise(from, to)?;
        let inside = cone.iter().zip(slopes).all(|([least, most], slope)| (*least..=*most).contains(&slope));
        let narrow = |n: usize| [cone[n][0].max(slopes[n] - slack), cone[n][1].min(slopes[n] + slack)];
        inside.then(|| [narrow(0), narrow(1)])
    };
    let Some(&first) = columns.first() else { return };
    let (mut kept, mut anchor, mut last, mut before) = (1, first, first, first);
    let (mut cone, mut passed) = (OPEN, 0);
    for i in 1..columns.len() {
        let column = columns[i];
        if let Some(narrower) = narrowed(cone, anchor, column) {
            (cone, passed) = (narrower, passed + 1);
        } else {
            let turns = |from: Column, to: Column| rise(from, to).is_none_or(|([a, b], _)| (a + b).abs() / 2.0 > steep);
            let corner = turns(before, last) || turns(last, column);
            // `last` stays, unless it is the one that stayed before.
            for stays in [(corner && passed > 1).then_some(before), (passed > 0).then_some(last)].into_iter().flatten()
            {
                columns[kept] = stays;
                kept += 1;
            }
            (anchor, cone, passed) = (last, OPEN, 0);
            if corner && let Some(further) = columns.get_mut(kept) {
                *further = column;
                kept += 1;
                anchor = column;
            } else {
                (cone, passed) = (narrowed(OPEN, anchor, column).unwrap_or(OPEN), 1);
            }
        }
        (before, last) = (last, column);
    }
    if passed > 0 {
        columns[kept] = last;
        kept += 1;
    }
    columns.truncate(kept);
}

/// Are samples far enough apart for dots?
fn sparse(decimated: &Decimated, plot: Plot) -> bool {
    let (Some(first), Some(last)) = (decimated.points.first(), decimated.points.last()) else { return false };
    (last.x - first.x) / decimated.points.len() as f32 >= DOT_SPACING_PX * plot.scale
}

/// Cut a curve into dashes. The pattern hangs on absolute time, so that it scrolls with the curve.
fn dashes(columns: &[Column], [on, off]: [f32; 2], time: TimeAxis, plot: Plot) -> Vec<Vec<Column>> {
    let [on, period] = [on * plot.scale, (on + off) * plot.scale];
    let px_per_s = f64::from(plot.width()) / time.span_s();
    let phase = (time.start_s * px_per_s).rem_euclid(f64::from(period)) as f32 - plot.left;
    let mut pieces = Vec::new();
    let mut piece: Vec<Column> = Vec::new();
    let mut finish = |piece: &mut Vec<Column>| {
        if piece.len() > 1 {
            pieces.push(std::mem::take(piece));
        }
        piece.clear();
    };
    for pair in columns.windows(2) {
        let &[a, b] = pair else { continue };
        // Borders of dashes between a and b, in order; the segment is cut at each.
        let (from, to) = (a.x + phase, b.x + phase);
        let mut at = from;
        let mut start = a;
        while at <= to {
            let within = at.rem_euclid(period);
            let (visible, next) = if within < on { (true, at - within + on) } else { (false, at - within + period) };
            let stop = next.min(to);
            let end = between(a, b, if to > from { (stop - from) / (to - from) } else { 1.0 });
            if visible {
                if piece.is_empty() {
                    piece.push(start);
                }
                piece.push(end);
            }
            if next > to {
                break;
            }
            if visible {
                finish(&mut piece);
            }
            // Always forward, whatever rounding does.
            at = next.max(at + period * 1e-3);
            start = end;
        }
    }
    finish(&mut piece);
    pieces
}

fn between(a: Column, b: Column, share: f32) -> Column {
    let one = |a: f32, b: f32| a + (b - a) * share;
    Column { x: one(a.x, b.x), top: one(a.top, b.top), bottom: one(a.bottom, b.bottom) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::color::{Color, Theme};
    use crate::gpu::scene::Rect;
    use crate::model::axis::ValueAxis;
    use crate::model::series::Series;

    const PLOT: Plot = Plot { left: 100.0, top: 50.0, right: 900.0, bottom: 550.0, scale: 1.0 };

    fn drawn(series: &Series, style: Style, time: TimeAxis) -> Shapes {
        let view =
            ChartView::new(time, ValueAxis::new(0.0, 1.0), Theme::LIGHT).curve(series, Color::hex(0x123456), style);
        let mut shapes = Shapes::default();
        draw_chart(&mut shapes, &mut Scratch::default(), PLOT, &view);
        shapes
    }

    /// Vertices of the curve alone.
    fn curve_vertices(shapes: &Shapes) -> Vec<[f32; 2]> {
        let color = Color::hex(0x123456).packed();
        shapes.vertices().iter().filter(|v| v.color == color).map(|v| v.position).collect()
    }

    #[test]
    fn a_flat_curve_lies_at_its_value_after_days_of_flight() {
        let origin = 5.0e5;
        let vertices = |value: fn(i32) -> f32| {
            let series = Series::from_samples((0..1000).map(|i| (origin + f64::from(i) * 0.01, value(i))));
            curve_vertices(&drawn(&series, Style::Solid, TimeAxis::new(origin, origin + 9.99)))
        };
        let flat = vertices(|_| 0.25);
        let y = 550.0 - 0.25 * 500.0;
        assert!(flat.iter().all(|v| (v[1] - y).abs() <= 1.3), "{:?}", &flat[..4]);
        let (left, right) = flat.iter().fold((f32::MAX, f32::MIN), |(l, r), v| (l.min(v[0]), r.max(v[0])));
        assert!((left - 100.0).abs() < 1.0 && (right - 900.0).abs() < 1.0, "{left} {right}");
        // From sample to sample 2 px up and down nothing can be left out. Evenly spread: f32 times would fall into clumps.
        let mut xs: Vec<_> = vertices(|i| 0.25 + 0.004 * (i % 2) as f32).iter().map(|v| v[0]).collect();
        assert!(xs.len() > 500);
        xs.sort_by(f32::total_cmp);
        xs.dedup();
        assert!(xs.windows(2).all(|w| w[1] - w[0] < 1.6), "uneven columns");
    }

    #[test]
    fn a_hundred_thousand_samples_cost_two_vertices_per_column_at_most() {
        let count = |value: fn(i32) -> f32| {
            let series = Series::from_samples((0..100_000).map(|i| (f64::from(i) * 0.001, value(i))));
            curve_vertices(&drawn(&series, Style::Solid, TimeAxis::new(0.0, 100.0))).len()
        };
        let noisy =
            count(|i| (i.wrapping_mul(7919) % 1009).unsigned_abs() as f32 / 1009.0 * ((i / 125) % 7) as f32 / 7.0);
        assert!((1200..1620).contains(&noisy), "{noisy}");
        let flat = count(|i| (i % 10) as f32 * 0.1);
        assert!(flat < 20, "{flat}");
    }

    #[test]
    fn what_is_left_out_lies_on_the_way_past_it() {
        // A walk of calm stretches, slopes and jumps, envelopes of a width that changes.
        let (mut at, mut state) = (200.0_f32, 1_u32);
        let mut draw = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let columns: Vec<Column> = (0..4000)
            .map(|i| {
                at += match (i / 200) % 4 {
                    0 => 0.0,
                    1 => 0.7,
                    2 => 0.2 * (draw() - 0.5),
                    _ => 40.0 * (draw() - 0.5),
                };
                let wide = if (i / 500) % 2 == 0 { 0.0 } else { 3.0 * draw() };
                Column { x: i as f32 * 1.25 + 0.3 * draw(), top: at - wide, bottom: at + wide }
            })
            .collect();
        for steep in [STEEP, f32::INFINITY] {
            let mut kept = columns.clone();
            straighten(&mut kept, steep);
            assert!(kept.len() < columns.len() * 3 / 4, "{} of {}", kept.len(), columns.len());
            assert_eq!((kept.first(), kept.last()), (columns.first(), columns.last()));
            let mut next = 1;
            for column in &columns {
                while kept[next].x < column.x {
                    next += 1;
                }
                let [a, b] = [kept[next - 1], kept[next]];
                let on_the_way = between(a, b, (column.x - a.x) / (b.x - a.x));
                let off = (on_the_way.top - column.top).abs().max((on_the_way.bottom - column.bottom).abs());
                assert!(off < 2.0 * STRAIGHT_PX, "{off} px at {}", column.x);
            }
        }
    }

    #[test]
    fn dashes_cover_their_share_and_scroll_with_the_curve() {
        let series = Series::from_samples((0..400).map(|i| (f64::from(i) * 0.1, 0.5)));
        let length = |start_s: f64| {
            let time = TimeAxis::new(start_s, start_s + 20.0);
            let plot = Plot::new(Rect::new(0.0, 0.0, 800.0, 100.0), 1.0);
            let mut decimated = Decimated::default();
            decimate(&series, time.start_s, time.end_s, 800, Joined::Straight, &mut decimated);
            let columns: Vec<_> = decimated.points.iter().map(|p| Column { x: p.x, top: 50.0, bottom: 50.0 }).collect();
            let pieces = dashes(&columns, [7.0, 4.0], time, plot);
            let starts: Vec<f64> = pieces.iter().map(|p| time.time_s(f64::from(p[0].x) / 800.0)).collect();
            let covered: f32 = pieces.iter().map(|p| p[p.len() - 1].x - p[0].x).sum();
            (covered, starts)
        };
        let (covered, starts) = length(5.0);
        assert!((covered / 800.0 - 7.0 / 11.0).abs() < 0.02, "{covered}");
        let (_, later) = length(5.35);
        // A dash begins at the same moment of flight in both windows.
        let middle = starts[starts.len() / 2];
        assert!(later.iter().any(|s| (s - middle).abs() < 2e-3), "{middle} not among {later:?}");
    }

    #[test]
    fn a_band_reaches_as_far_down_as_up() {
        let series = Series::from_samples((0..100).map(|i| (f64::from(i) * 0.1, 0.25)));
        let view = ChartView::new(TimeAxis::new(0.0, 9.9), ValueAxis::new(-1.0, 1.0), Theme::LIGHT);
        let view = view.curve(&series, Color::hex(0x123456), Style::Band);
        let mut shapes = Shapes::default();
        draw_chart(&mut shapes, &mut Scratch::default(), PLOT, &view);
        let ys: Vec<f32> = curve_vertices(&shapes).iter().map(|v| v[1]).collect();
        let (top, bottom) = ys.iter().fold((f32::MAX, f32::MIN), |(a, b), y| (a.min(*y), b.max(*y)));
        assert!((top - 237.5).abs() < 1.5 && (bottom - 362.5).abs() < 1.5, "{top} {bottom}");
    }

    #[test]
    fn a_lone_sample_is_a_dot() {
        let series = Series::from_samples([(5.0, 0.5)]);
        let vertices = curve_vertices(&drawn(&series, Style::Solid, TimeAxis::new(0.0, 10.0)));
        assert!(!vertices.is_empty());
        assert!(vertices.iter().all(|v| (v[0] - 500.0).abs() < 4.0 && (v[1] - 300.0).abs() < 4.0));
    }
}

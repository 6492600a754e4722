//! Residuals at a glance: a row per residual, a bar per column of time.
//!
//! Height and colour both tell the innovation ratio, so that nobody needs to tell colours apart: a
//! bar that fills its row touched the gate. The largest ratio of a column decides; a single rejected
//! measurement in ten minutes stays visible.

use super::chart::Scratch;
use super::color::{Color, Theme};
use super::grid::{Plot, draw_cursor, draw_grid, draw_spans};
use super::scene::HeatmapView;
use super::shape::Shapes;
use crate::model::decimate::{Joined, decimate};

/// Width of a column, CSS pixels.
const COLUMN_PX: f32 = 2.0;
/// How long a sample fills its row when the series names no largest gap, s.
const HOLD_S: f64 = 0.5;

/// Half the gate.
const NOTICE: f32 = 0.5;
/// Close to the gate.
const WARN: f32 = 0.8;

/// Colour of an innovation ratio, the same everywhere on the page.
pub fn ratio_color(ratio: f32, theme: &Theme) -> Color {
    let calm = if theme.dark { Color::hex(0x4c6a86) } else { Color::hex(0x8fa9c0) };
    if ratio < NOTICE {
        calm
    } else if ratio < WARN {
        Color::hex(0xe69f00)
    } else if ratio <= 1.0 {
        Color::hex(0xd55e00)
    } else if theme.dark {
        Color::hex(0xff4d6d)
    } else {
        Color::hex(0xb00e3a)
    }
}

/// One bar, widened as long as its neighbours look the same.
#[derive(Clone, Copy, PartialEq)]
struct Bar {
    from: f32,
    to: f32,
    height: f32,
    color: Color,
}

/// Draw the rows into their plot area.
pub(crate) fn draw_heatmap(shapes: &mut Shapes, scratch: &mut Scratch, plot: Plot, view: &HeatmapView<'_>) {
    let theme = &view.theme;
    draw_grid(shapes, plot, view.time, None, view.time_origin_s, theme);
    draw_spans(shapes, plot, view.time, &view.spans);
    let row_height = plot.height() / view.rows.len().max(1) as f32;
    for (i, row) in view.rows.iter().enumerate() {
        let top = (plot.top + i as f32 * row_height).round();
        let bottom = (plot.top + (i + 1) as f32 * row_height).round();
        if row.group_start && i > 0 {
            plot.across(shapes, top, theme.axis.alpha(0.6));
        }
        let air = if bottom - top > 6.0 * plot.scale { plot.hair() } else { 0.0 };
        draw_row(shapes, scratch, plot, view, row.ratio, [top + air, bottom - air]);
    }
    draw_cursor(shapes, plot, view.time, view.cursor_s, theme);
}

fn draw_row(
    shapes: &mut Shapes,
    scratch: &mut Scratch,
    plot: Plot,
    view: &HeatmapView<'_>,
    ratio: &crate::model::series::Series,
    [top, bottom]: [f32; 2],
) {
    let column_px = COLUMN_PX * plot.scale;
    let columns = (plot.width() / column_px).floor().max(1.0) as usize;
    let px = plot.width() / columns as f32;
    decimate(ratio, view.time.start_s, view.time.end_s, columns, Joined::Straight, &mut scratch.decimated);
    let hold_s = if ratio.max_gap_s().is_finite() { ratio.max_gap_s() } else { HOLD_S };
    let hold = (hold_s / view.time.span_s() * columns as f64) as f32;
    let points = &scratch.decimated.points;
    let mut open: Option<Bar> = None;
    // Bars that touch are one strip.
    let mut end = f32::NEG_INFINITY;
    let mut draw = |bar: Bar| {
        let (from, to) = (bar.from.max(plot.left), bar.to.min(plot.right));
        if to <= from {
            return;
        }
        if from != end {
            shapes.lift();
        }
        for x in [from, to] {
            shapes.inside([x, bottom - bar.height], bar.color);
            shapes.inside([x, bottom], bar.color);
        }
        end = to;
    };
    for (i, point) in points.iter().enumerate() {
        let next = points.get(i + 1).map_or(f32::INFINITY, |next| next.x);
        let (from, to) = if scratch.decimated.envelope {
            (point.x - 0.5, if next - point.x < hold.max(1.5) { next - 0.5 } else { point.x + 0.5 })
        } else {
            (point.x, next.min(point.x + hold.max(1.0)))
        };
        let full = bottom - top;
        let height = (point.high.clamp(0.0, 1.0) * full).round().max(plot.hair()).min(full.max(0.0));
        let edge = |x: f32| (plot.left + x * px).round();
        let bar = Bar { from: edge(from), to: edge(to), height, color: ratio_color(point.high, &view.theme) };
        match &mut open {
            Some(last) if last.height == bar.height && last.color == bar.color && bar.from <= last.to => {
                last.to = bar.to.max(last.to);
            }
            _ => {
                if let Some(done) = open.replace(bar) {
                    draw(done);
                }
            }
        }
    }
    if let Some(done) = open {
        draw(done);
    }
    shapes.lift();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::scene::HeatRow;
    use crate::model::axis::TimeAxis;
    use crate::model::series::Series;

    #[test]
    fn one_rejected_measurement_among_many_stays_visible_and_calm_rows_are_cheap() {
        let plot = Plot { left: 0.0, top: 0.0, right: 800.0, bottom: 40.0, scale: 1.0 };
        let calm = Series::from_samples((0..60_000).map(|i| (f64::from(i) * 0.01, 0.02)));
        let spiked =
            Series::from_samples((0..60_000).map(|i| (f64::from(i) * 0.01, if i == 31_234 { 1.7 } else { 0.02 })));
        let rows = vec![HeatRow { ratio: &calm, group_start: true }, HeatRow { ratio: &spiked, group_start: true }];
        let view = HeatmapView {
            time: TimeAxis::new(0.0, 600.0),
            rows,
            spans: Vec::new(),
            cursor_s: None,
            time_origin_s: 0.0,
            theme: Theme::LIGHT,
        };
        let mut shapes = Shapes::default();
        draw_heatmap(&mut shapes, &mut Scratch::default(), plot, &view);
        let of = |ratio: f32| {
            let color = ratio_color(ratio, &Theme::LIGHT).packed();
            shapes.vertices().iter().filter(|v| v.color == color).map(|v| v.position).collect::<Vec<_>>()
        };
        let (quiet, rejected) = (of(0.02), of(1.7));
        assert!(quiet.len() < 40, "{} vertices for calm rows", quiet.len());
        let x = 31_234.0 * 0.01 / 600.0 * 800.0;
        assert!(!rejected.is_empty());
        assert!(rejected.iter().all(|p| (p[0] - x).abs() < 6.0 && p[1] >= 20.0), "{rejected:?}");
        // It fills its row but for the hairline above and below.
        let tallest = rejected.iter().fold(f32::MAX, |y, p| y.min(p[1]));
        assert!(tallest <= 21.0, "{tallest}");
    }
}

//! The ground every chart stands on: plot area, grid lines, shaded spans, cursor.

use super::color::{Color, Theme};
use super::scene::{Rect, Span};
use super::shape::Shapes;
use crate::model::axis::{TimeAxis, ValueAxis};

/// Ticks are at least this far apart, CSS pixels. The page uses the same figures for its labels.
pub const VALUE_TICK_SPACING_PX: f64 = 36.0;
/// See [`VALUE_TICK_SPACING_PX`].
pub const TIME_TICK_SPACING_PX: f64 = 90.0;

/// Opacity of the inside of a shaded span.
const SPAN_OPACITY: f32 = 0.13;

/// A plot area in device pixels, on whole pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plot {
    pub left: f32,
    pub top: f32,
    pub right: f32,
    pub bottom: f32,
    /// Device pixels per CSS pixel.
    pub scale: f32,
}

impl Plot {
    pub fn new(rect: Rect, scale: f32) -> Self {
        let [left, top] = [rect.x, rect.y].map(|p| (p * scale).round());
        let right = ((rect.x + rect.width) * scale).round().max(left);
        let bottom = ((rect.y + rect.height) * scale).round().max(top);
        Self { left, top, right, bottom, scale }
    }

    pub fn width(self) -> f32 {
        self.right - self.left
    }

    pub fn height(self) -> f32 {
        self.bottom - self.top
    }

    pub fn edges(self) -> [f32; 4] {
        [self.left, self.top, self.right, self.bottom]
    }

    /// Horizontal place of a time.
    pub fn x(self, time: TimeAxis, time_s: f64) -> f32 {
        self.left + (time.fraction(time_s).clamp(-1.0, 2.0) * f64::from(self.width())) as f32
    }

    /// Vertical place of a value.
    pub fn y(self, axis: ValueAxis, value: f64) -> f32 {
        self.bottom - (axis.fraction(value).clamp(-10.0, 11.0) * f64::from(self.height())) as f32
    }

    /// Width of the thinnest crisp line: one CSS pixel in whole device pixels.
    pub fn hair(self) -> f32 {
        self.scale.floor().max(1.0)
    }

    /// A crisp horizontal hairline.
    pub fn across(self, shapes: &mut Shapes, y: f32, color: Color) {
        let top = (y - self.hair() / 2.0).round();
        shapes.rect([self.left, top, self.right, top + self.hair()], color);
    }

    /// A crisp vertical hairline; none outside the plot.
    pub fn down(self, shapes: &mut Shapes, x: f32, color: Color) {
        let left = (x - self.hair() / 2.0).round();
        if left + self.hair() >= self.left && left <= self.right {
            shapes.rect([left, self.top, left + self.hair(), self.bottom], color);
        }
    }

    /// A dashed vertical hairline.
    pub fn down_dashed(self, shapes: &mut Shapes, x: f32, color: Color) {
        let x = x.round() + self.hair() / 2.0;
        if (self.left..=self.right).contains(&x) {
            shapes.dashed([x, self.top], [x, self.bottom], self.hair(), [4.0 * self.scale, 3.0 * self.scale], color);
        }
    }
}

/// Plot area and grid lines, at the ticks that the page labels.
pub(crate) fn draw_grid(
    shapes: &mut Shapes,
    plot: Plot,
    time: TimeAxis,
    value: Option<ValueAxis>,
    origin_s: f64,
    theme: &Theme,
) {
    shapes.rect(plot.edges(), theme.plot);
    let css = |device: f32| f64::from(device / plot.scale);
    for tick in time.ticks(css(plot.width()), TIME_TICK_SPACING_PX, origin_s) {
        plot.down(shapes, plot.x(time, tick.value), theme.grid);
    }
    let Some(value) = value else { return };
    for tick in value.ticks(css(plot.height()), VALUE_TICK_SPACING_PX) {
        let zero = tick.value.abs() < 1e-9 * value.span();
        plot.across(shapes, plot.y(value, tick.value), if zero { theme.axis } else { theme.grid });
    }
}

/// The inside of shaded spans: below the curves.
pub(crate) fn draw_spans(shapes: &mut Shapes, plot: Plot, time: TimeAxis, spans: &[Span]) {
    for span in spans {
        let left = plot.x(time, span.start_s).max(plot.left);
        let right = plot.x(time, span.end_s.min(time.end_s + time.span_s())).min(plot.right);
        if right <= left {
            continue;
        }
        if span.planned {
            hatch(shapes, [left, plot.top, right, plot.bottom], plot.scale, span.color.alpha(0.35));
        } else {
            shapes.rect([left, plot.top, right, plot.bottom], span.color.alpha(SPAN_OPACITY));
        }
        plot.down(shapes, plot.x(time, span.start_s), span.color.alpha(0.7));
        if span.end_s <= time.end_s {
            plot.down(shapes, plot.x(time, span.end_s), span.color.alpha(0.7));
        }
    }
}

/// Diagonal lines cut to a rectangle.
fn hatch(shapes: &mut Shapes, [left, top, right, bottom]: [f32; 4], scale: f32, color: Color) {
    let step = 8.0 * scale;
    // Lines x + y = sum, on fixed sums so that they do not crawl along a growing span.
    let mut sum = ((left + top) / step).ceil() * step;
    while sum < right + bottom {
        let a = [(sum - top).min(right), (sum - right).max(top)];
        let b = [(sum - bottom).max(left), (sum - left).min(bottom)];
        shapes.line(a, b, scale, color);
        sum += step;
    }
}

/// The cursor: above the curves.
pub(crate) fn draw_cursor(shapes: &mut Shapes, plot: Plot, time: TimeAxis, cursor_s: Option<f64>, theme: &Theme) {
    if let Some(cursor_s) = cursor_s {
        plot.down(shapes, plot.x(time, cursor_s), theme.ink.alpha(0.55));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inside(shapes: &Shapes, edges: [f32; 4], border: f32) -> bool {
        shapes.vertices().iter().all(|v| {
            (edges[0] - border..=edges[2] + border).contains(&v.position[0])
                && (edges[1] - border..=edges[3] + border).contains(&v.position[1])
        })
    }

    #[test]
    fn spans_stay_inside_the_plot_whatever_their_times() {
        let plot = Plot::new(Rect::new(10.0, 10.0, 300.0, 100.0), 2.0);
        let time = TimeAxis::new(100.0, 110.0);
        let span = |start_s, end_s, planned| Span { start_s, end_s, color: Color::hex(0xd55e00), planned };
        for planned in [false, true] {
            for (start_s, end_s) in
                [(0.0, f64::INFINITY), (102.0, 104.0), (-5.0, 101.0), (109.0, 1e9), (0.0, 1.0), (200.0, 300.0)]
            {
                let mut shapes = Shapes::default();
                draw_spans(&mut shapes, plot, time, &[span(start_s, end_s, planned)]);
                assert!(inside(&shapes, plot.edges(), 2.0 + 2.0), "{start_s} {end_s} {planned}");
                let visible = start_s < 110.0 && end_s > 100.0;
                assert_eq!(!shapes.vertices().is_empty(), visible, "{start_s} {end_s} {planned}");
            }
        }
    }
}

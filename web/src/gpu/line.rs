//! Strokes: lines of any width with smooth edges, and the band of a decimated curve.
//!
//! A stroke is a strip of two vertices per point, pushed apart along the normal by half its width
//! and half a pixel more for the soft border. Sharp corners are bevelled.

use super::color::Color;
use super::shape::Shapes;

/// Corners sharper than this (cosine of half the turn) are bevelled.
const MITRE_LIMIT: f32 = 0.6;

/// Steepest slope for which a band's border is widened, to keep its thickness.
const STEEPEST: f32 = 8.0;

/// One column of a band, in device pixels, y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Middle of the column.
    pub x: f32,
    /// Upper border (the smaller y).
    pub top: f32,
    /// Lower border.
    pub bottom: f32,
}

impl Column {
    fn middle(self) -> f32 {
        (self.top + self.bottom) / 2.0
    }
}

/// Unit normal of the segment from `a` to `b`; `None` when they coincide.
fn normal(a: [f32; 2], b: [f32; 2]) -> Option<[f32; 2]> {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let length = x.hypot(y);
    (length > 1e-6).then(|| [-y / length, x / length])
}

impl Shapes {
    /// A straight line.
    pub fn line(&mut self, a: [f32; 2], b: [f32; 2], width: f32, color: Color) {
        self.polyline(&[a, b], width, color);
    }

    /// A line through points.
    pub fn polyline(&mut self, points: &[[f32; 2]], width: f32, color: Color) {
        let half = width / 2.0;
        self.lift();
        let mut before: Option<[f32; 2]> = None;
        for (i, &point) in points.iter().enumerate() {
            // Points that repeat give no direction: look for the next that differs.
            let after = points[i + 1..].iter().find_map(|next| normal(point, *next));
            match (before, after) {
                (Some(n0), Some(n1)) => {
                    let sum = [n0[0] + n1[0], n0[1] + n1[1]];
                    let cos_half = sum[0].hypot(sum[1]) / 2.0;
                    if cos_half > MITRE_LIMIT {
                        let stretch = 1.0 / (2.0 * cos_half * cos_half);
                        self.pair(point, [sum[0] * stretch, sum[1] * stretch], half, color);
                    } else {
                        self.pair(point, n0, half, color);
                        self.pair(point, n1, half, color);
                    }
                }
                (Some(n), None) | (None, Some(n)) => self.pair(point, n, half, color),
                (None, None) => {}
            }
            before = after.or(before);
        }
        self.lift();
    }

    /// The two vertices of a stroke at one point.
    fn pair(&mut self, [x, y]: [f32; 2], [nx, ny]: [f32; 2], half: f32, color: Color) {
        let reach = half + 0.5;
        self.vertex([x + nx * reach, y + ny * reach], color, [reach, half]);
        self.vertex([x - nx * reach, y - ny * reach], color, [-reach, half]);
    }

    /// An arc about a centre; angles in rad, clockwise from the right (y is down).
    pub fn arc(&mut self, centre: [f32; 2], radius: f32, from: f32, to: f32, width: f32, color: Color) {
        let steps = ((to - from).abs() * radius.sqrt() * 1.5).ceil().clamp(2.0, 128.0) as usize;
        let points: Vec<_> = (0..=steps)
            .map(|i| {
                let (sin, cos) = (from + (to - from) * i as f32 / steps as f32).sin_cos();
                [centre[0] + radius * cos, centre[1] + radius * sin]
            })
            .collect();
        self.polyline(&points, width, color);
    }

    /// A line of dashes along a straight line.
    pub fn dashed(&mut self, a: [f32; 2], b: [f32; 2], width: f32, [on, off]: [f32; 2], color: Color) {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let at = |s: f32| [a[0] + (b[0] - a[0]) * s / length, a[1] + (b[1] - a[1]) * s / length];
        let period = (on + off).max(1.0);
        // Bounded: no screen is that long.
        for i in 0..((length / period).ceil().clamp(0.0, 10_000.0) as usize) {
            let start = i as f32 * period;
            self.line(at(start), at((start + on).min(length)), width, color);
        }
    }

    /// The band between the borders of neighbouring columns, nowhere thinner than `width` measured
    /// across its direction.
    pub fn band(&mut self, columns: &[Column], width: f32, color: Color) {
        self.lift();
        if let [only] = columns {
            // A single column has no direction: a stub as long as wide.
            let half = width / 2.0;
            let top = only.top.min(only.middle() - half);
            let bottom = only.bottom.max(only.middle() + half);
            self.rect([only.x - half, top, only.x + half, bottom], color);
            return;
        }
        for (i, &column) in columns.iter().enumerate() {
            let slope = |a: &Column, b: &Column| (b.middle() - a.middle()) / (b.x - a.x).max(1e-3);
            let before = i.checked_sub(1).map(|i| slope(&columns[i], &column));
            let after = columns.get(i + 1).map(|next| slope(&column, next));
            let slope = match (before, after) {
                // A corner or a peak belongs to its flatter side, else it would spill over.
                (Some(a), Some(b)) if a * b > 0.0 => a.abs().min(b.abs()),
                (Some(_), Some(_)) => 0.0,
                (one, other) => one.or(other).unwrap_or(0.0).abs(),
            };
            // An end of a run knows one side only; a column as flat as this is not that steep.
            let slope = slope.min(column.bottom - column.top).min(STEEPEST);
            // Pixels up and down per pixel across the band.
            let steep = 1.0_f32.hypot(slope);
            let half = ((column.bottom - column.top) / 2.0 / steep).max(width / 2.0);
            let reach = half + 0.5;
            self.vertex([column.x, column.middle() - reach * steep], color, [-reach, half]);
            self.vertex([column.x, column.middle() + reach * steep], color, [reach, half]);
        }
        self.lift();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Color = Color::hex(0);

    fn bounds(shapes: &Shapes) -> [f32; 4] {
        shapes.vertices().iter().fold([f32::MAX, f32::MAX, f32::MIN, f32::MIN], |b, v| {
            [b[0].min(v.position[0]), b[1].min(v.position[1]), b[2].max(v.position[0]), b[3].max(v.position[1])]
        })
    }

    #[test]
    fn a_line_is_as_wide_as_asked_plus_its_soft_border() {
        let mut shapes = Shapes::default();
        shapes.line([0.0, 10.0], [50.0, 10.0], 2.0, BLACK);
        assert_eq!(bounds(&shapes), [0.0, 8.5, 50.0, 11.5]);
    }

    #[test]
    fn mitres_meet_and_spikes_stay_short() {
        let mut shapes = Shapes::default();
        shapes.polyline(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]], 2.0, BLACK);
        // A right angle: the outer corner lies a half width (and border) out on both axes.
        let [_, top, right, _] = bounds(&shapes);
        assert!((top + 1.5).abs() < 1e-4 && (right - 11.5).abs() < 1e-4);
        let mut spike = Shapes::default();
        spike.polyline(&[[0.0, 100.0], [1.0, 0.0], [2.0, 100.0]], 2.0, BLACK);
        assert!(bounds(&spike)[1] >= -1.5, "{:?}", bounds(&spike));
    }

    #[test]
    fn repeated_points_do_no_harm() {
        let mut shapes = Shapes::default();
        shapes.polyline(&[[0.0, 0.0], [0.0, 0.0], [5.0, 0.0], [5.0, 0.0]], 1.0, BLACK);
        assert!(shapes.vertices().iter().all(|v| v.position.iter().all(|p| p.is_finite())));
        assert_eq!(bounds(&shapes), [0.0, -1.0, 5.0, 1.0]);
        let mut nothing = Shapes::default();
        nothing.polyline(&[[3.0, 3.0], [3.0, 3.0]], 1.0, BLACK);
        nothing.polyline(&[], 1.0, BLACK);
        assert!(nothing.vertices().is_empty());
    }

    #[test]
    fn a_band_covers_its_columns_and_keeps_a_least_width() {
        let column = |x: f32, top: f32, bottom: f32| Column { x, top, bottom };
        let mut flat = Shapes::default();
        flat.band(&[column(0.5, 10.0, 10.0), column(1.5, 10.0, 10.0), column(2.5, 10.0, 10.0)], 1.5, BLACK);
        assert_eq!(bounds(&flat), [0.5, 8.75, 2.5, 11.25]);
        let mut noisy = Shapes::default();
        noisy.band(&[column(0.5, 5.0, 25.0), column(1.5, 4.0, 26.0), column(2.5, 5.0, 25.0)], 1.5, BLACK);
        assert_eq!(bounds(&noisy), [0.5, 3.5, 2.5, 26.5]);
        // A jump inside one column: its corners spill over by no more than the soft border.
        let mut jump = Shapes::default();
        jump.band(&[column(0.5, 0.0, 0.0), column(1.5, 0.0, 100.0), column(2.5, 100.0, 100.0)], 1.5, BLACK);
        let [_, top, _, bottom] = bounds(&jump);
        assert!(top > -5.0 && bottom < 105.0, "{top} {bottom}");
    }
}

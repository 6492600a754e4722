//! Pictures of a report, as SVG text.

use std::fmt::Write as _;

use plumbline_rest::experiment::Spread;

use super::{escape, number};

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 60.0;
const TOP: f64 = 12.0;
/// Okabe–Ito, readable with every kind of colour vision.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a7a00"];

/// One flight.
pub(super) struct Dot {
    pub(super) value: f64,
    pub(super) lost: bool,
    pub(super) link: String,
    pub(super) says: String,
}

/// One condition.
pub(super) struct Column {
    pub(super) label: String,
    pub(super) spread: Option<Spread>,
    pub(super) dots: Vec<Dot>,
}

/// A point of a curve.
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) interval: [f64; 2],
}

/// A value's place on an axis; logarithmic where values span more than 30 times.
#[derive(Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64> + Clone) -> Self {
        let finite = values.filter(|value| value.is_finite());
        let low = finite.clone().fold(f64::INFINITY, f64::min);
        let high = finite.fold(f64::NEG_INFINITY, f64::max);
        if low > 0.0 && high / low > 30.0 {
            Self { low, high, log: true }
        } else {
            let low = low.min(0.0);
            Self { low, high: if high > low { high } else { low + 1.0 }, log: false }
        }
    }

    /// 0 to 1.
    fn place(self, value: f64) -> f64 {
        let (low, high, value) =
            if self.log { (self.low.ln(), self.high.ln(), value.ln()) } else { (self.low, self.high, value) };
        ((value - low) / (high - low)).clamp(0.0, 1.0)
    }

    fn at(self, part: f64) -> f64 {
        if self.log { self.low * (self.high / self.low).powf(part) } else { self.low + (self.high - self.low) * part }
    }
}

fn begin(what: &str, height: f64) -> String {
    format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=img aria-label=\"{}\">", escape(what))
}

fn ticks(out: &mut String, axis: Axis) {
    for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let y = TOP + HEIGHT * (1.0 - part);
        let _ = write!(
            out,
            "<line class=axis x1={LEFT} x2={WIDTH} y1={y:.1} y2={y:.1} /><text x={:.0} y={:.1} text-anchor=end>{}</text>",
            LEFT - 6.0,
            y + 4.0,
            number(axis.at(part)),
        );
    }
}

/// A box for each column, and its dots.
pub(super) fn boxes(what: &str, columns: &[Column]) -> String {
    let most = columns.iter().flat_map(|column| column.dots.iter().map(|dot| dot.value));
    let spreads = columns.iter().filter_map(|column| column.spread).flat_map(|spread| [spread.least, spread.most]);
    let axis = Axis::over(most.chain(spreads).collect::<Vec<_>>().into_iter());
    let mut out = begin(what, TOP + HEIGHT + 150.0);
    ticks(&mut out, axis);
    let y = |value: f64| TOP + HEIGHT * (1.0 - axis.place(value));
    let wide = (WIDTH - LEFT) / columns.len().max(1) as f64;
    for (at, column) in columns.iter().enumerate() {
        let middle = LEFT + wide * (at as f64 + 0.5);
        let half = (0.3 * wide).min(30.0);
        for (nth, dot) in column.dots.iter().enumerate() {
            // Beside each other by turns of the golden ratio, so that neighbours in time are not neighbours here.
            let aside = ((nth as f64 * 0.618_034) % 1.0 - 0.5) * 2.0 * half;
            let class = if dot.lost { "dot lost" } else { "dot" };
            let _ = write!(
                out,
                "<a href=\"{}\" target=_blank><circle class=\"{class}\" cx={:.1} cy={:.1} r=3><title>{}</title></circle></a>",
                dot.link,
                middle + aside,
                y(dot.value),
                escape(&dot.says),
            );
        }
        if let Some(s) = column.spread {
            let (left, right) = (middle - half, middle + half);
            let (q1, q3, m) = (y(s.quarter), y(s.three_quarters), y(s.median));
            let _ = write!(
                out,
                "<path class=box d=\"M{middle:.1} {:.1}V{q3:.1}M{middle:.1} {q1:.1}V{:.1}M{left:.1} {q1:.1}H{right:.1}V{q3:.1}H{left:.1}Z\" />\
                 <path class=box stroke-width=3 d=\"M{left:.1} {m:.1}H{right:.1}\" />",
                y(s.most),
                y(s.least),
            );
        }
        let foot = TOP + HEIGHT + 14.0;
        let _ = write!(
            out,
            "<text x={middle:.1} y={foot:.1} text-anchor=end transform=\"rotate(-35 {middle:.1} {foot:.1})\">{}</text>",
            escape(&column.label),
        );
    }
    out + "</svg>"
}

/// Curves with intervals.
pub(super) fn curves(x: &str, what: &str, series: &[(String, Vec<Point>)]) -> String {
    let across = Axis::over(
        series.iter().flat_map(|(_, points)| points.iter().map(|point| point.x)).collect::<Vec<_>>().into_iter(),
    );
    let up = Axis { low: 0.0, high: 1.0, log: false };
    let mut out = begin(what, TOP + HEIGHT + 40.0 + 18.0 * series.len() as f64);
    ticks(&mut out, up);
    let place = |x: f64, y: f64| (LEFT + (WIDTH - LEFT) * across.place(x), TOP + HEIGHT * (1.0 - up.place(y)));
    for (nth, (name, points)) in series.iter().enumerate() {
        let colour = COLOURS.get(nth % COLOURS.len()).copied().unwrap_or("#444");
        let mut line = String::new();
        for point in points {
            let (px, py) = place(point.x, point.y);
            let [low, high] = point.interval.map(|end| place(point.x, end).1);
            let _ = write!(line, "{}{px:.1} {py:.1}", if line.is_empty() { 'M' } else { 'L' });
            let _ = write!(
                out,
                "<path stroke={colour} stroke-opacity=.5 d=\"M{px:.1} {low:.1}V{high:.1}\" /><circle fill={colour} cx={px:.1} cy={py:.1} \
                 r=3><title>{} {}: {:.2}</title></circle>",
                escape(x),
                number(point.x),
                point.y,
            );
        }
        let foot = TOP + HEIGHT + 44.0 + 18.0 * nth as f64;
        let _ = write!(
            out,
            "<path fill=none stroke={colour} stroke-width=2 d=\"{line}\" /><text x={LEFT} y={foot} style=\"fill:{colour}\">{}</text>",
            escape(name),
        );
    }
    for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let (at, foot) = (LEFT + (WIDTH - LEFT) * part, TOP + HEIGHT + 16.0);
        let anchor = if part > 0.9 { "end" } else { "middle" };
        let _ = write!(out, "<text x={at:.1} y={foot} text-anchor={anchor}>{}</text>", number(across.at(part)));
    }
    let _ = write!(
        out,
        "<text x={:.0} y={:.0} text-anchor=middle>{}</text>",
        0.5 * (LEFT + WIDTH),
        TOP + HEIGHT + 32.0,
        escape(x)
    );
    out + "</svg>"
}

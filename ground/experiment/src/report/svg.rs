//! Pictures of a report, as SVG text; each can be kept as a file of its own.

use std::fmt::Write as _;

use plumbline_rest::experiment::Spread;

use super::{escape, number};
use crate::draw::percentile;

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 60.0;
const TOP: f64 = 12.0;
/// Okabe–Ito, readable with every kind of colour vision.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a7a00"];

/// Of a picture that stands alone: on paper.
const STYLE: &str = "svg{background:#fff}text{fill:#1b1f24;font:12px system-ui,sans-serif}.axis{stroke:#d5dae0}\
    .box{fill:none;stroke:#1b1f24}.violin{fill:#0072b2;fill-opacity:.14}.dot{fill:#0072b2;fill-opacity:.45}.lost{fill:#d55e00}";

/// A figure with its caption, and the picture as a file of this name.
pub(super) fn figure(name: &str, picture: &str, caption: &str) -> String {
    let link = super::kept(&format!("{name}.svg"), "image/svg+xml", &alone(picture), "SVG");
    format!("<figure>{picture}<figcaption>{caption} {link}</figcaption></figure>\n")
}

/// The picture as a document: with what its page gives it, and without what leads elsewhere.
fn alone(picture: &str) -> String {
    let mut out = String::new();
    for (n, part) in picture.split("<a ").enumerate() {
        // Up to the end of its tag a link is left out.
        out.push_str(if n == 0 { part } else { part.split_once('>').map_or("", |(_, rest)| rest) });
    }
    let out = out.replace("</a>", "").replacen("<svg", "<svg xmlns=\"http://www.w3.org/2000/svg\"", 1);
    out.replacen('>', &format!("><style>{STYLE}</style>"), 1)
}

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
    /// Of the flights not lost.
    pub(super) values: Vec<f64>,
    pub(super) dots: Vec<Dot>,
}

/// A point of a curve.
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) interval: [f64; 2],
}

/// How a curve is drawn.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Look {
    /// Points with intervals, and a line through them, and after it a dashed line in its colour; the axis is 0 to 1.
    Points,
    /// A line, and after it a point in its colour; both axes are 0 to 1, and chance is the diagonal.
    Line,
    /// A line in the band of its intervals.
    Band,
}

/// Fewer values have no density.
const DENSE: usize = 8;
/// Points of a density from its lowest to its highest value.
const FINE: usize = 48;

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

    /// From zero where nothing is below.
    fn linear(self) -> Self {
        Self { low: self.low.min(0.0), log: false, ..self }
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
    format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{}\">", escape(what))
}

fn ticks(out: &mut String, axis: Axis) {
    for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let y = TOP + HEIGHT * (1.0 - part);
        let _ = write!(
            out,
            "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{WIDTH}\" y1=\"{y:.1}\" y2=\"{y:.1}\" /><text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            y + 4.0,
            number(axis.at(part)),
        );
    }
}

/// The density of values over an axis as a shape about `middle`, as wide as the box where it is highest: Gaussian kernels whose
/// width is Silverman's rule (1986, Eq. 3.31) on the axis as it is drawn.
fn violin(values: &[f64], axis: Axis, middle: f64, half: f64) -> String {
    let mut places: Vec<f64> = values.iter().map(|value| axis.place(*value)).collect();
    places.sort_by(f64::total_cmp);
    let (Some(low), Some(high)) = (places.first().copied(), places.last().copied()) else { return String::new() };
    let n = places.len() as f64;
    let mean = places.iter().sum::<f64>() / n;
    let sigma = (places.iter().map(|place| (place - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    let quartiles = percentile(&places, 0.75) - percentile(&places, 0.25);
    let spread = if quartiles > 0.0 { sigma.min(quartiles / 1.34) } else { sigma };
    let width = 0.9 * spread * n.powf(-0.2);
    if places.len() < DENSE || high <= low || !width.is_finite() {
        return String::new();
    }
    let at = |step: usize| low + (high - low) * step as f64 / (FINE - 1) as f64;
    let density = |place: f64| places.iter().map(|own| (-0.5 * ((place - own) / width).powi(2)).exp()).sum::<f64>();
    let densities: Vec<(f64, f64)> = (0..FINE).map(|step| (at(step), density(at(step)))).collect();
    let most = densities.iter().map(|(_, density)| *density).fold(0.0, f64::max);
    let mut path = String::new();
    let sides = densities.iter().map(|point| (1.0, point)).chain(densities.iter().rev().map(|point| (-1.0, point)));
    for (side, (place, density)) in sides {
        let (x, y) = (middle + side * half * density / most, TOP + HEIGHT * (1.0 - place));
        let _ = write!(path, "{}{x:.1} {y:.1}", if path.is_empty() { 'M' } else { 'L' });
    }
    format!("<path class=\"violin\" d=\"{path}Z\" />")
}

/// A box and a density for each column, and its dots.
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
        out.push_str(&violin(&column.values, axis, middle, 1.5 * half));
        for (nth, dot) in column.dots.iter().enumerate() {
            // Beside each other by turns of the golden ratio, so that neighbours in time are not neighbours here.
            let aside = ((nth as f64 * 0.618_034) % 1.0 - 0.5) * 2.0 * half;
            let class = if dot.lost { "dot lost" } else { "dot" };
            let _ = write!(
                out,
                "<a href=\"{}\" target=\"_blank\"><circle class=\"{class}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"><title>{}</title></circle></a>",
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
                "<path class=\"box\" d=\"M{middle:.1} {:.1}V{q3:.1}M{middle:.1} {q1:.1}V{:.1}M{left:.1} {q1:.1}H{right:.1}V{q3:.1}H{left:.1}Z\" />\
                 <path class=\"box\" stroke-width=\"3\" d=\"M{left:.1} {m:.1}H{right:.1}\" />",
                y(s.most),
                y(s.least),
            );
        }
        let foot = TOP + HEIGHT + 14.0;
        let _ = write!(
            out,
            "<text x=\"{middle:.1}\" y=\"{foot:.1}\" text-anchor=\"end\" transform=\"rotate(-35 {middle:.1} {foot:.1})\">{}</text>",
            escape(&column.label),
        );
    }
    out + "</svg>"
}

/// Curves, each in a colour of its own.
pub(super) fn curves(x: &str, what: &str, look: Look, series: &[(String, Vec<Point>)]) -> String {
    let all = || series.iter().flat_map(|(_, points)| points);
    let over = |values: Vec<f64>| Axis::over(values.into_iter());
    let unit = Axis { low: 0.0, high: 1.0, log: false };
    let places = || over(all().map(|point| point.x).collect());
    let (across, up) = match look {
        Look::Points => (places(), unit),
        Look::Line => (unit, unit),
        Look::Band => (places().linear(), over(all().flat_map(|point| point.interval).collect()).linear()),
    };
    let mut out = begin(what, TOP + HEIGHT + 40.0 + 18.0 * series.len() as f64);
    ticks(&mut out, up);
    let place = |x: f64, y: f64| (LEFT + (WIDTH - LEFT) * across.place(x), TOP + HEIGHT * (1.0 - up.place(y)));
    if look == Look::Line {
        let _ =
            write!(out, "<path class=\"axis\" stroke-dasharray=\"4\" d=\"M{LEFT} {}L{WIDTH} {TOP}\" />", TOP + HEIGHT);
    }
    for (nth, (name, points)) in series.iter().enumerate().filter(|(_, (_, points))| !points.is_empty()) {
        let of_two = if look == Look::Band { nth } else { nth / 2 };
        let dashed = look == Look::Points && nth % 2 == 1;
        let colour = COLOURS.get(of_two % COLOURS.len()).copied().unwrap_or("#444");
        let path = |along: &mut dyn Iterator<Item = (f64, f64)>| {
            let mut line = String::new();
            for (x, y) in along {
                let (px, py) = place(x, y);
                let _ = write!(line, "{}{px:.1} {py:.1}", if line.is_empty() { 'M' } else { 'L' });
            }
            line
        };
        match look {
            Look::Line if points.len() > 1 => {}
            Look::Points if dashed => {}
            Look::Points | Look::Line => points.iter().for_each(|point| marked(&mut out, x, colour, point, &place)),
            Look::Band => {
                let low = points.iter().map(|point| (point.x, point.interval[0]));
                let high = points.iter().rev().map(|point| (point.x, point.interval[1]));
                let edge = path(&mut low.chain(high));
                let _ = write!(out, "<path fill=\"{colour}\" fill-opacity=\".18\" d=\"{edge}Z\" />");
            }
        }
        let line = path(&mut points.iter().map(|point| (point.x, point.y)));
        let foot = TOP + HEIGHT + 44.0 + 18.0 * nth as f64;
        let dashes = if dashed { " stroke-dasharray=\"6\"" } else { "" };
        let _ = write!(
            out,
            "<path fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"{dashes} d=\"{line}\" /><text x=\"{LEFT}\" y=\"{foot}\" style=\"fill:{colour}\">{}</text>",
            escape(name),
        );
    }
    foot(&mut out, across, x);
    out + "</svg>"
}

fn marked(out: &mut String, x: &str, colour: &str, point: &Point, place: &impl Fn(f64, f64) -> (f64, f64)) {
    let (px, py) = place(point.x, point.y);
    let [low, high] = point.interval.map(|end| place(point.x, end).1);
    let _ = write!(
        out,
        "<path stroke=\"{colour}\" stroke-opacity=\".5\" d=\"M{px:.1} {low:.1}V{high:.1}\" /><circle fill=\"{colour}\" cx=\"{px:.1}\" cy=\"{py:.1}\" \
         r=\"3\"><title>{} {}: {:.2}</title></circle>",
        escape(x),
        number(point.x),
        point.y,
    );
}

/// The horizontal axis.
fn foot(out: &mut String, across: Axis, x: &str) {
    for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let (at, foot) = (LEFT + (WIDTH - LEFT) * part, TOP + HEIGHT + 16.0);
        let anchor = if part > 0.9 { "end" } else { "middle" };
        let _ =
            write!(out, "<text x=\"{at:.1}\" y=\"{foot}\" text-anchor=\"{anchor}\">{}</text>", number(across.at(part)));
    }
    let (middle, below) = (0.5 * (LEFT + WIDTH), TOP + HEIGHT + 32.0);
    let _ = write!(out, "<text x=\"{middle:.0}\" y=\"{below:.0}\" text-anchor=\"middle\">{}</text>", escape(x));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_stands_alone_has_its_style_and_leads_nowhere() {
        let dot = Dot { value: 1.0, lost: true, link: "/open".into(), says: "flight 1 < 2".into() };
        let column = Column { label: "a & b".into(), spread: None, values: Vec::new(), dots: vec![dot] };
        let text = alone(&boxes("altitude_m", &[column]));
        assert!(text.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox="), "{text}");
        assert!(
            text.contains("aria-label=\"altitude_m\"><style>svg{") && !text.contains("/open") && !text.contains("<a")
        );
        assert!(
            text.contains("<circle class=\"dot lost\"") && text.contains("flight 1 &lt; 2") && text.ends_with("</svg>")
        );
        // An XML document quotes every attribute.
        let bare = |tag: &str| tag.split('=').skip(1).any(|value| !value.starts_with('"'));
        let tags = text.split('<').filter_map(|tag| Some(tag.split_once('>')?.0)).filter(|tag| !tag.starts_with('/'));
        assert!(tags.clone().count() > 10 && !tags.into_iter().any(bare), "{text}");
    }

    #[test]
    fn a_density_is_widest_where_most_values_are() {
        let axis = Axis { low: 0.0, high: 1.0, log: false };
        // Three at 0.2 for each at 0.8, each with a little around.
        let values: Vec<f64> = (0..40).map(|n| if n % 4 == 0 { 0.8 } else { 0.2 } + f64::from(n) * 1e-3).collect();
        let path = violin(&values, axis, 100.0, 30.0);
        let points: Vec<(f64, f64)> = path
            .split_once("d=\"M")
            .unwrap()
            .1
            .trim_end_matches("Z\" />")
            .split('L')
            .map(|point| point.split_once(' ').unwrap())
            .map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap()))
            .collect();
        assert_eq!(points.len(), 2 * FINE);
        let widest = points.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        assert_eq!(widest.0, 130.0);
        let at = 1.0 - (widest.1 - TOP) / HEIGHT;
        assert!((0.18..0.26).contains(&at), "{at}");
        // Few values, or the same ones, have no density.
        assert!(violin(&values[..DENSE - 1], axis, 100.0, 30.0).is_empty());
        assert!(violin(&[0.3; 40], axis, 100.0, 30.0).is_empty());
    }
}

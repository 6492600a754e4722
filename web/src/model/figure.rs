//! A chart as a still picture: SVG for a document in the page's colours, or by itself for a paper.

use std::fmt::Write;

use super::{
    axis::{TimeAxis, ValueAxis},
    decimate::{Decimated, Joined, decimate},
    series::Series,
};
use crate::palette::{self, Ink, Stroke};

/// Size of a figure, its margins left and below, px.
const SIZE: [f64; 4] = [920.0, 240.0, 54.0, 20.0];
/// Room above and to the right, px.
const EDGE: f64 = 6.0;
/// Height of the heading of a figure by itself, and of a line of its key, px.
const LINE: f64 = 20.0;
/// Room of a letter in the key, px: names are laid beside each other without measuring them.
const LETTER: f64 = 7.2;
/// How a figure by itself writes.
const FONT: &str = "font-family=\"Inter, Helvetica, Arial, sans-serif\" font-size=\"13\"";

/// Text that means nothing but itself.
pub fn plain(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A curve of a figure.
#[derive(Debug, Clone)]
pub struct Line<'a> {
    /// Its name.
    pub name: String,
    /// Its samples.
    pub series: &'a Series,
    /// Its colour and dash.
    pub stroke: Stroke,
}

/// What is drawn.
#[derive(Debug, Clone)]
pub struct Figure<'a> {
    /// Name.
    pub title: String,
    /// Unit of the values.
    pub unit: String,
    /// Along the bottom.
    pub time: TimeAxis,
    /// Time that labels count from, s.
    pub origin_s: f64,
    /// Up the side.
    pub values: ValueAxis,
    /// Attacked stretches, s.
    pub attacked: Vec<(f64, f64)>,
    /// Curves, the last on top.
    pub lines: Vec<Line<'a>>,
}

/// Colours, where no style sheet gives them, and the key's place, where no list follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Setting {
    Document,
    Alone,
}

impl Setting {
    fn stroke(self, ink: Ink) -> String {
        match self {
            Self::Document => format!("style=\"stroke:{}\"", ink.css()),
            Self::Alone => {
                format!("stroke=\"{}\" fill=\"none\" stroke-width=\"1.5\" stroke-linejoin=\"round\"", ink.hex())
            }
        }
    }

    fn grid(self) -> &'static str {
        if self == Self::Alone { "stroke=\"#d5d9df\" fill=\"none\"" } else { "class=\"grid\"" }
    }

    fn attacked(self) -> String {
        match self {
            Self::Document => "class=\"attacked\"".to_owned(),
            Self::Alone => format!("fill=\"{}\" fill-opacity=\"0.15\"", palette::ATTACK.hex()),
        }
    }
}

impl Figure<'_> {
    /// Inside of a document: its style sheet has the colours.
    pub fn html(&self) -> String {
        let [width, height, ..] = SIZE;
        let title = plain(&self.title);
        let mut out = format!(
            "<figure tabindex=\"0\"><figcaption>{title} <small>{}</small></figcaption><svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">{}</svg><ul class=\"key\">",
            plain(&self.unit),
            self.body(Setting::Document)
        );
        for line in &self.lines {
            let _ = write!(
                out,
                "<li><i class=\"{}\" style=\"border-color:{}\"></i>{}</li>",
                line.stroke.dash.px().map_or("", |_| "dashed"),
                line.stroke.ink.css(),
                plain(&line.name)
            );
        }
        out += "</ul></figure>";
        out
    }

    /// By itself: heading, key and colours included, on white.
    pub fn svg(&self) -> String {
        let [width, height, left, _] = SIZE;
        let (mut x, mut y) = (left, LINE + height + LINE);
        let mut key = String::new();
        for line in &self.lines {
            let long = 24.0 + LETTER * line.name.chars().count() as f64 + 16.0;
            if x + long > width && x > left {
                (x, y) = (left, y + LINE);
            }
            let dash = dashes(line.stroke);
            let _ = write!(
                key,
                "<path {} d=\"M{x:.1} {:.1}h18\"{dash}/><text x=\"{:.1}\" y=\"{y:.1}\">{}</text>",
                Setting::Alone.stroke(line.stroke.ink),
                y - 4.0,
                x + 24.0,
                plain(&line.name)
            );
            x += long;
        }
        let total = y + 8.0;
        let heading = if self.unit.is_empty() { self.title.clone() } else { format!("{}, {}", self.title, self.unit) };
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{total}\" viewBox=\"0 0 {width} {total}\" {FONT} fill=\"#1c2128\"><title>{0}</title><rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/><text x=\"{left}\" y=\"14\" font-weight=\"600\">{0}</text><g transform=\"translate(0 {LINE})\">{1}</g>{key}</svg>\n",
            plain(&heading),
            self.body(Setting::Alone)
        )
    }

    fn body(&self, setting: Setting) -> String {
        let [width, height, left, below] = SIZE;
        let (w, h) = (width - left - EDGE, height - below - EDGE);
        let x = |time_s: f64| left + self.time.fraction(time_s).clamp(0.0, 1.0) * w;
        let y = |value: f64| EDGE + (1.0 - self.values.fraction(value).clamp(0.0, 1.0)) * h;
        let mut out = String::new();
        for (start_s, end_s) in &self.attacked {
            let (a, b) = (x(*start_s), x(*end_s));
            let _ = write!(
                out,
                "<rect {} x=\"{a:.1}\" y=\"{EDGE}\" width=\"{:.1}\" height=\"{h:.1}\"/>",
                setting.attacked(),
                (b - a).max(1.0)
            );
        }
        let grid = setting.grid();
        for tick in self.values.ticks(h, 36.0) {
            let at = y(tick.value);
            let _ = write!(
                out,
                "<path {grid} d=\"M{left} {at:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left + w,
                left - 6.0,
                at + 4.0,
                tick.label
            );
        }
        let ticks = self.time.ticks(w, 90.0, self.origin_s);
        for (i, tick) in ticks.iter().enumerate() {
            let at = x(tick.value);
            let last = i + 1 == ticks.len();
            // What stands at the right edge ends there.
            let anchor = if last && at > left + w - 24.0 { "end" } else { "middle" };
            let unit = if last { " min" } else { "" };
            let _ = write!(
                out,
                "<path {grid} d=\"M{at:.1} {EDGE}V{:.1}\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}{unit}</text>",
                EDGE + h,
                height - 4.0,
                tick.label
            );
        }
        for line in &self.lines {
            let dash = dashes(line.stroke);
            let d = path(line.series, self.time, w, |column, value| [left + f64::from(column), y(f64::from(value))]);
            let _ = write!(out, "<path class=\"line\" {}{dash} d=\"{d}\"/>", setting.stroke(line.stroke.ink));
        }
        out
    }
}

/// The dashes of a path, if it has any.
fn dashes(stroke: Stroke) -> String {
    stroke.dash.px().map_or_else(String::new, |[on, off]| format!(" stroke-dasharray=\"{on} {off}\""))
}

/// A curve as an SVG path of one point, or one smallest and largest, per column.
fn path(series: &Series, axis: TimeAxis, columns: f64, place: impl Fn(f32, f32) -> [f64; 2]) -> String {
    let mut decimated = Decimated::default();
    decimate(series, axis.start_s, axis.end_s, columns as usize, Joined::Straight, &mut decimated);
    let mut out = String::new();
    for run in &decimated.runs {
        let mut pen = 'M';
        for point in decimated.points.get(run.clone()).unwrap_or_default() {
            let mut to = |value: f32| {
                let [x, y] = place(point.x, value);
                let _ = write!(out, "{pen}{x:.1} {y:.1}");
                pen = 'L';
            };
            to(point.low);
            if point.high != point.low {
                to(point.high);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::curves::Curve;

    #[test]
    fn a_figure_by_itself_needs_no_style_sheet_and_keeps_its_names() {
        let series = Series::from_samples((0..100).map(|i| (f64::from(i) * 0.1, i as f32 * 0.01)));
        let lines: Vec<_> = ["setpoint <m>", "truth"]
            .into_iter()
            .zip([Curve::Altitude(1), Curve::TruthAltitude])
            .map(|(name, of)| Line { name: name.into(), series: &series, stroke: palette::stroke(of, 1) })
            .collect();
        let figure = Figure {
            title: "Altitude".into(),
            unit: "m".into(),
            time: TimeAxis::new(0.0, 9.9),
            origin_s: 0.0,
            values: ValueAxis::new(0.0, 1.0),
            attacked: vec![(2.0, 4.0)],
            lines,
        };
        let alone = figure.svg();
        assert!(alone.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && alone.contains("#0072b2"), "{alone}");
        assert!(!alone.contains("var(") && !alone.contains("style="), "colours of a style sheet it does not have");
        assert!(alone.contains("setpoint &lt;m&gt;") && alone.contains("Altitude, m"));
        assert_eq!(alone.matches("stroke-dasharray").count(), 2, "curve and key of the dashed one");
        let inside = figure.html();
        assert!(inside.contains("var(--in-loop)") && inside.contains("class=\"attacked\""));
    }
}

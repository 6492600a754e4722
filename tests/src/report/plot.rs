//! One plot: series over an x axis, drawn as SVG by `plotters`.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::ReportError;

const SIZE_PX: (u32, u32) = (900, 380);
/// Most points drawn of one line: beyond that each pair of columns keeps its lowest and highest.
const MOST_POINTS: usize = 4000;
/// Okabe–Ito, readable with every kind of colour vision; the page's colours in the same order.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0x00, 0x72, 0xB2),
    RGBColor(0xD5, 0x5E, 0x00),
    RGBColor(0x00, 0x9E, 0x73),
    RGBColor(0xCC, 0x79, 0xA7),
    RGBColor(0xE6, 0x9F, 0x00),
    RGBColor(0x56, 0xB4, 0xE9),
    RGBColor(0x8A, 0x7A, 0x00),
    RGBColor(0x44, 0x44, 0x44),
];

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// Joined points.
    Line,
    /// Joined points, dashed: limits, floors, the paper's own curve.
    Dashed,
    /// Single points.
    Points,
}

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Axis {
    /// Linear.
    #[default]
    Linear,
    /// Decades; points that are not positive are left out.
    Log,
}

/// A named series of (x, y).
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    name: String,
    points: Vec<(f64, f64)>,
    style: Style,
}

impl Series {
    /// Joined points.
    pub fn line(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, style: Style::Line }
    }

    /// Joined points, dashed.
    pub fn dashed(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, style: Style::Dashed }
    }

    /// Single points.
    pub fn points(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, style: Style::Points }
    }
}

/// A plot with any number of series.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    title: String,
    x_label: String,
    y_label: String,
    x_axis: Axis,
    y_axis: Axis,
    y_range: Option<(f64, f64)>,
    bands: Vec<(f64, f64)>,
    series: Vec<Series>,
}

impl Plot {
    /// An empty plot; labels carry the unit ("t, s").
    pub fn new(title: &str, x_label: &str, y_label: &str) -> Self {
        Self {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            x_axis: Axis::Linear,
            y_axis: Axis::Linear,
            y_range: None,
            bands: Vec::new(),
            series: Vec::new(),
        }
    }

    /// With one series more.
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// With these axes.
    pub fn axes(mut self, x: Axis, y: Axis) -> Self {
        (self.x_axis, self.y_axis) = (x, y);
        self
    }

    /// With y from `low` to `high`, whatever the points say.
    pub fn y_range(mut self, low: f64, high: f64) -> Self {
        self.y_range = Some((low, high));
        self
    }

    /// With x from `from` to `to` shaded (an attack).
    pub fn band(mut self, from: f64, to: f64) -> Self {
        self.bands.push((from, to));
        self
    }

    /// `series,x,y`, one line a point, as given.
    pub fn csv(&self) -> String {
        let mut text =
            format!("series,{},{}\n", super::html::csv_cell(&self.x_label), super::html::csv_cell(&self.y_label));
        for one in &self.series {
            let name = super::html::csv_cell(&one.name);
            one.points.iter().for_each(|(x, y)| text += &format!("{name},{x},{y}\n"));
        }
        text
    }

    /// The plot as one `<svg>` element.
    ///
    /// # Errors
    /// No finite point, or the drawing library refused.
    pub fn svg(&self) -> Result<String, ReportError> {
        let refuse = |reason: String| ReportError::Plot { plot: self.title.clone(), reason };
        let drawn: Vec<Vec<(f64, f64)>> = self.series.iter().map(|one| self.on_axes(&one.points)).collect();
        let all = || drawn.iter().flatten();
        let x = range(all().map(|p| p.0), 0.0).ok_or_else(|| refuse("has no finite point".into()))?;
        let free = range(all().map(|p| p.1), 0.05).unwrap_or((0.0, 1.0));
        let y = self.y_range.map_or(free, |(low, high)| (to_axis(self.y_axis, low), to_axis(self.y_axis, high)));
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, SIZE_PX).into_drawing_area();
            self.draw(&area, &drawn, x, y).map_err(|error| refuse(error.to_string()))?;
        }
        Ok(text)
    }

    fn draw(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        drawn: &[Vec<(f64, f64)>],
        x: (f64, f64),
        y: (f64, f64),
    ) -> Result<(), Box<dyn std::error::Error>> {
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 17))
            .margin(10)
            .x_label_area_size(38)
            .y_label_area_size(66)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let (x_axis, y_axis) = (self.x_axis, self.y_axis);
        chart
            .configure_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_label_formatter(&move |v| label(x_axis, *v))
            .y_label_formatter(&move |v| label(y_axis, *v))
            .light_line_style(WHITE)
            .bold_line_style(BLACK.mix(0.12))
            .draw()?;
        for (from, to) in &self.bands {
            let corners = [(from.max(x.0), y.0), (to.min(x.1), y.1)];
            chart.draw_series([Rectangle::new(corners, RGBColor(0xD5, 0x5E, 0x00).mix(0.12).filled())])?;
        }
        for (i, (one, points)) in self.series.iter().zip(drawn).enumerate() {
            let colour = COLOURS.get(i % COLOURS.len()).copied().unwrap_or(BLACK);
            let stroke = colour.stroke_width(2);
            let points = points.iter().copied();
            let added = match one.style {
                Style::Line => chart.draw_series(LineSeries::new(points, stroke))?,
                Style::Dashed => chart.draw_series(DashedLineSeries::new(points, 6, 4, stroke))?,
                Style::Points => chart.draw_series(points.map(|at| Circle::new(at, 3, colour.filled())))?,
            };
            added.label(&one.name).legend(move |(x, y)| Rectangle::new([(x, y - 2), (x + 16, y + 2)], colour.filled()));
        }
        if !self.series.is_empty() {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE.mix(0.85))
                .border_style(BLACK.mix(0.2))
                .label_font(("sans-serif", 13))
                .draw()?;
        }
        area.present()?;
        Ok(())
    }

    /// Finite points in axis coordinates, thinned where there are far more than pixels.
    fn on_axes(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let placed = points.iter().map(|(x, y)| (to_axis(self.x_axis, *x), to_axis(self.y_axis, *y)));
        let finite: Vec<_> = placed.filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        if finite.len() <= MOST_POINTS {
            return finite;
        }
        let chunk = finite.len().div_ceil(MOST_POINTS / 2);
        let by_y = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let ends = |part: &[(f64, f64)]| {
            let low = part.iter().min_by(by_y).copied();
            let high = part.iter().max_by(by_y).copied();
            let (first, second) = if low.map(|p| p.0) <= high.map(|p| p.0) { (low, high) } else { (high, low) };
            first.into_iter().chain(second).collect::<Vec<_>>()
        };
        finite.chunks(chunk).flat_map(ends).collect()
    }
}

fn to_axis(axis: Axis, value: f64) -> f64 {
    match axis {
        Axis::Linear => value,
        Axis::Log => value.log10(),
    }
}

fn label(axis: Axis, value: f64) -> String {
    let shown = match axis {
        Axis::Linear => value,
        Axis::Log => 10f64.powf(value),
    };
    if shown != 0.0 && !(1e-3..1e5).contains(&shown.abs()) {
        return format!("{shown:.0e}");
    }
    let text = format!("{shown:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Lowest and highest, with `margin` of their distance added; widened where they are equal.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Option<(f64, f64)> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if !low.is_finite() || !high.is_finite() {
        return None;
    }
    let pad = if high > low { margin * (high - low) } else { 0.5 * low.abs().max(1.0) };
    Some((low - pad, high + pad))
}

//! A small still picture of lines and marks, as SVG: previews and fits, drawn once per answer and readable
//! without graphics. Live and recorded curves are the canvas's business (`panel/plot.rs`).

use leptos::prelude::*;

use crate::model::axis::ValueAxis;

/// Room for labels, px: left, bottom, right, top.
const MARGINS: [f64; 4] = [44.0, 19.0, 8.0, 7.0];
/// A place smaller than this is none yet, px.
const LEAST_PX: [f64; 2] = [80.0, 40.0];
/// Ticks are at least this far apart, px: along the bottom, up the side.
const SPACING: [f64; 2] = [56.0, 26.0];

/// A line.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Points, in the units of the axes; a NaN breaks the line.
    pub points: Vec<[f64; 2]>,
    /// Colour, as the style sheet has it.
    pub color: &'static str,
    /// Dashed?
    pub dashed: bool,
}

/// A mark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// Place.
    pub at: [f64; 2],
    /// Colour, as the style sheet has it.
    pub color: &'static str,
    /// A cross instead of a disc.
    pub cross: bool,
}

/// What is drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drawing {
    /// Lines, the last on top.
    pub traces: Vec<Trace>,
    /// Marks, above the lines.
    pub dots: Vec<Dot>,
    /// Horizontal lines.
    pub levels: Vec<f64>,
    /// Least range of the axes: x, y.
    pub least: [f64; 2],
    /// Fixed ranges, where the data must not decide.
    pub fixed: [Option<[f64; 2]>; 2],
    /// Units of the axes, written at their ends.
    pub units: [String; 2],
}

impl Drawing {
    /// Range of axis 0 or 1.
    fn axis(&self, i: usize) -> ValueAxis {
        if let Some([low, high]) = self.fixed[i] {
            return ValueAxis::new(low, high);
        }
        let points = self.traces.iter().flat_map(|t| t.points.iter().map(move |p| p[i]));
        let all = points.chain(self.dots.iter().map(|d| d.at[i]));
        let (low, high) = all
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        ValueAxis::fit(low, high, self.least[i].max(1e-9), None)
    }

    /// Nothing to see?
    pub fn is_empty(&self) -> bool {
        self.dots.is_empty() && self.traces.iter().all(|t| t.points.is_empty())
    }
}

/// The path of a line, in pixels; broken where a point is not finite.
fn path(points: &[[f64; 2]], place: impl Fn([f64; 2]) -> [f64; 2]) -> String {
    use std::fmt::Write;
    let mut out = String::new();
    let mut pen_down = false;
    for point in points {
        if !point.iter().all(|v| v.is_finite()) {
            pen_down = false;
            continue;
        }
        let [x, y] = place(*point);
        let _ = write!(out, "{}{x:.1} {y:.1}", if pen_down { "L" } else { "M" });
        pen_down = true;
    }
    out
}

/// The picture.
#[component]
pub fn Sketch(
    /// Name for those who cannot see it.
    #[prop(into)]
    label: Signal<String>,
    /// What is drawn.
    #[prop(into)]
    drawing: Signal<Drawing>,
    /// Its size where its place leaves it open, px; on the page it fills its place.
    #[prop(default = [300.0, 150.0])]
    size: [f64; 2],
) -> impl IntoView {
    let [left, bottom, right, top] = MARGINS;
    let node = NodeRef::<leptos::svg::Svg>::new();
    // A pixel of the drawing is one of the page: letters are as large as all others.
    let shown = RwSignal::new(size);
    let measure = move || {
        let Some(rect) = node.try_get_untracked().flatten().map(|node| node.get_bounding_client_rect()) else { return };
        let now = [rect.width().round(), rect.height().round()];
        let is_place = now.iter().zip(LEAST_PX).all(|(now, least)| *now > least);
        if is_place && shown.try_get_untracked().is_some_and(|before| before != now) {
            shown.set(now);
        }
    };
    Effect::new(move |_| {
        drawing.track();
        request_animation_frame(measure);
    });
    let resized = window_event_listener(leptos::ev::resize, move |_| measure());
    on_cleanup(move || resized.remove());
    let body = move || {
        let drawing = drawing.get();
        let [width, height] = shown.get();
        let (w, h) = (width - left - right, height - top - bottom);
        let (x, y) = (drawing.axis(0), drawing.axis(1));
        let place = move |[a, b]: [f64; 2]| {
            let clamp = |v: f64| v.clamp(-1.0, 2.0);
            [left + clamp(x.fraction(a)) * w, top + (1.0 - clamp(y.fraction(b))) * h]
        };
        let vertical = x.ticks(w, SPACING[0]).into_iter().map(|tick| {
            let at = left + tick.fraction * w;
            view! {
                <line class="grid" x1=at x2=at y1=top y2=top + h></line>
                <text x=at y=height - 4.0 text-anchor="middle">{tick.label}</text>
            }
        });
        let horizontal = y.ticks(h, SPACING[1]).into_iter().map(|tick| {
            let at = top + (1.0 - tick.fraction) * h;
            view! {
                <line class="grid" x1=left x2=left + w y1=at y2=at></line>
                <text x=left - 5.0 y=at + 4.0 text-anchor="end">{tick.label}</text>
            }
        });
        let zero = |low: f64, high: f64| low < 0.0 && high > 0.0;
        let origin = zero(x.value(0.0), x.value(1.0)).then(|| {
            let at = place([0.0, 0.0])[0];
            view! { <line class="axis" x1=at x2=at y1=top y2=top + h></line> }
        });
        let levels = drawing.levels.iter().map(|level| {
            let at = place([0.0, *level])[1];
            view! { <line class="level" x1=left x2=left + w y1=at y2=at></line> }
        });
        let traces = drawing.traces.iter().map(|t| {
            let dashes = if t.dashed { "4 3" } else { "none" };
            view! { <path d=path(&t.points, place) stroke=t.color stroke-dasharray=dashes fill="none" stroke-width="1.6" stroke-linejoin="round"></path> }
        });
        let dots = drawing.dots.iter().map(|d| {
            let [x, y] = place(d.at);
            if d.cross {
                let d_ = format!("M{:.1} {:.1}l7 7m0 -7l-7 7", x - 3.5, y - 3.5);
                view! { <path d=d_ stroke=d.color stroke-width="1.6" fill="none"></path> }.into_any()
            } else {
                view! { <circle cx=x cy=y r="3.2" fill=d.color></circle> }.into_any()
            }
        });
        view! {
            {vertical.collect::<Vec<_>>()}
            {horizontal.collect::<Vec<_>>()}
            {origin}
            {levels.collect::<Vec<_>>()}
            <svg x=left y=top width=w height=h viewBox=format!("{left} {top} {w} {h}") overflow="hidden">
                {traces.collect::<Vec<_>>()}
                {dots.collect::<Vec<_>>()}
            </svg>
            <text x=width - right - 2.0 y=top + h - 4.0 text-anchor="end">{drawing.units[0].clone()}</text>
            <text x=left + 4.0 y=top + 11.0>{drawing.units[1].clone()}</text>
        }
    };
    view! {
        <svg class="sketch" role="img" aria-label=label node_ref=node viewBox=move || { let [w, h] = shown.get(); format!("0 0 {w} {h}") } preserveAspectRatio="xMidYMid meet">
            {body}
        </svg>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_breaks_where_nothing_is_known() {
        let points = [[0.0, 0.0], [1.0, 1.0], [2.0, f64::NAN], [3.0, 1.0], [4.0, 0.0]];
        assert_eq!(path(&points, |p| p), "M0.0 0.0L1.0 1.0M3.0 1.0L4.0 0.0");
    }

    #[test]
    fn axes_hold_every_finite_point() {
        let drawing = Drawing {
            traces: vec![Trace { points: vec![[0.0, -1.0], [5.0, f64::INFINITY]], color: "red", dashed: false }],
            dots: vec![Dot { at: [-2.0, 3.0], color: "red", cross: true }],
            least: [0.1, 0.1],
            ..Drawing::default()
        };
        let (x, y) = (drawing.axis(0), drawing.axis(1));
        assert!(x.fraction(-2.0) >= 0.0 && x.fraction(5.0) <= 1.0 && y.fraction(-1.0) >= 0.0 && y.fraction(3.0) <= 1.0);
        assert!(!drawing.is_empty() && Drawing::default().is_empty());
    }
}

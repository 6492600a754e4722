//! What can be drawn: plain data, borrowed for one frame.
//!
//! The page describes each frame as a list of [`Panel`]s and gives it to
//! [`Renderer::frame`](super::Renderer::frame); nothing is remembered from one frame to the next but
//! buffers. Text is not drawn here: labels are page elements, placed with the ticks of
//! [`crate::model::axis`] and the `*_labels` functions of the views.

use super::color::{Color, Theme};
use crate::model::axis::{TimeAxis, ValueAxis};
use crate::model::series::Series;

/// A rectangle in CSS pixels relative to the canvas, y down: what `getBoundingClientRect` gives,
/// since the canvas is fixed over the whole window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect {
    /// Left edge.
    pub x: f32,
    /// Top edge.
    pub y: f32,
    /// Width.
    pub width: f32,
    /// Height.
    pub height: f32,
}

impl Rect {
    /// A rectangle from its top left corner and size.
    pub const fn new(x: f32, y: f32, width: f32, height: f32) -> Self {
        Self { x, y, width, height }
    }
}

/// One part of the canvas and what it shows. Nothing is drawn outside `rect`.
#[derive(Debug, Clone)]
pub struct Panel<'a> {
    /// Where, for a chart the plot area without its labels.
    pub rect: Rect,
    /// What.
    pub content: Content<'a>,
}

/// What a panel can show.
#[derive(Debug, Clone)]
pub enum Content<'a> {
    /// Curves over time.
    Chart(ChartView<'a>),
    /// Rows of innovation ratios over time.
    Heatmap(HeatmapView<'a>),
    /// The artificial horizon.
    Horizon(HorizonView),
    /// The vehicle in space.
    Attitude3d(Attitude3dView<'a>),
}

/// Curves over time, with everything that explains them.
#[derive(Debug, Clone)]
pub struct ChartView<'a> {
    /// Stretch of time shown.
    pub time: TimeAxis,
    /// Range of values shown.
    pub value: ValueAxis,
    /// Drawn in this order, the last on top.
    pub curves: Vec<Curve<'a>>,
    /// Shaded stretches of time: attacks.
    pub spans: Vec<Span>,
    /// Horizontal lines: gates, limits.
    pub levels: Vec<LevelLine>,
    /// Vertical lines: events.
    pub marks: Vec<Mark>,
    /// The shared cursor, at this time.
    pub cursor_s: Option<f64>,
    /// Time the ticks count from; the same as given to [`TimeAxis::ticks`].
    pub time_origin_s: f64,
    /// Colours of the page.
    pub theme: Theme,
}

impl<'a> ChartView<'a> {
    /// An empty chart with its grid.
    pub fn new(time: TimeAxis, value: ValueAxis, theme: Theme) -> Self {
        Self {
            time,
            value,
            curves: Vec::new(),
            spans: Vec::new(),
            levels: Vec::new(),
            marks: Vec::new(),
            cursor_s: None,
            time_origin_s: 0.0,
            theme,
        }
    }

    /// With one more curve on top.
    pub fn curve(mut self, series: &'a Series, color: Color, style: Style) -> Self {
        self.curves.push(Curve { series, color, style, dash: Dash::None, scale: 1.0 });
        self
    }

    /// The last one is interrupted.
    pub fn dashed(mut self, dash: Dash) -> Self {
        if let Some(last) = self.curves.last_mut() {
            last.dash = dash;
        }
        self
    }
}

/// One curve of a chart.
#[derive(Debug, Clone, Copy)]
pub struct Curve<'a> {
    /// The samples.
    pub series: &'a Series,
    /// Colour of the line.
    pub color: Color,
    /// How the line is drawn.
    pub style: Style,
    /// How it is interrupted.
    pub dash: Dash,
    /// Samples are multiplied by this before they are drawn: radians to degrees.
    pub scale: f32,
}

/// How a curve is drawn. Widths in CSS pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// 1.75 px line: the in-loop estimate.
    Strong,
    /// 1.5 px line.
    Solid,
    /// 1 px line: raw sensors.
    Thin,
    /// 1.5 px line holding each value until the next: setpoints.
    Step,
    /// A dot for each sample, where they are far enough apart, on a thin line.
    Points,
    /// Filled from minus the value to the value: ±3σ.
    Band,
}

/// How a line is interrupted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Dash {
    /// Not at all.
    #[default]
    None,
    /// Dashes: truth, and what was computed again.
    Dashed,
    /// Dots.
    Dotted,
    /// Long dashes.
    Long,
    /// Dashes far apart.
    Sparse,
}

impl Dash {
    /// Length of a dash and of the gap after it, CSS pixels; `None` where there is no gap.
    pub const fn px(self) -> Option<[f32; 2]> {
        match self {
            Self::None => None,
            Self::Dashed => Some([7.0, 4.0]),
            Self::Dotted => Some([2.0, 3.0]),
            Self::Long => Some([18.0, 5.0]),
            Self::Sparse => Some([5.0, 10.0]),
        }
    }
}

/// A shaded stretch of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Begin, s.
    pub start_s: f64,
    /// End, s; `f64::INFINITY` while it goes on.
    pub end_s: f64,
    /// Colour of its edges; the inside is the same at low opacity.
    pub color: Color,
    /// Only announced so far (accepted, not active): hatched instead of filled.
    pub planned: bool,
}

/// A horizontal line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelLine {
    /// Its value.
    pub value: f64,
    /// Its colour.
    pub color: Color,
    /// Dashed?
    pub dashed: bool,
}

/// A vertical line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Its time, s.
    pub time_s: f64,
    /// Its colour.
    pub color: Color,
}

/// Rows of innovation ratios (|innovation| / gate) over time: a row per residual, never merged.
#[derive(Debug, Clone)]
pub struct HeatmapView<'a> {
    /// Stretch of time shown.
    pub time: TimeAxis,
    /// From top to bottom; row `i` occupies `i/rows .. (i+1)/rows` of the height, so that row labels
    /// are a page list of the same height.
    pub rows: Vec<HeatRow<'a>>,
    /// Shaded stretches of time, over all rows.
    pub spans: Vec<Span>,
    /// The shared cursor.
    pub cursor_s: Option<f64>,
    /// Time the ticks count from; the same as given to [`TimeAxis::ticks`].
    pub time_origin_s: f64,
    /// Colours of the page.
    pub theme: Theme,
}

/// One row of a heat map.
#[derive(Debug, Clone, Copy)]
pub struct HeatRow<'a> {
    /// Innovation ratios; 1 is the gate.
    pub ratio: &'a Series,
    /// The first row of a sensor: a line separates it from the one above.
    pub group_start: bool,
}

/// The artificial horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HorizonView {
    /// Roll, rad, positive right wing down.
    pub roll_rad: f32,
    /// Pitch about the FLU y axis, rad, **positive nose down**, as on the wire.
    pub pitch_flu_rad: f32,
    /// No attitude, or too old: drawn grey, without horizon.
    pub stale: bool,
    /// Colours of the page.
    pub theme: Theme,
}

/// The vehicle in space. ENU metres; quaternions (w, x, y, z) turn body FLU into world.
#[derive(Debug, Clone)]
pub struct Attitude3dView<'a> {
    /// Where and how it hangs in the air.
    pub pose: Pose,
    /// Other poses, drawn as outlines: truth, and what other estimators say.
    pub ghosts: Vec<Ghost>,
    /// Where it came from, oldest first, world ENU, m.
    pub trail: Vec<[f32; 3]>,
    /// What it must not leave.
    pub bounds: Option<Bounds>,
    /// Where it is to be, world ENU, m.
    pub goal: Option<[f32; 3]>,
    /// Its rotors.
    pub rotors: &'a [Rotor],
    /// Its strings.
    pub strings: &'a [StringLine],
    /// Where it is looked at from.
    pub camera: Camera,
    /// Values are too old: drawn grey.
    pub stale: bool,
    /// Colours of the page.
    pub theme: Theme,
}

/// Position and attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// World ENU, m.
    pub position_enu_m: [f32; 3],
    /// Unit quaternion w, x, y, z.
    pub world_from_body: [f32; 4],
}

impl Pose {
    /// At the world's origin, level, nose east.
    pub const ORIGIN: Self = Self { position_enu_m: [0.0; 3], world_from_body: [1.0, 0.0, 0.0, 0.0] };
}

/// An outline of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ghost {
    /// Where and how.
    pub pose: Pose,
    /// Whose.
    pub color: Color,
}

/// A box on the floor about the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Half its width, east and north, m.
    pub half_m: f32,
    /// Its height, m.
    pub top_m: f32,
}

/// One rotor of the drawn vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotor {
    /// Hub, body FLU, m.
    pub position_flu_m: [f32; 3],
    /// Radius of the disc, m.
    pub radius_m: f32,
    /// Command or thrust, 0..=1: colours the disc.
    pub level: f32,
    /// The command was cut short by its limit.
    pub saturated: bool,
}

/// A string from a fixed point to the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StringLine {
    /// Fixed end, world ENU, m.
    pub anchor_enu_m: [f32; 3],
    /// End on the vehicle, body FLU, m.
    pub attach_flu_m: [f32; 3],
    /// Length at rest, m: a slack string is drawn sagging.
    pub length_m: f32,
}

/// A camera on a sphere about the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Where it stands, rad, anticlockwise from east, as seen from the vehicle.
    pub azimuth_rad: f32,
    /// Above the horizontal, rad.
    pub elevation_rad: f32,
    /// Times the distance that shows the whole vehicle: 1 is close, 2 farther.
    pub zoom_out: f32,
}

impl Default for Camera {
    /// From behind, a little to the right and above, for a vehicle whose nose points east.
    fn default() -> Self {
        Self { azimuth_rad: -2.55, elevation_rad: 0.38, zoom_out: 1.0 }
    }
}

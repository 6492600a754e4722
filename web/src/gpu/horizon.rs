//! The artificial horizon: blue over brown, pitch ladder, roll scale, aircraft symbol.
//!
//! Screen angles: a right roll turns the horizon anticlockwise; a raised nose pushes it down. The
//! scale of the pitch ladder is the same over the whole instrument. Numbers are page elements:
//! [`ladder_numbers`] says which.

use super::color::{Color, Theme};
use super::grid::Plot;
use super::scene::HorizonView;
use super::shape::Shapes;

/// Pitch shown from the middle to the nearer edge, rad.
const HALF_VIEW_RAD: f32 = 0.48;
/// Radius of the roll scale, shares of the shorter side.
const ROLL_RADIUS: f32 = 0.43;
/// Marks of the roll scale, degrees, and whether they are long.
const ROLL_MARKS: [(f32, bool); 11] = [
    (-60.0, true),
    (-45.0, false),
    (-30.0, true),
    (-20.0, false),
    (-10.0, false),
    (0.0, true),
    (10.0, false),
    (20.0, false),
    (30.0, true),
    (45.0, false),
    (60.0, true),
];

const WHITE: Color = Color::hex(0xffffff);
const SYMBOL: Color = Color::hex(0xffc81e);
const OUTLINE: Color = Color { r: 0, g: 0, b: 0, a: 150 };

/// Attitude turned into the directions of the screen.
#[derive(Debug, Clone, Copy)]
struct Geometry {
    centre: [f32; 2],
    /// Along the horizon, to the right.
    along: [f32; 2],
    /// Towards the sky.
    up: [f32; 2],
    /// Nose above the horizon, rad.
    nose_up_rad: f32,
    px_per_rad: f32,
    /// Shorter side.
    size: f32,
}

impl Geometry {
    fn new([left, top, right, bottom]: [f32; 4], view: &HorizonView) -> Self {
        let (sin, cos) = view.roll_rad.sin_cos();
        let size = (right - left).min(bottom - top);
        Self {
            centre: [(left + right) / 2.0, (top + bottom) / 2.0],
            along: [cos, -sin],
            up: [-sin, -cos],
            nose_up_rad: -view.pitch_flu_rad,
            px_per_rad: size * LADDER_PER_RAD,
            size,
        }
    }

    /// The point `across` px right of the line of this pitch's middle.
    fn at(&self, pitch_up_rad: f32, across: f32) -> [f32; 2] {
        let rise = (pitch_up_rad - self.nose_up_rad) * self.px_per_rad;
        [0, 1].map(|i| self.centre[i] + self.up[i] * rise + self.along[i] * across)
    }

    /// A point relative to the airframe, in shares of the size.
    fn fixed(&self, x: f32, y: f32) -> [f32; 2] {
        [self.centre[0] + x * self.size, self.centre[1] + y * self.size]
    }

    /// A point of the roll scale: angle from the top, clockwise.
    fn on_scale(&self, angle_rad: f32, radius: f32) -> [f32; 2] {
        let (sin, cos) = angle_rad.sin_cos();
        self.fixed(sin * radius, -cos * radius)
    }
}

/// One radian on the ladder, in shares of the instrument's shorter side.
pub const LADDER_PER_RAD: f32 = 0.5 / HALF_VIEW_RAD;
/// Half the length of a ten-degree line, in shares of the same.
pub const LADDER_HALF: f32 = 0.13;
/// Farthest line from the middle, in shares of the same.
const LADDER_REACH: f32 = 0.31;

/// Ten-degree lines of the pitch ladder that are seen, degrees above the horizon; each end of them has a number.
pub fn ladder_numbers(pitch_flu_rad: f32) -> Vec<i32> {
    ladder(-pitch_flu_rad).filter(|degrees| degrees % 10 == 0).collect()
}

/// How the ladder lies, as a style has it: turned clockwise about the middle, °, then moved down along itself, shares of the shorter
/// side.
pub fn ladder_lies(roll_deg: f64, pitch_flu_deg: f64) -> (f64, f64) {
    (-roll_deg, -pitch_flu_deg.to_radians() * f64::from(LADDER_PER_RAD))
}

/// Lines of the ladder, degrees above the horizon. They fade out of use before the roll scale.
fn ladder(nose_up_rad: f32) -> impl Iterator<Item = i32> {
    let seen = move |degrees: &i32| {
        ((*degrees as f32).to_radians() - nose_up_rad).abs() * LADDER_PER_RAD < LADDER_REACH && *degrees != 0
    };
    (-18..=18).map(|i| i * 5).filter(seen)
}

/// Draw the instrument into its panel.
pub(crate) fn draw_horizon(shapes: &mut Shapes, plot: Plot, view: &HorizonView) {
    let geometry = Geometry::new(plot.edges(), view);
    if view.stale {
        shapes.rect(plot.edges(), view.theme.grid);
        draw_scale(shapes, plot, &geometry, None, view.theme.axis);
        draw_symbol(shapes, plot, &geometry, view.theme.axis, view.theme.plot);
        return;
    }
    draw_world(shapes, plot, &geometry, &view.theme);
    draw_ladder(shapes, plot, &geometry);
    draw_scale(shapes, plot, &geometry, Some(view.roll_rad), WHITE);
    draw_symbol(shapes, plot, &geometry, SYMBOL, OUTLINE);
}

fn draw_world(shapes: &mut Shapes, plot: Plot, geometry: &Geometry, theme: &Theme) {
    let reach = 3.0 * (plot.width() + plot.height());
    let deep_rad = 0.7;
    let (sky, earth) = (theme.sky, theme.earth);
    let (bright, dim) = (sky.mix(WHITE, 0.28), sky.mix(Color::hex(0), 0.12));
    let (near, far) = (earth.mix(WHITE, 0.10), earth.mix(Color::hex(0), 0.30));
    // From the zenith down; each border spans the whole instrument.
    let bands = [(4.0, dim), (deep_rad, dim), (0.0, bright), (0.0, near), (-deep_rad, far), (-4.0, far)];
    shapes.lift();
    for (pitch_rad, color) in bands {
        shapes.vertex(geometry.at(pitch_rad, -reach), color, [0.0, 1.0]);
        shapes.vertex(geometry.at(pitch_rad, reach), color, [0.0, 1.0]);
    }
    shapes.lift();
    shapes.line(geometry.at(0.0, -reach), geometry.at(0.0, reach), 1.75 * plot.scale, WHITE);
}

fn draw_ladder(shapes: &mut Shapes, plot: Plot, geometry: &Geometry) {
    let width = 1.25 * plot.scale;
    let color = WHITE.alpha(0.92);
    for degrees in ladder(geometry.nose_up_rad) {
        let half = geometry.size * if degrees % 10 == 0 { LADDER_HALF } else { 0.06 };
        let pitch_rad = (degrees as f32).to_radians();
        let [a, b] = [geometry.at(pitch_rad, -half), geometry.at(pitch_rad, half)];
        if degrees > 0 {
            shapes.line(a, b, width, color);
        } else {
            shapes.dashed(a, b, width, [5.0 * plot.scale, 3.0 * plot.scale], color);
        }
        if degrees % 10 == 0 {
            // Little hooks point to the horizon.
            let towards = pitch_rad - f32::signum(degrees as f32) * 5.0 * plot.scale / geometry.px_per_rad;
            shapes.line(a, geometry.at(towards, -half), width, color);
            shapes.line(b, geometry.at(towards, half), width, color);
        }
    }
}

fn draw_scale(shapes: &mut Shapes, plot: Plot, geometry: &Geometry, roll_rad: Option<f32>, color: Color) {
    let width = 1.25 * plot.scale;
    let up = -std::f32::consts::FRAC_PI_2;
    let reach = 60_f32.to_radians();
    shapes.arc(geometry.centre, ROLL_RADIUS * geometry.size, up - reach, up + reach, width, color);
    for (degrees, long) in ROLL_MARKS {
        let angle_rad = degrees.to_radians();
        let outer = ROLL_RADIUS + if long { 0.035 } else { 0.02 };
        if degrees != 0.0 {
            shapes.line(geometry.on_scale(angle_rad, ROLL_RADIUS), geometry.on_scale(angle_rad, outer), width, color);
        }
    }
    let tip = ROLL_RADIUS;
    shapes.convex(
        &[geometry.on_scale(0.0, tip), geometry.on_scale(-0.06, tip + 0.04), geometry.on_scale(0.06, tip + 0.04)],
        color,
    );
    if let Some(roll_rad) = roll_rad {
        // The pointer keeps to the sky: a right roll moves it left.
        let at = |turn: f32, radius: f32| geometry.on_scale(turn - roll_rad, radius);
        let corners = [at(0.0, tip - 0.008), at(-0.065, tip - 0.052), at(0.065, tip - 0.052)];
        shapes.convex(&corners, SYMBOL);
        shapes.polyline(&[corners[0], corners[1], corners[2], corners[0]], plot.scale, OUTLINE);
    }
}

fn draw_symbol(shapes: &mut Shapes, plot: Plot, geometry: &Geometry, color: Color, outline: Color) {
    let wing = |side: f32| {
        [geometry.fixed(0.30 * side, 0.0), geometry.fixed(0.12 * side, 0.0), geometry.fixed(0.12 * side, 0.035)]
    };
    let width = (0.014 * geometry.size).max(2.5 * plot.scale);
    for (extra, color) in [(2.0 * plot.scale, outline), (0.0, color)] {
        for side in [-1.0, 1.0] {
            shapes.polyline(&wing(side), width + extra, color);
        }
        shapes.disc(geometry.centre, (width + extra) * 0.75, color);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EDGES: [f32; 4] = [0.0, 0.0, 200.0, 200.0];

    fn view(roll_rad: f32, pitch_flu_rad: f32) -> HorizonView {
        HorizonView { roll_rad, pitch_flu_rad, stale: false, theme: Theme::DARK }
    }

    #[test]
    fn a_raised_nose_shows_more_sky() {
        // FLU: nose up is negative pitch.
        let geometry = Geometry::new(EDGES, &view(0.0, -0.1));
        let [x, y] = geometry.at(0.0, 0.0);
        assert!((x - 100.0).abs() < 1e-3 && y > 105.0, "horizon at {y}, below the middle");
        let level = Geometry::new(EDGES, &view(0.0, 0.0)).at(0.0, 0.0);
        assert_eq!(level, [100.0, 100.0]);
    }

    #[test]
    fn a_right_roll_lifts_the_right_end_of_the_horizon() {
        let geometry = Geometry::new(EDGES, &view(0.3, 0.0));
        assert!(geometry.at(0.0, 50.0)[1] < 90.0);
        assert!(geometry.at(0.0, -50.0)[1] > 110.0);
        // The sky stays above while the roll is under a quarter turn, and is below when inverted.
        assert!(geometry.at(0.2, 0.0)[1] < 100.0);
        let inverted = Geometry::new(EDGES, &view(std::f32::consts::PI, 0.0));
        assert!(inverted.at(0.2, 0.0)[1] > 100.0);
    }

    #[test]
    fn the_ladder_has_the_numbers_that_are_near_the_nose() {
        assert_eq!(ladder_numbers(0.0), [-10, 10]);
        assert_eq!(ladder_numbers(-30_f32.to_radians()), [20, 30, 40]);
        assert_eq!(ladder_numbers(f32::NAN), [0; 0]);
    }

    /// GIVEN a ladder that is turned and moved as a style does it WHEN a number is put on it THEN it is where the rung is drawn.
    #[test]
    fn the_numbers_lie_where_the_rungs_are_drawn() {
        for (roll_deg, pitch_flu_deg) in [(0.0, 0.0), (20.0, 0.0), (0.0, -15.0), (-35.0, 12.0)] {
            let geometry = Geometry::new(EDGES, &view(f32::to_radians(roll_deg), f32::to_radians(pitch_flu_deg)));
            let (turn_deg, fall) = ladder_lies(roll_deg.into(), pitch_flu_deg.into());
            let (sin, cos) = turn_deg.to_radians().sin_cos();
            for degrees in ladder_numbers(f32::to_radians(pitch_flu_deg)) {
                let rise = f64::from(degrees).to_radians() * f64::from(LADDER_PER_RAD);
                let (x, y) = (f64::from(LADDER_HALF) * 200.0, (fall - rise) * 200.0);
                let put = [100.0 + cos * x - sin * y, 100.0 + sin * x + cos * y];
                let drawn = geometry.at((degrees as f32).to_radians(), LADDER_HALF * 200.0);
                let off = (put[0] - f64::from(drawn[0])).hypot(put[1] - f64::from(drawn[1]));
                assert!(off < 0.01, "{degrees}° at {put:?}, its rung at {drawn:?}");
            }
        }
    }

    #[test]
    fn every_attitude_gives_finite_triangles() {
        let plot = Plot { left: 0.0, top: 0.0, right: 200.0, bottom: 150.0, scale: 2.0 };
        for roll in -8..=8 {
            for pitch in -8..=8 {
                let mut shapes = Shapes::default();
                draw_horizon(&mut shapes, plot, &view(roll as f32 * 0.4, pitch as f32 * 0.2));
                assert!(shapes.vertices().iter().all(|v| v.position.iter().all(|p| p.is_finite())));
            }
        }
    }
}

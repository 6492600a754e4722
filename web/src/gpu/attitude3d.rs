//! The vehicle in space: a small lit quadrotor over a floor grid, with its strings, its shadow and
//! the line that shows its height.
//!
//! Drawn around the vehicle's own position, so that single precision is enough anywhere.

use plumbline_raster::View;

use super::color::{Color, Theme};
use super::mesh::{Frame, Mesh, Vec3, add, cross, dot, length, scaled, sub, unit};
use super::scene::{Attitude3dView, Bounds, Ghost, Rotor, StringLine};

/// Vertical field of view, rad.
/// Size of a vehicle of which no rotor is known, m.
const BARE_M: f32 = 0.25;
const FIELD_RAD: f32 = 0.60;
/// Nearest and farthest distance seen, m.
const NEAR_FAR_M: [f32; 2] = [0.03, 80.0];
/// Distance between lines of the floor grid, m; every second one is stronger.
const GRID_M: f32 = 0.5;
/// Lines of the grid on each side of the vehicle.
const GRID_LINES: i32 = 10;

/// Body axes and nose: forward vermilion, left green, up blue, as on the charts of the page.
const FORWARD: Color = Color::hex(0xd55e00);
const LEFT: Color = Color::hex(0x009e73);
const UP: Color = Color::hex(0x0072b2);
/// Front rotors and nose.
const NOSE: Color = Color::hex(0xe67a1e);

/// Everything drawn in one picture.
#[derive(Debug, Default)]
pub(crate) struct Space {
    /// Hides what is behind it.
    pub solid: Mesh,
    /// Drawn after it, from far to near, and hides nothing.
    pub clear: Mesh,
}

/// How the scene looks on a picture of this shape.
struct Eye {
    position: Vec3,
    /// Metres per pixel at one metre distance.
    m_per_px: f32,
    view: View,
}

impl Eye {
    fn new(view: &Attitude3dView<'_>, [width, height]: [f32; 2], scale: f32) -> Self {
        let reach = view.rotors.iter().map(|rotor| length(rotor.position_flu_m) + rotor.radius_m).fold(0.05, f32::max);
        let aspect = (width / height.max(1.0)).max(0.1);
        let tan = (FIELD_RAD / 2.0).tan();
        let distance = 1.5 * reach * view.camera.zoom_out.clamp(0.3, 30.0) / (tan * aspect.min(1.0));
        let elevation = view.camera.elevation_rad.clamp(0.03, 1.5);
        let (sin_az, cos_az) = view.camera.azimuth_rad.sin_cos();
        let (sin_el, cos_el) = elevation.sin_cos();
        let target = [0.0, 0.0, -0.25 * reach];
        let position = add(target, scaled([cos_az * cos_el, sin_az * cos_el, sin_el], distance));
        let forward = unit(sub(target, position));
        let right = unit(cross(forward, [0.0, 0.0, 1.0]));
        let up = cross(right, forward);
        let [near, far] = NEAR_FAR_M;
        let (fx, fy, fz) = (1.0 / (tan * aspect), 1.0 / tan, far / (near - far));
        // Perspective with depth 0..1, times the camera's frame.
        let column = |i: usize| {
            let depth = -forward[i];
            [right[i] * fx, up[i] * fy, depth * fz, -depth]
        };
        let shift = [
            -dot(right, position) * fx,
            -dot(up, position) * fy,
            dot(forward, position) * fz + near * fz,
            -dot(forward, position),
        ];
        let light = unit([-0.35, -0.5, 0.8]);
        Self {
            position,
            m_per_px: 2.0 * tan / height.max(1.0) * scale,
            view: View {
                clip_from_world: [column(0), column(1), column(2), shift],
                light: [light[0], light[1], light[2], if view.theme.dark { 0.42 } else { 0.5 }],
            },
        }
    }

    /// Width in metres of a line `px` CSS pixels wide at a point.
    fn width_m(&self, point: Vec3, px: f32) -> f32 {
        length(sub(point, self.position)) * self.m_per_px * px
    }
}

impl Space {
    /// Build the picture for a panel of this size (device pixels; `scale` of them per CSS pixel).
    pub fn build(&mut self, view: &Attitude3dView<'_>, size: [f32; 2], scale: f32) -> View {
        self.solid.clear();
        self.clear.clear();
        let eye = Eye::new(view, size, scale);
        // The world is moved so that the vehicle hangs at its origin.
        let centre = view.pose.position_enu_m;
        let floor_m = -centre[2];
        self.floor(&eye, view, floor_m);
        self.shadow(&eye, view, floor_m);
        for string in view.strings {
            self.string(&eye, view, string);
        }
        if let Some(bounds) = view.bounds {
            self.bounds(&eye, view, bounds);
        }
        self.trail(&eye, view);
        if let Some(goal) = view.goal {
            self.goal(&eye, view, sub(goal, centre));
        }
        for ghost in &view.ghosts {
            self.outline(&eye, view, ghost);
        }
        self.vehicle(&eye, view);
        eye.view
    }

    fn floor(&mut self, eye: &Eye, view: &Attitude3dView<'_>, floor_m: f32) {
        let [x, y, _] = view.pose.position_enu_m;
        let reach = GRID_M * GRID_LINES as f32;
        let theme = &view.theme;
        let fade = |point: Vec3, strong: bool| {
            let away = (point[0].hypot(point[1]) / reach).min(1.0);
            let color = if strong { theme.axis } else { theme.axis.mix(theme.grid, 0.55) };
            color.alpha((1.0 - away * away) * if strong { 0.95 } else { 0.8 })
        };
        for axis in 0..2_usize {
            // Lines keep to whole multiples of the spacing in the world.
            let off = [x, y][axis];
            let first = (off / GRID_M).round() as i32;
            let across = [y, x][axis];
            let start = (across / GRID_M).round() as i32;
            for i in -GRID_LINES..=GRID_LINES {
                let line = (first + i) as f32 * GRID_M - off;
                let strong = (first + i) % 2 == 0;
                for j in -GRID_LINES..GRID_LINES {
                    let at = |n: i32| {
                        let along = (start + n) as f32 * GRID_M - across;
                        if axis == 0 { [line, along, floor_m] } else { [along, line, floor_m] }
                    };
                    let (a, b) = (at(j), at(j + 1));
                    let colors = [fade(a, strong), fade(b, strong)];
                    if colors.iter().all(|color| color.a == 0) {
                        continue;
                    }
                    self.clear.ribbon(eye.position, a, b, eye.width_m(a, 1.1), colors);
                }
            }
        }
    }

    fn shadow(&mut self, eye: &Eye, view: &Attitude3dView<'_>, floor_m: f32) {
        let frame = Frame { origin: [0.0; 3], rotation: view.pose.world_from_body };
        let dark = Color::hex(0);
        // Softer and fainter the higher it hangs.
        let height = view.pose.position_enu_m[2].max(0.0);
        let opacity = if view.theme.dark { 0.55 } else { 0.26 } / (1.0 + 0.5 * height);
        for rotor in view.rotors {
            let hub = frame.turn(rotor.position_flu_m);
            let spot = [hub[0], hub[1], floor_m];
            let radius = rotor.radius_m * (1.15 + 0.25 * height);
            let colors = [dark.alpha(opacity), dark.alpha(0.0)];
            self.clear.annulus(&Frame::WORLD, spot, [0.0, radius], [0.0, 0.0, 1.0], colors, 24);
        }
        if height > 0.02 {
            // The plumb line: dashed to the floor, with a ring where it meets it.
            let ink = view.theme.ink.alpha(0.6);
            let (dash, gap) = (0.03_f32.max(height / 60.0), 0.02_f32.max(height / 90.0));
            let mut low = 0.0;
            while low < height {
                let (a, b) = ([0.0, 0.0, floor_m + low], [0.0, 0.0, floor_m + (low + dash).min(height)]);
                self.clear.ribbon(eye.position, a, b, eye.width_m(a, 1.3), [ink, ink]);
                low += dash + gap;
            }
            let ring = [0.0, 0.0, floor_m];
            let width = eye.width_m(ring, 1.5);
            self.clear.annulus(&Frame::WORLD, ring, [0.05, 0.05 + width], [0.0, 0.0, 1.0], [ink, ink], 32);
        }
    }

    fn string(&mut self, eye: &Eye, view: &Attitude3dView<'_>, string: &StringLine) {
        let frame = Frame { origin: [0.0; 3], rotation: view.pose.world_from_body };
        let top = sub(string.anchor_enu_m, view.pose.position_enu_m);
        let end = frame.turn(string.attach_flu_m);
        let chord = sub(end, top);
        let slack = (string.length_m - length(chord)).max(0.0);
        let taut = slack < 1e-3;
        let color = if taut { view.theme.ink.alpha(0.9) } else { view.theme.ink.alpha(0.5) };
        // A shallow arc of the string's own length: sag = √(3/8 · chord · slack).
        let sag = (0.375 * length(chord) * slack).sqrt();
        let along = unit(chord);
        // Downwards as far as that is across the chord, else to the side.
        let down = sub([0.25, 0.0, -1.0], scaled(along, dot([0.25, 0.0, -1.0], along)));
        let at = |share: f32| {
            let bow = 4.0 * share * (1.0 - share) * sag;
            add(add(top, scaled(chord, share)), scaled(unit(down), bow))
        };
        let steps = if taut { 4 } else { 16 };
        for i in 0..steps {
            let [a, b] = [i, i + 1].map(|n| at(n as f32 / steps as f32));
            self.clear.ribbon(eye.position, a, b, eye.width_m(a, 1.4), [color, color]);
        }
        self.solid.cuboid(&Frame::WORLD, top, [0.02, 0.02, 0.008], view.theme.axis);
    }

    /// The edges of the box.
    fn bounds(&mut self, eye: &Eye, view: &Attitude3dView<'_>, Bounds { half_m, top_m }: Bounds) {
        let color = view.theme.axis.alpha(0.8);
        let corner = |i: usize, z: f32| {
            let [x, y] = [[-half_m, -half_m], [half_m, -half_m], [half_m, half_m], [-half_m, half_m]][i % 4];
            sub([x, y, z], view.pose.position_enu_m)
        };
        for i in 0..4 {
            let edges = [
                (corner(i, 0.0), corner(i + 1, 0.0)),
                (corner(i, top_m), corner(i + 1, top_m)),
                (corner(i, 0.0), corner(i, top_m)),
            ];
            for (a, b) in edges {
                self.line(eye, a, b, [color, color]);
            }
        }
    }

    /// A line in pieces, each as wide as it should be where it is.
    fn line(&mut self, eye: &Eye, a: Vec3, b: Vec3, [from, to]: [Color; 2]) {
        const PIECES: usize = 8;
        let at = |n: usize| {
            let share = n as f32 / PIECES as f32;
            (add(a, scaled(sub(b, a), share)), from.mix(to, share))
        };
        for i in 0..PIECES {
            let ((a, from), (b, to)) = (at(i), at(i + 1));
            self.clear.ribbon(eye.position, a, b, eye.width_m(a, 1.2), [from, to]);
        }
    }

    /// Where the vehicle was, the fainter the longer ago.
    fn trail(&mut self, eye: &Eye, view: &Attitude3dView<'_>) {
        let count = view.trail.len().max(1) as f32;
        let color = |i: usize| UP.alpha(0.75 * i as f32 / count);
        for (i, pair) in view.trail.windows(2).enumerate() {
            if let [a, b] = pair {
                let [a, b] = [a, b].map(|p| sub(*p, view.pose.position_enu_m));
                self.clear.ribbon(eye.position, a, b, eye.width_m(a, 2.2), [color(i), color(i + 1)]);
            }
        }
    }

    /// A ring where the vehicle is to be.
    fn goal(&mut self, eye: &Eye, view: &Attitude3dView<'_>, at: Vec3) {
        let arm = view.rotors.iter().map(|rotor| length(rotor.position_flu_m)).fold(0.1, f32::max);
        let color = view.theme.ink.alpha(0.8);
        let width = eye.width_m(at, 1.6);
        self.clear.annulus(&Frame::WORLD, at, [0.5 * arm, 0.5 * arm + width], [0.0, 0.0, 1.0], [color, color], 40);
        for side in [[arm, 0.0, 0.0], [0.0, arm, 0.0]] {
            let [a, b] = [sub(at, scaled(side, 0.25)), add(at, scaled(side, 0.25))];
            self.clear.ribbon(eye.position, a, b, width, [color, color]);
        }
    }

    /// Another opinion on the pose: lines only.
    fn outline(&mut self, eye: &Eye, view: &Attitude3dView<'_>, ghost: &Ghost) {
        let pose = &ghost.pose;
        let origin = sub(pose.position_enu_m, view.pose.position_enu_m);
        let frame = Frame { origin, rotation: pose.world_from_body };
        let color = ghost.color.alpha(0.7);
        for rotor in view.rotors {
            let hub = frame.place(rotor.position_flu_m);
            let width = eye.width_m(hub, 1.2);
            self.clear.ribbon(eye.position, frame.origin, hub, width, [color, color]);
            let ring = [rotor.radius_m - width, rotor.radius_m];
            self.clear.annulus(&frame, rotor.position_flu_m, ring, [0.0, 0.0, 1.0], [color, color], 40);
        }
    }

    fn vehicle(&mut self, eye: &Eye, view: &Attitude3dView<'_>) {
        let frame = Frame { origin: [0.0; 3], rotation: view.pose.world_from_body };
        let theme = &view.theme;
        let shell = if theme.dark { Color::hex(0xb9c2cc) } else { Color::hex(0x56606c) };
        let dark = if theme.dark { Color::hex(0x76808c) } else { Color::hex(0x2f3740) };
        let paint = |color: Color| if view.stale { color.mix(theme.axis, 0.85) } else { color };
        let arm = view.rotors.iter().map(|rotor| length(rotor.position_flu_m)).fold(0.05, f32::max);
        let unit_m = if view.rotors.is_empty() { BARE_M } else { arm };
        // Hull, battery and a nose.
        let [hx, hy, hz] = [0.30, 0.20, 0.055].map(|share| share * unit_m);
        self.solid.cuboid(&frame, [0.0; 3], [hx, hy, hz], paint(shell));
        self.solid.cuboid(
            &frame,
            [-0.02 * unit_m, 0.0, hz + 0.035 * unit_m],
            [0.2 * unit_m, 0.11 * unit_m, 0.035 * unit_m],
            paint(dark),
        );
        self.solid.cone(
            &frame,
            [hx, 0.0, 0.0],
            [hx + 0.2 * unit_m, 0.0, 0.0],
            [0.055 * unit_m, 0.012 * unit_m],
            16,
            paint(NOSE),
        );
        for side in [-1.0, 1.0] {
            // Landing skids.
            let foot = |x: f32| [x * unit_m, side * 0.26 * unit_m, -0.3 * unit_m];
            self.solid.cone(&frame, foot(-0.28), foot(0.28), [0.016 * unit_m; 2], 8, paint(dark));
            for x in [-0.15, 0.15] {
                let top = [x * unit_m, side * 0.12 * unit_m, -hz];
                self.solid.cone(&frame, top, foot(x), [0.016 * unit_m; 2], 8, paint(dark));
            }
        }
        for rotor in view.rotors {
            let hub = rotor.position_flu_m;
            let root = scaled(unit([hub[0], hub[1], 0.0]), 0.14 * unit_m);
            let front = hub[0] > 0.02 * unit_m;
            self.solid.cone(
                &frame,
                root,
                hub,
                [0.04 * unit_m, 0.028 * unit_m],
                12,
                paint(if front { NOSE } else { shell }),
            );
            let lift = |z: f32| add(hub, [0.0, 0.0, z * unit_m]);
            self.solid.cone(&frame, lift(-0.04), lift(0.075), [0.062 * unit_m, 0.055 * unit_m], 16, paint(dark));
        }
        self.axes(eye, &frame, 1.0 * unit_m, view.stale);
        let mut rotors: Vec<&Rotor> = view.rotors.iter().collect();
        let away = |rotor: &Rotor| length(sub(frame.turn(rotor.position_flu_m), eye.position));
        rotors.sort_by(|a, b| away(b).total_cmp(&away(a)));
        for rotor in rotors {
            let hub = add(rotor.position_flu_m, [0.0, 0.0, 0.085 * unit_m]);
            let color = paint(rotor_color(rotor, theme));
            let rim = rotor.radius_m - eye.width_m(frame.turn(hub), 2.0).min(0.1 * rotor.radius_m);
            let disc = [color.alpha(0.22), color.alpha(0.5)];
            self.clear.annulus(&frame, hub, [0.0, rim], [0.0, 0.0, 1.0], disc, 48);
            self.clear.annulus(&frame, hub, [rim, rotor.radius_m], [0.0, 0.0, 1.0], [color, color], 48);
            // Thrust stands on the hub.
            let tip = add(hub, [0.0, 0.0, rotor.level.clamp(0.0, 1.0) * 0.75 * unit_m]);
            let (a, b) = (frame.turn(hub), frame.turn(tip));
            self.clear.ribbon(eye.position, a, b, eye.width_m(a, 3.0), [color.alpha(0.9), color]);
        }
    }

    fn axes(&mut self, eye: &Eye, frame: &Frame, reach: f32, stale: bool) {
        for (i, color) in [FORWARD, LEFT, UP].into_iter().enumerate() {
            let mut tip = [0.0; 3];
            tip[i] = reach * if i == 2 { 0.7 } else { 1.0 };
            let color = if stale { color.alpha(0.3) } else { color.alpha(0.9) };
            let (a, b) = (frame.origin, frame.place(tip));
            self.clear.ribbon(eye.position, a, b, eye.width_m(a, 1.8), [color, color]);
        }
    }
}

/// Colour of a rotor's command: pale at rest, blue at work, vermilion at its limit; its bar tells how much.
pub fn rotor_color(rotor: &Rotor, theme: &Theme) -> Color {
    let idle = if theme.dark { Color::hex(0x8a96a3) } else { Color::hex(0x9aa6b2) };
    let working = Color::hex(if theme.dark { 0x56b4e9 } else { 0x0072b2 });
    if rotor.saturated {
        return Color::hex(0xd55e00);
    }
    idle.mix(working, rotor.level.clamp(0.0, 0.6) / 0.6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::scene::{Camera, Pose};

    fn view(rotors: &[Rotor]) -> Attitude3dView<'_> {
        Attitude3dView {
            pose: Pose { position_enu_m: [120.0, -40.0, 1.5], ..Pose::ORIGIN },
            ghosts: vec![Ghost { pose: Pose::ORIGIN, color: UP }],
            trail: vec![[119.0, -40.0, 0.5], [119.5, -40.0, 1.0]],
            bounds: Some(Bounds { half_m: 2.0, top_m: 2.0 }),
            goal: Some([120.0, -40.0, 1.6]),
            rotors,
            strings: &[],
            camera: Camera::default(),
            stale: false,
            theme: Theme::DARK,
        }
    }

    fn cross_of_rotors() -> Vec<Rotor> {
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(x, y)| Rotor {
                position_flu_m: [0.18 * x, 0.18 * y, 0.0],
                radius_m: 0.12,
                level: 0.5,
                saturated: false,
            })
            .to_vec()
    }

    fn projected(view: &View, p: Vec3) -> [f32; 3] {
        let m = view.clip_from_world;
        let row = |r: usize| m[0][r] * p[0] + m[1][r] * p[1] + m[2][r] * p[2] + m[3][r];
        [row(0) / row(3), row(1) / row(3), row(2) / row(3)]
    }

    #[test]
    fn the_vehicle_fills_but_never_leaves_the_picture() {
        let rotors = cross_of_rotors();
        for (azimuth, size) in [(0.0, [300.0, 300.0]), (2.0, [500.0, 200.0]), (-1.0, [150.0, 400.0])] {
            let mut view = view(&rotors);
            view.camera.azimuth_rad = azimuth;
            let seen = Eye::new(&view, size, 1.0).view;
            let mut widest: f32 = 0.0;
            for rotor in &rotors {
                let [x, y, z] = projected(&seen, scaled(rotor.position_flu_m, 1.47));
                assert!(x.abs() < 1.0 && y.abs() < 1.0 && (0.0..1.0).contains(&z), "{x} {y} {z}");
                widest = widest.max(x.abs()).max(y.abs());
            }
            assert!(widest > 0.2, "{widest}");
        }
    }

    #[test]
    fn up_is_up_and_near_is_near() {
        let rotors = cross_of_rotors();
        let view = view(&rotors);
        let eye = Eye::new(&view, [300.0, 300.0], 1.0);
        assert!(projected(&eye.view, [0.0, 0.0, 0.2])[1] > projected(&eye.view, [0.0, 0.0, -0.2])[1]);
        let towards = scaled(unit(eye.position), 0.1);
        assert!(projected(&eye.view, towards)[2] < projected(&eye.view, scaled(towards, -1.0))[2]);
        // From behind and to the right, the nose points away and the left side is to the left.
        assert!(projected(&eye.view, [0.0, 0.2, 0.0])[0] < projected(&eye.view, [0.0, -0.2, 0.0])[0]);
    }

    #[test]
    fn a_slack_string_hangs_below_a_taut_one_and_all_is_finite() {
        let rotors = cross_of_rotors();
        let string =
            |length_m| StringLine { anchor_enu_m: [120.0, -40.0, 3.0], attach_flu_m: [0.0, 0.0, 0.05], length_m };
        let taut = [string(1.4)];
        let slack = [string(2.0)];
        let mut counts = Vec::new();
        for strings in [&taut, &slack] {
            let mut space = Space::default();
            space.build(&Attitude3dView { strings, ..view(&rotors) }, [300.0, 300.0], 1.0);
            let all = space.solid.vertices().iter().chain(space.clear.vertices());
            assert!(all.clone().all(|v| v.position.iter().chain(&v.normal).all(|x| x.is_finite())));
            counts.push(all.count());
        }
        assert!(counts[0] < counts[1], "{counts:?}");
    }
}

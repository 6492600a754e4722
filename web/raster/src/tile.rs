//! A picture, and what fills it.

use crate::{Flat, INSIDE, Solid, View};

/// Pictures of space with more pixels than this have one sample a pixel instead of four.
const FINE_PX: usize = 250_000;
/// What is nearer to the eye than this, in m, is cut off.
const NEAR_M: f32 = 0.02;

/// A picture.
#[derive(Debug, Default)]
pub struct Tile {
    width: usize,
    height: usize,
    /// Row by row from the top: red, green, blue and alpha, red in the lowest byte.
    pixels: Vec<u32>,
}

/// Kept between frames so that nothing is allocated.
#[derive(Debug, Default)]
pub struct Depths {
    fine: Tile,
    depths: Vec<f32>,
}

/// Something that changes evenly over a triangle.
#[derive(Debug, Clone, Copy)]
struct Plane {
    /// At the picture's corner.
    origin: f32,
    per_x: f32,
    per_y: f32,
}

/// Three corners, px, and twice their area.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    corners: [[f32; 2]; 3],
    area: f32,
}

impl Triangle {
    /// `None` for what covers nothing.
    fn new(corners: [[f32; 2]; 3]) -> Option<Self> {
        let [a, b, c] = corners;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        (area != 0.0 && area.is_finite()).then_some(Self { corners, area })
    }

    /// The plane through a value at each corner.
    fn plane(&self, [v0, v1, v2]: [f32; 3]) -> Plane {
        let [a, b, c] = self.corners;
        let per_area = 1.0 / self.area;
        let (d1, d2) = ((v1 - v0) * per_area, (v2 - v0) * per_area);
        let per_x = d1 * (c[1] - a[1]) - d2 * (b[1] - a[1]);
        let per_y = d2 * (b[0] - a[0]) - d1 * (c[0] - a[0]);
        Plane { origin: v0 - per_x * a[0] - per_y * a[1], per_x, per_y }
    }

    /// Calls `visit` with each line of pixels whose centres are inside; a centre on an edge that two triangles share belongs to one of
    /// them. What is slender is scanned from above to below, in few lines; else from left to right.
    fn lines(&self, size: [usize; 2], mut visit: impl FnMut(Line)) {
        let [mut a, mut b, mut c] = self.corners;
        let extent = |n: usize| a[n].max(b[n]).max(c[n]) - a[n].min(b[n]).min(c[n]);
        let down = extent(1) > 2.0 * extent(0);
        // The axis along a line, and the one across.
        let (along, across) = if down { (1, 0) } else { (0, 1) };
        if b[across] < a[across] {
            std::mem::swap(&mut a, &mut b);
        }
        if c[across] < b[across] {
            std::mem::swap(&mut b, &mut c);
        }
        if b[across] < a[across] {
            std::mem::swap(&mut a, &mut b);
        }
        // The first pixel whose centre is not before this.
        let pixel = |at: f32, most: usize| ((at - 0.5).ceil().max(0.0) as usize).min(most);
        let edge = |from: [f32; 2], to: [f32; 2]| (from, (to[along] - from[along]) / (to[across] - from[across]));
        let (long, first, second) = (edge(a, c), edge(a, b), edge(b, c));
        // From the lesser end to the greater, whichever triangle asks: both of an edge find the same.
        let meets = |(from, slope): ([f32; 2], f32), centre: f32| from[along] + (centre - from[across]) * slope;
        for number in pixel(a[across], size[across])..pixel(c[across], size[across]) {
            let centre = number as f32 + 0.5;
            let (one, other) = (meets(long, centre), meets(if centre < b[across] { first } else { second }, centre));
            let (from, to) = (pixel(one.min(other), size[along]), pixel(one.max(other), size[along]));
            if from < to {
                visit(Line { number, from, to, down });
            }
        }
    }
}

/// Pixels of a row (or of a column, where it leads `down`): the number of it, and the first and the last but one of them.
#[derive(Debug, Clone, Copy)]
struct Line {
    number: usize,
    from: usize,
    to: usize,
    down: bool,
}

impl Line {
    /// Column and row of the first pixel.
    fn first(&self) -> [usize; 2] {
        if self.down { [self.number, self.from] } else { [self.from, self.number] }
    }

    /// Its pixels among those of a picture so wide.
    fn of<'a, T>(&self, pixels: &'a mut [T], width: usize) -> Strided<'a, T> {
        let [x, y] = self.first();
        let step = if self.down { width } else { 1 };
        let first = y * width + x;
        let end = first + (self.to - self.from - 1) * step + 1;
        Strided { rest: pixels.get_mut(first..end).unwrap_or_default(), between: step - 1 }
    }

    /// The value of a plane at the centre of its first pixel, and how much it changes to the next.
    fn along(&self, plane: &Plane) -> (f32, f32) {
        let [x, y] = self.first();
        let first = plane.origin + (x as f32 + 0.5) * plane.per_x + (y as f32 + 0.5) * plane.per_y;
        (first, if self.down { plane.per_y } else { plane.per_x })
    }
}

/// Every n-th of a slice, as `step_by` does; with that, and iterators beside it, a page built for size drew 25 frames/s instead of 30.
struct Strided<'a, T> {
    rest: &'a mut [T],
    between: usize,
}

impl<'a, T> Iterator for Strided<'a, T> {
    type Item = &'a mut T;

    fn next(&mut self) -> Option<&'a mut T> {
        let (first, rest) = std::mem::take(&mut self.rest).split_first_mut()?;
        self.rest = rest.get_mut(self.between..).unwrap_or_default();
        Some(first)
    }
}

/// `color` over a pixel, `share` of 256 parts of it.
fn blend(pixel: &mut u32, color: u32, share: u32) {
    // Two channels at once: each has a byte of room above it.
    let mix = |old: u32, new: u32| ((old * (256 - share) + new * share + 0x80_0080) >> 8) & 0xff_00ff;
    let (even, odd) = (mix(*pixel & 0xff_00ff, color & 0xff_00ff), mix((*pixel >> 8) & 0xff, (color >> 8) & 0xff));
    *pixel = even | (odd & 0xff) << 8 | 0xff00_0000;
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Opacity 0..=1 in parts of 256.
fn share(opacity: f32) -> u32 {
    (opacity * 256.0 + 0.5) as u32
}

fn channels(color: u32) -> [f32; 4] {
    color.to_le_bytes().map(f32::from)
}

/// A colour of channels 0..=255 without its opacity.
fn packed([r, g, b, _]: [f32; 4]) -> u32 {
    u32::from_le_bytes([r, g, b, 255.0].map(|channel| (channel + 0.5) as u8))
}

impl Tile {
    /// Makes it this large, in px, and of one colour.
    pub fn clear(&mut self, [width, height]: [usize; 2], color: u32) {
        (self.width, self.height) = (width, height);
        self.pixels.clear();
        self.pixels.resize(width * height, color);
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Row by row from the top: red, green, blue and alpha, red in the lowest byte.
    pub fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// Red, green, blue and alpha of each pixel.
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.pixels)
    }

    /// What `shape.wgsl` does to a strip, whose coordinates begin at `corner`.
    pub fn shapes(&mut self, vertices: &[Flat], corner: [f32; 2]) {
        let mut rest = vertices;
        while let [a, b, c, ..] = rest {
            rest = rest.get(1..).unwrap_or_default();
            let corners = [a, b, c].map(|v| [v.position[0] - corner[0], v.position[1] - corner[1]]);
            let Some(triangle) = Triangle::new(corners) else { continue };
            let one_color = a.color == b.color && b.color == c.color;
            let edges = [a.edge, b.edge, c.edge];
            if one_color && edges == [INSIDE; 3] {
                self.fill(&triangle, a.color);
            } else if one_color {
                self.stroke(&triangle, a.color, edges);
            } else {
                self.shade(&triangle, [a.color, b.color, c.color], edges);
            }
        }
    }

    fn fill(&mut self, triangle: &Triangle, color: u32) {
        let opaque = color >> 24 == 255;
        let part = share((color >> 24) as f32 / 255.0);
        triangle.lines(self.size(), |line| {
            let pixels = line.of(&mut self.pixels, self.width);
            if opaque {
                pixels.for_each(|pixel| *pixel = color);
            } else {
                pixels.for_each(|pixel| blend(pixel, color, part));
            }
        });
    }

    fn stroke(&mut self, triangle: &Triangle, color: u32, edges: [[f32; 2]; 3]) {
        let opacity = (color >> 24) as f32 / 255.0;
        let [distance, half] = [0, 1].map(|n| triangle.plane(edges.map(|edge| edge[n])));
        triangle.lines(self.size(), |line| {
            let ((mut d, to_d), (mut h, to_h)) = (line.along(&distance), line.along(&half));
            for pixel in line.of(&mut self.pixels, self.width) {
                blend(pixel, color, share(opacity * (h + 0.5 - d.abs()).clamp(0.0, 1.0)));
                (d, h) = (d + to_d, h + to_h);
            }
        });
    }

    fn shade(&mut self, triangle: &Triangle, colors: [u32; 3], edges: [[f32; 2]; 3]) {
        let corners = colors.map(channels);
        let [r, g, b, a] = [0, 1, 2, 3].map(|n| triangle.plane(corners.map(|channels| channels[n])));
        let [distance, half] = [0, 1].map(|n| triangle.plane(edges.map(|edge| edge[n])));
        let plain = edges == [INSIDE; 3] && colors.iter().all(|color| color >> 24 == 255);
        triangle.lines(self.size(), |line| {
            let ((mut r, to_r), (mut g, to_g), (mut b, to_b)) = (line.along(&r), line.along(&g), line.along(&b));
            let ((mut a, to_a), (mut d, to_d), (mut h, to_h)) =
                (line.along(&a), line.along(&distance), line.along(&half));
            for pixel in line.of(&mut self.pixels, self.width) {
                if plain {
                    *pixel = packed([r, g, b, a]);
                } else {
                    let coverage = (h + 0.5 - d.abs()).clamp(0.0, 1.0);
                    blend(pixel, packed([r, g, b, a]), share((a / 255.0).clamp(0.0, 1.0) * coverage));
                    (a, d, h) = (a + to_a, d + to_d, h + to_h);
                }
                (r, g, b) = (r + to_r, g + to_g, b + to_b);
            }
        });
    }

    /// What `mesh.wgsl` does, over all of this picture: what is opaque, then what is translucent.
    pub fn space(&mut self, solids: [&[Solid]; 2], view: &View, sky: u32, kept: &mut Depths) {
        let samples = if self.pixels.len() > FINE_PX { 1 } else { 2 };
        let Depths { fine, depths } = kept;
        fine.clear(self.size().map(|px| px * samples), sky);
        depths.clear();
        depths.resize(fine.pixels.len(), 1.0);
        for (vertices, solid) in solids.into_iter().zip([true, false]) {
            for corners in vertices.as_chunks::<3>().0 {
                fine.lit(corners, view, depths, solid);
            }
        }
        if samples == 1 {
            self.pixels.copy_from_slice(&fine.pixels);
            return;
        }
        let wide = 2 * self.width;
        let rows = fine.pixels.chunks_exact((2 * wide).max(1));
        for (row, two) in self.pixels.chunks_exact_mut(self.width.max(1)).zip(rows) {
            let (upper, lower) = two.split_at(wide);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            for (pixel, (&[a, b], &[c, d])) in row.iter_mut().zip(pairs) {
                let even = |p: u32| p & 0xff_00ff;
                let odd = |p: u32| (p >> 8) & 0xff_00ff;
                let mean = |part: fn(u32) -> u32| ((part(a) + part(b) + part(c) + part(d) + 0x2_0002) >> 2) & 0xff_00ff;
                *pixel = mean(even) | mean(odd) << 8;
            }
        }
    }

    fn lit(&mut self, corners: &[Solid; 3], view: &View, depths: &mut [f32], solid: bool) {
        let m = view.clip_from_world;
        let seen = corners.each_ref().map(|vertex| {
            let p = vertex.position;
            let clip = [0, 1, 2, 3].map(|r| m[0][r] * p[0] + m[1][r] * p[1] + m[2][r] * p[2] + m[3][r]);
            let light = [view.light[0], view.light[1], view.light[2]];
            let shade = view.light[3] + (1.0 - view.light[3]) * dot(vertex.normal, light).max(0.0);
            let shade = if dot(vertex.normal, vertex.normal) > 0.25 { shade } else { 1.0 };
            let [r, g, b, a] = channels(vertex.color);
            Seen { clip, color: [r * shade, g * shade, b * shade, a] }
        });
        let (whole, count) = before_the_eye(seen);
        let fan = whole.get(..count).unwrap_or_default();
        if let [first, others @ ..] = fan {
            for pair in others.windows(2) {
                if let [second, third] = pair {
                    self.face([*first, *second, *third], depths, solid);
                }
            }
        }
    }

    fn face(&mut self, corners: [Seen; 3], depths: &mut [f32], solid: bool) {
        let (width, height) = (self.width as f32, self.height as f32);
        let screen =
            corners.map(|Seen { clip: [x, y, _, w], .. }| [(x / w * 0.5 + 0.5) * width, (0.5 - y / w * 0.5) * height]);
        let Some(triangle) = Triangle::new(screen) else { return };
        let depth = triangle.plane(corners.map(|corner| corner.clip[2] / corner.clip[3]));
        // Even over the picture are what is divided by the distance, and its inverse.
        let inverse = triangle.plane(corners.map(|corner| 1.0 / corner.clip[3]));
        let one_color = corners[0].color == corners[1].color && corners[1].color == corners[2].color;
        let [r, g, b, a] = [0, 1, 2, 3].map(|n| triangle.plane(corners.map(|corner| corner.color[n] / corner.clip[3])));
        let (flat, opaque) = (packed(corners[0].color), share(corners[0].color[3] / 255.0));
        triangle.lines(self.size(), |line| {
            let ((mut r, to_r), (mut g, to_g), (mut b, to_b)) = (line.along(&r), line.along(&g), line.along(&b));
            let ((mut a, to_a), (mut z, to_z), (mut i, to_i)) =
                (line.along(&a), line.along(&depth), line.along(&inverse));
            for (pixel, kept) in line.of(&mut self.pixels, self.width).zip(line.of(depths, self.width)) {
                if z <= *kept {
                    if solid {
                        *kept = z;
                    }
                    if one_color {
                        blend(pixel, flat, opaque);
                    } else {
                        let color = [r / i, g / i, b / i, a / i];
                        blend(pixel, packed(color), share((color[3] / 255.0).clamp(0.0, 1.0)));
                    }
                }
                (r, g, b, a) = (r + to_r, g + to_g, b + to_b, a + to_a);
                (z, i) = (z + to_z, i + to_i);
            }
        });
    }
}

/// A corner as the eye has it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    clip: [f32; 4],
    color: [f32; 4],
}

/// What of a triangle is before the eye: a polygon of so many corners.
fn before_the_eye(corners: [Seen; 3]) -> ([Seen; 4], usize) {
    let [a, b, c] = corners;
    let mut whole = [a, b, c, a];
    if corners.iter().all(|corner| corner.clip[3] >= NEAR_M) {
        return (whole, 3);
    }
    let mut count = 0;
    let mut keep = |corner: Seen| {
        if let Some(place) = whole.get_mut(count) {
            *place = corner;
            count += 1;
        }
    };
    for (from, to) in [(a, b), (b, c), (c, a)] {
        let (w0, w1) = (from.clip[3] - NEAR_M, to.clip[3] - NEAR_M);
        if w0 >= 0.0 {
            keep(from);
        }
        if (w0 >= 0.0) != (w1 >= 0.0) {
            let part = w0 / (w0 - w1);
            let cut = |from: [f32; 4], to: [f32; 4]| [0, 1, 2, 3].map(|n| from[n] + (to[n] - from[n]) * part);
            keep(Seen { clip: cut(from.clip, to.clip), color: cut(from.color, to.color) });
        }
    }
    (whole, count)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// GIVEN a fan of triangles that share edges, at odd places WHEN each is filled half opaque THEN no pixel inside has been met twice,
    /// and none has been left out.
    #[test]
    fn what_triangles_share_is_filled_once() {
        let centre = [50.3, 49.6];
        let rim = |i: usize| {
            let (sin, cos) = (i as f32 / 17.0 * std::f32::consts::TAU).sin_cos();
            [50.3 + 45.0 * cos, 49.6 + 45.0 * sin]
        };
        let mut tile = Tile::default();
        tile.clear([100, 100], 0xff00_0000);
        for i in 0..17 {
            let triangle = Triangle::new([centre, rim(i), rim(i + 1)]).unwrap();
            tile.fill(&triangle, 0x80ff_ffff);
        }
        for (i, pixel) in tile.pixels.iter().enumerate() {
            let far = ((i % 100) as f32 + 0.5 - 50.3).hypot((i / 100) as f32 + 0.5 - 49.6);
            let level = pixel & 0xff;
            assert!(level == 0 || level == 128, "{level} at {i}");
            assert!(
                if far < 43.0 { level == 128 } else { far < 45.5 || level == 0 },
                "{level} {far} px from the centre"
            );
        }
    }

    #[test]
    fn what_reaches_behind_the_eye_is_cut() {
        let corner = |w: f32| Seen { clip: [0.0, 0.0, 0.0, w], color: [w; 4] };
        let count = |w: [f32; 3]| before_the_eye(w.map(corner)).1;
        assert_eq!(count([1.0, 2.0, 3.0]), 3);
        assert_eq!(count([-1.0, -2.0, 0.0]), 0);
        assert_eq!(count([-1.0, 2.0, 3.0]), 4);
        assert_eq!(count([1.0, -2.0, -3.0]), 3);
        let (whole, count) = before_the_eye([-1.0, 2.0, 3.0].map(corner));
        assert!(
            whole[..count].iter().all(|corner| corner.clip[3] > 0.99 * NEAR_M && corner.color[0] == corner.clip[3])
        );
    }
}

//! Flat triangles with anti-aliased edges: one strip, one pipeline, one draw per panel.
//!
//! Each vertex carries how far it lies from the middle of its stroke and how wide the stroke is; the
//! shader turns that into coverage, so lines, bands, dots and fills need neither multisampling nor
//! derivatives. Strips are joined by repeated vertices (triangles without area). In software WebGL2
//! this was the fastest of the ways tried: line strips managed 5 000 points, instanced segments less.

use plumbline_raster::{Flat, INSIDE};

use super::color::Color;

const ATTRIBUTES: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x2, 1 => Unorm8x4, 2 => Float32x2];
/// Layout of a buffer of vertices.
pub(super) const LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Flat>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &ATTRIBUTES,
};

/// A growing strip of triangles. Positions and widths are device pixels.
#[derive(Debug, Default)]
pub struct Shapes {
    vertices: Vec<Flat>,
    /// The next vertex begins a new strip.
    lifted: bool,
}

impl Shapes {
    /// Forget everything, keep the memory.
    pub fn clear(&mut self) {
        self.vertices.clear();
        self.lifted = false;
    }

    /// All vertices so far.
    pub fn vertices(&self) -> &[Flat] {
        &self.vertices
    }

    /// End the strip: the next vertex is joined to nothing.
    pub fn lift(&mut self) {
        self.lifted = !self.vertices.is_empty();
    }

    /// Number of the next vertex, when the strip was just lifted: a draw may begin here.
    pub fn mark(&mut self) -> u32 {
        // Nothing joins two draws.
        self.lifted = false;
        self.vertices.len() as u32
    }

    /// Append a vertex to the strip.
    pub fn vertex(&mut self, position: [f32; 2], color: Color, edge: [f32; 2]) {
        let vertex = Flat { position, color: color.packed(), edge };
        if self.lifted
            && let Some(last) = self.vertices.last().copied()
        {
            self.vertices.extend([last, vertex]);
        }
        self.lifted = false;
        self.vertices.push(vertex);
    }

    /// Append a vertex of a fill with hard edges.
    pub fn inside(&mut self, position: [f32; 2], color: Color) {
        self.vertex(position, color, INSIDE);
    }

    /// A filled rectangle with hard edges; the caller rounds to pixels where that matters.
    pub fn rect(&mut self, [left, top, right, bottom]: [f32; 4], color: Color) {
        self.rect_shaded([left, top, right, bottom], color, color);
    }

    /// The same, from one colour at the top to another at the bottom.
    pub fn rect_shaded(&mut self, [left, top, right, bottom]: [f32; 4], upper: Color, lower: Color) {
        if right <= left || bottom <= top {
            return;
        }
        self.lift();
        self.inside([left, top], upper);
        self.inside([left, bottom], lower);
        self.inside([right, top], upper);
        self.inside([right, bottom], lower);
        self.lift();
    }

    /// A filled convex polygon with hard edges.
    pub fn convex(&mut self, corners: &[[f32; 2]], color: Color) {
        self.lift();
        let (mut low, mut high) = (0, corners.len());
        // Zigzag between both ends of the outline.
        while low < high {
            self.inside(corners[low], color);
            low += 1;
            if low < high {
                high -= 1;
                self.inside(corners[high], color);
            }
        }
        self.lift();
    }

    /// A filled disc, anti-aliased.
    pub fn disc(&mut self, [x, y]: [f32; 2], radius: f32, color: Color) {
        let sides = if radius < 4.0 { 8 } else { 32 };
        // A polygon outside the circle's soft border.
        let reach = (radius + 0.5) / (std::f32::consts::PI / sides as f32).cos();
        self.lift();
        for i in 0..=sides {
            let (sin, cos) = (i as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
            self.vertex([x + reach * cos, y + reach * sin], color, [reach, radius]);
            self.vertex([x, y], color, [0.0, radius]);
        }
        self.lift();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Area covered by a strip's triangles, degenerate ones included.
    fn area(vertices: &[Flat]) -> f32 {
        vertices
            .windows(3)
            .map(|t| {
                let [a, b, c] = [t[0].position, t[1].position, t[2].position];
                ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs() / 2.0
            })
            .sum()
    }

    #[test]
    fn strips_are_joined_by_triangles_without_area() {
        let mut shapes = Shapes::default();
        shapes.rect([0.0, 0.0, 10.0, 5.0], Color::hex(0));
        shapes.rect([100.0, 100.0, 110.0, 105.0], Color::hex(0));
        shapes.convex(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]], Color::hex(0));
        assert!((area(shapes.vertices()) - 200.0).abs() < 1e-3);
        assert_eq!(shapes.vertices().len(), 4 + 6 + 6);
    }

    #[test]
    fn a_disc_has_its_area() {
        let mut shapes = Shapes::default();
        shapes.disc([50.0, 50.0], 20.0, Color::hex(0));
        let expected = std::f32::consts::PI * 20.5 * 20.5;
        assert!((area(shapes.vertices()) / expected - 1.0).abs() < 0.02);
    }

    #[test]
    fn what_has_no_area_is_not_drawn() {
        let mut shapes = Shapes::default();
        shapes.rect([5.0, 0.0, 5.0, 5.0], Color::hex(0));
        shapes.rect([5.0, 7.0, 9.0, 5.0], Color::hex(0));
        assert!(shapes.vertices().is_empty());
    }
}

//! Solid bodies in space: a triangle list built anew each frame, lit per vertex, depth-tested.

use plumbline_raster::Solid;

use super::color::Color;

/// A point or direction in space.
pub(crate) type Vec3 = [f32; 3];

const ATTRIBUTES: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Unorm8x4];
/// Layout of a buffer of vertices.
pub(super) const LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Solid>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &ATTRIBUTES,
};

pub(crate) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn scaled(a: Vec3, s: f32) -> Vec3 {
    a.map(|x| x * s)
}

pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn length(a: Vec3) -> f32 {
    dot(a, a).sqrt()
}

/// Unit vector along `a`; zero for a zero vector.
pub(crate) fn unit(a: Vec3) -> Vec3 {
    scaled(a, 1.0 / length(a).max(1e-9))
}

/// Turns and moves body points into the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub origin: Vec3,
    /// Unit quaternion w, x, y, z.
    pub rotation: [f32; 4],
}

impl Frame {
    pub const WORLD: Self = Self { origin: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };

    /// A direction: v + 2w(q × v) + 2 q × (q × v).
    pub fn turn(&self, v: Vec3) -> Vec3 {
        let [w, x, y, z] = self.rotation;
        let q = [x, y, z];
        let t = scaled(cross(q, v), 2.0);
        add(add(v, scaled(t, w)), cross(q, t))
    }

    /// A point.
    pub fn place(&self, p: Vec3) -> Vec3 {
        add(self.origin, self.turn(p))
    }
}

/// A growing list of triangles.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    vertices: Vec<Solid>,
}

impl Mesh {
    pub fn clear(&mut self) {
        self.vertices.clear();
    }

    pub fn vertices(&self) -> &[Solid] {
        &self.vertices
    }

    /// A triangle of corners with their normals.
    fn triangle(&mut self, corners: [(Vec3, Vec3); 3], color: Color) {
        let color = color.packed();
        self.vertices.extend(corners.map(|(position, normal)| Solid { position, normal, color }));
    }

    /// A flat four-sided face with one normal, corners in order round it.
    pub fn face(&mut self, [a, b, c, d]: [Vec3; 4], normal: Vec3, color: Color) {
        self.triangle([(a, normal), (b, normal), (c, normal)], color);
        self.triangle([(a, normal), (c, normal), (d, normal)], color);
    }

    /// The same with a colour for each corner and no light: lines that fade out.
    pub fn face_shaded(&mut self, corners: [Vec3; 4], colors: [Color; 4]) {
        for [i, j, k] in [[0, 1, 2], [0, 2, 3]] {
            self.vertices.extend([i, j, k].map(|n: usize| Solid {
                position: corners[n],
                normal: [0.0; 3],
                color: colors[n].packed(),
            }));
        }
    }

    /// A box with its edges along the frame's axes.
    pub fn cuboid(&mut self, frame: &Frame, centre: Vec3, half: Vec3, color: Color) {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let mut normal = [0.0; 3];
                normal[axis] = side;
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |a: f32, b: f32| {
                    let mut p = centre;
                    p[axis] += side * half[axis];
                    p[u] += a * half[u];
                    p[v] += b * half[v];
                    frame.place(p)
                };
                let face = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
                self.face(face, frame.turn(normal), color);
            }
        }
    }

    /// A cone from `a` (radius `ra`) to `b` (radius `rb`), round-shaded, with its lids.
    pub fn cone(&mut self, frame: &Frame, a: Vec3, b: Vec3, [ra, rb]: [f32; 2], sides: usize, color: Color) {
        let along = unit(sub(b, a));
        let (u, v) = normals_of(along);
        let ring = |i: usize| {
            let (sin, cos) = (i as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
            add(scaled(u, cos), scaled(v, sin))
        };
        // The mantle leans by the difference of the radii.
        let lean = (ra - rb) / length(sub(b, a)).max(1e-6);
        for i in 0..sides {
            let [r0, r1] = [ring(i), ring(i + 1)];
            let [n0, n1] = [r0, r1].map(|r| frame.turn(unit(add(r, scaled(along, lean)))));
            let [a0, a1] = [r0, r1].map(|r| frame.place(add(a, scaled(r, ra))));
            let [b0, b1] = [r0, r1].map(|r| frame.place(add(b, scaled(r, rb))));
            self.triangle([(a0, n0), (a1, n1), (b1, n1)], color);
            self.triangle([(a0, n0), (b1, n1), (b0, n0)], color);
            let [back, front] = [frame.turn(scaled(along, -1.0)), frame.turn(along)];
            self.triangle([(frame.place(a), back), (a1, back), (a0, back)], color);
            self.triangle([(frame.place(b), front), (b0, front), (b1, front)], color);
        }
    }

    /// A flat disc or ring between two radii, seen from both sides, colours inside to outside.
    pub fn annulus(
        &mut self,
        frame: &Frame,
        centre: Vec3,
        [inner, outer]: [f32; 2],
        normal: Vec3,
        [from, to]: [Color; 2],
        sides: usize,
    ) {
        let (u, v) = normals_of(unit(normal));
        let at = |i: usize, radius: f32| {
            let (sin, cos) = (i as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
            frame.place(add(centre, add(scaled(u, cos * radius), scaled(v, sin * radius))))
        };
        for i in 0..sides {
            let corners = [at(i, inner), at(i, outer), at(i + 1, outer), at(i + 1, inner)];
            self.face_shaded(corners, [from, to, to, from]);
        }
    }

    /// A ribbon between two points that always faces the eye.
    pub fn ribbon(&mut self, eye: Vec3, a: Vec3, b: Vec3, width: f32, [from, to]: [Color; 2]) {
        let side = scaled(unit(cross(sub(b, a), sub(eye, a))), width / 2.0);
        self.face_shaded([sub(a, side), add(a, side), add(b, side), sub(b, side)], [from, from, to, to]);
    }
}

/// Two unit vectors perpendicular to a unit vector and to each other.
fn normals_of(along: Vec3) -> (Vec3, Vec3) {
    let helper = if along[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0] };
    let u = unit(cross(helper, along));
    (u, cross(along, u))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_turn_as_quaternions_do() {
        // A quarter turn about up: forward becomes left.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let frame = Frame { origin: [1.0, 2.0, 3.0], rotation: [half, 0.0, 0.0, half] };
        let placed = frame.place([1.0, 0.0, 0.0]);
        assert!(length(sub(placed, [1.0, 3.0, 3.0])) < 1e-6, "{placed:?}");
    }

    #[test]
    fn solids_are_closed_and_their_normals_point_out() {
        let mut mesh = Mesh::default();
        let frame = Frame { origin: [0.0; 3], rotation: [0.5, 0.5, 0.5, 0.5] };
        mesh.cuboid(&frame, [0.0; 3], [1.0, 2.0, 3.0], Color::hex(0));
        mesh.cone(&frame, [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.5], 12, Color::hex(0));
        for vertex in mesh.vertices() {
            assert!((length(vertex.normal) - 1.0).abs() < 1e-5);
            assert!(dot(vertex.normal, vertex.position) > -1e-6, "{vertex:?}");
        }
        assert_eq!(mesh.vertices().len(), 6 * 6 + 12 * 12);
    }
}

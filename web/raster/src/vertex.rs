//! Corners of triangles, as graphics cards and [`crate::Tile`] take them.

use bytemuck::{Pod, Zeroable};

/// A corner of a flat shape, which belongs to a strip. Keep in sync with `shape.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Flat {
    /// Device pixels from the canvas's top left corner.
    pub position: [f32; 2],
    /// r, g, b, a.
    pub color: u32,
    /// Distance from the stroke's middle and half its width, device pixels.
    pub edge: [f32; 2],
}

/// Edge of a vertex well inside a fill: fully covered.
pub const INSIDE: [f32; 2] = [0.0, 1.0];

/// A corner of a solid, three for each triangle. Keep in sync with `mesh.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Solid {
    /// World ENU, m.
    pub position: [f32; 3],
    /// Unit normal, or zero for what is not lit.
    pub normal: [f32; 3],
    /// r, g, b, a.
    pub color: u32,
}

/// How space is seen. Keep in sync with `mesh.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct View {
    /// Columns of the matrix.
    pub clip_from_world: [[f32; 4]; 4],
    /// Direction towards the light and the ambient share.
    pub light: [f32; 4],
}

//! Everything that is drawn: one wgpu canvas behind the page, WebGPU where present, else WebGL2.
//!
//! - [`scene`] says what can be drawn; plain data, tested natively.
//! - [`Renderer`] draws a list of panels per frame: canvas and device are `screen`'s, what they draw with `pipelines`'.
//! - Two kinds of triangles do all the work: [`shape`] (flat, anti-aliased by coverage) for charts,
//!   heat maps and the horizon; [`mesh`] (lit, depth-tested, multisampled) for the vehicle in space.
//! - `chart`, `heatmap`, `horizon` and `attitude3d` turn one content each into those triangles.

pub mod attitude3d;
mod chart;
pub mod color;
mod context;
mod error;
mod grid;
mod heatmap;
pub mod horizon;
mod image;
mod line;
mod mesh;
mod pipelines;
#[cfg(test)]
mod raster;
pub mod scene;
mod screen;
mod shape;

pub use color::{Color, Theme};
pub use context::{FrameOutcome, FrameStats, Renderer};
pub use error::GpuError;
pub use grid::{TIME_TICK_SPACING_PX, VALUE_TICK_SPACING_PX};
pub use scene::*;
pub use screen::Backend;

//! Everything that is drawn: one canvas behind the page, by wgpu (WebGPU where present, else WebGL2), or by the processor where there is
//! no graphics card.
//!
//! - [`scene`] says what can be drawn; plain data, tested natively.
//! - [`Renderer`] draws a list of panels per frame, on a card by `context` (canvas and device are `screen`'s, what they draw with
//!   `pipelines`') or on `paper`: the same triangles, written on a `sheet`, become pixels in the page's worker (`web/worker`).
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
mod paper;
mod pipelines;
mod pixels;
mod renderer;
pub mod scene;
mod screen;
mod shape;
mod sheet;

pub use color::{Color, Theme};
pub use context::{FrameOutcome, FrameStats};
pub use error::GpuError;
pub use grid::{TIME_TICK_SPACING_PX, VALUE_TICK_SPACING_PX};
pub(crate) use pixels::Pixels;
pub use renderer::Renderer;
pub use scene::*;
pub use screen::Backend;

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    fn shaders(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                shaders(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "wgsl") {
                found.push(path);
            }
        }
    }

    /// GIVEN every shader WHEN it is parsed and validated without a graphics device THEN it is within what WebGL2 offers.
    #[test]
    fn every_shader_is_valid() {
        let mut found = Vec::new();
        shaders(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
        assert!(found.len() >= 3, "only {found:?}");
        for path in found {
            let source = std::fs::read_to_string(&path).unwrap();
            let module = naga::front::wgsl::parse_str(&source)
                .unwrap_or_else(|error| panic!("{}: {}", path.display(), error.emit_to_string(&source)));
            // No capability beyond the core: WebGL2 has none of them.
            let mut validator =
                naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
            if let Err(error) = validator.validate(&module) {
                panic!("{}: {}", path.display(), error.emit_to_string(&source));
            }
            let stages: Vec<_> = module.entry_points.iter().map(|entry| entry.stage).collect();
            assert!(stages.contains(&naga::ShaderStage::Vertex), "{}: no vertex stage", path.display());
            assert!(stages.contains(&naga::ShaderStage::Fragment), "{}: no fragment stage", path.display());
            assert!(!stages.contains(&naga::ShaderStage::Compute), "{}: WebGL2 has no compute", path.display());
        }
    }
}

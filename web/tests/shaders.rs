//! Every shader parses and validates, without a graphics device, within what WebGL2 offers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

fn shaders(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("source folder") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            shaders(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "wgsl") {
            found.push(path);
        }
    }
}

#[test]
fn every_shader_is_valid() {
    let mut found = Vec::new();
    shaders(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
    assert!(found.len() >= 3, "only {found:?}");
    for path in found {
        let source = std::fs::read_to_string(&path).expect("shader");
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

// Copies a finished picture onto the canvas, pixel by pixel. Keep in sync with `Placement` in image.rs.

struct Placement {
    // Top left corner on the canvas, device pixels; z is the number of rows where the first is the lowest, else 0; w unused.
    corner: vec4<f32>,
}

@group(0) @binding(0) var<uniform> placement: Placement;
@group(0) @binding(1) var picture: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle over everything; the scissor leaves the panel.
    let x = f32(index & 1u) * 4.0 - 1.0;
    let y = f32(index >> 1u) * 4.0 - 1.0;
    return vec4<f32>(x, y, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let rows = placement.corner.z;
    let y = select(position.y, rows - position.y, rows > 0.0);
    let pixel = vec2<i32>(floor(vec2<f32>(position.x, y) - placement.corner.xy));
    return textureLoad(picture, pixel, 0);
}

// Flat triangles with anti-aliased edges. Keep in sync with `Vertex` in shape.rs.

struct Canvas {
    // Device pixels; z is -1 where the first row is the lowest, else 1; w unused (a uniform is at least 16 bytes long in WebGL2).
    size: vec4<f32>,
}

@group(0) @binding(0) var<uniform> canvas: Canvas;

struct Out {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
    @location(1) edge: vec2<f32>,
}

@vertex
fn vertex(
    @location(0) position: vec2<f32>,
    @location(1) color: vec4<f32>,
    @location(2) edge: vec2<f32>,
) -> Out {
    let unit = position / canvas.size.xy;
    var out: Out;
    out.position = vec4<f32>(unit.x * 2.0 - 1.0, (1.0 - unit.y * 2.0) * canvas.size.z, 0.0, 1.0);
    out.color = color;
    out.edge = edge;
    return out;
}

// edge.x: distance from the middle of the stroke, edge.y: half its width, both in pixels.
// A pixel whose centre lies on the border is covered by half.
@fragment
fn fragment(in: Out) -> @location(0) vec4<f32> {
    let coverage = clamp(in.edge.y + 0.5 - abs(in.edge.x), 0.0, 1.0);
    return vec4<f32>(in.color.rgb, in.color.a * coverage);
}

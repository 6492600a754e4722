// Lit triangles in space. Keep in sync with `Vertex` and `View` in mesh.rs.

struct View {
    clip_from_world: mat4x4<f32>,
    // Unit vector towards the light, world ENU; w is the share of light that comes from everywhere.
    light: vec4<f32>,
}

@group(0) @binding(0) var<uniform> view: View;

struct Out {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
}

@vertex
fn vertex(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) color: vec4<f32>,
) -> Out {
    var out: Out;
    out.position = view.clip_from_world * vec4<f32>(position, 1.0);
    // Without a normal: a line or a mark, which keeps its colour in any light.
    let lit = view.light.w + (1.0 - view.light.w) * max(dot(normal, view.light.xyz), 0.0);
    let shade = select(1.0, lit, dot(normal, normal) > 0.25);
    out.color = vec4<f32>(color.rgb * shade, color.a);
    return out;
}

@fragment
fn fragment(in: Out) -> @location(0) vec4<f32> {
    return in.color;
}

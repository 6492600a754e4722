//! The pipelines: flat shapes on the canvas, lit solids in a picture, the picture copied onto the canvas.

use super::image::{DEPTH_FORMAT, ImageCopier, PICTURE_FORMAT};
use super::screen::Screen;
use super::{mesh, shape};

/// Pipelines and what they are bound to. They last as long as the device.
pub(super) struct Pipelines {
    pub(super) shapes: wgpu::RenderPipeline,
    canvas_size: wgpu::Buffer,
    pub(super) canvas_group: wgpu::BindGroup,
    /// Solids that hide what is behind them.
    pub(super) solid: wgpu::RenderPipeline,
    /// Faces that are blended over it.
    pub(super) clear: wgpu::RenderPipeline,
    space_layout: wgpu::BindGroupLayout,
    pub(super) copier: ImageCopier,
    /// Samples a pixel of a picture.
    pub(super) samples: u32,
}

impl Pipelines {
    pub(super) fn new(screen: &Screen) -> Self {
        let device = &screen.device;
        let samples = if screen.multisampled { 4 } else { 1 };
        let canvas_size = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("canvas size"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let canvas_layout = uniform_layout(device, "canvas");
        let space_layout = uniform_layout(device, "space");
        Self {
            shapes: shape_pipeline(device, &canvas_layout, screen.format()),
            canvas_group: uniform_group(device, "canvas", &canvas_layout, &canvas_size),
            canvas_size,
            solid: mesh_pipeline(device, &space_layout, samples, true),
            clear: mesh_pipeline(device, &space_layout, samples, false),
            copier: ImageCopier::new(device, screen.format()),
            space_layout,
            samples,
        }
    }

    /// Tells the shaders how large the canvas is, px, and whether its first row is the lowest.
    pub(super) fn set_canvas_size(&self, queue: &wgpu::Queue, [width, height]: [u32; 2], upside_down: bool) {
        let size = [width as f32, height as f32, if upside_down { -1.0 } else { 1.0 }, 0.0];
        queue.write_buffer(&self.canvas_size, 0, bytemuck::bytes_of(&size));
    }

    /// Binds the view into space that `buffer` holds.
    pub(super) fn space_group(&self, device: &wgpu::Device, buffer: &wgpu::Buffer) -> wgpu::BindGroup {
        uniform_group(device, "space", &self.space_layout, buffer)
    }
}

fn uniform_layout(device: &wgpu::Device, label: &str) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::VERTEX,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        }],
    })
}

fn uniform_group(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    buffer: &wgpu::Buffer,
) -> wgpu::BindGroup {
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(label),
        layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
    })
}

fn pipeline_layout(device: &wgpu::Device, group: &wgpu::BindGroupLayout) -> wgpu::PipelineLayout {
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(group)],
        immediate_size: 0,
    })
}

fn shape_pipeline(
    device: &wgpu::Device,
    group: &wgpu::BindGroupLayout,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("shape.wgsl"));
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("shapes"),
        layout: Some(&pipeline_layout(device, group)),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(shape::LAYOUT)],
        },
        primitive: wgpu::PrimitiveState {
            topology: wgpu::PrimitiveTopology::TriangleStrip,
            ..wgpu::PrimitiveState::default()
        },
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format,
                blend: Some(wgpu::BlendState::ALPHA_BLENDING),
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// `solid` writes depth and hides what is behind; otherwise faces are blended over it.
fn mesh_pipeline(
    device: &wgpu::Device,
    group: &wgpu::BindGroupLayout,
    samples: u32,
    solid: bool,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("mesh.wgsl"));
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("space"),
        layout: Some(&pipeline_layout(device, group)),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(mesh::LAYOUT)],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(solid),
            depth_compare: Some(wgpu::CompareFunction::LessEqual),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState { count: samples, ..wgpu::MultisampleState::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format: PICTURE_FORMAT,
                blend: Some(wgpu::BlendState::ALPHA_BLENDING),
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

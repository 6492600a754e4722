//! A multisampled picture of its own, copied onto the canvas: for what needs depth and smooth
//! silhouettes. Only that panel pays for multisampling, not the charts.

use bytemuck::{Pod, Zeroable};

/// Format of the picture; renderable with four samples on every WebGL2 and WebGPU device.
pub(crate) const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Format of its depth buffer.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth24Plus;

/// Keep in sync with `image.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Placement {
    corner: [f32; 4],
}

/// Pipeline that copies pictures onto the canvas.
pub(crate) struct ImageCopier {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
}

/// One picture: what is drawn into, and what is copied from.
pub(crate) struct Picture {
    pub size: [u32; 2],
    pub samples: u32,
    pub drawn: wgpu::TextureView,
    /// Where the samples are resolved to, if there are several.
    pub resolved: Option<wgpu::TextureView>,
    pub depth: wgpu::TextureView,
    placement: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl ImageCopier {
    pub fn new(device: &wgpu::Device, surface_format: wgpu::TextureFormat) -> Self {
        let module = device.create_shader_module(wgpu::include_wgsl!("image.wgsl"));
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("picture"),
            entries: &[
                wgpu::BindGroupLayoutEntry {
                    binding: 0,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Buffer {
                        ty: wgpu::BufferBindingType::Uniform,
                        has_dynamic_offset: false,
                        min_binding_size: None,
                    },
                    count: None,
                },
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: false },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
            ],
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("picture"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("picture"),
            layout: Some(&pipeline_layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(surface_format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { pipeline, layout }
    }

    pub fn picture(&self, device: &wgpu::Device, size: [u32; 2], samples: u32) -> Picture {
        let texture = |label, format, sample_count, usage| {
            device
                .create_texture(&wgpu::TextureDescriptor {
                    label: Some(label),
                    size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage,
                    view_formats: &[],
                })
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let plain = texture("picture", PICTURE_FORMAT, 1, attachment | wgpu::TextureUsages::TEXTURE_BINDING);
        let many = (samples > 1).then(|| texture("picture samples", PICTURE_FORMAT, samples, attachment));
        let depth = texture("picture depth", DEPTH_FORMAT, samples, attachment);
        let placement = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture placement"),
            size: size_of::<Placement>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: placement.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&plain) },
            ],
        });
        let (drawn, resolved) = match many {
            Some(many) => (many, Some(plain)),
            None => (plain, None),
        };
        Picture { size, samples, drawn, resolved, depth, placement, group }
    }

    /// Say where a picture goes, and how many rows a canvas has whose first is the lowest (else 0); before the pass that copies it.
    pub fn place(&self, queue: &wgpu::Queue, picture: &Picture, corner: [f32; 2], rows: u32) {
        let placement = Placement { corner: [corner[0], corner[1], rows as f32, 0.0] };
        queue.write_buffer(&picture.placement, 0, bytemuck::bytes_of(&placement));
    }

    /// Copy a picture; the caller has set the scissor.
    pub fn copy(&self, pass: &mut wgpu::RenderPass<'_>, picture: &Picture) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &picture.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

//! The device, the canvas and one frame.
//!
//! The canvas is fixed over the window, behind the page. Each frame clears it, draws every panel
//! inside its own scissor, and resets the scissor before the pass ends (wgpu's WebGL present obeys
//! the last one). A lost context is reported as [`FrameOutcome::Rebuild`] once drawing is possible
//! again: the page then makes a new [`Renderer`] on the same canvas.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use wasm_bindgen::JsCast;
use wasm_bindgen::closure::Closure;
use web_sys::HtmlCanvasElement;

use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::error::GpuError;
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::image::{DEPTH_FORMAT, ImageCopier, PICTURE_FORMAT, Picture};
use super::scene::{Attitude3dView, Content, Panel};
use super::shape::{self, Shapes};
use super::{Theme, mesh};

/// Which interface of the browser draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// WebGPU.
    WebGpu,
    /// WebGL2.
    WebGl,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameOutcome {
    /// It is on the canvas.
    Drawn,
    /// Nothing could be drawn this time (hidden, busy); try again next time.
    Skipped,
    /// The context is lost; try again until it is restored.
    Lost,
    /// The device is gone for good and a new one can be had: drop this renderer and make another.
    Rebuild,
}

/// What the last frame cost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Vertices of flat shapes.
    pub shape_vertices: u32,
    /// Vertices of solids.
    pub mesh_vertices: u32,
    /// Draw calls.
    pub draws: u32,
}

/// One draw of the main pass.
enum Draw {
    Shapes { vertices: std::ops::Range<u32>, scissor: [u32; 4] },
    Picture { index: usize, scissor: [u32; 4] },
}

/// A vertex buffer that grows and is written once a frame.
struct Stream {
    label: &'static str,
    buffer: wgpu::Buffer,
}

impl Stream {
    fn new(device: &wgpu::Device, label: &'static str, bytes: u64) -> Self {
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_power_of_two(),
            usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { label, buffer }
    }

    fn write(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, bytes: &[u8]) {
        if bytes.len() as u64 > self.buffer.size() {
            *self = Self::new(device, self.label, bytes.len() as u64);
        }
        if !bytes.is_empty() {
            queue.write_buffer(&self.buffer, 0, bytes);
        }
    }
}

/// A picture of the vehicle in space and what fills it.
struct SpacePicture {
    picture: Picture,
    space: Space,
    solid: Stream,
    clear: Stream,
    view: wgpu::Buffer,
    group: wgpu::BindGroup,
}

/// Notices a lost WebGL context on the canvas.
struct ContextWatch {
    canvas: HtmlCanvasElement,
    lost: Rc<Cell<bool>>,
    restored: Rc<Cell<bool>>,
    on_lost: Closure<dyn FnMut(web_sys::Event)>,
    on_restored: Closure<dyn FnMut(web_sys::Event)>,
}

impl ContextWatch {
    fn new(canvas: HtmlCanvasElement) -> Self {
        let (lost, restored) = (Rc::new(Cell::new(false)), Rc::new(Cell::new(false)));
        let flag = lost.clone();
        let on_lost = Closure::<dyn FnMut(web_sys::Event)>::new(move |event: web_sys::Event| {
            // Without this the browser never restores the context.
            event.prevent_default();
            flag.set(true);
        });
        let flag = restored.clone();
        let on_restored = Closure::<dyn FnMut(web_sys::Event)>::new(move |_| flag.set(true));
        let listen = |name: &str, closure: &Closure<dyn FnMut(web_sys::Event)>| {
            // Fails only for names that are not strings.
            let _ = canvas.add_event_listener_with_callback(name, closure.as_ref().unchecked_ref());
        };
        listen("webglcontextlost", &on_lost);
        listen("webglcontextrestored", &on_restored);
        Self { canvas, lost, restored, on_lost, on_restored }
    }
}

impl Drop for ContextWatch {
    fn drop(&mut self) {
        for (name, closure) in [("webglcontextlost", &self.on_lost), ("webglcontextrestored", &self.on_restored)] {
            let _ = self.canvas.remove_event_listener_with_callback(name, closure.as_ref().unchecked_ref());
        }
    }
}

/// Draws panels on one canvas.
pub struct Renderer {
    canvas: HtmlCanvasElement,
    surface: wgpu::Surface<'static>,
    device: wgpu::Device,
    queue: wgpu::Queue,
    config: wgpu::SurfaceConfiguration,
    backend: Backend,
    adapter_name: String,
    scale: f32,
    most_pixels: u32,
    shape_pipeline: wgpu::RenderPipeline,
    canvas_size: wgpu::Buffer,
    canvas_group: wgpu::BindGroup,
    solid_pipeline: wgpu::RenderPipeline,
    clear_pipeline: wgpu::RenderPipeline,
    space_layout: wgpu::BindGroupLayout,
    copier: ImageCopier,
    samples: u32,
    shapes: Shapes,
    scratch: Scratch,
    stream: Stream,
    pictures: Vec<SpacePicture>,
    draws: Vec<Draw>,
    device_lost: Arc<AtomicBool>,
    watch: ContextWatch,
    stats: FrameStats,
}

/// A surface for the canvas; the page's code also compiles natively, where there is none.
#[cfg(target_arch = "wasm32")]
fn surface_of(instance: &wgpu::Instance, canvas: &HtmlCanvasElement) -> Result<wgpu::Surface<'static>, GpuError> {
    instance
        .create_surface(wgpu::SurfaceTarget::Canvas(canvas.clone()))
        .map_err(|error| GpuError::Surface(error.to_string()))
}

#[cfg(not(target_arch = "wasm32"))]
fn surface_of(_: &wgpu::Instance, _: &HtmlCanvasElement) -> Result<wgpu::Surface<'static>, GpuError> {
    Err(GpuError::Surface("a canvas needs a browser".to_owned()))
}

impl Renderer {
    /// A renderer on this canvas, by WebGPU where the browser has it, else by WebGL2.
    pub async fn new(canvas: HtmlCanvasElement) -> Result<Self, GpuError> {
        Self::with_backends(canvas, wgpu::Backends::BROWSER_WEBGPU | wgpu::Backends::GL).await
    }

    /// The same by WebGL2 even where there is WebGPU: for comparison, and for drivers that lie.
    pub async fn new_webgl(canvas: HtmlCanvasElement) -> Result<Self, GpuError> {
        Self::with_backends(canvas, wgpu::Backends::GL).await
    }

    async fn with_backends(canvas: HtmlCanvasElement, backends: wgpu::Backends) -> Result<Self, GpuError> {
        let descriptor =
            wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() };
        let instance = wgpu::util::new_instance_with_webgpu_detection(descriptor).await;
        let surface = surface_of(&instance, &canvas)?;
        let adapter = instance
            .request_adapter(&wgpu::RequestAdapterOptions {
                compatible_surface: Some(&surface),
                ..wgpu::RequestAdapterOptions::default()
            })
            .await
            .map_err(|error| GpuError::Adapter(error.to_string()))?;
        let info = adapter.get_info();
        let backend = if info.backend == wgpu::Backend::BrowserWebGpu { Backend::WebGpu } else { Backend::WebGl };
        let limits = wgpu::Limits::downlevel_webgl2_defaults().using_resolution(adapter.limits());
        let most_pixels = limits.max_texture_dimension_2d;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor { required_limits: limits, ..wgpu::DeviceDescriptor::default() })
            .await
            .map_err(|error| GpuError::Device(error.to_string()))?;
        let device_lost = Arc::new(AtomicBool::new(false));
        let flag = device_lost.clone();
        device.set_device_lost_callback(move |reason, _| {
            // Dropping the renderer destroys the device too; only the other reasons matter.
            if reason != wgpu::DeviceLostReason::Destroyed {
                flag.store(true, Ordering::Relaxed);
            }
        });
        // A non-sRGB format: colours are given as the style sheet has them, and blend as there.
        let formats = surface.get_capabilities(&adapter).formats;
        let format = formats
            .iter()
            .find(|format| !format.is_srgb())
            .or(formats.first())
            .copied()
            .ok_or_else(|| GpuError::Format { adapter: info.name.clone() })?;
        let mut config = surface
            .get_default_config(&adapter, canvas.width().max(1), canvas.height().max(1))
            .ok_or_else(|| GpuError::Format { adapter: info.name.clone() })?;
        config.format = format;
        let flags = adapter.get_texture_format_features(PICTURE_FORMAT).flags;
        let samples = if flags.sample_count_supported(4) { 4 } else { 1 };

        let canvas_size = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("canvas size"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let canvas_layout = uniform_layout(&device, "canvas");
        let canvas_group = uniform_group(&device, "canvas", &canvas_layout, &canvas_size);
        let space_layout = uniform_layout(&device, "space");
        let shape_pipeline = shape_pipeline(&device, &canvas_layout, format);
        let solid_pipeline = mesh_pipeline(&device, &space_layout, samples, true);
        let clear_pipeline = mesh_pipeline(&device, &space_layout, samples, false);
        let copier = ImageCopier::new(&device, format);
        let stream = Stream::new(&device, "shapes", 1 << 18);
        let mut renderer = Self {
            watch: ContextWatch::new(canvas.clone()),
            canvas,
            surface,
            device,
            queue,
            config,
            backend,
            adapter_name: info.name,
            scale: 1.0,
            most_pixels,
            shape_pipeline,
            canvas_size,
            canvas_group,
            solid_pipeline,
            clear_pipeline,
            space_layout,
            copier,
            samples,
            shapes: Shapes::default(),
            scratch: Scratch::default(),
            stream,
            pictures: Vec::new(),
            draws: Vec::new(),
            device_lost,
            stats: FrameStats::default(),
        };
        renderer.configure();
        Ok(renderer)
    }

    /// Interface in use.
    pub fn backend(&self) -> Backend {
        self.backend
    }

    /// What the browser calls its graphics adapter.
    pub fn adapter_name(&self) -> &str {
        &self.adapter_name
    }

    /// What the last frame cost.
    pub fn stats(&self) -> FrameStats {
        self.stats
    }

    /// Fit the canvas to its size on the page (CSS pixels) and the device pixel ratio. Cheap when
    /// nothing changed, so it may be called before each frame.
    pub fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) {
        let ratio = if device_pixel_ratio.is_finite() { device_pixel_ratio.clamp(0.25, 8.0) } else { 1.0 };
        let pixels = |css: f64| ((css * ratio).round().max(1.0) as u32).min(self.most_pixels);
        let (width, height) = (pixels(css_width), pixels(css_height));
        self.scale = ratio as f32;
        if (width, height) == (self.config.width, self.config.height) {
            return;
        }
        self.canvas.set_width(width);
        self.canvas.set_height(height);
        (self.config.width, self.config.height) = (width, height);
        self.configure();
    }

    fn configure(&mut self) {
        self.surface.configure(&self.device, &self.config);
        let size = [self.config.width as f32, self.config.height as f32, 0.0, 0.0];
        self.queue.write_buffer(&self.canvas_size, 0, bytemuck::bytes_of(&size));
    }

    /// Draw these panels, and nothing else, on a canvas of the theme's page colour.
    pub fn frame(&mut self, theme: &Theme, panels: &[Panel<'_>]) -> FrameOutcome {
        if self.watch.lost.get() {
            return if self.watch.restored.get() { FrameOutcome::Rebuild } else { FrameOutcome::Lost };
        }
        if self.device_lost.load(Ordering::Relaxed) {
            return FrameOutcome::Rebuild;
        }
        let surface = match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(texture) | wgpu::CurrentSurfaceTexture::Suboptimal(texture) => texture,
            wgpu::CurrentSurfaceTexture::Timeout
            | wgpu::CurrentSurfaceTexture::Occluded
            | wgpu::CurrentSurfaceTexture::Validation => return FrameOutcome::Skipped,
            wgpu::CurrentSurfaceTexture::Outdated => {
                self.configure();
                return FrameOutcome::Skipped;
            }
            wgpu::CurrentSurfaceTexture::Lost => return FrameOutcome::Rebuild,
        };
        self.build(panels);
        let view = surface.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        self.draw_pictures(&mut encoder, panels);
        self.draw_canvas(&mut encoder, &view, theme);
        self.queue.submit([encoder.finish()]);
        self.queue.present(surface);
        FrameOutcome::Drawn
    }

    /// Panels to triangles, and triangles to the device.
    fn build(&mut self, panels: &[Panel<'_>]) {
        self.shapes.clear();
        self.draws.clear();
        let mut pictures = 0;
        for panel in panels {
            let plot = Plot::new(panel.rect, self.scale);
            let Some(scissor) = self.scissor(plot) else { continue };
            let first = self.shapes.mark();
            match &panel.content {
                Content::Chart(view) => draw_chart(&mut self.shapes, &mut self.scratch, plot, view),
                Content::Heatmap(view) => draw_heatmap(&mut self.shapes, &mut self.scratch, plot, view),
                Content::Horizon(view) => draw_horizon(&mut self.shapes, plot, view),
                Content::Attitude3d(view) => {
                    self.build_picture(pictures, plot, view);
                    self.draws.push(Draw::Picture { index: pictures, scissor });
                    pictures += 1;
                }
            }
            let end = self.shapes.mark();
            if end > first {
                self.draws.push(Draw::Shapes { vertices: first..end, scissor });
            }
        }
        self.pictures.truncate(pictures);
        let vertices = self.shapes.vertices();
        self.stream.write(&self.device, &self.queue, bytemuck::cast_slice(vertices));
        let solids = self.pictures.iter().map(|p| p.space.solid.vertices().len() + p.space.clear.vertices().len());
        self.stats = FrameStats {
            shape_vertices: vertices.len() as u32,
            mesh_vertices: solids.sum::<usize>() as u32,
            draws: self.draws.len() as u32 + 2 * pictures as u32,
        };
    }

    /// The part of a panel that lies on the canvas: x, y, width, height.
    fn scissor(&self, plot: Plot) -> Option<[u32; 4]> {
        let clamp = |p: f32, most: u32| p.clamp(0.0, most as f32) as u32;
        let (left, right) = (clamp(plot.left, self.config.width), clamp(plot.right, self.config.width));
        let (top, bottom) = (clamp(plot.top, self.config.height), clamp(plot.bottom, self.config.height));
        (right > left && bottom > top).then(|| [left, top, right - left, bottom - top])
    }

    fn build_picture(&mut self, index: usize, plot: Plot, view: &Attitude3dView<'_>) {
        let limit = |px: f32| (px as u32).clamp(1, self.most_pixels);
        let size = [limit(plot.width()), limit(plot.height())];
        if self.pictures.get(index).is_none_or(|old| old.picture.size != size) {
            let fresh = self.new_picture(size);
            if let Some(old) = self.pictures.get_mut(index) {
                old.picture = fresh.picture;
            } else {
                self.pictures.push(fresh);
            }
        }
        let Some(target) = self.pictures.get_mut(index) else { return };
        let seen = target.space.build(view, size.map(|px| px as f32), self.scale);
        self.queue.write_buffer(&target.view, 0, bytemuck::bytes_of(&seen));
        target.solid.write(&self.device, &self.queue, bytemuck::cast_slice(target.space.solid.vertices()));
        target.clear.write(&self.device, &self.queue, bytemuck::cast_slice(target.space.clear.vertices()));
        self.copier.place(&self.queue, &target.picture, [plot.left, plot.top]);
    }

    fn new_picture(&self, size: [u32; 2]) -> SpacePicture {
        let view = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("space"),
            size: size_of::<mesh::View>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        SpacePicture {
            picture: self.copier.picture(&self.device, size, self.samples),
            space: Space::default(),
            solid: Stream::new(&self.device, "solids", 1 << 17),
            clear: Stream::new(&self.device, "clear faces", 1 << 17),
            group: uniform_group(&self.device, "space", &self.space_layout, &view),
            view,
        }
    }

    /// A pass of its own for each view into space.
    fn draw_pictures(&self, encoder: &mut wgpu::CommandEncoder, panels: &[Panel<'_>]) {
        let mut views = panels.iter().filter_map(|panel| match &panel.content {
            Content::Attitude3d(view) if self.scissor(Plot::new(panel.rect, self.scale)).is_some() => Some(view),
            _ => None,
        });
        for target in &self.pictures {
            let Some(view) = views.next() else { return };
            let picture = &target.picture;
            let store = if picture.samples > 1 { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("space"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &picture.drawn,
                    depth_slice: None,
                    resolve_target: picture.resolved.as_ref(),
                    ops: wgpu::Operations { load: wgpu::LoadOp::Clear(view.theme.plot.clear()), store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &picture.depth,
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Discard }),
                    stencil_ops: None,
                }),
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_bind_group(0, &target.group, &[]);
            for (pipeline, stream, mesh) in [
                (&self.solid_pipeline, &target.solid, &target.space.solid),
                (&self.clear_pipeline, &target.clear, &target.space.clear),
            ] {
                if mesh.vertices().is_empty() {
                    continue;
                }
                pass.set_pipeline(pipeline);
                pass.set_vertex_buffer(0, stream.buffer.slice(..));
                pass.draw(0..mesh.vertices().len() as u32, 0..1);
            }
        }
    }

    fn draw_canvas(&self, encoder: &mut wgpu::CommandEncoder, view: &wgpu::TextureView, theme: &Theme) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("canvas"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(theme.page.clear()), store: wgpu::StoreOp::Store },
            })],
            ..wgpu::RenderPassDescriptor::default()
        });
        for draw in &self.draws {
            match draw {
                Draw::Shapes { vertices, scissor: [x, y, width, height] } => {
                    pass.set_scissor_rect(*x, *y, *width, *height);
                    pass.set_pipeline(&self.shape_pipeline);
                    pass.set_bind_group(0, &self.canvas_group, &[]);
                    pass.set_vertex_buffer(0, self.stream.buffer.slice(..));
                    pass.draw(vertices.clone(), 0..1);
                }
                Draw::Picture { index, scissor: [x, y, width, height] } => {
                    let Some(target) = self.pictures.get(*index) else { continue };
                    pass.set_scissor_rect(*x, *y, *width, *height);
                    self.copier.copy(&mut pass, &target.picture);
                }
            }
        }
        // wgpu's WebGL present obeys the last scissor and viewport.
        let (width, height) = (self.config.width, self.config.height);
        pass.set_viewport(0.0, 0.0, width as f32, height as f32, 0.0, 1.0);
        pass.set_scissor_rect(0, 0, width, height);
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
            buffers: &[Some(shape::Vertex::LAYOUT)],
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
            buffers: &[Some(mesh::Vertex::LAYOUT)],
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

//! One frame by a graphics card: panels to triangles, triangles to the canvas.
//!
//! The canvas is fixed over the window, behind the page. Each frame clears it and draws every panel
//! inside its own scissor. A lost context is reported as [`FrameOutcome::Rebuild`] once drawing is possible
//! again: the page then makes a new [`Renderer`](super::Renderer) on the same canvas.

use plumbline_raster::View;
use web_sys::HtmlCanvasElement;

use super::Theme;
use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::error::GpuError;
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::image::{PICTURE_FORMAT, Picture};
use super::pipelines::Pipelines;
use super::scene::{Attitude3dView, Content, Panel};
use super::screen::{Backend, Missing, Screen};
use super::shape::Shapes;

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

/// Draws panels on one canvas, by WebGPU or WebGL2.
pub(super) struct Card {
    screen: Screen,
    pipelines: Pipelines,
    shapes: Shapes,
    scratch: Scratch,
    stream: Stream,
    pictures: Vec<SpacePicture>,
    draws: Vec<Draw>,
    stats: FrameStats,
}

impl Card {
    /// On this canvas, by one of these interfaces.
    pub async fn new(canvas: HtmlCanvasElement, backends: wgpu::Backends) -> Result<Self, GpuError> {
        let screen = Screen::open(canvas, backends, PICTURE_FORMAT).await?;
        let pipelines = Pipelines::new(&screen);
        pipelines.set_canvas_size(&screen.queue, screen.size(), screen.upside_down());
        Ok(Self {
            stream: Stream::new(&screen.device, "shapes", 1 << 18),
            screen,
            pipelines,
            shapes: Shapes::default(),
            scratch: Scratch::default(),
            pictures: Vec::new(),
            draws: Vec::new(),
            stats: FrameStats::default(),
        })
    }

    /// The same, if what it draws comes to be seen.
    pub async fn seen(canvas: HtmlCanvasElement, backends: wgpu::Backends) -> Result<Self, GpuError> {
        let mut card = Self::new(canvas, backends).await?;
        if card.frame(&Theme::of(false), &[]) == FrameOutcome::Drawn && card.screen.is_painted() {
            return Ok(card);
        }
        Err(GpuError::Unseen { adapter: card.screen.adapter_name })
    }

    pub fn backend(&self) -> Backend {
        self.screen.backend
    }

    pub fn adapter_name(&self) -> &str {
        &self.screen.adapter_name
    }

    pub fn stats(&self) -> FrameStats {
        self.stats
    }

    pub fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) {
        if self.screen.resize(css_width, css_height, device_pixel_ratio) {
            self.pipelines.set_canvas_size(&self.screen.queue, self.screen.size(), self.screen.upside_down());
        }
    }

    pub fn frame(&mut self, theme: &Theme, panels: &[Panel<'_>]) -> FrameOutcome {
        let target = match self.screen.target() {
            Ok(target) => target,
            Err(Missing::Busy) => return FrameOutcome::Skipped,
            Err(Missing::Lost) => return FrameOutcome::Lost,
            Err(Missing::Gone) => return FrameOutcome::Rebuild,
        };
        self.build(panels);
        let mut encoder =
            self.screen.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        self.draw_pictures(&mut encoder, panels);
        self.draw_canvas(&mut encoder, &target.view, theme);
        self.screen.queue.submit([encoder.finish()]);
        self.screen.show(target);
        FrameOutcome::Drawn
    }

    /// Panels to triangles, and triangles to the device.
    fn build(&mut self, panels: &[Panel<'_>]) {
        self.shapes.clear();
        self.draws.clear();
        let mut pictures = 0;
        for panel in panels {
            let plot = Plot::new(panel.rect, self.screen.scale);
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
        self.stream.write(&self.screen.device, &self.screen.queue, bytemuck::cast_slice(vertices));
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
        let [width, height] = self.screen.size();
        let (left, right) = (clamp(plot.left, width), clamp(plot.right, width));
        let (top, bottom) = (clamp(plot.top, height), clamp(plot.bottom, height));
        (right > left && bottom > top).then(|| [left, top, right - left, bottom - top])
    }

    fn build_picture(&mut self, index: usize, plot: Plot, view: &Attitude3dView<'_>) {
        let limit = |px: f32| (px as u32).clamp(1, self.screen.most_pixels);
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
        let seen = target.space.build(view, size.map(|px| px as f32), self.screen.scale);
        self.screen.queue.write_buffer(&target.view, 0, bytemuck::bytes_of(&seen));
        target.solid.write(
            &self.screen.device,
            &self.screen.queue,
            bytemuck::cast_slice(target.space.solid.vertices()),
        );
        target.clear.write(
            &self.screen.device,
            &self.screen.queue,
            bytemuck::cast_slice(target.space.clear.vertices()),
        );
        let rows = if self.screen.upside_down() { self.screen.size()[1] } else { 0 };
        self.pipelines.copier.place(&self.screen.queue, &target.picture, [plot.left, plot.top], rows);
    }

    fn new_picture(&self, size: [u32; 2]) -> SpacePicture {
        let view = self.screen.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("space"),
            size: size_of::<View>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        SpacePicture {
            picture: self.pipelines.copier.picture(&self.screen.device, size, self.pipelines.samples),
            space: Space::default(),
            solid: Stream::new(&self.screen.device, "solids", 1 << 17),
            clear: Stream::new(&self.screen.device, "clear faces", 1 << 17),
            group: self.pipelines.space_group(&self.screen.device, &view),
            view,
        }
    }

    /// A pass of its own for each view into space.
    fn draw_pictures(&self, encoder: &mut wgpu::CommandEncoder, panels: &[Panel<'_>]) {
        let mut views = panels.iter().filter_map(|panel| match &panel.content {
            Content::Attitude3d(view) if self.scissor(Plot::new(panel.rect, self.screen.scale)).is_some() => Some(view),
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
                (&self.pipelines.solid, &target.solid, &target.space.solid),
                (&self.pipelines.clear, &target.clear, &target.space.clear),
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
        let [_, height] = self.screen.size();
        let leave = |pass: &mut wgpu::RenderPass<'_>, [x, y, wide, high]: [u32; 4]| {
            let first = if self.screen.upside_down() { height - y - high } else { y };
            pass.set_scissor_rect(x, first, wide, high);
        };
        for draw in &self.draws {
            match draw {
                Draw::Shapes { vertices, scissor } => {
                    leave(&mut pass, *scissor);
                    pass.set_pipeline(&self.pipelines.shapes);
                    pass.set_bind_group(0, &self.pipelines.canvas_group, &[]);
                    pass.set_vertex_buffer(0, self.stream.buffer.slice(..));
                    pass.draw(vertices.clone(), 0..1);
                }
                Draw::Picture { index, scissor } => {
                    let Some(target) = self.pictures.get(*index) else { continue };
                    leave(&mut pass, *scissor);
                    self.pipelines.copier.copy(&mut pass, &target.picture);
                }
            }
        }
    }
}

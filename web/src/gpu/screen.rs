//! The canvas and the device that draws on it: asked for, fitted to the page, noticed when lost.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use wasm_bindgen::JsCast;
use wasm_bindgen::closure::Closure;
use web_sys::HtmlCanvasElement;

use super::error::GpuError;
use super::pixels::Pixels;

/// Which interface of the browser draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// WebGPU.
    WebGpu,
    /// WebGL2.
    WebGl,
    /// The processor, without a graphics card.
    Processor,
}

/// How many pixels a size on the page (CSS pixels) takes, at most `most` each way, and how many one CSS pixel takes.
pub(super) fn pixels(css: [f64; 2], device_pixel_ratio: f64, most: u32) -> ([u32; 2], f32) {
    let ratio = if device_pixel_ratio.is_finite() { device_pixel_ratio.clamp(0.25, 8.0) } else { 1.0 };
    (css.map(|css| ((css * ratio).round().max(1.0) as u32).min(most)), ratio as f32)
}

/// Why there is nothing to draw on.
pub(super) enum Missing {
    /// Hidden, or busy: next time there may be.
    Busy,
    /// The context is lost, and not restored yet.
    Lost,
    /// The device is gone for good, and a new one can be had.
    Gone,
}

/// What one frame is drawn on.
pub(super) struct Target {
    pub(super) view: wgpu::TextureView,
    /// To be presented; `None` where the browser shows what was drawn by itself.
    surface: Option<wgpu::SurfaceTexture>,
}

/// See the module documentation.
pub(super) struct Screen {
    canvas: HtmlCanvasElement,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    /// The framebuffer of the canvas itself, in WebGL: presenting a surface there copies every pixel once more, which takes
    /// three times as long as all else where there is no graphics card.
    framebuffer: Option<wgpu::Texture>,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) backend: Backend,
    /// What the browser calls its graphics adapter.
    pub(super) adapter_name: String,
    /// Can pictures be drawn with four samples a pixel?
    pub(super) multisampled: bool,
    /// Pixels for one CSS pixel.
    pub(super) scale: f32,
    /// Most pixels a picture may be wide or high.
    pub(super) most_pixels: u32,
    watch: ContextWatch,
    device_lost: Arc<AtomicBool>,
}

impl Screen {
    /// Asks the browser for a device that draws on `canvas`, for pictures of format `picture` as well.
    pub(super) async fn open(
        canvas: HtmlCanvasElement,
        backends: wgpu::Backends,
        picture: wgpu::TextureFormat,
    ) -> Result<Self, GpuError> {
        let descriptor =
            wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() };
        let instance = wgpu::Instance::new(descriptor);
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
        let config = configuration(&surface, &adapter, &canvas)
            .ok_or_else(|| GpuError::Format { adapter: info.name.clone() })?;
        let mut screen = Self {
            watch: ContextWatch::new(canvas.clone()),
            device_lost: watch_device(&device),
            multisampled: adapter.get_texture_format_features(picture).flags.sample_count_supported(4),
            adapter_name: info.name,
            scale: 1.0,
            canvas,
            surface,
            config,
            framebuffer: None,
            device,
            queue,
            backend,
            most_pixels,
        };
        screen.configure();
        Ok(screen)
    }

    /// Format of the canvas.
    pub(super) fn format(&self) -> wgpu::TextureFormat {
        self.config.format
    }

    /// Width and height of the canvas, px.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    /// Fits the canvas to its size on the page (CSS pixels) and the device pixel ratio; did its size change?
    pub(super) fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) -> bool {
        let ([width, height], scale) = pixels([css_width, css_height], device_pixel_ratio, self.most_pixels);
        self.scale = scale;
        if [width, height] == self.size() {
            return false;
        }
        self.canvas.set_width(width);
        self.canvas.set_height(height);
        (self.config.width, self.config.height) = (width, height);
        self.configure();
        true
    }

    /// Is the first row of pixels the lowest, as OpenGL has it?
    pub(super) fn upside_down(&self) -> bool {
        self.framebuffer.is_some()
    }

    fn configure(&mut self) {
        if self.backend == Backend::WebGpu {
            self.surface.configure(&self.device, &self.config);
        } else {
            self.framebuffer = framebuffer_of(&self.device, &self.config);
        }
    }

    /// What the next frame is drawn on.
    pub(super) fn target(&mut self) -> Result<Target, Missing> {
        if self.watch.lost.get() {
            return Err(if self.watch.restored.get() { Missing::Gone } else { Missing::Lost });
        }
        if self.device_lost.load(Ordering::Relaxed) {
            return Err(Missing::Gone);
        }
        let view_of = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        if let Some(framebuffer) = &self.framebuffer {
            return Ok(Target { view: view_of(framebuffer), surface: None });
        }
        match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(texture) | wgpu::CurrentSurfaceTexture::Suboptimal(texture) => {
                Ok(Target { view: view_of(&texture.texture), surface: Some(texture) })
            }
            wgpu::CurrentSurfaceTexture::Timeout
            | wgpu::CurrentSurfaceTexture::Occluded
            | wgpu::CurrentSurfaceTexture::Validation => Err(Missing::Busy),
            wgpu::CurrentSurfaceTexture::Outdated => {
                self.configure();
                Err(Missing::Busy)
            }
            wgpu::CurrentSurfaceTexture::Lost => Err(Missing::Gone),
        }
    }

    /// Shows a frame whose commands have been submitted.
    pub(super) fn show(&self, target: Target) {
        if let Some(surface) = target.surface {
            self.queue.present(surface);
        }
    }

    /// Is the canvas painted? To be asked by whoever just showed a frame, before the browser has its turn.
    pub(super) fn is_painted(&self) -> bool {
        Pixels::read(&self.canvas, 1, 1).is_some_and(|pixels| pixels.are_painted())
    }
}

/// A canvas laid over the page's own, for whoever cannot draw on that: what a canvas was first asked to draw by stays. Goes when it is
/// dropped.
pub(super) struct Over(HtmlCanvasElement);

impl Over {
    /// Over this one, and as large.
    pub(super) fn new(canvas: &HtmlCanvasElement) -> Option<Self> {
        let over: HtmlCanvasElement = canvas.clone_node().ok()?.dyn_into().ok()?;
        canvas.after_with_node_1(&over).ok()?;
        Some(Self(over))
    }

    pub(super) fn canvas(&self) -> &HtmlCanvasElement {
        &self.0
    }
}

impl Drop for Over {
    fn drop(&mut self) {
        self.0.remove();
    }
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

/// The framebuffer that the browser shows, of the canvas that `device` was made for.
#[cfg(target_arch = "wasm32")]
fn framebuffer_of(device: &wgpu::Device, config: &wgpu::SurfaceConfiguration) -> Option<wgpu::Texture> {
    use wgpu::hal::gles;

    let mut framebuffer = gles::Texture::default_framebuffer(config.format);
    // No framebuffer object stands for the canvas's own; wgpu's name for that, `DefaultRenderbuffer`, would have the browser complain
    // of each pass: it names a colour attachment, of which that framebuffer has none.
    framebuffer.inner = gles::TextureInner::ExternalFramebuffer { inner: wasm_bindgen::JsValue::NULL.unchecked_into() };
    let descriptor = wgpu::TextureDescriptor {
        label: Some("canvas"),
        size: wgpu::Extent3d { width: config.width, height: config.height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: config.format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    };
    // SAFETY: the device draws by the canvas's own context, to which no framebuffer object means the canvas; that is as large as its
    // configuration says, has a plain colour for each pixel, is cleared before anything is drawn, and is only ever drawn on.
    Some(unsafe {
        device.create_texture_from_hal::<wgpu::hal::api::Gles>(
            framebuffer,
            &descriptor,
            wgpu::TextureUses::UNINITIALIZED,
        )
    })
}

#[cfg(not(target_arch = "wasm32"))]
fn framebuffer_of(_: &wgpu::Device, _: &wgpu::SurfaceConfiguration) -> Option<wgpu::Texture> {
    None
}

/// How the canvas is drawn on; `None` where the adapter cannot draw on it at all.
fn configuration(
    surface: &wgpu::Surface<'static>,
    adapter: &wgpu::Adapter,
    canvas: &HtmlCanvasElement,
) -> Option<wgpu::SurfaceConfiguration> {
    // A non-sRGB format: colours are given as the style sheet has them, and blend as there.
    let formats = surface.get_capabilities(adapter).formats;
    let format = formats.iter().find(|format| !format.is_srgb()).or(formats.first()).copied()?;
    let mut config = surface.get_default_config(adapter, canvas.width().max(1), canvas.height().max(1))?;
    config.format = format;
    Some(config)
}

/// Set once the device is lost for another reason than that nobody wants it any more.
fn watch_device(device: &wgpu::Device) -> Arc<AtomicBool> {
    let lost = Arc::new(AtomicBool::new(false));
    let flag = lost.clone();
    device.set_device_lost_callback(move |reason, _| {
        // Dropping the renderer destroys the device too; only the other reasons matter.
        if reason != wgpu::DeviceLostReason::Destroyed {
            flag.store(true, Ordering::Relaxed);
        }
    });
    lost
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

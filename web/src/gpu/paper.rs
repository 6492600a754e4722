//! One frame where no graphics card draws: panels to triangles as everywhere, triangles to pixels by the processor, pixels to the canvas.

use wasm_bindgen::{Clamped, JsCast};
use web_sys::{
    CanvasRenderingContext2d, HtmlCanvasElement, ImageData, WebGl2RenderingContext, WebglDebugRendererInfo,
    WebglLoseContext,
};

use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::context::FrameStats;
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::raster::{Depths, Tile};
use super::scene::{Content, Panel, Rect};
use super::screen::pixels;
use super::shape::Shapes;
use super::{Color, Theme};

/// What names a renderer that draws with the processor: Chromium's and Mesa's, and what Windows falls back to.
const RENDERERS_IN_SOFTWARE: [&str; 4] = ["SwiftShader", "llvmpipe", "softpipe", "Microsoft Basic Render"];
/// Most pixels a canvas may be wide or high.
const MOST_PIXELS: u32 = 8192;

/// Why WebGL2 is not what draws fastest here: there is none, or its renderer, which is named, draws with the processor. Asked of a canvas
/// that nobody sees: the first context of a canvas stays.
pub(super) fn without_card() -> Option<String> {
    let context = || {
        let canvas = web_sys::window()?.document()?.create_element("canvas").ok()?;
        let context = canvas.dyn_into::<HtmlCanvasElement>().ok()?.get_context("webgl2").ok()??;
        context.dyn_into::<WebGl2RenderingContext>().ok()
    };
    let Some(gl) = context() else { return Some("no WebGL2".to_owned()) };
    let asked = gl.get_extension("WEBGL_debug_renderer_info").ok().flatten();
    let name = asked.and_then(|_| gl.get_parameter(WebglDebugRendererInfo::UNMASKED_RENDERER_WEBGL).ok());
    let name = name.and_then(|name| name.as_string()).unwrap_or_default();
    if let Ok(Some(lose)) = gl.get_extension("WEBGL_lose_context") {
        lose.unchecked_into::<WebglLoseContext>().lose_context();
    }
    let found = RENDERERS_IN_SOFTWARE.iter().find(|renderer| name.contains(**renderer))?;
    Some(format!("WebGL2 only by {found}"))
}

/// What panels are drawn with; kept between frames so that nothing is allocated.
#[derive(Default)]
pub(super) struct Easel {
    shapes: Shapes,
    scratch: Scratch,
    space: Space,
    depths: Depths,
}

/// Makes `tile` the picture of a panel.
pub(super) fn paint(tile: &mut Tile, easel: &mut Easel, plot: Plot, content: &Content<'_>, page: Color) {
    let Easel { shapes, scratch, space, depths } = easel;
    tile.clear([plot.width(), plot.height()].map(|px| px as usize), page);
    shapes.clear();
    match content {
        Content::Chart(view) => draw_chart(shapes, scratch, plot, view),
        Content::Heatmap(view) => draw_heatmap(shapes, scratch, plot, view),
        Content::Horizon(view) => draw_horizon(shapes, plot, view),
        Content::Attitude3d(view) => {
            let seen = space.build(view, [plot.width(), plot.height()], plot.scale);
            tile.space(space, &seen, view.theme.plot, depths);
        }
    }
    tile.shapes(shapes.vertices(), [plot.left, plot.top]);
}

/// What the canvas shows beside the panels.
#[derive(Debug, Clone, PartialEq)]
struct Layout {
    size: [u32; 2],
    page: Color,
    places: Vec<Rect>,
}

/// Draws panels on one canvas.
pub(super) struct Paper {
    canvas: HtmlCanvasElement,
    context: CanvasRenderingContext2d,
    pub(super) why: String,
    size: [u32; 2],
    scale: f32,
    tile: Tile,
    easel: Easel,
    shown: Option<Layout>,
    pub(super) stats: FrameStats,
}

impl Paper {
    /// On this canvas, for the reason `why`; `None` where another kind of context has been asked of it.
    pub(super) fn new(canvas: HtmlCanvasElement, why: String) -> Option<Self> {
        let options = js_sys::Object::new();
        // Fails only for objects that are frozen. What is opaque is put on the screen without a look at what is behind.
        let _ = js_sys::Reflect::set(&options, &"alpha".into(), &false.into());
        let context = canvas.get_context_with_context_options("2d", &options).ok()??.dyn_into().ok()?;
        Some(Self {
            canvas,
            context,
            why,
            size: [1, 1],
            scale: 1.0,
            tile: Tile::default(),
            easel: Easel::default(),
            shown: None,
            stats: FrameStats::default(),
        })
    }

    pub(super) fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) {
        (self.size, self.scale) = pixels([css_width, css_height], device_pixel_ratio, MOST_PIXELS);
    }

    /// Clears the canvas where panels have another place, or the page another colour; was it cleared?
    pub(super) fn lay_out(&mut self, theme: &Theme, places: &[Rect]) -> bool {
        let layout = Layout { size: self.size, page: theme.page, places: places.to_vec() };
        if self.shown.as_ref() == Some(&layout) {
            return false;
        }
        let [width, height] = self.size;
        if [self.canvas.width(), self.canvas.height()] != self.size {
            self.canvas.set_width(width);
            self.canvas.set_height(height);
        }
        self.context.set_fill_style_str(&theme.page.css());
        self.context.fill_rect(0.0, 0.0, f64::from(width), f64::from(height));
        self.shown = Some(layout);
        true
    }

    pub(super) fn frame(&mut self, theme: &Theme, panels: &[Panel<'_>]) {
        self.stats = FrameStats::default();
        for panel in panels {
            let plot = Plot::new(panel.rect, self.scale);
            paint(&mut self.tile, &mut self.easel, plot, &panel.content, theme.page);
            let [width, height] = self.tile.size().map(|px| px as u32);
            self.stats.shape_vertices += self.easel.shapes.vertices().len() as u32;
            self.stats.draws += 1;
            // Fails only for panels without a pixel.
            let bytes = Clamped(self.tile.bytes());
            if let Ok(image) = ImageData::new_with_u8_clamped_array_and_sh(bytes, width, height) {
                let _ = self.context.put_image_data(&image, f64::from(plot.left), f64::from(plot.top));
            }
        }
    }
}

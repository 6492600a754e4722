//! One frame where no graphics card draws: panels to triangles as everywhere, which the page's worker makes pixels of.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use js_sys::{Array, ArrayBuffer, Uint32Array};
use plumbline_raster::Ground;
use wasm_bindgen::{JsCast, closure::Closure};
use web_sys::{
    HtmlCanvasElement, MessageEvent, WebGl2RenderingContext, WebglDebugRendererInfo, WebglLoseContext, Worker,
    WorkerOptions, WorkerType,
};

use super::context::{FrameOutcome, FrameStats};
use super::grid::Plot;
use super::scene::{Panel, Rect};
use super::screen::pixels;
use super::sheet::Sheet;
use super::{Color, Theme};

/// What names a renderer that draws with the processor: Chromium's and Mesa's, and what Windows falls back to.
const RENDERERS_IN_SOFTWARE: [&str; 4] = ["SwiftShader", "llvmpipe", "softpipe", "Microsoft Basic Render"];
/// Most pixels a canvas may be wide or high.
const MOST_PIXELS: u32 = 8192;
/// After so many workers that ended by themselves it is drawn by other means.
const MOST_ENDS: u32 = 3;

thread_local! {
    /// Workers of this page that ended by themselves.
    static ENDS: Cell<u32> = const { Cell::new(0) };
}

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

/// What the canvas shows beside the panels.
#[derive(Debug, Clone, PartialEq)]
struct Layout {
    size: [u32; 2],
    page: Color,
    places: Vec<Rect>,
}

/// Draws panels on one canvas, by a worker of the page.
pub(super) struct Paper {
    worker: Worker,
    /// Has the worker ended by itself?
    ended: Rc<Cell<bool>>,
    /// Since the worker has had its last frame and has not said that it is drawn.
    busy: Rc<Cell<bool>>,
    /// The memory of the last frame, which the worker hands back.
    memory: Rc<RefCell<Option<ArrayBuffer>>>,
    _drawn: Closure<dyn Fn(MessageEvent)>,
    _failed: Closure<dyn Fn()>,
    pub(super) why: String,
    size: [u32; 2],
    scale: f32,
    sheet: Sheet,
    shown: Option<Layout>,
    /// Must the canvas be cleared before the next panels?
    clear: bool,
    pub(super) stats: FrameStats,
}

impl Paper {
    /// On this canvas, which can be given away once only, for the reason `why`; `None` where a page has no workers that draw, or where they
    /// end by themselves.
    pub(super) async fn new(canvas: &HtmlCanvasElement, why: String) -> Option<Self> {
        if ENDS.get() >= MOST_ENDS {
            return None;
        }
        let script = canvas.owner_document()?.query_selector("meta[name=worker]").ok()??.get_attribute("content")?;
        let options = WorkerOptions::new();
        options.set_type(WorkerType::Module);
        let worker = Worker::new_with_options(&script, &options).ok()?;
        let begun = js_sys::Promise::new(&mut |done, failed| {
            worker.set_onmessage(Some(&done));
            worker.set_onerror(Some(&failed));
        });
        wasm_bindgen_futures::JsFuture::from(begun).await.ok()?;
        let given = canvas.transfer_control_to_offscreen().ok()?;
        worker.post_message_with_transfer(&given, &Array::of1(&given)).ok()?;
        let (busy, memory) = (Rc::new(Cell::new(true)), Rc::new(RefCell::new(None)));
        let (is_busy, back) = (busy.clone(), memory.clone());
        let drawn = Closure::<dyn Fn(MessageEvent)>::new(move |message: MessageEvent| {
            is_busy.set(false);
            back.replace(message.data().dyn_into().ok());
        });
        worker.set_onmessage(Some(drawn.as_ref().unchecked_ref()));
        let ended = Rc::new(Cell::new(false));
        let has_ended = ended.clone();
        let failed = Closure::<dyn Fn()>::new(move || {
            if !has_ended.replace(true) {
                ENDS.set(ENDS.get() + 1);
            }
        });
        worker.set_onerror(Some(failed.as_ref().unchecked_ref()));
        Some(Self {
            worker,
            ended,
            busy,
            memory,
            _drawn: drawn,
            _failed: failed,
            why,
            size: [1, 1],
            scale: 1.0,
            sheet: Sheet::default(),
            shown: None,
            clear: true,
            stats: FrameStats::default(),
        })
    }

    /// Is the last frame not drawn yet?
    pub(super) fn is_busy(&self) -> bool {
        self.busy.get() && !self.ended.get()
    }

    pub(super) fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) {
        (self.size, self.scale) = pixels([css_width, css_height], device_pixel_ratio, MOST_PIXELS);
    }

    /// Has the canvas cleared where panels have another place, or the page another colour; is it?
    pub(super) fn lay_out(&mut self, theme: &Theme, places: &[Rect]) -> bool {
        let layout = Layout { size: self.size, page: theme.page, places: places.to_vec() };
        let other = self.shown.as_ref() != Some(&layout);
        self.shown = Some(layout);
        self.clear |= other;
        other
    }

    pub(super) fn frame(&mut self, theme: &Theme, panels: &[Panel<'_>]) -> FrameOutcome {
        if self.ended.get() {
            return FrameOutcome::Rebuild;
        }
        if self.busy.get() {
            return FrameOutcome::Skipped;
        }
        self.stats = FrameStats::default();
        self.sheet.begin(Ground { size: self.size, page: theme.page.packed(), clear: u32::from(self.clear) });
        for panel in panels {
            let [flat, solid] = self.sheet.panel(Plot::new(panel.rect, self.scale), &panel.content, theme.page);
            self.stats.shape_vertices += flat as u32;
            self.stats.mesh_vertices += solid as u32;
            self.stats.draws += 1;
        }
        let words = self.copied();
        // Fails only for what cannot be sent.
        let sent = self.worker.post_message_with_transfer(&words, &Array::of1(&words.buffer()));
        self.busy.set(sent.is_ok());
        self.clear = false;
        FrameOutcome::Drawn
    }
}

impl Paper {
    /// The sheet as the worker gets it, in the memory of the last one where it fits.
    fn copied(&self) -> Uint32Array {
        let words = self.sheet.words();
        let length = words.len() as u32;
        let used = self.memory.take().filter(|memory| (length..=8 * length).contains(&(memory.byte_length() / 4)));
        let memory = used.unwrap_or_else(|| ArrayBuffer::new(4 * (length + length / 4)));
        let copy = Uint32Array::new_with_byte_offset_and_length(&memory, 0, length);
        copy.copy_from(words);
        copy
    }
}

impl Drop for Paper {
    fn drop(&mut self) {
        self.worker.terminate();
    }
}

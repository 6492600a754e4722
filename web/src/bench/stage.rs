//! A bare page: one canvas, some lines of text, a loop of animation frames.

use std::cell::RefCell;
use std::rc::Rc;

use wasm_bindgen::JsCast;
use wasm_bindgen::closure::Closure;
use web_sys::{Document, HtmlCanvasElement, Window};

use crate::gpu::{GpuError, Renderer};

/// Holds the callback that asks for itself again.
type Slot = Rc<RefCell<Option<Closure<dyn FnMut()>>>>;

/// See the module documentation.
#[derive(Clone)]
pub(super) struct Stage {
    window: Window,
    pub document: Document,
    pub canvas: HtmlCanvasElement,
}

impl Stage {
    pub fn new() -> Option<Self> {
        let window = web_sys::window()?;
        let document = window.document()?;
        let canvas: HtmlCanvasElement = document.create_element("canvas").ok()?.dyn_into().ok()?;
        canvas.set_attribute("style", "position:fixed;inset:0;width:100vw;height:100vh").ok()?;
        document.body()?.append_child(&canvas).ok()?;
        Some(Self { window, document, canvas })
    }

    pub async fn renderer(&self, webgl: bool) -> Result<Renderer, GpuError> {
        let canvas = self.canvas.clone();
        if webgl { Renderer::new_webgl(canvas).await } else { Renderer::new(canvas).await }
    }

    /// The canvas that is seen: a renderer may lay another over its own.
    pub fn drawn_on(&self) -> HtmlCanvasElement {
        let over = self.canvas.next_element_sibling().and_then(|over| over.dyn_into().ok());
        over.unwrap_or_else(|| self.canvas.clone())
    }

    /// Width and height of the window in CSS pixels, and the device pixel ratio.
    pub fn size(&self) -> (f64, f64, f64) {
        let number = |value: Result<wasm_bindgen::JsValue, _>| value.ok().and_then(|v| v.as_f64()).unwrap_or(1.0);
        (number(self.window.inner_width()), number(self.window.inner_height()), self.window.device_pixel_ratio())
    }

    /// Milliseconds of the page's monotonic clock.
    pub fn now_ms(&self) -> f64 {
        self.window.performance().map_or(0.0, |clock| clock.now())
    }

    /// Write a line of text under this id, at the bottom of the page.
    pub fn say(&self, id: &str, text: &str) {
        let found = self.document.get_element_by_id(id).or_else(|| {
            let element = self.document.create_element("output").ok()?;
            element.set_id(id);
            let style = "position:relative;display:block;margin-top:0.3em;font:13px monospace;color:#888";
            element.set_attribute("style", style).ok()?;
            let body = self.document.body()?;
            if self.document.query_selector("output").ok()?.is_none() {
                body.set_attribute("style", "margin:0;padding:520px 0 0 0").ok()?;
            }
            body.append_child(&element).ok()?;
            Some(element)
        });
        if let Some(element) = found {
            element.set_text_content(Some(text));
        }
    }

    /// Call `step` with the page's clock each animation frame, until it answers `false`.
    pub fn each_frame(self, mut step: impl FnMut(&Self, f64) -> bool + 'static) {
        let slot = Slot::default();
        let again = slot.clone();
        let stage = self.clone();
        *slot.borrow_mut() = Some(Closure::new(move || {
            if step(&stage, stage.now_ms()) {
                stage.request(&again);
            }
        }));
        self.request(&slot);
    }

    fn request(&self, slot: &Slot) {
        if let Some(closure) = slot.borrow().as_ref() {
            // Fails only for a page that is going away.
            let _ = self.window.request_animation_frame(closure.as_ref().unchecked_ref());
        }
    }
}

//! Animation frames: measure the places of the charts, describe what each shows (`paint/frame.rs`,
//! `paint/space.rs`), draw.
//!
//! Runs on `requestAnimationFrame`, so a hidden tab costs nothing. Labels are written only when they
//! change. Without graphics the page goes on as numbers.

use std::cell::RefCell;
use std::rc::Rc;

use leptos::{html, prelude::*};
use wasm_bindgen::{JsCast, prelude::Closure};

use crate::{
    ctx::{Ctx, Graphics},
    deck::Slot,
    gpu::{Backend, FrameOutcome, Panel, Rect, Renderer, Theme},
};

mod frame;
mod space;

use frame::Frame;
use space::Body;

/// Starts drawing on `canvas`, for as long as the page lives.
pub fn start(ctx: Ctx, canvas: NodeRef<html::Canvas>) {
    let painter = Rc::new(RefCell::new(None::<Renderer>));
    Effect::new(move |_| {
        let Some(canvas) = canvas.get() else { return };
        acquire(ctx, canvas, painter.clone());
    });
}

/// Gets a device, then begins the loop.
fn acquire(ctx: Ctx, canvas: web_sys::HtmlCanvasElement, painter: Rc<RefCell<Option<Renderer>>>) {
    leptos::task::spawn_local(async move {
        let forced = window().location().search().unwrap_or_default();
        let made = if forced.contains("graphics=none") {
            ctx.graphics.set(Graphics::Off("switched off in the address".into()));
            return;
        } else if forced.contains("graphics=webgl") {
            Renderer::new_webgl(canvas.clone()).await
        } else {
            Renderer::new(canvas.clone()).await
        };
        match made {
            Ok(renderer) => {
                let backend = match renderer.backend() {
                    Backend::WebGpu => "WebGPU",
                    Backend::WebGl => "WebGL2",
                };
                ctx.graphics.set(Graphics::On(format!("{backend}, {}", renderer.adapter_name())));
                let first = painter.borrow().is_none();
                *painter.borrow_mut() = Some(renderer);
                if first {
                    run(ctx, canvas, painter);
                }
            }
            Err(error) => ctx.graphics.set(Graphics::Off(error.to_string())),
        }
    });
}

/// The animation loop; ends when the device is gone, and [`acquire`] begins another.
fn run(ctx: Ctx, canvas: web_sys::HtmlCanvasElement, painter: Rc<RefCell<Option<Renderer>>>) {
    type Loop = Rc<RefCell<Option<Closure<dyn FnMut()>>>>;
    let next: Loop = Rc::new(RefCell::new(None));
    let again = next.clone();
    let body = Closure::<dyn FnMut()>::new(move || {
        let outcome = painter.borrow_mut().as_mut().map(|renderer| frame(ctx, renderer));
        if outcome == Some(FrameOutcome::Lost) && ctx.graphics.with_untracked(|g| *g != Graphics::Lost) {
            ctx.graphics.set(Graphics::Lost);
        }
        if outcome == Some(FrameOutcome::Rebuild) {
            *painter.borrow_mut() = None;
            acquire(ctx, canvas.clone(), painter.clone());
            return;
        }
        if let Some(closure) = again.borrow().as_ref() {
            // Fails only without a window.
            let _ = window().request_animation_frame(closure.as_ref().unchecked_ref());
        }
    });
    let _ = window().request_animation_frame(body.as_ref().unchecked_ref());
    *next.borrow_mut() = Some(body);
}

/// One frame.
fn frame(ctx: Ctx, renderer: &mut Renderer) -> FrameOutcome {
    let number = |value: Result<wasm_bindgen::JsValue, _>| value.ok().and_then(|v| v.as_f64()).unwrap_or(1.0);
    let (width, height) = (number(window().inner_width()), number(window().inner_height()));
    renderer.resize(width, height, window().device_pixel_ratio());
    let dark = ctx.dark.get_untracked();
    let theme = Theme::of(dark);
    let Some(deck) = ctx.deck.get_untracked() else { return renderer.frame(&theme, &[]) };
    let slots = deck.slots();
    let rects: Vec<Option<Rect>> = slots.iter().map(|slot| visible(slot, height)).collect();
    let instrument = deck.instrument_now();
    let frame = Frame { deck, dark, theme };
    let outcome = deck.data.try_with_value(|live| {
        let body = Body::new(live, &instrument);
        let axis = deck.axis(live);
        let panels: Vec<Panel<'_>> = slots
            .iter()
            .zip(&rects)
            .filter_map(|(slot, rect)| {
                let rect = (*rect)?;
                let content = frame.content(slot, rect, live, axis, &instrument, &body)?;
                Some(Panel { rect, content })
            })
            .collect();
        renderer.frame(&theme, &panels)
    });
    outcome.unwrap_or(FrameOutcome::Skipped)
}

/// Where a chart is, if any of it can be seen.
fn visible(slot: &Slot, height: f64) -> Option<Rect> {
    let node = slot.node.get_untracked()?;
    let r = node.get_bounding_client_rect();
    let seen = r.width() > 1.0 && r.height() > 1.0 && r.bottom() > 0.0 && r.top() < height;
    seen.then(|| Rect::new(r.left() as f32, r.top() as f32, r.width() as f32, r.height() as f32))
}

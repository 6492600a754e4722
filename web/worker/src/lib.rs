//! The page's worker where no graphics card draws: triangles to pixels, pixels to the canvas, while the page does everything else. A
//! program of its own in a thread of its own, which shares nothing: the page hands it the canvas, then a sheet per frame.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::cell::RefCell;

use js_sys::{Array, Uint32Array};
use plumbline_raster::{Depths, Ground, Tile, draw};
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{Clamped, JsCast, JsValue, closure::Closure};
use web_sys::{
    DedicatedWorkerGlobalScope, ImageData, MessageEvent, OffscreenCanvas, OffscreenCanvasRenderingContext2d,
};

/// What there is to draw with.
#[derive(Default)]
struct Easel {
    canvas: Option<(OffscreenCanvas, OffscreenCanvasRenderingContext2d)>,
    words: Vec<u32>,
    tile: Tile,
    depths: Depths,
}

/// Waits for what the page has to draw. Called by the worker's script; anywhere else nothing happens.
#[wasm_bindgen(start)]
pub fn start() {
    console_error_panic_hook::set_once();
    let Ok(scope) = js_sys::global().dyn_into::<DedicatedWorkerGlobalScope>() else { return };
    let (easel, page) = (RefCell::new(Easel::default()), scope.clone());
    let take = Closure::<dyn Fn(MessageEvent)>::new(move |message: MessageEvent| {
        let Ok(mut easel) = easel.try_borrow_mut() else { return };
        match message.data().dyn_into::<Uint32Array>() {
            Ok(words) => {
                easel.draw(&words);
                // Fails only for what cannot be sent. The page writes on it again.
                let _ = page.post_message_with_transfer(&words.buffer(), &Array::of1(&words.buffer()));
            }
            Err(canvas) => {
                easel.canvas = canvas.dyn_into().ok().and_then(context);
                tell(&page);
            }
        }
    });
    scope.set_onmessage(Some(take.as_ref().unchecked_ref()));
    // For as long as the worker lives.
    take.forget();
    tell(&scope);
}

/// That this is ready for what comes next; fails only for what cannot be sent.
fn tell(page: &DedicatedWorkerGlobalScope) {
    let _ = page.post_message(&JsValue::NULL);
}

fn context(canvas: OffscreenCanvas) -> Option<(OffscreenCanvas, OffscreenCanvasRenderingContext2d)> {
    let options = js_sys::Object::new();
    // Fails only for objects that are frozen. What is opaque is put on the screen without a look at what is behind.
    let _ = js_sys::Reflect::set(&options, &"alpha".into(), &false.into());
    let context = canvas.get_context_with_context_options("2d", &options).ok()??.dyn_into().ok()?;
    Some((canvas, context))
}

impl Easel {
    fn draw(&mut self, sheet: &Uint32Array) {
        let Self { canvas: Some((canvas, context)), words, tile, depths } = self else { return };
        words.resize(sheet.length() as usize, 0);
        sheet.copy_to(words);
        let begin = |ground: &Ground| {
            let [width, height] = ground.size;
            if [canvas.width(), canvas.height()] != ground.size {
                canvas.set_width(width);
                canvas.set_height(height);
            }
            if ground.clear != 0 {
                let [r, g, b, _] = ground.page.to_le_bytes();
                context.set_fill_style_str(&format!("rgb({r} {g} {b})"));
                context.fill_rect(0.0, 0.0, f64::from(width), f64::from(height));
            }
        };
        draw(words, tile, depths, begin, |tile, [x, y]| {
            let [width, height] = tile.size().map(|px| px as u32);
            // Fails only for panels without a pixel.
            if let Ok(image) = ImageData::new_with_u8_clamped_array_and_sh(Clamped(tile.bytes()), width, height) {
                let _ = context.put_image_data(&image, f64::from(x), f64::from(y));
            }
        });
    }
}

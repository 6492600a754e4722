//! The page of Plumbline.
//!
//! `model` is what the page knows (pure, tested natively), `gpu` draws on one canvas behind the page.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod bench;
pub mod gpu;
pub mod model;

use wasm_bindgen::prelude::wasm_bindgen;

/// Entry of the page.
#[wasm_bindgen(start)]
pub fn start() {
    console_error_panic_hook::set_once();
    // `/?bench` and `/?gallery` are pages of their own; `true` means that one of them runs.
    let _ordinary = !bench::start();
}

//! The page: Rust to wasm, Leptos for everything a person can read or press, one wgpu canvas behind it.
//!
//! ```text
//! net ─► event ─► app (pure: state + effects) ─► panel, page   text with each beat, commands up
//!          └────► model::live (topics, curves) ─► paint ─► gpu   curves on animation frames
//! ```
//! Start reading at [`app`]; [`ctx`] is what every panel holds. The browser owns no truth: after a
//! reload the ground's snapshot and history bring everything back.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod address;
pub mod app;
pub mod bench;
pub mod ctx;
pub mod deck;
pub mod event;
pub mod gpu;
pub mod keys;
pub mod model;
pub mod net;
pub mod page;
pub mod paint;
pub mod palette;
pub mod panel;
mod store;
pub mod tones;
pub mod turns;

use leptos::{html, prelude::*};
use wasm_bindgen::prelude::wasm_bindgen;

use model::route::Route;

/// Called by the page's script.
#[wasm_bindgen(start)]
pub fn start() {
    console_error_panic_hook::set_once();
    if let Some(waiting) = document().get_element_by_id("waiting") {
        waiting.remove();
    }
    // `/?bench` and `/?gallery` are pages of their own.
    if bench::start() {
        return;
    }
    leptos::mount::mount_to_body(Root);
}

/// Toolbar, page, notices; the canvas lies behind them.
#[component]
fn Root() -> impl IntoView {
    let ctx = ctx::Ctx::begin();
    provide_context(ctx);
    provide_context(panel::alarms::AlarmState::default());
    provide_context(tones::Tones::default());
    panel::alarms::sound(ctx);
    keys::listen(ctx);
    window_event_listener(leptos::ev::popstate, move |_| {
        let path = window().location().pathname().unwrap_or_default();
        ctx.route.set(Route::from_path(&path));
    });
    Effect::new(move |_| {
        if let Some(root) = document().document_element() {
            let _ = root.set_attribute("data-theme", if ctx.dark.get() { "dark" } else { "light" });
        }
    });
    let canvas = NodeRef::<html::Canvas>::new();
    paint::start(ctx, canvas);
    let route = Memo::new(move |_| ctx.route.get());
    Effect::new(move |_| document().set_title(route.with(Route::title)));
    view! {
        <canvas class="behind" node_ref=canvas aria-hidden="true"></canvas>
        <a class="skip" href="#main">"Skip to the page"</a>
        <Show when=move || route.with(|route| *route == Route::Fly)><a class="skip" href="#arm">"Skip to arming"</a></Show>
        <panel::toolbar::Toolbar />
        {move || {
            ctx.deck.set(None);
            match route.get() {
                Route::Fly => view! { <page::Fly /> }.into_any(),
                Route::Flights => view! { <page::FlightsPage /> }.into_any(),
                Route::Flight(id) => view! { <page::FlightPage id=id /> }.into_any(),
                Route::Report(id) => view! { <page::ReportPage id=id /> }.into_any(),
                Route::Compare(ids) => view! { <page::Compare ids=ids /> }.into_any(),
                Route::Experiments => view! { <page::ExperimentsPage /> }.into_any(),
                Route::Tune => view! { <page::Tune /> }.into_any(),
                Route::Calibrate => view! { <page::Calibrate /> }.into_any(),
                Route::Setup => view! { <page::Setup /> }.into_any(),
                Route::Unknown(path) => view! {
                    <main id="main" class="sheet"><h1>"No such page"</h1><p>{format!("{path} names no page. ")}<panel::toolbar::Link to=Route::Fly>"Fly"</panel::toolbar::Link></p></main>
                }.into_any(),
            }
        }}
        <panel::alarms::PageAlarms />
        <panel::alarms::HintBubble />
        <panel::alarms::Dock />
        <panel::notices::Notices />
        <panel::guide::FirstFlight />
        <panel::by_hand::FlightsByHand />
        <page::Help />
    }
}

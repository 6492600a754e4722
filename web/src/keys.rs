//! The keyboard, in one place.

use leptos::{ev, prelude::*};
use wasm_bindgen::JsCast;

use crate::{ctx::Ctx, deck::Source, model::route::Route, panel::setpoint::STEP_M};

/// Every key and what it does.
pub const KEYS: [(&str, &str); 9] = [
    ("Ctrl+Shift+X", "cut motors – vehicle falls"),
    ("↑ ↓", "altitude setpoint ±0.1 m"),
    ("Space", "pause the charts; play a recorded flight"),
    ("R", "start or stop a recording"),
    ("A", "attacks: go to the form"),
    ("← →", "recorded flight: back or on by 1 s, with Shift 10 s"),
    ("1 … 5", "Fly, Flights, Tune, Calibrate, Setup"),
    ("Esc", "close; leave a zoom or a residual"),
    ("?", "this list"),
];

/// Does the focus take the keys itself: a field, a list, a button for Space?
fn typing(e: &ev::KeyboardEvent) -> bool {
    let Some(element) = e.target().and_then(|t| t.dyn_into::<web_sys::Element>().ok()) else { return false };
    matches!(element.tag_name().as_str(), "INPUT" | "TEXTAREA" | "SELECT")
}

fn on_control(e: &ev::KeyboardEvent) -> bool {
    let Some(element) = e.target().and_then(|t| t.dyn_into::<web_sys::Element>().ok()) else { return false };
    matches!(element.tag_name().as_str(), "BUTTON" | "A" | "SUMMARY")
}

/// Listens for as long as the page lives.
pub fn listen(ctx: Ctx) {
    window_event_listener(ev::keydown, move |e| {
        if e.ctrl_key() && e.shift_key() && e.key().eq_ignore_ascii_case("x") {
            e.prevent_default();
            // A key held down is one cut.
            if !e.repeat() {
                ctx.cut();
            }
            return;
        }
        if e.ctrl_key() || e.alt_key() || e.meta_key() || typing(&e) || ctx.help.get_untracked() {
            return;
        }
        if handle(ctx, &e) {
            e.prevent_default();
        }
    });
}

/// Does what the key says; false when it says nothing here.
fn handle(ctx: Ctx, e: &ev::KeyboardEvent) -> bool {
    let deck = ctx.deck.get_untracked();
    let flying = ctx.route.with_untracked(|r| *r == Route::Fly);
    match e.key().as_str() {
        "ArrowUp" if flying => ctx.step_altitude(STEP_M),
        "ArrowDown" if flying => ctx.step_altitude(-STEP_M),
        " " if !on_control(e) && flying => {
            if let Some(deck) = deck {
                deck.toggle_pause();
            }
        }
        "r" | "R" if flying && !e.repeat() => ctx.toggle_recording(),
        "a" | "A" if flying => ctx.attacks_focus.update(|n| *n += 1),
        "1" => ctx.go(Route::Fly),
        "2" => ctx.go(Route::Flights),
        "3" => ctx.go(Route::Tune),
        "4" => ctx.go(Route::Calibrate),
        "5" => ctx.go(Route::Setup),
        "?" => ctx.help.set(true),
        "Escape" => match deck {
            Some(deck) if deck.zoom.get_untracked().is_some() => deck.zoom_out(),
            Some(deck) if deck.residual.get_untracked().is_some() => deck.residual.set(None),
            Some(deck) if deck.source == Source::Live && deck.paused_at.get_untracked().is_some() => deck.zoom_out(),
            _ => return false,
        },
        _ => return false,
    }
    true
}

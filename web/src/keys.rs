//! The keyboard, in one place.

use std::cell::Cell;
use std::rc::Rc;

use leptos::{ev, prelude::*};
use wasm_bindgen::JsCast;

use crate::{ctx::Ctx, deck::Source, event::Tone, model::route::Route, tones::Tones};

/// Every key and what it does.
pub const KEYS: [(&str, &str); 14] = [
    ("Ctrl+Shift+X", "cut motors – vehicle falls"),
    ("L", "land"),
    ("↑ ↓", "altitude setpoint ±0.1 m"),
    ("Space", "pause the charts; play a recorded flight"),
    ("R", "start or stop a recording"),
    ("A", "attacks: go to the form"),
    ("M", "two cursors that stay, to measure between"),
    ("← →", "recorded flight: back or on by 1 s, with Shift 10 s"),
    ("drag, wheel", "charts: pan, zoom; with Shift the values; double-click: back"),
    ("Alt + click", "legend: this curve alone, or all again"),
    ("T", "tones for alarms on or off"),
    ("1 … 6", "Fly, Flights, Tune, Calibrate, Setup, Experiments"),
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

thread_local! {
    static POINTER: Cell<(f64, f64)> = const { Cell::new((0.0, 0.0)) };
}

/// Where the pointer was pressed last, px; after a key, the middle of what has the focus.
pub fn pointer() -> (f64, f64) {
    POINTER.get()
}

/// The pointer was pressed here, px.
pub fn pointed(x: f64, y: f64) {
    POINTER.set((x, y));
}

/// Gives the focus back to the page, so that keys are the page's again.
pub fn let_go() {
    let focused = document().active_element().and_then(|e| e.dyn_into::<web_sys::HtmlElement>().ok());
    if let Some(focused) = focused {
        // What has the focus can lose it.
        let _ = focused.blur();
    }
}

/// A list chosen from with the pointer has had its turn: the next arrow key is the page's.
fn listen_to_lists() {
    let by_pointer = Rc::new(Cell::new(false));
    let by = by_pointer.clone();
    window_event_listener(ev::pointerdown, move |e| {
        by.set(true);
        pointed(f64::from(e.client_x()), f64::from(e.client_y()));
    });
    let by = by_pointer.clone();
    window_event_listener(ev::keydown, move |_| {
        by.set(false);
        if let Some(focused) = document().active_element() {
            let r = focused.get_bounding_client_rect();
            pointed(r.left() + r.width() / 2.0, r.bottom().min(200.0));
        }
    });
    window_event_listener(ev::change, move |e| {
        let list = e.target().and_then(|t| t.dyn_into::<web_sys::HtmlSelectElement>().ok());
        if list.is_some_and(|list| by_pointer.get() && list.form().is_none()) {
            let_go();
        }
    });
}

/// Listens for as long as the page lives.
pub fn listen(ctx: Ctx) {
    listen_to_lists();
    let tones: Tones = expect_context();
    window_event_listener(ev::keydown, move |e| {
        if e.ctrl_key() && e.shift_key() && e.key().eq_ignore_ascii_case("x") {
            e.prevent_default();
            // A key held down is one cut.
            if !e.repeat() {
                ctx.cut();
            }
            return;
        }
        if e.repeat() && (on_control(&e) && matches!(e.key().as_str(), "Enter" | " ")) {
            // The browser would press the button again and again.
            e.prevent_default();
            return;
        }
        if e.ctrl_key() || e.alt_key() || e.meta_key() || typing(&e) || ctx.help.get_untracked() {
            return;
        }
        if e.repeat() {
            // One press is one command; a held arrow does not scroll the page either.
            if ctx.route.with_untracked(|r| *r == Route::Fly) && e.key().starts_with("Arrow") {
                e.prevent_default();
            }
            return;
        }
        if e.key().eq_ignore_ascii_case("t") {
            let on = !tones.on.get_untracked();
            tones.switch(on);
            ctx.tell(Tone::Done, if on { "Tones for alarms are on" } else { "Tones for alarms are off" });
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
        "ArrowUp" if flying => ctx.step_altitude(true),
        "ArrowDown" if flying => ctx.step_altitude(false),
        " " if !on_control(e) && flying => {
            if let Some(deck) = deck {
                deck.toggle_pause();
            }
        }
        "l" | "L" if flying => ctx.land(),
        "r" | "R" if flying => ctx.toggle_recording(),
        "a" | "A" if flying => ctx.attacks_focus.update(|n| *n += 1),
        "m" | "M" => match deck {
            Some(deck) => deck.toggle_pins(),
            None => return false,
        },
        "1" => ctx.go(Route::Fly),
        "2" => ctx.go(Route::Flights),
        "3" => ctx.go(Route::Tune),
        "4" => ctx.go(Route::Calibrate),
        "5" => ctx.go(Route::Setup),
        "6" => ctx.go(Route::Experiments),
        "?" => ctx.help.set(true),
        "Escape" => match deck {
            Some(deck) if untrack(|| deck.is_zoomed()) => deck.zoom_out(),
            Some(deck) if deck.residual.get_untracked().is_some() => deck.residual.set(None),
            Some(deck) if deck.source == Source::Live && deck.paused_at.get_untracked().is_some() => deck.zoom_out(),
            _ => return false,
        },
        _ => return false,
    }
    true
}

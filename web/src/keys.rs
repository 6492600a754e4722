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
    ("Esc", "close; leave the large 3D view, a zoom or a residual"),
    ("?", "this list"),
];

/// Which keys an element takes itself, before the page does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Takes {
    /// None.
    Nothing,
    /// Those that press it: Space and Enter.
    Press,
    /// All: it is written or chosen in.
    All,
}

impl Takes {
    /// Those that the element with the focus takes.
    pub fn by(e: &ev::KeyboardEvent) -> Self {
        let Some(element) = e.target().and_then(|t| t.dyn_into::<web_sys::Element>().ok()) else {
            return Self::Nothing;
        };
        let kind = element.dyn_ref::<web_sys::HtmlInputElement>().map(web_sys::HtmlInputElement::type_);
        Self::of(&element.tag_name(), &kind.unwrap_or_default())
    }

    /// Those that an element of this name takes and, where it is an input, of this type.
    fn of(name: &str, kind: &str) -> Self {
        match (name, kind) {
            ("INPUT", "checkbox" | "button" | "submit" | "reset" | "file" | "color") => Self::Press,
            ("INPUT" | "TEXTAREA" | "SELECT", _) => Self::All,
            ("BUTTON" | "A" | "SUMMARY", _) => Self::Press,
            _ => Self::Nothing,
        }
    }
}

/// What a key says: what it writes, and under a layout of other letters than Latin ones, the Latin one at its place. Latin letters with
/// marks are Latin, too.
fn said<'a>(key: &'a str, code: &'a str) -> &'a str {
    code.strip_prefix("Key").filter(|_| key.chars().all(|c| c > '\u{24f}')).unwrap_or(key)
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
        if let Some(list) = list.filter(|_| by_pointer.get()) {
            // And nothing else, whatever has the focus: a field with text that is not taken yet would change in the midst of this.
            let _ = list.blur();
        }
    });
}

/// Listens for as long as the page lives.
pub fn listen(ctx: Ctx) {
    listen_to_lists();
    let tones: Tones = expect_context();
    window_event_listener(ev::keydown, move |e| {
        let (key, code) = (e.key(), e.code());
        let key = said(&key, &code);
        let takes = Takes::by(&e);
        if e.ctrl_key() && e.shift_key() && key.eq_ignore_ascii_case("x") {
            e.prevent_default();
            // A key held down is one cut.
            if !e.repeat() {
                ctx.cut();
            }
            return;
        }
        if e.repeat() && takes == Takes::Press && matches!(key, "Enter" | " ") {
            // The browser would press the button again and again.
            e.prevent_default();
            return;
        }
        if e.ctrl_key() || e.alt_key() || e.meta_key() || takes == Takes::All || ctx.help.get_untracked() {
            return;
        }
        if e.repeat() {
            // One press is one command; a held arrow does not scroll the page either.
            if ctx.route.with_untracked(|r| *r == Route::Fly) && key.starts_with("Arrow") {
                e.prevent_default();
            }
            return;
        }
        if key.eq_ignore_ascii_case("t") {
            let on = !tones.on.get_untracked();
            tones.switch(on);
            ctx.tell(Tone::Done, if on { "Tones for alarms are on" } else { "Tones for alarms are off" });
            return;
        }
        if handle(ctx, key, takes) {
            e.prevent_default();
        }
    });
}

/// Does what the key says; false when it says nothing here.
fn handle(ctx: Ctx, key: &str, takes: Takes) -> bool {
    let deck = ctx.deck.get_untracked();
    let flying = ctx.route.with_untracked(|r| *r == Route::Fly);
    match key {
        "ArrowUp" if flying => ctx.step_altitude(true),
        "ArrowDown" if flying => ctx.step_altitude(false),
        " " if takes == Takes::Nothing && flying => {
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
            Some(deck) if deck.wide.get_untracked() => deck.wide.set(false),
            Some(deck) if untrack(|| deck.is_zoomed()) => deck.zoom_out(),
            Some(deck) if deck.residual.get_untracked().is_some() => deck.residual.set(None),
            Some(deck) if deck.source == Source::Live && deck.paused_at.get_untracked().is_some() => deck.zoom_out(),
            _ => return false,
        },
        _ => return false,
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_written_or_chosen_in_keeps_the_keys() {
        for kind in ["text", "number", "password", "search", "range", "radio"] {
            assert_eq!(Takes::of("INPUT", kind), Takes::All, "{kind}");
        }
        assert_eq!(Takes::of("SELECT", ""), Takes::All);
        assert_eq!(Takes::of("INPUT", "checkbox"), Takes::Press);
        assert_eq!(Takes::of("BUTTON", ""), Takes::Press);
        assert_eq!(Takes::of("BODY", ""), Takes::Nothing);
    }

    #[test]
    fn letters_are_found_under_every_layout() {
        // Latin layouts go by what is written: on Dvorak's the key at the place of X writes Q.
        assert_eq!(said("X", "KeyB"), "X");
        assert_eq!(said("Q", "KeyX"), "Q");
        assert_eq!(said("ł", "KeyL"), "ł");
        // Cyrillic, Greek.
        assert_eq!(said("Ч", "KeyX"), "X");
        assert_eq!(said("λ", "KeyL"), "L");
        assert_eq!(said("ArrowUp", "ArrowUp"), "ArrowUp");
        assert_eq!(said("é", "Digit2"), "é");
    }
}

//! Animation frames: measure the places of the charts, describe what each shows (`paint/frame.rs`,
//! `paint/space.rs`), draw.
//!
//! Runs on `requestAnimationFrame`, or by a timer where the page's worker draws; a hidden tab costs nothing. Labels are written
//! only when they change. Without graphics the page goes on as numbers.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;

use leptos::{html, prelude::*};
use wasm_bindgen::{JsCast, prelude::Closure};

use crate::{
    ctx::{Ctx, Graphics},
    deck::{Deck, Picture, Slot, Source},
    gpu::{Backend, FrameOutcome, Panel, Rect, Renderer, Theme},
    model::{
        axis::{TimeAxis, ValueAxis},
        curves::{Axis, Curve, Group, Way},
        instrument::Instrument,
        live::Live,
    },
    net,
};

mod frame;
mod space;

use frame::Frame;
use space::Body;

/// A frame that takes less than this, ms, leaves time for everything else.
const LIGHT_MS: f64 = 8.0;
/// After a heavier one, pictures wait for this multiple of its time: telemetry, keys and the operator's sign of life come
/// before them.
const PAUSE_SHARE: f64 = 1.5;
/// Longest pause between two frames, ms.
const MOST_PAUSE_MS: f64 = 250.0;
/// What a live chart shows besides where its newest sample is, new spans and marks, is looked at this often, ms.
const NEWS_MS: f64 = 200.0;
/// Without a graphics card a frame begins this long after the last, ms: every second one of a usual screen.
const SOFTWARE_MS: f64 = 31.0;
/// Whether a worker that is late has drawn is looked at this often, ms.
const LATE_MS: f64 = 8.0;
/// After this long charts are looked for anew, ms …
const PLACES_MS: f64 = 100.0;
/// … and in each frame for so long after somebody did what may move them, ms: that has the browser lay out the page.
const MOVING_MS: f64 = 1000.0;
/// What may move them.
const MOVES: [&str; 6] = ["scroll", "resize", "click", "pointerdown", "keydown", "wheel"];
/// While no chart can be seen, whether one can is looked at this often.
const LOOK: Duration = Duration::from_millis(100);

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
                    Backend::Processor => "processor",
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

/// What draws a frame, which asks for itself again.
type Loop = Rc<RefCell<Option<Closure<dyn FnMut()>>>>;

/// Has the next frame drawn with the browser's next, or after so many ms.
fn ask(next: &Loop, after_ms: Option<f64>) {
    let Some(body) = &*next.borrow() else { return };
    let body = body.as_ref().unchecked_ref();
    // Fails only without a window.
    let _ = match after_ms {
        Some(ms) => window().set_timeout_with_callback_and_timeout_and_arguments_0(body, ms as i32),
        None => window().request_animation_frame(body),
    };
}

/// The animation loop; ends when the device is gone, and [`acquire`] begins another.
fn run(ctx: Ctx, canvas: web_sys::HtmlCanvasElement, painter: Rc<RefCell<Option<Renderer>>>) {
    let next: Loop = Rc::new(RefCell::new(None));
    let again = next.clone();
    let (mut shown, mut charted, mut places) = (None, None, Places::new());
    let body = Closure::<dyn FnMut()>::new(move || {
        let begun = net::now_ms();
        let outcome =
            painter.borrow_mut().as_mut().map(|renderer| frame(ctx, renderer, &mut shown, &mut charted, &mut places));
        if outcome == Some(FrameOutcome::Lost) && ctx.graphics.with_untracked(|g| *g != Graphics::Lost) {
            ctx.graphics.set(Graphics::Lost);
        }
        if outcome == Some(FrameOutcome::Rebuild) {
            *painter.borrow_mut() = None;
            acquire(ctx, canvas.clone(), painter.clone());
            // It holds itself, and cannot let itself go while it runs.
            let over = again.clone();
            set_timeout(move || drop(over.take()), Duration::ZERO);
            return;
        }
        let nothing = shown.as_ref().is_some_and(Still::shows_nothing);
        let again = again.clone();
        let painter = painter.borrow();
        let worker = painter.as_ref().filter(|renderer| renderer.backend() == Backend::Processor);
        if let Some(worker) = worker.filter(|_| !nothing && !document().hidden()) {
            // Not by the browser's frames: it would go over the whole page for each, although only the worker's canvas changes.
            let spent_ms = net::now_ms() - begun;
            let rest_ms = if outcome == Some(FrameOutcome::Skipped) && worker.is_busy() {
                LATE_MS
            } else {
                SOFTWARE_MS - spent_ms
            };
            ask(&again, Some((PAUSE_SHARE * spent_ms).max(rest_ms).min(MOST_PAUSE_MS)));
            return;
        }
        let ask = move || ask(&again, None);
        // A timer of no time ends when the browser has put the frame on the screen.
        let on_screen = move || {
            let spent_ms = net::now_ms() - begun;
            if nothing {
                set_timeout(ask, LOOK);
            } else if spent_ms < LIGHT_MS {
                ask();
            } else {
                set_timeout(ask, Duration::from_millis((PAUSE_SHARE * spent_ms).min(MOST_PAUSE_MS) as u64));
            }
        };
        set_timeout(on_screen, Duration::ZERO);
    });
    *next.borrow_mut() = Some(body);
    ask(&next, None);
}

/// What a frame shows where nothing moves by itself: the same again need not be drawn.
#[derive(PartialEq)]
struct Still {
    dark: bool,
    size: (f64, f64, f64),
    places: Vec<(Picture, Option<Rect>)>,
    recorded: Option<Charted>,
}

impl Still {
    /// Is there no chart that can be seen?
    fn shows_nothing(&self) -> bool {
        self.places.iter().all(|(_, rect)| rect.is_none())
    }
}

/// What charts depend on.
#[derive(PartialEq)]
struct Charted {
    instrument: Instrument,
    axis: TimeAxis,
    cursor: Option<f64>,
    value_zoom: Vec<(Picture, ValueAxis)>,
    playhead: f64,
    residual: Option<(i32, u32)>,
    residuals_of: u16,
    camera: (f32, f32, f32),
    pins: Option<[f64; 2]>,
    kept: Option<[f64; 2]>,
    error_axis: Axis,
    way: Way,
    hidden: Vec<Curve>,
    lit: Option<Curve>,
    tolerance: Option<f64>,
    unfolded: Vec<Group>,
    /// Of all curves: another estimator's may be laid over them. Of live ones, how far time has come.
    curves: (usize, u64),
}

impl Charted {
    fn recorded(deck: Deck, instrument: &Instrument) -> Option<Self> {
        let (axis, curves) = deck.data.try_with_value(|live| (deck.axis(live), live.curves.state()))?;
        Some(Self::with(deck, instrument.clone(), axis, curves))
    }

    /// Of a live vehicle, to the pixel: a chart `width_px` wide, which moves on with time, looks the same until it has moved by one.
    fn live(deck: Deck, width_px: f64) -> Option<Self> {
        let axis = deck.data.try_with_value(|live| deck.axis(live))?;
        let span_s = axis.span_s();
        let moved = ((net::now_ms() / NEWS_MS) as usize, (axis.end_s / span_s * width_px) as u64);
        Some(Self::with(deck, Instrument::default(), TimeAxis::new(0.0, span_s), moved))
    }

    fn with(deck: Deck, instrument: Instrument, axis: TimeAxis, curves: (usize, u64)) -> Self {
        Self {
            instrument,
            axis,
            cursor: deck.cursor.get_untracked(),
            value_zoom: deck.value_zoom.get_untracked(),
            playhead: deck.playhead.get_untracked(),
            residual: deck.residual.get_untracked(),
            residuals_of: deck.residuals_of.get_untracked(),
            camera: deck.camera.get_untracked(),
            pins: deck.pins.get_untracked(),
            kept: deck.kept.get_untracked(),
            error_axis: deck.error_axis.get_untracked(),
            way: deck.way.get_untracked(),
            hidden: deck.hidden.get_untracked(),
            lit: deck.lit.get_untracked(),
            tolerance: deck.tolerance.get_untracked(),
            unfolded: deck.unfolded.get_untracked(),
            curves,
        }
    }
}

/// One frame; nothing is drawn while it would be `shown` again, and no chart while it would be as it was `charted`, where what is not
/// drawn stays.
fn frame(
    ctx: Ctx,
    renderer: &mut Renderer,
    shown: &mut Option<Still>,
    charted: &mut Option<Charted>,
    places: &mut Places,
) -> FrameOutcome {
    if renderer.is_busy() {
        return FrameOutcome::Skipped;
    }
    let number = |value: Result<wasm_bindgen::JsValue, _>| value.ok().and_then(|v| v.as_f64()).unwrap_or(1.0);
    let (width, height) = (number(window().inner_width()), number(window().inner_height()));
    let size = (width, height, window().device_pixel_ratio());
    renderer.resize(size.0, size.1, size.2);
    let dark = ctx.dark.get_untracked();
    let theme = Theme::of(dark);
    let deck = ctx.deck.get_untracked();
    let slots = deck.map(Deck::slots).unwrap_or_default();
    let rects = places.of(&slots, height).to_vec();
    let instrument = deck.map(Deck::instrument_now).unwrap_or_default();
    let recorded = deck.filter(|deck| deck.source == Source::Recorded);
    let recorded = recorded.and_then(|deck| Charted::recorded(deck, &instrument));
    let seen_at: Vec<_> = slots.iter().map(|slot| slot.picture).zip(rects.iter().copied()).collect();
    let moves = recorded.is_none() && rects.iter().any(Option::is_some);
    let now = (!moves).then_some(Still { dark, size, places: seen_at, recorded });
    if now.is_some() && now == *shown {
        return FrameOutcome::Skipped;
    }
    let seen: Vec<Rect> = rects.iter().copied().flatten().collect();
    let width = seen.iter().map(|rect| f64::from(rect.width)).fold(1.0, f64::max) * size.2;
    let may_stay = moves && renderer.backend() == Backend::Processor;
    let charts = deck.filter(|_| may_stay).and_then(|deck| Charted::live(deck, width));
    let stay = !renderer.lay_out(&theme, &seen) && charts.is_some() && charts == *charted;
    *charted = charts;
    let mut draw = |live: &Live, deck: Deck| {
        let frame = Frame { deck, dark, theme };
        let body = Body::new(live, &instrument);
        let axis = deck.axis(live);
        let panels: Vec<Panel<'_>> = slots
            .iter()
            .zip(&rects)
            .filter_map(|(slot, rect)| {
                let rect = (*rect)?;
                if stay && !matches!(slot.picture, Picture::Horizon | Picture::Space) {
                    return None;
                }
                let content = frame.content(slot, rect, live, axis, &instrument, &body)?;
                Some(Panel { rect, content })
            })
            .collect();
        renderer.frame(&theme, &panels)
    };
    let outcome = match deck {
        Some(deck) => deck.data.try_with_value(|live| draw(live, deck)).unwrap_or(FrameOutcome::Skipped),
        None => renderer.frame(&theme, &[]),
    };
    *shown = now.filter(|_| outcome == FrameOutcome::Drawn);
    outcome
}

/// Where charts are.
struct Places {
    /// When somebody last did what may move them, ms.
    moved_ms: Rc<Cell<f64>>,
    /// Hears of it.
    moves: Closure<dyn Fn()>,
    looked_ms: f64,
    rects: Vec<Option<Rect>>,
}

impl Places {
    fn new() -> Self {
        let moved_ms = Rc::new(Cell::new(net::now_ms()));
        let moves = moved_ms.clone();
        let moves = Closure::<dyn Fn()>::new(move || moves.set(net::now_ms()));
        for name in MOVES {
            // Captured: what scrolls inside the page tells nobody else. Fails for no name of an event.
            let _ = window().add_event_listener_with_callback_and_bool(name, moves.as_ref().unchecked_ref(), true);
        }
        Self { moved_ms, moves, looked_ms: f64::NEG_INFINITY, rects: Vec::new() }
    }

    fn of(&mut self, slots: &[Slot], height: f64) -> &[Option<Rect>] {
        let now_ms = net::now_ms();
        let same = slots.len() == self.rects.len() && now_ms - self.looked_ms < PLACES_MS;
        if !same || now_ms - self.moved_ms.get() < MOVING_MS {
            self.looked_ms = now_ms;
            self.rects = slots.iter().map(|slot| visible(slot, height)).collect();
        }
        &self.rects
    }
}

impl Drop for Places {
    fn drop(&mut self) {
        for name in MOVES {
            let hears = self.moves.as_ref().unchecked_ref();
            let _ = window().remove_event_listener_with_callback_and_bool(name, hears, true);
        }
    }
}

/// Where a chart is, if any of it can be seen.
fn visible(slot: &Slot, height: f64) -> Option<Rect> {
    let node = slot.node.get_untracked()?;
    let r = node.get_bounding_client_rect();
    let seen = r.width() > 1.0 && r.height() > 1.0 && r.bottom() > 0.0 && r.top() < height;
    seen.then(|| Rect::new(r.left() as f32, r.top() as f32, r.width() as f32, r.height() as f32))
}

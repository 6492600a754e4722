//! The place of a chart: labels around it, pointer on it; the curves are drawn behind it.

use leptos::{ev, html, prelude::*};

use crate::{
    deck::{Deck, Picture, Slot, Source, deck},
    model::axis::ValueAxis,
};

/// A turn of the wheel by a pixel changes the span by this share.
const WHEEL_ZOOM: f64 = 0.002;
/// A pointer that moves less than this is a click, px.
const CLICK_PX: f64 = 4.0;

/// A pointer that holds a chart at a time.
#[derive(Debug, Clone, Copy)]
struct Hold {
    pointer: i32,
    /// What it holds, s.
    time_s: f64,
    /// Where it is, 0 at the left edge of the plot, 1 at the right.
    at: f64,
}

/// Begin and end of the axis, s, that has each time held where its pointer is: one pointer pans, two zoom.
fn held_axis(holds: &[Hold], span_s: f64) -> Option<(f64, f64)> {
    let (first, span_s) = match holds {
        [one] => (one, span_s),
        [one, other, ..] if (other.at - one.at).abs() > 0.02 => {
            (one, (other.time_s - one.time_s) / (other.at - one.at))
        }
        _ => return None,
    };
    let start_s = first.time_s - first.at * span_s;
    (span_s > 0.0).then_some((start_s, start_s + span_s))
}

/// What the pointers do on one plot: a drag pans, two zoom, with Shift a drag chooses values.
#[derive(Clone, Copy)]
struct Pointers {
    deck: Deck,
    slot: StoredValue<Slot, LocalStorage>,
    holds: StoredValue<Vec<Hold>>,
    /// Where the first one was pressed, px.
    pressed: StoredValue<(f64, f64)>,
    /// Does it pan by now?
    pans: RwSignal<bool>,
    /// Where a pointer rests, as a fraction of the width.
    rests: StoredValue<Option<f64>>,
    /// Values being chosen, as fractions of the height from the top.
    values: RwSignal<Option<(f64, f64)>>,
}

impl Pointers {
    /// Where a pointer is in the plot, 0 to 1 from left and top.
    fn at(self, e: &ev::MouseEvent) -> Option<(f64, f64)> {
        let rect = self.slot.with_value(|slot| slot.node.get_untracked())?.get_bounding_client_rect();
        let x = (f64::from(e.client_x()) - rect.left()) / rect.width().max(1.0);
        let y = (f64::from(e.client_y()) - rect.top()) / rect.height().max(1.0);
        Some((x.clamp(0.0, 1.0), y.clamp(0.0, 1.0)))
    }

    fn time_s(self, fraction: f64) -> f64 {
        self.deck.data.with_value(|live| self.deck.axis(live)).time_s(fraction)
    }

    fn down(self, e: &ev::PointerEvent) {
        let Some((x, y)) = self.at(e).filter(|_| e.button() == 0) else { return };
        if let Some(node) = self.slot.with_value(|slot| slot.node.get_untracked()) {
            let _ = node.set_pointer_capture(e.pointer_id());
        }
        self.pressed.set_value((f64::from(e.client_x()), f64::from(e.client_y())));
        if e.shift_key() && self.slot.with_value(|slot| slot.axis.get()).is_some() {
            self.values.set(Some((y, y)));
            return;
        }
        let hold = Hold { pointer: e.pointer_id(), time_s: self.time_s(x), at: x };
        self.holds.update_value(|holds| holds.push(hold));
    }

    fn moved(self, e: &ev::PointerEvent) {
        let Some((x, y)) = self.at(e) else { return };
        if let Some((from, _)) = self.values.get_untracked() {
            self.values.set(Some((from, y)));
        }
        let (pressed_x, pressed_y) = self.pressed.get_value();
        let far = f64::hypot(f64::from(e.client_x()) - pressed_x, f64::from(e.client_y()) - pressed_y) > CLICK_PX;
        let mut holds = self.holds.get_value();
        if let Some(hold) = holds.iter_mut().find(|hold| hold.pointer == e.pointer_id()) {
            hold.at = x;
            if far && !self.pans.get_untracked() {
                self.pans.set(true);
            }
            let span_s = self.deck.data.with_value(|live| self.deck.axis(live)).span_s();
            if let Some((start_s, end_s)) = held_axis(&holds, span_s).filter(|_| self.pans.get_untracked()) {
                self.deck.zoom_to(start_s, end_s);
            }
            self.holds.set_value(holds);
        }
        self.rests.set_value(Some(x));
        self.point();
    }

    /// The cursor is where the pointer rests, whatever passes below it.
    fn point(self) {
        if let Some(x) = self.rests.get_value() {
            self.deck.cursor.set(Some(self.time_s(x)));
        }
    }

    fn up(self, e: &ev::PointerEvent) {
        if let Some((from, to)) = self.values.get_untracked() {
            self.values.set(None);
            let slot = self.slot.get_value();
            let height = slot.node.get_untracked().map_or(0.0, |node| f64::from(node.client_height()));
            if let Some(axis) = slot.axis.get().filter(|_| (to - from).abs() * height > CLICK_PX) {
                let [low, high] = [from.max(to), from.min(to)].map(|y| axis.value(1.0 - y));
                self.deck.zoom_values(slot.picture, ValueAxis::new(low, high));
            }
            return;
        }
        let held = self.holds.try_update_value(|holds| {
            let before = holds.len();
            holds.retain(|hold| hold.pointer != e.pointer_id());
            before > holds.len()
        });
        if held == Some(true) && !self.pans.get_untracked() {
            self.click(e);
        }
        if self.holds.with_value(Vec::is_empty) {
            self.pans.set(false);
        }
    }

    /// Moves a pinned cursor here, or the play head.
    fn click(self, e: &ev::PointerEvent) {
        let Some((x, _)) = self.at(e) else { return };
        let time_s = self.time_s(x);
        if !self.deck.pin(time_s) && self.deck.source == Source::Recorded {
            self.deck.playhead.set(time_s);
        }
    }

    fn leave(self) {
        self.holds.set_value(Vec::new());
        self.pans.set(false);
        self.values.set(None);
        self.rests.set_value(None);
        self.deck.cursor.set(None);
    }

    /// The wheel zooms about the pointer; sideways, or with Shift, it pans. A page that scrolls keeps its wheel.
    fn wheel(self, e: &ev::WheelEvent) {
        let scrolls = document().scrolling_element().is_some_and(|page| page.scroll_height() > page.client_height());
        if scrolls && !e.ctrl_key() {
            return;
        }
        let Some((x, _)) = self.at(e) else { return };
        e.prevent_default();
        let axis = self.deck.data.with_value(|live| self.deck.axis(live));
        let along = if e.shift_key() { e.delta_x() + e.delta_y() } else { e.delta_x() };
        if along.abs() > e.delta_y().abs() || e.shift_key() {
            let width = self.slot.with_value(|slot| slot.node.get_untracked()).map_or(1, |node| node.client_width());
            let by = along / f64::from(width.max(1)) * axis.span_s();
            self.deck.zoom_to(axis.start_s + by, axis.end_s + by);
        } else {
            self.deck.zoom_about(axis.time_s(x), (e.delta_y() * WHEEL_ZOOM).clamp(-1.0, 1.0).exp());
        }
    }
}

/// A plot with its axis labels. Children are overlays in the plot's own coordinates.
#[component]
pub fn Plot(
    /// What is drawn.
    picture: Picture,
    /// Name for those who cannot see it.
    #[prop(into)]
    label: Signal<String>,
    /// Unit of the values, written in the corner of the axes.
    #[prop(optional, into)]
    unit: String,
    /// Labels up the side?
    #[prop(default = true)]
    values: bool,
    /// Labels along the bottom?
    #[prop(default = true)]
    times: bool,
    /// Overlays.
    #[prop(optional)]
    children: Option<Children>,
) -> impl IntoView {
    let deck = deck();
    let node = NodeRef::<html::Div>::new();
    let slot = deck.slot(picture, node);
    let labels = slot.labels;
    let pointers = Pointers {
        deck,
        slot: StoredValue::new_local(slot),
        holds: StoredValue::new(Vec::new()),
        pressed: StoredValue::new((0.0, 0.0)),
        pans: RwSignal::new(false),
        rests: StoredValue::new(None),
        values: RwSignal::new(None),
    };
    Effect::new(move |_| {
        deck.beat();
        if !deck.is_still() {
            pointers.point();
        }
    });
    view! {
        <div class="plot-frame" class:no-values=!values class:no-times=!times>
            <div class="y-labels" aria-hidden="true">
                {move || labels.with(|l| l.value.iter().map(|tick| view! {
                    <span style=format!("bottom:{:.2}%", tick.fraction * 100.0)>{tick.label.clone()}</span>
                }).collect::<Vec<_>>())}
            </div>
            <div
                class="plot"
                class:panning=pointers.pans
                role="img"
                aria-label=label
                node_ref=node
                on:pointerdown=move |e| pointers.down(&e)
                on:pointermove=move |e| pointers.moved(&e)
                on:pointerup=move |e| pointers.up(&e)
                on:pointercancel=move |_| pointers.leave()
                on:pointerleave=move |_| pointers.leave()
                on:wheel=move |e| pointers.wheel(&e)
                on:dblclick=move |_| deck.zoom_out()
            ></div>
            <div class="plot-over">
                {children.map(|c| c())}
                {move || pointers.values.get().map(|(a, b)| view! {
                    <i class="chosen-values" style=format!("top:{:.2}%;height:{:.2}%", a.min(b) * 100.0, (a - b).abs() * 100.0)></i>
                })}
            </div>
            <div class="axis-unit" aria-hidden="true">{unit}</div>
            <div class="x-labels" aria-hidden="true">
                {move || labels.with(|l| {
                    let last = l.time.len().saturating_sub(1);
                    l.time.iter().enumerate().map(|(i, tick)| view! {
                        <span style=format!("left:{:.2}%", tick.fraction * 100.0)>{tick.label.clone()}{(i == last).then_some(" min")}</span>
                    }).collect::<Vec<_>>()
                })}
                {move || labels.with(|l| l.pins.iter().map(|pin| view! {
                    <b class="pin" style=format!("left:{:.2}%", pin.fraction * 100.0)>{pin.label.clone()}</b>
                }).collect::<Vec<_>>())}
            </div>
        </div>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pointer_pans_and_two_zoom() {
        let hold = |time_s, at| Hold { pointer: 0, time_s, at };
        assert_eq!(held_axis(&[hold(15.0, 0.25)], 10.0), Some((12.5, 22.5)), "the time held is where the pointer is");
        assert_eq!(held_axis(&[hold(12.0, 0.25), hold(16.0, 0.75)], 10.0), Some((10.0, 18.0)));
        assert_eq!(held_axis(&[hold(12.0, 0.5), hold(16.0, 0.5)], 10.0), None, "two fingers in one place");
        assert_eq!(held_axis(&[hold(12.0, 0.75), hold(16.0, 0.25)], 10.0), None, "never backwards");
        assert_eq!(held_axis(&[], 10.0), None);
    }
}

//! The place of a chart: labels around it, pointer on it; the curves are drawn behind it.

use leptos::{ev, html, prelude::*};

use crate::{
    deck::{Labels, Picture, deck},
    model::axis::TimeAxis,
};

/// A turn of the wheel by a pixel changes the span by this share.
const WHEEL_ZOOM: f64 = 0.002;

/// A plot with its axis labels. Children are overlays in the plot's own coordinates.
#[component]
pub fn Plot(
    /// What is drawn.
    picture: Picture,
    /// Name for those who cannot see it.
    #[prop(into)]
    label: Signal<String>,
    /// Unit of the values, written in the corner of the axes.
    #[prop(optional)]
    unit: &'static str,
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
    let labels: RwSignal<Labels> = deck.slot(picture, node);
    let dragging = RwSignal::new(None::<f64>);

    // The time under the pointer, exactly as drawn in this moment.
    let time_at = move |e: &ev::PointerEvent| -> Option<(f64, TimeAxis)> {
        let rect = node.get_untracked()?.get_bounding_client_rect();
        let axis = deck.data.with_value(|live| deck.axis(live));
        let fraction = ((f64::from(e.client_x()) - rect.left()) / rect.width().max(1.0)).clamp(0.0, 1.0);
        Some((axis.time_s(fraction), axis))
    };
    let down = move |e: ev::PointerEvent| {
        if e.button() == 0 && e.pointer_type() != "touch" {
            dragging.set(time_at(&e).map(|(t, _)| t));
            if let Some(node) = node.get_untracked() {
                let _ = node.set_pointer_capture(e.pointer_id());
            }
        }
    };
    let moved = move |e: ev::PointerEvent| {
        let Some((time, _)) = time_at(&e) else { return };
        deck.cursor.set(Some(time));
        deck.selection.set(dragging.get_untracked().map(|from| (from.min(time), from.max(time))));
    };
    let up = move |e: ev::PointerEvent| {
        if let (Some(from), Some((to, axis))) = (dragging.get_untracked(), time_at(&e)) {
            // A drag of a few pixels is a click.
            if (to - from).abs() > axis.span_s() * 0.01 {
                deck.zoom_to(from, to);
            } else if !deck.pin(to) && deck.source == crate::deck::Source::Recorded {
                deck.playhead.set(to);
            }
        }
        dragging.set(None);
        deck.selection.set(None);
    };
    // The wheel zooms about the pointer; sideways, or with Shift, it pans. A page that scrolls keeps its wheel.
    let wheel = move |e: ev::WheelEvent| {
        let scrolls = document().scrolling_element().is_some_and(|page| page.scroll_height() > page.client_height());
        if scrolls && !e.ctrl_key() {
            return;
        }
        let Some(node) = node.get_untracked() else { return };
        e.prevent_default();
        let rect = node.get_bounding_client_rect();
        let axis = deck.data.with_value(|live| deck.axis(live));
        let along = if e.shift_key() { e.delta_x() + e.delta_y() } else { e.delta_x() };
        if along.abs() > e.delta_y().abs() || e.shift_key() {
            let by = along / rect.width().max(1.0) * axis.span_s();
            deck.zoom_to(axis.start_s + by, axis.end_s + by);
        } else {
            let fraction = ((f64::from(e.client_x()) - rect.left()) / rect.width().max(1.0)).clamp(0.0, 1.0);
            deck.zoom_about(axis.time_s(fraction), (e.delta_y() * WHEEL_ZOOM).clamp(-1.0, 1.0).exp());
        }
    };
    let leave = move |_| {
        dragging.set(None);
        deck.selection.set(None);
        deck.cursor.set(None);
    };
    view! {
        <div class="plot-frame" class:no-values=!values class:no-times=!times>
            <div class="y-labels" aria-hidden="true">
                {move || labels.with(|l| l.value.iter().map(|tick| view! {
                    <span style=format!("bottom:{:.2}%", tick.fraction * 100.0)>{tick.label.clone()}</span>
                }).collect::<Vec<_>>())}
            </div>
            <div
                class="plot"
                role="img"
                aria-label=label
                node_ref=node
                on:pointerdown=down
                on:pointermove=moved
                on:pointerup=up
                on:pointerleave=leave
                on:wheel=wheel
                on:dblclick=move |_| deck.zoom_out()
            ></div>
            <div class="plot-over">{children.map(|c| c())}</div>
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

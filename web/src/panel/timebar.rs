//! Length of the window, pause, and the way back from a zoom.

use leptos::prelude::*;

use super::{cursors::PinButton, layouts::LayoutsButton};
use crate::{
    deck::{Source, WINDOWS_S, deck},
    model::format,
};

fn window_name(seconds: f64) -> String {
    if seconds < 60.0 { format!("{seconds:.0} s") } else { format!("{:.0} min", seconds / 60.0) }
}

/// The controls of the time axis.
#[component]
pub fn TimeBar() -> impl IntoView {
    let deck = deck();
    let zoomed = Memo::new(move |_| deck.is_zoomed().then(|| deck.zoom.get()));
    let live = deck.source == Source::Live;
    view! {
        <div class="timebar">
            {move || zoomed.get().map(|stretch| view! {
                <button type="button" class="small" on:click=move |_| deck.zoom_out() title="Back to the whole window (double-click on a chart)">
                    {stretch.map_or_else(|| "zoom ×".to_owned(), |(a, b)| format!("zoom {} s ×", format::fixed(b - a, 1)))}
                </button>
            })}
            <PinButton />
            <LayoutsButton />
            {live.then(|| view! {
                <select
                    class="small"
                    aria-label="Time window"
                    prop:value=move || deck.window_s.get().to_string()
                    on:change:target=move |e| {
                        if let Ok(seconds) = e.target().value().parse() {
                            deck.set_window(seconds);
                        }
                    }
                >
                    {WINDOWS_S.into_iter().map(|w| view! {
                        <option value=w.to_string() selected=move || deck.window_s.get() == w>{window_name(w)}</option>
                    }).collect::<Vec<_>>()}
                </select>
                <button
                    type="button"
                    class="small pause"
                    aria-pressed=move || deck.paused_at.get().is_some().to_string()
                    aria-label="Pause charts"
                    title="Pause charts, nothing is lost (Space)"
                    on:click=move |_| deck.toggle_pause()
                >
                    {move || if deck.paused_at.get().is_some() { "▶ live" } else { "❚❚" }}
                </button>
            })}
        </div>
    }
}

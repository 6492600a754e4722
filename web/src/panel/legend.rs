//! A chart's legend, which is also its read-out: swatch, name, value under the cursor or newest.

use leptos::prelude::*;

use crate::{
    deck::deck,
    model::{curves::Curve, format},
};

/// How a curve looks in the legend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Swatch {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// A thin line.
    Thin,
}

/// One entry.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The curve.
    pub curve: Curve,
    /// Its name.
    pub name: String,
    /// Its colour, as a style-sheet value.
    pub color: &'static str,
    /// Its line.
    pub swatch: Swatch,
}

/// The legend of some curves.
#[component]
pub fn Legend(
    /// Entries; those whose curve has no sample are left out.
    #[prop(into)]
    entries: Signal<Vec<Entry>>,
    /// Decimals of the values.
    decimals: usize,
) -> impl IntoView {
    let deck = deck();
    let present = Memo::new(move |_| {
        let entries = entries.get();
        deck.read(|live| entries.into_iter().filter(|e| live.curves.get(e.curve).is_some()).collect::<Vec<_>>())
    });
    view! {
        <ul class="legend">
            <For each=move || present.get() key=|e| (e.curve, e.color) let:entry>
                <li>
                    <span
                        class="swatch"
                        class:dashed=entry.swatch == Swatch::Dashed
                        class:thin=entry.swatch == Swatch::Thin
                        style=format!("--swatch:{}", entry.color)
                        aria-hidden="true"
                    ></span>
                    <span class="legend-name">{entry.name.clone()}</span>
                    <span class="value num">
                        {move || {
                            let at = deck.reading_s();
                            let value = deck.read(|live| match at {
                                Some(time) => live.curves.value_at(entry.curve, time),
                                None => live.curves.get(entry.curve).and_then(|s| s.last()).map(|(_, v)| f64::from(v)),
                            });
                            format::maybe(value, decimals)
                        }}
                    </span>
                </li>
            </For>
        </ul>
    }
}

//! Motors and tick time, folded until wanted.

use leptos::prelude::*;

use super::{
    legend::{Entry, Legend},
    plot::Plot,
};
use crate::{
    deck::{Picture, deck},
    model::{curves::Curve, format},
};

/// Motor commands over time, and how long a control tick takes.
#[component]
pub fn MotorsAndTicks() -> impl IntoView {
    let deck = deck();
    let open = deck.motors;
    let motors = Memo::new(move |_| {
        deck.read(|live| {
            let known = (0..8_u8).filter(|i| live.curves.get(Curve::Motor(*i)).is_some());
            known.map(|i| Entry::new(Curve::Motor(i), format!("motor {}", i + 1), 0)).collect::<Vec<_>>()
        })
    });
    let ticks = Signal::derive(|| {
        vec![
            Entry::new(Curve::TickMedian, "median", 0),
            Entry::new(Curve::TickP99, "p99", 0),
            Entry::new(Curve::TickJitter, "jitter p99", 0),
        ]
    });
    let summary = move || {
        deck.read(|live| {
            live.status.get().map_or_else(String::new, |s| {
                format!(
                    "tick {} µs median, {} µs p99 · {} Hz · {} missed",
                    format::fixed(s.tick_time_p50_us, 0),
                    format::fixed(s.tick_time_p99_us, 0),
                    format::fixed(s.tick_rate_hz, 0),
                    format::count(s.deadline_misses),
                )
            })
        })
    };
    let old = Memo::new(move |_| deck.is_old(|live| &live.status));
    view! {
        <details class="card chart motors" prop:open=move || open.get() on:toggle:target=move |e| open.set(e.target().open())>
            <summary>
                <h2>"Motors and tick time"</h2>
                <span class="num quiet" class:stale=old>{summary}</span>
            </summary>
            <Show when=move || open.get()>
                <div class="chart-body folded">
                    <Legend entries=motors name="Motors" unit="" decimals=2 picture=Picture::Motors />
                    <Plot picture=Picture::Motors unit="of 1" times=false label="Motor commands over time, 0 to 1" />
                </div>
                <div class="chart-body folded">
                    <Legend entries=ticks name="Tick time" unit="µs" decimals=0 picture=Picture::Ticks />
                    <Plot picture=Picture::Ticks unit="µs" label="Time of a control tick over time, in microseconds" />
                </div>
            </Show>
        </details>
    }
}

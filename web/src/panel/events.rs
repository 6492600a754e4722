//! What happened: the vehicle's own log, newest first.

use leptos::prelude::*;
use plumbline_proto::v1::Severity;

use crate::{
    deck::{Source, deck},
    model::format,
};

/// Lines shown.
const LINES: usize = 60;

/// The log, folded until wanted.
#[component]
pub fn Events() -> impl IntoView {
    let deck = deck();
    let seen = Memo::new(move |_| deck.read(|live| live.log.events_seen));
    let newest = Memo::new(move |_| {
        seen.get();
        deck.data.with_value(|live| live.log.events.back().map(|e| e.text.clone()).unwrap_or_default())
    });
    let lines = move || {
        seen.get();
        let origin = match deck.source {
            Source::Recorded => deck.origin_s.get(),
            Source::Live => 0.0,
        };
        deck.data.with_value(|live| {
            live.log
                .events
                .iter()
                .rev()
                .take(LINES)
                .map(|e| (format::clock(e.time_us as f64 * 1e-6 - origin), e.severity(), e.text.clone()))
                .collect::<Vec<_>>()
        })
    };
    view! {
        <details class="card events">
            <summary>
                <h2>"Events"</h2>
                <span class="quiet one-line">{newest}</span>
            </summary>
            <ol>
                {move || lines().into_iter().map(|(time, severity, text)| {
                    let class = match severity {
                        Severity::Critical => "critical",
                        Severity::Warning => "warning",
                        _ => "",
                    };
                    view! { <li class=class><time class="num">{time}</time> <span>{text}</span></li> }
                }).collect::<Vec<_>>()}
            </ol>
            <Show when=move || seen.get() == 0><p class="quiet">"Nothing has happened yet."</p></Show>
        </details>
    }
}

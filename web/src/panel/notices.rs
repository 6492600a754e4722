//! Answers and errors, in the ground's own words, announced to screen readers as well.

use leptos::prelude::*;

use crate::{
    ctx::ctx,
    event::{Event, Tone},
};

/// The stack of notices.
#[component]
pub fn Notices() -> impl IntoView {
    let ctx = ctx();
    let notices = move || ctx.app(|app| app.notices.iter().cloned().collect::<Vec<_>>());
    let spoken = move |wanted: bool| {
        ctx.app(|app| app.notices.iter().rev().find(|n| (n.tone == Tone::Error) == wanted).map(|n| n.text.clone()))
    };
    view! {
        <div class="notices">
            <For each=notices key=|n| n.number let:notice>
                <div class="notice" class:error=notice.tone == Tone::Error class:done=notice.tone == Tone::Done>
                    <span class="notice-mark" aria-hidden="true">
                        {match notice.tone { Tone::Done => "✓", Tone::Info => "i", Tone::Error => "!" }}
                    </span>
                    <span class="notice-text">{notice.text.clone()}</span>
                    <button type="button" class="plain" aria-label="Dismiss notice" on:click=move |_| ctx.dispatch(Event::Dismiss(notice.number))>
                        "×"
                    </button>
                </div>
            </For>
        </div>
        <div class="visually-hidden" role="status" aria-live="polite">{move || spoken(false)}</div>
        <div class="visually-hidden" role="alert" aria-live="assertive">{move || spoken(true)}</div>
    }
}

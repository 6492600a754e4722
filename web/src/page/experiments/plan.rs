//! The plan being written: its text, what it comes to, the way to start it.

use std::time::Duration;

use leptos::prelude::*;
use plumbline_rest::experiment::{Asked, Size, State};

use super::ROOT;
use crate::{
    ctx::ctx,
    event::{Event, Failure, Tone},
    model::{experiment::templates, format},
    net,
};

/// A plan is asked about once nothing was typed for so long.
const STILL: Duration = Duration::from_millis(500);

/// The card; `begun` hears the id of what was started.
#[component]
pub fn PlanCard(begun: impl Fn(String) + Copy + 'static) -> impl IntoView {
    let ctx = ctx();
    let [(_, first), ..] = templates();
    let text = RwSignal::new(first);
    let size = RwSignal::new(None::<Result<Size, Failure>>);
    let body = move |plan: String| serde_json::to_string(&Asked { plan }).ok();
    let ask = move || {
        let plan = text.get_untracked();
        leptos::task::spawn_local(async move {
            let found = net::json("POST", &format!("{ROOT}/size"), body(plan.clone()), "").await;
            // An answer to what is no longer asked comes too late.
            if text.try_with_untracked(|text| *text == plan) == Some(true) {
                size.try_set(Some(found));
            }
        });
    };
    let typed = RwSignal::new(0_u32);
    Effect::new(move |_| {
        text.track();
        size.set(None);
        typed.update_untracked(|n| *n += 1);
        let now = typed.get_untracked();
        set_timeout(
            move || {
                if typed.try_get_untracked() == Some(now) {
                    ask();
                }
            },
            STILL,
        );
    });
    let start = move |_| {
        let plan = text.get_untracked();
        leptos::task::spawn_local(async move {
            match net::json::<State>("POST", ROOT, body(plan), "").await {
                Ok(state) => begun(state.id),
                Err(failure) => ctx.dispatch(Event::Tell(Tone::Error, format!("Experiment: {}", failure.text))),
            }
        });
    };
    let told = move || match size.get() {
        None => view! { <p class="quiet" role="status">"counting…"</p> }.into_any(),
        Some(Err(failure)) => view! { <p class="bad" role="alert">{failure.text}</p> }.into_any(),
        Some(Ok(size)) => {
            let left = size.flights.saturating_sub(size.done);
            let done = if size.done > 0 { format!(", {} of them flown already", size.done) } else { String::new() };
            view! {
                <p class="num" role="status">
                    {format!("{} × {} = ", format::plural(size.conditions, "condition"), size.repeats)}
                    <b>{format::plural(size.flights, "flight")}</b>{done}
                    {format!("; about {} here", format::age(if left > 0 { size.expected_s } else { 0.0 }))}
                </p>
            }
            .into_any()
        }
    };
    view! {
        <section class="card plan" aria-label="Plan">
            <header><h2>"Plan"</h2></header>
            <select aria-label="Question to begin with" on:change:target=move |e| {
                if let Some((_, plan)) = templates().into_iter().find(|(question, _)| *question == e.target().value()) {
                    text.set(plan);
                }
            }>
                {templates().map(|(question, _)| view! { <option>{question}</option> })}
            </select>
            <textarea
                rows="16"
                spellcheck="false"
                aria-label="Plan, TOML"
                prop:value=move || text.get()
                on:input:target=move |e| text.set(e.target().value())
            ></textarea>
            {told}
            <button type="button" class="fit" disabled=move || !matches!(size.get(), Some(Ok(_))) on:click=start>"Start"</button>
        </section>
    }
}

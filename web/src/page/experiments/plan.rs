//! The plan being written: its text, what it comes to, the way to start it.

use std::time::Duration;

use leptos::prelude::*;
use plumbline_rest::experiment::{Asked, Size, State};
use plumbline_rest::flight::{Completeness, Flight, Flights};
use plumbline_rest::people::Role;

use super::ROOT;
use super::study::StudyForm;
use crate::{
    ctx::ctx,
    event::Failure,
    keys,
    model::{experiment::templates, format},
    net,
    panel::alarms::Guarded,
};

/// A plan is asked about once nothing was typed for so long.
const STILL: Duration = Duration::from_millis(500);

/// A plan over recordings begins with so many, the newest of those that are long enough, s, to be judged.
const RECORDINGS: usize = 3;
const SHORTEST_S: f64 = 15.0;

/// The flights that a plan over recordings begins with.
async fn recorded() -> Vec<String> {
    let found: Result<Flights, _> = net::json("GET", "/api/v1/flights?limit=20", None, "").await;
    let usable = |flight: &Flight| flight.completeness == Completeness::Complete && flight.duration_s > SHORTEST_S;
    let flights = found.map(|found| found.flights).unwrap_or_default();
    flights.into_iter().filter(usable).map(|flight| flight.id).take(RECORDINGS).collect()
}

/// The card; `begun` hears the id of what was started.
#[component]
pub fn PlanCard(begun: impl Fn(String) + Copy + Send + 'static) -> impl IntoView {
    let ctx = ctx();
    let vehicle = move || ctx.app.with_value(|app| app.vehicle.clone()).unwrap_or_default();
    let [(_, first), ..] = templates(&[], "");
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
        let asked_at = keys::pointer();
        leptos::task::spawn_local(async move {
            match net::json::<State>("POST", ROOT, body(plan), "").await {
                Ok(state) => begun(state.id),
                Err(failure) => ctx.failed(asked_at, "Experiment", &failure),
            }
        });
    };
    let choose = move |asked: String| {
        leptos::task::spawn_local(async move {
            let flights = recorded().await;
            if let Some((_, plan)) =
                templates(&flights, &vehicle()).into_iter().find(|(question, _)| *question == asked)
            {
                text.try_set(plan);
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
                    {format!("; about {} {}", format::age(if left > 0 { size.expected_s } else { 0.0 }), if size.by_hand { "at the stick" } else { "here" })}
                </p>
            }
            .into_any()
        }
    };
    view! {
        <section class="card plan" aria-label="Plan">
            <header><h2>"Plan"</h2></header>
            <select aria-label="Question to begin with" on:change:target=move |e| choose(e.target().value())>
                {templates(&[], "").map(|(question, _)| view! { <option>{question}</option> })}
            </select>
            <StudyForm text />
            <textarea
                rows="16"
                spellcheck="false"
                aria-label="Plan, TOML"
                prop:value=move || text.get()
                on:input:target=move |e| text.set(e.target().value())
            ></textarea>
            {told}
            <Guarded takes=Role::Operator>
                <button type="button" class="fit" disabled=move || !matches!(size.get(), Some(Ok(_))) on:click=start>{move || if matches!(size.get(), Some(Ok(size)) if size.by_hand) { "Keep" } else { "Start" }}</button>
            </Guarded>
        </section>
    }
}

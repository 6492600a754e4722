//! Experiments: a plan of many flights is written, flown and read; every dot is a flight that can be opened.

mod browse;
mod head;
mod plan;
mod results;
mod study;

use std::time::Duration;

use leptos::prelude::*;
use plumbline_rest::experiment::{Experiments, State};

use crate::{
    address,
    ctx::{ctx, every},
    event::{Failure, Tone},
    model::format,
    net,
};

use plan::PlanCard;
use results::ResultsCard;

/// Where they are.
const ROOT: &str = "/api/v1/experiments";
/// Name of what an address keeps: which of them is shown.
const EXPERIMENT: &str = "experiment";
/// The list is asked for again after this.
const PERIOD: Duration = Duration::from_secs(2);

/// The page.
#[component]
pub fn ExperimentsPage() -> impl IntoView {
    let answer = RwSignal::new(None::<Result<Experiments, Failure>>);
    let ctx = ctx();
    let chosen = RwSignal::new(address::all(EXPERIMENT).into_iter().next());
    let load = move || {
        leptos::task::spawn_local(async move {
            let found: Result<Experiments, _> = net::json("GET", ROOT, None, "").await;
            if let Ok(found) = &found
                && let Some(asked) = chosen.try_get_untracked()
            {
                // Only an address may name one that there is not; what is begun here is in the next list.
                let first = answer.try_with_untracked(|a| !matches!(a, Some(Ok(_)))) == Some(true);
                let missing = asked.filter(|id| first && found.experiments.iter().all(|state| state.id != *id));
                if let Some(id) = &missing {
                    ctx.tell(Tone::Error, format!("Experiment {id} is not kept here"));
                }
                if missing.is_some() || chosen.try_with_untracked(Option::is_none) == Some(true) {
                    chosen.try_set(found.experiments.first().map(|first| first.id.clone()));
                }
            }
            answer.try_set(Some(found));
        });
    };
    load();
    every(PERIOD, load);
    let states = Memo::new(move |_| match answer.get() {
        Some(Ok(found)) => found.experiments,
        _ => Vec::new(),
    });
    let trouble = move || answer.with(|a| a.as_ref().and_then(|a| a.as_ref().err()).map(|e| e.text.clone()));
    let found = move |id: Option<String>| states.get().into_iter().find(|state| Some(&state.id) == id.as_ref());
    let state = Memo::new(move |before: Option<&State>| {
        // A list that does not come leaves what is known.
        found(chosen.get()).or_else(|| before.cloned()).unwrap_or_default()
    });
    let shown = Memo::new(move |_| Some(state.get().id).filter(|id| !id.is_empty()));
    view! {
        <main class="sheet wide" id="main">
            <div class="sheet-head"><h1>"Experiments"</h1>
                <span class="quiet">"Plans of many flights, simulated or recorded; each can be flown again, bit for bit."</span>
            </div>
            {move || trouble().map(|text| view! { <p class="banner bad" role="alert"><b>"The list cannot be loaded: "</b>{text}</p> })}
            <div class="experiments">
                <div class="experiments-side">
                    <PlanCard begun=move |id| { chosen.set(Some(id)); load(); } />
                    <section class="card" aria-label="Experiments that are kept">
                        <header><h2>"Kept"</h2></header>
                        <ul class="experiment-list">
                            {move || states.get().into_iter().map(|state| view! { <Kept state chosen /> }).collect_view()}
                        </ul>
                        <Show when=move || answer.with(|a| matches!(a, Some(Ok(_)))) && states.with(Vec::is_empty)>
                            <p class="blank">"None yet. Choose a question above, and start it."</p>
                        </Show>
                    </section>
                </div>
                // Remade for another experiment, and not for another state of the same.
                {move || shown.get().map(|id| view! { <ResultsCard id state states /> })}
            </div>
        </main>
    }
}

/// A line of the list.
#[component]
fn Kept(state: State, chosen: RwSignal<Option<String>>) -> impl IntoView {
    let id = state.id.clone();
    let shown = state.id.clone();
    view! {
        <li>
            <button
                type="button"
                class="plain"
                aria-pressed=move || (chosen.get().as_ref() == Some(&shown)).to_string()
                on:click=move |_| chosen.set(Some(id.clone()))
            >
                <b>{state.name.clone()}</b>
                <span class="quiet num">{progress(&state)}</span>
            </button>
            <progress max="1" value=share(&state) aria-label=format!("{} flown", state.name)></progress>
        </li>
    }
}

fn share(state: &State) -> f64 {
    if state.flights > 0 { state.done as f64 / state.flights as f64 } else { 0.0 }
}

/// "12 of 40 flights, 3.1 a second, 9 s left"
fn progress(state: &State) -> String {
    let mut text = format!("{} of {}", state.done, format::plural(state.flights, "flight"));
    if let Some(rate) = state.per_s.filter(|_| state.running) {
        text += &format!(", {} a second", format::fixed(rate, 1));
    }
    if let Some(left_s) = state.left_s.filter(|_| state.running) {
        text += &format!(", {} left", format::age(left_s));
    }
    text
}

//! What an experiment is called, how far it is, and what can be done with it.

use leptos::prelude::*;
use plumbline_rest::experiment::State;

use super::{ROOT, progress};
use crate::{ctx::ctx, keys, net, panel::by_hand};

/// Name, progress, what can be done with it.
#[component]
pub fn Head(
    /// Its address.
    at: String,
    /// How it stands.
    state: Memo<State>,
    /// All that are kept.
    states: Memo<Vec<State>>,
) -> impl IntoView {
    let ctx = ctx();
    let address = StoredValue::new(at.clone());
    let turn = move |what: &'static str| {
        let address = format!("{}/{what}", address.get_value());
        let asked_at = keys::pointer();
        leptos::task::spawn_local(async move {
            if let Err(failure) = net::json::<State>("POST", &address, None, "").await {
                ctx.failed(asked_at, "Experiment", &failure);
            }
        });
    };
    let running = Memo::new(move |_| state.with(|s| s.running));
    let left = Memo::new(move |_| state.with(|s| s.own && s.done < s.flights));
    // Names and hashes: what is flown meanwhile leaves an open list alone.
    let others = Memo::new(move |_| {
        let own = state.with(|s| s.id.clone());
        states.with(|all| all.iter().map(|other| other.id.clone()).filter(|id| *id != own).collect::<Vec<_>>())
    });
    let since = RwSignal::new(String::new());
    let against = move || format!("{ROOT}/{}/against/{}", since.get(), state.with(|s| s.id.clone()));
    view! {
        <header>
            <h2>{move || state.with(|s| s.name.clone())}</h2>
            <span class="quiet num">{move || state.with(progress)}</span>
            <span class="push buttons-row">
                {move || match (running.get(), left.get()) {
                    (false, true) if state.with(|s| s.by_hand) => view! { <button type="button" on:click=move |_| by_hand::begin(ctx, state.with_untracked(|s| s.id.clone()))>"Fly the next"</button> }.into_any(),
                    (true, _) => view! { <button type="button" on:click=move |_| turn("stop")>"Stop"</button> }.into_any(),
                    (false, true) => view! { <button type="button" on:click=move |_| turn("start")>"Go on"</button> }.into_any(),
                    _ => ().into_any(),
                }}
                <a class="button" href=format!("{at}/report.html") target="_blank" rel="external">"Report"</a>
                <a class="button" href=format!("{at}/flights.parquet") rel="external">"Parquet"</a>
                <a class="button" href=format!("{at}/plan.toml") rel="external">"Plan"</a>
                <Show when=move || others.with(|others| !others.is_empty())>
                    <select aria-label="Another experiment, to compare with" on:change:target=move |e| since.set(e.target().value())>
                        <option value="">"Compare with…"</option>
                        {move || others.get().into_iter().map(|id| view! { <option>{id}</option> }).collect_view()}
                    </select>
                </Show>
                <Show when=move || !since.with(String::is_empty)>
                    <a class="button" href=against target="_blank" rel="external">"What changed"</a>
                </Show>
            </span>
        </header>
        {move || state.with(|s| s.error.clone()).map(|error| view! { <p class="banner bad" role="alert">{error}</p> })}
        {move || (!state.with(|s| s.own)).then(|| view! { <p class="banner">"Another version of the program flew this: it can be read, and not gone on with."</p> })}
    }
}

//! Through many conditions: their levels are chosen above the table, their flights are listed below it.

use leptos::prelude::*;
use plumbline_rest::experiment::{Condition, Flight, Results};

use super::results::{MOST, short};
use crate::{
    model::{
        experiment::selection::{Selection, flown, levels, value, worst_first},
        format,
    },
    panel::table::Pages,
};

/// Flights on a page of the list.
const LISTED: usize = 50;

/// The last part of a factor's key; the whole is told to whoever asks.
pub fn last_part(key: &str) -> String {
    key.rsplit('.').next().unwrap_or(key).to_owned()
}

/// A level, in words.
fn named(level: &str) -> String {
    if level.is_empty() { "as it is".to_owned() } else { level.to_owned() }
}

/// A choice for each factor of several levels, and how many conditions are shown.
#[component]
pub fn Levels(
    /// Of which conditions.
    results: RwSignal<Results>,
    /// What is chosen.
    selection: RwSignal<Selection>,
) -> impl IntoView {
    let varied = Memo::new(move |_| {
        let several = |r: &Results, place: usize| levels(&r.conditions, place).len() > 1;
        results.with(|r| {
            let factors = r.factors.iter().cloned().enumerate();
            factors.filter(|(place, _)| several(r, *place)).collect::<Vec<_>>()
        })
    });
    let count = Memo::new(move |_| results.with(|r| (selection.with(|s| s.conditions(r).len()), r.conditions.len())));
    let filtered = move || count.get().0 < count.get().1;
    let told = move || match count.get() {
        (shown, all) if shown < all => format!("{shown} of {}", format::plural(all as u64, "condition")),
        (_, all) => format::plural(all as u64, "condition"),
    };
    view! {
        <Show when=move || !varied.with(Vec::is_empty)>
            <div class="sheet-head levels" role="group" aria-label="Conditions shown">
                <For each=move || varied.get() key=|factor| factor.clone() let((place, key))>
                    <Level place key results selection />
                </For>
                <span class="num no-wrap" role="status">{told}</span>
                <Show when=filtered>
                    <button type="button" on:click=move |_| selection.update(|s| s.levels.clear())>"Show all"</button>
                </Show>
                <Show when=move || selection.with(|s| s.sort.is_some())>
                    <button type="button" on:click=move |_| selection.update(|s| s.sort = None)>"Order of the plan"</button>
                </Show>
            </div>
        </Show>
    }
}

/// The choice of one factor's level.
#[component]
fn Level(place: usize, key: String, results: RwSignal<Results>, selection: RwSignal<Selection>) -> impl IntoView {
    let offered = Memo::new(move |_| {
        results.with(|r| levels(&r.conditions, place).into_iter().map(str::to_owned).collect::<Vec<_>>())
    });
    let key = StoredValue::new(key);
    let chosen = Memo::new(move |_| key.with_value(|key| selection.with(|s| s.levels.get(key).cloned())));
    let choose = move |value: String| {
        let level = value.parse().ok().and_then(|at: usize| offered.with_untracked(|all| all.get(at).cloned()));
        selection.update(|s| match level {
            Some(level) => drop(s.levels.insert(key.get_value(), level)),
            None => drop(s.levels.remove(&key.get_value())),
        });
    };
    view! {
        <label class="field" title=key.get_value()>{last_part(&key.get_value())}
            <select on:change:target=move |e| choose(e.target().value())>
                <option value="" prop:selected=move || chosen.with(Option::is_none)>"all"</option>
                {move || offered.get().into_iter().enumerate().map(|(at, level)| {
                    let name = named(&level);
                    view! {
                        <option value=at.to_string() prop:selected=move || chosen.with(|chosen| chosen.as_ref() == Some(&level))>{name}</option>
                    }
                }).collect_view()}
            </select>
        </label>
    }
}

/// The flights of the conditions shown, the worst first.
#[component]
pub fn FlightList(
    /// Address of the experiment.
    at: String,
    /// Their conditions.
    results: RwSignal<Results>,
    /// What is shown.
    selection: RwSignal<Selection>,
    /// Those loaded.
    flights: RwSignal<Vec<Flight>>,
    /// What they are compared by.
    measure: Memo<usize>,
) -> impl IntoView {
    let open = RwSignal::new(false);
    let offset = RwSignal::new(0);
    // Another choice begins at its worst.
    Effect::new(move |_| {
        selection.track();
        offset.set(0);
    });
    let at = StoredValue::new(at);
    let listed = Memo::new(move |_| {
        let levels = |(flight, condition): (&Flight, &Condition)| (flight.clone(), condition.levels.clone());
        let listed = |r: &Results, s: &Selection, all: &[Flight]| {
            worst_first(all, &s.conditions(r), s.measure(r)).into_iter().map(levels).collect::<Vec<_>>()
        };
        results.with(|r| selection.with(|s| flights.with(|all| listed(r, s, all))))
    });
    let missing = move || {
        let (there, whole) = results.with(|r| (selection.with(|s| flown(s.conditions(r))), flown(&r.conditions)));
        // While flights are flown the two are not of the same moment; where all are loaded nothing is missing.
        let here = if whole > MOST as u64 { listed.with(Vec::len) as u64 } else { there };
        (here < there).then(|| {
            format!("{here} of these {there} flights are shown: at most {MOST} are loaded. A condition shown alone has its own loaded.")
        })
    };
    let name =
        move || results.with(|r| r.measures.get(measure.get()).map(|measure| measure.name.clone()).unwrap_or_default());
    let rows = move || {
        let page = listed.with(|all| all.iter().skip(offset.get()).take(LISTED).cloned().collect::<Vec<_>>());
        page.into_iter().map(|(flight, levels)| {
            let figure = value(&flight, measure.get()).map_or_else(|| format::NONE.to_owned(), short);
            let href = format!("{}/flights/{}/open", at.get_value(), flight.index);
            view! {
                <tr>
                    <td><a href=href rel="external" aria-label=format!("Open flight {}", flight.index)>{flight.index}</a></td>
                    <td>{levels.iter().map(|level| named(level)).collect::<Vec<_>>().join(", ")}</td>
                    <td class="num">{flight.seed}</td>
                    <td class="bad">{flight.lost}</td>
                    <td class="num">{figure}</td>
                </tr>
            }
        }).collect_view()
    };
    view! {
        {move || missing().map(|says| view! { <p class="quiet">{says}</p> })}
        <details class="counts" on:toggle:target=move |e| open.set(e.target().open())>
            <summary>"Flights, the worst first"</summary>
            <Show when=move || open.get()>
                <table class="dense">
                    <thead><tr>
                        <th scope="col">"flight"</th>
                        <th scope="col">"levels"</th>
                        <th class="num" scope="col">"seed"</th>
                        <th scope="col">"lost"</th>
                        <th class="num" scope="col">{name}</th>
                    </tr></thead>
                    <tbody>{rows}</tbody>
                </table>
                <Pages offset limit=LISTED found=move || listed.with(Vec::len) turn=move |to| offset.set(to) />
            </Show>
        </details>
    }
}

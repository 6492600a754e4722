//! Fly again: the ground flies the recording under the estimators chosen, as an experiment, and what comes of it is laid over it.

use leptos::prelude::*;
use plumbline_proto::v1::EstimatorKind;
use plumbline_rest::experiment::{Asked, Opened, State};
use plumbline_rest::flight::Flight;
use plumbline_rest::people::Role;

use super::reestimate;
use crate::{
    ctx::ctx,
    event::Failure,
    model::{choice, experiment::Again, names, route::Route},
    net,
    panel::{alarms::Guarded, waiting::Waiting},
};

/// Estimators that a recording can be flown under.
fn estimators() -> impl Iterator<Item = EstimatorKind> {
    reestimate::estimators().filter(|kind| names::estimates_altitude(*kind))
}

/// Flies a plan of `count` flights and keeps each as a flight file; their ids.
async fn flown(plan: String, count: usize, operator: &str, told: impl Fn(usize)) -> Result<Vec<String>, Failure> {
    let body = serde_json::to_string(&Asked { plan }).ok();
    let State { id, .. } = net::json("POST", "/api/v1/experiments", body, operator).await?;
    let mut flights = Vec::new();
    for index in 0..count {
        told(index);
        let url = format!("/api/v1/experiments/{id}/flights/{index}");
        let Opened { flight } = net::json("POST", &url, None, operator).await?;
        flights.push(flight);
    }
    Ok(flights)
}

/// The card.
#[component]
pub fn FlyAgain(flight: Flight) -> impl IntoView {
    let ctx = ctx();
    let chosen = RwSignal::new(vec![EstimatorKind::EkfBias, EstimatorKind::Lanes]);
    let sensors = RwSignal::new(Again::Received);
    let working = RwSignal::new(None::<[usize; 2]>);
    let problem = RwSignal::new(String::new());
    let fly = move |_| {
        let estimators: Vec<String> = chosen.get_untracked().into_iter().map(names::estimator_json).collect();
        let plan = sensors.get_untracked().plan(&flight.id, &estimators, flight.duration_s);
        let (count, first) = (estimators.len(), flight.id.clone());
        problem.set(String::new());
        working.set(Some([0, count]));
        leptos::task::spawn_local(async move {
            let told = move |index: usize| {
                let _ = working.try_set(Some([index, count]));
            };
            let answer = flown(plan, count, &ctx.operator(), told).await;
            // The page may have been left meanwhile.
            if working.try_set(None).is_some() {
                return;
            }
            match answer {
                Ok(flights) => ctx.go(Route::Compare([vec![first], flights].concat())),
                Err(failure) => problem.set(failure.text),
            }
        });
    };
    let toggle = move |kind: EstimatorKind, on: bool| chosen.update(|chosen| choice::choose(chosen, kind, on));
    view! {
        <section class="card facts again" aria-label="Fly again">
            <header><h2>"Fly again"</h2></header>
            <fieldset class="checks">
                <legend class="quiet">"under"</legend>
                {estimators().map(|kind| view! {
                    <label class="check">
                        <input type="checkbox" prop:checked=move || chosen.get().contains(&kind) on:change:target=move |e| toggle(kind, e.target().checked()) />
                        {kind.title()}
                    </label>
                }).collect_view()}
            </fieldset>
            <div class="row">
                <select class="small" aria-label="Sensors" on:change:target=move |e| {
                    let at = e.target().value().parse::<usize>().unwrap_or_default();
                    sensors.set(Again::ALL.get(at).map_or(Again::Received, |(again, _)| *again));
                }>
                    {Again::ALL.into_iter().enumerate().map(|(at, (_, words))| view! { <option value=at.to_string()>{words}</option> }).collect_view()}
                </select>
                <Guarded takes=Role::Operator>
                    <button type="button" class="small" disabled=move || working.get().is_some() || chosen.get().is_empty() on:click=fly>
                        "Fly again"
                    </button>
                </Guarded>
            </div>
            <Show when=move || working.with(Option::is_some)>
                <Waiting
                    text=Signal::derive(move || working.get().map_or_else(String::new, |[at, count]| format!("Flying {} of {count}…", at + 1)))
                    share=Signal::derive(move || working.get().map(|[at, count]| at as f64 / count as f64))
                />
            </Show>
            <Show when=move || !problem.with(String::is_empty)>
                <p class="bad" role="alert">{problem}</p>
            </Show>
            <p class="quiet">"The ground flies it, each becomes a flight of its own, and all are laid over this one. What it would have done with other motors nobody knows: they turn as they did."</p>
        </section>
    }
}

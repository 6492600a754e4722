//! Fly again: the ground flies the recording under the estimators chosen, with its own attacks, none or drafted ones, as experiments;
//! what comes of it is laid over it.

use leptos::prelude::*;
use plumbline_proto::v1::EstimatorKind;
use plumbline_rest::experiment::{Asked, Opened, State};
use plumbline_rest::flight::{Flight, Labels};
use plumbline_rest::people::Role;
use serde_json::json;

use super::reestimate;
use crate::{
    ctx::ctx,
    deck::deck,
    event::Failure,
    model::{choice, draft::Draft, experiment::Again, names, route::Route},
    net,
    page::compare,
    panel::{alarms::Guarded, attacks::Editor, waiting::Waiting},
};

/// Flights that are laid over the recording at most.
const MOST: usize = compare::MOST - 1;

/// Estimators that a recording can be flown under.
fn estimators() -> impl Iterator<Item = EstimatorKind> {
    reestimate::estimators().filter(|kind| names::estimates_altitude(*kind))
}

/// Flies a plan and keeps the flight of each of these names as a flight file; their ids.
async fn flown(plan: String, named: &[String], operator: &str, told: impl Fn(usize)) -> Result<Vec<String>, Failure> {
    let body = serde_json::to_string(&Asked { plan }).ok();
    let State { id, .. } = net::json("POST", "/api/v1/experiments", body, operator).await?;
    let mut flights = Vec::new();
    for (index, name) in named.iter().enumerate() {
        told(index);
        let url = format!("/api/v1/experiments/{id}/flights/{index}");
        let Opened { flight } = net::json("POST", &url, None, operator).await?;
        let label = json!(Labels { name: Some(name.clone()), notes: None }).to_string();
        let _: Flight = net::json("PATCH", &format!("/api/v1/flights/{flight}"), Some(label), operator).await?;
        flights.push(flight);
    }
    Ok(flights)
}

/// A box to tick.
#[component]
fn Tick(#[prop(into)] text: Signal<String>, on: Signal<bool>, set: Callback<bool>) -> impl IntoView {
    view! {
        <label class="check">
            <input type="checkbox" prop:checked=on on:change:target=move |e| set.run(e.target().checked()) />
            {text}
        </label>
    }
}

/// The card.
#[component]
pub fn FlyAgain(flight: Flight) -> impl IntoView {
    let ctx = ctx();
    let deck = deck();
    let chosen = RwSignal::new(vec![EstimatorKind::EkfBias, EstimatorKind::Lanes]);
    let (received, sensed) = (RwSignal::new(true), RwSignal::new(false));
    let drafts = RwSignal::new(Vec::<Draft>::new());
    let working = RwSignal::new(None::<[usize; 2]>);
    let problem = RwSignal::new(String::new());
    let ways = move || {
        let own = received.get().then_some(Again::Received);
        let none = sensed.get().then_some(Again::Sensed);
        own.into_iter().chain(none).chain(drafts.get().into_iter().map(Again::Attacked)).collect::<Vec<_>>()
    };
    let count = Memo::new(move |_| ways().len() * chosen.with(Vec::len));
    let subject = move |again: &Again| deck.data.with_value(|live| again.name(live.description.get()));
    let fly = move |_| {
        let kinds = chosen.get_untracked();
        let estimators: Vec<String> = kinds.iter().copied().map(names::estimator_json).collect();
        let plans: Vec<_> = untrack(ways)
            .iter()
            .map(|again| {
                let named =
                    kinds.iter().map(|kind| format!("{}, {}", kind.title(), subject(again))).collect::<Vec<_>>();
                (again.plan(&flight.id, &estimators), named)
            })
            .collect();
        let (count, first) = (count.get_untracked(), flight.id.clone());
        problem.set(String::new());
        working.set(Some([0, count]));
        leptos::task::spawn_local(async move {
            let mut all = vec![first];
            for (plan, named) in plans {
                let before = all.len() - 1;
                let told = move |index: usize| {
                    let _ = working.try_set(Some([before + index, count]));
                };
                match flown(plan, &named, &ctx.operator(), told).await {
                    Ok(flights) => all.extend(flights),
                    Err(failure) => {
                        working.try_set(None);
                        problem.try_set(failure.text);
                        return;
                    }
                }
            }
            // The page may have been left meanwhile.
            if working.try_set(None).is_none() {
                ctx.go(Route::Compare(all));
            }
        });
    };
    let toggle = move |kind: EstimatorKind, on: bool| chosen.update(|chosen| choice::choose(chosen, kind, on));
    let remove = move |at: usize| {
        drafts.update(|all| {
            if at < all.len() {
                all.remove(at);
            }
        });
    };
    let button = move || match count.get() {
        1 => "Fly again".to_owned(),
        count => format!("Fly again, {count} flights"),
    };
    view! {
        <section class="card facts again" aria-label="Fly again">
            <header><h2>"Fly again"</h2></header>
            <fieldset class="checks">
                <legend class="quiet">"under"</legend>
                {estimators().map(|kind| view! {
                    <Tick text=kind.title() on=Signal::derive(move || chosen.get().contains(&kind)) set=Callback::new(move |on| toggle(kind, on)) />
                }).collect_view()}
            </fieldset>
            <fieldset class="checks ways">
                <legend class="quiet">"and attacked"</legend>
                <Tick text="as it was then" on=received.into() set=Callback::new(move |on| received.set(on)) />
                <Tick text="not at all" on=sensed.into() set=Callback::new(move |on| sensed.set(on)) />
                {move || drafts.get().into_iter().enumerate().map(|(at, draft)| view! {
                    <span class="check">
                        {format!("{}, from {} s on for {} s", subject(&Again::Attacked(draft.clone())), draft.start_s, draft.duration_s)}
                        <button type="button" class="plain" aria-label="Remove from draft" on:click=move |_| remove(at)>"×"</button>
                    </span>
                }).collect_view()}
            </fieldset>
            <details class="drafting">
                <summary>"Draft an attack"</summary>
                <Editor drafts live=deck.data />
            </details>
            <div class="row">
                <Guarded takes=Role::Operator>
                    <button type="button" class="small" disabled=move || working.get().is_some() || !(1..=MOST).contains(&count.get()) on:click=fly>
                        {button}
                    </button>
                </Guarded>
            </div>
            <Show when=move || { count.get() > MOST }>
                <p class="bad" role="alert">{format!("At most {MOST} at once: that many can be laid over the recording.")}</p>
            </Show>
            <Show when=move || working.with(Option::is_some)>
                <Waiting
                    text=Signal::derive(move || working.get().map_or_else(String::new, |[at, count]| format!("Flying {} of {count}…", at + 1)))
                    share=Signal::derive(move || working.get().map(|[at, count]| at as f64 / count as f64))
                />
            </Show>
            <Show when=move || !problem.with(String::is_empty)>
                <p class="bad" role="alert">{problem}</p>
            </Show>
            <p class="quiet">"The ground flies it, each becomes a flight of its own, and all are laid over this one. Each drafted attack is a flight without the others. What it would have done with other motors nobody knows: they turn as they did."</p>
        </section>
    }
}

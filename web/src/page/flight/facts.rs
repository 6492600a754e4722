//! Everything known about a recorded flight: steps, attacks, configuration, notes.

use leptos::prelude::*;
use plumbline_rest::flight::{Flight, FlownAttack, Labels, Step};
use serde_json::json;

use super::{again::FlyAgain, reestimate::Reestimate, save, table::TableCard};
use crate::{
    ctx::ctx,
    deck::deck,
    event::Failure,
    model::{
        format::{self, NONE},
        listing,
    },
    page::flights::local_offset_min,
    panel::{lanes::timed_notes, waiting::Waiting},
};

/// Everything known about the flight, beside its charts.
#[component]
pub(super) fn Summary(summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    view! {
        {move || match summary.get() {
            None => view! { <section class="card"><header><h2>"Flight"</h2></header><Waiting text="Loading…" /></section> }.into_any(),
            Some(Err(failure)) => view! { <section class="card"><header><h2>"Flight"</h2></header><p class="bad">{failure.text}</p></section> }.into_any(),
            Some(Ok(flight)) => view! { <Facts flight summary /> }.into_any(),
        }}
    }
}

#[component]
fn Facts(flight: Flight, summary: RwSignal<Option<Result<Flight, Failure>>>) -> impl IntoView {
    let ctx = ctx();
    let url = StoredValue::new(format!("/api/v1/flights/{}", flight.id));
    let notes = RwSignal::new(flight.notes.clone());
    let deck = deck();
    let place = move || {
        let begin_s = deck.origin_s.get_untracked();
        let timed = notes.with_untracked(|notes| timed_notes(notes));
        deck.notes.set(timed.into_iter().map(|(at_s, text)| (begin_s + at_s, text)).collect());
    };
    place();
    let fact = |name: &'static str, value: String| view! { <div><dt>{name}</dt><dd class="num">{value}</dd></div> };
    let missing = if flight.missing == 0 { "none".to_owned() } else { format::count(flight.missing) };
    let rms =
        flight.tracking_rms_m.map_or_else(|| NONE.to_owned(), |m| format!("{} mm RMS", format::fixed(m * 1e3, 1)));
    view! {
        <section class="card facts" aria-label="Steps">
            <header><h2>"Steps"</h2><span class="quiet num push">{rms}</span></header>
            <StepTable steps=flight.steps.clone() />
        </section>
        <section class="card facts" aria-label="Attacks">
            <header><h2>"Attacks"</h2></header>
            <AttackTable attacks=flight.attacks.clone() />
        </section>
        <section class="card facts" aria-label="Flight">
            <header><h2>"Flight"</h2></header>
            <dl class="facts-list">
                {fact("id", flight.id.clone())}
                {fact("vehicle", format!("{} ({})", flight.vehicle_id, flight.vehicle))}
                {fact("airframe", flight.airframe.clone())}
                {fact("rig", flight.rig.clone())}
                {fact("seed", flight.seed.to_string())}
                {fact("agent", flight.agent_version.clone())}
                {fact("messages", format::count(flight.messages))}
                {fact("missing", missing)}
                {fact("size", format::bytes(flight.size_bytes))}
                {flight.deleted_unix_us.map(|at| {
                    let when = listing::when(at, local_offset_min());
                    fact("deleted", format!("{when}; a name or a note keeps it"))
                })}
            </dl>
            <details class="counts">
                <summary>"Messages by topic"</summary>
                <table><tbody>
                    {flight.counts.iter().map(|(topic, n)| view! { <tr><th scope="row">{topic.clone()}</th><td class="num">{format::count(*n)}</td></tr> }).collect::<Vec<_>>()}
                </tbody></table>
            </details>
        </section>
        <TableCard topics=flight.counts.keys().cloned().collect() />
        <Reestimate id=flight.id.clone() topics=flight.counts.keys().cloned().collect() />
        <FlyAgain flight=flight.clone() />
        <section class="card facts notes" aria-label="Notes">
            <header><h2><label for="notes">"Notes"</label></h2></header>
            <textarea
                id="notes"
                rows="4"
                placeholder="What was tried, what was seen. Begin a line with a time (1:23) and it stands on the timeline; a #word is a tag."
                prop:value=notes
                on:input:target=move |e| notes.set(e.target().value())
                on:change=move |_| {
                    place();
                    save(ctx, url.get_value(), json!(Labels { name: None, notes: Some(notes.get_untracked()) }), summary);
                }
            ></textarea>
        </section>
    }
}

#[component]
fn StepTable(steps: Vec<Step>) -> impl IntoView {
    if steps.is_empty() {
        return view! { <p class="quiet">"No setpoint step in this flight."</p> }.into_any();
    }
    let seconds = |v: Option<f64>| format::maybe(v, 2);
    view! {
        <table class="dense">
            <thead><tr><th class="num">"at s"</th><th class="num">"step m"</th><th class="num" title="10 % to 90 %">"rise s"</th><th class="num">"over %"</th><th class="num">"settle s"</th><th class="num">"err mm"</th></tr></thead>
            <tbody>
                {steps.into_iter().map(|s| view! {
                    <tr>
                        <td class="num">{format::fixed(s.start_s, 1)}</td>
                        <td class="num">{format!("{}→{}", format::fixed(s.from_m, 1), format::fixed(s.to_m, 1))}</td>
                        <td class="num">{seconds(s.rise_time_s)}</td>
                        <td class="num">{format::fixed(s.overshoot_percent, 1)}</td>
                        {if s.interrupted {
                            view! { <td class="quiet" colspan="2" title="The next step, or another mode, began before this one was inside the band">"interrupted"</td> }.into_any()
                        } else {
                            view! {
                                <td class="num">{seconds(s.settling_time_s)}</td>
                                <td class="num">{s.steady_error_m.map_or_else(|| NONE.to_owned(), |e| format::signed(e * 1e3, 0))}</td>
                            }.into_any()
                        }}
                    </tr>
                }).collect::<Vec<_>>()}
            </tbody>
        </table>
    }.into_any()
}

#[component]
fn AttackTable(attacks: Vec<FlownAttack>) -> impl IntoView {
    if attacks.is_empty() {
        return view! { <p class="quiet">"No attack in this flight."</p> }.into_any();
    }
    view! {
        <ul class="attack-list">
            {attacks.into_iter().map(|a| {
                let channel = if a.planned.channel == "all" || a.planned.channel.is_empty() { String::new() } else { format!(" {}", a.planned.channel.replace('_', " ")) };
                let what = format!("{} {}{channel}: {} {}", a.planned.sensor.replace('_', " "), a.planned.instance, a.planned.kind.replace('_', " "), format::signed(a.planned.magnitude, 2));
                view! {
                    <li>
                        <span class="attack-title" title=what.clone()>{what.clone()}</span>
                        <span class="num quiet">{format!("{} s, {} s", format::fixed(a.planned.start_s, 1), format::fixed(a.planned.duration_s, 1))}</span>
                        <span class=format!("chip {}", a.phase)>{a.phase.clone()}</span>
                    </li>
                }
            }).collect::<Vec<_>>()}
        </ul>
    }.into_any()
}

//! Which estimator is in the loop: chosen, then applied. One that cannot fly the mode is not offered.

use leptos::prelude::*;
use plumbline_proto::v1::{EstimatorKind, Mode};
use plumbline_rest::command as rest;
use serde_json::json;

use crate::{
    ctx::ctx,
    keys,
    model::{format, names},
};

/// The estimator card.
#[component]
pub fn EstimatorCard() -> impl IntoView {
    let ctx = ctx();
    let old = Memo::new(move |_| ctx.is_old(|live| &live.status));
    let in_loop = Memo::new(move |_| ctx.live(|live| i32::from(live.in_loop())));
    let offered = Memo::new(move |_| ctx.live(|live| live.offered_estimators()));
    let cost = Memo::new(move |_| {
        ctx.live(|live| {
            live.estimate()
                .and_then(|t| t.get())
                .filter(|e| e.step_time_us > 0.0)
                .map(|e| format!("{} µs", format::fixed(e.step_time_us, 0)))
        })
    });
    // A choice is no command: that is Apply.
    let chosen = RwSignal::new(None::<i32>);
    let shown = move || chosen.get().unwrap_or_else(|| in_loop.get());
    let needed = Memo::new(move |_| {
        ctx.live(|live| {
            let status = live.status.get();
            status.is_some_and(|s| s.armed && matches!(s.mode(), Mode::AltitudeHold | Mode::Hold | Mode::Land))
        })
    });
    let unfit = move |kind: EstimatorKind| needed.get() && !names::estimates_altitude(kind);
    let apply = move |_| {
        let kind = chosen.get_untracked().and_then(|n| EstimatorKind::try_from(n).ok());
        chosen.set(None);
        keys::let_go();
        if let Some(kind) = kind.filter(|kind| *kind as i32 != in_loop.get_untracked()) {
            let what = format!("Estimator {}", kind.title());
            ctx.command(what, "POST", "estimator", json!(rest::Estimator { estimator: names::estimator_json(kind) }));
        }
    };
    view! {
        <section class="card estimator" aria-label="Estimator">
            <label for="estimator-in-loop"><h2>"Estimator"</h2></label>
            <select
                id="estimator-in-loop"
                class:stale=old
                aria-label="Estimator in the loop"
                disabled=move || offered.get().len() < 2
                title=move || cost.get().map(|cost| format!("A step takes {cost}"))
                prop:value=move || shown().to_string()
                on:change:target=move |e| chosen.set(e.target().value().parse().ok())
                on:keydown=move |e| {
                    if e.key() == "Escape" {
                        chosen.set(None);
                        keys::let_go();
                    }
                }
            >
                {move || {
                    let kinds = offered.get();
                    if kinds.is_empty() {
                        view! { <option>"—"</option> }.into_any()
                    } else {
                        kinds.into_iter().map(|k| view! {
                            <option
                                value=(k as i32).to_string()
                                selected=move || shown() == k as i32
                                disabled=move || unfit(k)
                            >{move || if unfit(k) { format!("{} – no altitude", k.title()) } else { k.title().to_owned() }}</option>
                        }).collect::<Vec<_>>().into_any()
                    }
                }}
            </select>
            <button
                type="button"
                class="small"
                aria-label="Apply estimator"
                disabled=move || shown() == in_loop.get()
                on:click=apply
            >"Apply"</button>
        </section>
    }
}

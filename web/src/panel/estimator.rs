//! Which estimator is in the loop.

use leptos::prelude::*;
use plumbline_proto::v1::EstimatorKind;
use serde_json::json;

use crate::{
    ctx::ctx,
    model::{format, names},
};

/// The estimator card.
#[component]
pub fn EstimatorCard() -> impl IntoView {
    let ctx = ctx();
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
    let choose = move |value: String| {
        let Some(kind) = value.parse().ok().and_then(|n: i32| EstimatorKind::try_from(n).ok()) else { return };
        let what = format!("Estimator {}", names::estimator(kind));
        ctx.command(what, "POST", "estimator", json!({ "estimator": names::estimator_json(kind) }));
    };
    view! {
        <section class="card estimator" aria-label="Estimator">
            <label for="estimator-in-loop"><h2>"Estimator"</h2></label>
            <select
                id="estimator-in-loop"
                aria-label="Estimator in the loop"
                disabled=move || offered.get().len() < 2
                prop:value=move || in_loop.get().to_string()
                on:change:target=move |e| choose(e.target().value())
            >
                {move || {
                    let kinds = offered.get();
                    if kinds.is_empty() {
                        view! { <option>"—"</option> }.into_any()
                    } else {
                        kinds.into_iter().map(|k| view! {
                            <option value=(k as i32).to_string() selected=move || in_loop.get() == k as i32>{names::estimator(k)}</option>
                        }).collect::<Vec<_>>().into_any()
                    }
                }}
            </select>
            <span class="num quiet">{cost}</span>
        </section>
    }
}

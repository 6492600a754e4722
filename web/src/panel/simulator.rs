//! What only a simulated vehicle can be given: a new battery, and its place at the begin.

use leptos::prelude::*;
use plumbline_rest::command as rest;
use serde_json::json;

use super::hold::HoldButton;
use crate::ctx::ctx;

/// The card; nothing where the vehicle is no simulated one.
#[component]
pub fn SimulatorCard() -> impl IntoView {
    let ctx = ctx();
    let simulated = Memo::new(move |_| ctx.live(|live| live.description.get().is_some_and(|d| d.vehicle == "sim")));
    let armed = Signal::derive(move || ctx.live(|live| live.status.get().is_none_or(|s| s.armed)));
    let reset = Callback::new(move |()| {
        ctx.command(
            "Reset the simulation",
            "POST",
            "simulator",
            json!(rest::Simulator { reset: true, battery: false }),
        );
    });
    view! {
        <Show when=move || simulated.get()>
            <section class="card simulator" aria-label="Simulator">
                <header><h2>"Simulator"</h2></header>
                <div class="buttons">
                    <button
                        type="button"
                        title="A full battery, at once"
                        on:click=move |_| ctx.command("New battery", "POST", "simulator", json!(rest::Simulator { battery: true, reset: false }))
                    >"New battery"</button>
                    <HoldButton label="Reset" class="warn" disabled=armed action=reset />
                </div>
            </section>
        </Show>
    }
}

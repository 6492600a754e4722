//! The attack envelope on the Setup page: a row for each set of attacked sensors, asked anew with every other vehicle and gains.

use leptos::prelude::*;
use plumbline_rest::envelope::Envelope;

use crate::{ctx::ctx, model::envelope::rows, net};

/// The card.
#[component]
pub fn EnvelopeCard() -> impl IntoView {
    let ctx = ctx();
    let found = RwSignal::new(None::<Result<Envelope, String>>);
    let asked = StoredValue::new(0_u64);
    // What the answer follows from: the vehicle, its sensors, its gains.
    let about = Memo::new(move |_| {
        let told = ctx.live(|live| {
            let gains = live.gains.get().map(|gains| gains.sha256.clone());
            live.description.get().map(|told| (told.boot_id, told.sensors.len(), gains))
        });
        ctx.app(|app| app.vehicle.clone()).zip(told)
    });
    Effect::new(move |_| {
        let number = asked.get_value() + 1;
        asked.set_value(number);
        found.set(None);
        let Some((id, _)) = about.get() else { return };
        leptos::task::spawn_local(async move {
            let id = String::from(js_sys::encode_uri_component(&id));
            let answer = net::json::<Envelope>("GET", &format!("/api/v1/vehicles/{id}/envelope"), None, "").await;
            // An older question's answer says nothing about the gains of now; the card may be gone.
            if asked.try_get_value() == Some(number) {
                let _ = found.try_set(Some(answer.map_err(|failure| failure.text)));
            }
        });
    });
    view! {
        <section class="card facts" aria-label="Attack envelope">
            <header><h2>"Attack envelope"</h2><span class="quiet push">"about hover, before flight"</span></header>
            {move || match found.get() {
                None if about.get().is_none() => view! { <p class="quiet">"Told of a vehicle that knows its sensor suite."</p> }.into_any(),
                None => view! { <p class="quiet">"Computing…"</p> }.into_any(),
                Some(Err(why)) => view! { <p class="bad">{format!("No envelope: {why}.")}</p> }.into_any(),
                Some(Ok(envelope)) => view! {
                    <p>{format!(
                        "Whoever adds what they like to the samples of these sensors for {} s, without one being excluded, moves the altitude of the linearised loop with lanes and the gains in use at most so far. Noise, wind and the error of the estimate come on top; in simulated flights without them single heights went up to 7 % further.",
                        envelope.horizon_s,
                    )}</p>
                    <table class="dense">
                        <thead><tr><th>"attacked"</th><th class="num">"altitude"</th><th>"held by"</th></tr></thead>
                        <tbody>{rows(&envelope).into_iter().map(|row| view! {
                            <tr>
                                <th scope="row">{row.attacked}</th>
                                <td class="num" class:bad=row.unbounded>{row.bound}</td>
                                <td>{row.held}</td>
                            </tr>
                        }).collect::<Vec<_>>()}</tbody>
                    </table>
                }.into_any(),
            }}
        </section>
    }
}

//! Velocity along one direction, estimates and truth: below the errors, in the place of the attitude, folded until wanted.

use leptos::prelude::*;

use super::{
    legend::{Entry, Legend, TableButton, shown},
    plot::Plot,
};
use crate::{
    deck::{Picture, deck},
    model::{
        curves::{Curve, Way},
        names,
    },
};

/// The card.
#[component]
pub fn VelocityCard() -> impl IntoView {
    let deck = deck();
    let (open, way) = (deck.velocity, deck.way);
    let entries = Memo::new(move |_| {
        let way = way.get();
        deck.read(|live| {
            let in_loop = live.in_loop();
            let entry = |(curve, n)| Entry::new(curve, names::estimator_numbered(n), in_loop);
            let (own, others): (Vec<_>, Vec<_>) = live.curves.velocities(way).partition(|(_, n)| *n == in_loop);
            let truth = Entry::new(Curve::TruthVelocity(way), "truth", in_loop);
            own.into_iter().map(entry).chain([truth]).chain(others.into_iter().map(entry)).collect::<Vec<_>>()
        })
    });
    view! {
        <details class="card chart motors velocity" prop:open=move || open.get() on:toggle:target=move |e| open.set(e.target().open())>
            <summary>
                <h2>"Velocity"</h2>
                <span class="quiet">"estimates and truth, in the place of the attitude"</span>
            </summary>
            <Show when=move || open.get()>
                <div class="chart-body folded">
                    <div class="chart-side">
                        <h3>
                            {shown("Direction of the velocity", Way::ALL, Way::name, way)}
                            <small>"m/s"</small><TableButton entries name="Velocity" unit="m/s" picture=Picture::Velocity />
                        </h3>
                        <Legend entries name="Velocity" unit="m/s" decimals=2 />
                    </div>
                    <Plot picture=Picture::Velocity unit="m/s" label="Velocity along one direction over time: estimates and truth, in metres a second" />
                </div>
            </Show>
        </details>
    }
}

//! The error view: each estimator minus truth, or minus the setpoint where no truth is known, in mm and mrad, with ±3σ
//! of each estimator that has a covariance, on the time axis of the charts above.

use leptos::prelude::*;

use super::{
    legend::{Entry, Legend, TableButton, shown},
    plot::Plot,
    residuals::EvidenceSwitch,
};
use crate::{
    deck::{Deck, Picture, deck},
    model::{
        curves::{Axis, Curve},
        names,
    },
};

/// The estimators with an error of altitude, or of an axis of attitude; the one in the loop first.
fn entries(deck: Deck, axis: Option<Axis>) -> Vec<Entry> {
    deck.read(|live| {
        let in_loop = live.in_loop();
        let entry = |(curve, number)| Entry::new(curve, names::estimator_numbered(number), in_loop);
        let (own, others): (Vec<_>, Vec<_>) = live.curves.error_names(axis).partition(|(_, n)| *n == in_loop);
        own.into_iter().chain(others).map(entry).collect()
    })
}

/// The card, in the place of the residuals.
#[component]
pub fn Errors() -> impl IntoView {
    let deck = deck();
    // They are found while somebody looks.
    Effect::new(move |_| {
        deck.beat();
        deck.data.update_value(|live| live.curves.follow_errors());
    });
    on_cleanup(move || {
        deck.data.try_update_value(|live| live.curves.forget_errors());
    });
    let against = Memo::new(move |_| deck.read(|live| live.curves.has_truth()));
    let axis = deck.error_axis;
    let altitude = Memo::new(move |_| entries(deck, None));
    let attitude = Memo::new(move |_| entries(deck, Some(axis.get())));
    let partial = Memo::new(move |_| {
        deck.zoom.track();
        deck.read(|live| !deck.is_whole(live, Curve::TruthAltitude))
    });
    let unknown = Memo::new(move |_| !partial.get() && altitude.with(Vec::is_empty) && attitude.with(Vec::is_empty));
    // Beside each name: the error under the cursor, else the mean over the window.
    let rms = move || if deck.cursor.get().is_some() { "" } else { "RMS" };
    view! {
        <section class="card chart residuals errors" aria-label="Errors">
            <header>
                <h2>"Errors"</h2>
                <span class="quiet">{move || if against.get() { "estimate minus truth; bands: ±3σ of each" } else { "estimate minus setpoint (no truth here); bands: ±3σ of each" }}</span>
                <span class="push buttons-row"><EvidenceSwitch /></span>
            </header>
            <Show when=move || partial.get()><p class="empty" role="status">"Reading every sample of what is in view…"</p></Show>
            <Show when=move || unknown.get()><p class="empty">"No estimate and truth, or setpoint, to compare yet."</p></Show>
            <div class="chart-body">
                <div class="chart-side">
                    <h3>"Altitude" <small>{rms}" mm"</small><TableButton entries=altitude name="Altitude error" unit="mm" picture=Picture::AltitudeError /></h3>
                    <Legend entries=altitude name="Altitude error" unit="mm" decimals=1 errors=true />
                </div>
                <Plot picture=Picture::AltitudeError unit="mm" times=false label="What each estimator's altitude is off by, in millimetres" />
            </div>
            <div class="chart-body">
                <div class="chart-side">
                    <h3>
                        {shown("Axis of the attitude errors", Axis::ALL, Axis::name, axis)}
                        <small>{rms}" mrad"</small><TableButton entries=attitude name="Attitude error" unit="mrad" picture=Picture::AttitudeError />
                    </h3>
                    <Legend entries=attitude name="Attitude error" unit="mrad" decimals=1 errors=true />
                </div>
                <Plot picture=Picture::AttitudeError unit="mrad" label="What each estimator's attitude is off by about one axis, in milliradians" />
            </div>
        </section>
    }
}

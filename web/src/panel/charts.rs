//! The two charts that are always there: altitude and attitude.

use leptos::prelude::*;

use super::{
    horizon::SpaceCard,
    legend::{Entry, Legend, TableButton},
    motors::MotorsAndTicks,
    plot::Plot,
    residuals::Evidence,
    steps::StepMarks,
    timebar::TimeBar,
};
use crate::{
    deck::{Picture, deck},
    model::{
        curves::{Axis, Curve},
        layout::Evidence as Shown,
        live::Live,
        names,
    },
};

/// Entries of the altitude chart, in drawing order from the most to the least important.
fn altitude_entries(live: &Live) -> Vec<Entry> {
    let in_loop = live.in_loop();
    let estimator = names::estimator_numbered;
    let named = live.curves.names().filter_map(|curve| {
        let name = match curve {
            Curve::Altitude(number) if number == in_loop => "estimate".to_owned(),
            Curve::Altitude(number) => estimator(number).to_owned(),
            Curve::Height(instance) => format!("height {instance}"),
            Curve::TruthAltitude => "truth".to_owned(),
            Curve::Reach(side) => if side { "highest" } else { "lowest" }.to_owned(),
            Curve::AgainAltitude(number) => format!("{} again", estimator(number)),
            _ => return None,
        };
        Some(Entry::new(curve, name, in_loop))
    });
    let setpoint = Entry::new(Curve::SetpointAltitude, "setpoint", in_loop);
    let mut entries: Vec<Entry> = std::iter::once(setpoint).chain(named).collect();
    // The estimate in the loop right after the setpoint.
    entries.sort_by_key(|e| match e.curve {
        Curve::SetpointAltitude => 0,
        Curve::Altitude(n) if n == in_loop => 1,
        Curve::Height(_) => 3,
        Curve::TruthAltitude => 4,
        Curve::Reach(_) => 5,
        _ => 2,
    });
    entries
}

/// Altitude: setpoint, estimates, heights, truth, and the measured response to each step.
#[component]
fn AltitudeChart() -> impl IntoView {
    let deck = deck();
    let entries = Memo::new(move |_| deck.read(altitude_entries));
    view! {
        <section class="card chart altitude" aria-label="Altitude chart">
            <header>
                <h2>"Altitude" <small>"m"</small></h2>
                <TableButton entries name="Altitude" unit="m" picture=Picture::Altitude />
                <TimeBar />
            </header>
            <div class="chart-body">
                <Legend entries name="Altitude" unit="m" decimals=3 />
                <Plot picture=Picture::Altitude unit="m" label="Altitude over time: setpoint, estimates, heights and truth, in metres">
                    <StepMarks />
                </Plot>
            </div>
        </section>
    }
}

/// All charts of a vehicle or a flight; or its altitude below the vehicle in space.
#[component]
pub fn Charts() -> impl IntoView {
    let deck = deck();
    view! {
        <Show when=move || deck.wide.get()><SpaceCard /></Show>
        <AltitudeChart />
        <Show when=move || !deck.wide.get()>
            <Show when=move || { deck.evidence.get() != Shown::Errors || !deck.velocity.get() }><AttitudeChart /></Show>
            <Evidence />
            <MotorsAndTicks />
        </Show>
    }
}

/// Roll, pitch and yaw of the estimate in the loop.
#[component]
fn AttitudeChart() -> impl IntoView {
    let deck = deck();
    let entries = Memo::new(move |_| {
        deck.read(|live| {
            let in_loop = live.in_loop();
            let own = Axis::ALL.map(|axis| Entry::new(Curve::Attitude(in_loop, axis), axis.name(), in_loop));
            let others = live.curves.names().filter_map(|curve| {
                let name = match curve {
                    Curve::TruthAttitude(axis) => format!("true {}", axis.name()),
                    Curve::AgainAttitude(n, axis) => format!("{} again, {}", names::estimator_numbered(n), axis.name()),
                    _ => return None,
                };
                Some(Entry::new(curve, name, in_loop))
            });
            own.into_iter().chain(others).collect::<Vec<_>>()
        })
    });
    view! {
        <section class="card chart attitude" aria-label="Attitude chart">
            <header>
                <h2>"Attitude" <small>"°"</small></h2>
                <TableButton entries name="Attitude" unit="°" picture=Picture::Attitude />
            </header>
            <div class="chart-body">
                <Legend entries name="Attitude" unit="°" decimals=1 />
                <Plot picture=Picture::Attitude unit="°" label="Roll, pitch and yaw over time, in degrees" />
            </div>
        </section>
    }
}

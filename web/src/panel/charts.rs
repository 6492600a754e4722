//! The two charts that are always there: altitude and attitude.

use leptos::prelude::*;

use super::{
    legend::{Entry, Legend, Swatch, TableButton},
    plot::Plot,
    steps::StepMarks,
    timebar::TimeBar,
};
use crate::{
    deck::{Picture, deck},
    model::{
        curves::{Axis, Curve},
        live::Live,
        names,
    },
    palette,
};

/// Entries of the altitude chart, in drawing order from the most to the least important.
fn altitude_entries(live: &Live) -> Vec<Entry> {
    let in_loop = live.in_loop();
    let mut entries = vec![Entry {
        curve: Curve::SetpointAltitude,
        name: "setpoint".into(),
        color: "var(--setpoint)",
        swatch: Swatch::Line,
    }];
    for curve in live.curves.names() {
        match curve {
            Curve::Altitude(number) => {
                let name = if number == in_loop { "estimate" } else { names::estimator_numbered(number) }.to_owned();
                let color = palette::estimator_css(number, in_loop);
                entries.push(Entry { curve, name, color, swatch: Swatch::Line });
            }
            Curve::Height(instance) => entries.push(Entry {
                curve,
                name: format!("height {instance}"),
                color: palette::sensor_css(instance),
                swatch: Swatch::Thin,
            }),
            Curve::TruthAltitude => {
                entries.push(Entry { curve, name: "truth".into(), color: "var(--in-loop)", swatch: Swatch::Dashed });
            }
            Curve::Reach(side) => entries.push(Entry {
                curve,
                name: if side { "highest" } else { "lowest" }.into(),
                color: "var(--attack)",
                swatch: Swatch::Thin,
            }),
            Curve::AgainAltitude(number) => entries.push(Entry {
                curve,
                name: format!("{} again", names::estimator_numbered(number)),
                color: palette::again(number).css(),
                swatch: Swatch::Dashed,
            }),
            _ => {}
        }
    }
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
pub fn AltitudeChart() -> impl IntoView {
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

/// Roll, pitch and yaw of the estimate in the loop.
#[component]
pub fn AttitudeChart() -> impl IntoView {
    let deck = deck();
    let entries = Memo::new(move |_| {
        deck.read(|live| {
            let in_loop = live.in_loop();
            let mut entries: Vec<Entry> = Axis::ALL
                .into_iter()
                .map(|axis| Entry {
                    curve: Curve::Attitude(in_loop, axis),
                    name: axis.name().into(),
                    color: palette::axis_css(axis),
                    swatch: Swatch::Line,
                })
                .collect();
            if live.curves.get(Curve::TruthAttitude(Axis::Roll)).is_some() {
                entries.extend(Axis::ALL.into_iter().map(|axis| Entry {
                    curve: Curve::TruthAttitude(axis),
                    name: format!("true {}", axis.name()),
                    color: palette::axis_css(axis),
                    swatch: Swatch::Dashed,
                }));
            }
            entries.extend(live.curves.names().filter_map(|curve| match curve {
                Curve::AgainAttitude(number, axis) => Some(Entry {
                    curve,
                    name: format!("{} again, {}", names::estimator_numbered(number), axis.name()),
                    color: palette::axis_css(axis),
                    swatch: Swatch::Dashed,
                }),
                _ => None,
            }));
            entries
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

//! Compare: the altitude of several recordings over the same time axis, each from its own begin.

use leptos::prelude::*;
use plumbline_rest::flight::Flight;

use crate::{
    ctx::ctx,
    deck::{Deck, Picture},
    model::{
        curves::{Curve, Curves},
        format,
        live::Live,
        route::Route,
    },
    net,
    page::flight::load_frames,
    palette,
    panel::{
        legend::{Entry, Legend, Swatch},
        plot::Plot,
        toolbar::Link,
    },
};

/// Most flights at once: more colours than this cannot be told apart.
const MOST: usize = 6;

/// Altitude and setpoint of each flight, from its own begin, as curves of one.
fn overlay(flights: &[Live]) -> Live {
    let mut out = Live::recorded();
    out.curves = Curves::unbounded();
    for (i, flight) in flights.iter().enumerate() {
        let begin = flight.curves.time_span_s().map_or(0.0, |s| s.start);
        let mut copy = |from: Curve, to: Curve| {
            if let Some(series) = flight.curves.get(from) {
                for (time, value) in series.samples(series.first()..series.end()) {
                    out.curves.push(to, ((time - begin) * 1e6).max(0.0) as u64, f64::from(value));
                }
            }
        };
        copy(Curve::Altitude(flight.in_loop()), Curve::Compared(i as u8));
        copy(Curve::SetpointAltitude, Curve::ComparedSetpoint(i as u8));
    }
    out
}

/// The page of several flights.
#[component]
pub fn Compare(
    /// Which.
    ids: Vec<String>,
) -> impl IntoView {
    let ctx = ctx();
    let owner = Owner::current();
    let left_out = ids.len().saturating_sub(MOST);
    let ids: Vec<String> = ids.into_iter().take(MOST).collect();
    let state = RwSignal::new(None::<Result<(Deck, Vec<Flight>), String>>);
    leptos::task::spawn_local(async move {
        let mut flights = Vec::new();
        let mut summaries = Vec::new();
        for id in &ids {
            let summary = net::json::<Flight>("GET", &format!("/api/flights/{id}"), None, "").await;
            match (summary, load_frames(id).await) {
                (Ok(summary), Ok(flight)) => {
                    summaries.push(summary);
                    flights.push(flight);
                }
                (Err(e), _) | (_, Err(e)) => {
                    state.try_set(Some(Err(format!("{id}: {}", e.text))));
                    return;
                }
            }
        }
        if state.is_disposed() {
            return;
        }
        if let Some(owner) = owner {
            let deck = owner.with(|| Deck::recorded(ctx, overlay(&flights)));
            state.set(Some(Ok((deck, summaries))));
        }
    });
    on_cleanup(move || ctx.deck.set(None));
    view! {
        <main class="sheet compare" id="main">
            <div class="sheet-head">
                <Link to=Route::Flights>"← Flights"</Link>
                <h1>"Compare"</h1>
                {(left_out > 0).then(|| view! { <span class="quiet">{format!("the first {MOST} of {}", MOST + left_out)}</span> })}
            </div>
            {move || match state.get() {
                None => view! { <p class="banner">"Loading the recordings…"</p> }.into_any(),
                Some(Err(why)) => view! { <p class="banner bad" role="alert">{why}</p> }.into_any(),
                Some(Ok((deck, flights))) => {
                    ctx.deck.set(Some(deck));
                    view! { <Overlay deck flights /> }.into_any()
                }
            }}
        </main>
    }
}

#[component]
fn Overlay(deck: Deck, flights: Vec<Flight>) -> impl IntoView {
    provide_context(deck);
    let entries: Vec<Entry> = flights
        .iter()
        .enumerate()
        .map(|(i, f)| Entry {
            curve: Curve::Compared(i as u8),
            name: f.title().to_owned(),
            color: palette::series(i).css(),
            swatch: Swatch::Line,
        })
        .collect();
    let entries = Signal::derive(move || entries.clone());
    view! {
        <section class="card chart compare-chart" aria-label="Altitude of each flight">
            <header><h2>"Altitude" <small>"m, from the begin of each flight"</small></h2><Legend entries decimals=3 /></header>
            <Plot picture=Picture::Compare label="Altitude of each flight over time, in metres; setpoints dashed" />
        </section>
        <section class="card table-wrap" aria-label="Figures">
            <table>
                <thead><tr><th>"flight"</th><th>"rig"</th><th class="num">"duration"</th><th class="num">"error RMS"</th><th class="num">"first step: rise"</th><th class="num">"overshoot"</th><th class="num">"settling"</th><th class="num">"attacks"</th></tr></thead>
                <tbody>
                    {flights.into_iter().enumerate().map(|(i, f)| {
                        let first = f.steps.first().cloned().unwrap_or_default();
                        let (id, title) = (f.id.clone(), f.title().to_owned());
                        let seconds = |v: Option<f64>| v.map_or_else(|| format::NONE.to_owned(), |s| format!("{} s", format::fixed(s, 2)));
                        view! {
                            <tr>
                                <th scope="row"><i class="swatch" style=format!("--swatch:{};display:inline-block;margin-right:6px;vertical-align:middle", palette::series(i).css())></i><Link to=Route::Flight(id)>{title}</Link></th>
                                <td>{f.rig.clone()}</td>
                                <td class="num">{format::clock(f.duration_s)}</td>
                                <td class="num">{f.tracking_rms_m.map_or_else(|| format::NONE.to_owned(), |m| format!("{} mm", format::fixed(m * 1e3, 1)))}</td>
                                <td class="num">{seconds(first.rise_time_s)}</td>
                                <td class="num">{format!("{} %", format::fixed(first.overshoot_percent, 1))}</td>
                                <td class="num">{seconds(first.settling_time_s)}</td>
                                <td class="num">{f.attacks.len()}</td>
                            </tr>
                        }
                    }).collect::<Vec<_>>()}
                </tbody>
            </table>
        </section>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flight_begins_at_zero() {
        let flight = |start: u64| {
            let mut live = Live::recorded();
            for i in 0..5_u64 {
                live.curves.push(Curve::SetpointAltitude, start + i * 1000, i as f64);
            }
            live
        };
        let out = overlay(&[flight(7_000_000), flight(900_000_000)]);
        assert_eq!(out.curves.value_at(Curve::ComparedSetpoint(0), 0.0), Some(0.0));
        assert_eq!(out.curves.value_at(Curve::ComparedSetpoint(1), 0.0041), Some(4.0));
    }
}

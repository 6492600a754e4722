//! Flights: every recording, to find, compare, download.

use leptos::prelude::*;
use plumbline_rest::flight::{Completeness, Flight, Flights};

use crate::{
    ctx::ctx,
    event::Failure,
    model::{
        format,
        listing::{self, Column},
        route::Route,
    },
    net,
    panel::toolbar::Link,
};

/// The table of flights.
#[component]
pub fn FlightsPage() -> impl IntoView {
    let ctx = ctx();
    let answer = RwSignal::new(None::<Result<Flights, Failure>>);
    let filter = RwSignal::new(String::new());
    let order = RwSignal::new((Column::Started, true));
    let chosen = RwSignal::new(Vec::<String>::new());
    let load = move || {
        leptos::task::spawn_local(async move {
            let flights = net::json("GET", "/api/flights", None, "").await;
            answer.try_set(Some(flights));
        });
    };
    load();
    // A flight that is being recorded, or filled, changes while one looks.
    let timer = set_interval_with_handle(load, std::time::Duration::from_secs(3)).ok();
    on_cleanup(move || {
        if let Some(timer) = timer {
            timer.clear();
        }
    });
    let rows = Memo::new(move |_| {
        let (column, descending) = order.get();
        match answer.get() {
            Some(Ok(flights)) => listing::select(flights.flights, &filter.get(), column, descending),
            _ => Vec::new(),
        }
    });
    let total =
        Memo::new(move |_| answer.with(|a| a.as_ref().and_then(|a| a.as_ref().ok()).map_or(0, |f| f.flights.len())));
    let storage = move || {
        answer.with(|a| {
            a.as_ref().and_then(|a| a.as_ref().ok()).map(|f| {
                format!(
                    "{}, {} used, {} free",
                    format::plural(f.flights.len() as u64, "flight"),
                    format::bytes(f.storage.used_bytes),
                    format::bytes(f.storage.free_bytes)
                )
            })
        })
    };
    let trouble = move || answer.with(|a| a.as_ref().and_then(|a| a.as_ref().err()).map(|e| e.text.clone()));
    let head = move |column: Column| {
        view! {
            <th
                scope="col"
                class:num=column.is_number()
                aria-sort=move || match order.get() {
                    (c, true) if c == column => "descending",
                    (c, false) if c == column => "ascending",
                    _ => "none",
                }
            >
                <button type="button" class="plain" on:click=move |_| order.update(|(c, descending)| {
                    *descending = if *c == column { !*descending } else { column.is_number() || column == Column::Started };
                    *c = column;
                })>
                    {column.name()}
                    <span aria-hidden="true">{move || match order.get() {
                        (c, true) if c == column => " ▾",
                        (c, false) if c == column => " ▴",
                        _ => "",
                    }}</span>
                </button>
            </th>
        }
    };
    let toggle = move |id: String| {
        chosen.update(|all| match all.iter().position(|c| *c == id) {
            Some(at) => {
                all.remove(at);
            }
            None => all.push(id),
        })
    };
    let download = move |_| {
        for id in chosen.get_untracked() {
            net::download(&format!("/api/flights/{id}/mcap"), "");
        }
    };
    view! {
        <main class="sheet" id="main">
            <div class="sheet-head">
                <h1>"Flights"</h1>
                <span class="quiet num">{storage}</span>
                <input
                    type="search"
                    class="push filter"
                    placeholder="Filter: name, vehicle, rig, note"
                    aria-label="Filter flights"
                    prop:value=filter
                    on:input:target=move |e| filter.set(e.target().value())
                />
                <button type="button" disabled=move || chosen.with(|c| c.len() < 2) on:click=move |_| ctx.go(Route::Compare(chosen.get_untracked()))>
                    {move || format!("Compare {}", chosen.with(Vec::len).max(2))}
                </button>
                <button type="button" disabled=move || chosen.with(Vec::is_empty) on:click=download>"Download MCAP"</button>
            </div>
            {move || trouble().map(|text| view! { <p class="banner bad" role="alert"><b>"The list cannot be loaded: "</b>{text}</p> })}
            <div class="card table-wrap">
                <table>
                    <thead>
                        <tr>
                            <th scope="col"><span class="visually-hidden">"Choose"</span></th>
                            {Column::ALL.into_iter().map(head).collect::<Vec<_>>()}
                        </tr>
                    </thead>
                    <tbody>
                        {move || rows.get().into_iter().map(|flight| {
                            let id = flight.id.clone();
                            let picked = id.clone();
                            view! {
                                <tr>
                                    <td>
                                        <input
                                            type="checkbox"
                                            aria-label=format!("Choose {}", flight.title())
                                            prop:checked=move || chosen.with(|c| c.contains(&picked))
                                            on:change=move |_| toggle(id.clone())
                                        />
                                    </td>
                                    <Row flight />
                                </tr>
                            }
                        }).collect::<Vec<_>>()}
                    </tbody>
                </table>
                <Show when=move || answer.with(|a| matches!(a, Some(Ok(_)))) && rows.with(Vec::is_empty)>
                    <p class="blank">{move || if total.get() == 0 {
                        "No flights yet. Arm the vehicle on the Fly page: every flight is recorded by itself, and R records by hand."
                    } else {
                        "No flight matches the filter."
                    }}</p>
                </Show>
                <Show when=move || answer.with(Option::is_none)><p class="blank">"Loading…"</p></Show>
            </div>
        </main>
    }
}

/// The cells of one flight.
#[component]
fn Row(flight: Flight) -> impl IntoView {
    let (id, title) = (flight.id.clone(), flight.title().to_owned());
    let steps = flight.steps.len();
    let attacks = flight.attacks.len();
    let state = match flight.completeness {
        Completeness::Complete => "good",
        Completeness::Truncated => "bad",
        Completeness::Recording | Completeness::Filling => "warn",
    };
    let missing = if flight.missing > 0 {
        format!("{} messages missing", format::count(flight.missing))
    } else {
        "every message is there".to_owned()
    };
    view! {
        <td class="num when">{listing::when(flight.started_unix_us, local_offset_min())}</td>
        <td class="flight-name"><Link to=Route::Flight(id)>{title}</Link></td>
        <td>{flight.vehicle_id.clone()}</td>
        <td>{flight.rig.clone()}</td>
        <td class="num">{format::clock(flight.duration_s)}</td>
        <td class="num">{steps}</td>
        <td class="num">{attacks}</td>
        <td class="num">{flight.tracking_rms_m.map_or_else(|| format::NONE.to_owned(), |m| format!("{} mm", format::fixed(m * 1e3, 0)))}</td>
        <td class=state title=missing>{flight.completeness.name()}</td>
        <td class="num">{format::bytes(flight.size_bytes)}</td>
    }
}

/// Minutes the browser's clock is behind UTC, as `Date` says.
pub fn local_offset_min() -> i64 {
    js_sys::Date::new_0().get_timezone_offset() as i64
}

//! Flights: every recording, to find, compare, download, import.

mod import;

use std::time::Duration;

use leptos::prelude::*;
use plumbline_rest::flight::{Column, Completeness, Flight, Flights, Listing};
use plumbline_rest::people::Role;

use crate::{
    ctx::{ctx, every},
    event::Failure,
    keys,
    model::{choice, format, listing, route::Route},
    net,
    panel::{
        alarms::Guarded,
        guide,
        table::{Pages, SortHead},
        toolbar::Link,
        waiting::Waiting,
    },
};
use import::{ImportButton, Importer, Imports};

/// The list is asked for again after this.
const PERIOD: Duration = Duration::from_secs(3);
/// Columns on the left of the small picture.
const PICTURE_AFTER: usize = 1;
/// Its size, px.
const PICTURE: [f64; 2] = [96.0, 28.0];

/// The altitude of a flight at a glance, and when it was attacked.
#[component]
fn Picture(flight: Flight) -> impl IntoView {
    let Some(picture) = listing::thumbnail(&flight, PICTURE) else { return format::NONE.into_any() };
    let [width, height] = PICTURE;
    let [low, high] = picture.range_m.map(|m| format::fixed(m, 2));
    let attacked = if picture.attacks.is_empty() { "" } else { ", attacked" };
    view! {
        <svg class="thumbnail" role="img" aria-label=format!("Altitude {low} to {high} m{attacked}") width=width height=height>
            {picture.attacks.into_iter().map(|[from, to]| view! {
                <rect class="attacked" x=from y="0" width=(to - from).max(1.0) height=height></rect>
            }).collect::<Vec<_>>()}
            <path class="below" d=picture.below></path>
            <path d=picture.path></path>
        </svg>
        <small class="quiet num">{high} " m"</small>
    }
    .into_any()
}

/// The table of flights.
#[component]
pub fn FlightsPage() -> impl IntoView {
    let ctx = ctx();
    let answer = RwSignal::new(None::<Result<Flights, Failure>>);
    let asked = RwSignal::new(Listing::default());
    let chosen = RwSignal::new(Vec::<String>::new());
    let load = move || {
        let Some(now) = asked.try_get_untracked() else { return };
        leptos::task::spawn_local(async move {
            let flights = net::json("GET", &address(&now), None, "").await;
            // An answer to what is no longer asked comes too late.
            if asked.try_with_untracked(|asked| *asked == now) == Some(true) {
                answer.try_set(Some(flights));
            }
        });
    };
    Effect::new(move |_| {
        asked.track();
        load();
    });
    let importer = Importer::new(load);
    // A flight that is being recorded, or filled, changes while one looks.
    every(PERIOD, load);
    let whole = move |of: fn(&Flights) -> u64| answer.with(|a| a.as_ref().and_then(|a| a.as_ref().ok()).map_or(0, of));
    let rows = Memo::new(move |_| match answer.get() {
        Some(Ok(flights)) => flights.flights,
        _ => Vec::new(),
    });
    let found = Memo::new(move |_| whole(|flights| flights.total) as usize);
    let storage = move || {
        answer.with(|a| {
            a.as_ref().and_then(|a| a.as_ref().ok()).map(|f| {
                format!(
                    "{}, {} used, {} free",
                    format::plural(f.storage.flights, "flight"),
                    format::bytes(f.storage.used_bytes),
                    format::bytes(f.storage.free_bytes)
                )
            })
        })
    };
    let trouble = move || answer.with(|a| a.as_ref().and_then(|a| a.as_ref().err()).map(|e| e.text.clone()));
    let head = move |column: Column| {
        let press = move || {
            asked.update(|asked| {
                let first = listing::is_number(column) || column == Column::Started;
                asked.descending = if asked.sort == column { !asked.descending } else { first };
                asked.sort = column;
                asked.offset = 0;
            });
        };
        view! {
            <SortHead
                name=listing::head(column)
                num=listing::is_number(column)
                column=column.query()
                descending=move || asked.with(|asked| (asked.sort == column).then_some(asked.descending))
                press
            />
        }
    };
    let toggle = move |id: String| chosen.update(|all| choice::toggle(all, id));
    let form = RwSignal::new(listing::FORMS[0].0.to_owned());
    let download = move |_| {
        if let Some(address) = chosen.with_untracked(|ids| listing::download_all(ids, &form.get_untracked())) {
            net::download(&address, "");
        }
    };
    view! {
        <main
            class="sheet"
            id="main"
            class:dropped-on=move || importer.over.get()
            on:dragover=move |e| {
                e.prevent_default();
                importer.over.set(true);
            }
            on:dragleave=move |_| importer.over.set(false)
            on:drop=move |e| {
                e.prevent_default();
                importer.over.set(false);
                match untrack(|| ctx.lacks(Role::Operator)) {
                    Some(why) => {
                        keys::pointed(f64::from(e.client_x()), f64::from(e.client_y()));
                        ctx.refuse(why);
                    }
                    None => importer.dropped(&e),
                }
            }
        >
            <div class="sheet-head">
                <h1>"Flights"</h1>
                <span class="quiet num">{storage}</span>
                <input
                    type="search"
                    class="push filter"
                    placeholder="Filter: name, vehicle, rig, note"
                    aria-label="Filter flights"
                    prop:value=move || asked.with(|asked| asked.search.clone())
                    on:input:target=move |e| asked.update(|asked| {
                        asked.search = e.target().value();
                        asked.offset = 0;
                    })
                />
                <Guarded takes=Role::Operator><ImportButton importer /></Guarded>
                <button type="button" disabled=move || chosen.with(|c| c.len() < 2) on:click=move |_| ctx.go(Route::Compare(chosen.get_untracked()))>
                    {move || format!("Compare {}", chosen.with(Vec::len).max(2))}
                </button>
                <select aria-label="Form of downloads" on:change:target=move |e| form.set(e.target().value())>
                    {listing::FORMS.map(|(form, name)| view! { <option value=form>{name}</option> })}
                </select>
                <button type="button" disabled=move || chosen.with(Vec::is_empty) on:click=download>
                    {move || match chosen.with(Vec::len) {
                        0 | 1 => "Download".to_owned(),
                        several => format!("Download {several} as tar"),
                    }}
                </button>
            </div>
            {move || trouble().map(|text| view! { <p class="banner bad" role="alert"><b>"The list cannot be loaded: "</b>{text}</p> })}
            <Imports importer />
            <div class="card table-wrap">
                <table class="flights-table">
                    <thead>
                        <tr>
                            <th scope="col"><span class="visually-hidden">"Choose"</span></th>
                            {Column::ALL.into_iter().take(PICTURE_AFTER).map(head).collect::<Vec<_>>()}
                            <th scope="col" class="quiet">"altitude"</th>
                            {Column::ALL.into_iter().skip(PICTURE_AFTER).map(head).collect::<Vec<_>>()}
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
                                    <Row flight asked />
                                </tr>
                            }
                        }).collect::<Vec<_>>()}
                    </tbody>
                </table>
                <Show when=move || answer.with(|a| matches!(a, Some(Ok(_)))) && rows.with(Vec::is_empty)>
                    <p class="blank">{move || if asked.with(|asked| asked.search.is_empty()) {
                        view! {
                            "No flights yet. Arm the vehicle on the Fly page: every flight is recorded by itself, and R records by hand. "
                            <button type="button" on:click=move |_| guide::begin(ctx)>"First flight, step by step"</button>
                        }.into_any()
                    } else {
                        view! { "No flight matches the filter." }.into_any()
                    }}</p>
                </Show>
                <Show when=move || answer.with(Option::is_none)><Waiting text="Loading the list…" /></Show>
            </div>
            <Pages
                offset=move || asked.with(|asked| asked.offset)
                limit=move || asked.with(|asked| asked.limit)
                found
                turn=move |offset| asked.update(|asked| asked.offset = offset)
            />
        </main>
    }
}

/// Where a page of the list is asked for.
fn address(asked: &Listing) -> String {
    let search = js_sys::encode_uri_component(&asked.search);
    let Listing { sort, descending, offset, limit, .. } = asked;
    let sort = sort.query();
    format!("/api/v1/flights?search={search}&sort={sort}&descending={descending}&offset={offset}&limit={limit}")
}

/// The cells of one flight.
#[component]
fn Row(flight: Flight, asked: RwSignal<Listing>) -> impl IntoView {
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
        <td class="num when" data-column=Column::Started.query()>{listing::when(flight.started_unix_us, local_offset_min())}</td>
        <td class="picture"><Picture flight=flight.clone() /></td>
        <td class="flight-name">
            <Link to=Route::Flight(id)>{title}</Link>
            {listing::tags(&flight.notes).into_iter().map(|tag| {
                let search = tag.clone();
                view! {
                    <button type="button" class="small plain flight-tag" title="Every flight with this tag" on:click=move |_| asked.update(|asked| {
                        asked.search.clone_from(&search);
                        asked.offset = 0;
                    })>{tag}</button>
                }
            }).collect::<Vec<_>>()}
            {flight.away.then(|| view! {
                <span class="quiet" title="It is fetched from the archive that the grounds share when it is opened">
                    {format!(" at {}", flight.ground.clone().unwrap_or_default())}
                </span>
            })}
            {flight.deleted_unix_us.map(|at| view! {
                <span class="quiet num" title="Retention deletes it then; a name or a note keeps it">
                    {format!(" until {}", listing::when(at, local_offset_min()))}
                </span>
            })}
        </td>
        <td data-column=Column::Vehicle.query()>{flight.vehicle_id.clone()}</td>
        <td data-column=Column::Rig.query()>{flight.rig.clone()}</td>
        <td class="num" data-column=Column::Duration.query()>{format::clock(flight.duration_s)}</td>
        <td class="num" data-column=Column::Steps.query()>{steps}</td>
        <td class="num" data-column=Column::Attacks.query()>{attacks}</td>
        <td class="num">{format::millimetres(flight.tracking_rms_m, 0)}</td>
        <td class=state title=missing>{flight.completeness.name()}</td>
        <td class="num" data-column=Column::Size.query()>{format::bytes(flight.size_bytes)}</td>
    }
}

/// Minutes the browser's clock is behind UTC, as `Date` says.
pub fn local_offset_min() -> i64 {
    js_sys::Date::new_0().get_timezone_offset() as i64
}

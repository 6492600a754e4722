//! Setup: the ground, the vehicle, its suite and limits, and how a real one is connected.

use leptos::prelude::*;
use plumbline_proto::v1::{Description, EstimatorKind, LinkStatus};
use plumbline_rest::ground::Fleet;

use crate::{
    app::GroundState,
    ctx::{Graphics, ctx},
    model::{api, curves::DEGREES, format, names, operator},
    panel::envelope::EnvelopeCard,
    panel::secure::rotors,
    tones::{Tones, Tune},
};

/// Beats of a page of text in two seconds.
const LINK_BEATS: u64 = 8;

fn fact(name: impl IntoView + 'static, value: impl IntoView + 'static) -> impl IntoView {
    view! { <div><dt>{name}</dt><dd class="num">{value}</dd></div> }
}

/// What this ground shares with others.
fn fleet_facts(fleet: Fleet) -> impl IntoView {
    let Fleet { name, archive, index, waiting, archive_error, grounds, live_error } = fleet;
    let kept = archive.map(|archive| {
        let waits = if waiting > 0 { format!(", {waiting} wait") } else { String::new() };
        let error = archive_error.map_or_else(String::new, |error| format!(": {error}"));
        fact("archive", format!("{archive}, index {}{waits}{error}", index.unwrap_or_default()))
    });
    let heard = grounds.map(|grounds| {
        let others = if grounds.is_empty() { "none heard".to_owned() } else { grounds.join(", ") };
        fact("other grounds", live_error.map_or(others.clone(), |error| format!("{others}: {error}")))
    });
    view! {
        {fact("called", name)}
        {kept}
        {heard}
    }
}

/// The operator's name, where no account gives it.
#[component]
fn Name() -> impl IntoView {
    let ctx = ctx();
    let account = move || ctx.session.with(|s| s.name.clone());
    view! {
        {move || match account() {
            Some(name) => name.into_any(),
            None => view! {
                <input
                    type="text"
                    aria-label="Your name, as other operators see it"
                    maxlength="40"
                    prop:value=move || operator::name(&ctx.operator()).to_owned()
                    on:change:target=move |e| ctx.rename(&e.target().value())
                />
                <small class="quiet">{move || format!(" others see “{}”", ctx.operator())}</small>
            }.into_any(),
        }}
    }
}

/// Whether alarms can be heard.
#[component]
fn Tunes() -> impl IntoView {
    let tones: Tones = expect_context();
    view! {
        <label class="check">
            <input type="checkbox" prop:checked=tones.on on:change:target=move |e| tones.switch(e.target().checked()) />
            "on (T)"
        </label>
        " "
        <button type="button" class="small" disabled=move || !tones.on.get() on:click=move |_| tones.play(Tune::Failsafe)>
            "Hear one"
        </button>
    }
}

/// The devices of a vehicle that is really there, live; nothing for any other.
#[component]
fn Devices() -> impl IntoView {
    let ctx = ctx();
    // Told once a second each: only then there is something to copy.
    let told = Memo::new(move |_| ctx.live(|live| live.devices.values().map(|d| d.time_us()).collect::<Vec<_>>()));
    let devices = Memo::new(move |_| {
        told.track();
        ctx.live.with_value(|live| live.devices.values().filter_map(|d| d.get().cloned()).collect::<Vec<_>>())
    });
    let milliseconds =
        |seconds: Option<f64>| seconds.map_or_else(String::new, |s| format!("{} ms", format::fixed(1e3 * s, 1)));
    move || {
        let rows = devices.get();
        (!rows.is_empty()).then(|| view! {
            <section class="card facts" aria-label="Devices">
                <header><h2>"Devices"</h2><span class="quiet push">"since the agent's start"</span></header>
                <table class="dense">
                    <thead><tr>
                        <th>"device"</th><th>"port"</th><th class="num">"rate"</th><th class="num">"age"</th>
                        <th class="num">"jitter"</th><th class="num">"round trip"</th><th class="num">"errors"</th><th class="num">"opened"</th><th>"last reason"</th>
                    </tr></thead>
                    <tbody>{rows.into_iter().map(|d| view! {
                        <tr>
                            <th scope="row" class:bad=!d.up>{d.name}{if d.up { "" } else { " – lost" }}</th>
                            <td>{d.port}</td>
                            <td class="num">{format!("{} Hz", format::fixed(d.rate_hz, 1))}</td>
                            <td class="num">{milliseconds(d.age_s)}</td>
                            <td class="num">{milliseconds(d.jitter_us.map(|us| 1e-6 * us))}</td>
                            <td class="num">{milliseconds(d.round_trip_us.map(|us| 1e-6 * us))}</td>
                            <td class="num">{format::count(d.faults + d.given_up)}</td>
                            <td class="num">{format::count(d.opened)}</td>
                            <td>{d.reason}</td>
                        </tr>
                    }).collect::<Vec<_>>()}</tbody>
                </table>
            </section>
        })
    }
}

/// The Setup page.
#[component]
pub fn Setup() -> impl IntoView {
    let ctx = ctx();
    let ground = Memo::new(move |_| ctx.app(|app| app.ground.clone()));
    // Said again and again: what it says changes seldom.
    let description = Memo::new(move |_| {
        ctx.live(|live| live.description.get().map(|told| Description { time_us: 0, ..told.clone() }))
    });
    // Every two seconds: nobody reads them sooner, and each figure that changes has the browser lay the page out.
    let link = Memo::new(move |shown: Option<&Option<LinkStatus>>| match shown.copied().flatten() {
        Some(shown) if !ctx.tick.get().is_multiple_of(LINK_BEATS) => Some(shown),
        _ => ctx.live(|live| live.ground.link),
    });
    let graphics = move || match ctx.graphics.get() {
        Graphics::Starting => "starting".to_owned(),
        Graphics::On(what) => what,
        Graphics::Lost => "taken away by the browser, coming back".to_owned(),
        Graphics::Off(why) => format!("numbers only: {why}"),
    };
    view! {
        <main class="sheet" id="main">
            <div class="sheet-head"><h1>"Setup"</h1></div>
            <div class="setup-grid">
                <div class="column">
                    <section class="card facts" aria-label="Ground station">
                        <header><h2>"Ground station"</h2></header>
                        {move || match ground.get() {
                            GroundState::Unknown => view! { <p class="quiet">"Asking…"</p> }.into_any(),
                            GroundState::Down(why) => view! {
                                <p class="bad">{format!("No answer: {why}.")}</p>
                                <p>"Start it with " <code>"plumbline-ground"</code> "."</p>
                            }.into_any(),
                            GroundState::Up(g) => view! {
                                <dl class="facts-list">
                                    {fact("version", g.version)}
                                    {fact("schema", g.schema.to_string())}
                                    {fact("up for", format::clock(g.uptime_s))}
                                    {fact("flights in", g.data_folder)}
                                    {fact("storage", format!("{} used by {}, {} free", format::bytes(g.storage.used_bytes), format::plural(g.storage.flights, "flight"), format::bytes(g.storage.free_bytes)))}
                                    {fact("recording", g.recording_error.map_or_else(|| "ready".to_owned(), |e| format!("failing: {e}")))}
                                    {g.fleet.map(|fleet| fleet_facts(*fleet))}
                                    {(!g.set_aside.is_empty()).then(|| fact("damaged, set aside", g.set_aside.join(", ")))}
                                </dl>
                            }.into_any(),
                        }}
                    </section>
                    <section class="card facts" aria-label="Page">
                        <header><h2>"This page"</h2></header>
                        <dl class="facts-list">
                            {fact("version", env!("CARGO_PKG_VERSION"))}
                            {fact("schema", plumbline_proto::SCHEMA.to_string())}
                            {fact("graphics", graphics)}
                            {fact("you are", view! { <Name /> })}
                            {fact("tones for alarms", view! { <Tunes /> })}
                            {move || ctx.session.with(api::who).map(|who| {
                                fact("signed in as", view! { {who} " – " <a href="/login">"sign out"</a> })
                            })}
                            {fact("unreadable messages", move || ctx.live(|live| match live.unreadable() {
                                (0, _) => "none".to_owned(),
                                (number, reason) => format!("{}: {reason}", format::count(number)),
                            }))}
                        </dl>
                    </section>
                    <section class="card facts" aria-label="Link">
                        <header><h2>"Link"</h2></header>
                        {move || match link.get() {
                            None => view! { <p class="quiet">"No vehicle has spoken yet."</p> }.into_any(),
                            Some(l) => view! {
                                <dl class="facts-list">
                                    {fact("connected", if l.connected { "yes" } else { "no" })}
                                    {fact("age of newest", format!("{} ms", format::fixed(l.age_ms, 1)))}
                                    {fact("round trip", format!("{} ms", format::fixed(l.round_trip_ms, 1)))}
                                    {fact("rate", format!("{} Hz", format::fixed(l.rate_hz, 0)))}
                                    {fact("loss", format!("{} %", format::fixed(l.loss_percent, 2)))}
                                    {fact("received", format::count(l.received))}
                                    {fact("missing, this flight", format::count(l.missing))}
                                    {fact("dropped for this page", format::count(l.viewer_dropped))}
                                </dl>
                            }.into_any(),
                        }}
                    </section>
                    <section class="card facts" aria-label="Limits">
                        <header><h2>"Limits"</h2><span class="quiet push">"enforced on the vehicle"</span></header>
                        {move || match description.get().and_then(|d| d.limits) {
                            None => view! { <p class="quiet">"Told by the vehicle once it is connected."</p> }.into_any(),
                            Some(l) => view! {
                                <dl class="facts-list">
                                    {fact("altitude", format!("{} … {} m", format::fixed(l.altitude_min_m, 2), format::fixed(l.altitude_max_m, 2)))}
                                    {fact("lateral", format!("{} m", format::fixed(l.lateral_max_m, 2)))}
                                    {fact("climb", format!("{} m/s", format::fixed(l.climb_max_mps, 2)))}
                                    {fact("descent", format!("{} m/s", format::fixed(l.descent_max_mps, 2)))}
                                    {fact("tilt", format!("{}°", format::fixed(l.tilt_max_rad * DEGREES, 1)))}
                                    {fact("thrust", format!("{} N", format::fixed(l.thrust_max_n, 1)))}
                                    {fact("longest attack", format!("{} s", format::fixed(l.attack_max_duration_s, 0)))}
                                </dl>
                            }.into_any(),
                        }}
                    </section>
                </div>
                <div class="column">
                    <section class="card facts" aria-label="Vehicle">
                        <header><h2>"Vehicle"</h2></header>
                        {move || match description.get() {
                            None => view! { <p class="quiet">"No vehicle has described itself yet. Start a simulated one with " <code>"plumbline-agent --vehicle sim"</code> "."</p> }.into_any(),
                            Some(d) => view! {
                                <dl class="facts-list">
                                    {fact("id", d.agent_id.clone())}
                                    {fact("kind", d.vehicle.clone())}
                                    {fact("agent", d.agent_version.clone())}
                                    {fact("airframe", d.airframe.clone())}
                                    {fact("mass", format!("{} kg", format::fixed(d.mass_kg, 3)))}
                                    {fact("rig", d.rig.clone())}
                                    {fact("tick rate", format!("{} Hz", format::fixed(d.tick_rate_hz, 0)))}
                                    {fact("seed", d.seed.to_string())}
                                    {fact("estimators", d.estimators().map(EstimatorKind::title).collect::<Vec<_>>().join(", "))}
                                    {fact("rotors", move || ctx.live(|live| live.status.get().and_then(rotors)).map_or_else(|| "not told".to_owned(), |(text, _)| text))}
                                    {fact("attacks", if d.attacks_enabled { "enabled by its configuration" } else { "off" })}
                                    {(!d.source_file.is_empty()).then(|| fact("replays", d.source_file.clone()))}
                                </dl>
                                {(!d.scenario.is_empty()).then(|| view! {
                                    <details class="counts"><summary>"Scenario file"</summary><pre>{d.scenario.clone()}</pre></details>
                                })}
                            }.into_any(),
                        }}
                    </section>
                    <section class="card facts" aria-label="Sensor suite">
                        <header><h2>"Sensor suite"</h2></header>
                        {move || match description.get().filter(|d| !d.sensors.is_empty()) {
                            None => view! { <p class="quiet">"Told by the vehicle once it is connected."</p> }.into_any(),
                            Some(d) => view! {
                                <table class="dense">
                                    <thead><tr><th>"sensor"</th><th class="num">"rate"</th><th class="num">"sigma"</th><th></th></tr></thead>
                                    <tbody>{d.sensors.iter().map(|s| view! {
                                        <tr>
                                            <th scope="row">{if s.name.is_empty() { names::instance(s.kind(), s.instance) } else { s.name.clone() }}</th>
                                            <td class="num">{format!("{} Hz", format::fixed(s.rate_hz, 0))}</td>
                                            <td class="num">{format::fixed(s.sigma, 4)}</td>
                                            <td>{s.unit.clone()}</td>
                                        </tr>
                                    }).collect::<Vec<_>>()}</tbody>
                                </table>
                            }.into_any(),
                        }}
                    </section>
                </div>
                <div class="column">
                    <section class="card facts" aria-label="Observability">
                        <header><h2>"Observability"</h2><span class="quiet push">"at hover, before flight"</span></header>
                        {move || match description.get().and_then(|d| d.observability) {
                            None => view! { <p class="quiet">"Told by a vehicle that knows its sensor suite."</p> }.into_any(),
                            Some(o) if !o.error.is_empty() => view! { <p class="bad">{o.error.clone()}</p> }.into_any(),
                            Some(o) => view! {
                                <dl class="facts-list">
                                    {fact("rows", o.rows.to_string())}
                                    {fact("rank", format!("{} of {}", o.rank, o.states.len()))}
                                    {fact("any rows that may be lost", o.sparse_observable.to_string())}
                                    {fact("any rows that may be attacked", o.correctable.to_string())}
                                    {fact("first state lost", o.binding_state.clone())}
                                    {o.types.iter().map(|t| fact(
                                        names::sensor(t.sensor()),
                                        format!("{} of {} rows may be attacked", t.correctable, t.rows),
                                    )).collect::<Vec<_>>()}
                                </dl>
                                <table class="dense">
                                    <thead><tr><th>"state"</th><th class="num">"rows to lose it"</th></tr></thead>
                                    <tbody>{o.states.iter().map(|s| view! {
                                        <tr><th scope="row">{s.state.clone()}</th><td class="num">{s.rows_to_lose}</td></tr>
                                    }).collect::<Vec<_>>()}</tbody>
                                </table>
                            }.into_any(),
                        }}
                    </section>
                    <EnvelopeCard />
                </div>
                <Devices />
                <super::people::PeopleCard />
                <section class="card facts" aria-label="Connect a vehicle">
                    <header><h2>"Connect a vehicle"</h2></header>
                    <ol class="how">
                        <li><b>"Simulated. "</b><code>"plumbline-agent --vehicle sim"</code>" flies the default hanging-string rig; a scenario file chooses another."</li>
                        <li><b>"Recorded. "</b><code>"plumbline-agent --vehicle replay FILE"</code>" flies a recording again: one of ours, or PX4 ULog, BROAD, Phantom 4."</li>
                        <li><b>"Real. "</b>"Run the agent on the vehicle's computer with the address of this ground station, and pair the two once: each keeps the other's certificate. An unpaired vehicle gets nothing."</li>
                    </ol>
                    <p class="quiet">"Whatever is pressed here, the vehicle enforces its own limits and failsafes: link loss freezes the setpoint after 0.5 s and descends after 2 s."</p>
                </section>
            </div>
        </main>
    }
}

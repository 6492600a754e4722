//! Compare: the altitude, or any signal, of several recordings over the same time axis, what each differs by from the first and
//! whether that is within a tolerance, all their steps, and what they were flown with.

use leptos::prelude::*;
use plumbline_rest::flight::{Flight, OVERVIEW_COLUMNS, Samples, Signal as Recorded, Signals};

use crate::{
    ctx::ctx,
    deck::{Deck, Picture},
    event::Failure,
    model::{
        axis::TimeAxis,
        configuration::{Row, all, differences},
        curves::{Curve, Curves},
        format,
        live::Live,
        route::Route,
        series::Series,
    },
    net,
    page::flight::{WHOLE_S, load},
    palette,
    panel::{
        legend::{Entry, Legend, TableButton},
        plot::Plot,
        toolbar::Link,
        waiting::Waiting,
    },
};

/// Kinds that are compared.
const KINDS: &str = "estimate,control,status,attacks,event,step,description,gains";
/// Most flights at once: more colours than this cannot be told apart.
pub const MOST: usize = 8;
/// A flight that leads by so much has taken off, m.
const OFF_THE_GROUND_M: f64 = 0.1;

/// What is laid on top of each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Align {
    Begin,
    TakeOff,
    /// The step of this number, from 1.
    Step(usize),
    Attack,
}

impl Align {
    const ALL: [(Self, &'static str); 4] = [
        (Self::Begin, "begin of the recording"),
        (Self::TakeOff, "take-off"),
        (Self::Step(1), "step"),
        (Self::Attack, "first attack"),
    ];

    /// When that is in a flight, s of its flight time; its begin where it never was.
    fn time_s(self, flight: &Live) -> f64 {
        let span = flight.curves.time_span_s().unwrap_or(0.0..0.0);
        let found = match self {
            Self::Begin => None,
            Self::TakeOff => flight.curves.get(Curve::Altitude(flight.in_loop())).and_then(take_off),
            Self::Step(number) => flight.log.steps.get(number.saturating_sub(1)).map(|s| s.start_time_us as f64 * 1e-6),
            Self::Attack => {
                // What is over is told on in the flights after it.
                let seen = flight.log.attacks.between(span.start, span.end).filter(|s| s.seen);
                seen.map(|s| s.start_s).min_by(f64::total_cmp)
            }
        };
        found.unwrap_or(span.start)
    }
}

/// When an altitude was first above what it was at first.
fn take_off(altitude: &Series) -> Option<f64> {
    let mut known = altitude.samples(altitude.first()..altitude.end()).filter(|(_, value)| value.is_finite());
    let (_, ground) = known.next()?;
    known.find(|(_, value)| f64::from(value - ground) > OFF_THE_GROUND_M).map(|(time_s, _)| time_s)
}

/// Altitude and setpoint of each flight, or its `signal`, as curves of one, what `align` names at the same time and then each moved
/// by its `shifts_s`; and what each differs by from the first: altitudes in mm.
fn overlay(flights: &[Live], align: Align, shifts_s: &[f64], signal: bool) -> Curves {
    let mut out = Curves::unbounded();
    let at: Vec<f64> = flights
        .iter()
        .enumerate()
        .map(|(i, flight)| align.time_s(flight) - shifts_s.get(i).copied().unwrap_or(0.0))
        .collect();
    // Nothing is before zero.
    let begin = |flight: &Live| flight.curves.time_span_s().map_or(0.0, |s| s.start);
    let longest = flights.iter().zip(&at).map(|(flight, at)| at - begin(flight)).fold(0.0, f64::max);
    for (i, (flight, at)) in flights.iter().zip(&at).enumerate() {
        let zero = at - longest;
        let mut copy = |from: Curve, to: Curve| {
            if let Some(series) = flight.curves.get(from) {
                for (time, value) in series.samples(series.first()..series.end()) {
                    out.push(to, ((time - zero) * 1e6).round().max(0.0) as u64, f64::from(value));
                }
            }
        };
        if signal {
            copy(Curve::Signal(0), Curve::Compared(i as u8));
        } else {
            copy(Curve::Altitude(flight.in_loop()), Curve::Compared(i as u8));
            copy(Curve::SetpointAltitude, Curve::ComparedSetpoint(i as u8));
        }
    }
    let factor = if signal { 1.0 } else { 1e3 };
    for i in 1..flights.len() as u8 {
        for (time_s, off) in out.minus(Curve::Compared(i), Curve::Compared(0)) {
            out.push(Curve::Difference(i), (time_s * 1e6).round() as u64, off * factor);
        }
    }
    out
}

/// The largest difference of a curve in a stretch, either way, and whether it is within the tolerance; `None` where the
/// two flights have no time in common there.
fn verdict(curves: &Curves, of: u8, axis: TimeAxis, tolerance: Option<f64>) -> Option<(f64, Option<bool>)> {
    let extent = curves.get(Curve::Difference(of))?.extent_between(axis.start_s, axis.end_s);
    let largest = f64::from(extent.max.max(-extent.min));
    (!extent.is_empty()).then(|| (largest, tolerance.map(|most| largest <= most)))
}

/// Flights to compare: their curves, what is known of them, and how many samples were recorded for each altitude drawn.
type Loaded = (StoredValue<Vec<Live>, LocalStorage>, Deck, Vec<Flight>, Vec<Vec<Row>>, u64);

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
    let state = RwSignal::new(None::<Result<Loaded, String>>);
    let share = RwSignal::new(None::<f64>);
    leptos::task::spawn_local(async move {
        let mut flights = Vec::new();
        let mut summaries = Vec::new();
        let mut each = 1;
        for (done, id) in ids.iter().enumerate() {
            let summary = net::json::<Flight>("GET", &format!("/api/v1/flights/{id}"), None, "").await;
            let length_s = summary.as_ref().map_or(f64::INFINITY, |flight| flight.duration_s.max(1e-3));
            let told = |covered_s: f64| {
                let _ = share.try_set(Some((done as f64 + (covered_s / length_s).min(1.0)) / ids.len() as f64));
            };
            match (summary, whole(id, length_s, told).await) {
                (Ok(summary), Ok((flight, of))) => {
                    each = each.max(of);
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
            let rows = summaries.iter().zip(&flights).map(|(flight, live)| all(flight, live)).collect();
            let mut live = Live::recorded();
            live.curves = overlay(&flights, Align::Begin, &[], false);
            let (flights, deck) = owner.with(|| (StoredValue::new_local(flights), Deck::recorded(ctx, live)));
            state.set(Some(Ok((flights, deck, summaries, rows, each))));
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
                None => view! { <Waiting text="Loading the recordings…" share /> }.into_any(),
                Some(Err(why)) => view! { <p class="banner bad" role="alert">{why}</p> }.into_any(),
                Some(Ok((lives, deck, flights, rows, each))) => {
                    ctx.deck.set(Some(deck));
                    provide_context(deck);
                    view! {
                        <Overlay deck lives flights=flights.clone() each />
                        <Figures flights=flights.clone() />
                        <Steps flights=flights.clone() />
                        <Configuration flights rows />
                    }.into_any()
                }
            }}
        </main>
    }
}

/// What is compared: the altitude where nothing is named.
type What = Option<Recorded>;

/// Stretches asked for of a signal: of two minutes every sample at 200 Hz.
const COLUMNS: usize = 10_000;

/// A signal of a flight.
struct Read {
    /// Flight time at which the flight begins, s; samples count from there.
    start_s: f64,
    samples: Samples,
}

/// The signals of a flight, and when it begins.
async fn recorded(id: &str) -> Result<Signals, Failure> {
    net::json("GET", &format!("/api/v1/flights/{id}/signals"), None, "").await
}

/// The signal called so of each flight.
async fn read_all(ids: &[String], name: &str) -> Result<(Recorded, Vec<Read>), String> {
    let (mut signal, mut reads) = (None, Vec::new());
    for id in ids {
        let of = |why: Failure| format!("{id}: {}", why.text);
        let Signals { start_s, signals } = recorded(id).await.map_err(of)?;
        if signal.is_none() {
            let known = signals.into_iter().find(|signal| signal.name == name);
            signal = Some(known.ok_or_else(|| format!("{name:?} is no signal of the first flight"))?);
        }
        reads.push(Read::of(id, name, start_s).await.map_err(of)?);
    }
    Ok((signal.ok_or("no flight is compared")?, reads))
}

impl Read {
    async fn of(id: &str, name: &str, start_s: f64) -> Result<Self, Failure> {
        let asked = String::from(js_sys::encode_uri_component(name));
        let url = format!("/api/v1/flights/{id}/signal?name={asked}&columns={COLUMNS}");
        Ok(Self { start_s, samples: net::json("GET", &url, None, "").await? })
    }

    /// Becomes this curve.
    fn put(&self, curves: &mut Curves, curve: Curve) {
        let length_s = self.samples.time_s.last().copied().unwrap_or(0.0);
        let times = self.samples.time_s.iter().map(|time_s| self.start_s + time_s);
        curves.set(curve, times.zip(self.samples.value.iter().copied()), 4.0 * length_s / COLUMNS as f64);
    }

    /// How many samples were recorded for each that came.
    fn each(&self) -> u64 {
        self.samples.samples.div_ceil(self.samples.time_s.len().max(1) as u64)
    }
}

/// What is compared of a flight that lasts `length_s`. Of a long one the ground thins what only tells when things happened; the
/// altitude in the loop and its setpoint come as signals do. And how many samples were recorded for each of theirs.
async fn whole(id: &str, length_s: f64, told: impl Fn(f64)) -> Result<(Live, u64), Failure> {
    if length_s <= WHOLE_S {
        return Ok((load(id, KINDS, "", told).await?, 1));
    }
    let mut flight = load(id, KINDS, &format!("&columns={OVERVIEW_COLUMNS}"), told).await?;
    let (estimator, start_s, mut each) = (flight.in_loop(), recorded(id).await?.start_s, 1);
    for (curve, name) in [
        (Curve::Altitude(estimator), format!("estimate_{estimator}.position_enu_m.z")),
        (Curve::SetpointAltitude, "control.setpoint.altitude_m".to_owned()),
    ] {
        if flight.curves.get(curve).is_some() {
            let read = Read::of(id, &name, start_s).await?;
            each = each.max(read.each());
            read.put(&mut flight.curves, curve);
        }
    }
    Ok((flight, each))
}

/// What is said where one of so many samples is drawn.
fn thinned(each: u64) -> Option<Result<String, String>> {
    let text = format!(
        "long: drawn is the least and the greatest of about {each} samples, and the difference is between those"
    );
    (each > 1).then_some(Ok(text))
}

/// The curves, and what they differ by; `each` altitude drawn is one of so many.
#[component]
fn Overlay(deck: Deck, lives: StoredValue<Vec<Live>, LocalStorage>, flights: Vec<Flight>, each: u64) -> impl IntoView {
    let chosen = RwSignal::new(Align::Begin);
    let shifts = RwSignal::new(vec![0.0; flights.len()]);
    let what = RwSignal::new(None::<Recorded>);
    let said = RwSignal::new(thinned(each));
    let lay = move || {
        let signal = what.with_untracked(Option::is_some);
        let curves = lives.with_value(|lives| shifts.with(|shifts| overlay(lives, chosen.get(), shifts, signal)));
        let span = curves.time_span_s().unwrap_or(0.0..1.0);
        deck.data.update_value(|live| live.curves = curves);
        deck.zoom.set(None);
        deck.origin_s.set(span.start);
        deck.window_s.set((span.end - span.start).max(1.0));
    };
    Effect::new(move |before: Option<()>| {
        chosen.track();
        shifts.track();
        what.track();
        if before.is_some() {
            lay();
        }
    });
    let known = RwSignal::new(Vec::<Recorded>::new());
    let ids: Vec<String> = flights.iter().map(|flight| flight.id.clone()).collect();
    if let Some(first) = ids.first().cloned() {
        leptos::task::spawn_local(async move {
            if let Ok(found) = recorded(&first).await {
                known.try_set(found.signals);
            }
        });
    }
    let ids = StoredValue::new(ids);
    // What was asked for last: an answer to anything before comes too late.
    let asked = StoredValue::new(String::new());
    let compare = move |name: String| {
        let name = name.trim().to_owned();
        asked.set_value(name.clone());
        if name.is_empty() {
            said.set(thinned(each));
            what.set(None);
            return;
        }
        said.set(Some(Ok("reading…".into())));
        leptos::task::spawn_local(async move {
            let ids = ids.try_get_value().unwrap_or_default();
            let found = read_all(&ids, &name).await;
            if asked.try_with_value(|last| *last != name).unwrap_or(true) {
                return;
            }
            let (signal, reads) = match found {
                Ok(found) => found,
                Err(why) => return drop(said.try_set(Some(Err(why)))),
            };
            lives.try_update_value(|lives| {
                for (live, read) in lives.iter_mut().zip(&reads) {
                    read.put(&mut live.curves, Curve::Signal(0));
                }
            });
            said.try_set(thinned(reads.iter().map(Read::each).fold(1, u64::max)));
            what.try_set(Some(signal));
        });
    };
    let align = move |text: String| {
        if let Some((align, _)) = Align::ALL.into_iter().find(|(_, name)| *name == text) {
            chosen.set(align);
        }
    };
    let most_steps = flights.iter().map(|f| f.steps.len()).max().unwrap_or(0).max(1);
    let step = move |text: String| {
        if let Some(number) = text.parse().ok().filter(|n| (1..=most_steps).contains(n)) {
            chosen.set(Align::Step(number));
        }
    };
    let flights = StoredValue::new(flights);
    view! {
        <div class="sheet-head">
            <label class="row quiet">"what: "
                <input
                    type="search"
                    class="filter"
                    list="compared-signals"
                    placeholder="altitude, or a signal"
                    autocomplete="off"
                    aria-label="What is compared: the altitude, or a signal by its name"
                    on:change:target=move |e| compare(e.target().value())
                />
                <datalist id="compared-signals">{move || known.get().into_iter().map(|signal| view! { <option value=signal.name>{signal.unit}</option> }).collect_view()}</datalist>
            </label>
            <label class="row quiet">"same time: "
                <select class="small" aria-label="What is laid on top of each other" on:change:target=move |e| align(e.target().value())>
                    {Align::ALL.map(|(_, name)| view! { <option>{name}</option> }).collect_view()}
                </select>
            </label>
            <Show when=move || matches!(chosen.get(), Align::Step(_))>
                <input type="number" class="brief" min="1" max=most_steps value="1" aria-label="Number of the step" on:change:target=move |e| step(e.target().value()) />
            </Show>
            {move || said.get().map(|said| match said {
                Ok(note) => view! { <span class="quiet" role="status">{note}</span> }.into_any(),
                Err(why) => view! { <span class="bad" role="alert">{why}</span> }.into_any(),
            })}
        </div>
        // Remade for another quantity: its unit stands on the axes.
        {move || view! { <Quantity deck shifts what=what.get() flights=flights.get_value() /> }}
    }
}

/// One quantity of each flight, what it differs by, and whether that is within a tolerance.
#[component]
fn Quantity(deck: Deck, shifts: RwSignal<Vec<f64>>, what: What, flights: Vec<Flight>) -> impl IntoView {
    let entries = |curve: fn(u8) -> Curve, from: usize| {
        let entry = |(i, f): (usize, &Flight)| Entry::new(curve(i as u8), f.title(), 0);
        let all: Vec<Entry> = flights.iter().enumerate().skip(from).map(entry).collect();
        Signal::derive(move || all.clone())
    };
    let (values, differences) = (entries(Curve::Compared, 0), entries(Curve::Difference, 1));
    let first = flights.first().map(|f| f.title().to_owned()).unwrap_or_default();
    let altitude = what.is_none();
    let Recorded { name, unit } = what.unwrap_or_else(|| Recorded { name: "Altitude".into(), unit: "m".into() });
    let apart = if altitude { "mm".to_owned() } else { unit.clone() };
    let (said, decimals) = if altitude { ("altitude".to_owned(), 3) } else { (name.clone(), 4) };
    let each = format!("{name} of each flight over time{}", if altitude { "; setpoints dashed" } else { "" });
    let tolerance = move |text: String| deck.tolerance.set(format::parse_number(&text).ok().filter(|most| *most > 0.0));
    // One of another unit would be another tolerance.
    deck.tolerance.set(None);
    deck.another.set(!altitude);
    view! {
        <section class="card chart compare-chart" aria-label=format!("{name} of each flight")>
            <header>
                <h2>{name.clone()} " " <small>{unit.clone()}</small></h2>
                <TableButton entries=values name="Compared" unit="" picture=Picture::Compare />
            </header>
            <div class="chart-body">
                <Legend entries=values name="Compared" unit="" decimals />
                <Plot picture=Picture::Compare unit=unit label=each />
            </div>
        </section>
        <section class="card chart compare-chart difference" aria-label=format!("Difference of {said}")>
            <header>
                <h2>"Difference" <small>{format!("RMS {apart}, minus {first}")}</small></h2>
                <TableButton entries=differences name="Difference" unit="" picture=Picture::Difference />
            </header>
            <div class="chart-body">
                <Legend entries=differences name="Difference" unit="" decimals=if altitude { 1 } else { 4 } errors=true />
                <Plot picture=Picture::Difference unit=apart.clone() label=format!("{said} of each flight minus that of the first") />
            </div>
        </section>
        <section class="card table-wrap" aria-label="Tolerance">
            <header>
                <h2>"Within tolerance"</h2>
                <label class="row quiet">{format!("tolerance, {apart} ")}
                    <input type="text" class="brief" inputmode="decimal" autocomplete="off" aria-label=format!("Tolerance of the difference, {}", if altitude { "in millimetres" } else { &apart }) on:change:target=move |e| tolerance(e.target().value()) />
                </label>
            </header>
            <table>
                <thead><tr><th>"flight"</th><th class="num">"moved by, s"</th><th class="num">{format!("largest difference in view, {apart}")}</th><th>"verdict"</th></tr></thead>
                <tbody>{flights.iter().enumerate().map(|(i, flight)| view! { <Judged deck shifts i decimals=if altitude { 1 } else { 4 } flight=flight.clone() /> }).collect_view()}</tbody>
            </table>
        </section>
    }
}

/// What one flight is moved by, and whether it is close enough to the first.
#[component]
fn Judged(deck: Deck, shifts: RwSignal<Vec<f64>>, i: usize, decimals: usize, flight: Flight) -> impl IntoView {
    let judged = Memo::new(move |_| {
        let tolerance = deck.tolerance.get();
        deck.zoom.track();
        deck.read(|live| verdict(&live.curves, i as u8, deck.axis(live), tolerance))
    });
    let moved = move |text: String| {
        let to = if text.trim().is_empty() { Ok(0.0) } else { format::parse_number(&text) };
        if let Ok(to) = to {
            shifts.update(|all| {
                if let Some(shift) = all.get_mut(i) {
                    *shift = to;
                }
            });
        }
    };
    let text = move || match judged.get() {
        _ if i == 0 => ("quiet", "what the others are compared with"),
        None => ("quiet", "no time in common"),
        Some((_, None)) => ("quiet", "no tolerance given"),
        Some((_, Some(true))) => ("good", "✓ pass"),
        Some((_, Some(false))) => ("bad", "✗ fail"),
    };
    let label = format!("Move {} by, in seconds", flight.title());
    // A quantity that is shown anew finds the flights where they were moved to.
    let shifted = shifts
        .with_untracked(|all| all.get(i).copied())
        .filter(|by| *by != 0.0)
        .map_or_else(String::new, |by| by.to_string());
    view! {
        <tr>
            <th scope="row">{named(i, &flight)}</th>
            <td class="num"><input type="text" class="brief" inputmode="decimal" autocomplete="off" placeholder="0" aria-label=label prop:value=shifted on:change:target=move |e| moved(e.target().value()) /></td>
            <td class="num">{move || format::maybe(judged.get().map(|(largest, _)| largest), decimals)}</td>
            <td class=move || text().0>{move || text().1}</td>
        </tr>
    }
}

/// The mark and the name of a flight.
fn named(i: usize, flight: &Flight) -> impl IntoView + use<> {
    let (id, title) = (flight.id.clone(), flight.title().to_owned());
    let style = format!(
        "--swatch:{};display:inline-block;margin-right:6px;vertical-align:middle",
        palette::series(i).ink.css()
    );
    view! { <i class="swatch" style=style></i><Link to=Route::Flight(id)>{title}</Link> }
}

#[component]
fn Figures(flights: Vec<Flight>) -> impl IntoView {
    view! {
        <section class="card table-wrap" aria-label="Figures">
            <h2 class="visually-hidden">"Figures"</h2>
            <table>
                <thead><tr><th>"flight"</th><th>"rig"</th><th class="num">"duration"</th><th class="num">"error RMS"</th><th class="num">"steps"</th><th class="num">"attacks"</th></tr></thead>
                <tbody>
                    {flights.into_iter().enumerate().map(|(i, f)| {
                        view! {
                            <tr>
                                <th scope="row">{named(i, &f)}</th>
                                <td>{f.rig.clone()}</td>
                                <td class="num">{format::clock(f.duration_s)}</td>
                                <td class="num">{format::millimetres(f.tracking_rms_m, 1)}</td>
                                <td class="num">{f.steps.len()}</td>
                                <td class="num">{f.attacks.len()}</td>
                            </tr>
                        }
                    }).collect::<Vec<_>>()}
                </tbody>
            </table>
        </section>
    }
}

/// Every step of every flight, those of the same number together.
#[component]
fn Steps(flights: Vec<Flight>) -> impl IntoView {
    let most = flights.iter().map(|f| f.steps.len()).max().unwrap_or(0);
    let row = |number: usize, i: usize, flight: &Flight| {
        let s = flight.steps.get(number)?.clone();
        let settled = |text: String| if s.interrupted { "interrupted".to_owned() } else { text };
        let error = s.steady_error_m.filter(|_| !s.interrupted);
        Some(view! {
            <tr>
                <td class="num">{number + 1}</td>
                <th scope="row">{named(i, flight)}</th>
                <td class="num">{format!("{} → {} m", format::fixed(s.from_m, 2), format::fixed(s.to_m, 2))}</td>
                <td class="num">{format::maybe(s.rise_time_s, 2)}</td>
                <td class="num">{format::fixed(s.overshoot_percent, 1)}</td>
                <td class="num">{settled(format::maybe(s.settling_time_s, 2))}</td>
                <td class="num">{error.map_or_else(|| format::NONE.to_owned(), |m| format::signed(m * 1e3, 1))}</td>
            </tr>
        })
    };
    let rows: Vec<_> = (0..most)
        .flat_map(|number| flights.iter().enumerate().filter_map(move |(i, flight)| row(number, i, flight)))
        .collect();
    view! {
        <section class="card table-wrap" aria-label="Steps">
            <header><h2>"Steps"</h2></header>
            {if rows.is_empty() {
                view! { <p class="blank">"No step of the altitude setpoint in any of them."</p> }.into_any()
            } else {
                view! {
                    <table>
                        <thead><tr><th class="num">"step"</th><th>"flight"</th><th class="num">"of"</th><th class="num">"rise s"</th><th class="num">"overshoot %"</th><th class="num">"settling s"</th><th class="num">"error mm"</th></tr></thead>
                        <tbody>{rows}</tbody>
                    </table>
                }.into_any()
            }}
        </section>
    }
}

/// What the flights were flown with, where it is not the same.
#[component]
fn Configuration(flights: Vec<Flight>, rows: Vec<Vec<Row>>) -> impl IntoView {
    let (rows, same) = differences(&rows);
    let the_same = format!("{} the same", format::plural(same as u64, "value"));
    view! {
        <section class="card table-wrap" aria-label="Configuration and gains">
            <header><h2>"Configuration and gains"</h2><span class="quiet">{the_same}</span></header>
            {if rows.is_empty() {
                view! { <p class="blank">"They were flown with the same configuration, gains and scenario."</p> }.into_any()
            } else {
                view! {
                    <table>
                        <thead><tr><th>"what differs"</th>{flights.iter().enumerate().map(|(i, f)| view! { <th scope="col">{named(i, f)}</th> }).collect_view()}</tr></thead>
                        <tbody>
                            {rows.into_iter().map(|(name, values)| view! {
                                <tr><th scope="row">{name}</th>{values.into_iter().map(|value| view! { <td class="num-left">{value}</td> }).collect_view()}</tr>
                            }).collect_view()}
                        </tbody>
                    </table>
                }.into_any()
            }}
        </section>
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::v1;

    use super::*;

    fn flight(start: u64) -> Live {
        let mut live = Live::recorded();
        for i in 0..5_u64 {
            live.curves.push(Curve::SetpointAltitude, start + i * 1000, i as f64);
        }
        live
    }

    #[test]
    fn every_flight_begins_at_zero() {
        let out = overlay(&[flight(7_000_000), flight(900_000_000)], Align::Begin, &[], false);
        assert_eq!(out.value_at(Curve::ComparedSetpoint(0), 0.0), Some(0.0));
        assert_eq!(out.value_at(Curve::ComparedSetpoint(1), 0.0041), Some(4.0));
    }

    #[test]
    fn an_attack_of_a_flight_before_is_not_the_first_of_this_one() {
        let attacked = |active_time_us: u64| {
            let mut live = flight(7_000_000);
            let progress = v1::AttackProgress {
                attack: Some(v1::Attack { id: 1, duration_s: 0.001, ..Default::default() }),
                phase: v1::AttackPhase::Done.into(),
                active_time_us: Some(active_time_us),
                ended_time_us: Some(active_time_us + 1000),
                ..Default::default()
            };
            live.log.attacks.update(&v1::AttackState { attacks: vec![progress], ..Default::default() });
            Align::Attack.time_s(&live)
        };
        assert_eq!(attacked(2_000_000), 7.0, "its begin");
        assert_eq!(attacked(7_002_000), 7.002);
    }

    #[test]
    fn laid_together_at_take_off_the_same_flights_do_not_differ() {
        let flown = |start: u64, waits: u64| {
            let mut live = Live::recorded();
            for i in 0..100_u64 {
                live.curves.push(
                    Curve::Altitude(0),
                    start + i * 10_000,
                    if i < waits { 0.0 } else { 0.02 * (i - waits) as f64 },
                );
            }
            live
        };
        let flights = [flown(5_000_000, 20), flown(1_000_000, 50)];
        let largest = |curves: &Curves| {
            let series = curves.get(Curve::Difference(1)).unwrap();
            let extent = series.extent(series.first()..series.end());
            extent.max.max(-extent.min)
        };
        assert!(largest(&overlay(&flights, Align::TakeOff, &[], false)) < 0.1);
        assert!(largest(&overlay(&flights, Align::Begin, &[], false)) > 500.0);
    }

    #[test]
    fn flights_are_laid_together_at_a_step_or_by_hand_and_judged_by_the_largest_difference_in_view() {
        let flown = |start: u64, steps: [u64; 2]| {
            let mut live = Live::recorded();
            for i in 0..400_u64 {
                let height = steps.iter().filter(|at| i >= **at).count() as f64;
                live.curves.push(Curve::Altitude(0), start + i * 10_000, height);
            }
            for at in steps {
                let time_us = start + at * 10_000;
                live.log.step(v1::StepResponse { start_time_us: time_us, time_us, ..Default::default() });
            }
            live
        };
        // The second step comes 30 samples, 0.3 s, later in the second flight; the first one does not.
        let flights = [flown(5_000_000, [100, 200]), flown(1_000_000, [100, 230])];
        let whole = TimeAxis::new(0.0, 10.0);
        let largest = |align, shifts: &[f64], axis| {
            verdict(&overlay(&flights, align, shifts, false), 1, axis, Some(50.0)).unwrap()
        };
        assert_eq!(largest(Align::Step(1), &[], whole), (1000.0, Some(false)));
        assert_eq!(largest(Align::Step(1), &[], TimeAxis::new(0.0, 1.5)), (0.0, Some(true)), "only what is in view");
        let second = TimeAxis::new(1.6, 4.0);
        assert_eq!(largest(Align::Step(2), &[], second), (0.0, Some(true)));
        assert_eq!(largest(Align::Begin, &[0.0, -0.3], TimeAxis::new(1.6, 4.0)), (0.0, Some(true)), "by hand");
        assert_eq!(
            verdict(&overlay(&flights, Align::Begin, &[], false), 0, whole, None),
            None,
            "the first has no difference"
        );
    }

    #[test]
    fn another_signal_is_laid_together_in_its_own_unit_where_the_altitude_says() {
        let flown = |start: u64, offset: f64| {
            let mut live = Live::recorded();
            for i in 0..100_u64 {
                let climbs = if i < 50 { 0.0 } else { 1.0 };
                live.curves.push(Curve::Altitude(0), start + i * 10_000, climbs);
            }
            let samples = (0..100).map(|i| (start as f64 * 1e-6 + f64::from(i) * 0.01, f64::from(i >= 50) + offset));
            live.curves.set(Curve::Signal(0), samples, 0.1);
            live
        };
        let flights = [flown(5_000_000, 0.0), flown(1_000_000, 0.25)];
        let out = overlay(&flights, Align::TakeOff, &[], true);
        assert_eq!(out.value_at(Curve::Compared(1), 0.9), Some(1.25));
        let axis = TimeAxis::new(0.0, 1.0);
        assert_eq!(verdict(&out, 1, axis, Some(0.3)), Some((0.25, Some(true))), "not in thousandths");
        assert!(out.get(Curve::ComparedSetpoint(0)).is_none(), "the setpoint is of the altitude");
    }
}

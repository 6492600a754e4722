//! The signal browser of a recorded flight: any number that was recorded on a chart of its own, on the time axis of the
//! charts above, or its spectrum over what is in view, or between the pinned cursors. The address keeps what is shown.

use leptos::{ev, html, prelude::*};
use plumbline_rest::flight::{Samples, Signal as Recorded, Signals, Spectrum};

use super::{
    legend::{Entry, PictureButton, Swatch, TableButton},
    plot::Plot,
    residuals::EvidenceSwitch,
    sketch::{Drawing, Sketch, Trace},
};
use crate::{
    address,
    deck::{Charted, Deck, Evidence, Picture, deck, settled},
    model::{
        curves::Curve,
        format::{self, NONE},
        signals::{decibels, found, peak_hz, read, told},
    },
    net, palette,
};

/// Most signals at a time.
const MOST: usize = 6;
/// Stretches of time asked for: of a whole flight, and of what was zoomed into with as much on both sides.
const COLUMNS: usize = 1500;
/// Longer than any flight, s.
const LONGEST_S: f64 = 1e7;

/// Which recording the charts show.
#[derive(Debug, Clone, Copy)]
pub struct Recording(StoredValue<String>);

impl Recording {
    /// The flight with this id.
    pub fn new(id: String) -> Self {
        Self(StoredValue::new(id))
    }

    /// What is asked about a signal of it between two times, s since its start.
    fn url(self, what: &str, name: &str, [from_s, to_s]: [f64; 2]) -> String {
        let name = String::from(js_sys::encode_uri_component(name));
        let id = self.0.get_value();
        format!("/api/v1/flights/{id}/{what}?name={name}&from_s={:.6}&to_s={to_s:.6}", from_s.max(0.0))
    }
}

/// The name of what an address keeps.
const QUERY: &str = "signals";

/// Puts the signals that the page's address names on charts, each once.
pub fn begin(deck: Deck) {
    let named = address::all(QUERY);
    for (name, spectrum) in named.iter().flat_map(|named| read(named)).take(MOST) {
        add(deck, Recorded { name, unit: String::new() }, spectrum);
    }
    if deck.signals.with_untracked(|all| !all.is_empty()) {
        deck.evidence.set(Evidence::Signals);
    }
}

fn add(deck: Deck, signal: Recorded, spectrum: bool) {
    deck.signals.update(|all| {
        let taken = |place: &u8| all.iter().any(|c| c.place == *place);
        let place = (0..MOST as u8).find(|place| !taken(place));
        if let Some(place) = place.filter(|_| all.iter().all(|c| c.name != signal.name)) {
            all.push(Charted { place, name: signal.name, unit: signal.unit, spectrum });
        }
    });
}

/// Writes what is charted into the address.
fn keep(charted: &[Charted]) {
    let text = told(charted.iter().map(|c| (c.name.as_str(), c.spectrum)));
    address::keep(Some((QUERY, text)).filter(|(_, text)| !text.is_empty()).as_slice());
}

/// The card, in the place of the residuals.
#[component]
pub fn SignalsCard() -> impl IntoView {
    let deck = deck();
    let recording: Recording = expect_context();
    let known = RwSignal::new(None::<Result<Signals, String>>);
    leptos::task::spawn_local(async move {
        let url = format!("/api/v1/flights/{}/signals", recording.0.get_value());
        let answer = net::json::<Signals>("GET", &url, None, "").await.map_err(|failure| failure.text);
        // Units are the ground's to say; an address does not.
        let unit = |name: &str| answer.as_ref().ok()?.signals.iter().find(|s| s.name == name).map(|s| s.unit.clone());
        deck.signals.try_update(|all| all.iter_mut().for_each(|c| c.unit = unit(&c.name).unwrap_or_default()));
        known.try_set(Some(answer));
    });
    Effect::new(move |_| deck.signals.with(|all| keep(all)));
    let entries = Memo::new(move |_| deck.signals.with(|all| all.iter().map(entry).collect::<Vec<_>>()));
    deck.list("Signals", "", 4, entries.into());
    let adding = RwSignal::new(deck.signals.with_untracked(Vec::is_empty));
    let full = Memo::new(move |_| deck.signals.with(Vec::len) >= MOST);
    let start_s = Memo::new(move |_| known.with(|k| k.as_ref().and_then(|k| k.as_ref().ok()).map(|k| k.start_s)));
    view! {
        <section class="card chart residuals signals" aria-label="Signals" style=move || format!("--charted:{}", deck.signals.with(Vec::len).max(1))>
            <header>
                <h2>"Signals"</h2>
                <button
                    type="button"
                    class="small"
                    disabled=move || full.get() && !adding.get()
                    aria-expanded=move || adding.get().to_string()
                    on:click=move |_| adding.update(|on| *on = !*on)
                >{move || if adding.get() { "Close the list" } else { "Add a signal…" }}</button>
                <TableButton entries=entries name="Signals" unit="" />
                <span class="push buttons-row"><EvidenceSwitch /></span>
            </header>
            <Show when=move || adding.get()><Choice known adding /></Show>
            {move || start_s.get().map(|start_s| view! {
                <For each=move || deck.signals.get() key=|c| (c.place, c.name.clone(), c.spectrum) let:charted>
                    <One charted start_s />
                </For>
            })}
        </section>
    }
}

fn entry(charted: &Charted) -> Entry {
    Entry {
        curve: Curve::Signal(charted.place),
        name: format!("{} {}", charted.name, charted.unit).trim_end().to_owned(),
        color: palette::series(usize::from(charted.place)).css(),
        swatch: Swatch::Line,
    }
}

/// The list to choose from.
#[component]
fn Choice(known: RwSignal<Option<Result<Signals, String>>>, adding: RwSignal<bool>) -> impl IntoView {
    let deck = deck();
    let search = RwSignal::new(String::new());
    let field = NodeRef::<html::Input>::new();
    field.on_load(|field| {
        // What cannot take the focus takes none.
        let _ = field.focus();
    });
    let choose = move |signal: Recorded| {
        add(deck, signal, false);
        adding.set(false);
    };
    let first = move || {
        known.with(|k| {
            k.as_ref()?.as_ref().ok().and_then(|k| found(&k.signals, &search.get()).0.first().map(|s| (*s).clone()))
        })
    };
    let list = move || match known.get() {
        None => view! { <p class="quiet">"The ground looks what was recorded…"</p> }.into_any(),
        Some(Err(why)) => view! { <p class="bad" role="alert">{why}</p> }.into_any(),
        Some(Ok(known)) => {
            let (offered, beyond) = found(&known.signals, &search.get());
            let none = offered.is_empty();
            view! {
                <ul>
                    {offered.into_iter().cloned().map(|signal| {
                        let (name, unit) = (signal.name.clone(), signal.unit.clone());
                        view! { <li><button type="button" class="plain" on:click=move |_| choose(signal.clone())>{name} " " <small class="quiet">{unit}</small></button></li> }
                    }).collect::<Vec<_>>()}
                </ul>
                {none.then(|| view! { <p class="quiet">"No signal has all of these words in its name."</p> })}
                {(beyond > 0).then(|| view! { <p class="quiet">{format!("and {beyond} more: type a part of the name")}</p> })}
            }.into_any()
        }
    };
    view! {
        <div class="signal-choice">
            <input
                type="search"
                node_ref=field
                aria-label="Search the recorded signals"
                placeholder="gyro x, innovation height 2, motor…"
                autocomplete="off"
                prop:value=search
                on:input:target=move |e| search.set(e.target().value())
                on:keydown=move |e: ev::KeyboardEvent| match e.key().as_str() {
                    "Enter" => if let Some(signal) = untrack(first) { choose(signal) },
                    "Escape" => adding.set(false),
                    _ => {}
                }
            />
            {list}
        </div>
    }
}

/// One signal on its chart.
#[component]
fn One(charted: Charted, start_s: f64) -> impl IntoView {
    let deck = deck();
    let drawn = vec![entry(&charted)];
    let drawn = Signal::derive(move || drawn.clone());
    let Charted { place, name, unit, spectrum } = charted;
    let problem = RwSignal::new(None::<String>);
    let waits = RwSignal::new(false);
    let remove = move |_| {
        deck.signals.update(|all| all.retain(|c| c.place != place));
        deck.data.update_value(|live| live.curves.remove_signal(place));
    };
    let turn = move |_| {
        deck.signals.update(|all| {
            if let Some(charted) = all.iter_mut().find(|c| c.place == place) {
                charted.spectrum = !charted.spectrum;
            }
        })
    };
    let value = move || {
        let at = deck.reading_s();
        let value = deck.read(|live| live.curves.value_at(Curve::Signal(place), at?));
        value.map_or_else(|| NONE.to_owned(), format::figures)
    };
    let color = palette::series(usize::from(place)).css();
    let body = if spectrum {
        view! { <Density name=name.clone() unit=unit.clone() color start_s problem waits /> }.into_any()
    } else {
        follow(deck, place, name.clone(), start_s, problem, waits);
        let label = format!("{name} over time");
        view! { <Plot picture=Picture::Signal(place) unit=unit.clone() label=label /> }.into_any()
    };
    view! {
        <div class="chart-body" role="group" aria-label=name.clone()>
            <div class="chart-side">
                <h3 class="signal-name" title=name.clone()>
                    <i class="swatch" style=format!("--swatch:{color}")></i>
                    <span>{name.clone()}</span>
                    <button type="button" class="plain push" aria-label=format!("Take {name} away") on:click=remove>"×"</button>
                </h3>
                <p class="signal-value num">
                    {(!spectrum).then(|| view! { <b>{value}</b> })} " " <small class="quiet">{unit.clone()}</small>
                    {(!spectrum).then(|| view! { <PictureButton entries=drawn name=name.clone() unit picture=Picture::Signal(place) /> })}
                    <button type="button" class="small push" aria-pressed=spectrum.to_string() title="Its power over frequency, of what is in view, or between the pinned cursors" on:click=turn>"Spectrum"</button>
                </p>
                <Show when=move || waits.get()><p class="quiet">"Reading…"</p></Show>
                {move || problem.get().map(|why| view! { <p class="bad" role="alert">{why}</p> })}
            </div>
            {body}
        </div>
    }
}

/// Keeps the curve of a signal: the whole flight coarsely, and what is zoomed into finer.
fn follow(deck: Deck, place: u8, name: String, start_s: f64, problem: RwSignal<Option<String>>, waits: RwSignal<bool>) {
    let recording: Recording = expect_context();
    let fetch = async move |name: String, range: [f64; 2]| {
        let url = format!("{}&columns={COLUMNS}", recording.url("signal", &name, range));
        net::json::<Samples>("GET", &url, None, "").await
    };
    let coarse = RwSignal::new(None::<Samples>);
    let whole = name.clone();
    waits.set(true);
    leptos::task::spawn_local(async move {
        let answer = fetch(whole, [0.0, LONGEST_S]).await;
        waits.try_set(false);
        match answer {
            Ok(samples) => {
                draw(deck, place, start_s, &samples, None);
                coarse.try_set(Some(samples));
            }
            Err(failure) => drop(problem.try_set(Some(failure.text))),
        }
    });
    let asked = StoredValue::new(0_u32);
    let thinned = move || coarse.with(|known| known.as_ref().is_some_and(|k| k.samples > k.time_s.len() as u64));
    settled(
        move || thinned().then(|| deck.in_view()),
        move |span| {
            let Some([from, to]) = span.filter(|_| deck.zoom.get_untracked().is_some()) else { return };
            let number = asked.get_value() + 1;
            asked.set_value(number);
            let (name, side) = (name.clone(), to - from);
            leptos::task::spawn_local(async move {
                let fine = fetch(name, [from - side - start_s, to + side - start_s]).await;
                if let (Ok(fine), Some(Some(known)), true) =
                    (fine, coarse.try_get_untracked(), asked.try_get_value() == Some(number))
                {
                    draw(deck, place, start_s, &known, Some(&fine));
                }
            });
        },
    );
}

/// Puts samples on a chart: the finer ones in the place of the coarse ones where there are any.
fn draw(deck: Deck, place: u8, start_s: f64, coarse: &Samples, fine: Option<&Samples>) {
    let pairs =
        |samples: &Samples| samples.time_s.iter().copied().zip(samples.value.iter().copied()).collect::<Vec<_>>();
    let (outer, inner) = (pairs(coarse), fine.map(pairs).unwrap_or_default());
    let (from, to) = match (inner.first(), inner.last()) {
        (Some(first), Some(last)) => (first.0, last.0),
        _ => (f64::INFINITY, f64::INFINITY),
    };
    let length_s = outer.last().map_or(0.0, |last| last.0);
    let before = outer.iter().filter(|sample| sample.0 < from);
    let after = outer.iter().filter(|sample| sample.0 > to);
    let all = before.chain(&inner).chain(after).map(|(time_s, value)| (start_s + time_s, *value));
    deck.data.try_update_value(|live| live.curves.set_signal(place, all, 4.0 * length_s / COLUMNS as f64));
}

/// The spectrum of a signal.
#[component]
fn Density(
    name: String,
    unit: String,
    color: &'static str,
    start_s: f64,
    problem: RwSignal<Option<String>>,
    waits: RwSignal<bool>,
) -> impl IntoView {
    let deck = deck();
    let recording: Recording = expect_context();
    let found = RwSignal::new(None::<Spectrum>);
    let asked = StoredValue::new(0_u32);
    let label = format!("Spectrum of {name}");
    let span = move || deck.pins.get().map_or_else(|| deck.in_view(), |[a, b]| [a.min(b), a.max(b)]);
    settled(span, move |range| {
        let number = asked.get_value() + 1;
        asked.set_value(number);
        waits.set(true);
        let url = recording.url("spectrum", &name, range.map(|s| s - start_s));
        leptos::task::spawn_local(async move {
            let answer = net::json::<Spectrum>("GET", &url, None, "").await;
            if asked.try_get_value() != Some(number) {
                return;
            }
            waits.try_set(false);
            problem.try_set(answer.as_ref().err().map(|failure| failure.text.clone()));
            found.try_set(answer.ok());
        });
    });
    let node = NodeRef::<html::Div>::new();
    let size = RwSignal::new(None::<[f64; 2]>);
    Effect::new(move |_| {
        if let Some(node) = node.get() {
            let place = node.get_bounding_client_rect();
            size.set(Some([place.width().max(200.0), place.height().max(60.0)]));
        }
    });
    let of = if unit.is_empty() { "1".to_owned() } else { format!("({unit})²") };
    let drawing =
        Signal::derive(move || found.with(|f| f.as_ref().map(|f| picture(f, &of, color)).unwrap_or_default()));
    let told = move || {
        let between = if deck.pins.with(Option::is_some) { "between the cursors" } else { "in view" };
        found.with(|f| {
            f.as_ref().map(|f| {
                let peak = peak_hz(f).map_or_else(String::new, |hz| format!("peak {} Hz; ", format::figures(hz)));
                let rotors = f.rotor_hz.map_or_else(String::new, |hz| {
                    format!(
                        "; dashed: rotors, {} Hz, 1 to {} times, folded at {} Hz",
                        format::figures(hz),
                        f.harmonics_hz.len(),
                        format::figures(f.rate_hz / 2.0)
                    )
                });
                format!("{peak}{between}, mean of {}{rotors}", format::plural(f.windows, "window"))
            })
        })
    };
    view! {
        <div class="density">
            <p class="quiet num" title=told>{told}</p>
            <div class="density-plot" node_ref=node>
                {move || size.get().map(|size| view! { <Sketch label=label.clone() drawing size /> })}
            </div>
        </div>
    }
}

/// Density over frequency, with a dashed line at each multiple of the rotors' speed.
fn picture(spectrum: &Spectrum, of: &str, color: &'static str) -> Drawing {
    let points = decibels(spectrum);
    let (low, high) =
        points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[1]), high.max(p[1])));
    let rotor = |hz: &f64| Trace { points: vec![[*hz, low], [*hz, high]], color: palette::TRUTH.css(), dashed: true };
    let mut traces: Vec<Trace> = spectrum.harmonics_hz.iter().map(rotor).collect();
    traces.push(Trace { points, color, dashed: false });
    Drawing {
        traces,
        least: [1.0, 3.0],
        fixed: [Some([0.0, spectrum.rate_hz / 2.0]), None],
        units: ["Hz".into(), format!("dB of {of}/Hz")],
        ..Drawing::default()
    }
}

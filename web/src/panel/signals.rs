//! The signal browser: any number of any topic on a chart of its own, on the time axis of the charts above, or its spectrum
//! over what is in view, or between the pinned cursors, beside that of a stretch that was kept. Of a recorded flight, and of
//! a vehicle while it flies.

use std::time::Duration;

use leptos::{ev, html, prelude::*};
use plumbline_rest::flight::{Samples, Signal as Named, Signals, Spectrum};

use super::{
    legend::{Entry, PictureButton, TableButton},
    plot::Plot,
    residuals::EvidenceSwitch,
    sketch::{Drawing, Sketch, Trace},
    waiting::Waiting,
};
use crate::{
    app::App,
    ctx::every,
    deck::{Charted, Deck, MOST_SIGNALS, Picture, Source, deck, settled},
    event::Failure,
    model::{
        curves::Curve,
        format::{self, NONE},
        signals::{decibels, found, peak_hz},
    },
    net, palette,
};

/// Stretches of time asked for: of a whole flight, and of what was zoomed into with as much on both sides.
const COLUMNS: usize = 1500;
/// Longer than any flight, s.
const LONGEST_S: f64 = 1e7;
/// While a vehicle flies what came since is asked for this often, and so much of the past at first, s: what its ground keeps.
const EVERY: Duration = Duration::from_millis(250);
const KEPT_S: f64 = 120.0;
/// Stretches of time in each second of it: two samples of each, at most.
const LIVE_COLUMNS: f64 = 100.0;
/// A spectrum of what moves is found anew every so many beats of the page.
const BEATS: u64 = 10;

/// Whose messages the charts show.
#[derive(Clone, Copy)]
pub enum Messages {
    /// Those of the recorded flight with this id.
    Flight(StoredValue<String>),
    /// Those that the vehicle shown sends.
    Vehicle(StoredValue<App, LocalStorage>),
}

impl Messages {
    /// Those of a recorded flight.
    pub fn of_flight(id: String) -> Self {
        Self::Flight(StoredValue::new(id))
    }

    /// Where one is asked about them; `None` while no vehicle is chosen.
    fn base(self) -> Option<String> {
        match self {
            Self::Flight(id) => Some(format!("/api/v1/flights/{}", id.try_get_value()?)),
            Self::Vehicle(app) => {
                let id = app.try_with_value(|app| app.vehicle.clone())??;
                Some(format!("/api/v1/vehicles/{}", js_sys::encode_uri_component(&id)))
            }
        }
    }

    /// Asks something about a signal between two times, s since the start of the flight, or since the vehicle's boot.
    async fn ask<T: serde::de::DeserializeOwned>(
        base: Option<String>,
        what: &str,
        name: &str,
        [from_s, to_s]: [f64; 2],
        rest: &str,
    ) -> Result<T, Failure> {
        let name = String::from(js_sys::encode_uri_component(name));
        let base = base.ok_or_else(net::unreachable_ground)?;
        let url = format!("{base}/{what}?name={name}&from_s={:.6}&to_s={to_s:.6}{rest}", from_s.max(0.0));
        net::json("GET", &url, None, "").await
    }
}

fn add(deck: Deck, signal: Named) {
    deck.signals.update(|all| {
        let taken = |place: &u8| all.iter().any(|c| c.place == *place);
        let place = (0..MOST_SIGNALS).find(|place| !taken(place));
        if let Some(place) = place.filter(|_| all.iter().all(|c| c.name != signal.name)) {
            all.push(Charted { place, name: signal.name, unit: signal.unit, spectrum: false });
        }
    });
}

/// What there is to choose from.
#[derive(Clone, Copy)]
struct Offer {
    messages: Messages,
    known: RwSignal<Option<Result<Signals, String>>>,
    /// That which is being dragged.
    dragged: RwSignal<Option<Named>>,
}

impl Offer {
    fn new(messages: Messages) -> Self {
        Self { messages, known: RwSignal::new(None), dragged: RwSignal::new(None) }
    }

    /// Asks for it, again: what a vehicle sends changes.
    fn ask(self, deck: Deck) {
        let base = self.messages.base();
        leptos::task::spawn_local(async move {
            let answer = match base {
                Some(base) => net::json::<Signals>("GET", &format!("{base}/signals"), None, "").await,
                None => Err(Failure { status: 0, text: "no vehicle is connected".to_owned() }),
            };
            let answer = answer.map_err(|failure| failure.text);
            // Units are the ground's to say; an address does not.
            let unit =
                |name: &str| answer.as_ref().ok()?.signals.iter().find(|s| s.name == name).map(|s| s.unit.clone());
            let told = |c: &Charted| unit(&c.name).filter(|unit| *unit != c.unit);
            if deck.signals.try_with_untracked(|all| all.iter().any(|c| told(c).is_some())) == Some(true) {
                deck.signals
                    .update(|all| all.iter_mut().for_each(|c| c.unit = told(c).unwrap_or_else(|| c.unit.clone())));
            }
            self.known.try_set(Some(answer));
        });
    }

    /// Flight time that answers count from, s; `None` before it is known.
    fn start_s(self) -> Option<f64> {
        match self.messages {
            Messages::Flight(_) => self.known.with(|k| k.as_ref()?.as_ref().ok().map(|k| k.start_s)),
            Messages::Vehicle(_) => Some(0.0),
        }
    }
}

/// The card, in the place of the residuals.
#[component]
pub fn SignalsCard() -> impl IntoView {
    let deck = deck();
    let offer = Offer::new(expect_context());
    offer.ask(deck);
    let entries = Memo::new(move |_| deck.signals.with(|all| all.iter().map(entry).collect::<Vec<_>>()));
    deck.list("Signals", "", 4, entries.into());
    let adding = RwSignal::new(deck.signals.with_untracked(Vec::is_empty));
    let full = Memo::new(move |_| deck.signals.with(Vec::len) >= usize::from(MOST_SIGNALS));
    let start_s = Memo::new(move |_| offer.start_s());
    let drop = move |e: ev::DragEvent| {
        if let Some(signal) = offer.dragged.get_untracked() {
            e.prevent_default();
            add(deck, signal);
            offer.dragged.set(None);
        }
    };
    view! {
        <section
            class="card chart residuals signals"
            aria-label="Signals"
            style=move || format!("--charted:{}", deck.signals.with(Vec::len).max(1))
            on:dragover=move |e| if offer.dragged.with_untracked(Option::is_some) && !full.get_untracked() { e.prevent_default() }
            on:drop=drop
        >
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
            <Show when=move || adding.get()><Choice offer adding /></Show>
            {move || start_s.get().map(|start_s| view! {
                <For each=move || deck.signals.get() key=|c| (c.place, c.name.clone(), c.unit.clone(), c.spectrum) let:charted>
                    <One charted start_s />
                </For>
            })}
            <Show when=move || offer.dragged.with(Option::is_some)>
                <p class="drop-plot">{move || if full.get() { "No room: take a plot away first" } else { "Drop it here: a plot of its own" }}</p>
            </Show>
        </section>
    }
}

fn entry(charted: &Charted) -> Entry {
    Entry::new(Curve::Signal(charted.place), format!("{} {}", charted.name, charted.unit).trim_end(), 0)
}

/// The list to choose from: by a click or Enter, or dragged onto the charts.
#[component]
fn Choice(offer: Offer, adding: RwSignal<bool>) -> impl IntoView {
    let deck = deck();
    let search = RwSignal::new(String::new());
    let field = NodeRef::<html::Input>::new();
    field.on_load(|field| {
        // What cannot take the focus takes none.
        let _ = field.focus();
    });
    if deck.source == Source::Live && offer.known.with_untracked(Option::is_some) {
        offer.ask(deck);
    }
    let choose = move |signal: Named| {
        add(deck, signal);
        adding.set(false);
    };
    let first = move || {
        offer.known.with(|k| {
            k.as_ref()?.as_ref().ok().and_then(|k| found(&k.signals, &search.get()).0.first().map(|s| (*s).clone()))
        })
    };
    let one = move |signal: Named| {
        let (name, unit) = (signal.name.clone(), signal.unit.clone());
        let (clicked, dragged) = (signal.clone(), signal);
        let begin = move |e: ev::DragEvent| {
            if let Some(held) = e.data_transfer() {
                // Some browsers drag nothing that holds nothing.
                let _ = held.set_data("text/plain", &dragged.name);
                held.set_effect_allowed("copy");
            }
            offer.dragged.set(Some(dragged.clone()));
        };
        view! {
            <li draggable="true" on:dragstart=begin on:dragend=move |_| offer.dragged.set(None)>
                <button type="button" class="plain" title="A click or Enter: on a plot of its own; or drag it there" on:click=move |_| choose(clicked.clone())>{name} " " <small class="quiet">{unit}</small></button>
            </li>
        }
    };
    let list = move || match offer.known.get() {
        None => view! { <Waiting text="The ground looks what there is…" /> }.into_any(),
        Some(Err(why)) => view! { <p class="bad" role="alert">{why}</p> }.into_any(),
        Some(Ok(known)) => {
            let (offered, beyond) = found(&known.signals, &search.get());
            let none = offered.is_empty();
            view! {
                <ul>{offered.into_iter().cloned().map(one).collect::<Vec<_>>()}</ul>
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
                aria-label="Search the signals"
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

/// What is being read of a signal, and why it could not be.
#[derive(Clone, Copy)]
struct Progress {
    problem: RwSignal<Option<String>>,
    waits: RwSignal<bool>,
}

/// One signal on its chart.
#[component]
fn One(charted: Charted, start_s: f64) -> impl IntoView {
    let deck = deck();
    let drawn = vec![entry(&charted)];
    let drawn = Signal::derive(move || drawn.clone());
    let Charted { place, name, unit, spectrum } = charted;
    let progress = Progress { problem: RwSignal::new(None), waits: RwSignal::new(false) };
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
    let value = move || deck.value(Curve::Signal(place)).map_or_else(|| NONE.to_owned(), format::figures);
    let color = palette::series(usize::from(place)).ink.css();
    let body = if spectrum {
        view! { <Density name=name.clone() unit=unit.clone() color start_s progress /> }.into_any()
    } else {
        match deck.source {
            Source::Recorded => follow(deck, place, name.clone(), start_s, progress),
            Source::Live => listen(deck, place, name.clone(), progress),
        }
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
                    {spectrum.then(|| view! { <KeepButton /> })}
                    <button type="button" class="small push" aria-pressed=spectrum.to_string() title="Its power over frequency, of what is in view, or between the pinned cursors" on:click=turn>"Spectrum"</button>
                </p>
                <Show when=move || progress.waits.get()><Waiting text="Reading…" /></Show>
                {move || progress.problem.get().map(|why| view! { <p class="bad" role="alert">{why}</p> })}
            </div>
            {body}
        </div>
    }
}

/// Keeps the stretch whose spectra are shown, for those of the next one to be laid over.
#[component]
fn KeepButton() -> impl IntoView {
    let deck = deck();
    view! {
        <button
            type="button"
            class="small"
            aria-pressed=move || deck.kept.get().is_some().to_string()
            title="Keeps the spectrum of this stretch (A): then look at another one (B), and both lie over each other"
            on:click=move |_| {
                let span = untrack(|| looked_at(deck));
                deck.kept.update(|kept| *kept = if kept.is_some() { None } else { Some(span) });
            }
        >"Keep"</button>
    }
}

/// The stretch whose spectra are shown: between the pinned cursors, else what is in view.
fn looked_at(deck: Deck) -> [f64; 2] {
    deck.pins.get().map_or_else(|| deck.in_view(), |[a, b]| [a.min(b), a.max(b)])
}

/// Appends what the vehicle sends of a signal to its curve, as it comes.
fn listen(deck: Deck, place: u8, name: String, Progress { problem, waits }: Progress) {
    let messages: Messages = expect_context();
    let curve = Curve::Signal(place);
    let busy = StoredValue::new(false);
    waits.set(true);
    let ask = move || {
        if busy.get_value() {
            return;
        }
        busy.set_value(true);
        let now_s = deck.data.with_value(|live| live.edge_us(net::now_ms()) * 1e-6);
        let last_s = deck.data.with_value(|live| live.curves.get(curve).and_then(|series| Some(series.last()?.0)));
        let from_s = last_s.map_or(now_s - KEPT_S, |last_s| last_s + 1e-6).max(now_s - KEPT_S);
        let columns = ((now_s - from_s) * LIVE_COLUMNS).clamp(1.0, COLUMNS as f64).ceil();
        let (base, boot, name) = (messages.base(), deck.data.with_value(|live| live.boot()), name.clone());
        leptos::task::spawn_local(async move {
            let range = [from_s, LONGEST_S];
            let answer =
                Messages::ask::<Samples>(base, "signal", &name, range, &format!("&columns={columns:.0}")).await;
            busy.try_set_value(false);
            // Taken away meanwhile, or the vehicle began again.
            let ours = deck.signals.try_with_untracked(|all| all.iter().any(|c| c.place == place && c.name == name));
            if ours != Some(true) || deck.data.try_with_value(|live| live.boot()) != Some(boot) {
                return;
            }
            waits.try_set(false);
            match answer {
                Ok(samples) => {
                    problem.try_set(None);
                    let pairs = samples.time_s.into_iter().zip(samples.value);
                    deck.data.try_update_value(|live| live.curves.extend_signal(place, pairs));
                }
                Err(failure) => drop(problem.try_set(Some(failure.text))),
            }
        });
    };
    ask();
    every(EVERY, ask);
}

/// Keeps the curve of a signal: the whole flight coarsely, and what is zoomed into finer.
fn follow(deck: Deck, place: u8, name: String, start_s: f64, Progress { problem, waits }: Progress) {
    let messages: Messages = expect_context();
    let fetch = async move |name: String, range: [f64; 2]| {
        Messages::ask::<Samples>(messages.base(), "signal", &name, range, &format!("&columns={COLUMNS}")).await
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
    deck.data.try_update_value(|live| live.curves.set(Curve::Signal(place), all, 4.0 * length_s / COLUMNS as f64));
}

/// A spectrum, found again when `span` has changed and stands still; none where that is `None` or ends before anything was
/// sent. One is asked for at a time: of what moves no answer would ever come in time.
fn spectrum_of(
    name: String,
    start_s: f64,
    span: impl Fn() -> Option<[f64; 2]> + Send + Sync + 'static,
    Progress { problem, waits }: Progress,
) -> RwSignal<Option<Spectrum>> {
    let messages: Messages = expect_context();
    let found = RwSignal::new(None::<Spectrum>);
    let wanted = StoredValue::new(None::<[f64; 2]>);
    let busy = StoredValue::new(false);
    let span = move || span().filter(|[_, to_s]| *to_s > start_s);
    settled(span, move |range| {
        wanted.set_value(range);
        if range.is_none() {
            found.set(None);
        }
        if range.is_none() || busy.get_value() {
            return;
        }
        busy.set_value(true);
        waits.set(true);
        let (base, name) = (messages.base(), name.clone());
        leptos::task::spawn_local(async move {
            while let Some(Some(range)) = wanted.try_update_value(Option::take) {
                let range = range.map(|s| s - start_s);
                let answer = Messages::ask::<Spectrum>(base.clone(), "spectrum", &name, range, "").await;
                problem.try_set(answer.as_ref().err().map(|failure| failure.text.clone()));
                found.try_set(answer.ok());
            }
            busy.try_set_value(false);
            waits.try_set(false);
        });
    });
    found
}

/// The spectrum of a signal: of what is looked at, over that of the stretch that was kept.
#[component]
fn Density(name: String, unit: String, color: &'static str, start_s: f64, progress: Progress) -> impl IntoView {
    let deck = deck();
    let label = format!("Spectrum of {name}");
    let round = Memo::new(move |_| if deck.source == Source::Live { deck.beat() / BEATS } else { 0 });
    let moves = move || deck.paused_at.get().is_none() && deck.zoom.get().is_none();
    let span = move || {
        if moves() {
            round.get();
        }
        Some(looked_at(deck))
    };
    let found = spectrum_of(name.clone(), start_s, span, progress);
    let kept = spectrum_of(name, start_s, move || deck.kept.get(), progress);
    let of = if unit.is_empty() { "1".to_owned() } else { format!("({unit})²") };
    let drawing = Signal::derive(move || {
        found.with(|found| {
            kept.with(|kept| found.as_ref().map(|found| picture(found, kept.as_ref(), &of, color)).unwrap_or_default())
        })
    });
    let known = Memo::new(move |_| found.with(Option::is_some));
    let unit = StoredValue::new(unit);
    let told = move || {
        let between = if deck.pins.with(Option::is_some) { "between the cursors" } else { "in view" };
        let begun = if deck.kept.with(Option::is_some) { "B: " } else { "" };
        let words = unit.with_value(|unit| found.with(|f| f.as_ref().map(|f| described(f, unit, between))));
        words.map(|words| format!("{begun}{words}"))
    };
    let told_kept = move || {
        let [from_s, to_s] = deck.kept.get()?;
        let begin_s = deck.data.with_value(|live| deck.begin_s(live));
        let span = format!("{:.1} to {:.1} s", from_s - begin_s, to_s - begin_s);
        let words = unit.with_value(|unit| kept.with(|k| k.as_ref().map(|k| described(k, unit, &span))))?;
        let times = found.with(|f| kept.with(|k| Some(f.as_ref()?.rms / k.as_ref()?.rms)))?;
        Some(format!("A: {words}; B has {} times its RMS", format::figures(times)))
    };
    view! {
        <div class="density">
            <p class="quiet num" title=told>{told}</p>
            <Show when=move || deck.kept.get().is_some()>
                <p class="quiet num kept" title=told_kept><i class="swatch" style=format!("--swatch:{}", palette::SETPOINT.css())></i>{told_kept}</p>
            </Show>
            <div class="density-plot">{move || known.get().then(|| view! { <Sketch label=label.clone() drawing /> })}</div>
        </div>
    }
}

/// A spectrum in words.
fn described(spectrum: &Spectrum, unit: &str, span: &str) -> String {
    let rms = format!("RMS {} {unit}", format::figures(spectrum.rms));
    let peak = peak_hz(spectrum).map_or_else(String::new, |hz| format!("; peak {} Hz", format::figures(hz)));
    let rotors = spectrum.rotor_hz.map_or_else(String::new, |hz| {
        format!(
            "; dashed: rotors, {} Hz, 1 to {} times, folded at {} Hz",
            format::figures(hz),
            spectrum.harmonics_hz.len(),
            format::figures(spectrum.rate_hz / 2.0)
        )
    });
    format!("{}{peak}; {span}, mean of {}{rotors}", rms.trim_end(), format::plural(spectrum.windows, "window"))
}

/// Density over frequency, with a dashed line at each multiple of the rotors' speed; that which was kept lies below.
fn picture(spectrum: &Spectrum, kept: Option<&Spectrum>, of: &str, color: &'static str) -> Drawing {
    let both = || kept.into_iter().chain([spectrum]);
    let (low, high) = both()
        .flat_map(decibels)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[1]), high.max(p[1])));
    let rotor = |hz: &f64, color| Trace { points: vec![[*hz, low], [*hz, high]], color, dashed: true };
    let curve = |spectrum: &Spectrum, color| Trace { points: decibels(spectrum), color, dashed: false };
    let mut traces: Vec<Trace> = Vec::new();
    if let Some(kept) = kept {
        traces.extend(kept.harmonics_hz.iter().map(|hz| rotor(hz, palette::SETPOINT.css())));
        traces.push(curve(kept, palette::SETPOINT.css()));
    }
    traces.extend(spectrum.harmonics_hz.iter().map(|hz| rotor(hz, palette::TRUTH.css())));
    traces.push(curve(spectrum, color));
    Drawing {
        traces,
        least: [1.0, 3.0],
        fixed: [Some([0.0, spectrum.rate_hz / 2.0]), None],
        units: ["Hz".into(), format!("dB of {of}/Hz")],
        ..Drawing::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_stretches_share_a_picture_with_the_rotors_of_each() {
        let of = |hz: f64, density: f64| Spectrum {
            rate_hz: 200.0,
            windows: 4,
            frequency_hz: vec![0.0, 50.0, 100.0],
            density: vec![1.0, density, 0.1],
            rms: density.sqrt(),
            rotor_hz: Some(hz),
            harmonics_hz: vec![hz, 2.0 * hz],
            ..Spectrum::default()
        };
        let (now, kept) = (of(40.0, 10.0), of(30.0, 1000.0));
        let drawn = picture(&now, Some(&kept), "1", "var(--in-loop)");
        assert_eq!(drawn.traces.iter().filter(|t| t.dashed).count(), 4);
        let last = drawn.traces.last().unwrap();
        assert_eq!((last.color, last.points[0]), ("var(--in-loop)", [50.0, 10.0]), "what is looked at lies on top");
        assert_eq!(drawn.traces[0].points, [[30.0, -10.0], [30.0, 30.0]], "marks span both");
        assert_eq!(picture(&now, None, "1", "var(--in-loop)").traces.len(), 3);
        assert_eq!(
            described(&kept, "m/s²", "3.0 to 9.0 s"),
            "RMS 31.62 m/s²; peak 50.00 Hz; 3.0 to 9.0 s, mean of 4 windows; dashed: rotors, 30.00 Hz, 1 to 2 times, folded at 100.0 Hz"
        );
    }
}

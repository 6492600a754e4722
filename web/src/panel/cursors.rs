//! Two pinned cursors: the time between them, and what each curve of a chart does in it. The card stands beside the
//! charts, never on one.

use leptos::prelude::*;

use crate::{
    deck::{Deck, Listed, PIN_NAMES, deck},
    model::{
        format::{self, NONE},
        measure::{Measure, measure},
    },
    palette::Stroke,
};

/// Means are taken anew every so many beats of the page.
const BEATS: u64 = 5;

/// The button that pins the cursors.
#[component]
pub fn PinButton() -> impl IntoView {
    let deck = deck();
    view! {
        <button
            type="button"
            class="small"
            aria-pressed=move || deck.pins.get().is_some().to_string()
            title="Two cursors that stay: a click on a chart moves the nearer one (M)"
            on:click=move |_| deck.toggle_pins()
        >"Cursors"</button>
    }
}

/// A curve between the cursors.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    name: String,
    stroke: Stroke,
    found: Option<Measure>,
}

fn rows(deck: Deck, listed: &Listed, [a, b]: [f64; 2]) -> Vec<Row> {
    let entries = listed.entries.get();
    deck.data.with_value(|live| {
        let row = |e: crate::panel::legend::Entry| {
            let series = live.curves.get(e.curve)?;
            let found = measure(series, a, b).filter(|_| live.curves.is_whole(e.curve, a, b));
            Some(Row { name: e.name, stroke: e.stroke, found })
        };
        entries.into_iter().filter(|e| deck.shows(live, e.curve)).filter_map(row).collect()
    })
}

/// The card; nothing while no cursor is pinned.
#[component]
pub fn CursorsCard() -> impl IntoView {
    let deck = deck();
    let pinned = Memo::new(move |_| deck.pins.get().is_some());
    view! { <Show when=move || pinned.get()><Card deck /></Show> }
}

#[component]
fn Card(deck: Deck) -> impl IntoView {
    let chosen = RwSignal::new("Altitude");
    let refusal = RwSignal::new(None::<String>);
    // Another chart may have gone meanwhile.
    let listed = move || deck.listed.with(|all| all.iter().find(|l| l.name == chosen.get()).or(all.first()).cloned());
    let begin_s = move || deck.data.with_value(|live| deck.begin_s(live));
    let beat = Memo::new(move |_| deck.beat() / BEATS);
    let found = Memo::new(move |_| {
        beat.get();
        let pins = deck.pins.get()?;
        listed().map(|listed| (rows(deck, &listed, pins), listed.unit, listed.decimals))
    });
    let set = move |which: usize, text: String| match format::parse_number(&text) {
        Ok(seconds) => {
            refusal.set(None);
            deck.pins.update(|pins| {
                if let Some(pin) = pins.as_mut().and_then(|pins| pins.get_mut(which)) {
                    *pin = begin_s() + seconds;
                }
            });
        }
        Err(why) => refusal.set(Some(format!("{}: {why}", PIN_NAMES[which]))),
    };
    let at = move |which: usize| deck.pins.get().map_or(f64::NAN, |pins| pins[which]) - begin_s();
    let between = move || deck.pins.get().map_or(f64::NAN, |[a, b]| b - a);
    view! {
        <section class="card cursors" aria-label="Cursors">
            <header>
                <h2>"Cursors"</h2>
                <button type="button" class="plain push" aria-label="Take the cursors away" on:click=move |_| deck.pins.set(None)>"×"</button>
            </header>
            <div class="cursor-times">
                {[0, 1].map(|which| view! {
                    <label class="field"><span>{PIN_NAMES[which]} " " <small>"s"</small></span>
                        <input
                            type="text" inputmode="decimal" autocomplete="off"
                            aria-label=format!("Time of cursor {}, in seconds of the flight", PIN_NAMES[which])
                            prop:value=move || format::fixed(at(which), 3)
                            on:change:target=move |e| set(which, e.target().value())
                        />
                    </label>
                }).collect_view()}
                <div class="field"><span>"Δt " <small>"s"</small></span><output class="num" aria-label="Time between the cursors">{move || format::signed(between(), 3)}</output></div>
            </div>
            <p class="bad" role="alert">{move || refusal.get()}</p>
            <select class="small" aria-label="Chart whose curves are measured" on:change:target=move |e| {
                let name = e.target().value();
                if let Some(listed) = deck.listed.with_untracked(|all| all.iter().find(|l| l.name == name).cloned()) {
                    chosen.set(listed.name);
                }
            }>
                {move || deck.listed.get().into_iter().map(|l| view! {
                    <option selected=move || chosen.get() == l.name>{l.name}</option>
                }).collect_view()}
            </select>
            <div class="cursor-table" tabindex="0" role="group" aria-label="Between the cursors">
                <table class="dense">
                    <thead><tr><th class="num" title="Value at B minus value at A">"Δ"</th><th class="num">"mean"</th><th class="num">"RMS"</th><th class="num" title="Straight line of least squares">"slope /s"</th></tr></thead>
                    {move || found.get().map(|(rows, unit, decimals)| rows.into_iter().map(|row| {
                        let text = move |value: fn(&Measure) -> f64, signed: bool| {
                            let value = row.found.as_ref().map(value).filter(|v| v.is_finite());
                            value.map_or_else(|| NONE.to_owned(), |v| if signed { format::signed(v, decimals + 1) } else { format::fixed(v, decimals + 1) })
                        };
                        view! {
                            <tbody>
                                <tr><th colspan="4" scope="rowgroup"><i class=row.stroke.class() style=row.stroke.style()></i>{row.name.clone()} " " <small>{unit}</small></th></tr>
                                <tr>
                                    <td class="num">{text(Measure::change, true)}</td>
                                    <td class="num">{text(|m| m.mean, false)}</td>
                                    <td class="num">{text(|m| m.rms, false)}</td>
                                    <td class="num">{text(|m| m.slope_per_s, true)}</td>
                                </tr>
                            </tbody>
                        }
                    }).collect_view())}
                </table>
            </div>
        </section>
    }
}

//! A chart's legend, which is also its read-out: swatch, name, value under the cursor or newest. What the chart shows
//! can be taken along as a table.

use leptos::prelude::*;

use crate::{
    deck::{Deck, Picture, deck},
    model::{
        axis::ValueAxis,
        csv::csv,
        curves::{Curve, Group},
        figure::{self, Figure},
        format,
        measure::rms,
        series::Extent,
    },
    net,
    palette::{self, Stroke},
};

/// A mean over the window is taken anew every so many beats of the page.
const BEATS: u64 = 5;

/// One entry.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The curve.
    pub curve: Curve,
    /// Its name.
    pub name: String,
    /// Its colour and dash.
    pub stroke: Stroke,
}

impl Entry {
    /// Of a curve that is drawn as it is everywhere.
    pub fn new(curve: Curve, name: impl Into<String>, in_loop: u16) -> Self {
        Self { curve, name: name.into(), stroke: palette::stroke(curve, in_loop) }
    }
}

/// A line of a legend.
#[derive(Debug, Clone, PartialEq)]
enum Line {
    Curve(Entry),
    /// Curves folded together: how many.
    Group(Group, usize),
}

/// Curves of their own first, each group after its name and only while it is unfolded.
fn lines(deck: Deck, entries: Vec<Entry>) -> Vec<Line> {
    deck.read(|live| {
        let in_loop = live.in_loop();
        let present: Vec<_> = entries.into_iter().filter(|e| live.curves.get(e.curve).is_some()).collect();
        let of = |group: Option<Group>| present.iter().filter(move |e| e.curve.group(in_loop) == group);
        let mut lines: Vec<_> = of(None).cloned().map(Line::Curve).collect();
        for group in Group::ALL {
            let count = of(Some(group)).count();
            if count > 0 {
                lines.push(Line::Group(group, count));
                let shown = of(Some(group)).filter(|e| !deck.folds(live, e.curve));
                lines.extend(shown.cloned().map(Line::Curve));
            }
        }
        lines
    })
}

/// The legend of some curves, beside their plot.
#[component]
pub fn Legend(
    /// Entries; those whose curve has no sample are left out.
    #[prop(into)]
    entries: Signal<Vec<Entry>>,
    /// Name of the chart.
    name: &'static str,
    /// Unit of the values.
    unit: &'static str,
    /// Decimals of the values.
    decimals: usize,
    /// The root mean square over the window, instead of the newest value?
    #[prop(default = false)]
    errors: bool,
    /// The chart, where nothing else offers its picture.
    #[prop(optional)]
    picture: Option<Picture>,
) -> impl IntoView {
    let deck = deck();
    deck.list(name, unit, decimals, entries);
    let beat = Memo::new(move |_| if errors { deck.beat() / BEATS } else { 0 });
    let present = Memo::new(move |_| lines(deck, entries.get()));
    let value = move |curve: Curve| {
        if errors {
            beat.get();
            return error_text(deck, curve, decimals);
        }
        format::maybe(deck.value(curve), decimals)
    };
    let old = move |curve: Curve| {
        !errors && deck.reading_s().is_none() && deck.read(|live| live.has_ended(curve, net::now_ms()))
    };
    let curves = move || entries.with_untracked(|all| all.iter().map(|e| e.curve).collect::<Vec<_>>());
    let of_curve = move |entry: Entry| {
        let hidden = move || deck.hidden.with(|hidden| hidden.contains(&entry.curve));
        view! {
            <li class:hidden=hidden>
                <button
                    type="button"
                    class="plain"
                    aria-pressed=move || (!hidden()).to_string()
                    title="Show or hide this curve; Alt and a click, or a double-click: this one alone, or all again"
                    on:click=move |e| if e.alt_key() {
                        deck.solo_curve(entry.curve, &curves());
                    } else {
                        deck.toggle_curve(entry.curve);
                    }
                    on:dblclick=move |_| deck.solo_curve(entry.curve, &curves())
                    on:pointerenter=move |_| deck.lit.set(Some(entry.curve))
                    on:pointerleave=move |_| deck.lit.set(None)
                    on:focus=move |_| deck.lit.set(Some(entry.curve))
                    on:blur=move |_| deck.lit.set(None)
                >
                    <span
                        class=entry.stroke.class()
                        class:thin=matches!(entry.curve, Curve::Height(_) | Curve::Reach(_))
                        style=entry.stroke.style()
                        aria-hidden="true"
                    ></span>
                    <span class="legend-name" title=entry.name.clone()>{entry.name.clone()}</span>
                </button>
                <span class="value num" class:stale=move || old(entry.curve)>{move || value(entry.curve)}</span>
            </li>
        }
    };
    let of_group = move |group: Group, count: usize| {
        let unfolded = move || deck.unfolded.with(|unfolded| unfolded.contains(&group));
        view! {
            <li class="group">
                <button
                    type="button"
                    class="plain"
                    aria-expanded=move || unfolded().to_string()
                    title="Show or hide these curves"
                    on:click=move |_| deck.toggle_group(group)
                >
                    <span aria-hidden="true">{move || if unfolded() { "▾" } else { "▸" }}</span>
                    <span class="legend-name">{format!("{count} {}", group.name())}</span>
                </button>
            </li>
        }
    };
    view! {
        <ul class="legend">
            <For
                each=move || present.get()
                key=|line| match line {
                    Line::Curve(e) => (Some((e.curve, e.stroke.class(), e.stroke.ink.css())), None, 0),
                    Line::Group(group, count) => (None, Some(*group), *count),
                }
                let:line
            >
                {match line {
                    Line::Curve(entry) => of_curve(entry).into_any(),
                    Line::Group(group, count) => of_group(group, count).into_any(),
                }}
            </For>
            {picture.map(|picture| view! { <li><PictureButton entries name unit picture /></li> })}
        </ul>
    }
}

/// Keeps what a chart shows: as a picture, as a table.
#[component]
pub fn TableButton(
    /// Curves of the chart.
    #[prop(into)]
    entries: Signal<Vec<Entry>>,
    /// Name of the chart.
    name: &'static str,
    /// Unit of the values.
    unit: &'static str,
    /// The chart, where it is one and not several.
    #[prop(optional)]
    picture: Option<Picture>,
) -> impl IntoView {
    let deck = deck();
    view! {
        <span class="table-buttons">
            {picture.map(|picture| view! { <PictureButton entries name unit picture /> })}
            <button
                type="button"
                class="small plain"
                aria-label=format!("{name}: what is visible as CSV")
                title="What is visible, as a table (CSV); of a long flight every sample where it is zoomed into, else the least and the greatest of each pixel"
                on:click=move |_| save(deck, name, unit, &entries.get_untracked())
            >"CSV"</button>
        </span>
    }
}

/// Keeps what a chart shows as a picture.
#[component]
pub fn PictureButton(
    /// Curves of the chart.
    #[prop(into)]
    entries: Signal<Vec<Entry>>,
    /// Name of the chart.
    #[prop(into)]
    name: String,
    /// Unit of the values.
    #[prop(into)]
    unit: String,
    /// The chart.
    picture: Picture,
) -> impl IntoView {
    let deck = deck();
    let file = name.to_lowercase().replace(' ', "-");
    let label = |form: &str| format!("{name}: what is visible as {form}");
    let labels = [label("SVG"), label("PNG")];
    let drawn = StoredValue::new((name, unit));
    let svg = move || drawn.with_value(|(name, unit)| svg_of(deck, name, unit, &entries.get_untracked(), picture));
    let [vector, raster] = labels;
    let again = file.clone();
    view! {
        <button type="button" class="small plain" aria-label=vector title="What is visible, as a picture (SVG)" on:click=move |_| net::save(&format!("{file}.svg"), "image/svg+xml", &svg())>"SVG"</button>
        <button type="button" class="small plain" aria-label=raster title="What is visible, as a picture (PNG)" on:click=move |_| net::save_png(&format!("{again}.png"), &svg())>"PNG"</button>
    }
}

/// The value under the cursor, signed; else the root mean square of what is in view.
fn error_text(deck: Deck, curve: Curve, decimals: usize) -> String {
    let under = deck.cursor.get();
    deck.zoom.track();
    deck.window_s.track();
    deck.data.with_value(|live| match under {
        Some(time) => {
            live.curves.value_at(curve, time).map_or_else(|| format::NONE.to_owned(), |v| format::signed(v, decimals))
        }
        None => {
            let axis = deck.axis(live);
            let series = live.curves.get(curve).filter(|_| deck.is_whole(live, curve));
            let rms = series.and_then(|series| rms(series, axis.start_s, axis.end_s));
            format::maybe(rms, decimals)
        }
    })
}

/// Keeps what is visible of some curves as a picture.
fn svg_of(deck: Deck, name: &str, unit: &str, entries: &[Entry], picture: Picture) -> String {
    deck.data.with_value(|live| {
        let time = deck.axis(live);
        let shown = entries.iter().filter(|e| deck.shows(live, e.curve));
        // The legend begins with what lies on top.
        let mut lines: Vec<_> = shown
            .filter_map(|e| {
                Some(figure::Line { name: e.name.clone(), series: live.curves.get(e.curve)?, stroke: e.stroke })
            })
            .collect();
        lines.reverse();
        let axis = deck.slots().into_iter().find(|slot| slot.picture == picture).and_then(|slot| slot.axis.get());
        let values = axis.unwrap_or_else(|| {
            let extents = lines.iter().map(|line| line.series.extent_between(time.start_s, time.end_s));
            let all = extents.fold(Extent::EMPTY, Extent::union);
            ValueAxis::fit(f64::from(all.min), f64::from(all.max), 1e-6, None)
        });
        let attacked = live.log.attacks.between(time.start_s, time.end_s).filter(|s| s.seen);
        let attacked = attacked.map(|s| (s.start_s, s.end_s)).collect();
        let origin_s = deck.label_origin_s(live, time);
        Figure { title: name.to_owned(), unit: unit.to_owned(), time, origin_s, values, attacked, lines }.svg()
    })
}

/// Keeps what is visible of some curves as a file.
fn save(deck: Deck, name: &str, unit: &str, entries: &[Entry]) {
    let text = deck.data.with_value(|live| {
        let axis = deck.axis(live);
        let head = |e: &Entry| format!("{} {unit}", e.name).trim_end().to_owned();
        let shown = entries.iter().filter(|e| deck.shows(live, e.curve));
        let columns: Vec<_> = shown.filter_map(|e| Some((head(e), live.curves.get(e.curve)?))).collect();
        csv(&columns, axis.start_s, axis.end_s)
    });
    net::save(&format!("{}.csv", name.to_lowercase().replace(' ', "-")), "text/csv", &text);
}

/// The list of what one chart shows one of: of `all`, by `name`, `chosen`.
pub fn shown<T, const N: usize>(
    label: &'static str,
    all: [T; N],
    name: fn(T) -> &'static str,
    chosen: RwSignal<T>,
) -> impl IntoView
where
    T: Copy + PartialEq + Send + Sync + 'static,
{
    let choose = move |text: String| {
        if let Some(one) = all.into_iter().find(|one| name(*one) == text) {
            chosen.set(one);
        }
    };
    view! {
        <select class="small" aria-label=label on:change:target=move |e| choose(e.target().value())>
            {all.map(|one| view! { <option selected=move || chosen.get() == one>{name(one)}</option> }).into_iter().collect_view()}
        </select>
    }
}

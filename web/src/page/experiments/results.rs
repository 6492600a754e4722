//! What is there of an experiment: a row for each condition, with a dot for each flight.

use std::collections::BTreeMap;

use leptos::prelude::*;
use plumbline_rest::experiment::{Condition, Expectation, Flight, Flights, Results, Spread, State};

use super::{
    EXPERIMENT, ROOT,
    browse::{FlightList, Levels, last_part},
    head::Head,
};
use crate::{
    address,
    gpu::VALUE_TICK_SPACING_PX,
    model::{
        experiment::{
            DOTS_PX, ROW_PX, axis, dots,
            selection::{Column, Selection, value},
        },
        format,
    },
    net,
    panel::table::SortHead,
};

/// So many flights are loaded at most: the ground sends no more at a time.
pub(super) const MOST: usize = 1000;

/// The card of one experiment. Its rows are asked for when it is shown, and again whenever the state tells of more flights, and when a run begins or ends.
#[component]
pub fn ResultsCard(
    /// Which.
    id: String,
    /// How it stands, as the list has it.
    state: Memo<State>,
    /// All that are kept.
    states: Memo<Vec<State>>,
) -> impl IntoView {
    let at = format!("{ROOT}/{id}");
    let results = RwSignal::new(Results::default());
    let flights = RwSignal::new(Vec::<Flight>::new());
    // What an address keeps of one experiment is not meant for another.
    let kept = address::all(EXPERIMENT).contains(&id);
    let selection = RwSignal::new(if kept { Selection::read(address::all) } else { Selection::default() });
    Effect::new(move |_| {
        let own = std::iter::once((EXPERIMENT, id.clone()));
        address::keep(&own.chain(selection.with(Selection::query)).collect::<Vec<_>>());
    });
    // The model may answer after the last flight: the run ends with it.
    let done = Memo::new(move |_| state.with(|state| (state.done, state.running)));
    let alone = Memo::new(move |_| results.with(|r| selection.with(|s| s.alone(r, MOST))));
    let from = at.clone();
    Effect::new(move |_| {
        // Read, not only tracked: a memo that nobody reads never changes.
        done.get();
        let condition = alone.get();
        let of = condition.map_or_else(String::new, |number| format!("&condition={number}"));
        let at = format!("{from}/flights?count={MOST}{of}");
        leptos::task::spawn_local(async move {
            let found = net::json::<Flights>("GET", &at, None, "").await;
            // An answer to what is no longer asked comes too late.
            if let Ok(found) = found
                && alone.try_get_untracked() == Some(condition)
            {
                flights.try_set(found.flights);
            }
        });
    });
    let from = at.clone();
    Effect::new(move |_| {
        done.get();
        let at = from.clone();
        leptos::task::spawn_local(async move {
            if let Ok(found) = net::json::<Results>("GET", &at, None, "").await {
                results.try_set(found);
            }
        });
    });
    let factors = Memo::new(move |_| results.with(|r| r.factors.clone()));
    let measures = Memo::new(move |_| results.with(|r| r.measures.clone()));
    let notes = Memo::new(move |_| results.with(|r| r.notes.clone()));
    let measure = Memo::new(move |_| results.with(|r| selection.with(|s| s.measure(r))));
    let choose = move |place: String| {
        let chosen = place.parse().ok().and_then(|place: usize| measures.with_untracked(|all| all.get(place).cloned()));
        selection.update(|s| s.measure = chosen.map(|measure| measure.name).unwrap_or_default());
    };
    let numbers = Memo::new(move |_| {
        results.with(|r| selection.with(|s| s.conditions(r).iter().map(|c| c.number).collect::<Vec<_>>()))
    });
    let head = move |column: Column| {
        let title = if let Column::Factor(key) = &column { key.clone() } else { String::new() };
        let (name, num) = (last_part(column.name()), title.is_empty());
        let (shown, pressed) = (column.clone(), column);
        view! {
            <SortHead
                name
                title
                num
                descending=move || selection.with(|s| (s.sort.as_ref() == Some(&shown)).then_some(s.descending))
                press=move || selection.update(|s| s.sort_by(pressed.clone()))
            />
        }
    };
    let row_at = at.clone();
    let list_at = at.clone();
    view! {
        <section class="card results" aria-label="Results">
            <Head at state states />
            {move || notes.get().into_iter().map(|note| view! { <p class="quiet">{note}</p> }).collect_view()}
            <label class="field measure">"Measure"
                <select on:change:target=move |e| choose(e.target().value())>
                    {move || measures.get().into_iter().enumerate().map(|(i, m)| view! {
                        <option value=i.to_string() selected=measure.get_untracked() == i>{format!("{}: {}", m.name, m.about)}</option>
                    }).collect_view()}
                </select>
            </label>
            <Levels results selection />
            <div class="table-wrap"><table class="dense">
                <thead><tr>
                    {move || factors.get().into_iter().map(|factor| head(Column::Factor(factor))).collect_view()}
                    {[Column::Lost, Column::Median].map(head)}
                    <th class="num" scope="col">"95 % interval"</th>
                    {[Column::Of95, Column::Worst, Column::Found].map(head)}
                    <th class="num" scope="col" title="Part of the flights that the model of the lanes finds: at rest about hover, white noise">"expected"</th>
                    <th class="num" scope="col" title="Median of this less the condition it is compared with, flight by flight of the same seed; d: the mean difference by its standard deviation">"less baseline"</th>
                    <th scope="col"><Scale flights measure /></th>
                </tr></thead>
                <tbody>
                    <For each=move || numbers.get() key=|number| *number let:number>
                        {
                            let condition = Memo::new(move |_| results.with(|r| {
                                r.conditions.iter().find(|c| c.number == number).cloned().unwrap_or_default()
                            }));
                            let at = row_at.clone();
                            // What a row says changes with its condition only.
                            move || view! { <Row condition=condition.get() flights measure at=at.clone() /> }
                        }
                    </For>
                </tbody>
            </table></div>
            {move || results.with(|r| selection.with(|s| s.conditions(r).into_iter().filter_map(differing).collect::<Vec<_>>())).into_iter().map(|says| view! {
                <p class="warn">{says}</p>
            }).collect_view()}
            {move || results.with(|r| selection.with(|s| unknown(&s.conditions(r)))).into_iter().map(|(why, count)| view! {
                <p class="quiet">{format!("Expected is not known of {count}: {why}")}</p>
            }).collect_view()}
            {move || results.with(|r| selection.with(|s| ticks(&s.conditions(r)))).map(|says| view! { <p class="quiet">{says}</p> })}
            <Show when=move || results.with(|r| r.conditions.is_empty())><p class="blank">"No flight has ended yet."</p></Show>
            <Show when=move || numbers.with(Vec::is_empty) && !results.with(|r| r.conditions.is_empty())><p class="blank">"No condition has these levels."</p></Show>
            <FlightList at=list_at results selection flights measure />
        </section>
    }
}

/// The axis of the dots.
#[component]
fn Scale(flights: RwSignal<Vec<Flight>>, measure: Memo<usize>) -> impl IntoView {
    let ticks = move || {
        flights.with(|flights| {
            if flights.iter().all(|flight| value(flight, measure.get()).is_none()) {
                return Vec::new();
            }
            axis(flights, measure.get()).ticks(DOTS_PX, VALUE_TICK_SPACING_PX * 2.0)
        })
    };
    view! {
        <div class="dots scale" aria-hidden="true">
            {move || ticks().into_iter().map(|tick| view! {
                <span style=format!("left:{:.1}px", tick.fraction * (DOTS_PX - 16.0))>{tick.label}</span>
            }).collect_view()}
        </div>
    }
}

/// A condition.
#[component]
fn Row(condition: Condition, flights: RwSignal<Vec<Flight>>, measure: Memo<usize>, at: String) -> impl IntoView {
    let none = || format::NONE.to_owned();
    let lost: u64 = condition.lost.values().sum();
    let why: Vec<_> = condition.lost.iter().map(|(why, count)| format!("{count} {why}")).collect();
    let found = condition.detected.map_or_else(String::new, |d| format!("{} of {}", d.count, d.of));
    let expected = condition.expected.as_ref().map_or_else(String::new, expected);
    let (differs, beside) = (condition.expected.as_ref().is_some_and(|e| e.differs), condition.beside());
    let spreads = condition.measures.clone();
    let spread = move || spreads.get(measure.get()).copied().flatten();
    let figure = move |of: fn(&Spread) -> f64| spread().map_or_else(none, |s| short(of(&s)));
    let [median, of_95, most] = [figure.clone(), figure.clone(), figure];
    let spreads = condition.measures.clone();
    let interval = move || {
        let interval = spreads.get(measure.get()).copied().flatten().and_then(|spread| spread.interval);
        interval.map_or_else(none, |[low, high]| format!("{} to {}", short(low), short(high)))
    };
    let differences = condition.differences.clone();
    let less = move || {
        let difference = differences.get(measure.get()).copied().flatten();
        difference.map_or_else(String::new, |d| {
            let effect = d.effect.map_or_else(String::new, |effect| format!(", d {}", short(effect)));
            format!("{}{effect}", short(d.median))
        })
    };
    let name = condition.levels.join(", ");
    let own = condition.clone();
    view! {
        <tr>
            {condition.levels.iter().map(|level| view! { <td>{level.clone()}</td> }).collect_view()}
            <td class="num" class:bad=move || { lost > 0 } title=why.join(", ")>{format!("{lost} of {}", condition.flights)}</td>
            <td class="num">{move || median(|s| s.median)}</td>
            <td class="num">{interval}</td>
            <td class="num">{move || of_95(|s| s.of_95)}</td>
            <td class="num">{move || most(|s| s.most)}</td>
            <td class="num">{found}</td>
            <td class="num" class:warn=differs title=beside>{expected}</td>
            <td class="num">{less}</td>
            <td>
                <div class="dots" style=format!("height:{ROW_PX}px") role="group" aria-label=format!("Flights of {name}")>
                    {move || {
                        let measure = measure.get();
                        flights.with(|all| dots(all, &own, measure, &axis(all, measure))).into_iter().map(|dot| view! {
                            <a
                                class:lost=dot.lost
                                href=format!("{at}/flights/{}/open", dot.index)
                                rel="external"
                                style=format!("left:{:.1}px;top:{:.1}px", dot.at[0], dot.at[1])
                                aria-label=format!("Open the flight: {}", dot.title)
                                title=dot.title.clone()
                            ></a>
                        }).collect_view()
                    }}
                </div>
            </td>
        </tr>
    }
}

/// A figure, or that there is none.
fn expected(expected: &Expectation) -> String {
    expected.probability.map_or_else(|| "not known".to_owned(), |probability| format!("{probability:.2}"))
}

/// A condition whose flights differ from the model, in words.
fn differing(condition: &Condition) -> Option<String> {
    condition.expected.as_ref().filter(|expected| expected.differs)?;
    Some(format!("{}: {}", condition.levels.join(", "), condition.beside()?))
}

/// How long the agent's ticks took; the report has it by condition.
fn ticks(conditions: &[&Condition]) -> Option<String> {
    let figures: Vec<[f64; 2]> = conditions.iter().filter_map(|condition| condition.tick_us).collect();
    let range = |which: fn(&[f64; 2]) -> f64| {
        let ends =
            figures.iter().map(which).fold((f64::INFINITY, 0.0_f64), |(low, high), us| (low.min(us), high.max(us)));
        let [low, high] = [ends.0, ends.1].map(|us| format!("{us:.0}"));
        if low == high { low } else { format!("{low} to {high}") }
    };
    (!figures.is_empty()).then(|| {
        format!(
            "The agent's tick, where it was flown: median {} µs, 99 of 100 within {} µs",
            range(|f| f[0]),
            range(|f| f[1])
        )
    })
}

/// Why nothing is expected, and of how many conditions.
fn unknown(conditions: &[&Condition]) -> BTreeMap<String, usize> {
    let mut reasons = BTreeMap::new();
    let expected = conditions.iter().filter_map(|condition| condition.expected.as_ref());
    for Expectation { note, .. } in expected.filter(|expected| expected.probability.is_none()) {
        *reasons.entry(note.clone()).or_default() += 1;
    }
    reasons
}

/// Three figures.
pub(super) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use plumbline_rest::experiment::{Condition, Expectation, Part};

    #[test]
    fn a_condition_that_differs_from_the_model_says_so() {
        let flown = Part { count: 12, of: 20, interval: [0.387, 0.781] };
        let of = |probability| {
            let expected = Expectation { probability, ..Expectation::default() }.against(&flown);
            Condition {
                levels: vec!["0.05".into()],
                detected: Some(flown),
                expected: Some(expected),
                ..Condition::default()
            }
        };
        let says = "0.05: expected 0.95, flown 0.60 (0.39 to 0.78): differs by more than the interval";
        assert_eq!([0.95, 0.5].map(|p| super::differing(&of(Some(p)))), [Some(says.to_owned()), None]);
        let unknown = Condition { expected: Some(Expectation::unknown("a climb")), ..of(None) };
        let reasons = super::unknown(&[&of(Some(0.5)), &unknown, &unknown]);
        assert_eq!(reasons.into_iter().collect::<Vec<_>>(), [("a climb".to_owned(), 2)]);
        assert_eq!([Some(0.5), None].map(|p| super::expected(&of(p).expected.unwrap())), ["0.50", "not known"]);
    }

    #[test]
    fn ticks_are_told_over_all_that_is_shown() {
        let of = |tick_us| Condition { tick_us, ..Condition::default() };
        let all = [of(Some([3.2, 54.0])), of(None), of(Some([6.1, 54.4]))];
        let says = "The agent's tick, where it was flown: median 3 to 6 µs, 99 of 100 within 54 µs";
        assert_eq!(super::ticks(&all.each_ref()), Some(says.to_owned()));
        assert_eq!(super::ticks(&[&of(None)]), None);
    }

    #[test]
    fn figures_have_three_digits() {
        let texts = [0.012_345, 1.5, 123.4, 0.0, -0.5].map(super::short);
        assert_eq!(texts, ["0.0123", "1.50", "123", "0", "-0.500"]);
    }
}

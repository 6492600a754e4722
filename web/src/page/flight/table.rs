//! Tables: what of a flight is downloaded as one, and how often.

use leptos::prelude::*;
use plumbline_proto::Kind;

use crate::model::{choice, listing::Part};

/// Most rows a second, and the words for it; none is what the ground does where nothing is said.
const RATES: [(Option<u32>, &str); 5] =
    [(Some(0), "every control tick"), (None, "100 Hz"), (Some(50), "50 Hz"), (Some(10), "10 Hz"), (Some(1), "1 Hz")];

/// What there are columns of: everything that is sampled, what attacks do and what happened.
fn groups<'a>(topics: impl Iterator<Item = &'a String>) -> Vec<String> {
    let has_columns = |topic: &&String| Kind::from_topic(topic).is_some_and(|(kind, _)| kind.has_columns());
    let sampled = topics.filter(has_columns).map(|topic| Kind::column_prefix(topic));
    sampled.chain(["attacks".to_owned(), "events".to_owned()]).collect()
}

/// The card: what it says is kept to by whichever table is downloaded from the head of the page.
#[component]
pub fn TableCard(
    /// What the flight holds messages of.
    topics: Vec<String>,
) -> impl IntoView {
    let part: RwSignal<Part> = expect_context();
    view! {
        <section class="card facts again" aria-label="Tables">
            <header><h2>"Tables"</h2></header>
            <label class="row">
                "Rows, at most"
                <select class="small" on:change:target=move |e| part.update(|part| part.rate_hz = e.target().value().parse().ok())>
                    {RATES.map(|(hz, name)| view! {
                        <option value=hz.map_or_else(String::new, |hz| hz.to_string()) selected=hz == part.with_untracked(|part| part.rate_hz)>{name}</option>
                    })}
                </select>
            </label>
            <fieldset class="checks">
                <legend class="quiet">"Columns of CSV, Parquet and MATLAB"</legend>
                {groups(topics.iter()).into_iter().map(|name| {
                    let column = name.clone();
                    let chosen = part.with_untracked(|part| part.columns.contains(&name));
                    let toggle = move |on: bool| part.update(|part| choice::choose(&mut part.columns, column.clone(), on));
                    view! { <label class="check num"><input type="checkbox" checked=chosen on:change:target=move |e| toggle(e.target().checked()) /> {name}</label> }
                }).collect_view()}
            </fieldset>
            <p class="quiet">"Where none is chosen, all but residuals."</p>
        </section>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sampled_has_columns() {
        let topics = ["/control", "/sensor/height/2", "/residuals/9", "/ack", "/event"].map(str::to_owned);
        assert_eq!(groups(topics.iter()), ["control", "height_2", "residuals_9", "attacks", "events"]);
    }
}

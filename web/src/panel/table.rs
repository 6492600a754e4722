//! What long tables have: heads that sort, and the way to further pages.

use leptos::prelude::*;

/// The head of a column that sorts the table.
#[component]
pub fn SortHead(
    /// What it says.
    #[prop(into)]
    name: String,
    /// What it says in full.
    #[prop(into, optional)]
    title: String,
    /// Of numbers?
    #[prop(optional)]
    num: bool,
    /// What style sheets know the column by.
    #[prop(optional)]
    column: Option<&'static str>,
    /// Is the table sorted by it, and with the greatest first?
    #[prop(into)]
    descending: Signal<Option<bool>>,
    /// Hears that it is pressed.
    press: impl Fn() + 'static,
) -> impl IntoView {
    let title = (!title.is_empty()).then_some(title);
    view! {
        <th
            scope="col"
            class:num=num
            data-column=column
            title=title
            aria-sort=move || match descending.get() {
                Some(true) => "descending",
                Some(false) => "ascending",
                None => "none",
            }
        >
            <button type="button" class="plain" on:click=move |_| press()>
                {name}
                <span aria-hidden="true">{move || match descending.get() {
                    Some(true) => " ▾",
                    Some(false) => " ▴",
                    None => "",
                }}</span>
            </button>
        </th>
    }
}

/// Where in a long list this page is, and the way to the others.
#[component]
pub fn Pages(
    /// How many come before.
    #[prop(into)]
    offset: Signal<usize>,
    /// How many a page has.
    #[prop(into)]
    limit: Signal<usize>,
    /// How many there are.
    #[prop(into)]
    found: Signal<usize>,
    /// Hears of another offset.
    #[prop(into)]
    turn: Callback<usize>,
) -> impl IntoView {
    let end = move || (offset.get() + limit.get()).min(found.get());
    view! {
        <Show when=move || { found.get() > limit.get() }>
            <nav class="sheet-head" aria-label="Further flights">
                <span class="quiet num">{move || format!("{} to {} of {}", offset.get() + 1, end(), found.get())}</span>
                <button
                    type="button"
                    class="push"
                    disabled=move || offset.get() == 0
                    on:click=move |_| turn.run(offset.get_untracked().saturating_sub(limit.get_untracked()))
                >
                    "Previous page"
                </button>
                <button
                    type="button"
                    disabled=move || found.get() <= end()
                    on:click=move |_| turn.run(offset.get_untracked() + limit.get_untracked())
                >
                    "Next page"
                </button>
            </nav>
        </Show>
    }
}

//! Layouts: what stands on the page is in its address, and is kept under names.

use leptos::{html, prelude::*};

use crate::{
    address,
    deck::{Deck, deck},
    model::layout::{Layout, save},
    store,
};

/// Shows what the page's address says, and writes into it what is shown from now on, for as long as the calling component
/// lives.
pub fn begin(deck: Deck) {
    if let Some(layout) = Layout::read(address::all) {
        deck.show(layout);
    }
    Effect::new(move |_| address::keep(&deck.layout().query()));
}

/// The button that opens the list of layouts.
#[component]
pub fn LayoutsButton() -> impl IntoView {
    let deck = deck();
    let saved = RwSignal::new(store::layouts());
    let name = RwSignal::new(String::new());
    let dialog = NodeRef::<html::Dialog>::new();
    let keep = move || {
        let layout = untrack(|| deck.layout());
        let mut kept = false;
        saved.update(|all| kept = save(all, &name.get_untracked(), &layout));
        if kept {
            saved.with_untracked(|all| store::keep_layouts(all));
            name.set(String::new());
        }
    };
    let forget = move |name: &str| {
        saved.update(|all| all.retain(|saved| saved.name != name));
        saved.with_untracked(|all| store::keep_layouts(all));
    };
    let open = move |_| {
        if let Some(dialog) = dialog.get_untracked() {
            // One that is open already stays open.
            let _ = dialog.show_modal();
        }
    };
    let close = move || {
        if let Some(dialog) = dialog.get_untracked() {
            dialog.close();
        }
    };
    let link = move || {
        let layout = deck.layout();
        let query = layout.query();
        let path = address::with(&query);
        format!("{}{path}", window().location().origin().unwrap_or_default())
    };
    let rows = move || {
        saved.get().into_iter().map(|saved| {
            let (shown, forgotten) = (saved.clone(), saved.name.clone());
            view! {
                <li>
                    <button type="button" on:click=move |_| { deck.show(shown.layout()); close(); }>{saved.name.clone()}</button>
                    <button type="button" class="plain push" aria-label=format!("Forget the layout {}", saved.name) on:click=move |_| forget(&forgotten)>"×"</button>
                </li>
            }
        }).collect::<Vec<_>>()
    };
    view! {
        <button type="button" class="small" aria-haspopup="dialog" title="Which charts stand here, of which signals and curves, over which window" on:click=open>"Layout"</button>
        <dialog class="layouts" node_ref=dialog aria-label="Layouts">
            <header>
                <h2>"Layouts"</h2>
                <button type="button" class="plain" aria-label="Close" on:click=move |_| close()>"×"</button>
            </header>
            <ul>
                <li><button type="button" on:click=move |_| { deck.show(Layout::default()); close(); }>"default"</button></li>
                {rows}
            </ul>
            <form on:submit=move |e| { e.prevent_default(); keep() }>
                <input type="text" aria-label="Name for this layout" placeholder="name for what is shown now" autocomplete="off" maxlength="40" prop:value=name on:input:target=move |e| name.set(e.target().value()) />
                <button type="submit">"Save"</button>
            </form>
            <label class="field"><span>"Address, to share"</span>
                <input type="text" readonly prop:value=link on:focus:target=move |e| e.target().select() />
            </label>
        </dialog>
    }
}

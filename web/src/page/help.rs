//! The list of keys.

use leptos::{html, prelude::*};

use crate::{ctx::ctx, keys::KEYS, panel::guide};

/// A dialog with every key; `?` opens it, Esc closes it.
#[component]
pub fn Help() -> impl IntoView {
    let ctx = ctx();
    let dialog = NodeRef::<html::Dialog>::new();
    Effect::new(move |_| {
        let Some(dialog) = dialog.get() else { return };
        if ctx.help.get() {
            let _ = dialog.show_modal();
        } else {
            dialog.close();
        }
    });
    view! {
        <dialog class="help" node_ref=dialog aria-label="Keys" on:close=move |_| ctx.help.set(false)>
            <header><h2>"Keys"</h2><button type="button" class="plain" aria-label="Close" on:click=move |_| ctx.help.set(false)>"×"</button></header>
            <dl>
                {KEYS.into_iter().map(|(key, what)| view! { <div><dt><kbd>{key}</kbd></dt><dd>{what}</dd></div> }).collect::<Vec<_>>()}
            </dl>
            <p class="quiet">
                <button type="button" on:click=move |_| guide::begin(ctx)>"First flight, step by step"</button>
            </p>
            <p class="quiet">
                "Arm, disarm and delete are held for 0.8 s, by pointer, Space or Enter. The motor cut is not: one click or one key."
            </p>
        </dialog>
    }
}

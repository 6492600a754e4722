//! A button that acts only when held: for everything that is dangerous, except the motor cut.

use std::time::Duration;

use leptos::{ev, leptos_dom::helpers::TimeoutHandle, prelude::*};

/// How long a hold takes.
pub const HOLD: Duration = Duration::from_millis(800);

/// Hold with pointer, Space or Enter; let go to think again.
#[component]
pub fn HoldButton(
    /// What it does.
    #[prop(into)]
    label: Signal<String>,
    /// Colour class.
    #[prop(optional, into)]
    class: String,
    /// May it be used?
    #[prop(optional, into)]
    disabled: Signal<bool>,
    /// Called at the end of the hold.
    action: Callback<()>,
) -> impl IntoView {
    let holding = RwSignal::new(false);
    let timer: StoredValue<Option<TimeoutHandle>> = StoredValue::new(None);
    let release = move || {
        if let Some(Some(handle)) = timer.try_update_value(Option::take) {
            handle.clear();
        }
        holding.try_set(false);
    };
    let press = move || {
        if disabled.get_untracked() || holding.get_untracked() {
            return;
        }
        holding.set(true);
        let done = move || {
            release();
            action.run(());
        };
        timer.set_value(set_timeout_with_handle(done, HOLD).ok());
    };
    on_cleanup(release);
    let is_key = |e: &ev::KeyboardEvent| e.key() == " " || e.key() == "Enter";
    view! {
        <button
            type="button"
            class=format!("hold {class}")
            class:holding=holding
            disabled=disabled
            title="Hold to confirm"
            on:pointerdown=move |e| {
                if e.button() == 0 {
                    press();
                }
            }
            on:pointerup=move |_| release()
            on:pointerleave=move |_| release()
            on:pointercancel=move |_| release()
            on:blur=move |_| release()
            on:contextmenu=move |e| e.prevent_default()
            on:keydown=move |e| {
                if is_key(&e) {
                    e.prevent_default();
                    e.stop_propagation();
                    // A key held on is one hold.
                    if !e.repeat() {
                        press();
                    }
                }
            }
            on:keyup=move |e| {
                if is_key(&e) {
                    e.prevent_default();
                    release();
                }
            }
        >
            <span class="hold-fill" aria-hidden="true"></span>
            <span class="hold-label">{label}</span>
            " "
            <span class="hold-hint">"(hold)"</span>
        </button>
    }
}

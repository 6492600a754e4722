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
    // What ends the hold, and since when it lasts, ms of the page's clock.
    let hold: StoredValue<Option<(TimeoutHandle, f64)>> = StoredValue::new(None);
    let release = move || {
        if let Some(Some((handle, _))) = hold.try_update_value(Option::take) {
            handle.clear();
        }
        holding.try_set(false);
    };
    let done = move || {
        release();
        action.run(());
    };
    let press = move |since_ms: f64| {
        if disabled.get_untracked() || holding.get_untracked() {
            return;
        }
        if let Ok(handle) = set_timeout_with_handle(done, HOLD) {
            hold.set_value(Some((handle, since_ms)));
            holding.set(true);
        }
    };
    // A hold lasts as long as it was held, not as long as a page that was busy drawing had noticed.
    let let_go = move |now_ms: f64| match hold.with_value(|hold| hold.as_ref().map(|(_, since_ms)| now_ms - since_ms)) {
        Some(held_ms) if held_ms >= HOLD.as_secs_f64() * 1e3 => done(),
        _ => release(),
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
                    press(e.time_stamp());
                }
            }
            on:pointerup=move |e| let_go(e.time_stamp())
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
                        press(e.time_stamp());
                    }
                }
            }
            on:keyup=move |e| {
                if is_key(&e) {
                    e.prevent_default();
                    let_go(e.time_stamp());
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

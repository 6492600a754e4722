//! What is said while something takes a while: what it is, and how far, where that is known.

use std::time::Duration;

use leptos::prelude::*;

/// What is done by then was not waited for.
const SHORT: Duration = Duration::from_millis(300);

/// A line with a bar, once it has taken longer than [`SHORT`].
#[component]
pub fn Waiting(
    /// What is being done.
    #[prop(into)]
    text: Signal<String>,
    /// Share of it that is done, 0 to 1; `None` where nobody knows.
    #[prop(optional, into)]
    share: Signal<Option<f64>>,
) -> impl IntoView {
    let long = RwSignal::new(false);
    let shown = move || {
        let _ = long.try_set(true);
    };
    // Without a timer it is shown at once.
    match set_timeout_with_handle(shown, SHORT) {
        Ok(timer) => on_cleanup(move || timer.clear()),
        Err(_) => long.set(true),
    }
    let percent = move || share.get().map(|share| format!("{:.0} %", (100.0 * share).clamp(0.0, 100.0)));
    view! {
        <Show when=move || long.get()>
            <p class="waiting" role="status">
                <span>{text}</span>
                {move || match share.get() {
                    Some(share) => view! { <progress value=share.clamp(0.0, 1.0).to_string() max="1" aria-label=text></progress> }.into_any(),
                    None => view! { <progress aria-label=text></progress> }.into_any(),
                }}
                <span class="num">{percent}</span>
            </p>
        </Show>
    }
}

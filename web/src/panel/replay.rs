//! Controls of a replayed vehicle: faster, slower, one tick at a time. Only there when a recording flies.

use leptos::prelude::*;
use plumbline_rest::command as rest;
use serde_json::json;

use crate::{ctx::ctx, model::format};

/// Speeds offered, times real time.
const SPEEDS: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];

/// The replay card.
#[component]
pub fn ReplayCard() -> impl IntoView {
    let ctx = ctx();
    let replayed = Memo::new(move |_| ctx.live(|live| live.is_replay()));
    let file = Memo::new(move |_| {
        ctx.live(|live| live.description.get().map(|d| d.source_file.rsplit('/').next().unwrap_or_default().to_owned()))
    });
    let speed = Memo::new(move |_| ctx.live(|live| live.status.get().map_or(0.0, |s| s.replay_speed)));
    let progress =
        Memo::new(move |_| ctx.live(|live| live.status.get().map_or(0.0, |s| s.replay_progress.clamp(0.0, 1.0))));
    let running = Memo::new(move |_| speed.get() > 0.0);
    let ended = Memo::new(move |_| !running.get() && progress.get() >= 1.0);
    // The speed in use; while it stands, the one before.
    let resume = Memo::new(move |before: Option<&f64>| {
        let now = speed.get();
        if now > 0.0 { now } else { before.copied().unwrap_or(1.0) }
    });
    let send = move |what: String, speed: f64, step: u32| {
        ctx.command(what, "POST", "replay", json!(rest::Replay { speed, step }))
    };
    let toggle = move |_| {
        if running.get_untracked() {
            send("Pause recording".into(), 0.0, 0);
        } else {
            send("Run recording".into(), resume.get_untracked(), 0);
        }
    };
    let set_speed = move |list: web_sys::HtmlSelectElement| {
        let wanted = list.value().parse::<f64>();
        // It shows what is in use: another one once the vehicle flies at it.
        list.set_value(&resume.get_untracked().to_string());
        if let Ok(wanted) = wanted {
            send(format!("Speed {wanted}×"), wanted, 0);
        }
    };
    view! {
        <Show when=move || replayed.get()>
            <section class="card replay-card" aria-label="Recording flown again">
                <header>
                    <h2>"Recording"</h2>
                    <span class="quiet one-line" title=move || file.get().unwrap_or_default()>{move || file.get()}</span>
                    <span class="num push quiet no-wrap">{move || format!("{} %", format::fixed(progress.get() * 100.0, 1))}</span>
                </header>
                <progress max="1" prop:value=progress aria-label="Progress of the recording"></progress>
                <div class="row">
                    <button type="button" aria-label=move || { if running.get() { "Pause recording" } else { "Run recording" } } on:click=toggle>
                        {move || if running.get() { "❚❚" } else { "▶" }}
                    </button>
                    <select
                        aria-label="Speed of the recording"
                        prop:value=move || resume.get().to_string()
                        on:change:target=move |e| set_speed(e.target())
                    >
                        {SPEEDS.into_iter().map(|s| view! {
                            <option value=s.to_string() selected=move || resume.get() == s>{format!("{s}×")}</option>
                        }).collect::<Vec<_>>()}
                    </select>
                    <button type="button" disabled=running on:click=move |_| send("Step 1 tick".into(), 0.0, 1)>"+1 tick"</button>
                    <button type="button" disabled=running aria-label="+20 ticks" on:click=move |_| send("Step 20 ticks".into(), 0.0, 20)>"+20"</button>
                </div>
                <p class="quiet">
                    {move || if ended.get() {
                        "End of the recording. Started again, it flies from its begin."
                    } else {
                        "Mode, setpoint and motors are those of then; estimators and attacks are yours to change."
                    }}
                </p>
            </section>
        </Show>
    }
}

//! Modes, arming, and the checks that stand in the way, with their reasons.

use leptos::prelude::*;
use plumbline_proto::v1::{Check, Failsafe, Mode};
use serde_json::json;

use super::hold::HoldButton;
use crate::{ctx::ctx, model::names};

/// Modes an operator can ask for.
const MODES: [Mode; 4] = [Mode::Stabilise, Mode::AltitudeHold, Mode::Hold, Mode::Land];

/// The mode card.
#[component]
pub fn ArmingCard() -> impl IntoView {
    let ctx = ctx();
    let status =
        move |read: fn(&plumbline_proto::v1::Status) -> bool| ctx.live(|live| live.status.get().is_some_and(read));
    let replayed = Memo::new(move |_| ctx.live(|live| live.is_replay()));
    let known = Memo::new(move |_| ctx.live(|live| live.status.get().is_some()));
    let armed = Memo::new(move |_| status(|s| s.armed));
    let ready = Memo::new(move |_| status(|s| s.ready_to_arm));
    let cut = Memo::new(move |_| status(|s| s.cut_latched));
    let mode = Memo::new(move |_| ctx.live(|live| live.status.get().map_or(Mode::Unspecified, |s| s.mode())));
    let failing = Memo::new(move |_| {
        ctx.live(|live| {
            live.status
                .get()
                .map(|s| s.checks.iter().filter(|c| !c.passed).cloned().collect::<Vec<Check>>())
                .unwrap_or_default()
        })
    });
    let checks = Memo::new(move |_| ctx.live(|live| live.status.get().map_or(0, |s| s.checks.len())));
    let failsafe = Memo::new(move |_| {
        ctx.live(|live| {
            live.status.get().filter(|s| s.failsafe() != Failsafe::None).map(|s| {
                let title = names::failsafe(s.failsafe());
                if s.failsafe_reason.is_empty() {
                    title.to_owned()
                } else {
                    format!("{title} – {}", s.failsafe_reason)
                }
            })
        })
    });
    let arm = Callback::new(move |()| ctx.command("Arm", "POST", "arm", json!({})));
    let disarm = Callback::new(move |()| ctx.command("Disarm", "POST", "disarm", json!({})));
    let release = Callback::new(move |()| ctx.command("Release cut", "POST", "release-cut", json!({})));
    view! {
        <section class="card arming" aria-label="Mode and arming">
            <header>
                <h2>"Mode"</h2>
                <span class="chip" class:alert=cut>{move || names::mode(mode.get())}</span>
            </header>
            <Show when=move || !replayed.get()>
                <div class="buttons modes" role="group" aria-label="Mode">
                    {MODES.into_iter().map(|m| view! {
                        <button
                            type="button"
                            title=names::mode_help(m)
                            aria-pressed=move || (mode.get() == m).to_string()
                            disabled=move || !known.get()
                            on:click=move |_| ctx.command(names::mode(m), "POST", "mode", json!({ "mode": names::mode_json(m) }))
                        >{names::mode(m)}</button>
                    }).collect::<Vec<_>>()}
                </div>
                <div class="arm-row">
                    {move || if cut.get() {
                        view! { <HoldButton label="Release cut" class="warn" action=release /> }.into_any()
                    } else if armed.get() {
                        view! { <HoldButton label="Disarm" class="warn" action=disarm /> }.into_any()
                    } else {
                        view! { <HoldButton label="Arm" class="go" disabled=Signal::derive(move || !known.get()) action=arm /> }.into_any()
                    }}
                </div>
                {move || failsafe.get().map(|text| view! { <p class="failsafe" role="alert">{text}</p> })}
                <div class="checks" aria-live="polite">
                    {move || {
                        let bad = failing.get();
                        if !known.get() {
                            view! { <p class="quiet">"Checks come with the vehicle's first status."</p> }.into_any()
                        } else if armed.get() {
                            view! { <p class="quiet">"Armed. Hold Disarm on the ground; Land descends first."</p> }.into_any()
                        } else if !bad.is_empty() {
                            view! {
                                <p class="bad">{format!("{} of {} checks fail", bad.len(), checks.get())}</p>
                                <ul>
                                    {bad.into_iter().map(|c| view! {
                                        <li><b>{c.name}</b> " " <span>{c.reason}</span></li>
                                    }).collect::<Vec<_>>()}
                                </ul>
                            }.into_any()
                        } else if ready.get() {
                            view! { <p class="good">{format!("✓ all {} checks pass", checks.get())}</p> }.into_any()
                        } else {
                            view! { <p class="quiet">"Not ready to arm in this mode."</p> }.into_any()
                        }
                    }}
                </div>
            </Show>
        </section>
    }
}

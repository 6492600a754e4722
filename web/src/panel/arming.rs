//! Modes, arming, and the checks that stand in the way, with their reasons. The card keeps its size, whatever it says:
//! nothing moves under the pointer that arms.

use leptos::prelude::*;
use plumbline_proto::v1::{Check, EstimatorKind, Mode, RecordingStatus, Status};
use plumbline_rest::command as rest;
use serde_json::json;

use super::{envelope::EnvelopeLine, hold::HoldButton};
use crate::{
    ctx::ctx,
    model::{live::Live, names},
};

/// Modes an operator can ask for.
const MODES: [Mode; 4] = [Mode::Stabilise, Mode::AltitudeHold, Mode::Hold, Mode::Land];

/// Everything that may refuse arming, what fails first: the vehicle's checks, and that the ground can record.
fn checks(status: &Status, recording: Option<&RecordingStatus>) -> Vec<Check> {
    let mut all = status.checks.clone();
    if let Some(recording) = recording {
        let (passed, reason) = (recording.error.is_empty(), recording.error.clone());
        all.push(Check { name: "recording".to_owned(), passed, reason });
    }
    all.sort_by_key(|check| check.passed);
    all
}

/// One line on the checks, and one on what to do: (class, line, line).
fn outlook(status: Option<&Status>, checks: &[Check]) -> (&'static str, String, String) {
    let Some(status) = status else {
        return ("quiet", "Checks come with the vehicle's first status.".to_owned(), String::new());
    };
    let failing: Vec<&Check> = checks.iter().filter(|c| !c.passed).collect();
    if status.armed {
        let line = match status.disarms_in_s {
            Some(s) => format!("Armed; disarms itself in {s:.0} s"),
            None if status.mode() == Mode::Land => "Landing; disarms on the ground.".to_owned(),
            None => "Armed.".to_owned(),
        };
        return ("quiet", line, "Hold Disarm on the ground; Land descends first.".to_owned());
    }
    match failing.first() {
        Some(first) => {
            let line = format!("{} of {} checks fail", failing.len(), checks.len());
            ("bad", line, format!("{}: {}", first.name, first.reason))
        }
        None if status.ready_to_arm => ("good", format!("✓ all {} checks pass", checks.len()), String::new()),
        None => ("quiet", "Not ready to arm in this mode.".to_owned(), String::new()),
    }
}

/// Why this mode cannot be flown with the estimator in the loop.
pub fn unfit(mode: Mode, live: &Live) -> Option<String> {
    let kind = EstimatorKind::try_from(i32::from(live.in_loop())).unwrap_or_default();
    let holds = matches!(mode, Mode::AltitudeHold | Mode::Hold);
    (holds && !names::estimates_altitude(kind))
        .then(|| format!("{} estimates no altitude: choose another estimator first", kind.title()))
}

/// The mode card.
#[component]
pub fn ArmingCard() -> impl IntoView {
    let ctx = ctx();
    let status =
        move |read: fn(&plumbline_proto::v1::Status) -> bool| ctx.live(|live| live.status.get().is_some_and(read));
    let replayed = Memo::new(move |_| ctx.live(|live| live.is_replay()));
    let known = Memo::new(move |_| ctx.live(|live| live.status.get().is_some()));
    let armed = Memo::new(move |_| status(|s| s.armed));
    let cut = Memo::new(move |_| status(|s| s.cut_latched));
    let mode = Memo::new(move |_| ctx.live(Live::mode));
    let old = Memo::new(move |_| ctx.is_old(|live| &live.status));
    let all = Memo::new(move |_| {
        ctx.live(|live| live.status.get().map(|s| checks(s, live.ground.recording.as_ref())).unwrap_or_default())
    });
    let outlook = Memo::new(move |_| ctx.live(|live| all.with(|all| outlook(live.status.get(), all))));
    let open = RwSignal::new(false);
    let arm = Callback::new(move |()| ctx.command("Arm", "POST", "arm", json!({})));
    let disarm = Callback::new(move |()| ctx.command("Disarm", "POST", "disarm", json!({})));
    let release = Callback::new(move |()| ctx.command("Release cut", "POST", "release-cut", json!({})));
    view! {
        <section class="card arming" id="arm" tabindex="-1" aria-label="Mode and arming">
            <header>
                <h2>"Mode"</h2>
                <span class="chip" class:alert=cut class:stale=old>{move || names::mode(mode.get())}</span>
            </header>
            <Show when=move || !replayed.get()>
                <div class="buttons modes" role="group" aria-label="Mode">
                    {MODES.into_iter().map(|m| {
                        let unfit = Memo::new(move |_| ctx.live(|live| unfit(m, live)));
                        view! {
                            <button
                                type="button"
                                title=move || unfit.get().unwrap_or_else(|| names::mode_help(m).to_owned())
                                aria-pressed=move || (mode.get() == m).to_string()
                                aria-disabled=move || unfit.with(Option::is_some).then_some("true")
                                disabled=move || !known.get()
                                on:click=move |_| match unfit.get_untracked() {
                                    Some(why) => ctx.refuse(why),
                                    None => ctx.command(names::mode(m), "POST", "mode", json!(rest::Mode { mode: names::mode_json(m) })),
                                }
                            >{names::mode(m)}</button>
                        }
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
                <details class="arm-checks" class:stale=old on:toggle=move |e| open.set(event_target::<web_sys::Element>(&e).has_attribute("open"))>
                    <summary aria-live="polite">
                        <span class=move || format!("one-line {}", outlook.get().0)>{move || outlook.get().1}</span>
                        <span class="one-line quiet">{move || outlook.get().2}</span>
                    </summary>
                    <ul>
                        // Their reasons change with every beat: nobody reads them while they are folded.
                        {move || open.get().then(|| all.get().into_iter().map(|c| view! {
                            <li class:bad=!c.passed><i aria-hidden="true">{if c.passed { "✓" } else { "✗" }}</i> <b>{c.name}</b> " " <span>{c.reason}</span></li>
                        }).collect::<Vec<_>>())}
                    </ul>
                    <EnvelopeLine open />
                </details>
            </Show>
        </section>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_comes_first_and_a_full_disk_is_a_check() {
        let check = |name: &str, passed| Check { name: name.into(), passed, reason: "why".into() };
        let status = Status { checks: vec![check("battery", true), check("tilt", false)], ..Default::default() };
        let recording = RecordingStatus { error: "no space left".into(), ..Default::default() };
        let all = checks(&status, Some(&recording));
        assert_eq!(all.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["tilt", "recording", "battery"]);
        let (class, line, reason) = outlook(Some(&status), &all);
        assert_eq!((class, line.as_str(), reason.as_str()), ("bad", "2 of 3 checks fail", "tilt: why"));
        let well = Status { checks: vec![check("battery", true)], ready_to_arm: true, ..Default::default() };
        let all = checks(&well, Some(&RecordingStatus::default()));
        assert_eq!(outlook(Some(&well), &all).1, "✓ all 2 checks pass");
    }
}

//! Attacks: a schedule written on a timeline, sent whole, watched from accepted to active to done.

use leptos::{html, prelude::*};
use plumbline_proto::v1::{AttackPhase, AttackProgress, Description, SensorKind};
use plumbline_rest::command as rest;
use serde_json::json;

use super::prepare::{ExpectedLine, Prepare};
use crate::{
    ctx::ctx,
    model::{
        draft::{self, Draft, Form, magnitude_unit, subject},
        format,
        live::Live,
        names,
    },
};

/// One bar of the timeline: a planned or running attack. Times in s from acceptance.
#[derive(Debug, Clone, PartialEq)]
struct Bar {
    key: u32,
    phase: AttackPhase,
    title: String,
    start_s: f64,
    end_s: f64,
    altered: u64,
}

/// Bars of the schedule on the vehicle, and how far it has come.
#[derive(Debug, Clone, PartialEq, Default)]
struct Running {
    bars: Vec<Bar>,
    elapsed_s: Option<f64>,
}

fn running(state: &[AttackProgress], vehicle: Option<&Description>, now_us: f64) -> Running {
    let bars = state
        .iter()
        .filter_map(|p| {
            let a = p.attack.as_ref()?;
            let relative = |t: u64| (t as f64 - p.accepted_time_us as f64) * 1e-6;
            Some(Bar {
                key: a.id,
                phase: p.phase(),
                title: subject(a.sensor(), a.instance, a.channel(), a.kind(), a.magnitude, vehicle),
                start_s: a.start_s,
                end_s: p.ended_time_us.map_or(a.start_s + a.duration_s, relative).max(a.start_s),
                altered: p.altered_samples,
            })
        })
        .collect::<Vec<_>>();
    let alive = state.iter().any(|p| matches!(p.phase(), AttackPhase::Accepted | AttackPhase::Active));
    let elapsed = state.iter().map(|p| p.accepted_time_us).max().filter(|_| alive);
    Running { bars, elapsed_s: elapsed.map(|t| (now_us - t as f64) * 1e-6) }
}

/// Length of the timeline, s: a round number that holds every bar.
fn horizon_s(bars: &[Bar]) -> f64 {
    let end = bars.iter().map(|b| b.end_s).fold(0.0, f64::max);
    [10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0].into_iter().find(|s| *s >= end).unwrap_or(3600.0)
}

fn phase_class(phase: AttackPhase) -> &'static str {
    match phase {
        AttackPhase::Unspecified => "draft",
        AttackPhase::Accepted => "accepted",
        AttackPhase::Active => "active",
        AttackPhase::Done => "done",
        AttackPhase::Aborted => "aborted",
    }
}

/// The attacks card.
#[component]
pub fn AttacksCard() -> impl IntoView {
    let ctx = ctx();
    let drafts = ctx.drafts;
    let enabled = Memo::new(move |_| {
        ctx.live(|live| {
            let told = live.attacks.get().map(|a| a.enabled);
            told.or_else(|| live.description.get().map(|d| d.attacks_enabled))
        })
    });
    let state = Memo::new(move |_| {
        let now = {
            ctx.tick.track();
            ctx.flight_now_us()
        };
        ctx.live(|live| running(live.attacks.get().map_or(&[], |a| a.attacks.as_slice()), live.description.get(), now))
    });
    let alive = Memo::new(move |_| state.with(|s| s.elapsed_s.is_some()));
    // A draft is the page's own.
    let old = Memo::new(move |_| ctx.is_old(|live| &live.attacks) && drafts.with(Vec::is_empty));
    // While a draft is being written the timeline shows the draft, else the vehicle's schedule.
    let bars = Memo::new(move |_| {
        let drafts = drafts.get();
        if drafts.is_empty() {
            return state.with(|s| s.bars.clone());
        }
        let bar = |(i, d): (usize, &Draft)| Bar {
            key: i as u32,
            phase: AttackPhase::Unspecified,
            title: ctx.live(|live| d.subject(live.description.get())),
            start_s: d.start_s,
            end_s: d.start_s + d.duration_s,
            altered: 0,
        };
        drafts.iter().enumerate().map(bar).collect()
    });
    let send = move |_| {
        let bodies: Vec<_> = drafts.get_untracked().iter().enumerate().map(|(i, d)| d.body(i as u64 + 1)).collect();
        let sent = drafts.get_untracked();
        // What is refused is still here to be mended.
        ctx.command_then(
            "Attack schedule",
            "PUT",
            "attacks",
            json!(rest::AttackPlan { attacks: bodies }),
            move |answer| {
                if answer.is_ok() && drafts.with_untracked(|all| *all == sent) {
                    drafts.set(Vec::new());
                }
            },
        );
    };
    view! {
        <section class="card attacks" aria-label="Attacks">
            <header>
                <h2>"Attacks"</h2>
                <button
                    type="button"
                    class="small abort"
                    disabled=move || !alive.get()
                    on:click=move |_| ctx.abort_attacks()
                >"Abort all"</button>
            </header>
            {move || match enabled.get() {
                Some(false) => view! {
                    <p class="quiet">"Attacks are off. Only the vehicle's own configuration turns them on."</p>
                }.into_any(),
                None => view! { <p class="quiet">"Attacks can be planned once a vehicle is connected."</p> }.into_any(),
                Some(true) => view! {
                    <Editor drafts live=ctx.live focused=true />
                    <Prepare drafts />
                    <div class="schedule" class:stale=old>
                        <Timeline bars elapsed=Signal::derive(move || if drafts.with(Vec::is_empty) { state.with(|s| s.elapsed_s) } else { None }) />
                        <List bars drafts />
                    </div>
                    <ExpectedLine drafts />
                    <Show when=move || !drafts.with(Vec::is_empty)>
                        <div class="buttons">
                            <button type="button" class="attack-send" on:click=send>
                                {move || match drafts.with(Vec::len) { 1 => "Schedule 1 attack".to_owned(), n => format!("Schedule {n} attacks") }}
                            </button>
                            <button type="button" on:click=move |_| drafts.set(Vec::new())>"Clear"</button>
                        </div>
                    </Show>
                }.into_any(),
            }}
        </section>
    }
}

/// The bars on their time axis.
#[component]
fn Timeline(bars: Memo<Vec<Bar>>, #[prop(into)] elapsed: Signal<Option<f64>>) -> impl IntoView {
    let length = Memo::new(move |_| bars.with(|b| horizon_s(b)));
    let place = move |bar: &Bar| {
        let length = length.get();
        format!(
            "left:{:.2}%;width:{:.2}%",
            bar.start_s / length * 100.0,
            ((bar.end_s - bar.start_s) / length * 100.0).max(0.8)
        )
    };
    view! {
        <div class="timeline" role="img" aria-label=move || bars.with(|b| match b.len() {
            0 => "Attack timeline, empty".to_owned(),
            n => format!("Attack timeline, {n} planned over {} s", length.get()),
        })>
            <div class="tracks" style=move || format!("--tracks:{}", bars.with(Vec::len).clamp(1, 8))>
                {move || bars.get().into_iter().map(|bar| view! {
                    <div class="track"><i class=phase_class(bar.phase) style=place(&bar) title=bar.title.clone()></i></div>
                }).collect::<Vec<_>>()}
                {move || elapsed.get().filter(|e| *e <= length.get()).map(|e| view! {
                    <div class="now" style=format!("left:{:.2}%", e / length.get() * 100.0)></div>
                })}
            </div>
            <div class="timeline-scale num" aria-hidden="true">
                <span>"+0"</span>
                <span>{move || format!("+{:.0} s", length.get() / 2.0)}</span>
                <span>{move || format!("+{:.0} s", length.get())}</span>
            </div>
        </div>
    }
}

/// The attacks by name, each with its state.
#[component]
fn List(bars: Memo<Vec<Bar>>, drafts: RwSignal<Vec<Draft>>) -> impl IntoView {
    let remove = move |key: u32| {
        drafts.update(|all| {
            if (key as usize) < all.len() {
                all.remove(key as usize);
            }
        })
    };
    view! {
        <ul class="attack-list" aria-live="polite">
            {move || bars.get().into_iter().map(|bar| {
                let draft = bar.phase == AttackPhase::Unspecified;
                let key = bar.key;
                view! {
                    <li>
                        <span class="attack-title">{bar.title}</span>
                        <span class="attack-when num quiet">
                            {format!("+{} s, {} s", format::fixed(bar.start_s, 0), format::fixed(bar.end_s - bar.start_s, 0))}
                        </span>
                        <span class=format!("chip {}", phase_class(bar.phase)) title=format!("{} samples altered", bar.altered)>
                            {names::phase(bar.phase)}
                        </span>
                        {draft.then(|| view! {
                            <button type="button" class="plain" aria-label="Remove from draft" on:click=move |_| remove(key)>"×"</button>
                        })}
                    </li>
                }
            }).collect::<Vec<_>>()}
        </ul>
        <Show when=move || bars.with(Vec::is_empty)>
            <p class="quiet">"Nothing scheduled."</p>
        </Show>
    }
}

/// One of what is said by numbers; none to choose from, nothing to choose.
#[component]
pub fn EnumSelect<T>(
    /// What there is.
    #[prop(into)]
    offered: Signal<Vec<T>>,
    /// Its name for people.
    name: fn(T) -> &'static str,
    /// The one chosen.
    #[prop(into)]
    chosen: Signal<T>,
    /// Nothing to choose?
    #[prop(into, optional)]
    disabled: Signal<bool>,
    /// Hears of another one.
    choose: impl Fn(T) + 'static,
) -> impl IntoView
where
    T: Copy + Default + PartialEq + TryFrom<i32> + Into<i32> + Send + Sync + 'static,
{
    let choose =
        move |value: String| choose(value.parse().ok().and_then(|n: i32| n.try_into().ok()).unwrap_or_default());
    view! {
        <select
            disabled=move || disabled.get() || offered.with(Vec::is_empty)
            on:change:target=move |e| choose(e.target().value())
        >
            {move || offered.get().into_iter().map(|one| {
                let number: i32 = one.into();
                view! { <option value=number.to_string() selected=move || chosen.get() == one>{name(one)}</option> }
            }).collect::<Vec<_>>()}
        </select>
    }
}

/// The form that adds one attack to the draft.
#[component]
pub fn Editor(
    /// Where it is added.
    drafts: RwSignal<Vec<Draft>>,
    /// Whose vehicle describes what can be attacked.
    live: StoredValue<Live, LocalStorage>,
    /// Does the key for attacks lead here?
    #[prop(optional)]
    focused: bool,
) -> impl IntoView {
    let ctx = ctx();
    let described = move || ctx.tick.track();
    let form = RwSignal::new(Form::default());
    let refusal = RwSignal::new(None::<String>);
    let first = NodeRef::<html::Select>::new();
    Effect::new(move |seen: Option<u64>| {
        let asked = ctx.attacks_focus.get();
        if focused
            && seen.is_some_and(|s| s != asked)
            && let Some(select) = first.get_untracked()
        {
            // Focus fails only on what cannot have it.
            let _ = select.focus();
        }
        asked
    });
    let sensors = Memo::new(move |_| {
        described();
        live.with_value(|live| {
            live.description
                .get()
                .map(|d| draft::targets(d).map(|s| (s.kind(), s.instance)).collect::<Vec<_>>())
                .unwrap_or_default()
        })
    });
    let add = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let checked = live.with_value(|live| form.get_untracked().check(live.description.get()));
        refusal.set(checked.as_ref().err().cloned());
        if let Ok(draft) = checked {
            drafts.update(|all| all.push(draft));
        }
    };
    // What is being mended is not refused yet.
    Effect::new(move |_| {
        form.track();
        refusal.set(None);
    });
    // What the vehicle says of the chosen sensor.
    let channels = Memo::new(move |_| {
        let (sensor, instance) = form.with(|f| (f.sensor, f.instance));
        described();
        live.with_value(|live| draft::channels(live.description.get(), sensor, instance).to_vec())
    });
    let unit = Memo::new(move |_| form.with(|f| channels.with(|c| magnitude_unit(f.kind, c, f.channel))));
    // Another sensor or kind may not cover the channel chosen before.
    Effect::new(move |_| {
        let offered = channels.with(|c| draft::offered(c, form.with(|f| f.kind)));
        if !offered.contains(&form.with_untracked(|f| f.channel)) {
            form.update(|f| f.channel = offered.first().copied().unwrap_or_default());
        }
    });
    let choose_sensor = move |value: String| {
        let Some((kind, instance)) = value.split_once('/') else { return };
        let (Ok(kind), Ok(instance)) = (kind.parse::<i32>(), instance.parse()) else { return };
        form.update(|f| {
            f.sensor = SensorKind::try_from(kind).unwrap_or_default();
            f.instance = instance;
        });
    };
    view! {
        <form class="attack-form" on:submit=add aria-label="New attack">
            <label class="field wide"><span>"sensor or rotor"</span>
                <select node_ref=first on:change:target=move |e| choose_sensor(e.target().value())>
                    {move || sensors.get().into_iter().map(|(kind, instance)| view! {
                        <option
                            value=format!("{}/{instance}", kind as i32)
                            selected=move || form.with(|f| f.sensor == kind && f.instance == instance)
                        >{names::instance(kind, instance)}</option>
                    }).collect::<Vec<_>>()}
                </select>
            </label>
            <label class="field wide"><span>"channel"</span>
                <EnumSelect
                    name=names::attack_channel
                    offered=move || channels.with(|c| draft::offered(c, form.with(|f| f.kind)))
                    chosen=move || form.with(|f| f.channel)
                    choose=move |channel| form.update(|f| f.channel = channel)
                />
            </label>
            <label class="field wide"><span>"kind"</span>
                <EnumSelect
                    name=names::attack_kind
                    offered=names::ATTACK_KINDS.to_vec()
                    chosen=move || form.with(|f| f.kind)
                    choose=move |kind| form.update(|f| f.kind = kind)
                />
            </label>
            <label class="field wide"><span>"magnitude " <small>{move || unit.get().unwrap_or_default()}</small></span>
                <input
                    type="text" inputmode="decimal" autocomplete="off"
                    disabled=move || unit.get().is_none()
                    prop:value=move || form.with(|f| f.magnitude.clone())
                    on:input:target=move |e| form.update(|f| f.magnitude = e.target().value())
                />
            </label>
            <label class="field"><span>"start " <small>"+s"</small></span>
                <input type="text" inputmode="decimal" autocomplete="off"
                    prop:value=move || form.with(|f| f.start.clone())
                    on:input:target=move |e| form.update(|f| f.start = e.target().value()) />
            </label>
            <label class="field"><span>"duration " <small>"s"</small></span>
                <input type="text" inputmode="decimal" autocomplete="off"
                    prop:value=move || form.with(|f| f.duration.clone())
                    on:input:target=move |e| form.update(|f| f.duration = e.target().value()) />
            </label>
            <button type="submit">"Add"</button>
            <p class="bad" role="alert">{move || refusal.get()}</p>
        </form>
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::v1::Attack;

    #[test]
    fn a_schedule_runs_from_its_acceptance_and_stops_when_nothing_is_left() {
        let attack = Attack {
            id: 1,
            start_s: 5.0,
            duration_s: 10.0,
            magnitude: 0.5,
            kind: 2,
            sensor: 2,
            instance: 2,
            ..Default::default()
        };
        let mut progress = AttackProgress { attack: Some(attack), accepted_time_us: 1_000_000, ..Default::default() };
        progress.set_phase(AttackPhase::Active);
        let state = running(std::slice::from_ref(&progress), None, 8e6);
        assert_eq!(state.elapsed_s, Some(7.0));
        assert_eq!((state.bars[0].start_s, state.bars[0].end_s), (5.0, 15.0));
        assert_eq!(state.bars[0].title, "height 2: bias +0.5");
        progress.set_phase(AttackPhase::Aborted);
        progress.ended_time_us = Some(9_000_000);
        let state = running(&[progress], None, 20e6);
        assert_eq!((state.elapsed_s, state.bars[0].end_s), (None, 8.0));
        assert_eq!(horizon_s(&state.bars), 10.0);
        assert_eq!(horizon_s(&[]), 10.0);
    }
}

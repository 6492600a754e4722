//! A plan from what this vehicle has: chosen and ticked, written as text below, where it may be changed further.

use leptos::prelude::*;
use plumbline_proto::v1::SensorKind;

use crate::{
    ctx::ctx,
    model::{
        choice, draft, names,
        study::{Study, Target},
    },
    panel::attacks::EnumSelect,
};

const WORLDS: [&str; 3] = ["bench", "datasheet", "harsh"];
const RIGS: [&str; 2] = ["on strings", "free"];

/// The form; each answer writes `text` anew.
#[component]
pub fn StudyForm(text: RwSignal<String>) -> impl IntoView {
    let ctx = ctx();
    let study = RwSignal::new(Study::default());
    let refusal = RwSignal::new(String::new());
    let answer = move |change: &dyn Fn(&mut Study)| {
        study.update(change);
        let written = ctx.live.with_value(|live| study.with_untracked(|study| study.plan(live.description.get())));
        refusal.set(written.as_ref().err().cloned().unwrap_or_default());
        if let Ok(plan) = written {
            text.set(plan);
        }
    };
    let targets = Memo::new(move |_| {
        let mut all: Vec<(SensorKind, Option<u32>)> = Vec::new();
        ctx.live(|live| {
            for sensor in live.description.get().into_iter().flat_map(draft::targets) {
                let drawn = (sensor.kind(), None);
                if !all.contains(&drawn) {
                    all.push(drawn);
                }
                all.push((sensor.kind(), Some(sensor.instance)));
            }
        });
        all
    });
    let estimators = Memo::new(move |_| {
        let fit = |kind: &_| names::estimates_altitude(*kind);
        ctx.live(|live| live.offered_estimators().into_iter().filter(fit).collect::<Vec<_>>())
    });
    let channels = Memo::new(move |_| {
        let (target, kind) = study.with(|study| (study.target, study.kind));
        let Some(Target { sensor, instance }) = target else { return Vec::new() };
        ctx.live(|live| draft::offered(draft::channels(live.description.get(), sensor, instance.unwrap_or(1)), kind))
    });
    let unit = Memo::new(move |_| ctx.live(|live| study.with(|study| study.unit(live.description.get()))));
    // Another sensor or kind may not cover the channel chosen before.
    Effect::new(move |_| {
        let offered = channels.get();
        if let Some(first) = offered.first()
            && !offered.contains(&study.with_untracked(|study| study.channel))
        {
            answer(&|study| study.channel = *first);
        }
    });
    let choose_target = move |value: String| {
        let target = value.split_once('/').and_then(|(kind, instance)| {
            let sensor = SensorKind::try_from(kind.parse::<i32>().ok()?).ok()?;
            Some(Target { sensor, instance: instance.parse().ok() })
        });
        answer(&|study| study.target = target);
    };
    let named = |kind: SensorKind, instance: Option<u32>| match instance {
        Some(number) => names::instance(kind, number),
        None => format!("one {}, drawn", names::sensor(kind)),
    };
    let typed = move |label: &'static str,
                      unit: Signal<String>,
                      read: fn(&Study) -> &String,
                      write: fn(&mut Study) -> &mut String,
                      unused: fn(&Study) -> Option<&'static str>| {
        view! {
            <label class="field" title=move || study.with(unused)><span>{label} " " <small>{unit}</small></span>
                <input
                    type="text" inputmode="decimal" autocomplete="off"
                    disabled=move || study.with(unused).is_some()
                    prop:value=move || study.with(|study| read(study).clone())
                    on:input:target=move |e| { let value = e.target().value(); answer(&|study| write(study).clone_from(&value)); }
                />
            </label>
        }
    };
    let fixed = |unit: &'static str| Signal::derive(move || unit.to_owned());
    let tick = move |label: String, on: Signal<bool>, set: Box<dyn Fn(bool)>| {
        view! {
            <label class="tick"><input type="checkbox" prop:checked=on on:change:target=move |e| set(e.target().checked()) />{label}</label>
        }
    };
    let listed =
        move |word: String, label: String, of: fn(&mut Study) -> &mut Vec<String>, has: fn(&Study) -> &Vec<String>| {
            let own = word.clone();
            let on = Signal::derive(move || study.with(|study| has(study).contains(&own)));
            let set = move |checked: bool| answer(&|study| choice::choose(of(study), word.clone(), checked));
            tick(label, on, Box::new(set))
        };
    view! {
        <details class="study">
            <summary>"From what this vehicle has"</summary>
            <form aria-label="Plan from this vehicle" on:submit=|e| e.prevent_default()>
                <label class="field wide"><span>"attacked"</span>
                    <select on:change:target=move |e| choose_target(e.target().value())>
                        <option value="none" selected=move || study.with(|study| study.target.is_none())>"nothing"</option>
                        {move || targets.get().into_iter().map(|(kind, instance)| view! {
                            <option
                                value=format!("{}/{}", kind as i32, instance.map_or_else(|| "drawn".to_owned(), |n| n.to_string()))
                                selected=move || study.with(|study| study.target == Some(Target { sensor: kind, instance }))
                            >{named(kind, instance)}</option>
                        }).collect::<Vec<_>>()}
                    </select>
                </label>
                <label class="field wide"><span>"channel"</span>
                    <EnumSelect
                        name=names::attack_channel
                        offered=channels
                        chosen=move || study.with(|study| study.channel)
                        choose=move |channel| answer(&|study| study.channel = channel)
                    />
                </label>
                <label class="field wide"><span>"kind"</span>
                    <EnumSelect
                        name=names::attack_kind
                        offered=names::ATTACK_KINDS.to_vec()
                        chosen=move || study.with(|study| study.kind)
                        disabled=move || study.with(|study| study.target.is_none())
                        choose=move |kind| answer(&|study| study.kind = kind)
                    />
                </label>
                {typed("sizes", Signal::derive(move || unit.get().unwrap_or_default()), |s| &s.sizes, |s| &mut s.sizes, |s| s.target.is_none().then_some("Nothing is attacked"))}
                {typed("altitudes", fixed("m"), |s| &s.altitudes, |s| &mut s.altitudes, |_| None)}
                {typed("each for", fixed("s"), |s| &s.hold_s, |s| &mut s.hold_s, |_| None)}
                {typed("repeats", fixed(""), |s| &s.repeats, |s| &mut s.repeats, |_| None)}
                {typed("first seed", fixed(""), |s| &s.seed, |s| &mut s.seed, |_| None)}
                <fieldset><legend>"estimators"</legend>
                    {move || estimators.get().into_iter().map(|kind| {
                        listed(names::estimator_json(kind), kind.title().to_owned(), |s| &mut s.estimators, |s| &s.estimators)
                    }).collect::<Vec<_>>()}
                </fieldset>
                <fieldset><legend>"worlds"</legend>
                    {WORLDS.map(|world| listed(world.to_owned(), world.to_owned(), |s| &mut s.worlds, |s| &s.worlds))}
                </fieldset>
                <fieldset><legend>"rigs"</legend>
                    {[0, 1].map(|n| {
                        let on = Signal::derive(move || study.with(|study| study.rigs[n]));
                        tick(RIGS[n].to_owned(), on, Box::new(move |checked| answer(&|study| study.rigs[n] = checked)))
                    })}
                </fieldset>
                <Show when=move || !refusal.with(String::is_empty)><p class="bad wide" role="alert">{refusal}</p></Show>
            </form>
        </details>
    }
}

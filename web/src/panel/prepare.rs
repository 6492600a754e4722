//! Attacks that know the model, prepared by the ground, and what is expected of the draft before it is sent.

use std::time::Duration;

use leptos::{leptos_dom::helpers::TimeoutHandle, prelude::*};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use serde_json::json;

use crate::{
    ctx::{Ctx, ctx},
    model::{choice, curves::DEGREES, draft::Draft, format, live::Live},
    net,
};

/// What is expected is asked for when the draft has stood still this long.
const SETTLE: Duration = Duration::from_millis(300);
/// Generators: name on the wire, name for people.
const GENERATORS: [(&str, &str); 4] = [
    ("optimal", "optimal, unseen"),
    ("stealthy_bias", "stealthy bias"),
    (UPWARDS, "zero dynamics"),
    ("covert", "covert motion"),
];
/// What one pushes: axis and deviation on the wire, name for people.
const PUSHED: [(Option<(&str, &str)>, &str); 7] = [
    (None, "altitude"),
    (Some(("x", "tilt")), "pitch"),
    (Some(("y", "tilt")), "roll"),
    (Some(("x", "velocity")), "velocity along x"),
    (Some(("y", "velocity")), "velocity along y"),
    (Some(("x", "position")), "position along x"),
    (Some(("y", "position")), "position along y"),
];
/// There is none of these along x and y.
const UPWARDS: &str = "zero_dynamics";
/// Those that are told how large they may be, and may attack the rotors.
const COMMANDED: [&str; 2] = [UPWARDS, "covert"];
/// Prepared ones begin so long after acceptance, s.
const START_S: f64 = 5.0;

/// Asked with what the lanes measure of the vehicle's accelerometers now: the more there is, the later those attacked are seen.
async fn ask(ctx: Ctx, mut question: AttackQuestion) -> Result<PreparedAttack, String> {
    let shaken = |live: &Live| live.secure.get().map(|status| [status.accel_noise_mps2, status.accel_rectified_mps2]);
    [question.of.noise_mps2, question.of.rectified_mps2] = untrack(|| ctx.live(shaken)).unwrap_or_default();
    let vehicle = ctx.app.with_value(|app| app.vehicle.clone()).unwrap_or_default();
    let url = format!("/api/v1/envelope/attack?vehicle={}", String::from(js_sys::encode_uri_component(&vehicle)));
    let answer = net::json::<PreparedAttack>("POST", &url, Some(json!(question).to_string()), "").await;
    answer.map_err(|failure| failure.text)
}

/// How far it moves along a horizontal axis.
fn aside(found: &PreparedAttack) -> impl Iterator<Item = String> {
    let all = [
        found.tilt_rad.map(|rad| format!("{}°", format::fixed(rad * DEGREES, 2))),
        found.velocity_mps.map(|mps| format!("{} cm/s", format::fixed(100.0 * mps, 1))),
        found.position_m.map(|m| format!("{} cm", format::fixed(100.0 * m, 1))),
    ];
    all.into_iter().flatten()
}

/// How surely the judges of the lanes exclude somebody or find the heights in contradiction, and how far the vehicle moves; `None` where that is not known.
fn judged(found: &PreparedAttack) -> Option<String> {
    let percent = format::fixed(100.0 * found.probability?, 0);
    let aside: Vec<String> = aside(found).collect();
    let moves = match found.altitude_m {
        Some(most_m) => format!("; until then the altitude moves up to {} cm", format::fixed(100.0 * most_m, 1)),
        None if aside.is_empty() => String::new(),
        None => format!("; unseen it would move up to {}", aside.join(", ")),
    };
    Some(format!(
        "With lanes in the loop an exclusion or a contradiction is expected in {percent} % of flights{moves}."
    ))
}

/// One line on what is expected of a draft.
fn told(expected: &PreparedAttack) -> String {
    let note = &expected.note;
    match (expected.attacks.as_slice(), expected.probability) {
        // By a closed form, which the note names.
        ([one], Some(part)) if one.sensor == "rotor" || one.kind == "replay" => {
            format!("Expected in {} % of flights: {note}.", format::fixed(100.0 * part, 0))
        }
        _ => judged(expected).map_or_else(|| note.clone(), |text| format!("{text} {note}").trim_end().to_owned()),
    }
}

/// What is said of a prepared attack besides that.
fn remark(found: &PreparedAttack) -> String {
    let pushed: String = aside(found).map(|far| format!("Moves it up to {far}: ")).collect();
    format!("{pushed}{}", found.note)
}

/// Attacks as the ground prepared them, and what it expects of all of them: it judges no thrust that rotors add unless it has
/// prepared it.
pub type Prepared = (Vec<Draft>, String);

/// What is known of `drafts` without asking: they are those that were prepared, all and alone.
fn known(prepared: Option<&Prepared>, drafts: &[Draft]) -> Option<String> {
    prepared.filter(|(of, _)| of == drafts).map(|(_, text)| text.clone())
}

/// What is expected of the draft.
#[component]
pub fn ExpectedLine(
    /// Attacks written so far.
    drafts: RwSignal<Vec<Draft>>,
) -> impl IntoView {
    let ctx = ctx();
    let line = RwSignal::new(String::new());
    let (asked, waiting) = (StoredValue::new(0_u64), StoredValue::new(None::<TimeoutHandle>));
    Effect::new(move |_| {
        let attacks: Vec<_> = drafts.with(|all| all.iter().zip(1..).map(|(draft, seed)| draft.body(seed)).collect());
        let number = asked.get_value() + 1;
        asked.set_value(number);
        if let Some(handle) = waiting.get_value() {
            handle.clear();
        }
        let known = ctx.prepared.with_untracked(|prepared| drafts.with(|all| known(prepared.as_ref(), all)));
        let asks = known.is_none() && !attacks.is_empty();
        line.set(known.unwrap_or_default());
        if !asks {
            return;
        }
        let send = move || {
            leptos::task::spawn_local(async move {
                let answer = ask(ctx, AttackQuestion { attacks, ..AttackQuestion::default() }).await;
                // An older draft's answer says nothing about this one.
                if asked.try_get_value() == Some(number) {
                    let _ =
                        line.try_set(answer.map_or_else(|why| format!("Nothing is expected: {why}"), |one| told(&one)));
                }
            });
        };
        waiting.set_value(set_timeout_with_handle(send, SETTLE).ok());
    });
    view! { <p class="quiet num" aria-live="polite">{move || line.get()}</p> }
}

/// The form that has attacks prepared.
#[component]
pub fn Prepare(
    /// Where they are added.
    drafts: RwSignal<Vec<Draft>>,
) -> impl IntoView {
    let ctx = ctx();
    let (generator, pushed) = (RwSignal::new(0_usize), RwSignal::new(0_usize));
    let named = move || GENERATORS.get(generator.get()).map_or("", |(name, _)| *name);
    let chosen = RwSignal::new(vec!["height 2".to_owned()]);
    let (duration, accel) = (RwSignal::new("10".to_owned()), RwSignal::new("0.02".to_owned()));
    let (refusal, busy) = (RwSignal::new(String::new()), RwSignal::new(false));
    let note = RwSignal::new(String::new());
    let sensors = Memo::new(move |_| {
        ctx.live(|live| {
            let all = live.description.get().map(|told| told.sensors.clone()).unwrap_or_default();
            let bounded =
                all.iter().filter(|s| matches!(s.kind(), SensorKind::Height | SensorKind::Imu | SensorKind::MocapPose));
            let rotors = live.description.get().filter(|told| !told.actuators.is_empty()).map(|_| "rotors".to_owned());
            bounded.map(|s| SensorId::new(s.kind(), s.instance as u8).to_string()).chain(rotors).collect::<Vec<_>>()
        })
    });
    let choose = move |name: String, on: bool| chosen.update(|all| choice::choose(all, name, on));
    let prepare = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let number = |name: &str, text: RwSignal<String>| {
            text.with_untracked(|text| format::parse_number(text)).map_err(|why| format!("{name}: {why}"))
        };
        let question = number("duration", duration).and_then(|horizon_s| {
            let (name, _) = GENERATORS.get(generator.get_untracked()).copied().unwrap_or_default();
            let aside = PUSHED.get(pushed.get_untracked()).and_then(|(aside, _)| *aside).filter(|_| name != UPWARDS);
            // The vehicle may have no sensor of a name that was chosen.
            let offered = sensors.get_untracked();
            let attacked = chosen.get_untracked().into_iter().filter(|name| offered.contains(name)).collect();
            let of = EnvelopeQuestion {
                sensors: Some(attacked),
                horizon_s: Some(horizon_s),
                axis: aside.map(|(axis, _)| axis.to_owned()),
                ..EnvelopeQuestion::default()
            };
            let deviation = aside.map(|(_, deviation)| deviation.to_owned());
            let accel_mps2 = if COMMANDED.contains(&name) { Some(number("acceleration", accel)?) } else { None };
            let generator = Some(name.to_owned());
            Ok(AttackQuestion { of, generator, deviation, accel_mps2, start_s: START_S, ..AttackQuestion::default() })
        });
        let question = match question {
            Ok(question) => question,
            Err(why) => return refusal.set(why),
        };
        refusal.set(String::new());
        note.set(String::new());
        busy.set(true);
        leptos::task::spawn_local(async move {
            let answer = ask(ctx, question).await;
            let _ = busy.try_set(false);
            match answer {
                Ok(found) => {
                    let attacks: Vec<Draft> = found.attacks.iter().filter_map(Draft::prepared).collect();
                    let whole = !attacks.is_empty() && attacks.len() == found.attacks.len();
                    ctx.prepared.set(judged(&found).filter(|_| whole).map(|text| (attacks.clone(), text)));
                    let _ = drafts.try_update(|all| all.extend(attacks));
                    let _ = note.try_set(remark(&found));
                }
                Err(why) => {
                    let _ = refusal.try_set(why);
                }
            }
        });
    };
    view! {
        <details class="attack-prepare">
            <summary>"Attacks that know the model"</summary>
            <form class="attack-form" on:submit=prepare aria-label="Prepared attack">
                <label class="field wide"><span>"generator"</span>
                    <select on:change:target=move |e| generator.set(e.target().value().parse().unwrap_or_default())>
                        {GENERATORS.iter().enumerate().map(|(i, (_, name))| view! { <option value=i.to_string()>{*name}</option> }).collect::<Vec<_>>()}
                    </select>
                </label>
                <label class="field wide"><span>"pushes"</span>
                    <select
                        disabled=move || named() == UPWARDS
                        on:change:target=move |e| pushed.set(e.target().value().parse().unwrap_or_default())
                    >
                        {PUSHED.iter().enumerate().map(|(i, (_, name))| view! { <option value=i.to_string()>{*name}</option> }).collect::<Vec<_>>()}
                    </select>
                </label>
                <fieldset class="field wide">
                    <legend>"attacked"</legend>
                    {move || sensors.get().into_iter().map(|name| {
                        let (is, set) = (name.clone(), name.clone());
                        view! {
                            <label><input
                                type="checkbox"
                                prop:checked=move || chosen.with(|all| all.contains(&is))
                                on:change:target=move |e| choose(set.clone(), e.target().checked())
                            />{name}</label>" "
                        }
                    }).collect::<Vec<_>>()}
                </fieldset>
                <label class="field"><span>"duration " <small>"s"</small></span>
                    <input type="text" inputmode="decimal" autocomplete="off"
                        prop:value=move || duration.get() on:input:target=move |e| duration.set(e.target().value()) />
                </label>
                <label class="field"><span>"acceleration " <small>"m/s²"</small></span>
                    <input type="text" inputmode="decimal" autocomplete="off"
                        disabled=move || !COMMANDED.contains(&named())
                        prop:value=move || accel.get() on:input:target=move |e| accel.set(e.target().value()) />
                </label>
                <button type="submit" disabled=busy>{move || if busy.get() { "Preparing…" } else { "Prepare" }}</button>
                <p class="bad" role="alert">{move || refusal.get()}</p>
                <p class="quiet num" aria-live="polite">{move || note.get()}</p>
            </form>
        </details>
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_rest::command::PlannedAttack;

    fn attack(sensor: &str, kind: &str) -> PlannedAttack {
        let (sensor, kind, channel) = (sensor.to_owned(), kind.to_owned(), "all".to_owned());
        PlannedAttack { sensor, instance: 2, kind, channel, duration_s: 5.0, ..PlannedAttack::default() }
    }

    #[test]
    fn what_is_expected_is_one_line_and_what_is_not_says_why() {
        let expected =
            PreparedAttack { probability: Some(0.887), altitude_m: Some(0.0241), ..PreparedAttack::default() };
        assert_eq!(
            told(&expected),
            "With lanes in the loop an exclusion or a contradiction is expected in 89 % of flights; until then the altitude moves up to 2.4 cm."
        );
        let aside = PreparedAttack {
            probability: Some(0.03),
            tilt_rad: Some(0.0161),
            velocity_mps: Some(0.021),
            note: "More.".into(),
            ..PreparedAttack::default()
        };
        assert_eq!(
            told(&aside),
            "With lanes in the loop an exclusion or a contradiction is expected in 3 % of flights; unseen it would move up to 0.92°, 2.1 cm/s. More."
        );
        let note = PreparedAttack { note: "nothing is expected of replay".into(), ..PreparedAttack::default() };
        assert_eq!(told(&note), "nothing is expected of replay");
        let rotor = PreparedAttack {
            attacks: vec![attack("rotor", "scale")],
            probability: Some(0.996),
            note: "rotor 2 isolated".into(),
            ..PreparedAttack::default()
        };
        assert_eq!(told(&rotor), "Expected in 100 % of flights: rotor 2 isolated.");
    }

    #[test]
    fn what_was_prepared_with_rotors_is_expected_of_the_draft_as_it_came() {
        let found = PreparedAttack {
            attacks: vec![attack("height", "bias"), attack("rotor", "bias")],
            probability: Some(0.02),
            altitude_m: Some(0.35),
            note: "Held.".to_owned(),
            ..PreparedAttack::default()
        };
        assert_eq!(remark(&found), "Held.");
        let text = judged(&found).unwrap();
        assert_eq!(
            text,
            "With lanes in the loop an exclusion or a contradiction is expected in 2 % of flights; until then the altitude moves up to 35.0 cm."
        );
        let drafts: Vec<Draft> = found.attacks.iter().filter_map(Draft::prepared).collect();
        assert_eq!(drafts.len(), 2);
        let prepared = (drafts.clone(), text.clone());
        assert_eq!(known(Some(&prepared), &drafts), Some(text));
        // Of part of them, or of more, the ground is asked.
        assert_eq!(known(Some(&prepared), &drafts[..1]), None);
        assert_eq!(known(Some(&prepared), &[&drafts[..], &drafts[..1]].concat()), None);
        assert_eq!(known(None, &drafts), None);
        // A healthy sensor hears of the motion: how far it goes then is not known.
        let heard = PreparedAttack { altitude_m: None, probability: Some(0.95), ..found };
        let text = "With lanes in the loop an exclusion or a contradiction is expected in 95 % of flights.";
        assert_eq!(judged(&heard).as_deref(), Some(text));
    }

    #[test]
    fn what_is_pushed_aside_is_said_before_the_note() {
        let aside = PreparedAttack { tilt_rad: Some(0.0161), note: "95 %.".into(), ..PreparedAttack::default() };
        assert_eq!((remark(&aside).as_str(), judged(&aside)), ("Moves it up to 0.92°: 95 %.", None));
    }
}

//! Attacks that know the model, prepared by the ground, and what is expected of the draft before it is sent.

use std::time::Duration;

use leptos::{leptos_dom::helpers::TimeoutHandle, prelude::*};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use serde_json::json;

use crate::{
    ctx::{Ctx, ctx},
    model::{curves::DEGREES, draft::Draft, format},
    net,
};

/// What is expected is asked for when the draft has stood still this long.
const SETTLE: Duration = Duration::from_millis(300);
const OPTIMAL: &str = "optimal";
/// Generators: name on the wire, name for people.
const GENERATORS: [(&str, &str); 4] = [
    (OPTIMAL, "optimal, unseen"),
    ("stealthy_bias", "stealthy bias"),
    ("zero_dynamics", "zero dynamics"),
    ("covert", "covert motion"),
];
/// What an optimal one pushes: axis and deviation on the wire, name for people.
const PUSHED: [(Option<(&str, &str)>, &str); 7] = [
    (None, "altitude"),
    (Some(("x", "tilt")), "pitch"),
    (Some(("y", "tilt")), "roll"),
    (Some(("x", "velocity")), "velocity along x"),
    (Some(("y", "velocity")), "velocity along y"),
    (Some(("x", "position")), "position along x"),
    (Some(("y", "position")), "position along y"),
];
/// Those that are told how large they may be, and may attack the rotors.
const COMMANDED: [&str; 2] = ["zero_dynamics", "covert"];
/// Prepared ones begin so long after acceptance, s.
const START_S: f64 = 5.0;

async fn ask(ctx: Ctx, question: AttackQuestion) -> Result<PreparedAttack, String> {
    let vehicle = ctx.app.with_value(|app| app.vehicle.clone()).unwrap_or_default();
    let url = format!("/api/v1/envelope/attack?vehicle={}", String::from(js_sys::encode_uri_component(&vehicle)));
    let answer = net::json::<PreparedAttack>("POST", &url, Some(json!(question).to_string()), "").await;
    answer.map_err(|failure| failure.text)
}

/// One line on what is expected.
fn told(expected: &PreparedAttack) -> String {
    match (expected.probability, expected.altitude_m) {
        (Some(part), Some(most_m)) => format!(
            "With lanes in the loop an exclusion is expected in {} % of flights; the altitude moves up to {} cm.",
            format::fixed(100.0 * part, 0),
            format::fixed(100.0 * most_m, 1)
        ),
        (Some(part), None) => {
            format!("Expected in {} % of flights: {}.", format::fixed(100.0 * part, 0), expected.note)
        }
        _ => expected.note.clone(),
    }
}

/// What is said of a prepared attack besides what is expected of the draft: of one on rotors that is here.
fn remark(found: &PreparedAttack) -> String {
    let rotors = found.attacks.iter().any(|attack| attack.sensor == "rotor");
    let expected = match (found.probability.filter(|_| rotors), found.altitude_m) {
        (Some(part), Some(most_m)) => format!(
            " A sensor is expected to be excluded in {} % of flights; the altitude moves {} cm.",
            format::fixed(100.0 * part, 0),
            format::fixed(100.0 * most_m, 1)
        ),
        (Some(part), None) => {
            format!(" A sensor is expected to be excluded in {} % of flights.", format::fixed(100.0 * part, 0))
        }
        _ => String::new(),
    };
    let aside = [
        found.tilt_rad.map(|rad| format!("{}°", format::fixed(rad * DEGREES, 2))),
        found.velocity_mps.map(|mps| format!("{} cm/s", format::fixed(100.0 * mps, 1))),
        found.position_m.map(|m| format!("{} cm", format::fixed(100.0 * m, 1))),
    ];
    let pushed: String = aside.into_iter().flatten().map(|far| format!("Moves it up to {far}: ")).collect();
    format!("{pushed}{}{expected}", found.note)
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
        line.set(String::new());
        if attacks.is_empty() {
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
            let bounded = all.iter().filter(|s| matches!(s.kind(), SensorKind::Height | SensorKind::Imu));
            let rotors = live.description.get().filter(|told| !told.actuators.is_empty()).map(|_| "rotors".to_owned());
            bounded.map(|s| SensorId::new(s.kind(), s.instance as u8).to_string()).chain(rotors).collect::<Vec<_>>()
        })
    });
    let choose = move |name: String, on: bool| {
        chosen.update(|all| {
            all.retain(|one| *one != name);
            if on {
                all.push(name);
            }
        });
    };
    let prepare = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let number = |name: &str, text: RwSignal<String>| {
            text.with_untracked(|text| format::parse_number(text)).map_err(|why| format!("{name}: {why}"))
        };
        let question = number("duration", duration).and_then(|horizon_s| {
            let (name, _) = GENERATORS.get(generator.get_untracked()).copied().unwrap_or_default();
            let aside = PUSHED.get(pushed.get_untracked()).and_then(|(aside, _)| *aside).filter(|_| name == OPTIMAL);
            let of = EnvelopeQuestion {
                sensors: Some(chosen.get_untracked()),
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
                    let prepared = found.attacks.iter().filter_map(Draft::prepared);
                    let _ = drafts.try_update(|all| all.extend(prepared));
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
                        disabled=move || named() != OPTIMAL
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

    #[test]
    fn what_is_expected_is_one_line_and_what_is_not_says_why() {
        let expected =
            PreparedAttack { probability: Some(0.887), altitude_m: Some(0.0241), ..PreparedAttack::default() };
        assert_eq!(
            told(&expected),
            "With lanes in the loop an exclusion is expected in 89 % of flights; the altitude moves up to 2.4 cm."
        );
        let note = PreparedAttack { note: "nothing is expected of replay".into(), ..PreparedAttack::default() };
        assert_eq!(told(&note), "nothing is expected of replay");
        let rotor =
            PreparedAttack { probability: Some(0.996), note: "rotor 2 isolated".into(), ..PreparedAttack::default() };
        assert_eq!(told(&rotor), "Expected in 100 % of flights: rotor 2 isolated.");
        let attacks = vec![PlannedAttack { sensor: "rotor".into(), ..PlannedAttack::default() }];
        let note = "Held.".to_owned();
        let prepared = PreparedAttack {
            attacks,
            probability: Some(0.02),
            altitude_m: Some(0.35),
            note,
            ..PreparedAttack::default()
        };
        let said = "Held. A sensor is expected to be excluded in 2 % of flights; the altitude moves 35.0 cm.";
        assert_eq!(remark(&prepared), said);
        let aside = PreparedAttack { tilt_rad: Some(0.0161), note: "95 %.".into(), ..PreparedAttack::default() };
        assert_eq!(remark(&aside), "Moves it up to 0.92°: 95 %.");
        // What sensors have added is expected of the draft.
        assert_eq!(remark(&PreparedAttack { attacks: Vec::new(), ..prepared }), "Held.");
    }
}

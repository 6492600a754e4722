//! Re-estimate: another estimator, or fewer sensors, over what was recorded; laid over the charts, errors in a table.

use leptos::prelude::*;
use plumbline_proto::v1::EstimatorKind;

use crate::{
    deck::deck,
    model::{
        api::{Again, Score},
        choice, format, names,
    },
    net,
    panel::waiting::Waiting,
};

/// Estimators that run over a recording: the complementary filter is there to be compared with in flight.
pub(super) fn estimators() -> impl Iterator<Item = EstimatorKind> {
    EstimatorKind::all().filter(|kind| *kind != EstimatorKind::Complementary)
}

/// Sensors that may be left out: name in the request, name on screen, topic in a flight. IMUs are always needed; the
/// magnetometers are part of them.
const SENSORS: [(&str, &str, &str); 6] = [
    ("mag", "magnetometers", "/sensor/imu"),
    ("height", "heights", "/sensor/height"),
    ("barometer", "barometer", "/sensor/barometer"),
    ("gnss", "GNSS", "/sensor/gnss"),
    ("mocap-pose", "mocap pose", "/sensor/mocap_pose"),
    ("camera-ranges", "camera ranges", "/sensor/camera_ranges"),
];

/// The sensors of [`SENSORS`] that a flight with these topics has.
fn recorded(topics: &[String]) -> Vec<(&'static str, &'static str)> {
    let has = |topic: &str| topics.iter().any(|t| t.strip_prefix(topic).is_some_and(|rest| rest.starts_with('/')));
    SENSORS.into_iter().filter(|(_, _, topic)| has(topic)).map(|(name, label, _)| (name, label)).collect()
}

/// What to ask the ground for; `chosen` of `offered`.
fn question(id: &str, estimator: EstimatorKind, offered: &[&str], chosen: &[&str]) -> String {
    let all = offered.iter().all(|name| chosen.contains(name));
    let sensors = if all { String::new() } else { format!("&sensors={}", [&["imu"], chosen].concat().join(",")) };
    format!("/api/v1/flights/{id}/estimate?estimator={}{sensors}", names::estimator_json(estimator))
}

/// Estimators that were run again, and what came of it.
type Done = Vec<(EstimatorKind, String, Score)>;

/// The card.
#[component]
pub(super) fn Reestimate(
    /// The flight.
    id: String,
    /// Its topics.
    topics: Vec<String>,
) -> impl IntoView {
    let deck = deck();
    let offered = recorded(&topics);
    let all: Vec<&'static str> = offered.iter().map(|(name, _)| *name).collect();
    let estimator = RwSignal::new(EstimatorKind::Ukf);
    let chosen = RwSignal::new(all.clone());
    let done = RwSignal::new(Done::new());
    let working = RwSignal::new(false);
    let problem = RwSignal::new(String::new());
    let choose = move |value: String| {
        if let Some(kind) = value.parse().ok().and_then(|n: i32| EstimatorKind::try_from(n).ok()) {
            estimator.set(kind);
        }
    };
    let run = move |_| {
        let kind = estimator.get_untracked();
        let sensors = chosen.get_untracked();
        let url = question(&id, kind, &all, &sensors);
        let without: Vec<&str> =
            SENSORS.into_iter().filter(|s| all.contains(&s.0) && !sensors.contains(&s.0)).map(|s| s.1).collect();
        let from = if without.is_empty() { String::new() } else { format!("without {}", without.join(", ")) };
        working.set(true);
        problem.set(String::new());
        leptos::task::spawn_local(async move {
            let answer = net::json::<Again>("GET", &url, None, "").await;
            // The page may have been left meanwhile.
            if working.try_set(false).is_some() {
                return;
            }
            match answer {
                Ok(again) => {
                    deck.data.update_value(|live| live.curves.set_again(kind as u16, &again.curves));
                    done.update(|done| {
                        done.retain(|(known, ..)| *known != kind);
                        done.push((kind, from, again.score));
                    });
                }
                Err(failure) => problem.set(failure.text),
            }
        });
    };
    let remove = move |kind: EstimatorKind| {
        deck.data.update_value(|live| live.curves.remove_again(kind as u16));
        done.update(|done| done.retain(|(known, ..)| *known != kind));
    };
    view! {
        <section class="card facts again" aria-label="Re-estimate">
            <header><h2>"Re-estimate"</h2></header>
            <div class="row">
                <select class="small" aria-label="Estimator to run over the recording" on:change:target=move |e| choose(e.target().value())>
                    {estimators().map(|k| view! {
                        <option value=(k as i32).to_string() selected=k == EstimatorKind::Ukf>{k.title()}</option>
                    }).collect_view()}
                </select>
                <button type="button" class="small" disabled=working on:click=run>
                    "Re-estimate"
                </button>
            </div>
            <Show when=move || working.get()><Waiting text="The ground runs it over the recording…" /></Show>
            <fieldset class="checks">
                <legend class="quiet">"from the IMUs and"</legend>
                {offered.into_iter().map(|(name, label)| {
                    let toggle = move |on: bool| chosen.update(|chosen| choice::choose(chosen, name, on));
                    view! { <label class="check"><input type="checkbox" checked=true on:change:target=move |e| toggle(e.target().checked()) /> {label}</label> }
                }).collect_view()}
            </fieldset>
            <Show when=move || !problem.with(String::is_empty)>
                <p class="bad" role="alert">{problem}</p>
            </Show>
            {move || {
                let done = done.get();
                if done.is_empty() {
                    view! { <p class="quiet">"The ground runs it over what the estimators received in flight; the result is drawn dashed over the charts."</p> }.into_any()
                } else {
                    view! { <Scores done remove=Callback::new(remove) /> }.into_any()
                }
            }}
        </section>
    }
}

/// Errors against truth, one row per estimator.
#[component]
fn Scores(done: Done, remove: Callback<EstimatorKind>) -> impl IntoView {
    let truth = done.iter().any(|(.., s)| s.inclination_rmse_deg.is_some());
    view! {
        <table class="dense">
            <thead><tr>
                <th>"RMS error"</th>
                <th class="num" title="Altitude">"z mm"</th>
                <th class="num" title="Vertical speed">"vz mm/s"</th>
                <th class="num" title="Heading">"head. °"</th>
                <th class="num" title="Inclination: roll and pitch together">"incl. °"</th>
                <th></th>
            </tr></thead>
            <tbody>
                {done.into_iter().map(|(kind, from, score)| {
                    let name = kind.title();
                    let milli = |v: Option<f64>| format::maybe(v.map(|v| v * 1e3), 0);
                    let nees = score.nees.zip(score.nees_states).map(|(value, states)| format!("NEES {} of {states}", format::fixed(value, 1)));
                    let title = [Some(from.clone()).filter(|f| !f.is_empty()), nees].into_iter().flatten().collect::<Vec<_>>().join(", ");
                    view! {
                        <tr>
                            <th scope="row">{name}<small class="quiet block">{title}</small></th>
                            <td class="num">{milli(score.position_rmse_xyz_m[2])}</td>
                            <td class="num">{milli(score.velocity_rmse_xyz_mps[2])}</td>
                            <td class="num">{format::maybe(score.heading_rmse_deg, 2)}</td>
                            <td class="num">{format::maybe(score.inclination_rmse_deg, 2)}</td>
                            <td><button type="button" class="small" aria-label=format!("Take {name} off the charts") on:click=move |_| remove.run(kind)>"×"</button></td>
                        </tr>
                    }
                }).collect_view()}
            </tbody>
        </table>
        {(!truth).then(|| view! { <p class="quiet">"No truth in this flight: nothing to measure errors against."</p> })}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_names_sensors_only_when_some_are_left_out() {
        let topics = ["/sensor/imu/1", "/sensor/height/2", "/estimate/1", "/sensor/heights"].map(str::to_owned);
        let offered: Vec<&str> = recorded(&topics).into_iter().map(|(name, _)| name).collect();
        assert_eq!(offered, ["mag", "height"]);
        let all = question("f1", EstimatorKind::EkfBias, &offered, &["height", "mag"]);
        assert_eq!(all, "/api/v1/flights/f1/estimate?estimator=ekf_bias");
        assert!(
            question("f1", EstimatorKind::Ukf, &offered, &["height"]).ends_with("estimator=ukf&sensors=imu,height")
        );
        assert!(question("f1", EstimatorKind::Ukf, &offered, &[]).ends_with("&sensors=imu"));
    }
}

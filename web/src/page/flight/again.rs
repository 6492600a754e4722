//! Fly again: the exact command that flies a recording under another estimator or attack schedule.

use leptos::prelude::*;
use plumbline_proto::v1::EstimatorKind;
use plumbline_rest::flight::Flight;

use crate::{
    app::GroundState,
    ctx::ctx,
    model::{names, route::Route},
    panel::toolbar::Link,
};

/// Estimators that a recording can be flown under.
const ESTIMATORS: [EstimatorKind; 6] = [
    EstimatorKind::EkfBias,
    EstimatorKind::Secure,
    EstimatorKind::Lanes,
    EstimatorKind::EkfHybrid,
    EstimatorKind::Ukf,
    EstimatorKind::ConstantAcceleration,
];

/// A path as a shell takes it.
fn quoted(path: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '/' | '-' | '_' | '.');
    if path.chars().all(plain) { path.to_owned() } else { format!("'{}'", path.replace('\'', r"'\''")) }
}

fn command(folder: &str, id: &str, estimator: Option<EstimatorKind>, attacked: bool) -> String {
    let mut out = format!("plumbline-agent --vehicle replay {}", quoted(&format!("{folder}/flights/{id}.mcap")));
    if let Some(kind) = estimator {
        out.push_str(&format!(" --estimator {}", names::estimator_json(kind)));
    }
    if attacked {
        out.push_str(" --attack-schedule attacks.toml");
    }
    out
}

/// The card.
#[component]
pub fn FlyAgain(flight: Flight) -> impl IntoView {
    let ctx = ctx();
    let id = flight.id;
    let folder = Memo::new(move |_| {
        ctx.app(|app| match &app.ground {
            GroundState::Up(ground) => ground.data_folder.clone(),
            _ => "data".to_owned(),
        })
    });
    let chosen = RwSignal::new(None::<EstimatorKind>);
    let attacked = RwSignal::new(false);
    let text = move || command(&folder.get(), &id, chosen.get(), attacked.get());
    let choose = move |value: String| {
        chosen.set(value.parse().ok().and_then(|n: i32| EstimatorKind::try_from(n).ok()).filter(|k| *k as i32 != 0));
    };
    view! {
        <section class="card facts again" aria-label="Fly again">
            <header><h2>"Fly again"</h2></header>
            <div class="row">
                <select class="small" aria-label="Fly again under estimator" on:change:target=move |e| choose(e.target().value())>
                    <option value="0">"as it flew"</option>
                    {ESTIMATORS.map(|k| view! { <option value=(k as i32).to_string()>{names::estimator(k)}</option> }).collect_view()}
                </select>
                <label class="check"><input type="checkbox" prop:checked=attacked on:change:target=move |e| attacked.set(e.target().checked()) /> "other attacks"</label>
            </div>
            <p><code class="wrap">{text}</code></p>
            <p class="quiet">"It appears on Fly at the speed you choose; R records it. Then select both in " <Link to=Route::Flights>"Flights"</Link> " to overlay them."</p>
        </section>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_survives_a_shell() {
        let plain = command("/srv/data", "20260131-iris-1", None, false);
        assert_eq!(plain, "plumbline-agent --vehicle replay /srv/data/flights/20260131-iris-1.mcap");
        let spaced = command("/my data", "f1", Some(EstimatorKind::Secure), true);
        assert!(spaced.contains("'/my data/flights/f1.mcap' --estimator secure --attack-schedule"), "{spaced}");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}

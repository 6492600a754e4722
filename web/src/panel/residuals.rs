//! Residuals: a row per sensor instance, coloured by innovation / gate; a click opens its channels.

use leptos::prelude::*;
use plumbline_proto::v1::{Channel, EstimatorKind, SensorKind};

use super::{
    errors::Errors,
    legend::{Entry, Legend},
    plot::Plot,
    secure::SecureCard,
    signals::SignalsCard,
    velocity::VelocityCard,
};
use crate::{
    deck::{Picture, Source, deck},
    model::{curves::Curve, format, layout::Evidence as Shown, names},
    net, palette,
};

/// Ratio at which a residual is worth a look.
const NOTICE: f64 = 0.5;
/// Ratio at which it is close to its gate.
const WARN: f64 = 0.8;

fn level(ratio: Option<f64>) -> &'static str {
    match ratio {
        None => "none",
        Some(r) if r > 1.0 => "rejected",
        Some(r) if r > WARN => "high",
        Some(r) if r > NOTICE => "raised",
        Some(_) => "calm",
    }
}

/// Residuals, the secure estimator's account, or the errors, in one place. The account opens by itself when the secure
/// estimator takes the loop, instead of the residuals.
#[component]
pub fn Evidence() -> impl IntoView {
    let deck = deck();
    let secure = Memo::new(move |_| deck.read(|live| i32::from(live.in_loop()) == EstimatorKind::Secure as i32));
    Effect::new(move |before: Option<bool>| {
        let now = secure.get();
        let by_itself = matches!(deck.evidence.get_untracked(), Shown::Residuals | Shown::Secure);
        if before.is_some_and(|before| before != now) && by_itself {
            deck.evidence.set(if now { Shown::Secure } else { Shown::Residuals });
        }
        now
    });
    move || match deck.evidence.get() {
        Shown::Residuals => view! { <Residuals /> }.into_any(),
        Shown::Secure => view! { <SecureCard /> }.into_any(),
        Shown::Errors => view! { <Errors /><VelocityCard /> }.into_any(),
        Shown::Signals => view! { <SignalsCard /> }.into_any(),
    }
}

/// What stands here instead of the residuals: errors, or the secure estimator's sensors where it runs.
#[component]
pub fn EvidenceSwitch() -> impl IntoView {
    let deck = deck();
    let runs = Memo::new(move |_| deck.read(|live| live.secure.get().is_some()));
    let button = move |name: &'static str, title: &'static str, shown: Shown| {
        view! {
            <button
                type="button"
                class="small"
                title=title
                aria-pressed=move || (deck.evidence.get() == shown).to_string()
                on:click=move |_| deck.evidence.update(|e| *e = if *e == shown { Shown::Residuals } else { shown })
            >{name}</button>
        }
    };
    view! {
        {button("Errors", "Each estimator minus truth, or minus the setpoint where truth is not known", Shown::Errors)}
        <Show when=move || runs.get()>
            {button("Secure", "Attacked set, margins and certificate of the secure estimator", Shown::Secure)}
        </Show>
        {button("Signals", "Any number of any topic, on a chart of its own", Shown::Signals)}
    }
}

/// The residual card.
#[component]
fn Residuals() -> impl IntoView {
    let deck = deck();
    let estimator = Memo::new(move |_| {
        deck.residuals_of.track();
        deck.read(|live| deck.residual_estimator(live))
    });
    let offered = Memo::new(move |_| {
        deck.read(|live| {
            let mut numbers: Vec<u16> = live.residuals.keys().map(|key| key.0).collect();
            numbers.dedup();
            numbers
        })
    });
    view! {
        <section class="card chart residuals" aria-label="Residuals">
            <header>
                <h2>"Residuals" <small>"innovation / gate"</small></h2>
                {move || deck.residual.get().map(|(sensor, instance)| {
                    let sensor = SensorKind::try_from(sensor).unwrap_or_default();
                    view! {
                        <button type="button" class="small" on:click=move |_| deck.residual.set(None)>"← all sensors"</button>
                        <b class="which">{names::instance(sensor, instance)}</b>
                    }
                })}
                <Show when=move || deck.residual.get().is_none()>
                    <ul class="legend heat-key" aria-label="Colours">
                        <li><span class="heat raised"></span>"0.5"</li>
                        <li><span class="heat high"></span>"0.8"</li>
                        <li><span class="heat rejected"></span>"1: gate"</li>
                    </ul>
                </Show>
                <span class="push buttons-row"><EvidenceSwitch /></span>
                <Show when=move || { offered.get().len() > 1 }>
                    <select
                        class="small"
                        aria-label="Residuals of estimator"
                        on:change:target=move |e| deck.residuals_of.set(e.target().value().parse().unwrap_or(0))
                    >
                        <option value="0" selected=move || deck.residuals_of.get() == 0>"in loop"</option>
                        {move || offered.get().into_iter().map(|n| view! {
                            <option value=n.to_string() selected=move || deck.residuals_of.get() == n>{names::estimator_numbered(n)}</option>
                        }).collect::<Vec<_>>()}
                    </select>
                </Show>
            </header>
            {move || match deck.residual.get() {
                Some((sensor, instance)) => view! { <Channels sensor instance estimator /> }.into_any(),
                None => view! { <Rows estimator /> }.into_any(),
            }}
        </section>
    }
}

/// All sensors, a row each.
#[component]
fn Rows(estimator: Memo<u16>) -> impl IntoView {
    let deck = deck();
    let rows = Memo::new(move |_| {
        let estimator = estimator.get();
        deck.read(|live| live.residual_rows(estimator))
    });
    let row = move |(sensor, instance): (i32, u32)| {
        let kind = SensorKind::try_from(sensor).unwrap_or_default();
        let name = names::instance(kind, instance);
        let at = move || deck.reading_s();
        let reading = Memo::new(move |_| {
            let (number, at) = (estimator.get(), at());
            deck.read(|live| match at {
                Some(time) => {
                    let ratio = live.curves.value_at(Curve::Worst(number, sensor, instance), time);
                    ratio.map(|r| (r, String::new(), false))
                }
                None => live.worst_residual(number, sensor, instance, net::now_ms()).map(|(r, old)| {
                    let channel = if kind == SensorKind::Height { "" } else { names::channel(r.channel()) };
                    (r.ratio, channel.to_owned(), old)
                }),
            })
        });
        let ratio = move || reading.get().map(|(r, ..)| r);
        // What was has no colour.
        let fresh = move || reading.get().filter(|(.., old)| !old).map(|(r, ..)| r);
        let open = move |_| deck.residual.set(Some((sensor, instance)));
        view! {
            <li class="res-row">
                <button type="button" class="res-name" title="Show every channel with its gate" on:click=open>
                    <span><span class="visually-hidden">"Residuals of "</span>{name}</span>
                    <span class="res-channel" aria-hidden="true">{move || reading.get().map(|(_, c, _)| c)}</span>
                </button>
                <span class=move || format!("res-value num {}", level(fresh()))>
                    {move || format::maybe(ratio().map(|r| r.min(99.99)), 2)}
                </span>
            </li>
        }
    };
    view! {
        <div class="res-body">
            <ul class="res-list" style=move || format!("--rows:{}", rows.get().len().max(1))>
                <For each=move || rows.get() key=|r| *r children=row />
            </ul>
            <Plot
                picture=Picture::Heatmap
                values=false
                label="Innovation ratio of each sensor over time; 1 is its gate"
            />
            <Show when=move || rows.get().is_empty()>
                <p class="empty">
                    {if deck.source == Source::Live {
                        "No residuals yet: they come with the estimator's first measurements."
                    } else {
                        "This recording holds no residuals."
                    }}
                </p>
            </Show>
        </div>
    }
}

/// One sensor, a curve per channel.
#[component]
fn Channels(sensor: i32, instance: u32, estimator: Memo<u16>) -> impl IntoView {
    let deck = deck();
    let entries = Memo::new(move |_| {
        let number = estimator.get();
        deck.read(|live| {
            let channels = live
                .curves
                .names()
                .filter_map(|c| match c {
                    Curve::Innovation(key) if (key.0, key.1, key.2) == (number, sensor, instance) => Some(key),
                    _ => None,
                })
                .enumerate();
            let mut entries = Vec::new();
            for (i, key) in channels {
                let channel = Channel::try_from(key.3).unwrap_or_default();
                let (unit, _) = names::channel_unit(channel);
                let (stroke, name) = (palette::series(i), format!("{} {unit}", names::channel(channel)));
                entries.push(Entry { curve: Curve::Innovation(key), name, stroke });
                // Each has the colour of what it judges.
                let (name, stroke) = ("gate ±".to_owned(), stroke.dashed());
                entries.push(Entry { curve: Curve::Gate(key), name, stroke });
            }
            entries
        })
    });
    // One axis for all channels: it has a unit where they have.
    let units = deck.data.with_value(|live| {
        let keys = live.residuals.keys().filter(|key| (key.1, key.2) == (sensor, instance));
        let mut units: Vec<_> =
            keys.map(|key| names::channel_unit(Channel::try_from(key.3).unwrap_or_default()).0).collect();
        units.dedup();
        units
    });
    let unit = if let [one] = units.as_slice() { *one } else { "" };
    view! {
        <div class="chart-body">
            <Legend entries name="Innovations" unit="" decimals=3 picture=Picture::Residual />
            <Plot picture=Picture::Residual unit label="Innovation of each channel over time, with its gate" />
        </div>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_change_at_half_at_four_fifths_and_at_the_gate() {
        let levels = [None, Some(0.5), Some(0.51), Some(0.81), Some(1.0), Some(1.01)].map(level);
        assert_eq!(levels, ["none", "calm", "raised", "high", "high", "rejected"]);
    }
}

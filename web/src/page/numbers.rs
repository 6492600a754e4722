//! Without graphics: the same facts as numbers.

use leptos::prelude::*;
use plumbline_proto::v1::{Channel, SensorKind};

use crate::{
    ctx::ctx,
    model::{curves::Curve, format, names},
    net,
    panel::steps::summary,
};

/// Altitudes, residuals and steps in tables.
#[component]
pub fn Numbers() -> impl IntoView {
    let ctx = ctx();
    let altitudes = move || {
        ctx.live(|live| {
            live.curves
                .names()
                .filter_map(|curve| {
                    let name = match curve {
                        Curve::SetpointAltitude => "setpoint".to_owned(),
                        Curve::Altitude(n) => names::estimator_numbered(n).to_owned(),
                        Curve::Height(i) => format!("height {i}"),
                        Curve::TruthAltitude => "truth".to_owned(),
                        _ => return None,
                    };
                    Some((name, format::maybe(live.curves.newest(curve), 3), live.has_ended(curve, net::now_ms())))
                })
                .collect::<Vec<_>>()
        })
    };
    let residuals = move || {
        ctx.live(|live| {
            let estimator = live.in_loop();
            live.residual_rows(estimator)
                .into_iter()
                .filter_map(|(sensor, instance)| {
                    let (worst, old) = live.worst_residual(estimator, sensor, instance, net::now_ms())?;
                    let kind = SensorKind::try_from(sensor).unwrap_or_default();
                    let (unit, factor) = names::channel_unit(worst.channel());
                    let channel = names::channel(Channel::try_from(worst.channel).unwrap_or_default());
                    let value = format!("{} {unit}", format::signed(worst.innovation * factor, 3));
                    let gate = format!("±{} {unit}", format::fixed(worst.gate * factor, 3));
                    Some((
                        names::instance(kind, instance),
                        channel,
                        value,
                        gate,
                        format::fixed(worst.ratio, 2),
                        worst.accepted,
                        old,
                    ))
                })
                .collect::<Vec<_>>()
        })
    };
    let steps = move || {
        ctx.live(|live| live.log.steps.iter().rev().take(5).map(|s| (s.from_m, s.to_m, summary(s))).collect::<Vec<_>>())
    };
    view! {
        <section class="card numbers" aria-label="Altitudes">
            <h2>"Altitude" <small>"m"</small></h2>
            <table>
                <tbody>{move || altitudes().into_iter().map(|(n, v, old)| view! { <tr class:stale=old><th scope="row">{n}</th><td class="num">{v}</td></tr> }).collect::<Vec<_>>()}</tbody>
            </table>
            <h2>"Residuals" <small>"worst channel of each sensor"</small></h2>
            <table>
                <thead><tr><th>"sensor"</th><th>"channel"</th><th class="num">"innovation"</th><th class="num">"gate"</th><th class="num">"ratio"</th><th></th></tr></thead>
                <tbody>{move || residuals().into_iter().map(|(s, c, v, g, r, ok, old)| view! {
                    <tr class:bad=!ok class:stale=old><th scope="row">{s}</th><td>{c}</td><td class="num">{v}</td><td class="num">{g}</td><td class="num">{r}</td><td>{if ok { "" } else { "rejected" }}</td></tr>
                }).collect::<Vec<_>>()}</tbody>
            </table>
            <h2>"Steps"</h2>
            <table>
                <tbody>{move || steps().into_iter().map(|(from, to, text)| view! {
                    <tr><th scope="row">{format!("{} → {} m", format::fixed(from, 2), format::fixed(to, 2))}</th><td class="num">{text}</td></tr>
                }).collect::<Vec<_>>()}</tbody>
            </table>
        </section>
    }
}

//! What the design would do: steps on the nonlinear vehicle, poles, margins, motors, change of K.

use leptos::prelude::*;
use plumbline_proto::v1::StepResponse;
use plumbline_rest::design::{Flown, Policy, Preview};

use super::Bench;
use crate::{
    model::{
        curves::{Curve, DEGREES},
        format::{self, NONE},
        tuning::{Entry, INPUTS, gains_table, rate_of},
    },
    palette,
    panel::{
        sketch::{Dot, Drawing, Sketch, Trace},
        steps,
        waiting::Waiting,
    },
};

/// A setpoint within this of another is the same, m.
const SAME_M: f64 = 0.01;
/// Faster poles are told in words, 1/s.
const FASTEST_SHOWN_PER_S: f64 = 40.0;

fn answered(bench: Bench) -> Option<Preview> {
    bench.preview.with(|p| p.as_ref().and_then(|p| p.as_ref().ok().cloned()))
}

/// What stands in the place of a preview while there is none.
#[component]
fn NoPreview() -> impl IntoView {
    let bench: Bench = expect_context();
    move || match bench.preview.get() {
        Some(Err(why)) => view! { <p class="bad blank" role="alert">{format!("No preview: {why}")}</p> }.into_any(),
        None => view! { <Waiting text="The ground computes the preview with the agent's own library…" /> }.into_any(),
        Some(Ok(_)) => ().into_any(),
    }
}

/// Values from where the vehicle was, in the unit of the page.
fn points(t: &[Option<f64>], values: &[Option<f64>], begin: f64, factor: f64) -> Vec<[f64; 2]> {
    let known = |v: Option<f64>| v.unwrap_or(f64::NAN);
    t.iter().zip(values).map(|(t, v)| [known(*t), (known(*v) - begin) * factor]).collect()
}

/// The newest measured altitude step: its figures, and its curve relative to where it began.
fn measured(bench: Bench) -> Option<(StepResponse, Vec<[f64; 2]>)> {
    bench.ctx.live(|live| {
        let step = live.log.steps.back().copied()?;
        let start = step.start_time_us as f64 * 1e-6;
        let series = live.curves.get(Curve::Altitude(live.in_loop()))?;
        // What was asked for next is no part of it.
        let asked = live.curves.get(Curve::SetpointAltitude);
        let end = asked.map_or(f64::INFINITY, |asked| asked.leaves(step.to_m, SAME_M, start));
        let range = series.lower_bound(start)..series.upper_bound(end.min(start + super::DURATION_S));
        // A point every 20 ms is finer than the picture.
        let every = ((range.end.saturating_sub(range.start)) / 300).max(1);
        let all = series.samples(range).enumerate().filter(|(i, _)| (*i as u64).is_multiple_of(every));
        Some((step, all.map(|(_, (t, z))| [t - start, f64::from(z) - step.from_m]).collect()))
    })
}

/// Steps of the four outputs.
#[component]
pub(super) fn Responses() -> impl IntoView {
    let bench: Bench = expect_context();
    let newest = Memo::new(move |_| measured(bench));
    let drawing = move |output: &'static str| {
        Signal::derive(move || {
            let Some(preview) = answered(bench) else { return Drawing::default() };
            let Some(flown) = preview.steps.iter().find(|s| s.output == output) else { return Drawing::default() };
            let (factor, unit) = if flown.unit == "rad" { (DEGREES, "°") } else { (1.0, "m") };
            let begin = flown.response.first().copied().flatten().unwrap_or(0.0);
            let trace = |values: &[Option<f64>], color, dashed| Trace {
                points: points(&flown.t_s, values, begin, factor),
                color,
                dashed,
            };
            let mut traces = vec![trace(&flown.setpoint, palette::SETPOINT.css(), true)];
            traces.push(trace(&flown.response, palette::IN_LOOP.css(), false));
            if output == "z"
                && let Some((_, points)) = newest.get()
            {
                traces.push(Trace { points, color: palette::OTHER_1.css(), dashed: false });
            }
            Drawing {
                traces,
                least: [1.0, 0.05],
                fixed: [Some([0.0, super::DURATION_S]), None],
                units: ["s".into(), unit.into()],
                ..Drawing::default()
            }
        })
    };
    let figures = move |output: &'static str| {
        answered(bench).and_then(|p| p.steps.iter().find(|s| s.output == output).map(step_figures)).unwrap_or_default()
    };
    let unanswered = move || answered(bench).is_none();
    let panel = move |output: &'static str, name: &'static str| {
        view! {
            <figure class="tune-step">
                <figcaption><b>{name}</b> " " <span class="num quiet">{move || figures(output)}</span></figcaption>
                <Sketch label=format!("Predicted step response, {name}") drawing=drawing(output) size=[300.0, 128.0] />
            </figure>
        }
    };
    view! {
        <section class="card tune-steps" aria-label="Step responses" class:stale=move || !bench.fresh.get()>
            <header>
                <h2>"Step responses" <small>"nonlinear model, profile included"</small></h2>
                <ul class="legend">
                    <li><i class="swatch dashed" style="--swatch:var(--setpoint)"></i>"setpoint"</li>
                    <li><i class="swatch" style="--swatch:var(--in-loop)"></i>"predicted"</li>
                    {move || newest.with(Option::is_some).then(|| view! {
                        <li><i class="swatch" style="--swatch:var(--other-1)"></i>"measured"</li>
                    })}
                </ul>
            </header>
            <NoPreview />
            <div class="tune-grid" hidden=unanswered>
                {panel("z", "altitude")} {panel("yaw", "yaw")} {panel("x", "east")} {panel("y", "north")}
            </div>
            <p class="tune-measured num" class:good=move || newest.with(Option::is_some) aria-label="Measured beside predicted">
                {move || match newest.get() {
                    None => "Measured: no altitude step in this flight yet. Step the altitude on Fly, then compare here.".to_owned(),
                    Some((step, _)) => format!(
                        "Measured {} → {} m: {}",
                        format::fixed(step.from_m, 2), format::fixed(step.to_m, 2), steps::summary(&step)
                    ),
                }}
            </p>
        </section>
    }
}

fn step_figures(step: &Flown) -> String {
    if step.stayed == Some(false) {
        return "leaves the range it may fly in".to_owned();
    }
    let seconds = |v: Option<f64>| v.map_or_else(|| NONE.to_owned(), |v| format!("{} s", format::fixed(v, 2)));
    let saturated = step.saturated_s.filter(|s| *s > 0.0);
    format!(
        "rise {} · over {} % · settle {}{}",
        seconds(step.rise_time_s),
        format::maybe(step.overshoot_percent, 1),
        seconds(step.settling_time_s),
        saturated.map_or_else(String::new, |s| format!(" · motors cut short {} s", format::fixed(s, 2))),
    )
}

/// Poles of both loops: as designed (crosses), and with lag and delay (discs).
fn poles(preview: &Preview) -> (Drawing, usize) {
    let mut faster = 0;
    let mut dots = Vec::new();
    for (examined, color) in [(&preview.position, palette::IN_LOOP.css()), (&preview.attitude, palette::OTHER_2.css())]
    {
        let designed = examined.continuous_poles_per_s.iter().map(|p| (*p, true));
        let sampled = examined.sampled_poles.iter().map(|p| (*p, false));
        for (pole, cross) in designed.chain(sampled) {
            let [Some(re), Some(im)] = pole else { continue };
            let at = if cross { [re, im] } else { rate_of([re, im], preview.tick_rate_hz) };
            if at[0] < -FASTEST_SHOWN_PER_S || !at.iter().all(|v| v.is_finite()) {
                faster += 1;
            } else {
                dots.push(Dot { at, color, cross });
            }
        }
    }
    let reach = dots.iter().map(|d| d.at[1].abs()).fold(5.0, f64::max) * 1.1;
    let right = dots.iter().map(|d| d.at[0]).fold(1.0, f64::max) * 1.2;
    let fixed = [Some([-FASTEST_SHOWN_PER_S, right]), Some([-reach, reach])];
    (Drawing { dots, fixed, units: ["1/s".into(), "rad/s".into()], ..Drawing::default() }, faster)
}

/// Poles, margins, motors, change.
#[component]
pub(super) fn Loops() -> impl IntoView {
    let bench: Bench = expect_context();
    let drawn = Memo::new(move |_| answered(bench).map(|p| poles(&p)).unwrap_or_default());
    view! {
        <section class="card tune-loops" aria-label="Poles and margins" class:stale=move || !bench.fresh.get()>
            <header>
                <h2>"Poles" <small>"× designed, ● with motor lag and delay; left is stable"</small></h2>
                <ul class="legend">
                    <li><i class="swatch" style="--swatch:var(--in-loop)"></i>"position"</li>
                    <li><i class="swatch" style="--swatch:var(--other-2)"></i>"attitude"</li>
                </ul>
            </header>
            <div class="tune-split" hidden=move || answered(bench).is_none()>
                <div>
                    <Sketch label="Closed-loop poles on the plane" drawing=Signal::derive(move || drawn.get().0) size=[300.0, 190.0] />
                    <p class="quiet num">{move || match drawn.get().1 { 0 => String::new(), n => format!("{n} faster than {FASTEST_SHOWN_PER_S} 1/s not shown") }}</p>
                </div>
                <div class="tune-tables">
                    {move || answered(bench).map(|p| view! { <Margins preview=p.clone() /> <Gains preview=p /> })}
                </div>
            </div>
        </section>
    }
}

/// Factors of a margin: "×2.1", "none" where there is no limit.
fn factor(value: Option<f64>) -> String {
    value.map_or_else(|| "no limit".to_owned(), |v| format!("×{}", format::fixed(v, 2)))
}

fn row_class(good: bool) -> &'static str {
    if good { "num" } else { "num bad" }
}

#[component]
fn Margins(preview: Preview) -> impl IntoView {
    let Policy {
        gain_up_min,
        gain_down_max,
        phase_min_rad,
        delay_min_s,
        sensitivity_max,
        unit_step_max,
        change_max,
        ..
    } = preview.policy.clone();
    let rows = preview.position.margins.clone().into_iter().map(move |m| {
        let phase = m.phase_rad.map_or_else(|| "no limit".to_owned(), |v| format!("{}°", format::fixed(v * DEGREES, 0)));
        let delay = m.delay_s.map_or_else(|| "no limit".to_owned(), |v| format!("{} ms", format::fixed(v * 1e3, 0)));
        view! {
            <tr>
                <th scope="row">{m.input.clone()}</th>
                <td class=row_class(m.gain_up.is_none_or(|v| v >= gain_up_min))>{factor(m.gain_up)}</td>
                <td class=row_class(m.gain_down.is_none_or(|v| v <= gain_down_max))>{m.gain_down.filter(|v| *v >= 0.005).map_or_else(|| "no limit".to_owned(), |v| factor(Some(v)))}</td>
                <td class=row_class(m.phase_rad.is_none_or(|v| v >= phase_min_rad))>{phase}</td>
                <td class=row_class(m.delay_s.is_none_or(|v| v >= delay_min_s))>{delay}</td>
                <td class=row_class(m.peak_sensitivity.is_none_or(|v| v <= sensitivity_max))>{format::maybe(m.peak_sensitivity, 2)}</td>
            </tr>
        }
    });
    let need = format!(
        "{}: at least ×{} and ×{} down, {}°, {} ms, sensitivity at most {}",
        preview.policy.name,
        format::fixed(gain_up_min, 2),
        format::fixed(gain_down_max, 2),
        format::fixed(phase_min_rad * DEGREES, 0),
        format::fixed(delay_min_s * 1e3, 0),
        format::fixed(sensitivity_max, 1),
    );
    let shares = preview.unit_step.iter().map(|s| {
        let share = s.share.unwrap_or(f64::NAN);
        let one = if s.unit == "rad" { "1 rad" } else { "1 m" };
        let text = format!("{} {one}: ×{}", s.output, format::fixed(share, 1));
        view! { <span class=row_class(share <= unit_step_max)>{text}</span> }
    });
    let change = preview.change.as_ref().map(|c| {
        let row = c.row.clone().unwrap_or_default();
        let share = c.largest.unwrap_or(f64::NAN);
        let each: Vec<String> =
            c.rows.iter().map(|(name, v)| format!("{name} {} %", format::maybe(v.map(|v| v * 100.0), 0))).collect();
        view! {
            <p title=each.join(", ")>"Change of K against the one in use: "
                <span class=row_class(share <= change_max)>{format!("{} %", format::fixed(share * 100.0, 0))}</span>
                <span class="quiet">{if share > 0.0 { format!(" ({row})") } else { " (the same)".to_owned() }}</span>
            </p>
        }
    });
    view! {
        <table class="dense">
            <thead><tr><th>"margin of"</th><th class="num">"gain up"</th><th class="num">"down"</th><th class="num">"phase"</th><th class="num">"delay"</th><th class="num" title="Peak of the sensitivity">"peak S"</th></tr></thead>
            <tbody>{rows.collect::<Vec<_>>()}</tbody>
        </table>
        <p class="quiet">{need}</p>
        <p title="Share of the motors' room that an uncut step asks for at once; above 1 they saturate. The profile that flies asks for less.">"Motors for a step of " <span class="tune-shares">{shares.collect::<Vec<_>>()}</span></p>
        {change}
    }
}

/// K against the K in use.
#[component]
fn Gains(preview: Preview) -> impl IntoView {
    let table = gains_table(&preview);
    if table.is_empty() {
        return ().into_any();
    }
    let compared = preview.k_in_use.is_some();
    let rows = table.into_iter().map(|(name, entries)| {
        let cells = entries.into_iter().map(|Entry { new, in_use, changed }| {
            let before = changed.then(|| view! { <small class="quiet">"now " {in_use}</small> });
            view! { <td class="num" class:changed=changed>{new}{before}</td> }
        });
        view! { <tr><th scope="row">{name}</th>{cells.collect::<Vec<_>>()}</tr> }
    });
    let heads = INPUTS.iter().map(|(name, unit, _)| {
        view! { <th class="num" title=format!("{unit} for one m, rad, m/s, rad/s")>{*name}</th> }
    });
    view! {
        <details class="tune-gains">
            <summary>{if compared { "K against the K in use" } else { "K (what is in use has none to compare with)" }}</summary>
            <div class="table-wrap">
                <table class="dense" aria-label="K against the K in use">
                    <thead><tr><th>"of"</th>{heads.collect::<Vec<_>>()}</tr></thead>
                    <tbody>{rows.collect::<Vec<_>>()}</tbody>
                </table>
            </div>
        </details>
    }
    .into_any()
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_rest::design::Examined;

    #[test]
    fn fast_poles_are_counted_and_unstable_ones_stay_in_the_picture() {
        let preview = Preview {
            tick_rate_hz: 200.0,
            position: Examined {
                continuous_poles_per_s: vec![
                    [Some(-3.0), Some(2.0)],
                    [Some(-300.0), Some(0.0)],
                    [Some(4.0), Some(0.0)],
                ],
                sampled_poles: vec![[Some(0.99), Some(0.0)], [Some(0.0), Some(0.0)]],
                ..Examined::default()
            },
            ..Preview::default()
        };
        let (drawing, faster) = poles(&preview);
        assert_eq!((drawing.dots.len(), faster), (3, 2));
        assert!(drawing.fixed[0].is_some_and(|[low, high]| low == -40.0 && high > 4.0));
    }

    #[test]
    fn a_step_that_leaves_says_so() {
        assert!(step_figures(&Flown { stayed: Some(false), ..Flown::default() }).contains("leaves"));
        let fine =
            Flown { rise_time_s: Some(0.5), overshoot_percent: Some(3.0), saturated_s: Some(0.1), ..Flown::default() };
        assert_eq!(step_figures(&fine), "rise 0.50 s · over 3.0 % · settle — · motors cut short 0.10 s");
    }
}

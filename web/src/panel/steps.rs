//! The measured response to each setpoint step, written onto the altitude chart and into a table.

use leptos::prelude::*;
use plumbline_proto::v1::StepResponse;

use crate::{
    deck::deck,
    model::{
        axis::TimeAxis,
        format::{self, NONE},
    },
};

/// "rise 0.42 s · over 3 % · settle 1.1 s · error +2 mm"; what the next step cut short says so.
pub fn summary(step: &StepResponse) -> String {
    let seconds = |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), |s| format!("{} s", format::fixed(s, 2)));
    let rise = seconds(step.rise_time_s);
    if step.interrupted {
        return format!("rise {rise} · over {} % · interrupted", format::fixed(step.overshoot_percent, 1));
    }
    let error = step.steady_error_m.map_or_else(|| NONE.to_owned(), |e| format!("{} mm", format::signed(e * 1e3, 0)));
    format!(
        "rise {rise} · over {} % · settle {} · error {error}",
        format::fixed(step.overshoot_percent, 1),
        seconds(step.settling_time_s),
    )
}

/// The parts of a summary, each kept on one line when the stretch is narrow.
fn pieces(text: &str) -> Vec<impl IntoView + use<>> {
    let parts: Vec<String> = text.split(" · ").map(str::to_owned).collect();
    let last = parts.len().saturating_sub(1);
    let tail = move |i: usize| if i < last { " · " } else { "" };
    parts.into_iter().enumerate().map(|(i, part)| view! { <span class="num">{part}</span>{tail(i)} }).collect()
}

/// A step as placed on the chart.
#[derive(Debug, Clone, PartialEq)]
struct Placed {
    start_us: u64,
    left: f64,
    width: f64,
    from_to: String,
    text: String,
    running: bool,
}

fn placed(steps: &[StepResponse], axis: TimeAxis) -> Vec<Placed> {
    let mut out = Vec::new();
    for (i, step) in steps.iter().enumerate() {
        let start = step.start_time_us as f64 * 1e-6;
        let end = steps.get(i + 1).map_or(axis.end_s, |next| next.start_time_us as f64 * 1e-6).min(axis.end_s);
        if end <= axis.start_s || start >= axis.end_s {
            continue;
        }
        let left = axis.fraction(start.max(axis.start_s));
        out.push(Placed {
            start_us: step.start_time_us,
            left,
            width: axis.fraction(end) - left,
            from_to: format!("{} → {} m", format::fixed(step.from_m, 2), format::fixed(step.to_m, 2)),
            text: summary(step),
            running: !step.finished,
        });
    }
    out
}

/// The steps in view, above their stretch of the chart.
#[component]
pub fn StepMarks() -> impl IntoView {
    let deck = deck();
    let steps = Memo::new(move |_| {
        deck.zoom.track();
        deck.window_s.track();
        deck.read(|live| {
            let axis = deck.axis(live);
            let steps: Vec<StepResponse> = live.log.steps.iter().copied().collect();
            placed(&steps, axis)
        })
    });
    let starts = move || steps.with(|all| all.iter().map(|s| s.start_us).collect::<Vec<_>>());
    view! {
        <div class="steps" role="list" aria-label="Step responses in view">
            <For each=starts key=|s| *s let:start>
                {
                    let step = Memo::new(move |_| steps.with(|all| all.iter().find(|s| s.start_us == start).cloned()));
                    let style = move || step.get().map_or_else(|| "display:none".to_owned(), |s| {
                        format!("left:{:.2}%;width:{:.2}%", s.left * 100.0, s.width * 100.0)
                    });
                    // Its place moves with every beat, what is written there does not.
                    let from_to = Memo::new(move |_| step.get().map(|s| s.from_to));
                    let text = Memo::new(move |_| step.get().map(|s| s.text));
                    view! {
                        <div class="step" role="listitem" style=style class:running=move || step.get().is_some_and(|s| s.running)>
                            <b class="num">{from_to}</b>
                            " "
                            <span class="figures">{move || text.get().map(|text| pieces(&text))}</span>
                        </div>
                    }
                }
            </For>
        </div>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(start_s: f64) -> StepResponse {
        StepResponse {
            start_time_us: (start_s * 1e6) as u64,
            from_m: 0.5,
            to_m: 0.8,
            rise_time_s: Some(0.42),
            overshoot_percent: 3.0,
            settling_time_s: None,
            steady_error_m: Some(-0.002),
            ..Default::default()
        }
    }

    #[test]
    fn a_step_is_read_in_one_line() {
        assert_eq!(summary(&step(0.0)), "rise 0.42 s · over 3.0 % · settle — · error \u{2212}2 mm");
        let cut_short = StepResponse { interrupted: true, ..step(0.0) };
        assert_eq!(summary(&cut_short), "rise 0.42 s · over 3.0 % · interrupted");
    }

    #[test]
    fn steps_share_the_axis_and_those_out_of_view_are_left_out() {
        let axis = TimeAxis::new(10.0, 20.0);
        let all = placed(&[step(1.0), step(5.0), step(15.0), step(30.0)], axis);
        assert_eq!(all.iter().map(|p| p.left).collect::<Vec<_>>(), [0.0, 0.5]);
        assert!((all[0].width - 0.5).abs() < 1e-12 && (all[1].width - 0.5).abs() < 1e-12);
    }
}

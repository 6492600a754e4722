//! `cargo xtask reproduce paternain`: the three experiments of [Paternain] VIII on the simulator, with our default
//! estimator and controller, beside what the paper reads off its Figures 8 to 10; then take-offs with its own suite, of which
//! `--flights N` flies so many of each row, `--quick` a tenth, `--seed-base N` others;
//! `--only roll|yaw|take_off|own_suite` flies one part.

pub mod take_offs;

use std::process::ExitCode;

use plumbline_support::effort::{Effort, Knows};
use plumbline_support::headless::paternain::{Answer, roll, take_off, yaw};
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

/// What the paper says of one figure of merit, and what is asked of us.
struct Figure {
    name: &'static str,
    unit: &'static str,
    paper: Option<f64>,
    limit: Option<f64>,
    value: fn(&Answer) -> Option<f64>,
}

struct Experiment {
    name: &'static str,
    title: &'static str,
    caption: &'static str,
    y: &'static str,
    /// Part of the curve that is drawn, s.
    window: (f64, f64),
    fly: fn(&dyn Fn(u64) -> u64) -> Answer,
    figures: &'static [Figure],
}

fn share(answer: &Answer) -> Option<f64> {
    Some(answer.overshoot / (answer.to - answer.from).abs() * 100.0)
}

const EXPERIMENTS: [Experiment; 3] = [
    Experiment {
        name: "roll",
        title: "VIII-A, Figure 8: roll let go",
        caption: "Single-axis rig, roll held at 20° for 0.4 s. The paper: rise 0.4 s, 3° or 4° beyond.",
        y: "roll, °",
        window: (-1.0, 4.0),
        fly: roll,
        figures: &[
            Figure { name: "held", unit: "deg", paper: Some(20.0), limit: None, value: |a| Some(a.from) },
            Figure { name: "rise", unit: "s", paper: Some(0.4), limit: Some(0.4), value: |a| a.rise_s },
            Figure { name: "overshoot", unit: "deg", paper: Some(4.0), limit: Some(4.0), value: |a| Some(a.overshoot) },
            Figure { name: "settled", unit: "s", paper: None, limit: None, value: |a| a.settled_s },
        ],
    },
    Experiment {
        name: "yaw",
        title: "VIII-B, Figure 9: yaw on strings",
        caption: "Thrust below lift-off on one string, yaw held aside for 1.2 s. The paper: rise 1.6 s, 13 % beyond.",
        y: "yaw, °",
        window: (-2.0, 12.0),
        fly: yaw,
        figures: &[
            Figure { name: "held", unit: "deg", paper: None, limit: None, value: |a| Some(a.from) },
            Figure { name: "rise", unit: "s", paper: Some(1.6), limit: Some(1.6), value: |a| a.rise_s },
            Figure { name: "overshoot", unit: "%", paper: Some(13.0), limit: Some(13.0), value: share },
            Figure { name: "settled", unit: "s", paper: None, limit: None, value: |a| a.settled_s },
            Figure { name: "final_error", unit: "deg", paper: None, limit: Some(2.0), value: |a| Some(a.final_error) },
        ],
    },
    Experiment {
        name: "take_off",
        title: "VIII-C, Figure 10: take-off to 1 m",
        caption: "Free flight from the floor. The paper: about a metre beyond.",
        y: "altitude, m",
        window: (-1.0, 14.0),
        fly: take_off,
        figures: &[
            Figure { name: "overshoot", unit: "m", paper: Some(1.0), limit: Some(0.1), value: |a| Some(a.overshoot) },
            Figure { name: "rise", unit: "s", paper: None, limit: None, value: |a| a.rise_s },
            Figure { name: "settled", unit: "s", paper: None, limit: None, value: |a| a.settled_s },
            Figure { name: "final_error", unit: "m", paper: None, limit: Some(0.05), value: |a| Some(a.final_error) },
        ],
    },
];

pub fn run() -> ExitCode {
    let effort = Effort::of_program(Knows { seed: 1, flights: Some([100, 10]), worlds: false, parts: true });
    let title = "Stability, orientation and take-off: [Paternain] VIII";
    let mut report = Report::open("reproduce", "paternain", title).unwrap();
    report.paragraph("Our default airframe, estimator and controller; figures are of the simulator's truth.");
    let mut rows = Vec::new();
    for experiment in EXPERIMENTS.iter().filter(|experiment| effort.wants(experiment.name)) {
        report.heading(experiment.title);
        let answer = (experiment.fly)(&|own| effort.seed(own));
        let (from, to) = experiment.window;
        let part = |of: &dyn Fn(&(f64, f64, f64)) -> f64| {
            answer.curve.iter().filter(|p| (from..=to).contains(&p.0)).map(|p| (p.0, of(p))).collect::<Vec<_>>()
        };
        let mut plot = Plot::new(experiment.title, "t, s", experiment.y)
            .with(Series::line("truth", part(&|p| p.1)))
            .with(Series::line("estimate", part(&|p| p.2)))
            .with(Series::dashed("target", vec![(from, answer.to), (to, answer.to)]));
        if experiment.name == "take_off" {
            plot = plot.with(Series::dashed("the paper's peak", vec![(from, 2.0), (to, 2.0)]));
        }
        report.figure(experiment.name, experiment.caption, &plot).unwrap();
        for figure in experiment.figures {
            let value = (figure.value)(&answer);
            let met = figure.limit.map(|limit| value.is_some_and(|v| v <= limit));
            let name = format!("{}/{}", experiment.name, figure.name);
            let more = json!({ "paper": figure.paper, "limit": figure.limit, "met": met });
            report.value(&name, value.unwrap_or(f64::NAN), figure.unit, more);
            let text = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
            rows.push(vec![name, figure.unit.to_owned(), text(figure.paper), text(value), text(figure.limit)]);
        }
    }
    if effort.wants("own_suite") {
        take_offs::take_offs(&mut report, &mut rows, &effort);
    }
    effort.is_done();
    let headers = ["figure", "unit", "paper", "ours", "asked of us, at most"];
    report.table("figures", "The paper's figures and ours", &headers, &rows).unwrap();
    report.finish().unwrap();
    ExitCode::SUCCESS
}

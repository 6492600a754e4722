//! `cargo xtask reproduce clinic`: [Clinic]'s figures and its Table 1 in closed loop, on the nonlinear simulator.
//!
//! `--quick` flies fewer seeds, `--seeds N` so many; `--only decoder|flights|phantom` runs one part. All cores;
//! figures as JSON lines, an HTML page with plots and CSV beside it.

mod decoder;
mod flight;
mod flights;
mod phantom;
mod sdof;

use std::process::ExitCode;

use plumbline_tests::report::Report;

/// How much of it.
pub struct Effort {
    /// Seeds of each flight.
    pub seeds: u64,
    /// Trials of each point of a figure.
    pub trials: u64,
}

pub fn run() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1));
    let quick = arguments.iter().any(|a| a == "--quick");
    let mut effort = if quick { Effort { seeds: 4, trials: 10 } } else { Effort { seeds: 20, trials: 50 } };
    if let Some(seeds) = value("--seeds") {
        effort.seeds = seeds.parse().expect("--seeds N");
    }
    let runs = |part: &str| value("--only").is_none_or(|only| only == part);
    let mut report =
        Report::open("reproduce", "clinic", "Secure state estimation: [Clinic] Figures 8 to 13 and Table 1").unwrap();
    report.paragraph(&format!(
        "{} seeds of each flight, {} trials of each point. Ratios are to e*, the tracking error of the plain EKF without attack.",
        effort.seeds, effort.trials
    ));
    if runs("decoder") {
        sdof::run(&mut report, &effort);
        decoder::run(&mut report, &effort);
    }
    if runs("flights") {
        flights::run(&mut report, &effort);
    }
    if runs("phantom") {
        phantom::run(&mut report);
    }
    report.finish().unwrap();
    ExitCode::SUCCESS
}

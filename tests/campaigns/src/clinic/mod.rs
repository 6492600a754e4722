//! `cargo xtask reproduce clinic`: [Clinic]'s figures and its Table 1 in closed loop, on the nonlinear simulator.
//!
//! `--quick` flies fewer seeds, `--flights N` so many, `--seed-base N` others, `--world NAME` elsewhere than in `datasheet`;
//! `--only decoder|offboard|flights|phantom` runs one part. All cores; figures as JSON lines, an HTML page with plots and CSV beside it.

mod decoder;
mod engines;
mod flight;
mod flights;
mod motion;
mod motor_curve;
mod off_board;
mod phantom;
mod random_systems;
mod sdof;

use std::process::ExitCode;

use plumbline_support::effort::{Effort as Asked, Knows};
use plumbline_tests::report::Report;

/// How much of it.
pub struct Effort {
    /// Flights of each kind, seeds and world.
    pub flown: Asked,
    /// Trials of each point of a figure.
    pub trials: u64,
}

impl Effort {
    /// Seeds of each flight.
    pub fn seeds(&self) -> usize {
        self.flown.flights as usize
    }

    /// The `n`th flight of a kind, from 0.
    pub fn plan(&self, rig: &'static str, profile: flight::Profile, n: usize, pilot: flight::Pilot) -> flight::Plan {
        flight::Plan {
            world: self.flown.world.clone(),
            ..flight::Plan::new(rig, profile, self.flown.seed_base + n as u64, pilot)
        }
    }
}

pub fn run() -> ExitCode {
    let flown = Asked::of_program(Knows { seed: 1, flights: Some([20, 4]), worlds: true, parts: true });
    let effort = Effort { trials: if flown.quick { 10 } else { 50 }, flown };
    let runs = |part: &str| effort.flown.wants(part);
    let mut report = Report::open(
        "reproduce",
        "clinic",
        "Secure state estimation: [Clinic] Figures 5 to 13, 16 to 18, 27, 30 and Table 1",
    )
    .unwrap();
    report.paragraph(&format!(
        "{} flights of each kind from seed {} in the world {}, {} trials of each point. Ratios are to e*, the tracking error of the \
         plain EKF without attack.",
        effort.flown.flights, effort.flown.seed_base, effort.flown.world, effort.trials
    ));
    deviations(&mut report);
    if runs("decoder") {
        motion::run(&mut report);
        sdof::run(&mut report, &effort);
        decoder::run(&mut report, &effort);
        random_systems::run(&mut report, &effort);
        motor_curve::run(&mut report, &effort);
        engines::run(&mut report, &effort);
    }
    if runs("offboard") {
        off_board::run(&mut report, &effort);
    }
    if runs("flights") {
        flights::run(&mut report, &effort);
    }
    if runs("phantom") {
        phantom::run(&mut report, &effort);
    }
    effort.flown.is_done();
    report.finish().unwrap();
    ExitCode::SUCCESS
}

/// What differs from the source, and why.
fn deviations(report: &mut Report) {
    let rows = [
        [
            "vehicle in Table 1",
            "about 1.6 kg with Jetson and Pixhawk, no coefficients given",
            "3DR Iris, 1.5 kg",
            "published coefficients",
        ],
        [
            "lasers",
            "two, for one height",
            "three, five, and two (rows _of_2)",
            "of two, none can be corrected (errata 11)",
        ],
        [
            "e*",
            "of the hardware, not given in numbers",
            "the plain EKF's of the same rig and seed without attack",
            "a figure to compare with",
        ],
        [
            "velocity",
            "accelerations integrated, as a sensor",
            "acceleration as an input with its bias",
            "the drift common to all is the source's own failure (6.2)",
        ],
        ["linear model", "about u = 0", "about hover", "at u = 0 tilt does not move the vehicle (errata 5)"],
        [
            "estimates",
            "10 Hz, the lasers' rate",
            "25 slots a second, brought to 200 Hz",
            "25 Hz are asked, and missed, by the source",
        ],
        [
            "control",
            "a pilot, or the Pixhawk",
            "altitude hold on strings or free",
            "Table 1 is about a closed loop, which the source did not close",
        ],
        [
            "Figure 12 (b), random systems",
            "of Fawzi et al., no figures printed",
            "n = 15, p = 20, T = 15, Gaussian, A over its spectral radius",
            "their sizes and scaling are not given",
        ],
        [
            "Figures 16 to 18, off board",
            "recordings of a vehicle flown by hand, a laser as the truth",
            "simulated, by altitude hold and a stick sideways, with the truth",
            "no recordings were given",
        ],
        [
            "Figure 27, rotor speed by pulse width",
            "eight points of a real motor, as a picture",
            "eight of the simulated one, linear but for the battery",
            "no numbers are printed",
        ],
        [
            "Figure 30, MATLAB against C",
            "CVX over the whole recording, CVXgen over ten slots",
            "Clarabel over the whole recording, Newton over ten slots",
            "two programs and two solvers, as there",
        ],
    ];
    let rows: Vec<Vec<String>> = rows.iter().map(|row| row.map(str::to_owned).to_vec()).collect();
    let headers = ["what", "[Clinic]", "here", "why"];
    report.table("deviations", "What differs from the source.", &headers, &rows).unwrap();
}

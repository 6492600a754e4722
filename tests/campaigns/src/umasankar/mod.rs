//! `cargo xtask reproduce umasankar`: Tables 3 to 5 of [Umasankar], four paths at six camera rates, our hybrid EKF and
//! UKF beside the paper's figures and beside the Cramér–Rao floor, and the literal Algorithm 1 failing.
//!
//! The source gives neither process noise nor IMU sigma. Two plants are flown: white acceleration and angular
//! acceleration of (0.02 m/s², 0.1 rad/s²)/√Hz, and a calmer one of (0.005, 0.02). `std` is the standard deviation
//! of the position error of a run at its update times, root mean square over the runs; NEES wants 12.

mod flights;
mod literal;
mod score;

use std::process::ExitCode;

use flights::{Flown, PATHS, Path};
use literal::Literal;
use plumbline_experiment::draw::parallel;
use plumbline_support::effort::{Effort, Knows};
use plumbline_tests::report::{Axis, Plot, Report, Series};
use score::{Cell, FILTERS, Tables};
use serde_json::json;

/// Camera rates, Hz.
pub const RATES_HZ: [usize; 6] = [120, 60, 24, 12, 6, 1];
/// Entries of Tables 3 to 5 that must be beaten, of 72.
const AHEAD_MIN: usize = 70;
/// Mean NEES of twelve states that is called consistent.
const NEES: std::ops::RangeInclusive<f64> = 10.0..=14.0;

/// How rough the plant is.
#[derive(Debug, Clone, Copy)]
pub struct Plant {
    /// In names of figures.
    pub name: &'static str,
    /// (m/s²)/√Hz.
    pub accel: f64,
    /// (rad/s²)/√Hz.
    pub turn: f64,
}

const PLANTS: [Plant; 2] =
    [Plant { name: "nominal", accel: 0.02, turn: 0.1 }, Plant { name: "calm", accel: 0.005, turn: 0.02 }];

/// As rough as three times the nominal one, and flown over by filters that assume the nominal one.
const UNKNOWN: Plant = Plant { name: "unknown", accel: 0.06, turn: 0.3 };

/// Tables 3, 4, 5: σ of x, y, z (m); rows 120 … 1 Hz, columns hover, circle, square, sine.
pub const PAPER: [[[f64; 4]; 6]; 3] = [
    [
        [0.0039932, 0.0085408, 0.0080575, 0.0049977],
        [0.0051788, 0.010278, 0.0096354, 0.0057264],
        [0.0056789, 0.013199, 0.011393, 0.0074061],
        [0.0074068, 0.014731, 0.012044, 0.0085448],
        [0.0081106, 0.016047, 0.012508, 0.0087954],
        [0.0095391, 0.029615, 0.015374, 0.013841],
    ],
    [
        [0.0040409, 0.0084944, 0.0080132, 0.0049065],
        [0.0052825, 0.010371, 0.0095661, 0.005823],
        [0.0056995, 0.012979, 0.011269, 0.0074443],
        [0.007463, 0.014687, 0.011893, 0.0089392],
        [0.0084155, 0.015925, 0.012634, 0.0087636],
        [0.0086878, 0.02909, 0.015167, 0.013621],
    ],
    [
        [0.0031726, 0.0030319, 0.0035243, 0.010083],
        [0.0028092, 0.0032654, 0.0040193, 0.012393],
        [0.0024405, 0.0036128, 0.004693, 0.015404],
        [0.0027021, 0.0046044, 0.0048127, 0.019746],
        [0.0024644, 0.0041818, 0.0056552, 0.017945],
        [0.01566, 0.01327, 0.0088481, 0.030748],
    ],
];
/// Names of the position's axes.
pub const AXES: [&str; 3] = ["x", "y", "z"];

pub fn run() -> ExitCode {
    let effort = Effort::of_program(Knows { seed: 0, flights: Some([20, 2]), worlds: false, parts: false });
    let title = "Motion capture: hybrid EKF and UKF of [Umasankar], Tables 3 to 5";
    let mut report = Report::open("reproduce", "umasankar", title).unwrap();
    report.paragraph(&format!(
        "{} flights of each path from seed {}, the same for both filters and every rate. Ranges with 1.5, 15, 2 and 100 mm of \
         noise, angles with 5 mrad (chosen; the source gives none). The floor is the Cramér–Rao bound along the true \
         flight. Two of the paper's entries (x and y, hover, 1 Hz) lie below the floor of their own sensors. At 1 Hz the rougher plant turns by 3° between measurements: first-order covariances are then \
         too small, the EKF's by a third, and the independent reference finds the same. Plant \"unknown\" is three times as \
         rough as the filters assume, and its floor too is that of the filters' assumption.",
        effort.flights, effort.seed_base
    ));
    for (plant, assumed) in [(PLANTS[0], PLANTS[0]), (PLANTS[1], PLANTS[1]), (UNKNOWN, PLANTS[0])] {
        let tables = fly_all(plant, assumed, &effort);
        show(&mut report, plant, &tables, &effort);
    }
    literal(&mut report, &effort);
    report.finish().unwrap();
    ExitCode::SUCCESS
}

/// Every path, run and rate on every core; the filters assume the plant `assumed`.
fn fly_all(plant: Plant, assumed: Plant, effort: &Effort) -> Tables {
    let runs = effort.seed_base..effort.seed_base + effort.flights;
    let jobs: Vec<_> = (0..PATHS.len()).flat_map(|path| runs.clone().map(move |run| (path, run))).collect();
    let scored = parallel(jobs.len(), |job| {
        let (path, run) = jobs[job];
        (path, score::score(&Flown::fly(PATHS[path], plant, run), assumed))
    });
    let mut tables = Tables::default();
    scored.into_iter().for_each(|(path, scored)| tables.take(path, scored));
    tables
}

fn show(report: &mut Report, plant: Plant, tables: &Tables, effort: &Effort) {
    report.heading(&format!("Plant \"{}\": {} m/s²/√Hz, {} rad/s²/√Hz", plant.name, plant.accel, plant.turn));
    let mut ahead = [0; FILTERS.len()];
    let mut consistent = [true; FILTERS.len()];
    let mut nees_range = [(f64::MAX, f64::MIN); FILTERS.len()];
    for (axis, axis_name) in AXES.iter().enumerate() {
        let mut rows = Vec::new();
        for (rate, hz) in RATES_HZ.iter().enumerate() {
            for (path, Path { name, .. }) in PATHS.iter().enumerate() {
                let cell: Cell = tables.cell(path, rate);
                let paper = PAPER[axis][rate][path];
                let std: Vec<f64> = (0..FILTERS.len()).map(|f| cell.std_m[f][axis]).collect();
                for f in 0..FILTERS.len() {
                    ahead[f] += usize::from(std[f] < paper);
                    consistent[f] &= NEES.contains(&cell.nees[f]);
                    nees_range[f] = (nees_range[f].0.min(cell.nees[f]), nees_range[f].1.max(cell.nees[f]));
                }
                report.value(
                    &format!("{}/{axis_name}/{name}/{hz}Hz", plant.name),
                    std[0],
                    "m",
                    json!({
                        "paper": paper, "ekf": std[0], "ukf": std[1], "floor": cell.floor_m[axis],
                        "nees_ekf": cell.nees[0], "nees_ukf": cell.nees[1], "runs": effort.flights, "seed_base": effort.seed_base,
                    }),
                );
                let mm = |v: f64| format!("{:.2}", v * 1e3);
                rows.push(vec![
                    format!("{hz} Hz {name}"),
                    mm(paper),
                    mm(std[0]),
                    mm(std[1]),
                    mm(cell.floor_m[axis]),
                    format!("{:.2}", cell.nees[0]),
                    format!("{:.2}", cell.nees[1]),
                ]);
            }
        }
        let stem = format!("{}_{axis_name}", plant.name);
        let headers = ["rate, path", "paper, mm", "EKF, mm", "UKF, mm", "floor, mm", "NEES EKF", "NEES UKF"];
        report.table(&stem, &format!("Table {}: σ of {axis_name}", 3 + axis), &headers, &rows).unwrap();
        for (path, Path { name, .. }) in PATHS.iter().enumerate() {
            let curve = |of: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
                RATES_HZ.iter().enumerate().map(|(rate, hz)| (*hz as f64, of(rate) * 1e3)).collect()
            };
            let mut plot = Plot::new(&format!("{name}, {axis_name}"), "camera rate, Hz", "σ, mm")
                .axes(Axis::Log, Axis::Log)
                .with(Series::dashed("paper", curve(&|rate| PAPER[axis][rate][path])))
                .with(Series::dashed("floor", curve(&|rate| tables.cell(path, rate).floor_m[axis])));
            for (f, filter) in FILTERS.iter().enumerate() {
                plot = plot.with(Series::line(filter, curve(&|rate| tables.cell(path, rate).std_m[f][axis])));
            }
            let caption = format!("σ of {axis_name} against the camera rate, {name}");
            report.figure(&format!("{}_{axis_name}_{name}", plant.name), &caption, &plot).unwrap();
        }
    }
    for (f, filter) in FILTERS.iter().enumerate() {
        let name = format!("{}/entries_ahead/{filter}", plant.name);
        let (low, high) = nees_range[f];
        let met = ahead[f] >= AHEAD_MIN && consistent[f];
        report.value(
            &name,
            ahead[f] as f64,
            "of 72",
            json!({ "limit": AHEAD_MIN, "nees_lowest": low, "nees_highest": high, "met": met }),
        );
    }
}

/// Algorithm 1 as it is printed, beside the corrected one, over one flight of the circle.
fn literal(report: &mut Report, effort: &Effort) {
    report.heading("The literal Algorithm 1");
    report.paragraph(
        "Lines 8 and 11 propagate P by one Euler step of P' = AP + PA' + Q over the whole interval between \
         measurements, which does not keep P positive; line 14 adds R, a 7x7 matrix, to a 12x12 one, read here as \
         added to its upper left corner (ERRATA, [Umasankar] 7). With K R K' instead the propagation alone is shown.",
    );
    let plant = PLANTS[0];
    let flown = Flown::fly(PATHS[1], plant, effort.seed_base);
    let mut rows = Vec::new();
    for variant in [Literal::AsPrinted, Literal::JosephUpdate] {
        for hz in RATES_HZ {
            let outcome = literal::run(&flown, plant, hz, variant);
            let name = format!("literal/{}/{hz}Hz", variant.name());
            report.value(
                &name,
                outcome.lost_s.unwrap_or(f64::NAN),
                "s",
                json!({
                    "what": "time at which the estimate is a metre off or not finite; null: never",
                    "std_m": outcome.std_m, "nees": outcome.nees,
                    "indefinite_share": outcome.indefinite_share, "least_eigenvalue": outcome.least_eigenvalue,
                }),
            );
            let text = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.3e}"));
            rows.push(vec![
                format!("{hz} Hz {}", variant.name()),
                outcome.lost_s.map_or_else(|| "never".to_owned(), |t| format!("{t:.2}")),
                text(outcome.std_m),
                text(outcome.nees),
                format!("{:.3}", outcome.indefinite_share),
                format!("{:.2e}", outcome.least_eigenvalue),
            ]);
        }
    }
    let headers =
        ["rate, variant", "lost after, s", "σ of x, m", "NEES", "updates with P indefinite", "least eigenvalue"];
    report.table("literal", "Algorithm 1 as printed, circle", &headers, &rows).unwrap();
}

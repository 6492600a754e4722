//! Figures 10 to 13: the decoder on [Clinic]'s ten-state model, its sensors compromised one after the other.

use nalgebra::{SMatrix, SVector};
use plumbline_agent::estimate::secure::newton::Settings;
use plumbline_agent::estimate::secure::suite::{Observed, STATES};
use plumbline_agent::estimate::secure::window::Window;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::trim::Trim;
use plumbline_tests::report::{Plot, Report, Series};

use super::Effort;
use plumbline_experiment::draw::{Dice, median, parallel, worst};

pub const PERIOD_S: f64 = 0.05;
pub const SLOTS: usize = 10;
/// Height sensors of Figures 11 and 12.
const MANY: usize = 50;
/// Heights of the small case that is decoded by trying every set, and how many are left out.
const FEW: usize = 5;
const FEW_MOST: usize = 2;
/// Successful recovery in Figure 12, as in the source.
const RECOVERED: f64 = 0.15;
/// Feedback of height and climb to thrust that makes the altitude step (N per m, N per m/s): any stable one.
const CLIMB: (f64, f64) = (2.0, 2.0);

/// What the compromised sensors give.
#[derive(Clone, Copy, PartialEq)]
enum Attack {
    /// Zero ([Clinic] Fig. 11).
    Zero,
    /// Each its own noise.
    Random,
    /// All the same other flight: the worst there is.
    Colluding,
}

pub struct Flight {
    pub observed: Observed,
    pub a: SMatrix<f64, STATES, STATES>,
    b: SMatrix<f64, STATES, 4>,
    pub x: SVector<f64, STATES>,
    /// Thrust really given for the thrust that is known.
    thrust_factor: f64,
}

impl Flight {
    pub fn new(heights: usize, thrust_factor: f64) -> Self {
        let airframe = Airframe::clinic();
        let observed = Observed::clinic(heights, &airframe, &Trim::hover(&airframe));
        let (a, b) = observed.sampled(PERIOD_S).unwrap();
        Self { observed, a, b, x: SVector::zeros(), thrust_factor }
    }

    pub fn window(&self, slots: usize) -> Window<STATES> {
        let q = SMatrix::from_diagonal(&SVector::repeat(1e-8));
        self.observed.window(slots, PERIOD_S, q, Settings::default()).unwrap()
    }

    /// One step towards 1 m; the forced response that the estimator knows.
    pub fn step(&mut self) -> SVector<f64, STATES> {
        let mut u = SVector::<f64, 4>::zeros();
        u[0] = CLIMB.0 * (1.0 - self.x[0]) - CLIMB.1 * self.x[3];
        let known = self.b * u;
        u[0] *= self.thrust_factor;
        self.x = self.a * self.x + self.b * u;
        known
    }

    fn sample(&self, sensor: usize, dice: &mut Dice) -> f64 {
        let s = &self.observed.scalars[sensor];
        s.c.dot(&self.x) + s.sigma * dice.normal()
    }
}

/// Height error relative to the true height after a climb, `attacked` of `heights` attacked; decoded as `decode` does.
fn height_error(
    heights: usize,
    attacked: usize,
    attack: Attack,
    seed: u64,
    decode: impl Fn(&mut Window<STATES>) -> SVector<f64, STATES>,
) -> f64 {
    let mut flight = Flight::new(heights, 1.0);
    let mut window = flight.window(SLOTS);
    let mut dice = Dice::new(seed);
    let chosen = dice.choose(attacked, heights);
    for step in 0..60 {
        let forced = flight.step();
        window.advance(Some(&forced));
        for sensor in 0..flight.observed.scalars.len() {
            let clean = flight.sample(sensor, &mut dice);
            let value = match attack {
                _ if !chosen.contains(&sensor) => clean,
                Attack::Zero => 0.0,
                Attack::Random => 3.0 * dice.normal(),
                Attack::Colluding => 2.0 - 0.005 * f64::from(step) + 0.01 * dice.normal(),
            };
            window.put(sensor, value);
        }
    }
    let x = decode(&mut window);
    ((x[0] - flight.x[0]) / flight.x[0]).abs()
}

/// The windowed ℓ1/ℓ2 program, all sensors in it.
fn convex(window: &mut Window<STATES>) -> SVector<f64, STATES> {
    window.decode(|_| false, &[], None).unwrap().x
}

/// Every set of [`FEW_MOST`] of [`FEW`] heights left out in turn: the one whose rest fits best. What a convex program is
/// the relaxation of, and what grows with the number of sets.
fn combinatorial(window: &mut Window<STATES>) -> SVector<f64, STATES> {
    let sets = (0..FEW).flat_map(|a| (a + 1..FEW).map(move |b| [a, b]));
    let fits = sets.map(|set| {
        let x = window.decode(|sensor| set.contains(&sensor), &[], None).unwrap().x;
        let kept = (0..FEW).filter(|sensor| !set.contains(sensor));
        (kept.map(|sensor| window.statistic(sensor).square).sum::<f64>(), x)
    });
    fits.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap().1
}

pub fn run(report: &mut Report, effort: &Effort) {
    figure_10(report, effort);
    figures_11_and_12(report, effort);
    every_set(report, effort);
    figure_13(report, effort);
    coupled_and_split(report, effort);
}

fn figure_10(report: &mut Report, effort: &Effort) {
    report.heading("Figure 10: one of three height sensors compromised");
    let mut flight = Flight::new(3, 1.0);
    let mut window = flight.window(SLOTS);
    let mut dice = Dice::new(effort.flown.seed(10));
    let (mut truth, mut attack, mut decoded) = (vec![], vec![], vec![]);
    let (mut sensor_error, mut error) = (vec![], vec![]);
    for step in 0..100 {
        let forced = flight.step();
        window.advance(Some(&forced));
        for sensor in 0..flight.observed.scalars.len() {
            let clean = flight.sample(sensor, &mut dice);
            let value =
                if sensor == 1 { flight.x[0] * (1.0 + 2.4 * dice.uniform()) + 0.1 * dice.normal() } else { clean };
            window.put(sensor, value);
            if sensor == 1 {
                attack.push((f64::from(step) * PERIOD_S, value));
                sensor_error.push(((value - flight.x[0]) / flight.x[0]).abs());
            }
        }
        truth.push((f64::from(step) * PERIOD_S, flight.x[0]));
        if window.is_ready() {
            let x = window.decode(|_| false, &[], None).unwrap().x;
            decoded.push((f64::from(step) * PERIOD_S, x[0]));
            error.push(((x[0] - flight.x[0]) / flight.x[0]).abs());
        }
    }
    let mean = |v: &[f64]| 100.0 * v.iter().sum::<f64>() / v.len() as f64;
    report.value("figure_10/compromised_sensor_error", mean(&sensor_error), "%", serde_json::json!({ "paper": 120.0 }));
    report.value("figure_10/estimate_error", mean(&error), "%", serde_json::json!({ "paper": 6.0 }));
    let plot = Plot::new("Three height sensors, one attacked", "t, s", "z, m")
        .with(Series::line("truth", truth))
        .with(Series::points("compromised sensor", attack))
        .with(Series::line("decoded", decoded));
    report.figure("figure_10", "Figure 10: windowed ℓ1/ℓ2 decoder, 39 rows.", &plot).unwrap();
}

fn figures_11_and_12(report: &mut Report, effort: &Effort) {
    report.heading("Figures 11 and 12: up to all of 50 height sensors compromised");
    let attacks = [("zero", Attack::Zero), ("random", Attack::Random), ("colluding", Attack::Colluding)];
    let mut errors =
        Plot::new("Error against compromised sensors", "compromised of 50", "height error, %").y_range(0.0, 110.0);
    let mut fractions = Plot::new("Recovery", "compromised of 50", "fraction recovered").y_range(0.0, 1.05);
    for (name, attack) in attacks {
        let points: Vec<usize> = (0..=MANY).step_by(2).collect();
        let trials = effort.trials.min(20) as usize;
        let all = parallel(points.len() * trials, |i| {
            height_error(MANY, points[i / trials], attack, effort.flown.seed(1000 + i as u64), convex)
        });
        let of = |p: usize| &all[p * trials..(p + 1) * trials];
        let recovered = |p: usize| of(p).iter().filter(|e| **e <= RECOVERED).count() as f64 / trials as f64;
        errors = errors.with(Series::line(
            name,
            points.iter().enumerate().map(|(p, n)| (*n as f64, 100.0 * median(of(p)).min(10.0))).collect(),
        ));
        fractions = fractions
            .with(Series::line(name, points.iter().enumerate().map(|(p, n)| (*n as f64, recovered(p))).collect()));
        for (p, n) in points.iter().enumerate().filter(|(_, n)| [0, 20, 24, 26, 30, 50].contains(n)) {
            let more = serde_json::json!({ "error_percent": 100.0 * median(of(p)), "attack": name });
            report.value(&format!("figure_12/{name}/{n}_of_50"), recovered(p), "fraction", more);
        }
    }
    report
        .figure("figure_11", "Figure 11: median error of the decoded height; theory: exact below half.", &errors)
        .unwrap();
    report
        .figure(
            "figure_12",
            "Figure 12: fraction within 15 %. Random attacks never agree; colluding ones win at half.",
            &fractions,
        )
        .unwrap();
}

/// The relaxation beside what it relaxes, where that is still small.
fn every_set(report: &mut Report, effort: &Effort) {
    report.heading("The convex program against every set of sensors, five heights");
    let trials = effort.trials as usize;
    let sets = FEW * (FEW - 1) / FEW_MOST;
    let attacks = [("zero", Attack::Zero), ("random", Attack::Random), ("colluding", Attack::Colluding)];
    let mut rows = Vec::new();
    for (name, attack) in attacks {
        for attacked in 0..=FEW_MOST + 1 {
            let all = parallel(trials, |i| {
                let seed = effort.flown.seed(5000 + 100 * attacked as u64 + i as u64);
                let error = |decode| 100.0 * height_error(FEW, attacked, attack, seed, decode);
                [error(convex as fn(&mut Window<STATES>) -> _), error(combinatorial)]
            });
            let of = |which: usize| all.iter().map(|errors| errors[which]).collect::<Vec<_>>();
            let (relaxed, tried) = (of(0), of(1));
            let more = serde_json::json!({ "worst": worst(&relaxed), "every_set_median": median(&tried),
                "every_set_worst": worst(&tried), "sets": sets, "trials": trials });
            report.value(&format!("every_set/{name}/{attacked}_of_{FEW}"), median(&relaxed), "%", more);
            let told = |errors: &[f64]| format!("{:.2} / {:.2}", median(errors), worst(errors));
            rows.push(vec![name.to_owned(), attacked.to_string(), told(&relaxed), told(&tried)]);
        }
    }
    let headers = ["attack", "attacked of 5", "ℓ1/ℓ2, %", "every set of two left out, %"];
    report
        .table(
            "every_set",
            "Error of the height: median / worst. Beyond two neither promises anything.",
            &headers,
            &rows,
        )
        .unwrap();
}

/// [Clinic] 3.4.1 solves position and orientation apart. At hover a pitch also shows in the speed, so the coupled
/// program has twice as many rows to ask for it.
fn coupled_and_split(report: &mut Report, effort: &Effort) {
    const PITCH: usize = 5;
    const BIAS_RAD: f64 = 0.2;
    report.heading("Coupled program against [Clinic]'s split");
    let trials = effort.trials.min(20) as usize;
    let error_deg = |split: bool, attacked: usize, seed: u64| {
        let mut flight = Flight::new(2, 1.0);
        if split {
            // z v_x v_y v_z, then the angles and rates.
            for (i, j) in
                (0..STATES).flat_map(|i| (0..STATES).map(move |j| (i, j))).filter(|(i, j)| (*i < 4) != (*j < 4))
            {
                flight.observed.a[(i, j)] = 0.0;
            }
        }
        let mut window = flight.window(SLOTS);
        let mut dice = Dice::new(seed);
        for _ in 0..60 {
            let forced = flight.step();
            window.advance(Some(&forced));
            for sensor in 0..flight.observed.scalars.len() {
                let scalar = &flight.observed.scalars[sensor];
                let biased = scalar.c[PITCH] != 0.0 && scalar.instance <= attacked;
                window.put(sensor, flight.sample(sensor, &mut dice) + if biased { BIAS_RAD } else { 0.0 });
            }
        }
        let x = window.decode(|_| false, &[], None).unwrap().x;
        (x[PITCH] - flight.x[PITCH]).abs().to_degrees()
    };
    let of = |split: bool, attacked: usize| {
        median(&parallel(trials, |i| error_deg(split, attacked, effort.flown.seed(1700 + i as u64))))
    };
    let mut plot = Plot::new("Pitch of so many of four units is biased by 11.5°", "attacked of 4", "pitch error, °");
    for (name, split) in [("coupled", false), ("split", true)] {
        let errors: Vec<f64> = (0..=4).map(|attacked| of(split, attacked)).collect();
        for (attacked, error) in errors.iter().enumerate() {
            report.value(&format!("coupling/{name}/{attacked}_of_4"), *error, "deg", serde_json::json!({}));
        }
        plot = plot.with(Series::line(name, errors.into_iter().enumerate().map(|(k, e)| (k as f64, e)).collect()));
    }
    report.figure("coupling", "Medians, 38 rows, ℓ1/ℓ2; the truth is the coupled vehicle.", &plot).unwrap();
}

fn figure_13(report: &mut Report, effort: &Effort) {
    report.heading("Figure 13: window that slides against window that grows");
    // The plant gives 5 % less thrust than the model knows: what a growing window never forgets.
    const STEPS: usize = 100;
    let runs = parallel(effort.trials as usize, |seed| {
        let mut flight = Flight::new(2, 0.95);
        let mut sliding = flight.window(SLOTS);
        let mut growing = flight.window(STEPS).growing();
        let mut dice = Dice::new(effort.flown.seed(1300 + seed as u64));
        let mut errors = Vec::with_capacity(STEPS);
        for _ in 0..STEPS {
            let forced = flight.step();
            sliding.advance(Some(&forced));
            growing.advance(Some(&forced));
            for sensor in 0..flight.observed.scalars.len() {
                let value = flight.sample(sensor, &mut dice);
                sliding.put(sensor, value);
                growing.put(sensor, value);
            }
            let error = |w: &mut Window<STATES>| {
                w.decode(|_| false, &[], None).map_or(f64::NAN, |d| (d.x[0] - flight.x[0]).abs())
            };
            let slid = if sliding.is_ready() { error(&mut sliding) } else { f64::NAN };
            errors.push((slid, error(&mut growing)));
        }
        errors
    });
    let at = |k: usize, pick: fn(&(f64, f64)) -> f64| {
        median(&runs.iter().map(|r| pick(&r[k])).filter(|v| v.is_finite()).collect::<Vec<_>>())
    };
    let line = |pick: fn(&(f64, f64)) -> f64| {
        (0..STEPS).map(|k| (k as f64, 1e3 * at(k, pick))).filter(|p| p.1.is_finite()).collect()
    };
    let plot = Plot::new("Height error, 5 % less thrust than modelled", "slot", "|error|, mm")
        .with(Series::line("window of 10", line(|e| e.0)))
        .with(Series::line("growing window", line(|e| e.1)));
    report.figure("figure_13", "Figure 13: medians.", &plot).unwrap();
    report.value("figure_13/window", 1e3 * at(STEPS - 1, |e| e.0), "mm", serde_json::json!({}));
    report.value("figure_13/growing", 1e3 * at(STEPS - 1, |e| e.1), "mm", serde_json::json!({}));
}

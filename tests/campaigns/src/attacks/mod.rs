//! `cargo xtask reproduce attacks`: attacks that nobody chose, on the vehicle as it is shipped, beside the estimators that a
//! user could pick instead.
//!
//! Onset, sensor, channel, kind, size, sign and duration are drawn from each flight's seed. The error is the true altitude
//! less the setpoint, from the onset to the end; e\* is that of the shipped EKF in the same flight without the attack, and in
//! `harsh`, where that EKF loses its own, of the lanes. A lost flight counts among the lost and not among the errors; where the attack is beyond what can be borne, one that flies away,
//! falls, or stops in the air. An operator keeps the vehicle over its place by eye, 0.3 s late. `--flights N` flies so many
//! of each row, `--seed-base N` begins elsewhere, `--only NAME` flies one row, the `table` of all rows, the `curves`, the `consistency` or the `roc`, `--quick` a tenth.

mod beside;
mod case;
mod consistency;
mod roc;

pub(crate) use roc::area;

use std::collections::BTreeMap;

use plumbline_agent::attack::Channel;
use plumbline_experiment::attacked::Attacked;
use plumbline_experiment::draw::{median, median_interval, parallel, percentile, worst};
use plumbline_experiment::flight::{Setup, fly};
use plumbline_experiment::judge::Outcome;
use plumbline_proto::v1::SensorKind;
use plumbline_support::effort::Effort;
use plumbline_tests::report::{Axis, Plot, Report, ReportError, Series};
use serde_json::json;

use beside::{Told, no_better};
use case::{Case, Pilot};

/// What is beyond the bound is declared within this, s.
const DECLARED_S: f64 = 1.0;
/// A healthy sensor may be excluded, or count for almost nothing, so long, s; longer in this part of the flights at most, where nobody is attacked.
const FALSE_S: f64 = 1.0;
const FALSE_PART: f64 = 0.05;

pub fn run() -> Result<(), ReportError> {
    let effort = Effort::asked([100, 10]);
    let mut report = Report::open("reproduce", "attacks", "Drawn attacks, in closed loop")?;
    report.paragraph(&format!(
        "{} flights of each row from seed {}, free and on strings by turns, steps of altitude throughout. Error: true \
         altitude less setpoint, rms from the onset to the end of the flight. e* is the shipped EKF's in the same flight \
         without the attack; in harsh, where the shipped EKF loses its own, it is the lanes' own without the attack. Median, \
         95th percentile and worst are of flights that were not lost. False: a healthy sensor announced as excluded; quiet: one \
         that counted for less than a hundredth of the one of its kind that counted most, without that.",
        effort.flights, effort.seed_base
    ));
    table(&mut report, &effort)?;
    if effort.wants("curves") {
        curves(&mut report, &effort)?;
    }
    if effort.wants("consistency") {
        consistency::consistency(&mut report, &effort)?;
    }
    if effort.wants("roc") {
        roc::roc(&mut report, &effort)?;
    }
    effort.is_done();
    report.finish().map(|_| ())
}

/// A flight of a row: with nobody attacked, and with each pilot.
struct Flown {
    clean: Outcome,
    by: Vec<Outcome>,
}

fn fly_all(case: &Case, effort: &Effort, pilots: &[Pilot]) -> Vec<Flown> {
    parallel(effort.flights as usize, |i| {
        let seed = effort.seed_base + i as u64;
        let scenario = case.scenario(seed);
        let attacks = case.attacked.attacks(&scenario.flight_config().sensors, seed);
        let from_s = attacks.iter().map(|a| a.start_s).fold(f64::INFINITY, f64::min);
        let from_s = if from_s.is_finite() { from_s } else { 0.0 };
        let flown = |pilot: Pilot, attacks: &[_]| {
            let comes_down = case.attacked.colludes() && !attacks.is_empty();
            fly(&Setup { comes_down, ..pilot.setup(&scenario, attacks, from_s) }).unwrap()
        };
        let clean = flown(case.against, &[]);
        let by = pilots.iter().map(|pilot| flown(*pilot, &attacks)).collect();
        Flown { clean, by }
    })
}

fn table(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Altitude and tilt under drawn attacks");
    let (mut rows, mut all) = (Vec::new(), Vec::new());
    let whole = effort.wants("table");
    for case in Case::ALL.iter().filter(|case| effort.wants(case.name) || whole) {
        let flown = fly_all(case, effort, case.pilots);
        for (p, pilot) in case.pilots.iter().enumerate() {
            let (cells, told) = row(report, case, *pilot, effort, flown.iter().map(|f| (&f.clean, &f.by[p])));
            rows.push(cells);
            all.push(told);
        }
    }
    if rows.is_empty() {
        return Ok(());
    }
    let headers = [
        "attacked",
        "world",
        "estimator",
        "e/e* median",
        "95 %",
        "worst",
        "e, mm",
        "95 %",
        "worst",
        "tilt median",
        "95 %",
        "worst",
        "lost of",
        "flights",
        "delay, s",
        "missed",
        "false > 1 s",
        "quiet > 1 s",
        "declared",
        "outside its bound",
    ];
    report.table("attacks", "Drawn attacks", &headers, &rows)?;
    for pilot in Pilot::ALL.into_iter().filter(|pilot| *pilot != Pilot::LANES) {
        if let Some(sentence) = no_better(&all, pilot) {
            report.paragraph(&sentence);
            eprintln!("{sentence}");
        }
    }
    Ok(())
}

fn row<'a>(
    report: &mut Report,
    case: &Case,
    pilot: Pilot,
    effort: &Effort,
    flights: impl Iterator<Item = (&'a Outcome, &'a Outcome)> + Clone,
) -> (Vec<String>, Told) {
    let comparable = flights.clone().filter(|(clean, o)| clean.lost.is_none() && o.lost.is_none());
    let altitude: Vec<f64> = comparable.clone().map(|(clean, o)| o.altitude_m / clean.altitude_m).collect();
    let tilt: Vec<f64> = comparable.clone().map(|(clean, o)| o.tilt_rad / clean.tilt_rad).collect();
    let all: Vec<&Outcome> = flights.clone().map(|(_, o)| o).collect();
    let lost = all.iter().filter(|o| o.lost.is_some()).count();
    let lost_seeds: Vec<u64> =
        (effort.seed_base..).zip(&all).filter_map(|(seed, o)| o.lost.as_ref().map(|_| seed)).collect();
    let mut why: BTreeMap<&str, usize> = BTreeMap::new();
    all.iter().filter_map(|o| o.lost.as_deref()).for_each(|reason| *why.entry(reason).or_default() += 1);
    let kept_mm = all.iter().filter(|o| o.lost.is_none()).map(|o| 1e3 * o.altitude_m).collect::<Vec<_>>();
    let delays: Vec<f64> = all.iter().flat_map(|o| o.delays_s.iter().copied()).collect();
    let missed: usize = all.iter().map(|o| o.missed).sum();
    let announced = |o: &&&Outcome| o.false_longest_s > FALSE_S;
    let quietly = |o: &&&Outcome| o.quiet_longest_s > FALSE_S;
    let falsely = all.iter().filter(announced).count();
    // Not announced, or not for as long.
    let quiet = all.iter().filter(|o| quietly(o) && !announced(o)).count();
    let quiet_longest_s = worst(&all.iter().map(|o| o.quiet_longest_s).collect::<Vec<_>>());
    let quiet_seeds: Vec<u64> =
        (effort.seed_base..).zip(&all).filter(|(_, o)| quietly(o)).map(|(seed, _)| seed).collect();
    let declared: Vec<f64> = all.iter().filter_map(|o| o.declared_s).collect();
    let of = |values: &[f64]| [median(values), percentile(values, 0.95), worst(values)];
    let (altitude3, tilt3, altitude_mm) = (of(&altitude), of(&tilt), of(&kept_mm));
    let within = |values: [f64; 3], most: [f64; 3]| values.iter().zip(most).all(|(value, most)| *value <= most);
    let judged = pilot.judges();
    let lost_of_hundred = 100.0 * lost as f64 / all.len() as f64;
    let beyond = case.attacked.colludes();
    let told = !beyond || declared.len() == all.len() && worst(&declared) <= DECLARED_S;
    let held = beyond || within(altitude3, case.altitude) && within(tilt3, case.tilt);
    let bound: Vec<f64> = all.iter().map(|o| o.outside_bound).filter(|part| part.is_finite()).collect();
    let outside = bound.iter().filter(|part| **part > 0.0).count();
    let outside_seeds: Vec<u64> =
        (effort.seed_base..).zip(&all).filter(|(_, o)| o.outside_bound > 0.0).map(|(seed, _)| seed).collect();
    let attacked = case.attacked != Attacked::None;
    let spared = attacked || (falsely + quiet) as f64 <= FALSE_PART * all.len() as f64;
    let holds = judged.then_some(held && told && spared && outside == 0 && lost_of_hundred <= case.lost);
    let clean_mm: Vec<f64> = flights.map(|(clean, _)| 1e3 * clean.altitude_m).collect();
    let name = pilot.name();
    let more = json!({
        "world": case.world, "seed_base": effort.seed_base, "flights": all.len(), "percentile_95": altitude3[1],
        "worst": altitude3[2], "altitude_mm": altitude_mm, "median_interval": median_interval(&altitude), "limits": case.altitude,
        "tilt": tilt3, "tilt_limits": case.tilt, "lost": lost, "lost_why": why, "lost_seeds": lost_seeds, "e_star_mm": median(&clean_mm), "e_star_of": case.against.name(),
        "most_mm": 1e3 * worst(&all.iter().map(|o| o.altitude_most_m).collect::<Vec<_>>()),
        "delay_s": [median(&delays), percentile(&delays, 0.95)], "missed": judged.then_some(missed),
        "flights_with_false_exclusion": judged.then_some(falsely), "flights_with_quiet_exclusion": judged.then_some(quiet),
        "quiet_longest_s": judged.then_some(quiet_longest_s), "quiet_seeds": judged.then_some(quiet_seeds),
        "declared": declared.len(), "declared_within_s": worst(&declared),
        "nees": of(&all.iter().map(|o| o.nees).filter(|nees| nees.is_finite()).collect::<Vec<_>>()),
        "outside_bound": worst(&bound), "flights_outside_bound": judged.then_some(outside), "outside_seeds": judged.then_some(outside_seeds), "holds": holds,
    });
    report.value(&format!("{}/{name}", case.name), altitude3[0], "e*", more);
    let number = |value: f64| if value.is_finite() { format!("{value:.2}") } else { "–".into() };
    let mut cells = vec![case.name.replace('_', " "), case.world.into(), name.into()];
    cells.extend(altitude3.iter().chain(&altitude_mm).chain(&tilt3).map(|value| number(*value)));
    cells.extend([lost.to_string(), all.len().to_string(), number(median(&delays))]);
    cells.extend([if attacked && judged { missed.to_string() } else { "–".into() }]);
    cells.extend([falsely, quiet].map(|flights| if judged { flights.to_string() } else { "–".into() }));
    cells.push(declared.len().to_string());
    cells.push(if judged { outside.to_string() } else { "–".into() });
    (cells, Told { case: case.name, pilot, altitude: altitude3, lost })
}

/// A quantity whose attack grows: sensor, channel, name, unit, sizes.
type Grown = (SensorKind, Channel, &'static str, &'static str, [f64; 7]);

const GROWN: [Grown; 3] = [
    (SensorKind::Height, Channel::All, "height", "m", [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0]),
    (SensorKind::Imu, Channel::AccelAxis(2), "vertical specific force", "m/s²", [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0]),
    (SensorKind::Imu, Channel::Gyro, "angular rate", "rad/s", [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0]),
];

/// How likely and how soon a bias is found, and what it does meanwhile, against its size.
fn curves(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Detectability of a bias on one sensor");
    let effort = effort.of((effort.flights / 5).max(2));
    for (kind, channel, what, unit, sizes) in GROWN {
        let (mut found, mut damage, mut gated) = (Vec::new(), Vec::new(), Vec::new());
        for size in sizes {
            let flown = fly_all(&Case::sized(kind, channel, size), &effort, &[Pilot::LANES, Pilot::EKF]);
            let rate = flown.iter().filter(|f| !f.by[0].delays_s.is_empty()).count() as f64 / flown.len() as f64;
            let delays: Vec<f64> = flown.iter().flat_map(|f| f.by[0].delays_s.iter().copied()).collect();
            let error = |pilot: usize| {
                let kept = flown.iter().filter(|f| f.by[pilot].lost.is_none());
                median(&kept.map(|f| f.by[pilot].altitude_m / f.clean.altitude_m).collect::<Vec<_>>())
            };
            let lost = |pilot: usize| flown.iter().filter(|f| f.by[pilot].lost.is_some()).count();
            found.push((size, rate));
            damage.push((size, error(0)));
            gated.push((size, error(1)));
            report.value(
                &format!("curve/{what}/{size}"),
                rate,
                "detected",
                json!({ "unit_of_size": unit, "size": size, "flights": flown.len(), "delay_s": median(&delays),
                    "delay_95_s": percentile(&delays, 0.95), "lanes_e_star": error(0), "ekf_e_star": error(1),
                    "lanes_lost": lost(0), "ekf_lost": lost(1) }),
            );
        }
        let stem = what.replace(' ', "_");
        let x = format!("bias of {what}, {unit}");
        let plot = Plot::new(&format!("Detected: {what}"), &x, "part of flights").axes(Axis::Log, Axis::Linear);
        report.figure(
            &format!("detected_{stem}"),
            "Excluded before the flight ended",
            &plot.with(Series::line("lanes", found)),
        )?;
        let plot = Plot::new(&format!("Damage: {what}"), &x, "e / e*").axes(Axis::Log, Axis::Linear);
        let plot = plot.with(Series::line("lanes", damage)).with(Series::line("shipped EKF", gated));
        report.figure(&format!("damage_{stem}"), "Median of the flights that were not lost", &plot)?;
    }
    Ok(())
}

//! `cargo xtask reproduce envelope`: the attack envelope against flights of the nonlinear vehicle.
//!
//! The maximising sequence of every set of one or two sensors of the default suite, and drawn attacks on them. The deviation is that
//! of the true altitude from the same flight without the attack, until somebody is excluded. `--flights N` draws so many attacks in
//! each world, `--seed-base N` begins elsewhere, `--only NAME` flies `worst`, `detect`, `lateral`, `commanded`, `heave`, `posed`, `sideways`, `watermark` or one world, `--quick` a twentieth.

mod aside;
mod commanded;
mod detection;
mod lateral;

use std::collections::HashMap;

use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_experiment::draw::{parallel, percentile, worst};
use plumbline_rest::envelope::EnvelopeQuestion;
use plumbline_support::effort::Effort;
use plumbline_support::envelope::{
    Bounds, Flown, HORIZON_S, LINEAR, Worn, asked_with, fly, fly_heaving, fly_held, largest,
};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

/// A maximising sequence reaches at least this part of its bound …
const REACHED: f64 = 0.9;
/// … whole, or scaled down this far where it is seen.
const PARTS: [f64; 4] = [1.0, 0.95, 0.8, 0.6];
/// Worlds that attacks are drawn in; in the first none may go further than its bound unseen.
const WORLDS: [&str; 3] = ["ideal", "bench", "datasheet"];
/// A heave in the place of a hover, m and s.
const HEAVE: (f64, f64) = (0.3, 4.0);
/// Flights without an attack that attacked ones are held against, in a world with noise.
const CLEAN: u64 = 25;
/// Part of an attack that moves nothing by itself.
const FAINT: f64 = 1e-3;

pub fn run() -> Result<(), ReportError> {
    let effort = Effort::asked([1000, 50]);
    let mut report = Report::open("reproduce", "envelope", "The attack envelope, flown")?;
    report.paragraph(&format!(
        "Every set of one or two sensors of the default suite, {HORIZON_S} s from the onset. Deviation: true altitude less that of the \
         same flight without the attack, until somebody is excluded. {} attacks are drawn in each world from seed {}.",
        effort.flights, effort.seed_base
    ));
    if effort.wants("worst") {
        worst_of(&mut report, &effort)?;
    }
    if effort.wants("detect") {
        detection::of_generators(&mut report, &effort)?;
    }
    if effort.wants("lateral") {
        lateral::of_lateral(&mut report, &effort)?;
    }
    if effort.wants("commanded") {
        commanded::of_rotors(&mut report, &effort)?;
    }
    if effort.wants("watermark") {
        detection::of_replays(&mut report, &effort)?;
    }
    if effort.wants("heave") {
        let title = format!("A heave of {} m within {} s", HEAVE.0, HEAVE.1);
        let fly = |worn: &Worn| fly_heaving("ideal", effort.seed_base, worn, HEAVE);
        otherwise(&mut report, &effort, ("heave", &title), |shaken| Bounds::along(shaken, Some(HEAVE), None), fly)?;
    }
    if effort.wants("posed") {
        let posed = |shaken| Bounds::asked(&EnvelopeQuestion { more: Some("pose".to_owned()), ..asked_with(shaken) });
        let fly = |worn: &Worn| fly_held("ideal", effort.seed_base, worn, HORIZON_S);
        otherwise(&mut report, &effort, ("posed", "The altitude under motion capture"), posed, fly)?;
    }
    if effort.wants("sideways") {
        aside::of_sideways(&mut report, &effort)?;
    }
    for world in WORLDS.into_iter().filter(|world| effort.wants(world)) {
        drawn(&mut report, world, &effort)?;
    }
    effort.is_done();
    report.finish().map(|_| ())
}

/// What lanes measure of the accelerometers in these flights: of the flights the middle one, as a few measure more and the limits move with
/// it.
fn usual(clean: &[Flown]) -> Shaken {
    let middle =
        |of: fn(&Shaken) -> f64| percentile(&clean.iter().map(|flight| of(&flight.usual)).collect::<Vec<_>>(), 0.5);
    Shaken { noise_mps2: middle(|of| of.noise_mps2), rectified_mps2: middle(|of| of.rectified_mps2) }
}

/// The maximising sequences of each set, flown by `fly` whole and scaled down: of those that nobody sees the one that gets furthest from
/// the same flight without, what it is scaled by, and that flight.
fn furthest(bounds: &Bounds, fly: impl Fn(&Worn) -> Flown + Sync) -> Vec<(f64, Flown, Flown)> {
    parallel(bounds.sets.len(), |i| {
        let set = &bounds.sets[i];
        let clean = fly(&set.none());
        let tries: Vec<_> = set.all_worst(&PARTS).map(|(part, worn)| (part, fly(&worn))).collect();
        let unseen = tries.iter().filter(|(_, flight)| flight.seen.is_none());
        let furthest = unseen.max_by(|a, b| a.1.unseen_m(&clean).total_cmp(&b.1.unseen_m(&clean)));
        let (part, flight) = furthest.unwrap_or(&tries[0]).clone();
        (part, flight, clean)
    })
}

/// Each maximising sequence in the ideal world.
fn worst_of(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Maximising sequences in the ideal world");
    let bounds = Bounds::new(fly("ideal", effort.seed_base, &Worn::default()).shaken);
    let flown = furthest(&bounds, |worn| fly("ideal", effort.seed_base, worn));
    let mut rows = Vec::new();
    for (set, (part, flight, clean)) in bounds.sets.iter().zip(flown) {
        let reached = flight.unseen_m(&clean) / set.bound_m;
        let excluded: Vec<String> = flight.excluded.iter().map(ToString::to_string).collect();
        let holds = flight.seen.is_none() && (REACHED..=LINEAR).contains(&reached);
        let more = json!({
            "bound_m": set.bound_m, "linear_m": set.reached_m, "binding": set.binding, "part": part, "excluded": excluded, "target": REACHED, "holds": holds,
        });
        report.value(&format!("worst/{}", set.name()), reached, "of the bound", more);
        rows.push(vec![
            set.name(),
            format!("{:.2}", 100.0 * set.bound_m),
            set.binding.into(),
            format!("{part:.2}"),
            format!("{reached:.3}"),
            excluded.join(", "),
        ]);
    }
    let headers = ["attacked", "bound, cm", "held by", "scaled by", "flown, of the bound", "excluded"];
    report.table("worst", "Maximising sequences", &headers, &rows)
}

/// Drawn attacks along z in the ideal world otherwise than about a hover with heights alone, and the worst sequences of each set: with these
/// `bounds`, flown by `fly`.
fn otherwise(
    report: &mut Report,
    effort: &Effort,
    (name, title): (&str, &str),
    bounds: impl FnOnce(Shaken) -> Bounds,
    fly: impl Fn(&Worn) -> Flown + Sync,
) -> Result<(), ReportError> {
    report.heading(&format!("{title}: the ideal world"));
    let shaken = fly(&Worn::default()).shaken;
    let (bounds, hover) = (bounds(shaken), Bounds::new(shaken));
    let flown = furthest(&bounds, &fly);
    let cleans: Vec<Flown> = flown.iter().map(|(.., clean)| clean.clone()).collect();
    let mut rows = Vec::new();
    for (set, (part, flight, clean)) in bounds.sets.iter().zip(flown) {
        let about = hover.sets.iter().find(|of| of.sensors == set.sensors).map_or(f64::NAN, |of| of.bound_m);
        let reached = flight.unseen_m(&clean) / set.bound_m;
        let seen = flight.seen.is_some();
        let more =
            json!({ "bound_m": set.bound_m, "hover_m": about, "linear_m": set.reached_m, "part": part, "seen": seen });
        report.value(&format!("{name}/worst/{}", set.name()), reached, "of the bound", more);
        let cm = |m: f64| format!("{:.3}", 100.0 * m);
        rows.push(vec![
            set.name(),
            cm(set.bound_m),
            cm(about),
            format!("{part:.2}"),
            format!("{reached:.3}"),
            seen.to_string(),
        ]);
    }
    let headers = ["attacked", "bound, cm", "about hover, cm", "scaled by", "flown, of the bound", "seen"];
    report.table(name, &format!("Maximising sequences: {title}"), &headers, &rows)?;
    let parts = parallel(effort.flights as usize, |i| {
        let (set, clean) = (&bounds.sets[i % bounds.sets.len()], &cleans[i % bounds.sets.len()]);
        let (shape, attack) = set.drawn(effort.seed_base + i as u64);
        let flight = fly(&attack);
        (shape, flight.unseen_m(clean) / set.bound_m, flight.seen.is_some())
    });
    let reached: Vec<f64> = parts.iter().map(|(_, part, _)| *part).collect();
    for (i, (shape, part, _)) in parts.iter().enumerate().filter(|(_, (_, part, _))| *part > LINEAR) {
        let more = json!({ "attacked": bounds.sets[i % bounds.sets.len()].name(), "shape": shape, "index": i });
        report.value(&format!("{name}/beyond"), *part, "of the bound", more);
    }
    let beyond = reached.iter().filter(|part| **part > LINEAR).count();
    let more = json!({
        "flights": parts.len(), "seed_base": effort.seed_base, "beyond": beyond, "worst": worst(&reached),
        "seen": parts.iter().filter(|(.., seen)| *seen).count(), "holds": beyond == 0,
    });
    report.value(&format!("{name}/drawn"), percentile(&reached, 0.95), "of the bound, 95 %", more);
    Ok(())
}

/// Drawn attacks in one world.
fn drawn(report: &mut Report, world: &str, effort: &Effort) -> Result<(), ReportError> {
    report.heading(&format!("Drawn attacks: {world}"));
    let seeds = if world == "ideal" { 1 } else { CLEAN };
    let clean: Vec<Flown> = parallel(seeds as usize, |i| fly(world, effort.seed_base + i as u64, &Worn::default()));
    // What was seen without an attack is no attack seen.
    let quiet: Vec<usize> = (0..clean.len()).filter(|i| clean[*i].seen.is_none()).collect();
    let shaken = largest(clean.iter().map(|flight| flight.shaken));
    // A height's bound rises with what is rectified, an IMU's falls.
    let least = clean.iter().map(|flight| flight.usual.rectified_mps2).fold(f64::INFINITY, f64::min);
    let ideal = world == "ideal";
    let made = if ideal { Bounds::new } else { Bounds::sampled };
    let bounds = made(shaken).or(made(Shaken { rectified_mps2: least, ..shaken }));
    // Without noise each set flies with heights that sample when it does the most.
    let own: Vec<Flown> =
        parallel(if ideal { bounds.sets.len() } else { 0 }, |i| fly(world, effort.seed_base, &bounds.sets[i].none()));
    let flown = parallel(effort.flights as usize, |i| {
        let (set, seed) = (&bounds.sets[i % bounds.sets.len()], quiet[i % quiet.len()]);
        let (shape, attack) = set.drawn(effort.seed_base + i as u64);
        let flight = fly(world, effort.seed_base + seed as u64, &attack);
        let clean = own.get(i % bounds.sets.len()).unwrap_or(&clean[seed]);
        (i, shape, flight.unseen_m(clean) / set.bound_m, flight)
    });
    let mut by: HashMap<(&str, &str), (u32, u32, Vec<f64>)> = HashMap::new();
    for (i, shape, part, flight) in &flown {
        let set = &bounds.sets[i % bounds.sets.len()];
        let kinds = match set.sensors.iter().filter(|s| s.to_string().starts_with("height")).count() {
            1 if set.sensors.len() == 2 => "height and IMU",
            0 if set.sensors.len() == 1 => "IMU",
            0 => "two IMUs",
            1 => "height",
            _ => "two heights",
        };
        let entry = by.entry((kinds, shape)).or_default();
        entry.0 += u32::from(flight.seen.is_some());
        entry.1 += u32::from(*part > LINEAR);
        entry.2.push(*part);
        if *part > LINEAR {
            let seed = quiet[i % quiet.len()];
            let clean = own.get(i % bounds.sets.len()).unwrap_or(&clean[seed]);
            let (_, worn) = set.drawn(effort.seed_base + *i as u64);
            let faint = fly(world, effort.seed_base + seed as u64, &worn.scaled(FAINT));
            let of = Bounds::along(flight.shaken, None, Some(&set.name()));
            let more = json!({
                "world": world, "attacked": set.name(), "shape": shape, "index": i, "bound_m": set.bound_m, "noise_mps2": flight.shaken.noise_mps2,
                "rectified_mps2": flight.shaken.rectified_mps2,
                "of_own_noise": part * set.bound_m / of.sets[0].bound_m, "faint": faint.unseen_m(clean) / set.bound_m,
            });
            report.value("beyond", *part, "of the bound", more);
        }
    }
    let mut rows = Vec::new();
    let mut keys: Vec<_> = by.keys().copied().collect();
    keys.sort_unstable();
    for key in keys {
        let (seen, beyond, parts) = &by[&key];
        let cells = [parts.len().to_string(), seen.to_string(), beyond.to_string()];
        let mut row = vec![key.0.to_owned(), key.1.to_owned()];
        row.extend(cells);
        row.extend([format!("{:.3}", percentile(parts, 0.95)), format!("{:.3}", worst(parts))]);
        rows.push(row);
    }
    let parts: Vec<f64> = flown.iter().map(|(_, _, part, _)| *part).collect();
    let beyond = parts.iter().filter(|part| **part > LINEAR).count();
    let more = json!({
        "world": world, "flights": parts.len(), "seed_base": effort.seed_base, "beyond": beyond, "noise_mps2": shaken.noise_mps2,
        "rectified_mps2": [least, shaken.rectified_mps2],
        "seen": flown.iter().filter(|(_, _, _, flight)| flight.seen.is_some()).count(),
        "clean_flights_with_an_exclusion": clean.len() - quiet.len(),
        "worst": worst(&parts), "holds": (world == "ideal").then_some(beyond == 0),
    });
    report.value(&format!("drawn/{world}"), percentile(&parts, 0.95), "of the bound, 95 %", more);
    let headers = ["attacked", "shape", "flights", "seen", "beyond the bound unseen", "95 %, of the bound", "worst"];
    report.table(world, "Drawn attacks", &headers, &rows)
}

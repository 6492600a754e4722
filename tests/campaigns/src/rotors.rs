//! `cargo xtask reproduce rotors`: rotors that lose thrust.
//!
//! The propeller of a rotor drawn from each flight's seed loses a part of its thrust in the simulator; nobody but the vehicle
//! feels it. Hover at 1 m, the lanes in the loop, an operator who keeps the vehicle over its place by eye. `--flights N` flies so
//! many of each row, `--seed-base N` begins elsewhere, `--only NAME` flies `clean`, `kept`, `power` or `lost`, `--quick` a tenth.

use plumbline_agent::envelope::theory::rotor_isolated;
use plumbline_experiment::draw::{median, parallel, percentile, worst};
use plumbline_experiment::summary::part;
use plumbline_support::effort::Effort;
use plumbline_support::rotors::{AFTER_S, Flown, How, RIGS, fly};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

/// Worlds without a loss.
const CLEAN: [&str; 2] = ["datasheet", "harsh"];
/// Losses of the power curve.
const LOSSES: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.5];
/// A loss of 20 % is isolated within this, s, and the altitude kept within this, m.
const WITHIN_S: f64 = 0.3;
const WITHIN_M: f64 = 0.1;
/// So soon after a complete loss the motors are cut, s.
const CUT_S: f64 = 0.5;

pub fn run() -> Result<(), ReportError> {
    let effort = Effort::asked([100, 10]);
    let mut report = Report::open("reproduce", "rotors", "Rotors that lose thrust")?;
    report.paragraph(&format!(
        "{} flights of each row from seed {}, hover at 1 m, the lanes in the loop. The propeller breaks in the simulator: no command, \
         no sensor and no estimator is told. Altitude: furthest of the true one from that at the onset, for {AFTER_S} s.",
        effort.flights, effort.seed_base
    ));
    if effort.wants("clean") {
        clean(&mut report, &effort)?;
    }
    if effort.wants("kept") {
        kept(&mut report, &effort)?;
    }
    if effort.wants("power") {
        power(&mut report, &effort)?;
    }
    if effort.wants("lost") {
        lost(&mut report, &effort)?;
    }
    effort.is_done();
    report.finish().map(|_| ())
}

fn fly_all(effort: &Effort, rig: &str, world: &str, loss: Option<f64>) -> Vec<Flown> {
    parallel(effort.flights as usize, |i| {
        fly(rig, world, effort.seed_base + i as u64, loss.map(|loss| (How::Broken, loss)))
    })
}

fn of(values: &[f64]) -> [f64; 3] {
    [median(values), percentile(values, 0.95), worst(values)]
}

/// 95 % interval of a part of `flights`.
fn interval(found: usize, flights: usize) -> [f64; 2] {
    part(found as u64, flights as u64).interval
}

/// Flights in which no rotor loses anything.
fn clean(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Nothing is lost");
    let mut rows = Vec::new();
    for world in CLEAN {
        for (rig, _) in RIGS {
            let flown = fly_all(effort, rig, world, None);
            let falsely = flown.iter().filter(|f| f.falsely > 0).count();
            let watched = flown.iter().filter(|f| f.watched).count();
            let lost = flown.iter().filter(|f| f.lost.is_some()).count();
            let sigma = |axis: usize| median(&flown.iter().map(|f| f.sigma[axis]).collect::<Vec<_>>());
            let which: Vec<u64> =
                (effort.seed_base..).zip(&flown).filter(|(_, f)| f.falsely > 0).map(|(seed, _)| seed).collect();
            let more = json!({
                "world": world, "rig": rig, "flights": flown.len(), "seed_base": effort.seed_base, "interval": interval(falsely, flown.len()),
                "watched": watched, "lost": lost, "seeds": which, "sigma": [sigma(0), sigma(1), sigma(2), sigma(3)],
                "holds": world != "datasheet" || falsely == 0,
            });
            report.value(&format!("false/{world}/{rig}"), falsely as f64, "flights", more);
            let cells = [flown.len(), falsely, watched].map(|n| n.to_string());
            rows.push([vec![world.to_owned(), rig.to_owned()], cells.to_vec()].concat());
        }
    }
    report.table(
        "clean",
        "Clean flights of a minute",
        &["world", "rig", "flights", "isolated", "watched at the end"],
        &rows,
    )
}

/// A fifth of the thrust.
fn kept(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("A loss of 20 %");
    let mut rows = Vec::new();
    for (rig, _) in RIGS {
        let flown = fly_all(effort, rig, "datasheet", Some(0.2));
        let right = flown.iter().filter(|f| f.right() && f.falsely == 0).count();
        let delays: Vec<f64> = flown.iter().map(|f| f.isolated.map_or(f64::INFINITY, |(after, _)| after)).collect();
        let (delay, moved) = (of(&delays), of(&flown.iter().map(|f| f.moved_m).collect::<Vec<_>>()));
        let off = of(&flown.iter().map(|f| f.off_m).collect::<Vec<_>>());
        let found = of(&flown.iter().map(|f| (f.found - 0.8).abs()).collect::<Vec<_>>());
        let lost = flown.iter().filter(|f| f.lost.is_some()).count();
        let more = json!({
            "rig": rig, "flights": flown.len(), "seed_base": effort.seed_base, "isolated_rightly": right, "lost": lost,
            "moved_m": moved, "off_setpoint_m": off, "estimate_off": found,
            "beyond": flown.iter().filter(|f| f.moved_m > WITHIN_M).count(), "late": delays.iter().filter(|s| **s > WITHIN_S).count(),
            "percentile_95": delay[1], "worst": delay[2], "target": [WITHIN_S, WITHIN_M],
            "holds": delay[2] <= WITHIN_S && moved[2] <= WITHIN_M && right == flown.len(),
        });
        report.value(&format!("kept/{rig}"), delay[0], "s", more);
        let mut row = vec![rig.to_owned(), flown.len().to_string(), right.to_string()];
        row.extend(delay.map(|s| format!("{s:.3}")));
        row.extend(moved.map(|m| format!("{:.1}", 100.0 * m)));
        row.push(format!("{:.3}", found[1]));
        rows.push(row);
    }
    let headers = [
        "rig",
        "flights",
        "rightly isolated",
        "delay, s",
        "95 %",
        "worst",
        "moved, cm",
        "95 %",
        "worst",
        "estimate off, 95 %",
    ];
    report.table("kept", "A rotor loses 20 %", &headers, &rows)
}

/// How likely losses are found, flown and by formula.
fn power(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Detection probability");
    let mut rows = Vec::new();
    for loss in LOSSES {
        let flown = fly_all(effort, "free", "datasheet", Some(loss));
        for within_s in [WITHIN_S, AFTER_S] {
            let soon = |f: &&Flown| f.right() && f.isolated.is_some_and(|(after, _)| after <= within_s);
            let found = flown.iter().filter(soon).count();
            let by_formula: Vec<f64> = flown.iter().map(|f| rotor_isolated(loss, information(f), within_s)).collect();
            let formula = by_formula.iter().sum::<f64>() / by_formula.len() as f64;
            let part = found as f64 / flown.len() as f64;
            let [low, high] = interval(found, flown.len());
            let wrongly = flown.iter().filter(|f| f.isolated.is_some() && !f.right()).count();
            let more = json!({
                "loss": loss, "within_s": within_s, "flights": flown.len(), "seed_base": effort.seed_base, "interval": [low, high],
                "formula": formula, "formula_within_interval": (low..=high).contains(&formula), "wrong_rotor": wrongly,
                "lost": flown.iter().filter(|f| f.lost.is_some()).count(),
            });
            report.value(&format!("power/{loss}/{within_s}"), part, "isolated", more);
            rows.push(vec![
                format!("{:.0} %", 100.0 * loss),
                format!("{within_s}"),
                flown.len().to_string(),
                format!("{part:.2}"),
                format!("{low:.2} to {high:.2}"),
                format!("{formula:.2}"),
                wrongly.to_string(),
            ]);
        }
    }
    let headers = ["loss", "within, s", "flights", "isolated", "95 % interval", "formula", "wrong rotor"];
    report.table("power", "Isolated, flown and by formula", &headers, &rows)
}

/// S of [`rotor_isolated`]: what a whole rotor at hover adds to the innovations, in their sigmas, each 2T.
fn information(flown: &Flown) -> f64 {
    plumbline_agent::flight::rotor_information(
        &plumbline_agent::model::airframe::Airframe::iris(),
        flown.rotor,
        &flown.sigma,
    )
}

/// All of it.
fn lost(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("A rotor is lost");
    let mut rows = Vec::new();
    for (rig, _) in RIGS {
        for loss in [0.5, 0.7, 1.0] {
            let flown = fly_all(effort, rig, "datasheet", Some(loss));
            let cut: Vec<f64> = flown.iter().filter_map(|f| f.cut.map(|(after, _)| after)).collect();
            let (after, tilt) = (of(&cut), of(&flown.iter().map(|f| f.tilt_rad.to_degrees()).collect::<Vec<_>>()));
            let sinks = of(&flown.iter().map(|f| f.sinks_mps).collect::<Vec<_>>());
            let mut why = std::collections::BTreeMap::<String, usize>::new();
            flown.iter().for_each(|f| *why.entry(format!("{:?}", f.failsafe)).or_default() += 1);
            let soon = cut.iter().filter(|s| (0.0..=CUT_S).contains(*s)).count();
            let more = json!({
                "rig": rig, "loss": loss, "flights": flown.len(), "seed_base": effort.seed_base, "ends": why, "cut_after_s": after,
                "tilt_deg": tilt, "sinks_mps": sinks, "uncontrolled": flown.iter().filter(|f| f.lost.is_some()).count(), "holds": (loss == 1.0).then_some(soon == flown.len()),
            });
            report.value(&format!("lost/{rig}/{loss}"), soon as f64, "flights cut", more);
            let ends: Vec<String> = why.iter().map(|(name, count)| format!("{name} {count}")).collect();
            let mut row =
                vec![rig.to_owned(), format!("{:.0} %", 100.0 * loss), flown.len().to_string(), soon.to_string()];
            row.extend(after.map(|s| format!("{s:.3}")));
            row.extend([format!("{:.0}", tilt[2]), format!("{:.2}", sinks[2]), ends.join(", ")]);
            rows.push(row);
        }
    }
    let headers = [
        "rig",
        "loss",
        "flights",
        "cut in time",
        "after, s",
        "95 %",
        "worst",
        "most tilt, °",
        "sinks at most, m/s",
        "ends",
    ];
    report.table("lost", "Half of a rotor and more", &headers, &rows)
}

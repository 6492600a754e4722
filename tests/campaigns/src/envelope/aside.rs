//! Attacks along x and y in the ideal world against their bounds: position held, and along a circle.

use plumbline_experiment::draw::{parallel, percentile, worst};
use plumbline_support::effort::Effort;
use plumbline_support::envelope::aside::{ASIDE_S, Aside, CIRCLE, SWUNG};
use plumbline_support::envelope::{Flown, LINEAR, Worn, fly_circling, fly_held};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

use super::REACHED;

/// What is pushed, in which unit.
const PUSHED: [(&str, &str); 3] = [("tilt", "rad"), ("velocity", "m/s"), ("position", "m")];

/// The worst of one IMU, and drawn attacks on any.
pub fn of_sideways(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Along x and y under motion capture: the ideal world");
    for axis in [0, 1] {
        let name = ["x", "y"][axis];
        let held = |worn: &Worn| fly_held("ideal", effort.seed_base, worn, ASIDE_S);
        flown(report, effort, axis, None, &format!("hold, {name}"), &held)?;
        let circling = |worn: &Worn| fly_circling("ideal", effort.seed_base, worn, axis, CIRCLE);
        flown(report, effort, axis, Some(SWUNG), &format!("circle, {name}"), &circling)?;
    }
    Ok(())
}

fn flown(
    report: &mut Report,
    effort: &Effort,
    axis: usize,
    swing: Option<(f64, f64)>,
    name: &str,
    fly: &(impl Fn(&Worn) -> Flown + Sync),
) -> Result<(), ReportError> {
    let clean = fly(&Worn::default());
    let bounds = Aside::new(axis, swing, clean.shaken.noise_mps2);
    let reached = |flight: &Flown, set: usize, which: usize| {
        flight.unseen_aside(&clean, axis, ASIDE_S)[which] / bounds.sets[set].bounds[which]
    };
    let mut rows = Vec::new();
    // IMUs are alike.
    let of = &bounds.sets[0];
    for (which, (pushed, unit)) in PUSHED.into_iter().enumerate() {
        let tries = bounds.all_worst(of, which).map(|(held, worn)| (held, fly(&worn)));
        let unseen = tries.filter(|(_, flight)| flight.seen.is_none());
        let unseen = unseen.map(|(held, flight)| (held, reached(&flight, 0, which)));
        let (held, most) = unseen.fold(((0.0, 0.0), 0.0), |best, one| if one.1 > best.1 { one } else { best });
        let more = json!({
            "bound": of.bounds[which], "unit": unit, "limits": held, "target": REACHED,
            "holds": (REACHED..=LINEAR).contains(&most),
        });
        report.value(&format!("sideways/{name}/worst/{}/{pushed}", of.name()), most, "of the bound", more);
        let bound = format!("{:.4} {unit}", of.bounds[which]);
        rows.push(vec![of.name(), pushed.into(), bound, format!("{held:?}"), format!("{most:.3}")]);
    }
    let headers = ["attacked", "pushed", "bound", "limits of evidence, of the rest", "flown, of the bound"];
    report.table(&format!("sideways {name}"), &format!("Maximising sequences: {name}"), &headers, &rows)?;
    let drawn = parallel(effort.flights as usize, |i| {
        let set = i % bounds.sets.len();
        let (shape, attack) = bounds.drawn(&bounds.sets[set], effort.seed_base + i as u64);
        let flight = fly(&attack);
        let parts = [0, 1, 2].map(|which| reached(&flight, set, which));
        (shape, bounds.sets[set].name(), parts.into_iter().fold(0.0, f64::max), flight.seen.is_some())
    });
    let parts: Vec<f64> = drawn.iter().map(|(.., part, _)| *part).collect();
    let beyond: Vec<_> = drawn.iter().enumerate().filter(|(_, (.., part, _))| *part > LINEAR).collect();
    for (i, (shape, sensors, part, _)) in &beyond {
        let more = json!({ "flown": name, "attacked": sensors, "shape": shape, "index": i });
        report.value("sideways/beyond", *part, "of the bound", more);
    }
    let more = json!({
        "flights": drawn.len(), "seed_base": effort.seed_base, "beyond": beyond.len(), "worst": worst(&parts),
        "seen": drawn.iter().filter(|(.., seen)| *seen).count(), "holds": beyond.is_empty(),
    });
    report.value(&format!("sideways/{name}/drawn"), percentile(&parts, 0.95), "of the bound, 95 %", more);
    Ok(())
}

//! Curves of a report: detected over the size of an attack, operating characteristics, errors over time.

use std::fmt::Write as _;

use plumbline_rest::experiment::{Condition, Results};

use super::svg::{self, Look, Point};
use super::{DRAWN, label};
use crate::judge::STEADY_S;
use crate::roc;
use crate::row::Row;
use crate::store::Experiment;
use crate::{summary, trace};

/// What tells attacked flights from others, by the names of measures.
const SCORE: &str = "nis_most";
/// What is shown before an onset, s.
const LEAD_S: f64 = 5.0;

/// Detected, and expected to be, against the first factor that is a number: the size of an attack, where that is varied.
pub(super) fn detected(out: &mut String, experiment: &Experiment, results: &Results) {
    let factors = &experiment.plan.factors;
    let size = factors.iter().position(|factor| factor.key == "attack.magnitude");
    let Some(x) = size.or(factors.iter().position(|factor| factor.is_number())) else { return };
    let mut series: Vec<(String, Vec<Point>)> = Vec::new();
    for condition in &results.conditions {
        let (Some(part), Some(Ok(at))) =
            (condition.detected, condition.levels.get(x).map(|level| level.parse::<f64>()))
        else {
            continue;
        };
        let others =
            condition.levels.iter().enumerate().filter(|(factor, _)| *factor != x).map(|(_, level)| level.as_str());
        let name = others.collect::<Vec<_>>().join(" · ");
        let point = Point { x: at, y: part.count as f64 / part.of.max(1) as f64, interval: part.interval };
        let expected = condition.expected.as_ref().and_then(|expected| expected.probability);
        let expected = expected.map(|y| Point { x: at, y, interval: [y; 2] });
        let of = series.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
            series.extend([(name.clone(), Vec::new()), (format!("{name} expected").trim().to_owned(), Vec::new())]);
            series.len() - 2
        });
        series.iter_mut().skip(of).zip([Some(point), expected]).for_each(|((_, points), more)| points.extend(more));
    }
    if series.iter().all(|(_, points)| points.len() < 2) {
        return;
    }
    series.iter_mut().for_each(|(_, points)| points.sort_by(|a, b| a.x.total_cmp(&b.x)));
    let key = factors.get(x).map_or("", |factor| factor.key.as_str());
    let _ = write!(
        out,
        "<h2>Detected</h2>\n{}",
        svg::figure(
            "detected",
            &svg::curves(key, "part of flights", Look::Points, &series),
            "Part of the flights whose attacked sensors were all excluded, with its 95 % interval (Wilson); dashed what the model \
             expects, where it can tell.",
        ),
    );
}

/// Of each attacked condition against the one that differs from it in nothing but the attack.
pub(super) fn roc(out: &mut String, experiment: &Experiment, results: &Results, rows: &[Row]) {
    let plan = &experiment.plan;
    let apart = |condition: &Condition| -> Vec<String> {
        let levels = condition.levels.iter().zip(&plan.factors);
        levels.filter(|(_, factor)| !factor.key.starts_with("attack.")).map(|(level, _)| level.clone()).collect()
    };
    let of = |condition: &Condition| {
        let number = condition.number;
        rows.iter().filter(move |row| plan.place(row.index.into()).0 == number)
    };
    let scores = |condition: &Condition| of(condition).map(|row| row.value(SCORE)).collect::<Vec<_>>();
    let mut series = Vec::new();
    let attacked = |condition: &&Condition| condition.detected.is_some() && plan.attacks(condition.number);
    for condition in results.conditions.iter().filter(attacked).take(DRAWN) {
        let clean = |other: &&Condition| apart(other) == apart(condition) && !plan.attacks(other.number);
        let beside = results.conditions.iter().find(clean);
        let Some(curve) = beside.and_then(|beside| roc::roc(&scores(condition), &scores(beside))) else { continue };
        let name = format!("{}: area {:.3}", label(condition), curve.area);
        let points = curve.points.iter().map(|[x, y]| Point { x: *x, y: *y, interval: [*y; 2] });
        series.push((name, points.collect()));
        // What the flights themselves excluded: one point, whatever the threshold.
        let alarmed =
            beside.map_or(0, |beside| of(beside).filter(|row| row.value("false_exclusions") > 0.0).count() as u64);
        let falsely = summary::part(alarmed, beside.map_or(0, |beside| beside.flights));
        let found = condition.detected.unwrap_or_default();
        let [x, y] = [falsely, found].map(|part| part.count as f64 / part.of.max(1) as f64);
        let name = format!(
            "{}: excluded {} of {}, falsely {} of {}",
            label(condition),
            found.count,
            found.of,
            alarmed,
            falsely.of
        );
        series.push((name, vec![Point { x, y, interval: found.interval }]));
    }
    if series.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>Receiver operating characteristic</h2>\n{}",
        svg::figure(
            "roc",
            &svg::curves("part of the flights without an attack", "part of attacked flights", Look::Line, &series),
            &format!(
                "Attacked flights alarmed over flights without an attack alarmed, by a threshold on <code>{SCORE}</code> of the \
                 estimator in the loop, against the condition that differs in the attack alone; the area is the probability that an \
                 attacked flight scores higher. The point of the same colour is what the flights excluded: every attacked sensor, and \
                 any healthy one."
            ),
        ),
    );
}

/// Errors over time, where flights were flown again for them.
pub(super) fn over_time(out: &mut String, experiment: &Experiment, results: &Results) {
    let Some(bands) = trace::bands(experiment) else { return };
    let named = |band: &trace::Band| {
        let of = results.conditions.iter().find(|condition| condition.number == band.condition);
        of.map_or_else(|| format!("condition {}", band.condition), label)
    };
    let series: Vec<_> = bands
        .bands
        .iter()
        .take(DRAWN)
        .map(|band| {
            // Taking off is nobody's question: from shortly before the onset on, or from where flights are judged.
            let from_s = if band.t_s.first().is_some_and(|first| *first < 0.0) { -LEAD_S } else { STEADY_S };
            let points = band.t_s.iter().zip(&band.quartiles).filter(|(t_s, _)| **t_s >= from_s);
            let point = |(t_s, [low, y, high]): (&f64, &[f64; 3])| Point { x: *t_s, y: *y, interval: [*low, *high] };
            (named(band), points.map(point).collect())
        })
        .collect();
    let _ = write!(
        out,
        "<h2>Error over time</h2>\n{}",
        svg::figure(
            "error",
            &svg::curves("s", "altitude less setpoint, m", Look::Band, &series),
            &format!(
                "True altitude less setpoint, m, without its sign: median and quartiles of the first {} flights of each condition, \
                 since the onset or since boot.",
                bands.repeats
            ),
        ),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Outcome;
    use crate::plan::Plan;

    #[test]
    fn flights_without_an_attack_are_the_others_where_propellers_break_as_well() {
        let folder = tempfile::tempdir().unwrap();
        let plan = "name = \"a\"\n[scenario]\nduration_s = 30\nbroken = [{ rotor = 1, at_s = 20, left = 0.8 }]\n\
                    [attack]\nsensor = \"height\"\nkind = \"bias\"\nmagnitude = 0.2\n\
                    [[factor]]\nkey = \"attack.kind\"\nvalues = [\"none\", \"bias\"]\n";
        let experiment = Experiment::create(folder.path(), Plan::from_toml(plan).unwrap()).unwrap();
        let row = |index, nis_most| Row::new(index, &Outcome { missed: 1, nis_most, ..Outcome::default() });
        let rows = [row(0, 1.0), row(1, 9.0)];
        let mut held = experiment.hold().unwrap();
        rows.iter().for_each(|row| held.append(row).unwrap());
        let mut out = String::new();
        roc(&mut out, &experiment, &summary::results(&experiment).unwrap(), &rows);
        assert!(out.contains("bias: area 1.000") && !out.contains("none: area"), "{out}");
    }
}

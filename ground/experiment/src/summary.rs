//! Statistics of what is there: medians with intervals, parts, paired differences.

use std::collections::BTreeMap;

use plumbline_rest::experiment as rest;
use toml::Value;

use crate::draw::{median, median_interval, percentile, worst};
use crate::expectation::{self, CONDITIONS};
use crate::plan::Plan;
use crate::recordings::{Against, Named};
use crate::row::{MEASURES, Row};
use crate::store::{Experiment, StoreError, now_unix_us};
use crate::ticks::{self, Ticks};

/// z of a 95 % interval.
const Z_95: f64 = 1.959_963_984_540_054;

/// How an experiment stands.
pub fn state(experiment: &Experiment) -> rest::State {
    let (done, flights) = (experiment.done(), experiment.identity.flights);
    let since = experiment.since();
    let per_s = since.and_then(|since| {
        let for_s = now_unix_us().saturating_sub(since.unix_us) as f64 / 1e6;
        (done > since.flights && for_s > 0.0).then(|| (done - since.flights) as f64 / for_s)
    });
    rest::State {
        id: experiment.id.clone(),
        name: experiment.plan.name.clone(),
        description: experiment.plan.description.clone(),
        made_unix_us: experiment.identity.made_unix_us,
        flights,
        done,
        running: since.is_some(),
        per_s,
        left_s: per_s.map(|per_s| flights.saturating_sub(done) as f64 / per_s),
        own: experiment.own().is_ok(),
        by_hand: experiment.plan.is_by_hand(),
        error: None,
    }
}

/// What is there, condition by condition.
///
/// # Errors
/// [`StoreError::Io`].
pub fn results(experiment: &Experiment) -> Result<rest::Results, StoreError> {
    let plan = &experiment.plan;
    let rows = experiment.rows()?;
    let mut by_condition: BTreeMap<u64, BTreeMap<u64, &Row>> = BTreeMap::new();
    for row in &rows {
        let (condition, repeat) = plan.place(row.index.into());
        by_condition.entry(condition).or_default().insert(repeat, row);
    }
    let (none, expected, ticks) = (BTreeMap::new(), expectation::kept(experiment), ticks::kept(experiment));
    let conditions = by_condition.iter().map(|(number, rows)| {
        let baseline = plan.baseline_of(*number);
        let beside = baseline.and_then(|baseline| by_condition.get(&baseline)).unwrap_or(&none);
        let flown = condition(plan, *number, rows, baseline.map(|baseline| (baseline, beside)));
        let why = || format!("the model is asked about the first {CONDITIONS} conditions of a plan");
        let beyond = || (*number >= CONDITIONS).then(|| rest::Expectation::unknown(why()));
        let expected = flown.detected.and_then(|flown| {
            let expected = expected.get(number).cloned().flatten().or_else(beyond)?;
            Some(expected.against(&flown))
        });
        let tick_us = ticks.get(number).and_then(Ticks::figures_us);
        rest::Condition { expected, tick_us, ..flown }
    });
    Ok(rest::Results {
        conditions: conditions.collect(),
        factors: plan.factors.iter().map(|factor| factor.key.clone()).collect(),
        measures: MEASURES.map(|m| rest::Measure { name: m.name.into(), about: m.about.into() }).into(),
        notes: notes(experiment),
        state: state(experiment),
    })
}

/// What the measures of recordings are, where they are not those of a simulated flight.
fn notes(experiment: &Experiment) -> Vec<String> {
    let of = |Named { name, against, .. }: &Named| match against {
        Against::Truth => None,
        Against::MotionCapture => Some(format!(
            "{name}: no truth in this recording. Altitude, place, tilt and the errors of estimates are against motion \
             capture, as it arrived."
        )),
        Against::Setpoint => Some(format!(
            "{name}: neither truth nor motion capture in this recording. Altitude and place are the estimate's less the \
             setpoint, where one is recorded; tilt_rad, estimate_m, nees and outside_bound are not known."
        )),
    };
    let each = experiment.plan.recordings.named().filter_map(of);
    let all = "Recordings flown again: motors, setpoints and the way flown are those of then, the same under every estimator.";
    let any = experiment.plan.recordings.named().next().map(|_| all.to_owned());
    let by_hand = "Flown by hand: each recording is given once more to the estimator that was in the loop, and measured against truth where it \
                   has one, else motion capture, else the estimate itself.";
    let by_hand = experiment.plan.is_by_hand().then(|| by_hand.to_owned());
    by_hand.into_iter().chain(any).chain(each).collect()
}

/// A level as it is shown: text without quotes, tables without braces.
pub fn shown(level: Option<&Value>) -> String {
    match level {
        None => String::new(),
        Some(Value::String(text)) => text.clone(),
        // What six digits would swallow keeps them all.
        Some(Value::Float(number)) if number.abs() < 1e-3 => number.to_string(),
        Some(Value::Float(number)) => format!("{number:.6}").trim_end_matches('0').trim_end_matches('.').to_owned(),
        Some(table @ Value::Table(_)) => {
            let plain = table.to_string().replace(" = {", ":").replace(['{', '}', '"'], " ");
            plain.split_whitespace().collect::<Vec<_>>().join(" ").replace(" = ", "=").replace(" ,", ",")
        }
        Some(other) => other.to_string(),
    }
}

fn condition(
    plan: &Plan,
    number: u64,
    rows: &BTreeMap<u64, &Row>,
    baseline: Option<(u64, &BTreeMap<u64, &Row>)>,
) -> rest::Condition {
    let mut lost: BTreeMap<String, u64> = BTreeMap::new();
    rows.values().filter(|row| !row.lost().is_empty()).for_each(|row| *lost.entry(kind_of_loss(row)).or_default() += 1);
    let kept =
        |measure: usize| rows.values().filter(|row| row.lost().is_empty()).filter_map(move |row| finite(row, measure));
    let count = |is: fn(&Row) -> bool| rows.values().filter(|row| is(row)).count() as u64;
    let attacked = count(Row::attacked);
    let difference = |measure: usize| {
        let (baseline, beside) = baseline?;
        let pair = |(repeat, row): (&u64, &&Row)| {
            let other = beside.get(repeat).filter(|other| other.lost().is_empty() && row.lost().is_empty())?;
            Some(finite(row, measure)? - finite(other, measure)?)
        };
        difference(baseline, &rows.iter().filter_map(pair).collect::<Vec<_>>())
    };
    rest::Condition {
        number,
        levels: plan.levels(number).iter().map(|level| shown(level.as_ref())).collect(),
        flights: rows.len() as u64,
        lost,
        measures: (0..MEASURES.len()).map(|measure| spread(&kept(measure).collect::<Vec<_>>())).collect(),
        detected: (attacked > 0).then(|| part(count(Row::detected), attacked)),
        expected: None,
        tick_us: None,
        differences: (0..MEASURES.len()).map(difference).collect(),
    }
}

/// "0.53 m astray" is one kind with every other.
fn kind_of_loss(row: &Row) -> String {
    if row.lost().contains("astray") { "astray".into() } else { row.lost().into() }
}

fn finite(row: &Row, measure: usize) -> Option<f64> {
    row.values.get(measure).copied().filter(|value| value.is_finite())
}

/// Of these values; `None` of nothing.
pub fn spread(values: &[f64]) -> Option<rest::Spread> {
    (!values.is_empty()).then(|| rest::Spread {
        count: values.len() as u64,
        least: values.iter().copied().fold(f64::NAN, f64::min),
        quarter: percentile(values, 0.25),
        median: median(values),
        three_quarters: percentile(values, 0.75),
        of_95: percentile(values, 0.95),
        most: worst(values),
        interval: median_interval(values),
    })
}

/// `count` of `of`, with the interval of Wilson (1927).
pub fn part(count: u64, of: u64) -> rest::Part {
    let (k, n) = (count as f64, of as f64);
    let (p, z2) = (k / n, Z_95 * Z_95);
    let centre = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    let interval = if of == 0 { [0.0, 1.0] } else { [(centre - half).max(0.0), (centre + half).min(1.0)] };
    rest::Part { count, of, interval }
}

/// Of paired differences; `None` of nothing.
pub fn difference(baseline: u64, of: &[f64]) -> Option<rest::Difference> {
    let n = of.len() as f64;
    let mean = of.iter().sum::<f64>() / n;
    let deviation = (of.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    let effect = (of.len() > 1 && deviation > 0.0).then(|| mean / deviation);
    let pairs = of.len() as u64;
    (pairs > 0).then(|| rest::Difference { baseline, pairs, median: median(of), interval: median_interval(of), effect })
}

/// Flights from the place `from` on, at most `count`, of one condition or of all.
///
/// # Errors
/// [`StoreError::Io`].
pub fn flights(
    experiment: &Experiment,
    from: usize,
    count: usize,
    condition: Option<u64>,
) -> Result<rest::Flights, StoreError> {
    let plan = &experiment.plan;
    let rows = experiment.rows()?;
    let wanted = |row: &&Row| condition.is_none_or(|condition| plan.place(row.index.into()).0 == condition);
    let flight = |row: &Row| {
        let (condition, repeat) = plan.place(row.index.into());
        rest::Flight {
            index: row.index.into(),
            condition,
            seed: plan.seed_of(repeat),
            lost: row.lost().to_owned(),
            values: (0..MEASURES.len()).map(|measure| finite(row, measure)).collect(),
        }
    };
    let total = rows.iter().filter(wanted).count() as u64;
    Ok(rest::Flights { total, flights: rows.iter().filter(wanted).skip(from).take(count).map(flight).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Outcome;

    #[test]
    fn known_values() {
        // Wilson's interval of 8 of 10, as published tables and other programs give it.
        let part = part(8, 10);
        assert!((part.interval[0] - 0.490_16).abs() < 1e-4 && (part.interval[1] - 0.943_31).abs() < 1e-4, "{part:?}");
        // The ranks 2 and 9 of ten hold the median with 97.9 %.
        let values: Vec<f64> = (1..=10).map(f64::from).collect();
        let spread = spread(&values).unwrap();
        assert_eq!((spread.median, spread.quarter, spread.three_quarters, spread.most), (5.5, 3.0, 8.0, 10.0));
        assert_eq!(spread.interval, Some([2.0, 9.0]));
        // Mean 2, standard deviation 1.
        let difference = difference(0, &[1.0, 2.0, 3.0]).unwrap();
        assert_eq!((difference.median, difference.interval, difference.effect), (2.0, None, Some(2.0)));
        assert!(super::spread(&[]).is_none() && super::difference(0, &[]).is_none());
    }

    #[test]
    fn levels_are_shown_without_toml() {
        let table: toml::Table = toml::from_str("a = { strings = { mode = \"flight\", height_m = 0.3 } }").unwrap();
        assert_eq!(shown(table.get("a")), "strings: height_m=0.3, mode=flight");
        let numbers = [
            Value::Float(4e-7),
            Value::Float(0.05),
            Value::Float(2.0),
            Value::Integer(7),
            Value::String("none".into()),
        ];
        assert_eq!(numbers.map(|level| shown(Some(&level))), ["0.0000004", "0.05", "2", "7", "none"]);
        assert_eq!(shown(None), "");
    }

    #[test]
    fn the_interval_of_the_median_holds_it_as_often_as_it_says() {
        let mut dice = crate::draw::Dice::new(3);
        let holds = (0..2000).filter(|_| {
            let values: Vec<f64> = (0..25).map(|_| dice.normal()).collect();
            median_interval(&values).is_some_and(|[low, high]| low <= 0.0 && 0.0 <= high)
        });
        let part = holds.count() as f64 / 2000.0;
        // Ranks are whole numbers: of 25 values it is 95.7 %.
        assert!((0.94..=0.975).contains(&part), "{part}");
    }

    #[test]
    fn detected_counts_flights_in_which_something_was_attacked() {
        let plan = Plan::from_toml("name = \"a\"\nrepeats = 3\n[scenario]\nduration_s = 30\n").unwrap();
        let row = |missed: usize, delays_s: &[f64]| {
            Row::new(0, &Outcome { missed, delays_s: delays_s.to_vec(), ..Outcome::default() })
        };
        // Found, missed, and one that was down before the onset.
        let rows = [row(0, &[0.3]), row(1, &[]), row(0, &[])];
        let of = |rows: &[Row]| condition(&plan, 0, &(0..).zip(rows).collect(), None).detected;
        assert_eq!(of(&rows).map(|part| (part.count, part.of)), Some((1, 2)));
        assert_eq!(of(&rows[2..]), None);
    }
}

//! Two experiments side by side: two versions of the program on the same plan, or two plans that vary the same factors.
//!
//! Conditions belong together that have the same level of every factor, flights of these that have the same seed. The rows of a
//! version that had other measures are compared by those that both have.

use std::collections::BTreeMap;

use plumbline_rest::experiment as rest;
use toml::{Table, Value};

use crate::plan::Plan;
use crate::row::{MEASURES, Row};
use crate::store::{Experiment, StoreError};
use crate::summary::{difference, shown, spread};

/// What two experiments differ in.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Keys of the plans whose values differ: as they are in the first, and in the second.
    pub plans: Vec<(String, String, String)>,
    /// Was the program another one?
    pub programs: bool,
    /// Conditions that both have flights of, in the order of the first plan.
    pub conditions: Vec<Pair>,
    /// Conditions with flights in only one of them.
    pub alone: [usize; 2],
}

/// A condition of both.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Its levels, in the order of the first plan.
    pub levels: Vec<String>,
    /// Flights of the same seed in both.
    pub pairs: u64,
    /// How many of these are the same, bit for bit, in all measures that both have.
    pub same: u64,
    /// Flights lost of these pairs.
    pub lost: [u64; 2],
    /// Flights of these pairs whose attacked sensors were all excluded; `None` where nothing was attacked.
    pub detected: Option<[u64; 2]>,
    /// Of each measure, in the order of [`MEASURES`], over pairs of which neither was lost.
    pub measures: Vec<Option<Compared>>,
    /// Flights that went another way: lost in one of them, or found in one of them.
    pub turned: Vec<Turned>,
}

/// One measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// Median of each.
    pub medians: [f64; 2],
    /// The second less the first, flight by flight; its `baseline` is the first's condition.
    pub difference: rest::Difference,
}

/// A flight that went another way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Turned {
    /// Its seed.
    pub seed: u64,
    /// Its index in each.
    pub index: [u64; 2],
    /// How it went in each.
    pub went: [String; 2],
}

type Flights = BTreeMap<u64, Row>;

/// What the second differs from the first in.
///
/// # Errors
/// [`StoreError::Io`].
pub fn compare(first: &Experiment, second: &Experiment) -> Result<Comparison, StoreError> {
    let measured = |at: usize| {
        let has = |experiment: &Experiment| {
            MEASURES.get(at).is_some_and(|measure| experiment.identity.measures.iter().any(|name| name == measure.name))
        };
        has(first) && has(second)
    };
    let measured: Vec<bool> = (0..MEASURES.len()).map(measured).collect();
    let (ours, mut theirs) = (by_condition(first)?, by_condition(second)?);
    let mut conditions = Vec::new();
    let mut alone = 0;
    for (number, flights) in &ours {
        let other = theirs
            .iter()
            .position(|(number_there, _)| levels(&first.plan, *number) == levels(&second.plan, *number_there));
        match other.map(|other| theirs.remove(other)) {
            Some((_, others)) => conditions.push(pair(&first.plan, *number, flights, &others, &measured)),
            None => alone += 1,
        }
    }
    Ok(Comparison {
        plans: plans(&first.plan.text, &second.plan.text),
        programs: first.identity.program != second.identity.program,
        conditions,
        alone: [alone, theirs.len()],
    })
}

/// Conditions with flights, and these by their seed.
fn by_condition(experiment: &Experiment) -> Result<Vec<(u64, Flights)>, StoreError> {
    let plan = &experiment.plan;
    let mut conditions: BTreeMap<u64, Flights> = BTreeMap::new();
    for row in experiment.rows()? {
        let (condition, repeat) = plan.place(row.index.into());
        conditions.entry(condition).or_default().insert(plan.seed_of(repeat), row);
    }
    Ok(conditions.into_iter().collect())
}

fn levels(plan: &Plan, condition: u64) -> BTreeMap<&str, String> {
    let keys = plan.factors.iter().map(|factor| factor.key.as_str());
    keys.zip(plan.levels(condition).iter().map(|level| shown(level.as_ref()))).collect()
}

fn pair(plan: &Plan, number: u64, ours: &Flights, theirs: &Flights, measured: &[bool]) -> Pair {
    let pairs: Vec<(u64, &Row, &Row)> =
        ours.iter().filter_map(|(seed, row)| Some((*seed, row, theirs.get(seed)?))).collect();
    let count = |is: &dyn Fn(&Row) -> bool| {
        let of = |which: fn(&(u64, &Row, &Row)) -> Row| pairs.iter().filter(|pair| is(&which(pair))).count() as u64;
        [of(|pair| *pair.1), of(|pair| *pair.2)]
    };
    let same = |a: &Row, b: &Row| {
        let values = a.values.iter().zip(&b.values).zip(measured);
        a.lost() == b.lost() && values.into_iter().all(|((a, b), measured)| !measured || a.to_bits() == b.to_bits())
    };
    let compared = |at: usize| {
        let value = |row: &Row| row.values.get(at).copied().filter(|value| value.is_finite() && row.lost().is_empty());
        let both: Vec<[f64; 2]> = pairs.iter().filter_map(|(_, a, b)| Some([value(a)?, value(b)?])).collect();
        let of = |which: usize| both.iter().filter_map(|both| both.get(which).copied()).collect::<Vec<_>>();
        let medians = [spread(&of(0))?.median, spread(&of(1))?.median];
        let less: Vec<f64> = both.iter().map(|[a, b]| b - a).collect();
        Some(Compared { medians, difference: difference(number, &less)? })
    };
    let attacked = pairs.iter().any(|(_, a, b)| a.attacked() || b.attacked());
    let turned = pairs.iter().filter(|(_, a, b)| went(a) != went(b));
    let turned = turned.map(|(seed, a, b)| Turned {
        seed: *seed,
        index: [a.index.into(), b.index.into()],
        went: [went(a), went(b)],
    });
    Pair {
        levels: plan.levels(number).iter().map(|level| shown(level.as_ref())).collect(),
        pairs: pairs.len() as u64,
        same: pairs.iter().filter(|(_, a, b)| same(a, b)).count() as u64,
        lost: count(&|row| !row.lost().is_empty()),
        detected: attacked.then(|| count(&Row::detected)),
        measures: measured.iter().enumerate().map(|(at, measured)| measured.then(|| compared(at)).flatten()).collect(),
        turned: turned.collect(),
    }
}

/// In a word, without numbers that differ from flight to flight.
fn went(row: &Row) -> String {
    let lost = match row.lost() {
        "" => "",
        why if why.contains("astray") => "astray",
        why => why,
    };
    match (lost, row.value("missed") > 0.0) {
        ("", false) if row.attacked() => "all excluded".into(),
        ("", false) => "held".into(),
        ("", true) => "missed".into(),
        (lost, _) => format!("lost: {lost}"),
    }
}

/// Keys whose values differ, by their whole path.
fn plans(first: &str, second: &str) -> Vec<(String, String, String)> {
    let flat = |text: &str| {
        let mut flat = BTreeMap::new();
        if let Ok(table) = toml::from_str::<Table>(text) {
            flatten(&mut flat, "", &Value::Table(table));
        }
        flat
    };
    let (ours, theirs) = (flat(first), flat(second));
    let keys = ours.keys().chain(theirs.keys().filter(|key| !ours.contains_key(*key)));
    let differs = keys.filter(|key| ours.get(*key) != theirs.get(*key));
    let of = |flat: &BTreeMap<String, String>, key: &String| flat.get(key).cloned().unwrap_or_default();
    differs.map(|key| (key.clone(), of(&ours, key), of(&theirs, key))).collect()
}

fn flatten(flat: &mut BTreeMap<String, String>, path: &str, value: &Value) {
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                flatten(flat, &if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, value);
            }
        }
        value => {
            flat.insert(path.to_owned(), value.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_differ_where_a_value_does_and_not_in_order_or_comments() {
        let first = "name = \"a\"\nrepeats = 2\n[agent]\nbox = { lateral_m = 1.0, altitude_m = 2.0 } # room\n";
        let second = "repeats = 2\nname = \"a\"\nseed = 4\n[agent]\nbox = { altitude_m = 2.0, lateral_m = 1.5 }\n";
        let differ = plans(first, second);
        let texts: Vec<_> = differ.iter().map(|(key, a, b)| (key.as_str(), a.as_str(), b.as_str())).collect();
        assert_eq!(texts, [("agent.box.lateral_m", "1.0", "1.5"), ("seed", "", "4")]);
        assert!(plans(first, first).is_empty());
    }
}

//! What is varied, and which levels come together.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use toml::{Spanned, Table, Value};

use super::source::Source;
use super::{PlanError, RECORDING, SECTIONS};
use crate::draw::{Dice, derived};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawFactor {
    key: Spanned<String>,
    values: Option<Spanned<Vec<Value>>>,
    range: Option<Spanned<[f64; 2]>>,
    #[serde(default)]
    log: bool,
}

/// One thing that is varied.
#[derive(Debug, Clone, PartialEq)]
pub struct Factor {
    /// Where it stands in the plan: `attack.magnitude`.
    pub key: String,
    /// Its levels.
    pub levels: Levels,
    /// Where it is written, bytes.
    pub(super) span: Range<usize>,
}

/// Levels of a factor.
#[derive(Debug, Clone, PartialEq)]
pub enum Levels {
    /// These.
    Values(Vec<Value>),
    /// Everything between.
    Range {
        /// Smallest.
        low: f64,
        /// Largest.
        high: f64,
        /// Every tenfold is as likely as the next.
        log: bool,
    },
}

impl Factor {
    /// The last part of its key.
    pub fn name(&self) -> &str {
        self.key.rsplit('.').next().unwrap_or(&self.key)
    }

    /// Are all its levels numbers?
    pub fn is_number(&self) -> bool {
        match &self.levels {
            Levels::Values(values) => values.iter().all(|value| value.is_float() || value.is_integer()),
            Levels::Range { .. } => true,
        }
    }

    /// Is this one of its levels?
    pub fn has(&self, level: &Value) -> bool {
        matches!(&self.levels, Levels::Values(values) if values.contains(level))
    }

    /// Every level there is, or the ends.
    pub(super) fn extremes(&self) -> Vec<Value> {
        match &self.levels {
            Levels::Values(values) => values.clone(),
            Levels::Range { low, high, .. } => vec![Value::Float(*low), Value::Float(*high)],
        }
    }

    /// The level at `u`, 0 to 1.
    fn at(&self, u: f64) -> Option<Value> {
        match &self.levels {
            Levels::Values(values) => {
                let index = ((u * values.len() as f64) as usize).min(values.len().saturating_sub(1));
                values.get(index).cloned()
            }
            Levels::Range { low, high, log: true } => Some(Value::Float(low * (high / low).powf(u))),
            Levels::Range { low, high, log: false } => Some(Value::Float(low + (high - low) * u)),
        }
    }
}

/// The factors written, or those that a list of conditions names.
pub(super) fn read(
    source: Source<'_>,
    raw: &[Spanned<RawFactor>],
    conditions: &[Spanned<Table>],
) -> Result<Vec<Factor>, PlanError> {
    let mut factors: Vec<Factor> = Vec::new();
    for spanned in raw {
        let RawFactor { key, values, range, log } = spanned.get_ref();
        checked(source, key.get_ref(), &key.span(), &factors)?;
        let levels = match (values, range) {
            (Some(values), None) if values.get_ref().is_empty() => {
                return Err(source.at(&values.span(), format!("factor {}: values = [] has no level", key.get_ref())));
            }
            (Some(values), None) => Levels::Values(values.get_ref().clone()),
            (None, Some(range)) => {
                let [low, high] = *range.get_ref();
                if low >= high || (*log && low <= 0.0) {
                    let kind = if *log { "above 0 and rising, as log asks" } else { "rising" };
                    let message = format!("factor {}: range = [{low}, {high}] is not {kind}", key.get_ref());
                    return Err(source.at(&range.span(), message));
                }
                Levels::Range { low, high, log: *log }
            }
            _ => return Err(source.at(&key.span(), format!("factor {} needs values or a range", key.get_ref()))),
        };
        factors.push(Factor { key: key.get_ref().clone(), levels, span: key.span() });
    }
    for condition in conditions {
        for (key, value) in condition.get_ref() {
            match factors.iter_mut().find(|factor| factor.key == *key) {
                Some(Factor { levels: Levels::Values(values), .. }) if values.contains(value) => {}
                Some(Factor { levels: Levels::Values(values), .. }) => values.push(value.clone()),
                Some(_) => {}
                None => {
                    checked(source, key, &condition.span(), &factors)?;
                    let levels = Levels::Values(vec![value.clone()]);
                    factors.push(Factor { key: key.clone(), levels, span: condition.span() });
                }
            }
        }
    }
    Ok(factors)
}

fn checked(source: Source<'_>, key: &str, span: &Range<usize>, known: &[Factor]) -> Result<(), PlanError> {
    let (section, inner) = key.split_once('.').unwrap_or((key, ""));
    if !SECTIONS.contains(&section) || (inner.is_empty() != ["reception", RECORDING].contains(&section)) {
        let known = "not a key below scenario, agent, attack or by_hand, nor reception or recording";
        return Err(source.at(span, format!("factor {key:?} is {known}")));
    }
    if key == "scenario.seed" || key.starts_with("scenario.attack") {
        return Err(source.at(span, format!("factor {key:?}: seeds are the repeats', attacks are below attack")));
    }
    if known.iter().any(|factor| factor.key == key) {
        return Err(source.at(span, format!("factor {key:?} is there twice")));
    }
    Ok(())
}

/// How a sample follows from its seed. It is drawn anew at every look, so that an experiment keeps the way it was made by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Draw {
    /// Of experiments that name none: samples of neighbouring seeds have points in common.
    #[default]
    Joined,
    /// Another seed is another sample.
    Derived,
}

/// Which levels come together.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Design {
    /// Every combination; the last factor changes first.
    Grid,
    /// These.
    List(Vec<Table>),
    /// So many; each factor takes every part of its range once.
    LatinHypercube(u64),
    /// So many, each for itself.
    Draws(u64),
}

impl Design {
    pub(super) fn read(
        source: Source<'_>,
        design: Option<&Spanned<String>>,
        samples: Option<&Spanned<i64>>,
        conditions: &[Spanned<Table>],
        factors: &[Factor],
    ) -> Result<Self, PlanError> {
        let name = design.map_or(if conditions.is_empty() { "grid" } else { "list" }, |design| design.get_ref());
        let bad = |message: String| {
            let span = design.map(Spanned::span).or(samples.map(Spanned::span));
            Err(source.at(&span.unwrap_or(0..0), message))
        };
        let sampled = matches!(name, "latin_hypercube" | "draws");
        if !sampled && let Some(samples) = samples {
            let message = format!("samples = {} goes with latin_hypercube and draws", samples.get_ref());
            return Err(source.at(&samples.span(), message));
        }
        if name != "list"
            && let Some(condition) = conditions.first()
        {
            return Err(source.at(&condition.span(), format!("[[condition]] goes with the design list, not {name}")));
        }
        let count = samples.and_then(|samples| u64::try_from(*samples.get_ref()).ok()).filter(|count| *count > 0);
        match (name, count) {
            ("grid", _) => match factors.iter().find(|factor| matches!(factor.levels, Levels::Range { .. })) {
                Some(factor) => {
                    let key = &factor.key;
                    Err(source.at(&factor.span, format!("factor {key}: a grid needs values, not a range")))
                }
                None => Ok(Self::Grid),
            },
            ("list", _) if conditions.is_empty() => bad("design = \"list\" has no [[condition]]".into()),
            ("list", _) => Ok(Self::List(conditions.iter().map(|condition| condition.get_ref().clone()).collect())),
            ("latin_hypercube", Some(count)) => Ok(Self::LatinHypercube(count)),
            ("draws", Some(count)) => Ok(Self::Draws(count)),
            ("latin_hypercube" | "draws", None) => {
                let given = samples.map_or("absent".to_owned(), |samples| samples.get_ref().to_string());
                bad(format!("design = {name:?}: samples is {given}, not 1 or more"))
            }
            _ => bad(format!("design = {name:?} is not grid, list, latin_hypercube or draws")),
        }
    }

    /// How many conditions.
    pub(super) fn count(&self, factors: &[Factor]) -> u128 {
        match self {
            Self::Grid => factors.iter().fold(1, |product: u128, factor| match &factor.levels {
                Levels::Values(values) => product.saturating_mul(values.len() as u128),
                Levels::Range { .. } => 0,
            }),
            Self::List(conditions) => conditions.len() as u128,
            Self::LatinHypercube(count) | Self::Draws(count) => u128::from(*count),
        }
    }

    /// The level of each factor in a condition.
    pub(super) fn levels(&self, factors: &[Factor], seed: u64, draw: Draw, condition: u64) -> Vec<Option<Value>> {
        let joined = draw == Draw::Joined;
        let dice = |seed: u64| Dice::new(if joined { seed ^ condition } else { derived(seed, condition) });
        match self {
            Self::Grid => {
                let mut left = condition;
                let mut levels: Vec<_> = factors
                    .iter()
                    .rev()
                    .map(|factor| {
                        let Levels::Values(values) = &factor.levels else { return None };
                        let count = values.len().max(1) as u64;
                        let level = values.get((left % count) as usize).cloned();
                        left /= count;
                        level
                    })
                    .collect();
                levels.reverse();
                levels
            }
            Self::List(conditions) => {
                let listed = conditions.get(condition as usize);
                factors.iter().map(|factor| listed.and_then(|table| table.get(&factor.key)).cloned()).collect()
            }
            Self::Draws(_) => {
                let mut dice = dice(seed ^ 0xd4a5_0000_0000);
                factors.iter().map(|factor| factor.at(dice.uniform())).collect()
            }
            Self::LatinHypercube(count) => {
                let mut dice = dice(seed ^ 0x1a71_0000_0000);
                let key = |at: u64| if joined { seed.wrapping_add(at) } else { derived(seed ^ 0x57a7_0000_0000, at) };
                let stratum = |at: usize| shuffled(condition, *count, key(at as u64));
                let each = factors.iter().enumerate();
                each.map(|(at, factor)| factor.at((stratum(at) as f64 + dice.uniform()) / *count as f64)).collect()
            }
        }
    }
}

/// Where `index` of `0..count` goes in a permutation that follows from `key`, without making the whole of it: a Feistel network
/// of four rounds over the next power of four, walked until it comes back into the range (Black & Rogaway 2002).
fn shuffled(index: u64, count: u64, key: u64) -> u64 {
    let bits = (64 - count.saturating_sub(1).leading_zeros()).max(1).div_ceil(2);
    let mask = (1_u64 << bits) - 1;
    let mut at = index;
    loop {
        let (mut left, mut right) = (at >> bits, at & mask);
        for round in 0..4_u64 {
            let mut dice = Dice::new(key ^ (round << 56) ^ (right << 8) ^ 0x00fe_1573);
            let mixed = (dice.uniform() * (mask + 1) as f64) as u64;
            (left, right) = (right, left ^ (mixed & mask));
        }
        at = (left << bits) | right;
        if at < count {
            return at;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shuffle_takes_every_place_once() {
        for count in [1, 2, 7, 64, 1000] {
            for key in [1, 99] {
                let mut places: Vec<_> = (0..count).map(|index| shuffled(index, count, key)).collect();
                places.sort_unstable();
                assert_eq!(places, (0..count).collect::<Vec<_>>(), "{count}, {key}");
            }
        }
        let one: Vec<_> = (0..64).map(|index| shuffled(index, 64, 1)).collect();
        let other: Vec<_> = (0..64).map(|index| shuffled(index, 64, 2)).collect();
        assert_ne!(one, other);
    }

    #[test]
    fn another_seed_is_another_sample() {
        let factor = |key: &str| Factor {
            key: key.into(),
            levels: Levels::Range { low: 0.0, high: 64.0, log: false },
            span: 0..0,
        };
        let factors = [factor("scenario.a"), factor("scenario.b")];
        let sample = |design: &Design, seed: u64, at: usize| -> Vec<u64> {
            let levels =
                (0..64).filter_map(|n| design.levels(&factors, seed, Draw::Derived, n).get(at)?.as_ref()?.as_float());
            levels.map(f64::to_bits).collect()
        };
        for design in [Design::Draws(64), Design::LatinHypercube(64)] {
            let points: std::collections::BTreeSet<u64> = (0..4).flat_map(|seed| sample(&design, seed, 0)).collect();
            assert_eq!(points.len(), 4 * 64, "{design:?}: a point of one seed is one of another");
        }
        // The strata of a factor are not those of its neighbour under the next seed.
        let strata = |seed: u64, at: usize| -> Vec<u64> {
            let points = sample(&Design::LatinHypercube(64), seed, at);
            points.into_iter().map(|point| f64::from_bits(point) as u64).collect()
        };
        assert!((0..4).all(|seed| strata(seed, 1) != strata(seed + 1, 0)));
        // What was flown with points in common keeps them.
        let flown = |seed, n| Design::Draws(64).levels(&factors, seed, Draw::Joined, n);
        assert_eq!(flown(0, 1), flown(1, 0));
        let strata = |seed, at: usize| -> Vec<Option<u64>> {
            let flown = |n| Design::LatinHypercube(64).levels(&factors, seed, Draw::Joined, n);
            (0..64).map(|n| Some(flown(n).get(at)?.as_ref()?.as_float()? as u64)).collect()
        };
        assert_eq!(strata(0, 1), strata(1, 0));
    }
}

//! A plan: a scenario, an agent, an attack, and what is varied in them.
//!
//! ```toml
//! name = "bias_of_a_height"
//! repeats = 20                      # flights of each condition; a repeat has the same seed in all of them
//! seed = 1000                       # of the first repeat
//! reception = "all"                 # or what stands before the estimator: "oracle", "median", "chi_square", "cusum", "ekf_per_imu"
//!
//! [scenario]                        # as a scenario file, without seed and attacks
//! world = "datasheet"
//! [agent]                           # as an agent's configuration
//! estimators = { in_loop = "secure" }
//! [attack]                          # one sensor; what is left out is drawn from the flight's seed, and the sign of a bias or ramp
//!                                   # unless `sign = "given"`
//! sensor = "height"
//! kind = "bias"
//!
//! [[factor]]                        # any key of these tables
//! key = "attack.magnitude"
//! values = [0.02, 0.05, 0.1, 0.2]
//! ```
//! Instead of a scenario a plan may have `recording = "FLIGHT"`, most often as a factor: that flight is flown again, its motors and
//! setpoints those of then. With an `[attack]`, even one of `sensor = "none"`, its samples are those sensed; without, those received.
//!
//! Or it has a table `[by_hand]` (`vehicle`, `altitude_m`, `hold_s`, `rest_s`, `gains`): an operator flies it on that vehicle, flight by
//! flight, in an order that is drawn.
//!
//! `design` is `grid` (every combination), `list` (each `[[condition]]`), `latin_hypercube` or `draws` (`samples` of them,
//! factors with `range = [low, high]`, `log = true`, or `values`). Flight `i` is repeat `i / conditions` of condition
//! `i % conditions`: repeats fill evenly, and results can be looked at while they do.

mod by_hand;
mod condition;
mod factor;
mod source;

use serde::Deserialize;
use sha2::{Digest, Sha256};
use toml::{Spanned, Table, Value};

pub use by_hand::ByHand;
pub use condition::Condition;
pub use factor::{Draw, Factor, Levels};
pub use source::PlanError;

use crate::recordings::{Library, Named, Recordings};
use condition::Wrong;
use factor::Design;
use source::Source;

/// Most flights of a plan: results of this many fit into memory.
pub const MAX_FLIGHTS: u64 = 1_000_000;
/// Most conditions that are tried before the start; of the rest each level is.
const TRIED: u64 = 200;
/// Where factors reach.
const SECTIONS: [&str; 6] = ["scenario", "agent", "attack", "reception", RECORDING, by_hand::SECTION];
/// What is flown instead of a scenario.
const RECORDING: &str = "recording";
/// Hash of the sources that decide how a flight goes, and the version.
pub const PROGRAM: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("PLUMBLINE_SOURCES"));

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPlan {
    name: Spanned<String>,
    #[serde(default)]
    description: String,
    #[serde(default)]
    scenario: Table,
    #[serde(default)]
    agent: Table,
    #[serde(default)]
    attack: Table,
    by_hand: Option<Table>,
    reception: Option<String>,
    recording: Option<Spanned<String>>,
    design: Option<Spanned<String>>,
    samples: Option<Spanned<i64>>,
    #[serde(default)]
    factor: Vec<Spanned<factor::RawFactor>>,
    #[serde(default)]
    condition: Vec<Spanned<Table>>,
    repeats: Option<Spanned<i64>>,
    seed: Option<Spanned<i64>>,
    baseline: Option<Spanned<Table>>,
    stop: Option<Spanned<RawStop>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStop {
    interval: Option<f64>,
    measure: Option<String>,
    minutes: Option<f64>,
}

/// When a plan ends early.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    /// A condition has enough repeats when the 95 % interval of the median of this measure, over the flights that were not lost, is
    /// narrower than this part of the median. Looked at after each ten repeats.
    pub interval: Option<(String, f64)>,
    /// Budget, s.
    pub budget_s: Option<f64>,
}

/// A plan that can be flown.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Short name.
    pub name: String,
    /// For people.
    pub description: String,
    /// As it was written.
    pub text: String,
    /// What is varied.
    pub factors: Vec<Factor>,
    /// Flights of each condition.
    pub repeats: u64,
    /// Seed of the first repeat.
    pub seed: u64,
    /// How levels of samples follow from it.
    pub draw: Draw,
    /// When it ends early.
    pub stop: Option<Stop>,
    /// Recordings that it names; none before they are looked for.
    pub recordings: Recordings,
    base: Table,
    design: Design,
    baseline: Vec<(usize, Value)>,
}

impl Plan {
    /// Reads and tries a plan of simulated flights: every level of every factor, and every condition where they are not too many.
    ///
    /// # Errors
    /// [`PlanError`]: the first line that cannot be flown.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        Self::over(text, &Library::default())
    }

    /// The same of a plan that may name recordings of this library.
    ///
    /// # Errors
    /// [`PlanError`]: the first line that cannot be flown.
    pub fn over(text: &str, library: &Library) -> Result<Self, PlanError> {
        let plan = Self::parse(text)?;
        let plan = plan.found(Source::new(text), library)?;
        plan.tried(Source::new(text))?;
        Ok(plan)
    }

    /// The same with these recordings, which were found when it was tried.
    pub fn knowing(self, named: &[Named]) -> Self {
        Self { recordings: Recordings::known(named), ..self }
    }

    /// Reads a plan without trying what it varies: one that was tried before.
    ///
    /// # Errors
    /// [`PlanError`]: the first line that is not one of a plan.
    pub fn parse(text: &str) -> Result<Self, PlanError> {
        let source = Source::new(text);
        let raw: RawPlan = source.read()?;
        if let Some(error) = source.not_finite() {
            return Err(error);
        }
        let name = named(source, &raw.name)?;
        for (key, instead) in [("scenario.seed", "`seed` of the plan"), ("scenario.attack", "`[attack]` of the plan")] {
            let (_, inner) = key.split_once('.').unwrap_or_default();
            if raw.scenario.contains_key(inner) {
                return Err(source.of(key, format!("{key} is given: it is {instead}")));
            }
        }
        let factors = factor::read(source, &raw.factor, &raw.condition)?;
        let design = Design::read(source, raw.design.as_ref(), raw.samples.as_ref(), &raw.condition, &factors)?;
        let mut base = Table::new();
        base.insert("scenario".into(), Value::Table(raw.scenario));
        base.insert("agent".into(), Value::Table(raw.agent));
        base.insert("attack".into(), Value::Table(raw.attack));
        base.insert("reception".into(), Value::String(raw.reception.unwrap_or_else(|| "all".into())));
        if let Some(table) = raw.by_hand {
            base.insert(by_hand::SECTION.into(), Value::Table(table));
        }
        if let Some(recording) = raw.recording {
            base.insert(RECORDING.into(), Value::String(recording.into_inner()));
        }
        let whole = |spanned: Option<&Spanned<i64>>, key: &str, default: u64| match spanned {
            None => Ok(default),
            Some(value) => u64::try_from(*value.get_ref())
                .map_err(|_| source.at(&value.span(), format!("{key} = {} is not 0 or more", value.get_ref()))),
        };
        let repeats = whole(raw.repeats.as_ref(), "repeats", 1)?;
        let plan = Self {
            name,
            description: raw.description,
            text: text.to_owned(),
            repeats,
            seed: whole(raw.seed.as_ref(), "seed", 1)?,
            draw: Draw::Derived,
            stop: raw.stop.as_ref().map(|stop| stop_rule(source, stop)).transpose()?,
            baseline: baseline(source, raw.baseline.as_ref(), &factors)?,
            recordings: Recordings::default(),
            factors,
            base,
            design,
        };
        plan.counted(source)?;
        Ok(plan)
    }

    /// How many conditions there are.
    pub fn conditions(&self) -> u64 {
        self.design.count(&self.factors).min(u128::from(u64::MAX)) as u64
    }

    /// How many flights there are.
    pub fn flights(&self) -> u64 {
        self.conditions().saturating_mul(self.repeats)
    }

    /// Condition and repeat of a flight.
    pub fn place(&self, index: u64) -> (u64, u64) {
        let conditions = self.conditions().max(1);
        (index % conditions, index / conditions)
    }

    /// Seed of a repeat, the same in every condition: what differs between them is not luck.
    pub fn seed_of(&self, repeat: u64) -> u64 {
        self.seed.wrapping_add(repeat)
    }

    /// The level of each factor in a condition; `None` where a list leaves it as it is.
    pub fn levels(&self, condition: u64) -> Vec<Option<Value>> {
        self.design.levels(&self.factors, self.seed, self.draw, condition)
    }

    /// The condition that `condition` is compared with, flight by flight of the same seed; `None` for that one itself.
    pub fn baseline_of(&self, condition: u64) -> Option<u64> {
        let of = if self.baseline.is_empty() {
            0
        } else {
            let mut levels = self.levels(condition);
            for (factor, value) in &self.baseline {
                if let Some(level) = levels.get_mut(*factor) {
                    *level = Some(value.clone());
                }
            }
            (0..self.conditions().min(TRIED * 50)).find(|other| self.levels(*other) == levels)?
        };
        (of != condition).then_some(of)
    }

    /// A condition, ready to be flown.
    ///
    /// # Errors
    /// What is wrong with its scenario, agent or attack.
    pub fn condition(&self, condition: u64) -> Result<Condition, String> {
        if self.is_by_hand() {
            return Err("it is flown by hand".into());
        }
        Condition::read(&self.table(condition)?, &self.recordings)
            .map_err(|wrong| format!("{}: {}", wrong.section, wrong.complaint))
    }

    /// Does a condition alter samples? What breaks, and what was attacked in a recording, is not altered by it.
    pub(crate) fn attacks(&self, condition: u64) -> bool {
        let attack = self.table(condition).and_then(|table| condition::attack_of(&table));
        attack.is_ok_and(|(attacked, off)| !off && attacked.alters())
    }

    /// Is it flown by an operator on a vehicle, and not by this program?
    pub fn is_by_hand(&self) -> bool {
        self.base.contains_key(by_hand::SECTION)
    }

    /// A condition that an operator is led through.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn by_hand(&self, condition: u64) -> Result<ByHand, String> {
        ByHand::read(&self.table(condition)?).map_err(|wrong| format!("{}: {}", wrong.section, wrong.complaint))
    }

    /// The tables of a condition.
    fn table(&self, condition: u64) -> Result<Table, String> {
        let mut table = self.base.clone();
        for (factor, level) in self.factors.iter().zip(self.levels(condition)) {
            if let Some(level) = level {
                set(&mut table, &factor.key, level)?;
            }
        }
        Ok(table)
    }

    /// Can these tables be flown?
    fn attempted(&self, table: &Table) -> Result<(), Wrong> {
        match self.is_by_hand() {
            true => ByHand::read(table).map(drop),
            false => Condition::read(table, &self.recordings).map(drop),
        }
    }

    /// What tells this plan, flown by this program, from every other.
    pub fn hash(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(PROGRAM.as_bytes());
        // Comments and the order of the keys change nothing.
        let canonical = toml::from_str::<Table>(&self.text).map(|table| table.to_string()).unwrap_or_default();
        hash.update(canonical.as_bytes());
        for Named { name, sha256, .. } in self.recordings.named() {
            hash.update(format!("\n{name} {sha256}"));
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// With the recordings that it names, each found, read and hashed.
    fn found(self, source: Source<'_>, library: &Library) -> Result<Self, PlanError> {
        let base = self.base.get(RECORDING).map(|name| (name, None));
        let factors = self.factors.iter().filter(|factor| factor.key == RECORDING);
        let levels = factors.flat_map(|factor| factor.extremes().into_iter().map(move |level| (level, Some(factor))));
        let levels = base.map(|(name, none)| (name.clone(), none)).into_iter().chain(levels);
        let levels: Vec<(Value, Option<&Factor>)> = levels.collect();
        let wrong = |factor: Option<&Factor>, level: &Value, message: String| match factor {
            Some(factor) => source.at(&factor.span, format!("factor {RECORDING} = {level}: {message}")),
            None => source.of(RECORDING, message),
        };
        let mut named: Vec<(&str, Option<&Factor>, &Value)> = Vec::new();
        for (level, factor) in &levels {
            let name = level.as_str().ok_or_else(|| wrong(*factor, level, "not the name of a recording".into()))?;
            if !named.iter().any(|(known, ..)| *known == name) {
                named.push((name, *factor, level));
            }
        }
        let names: Vec<&str> = named.iter().map(|(name, ..)| *name).collect();
        let recordings = Recordings::find(&names, library).map_err(|(at, error)| match named.get(at) {
            Some((_, factor, level)) => wrong(*factor, level, error.to_string()),
            None => source.of(RECORDING, error.to_string()),
        })?;
        Ok(Self { recordings, ..self })
    }

    /// Is every number of flights one that can be flown?
    fn counted(&self, source: Source<'_>) -> Result<(), PlanError> {
        let flights = self.design.count(&self.factors).saturating_mul(u128::from(self.repeats));
        let key = if self.repeats == 1 { "factor" } else { "repeats" };
        if flights == 0 {
            return Err(source.of(key, "there is no flight in it"));
        }
        let most = if self.is_by_hand() { by_hand::MOST } else { MAX_FLIGHTS };
        if flights > u128::from(most) {
            let conditions = self.design.count(&self.factors);
            let counted = format!("{conditions} conditions × {} repeats are {flights} flights", self.repeats);
            return Err(source.of(key, format!("{counted}, more than {most}")));
        }
        Ok(())
    }

    /// Can the plan as it stands, each level of each factor, and the first conditions be flown?
    fn tried(&self, source: Source<'_>) -> Result<(), PlanError> {
        // A base that lacks what every condition gives is no fault of it.
        let whole = self.conditions() <= TRIED;
        for condition in 0..self.conditions().min(TRIED) {
            self.attempt(source, &self.levels(condition))?;
        }
        if !whole {
            let first = self.levels(0);
            for (at, factor) in self.factors.iter().enumerate() {
                for level in factor.extremes() {
                    let mut levels = first.clone();
                    if let Some(place) = levels.get_mut(at) {
                        *place = Some(level);
                    }
                    self.attempt(source, &levels)?;
                }
            }
        }
        Ok(())
    }

    fn attempt(&self, source: Source<'_>, levels: &[Option<Value>]) -> Result<(), PlanError> {
        let mut table = self.base.clone();
        for (factor, level) in self.factors.iter().zip(levels) {
            if let Some(level) = level {
                let message = |wrong| source.at(&factor.span, format!("factor {} = {level}: {wrong}", factor.key));
                set(&mut table, &factor.key, level.clone()).map_err(message)?;
            }
        }
        let Err(wrong) = self.attempted(&table) else { return Ok(()) };
        // The factor whose level alone makes the difference is at fault, if one is.
        for (factor, level) in self.factors.iter().zip(levels) {
            let Some(level) = level else { continue };
            let mut alone = table.clone();
            unset(&mut alone, &factor.key, &self.base);
            if self.attempted(&alone).is_ok() {
                let message = format!("factor {} = {level}: {}", factor.key, wrong.complaint);
                return Err(source.at(&factor.span, message));
            }
        }
        Err(source.about(wrong.section, &wrong.complaint))
    }
}

fn named(source: Source<'_>, name: &Spanned<String>) -> Result<String, PlanError> {
    let text = name.get_ref();
    let fits =
        (1..=40).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
    let expected = "1 to 40 letters, digits, '_' or '-'";
    if fits { Ok(text.clone()) } else { Err(source.at(&name.span(), format!("name = {text:?} is not {expected}"))) }
}

fn stop_rule(source: Source<'_>, stop: &Spanned<RawStop>) -> Result<Stop, PlanError> {
    let raw = stop.get_ref();
    let bad = |message: String| Err(source.at(&stop.span(), message));
    if let Some(interval) = raw.interval.filter(|interval| *interval <= 0.0) {
        return bad(format!("stop.interval = {interval} is not above 0"));
    }
    if let Some(minutes) = raw.minutes.filter(|minutes| *minutes <= 0.0) {
        return bad(format!("stop.minutes = {minutes} is not above 0"));
    }
    let measure = raw.measure.clone().unwrap_or_else(|| "altitude_m".into());
    if !crate::row::MEASURES.iter().any(|known| known.name == measure) {
        let known: Vec<_> = crate::row::MEASURES.iter().map(|known| known.name).collect();
        return bad(format!("stop.measure = {measure:?} is not one of {}", known.join(", ")));
    }
    Ok(Stop { interval: raw.interval.map(|part| (measure, part)), budget_s: raw.minutes.map(|minutes| 60.0 * minutes) })
}

/// Levels that the reference of each comparison has.
fn baseline(
    source: Source<'_>,
    asked: Option<&Spanned<Table>>,
    factors: &[Factor],
) -> Result<Vec<(usize, Value)>, PlanError> {
    let Some(asked) = asked else { return Ok(Vec::new()) };
    let one = |(key, value): (&String, &Value)| {
        let at = factors.iter().position(|factor| factor.key == *key);
        let fits = at.filter(|at| factors.get(*at).is_some_and(|factor| factor.has(value)));
        fits.map(|at| (at, value.clone()))
            .ok_or_else(|| source.at(&asked.span(), format!("baseline {key} = {value} is no level of a factor")))
    };
    asked.get_ref().iter().map(one).collect()
}

/// Puts `value` where the dotted `path` leads.
fn set(table: &mut Table, path: &str, value: Value) -> Result<(), String> {
    let Some((first, rest)) = path.split_once('.') else {
        table.insert(path.to_owned(), value);
        return Ok(());
    };
    let inner = table.entry(first.to_owned()).or_insert_with(|| Value::Table(Table::new()));
    match inner {
        Value::Table(inner) => set(inner, rest, value),
        other => Err(format!("{first} = {other} has no {rest}")),
    }
}

/// Puts what `base` has there, or nothing.
fn unset(table: &mut Table, path: &str, base: &Table) {
    let was = path.split('.').try_fold(None::<&Value>, |at, part| {
        let inner = at.map_or(Some(base), Value::as_table);
        inner.and_then(|inner| inner.get(part)).map(Some)
    });
    match was.flatten() {
        Some(was) => drop(set(table, path, was.clone())),
        None => remove(table, path),
    }
}

fn remove(table: &mut Table, path: &str) {
    match path.split_once('.') {
        None => drop(table.remove(path)),
        Some((first, rest)) => {
            if let Some(inner) = table.get_mut(first).and_then(Value::as_table_mut) {
                remove(inner, rest);
            }
        }
    }
}

#[cfg(test)]
mod tests;

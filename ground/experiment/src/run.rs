//! Flying a plan: all cores, as fast as possible, every finished flight kept at once.
//!
//! Workers fly, one thread appends. Bound of what waits between them: [`WAITING`] rows; policy when full: a worker waits.
//! What a flight is follows from the plan, its index and its seed alone, so the order in which flights end, kills and the
//! number of cores change nothing of any row.

use std::collections::BTreeMap;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

use crate::draw::{median, median_interval};
use crate::expectation;
use crate::flight::fly;
use crate::plan::{Condition, Plan};
use crate::row::Row;
use crate::store::{Experiment, Held, StoreError};
use crate::ticks::{Gathered, Ticks};

/// Rows that may wait for the disk.
const WAITING: usize = 64;
/// Conditions kept ready; of a longer plan each flight reads its own.
const READY: u64 = 512;
/// Repeats after which a stopping rule is looked at, in every condition.
const BLOCK: u64 = 10;
/// The disk is asked to keep what was added this often.
const SYNC: Duration = Duration::from_secs(2);

/// How to fly.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Threads.
    pub threads: usize,
    /// Called first on each of them.
    pub on_thread: fn(),
}

impl Default for Options {
    fn default() -> Self {
        Self { threads: std::thread::available_parallelism().map_or(1, usize::from), on_thread: || {} }
    }
}

/// How far it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Flights there are.
    pub done: u64,
    /// Flights of the plan.
    pub flights: u64,
    /// Of this run, 1/s.
    pub per_s: f64,
    /// Until all are flown, s.
    pub left_s: f64,
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// Every flight that the plan and its stopping rule want is there.
    Complete,
    /// It was asked to.
    Stopped,
    /// The budget is spent.
    Spent,
}

/// Flies what is missing, and beside that asks the model what it expects. `each` hears of every flight when it is kept.
///
/// # Errors
/// [`StoreError`]: somebody else flies it, a recording is not what it was, or a row could not be kept; those before it are.
pub fn run(
    experiment: &Experiment,
    options: &Options,
    stop: &AtomicBool,
    each: impl FnMut(&Progress, &Row),
) -> Result<Ended, StoreError> {
    if experiment.plan.is_by_hand() {
        return Err(StoreError::ByHand(experiment.id.clone()));
    }
    experiment.plan.recordings.check()?;
    let mut held = experiment.hold()?;
    let over = AtomicBool::new(false);
    let go_on = || ![&over, stop].iter().any(|end| end.load(Ordering::Relaxed)) && !experiment.asked_to_stop();
    std::thread::scope(|scope| {
        let asked = scope.spawn(|| {
            (options.on_thread)();
            expectation::keep(experiment, go_on)
        });
        let ended = fly_missing(experiment, &mut held, options, stop, each);
        over.store(!matches!(ended, Ok(Ended::Complete)), Ordering::Relaxed);
        let asked = asked.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        ended.and_then(|ended| asked.map(|()| ended))
    })
}

fn fly_missing(
    experiment: &Experiment,
    held: &mut Held,
    options: &Options,
    stop: &AtomicBool,
    mut each: impl FnMut(&Progress, &Row),
) -> Result<Ended, StoreError> {
    let plan = &experiment.plan;
    let mut rows: BTreeMap<u32, Row> = experiment.rows()?.into_iter().map(|row| (row.index, row)).collect();
    let begun = Instant::now();
    let (before, flights) = (rows.len() as u64, plan.flights());
    let ready: Vec<OnceLock<Result<Condition, String>>> = match plan.conditions() {
        conditions if conditions <= READY => (0..conditions).map(|_| OnceLock::new()).collect(),
        _ => Vec::new(),
    };
    let budget = plan.stop.as_ref().and_then(|stop| stop.budget_s).map(Duration::from_secs_f64);
    let rule = plan.stop.as_ref().and_then(|stop| stop.interval.as_ref());
    let (mut synced, mut ticks) = (Instant::now(), Gathered::of(experiment));
    let mut failure = None;
    let repeats_at_once = if rule.is_some() { BLOCK } else { plan.repeats };
    let mut first = 0;
    while first < plan.repeats {
        let last = (first + repeats_at_once).min(plan.repeats);
        let wanted = missing(plan, &rows, first..last, rule);
        let (ended, next) = (AtomicBool::new(false), AtomicU64::new(0));
        let over = || ended.load(Ordering::Relaxed) || stop.load(Ordering::Relaxed);
        std::thread::scope(|scope| {
            let (sender, finished) = sync_channel::<(Row, Ticks)>(WAITING);
            let (wanted, next, over, ready) = (&wanted, &next, &over, &ready);
            for _ in 0..options.threads.max(1) {
                let sender = sender.clone();
                scope.spawn(move || {
                    (options.on_thread)();
                    work(experiment, ready, wanted, next, over, &sender);
                });
            }
            drop(sender);
            for (row, took) in finished {
                if failure.is_some() {
                    continue;
                }
                if let Err(error) = held.append(&row) {
                    failure = Some(error);
                    ended.store(true, Ordering::Relaxed);
                    continue;
                }
                if synced.elapsed() >= SYNC {
                    synced = Instant::now();
                    held.sync();
                    // No part of any row: what cannot be kept now is told when these flights are flown.
                    let _ = ticks.keep(experiment);
                }
                ticks.take(plan.place(row.index.into()).0, &took);
                rows.insert(row.index, row);
                let per_s = (rows.len() as u64 - before) as f64 / begun.elapsed().as_secs_f64();
                let done = rows.len() as u64;
                each(&Progress { done, flights, per_s, left_s: (flights - done) as f64 / per_s }, &row);
                if experiment.asked_to_stop() || budget.is_some_and(|budget| begun.elapsed() >= budget) {
                    ended.store(true, Ordering::Relaxed);
                }
            }
        });
        held.sync();
        if let Some(error) = failure {
            return Err(error);
        }
        ticks.keep(experiment)?;
        if stop.load(Ordering::Relaxed) || experiment.asked_to_stop() {
            return Ok(Ended::Stopped);
        }
        if ended.load(Ordering::Relaxed) {
            return Ok(Ended::Spent);
        }
        first = last;
    }
    Ok(Ended::Complete)
}

/// One worker: the next flight that is wanted, until there is none.
fn work(
    experiment: &Experiment,
    ready: &[OnceLock<Result<Condition, String>>],
    wanted: &[u64],
    next: &AtomicU64,
    over: &(impl Fn() -> bool + Sync),
    sender: &SyncSender<(Row, Ticks)>,
) {
    while !over() {
        let at = next.fetch_add(1, Ordering::Relaxed) as usize;
        let Some(index) = wanted.get(at).copied() else { return };
        let (condition, _) = experiment.plan.place(index);
        let own;
        let built = match ready.get(condition as usize) {
            Some(kept) => kept.get_or_init(|| experiment.plan.condition(condition)),
            None => {
                own = experiment.plan.condition(condition);
                &own
            }
        };
        let row = flown(&experiment.plan, built, index).unwrap_or_else(|error| {
            experiment.keep_error(index, &error);
            (Row::not_flown(index as u32), Ticks::default())
        });
        if sender.send(row).is_err() {
            return;
        }
    }
}

/// The row of one flight, and how long its ticks took.
///
/// # Errors
/// Why it cannot be flown.
pub fn flown(plan: &Plan, condition: &Result<Condition, String>, index: u64) -> Result<(Row, Ticks), String> {
    let (_, repeat) = plan.place(index);
    let setup = condition.as_ref().map_err(Clone::clone)?.setup(plan.seed_of(repeat));
    let outcome = fly(&setup).map_err(|error| error.to_string())?;
    Ok((Row::new(index as u32, &outcome), outcome.ticks))
}

/// Flights of these repeats that are not there, without the conditions that have enough. What is enough follows from whole blocks
/// of repeats before these, never from how many happen to be there.
fn missing(
    plan: &Plan,
    rows: &BTreeMap<u32, Row>,
    repeats: std::ops::Range<u64>,
    rule: Option<&(String, f64)>,
) -> Vec<u64> {
    let conditions = plan.conditions();
    let enough = |condition: u64| {
        let Some((measure, part)) = rule else { return false };
        let mut before = 0;
        while before + BLOCK <= repeats.start {
            before += BLOCK;
            let of = (0..before).filter_map(|repeat| rows.get(&((repeat * conditions + condition) as u32)));
            let kept = of.filter(|row| row.lost().is_empty());
            let values: Vec<f64> = kept.map(|row| row.value(measure)).filter(|value| value.is_finite()).collect();
            if median_interval(&values).is_some_and(|[low, high]| high - low <= part * median(&values).abs()) {
                return true;
            }
        }
        false
    };
    let satisfied: Vec<bool> = if rule.is_some() { (0..conditions).map(enough).collect() } else { Vec::new() };
    let of_repeat = |repeat: u64| (0..conditions).map(move |condition| (repeat * conditions + condition, condition));
    repeats
        .clone()
        .flat_map(of_repeat)
        .filter(|(index, condition)| {
            !rows.contains_key(&(*index as u32)) && !satisfied.get(*condition as usize).copied().unwrap_or(false)
        })
        .map(|(index, _)| index)
        .collect()
}

/// How long the missing flights will take on `threads`, s: the beginnings of a few are flown.
///
/// # Errors
/// A flight that cannot be flown.
pub fn expected_s(plan: &Plan, missing: u64, threads: usize) -> Result<f64, String> {
    const LOOKS: u64 = 4;
    const LENGTH_S: f64 = 5.0;
    let conditions = plan.conditions();
    if plan.is_by_hand() {
        let by_hand = plan.by_hand(0)?;
        return Ok(missing as f64 * (by_hand.lasts_s() + by_hand.rest_s));
    }
    let looks = LOOKS.min(conditions);
    let mut per_flight_s = 0.0;
    for look in 0..looks {
        let condition = plan.condition(look * conditions / looks)?;
        let mut setup = condition.setup(plan.seed);
        let whole_s = setup.scenario.duration_s;
        setup.scenario.duration_s = whole_s.min(LENGTH_S);
        let begun = Instant::now();
        fly(&setup).map_err(|error| error.to_string())?;
        per_flight_s += begun.elapsed().as_secs_f64() * whole_s / setup.scenario.duration_s / looks as f64;
    }
    Ok(per_flight_s * missing as f64 / threads.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Outcome;

    #[test]
    fn a_condition_has_enough_when_six_flights_that_were_not_lost_agree() {
        let plan = Plan::from_toml("name = \"a\"\nrepeats = 20\n[scenario]\nduration_s = 30\n").unwrap();
        let rule = ("delay_s".to_owned(), 0.1);
        // Of the first ten flights `found` have the same delay; the others have none, or had it before they were lost.
        let wanted = |found: u32, then_lost: bool| {
            let row = |index: u32| {
                let delays_s = if index < found || then_lost { vec![0.3] } else { Vec::new() };
                let lost = (index >= found && then_lost).then(|| "astray".to_owned());
                (index, Row::new(index, &Outcome { delays_s, lost, ..Outcome::default() }))
            };
            missing(&plan, &(0..10).map(row).collect(), 10..20, Some(&rule)).len()
        };
        assert_eq!([wanted(1, false), wanted(5, true), wanted(6, true), wanted(10, false)], [10, 10, 0, 0]);
    }
}

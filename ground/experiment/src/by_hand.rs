//! Experiments that an operator flies on a vehicle: the order of their flights, what was said of each, and the row that an accepted
//! one gets.
//!
//! Every block has each condition once, in an order drawn from the plan's seed. What was said of a flight is appended to
//! `by_hand.jsonl`, and the last word counts; a kill can only tear the last line, which is asked for again. An accepted recording is
//! flown again through the estimator that was in the loop, as every recording of a plan is, and measured by the same judge.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;

use plumbline_rest::experiment::FlownByHand;

use crate::draw::Dice;
use crate::flight::{FlyError, fly};
use crate::plan::Plan;
use crate::recordings::{Library, Recordings, UnusableError};
use crate::row::Row;
use crate::store::{Experiment, StoreError};

/// Why nothing can be said of a flight.
#[derive(Debug, thiserror::Error)]
pub enum ByHandError {
    /// The experiment.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The plan has fewer flights, or is not flown by hand.
    #[error("flight {0} is not one that is flown by hand here")]
    Unknown(u64),
    /// Another flight has its place.
    #[error("flight {index} of the plan was flown as {flight}: void that first")]
    Taken {
        /// Of the plan.
        index: u64,
        /// What it was flown as.
        flight: String,
    },
    /// The recording has another place.
    #[error("{flight} is flight {index} of the plan already")]
    Used {
        /// Of the plan.
        index: u64,
        /// The recording.
        flight: String,
    },
    /// A void flight says why.
    #[error("say why the flight is void")]
    NoReason,
    /// The recording.
    #[error(transparent)]
    Recording(#[from] UnusableError),
    /// It cannot be judged.
    #[error("{flight}: {reason}")]
    Judged {
        /// The recording.
        flight: String,
        /// Why.
        reason: String,
    },
    /// It was flown again, and could not be.
    #[error(transparent)]
    Fly(#[from] FlyError),
}

/// The flights of a plan in the order in which they are flown: block by block, each condition once.
pub fn order(plan: &Plan) -> Vec<u64> {
    let conditions = plan.conditions();
    let block = |repeat: u64| {
        let mut dice = Dice::new(plan.seed_of(repeat) ^ 0x0b1c_c0de);
        let shuffled = dice.choose(conditions as usize, conditions as usize);
        shuffled.into_iter().map(move |condition| repeat * conditions + condition as u64)
    };
    (0..plan.repeats).flat_map(block).collect()
}

fn path(experiment: &Experiment) -> PathBuf {
    experiment.folder.join("by_hand.jsonl")
}

/// Everything that was said of its flights, the oldest first.
///
/// # Errors
/// [`StoreError::Io`].
pub fn said(experiment: &Experiment) -> Result<Vec<FlownByHand>, StoreError> {
    let path = path(experiment);
    match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(source) => Err(StoreError::Io { path, source }),
        Ok(text) => Ok(text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()),
    }
}

/// The recording that each accepted flight of the plan was flown as.
///
/// # Errors
/// [`StoreError::Io`].
pub fn accepted(experiment: &Experiment) -> Result<BTreeMap<u64, String>, StoreError> {
    let mut accepted = BTreeMap::new();
    for FlownByHand { index, flight, accepted: counts, .. } in said(experiment)? {
        if counts {
            accepted.insert(index, flight);
        } else if accepted.get(&index) == Some(&flight) {
            accepted.remove(&index);
        }
    }
    Ok(accepted)
}

/// The first flight in [`order`] that is not accepted, and its place in it, from 0.
///
/// # Errors
/// [`StoreError::Io`].
pub fn next(experiment: &Experiment) -> Result<Option<(usize, u64)>, StoreError> {
    let accepted = accepted(experiment)?;
    Ok(order(&experiment.plan).into_iter().enumerate().find(|(_, index)| !accepted.contains_key(index)))
}

/// Keeps what is said of a flight. One that is accepted is judged first, and has its row then.
///
/// # Errors
/// [`ByHandError`]: nothing was kept.
pub fn keep(experiment: &Experiment, told: &FlownByHand, library: &Library) -> Result<(), ByHandError> {
    let plan = &experiment.plan;
    let FlownByHand { index, flight, .. } = told;
    if !plan.is_by_hand() || *index >= plan.flights() {
        return Err(ByHandError::Unknown(*index));
    }
    if !told.accepted && told.reason.trim().is_empty() {
        return Err(ByHandError::NoReason);
    }
    free(experiment, told)?;
    let row = if told.accepted { Some(judged(plan, *index, flight, library)?) } else { None };
    // Whoever holds it is alone with its files: now nobody else takes the place. A row without the word for it does not count; a word
    // without its row would.
    let mut held = experiment.hold()?;
    free(experiment, told)?;
    if let Some(row) = row {
        held.append(&row)?;
        held.sync();
    }
    let line = serde_json::to_string(told).unwrap_or_default() + "\n";
    let path = path(experiment);
    let kept = File::options().append(true).create(true).open(&path).and_then(|mut file| {
        // A torn line ends here.
        let begun = file.metadata()?.len() > 0 && !std::fs::read(&path)?.ends_with(b"\n");
        file.write_all(format!("{}{line}", if begun { "\n" } else { "" }).as_bytes())?;
        file.sync_data()
    });
    kept.map_err(|source| ByHandError::Store(StoreError::Io { path, source }))
}

/// May it be accepted: is its place of the plan free, and has the recording no other?
fn free(experiment: &Experiment, told: &FlownByHand) -> Result<(), ByHandError> {
    if !told.accepted {
        return Ok(());
    }
    let accepted = accepted(experiment)?;
    if let Some(flight) = accepted.get(&told.index) {
        return Err(ByHandError::Taken { index: told.index, flight: flight.clone() });
    }
    match accepted.into_iter().find(|(_, known)| *known == told.flight) {
        Some((index, flight)) => Err(ByHandError::Used { index, flight }),
        None => Ok(()),
    }
}

fn judged(plan: &Plan, index: u64, flight: &str, library: &Library) -> Result<Row, ByHandError> {
    let refused = |reason: String| ByHandError::Judged { flight: flight.to_owned(), reason };
    let (condition, repeat) = plan.place(index);
    let by_hand = plan.by_hand(condition).map_err(refused)?;
    let recordings = Recordings::find(&[flight], library).map_err(|(_, error)| error)?;
    let setup = by_hand.judged(flight, &recordings, plan.seed_of(repeat)).map_err(refused)?;
    Ok(Row::new(index as u32, &fly(&setup)?))
}

//! What the files of a flight hold, each message once.

use std::path::PathBuf;
use std::sync::Arc;

use mcap::McapResult;
use mcap::records::MessageHeader;

use super::flight::{Completeness, Flight, Learner};
use super::identity::{Ending, Identity, widen};
use super::intervals::IntervalSet;
use super::repair::{self, Damage};
use super::store::{Files, Labels};

/// Everything that the files of a flight say.
#[derive(Debug, Default)]
pub(super) struct Reading {
    pub(super) identity: Identity,
    pub(super) ending: Option<Ending>,
    pub(super) learner: Learner,
    pub(super) have: IntervalSet,
    pub(super) damage: Damage,
}

impl Reading {
    /// First sequence number of the flight, where a mark says it.
    pub(super) fn first(&self) -> Option<u64> {
        self.identity.first_sequence.or(self.learner.first_sequence)
    }

    /// First and last sequence number of the flight, as far as known.
    pub(super) fn range(&self) -> (Option<u64>, Option<u64>) {
        (self.first().or(self.have.min()), self.learner.last_sequence.or(self.ending.and_then(|e| e.last_sequence)))
    }

    /// Messages that are not there.
    pub(super) fn missing(&self) -> u64 {
        let (first, last) = self.range();
        match (first, last.or(self.have.max())) {
            (Some(first), Some(last)) => self.have.missing(first, last),
            _ => 0,
        }
    }

    /// Is the flight here from its first message to its last? Without its marks nobody knows.
    pub(super) fn whole(&self) -> bool {
        self.first().is_some() && self.range().1.is_some() && self.missing() == 0
    }

    /// What these files, by themselves, amount to.
    pub(super) fn ending(&self) -> Ending {
        let before = self.ending.unwrap_or_default();
        let completeness = match before.completeness {
            _ if self.whole() => Completeness::Complete,
            Completeness::Truncated => Completeness::Truncated,
            _ => Completeness::Filling,
        };
        let live = self.learner.messages().saturating_sub(before.filled);
        Ending { last_sequence: self.range().1, completeness, live, filled: before.filled }
    }

    /// The record of the flight.
    pub(super) fn flight(&self, id: &str, labels: Labels, size_bytes: u64) -> Flight {
        let ending = self.ending();
        let (first_sequence, last_sequence) = self.range();
        let mut flight = Flight {
            id: id.to_owned(),
            name: labels.name,
            notes: labels.notes,
            vehicle_id: self.identity.agent_id.clone(),
            boot_id: self.identity.boot_id,
            live: ending.live,
            filled: ending.filled,
            missing: self.missing(),
            first_sequence,
            last_sequence,
            completeness: ending.completeness,
            size_bytes,
            ..Flight::default()
        };
        self.learner.describe(&mut flight, self.identity.boot_wall_time_us);
        flight
    }
}

/// Reads the files one after the other and passes on each message once, up to message `last`. Answers what they
/// hold, and which of them are damaged, and how.
pub(super) fn gather(
    files: &Files,
    last: Option<u64>,
    mut each: impl FnMut(&Arc<mcap::Channel<'static>>, &MessageHeader, &[u8]) -> McapResult<()>,
) -> McapResult<(Reading, Vec<(PathBuf, String)>)> {
    let identity = files.identity();
    let learner = Learner::of(&identity.flight_id);
    let mut reading = Reading { identity, learner, ..Reading::default() };
    let mut damaged = Vec::new();
    let mut near = reading.identity.first_sequence;
    let boot_us = reading.identity.boot_wall_time_us;
    for path in files.finished.iter().chain(&files.parts) {
        let (learner, have) = (&mut reading.learner, &mut reading.have);
        let found = repair::scan(path, |channel, header, data| {
            // Other writers' files number nothing: 0 is always new.
            let mut sequence = 0;
            if header.sequence != 0 || near.is_some_and(|near| near > u64::from(u32::MAX)) {
                sequence = widen(header.sequence, *near.get_or_insert(u64::from(header.sequence)));
                if last.is_some_and(|last| sequence > last) || have.insert(sequence, sequence) == 0 {
                    return Ok(());
                }
            }
            learner.observe(&channel.topic, sequence, (header.log_time / 1000).saturating_sub(boot_us), data);
            each(channel, header, data)
        })?;
        if let Some(ending) = found.ending {
            let before = reading.ending.unwrap_or_default();
            reading.ending =
                Some(Ending { filled: before.filled.max(ending.filled), live: before.live.max(ending.live), ..ending });
        }
        match found.damage {
            Damage::Corrupt(reason) => {
                damaged.push((path.clone(), reason.clone()));
                reading.damage = Damage::Corrupt(reason);
            }
            Damage::Unfinished if reading.damage == Damage::None => reading.damage = Damage::Unfinished,
            _ => {}
        }
    }
    Ok((reading, damaged))
}

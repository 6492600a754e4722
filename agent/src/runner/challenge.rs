//! Proof that a page runs: a number nobody can guess in every status, and who answers it in time is there.
//!
//! The page of whoever holds control sends the number back; the ground only passes it on. A page that is closed, frozen
//! or hung answers no more, whatever the ground may do. An answer is triggered by the arrival of a status and not by a
//! timer, because browsers slow down the timers of a hidden tab (to one a second, later one a minute) and not its sockets.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;

use plumbline_proto::time::FlightTime;

/// A new challenge comes this often, s: every status has its own.
const PERIOD_S: f64 = 0.1;
/// Challenges that may still be answered: those of the last second or so.
const OPEN: usize = 12;

/// The challenges that are open.
#[derive(Debug)]
pub struct Challenges {
    /// Random for each start of the agent.
    secret: RandomState,
    issued: [(u64, FlightTime); OPEN],
    count: u64,
}

impl Default for Challenges {
    fn default() -> Self {
        Self { secret: RandomState::new(), issued: [(0, FlightTime(0)); OPEN], count: 0 }
    }
}

impl Challenges {
    /// The challenge of a status at `now`; never 0.
    pub fn current(&mut self, now: FlightTime) -> u64 {
        let (latest, at) = self.issued[self.slot(self.count)];
        if latest != 0 && now.seconds_since(at) < PERIOD_S {
            return latest;
        }
        self.count += 1;
        // SipHash with a random key: its next value cannot be told from those before.
        let challenge = self.secret.hash_one((self.count, now.0)).max(1);
        self.issued[self.slot(self.count)] = (challenge, now);
        challenge
    }

    /// When the challenge with this answer was issued; `None` for any other number, and for those too old.
    pub fn answered(&self, challenge: u64) -> Option<FlightTime> {
        let found = self.issued.iter().find(|(issued, _)| *issued == challenge && challenge != 0)?;
        Some(found.1)
    }

    fn slot(&self, count: u64) -> usize {
        (count % OPEN as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_recent_challenges_are_answers() {
        let mut challenges = Challenges::default();
        let at = |s| FlightTime::from_seconds(s);
        let first = challenges.current(at(1.0));
        assert_eq!(challenges.current(at(1.05)), first, "one for each status");
        assert_eq!(challenges.answered(first), Some(at(1.0)));
        assert_eq!(challenges.answered(first ^ 1), None);
        assert_eq!(challenges.answered(0), None);
        for n in 1..=OPEN {
            assert_ne!(challenges.current(at(1.0 + 0.11 * n as f64)), first);
        }
        assert_eq!(challenges.answered(first), None, "too late");
    }
}

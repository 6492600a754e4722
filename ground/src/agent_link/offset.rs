//! Clock offset and round trip from heartbeats and their echoes.
//!
//! The echo of a heartbeat sent at g₁ carries the agent's time a and comes back at g₂. Were both
//! ways equally long, the agent's clock read a at (g₁ + g₂)/2. The error is at most half the round
//! trip, so the sample of the shortest recent round trip is the one used.

use std::collections::VecDeque;

/// Samples the minimum is taken over: four seconds of heartbeats.
const WINDOW: usize = 40;
/// An echo older than this says nothing, µs.
const OLDEST_US: u64 = 10_000_000;

/// Keeps the recent samples.
#[derive(Debug, Default)]
pub struct OffsetEstimator {
    samples: VecDeque<(u64, f64)>,
}

impl OffsetEstimator {
    /// One echo: sent and received on the ground's clock, stamped on the agent's, all Unix µs.
    /// Answers `false`, and learns nothing, when the times cannot be true.
    pub fn add(&mut self, sent_us: u64, agent_us: u64, received_us: u64) -> bool {
        let Some(round_trip_us) = received_us.checked_sub(sent_us).filter(|round_trip| *round_trip <= OLDEST_US) else {
            return false;
        };
        let middle_us = sent_us as f64 + round_trip_us as f64 * 0.5;
        if self.samples.len() == WINDOW {
            self.samples.pop_front();
        }
        self.samples.push_back((round_trip_us, middle_us - agent_us as f64));
        true
    }

    /// Last round trip (ms) and the offset in use, ground minus agent (µs).
    pub fn estimate(&self) -> Option<(f64, f64)> {
        let (latest, _) = self.samples.back()?;
        let (_, offset) = self.samples.iter().min_by_key(|(round_trip, _)| *round_trip)?;
        Some((*latest as f64 * 1e-3, *offset))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_round_trip_is_used() {
        let mut offset = OffsetEstimator::default();
        // The agent's clock is 1 s behind; the way back is sometimes slow.
        for (n, back_us) in [9_000, 40_000, 3_000, 80_000].into_iter().enumerate() {
            let sent = 2_000_000_000 + n as u64 * 100_000;
            assert!(offset.add(sent, sent + 3_000 - 1_000_000, sent + 3_000 + back_us));
        }
        let (round_trip_ms, offset_us) = offset.estimate().unwrap();
        assert_eq!((round_trip_ms, offset_us), (83.0, 1_000_000.0));
    }

    #[test]
    fn impossible_echoes_teach_nothing() {
        let mut offset = OffsetEstimator::default();
        assert!(!offset.add(1_000, 0, 999), "from the future");
        assert!(!offset.add(0, 0, OLDEST_US + 1), "from long ago");
        assert_eq!(offset.estimate(), None);
    }
}

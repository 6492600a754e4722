//! When which attack was on: what the charts shade.

use std::collections::BTreeMap;

use plumbline_proto::v1::{self, AttackPhase};

/// Spans kept; the oldest go first.
const MAX_SPANS: usize = 500;

/// One attack on the time axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Span {
    /// When its schedule was accepted, µs.
    pub accepted_us: u64,
    /// The attack as scheduled.
    pub attack: v1::Attack,
    /// Where it stands.
    pub phase: AttackPhase,
    /// Begin, s of flight time: when it really altered a sample, else when it is due.
    pub start_s: f64,
    /// End, s; when it is due to end while it is on.
    pub end_s: f64,
    /// Did it really alter a sample?
    pub seen: bool,
}

/// Attacks by schedule and number.
#[derive(Debug, Default)]
pub struct Spans {
    map: BTreeMap<(u64, u32), Span>,
}

impl Spans {
    /// Takes over the state of the schedule.
    pub fn update(&mut self, state: &v1::AttackState) {
        for progress in &state.attacks {
            let Some(attack) = &progress.attack else { continue };
            // Two schedules accepted at different times are different, whatever their numbers.
            let key = (progress.accepted_time_us, attack.id);
            let due_s = progress.accepted_time_us as f64 * 1e-6 + attack.start_s;
            let start_s = progress.active_time_us.map_or(due_s, |t| t as f64 * 1e-6);
            let end_s = progress.ended_time_us.map_or(due_s + attack.duration_s, |t| t as f64 * 1e-6);
            let span = Span {
                accepted_us: progress.accepted_time_us,
                attack: *attack,
                phase: progress.phase(),
                start_s,
                end_s: end_s.max(start_s),
                seen: progress.active_time_us.is_some(),
            };
            self.map.insert(key, span);
        }
        // A schedule replaced before it began leaves attacks that will never be: drop them.
        let now: Vec<(u64, u32)> =
            state.attacks.iter().filter_map(|p| Some((p.accepted_time_us, p.attack.as_ref()?.id))).collect();
        self.map.retain(|key, span| now.contains(key) || span.seen);
        while self.map.len() > MAX_SPANS {
            self.map.pop_first();
        }
    }

    /// Adds the attacks of the past that were seen; those known already are known better.
    pub fn fill(&mut self, past: Self) {
        for (key, span) in past.map.into_iter().filter(|(_, span)| span.seen) {
            self.map.entry(key).or_insert(span);
        }
        while self.map.len() > MAX_SPANS {
            self.map.pop_first();
        }
    }

    /// The spans that overlap `start_s..end_s` and were seen, or are still to come.
    pub fn between(&self, start_s: f64, end_s: f64) -> impl Iterator<Item = &Span> {
        self.map.values().filter(move |s| {
            let alive = s.seen || matches!(s.phase, AttackPhase::Accepted | AttackPhase::Active);
            alive && s.end_s >= start_s && s.start_s <= end_s
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(accepted_us: u64, active: Option<u64>, ended: Option<u64>, phase: AttackPhase) -> v1::AttackState {
        let attack = v1::Attack { id: 1, start_s: 5.0, duration_s: 10.0, ..Default::default() };
        v1::AttackState {
            attacks: vec![v1::AttackProgress {
                attack: Some(attack),
                phase: phase.into(),
                accepted_time_us: accepted_us,
                active_time_us: active,
                ended_time_us: ended,
                altered_samples: 0,
            }],
            ..Default::default()
        }
    }

    #[test]
    fn planned_then_seen_then_aborted() {
        let mut spans = Spans::default();
        spans.update(&state(1_000_000, None, None, AttackPhase::Accepted));
        assert_eq!(spans.between(0.0, 100.0).map(|s| (s.start_s, s.end_s)).collect::<Vec<_>>(), [(6.0, 16.0)]);
        spans.update(&state(1_000_000, Some(6_050_000), Some(8_000_000), AttackPhase::Aborted));
        assert_eq!(spans.between(7.0, 100.0).map(|s| (s.start_s, s.end_s)).collect::<Vec<_>>(), [(6.05, 8.0)]);
        assert_eq!(spans.between(9.0, 100.0).count(), 0);
    }

    #[test]
    fn an_attack_that_never_began_leaves_no_shade() {
        let mut spans = Spans::default();
        spans.update(&state(1_000_000, None, Some(2_000_000), AttackPhase::Aborted));
        assert_eq!(spans.between(0.0, 100.0).count(), 0);
        spans.update(&state(9_000_000, None, None, AttackPhase::Accepted));
        assert_eq!(spans.map.len(), 1);
    }
}

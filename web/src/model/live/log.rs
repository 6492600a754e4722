//! What happened, oldest first: events, steps of the setpoint, attacks, changes of mode, estimator and gains.

use std::collections::{BTreeMap, VecDeque};

use plumbline_proto::v1;

use crate::model::spans::Spans;

/// Events kept of a live vehicle; the oldest go first.
const MAX_EVENTS: usize = 400;
/// Steps kept of one; the oldest go first.
const MAX_STEPS: usize = 200;
/// Changes of state kept of one; the oldest go first.
const MAX_STATES: usize = 400;
/// Events in which a repetition is looked for: each connection begins with the newest ones again.
const REPEATED: usize = 64;

/// What flies, from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Since when, s of flight time.
    pub from_s: f64,
    /// Mode.
    pub mode: v1::Mode,
    /// Estimator in the loop, by its number.
    pub estimator: u16,
    /// Revision of the gains.
    pub gains: u32,
}

impl State {
    fn of(status: &v1::Status) -> Self {
        Self {
            from_s: status.time_us as f64 * 1e-6,
            mode: status.mode(),
            estimator: status.estimator_in_loop as u16,
            gains: status.gains_revision,
        }
    }

    fn same(&self, other: &Self) -> bool {
        (self.mode, self.estimator, self.gains) == (other.mode, other.estimator, other.gains)
    }
}

/// See the module documentation.
#[derive(Debug, Default)]
pub struct Log {
    /// Events, oldest first.
    pub events: VecDeque<v1::Event>,
    /// Number of events seen since the page opened; tells a reader that there are new ones.
    pub events_seen: u64,
    /// Steps of the setpoint, oldest first.
    pub steps: VecDeque<v1::StepResponse>,
    /// Attacks by time, for shading.
    pub attacks: Spans,
    /// Changes of what flies, oldest first.
    pub states: VecDeque<State>,
    /// Gains that flew, by their revision.
    pub gains: BTreeMap<u32, v1::GainsInUse>,
    unbounded: bool,
}

impl Log {
    /// For a recorded flight: nothing is forgotten.
    pub fn unbounded() -> Self {
        Self { unbounded: true, ..Self::default() }
    }

    /// The same before anything happened; events are counted on.
    pub fn emptied(&self) -> Self {
        Self { events_seen: self.events_seen, unbounded: self.unbounded, ..Self::default() }
    }

    /// Adds what happened before; what is known already is known better.
    pub fn fill(&mut self, past: Self) {
        self.attacks.fill(past.attacks);
        past.events.into_iter().for_each(|event| self.event(event));
        past.steps.into_iter().for_each(|step| self.step(step));
        past.states.into_iter().for_each(|state| self.state(state));
        past.gains.into_values().for_each(|gains| self.gains(gains));
    }

    /// Takes gains in use.
    pub fn gains(&mut self, gains: v1::GainsInUse) {
        self.gains.insert(gains.revision, gains);
        if !self.unbounded && self.gains.len() > MAX_STATES {
            // What the agent started with is 0, and is wanted longest.
            if let Some(oldest) = self.gains.keys().find(|revision| **revision > 0).copied() {
                self.gains.remove(&oldest);
            }
        }
    }

    /// Revision of the gains at a time, s; `None` before the first status known.
    pub fn gains_at(&self, time_s: f64) -> Option<u32> {
        self.states.iter().rev().find(|state| state.from_s <= time_s).map(|state| state.gains)
    }

    /// Takes what a status says of mode, estimator and gains.
    pub fn status(&mut self, status: &v1::Status) {
        self.state(State::of(status));
    }

    fn state(&mut self, state: State) {
        let at = self.states.iter().rposition(|s| s.from_s <= state.from_s).map_or(0, |i| i + 1);
        let before = at.checked_sub(1).and_then(|before| self.states.get(before));
        if before.is_some_and(|before| before.same(&state)) {
            return;
        }
        // The same from earlier on, where the past comes after the present.
        match self.states.get_mut(at).filter(|after| after.same(&state)) {
            Some(after) => after.from_s = state.from_s,
            None => self.states.insert(at, state),
        }
        if !self.unbounded && self.states.len() > MAX_STATES {
            self.states.pop_front();
        }
    }

    /// Takes an event, unless it is known.
    pub fn event(&mut self, event: v1::Event) {
        let same = |e: &v1::Event| e.time_us == event.time_us && e.text == event.text;
        if self.events.iter().rev().take(REPEATED).any(same) {
            return;
        }
        // History may bring older events after the snapshot's newest one.
        let at = self.events.iter().rposition(|e| e.time_us <= event.time_us).map_or(0, |i| i + 1);
        self.events.insert(at, event);
        self.events_seen += 1;
        if !self.unbounded && self.events.len() > MAX_EVENTS {
            self.events.pop_front();
        }
    }

    /// Takes a step, or what is known of it by now.
    pub fn step(&mut self, step: v1::StepResponse) {
        match self.steps.iter_mut().find(|s| s.start_time_us == step.start_time_us) {
            Some(known) if known.time_us <= step.time_us => *known = step,
            Some(_) => {}
            None => {
                let at = self.steps.iter().rposition(|s| s.start_time_us < step.start_time_us).map_or(0, |i| i + 1);
                self.steps.insert(at, step);
                if !self.unbounded && self.steps.len() > MAX_STEPS {
                    self.steps.pop_front();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_of_state_are_kept_whether_they_come_in_order_or_the_past_comes_later() {
        let status = |at_s: u64, mode: v1::Mode, gains| v1::Status {
            time_us: at_s * 1_000_000,
            mode: mode.into(),
            gains_revision: gains,
            ..Default::default()
        };
        let all = [
            status(1, v1::Mode::Disarmed, 0),
            status(2, v1::Mode::Disarmed, 0),
            status(3, v1::Mode::AltitudeHold, 0),
            status(5, v1::Mode::AltitudeHold, 1),
            status(9, v1::Mode::AltitudeHold, 1),
        ];
        let mut whole = Log::default();
        all.iter().for_each(|s| whole.status(s));
        assert_eq!(
            whole.states.iter().map(|s| (s.from_s, s.gains)).collect::<Vec<_>>(),
            [(1.0, 0), (3.0, 0), (5.0, 1)]
        );
        let (mut late, mut past) = (Log::default(), Log::unbounded());
        late.status(&all[4]);
        all.iter().take(4).for_each(|s| past.status(s));
        late.fill(past);
        assert_eq!(late.states, whole.states);
    }
}

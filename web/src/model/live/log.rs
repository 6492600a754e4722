//! What happened, oldest first: events, steps of the setpoint, attacks.

use std::collections::VecDeque;

use plumbline_proto::v1;

use crate::model::spans::Spans;

/// Events kept of a live vehicle; the oldest go first.
const MAX_EVENTS: usize = 400;
/// Steps kept of one; the oldest go first.
const MAX_STEPS: usize = 200;
/// Events in which a repetition is looked for: each connection begins with the newest ones again.
const REPEATED: usize = 64;

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

//! Events: something worth a line in the log and a mark on the charts.
//!
//! Bound: [`EventQueue::CAPACITY`] events between two drains. When it is full the newest are
//! given up and counted; the count is reported by the next drain. Nothing here allocates.

use std::fmt;

use arrayvec::{ArrayString, ArrayVec};
use plumbline_proto::time::FlightTime;

pub use plumbline_proto::v1::Severity;

/// Text for people, of bounded length; what does not fit is cut off and marked with `…`.
pub type Text = ArrayString<256>;

/// Formats into a [`Text`] without allocating.
pub fn text(arguments: fmt::Arguments<'_>) -> Text {
    struct Cut<'a>(&'a mut Text);
    impl fmt::Write for Cut<'_> {
        fn write_str(&mut self, piece: &str) -> fmt::Result {
            const MARK: &str = "…";
            let room = self.0.remaining_capacity().saturating_sub(MARK.len());
            if piece.len() <= room {
                self.0.push_str(piece);
                return Ok(());
            }
            let end = (0..=room).rev().find(|&end| piece.is_char_boundary(end)).unwrap_or(0);
            self.0.push_str(piece.get(..end).unwrap_or_default());
            self.0.push_str(MARK);
            Err(fmt::Error)
        }
    }
    let mut out = Text::new();
    // An error only says that the text was cut.
    let _ = fmt::write(&mut Cut(&mut out), arguments);
    out
}

/// What an event is about; the names on the wire are those of [`EventKind::as_str`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EventKind {
    /// The flight mode changed.
    Mode,
    /// Armed or disarmed.
    Armed,
    /// A setpoint was accepted or limited.
    Setpoint,
    /// Gains were applied or refused.
    Gains,
    /// An attack was accepted, became active, ended or was aborted.
    Attack,
    /// A failsafe acted or ended.
    Failsafe,
    /// The estimator in the loop changed, or its health did.
    Estimator,
    /// Recording.
    Recording,
    /// Anything else that deserves attention.
    Warning,
}

impl EventKind {
    /// As written on the wire.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Mode => "mode",
            Self::Armed => "armed",
            Self::Setpoint => "setpoint",
            Self::Gains => "gains",
            Self::Attack => "attack",
            Self::Failsafe => "failsafe",
            Self::Estimator => "estimator",
            Self::Recording => "recording",
            Self::Warning => "warning",
        }
    }
}

/// One event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// When.
    pub time: FlightTime,
    /// How much it matters.
    pub severity: Severity,
    /// What it is about.
    pub kind: EventKind,
    /// For people, with values and units.
    pub text: Text,
}

/// Events since the last drain.
#[derive(Debug, Default)]
pub struct EventQueue {
    events: ArrayVec<Event, { EventQueue::CAPACITY }>,
    lost: u32,
}

impl EventQueue {
    /// Most events kept between two drains.
    pub const CAPACITY: usize = 32;

    /// Adds one, or counts it as lost when the queue is full.
    pub fn push(&mut self, event: Event) {
        if self.events.try_push(event).is_err() {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// Hands every event to `take`, oldest first, then the number lost, if any, as an event of its own.
    pub fn drain(&mut self, now: FlightTime, mut take: impl FnMut(&Event)) {
        self.events.iter().for_each(&mut take);
        self.events.clear();
        if self.lost > 0 {
            take(&Event {
                time: now,
                severity: Severity::Warning,
                kind: EventKind::Warning,
                text: text(format_args!("{} events lost: more than {} at once", self.lost, Self::CAPACITY)),
            });
            self.lost = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(n: usize) -> Event {
        Event {
            time: FlightTime(n as u64),
            severity: Severity::Info,
            kind: EventKind::Mode,
            text: text(format_args!("event {n}")),
        }
    }

    #[test]
    fn a_full_queue_keeps_the_oldest_and_counts_the_rest() {
        let mut queue = EventQueue::default();
        (0..EventQueue::CAPACITY + 3).for_each(|n| queue.push(event(n)));
        let mut seen = Vec::new();
        queue.drain(FlightTime(9), |e| seen.push(e.text.to_string()));
        assert_eq!(seen.len(), EventQueue::CAPACITY + 1);
        assert_eq!(seen[0], "event 0");
        assert_eq!(seen[EventQueue::CAPACITY], "3 events lost: more than 32 at once");
        queue.drain(FlightTime(9), |e| panic!("drained twice: {e:?}"));
    }

    #[test]
    fn long_text_is_cut_at_a_character_and_marked() {
        let long = "é".repeat(200);
        let cut = text(format_args!("{long}"));
        assert!(cut.ends_with('…') && cut.len() <= 256 && cut.starts_with("éé"));
        assert_eq!(text(format_args!("{} m", 3.4)).as_str(), "3.4 m");
    }
}

//! When a flight begins and ends, and what it is called.
//!
//! A flight begins when the vehicle is armed, or by hand; it ends [`AFTER_DISARM_S`] after the vehicle
//! is disarmed, or by hand. Its messages are a contiguous range of sequence numbers, the opening and
//! the closing mark included.

use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::v1::FlightMark;

use super::Identification;

/// A flight goes on for this long after the motors stop.
pub const AFTER_DISARM_S: f64 = 1.0;

/// The flight being recorded, if any.
#[derive(Debug)]
pub struct Recording {
    prefix: String,
    boot_wall_time: WallTime,
    count: u32,
    open: Option<FlightTime>,
    by_hand: bool,
    disarmed: Option<FlightTime>,
    mark: FlightMark,
}

impl Recording {
    pub(super) fn new(identification: &Identification) -> Self {
        let agent: String = identification.agent_id.chars().take(30).collect();
        Self {
            prefix: format!("{agent}-{:04x}", identification.boot_id & 0xffff),
            boot_wall_time: identification.boot_wall_time,
            count: 0,
            open: None,
            by_hand: false,
            disarmed: None,
            // Long enough for every id and reason: a flight begins in the middle of a tick.
            mark: FlightMark {
                flight_id: String::with_capacity(64),
                reason: String::with_capacity(64),
                ..FlightMark::default()
            },
        }
    }

    /// Is a flight being recorded?
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// When it began.
    pub fn start(&self) -> Option<FlightTime> {
        self.open
    }

    /// Its id; empty when there is none.
    pub fn flight_id(&self) -> &str {
        if self.open.is_some() { &self.mark.flight_id } else { "" }
    }

    pub(super) fn by_hand(&mut self, on: bool) {
        self.by_hand = on;
    }

    pub(super) fn wants_to_begin(&self, armed: bool) -> Option<&'static str> {
        (armed && self.open.is_none()).then_some("armed")
    }

    pub(super) fn wants_to_end(&mut self, armed: bool, now: FlightTime) -> Option<&'static str> {
        if armed || self.by_hand || self.open.is_none() {
            self.disarmed = None;
            return None;
        }
        let since = *self.disarmed.get_or_insert(now);
        (now.seconds_since(since) >= AFTER_DISARM_S).then_some("disarmed")
    }

    pub(super) fn begin(&mut self, now: FlightTime, sequence: u64, reason: &str) -> &FlightMark {
        use std::fmt::Write;
        self.count += 1;
        self.open = Some(now);
        self.disarmed = None;
        let (date, time) = self.boot_wall_time.at(now).utc();
        let mark = &mut self.mark;
        mark.flight_id.clear();
        let _ = write!(
            mark.flight_id,
            "{:04}{:02}{:02}T{:02}{:02}{:02}-{}-{}",
            date.0, date.1, date.2, time.0, time.1, time.2, self.prefix, self.count
        );
        mark.time_us = now.0;
        mark.first_sequence = sequence;
        mark.last_sequence = None;
        super::convert::set(&mut mark.reason, reason);
        mark
    }

    pub(super) fn end(&mut self, now: FlightTime, sequence: u64, reason: &str) -> &FlightMark {
        self.open = None;
        self.by_hand = false;
        self.disarmed = None;
        self.mark.time_us = now.0;
        self.mark.last_sequence = Some(sequence);
        super::convert::set(&mut self.mark.reason, reason);
        &self.mark
    }
}

//! How well one vehicle's telemetry arrives: age, rate, loss.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use plumbline_proto::{Kind, codec::Frame};

/// Rates and losses are of the last second, in slices of this length.
const SLICE: Duration = Duration::from_millis(250);
const SLICES: usize = 4;

#[derive(Debug, Clone, Copy, Default)]
struct Slice {
    received: u64,
    control: u64,
    /// How far the highest sequence number moved in this slice.
    advanced: u64,
}

/// Counters of one vehicle since its boot.
#[derive(Debug)]
pub(super) struct Health {
    pub(super) received: u64,
    pub(super) round_trip_ms: f64,
    pub(super) clock_offset_us: f64,
    pub(super) newest_time_us: Option<u64>,
    highest: u64,
    current: Slice,
    current_began: Instant,
    past: VecDeque<Slice>,
}

impl Health {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            received: 0,
            round_trip_ms: 0.0,
            clock_offset_us: 0.0,
            newest_time_us: None,
            highest: 0,
            current: Slice::default(),
            current_began: now,
            past: VecDeque::with_capacity(SLICES),
        }
    }

    /// Counts one live frame.
    pub(super) fn observe(&mut self, frame: &Frame<'_>) {
        self.received += 1;
        self.current.received += 1;
        if frame.kind == Kind::Control.to_wire() {
            self.current.control += 1;
        }
        if frame.sequence > self.highest {
            if self.highest > 0 {
                self.current.advanced += frame.sequence - self.highest;
            } else {
                self.current.advanced += 1;
            }
            self.highest = frame.sequence;
        }
        self.newest_time_us = self.newest_time_us.max(Some(frame.time_us));
    }

    /// Closes the slice in progress when its time is over.
    pub(super) fn roll(&mut self, now: Instant) {
        while now.saturating_duration_since(self.current_began) >= SLICE {
            if self.past.len() == SLICES {
                self.past.pop_front();
            }
            self.past.push_back(std::mem::take(&mut self.current));
            self.current_began += SLICE;
            if now.saturating_duration_since(self.current_began) > SLICE * (SLICES as u32 + 1) {
                // Nothing arrived for long: no need to roll through every empty slice.
                self.past.clear();
                self.current_began = now;
            }
        }
    }

    /// Control messages a second.
    pub(super) fn rate_hz(&self) -> f64 {
        let seconds = self.past.len() as f64 * SLICE.as_secs_f64();
        let control: u64 = self.past.iter().map(|s| s.control).sum();
        if seconds > 0.0 { control as f64 / seconds } else { 0.0 }
    }

    /// Share of the messages sent in the last second that did not arrive, %.
    pub(super) fn loss_percent(&self) -> f64 {
        let sent: u64 = self.past.iter().map(|s| s.advanced).sum();
        let received: u64 = self.past.iter().map(|s| s.received).sum();
        if sent == 0 { 0.0 } else { (100.0 * (1.0 - received as f64 / sent as f64)).max(0.0) }
    }

    /// Time since the newest message was sensed, ms, on the ground's clock.
    pub(super) fn age_ms(&self, boot_wall_time_us: u64, wall_time_us: u64) -> f64 {
        let Some(newest) = self.newest_time_us else { return 0.0 };
        let sensed = (boot_wall_time_us.saturating_add(newest)) as f64 + self.clock_offset_us;
        ((wall_time_us as f64 - sensed) * 1e-3).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_loss_and_age_are_those_of_the_stream() {
        let start = Instant::now();
        let mut health = Health::new(start);
        // 400 messages a second for 2 s, every second one control, every fourth lost.
        for n in 1..=800_u64 {
            let now = start + Duration::from_micros(2500 * n);
            health.roll(now);
            if n % 4 != 0 {
                let kind = if n % 2 == 0 { Kind::Control } else { Kind::Estimate };
                health.observe(&Frame {
                    kind: kind.to_wire(),
                    instance: 0,
                    sequence: n,
                    time_us: 2500 * n,
                    payload: &[],
                });
            }
        }
        assert!((health.loss_percent() - 25.0).abs() < 1.0, "{}", health.loss_percent());
        assert!((health.rate_hz() - 100.0).abs() < 2.0, "{}", health.rate_hz());
        // The agent's clock is 1 s behind the ground's; the newest message is of 1.9975 s.
        health.clock_offset_us = 1e6;
        let age = health.age_ms(5_000_000, 5_000_000 + 2_010_000 + 1_000_000);
        assert!((age - 12.5).abs() < 1e-6, "{age}");
    }
}

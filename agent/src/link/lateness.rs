//! Was a command held up on its way?
//!
//! A stream delivers after a fade what was written before it. An operator who was told "not answered"
//! must not see the vehicle arm seconds later. Heartbeats travel on the same stream as commands, ten
//! times a second, and carry the ground's steady clock: a command that comes long after the heartbeat
//! before it was *sent* is late. Clocks need not agree: the quickest heartbeat is the measure of the others. Nor need
//! they run alike: that measure creeps up by [`DRIFT_MAX`], more than two crystals differ, so that a slow clock does not
//! look like a slow link after hours; congestion, which delays by seconds, would have to last for hours to be taken for it.

use std::time::Instant;

use super::transport::HEARTBEAT_PERIOD;
use crate::command::Command;
use crate::types::Mode;

/// A command older than this is refused, s: beyond any retransmission, below any failsafe's end.
pub const COMMAND_MAX_AGE_S: f64 = 1.0;

/// Two clocks differ by less than this fraction; crystals by 100 ppm.
const DRIFT_MAX: f64 = 300e-6;

/// Times of the heartbeats of one session.
#[derive(Debug)]
pub struct Lateness {
    begun: Instant,
    /// Least of arrival minus sending lately, µs on two unrelated clocks, and when it was last moved on.
    quickest: Option<(i128, Instant)>,
    /// When the ground sent the last heartbeat, on its clock.
    sent_us: u64,
}

impl Lateness {
    /// Of a session that begins now.
    pub fn new(now: Instant) -> Self {
        Self { begun: now, quickest: None, sent_us: 0 }
    }

    fn way_us(&self, now: Instant) -> i128 {
        now.saturating_duration_since(self.begun).as_micros() as i128 - i128::from(self.sent_us)
    }

    /// The measure, with the drift that the clocks may have had since.
    fn quickest_us(&self, now: Instant) -> Option<i128> {
        let (quickest_us, at) = self.quickest?;
        Some(quickest_us + (now.saturating_duration_since(at).as_micros() as f64 * DRIFT_MAX).ceil() as i128)
    }

    /// A heartbeat arrived.
    pub fn heartbeat(&mut self, sent_us: u64, now: Instant) {
        self.sent_us = sent_us;
        let way_us = self.way_us(now);
        let quickest_us = self.quickest_us(now).map_or(way_us, |quickest| quickest.min(way_us));
        self.quickest = Some((quickest_us, now));
    }

    /// At least how long a command that arrives now was on its way, s; zero before the first heartbeat.
    pub fn command_s(&self, now: Instant) -> f64 {
        let Some(quickest_us) = self.quickest_us(now) else { return 0.0 };
        let since_heartbeat_s = (self.way_us(now) - quickest_us) as f64 * 1e-6;
        (since_heartbeat_s - HEARTBEAT_PERIOD.as_secs_f64()).max(0.0)
    }
}

/// Is `command` right however late it comes? Those that only end something are.
pub fn never_too_late(command: &Command) -> bool {
    matches!(
        command,
        Command::CutMotors
            | Command::Disarm
            | Command::AbortAttacks
            | Command::SetMode(Mode::Land)
            | Command::Trajectory(None)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn what_waited_out_a_fade_is_told_from_what_came_at_once() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let ground_us = |ms: u64| 1_700_000_000_000_000 + ms * 1000;
        let mut lateness = Lateness::new(begun);
        assert_eq!(lateness.command_s(at(1)), 0.0);
        for beat in 0..20 {
            // 5 to 25 ms on the way.
            lateness.heartbeat(ground_us(100 * beat), at(100 * beat + 5 + beat));
            assert_eq!(lateness.command_s(at(100 * beat + 60 + beat)), 0.0);
        }
        // Fade at 1.95 s; a command sent then comes at 5 s, before the heartbeats that follow it.
        let late_s = lateness.command_s(at(5000));
        assert!((late_s - 2.995).abs() < 2e-3, "{late_s}");
        // Commands sent later follow heartbeats that were held up as well.
        lateness.heartbeat(ground_us(3000), at(5000));
        assert!((lateness.command_s(at(5001)) - 1.896).abs() < 2e-3);
        lateness.heartbeat(ground_us(5000), at(5006));
        assert_eq!(lateness.command_s(at(5050)), 0.0);
    }

    #[test]
    fn a_day_of_clocks_that_drift_refuses_nothing_and_a_fade_is_still_late() {
        let begun = Instant::now();
        for drift in [-100e-6, 0.0, 100e-6] {
            let mut lateness = Lateness::new(begun);
            let arrival = |s: f64, way_s: f64| begun + Duration::from_secs_f64(s + way_s);
            // The ground's clock loses or gains against ours.
            let sent_us = |s: f64| (1e6 * s * (1.0 - drift)) as u64;
            for tenth in 0..864_000_u32 {
                let s = f64::from(tenth) * 0.1;
                let way_s = 0.005 + 0.02 * f64::from(tenth % 7) / 7.0;
                lateness.heartbeat(sent_us(s), arrival(s, way_s));
                assert_eq!(lateness.command_s(arrival(s, way_s + 0.05)), 0.0, "{drift} after {s} s");
            }
            let late_s = lateness.command_s(arrival(86_403.0, 0.0));
            assert!((late_s - 2.97).abs() < 0.05, "{drift}: {late_s}");
        }
    }
}

//! Was a command held up on its way?
//!
//! A stream delivers after a fade what was written before it. An operator who was told "not answered"
//! must not see the vehicle arm seconds later. Heartbeats travel on the same stream as commands, ten
//! times a second, and carry the ground's steady clock: a command that comes long after the heartbeat
//! before it was *sent* is late. Clocks need not agree: the quickest heartbeat of the last [`SPAN`] or two is the measure
//! of the others. Nor need they run alike, or without a jump: crystals drift apart, a time server slews one of them, a
//! computer that was suspended comes back with a clock that stood. Only while the network itself is slow does the
//! measure stay (and creep up by [`DRIFT_MAX`]), or congestion would soon be taken for the clock's.

use std::time::{Duration, Instant};

use super::transport::HEARTBEAT_PERIOD;
use crate::command::Command;
use crate::types::Mode;

/// A command older than this is refused, s: beyond any retransmission, below any failsafe's end.
pub const COMMAND_MAX_AGE_S: f64 = 1.0;

/// Nor is one whose operator saw a picture older than this, s: it waited where no heartbeat tells of it, in the socket of
/// a ground that stood still, or its page had stopped.
pub const PICTURE_MAX_AGE_S: f64 = 2.0;

/// Two clocks differ by less than this fraction; crystals by 100 ppm.
const DRIFT_MAX: f64 = 300e-6;
/// The measure is the quickest of the present span of this length and of the one before …
const SPAN: Duration = Duration::from_secs(5);
/// … which ends only while QUIC's packets come back within this: some heartbeat of it was quick then.
const ROUND_TRIP_SHORT: Duration = Duration::from_millis(250);

/// Times of the heartbeats of one session.
#[derive(Debug)]
pub struct Lateness {
    begun: Instant,
    /// Least of arrival minus sending, µs on two unrelated clocks, of the present span and of the one before.
    quickest_us: [Option<i128>; 2],
    /// When they were moved on.
    moved: Instant,
    span_begun: Instant,
    /// When the ground sent the last heartbeat, on its clock.
    sent_us: u64,
}

impl Lateness {
    /// Of a session that begins now.
    pub fn new(now: Instant) -> Self {
        Self { begun: now, quickest_us: [None; 2], moved: now, span_begun: now, sent_us: 0 }
    }

    fn way_us(&self, now: Instant) -> i128 {
        now.saturating_duration_since(self.begun).as_micros() as i128 - i128::from(self.sent_us)
    }

    /// A measure, with the drift that the clocks may have had since.
    fn drifted_us(&self, quickest_us: i128, now: Instant) -> i128 {
        let since_us = now.saturating_duration_since(self.moved).as_micros() as f64;
        quickest_us + (since_us * DRIFT_MAX).ceil() as i128
    }

    /// A heartbeat arrived that the ground sent at `sent_us`, while packets took `round_trip` to the ground and back.
    pub fn heartbeat(&mut self, sent_us: u64, now: Instant, round_trip: Duration) {
        self.sent_us = sent_us;
        let way_us = self.way_us(now);
        self.quickest_us = self.quickest_us.map(|quickest| quickest.map(|us| self.drifted_us(us, now)));
        self.moved = now;
        if now.saturating_duration_since(self.span_begun) >= SPAN && round_trip < ROUND_TRIP_SHORT {
            self.quickest_us = [None, self.quickest_us[0]];
            self.span_begun = now;
        }
        self.quickest_us[0] = Some(self.quickest_us[0].map_or(way_us, |quickest| quickest.min(way_us)));
    }

    /// At least how long a command that arrives now was on its way, s; zero before the first heartbeat.
    pub fn command_s(&self, now: Instant) -> f64 {
        let Some(quickest_us) = self.quickest_us.into_iter().flatten().min() else { return 0.0 };
        let since_heartbeat_s = (self.way_us(now) - self.drifted_us(quickest_us, now)) as f64 * 1e-6;
        (since_heartbeat_s - HEARTBEAT_PERIOD.as_secs_f64()).max(0.0)
    }
}

/// Why a command that was `way_s` on its way, and asked on a picture `picture_s` old, comes too late; `None` in time.
pub fn too_late(way_s: f64, picture_s: f64) -> Option<String> {
    if way_s > COMMAND_MAX_AGE_S {
        Some(format!(
            "it was {way_s:.1} s on its way (limit {COMMAND_MAX_AGE_S} s): the link had failed; send it again"
        ))
    } else if picture_s == f64::INFINITY {
        Some("it was asked on a picture from before the agent's start; look again, then ask again".to_owned())
    } else if picture_s > PICTURE_MAX_AGE_S {
        Some(format!(
            "it was asked on a picture {picture_s:.1} s old (limit {PICTURE_MAX_AGE_S} s); look again, then ask again"
        ))
    } else {
        None
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

    const QUICK: Duration = Duration::from_millis(10);

    #[test]
    fn what_waited_out_a_fade_is_told_from_what_came_at_once() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let ground_us = |ms: u64| 1_700_000_000_000_000 + ms * 1000;
        let mut lateness = Lateness::new(begun);
        assert_eq!(lateness.command_s(at(1)), 0.0);
        for beat in 0..20 {
            // 5 to 25 ms on the way.
            lateness.heartbeat(ground_us(100 * beat), at(100 * beat + 5 + beat), QUICK);
            assert_eq!(lateness.command_s(at(100 * beat + 60 + beat)), 0.0);
        }
        // Fade at 1.95 s; a command sent then comes at 5 s, before the heartbeats that follow it.
        let late_s = lateness.command_s(at(5000));
        assert!((late_s - 2.995).abs() < 2e-3, "{late_s}");
        // Commands sent later follow heartbeats that were held up as well.
        lateness.heartbeat(ground_us(3000), at(5000), QUICK);
        assert!((lateness.command_s(at(5001)) - 1.896).abs() < 2e-3);
        lateness.heartbeat(ground_us(5000), at(5006), QUICK);
        assert_eq!(lateness.command_s(at(5050)), 0.0);
    }

    #[test]
    fn a_day_of_clocks_that_drift_refuses_nothing_and_a_fade_is_still_late() {
        let begun = Instant::now();
        for drift in [-200e-6, 0.0, 100e-6, 200e-6] {
            let mut lateness = Lateness::new(begun);
            let arrival = |s: f64, way_s: f64| begun + Duration::from_secs_f64(s + way_s);
            // The ground's clock loses or gains against ours.
            let sent_us = |s: f64| (1e6 * s * (1.0 - drift)) as u64;
            for tenth in 0..864_000_u32 {
                let s = f64::from(tenth) * 0.1;
                let way_s = 0.005 + 0.02 * f64::from(tenth % 7) / 7.0;
                lateness.heartbeat(sent_us(s), arrival(s, way_s), QUICK);
                assert_eq!(lateness.command_s(arrival(s, way_s + 0.05)), 0.0, "{drift} after {s} s");
            }
            let late_s = lateness.command_s(arrival(86_403.0, 0.0));
            assert!((late_s - 2.97).abs() < 0.05, "{drift}: {late_s}");
        }
    }

    /// A ground that is suspended, or whose clock a time server slews, sends as if every heartbeat were late.
    #[test]
    fn a_clock_that_stood_or_was_slewed_refuses_commands_for_seconds_and_not_for_hours() {
        let begun = Instant::now();
        let mut lateness = Lateness::new(begun);
        let mut refused_s = 0.0;
        for beat in 0..1200_u32 {
            let s = f64::from(beat) * 0.1;
            // Stands for 2.5 s, an hour after the start of its clock; from 60 s on slow by 5 % for 40 s.
            let stood_s = if s > 20.0 { 2.5 } else { 0.0 };
            let slewed_s = 0.05 * (s - 60.0).clamp(0.0, 40.0);
            let sent_us = ((3600.0 + s - stood_s - slewed_s) * 1e6) as u64;
            let now = begun + Duration::from_secs_f64(s + 0.008);
            lateness.heartbeat(sent_us, now, QUICK);
            refused_s += if lateness.command_s(now) > COMMAND_MAX_AGE_S { 0.1 } else { 0.0 };
        }
        assert!(refused_s > 4.0 && refused_s < 10.5, "{refused_s} s");
    }

    #[test]
    fn congestion_is_not_taken_for_the_clock_however_long_it_lasts() {
        let begun = Instant::now();
        let mut lateness = Lateness::new(begun);
        let beat = |lateness: &mut Lateness, s: f64, way_s: f64| {
            let now = begun + Duration::from_secs_f64(s + way_s);
            lateness.heartbeat((s * 1e6) as u64, now, Duration::from_secs_f64(2.0 * way_s));
            lateness.command_s(now)
        };
        (0..100).for_each(|tenth| assert_eq!(beat(&mut lateness, f64::from(tenth) * 0.1, 0.01), 0.0));
        // Ten minutes with two seconds of waiting packets.
        (100..6100).for_each(|tenth| {
            let late_s = beat(&mut lateness, f64::from(tenth) * 0.1, 2.0);
            assert!(late_s > COMMAND_MAX_AGE_S, "{late_s} s");
        });
        assert_eq!(beat(&mut lateness, 620.0, 0.01), 0.0);
    }
}

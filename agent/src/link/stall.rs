//! Does the commands connection come back after a fade?
//!
//! Telemetry never stops being sent, so that connection is heard again at once. The commands connection may have filled
//! its window in the fade, with backfill above all; then only QUIC's probes are left of it, and the next one may be as far
//! away as the fade was long. A new connection is quicker. So what is counted is the time in which telemetry is
//! acknowledged and the other connection is silent, one way or the other.

use std::time::Duration;

/// How often the signs are looked at.
pub const PERIOD: Duration = Duration::from_millis(100);
/// Periods of such silence after which the connection is given up: longer than a lossy radio takes to repeat a packet
/// (five times with 30 % loss), shorter than people wait for an answer.
const PERIODS_MAX: u32 = 15;

/// What has been received since the connections began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Signs {
    /// Acknowledgements of telemetry.
    pub telemetry_acks: u64,
    /// Acknowledgements of what was sent on the commands connection.
    pub commands_acks: u64,
    /// Heartbeats of the ground, on the commands connection.
    pub heartbeats: u64,
}

/// Counts the silence.
#[derive(Debug)]
pub struct Stall {
    last: Signs,
    /// Has the ground sent a heartbeat in this session? A busy one may take its time with the first.
    begun: bool,
    /// Periods without an acknowledgement, without a heartbeat.
    silent: [u32; 2],
}

impl Stall {
    /// Of a session that begins with these signs.
    pub fn new(signs: Signs) -> Self {
        Self { last: signs, begun: false, silent: [0; 2] }
    }

    /// Called once a [`PERIOD`]; true when the commands connection is to be given up.
    pub fn update(&mut self, signs: Signs) -> bool {
        let telemetry = signs.telemetry_acks != self.last.telemetry_acks;
        let heartbeat = signs.heartbeats != self.last.heartbeats;
        self.begun |= heartbeat;
        let moved = [signs.commands_acks != self.last.commands_acks, heartbeat || !self.begun];
        for (silent, moved) in self.silent.iter_mut().zip(moved) {
            *silent = if moved { 0 } else { *silent + u32::from(telemetry) };
        }
        self.last = signs;
        self.silent.iter().any(|silent| *silent >= PERIODS_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks once after these have grown by so much.
    fn look(stall: &mut Stall, signs: &mut Signs, [telemetry, commands, heartbeats]: [u64; 3]) -> bool {
        signs.telemetry_acks += telemetry;
        signs.commands_acks += commands;
        signs.heartbeats += heartbeats;
        stall.update(*signs)
    }

    #[test]
    fn a_fade_is_waited_out_and_a_connection_that_stays_silent_after_it_is_given_up() {
        // Silent: both ways, upward only, downward only.
        for after in [[9, 0, 0], [9, 0, 1], [9, 1, 0]] {
            let (mut stall, mut signs) = (Stall::new(Signs::default()), Signs::default());
            assert!((0..100).all(|_| !look(&mut stall, &mut signs, [9, 1, 1])), "all well");
            assert!((0..70).all(|_| !look(&mut stall, &mut signs, [0, 0, 0])), "nothing is heard for 7 s");
            let given_up = (1..100).find(|_| look(&mut stall, &mut signs, after));
            assert_eq!(given_up, Some(PERIODS_MAX), "{after:?}");
        }
        // WHEN a probe comes through within the second after the fade, THEN it stays.
        let (mut stall, mut signs) = (Stall::new(Signs::default()), Signs::default());
        assert!((0..100).all(|_| !look(&mut stall, &mut signs, [9, 1, 0])), "the first heartbeat takes its time");
        assert!((0..70).all(|_| !look(&mut stall, &mut signs, [0, 0, 0])));
        assert!((0..10).all(|_| !look(&mut stall, &mut signs, [9, 0, 0])));
        assert!((0..100).all(|_| !look(&mut stall, &mut signs, [9, 1, 1])));
    }
}

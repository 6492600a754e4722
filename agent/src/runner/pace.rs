//! When the next tick is due on the machine's clock.

use std::time::{Duration, Instant};

use plumbline_proto::time::FlightTime;

use crate::link::clock::FlightClock;

/// How fast flight time runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// Times real time; 1 for a vehicle that is really there.
    Times(f64),
    /// As fast as possible.
    Free,
    /// Only so many ticks as were allowed.
    Stepped,
}

/// Waits for ticks.
#[derive(Debug)]
pub struct Pacer {
    pace: Pace,
    anchor: Option<(Instant, FlightTime)>,
    allowed: u32,
}

impl Pacer {
    /// At this pace.
    pub fn new(pace: Pace) -> Self {
        Self { pace, anchor: None, allowed: 0 }
    }

    /// Flight time zero is at this instant, so that it is the wall time that was told of it; ticks wait for it.
    pub fn begin_at(&mut self, zero: Instant, clock: &FlightClock) {
        if let Pace::Times(speed) = self.pace {
            self.anchor = Some((zero, FlightTime(0)));
            clock.run(zero, FlightTime(0), speed);
        }
    }

    /// Changes the pace.
    pub fn set(&mut self, pace: Pace) {
        self.pace = pace;
        self.anchor = None;
    }

    /// Lets `ticks` more pass while stepped.
    pub fn allow(&mut self, ticks: u32) {
        self.allowed = self.allowed.saturating_add(ticks);
    }

    /// Stepped, with nothing allowed?
    pub fn stands_still(&self) -> bool {
        self.pace == Pace::Stepped && self.allowed == 0
    }

    /// As fast as possible?
    pub fn is_free(&self) -> bool {
        self.pace == Pace::Free
    }

    /// Do deadlines mean anything?
    pub fn is_real_time(&self) -> bool {
        self.pace == Pace::Times(1.0)
    }

    /// Times real time; 0 stepped, infinite as fast as possible.
    pub fn speed(&self) -> f64 {
        match self.pace {
            Pace::Times(speed) => speed,
            Pace::Free => f64::INFINITY,
            Pace::Stepped => 0.0,
        }
    }

    /// From now on every tick is due so much later, in real time.
    pub fn set_back(&mut self, by_ns: i64, clock: &FlightClock) {
        let (Pace::Times(speed), Some((at, time))) = (self.pace, &mut self.anchor) else { return };
        let by = Duration::from_nanos(by_ns.unsigned_abs());
        if let (false, Some(moved)) = (by_ns == 0, if by_ns < 0 { at.checked_sub(by) } else { at.checked_add(by) }) {
            *at = moved;
            clock.follow(moved, *time, speed);
        }
    }

    /// Waits until the tick of `time` is due; answers when that was, which may be long ago. `None`: it was not waited for.
    pub fn wait_for(&mut self, time: FlightTime, clock: &FlightClock) -> Option<Instant> {
        let speed = match self.pace {
            Pace::Times(speed) => speed,
            Pace::Free => {
                clock.stop();
                return None;
            }
            Pace::Stepped => {
                self.allowed = self.allowed.saturating_sub(1);
                clock.stop();
                return None;
            }
        };
        let now = Instant::now();
        let due = self.anchor.and_then(|(at, from)| {
            let ahead = time.seconds_since(from) / speed;
            at.checked_add(Duration::try_from_secs_f64(ahead).ok()?)
        });
        let Some(due) = due else {
            self.begin_anew(now, time, clock);
            return Some(now);
        };
        sleep_until(due);
        Some(due)
    }

    /// Counts from here: the tick of `time` is due `at`. Catching up with what is lost would fly in fast motion.
    pub fn begin_anew(&mut self, at: Instant, time: FlightTime, clock: &FlightClock) {
        if let Pace::Times(speed) = self.pace {
            self.anchor = Some((at, time));
            clock.run(at, time, speed);
        }
    }
}

/// Sleeps until `due` by the kernel's own timer: absolute, so that being interrupted adds nothing.
pub fn sleep_until(due: Instant) {
    loop {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `now` is a valid place for the answer.
        if unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) } != 0 {
            std::thread::sleep(left);
            continue;
        }
        let nanos = now.tv_nsec as u64 + u64::from(left.subsec_nanos());
        let until = libc::timespec {
            tv_sec: now.tv_sec + left.as_secs() as libc::time_t + (nanos / 1_000_000_000) as libc::time_t,
            tv_nsec: (nanos % 1_000_000_000) as _,
        };
        // SAFETY: `until` is a valid time; nobody wants to know what is left of it.
        unsafe {
            libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &raw const until, std::ptr::null_mut())
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_due_at_their_own_times() {
        let clock = FlightClock::default();
        let mut pacer = Pacer::new(Pace::Times(2.0));
        let first = pacer.wait_for(FlightTime(1_000_000), &clock).unwrap();
        let second = pacer.wait_for(FlightTime(1_040_000), &clock).unwrap();
        assert_eq!(second - first, Duration::from_millis(20), "40 ms at twice real time");
        assert!(Instant::now() >= second);
        assert!(clock.now() >= FlightTime(1_040_000));
    }

    #[test]
    fn ticks_that_are_set_back_are_due_later_and_flight_time_with_them() {
        let clock = FlightClock::default();
        let mut pacer = Pacer::new(Pace::Times(1.0));
        let first = pacer.wait_for(FlightTime(0), &clock).unwrap();
        pacer.set_back(2_000_000, &clock);
        let second = pacer.wait_for(FlightTime(5_000), &clock).unwrap();
        assert_eq!(second - first, Duration::from_millis(7));
        let late_us = (Instant::now() - second).as_micros() as u64;
        assert!((5_000..=5_000 + late_us + 1_000).contains(&clock.now().0), "{} {late_us}", clock.now().0);
        pacer.set_back(-1_000_000, &clock);
        let third = pacer.wait_for(FlightTime(10_000), &clock).unwrap();
        assert_eq!(third - second, Duration::from_millis(4));
    }

    #[test]
    fn a_delay_is_told_and_a_new_count_can_be_begun() {
        let clock = FlightClock::default();
        let mut pacer = Pacer::new(Pace::Times(1.0));
        pacer.wait_for(FlightTime(0), &clock);
        std::thread::sleep(Duration::from_millis(50));
        let due = pacer.wait_for(FlightTime(5_000), &clock).unwrap();
        assert!(due.elapsed() >= Duration::from_millis(40));
        let now = Instant::now();
        pacer.begin_anew(now, FlightTime(5_000), &clock);
        let next = pacer.wait_for(FlightTime(10_000), &clock).unwrap();
        assert_eq!(next - now, Duration::from_millis(5));
    }

    #[test]
    fn stepping_passes_as_many_ticks_as_allowed() {
        let clock = FlightClock::default();
        let mut pacer = Pacer::new(Pace::Stepped);
        assert!(pacer.stands_still());
        pacer.allow(2);
        assert_eq!(pacer.wait_for(FlightTime(0), &clock), None);
        assert!(!pacer.stands_still());
        pacer.wait_for(FlightTime(5_000), &clock);
        assert!(pacer.stands_still());
    }
}

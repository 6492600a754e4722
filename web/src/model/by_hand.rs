//! One flight of an experiment that is flown by hand, step by step; each is done when the vehicle says so.

use plumbline_proto::v1::Mode;
use plumbline_rest::experiment::NextByHand;
use serde::{Deserialize, Serialize};

use super::{live::Live, names};

/// What is to be done, and how.
pub const STEPS: [(&str, &str); 6] = [
    ("Rest", "Motors and strings come to rest."),
    ("Set up", "Estimator and gains of this flight are sent to the vehicle."),
    ("Arm, hold the altitude", "Hold Arm in the Mode card, then press Altitude hold."),
    ("Fly the profile", "The attacks of this flight are uploaded and its altitudes flown one after the other."),
    ("Land", "Press L. On the ground the vehicle disarms by itself, and the recording ends."),
    ("Does it count?", "Accept it, or say why it is void: then it is flown again."),
];

/// Where in them one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum At {
    /// Until the flight before is long enough ago.
    #[default]
    Rest,
    /// Estimator and gains.
    SetUp,
    /// By its operator.
    Arm,
    /// The profile can begin.
    Fly,
    /// It has, at this flight time, µs.
    Flying(u64),
    /// It is over.
    Land,
    /// The flight is over.
    Say,
}

impl At {
    /// Its place among [`STEPS`].
    pub const fn step(self) -> usize {
        match self {
            Self::Rest => 0,
            Self::SetUp => 1,
            Self::Arm => 2,
            Self::Fly | Self::Flying(_) => 3,
            Self::Land => 4,
            Self::Say => 5,
        }
    }
}

/// What of the vehicle the steps go by.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[allow(missing_docs)]
pub struct Seen {
    pub estimator: String,
    /// Not known before its first status, as after a reload.
    pub armed: Option<bool>,
    pub holds: bool,
    /// Being recorded; empty for none.
    pub flight: String,
    /// Flight time, µs.
    pub now_us: u64,
}

impl Seen {
    /// As things are now.
    pub fn of(live: &Live) -> Self {
        let status = live.status.get();
        let estimator = i32::from(live.in_loop());
        Self {
            estimator: estimator.try_into().map(names::estimator_json).unwrap_or_default(),
            armed: status.map(|s| s.armed),
            holds: status.is_some_and(|s| matches!(s.mode(), Mode::AltitudeHold | Mode::Hold)),
            flight: status.map(|s| s.flight_id.clone()).unwrap_or_default(),
            now_us: live.clock.newest_us(),
        }
    }
}

/// Somebody who is led through the flights of an experiment.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Led {
    /// Its id.
    pub experiment: String,
    /// The step that is to be done.
    pub at: At,
    /// The gains of this flight are in use.
    pub gains: bool,
    /// The recording of this flight; empty before it begins.
    pub flight: String,
    /// It ended before its profile did.
    pub early: bool,
}

impl Led {
    /// Through the next flight of this experiment.
    pub fn through(experiment: impl Into<String>) -> Self {
        Self { experiment: experiment.into(), ..Self::default() }
    }

    /// Goes on where the present step is done.
    pub fn go_on(&mut self, next: &NextByHand, seen: &Seen, rested: bool) {
        let (armed, disarmed) = (seen.armed == Some(true), seen.armed == Some(false));
        if armed && !seen.flight.is_empty() && self.at.step() >= At::Arm.step() && self.at != At::Say {
            self.flight.clone_from(&seen.flight);
        }
        self.at = match self.at {
            At::Rest if rested => At::SetUp,
            At::SetUp
                if next.lacks.is_empty()
                    && seen.estimator == next.estimator
                    && (self.gains || next.gains.is_none()) =>
            {
                At::Arm
            }
            At::Arm if armed && seen.holds => At::Fly,
            // Nothing of the profile was flown.
            At::Fly if disarmed => At::Arm,
            At::Flying(_) if disarmed => {
                self.early = true;
                At::Say
            }
            At::Flying(since_us) if self.left_s(next, seen) <= 0.0 && since_us > 0 => At::Land,
            At::Land if disarmed => At::Say,
            at => at,
        };
    }

    /// Of the profile, s; all of it before it begins.
    pub fn left_s(&self, next: &NextByHand, seen: &Seen) -> f64 {
        match self.at {
            At::Flying(since_us) => (next.lasts_s - seen.now_us.saturating_sub(since_us) as f64 * 1e-6).max(0.0),
            _ => next.lasts_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn next() -> NextByHand {
        NextByHand { estimator: "lanes".into(), gains: Some(3), lasts_s: 20.0, ..NextByHand::default() }
    }

    fn seen() -> Seen {
        Seen { estimator: "lanes".into(), armed: Some(false), ..Seen::default() }
    }

    fn flying(now_us: u64) -> Seen {
        Seen { armed: Some(true), holds: true, flight: "f1".into(), now_us, ..seen() }
    }

    #[test]
    fn a_flight_goes_from_rest_to_what_is_said_of_it() {
        let mut led = Led::through("plan");
        let mut after = |seen: &Seen, rested, change: fn(&mut Led)| {
            led.go_on(&next(), seen, rested);
            change(&mut led);
            led.at
        };
        assert_eq!(after(&seen(), false, |_| ()), At::Rest);
        assert_eq!(after(&seen(), true, |_| ()), At::SetUp);
        // The gains were not accepted yet.
        assert_eq!(after(&seen(), true, |led| led.gains = true), At::SetUp);
        assert_eq!(after(&Seen { estimator: "ukf".into(), ..seen() }, true, |_| ()), At::SetUp);
        assert_eq!(after(&seen(), true, |_| ()), At::Arm);
        assert_eq!(after(&Seen { holds: false, ..flying(1) }, true, |_| ()), At::Arm);
        assert_eq!(after(&flying(1), true, |_| ()), At::Fly);
        // Disarmed before anything was flown: armed again.
        assert_eq!(after(&seen(), true, |_| ()), At::Arm);
        assert_eq!(after(&flying(5_000_000), true, |led| led.at = At::Flying(5_000_000)), At::Flying(5_000_000));
        assert_eq!(after(&flying(24_999_999), true, |_| ()), At::Flying(5_000_000));
        assert_eq!(after(&flying(25_000_000), true, |_| ()), At::Land);
        assert_eq!(after(&seen(), true, |_| ()), At::Say);
        // What flies afterwards is another flight.
        assert_eq!(after(&Seen { flight: "f2".into(), ..flying(90_000_000) }, true, |_| ()), At::Say);
        assert_eq!((led.flight.as_str(), led.early), ("f1", false));
    }

    #[test]
    fn a_flight_that_ends_before_its_profile_says_so_and_survives_a_reload() {
        let mut led = Led { at: At::Flying(1), ..Led::through("plan") };
        led.go_on(&next(), &flying(2_000_001), true);
        assert_eq!(led.left_s(&next(), &flying(2_000_001)), 18.0);
        let mut led: Led = serde_json::from_str(&serde_json::to_string(&led).unwrap()).unwrap();
        // Before its first status nothing is known of the vehicle.
        led.go_on(&next(), &Seen::default(), true);
        assert_eq!(led.at, At::Flying(1));
        led.go_on(&next(), &seen(), true);
        assert_eq!((led.at, led.early, led.flight.as_str()), (At::Say, true, "f1"));
    }
}

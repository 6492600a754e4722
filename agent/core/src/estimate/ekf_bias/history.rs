//! Where the vehicle was when a late sample was taken.
//!
//! A ring of past states, at least 4 ms apart. Corrections made since then are kept as running sums, so
//! that an old state can be brought up to date in constant time: past + (sum now − sum then).

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use crate::sensor::measure::Kinematics;

const LENGTH: usize = 256;
const SPACING_US: u64 = 4_000;
/// Samples younger than this are taken as of now, s.
pub const SHORTEST_DELAY_S: f64 = 1.5e-3;

#[derive(Debug, Clone, Copy)]
struct Past {
    time: FlightTime,
    state: Kinematics,
    corrected: Corrections,
}

#[derive(Debug, Clone, Copy)]
struct Corrections {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    attitude: Vector3<f64>,
}

/// Past states, about one second.
#[derive(Debug, Clone)]
pub struct History {
    ring: [Past; LENGTH],
    next: usize,
    filled: usize,
    corrected: Corrections,
}

impl History {
    /// Empty.
    pub fn new() -> Self {
        let zero = Corrections { position: Vector3::zeros(), velocity: Vector3::zeros(), attitude: Vector3::zeros() };
        let state = Kinematics {
            position_enu_m: Vector3::zeros(),
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: UnitQuaternion::identity(),
        };
        let past = Past { time: FlightTime(0), state, corrected: zero };
        Self { ring: [past; LENGTH], next: 0, filled: 0, corrected: zero }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.filled = 0;
    }

    /// Remembers `state` at `time`.
    pub fn push(&mut self, time: FlightTime, state: &Kinematics) {
        if self.filled > 0 {
            let newest = &self.ring[(self.next + LENGTH - 1) % LENGTH];
            if time.0 < newest.time.0 + SPACING_US {
                return;
            }
        }
        self.ring[self.next] = Past { time, state: *state, corrected: self.corrected };
        self.next = (self.next + 1) % LENGTH;
        self.filled = (self.filled + 1).min(LENGTH);
    }

    /// Adds one correction to the sums.
    pub fn corrected(&mut self, position: &Vector3<f64>, velocity: &Vector3<f64>, attitude: &Vector3<f64>) {
        self.corrected.position += position;
        self.corrected.velocity += velocity;
        self.corrected.attitude += attitude;
    }

    /// Sums of the corrections of height (m) and climb (m/s).
    pub fn vertical_corrections(&self) -> (f64, f64) {
        (self.corrected.position.z, self.corrected.velocity.z)
    }

    /// The state at `time`, brought up to date, and how long ago that was (s); `now` where nothing that
    /// old is remembered or the sample is fresh.
    pub fn at(&self, time: FlightTime, now: FlightTime, current: &Kinematics) -> (Kinematics, f64) {
        let delay_s = now.seconds_since(time);
        if delay_s < SHORTEST_DELAY_S || self.filled == 0 {
            return (*current, 0.0);
        }
        let mut past = &self.ring[(self.next + LENGTH - 1) % LENGTH];
        for back in 1..=self.filled {
            past = &self.ring[(self.next + LENGTH - back) % LENGTH];
            if past.time <= time {
                break;
            }
        }
        let moved_s = time.seconds_since(past.time).clamp(-0.05, 0.05);
        let velocity = past.state.velocity_enu_mps + self.corrected.velocity - past.corrected.velocity;
        let state = Kinematics {
            position_enu_m: past.state.position_enu_m + self.corrected.position - past.corrected.position
                + velocity * moved_s,
            velocity_enu_mps: velocity,
            world_from_body: UnitQuaternion::from_scaled_axis(self.corrected.attitude - past.corrected.attitude)
                * past.state.world_from_body,
        };
        (state, now.seconds_since(past.time) - moved_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_sample_meets_the_state_of_its_time_with_later_corrections() {
        let mut history = History::new();
        let at = |t: f64| Kinematics {
            position_enu_m: Vector3::new(2.0 * t, 0.0, 1.0),
            velocity_enu_mps: Vector3::new(2.0, 0.0, 0.0),
            world_from_body: UnitQuaternion::identity(),
        };
        for k in 0..400u64 {
            history.push(FlightTime(k * 5000), &at(k as f64 * 0.005));
        }
        let now = FlightTime(399 * 5000);
        history.corrected(&Vector3::new(0.5, 0.0, 0.0), &Vector3::zeros(), &Vector3::zeros());
        let (state, delay) = history.at(FlightTime(now.0 - 151_000), now, &at(1.995));
        assert!((delay - 0.151).abs() < 1e-9);
        assert!((state.position_enu_m.x - (2.0 * (1.995 - 0.151) + 0.5)).abs() < 1e-9, "{}", state.position_enu_m.x);
        // Fresh, and from the future: the present.
        assert_eq!(history.at(now, now, &at(1.995)).1, 0.0);
        assert_eq!(history.at(FlightTime(now.0 + 9_000_000), now, &at(1.995)).0, at(1.995));
    }
}

//! Stamps that cannot be. A sample that says it was taken long before it came, or after, is of a slot that nobody knows: it is not
//! used. An IMU or a height whose samples have been such for a while is excluded.

use plumbline_proto::time::FlightTime;

use super::LANES;
use crate::sensor::MAX_HEIGHTS;

/// A sample is of no time after the one at which it came, but for what clocks differ by, µs.
const AHEAD_US: u64 = 20_000;
/// Nor of so long before it came: of an IMU, which comes at once; of a height, which takes a scan and its way; of what comes from elsewhere.
const IMU_BEHIND_US: u64 = 100_000;
const HEIGHT_BEHIND_US: u64 = 300_000;
const ELSEWHERE_BEHIND_US: u64 = 1_000_000;
/// Samples of such times are a matter of a moment until they have come for so long, s.
const MOMENT_S: f64 = 0.3;

/// Since when each sensor of a kind has told nothing but such times, and how long before it came a sample of theirs may be taken, µs.
#[derive(Debug, Clone)]
pub struct Stamps<const N: usize> {
    since: [Option<FlightTime>; N],
    behind_us: u64,
}

impl Stamps<LANES> {
    /// Those of IMUs.
    pub const IMUS: Self = Self { since: [None; LANES], behind_us: IMU_BEHIND_US };
}

impl Stamps<MAX_HEIGHTS> {
    /// Those of heights.
    pub const HEIGHTS: Self = Self { since: [None; MAX_HEIGHTS], behind_us: HEIGHT_BEHIND_US };
}

impl<const N: usize> Stamps<N> {
    /// May a sample of sensor `index` that came `now` be of `time`?
    pub fn admit(&mut self, index: usize, time: FlightTime, now: FlightTime) -> bool {
        let may_be = may_be(time, now, self.behind_us);
        self.since.get_mut(index).is_some_and(|since| {
            *since = if may_be { None } else { since.or(Some(now)) };
            may_be
        })
    }

    /// Does sensor `index` tell times that cannot be?
    pub fn excludes(&self, index: usize, now: FlightTime) -> bool {
        self.since.get(index).copied().flatten().is_some_and(|since| now.seconds_since(since) > MOMENT_S)
    }
}

/// May a sample of a barometer, GNSS or motion capture that came `now` be of `time`?
pub fn from_elsewhere(time: FlightTime, now: FlightTime) -> bool {
    may_be(time, now, ELSEWHERE_BEHIND_US)
}

fn may_be(time: FlightTime, now: FlightTime, behind_us: u64) -> bool {
    time.0 <= now.0.saturating_add(AHEAD_US) && time.0.saturating_add(behind_us) >= now.0
}

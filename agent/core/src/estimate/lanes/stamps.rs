//! Stamps that cannot be. A sample that says it was taken long before it came, or after, is of a slot that nobody knows: it is not
//! used. An IMU or a height whose samples have been such for a while is excluded.

use plumbline_proto::time::FlightTime;

use super::PerLane;
use crate::sensor::{MAX_HEIGHTS, SensorFrame};

/// A sample is of no time after the one at which it came, but for what clocks differ by, µs.
const AHEAD_US: u64 = 20_000;
/// Nor of so long before it came: of an IMU, which comes at once; of a height, which takes a scan and its way; of what comes from elsewhere.
const IMU_BEHIND_US: u64 = 100_000;
const HEIGHT_BEHIND_US: u64 = 300_000;
const ELSEWHERE_BEHIND_US: u64 = 1_000_000;
/// Samples of such times are a matter of a moment until they have come for so long, s.
const MOMENT_S: f64 = 0.3;

/// Since when each IMU and height has told nothing but such times.
#[derive(Debug, Clone, Default)]
pub struct Stamps {
    imus: PerLane<Option<FlightTime>>,
    heights: [Option<FlightTime>; MAX_HEIGHTS],
}

fn may_be(time: FlightTime, now: FlightTime, behind_us: u64) -> bool {
    time.0 <= now.0.saturating_add(AHEAD_US) && time.0.saturating_add(behind_us) >= now.0
}

fn heard(since: &mut Option<FlightTime>, may_be: bool, now: FlightTime) -> bool {
    *since = if may_be { None } else { since.or(Some(now)) };
    may_be
}

impl Stamps {
    /// May a sample of IMU `index` be of `time`?
    pub fn imu(&mut self, index: usize, time: FlightTime, now: FlightTime) -> bool {
        let may_be = may_be(time, now, IMU_BEHIND_US);
        self.imus.get_mut(index).is_some_and(|since| heard(since, may_be, now))
    }

    /// May one of height `index`?
    pub fn height(&mut self, index: usize, time: FlightTime, now: FlightTime) -> bool {
        let may_be = may_be(time, now, HEIGHT_BEHIND_US);
        self.heights.get_mut(index).is_some_and(|since| heard(since, may_be, now))
    }

    /// May one of a barometer, GNSS or motion capture?
    pub fn elsewhere(time: FlightTime, frame: &SensorFrame) -> bool {
        may_be(time, frame.time, ELSEWHERE_BEHIND_US)
    }

    /// Does IMU `index` tell times that cannot be?
    pub fn excludes_imu(&self, index: usize, now: FlightTime) -> bool {
        lasts(self.imus.get(index), now)
    }

    /// Does height `index`?
    pub fn excludes_height(&self, index: usize, now: FlightTime) -> bool {
        lasts(self.heights.get(index), now)
    }
}

fn lasts(since: Option<&Option<FlightTime>>, now: FlightTime) -> bool {
    since.copied().flatten().is_some_and(|since| now.seconds_since(since) > MOMENT_S)
}

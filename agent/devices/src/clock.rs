//! A device's clock as the agent's: offset and skew from the arrivals of its stamps.
//!
//! What is known of each frame is t, the device's own time, and a = t + offset + skew · t + delay with a delay ≥ 0 that
//! jumps about. The least a − t of each second has next to none of it; a straight line through the last [`BLOCKS`] of these
//! minima (least squares) is offset and skew. A frame's time on our clock is then t on that line, never after its arrival.
//!
//! Assumes that the shortest delay of a second is the same from second to second. One-way it cannot be told from the offset and
//! is taken for zero, so a constant latency of the device is configured (`delay_s`), not found. Where the device answers
//! questions about its clock (Cristian 1989) it is found: a question asked at s and answered at a, with t in between, has the offset
//! (s + a)/2 − t within (a − s)/2; of the last [`EXCHANGES`] the one with the least round trip counts, and what the line lies
//! above it is the shortest delay.

use arrayvec::ArrayVec;

/// Seconds whose minima make the line.
pub const BLOCKS: usize = 16;
/// Length of a block, µs.
const BLOCK_US: f64 = 1e6;
/// Answers that are kept.
pub const EXCHANGES: usize = 16;
/// A crystal is off by less than 100 ppm, an RC oscillator by a few per cent.
const SKEW_MAX: f64 = 0.05;
/// A stamp that is off the line by more than this has jumped, µs.
const JUMP_US: f64 = 500e3;
/// Share of a new frame in the figures of delay and jitter.
const SMOOTHING: f64 = 0.02;

/// How a device counts time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stamp {
    /// As sent.
    pub ticks: u64,
    /// Length of a tick, µs.
    pub tick_us: f64,
    /// It counts from zero again at this many ticks.
    pub roll_over: u64,
}

/// A frame's time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mapped {
    /// On our clock, µs.
    pub time_us: f64,
    /// The device's clock went backwards (negative) or leapt: its line begins anew here. By how much, s.
    pub jumped_s: Option<f64>,
}

/// One device's clock.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    last: Option<(Stamp, f64)>,
    /// Device's time without roll-over, µs, and a − t there: the minimum of each past block.
    minima: ArrayVec<[f64; 2], BLOCKS>,
    /// Of the block under way: when it began, and its minimum.
    block: Option<(f64, [f64; 2])>,
    /// a − t at `at`, and its slope.
    line: Line,
    /// Round trip, device's time, offset there of the last answers, µs.
    exchanges: ArrayVec<[f64; 3], EXCHANGES>,
    /// Shortest delay by them, µs.
    shortest_us: f64,
    delay_us: f64,
    variance_us2: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Line {
    at_us: f64,
    offset_us: f64,
    skew: f64,
}

impl Line {
    /// a − t at the device's time `device_us`.
    fn at(&self, device_us: f64) -> f64 {
        self.offset_us + self.skew * (device_us - self.at_us)
    }
}

impl DeviceClock {
    /// Relative rate: how much faster our clock runs than the device's.
    pub fn skew(&self) -> f64 {
        self.line.skew
    }

    /// One sigma of the delays, µs.
    pub fn jitter_us(&self) -> f64 {
        self.variance_us2.sqrt()
    }

    /// Least round trip of the last answers, and the device's clock less ours by it, µs; `None` without any.
    pub fn offset(&self) -> Option<(f64, f64)> {
        self.least().map(|[round_trip_us, _, offset_us]| (round_trip_us, -offset_us))
    }

    /// A question asked at `asked_us` was answered with `stamp` at `answered_us`. Nothing before the first frame.
    pub fn answered(&mut self, stamp: Stamp, asked_us: f64, answered_us: f64) {
        let Some((last, last_us)) = self.last else { return };
        let (now, roll_over) = (stamp.ticks as f64 * stamp.tick_us, stamp.roll_over as f64 * stamp.tick_us);
        let since_us = now - last.ticks as f64 * last.tick_us;
        let device_us = last_us + since_us - roll_over * (since_us / roll_over).round();
        if self.exchanges.is_full() {
            self.exchanges.remove(0);
        }
        self.exchanges.push([answered_us - asked_us, device_us, 0.5 * (asked_us + answered_us) - device_us]);
        if let Some([round_trip_us, device_us, offset_us]) = self.least() {
            self.shortest_us = (self.line.at(device_us) - offset_us).clamp(0.0, round_trip_us.max(0.0));
        }
    }

    fn least(&self) -> Option<[f64; 3]> {
        self.exchanges.iter().copied().min_by(|a, b| a[0].total_cmp(&b[0]))
    }

    /// Mean delay beyond the shortest, µs.
    pub fn delay_us(&self) -> f64 {
        self.delay_us
    }

    /// The time of a frame that arrived at `arrival_us`.
    pub fn map(&mut self, stamp: Stamp, arrival_us: f64) -> Mapped {
        let jumped_s = self.advance(stamp, arrival_us);
        let device_us = self.last.map_or(0.0, |(_, us)| us);
        self.learn([device_us, arrival_us - device_us]);
        let mapped = device_us + self.line.at(device_us);
        let delay = arrival_us - mapped;
        let late = delay - self.delay_us;
        self.delay_us += SMOOTHING * late;
        self.variance_us2 += SMOOTHING * (late * late - self.variance_us2);
        Mapped { time_us: mapped.min(arrival_us) - self.shortest_us, jumped_s }
    }

    /// Counts on through roll-overs; begins anew where that makes no sense.
    fn advance(&mut self, stamp: Stamp, arrival_us: f64) -> Option<f64> {
        let Some((last, last_us)) = self.last else {
            self.last = Some((stamp, stamp.ticks as f64 * stamp.tick_us));
            return None;
        };
        let roll_over = stamp.roll_over.max(1);
        let forward = (stamp.ticks % roll_over + roll_over - last.ticks % roll_over) % roll_over;
        let device_us = last_us + forward as f64 * stamp.tick_us;
        let expected_us = device_us + self.line.at(device_us);
        let off_us = expected_us - arrival_us;
        // Late frames may be very late, but nothing arrives before it was sent.
        let jumped = !(-10.0 * JUMP_US..=JUMP_US).contains(&off_us);
        if jumped {
            *self = Self::default();
            self.last = Some((stamp, stamp.ticks as f64 * stamp.tick_us));
            // Backwards reads as nearly a whole roll-over forward.
            let back_us = off_us - roll_over as f64 * stamp.tick_us;
            return Some(1e-6 * if back_us.abs() < off_us.abs() { back_us } else { off_us });
        }
        self.last = Some((stamp, device_us));
        None
    }

    fn learn(&mut self, point: [f64; 2]) {
        // The least delay: what the skew known so far adds within a block is no delay.
        let skew = self.line.skew;
        let bare = |p: &[f64; 2]| p[1] - skew * p[0];
        let (begun_us, minimum) = self.block.get_or_insert((point[0], point));
        if bare(&point) < bare(minimum) {
            *minimum = point;
        }
        if self.minima.len() < 3 {
            // Too few for a slope: the least so far.
            let least = self.minima.iter().chain([&*minimum]).fold(f64::INFINITY, |least, p| least.min(p[1]));
            self.line = Line { at_us: point[0], offset_us: least, skew: 0.0 };
        }
        if point[0] - *begun_us >= BLOCK_US {
            if self.minima.is_full() {
                self.minima.remove(0);
            }
            self.minima.push(*minimum);
            self.block = None;
            self.fit();
        }
    }

    fn fit(&mut self) {
        let n = self.minima.len() as f64;
        if n < 3.0 {
            return;
        }
        let (st, sd) = self.minima.iter().fold((0.0, 0.0), |(t, d), p| (t + p[0], d + p[1]));
        let (mean_t, mean_d) = (st / n, sd / n);
        let (tt, td) = self.minima.iter().fold((0.0, 0.0), |(tt, td), p| {
            let t = p[0] - mean_t;
            (tt + t * t, td + t * (p[1] - mean_d))
        });
        let skew = if tt > 0.0 { (td / tt).clamp(-SKEW_MAX, SKEW_MAX) } else { 0.0 };
        self.line = Line { at_us: mean_t, offset_us: mean_d, skew };
    }
}

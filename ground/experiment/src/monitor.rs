//! The detectors that anyone would try first, for each sensor: χ² of a window, and CUSUM.
//!
//! | symbol | meaning |
//! |---|---|
//! | d | deviation over its σ: of an IMU's axis from the median of all IMUs, of a height from the altitude of the estimator in the loop; mean and σ as learned in steady flight |
//! | χ²/n | Σ d² over the samples and axes of the last [`WINDOW_S`], by their number |
//! | S | max(0, S ± d − [`SLACK`]), the largest of all axes and both signs (Page 1954) |
//!
//! Both are over the level that one healthy sensor of a hundred reaches in a flight ([`Test::limit`]), so that 1 excludes.

use std::collections::VecDeque;

use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::imu::ImuSample;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use crate::draw::median;

/// Mean and σ are learned between these times from the beginning on, s: on the way to the first altitude and there.
const LEARNS_S: (f64, f64) = (7.0, 12.0);
/// Length of the window of χ², s.
pub const WINDOW_S: f64 = 0.5;
/// Slack k of the CUSUM, σ.
pub const SLACK: f64 = 0.75;
/// One sample counts at most so many σ.
const MOST: f64 = 30.0;
/// An IMU's sample counts for the median so long, s.
pub(crate) const FRESH_S: f64 = 0.03;
/// Excluded until it has been below half its limit for so long, s.
const CALM_S: f64 = 2.0;
/// Gyroscope, accelerometer, magnetometer.
const AXES: usize = 9;

/// Which of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Test {
    /// χ² of a window.
    ChiSquare,
    /// CUSUM.
    Cusum,
}

impl Test {
    /// Both.
    pub const ALL: [Self; 2] = [Self::ChiSquare, Self::Cusum];

    /// What one healthy sensor of a hundred reaches in a flight of the world `datasheet` without an attack: 100 flights of
    /// `cargo xtask reproduce attacks --only roc --seed-base 1`. Residuals are coloured, hence so much.
    fn limit(self, kind: SensorKind) -> f64 {
        match (self, kind) {
            (Self::ChiSquare, SensorKind::Imu) => 5.5,
            (Self::ChiSquare, _) => 207.0,
            (Self::Cusum, SensorKind::Imu) => 49.0,
            (Self::Cusum, _) => 161.0,
        }
    }
}

/// One scalar of a sensor.
#[derive(Debug, Clone, Default)]
struct Axis {
    learned: Vec<f64>,
    mean: f64,
    sigma: f64,
    up: f64,
    down: f64,
}

impl Axis {
    /// `value` over σ; `None` while it learns.
    fn deviation(&mut self, value: f64, t: f64) -> Option<f64> {
        if t < LEARNS_S.1 {
            if t >= LEARNS_S.0 {
                self.learned.push(value);
            }
            return None;
        }
        if !self.learned.is_empty() {
            let learned = std::mem::take(&mut self.learned);
            self.mean = median(&learned);
            // 1.4826: σ of a normal over its median absolute deviation.
            self.sigma = 1.4826 * median(&learned.iter().map(|v| (v - self.mean).abs()).collect::<Vec<_>>());
        }
        let d = (value - self.mean) / self.sigma;
        d.is_finite().then(|| d.clamp(-MOST, MOST))
    }

    fn sum(&mut self, d: f64) -> f64 {
        (self.up, self.down) = ((self.up + d - SLACK).max(0.0), (self.down - d - SLACK).max(0.0));
        self.up.max(self.down)
    }
}

#[derive(Debug, Clone)]
struct Watched {
    sensor: SensorId,
    axes: [Axis; AXES],
    /// When, Σ d², of how many axes.
    window: VecDeque<(f64, f64, f64)>,
    statistic: [f64; 2],
    /// Excluded by each test until it has been calm since, s.
    excluded: [Option<f64>; 2],
}

impl Watched {
    fn take(&mut self, t: f64, values: impl Iterator<Item = (usize, f64)>) {
        let (mut squares, mut count, mut sum) = (0.0, 0.0, 0.0_f64);
        for (axis, value) in values {
            let Some(axis) = self.axes.get_mut(axis) else { continue };
            let Some(d) = axis.deviation(value, t) else { continue };
            (squares, count, sum) = (squares + d * d, count + 1.0, sum.max(axis.sum(d)));
        }
        if count == 0.0 {
            return;
        }
        self.window.push_back((t, squares, count));
        while self.window.front().is_some_and(|(at, _, _)| t - at > WINDOW_S) {
            self.window.pop_front();
        }
        let [squares, count] =
            self.window.iter().fold([0.0; 2], |[squares, all], (_, square, count)| [squares + square, all + count]);
        let kind = self.sensor.kind;
        self.statistic = [squares / count / Test::ChiSquare.limit(kind), sum / Test::Cusum.limit(kind)];
        for (excluded, statistic) in self.excluded.iter_mut().zip(self.statistic) {
            *excluded = match *excluded {
                _ if statistic > 0.5 && (statistic > 1.0 || excluded.is_some()) => Some(t),
                Some(since) if t - since < CALM_S => Some(since),
                _ => None,
            };
        }
    }
}

/// Both tests of every IMU and height.
#[derive(Debug, Clone, Default)]
pub struct Monitor {
    begin: FlightTime,
    watched: Vec<Watched>,
    imus: Vec<Option<ImuSample>>,
}

fn scalars(sample: &ImuSample) -> [Option<f64>; AXES] {
    let (gyro, accel, mag) = (sample.gyro_radps, sample.accel_mps2, sample.mag_ut);
    std::array::from_fn(|i| match i {
        0..3 => Some(gyro[i]),
        3..6 => Some(accel[i - 3]),
        _ => mag.map(|mag| mag[i - 6]),
    })
}

impl Monitor {
    /// Of a recording that begins at this time.
    pub(crate) fn since(begin: FlightTime) -> Self {
        Self { begin, ..Self::default() }
    }

    /// What was received in a tick, and the altitude (ENU, m) of the estimator in the loop, where it knows one.
    pub fn take(&mut self, received: &SensorFrame, altitude_m: Option<f64>) {
        let t = received.time.seconds_since(self.begin);
        self.imus.resize(received.imus.len(), None);
        for (kept, new) in self.imus.iter_mut().zip(&received.imus) {
            *kept = new.or(*kept).filter(|sample| received.time.seconds_since(sample.time) < FRESH_S);
        }
        let all: Vec<_> = self.imus.iter().flatten().map(scalars).collect();
        let centre: [f64; AXES] =
            std::array::from_fn(|axis| median(&all.iter().filter_map(|of| of[axis]).collect::<Vec<_>>()));
        for (i, sample) in received.imus.iter().enumerate() {
            if let (Some(sample), true) = (sample, all.len() > 2) {
                let off = scalars(sample).into_iter().zip(centre).map(|(value, centre)| value.map(|v| v - centre));
                let off = off.enumerate().filter_map(|(axis, value)| Some((axis, value?)));
                self.of(SensorId::new(SensorKind::Imu, i as u8 + 1)).take(t, off);
            }
        }
        for (i, sample) in received.heights.iter().enumerate() {
            if let (Some(sample), Some(altitude_m)) = (sample, altitude_m) {
                let off = std::iter::once((0, sample.height_m - altitude_m));
                self.of(SensorId::new(SensorKind::Height, i as u8 + 1)).take(t, off);
            }
        }
    }

    fn of(&mut self, sensor: SensorId) -> &mut Watched {
        let index = self.watched.iter().position(|watched| watched.sensor == sensor).unwrap_or_else(|| {
            let (axes, window) = (std::array::from_fn(|_| Axis::default()), VecDeque::new());
            self.watched.push(Watched { sensor, axes, window, statistic: [0.0; 2], excluded: [None; 2] });
            self.watched.len() - 1
        });
        &mut self.watched[index]
    }

    /// The statistic of each sensor over the limit, by [`Test::ALL`].
    pub fn statistics(&self) -> impl Iterator<Item = (SensorId, [f64; 2])> {
        self.watched.iter().map(|watched| (watched.sensor, watched.statistic))
    }

    /// `frame` without the sensors that `test` excludes.
    pub(crate) fn without(&self, test: Test, mut frame: SensorFrame) -> SensorFrame {
        let of = |watched: &&Watched| watched.excluded.get(test as usize).copied().flatten().is_some();
        for watched in self.watched.iter().filter(of) {
            frame.withhold(|sensor| sensor == watched.sensor);
        }
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Dice;
    use nalgebra::Vector3;
    use plumbline_agent::sensor::height::HeightSample;

    /// 30 s of four IMUs and two heights at 100 Hz; `attack` changes the second of each in the last two seconds.
    fn run(begin: FlightTime, attack: fn(&mut ImuSample, &mut HeightSample)) -> Monitor {
        let (mut monitor, mut dice) = (Monitor::since(begin), Dice::new(3));
        for k in 0..3000_u64 {
            let time = FlightTime(begin.0 + k * 10_000);
            let mut frame = SensorFrame { time, ..SensorFrame::default() };
            let mut imu = || ImuSample {
                time,
                gyro_radps: Vector3::from_fn(|_, _| 0.01 * dice.normal()),
                accel_mps2: Vector3::from_fn(|_, _| 0.1 * dice.normal()),
                mag_ut: None,
                temperature_c: 20.0,
            };
            let mut imus = [imu(), imu(), imu(), imu()];
            let mut heights = [0.01, 0.01].map(|sigma| HeightSample { time, height_m: 1.0 + sigma * dice.normal() });
            if time.seconds_since(begin) > 28.0 {
                attack(&mut imus[1], &mut heights[1]);
            }
            frame.imus.iter_mut().zip(imus).for_each(|(place, sample)| *place = Some(sample));
            frame.heights.iter_mut().zip(heights).for_each(|(place, sample)| *place = Some(sample));
            monitor.take(&frame, Some(1.0));
        }
        monitor
    }

    fn excluded(monitor: &Monitor, test: Test) -> Vec<SensorId> {
        let of = |watched: &&Watched| watched.excluded[test as usize].is_some();
        monitor.watched.iter().filter(of).map(|watched| watched.sensor).collect()
    }

    #[test]
    fn who_is_attacked_is_excluded_by_both_and_nobody_else() {
        // From boot on, and in a recording that begins ten minutes later.
        for begin in [FlightTime(0), FlightTime(600_000_000)] {
            let quiet = run(begin, |_, _| {});
            for (sensor, [chi_square, cusum]) in quiet.statistics() {
                let limit = Test::ChiSquare.limit(sensor.kind);
                assert!((0.5..2.0).contains(&(chi_square * limit)) && cusum < 0.3, "{sensor}: {chi_square} {cusum}");
            }
            let attacked = run(begin, |imu, height| {
                imu.gyro_radps.x += 0.1;
                height.height_m += 0.4;
            });
            let both = [SensorId::new(SensorKind::Imu, 2), SensorId::new(SensorKind::Height, 2)];
            for test in Test::ALL {
                assert_eq!(excluded(&quiet, test), []);
                assert_eq!(excluded(&attacked, test), both, "{test:?}");
            }
        }
    }
}

//! Do the sensors of a kind tell the same before take-off? A height over the edge of a table, an IMU that has been turned in its mount or
//! whose bias has jumped outvotes nobody in flight: it takes one of those that could have been.
//!
//! What each reads is averaged over a second and held against the median of its kind; of two neither is known to be right.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use crate::estimate::median;
use crate::event::{Text, text};
use crate::sensor::{MAX_HEIGHTS, MAX_IMUS, SensorFrame};

/// Time constant of the means, s.
const MEAN_S: f64 = 1.0;
/// A mean over less says nothing yet, s …
const LEAST_S: f64 = 2.0;
/// … nor does one that nothing was added to for so long, s.
const SILENT_S: f64 = 0.5;
/// How far specific forces may be apart on an axis, m/s²: twice ArduPilot's `ARMING_ACCTHRESH`, beyond which scale and cross-axis errors
/// of a data sheet (2 % of gravity each) alone were in 12 of 100 vehicles …
const ACCEL_MPS2: f64 = 1.5;
/// … angular rates, rad/s (PX4's `COM_ARM_IMU_GYR`) …
const GYRO_RADPS: f64 = 0.25;
/// … and heights, m.
const HEIGHT_M: f64 = 0.12;

/// Mean of what one sensor reads.
#[derive(Debug, Clone, Copy)]
struct Mean<const N: usize> {
    since: FlightTime,
    latest: FlightTime,
    value: [f64; N],
}

impl<const N: usize> Mean<N> {
    fn take(kept: &mut Option<Self>, now: FlightTime, new: Option<[f64; N]>) {
        *kept = kept.filter(|mean| mean.is_fresh(now));
        let Some(new) = new.filter(|values| values.iter().all(|value| value.is_finite())) else { return };
        let mean = kept.get_or_insert(Self { since: now, latest: now, value: new });
        let part = 1.0 - (-now.seconds_since(mean.latest) / MEAN_S).exp();
        mean.value.iter_mut().zip(new).for_each(|(mean, new)| *mean += part * (new - *mean));
        mean.latest = now;
    }

    fn is_fresh(&self, now: FlightTime) -> bool {
        now.seconds_since(self.latest) <= SILENT_S
    }

    fn is_known(&self, now: FlightTime) -> bool {
        self.is_fresh(now) && now.seconds_since(self.since) >= LEAST_S
    }
}

/// One reading that is apart from the others.
#[derive(Debug, Clone, Copy)]
struct Apart {
    sensor: SensorId,
    /// Of how many.
    of: usize,
    by: f64,
    limit: f64,
    unit: &'static str,
}

/// See the module.
#[derive(Debug, Clone, Default)]
pub struct Agreement {
    /// Specific force and angular rate, body FLU, m/s² and rad/s.
    imus: [Option<Mean<6>>; MAX_IMUS],
    /// m.
    heights: [Option<Mean<1>>; MAX_HEIGHTS],
}

impl Agreement {
    /// Takes the frame received.
    pub fn step(&mut self, received: &SensorFrame) {
        let now = received.time;
        for (kept, new) in self.imus.iter_mut().zip(&received.imus) {
            let six = |(a, w): (Vector3<f64>, Vector3<f64>)| [a.x, a.y, a.z, w.x, w.y, w.z];
            Mean::take(kept, now, new.map(|imu| six((imu.accel_mps2, imu.gyro_radps))));
        }
        for (kept, new) in self.heights.iter_mut().zip(&received.heights) {
            Mean::take(kept, now, new.map(|height| [height.height_m]));
        }
    }

    /// Do they agree, and in words how far which is apart?
    pub fn told(&self, now: FlightTime) -> (bool, Text) {
        let limits = [ACCEL_MPS2, ACCEL_MPS2, ACCEL_MPS2, GYRO_RADPS, GYRO_RADPS, GYRO_RADPS];
        let units = ["m/s²", "m/s²", "m/s²", "rad/s", "rad/s", "rad/s"];
        let imus = furthest(SensorKind::Imu, &self.imus, now, limits, units);
        let heights = furthest(SensorKind::Height, &self.heights, now, [HEIGHT_M], ["m"]);
        let furthest = imus.into_iter().chain(heights).max_by(|a, b| (a.by / a.limit).total_cmp(&(b.by / b.limit)));
        let Some(Apart { sensor, of, by, limit, unit }) = furthest else {
            return (true, text(format_args!("nothing to compare")));
        };
        let others = if of == 2 { "the other of its kind" } else { "the median of its kind" };
        let line = text(format_args!("{sensor} is {by:.2} {unit} from {others}, at most {limit} {unit}"));
        (by <= limit, line)
    }
}

/// Of several sensors of a kind the one that is furthest from their median, by the limits.
fn furthest<const N: usize>(
    kind: SensorKind,
    all: &[Option<Mean<N>>],
    now: FlightTime,
    limits: [f64; N],
    units: [&'static str; N],
) -> Option<Apart> {
    let known =
        || (1..).zip(all).filter_map(|(instance, mean)| Some((instance, mean.filter(|mean| mean.is_known(now))?)));
    let of = known().count();
    if of < 2 {
        return None;
    }
    let channels = limits.into_iter().zip(units).enumerate();
    let apart = channels.flat_map(|(channel, (limit, unit))| {
        let value = move |mean: &Mean<N>| mean.value.get(channel).copied().unwrap_or_default();
        let middle = median(known().map(|(_, mean)| value(&mean)));
        // Between two lies nobody: each is as far from the other.
        let whole = if of == 2 { 2.0 } else { 1.0 };
        let each: ArrayVec<Apart, MAX_IMUS> = known()
            .take(MAX_IMUS)
            .map(|(instance, mean)| {
                let by = whole * (value(&mean) - middle).abs();
                Apart { sensor: SensorId::new(kind, instance), of, by, limit, unit }
            })
            .collect();
        each
    });
    apart.max_by(|a, b| (a.by / a.limit).total_cmp(&(b.by / b.limit)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{HeightSample, ImuSample};

    /// Three seconds of IMUs with these forces along x and of these heights.
    fn heard(forces_mps2: &[f64], heights_m: &[f64], silent_from: u64) -> (bool, String) {
        let mut agreement = Agreement::default();
        let mut now = FlightTime(0);
        for k in 0..600_u64 {
            now = FlightTime(5000 * k);
            let mut frame = SensorFrame { time: now, ..SensorFrame::default() };
            if k < silent_from {
                for (place, x) in frame.imus.iter_mut().zip(forces_mps2) {
                    // As it shakes.
                    let shaken = if k % 2 == 0 { 3.0 } else { -3.0 };
                    let accel_mps2 = Vector3::new(x + shaken, 0.0, 9.81);
                    let gyro_radps = Vector3::zeros();
                    *place = Some(ImuSample { time: now, gyro_radps, accel_mps2, mag_ut: None, temperature_c: 20.0 });
                }
            }
            for (place, height_m) in frame.heights.iter_mut().zip(heights_m) {
                *place = Some(HeightSample { time: now, height_m: *height_m });
            }
            agreement.step(&frame);
        }
        let (passed, line) = agreement.told(now);
        (passed, line.to_string())
    }

    #[test]
    fn names_whoever_is_apart_and_by_how_much() {
        let all = u64::MAX;
        let (passed, line) = heard(&[0.1, 0.0, 0.05, -0.05], &[0.3, 0.31, 0.29], all);
        assert!(passed && line.starts_with("height 3 is 0.01 m"), "{line}");
        let (passed, line) = heard(&[0.1, 0.0, 0.05, -1.9], &[0.3, 0.31, 0.29], all);
        assert!(!passed && line.starts_with("imu 4 is 1.9") && line.ends_with("at most 1.5 m/s²"), "{line}");
        let (passed, line) = heard(&[0.1, 0.0, 0.05], &[0.3, 0.95, 0.29], all);
        assert_eq!((passed, line.as_str()), (false, "height 2 is 0.65 m from the median of its kind, at most 0.12 m"));
        let (passed, line) = heard(&[0.0], &[0.3, 0.5], all);
        assert!(!passed && line.contains("is 0.20 m from the other of its kind"), "{line}");
    }

    #[test]
    fn one_alone_and_one_that_is_silent_contradict_nobody() {
        assert_eq!(heard(&[1.0], &[0.3], u64::MAX), (true, "nothing to compare".to_owned()));
        assert_eq!(heard(&[0.0, 5.0, 0.0], &[], 450), (true, "nothing to compare".to_owned()));
        assert!(!heard(&[], &[f64::NAN, 0.3, 9.0], u64::MAX).0);
    }
}

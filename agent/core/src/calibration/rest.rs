//! Static intervals: when an IMU lies still, judged by its own noise.
//!
//! After Skog & Händel 2006 and Tedaldi et al. 2014, with one change: the threshold follows from the noise of the
//! recording itself (second differences of successive samples, median: motion hardly moves it), so nothing has
//! to be held still at the beginning.

use nalgebra::Vector3;

use super::fit::median;

/// Windows in which standstill is judged, s.
const WINDOW_S: f64 = 0.5;
/// Shortest interval that counts, s.
const INTERVAL_S: f64 = 1.0;
/// Some of it may be lost to the edges of windows.
const WHOLE: f64 = 0.9;
/// A window is still while its spread stays below this many sigmas of white noise …
const NOISE_SIGMAS: f64 = 2.5;
/// … plus what a table or a hand adds: m/s² …
const ACCEL_FLOOR_MPS2: f64 = 0.05;
/// … and rad/s.
const GYRO_FLOOR_RADPS: f64 = 0.01;
/// A steady rate above this is a turn, not a bias, rad/s.
const GYRO_BIAS_MAX_RADPS: f64 = 0.15;
/// Median of |x| over σ of a normal x.
const NORMAL_MEDIAN: f64 = 0.6745;

/// One sample of both sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Time, s.
    pub time_s: f64,
    /// Specific force, m/s².
    pub accel_mps2: Vector3<f64>,
    /// Angular rate, rad/s; `None` where there is no gyroscope.
    pub gyro_radps: Option<Vector3<f64>>,
}

/// A time at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// First sample.
    pub first: usize,
    /// One past the last.
    pub end: usize,
    /// Mean specific force, m/s².
    pub accel_mps2: Vector3<f64>,
    /// Mean angular rate, rad/s.
    pub gyro_radps: Option<Vector3<f64>>,
}

/// One-sigma of white noise of the worst axis, by second differences.
fn white_sigma(values: impl Fn(usize) -> Option<Vector3<f64>>, count: usize) -> f64 {
    (0..3)
        .map(|axis| {
            let mut sizes: Vec<f64> = (2..count)
                .filter_map(|k| {
                    let (a, b, c) = (values(k - 2)?, values(k - 1)?, values(k)?);
                    Some((a[axis] - 2.0 * b[axis] + c[axis]).abs())
                })
                .collect();
            median(&mut sizes).unwrap_or(0.0) / (NORMAL_MEDIAN * 6.0_f64.sqrt())
        })
        .fold(0.0, f64::max)
}

/// Largest standard deviation of the three axes, and their mean.
fn spread(values: impl Iterator<Item = Vector3<f64>> + Clone) -> (f64, Vector3<f64>) {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<Vector3<f64>>() / n;
    let variance = values.map(|v| (v - mean).component_mul(&(v - mean))).sum::<Vector3<f64>>() / n;
    (variance.max().sqrt(), mean)
}

/// The intervals at rest, in time order.
pub fn intervals(samples: &[Pair]) -> Vec<Rest> {
    let long = |(first, end): &(usize, usize)| end > first && held_s(samples, *first, *end) >= WHOLE * INTERVAL_S;
    let rest = |(first, end): (usize, usize)| {
        let window = &samples[first..end];
        let (_, accel_mps2) = spread(window.iter().map(|s| s.accel_mps2));
        let gyros = window.iter().filter_map(|s| s.gyro_radps);
        let gyro_radps = (gyros.clone().count() > 0).then(|| spread(gyros).1);
        Rest { first, end, accel_mps2, gyro_radps }
    };
    still(samples).into_iter().filter(long).map(rest).collect()
}

/// How long the newest samples have been at rest, as a share of what makes an interval: 1 where they are one, 0 in motion.
pub fn share(samples: &[Pair]) -> f64 {
    let newest_s = samples.last().map_or(0.0, |s| s.time_s);
    let last = still(samples).last().copied().filter(|(_, end)| {
        // The windows do not end with the newest sample.
        samples.get(*end - 1).is_some_and(|s| newest_s - s.time_s < WINDOW_S)
    });
    last.map_or(0.0, |(first, end)| (held_s(samples, first, end) / (WHOLE * INTERVAL_S)).min(1.0))
}

fn held_s(samples: &[Pair], first: usize, end: usize) -> f64 {
    samples[end - 1].time_s - samples[first].time_s
}

/// First and one past the last sample of each run of still windows of one pose, however short.
fn still(samples: &[Pair]) -> Vec<(usize, usize)> {
    let accel_limit = NOISE_SIGMAS * white_sigma(|k| Some(samples[k].accel_mps2), samples.len()) + ACCEL_FLOOR_MPS2;
    let gyro_limit = NOISE_SIGMAS * white_sigma(|k| samples[k].gyro_radps, samples.len()) + GYRO_FLOOR_RADPS;
    // Windows of half their own length apart; an interval is a run of still ones.
    let mut still = Vec::new();
    let mut first = 0;
    while first < samples.len() {
        let until = samples[first].time_s + WINDOW_S;
        let end = first + samples[first..].iter().take_while(|s| s.time_s < until).count();
        if end - first < 4 || samples[end - 1].time_s - samples[first].time_s < 0.6 * WINDOW_S {
            first = end.max(first + 1);
            continue;
        }
        let window = &samples[first..end];
        let (accel, _) = spread(window.iter().map(|s| s.accel_mps2));
        let gyros = window.iter().filter_map(|s| s.gyro_radps);
        let (gyro, mean) = spread(gyros);
        if accel <= accel_limit && gyro <= gyro_limit && mean.amax() <= GYRO_BIAS_MAX_RADPS {
            still.push((first, end));
        }
        first += ((end - first) / 2).max(1);
    }
    let mut merged: Vec<(usize, usize)> = Vec::new();
    for (first, end) in still {
        match merged.last_mut() {
            // The same pose only: a slow tilt between two still windows would smear the mean.
            Some(last) if first <= last.1 && same_pose(&samples[last.0..last.1], &samples[first..end], accel_limit) => {
                last.1 = end;
            }
            _ => merged.push((first.max(merged.last().map_or(0, |l| l.1)), end)),
        }
    }
    merged
}

fn same_pose(a: &[Pair], b: &[Pair], limit: f64) -> bool {
    let mean = |w: &[Pair]| spread(w.iter().map(|s| s.accel_mps2)).1;
    (mean(a) - mean(b)).norm() <= limit
}

/// One interval for each pose: those within `apart_rad` of an earlier direction are left out, the longest kept.
pub fn poses(rests: &[Rest], apart_rad: f64) -> Vec<Rest> {
    let mut sorted: Vec<Rest> = rests.to_vec();
    sorted.sort_by_key(|r| std::cmp::Reverse(r.end - r.first));
    let mut kept: Vec<Rest> = Vec::new();
    for rest in sorted {
        if kept.iter().all(|k| k.accel_mps2.angle(&rest.accel_mps2) >= apart_rad) {
            kept.push(rest);
        }
    }
    kept.sort_by_key(|r| r.first);
    kept
}

//! Accelerometer and gyroscope: scale, misalignment, bias, from poses at rest and the turns between them.
//!
//! After I. Skog and P. Händel, "Calibration of a MEMS inertial measurement unit" (2006), for the accelerometer:
//! at rest |f| = g in every pose. The gyroscope after D. Tedaldi, A. Pretto and E. Menegatti, "A robust and easy
//! to implement method for IMU calibration without external equipments" (2014): integrated from one pose to the
//! next, it must turn the one's direction of gravity into the other's; no turntable is needed.
//!
//! | symbol | meaning |
//! |---|---|
//! | u | reading |
//! | b | bias, in units of the reading |
//! | K | diag of scale factors |
//! | T | unit diagonal: misalignment, rad |
//! | a, ω | calibrated: a = T K (u − b) |
//!
//! The frame is the accelerometer's: its x axis is taken as true and its xy plane as level with it (T upper
//! triangular), since rest alone cannot tell a common rotation of all axes. The gyroscope's T is full: it is
//! aligned with the accelerometer. Deviation from the sources: the inverse model is fitted directly (a from u),
//! as Tedaldi et al. write it; the cost is (|a| − g) instead of (|a|² − g²), which is in m/s².

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::fit::{self, Fit};
use super::guide::{Aim, Progress};
use super::rest::{self, Pair, Rest, intervals, poses};
use super::samples::{Channel, Sample, channel};
use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};

/// Poses nearer to each other than this count once, rad.
const POSES_APART_RAD: f64 = 0.25;
/// Poses for scale, misalignment and bias; one more than the nine unknowns would be for a residual.
const POSES_FULL: usize = 10;
/// Poses for scale and bias alone.
const POSES_SCALE: usize = 7;
/// Turns for the gyroscope's nine unknowns (each gives two equations).
const TURNS_MIN: usize = 6;
/// A turn of gravity by less than this says little, rad.
const TURN_MIN_RAD: f64 = 0.5;
/// Longest turn that is integrated, s: noise and bias grow with it.
const TURN_MAX_S: f64 = 30.0;
/// A scale factor known worse than this is useless.
const SCALE_SIGMA_MAX: f64 = 0.02;
/// Largest residual of the accelerometer, m/s².
const ACCEL_RESIDUAL_MAX: f64 = 0.2;
/// Largest residual of the gyroscope's turns, as an angle, rad.
const TURN_RESIDUAL_MAX: f64 = 0.1;
/// Samples for anything at all.
const SAMPLES_MIN: usize = 200;
/// What is counted.
const POSES: &str = "poses at rest (a second each, 15° apart)";
const TURNS: &str = "turns of 30° and more between rests";

/// Reading ─► calibrated: `matrix` (reading − `offset`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triad {
    /// T K.
    pub matrix: Matrix3<f64>,
    /// b, in units of the reading.
    pub offset: Vector3<f64>,
}

impl Triad {
    /// Changes nothing.
    pub fn identity() -> Self {
        Self { matrix: Matrix3::identity(), offset: Vector3::zeros() }
    }

    /// Calibrated value of `reading`.
    pub fn apply(&self, reading: &Vector3<f64>) -> Vector3<f64> {
        self.matrix * (reading - self.offset)
    }
}

const ACCEL_NAMES: [(&str, &str); 9] = [
    ("scale_x", ""),
    ("scale_y", ""),
    ("scale_z", ""),
    ("bias_x", "m/s²"),
    ("bias_y", "m/s²"),
    ("bias_z", "m/s²"),
    ("misalignment_xy", "rad"),
    ("misalignment_xz", "rad"),
    ("misalignment_yz", "rad"),
];

fn accel_triad(x: &[f64]) -> Triad {
    let at = |i: usize| x.get(i).copied().unwrap_or(0.0);
    let t = Matrix3::new(1.0, at(6), at(7), 0.0, 1.0, at(8), 0.0, 0.0, 1.0);
    Triad {
        matrix: t * Matrix3::from_diagonal(&Vector3::new(at(0), at(1), at(2))),
        offset: Vector3::new(at(3), at(4), at(5)),
    }
}

/// The accelerometer's triad of a file.
///
/// # Errors
/// [`CalibrationError::File`] where a parameter is missing.
pub fn accelerometer_of(file: &CalibrationFile) -> Result<Triad, CalibrationError> {
    // Misalignment is absent from a fit of scale and bias alone.
    let x: Vec<f64> = ACCEL_NAMES[..6].iter().map(|(name, _)| file.value(name)).collect::<Result<_, _>>()?;
    let rest = ACCEL_NAMES[6..].iter().map(|(name, _)| file.value(name).unwrap_or(0.0));
    Ok(accel_triad(&x.into_iter().chain(rest).collect::<Vec<_>>()))
}

/// Samples that have both sensors, or the accelerometer alone.
fn pairs(samples: &[Sample]) -> Result<Vec<Pair>, CalibrationError> {
    paired(samples, SAMPLES_MIN)
}

fn paired(samples: &[Sample], needed: usize) -> Result<Vec<Pair>, CalibrationError> {
    let accel = channel(samples, Channel::Accelerometer, "accelerometer samples", needed)?;
    let mut gyros = samples.iter().filter(|s| s.accel_mps2.is_some()).map(|s| s.gyro_radps);
    Ok(accel
        .into_iter()
        .map(|(time_s, accel_mps2)| Pair { time_s, accel_mps2, gyro_radps: gyros.next().flatten() })
        .collect())
}

/// Fits the accelerometer: `gravity_mps2` is that of the place.
///
/// # Errors
/// [`CalibrationError`]: NaN, saturation, no rest, too few poses, a parameter that stays unknown, a bad fit.
pub fn accelerometer(samples: &[Sample], gravity_mps2: f64) -> Result<CalibrationFile, CalibrationError> {
    let pairs = pairs(samples)?;
    let rests = intervals(&pairs);
    let poses = poses(&rests, POSES_APART_RAD);
    if poses.len() < POSES_SCALE {
        return Err(CalibrationError::TooFew { what: POSES, found: poses.len(), needed: POSES_SCALE });
    }
    let full = poses.len() >= POSES_FULL;
    let fit = fit_accelerometer(&poses, gravity_mps2, if full { 9 } else { 6 })?;
    for (i, (name, _)) in ACCEL_NAMES.iter().enumerate().take(fit.x.len()) {
        // A bias is judged by the tilt it would feign: 2 % of g.
        let limit = if (3..6).contains(&i) { SCALE_SIGMA_MAX * gravity_mps2 } else { SCALE_SIGMA_MAX };
        if fit.sigma(i) > limit {
            return Err(CalibrationError::Undetermined { parameter: (*name).into(), sigma: fit.sigma(i), limit });
        }
    }
    fit.converged()?;
    if fit.rms > ACCEL_RESIDUAL_MAX {
        return Err(CalibrationError::BadFit { found: fit.rms, limit: ACCEL_RESIDUAL_MAX, unit: "m/s²" });
    }
    let triad = accel_triad(fit.x.as_slice());
    let mut file = CalibrationFile::new(Kind::Accelerometer, poses.len(), fit.rms, "m/s²")
        .with_fit(&fit, &ACCEL_NAMES[..fit.x.len()]);
    if !full {
        let found = poses.len();
        file.notes.push(format!("{found} poses: scale and bias only; misalignment takes {POSES_FULL} poses"));
    }
    let strength = |f: &dyn Fn(&Rest) -> Vector3<f64>| {
        poses.iter().enumerate().map(|(k, pose)| [(k + 1) as f64, f(pose).norm()]).collect::<Vec<_>>()
    };
    file.picture.push(Plot {
        title: "Specific force at rest".into(),
        x: "pose".into(),
        y: "|f|, m/s²".into(),
        log: false,
        series: vec![
            Series::new("before", false, strength(&|pose| pose.accel_mps2)),
            Series::new("after", false, strength(&|pose| triad.apply(&pose.accel_mps2))),
            Series::new("gravity", true, [[1.0, gravity_mps2], [poses.len() as f64, gravity_mps2]]),
        ],
    });
    Ok(file)
}

/// How far samples are from what [`accelerometer`] asks for.
pub(super) fn poses_taken(samples: &[Sample]) -> Result<Progress, CalibrationError> {
    let pairs = paired(samples, 0)?;
    let poses = poses(&intervals(&pairs), POSES_APART_RAD);
    let aims = vec![Aim { what: POSES, found: poses.len(), needed: POSES_SCALE, best: POSES_FULL }];
    Ok(Progress { aims, ..still(&pairs, &poses) })
}

/// How far they are from what [`gyroscope`] asks for.
pub(super) fn turns_taken(samples: &[Sample]) -> Result<Progress, CalibrationError> {
    let pairs = paired(samples, 0)?;
    let rests: Vec<Rest> = intervals(&pairs).into_iter().filter(|r| r.gyro_radps.is_some()).collect();
    let turns = if rests.is_empty() {
        0
    } else {
        let (bias, _) = still_bias(&pairs, &rests);
        turns(&pairs, &rests, &Triad::identity(), &bias).len()
    };
    let aims = vec![Aim { what: TURNS, found: turns, needed: TURNS_MIN, best: TURNS_MIN }];
    Ok(Progress { aims, ..still(&pairs, &poses(&rests, POSES_APART_RAD)) })
}

fn still(pairs: &[Pair], poses: &[Rest]) -> Progress {
    Progress {
        still: rest::share(pairs),
        up: pairs.last().and_then(|pair| pair.accel_mps2.try_normalize(1e-9)),
        poses: poses.iter().filter_map(|pose| pose.accel_mps2.try_normalize(1e-9)).collect(),
        ..Progress::default()
    }
}

fn fit_accelerometer(poses: &[Rest], gravity_mps2: f64, unknowns: usize) -> Result<Fit, CalibrationError> {
    let start = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let sizes = [0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 0.1, 0.1, 0.1];
    fit::least_squares(&start[..unknowns], &sizes[..unknowns], |x, r| {
        let triad = accel_triad(x);
        r.clear();
        r.extend(poses.iter().map(|pose| triad.apply(&pose.accel_mps2).norm() - gravity_mps2));
    })
}

const GYRO_NAMES: [(&str, &str); 9] = [
    ("matrix_xx", ""),
    ("matrix_xy", ""),
    ("matrix_xz", ""),
    ("matrix_yx", ""),
    ("matrix_yy", ""),
    ("matrix_yz", ""),
    ("matrix_zx", ""),
    ("matrix_zy", ""),
    ("matrix_zz", ""),
];
const GYRO_BIAS_NAMES: [&str; 3] = ["bias_x", "bias_y", "bias_z"];

/// The gyroscope's triad of a file.
///
/// # Errors
/// [`CalibrationError::File`] where a parameter is missing.
pub fn gyroscope_of(file: &CalibrationFile) -> Result<Triad, CalibrationError> {
    let m: Vec<f64> = GYRO_NAMES.iter().map(|(name, _)| file.value(name)).collect::<Result<_, _>>()?;
    let b: Vec<f64> = GYRO_BIAS_NAMES.iter().map(|name| file.value(name)).collect::<Result<_, _>>()?;
    Ok(Triad { matrix: Matrix3::from_row_slice(&m), offset: Vector3::from_column_slice(&b) })
}

/// A turn from one rest to the next.
struct Turn {
    from: Vector3<f64>,
    to: Vector3<f64>,
    /// (duration, mean reading less bias) of each step.
    steps: Vec<(f64, Vector3<f64>)>,
}

/// Fits the gyroscope. `accel` is the accelerometer's calibration: gravity's directions come from it; identity
/// where there is none.
///
/// # Errors
/// [`CalibrationError`]: NaN, saturation, no rest, too few turns, a parameter that stays unknown, a bad fit.
pub fn gyroscope(samples: &[Sample], accel: &Triad) -> Result<CalibrationFile, CalibrationError> {
    channel(samples, Channel::Gyroscope, "gyroscope samples", SAMPLES_MIN)?;
    let pairs = pairs(samples)?;
    let rests: Vec<Rest> = intervals(&pairs).into_iter().filter(|r| r.gyro_radps.is_some()).collect();
    if rests.len() < 2 {
        let what = "intervals at rest (a second each)";
        return Err(CalibrationError::TooFew { what, found: rests.len(), needed: TURNS_MIN + 1 });
    }
    let (bias, bias_variance) = still_bias(&pairs, &rests);
    let turns = turns(&pairs, &rests, accel, &bias);
    if turns.len() < TURNS_MIN {
        return Err(CalibrationError::TooFew { what: TURNS, found: turns.len(), needed: TURNS_MIN });
    }
    let start: Vec<f64> = Matrix3::<f64>::identity().transpose().iter().copied().collect();
    let fit = fit::least_squares(&start, &[0.1; 9], |x, r| {
        let matrix = Matrix3::from_row_slice(x);
        r.clear();
        r.extend(turns.iter().flat_map(|turn| {
            let miss = turned(turn, &matrix) - turn.to;
            [miss.x, miss.y, miss.z]
        }));
    })?;
    for (i, (name, _)) in GYRO_NAMES.iter().enumerate() {
        if fit.sigma(i) > SCALE_SIGMA_MAX {
            let (sigma, limit) = (fit.sigma(i), SCALE_SIGMA_MAX);
            return Err(CalibrationError::Undetermined { parameter: (*name).into(), sigma, limit });
        }
    }
    fit.converged()?;
    // Three components, of which the one along gravity is nearly nothing.
    let angle = fit.rms * 3.0_f64.sqrt();
    if angle > TURN_RESIDUAL_MAX {
        return Err(CalibrationError::BadFit { found: angle, limit: TURN_RESIDUAL_MAX, unit: "rad" });
    }
    let matrix = Matrix3::from_row_slice(fit.x.as_slice());
    let mut file = CalibrationFile::new(Kind::Gyroscope, turns.len(), angle, "rad").with_fit(&fit, &GYRO_NAMES);
    for (i, name) in GYRO_BIAS_NAMES.iter().enumerate() {
        file.push(name, bias[i], Some(bias_variance[i].sqrt()), "rad/s");
    }
    for row in &mut file.covariance {
        row.extend([0.0; 3]);
    }
    for i in 0..3 {
        let mut row = vec![0.0; 12];
        row[9 + i] = bias_variance[i];
        file.covariance.push(row);
    }
    file.picture.push(picture(&turns, &matrix));
    Ok(file)
}

/// Mean rate at rest, and the variance of that mean by axis.
fn still_bias(pairs: &[Pair], rests: &[Rest]) -> (Vector3<f64>, Vector3<f64>) {
    let still: Vec<Vector3<f64>> =
        rests.iter().flat_map(|r| pairs[r.first..r.end].iter().filter_map(|p| p.gyro_radps)).collect();
    let bias = still.iter().sum::<Vector3<f64>>() / still.len() as f64;
    // White noise averages out; what differs from rest to rest does not.
    let means: Vec<Vector3<f64>> = rests.iter().filter_map(|r| r.gyro_radps).collect();
    let squares = means.iter().map(|m| (m - bias).component_mul(&(m - bias))).sum::<Vector3<f64>>();
    (bias, squares / (means.len() * (means.len() - 1).max(1)) as f64)
}

/// The turns from one rest to the next that are quick and large enough.
fn turns(pairs: &[Pair], rests: &[Rest], accel: &Triad, bias: &Vector3<f64>) -> Vec<Turn> {
    let quick = |pair: &&[Rest]| pairs[pair[1].first].time_s - pairs[pair[0].end - 1].time_s <= TURN_MAX_S;
    let turn = |pair: &[Rest]| {
        let from = accel.apply(&pair[0].accel_mps2).try_normalize(1e-9)?;
        let to = accel.apply(&pair[1].accel_mps2).try_normalize(1e-9)?;
        // From within the one rest to within the other: both ends stand still.
        let between = &pairs[pair[0].end - 1..=pair[1].first];
        let steps: Vec<_> = between
            .windows(2)
            .filter_map(|w| {
                let rate = (w[0].gyro_radps? + w[1].gyro_radps?) * 0.5 - bias;
                Some((w[1].time_s - w[0].time_s, rate))
            })
            .collect();
        let turned: f64 = steps.iter().map(|(dt, rate)| dt * rate.norm()).sum();
        (turned >= TURN_MIN_RAD).then_some(Turn { from, to, steps })
    };
    rests.windows(2).filter(quick).filter_map(turn).collect()
}

/// How far gravity is off after each turn, without and with `matrix`.
fn picture(turns: &[Turn], matrix: &Matrix3<f64>) -> Plot {
    let miss = |m: &Matrix3<f64>| {
        let of = |(k, turn): (usize, &Turn)| [(k + 1) as f64, turned(turn, m).angle(&turn.to).to_degrees()];
        turns.iter().enumerate().map(of).collect::<Vec<_>>()
    };
    let (before, after) = (miss(&Matrix3::identity()), miss(matrix));
    Plot {
        title: "Gravity after a turn, against the accelerometer".into(),
        x: "turn".into(),
        y: "angle, °".into(),
        log: false,
        series: vec![Series::new("before", false, before), Series::new("after", false, after)],
    }
}

/// Gravity's direction at the end of a turn, by the gyroscope.
fn turned(turn: &Turn, matrix: &Matrix3<f64>) -> Vector3<f64> {
    let mut from_start = UnitQuaternion::identity();
    for (dt, rate) in &turn.steps {
        from_start *= UnitQuaternion::from_scaled_axis(matrix * rate * *dt);
    }
    // A direction fixed in the world turns the other way in the body.
    from_start.inverse_transform_vector(&turn.from)
}

#[cfg(test)]
mod tests;

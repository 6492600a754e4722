//! Round trips with the simulator's own error model: what distorted the readings is found again.

use super::*;
use crate::calibration::guide;
use crate::sensor::imu::{Distortion, Imu};
use crate::sensor::noise::{ScalarError, Stream};
use crate::sensor::suite::{Quality, Sheet as _};
use crate::types::GRAVITY_MPS2;

/// An IMU turned by hand from pose to pose: rest, turn, rest …
struct Bench {
    gyro: [[f64; 3]; 3],
    accel: [[f64; 3]; 3],
    poses: usize,
    range: f64,
}

impl Default for Bench {
    fn default() -> Self {
        let Distortion { gyro, accel, .. } = Distortion::default();
        Self { gyro, accel, poses: 24, range: f64::MAX }
    }
}

const DT_S: f64 = 0.01;
const REST_S: f64 = 3.0;
const TURN_S: f64 = 1.5;

/// Directions spread evenly over the sphere (golden spiral); the one after the last is the first.
fn up(pose: usize, of: usize) -> Vector3<f64> {
    let k = (pose % of) as f64 + 0.5;
    let z = 1.0 - 2.0 * k / of as f64;
    let (s, c) = (2.399_963 * k).sin_cos();
    Vector3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z)
}

impl Bench {
    /// The samples, and the biases of gyroscope and accelerometer that were drawn.
    fn samples(&self) -> (Vec<Sample>, Vector3<f64>, Vector3<f64>) {
        let unit = Imu::typical(1);
        let mut stream = Stream::new(11, "bench");
        let quality = |q: Quality| Quality { bias_walk: 0.0, range: self.range.min(q.range), ..q };
        let mut errors = |q: Quality| [0; 3].map(|_| ScalarError::new(quality(q), DT_S, &mut stream));
        let (mut gyro, mut accel) = (errors(unit.gyro), errors(unit.accel));
        let bias = |e: &[ScalarError; 3]| Vector3::new(e[0].bias(), e[1].bias(), e[2].bias());
        let (gyro_bias, accel_bias) = (bias(&gyro), bias(&accel));
        let (g, a) = (Distortion::matrix(&self.gyro), Distortion::matrix(&self.accel));
        let mut read = |errors: &mut [ScalarError; 3], truth: Vector3<f64>| {
            Vector3::from_fn(|i, _| errors[i].read(truth[i], &mut stream))
        };
        let mut attitude = UnitQuaternion::rotation_between(&up(0, self.poses), &Vector3::z()).unwrap();
        let mut samples = Vec::new();
        let mut time_s = 0.0;
        for pose in 0..self.poses {
            // Gravity's direction in the next pose, and the shortest turn to it.
            let turn = UnitQuaternion::rotation_between(&up(pose + 1, self.poses), &up(pose, self.poses)).unwrap();
            let (axis, angle) = turn.axis_angle().unwrap();
            for phase in 0..((REST_S + TURN_S) / DT_S) as usize {
                let t = phase as f64 * DT_S - REST_S;
                // The rate swells and ebbs; the reading is the rate in the middle of the step.
                let rate = if t < 0.0 {
                    Vector3::zeros()
                } else {
                    let x = t / TURN_S;
                    axis.into_inner() * (angle / TURN_S * (1.0 - (std::f64::consts::TAU * x).cos()))
                };
                samples.push(Sample {
                    time_s,
                    gyro_radps: Some(read(&mut gyro, g * rate)),
                    accel_mps2: Some(read(
                        &mut accel,
                        a * attitude.inverse_transform_vector(&(Vector3::z() * GRAVITY_MPS2)),
                    )),
                    ..Sample::default()
                });
                attitude *= UnitQuaternion::from_scaled_axis(rate * DT_S);
                time_s += DT_S;
            }
        }
        (samples, gyro_bias, accel_bias)
    }
}

/// Upper triangular, as T⁻¹ of the model: what rest can tell.
const ACCEL: [[f64; 3]; 3] = [[1.03, 0.012, -0.02], [0.0, 0.98, 0.015], [0.0, 0.0, 1.01]];
const GYRO: [[f64; 3]; 3] = [[1.02, 0.01, -0.015], [0.008, 0.97, 0.012], [-0.01, 0.006, 1.025]];
/// 24 poses of 300 samples with 0.1 m/s² of noise: 0.006 m/s² for each mean, 1e-3 for scale and angle.
const SCALE_TOLERANCE: f64 = 3e-3;

#[test]
fn accelerometer_of_the_simulator_is_recovered() {
    let (samples, _, bias) = Bench { accel: ACCEL, ..Bench::default() }.samples();
    let file = accelerometer(&samples, GRAVITY_MPS2).unwrap();
    let triad = accelerometer_of(&CalibrationFile::from_json(&file.to_value().to_string()).unwrap()).unwrap();
    let left = triad.matrix * Distortion::matrix(&ACCEL) - Matrix3::identity();
    assert!(left.amax() < SCALE_TOLERANCE, "{left}");
    assert!((triad.offset - bias).amax() < 0.03, "{} {bias}", triad.offset);
    assert!(file.samples >= 20 && file.residual.value < 0.02, "{:?}", file.residual);
    // Every error within five of its own sigmas.
    for (name, error) in [("scale_x", left[(0, 0)]), ("misalignment_yz", left[(1, 2)])] {
        let sigma = file.parameters.iter().find(|p| p.name == name).unwrap().sigma.unwrap();
        assert!(error.abs() < 5.0 * sigma, "{name}: {error} for a sigma of {sigma}");
    }
}

#[test]
fn gyroscope_of_the_simulator_is_recovered_and_aligned_with_the_accelerometer() {
    let (samples, bias, _) = Bench { accel: ACCEL, gyro: GYRO, ..Bench::default() }.samples();
    let accel = accelerometer_of(&accelerometer(&samples, GRAVITY_MPS2).unwrap()).unwrap();
    let file = gyroscope(&samples, &accel).unwrap();
    let triad = gyroscope_of(&CalibrationFile::from_json(&file.to_value().to_string()).unwrap()).unwrap();
    let left = triad.matrix * Distortion::matrix(&GYRO) - Matrix3::identity();
    assert!(left.amax() < SCALE_TOLERANCE, "{left}");
    // The mean of 7200 samples, rounded to 0.07 °/s each.
    assert!((triad.offset - bias).amax() < 5e-4, "{} {bias}", triad.offset);
    assert_eq!(file.covariance.len(), 12);
}

#[test]
fn few_poses_give_scale_and_bias_and_fewer_are_refused() {
    let (samples, ..) = Bench { accel: ACCEL, poses: 8, ..Bench::default() }.samples();
    let file = accelerometer(&samples, GRAVITY_MPS2).unwrap();
    assert_eq!(file.parameters.len(), 6);
    assert!(file.notes[0].contains("scale and bias only"), "{:?}", file.notes);
    let (samples, ..) = Bench { poses: 4, ..Bench::default() }.samples();
    let text = accelerometer(&samples, GRAVITY_MPS2).unwrap_err().to_string();
    assert!(text.contains("4 poses at rest") && text.contains("at least 7"), "{text}");
    let text = gyroscope(&samples, &Triad::identity()).unwrap_err().to_string();
    assert!(text.contains("3 turns of 30°"), "{text}");
}

#[test]
fn motion_saturation_and_nan_are_refused() {
    let (samples, ..) = Bench::default().samples();
    let moving: Vec<Sample> = samples
        .iter()
        .enumerate()
        .map(|(k, s)| {
            let shake = Vector3::repeat(3.0 * (k as f64 * 0.3).sin());
            Sample { accel_mps2: s.accel_mps2.map(|a| a + shake), ..*s }
        })
        .collect();
    assert!(accelerometer(&moving, GRAVITY_MPS2).unwrap_err().to_string().contains("0 poses at rest"));
    let (flat, ..) = Bench { range: 3.2, ..Bench::default() }.samples();
    let text = gyroscope(&flat, &Triad::identity()).map(|_| ()).unwrap_err().to_string();
    assert!(text.contains("saturated") || text.contains("needed"), "{text}");
    let mut broken = samples;
    broken[100].accel_mps2 = Some(Vector3::repeat(f64::INFINITY));
    let text = accelerometer(&broken, GRAVITY_MPS2).unwrap_err().to_string();
    assert_eq!(text, "sample 100: accelerometer x is inf, not a finite number");
}

#[test]
fn guidance_counts_what_the_fits_count() {
    let mut ready = [None; 2];
    let (samples, ..) = Bench { accel: ACCEL, poses: 12, ..Bench::default() }.samples();
    for seconds in (3..60).step_by(2) {
        let taken = &samples[..(seconds * 100).min(samples.len())];
        let of = [
            (guide::progress(Kind::Accelerometer, taken).unwrap(), accelerometer(taken, GRAVITY_MPS2).map(drop)),
            (guide::progress(Kind::Gyroscope, taken).unwrap(), gyroscope(taken, &Triad::identity()).map(drop)),
        ];
        for (ready, (progress, fitted)) in ready.iter_mut().zip(of) {
            assert_eq!(progress.is_ready(), fitted.is_ok(), "{seconds} s: {progress:?}, {fitted:?}");
            let Some(short) = progress.aims.iter().find(|aim| aim.found < aim.needed) else {
                *ready = ready.or(Some(seconds));
                continue;
            };
            // THEN the fit refuses for the very number, but for turns before there are two rests.
            let CalibrationError::TooFew { what, found, .. } = fitted.unwrap_err() else { panic!("{seconds} s") };
            assert!((what, found) == (short.what, short.found) || seconds < 7, "{seconds} s: {found} {what}");
        }
    }
    // Seven poses of 4.5 s each, the last of which has been held for a second.
    assert!(ready.iter().all(|s| s.is_some_and(|s| (28..=33).contains(&s))), "{ready:?}");
}

#[test]
fn a_pose_fills_while_it_is_held_and_empties_in_motion() {
    let (samples, ..) = Bench::default().samples();
    let share = |until_s: f64| poses_taken(&samples[..(until_s / DT_S) as usize]).unwrap().still;
    assert!(share(0.3) == 0.0 && (0.3..0.9).contains(&share(0.8)) && share(2.9) == 1.0);
    // In the midst of the turn that follows the first rest.
    assert_eq!(share(REST_S + 0.75), 0.0);
    let progress = poses_taken(&samples[..290]).unwrap();
    assert_eq!(progress.poses.len(), 1);
    assert!(progress.up.unwrap().angle(&up(0, 24)) < 0.1 && progress.poses[0].angle(&up(0, 24)) < 0.1);
}

#[test]
fn turns_that_leave_an_axis_open_are_told_as_such_however_slowly_the_fit_creeps() {
    // Held for 1.8 s each, and turned on about the axis that leads there by the shortest way: about y, y, y, then about few others.
    let ups =
        [[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 1, 0], [1, 1, 1], [0, -1, 0], [1, -1, -1], [-1, 1, -1]];
    let ups = ups.map(|up| Vector3::from(up.map(f64::from)).normalize());
    let mut stream = Stream::new(3, "turned on");
    let mut samples = Vec::new();
    let mut push = |up: &Vector3<f64>, rate: Vector3<f64>| {
        let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * stream.normal());
        samples.push(Sample {
            time_s: samples.len() as f64 * DT_S,
            gyro_radps: Some(rate + noise(0.002)),
            accel_mps2: Some(up * GRAVITY_MPS2 + noise(0.03)),
            ..Sample::default()
        });
    };
    for (k, up) in ups.iter().enumerate() {
        (0..180).for_each(|_| push(up, Vector3::zeros()));
        let Some(next) = ups.get(k + 1) else { continue };
        let (axis, angle) = (nalgebra::Unit::new_normalize(up.cross(next)), up.angle(next));
        for step in 0..80 {
            let turned = UnitQuaternion::from_axis_angle(&axis, angle * f64::from(step) / 80.0) * up;
            push(&turned, -axis.into_inner() * angle / 0.8);
        }
    }
    let open = &samples[..6 * 260 + 180];
    let progress = guide::progress(Kind::Gyroscope, open).unwrap();
    assert!(!progress.is_ready(), "{progress:?}");
    let refused = gyroscope(open, &Triad::identity()).unwrap_err();
    assert!(matches!(refused, CalibrationError::Undetermined { .. }), "{refused}");
    assert_eq!(progress.undetermined, Some(refused));
    gyroscope(&samples, &Triad::identity()).unwrap();
}

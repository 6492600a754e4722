//! Round trips, and the refusals.

use super::*;
use crate::calibration::guide;
use crate::sensor::imu::{Distortion, Imu};
use crate::sensor::noise::{ScalarError, Stream};
use crate::sensor::suite::Sheet as _;
use nalgebra::UnitQuaternion;

const FIELD: [f64; 3] = [0.0, 17.8, 13.9];
const SOFT: [[f64; 3]; 3] = [[1.06, 0.02, -0.03], [0.02, 0.95, 0.015], [-0.03, 0.015, 1.01]];
const HARD: [f64; 3] = [4.0, -7.0, 12.0];

/// A unit turned about all axes in the field of Montevideo, with the simulator's errors; `tilt` of 1 shows it the
/// whole sphere.
fn turned(tilt: f64, distortion: &Distortion) -> Vec<Sample> {
    let unit = Imu::typical(1);
    let quality = unit.mag.map(|q| crate::sensor::suite::Quality { bias_sigma: 0.0, ..q }).unwrap();
    let mut stream = Stream::new(2, "turned");
    let mut errors = [0; 3].map(|_| ScalarError::new(quality, 0.01, &mut stream));
    let soft = Distortion::matrix(&distortion.mag);
    (0..6000)
        .map(|k| {
            let t = f64::from(k) * 0.01;
            let turn = UnitQuaternion::from_euler_angles(
                tilt * 3.0 * (0.31 * t).sin(),
                tilt * 1.4 * (0.47 * t).cos(),
                0.8 * t,
            );
            let seen =
                soft * turn.inverse_transform_vector(&Vector3::from(FIELD)) + Vector3::from(distortion.hard_iron_ut);
            let mag = Vector3::from_fn(|i, _| errors[i].read(seen[i], &mut stream));
            Sample { time_s: t, mag_ut: Some(mag), ..Sample::default() }
        })
        .collect()
}

fn distorted() -> Distortion {
    Distortion { mag: SOFT, hard_iron_ut: HARD, ..Distortion::default() }
}

#[test]
fn hard_and_soft_iron_of_the_simulator_are_recovered() {
    let file = magnetometer(&turned(1.0, &distorted())).unwrap();
    let model = magnetometer_of(&CalibrationFile::from_json(&file.to_value().to_string()).unwrap()).unwrap();
    assert!((model.triad.offset - Vector3::from(HARD)).amax() < 0.2, "{}", model.triad.offset);
    // Up to the strength, which nothing fixes: W M is a multiple of a rotation, and for symmetric factors nearly 1.
    let product = model.triad.matrix * Distortion::matrix(&SOFT);
    let left = product / (product.trace() / 3.0) - Matrix3::identity();
    assert!(left.amax() < 0.01, "{left}");
    assert!(file.residual.value < 1.0 && file.picture.len() == 3);
}

#[test]
fn a_stretch_in_another_field_does_not_bend_the_fit() {
    let mut samples = turned(1.0, &distorted());
    for sample in samples.iter_mut().skip(4500) {
        sample.mag_ut = sample.mag_ut.map(|m| m + Vector3::new(0.0, 0.0, 30.0));
    }
    let file = magnetometer(&samples).unwrap();
    let model = magnetometer_of(&file).unwrap();
    assert!((model.triad.offset - Vector3::from(HARD)).amax() < 0.5, "{}", model.triad.offset);
    assert!(file.notes.iter().any(|n| n.contains("the field changed")), "{:?}", file.notes);
}

#[test]
fn an_undistorted_unit_is_left_alone() {
    let model = magnetometer_of(&magnetometer(&turned(1.0, &Distortion::default())).unwrap()).unwrap();
    assert!(model.triad.offset.amax() < 0.2, "{}", model.triad.offset);
    assert!((model.triad.matrix - Matrix3::identity()).amax() < 0.02, "{}", model.triad.matrix);
}

#[test]
fn too_little_turning_is_refused_with_the_numbers() {
    // Level, about the vertical: a circle, through which any number of spheres pass.
    let text = magnetometer(&turned(0.0, &distorted())).unwrap_err().to_string();
    assert!(text.contains("thickness of the cloud"), "{text}");
    let still = vec![turned(1.0, &distorted())[0]; 600];
    let text = magnetometer(&still).unwrap_err().to_string();
    assert!(text.contains("1 directions of the field"), "{text}");
    assert!(magnetometer(&[]).unwrap_err().to_string().contains("0 magnetometer samples"));
}

#[test]
fn guidance_fills_the_sphere_until_the_fit_takes_it() {
    let samples = turned(1.0, &distorted());
    let (mut before, mut open) = (0, 0);
    for tenths in 1..=400 {
        let taken = &samples[..tenths * 10];
        let progress = guide::progress(Kind::Magnetometer, taken).unwrap();
        let aim = |what: &str| progress.aims.iter().find(|aim| aim.what == what).copied().unwrap();
        assert_eq!(aim(SEEN).found, progress.sectors.iter().filter(|s| **s).count());
        assert!(aim(DIRECTIONS).found >= before);
        before = aim(DIRECTIONS).found;
        let fitted = magnetometer(taken);
        // Where all is there that is counted and the fit still cannot tell the hard iron, that is what is said.
        assert_eq!(progress.is_ready(), fitted.is_ok(), "{tenths}: {progress:?}, {fitted:?}");
        open += usize::from(progress.undetermined.is_some());
        assert!(progress.undetermined.is_none() || fitted.err() == progress.undetermined);
    }
    assert!(open > 0);
    let whole = directions_taken(&samples).unwrap();
    assert!(whole.is_ready() && whole.bands * 6 == whole.sectors.len());
    // Once the centre is known the field points where it does without hard iron.
    let last = samples.last().and_then(|s| s.mag_ut).unwrap() - Vector3::from(HARD);
    assert!(whole.field.unwrap().angle(&last) < 0.1);
    let flat = directions_taken(&turned(0.0, &distorted())).unwrap();
    assert!(!flat.is_ready() && flat.aims.iter().any(|aim| aim.what == THICK && aim.found < aim.needed));
    assert!(directions_taken(&[]).unwrap().field.is_none());
}

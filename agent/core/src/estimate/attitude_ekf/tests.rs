//! At rest, in motion with imperfect sensors, under disturbances, and the algebra against the plain formulas.

use super::covariance::N;
use super::*;
use crate::estimate::vqf::Vqf;
use crate::frames::from_roll_pitch_yaw;

const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -42.0);
const STEP_S: f64 = 0.004;

/// Attitude at `t`.
type Path = fn(f64) -> UnitQuaternion<f64>;

fn turning(t: f64) -> UnitQuaternion<f64> {
    from_roll_pitch_yaw(&Vector3::new(0.9 * (1.7 * t).sin(), 0.7 * (1.3 * t).cos(), 1.2 * t))
}

fn still(_: f64) -> UnitQuaternion<f64> {
    from_roll_pitch_yaw(&Vector3::new(0.2, -0.1, 0.7))
}

/// What is wrong with the sensors.
#[derive(Clone, Copy, Default)]
struct Faults {
    bias_radps: Vector3<f64>,
    gyro_matrix: Matrix3<f64>,
    lag_s: f64,
    /// Hard iron from this time on, s.
    iron: Option<(f64, Vector3<f64>)>,
    sway_mps2: f64,
}

/// Flies `path` from `from_s` to `to_s`, the magnetometer told by `field`; the errors of heading and inclination at the
/// end, rad.
fn fly<F: AttitudeFilter>(
    filter: &mut F,
    path: Path,
    (from_s, to_s): (f64, f64),
    faults: Faults,
    field: impl Fn(f64, Vector3<f64>) -> Option<Vector3<f64>>,
) -> (f64, f64) {
    let steps = ((to_s - from_s) / STEP_S).round() as usize;
    let at = |k: usize| from_s + k as f64 * STEP_S;
    for k in 0..steps {
        let t = at(k);
        let q = path(t);
        let rate = (path(t - STEP_S).inverse() * q).scaled_axis() / STEP_S;
        // ω = (I − S)(g − b).
        let gyro = (Matrix3::identity() - faults.gyro_matrix).try_inverse().unwrap() * rate + faults.bias_radps;
        let sway = faults.sway_mps2 * Vector3::new((3.0 * t).sin(), (2.3 * t).cos(), 0.5 * (4.0 * t).sin());
        let force = q.inverse() * (Vector3::new(0.0, 0.0, 9.81) + sway);
        let iron = faults.iron.filter(|(since_s, _)| t >= *since_s).map_or_else(Vector3::zeros, |(_, iron)| iron);
        let sample = path(t - faults.lag_s).inverse() * FIELD_UT + iron;
        filter.push(STEP_S, &gyro, &force, field(t, sample).as_ref());
    }
    let error = path(at(steps - 1)) * filter.world_from_body().inverse();
    (wrap_pi(2.0 * error.k.atan2(error.w)), 2.0 * error.w.hypot(error.k).min(1.0).acos())
}

fn measured(_: f64, field: Vector3<f64>) -> Option<Vector3<f64>> {
    Some(field)
}

#[test]
fn at_rest_the_bias_is_the_mean_rate_and_the_attitude_right() {
    let mut filter = AttitudeEkf::new(0.0);
    let bias_radps = Vector3::new(0.005, 0.01, -0.012);
    let (heading, inclination) =
        fly(&mut filter, still, (0.0, 30.0), Faults { bias_radps, ..Faults::default() }, measured);
    assert!(heading.abs() < 0.1 * DEGREE && inclination < 0.1 * DEGREE, "{heading} {inclination}");
    assert!((filter.gyro_bias_radps() - bias_radps).amax() < 0.01 * DEGREE, "{}", filter.gyro_bias_radps());
    assert!(filter.tilt_sigma_rad() < 1.0 * DEGREE && !filter.field_disturbed());
}

#[test]
fn declination_turns_the_heading() {
    let mut filter = AttitudeEkf::new(0.1);
    let (heading, _) = fly(&mut filter, still, (0.0, 2.0), Faults::default(), measured);
    // Magnetic north lies 0.1 rad east of north: what was thought to face north faces east of it.
    assert!((heading - 0.1).abs() < 1e-3, "{heading}");
}

#[test]
fn lag_scale_and_misalignment_are_found_in_motion() {
    let gyro_matrix = Matrix3::new(0.004, -0.002, 0.0, 0.001, -0.003, 0.002, 0.002, 0.0, 0.003);
    let faults = Faults { gyro_matrix, lag_s: 0.012, sway_mps2: 1.0, ..Faults::default() };
    let mut filter = AttitudeEkf::new(0.0);
    let (heading, inclination) = fly(&mut filter, turning, (0.0, 120.0), faults, measured);
    let mut vqf = Vqf::with_declination(0.0);
    let (heading_vqf, _) = fly(&mut vqf, turning, (0.0, 120.0), faults, measured);
    println!("heading {:.2}°, of VQF {:.2}°", heading / DEGREE, heading_vqf / DEGREE);
    assert!((filter.magnetometer_lag_s() - 0.012).abs() < 0.002, "{}", filter.magnetometer_lag_s());
    let found = filter.gyro_matrix();
    // Yaw's own scale shows in the magnetometer alone, which does not correct it.
    assert!((found - gyro_matrix).diagonal().xy().amax() < 0.0015, "{found}");
    assert!(heading.abs() < 0.5 * DEGREE && inclination < 0.5 * DEGREE, "{heading} {inclination}");
    assert!(heading.abs() < 0.5 * heading_vqf.abs(), "{heading} {heading_vqf}");
}

#[test]
fn iron_that_is_attached_in_flight_is_found() {
    let iron = Vector3::new(12.0, -8.0, 5.0);
    let faults = Faults { iron: Some((30.0, iron)), sway_mps2: 1.0, ..Faults::default() };
    let mut filter = AttitudeEkf::new(0.0);
    fly(&mut filter, turning, (0.0, 31.0), faults, measured);
    assert!(filter.field_disturbed());
    let (heading, inclination) = fly(&mut filter, turning, (31.0, 90.0), faults, measured);
    assert!((filter.hard_iron_ut() - iron).norm() < 1.0, "{}", filter.hard_iron_ut());
    assert!(!filter.field_disturbed() && heading.abs() < 1.0 * DEGREE, "{heading}");
    assert!(inclination < 0.5 * DEGREE, "{inclination}");
}

#[test]
fn a_magnet_that_stands_nearby_does_not_become_the_field() {
    let faults = Faults { sway_mps2: 1.0, ..Faults::default() };
    let magnet = |t: f64| if t > 60.0 && t < 140.0 { Vector3::new(20.0, 8.0, 12.0) } else { Vector3::zeros() };
    let near = |t: f64, field: Vector3<f64>| Some(field + turning(t).inverse() * magnet(t));
    let (mut filter, mut vqf) = (AttitudeEkf::new(0.0), Vqf::with_declination(0.0));
    let (heading, _) = fly(&mut filter, turning, (0.0, 139.0), faults, near);
    let (heading_vqf, _) = fly(&mut vqf, turning, (0.0, 139.0), faults, near);
    println!("heading {:.2}°, of VQF {:.2}°", heading / DEGREE, heading_vqf / DEGREE);
    assert!(filter.field_disturbed() && heading.abs() < 5.0 * DEGREE, "{heading}");
    assert!(heading_vqf.abs() > 20.0 * DEGREE, "{heading_vqf}: no disturbance at all");
    let (heading, _) = fly(&mut filter, turning, (139.0, 160.0), faults, near);
    assert!(!filter.field_disturbed() && heading.abs() < 1.0 * DEGREE, "{heading}");
}

#[test]
fn a_field_that_stays_another_is_followed_in_the_end() {
    let faults = Faults { sway_mps2: 1.0, ..Faults::default() };
    let turned = UnitQuaternion::from_euler_angles(0.3, 0.0, 0.6);
    let other =
        |t: f64, field: Vector3<f64>| Some(if t > 30.0 { turning(t).inverse() * (turned * FIELD_UT) } else { field });
    let mut filter = AttitudeEkf::new(0.0);
    fly(&mut filter, turning, (0.0, 45.0), faults, other);
    assert!(filter.field_disturbed());
    let (heading, _) = fly(&mut filter, turning, (45.0, 120.0), faults, other);
    assert!(heading.abs() < 2.0 * DEGREE, "{heading}");
    let (heading, _) = fly(&mut filter, turning, (120.0, 260.0), faults, other);
    assert!((heading - 0.6).abs() < 2.0 * DEGREE && !filter.field_disturbed(), "{heading}");
}

#[test]
fn upside_down_it_starts_again_and_keeps_the_calibration() {
    let bias_radps = Vector3::new(0.004, -0.006, 0.005);
    let faults = Faults { bias_radps, ..Faults::default() };
    let mut filter = AttitudeEkf::new(0.0);
    fly(&mut filter, still, (0.0, 10.0), faults, measured);
    // Turned over while nothing was sampled.
    let over: Path = |t| from_roll_pitch_yaw(&Vector3::new(3.0, 0.1, -0.4)) * still(t);
    let (_, inclination) = fly(&mut filter, over, (10.0, 10.02), faults, measured);
    assert!(inclination > 100.0 * DEGREE, "{inclination}");
    let (heading, inclination) = fly(&mut filter, over, (10.02, 13.0), faults, measured);
    assert!(heading.abs() < 1.0 * DEGREE && inclination < 0.5 * DEGREE, "{heading} {inclination}");
    assert!((filter.gyro_bias_radps() - bias_radps).amax() < 0.05 * DEGREE, "{}", filter.gyro_bias_radps());
}

#[test]
fn without_a_magnetometer_tilt_holds_and_a_late_field_is_followed_at_once() {
    for field in [None, Some(Vector3::repeat(f64::NAN))] {
        let mut filter = AttitudeEkf::new(0.0);
        let faults = Faults { sway_mps2: 1.0, ..Faults::default() };
        let (heading, inclination) = fly(&mut filter, turning, (0.0, 30.0), faults, |_, _| field);
        assert!(heading.is_finite() && inclination < 0.5 * DEGREE, "{heading} {inclination}");
        let (heading, _) = fly(&mut filter, turning, (30.0, 31.0), faults, measured);
        assert!(heading.abs() < 2.0 * DEGREE, "{heading}");
    }
}

#[test]
fn a_slow_magnetometer_does() {
    let mut filter = AttitudeEkf::new(0.0);
    let faults = Faults { sway_mps2: 1.0, lag_s: 0.01, ..Faults::default() };
    // Ten a second.
    let tenth = |t: f64, field: Vector3<f64>| ((t / STEP_S).round() as u64).is_multiple_of(25).then_some(field);
    let (heading, inclination) = fly(&mut filter, turning, (0.0, 120.0), faults, tenth);
    assert!(heading.abs() < 1.0 * DEGREE && inclination < 0.5 * DEGREE, "{heading} {inclination}");
}

#[test]
fn samples_that_are_not_finite_are_skipped_and_p_stays_positive() {
    let mut filter = AttitudeEkf::new(0.0);
    fly(&mut filter, turning, (0.0, 60.0), Faults { sway_mps2: 2.0, ..Faults::default() }, measured);
    let before = filter.state.clone();
    let (fine, bad) = (Vector3::zeros(), Vector3::new(0.0, f64::NAN, 0.0));
    filter.push(STEP_S, &bad, &fine, None);
    filter.push(STEP_S, &fine, &bad, None);
    filter.push(f64::NAN, &fine, &fine, None);
    assert_eq!(filter.state, before);
    assert_eq!(filter.p, filter.p.transpose());
    assert!(filter.p.symmetric_eigenvalues().min() > 0.0, "{}", filter.p.symmetric_eigenvalues());
}

fn some_covariance() -> Covariance {
    let a = Covariance::from_fn(|i, j| ((i * 7 + j * 3) as f64 * 1.3).sin());
    a * a.transpose() + Covariance::identity()
}

#[test]
fn propagation_is_the_dense_product() {
    let by = Propagation {
        dt_s: 0.01,
        rotation: turning(1.0).to_rotation_matrix().into_inner(),
        gamma: Vector3::new(0.3, -1.2, 0.7),
        rate: Vector3::new(0.29, -1.21, 0.71),
        force_up_mps2: 9.5,
        field_ut: Vector3::new(5.0, 19.0, -40.0),
    };
    let (gamma, force_up, h) = (by.gamma, by.force_up_mps2, by.field_ut);
    // Φ by differences of the motion itself: what an error of each state becomes within one sample.
    let transition = |x: &ErrorState| -> ErrorState {
        let s = Matrix3::from_fn(|i, j| x[ix::GYRO_MATRIX + 3 * i + j]);
        let epsilon = -by.rotation * (x.fixed_rows::<3>(ix::GYRO_BIAS) + s * gamma);
        let accel = by.rotation * x.fixed_rows::<3>(ix::ACCEL_BIAS);
        let mut dx = ErrorState::zeros();
        dx.fixed_rows_mut::<2>(ix::TILT).copy_from(&epsilon.xy());
        let leant = Vector2::new(x[ix::TILT + 1], -x[ix::TILT]) * force_up;
        let velocity = x.fixed_rows::<2>(ix::VELOCITY) / VELOCITY_LEAK_S;
        dx.fixed_rows_mut::<2>(ix::VELOCITY).copy_from(&(leant - accel.xy() - velocity));
        dx.fixed_rows_mut::<2>(ix::FIELD).copy_from(&(Vector2::new(h.y, -h.x) * epsilon.z));
        x + dx * by.dt_s
    };
    let mut phi = Covariance::zeros();
    for i in 0..N {
        phi.set_column(i, &transition(&covariance::unit(i)));
    }
    let p = some_covariance();
    let (mut got, mut noise) = (p, Covariance::zeros());
    covariance::propagate(&mut got, &by);
    covariance::propagate(&mut noise, &by);
    let expected = phi * p * phi.transpose() + noise;
    assert!((got - expected).amax() < 1e-9 * expected.amax(), "{}", (got - expected).amax());
    assert_eq!(got, got.transpose());
}

#[test]
fn considered_states_are_not_corrected() {
    let mut p = some_covariance();
    let (before, mut x) = (p, ErrorState::zeros());
    let h = ErrorState::from_fn(|i, _| (i as f64).cos());
    correct_scalar(&mut p, &mut x, &h, 2.0, 0.5, ix::GYRO_BIAS);
    assert!(x.rows(0, ix::GYRO_BIAS).iter().all(|v| *v == 0.0) && x[ix::LAG] != 0.0);
    let kept = |p: &Covariance| p.view((0, 0), (ix::GYRO_BIAS, ix::GYRO_BIAS)).into_owned();
    assert!((kept(&p) - kept(&before)).amax() < 1e-9 && p[(ix::LAG, ix::LAG)] < before[(ix::LAG, ix::LAG)]);
}

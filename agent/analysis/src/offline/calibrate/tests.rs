//! Calibrations of public recordings; skipped, and said so, where they are absent.

use super::*;
use crate::offline::tests::arguments;
use crate::offline::{EstimateArgs, run};
use crate::recordings::shared;

fn request(kind: Kind) -> Request {
    Request::new(kind, "2026-01-31T12:00:00Z")
}

#[test]
fn uiuc_gives_the_known_coefficient() {
    let Some(path) = shared("data/uiuc_propellers_static/uiuc_volume1_static.csv") else { return };
    let request = Request { propeller: Some("apcsf 10x4.7".into()), ..request(Kind::Thrust) };
    let file = from_path(&path, None, &request).unwrap();
    let k = file.value("thrust_coefficient").unwrap();
    println!("UIUC apcsf 10x4.7: k {k:.4e} N s², residual {:.1} % rms", 100.0 * file.residual.value);
    // The bound.
    assert!((k / 1.616e-5 - 1.0).abs() < 0.01, "{k}");
    assert!((file.residual.value - 0.094).abs() < 0.002);
    assert!(
        from_path(&path, None, &Request { propeller: None, ..request }).unwrap_err().to_string().contains("name one")
    );
}

/// Heading error (root mean square, degrees) of the attitude filter over the moving part of the second half of a
/// BROAD trial; calibrated on the first half, or not.
fn second_half_heading(trial: &str, calibrated: bool) -> Option<(f64, Option<CalibrationFile>)> {
    let path = shared(&format!("data/broad_imu_mocap/{trial}.csv.gz"))?;
    let folder = tempfile::tempdir().unwrap();
    let file = calibrated
        .then(|| from_path(&path, None, &Request { first_half: true, ..request(Kind::Magnetometer) }).unwrap());
    let calibration = file.iter().map(|file| {
        let path = folder.path().join("mag.json");
        write(&path, file).unwrap();
        path
    });
    let mut args = arguments(&path, "attitude", folder.path());
    args.calibration = calibration.collect();
    let score = run(&args).unwrap();
    println!("{}", score.to_json());
    Some((heading_after(&args, &path), file))
}

/// Scored as `evaluate` does: truth of the rows that move, from half the recording on.
fn heading_after(args: &EstimateArgs, recording: &Path) -> f64 {
    let mut reader = csv::Reader::from_path(&args.output).unwrap();
    let rows: Vec<Vec<f64>> =
        reader.records().map(|r| r.unwrap().iter().map(|v| v.parse().unwrap()).collect()).collect();
    let mut recording = recordings::open(recording).unwrap();
    let half = 0.5 * (recording.info().span.0.as_seconds() + recording.info().span.1.as_seconds());
    let (mut sum, mut count, mut row) = (0.0, 0.0, 0);
    while let Some(tick) = recording.next_tick() {
        let found = &rows[row];
        row += 1;
        let Some(truth) = tick.truth.filter(|t| t.time.as_seconds() > half) else { continue };
        let q = nalgebra::Quaternion::new(found[7], found[8], found[9], found[10]);
        let e = truth.world_from_body * nalgebra::UnitQuaternion::from_quaternion(q).inverse();
        let heading = plumbline_core::frames::wrap_pi(2.0 * e.k.atan2(e.w)).to_degrees();
        sum += heading * heading;
        count += 1.0;
    }
    f64::sqrt(sum / count)
}

#[test]
fn broad_magnet_trial_heading_after_calibration() {
    let trial = "34_disturbed_attached_magnet_3cm";
    let Some((raw, _)) = second_half_heading(trial, false) else { return };
    let (calibrated, file) = second_half_heading(trial, true).unwrap();
    let file = file.unwrap();
    println!("BROAD 34: heading {raw:.2}° raw, {calibrated:.2}° calibrated; {}", file.summary());
    // The bound; a sphere fit with VQF reaches 2.33.
    assert!(calibrated <= 2.3, "{calibrated}");
}

#[test]
fn broad_calibrated_on_itself_is_no_worse() {
    for trial in [
        "02_undisturbed_slow_rotation_B",
        "06_undisturbed_fast_rotation_A",
        "33_disturbed_attached_magnet_2cm",
        "28_disturbed_stationary_magnet_A",
    ] {
        let Some((raw, _)) = second_half_heading(trial, false) else { return };
        let (calibrated, file) = second_half_heading(trial, true).unwrap();
        println!("BROAD {trial}: heading {raw:.2}° raw, {calibrated:.2}° calibrated; {}", file.unwrap().summary());
        // A calibration may move a good heading by a degree, not spoil it.
        assert!(calibrated <= raw + 1.0, "{trial}: {raw} {calibrated}");
    }
}

#[test]
fn broad_translation_does_not_turn_enough_for_a_magnetometer() {
    let Some(path) = shared("data/broad_imu_mocap/15_undisturbed_fast_translation_A.csv.gz") else { return };
    let error = from_path(&path, None, &Request { first_half: true, ..request(Kind::Magnetometer) }).unwrap_err();
    println!("{error}");
    assert!(matches!(error, CalibrateError::Refused { kind: "magnetometer", .. }), "{error}");
}

#[test]
fn arguments_and_files_that_do_not_fit_are_named() {
    let text = |t: &str, r: &Request| from_table(t.as_bytes(), "t.csv", r).unwrap_err().to_string();
    let imu = "t_s,gx_radps,gy_radps,gz_radps\n0,0,0,0\n1,0,0,0\n";
    assert_eq!(
        text(imu, &request(Kind::Magnetometer)),
        "magnetometer calibration refused: 0 magnetometer samples, at least 60 are needed"
    );
    assert!(text(imu, &Request { from_s: Some(5.0), to_s: Some(2.0), ..request(Kind::Allan) }).contains("--from 5"));
    assert!(text(imu, &request(Kind::MotorCurve)).contains("t.csv: no column command"));
    assert_eq!(text(imu, &request(Kind::Delays)), "--kind delays: is fitted from a recorded flight only");
    let error = from_path(Path::new("absent.csv"), None, &request(Kind::Mass)).unwrap_err().to_string();
    assert!(error.contains("absent.csv"), "{error}");
    let error = from_path(Path::new("absent.csv"), Some("xml"), &request(Kind::Mass)).unwrap_err().to_string();
    assert!(error.contains("--format xml: not one of plumbline"), "{error}");
    assert_eq!(iso_8601(WallTime(951_782_400_000_000)), "2000-02-29T00:00:00Z");
}

#[test]
fn files_are_read_back_and_put_together() {
    let folder = tempfile::tempdir().unwrap();
    let motor =
        from_table("command,rpm\n0.2,2000\n0.5,4000\n0.9,6500\n".as_bytes(), "m.csv", &request(Kind::MotorCurve));
    let path = folder.path().join("motor.json");
    write(&path, &motor.unwrap()).unwrap();
    let mut airframe = plumbline_core::model::airframe::Airframe::iris();
    load(std::slice::from_ref(&path)).unwrap().apply_to_airframe(&mut airframe);
    assert!((airframe.motor_curve.full_speed_radps() - 745.0).abs() < 10.0, "{:?}", airframe.motor_curve);
    std::fs::write(&path, "{}").unwrap();
    let error = load(&[path]).unwrap_err().to_string();
    assert!(error.contains("motor.json") && error.contains("schema"), "{error}");
}

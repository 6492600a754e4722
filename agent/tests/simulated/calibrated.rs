//! A calibration in front of the simulator.

use plumbline_agent::calibration::Calibration;
use plumbline_agent::calibration::{CalibrationFile, Kind};
use plumbline_agent::sensor::imu::Distortion;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::vehicle::Vehicle as _;
use plumbline_agent::vehicle::calibrated::CalibratedVehicle;

/// A file with these parameters.
fn file(kind: Kind, parameters: &[(&str, f64)]) -> CalibrationFile {
    let mut file = CalibrationFile::new(kind, 1, 0.5, "");
    file.sensor = Some(1);
    parameters.iter().for_each(|(name, value)| file.push(name, *value, None, ""));
    file
}

#[test]
fn a_distorted_simulator_reads_as_a_true_one_once_calibrated() {
    let mut scenario = Scenario::bare();
    let plain = scenario.clone();
    let imu = scenario.suite.imus.first_mut().unwrap();
    imu.distortion = Distortion {
        accel: [[1.1, 0.0, 0.0], [0.0, 0.95, 0.0], [0.0, 0.0, 1.04]],
        hard_iron_ut: [5.0, -9.0, 20.0],
        ..Distortion::default()
    };
    let field_ut = scenario.site.magnetic_field_enu_ut.norm();
    let mut calibration = Calibration::default();
    let scale = [("scale_x", 1.0 / 1.1), ("scale_y", 1.0 / 0.95), ("scale_z", 1.0 / 1.04)];
    let none = [("bias_x", 0.0), ("bias_y", 0.0), ("bias_z", 0.0)];
    calibration.add(&file(Kind::Accelerometer, &[scale, none].concat())).unwrap();
    let hard = [("hard_x", 5.0), ("hard_y", -9.0), ("hard_z", 20.0), ("field", field_ut)];
    let soft = ["soft_xx", "soft_yy", "soft_xy", "soft_xz", "soft_yz"].map(|name| (name, 0.0));
    calibration.add(&file(Kind::Magnetometer, &[&hard[..], &soft[..]].concat())).unwrap();

    let sim = |scenario: &Scenario| Box::new(SimVehicle::new(scenario).unwrap());
    let mut calibrated = CalibratedVehicle::new(sim(&scenario), calibration);
    let (mut raw, mut truth) = (sim(&scenario), sim(&plain));
    // The same noise in all; a bias of 0.05 m/s² is scaled by a few per cent, and rounding is to 0.04 m/s².
    const NEAR_MPS2: f64 = 0.1;
    let mut seen = 0;
    for _ in 0..400 {
        let [calibrated, raw, truth] =
            [calibrated.sense(), raw.sense(), truth.sense()].map(|frame| frame.unwrap().imus[0]);
        let (Some(calibrated), Some(raw), Some(truth)) = (calibrated, raw, truth) else { continue };
        assert!((calibrated.accel_mps2 - truth.accel_mps2).amax() < NEAR_MPS2);
        assert!((raw.accel_mps2 - truth.accel_mps2).amax() > 0.2);
        assert_eq!(calibrated.gyro_radps, truth.gyro_radps);
        if let (Some(a), Some(b)) = (calibrated.mag_ut, truth.mag_ut) {
            // One step of the reading, and what the monitor has learnt of the unit's own half a microtesla.
            assert!((a - b).amax() < 1.5, "{a} {b}");
            seen += 1;
        }
    }
    assert!(seen > 100, "{seen}");
    assert!(calibrated.fields().all(|field| field.imu == 1 && field.fits));

    // A magnet comes near: the calibration no longer fits, and says so.
    let near = scenario.suite.imus.first_mut().unwrap();
    near.distortion.hard_iron_ut[2] += 2.0 * field_ut;
    let mut other = CalibratedVehicle::new(sim(&scenario), calibration);
    assert!(other.fields().all(|field| field.fits), "fits until seen");
    (0..400).for_each(|_| {
        other.sense().unwrap();
    });
    let fields: Vec<_> = other.fields().collect();
    assert!(fields.len() == 1 && !fields[0].fits && fields[0].withheld > 50, "{fields:?}");
}

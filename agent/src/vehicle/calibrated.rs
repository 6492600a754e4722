//! A vehicle whose readings pass through its calibration before anybody sees them.
//!
//! The same for simulator, recordings and hardware. A recording of our own was calibrated when it was flown: give
//! it a calibration only if it was flown without one.

use arrayvec::ArrayVec;

use super::{MAX_IMUS, MotorCommand, SensorFrame, Truth, Vehicle, VehicleError};
use crate::calibration::Calibration;
use crate::calibration::applied::FieldReport;
use crate::recordings::RecordedControl;

/// `inner`, calibrated.
pub struct CalibratedVehicle {
    inner: Box<dyn Vehicle>,
    sensed: Calibration,
    /// Received samples differ from sensed ones under attack: their magnetometers are watched on their own.
    received: Calibration,
    reception: Option<SensorFrame>,
}

impl CalibratedVehicle {
    /// Calibrates everything `inner` senses.
    pub fn new(inner: Box<dyn Vehicle>, calibration: Calibration) -> Self {
        Self { inner, sensed: calibration, received: calibration, reception: None }
    }
}

impl Vehicle for CalibratedVehicle {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        let mut frame = self.inner.sense()?;
        self.sensed.apply(&mut frame);
        self.reception = self.inner.recorded_reception();
        if let Some(received) = &mut self.reception {
            self.received.apply(received);
        }
        Ok(frame)
    }

    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        self.inner.actuate(command)
    }

    fn truth(&self) -> Option<Truth> {
        self.inner.truth()
    }

    fn progress(&self) -> Option<f64> {
        self.inner.progress()
    }

    fn recorded_reception(&self) -> Option<SensorFrame> {
        self.reception
    }

    fn recorded_control(&self) -> Option<RecordedControl> {
        self.inner.recorded_control()
    }

    fn fields(&self) -> ArrayVec<FieldReport, MAX_IMUS> {
        self.sensed.fields().take(MAX_IMUS).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{CalibrationFile, Kind};
    use crate::vehicle::sim::{Scenario, SimVehicle};
    use crate::vehicle::suite::Distortion;

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
        assert!(calibrated.fields().iter().all(|field| field.imu == 1 && field.fits));

        // A magnet comes near: the calibration no longer fits, and says so.
        let near = scenario.suite.imus.first_mut().unwrap();
        near.distortion.hard_iron_ut[2] += 2.0 * field_ut;
        let mut other = CalibratedVehicle::new(sim(&scenario), calibration);
        assert!(other.fields().iter().all(|field| field.fits), "innocent until seen");
        (0..400).for_each(|_| {
            other.sense().unwrap();
        });
        let fields = other.fields();
        assert!(fields.len() == 1 && !fields[0].fits && fields[0].withheld > 50, "{fields:?}");
    }
}

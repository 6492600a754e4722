//! A vehicle whose readings pass through its calibration before anybody sees them.
//!
//! The same for simulator, recordings and hardware. A recording of our own was calibrated when it was flown: give
//! it a calibration only if it was flown without one.

use std::sync::Arc;

use arrayvec::ArrayVec;

use super::{MotorStop, RecordedControl, Service, Truth, Vehicle, VehicleError};
use crate::calibration::Calibration;
use crate::calibration::applied::FieldReport;
use crate::sensor::{MAX_IMUS, SensorFrame};
use crate::types::MotorCommand;

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

    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        self.inner.motor_stop()
    }

    fn pass_over(&mut self, gap_s: f64) -> f64 {
        self.inner.pass_over(gap_s)
    }

    fn truth(&self) -> Option<Truth> {
        self.inner.truth()
    }

    fn serve(&mut self, service: Service) -> bool {
        self.inner.serve(service)
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

//! A vehicle whose readings pass through its calibration before anybody sees them.
//!
//! The same for simulator, recordings and hardware. A recording of our own was calibrated when it was flown: give
//! it a calibration only if it was flown without one.

use super::{Vehicle, VehicleError};
use crate::calibration::applied::{Correction, FieldReport, UseError};
use crate::calibration::{Calibration, Kind};
use crate::sensor::SensorFrame;

/// A vehicle and its calibration.
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
        Self { inner, sensed: calibration.clone(), received: calibration, reception: None }
    }

    /// The vehicle itself, for all but its readings.
    pub fn inner(&self) -> &dyn Vehicle {
        self.inner.as_ref()
    }

    /// The vehicle itself, to be commanded.
    pub fn inner_mut(&mut self) -> &mut dyn Vehicle {
        self.inner.as_mut()
    }

    /// The next frame, as [`Vehicle::sense`], calibrated.
    ///
    /// # Errors
    /// As the vehicle's.
    pub fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        let mut frame = self.inner.sense()?;
        self.sensed.apply(&mut frame);
        self.reception = self.inner.recorded().and_then(|recording| recording.reception());
        if let Some(received) = &mut self.reception {
            self.received.apply(received);
        }
        Ok(frame)
    }

    /// What the estimators received of the frame last sensed, calibrated, where a recording says that it differs.
    pub fn reception(&self) -> Option<&SensorFrame> {
        self.reception.as_ref()
    }

    /// What is in use.
    pub fn calibration(&self) -> &Calibration {
        &self.sensed
    }

    /// Corrects by `correction` from the next frame on.
    ///
    /// # Errors
    /// As [`Calibration::put`].
    pub fn put(&mut self, correction: &Correction) -> Result<(), UseError> {
        self.sensed.put(correction)?;
        self.received.put(correction)
    }

    /// Stops using the calibration of `kind` on IMU `imu`, from 1.
    ///
    /// # Errors
    /// As [`Calibration::take`].
    pub fn take(&mut self, kind: Kind, imu: u8) -> Result<(), UseError> {
        self.sensed.take(kind, imu)?;
        self.received.take(kind, imu)
    }

    /// How its calibrated magnetometers fare.
    pub fn fields(&self) -> impl Iterator<Item = FieldReport> + '_ {
        self.sensed.fields()
    }
}

impl<V: Vehicle + 'static> From<Box<V>> for CalibratedVehicle {
    /// Without a calibration: readings pass as they are.
    fn from(vehicle: Box<V>) -> Self {
        Self::new(vehicle, Calibration::default())
    }
}

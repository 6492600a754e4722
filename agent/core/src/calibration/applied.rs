//! Calibration files put to use: every frame that is sensed passes through here.

use nalgebra::Vector3;

use super::CalibrationError;
use super::field_monitor::FieldMonitor;
use super::file::{CalibrationFile, Kind};
use super::inertial::{Triad, accelerometer_of, gyroscope_of};
use super::magnetometer::magnetometer_of;
use super::motor_curve::motor_curve_of;
use super::thermal::{Drift, thermal_of};
use crate::model::airframe::Airframe;
use crate::model::motor_curve::MotorCurve;
use crate::sensor::{MAX_IMUS, SensorFrame};

/// Of one IMU.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct OfImu {
    accel: Option<Triad>,
    gyro: Option<Triad>,
    drift: Option<Drift>,
    field: Option<FieldMonitor>,
}

/// What the files say about the vehicle itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct OfAirframe {
    thrust_coefficient_ns2: Option<f64>,
    drag_torque_coefficient_nms2: Option<f64>,
    motor_curve: Option<MotorCurve>,
    mass_kg: Option<f64>,
    inertia_kgm2: Option<Vector3<f64>>,
}

/// Everything that is calibrated. Applied to a frame it allocates nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Calibration {
    imus: [OfImu; MAX_IMUS],
    airframe: OfAirframe,
}

/// How a magnetometer's calibration fared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldReport {
    /// Which IMU, from 1.
    pub imu: usize,
    /// Does it fit now?
    pub fits: bool,
    /// How often it stopped fitting.
    pub refits: u32,
    /// Samples withheld while it did not.
    pub withheld: u64,
    /// Of so many.
    pub samples: u64,
    /// Hard iron found since it was made, µT.
    pub hard_iron_since_ut: Vector3<f64>,
}

impl Calibration {
    /// Adds a file to what is known; a later file of a kind and sensor replaces an earlier one.
    ///
    /// # Errors
    /// [`CalibrationError::File`]: a parameter is missing, or the sensor is none.
    pub fn add(&mut self, file: &CalibrationFile) -> Result<(), CalibrationError> {
        let number = usize::from(file.sensor.unwrap_or(1));
        let imu = number.checked_sub(1).and_then(|index| self.imus.get_mut(index));
        let Some(imu) = imu else {
            return Err(CalibrationError::File(format!("sensor {number} is not 1 to {MAX_IMUS}")));
        };
        match file.kind {
            Kind::Accelerometer => imu.accel = Some(accelerometer_of(file)?),
            Kind::Gyroscope => imu.gyro = Some(gyroscope_of(file)?),
            Kind::Magnetometer => imu.field = Some(FieldMonitor::new(magnetometer_of(file)?)),
            Kind::Thermal => imu.drift = Some(thermal_of(file)?),
            Kind::MotorCurve => self.airframe.motor_curve = Some(motor_curve_of(file)?),
            Kind::Thrust => {
                self.airframe.thrust_coefficient_ns2 = Some(file.value("thrust_coefficient")?);
                self.airframe.drag_torque_coefficient_nms2 = file.value("drag_torque_coefficient").ok();
            }
            Kind::Mass => {
                self.airframe.mass_kg = Some(file.value("mass")?);
                let inertia = [file.value("inertia_x")?, file.value("inertia_y")?, file.value("inertia_z")?];
                self.airframe.inertia_kgm2 = Some(Vector3::from(inertia));
            }
            // Describes noise; it moves no reading.
            Kind::Allan => {}
        }
        Ok(())
    }

    /// Raw to calibrated. A magnetic field whose calibration no longer fits is withheld.
    pub fn apply(&mut self, frame: &mut SensorFrame) {
        for (imu, slot) in self.imus.iter_mut().zip(&mut frame.imus) {
            let Some(sample) = slot else { continue };
            if let Some(drift) = imu.drift.filter(|_| sample.temperature_c.is_finite()) {
                let (gyro, accel) = drift.at(sample.temperature_c);
                sample.gyro_radps -= gyro;
                sample.accel_mps2 -= accel;
            }
            if let Some(gyro) = imu.gyro {
                sample.gyro_radps = gyro.apply(&sample.gyro_radps);
            }
            if let Some(accel) = imu.accel {
                sample.accel_mps2 = accel.apply(&sample.accel_mps2);
            }
            if let (Some(monitor), Some(field)) = (&mut imu.field, sample.mag_ut) {
                sample.mag_ut = monitor.apply(sample.time.as_seconds(), &field);
            }
        }
    }

    /// Puts what is known of the vehicle into `airframe`.
    pub fn apply_to_airframe(&self, airframe: &mut Airframe) {
        let known = &self.airframe;
        let put = |into: &mut f64, value: Option<f64>| *into = value.unwrap_or(*into);
        put(&mut airframe.thrust_coefficient_ns2, known.thrust_coefficient_ns2);
        put(&mut airframe.drag_torque_coefficient_nms2, known.drag_torque_coefficient_nms2);
        put(&mut airframe.mass_kg, known.mass_kg);
        airframe.inertia_kgm2 = known.inertia_kgm2.unwrap_or(airframe.inertia_kgm2);
        airframe.motor_curve = known.motor_curve.unwrap_or(airframe.motor_curve);
    }

    /// How each calibrated magnetometer fared so far.
    pub fn fields(&self) -> impl Iterator<Item = FieldReport> + '_ {
        self.imus.iter().enumerate().filter_map(|(index, imu)| {
            let monitor = imu.field?;
            let (withheld, samples) = monitor.withheld();
            Some(FieldReport {
                imu: index + 1,
                fits: monitor.fits(),
                refits: monitor.refits(),
                withheld,
                samples,
                hard_iron_since_ut: monitor.hard_iron_since_ut(),
            })
        })
    }
}

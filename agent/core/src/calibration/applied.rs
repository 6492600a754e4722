//! Calibration files put to use: every frame that is sensed passes through here.

use arrayvec::{ArrayString, ArrayVec};
use nalgebra::{Matrix3, Vector3};

use super::CalibrationError;
use super::field_monitor::FieldMonitor;
use super::file::{CalibrationFile, Kind};
use super::inertial::{Triad, accelerometer_of, gyroscope_of};
use super::magnetometer::{FieldModel, magnetometer_of};
use super::motor_curve::motor_curve_of;
use super::thermal::{Drift, thermal_of};
use crate::event::{Text, text};
use crate::model::airframe::Airframe;
use crate::model::motor_curve::MotorCurve;
use crate::sensor::{MAX_IMUS, SensorFrame};

/// Kinds that correct the samples of an IMU.
const OF_AN_IMU: usize = 4;
/// Kinds that tell of the vehicle itself.
const OF_THE_AIRFRAME: usize = 3;
/// Most calibrations in use.
const MAX_USED: usize = OF_AN_IMU * MAX_IMUS + OF_THE_AIRFRAME;
/// A scale or an axis that is off by more is a wrong file, or a wrong unit.
const MATRIX_OFF_MAX: f64 = 0.5;
/// So is a larger bias of an accelerometer, m/s², or of a gyroscope, rad/s.
const ACCEL_OFFSET_MAX_MPS2: f64 = 5.0;
const GYRO_OFFSET_MAX_RADPS: f64 = 1.0;

/// A calibration in use, as people tell it from others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Used {
    /// What it corrects.
    pub kind: Kind,
    /// Which IMU, from 1; 0 where it is of the vehicle itself.
    pub imu: u8,
    /// When it was fitted, ISO 8601.
    pub date: ArrayString<32>,
    /// What it was fitted to.
    pub input: Text,
    /// Is it in the agent's configuration? Else it came by a command.
    pub configured: bool,
}

impl Used {
    fn of(file: &CalibrationFile, imu: u8) -> Self {
        let mut date = ArrayString::new();
        // What is longer is no date.
        let _ = file.date.chars().try_for_each(|letter| date.try_push(letter));
        Self { kind: file.kind, imu, date, input: text(format_args!("{}", file.input)), configured: true }
    }

    fn is(&self, kind: Kind, imu: u8) -> bool {
        (self.kind, self.imu) == (kind, imu)
    }
}

/// Why what is in use does not change.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum UseError {
    /// One of its kind is in use on that IMU.
    #[error("IMU {imu}: the {} calibration of {date} is in use: stop using that first", .kind.name())]
    Taken {
        /// Of what kind.
        kind: Kind,
        /// On which IMU, from 1.
        imu: u8,
        /// When that one was fitted.
        date: ArrayString<32>,
    },
    /// None is.
    #[error("IMU {imu}: no {} calibration is in use", .kind.name())]
    Nothing {
        /// Of what kind.
        kind: Kind,
        /// On which IMU, from 1.
        imu: u8,
    },
    /// It was not put to use by a command.
    #[error("IMU {imu}: its {} calibration is in the agent's configuration: take it out there", .kind.name())]
    Configured {
        /// Of what kind.
        kind: Kind,
        /// On which IMU, from 1.
        imu: u8,
    },
}

/// What one file does to the samples of one IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    used: Used,
    how: How,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum How {
    Accel(Triad),
    Gyro(Triad),
    Drift(Drift),
    Field(FieldModel),
}

impl Correction {
    /// The correction that `file` tells of.
    ///
    /// # Errors
    /// [`CalibrationError::File`]: a kind that corrects no samples, an IMU that is none, a parameter that is missing;
    /// [`CalibrationError::Value`]: more of it than any sensor needs.
    pub fn of(file: &CalibrationFile) -> Result<Self, CalibrationError> {
        let imu = file.sensor.unwrap_or(1);
        if !(1..=MAX_IMUS).contains(&usize::from(imu)) {
            return Err(CalibrationError::File(format!("sensor {imu} is not 1 to {MAX_IMUS}")));
        }
        let how = match file.kind {
            Kind::Accelerometer => {
                let triad = accelerometer_of(file)?;
                plausible(&triad, ACCEL_OFFSET_MAX_MPS2, "at most 5 m/s²")?;
                How::Accel(triad)
            }
            Kind::Gyroscope => {
                let triad = gyroscope_of(file)?;
                plausible(&triad, GYRO_OFFSET_MAX_RADPS, "at most 1 rad/s")?;
                How::Gyro(triad)
            }
            Kind::Magnetometer => {
                let model = magnetometer_of(file)?;
                // Hard iron of any size is lived with.
                plausible(&model.triad, f64::MAX, "finite")?;
                How::Field(model)
            }
            Kind::Thermal => How::Drift(thermal_of(file)?),
            Kind::MotorCurve | Kind::Thrust | Kind::Mass | Kind::Allan | Kind::Delays => {
                let name = file.kind.name();
                return Err(CalibrationError::File(format!("{name}: corrects no samples of an IMU")));
            }
        };
        Ok(Self { used: Used::of(file, imu), how })
    }

    /// Its kind, and which IMU it corrects, from 1.
    pub fn of_what(&self) -> (Kind, u8) {
        (self.used.kind, self.used.imu)
    }
}

fn plausible(triad: &Triad, offset_max: f64, offset_expected: &'static str) -> Result<(), CalibrationError> {
    let off = (triad.matrix - Matrix3::identity()).amax();
    let offset = triad.offset.amax();
    let refuse = |what: &str, value, expected| Err(CalibrationError::Value { what: what.to_owned(), value, expected });
    if off.is_nan() || off > MATRIX_OFF_MAX {
        return refuse("scale or axis off by", off, "at most 0.5");
    }
    if offset.is_nan() || offset > offset_max {
        return refuse("bias", offset, offset_expected);
    }
    Ok(())
}

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

/// Everything that is calibrated. Applied to a frame it allocates nothing, and neither does a change of what is in use.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Calibration {
    imus: [OfImu; MAX_IMUS],
    airframe: OfAirframe,
    used: ArrayVec<Used, MAX_USED>,
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
    /// As [`Correction::of`].
    pub fn add(&mut self, file: &CalibrationFile) -> Result<(), CalibrationError> {
        match file.kind {
            Kind::Accelerometer | Kind::Gyroscope | Kind::Magnetometer | Kind::Thermal => {
                self.set(&Correction::of(file)?);
                return Ok(());
            }
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
            // Noise and delays are told; they move no reading.
            Kind::Allan | Kind::Delays => return Ok(()),
        }
        self.note(Used::of(file, 0));
        Ok(())
    }

    /// Puts `correction` to use, as a command asks for it.
    ///
    /// # Errors
    /// [`UseError::Taken`].
    pub fn put(&mut self, correction: &Correction) -> Result<(), UseError> {
        let Used { kind, imu, .. } = correction.used;
        if let Some(before) = self.used.iter().find(|used| used.is(kind, imu)) {
            return Err(UseError::Taken { kind, imu, date: before.date });
        }
        self.set(&Correction { used: Used { configured: false, ..correction.used }, ..*correction });
        Ok(())
    }

    /// Stops using the calibration of `kind` on IMU `imu`, from 1.
    ///
    /// # Errors
    /// [`UseError::Nothing`], [`UseError::Configured`].
    pub fn take(&mut self, kind: Kind, imu: u8) -> Result<(), UseError> {
        let place = self.used.iter().position(|used| used.is(kind, imu));
        let of = usize::from(imu).checked_sub(1).and_then(|index| self.imus.get_mut(index));
        let (Some(place), Some(of)) = (place, of) else { return Err(UseError::Nothing { kind, imu }) };
        if self.used.get(place).is_some_and(|used| used.configured) {
            return Err(UseError::Configured { kind, imu });
        }
        match kind {
            Kind::Accelerometer => of.accel = None,
            Kind::Gyroscope => of.gyro = None,
            Kind::Magnetometer => of.field = None,
            Kind::Thermal => of.drift = None,
            Kind::MotorCurve | Kind::Thrust | Kind::Mass | Kind::Allan | Kind::Delays => {}
        }
        self.used.remove(place);
        Ok(())
    }

    /// What is in use.
    pub fn used(&self) -> &[Used] {
        &self.used
    }

    fn set(&mut self, correction: &Correction) {
        let Correction { used, how } = correction;
        let Some(imu) = usize::from(used.imu).checked_sub(1).and_then(|index| self.imus.get_mut(index)) else { return };
        match how {
            How::Accel(triad) => imu.accel = Some(*triad),
            How::Gyro(triad) => imu.gyro = Some(*triad),
            How::Drift(drift) => imu.drift = Some(*drift),
            How::Field(model) => imu.field = Some(FieldMonitor::new(*model)),
        }
        self.note(*used);
    }

    /// There is room for one of each kind on each IMU.
    fn note(&mut self, used: Used) {
        self.used.retain(|before| !before.is(used.kind, used.imu));
        let _ = self.used.try_push(used);
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

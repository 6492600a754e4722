//! What devices measure, in SI units and in their own axes: mounting and place are removed by the vehicle.

use nalgebra::{UnitQuaternion, Vector3};

/// One measurement of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// Rate, force, field.
    Imu(ImuReading),
    /// Pressure and temperature.
    Barometer(BarometerReading),
    /// Distance to what lies below.
    Range(RangeReading),
    /// Position and velocity.
    Fix(FixReading),
    /// Position and attitude.
    Pose(PoseReading),
    /// Voltage of the battery, V.
    Battery(f64),
}

/// Of an IMU, in its own axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuReading {
    /// Angular rate, rad/s.
    pub gyro_radps: Vector3<f64>,
    /// Specific force, m/s².
    pub accel_mps2: Vector3<f64>,
    /// Magnetic field, µT.
    pub mag_ut: Option<Vector3<f64>>,
    /// °C.
    pub temperature_c: f64,
}

/// Of a barometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BarometerReading {
    /// Pa.
    pub pressure_pa: f64,
    /// °C.
    pub temperature_c: f64,
}

/// Of something that looks down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeReading {
    /// Along the beam, or from the scanner to the line fitted to the floor, m.
    pub distance_m: f64,
    /// A scanner turns in its own y-z plane and finds the vertical there: only tilt out of that plane is left.
    pub scanned: bool,
    /// One-sigma as the device or the fit says, m.
    pub sigma_m: f64,
}

/// Of a GNSS receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixReading {
    /// Latitude, longitude (deg), altitude above mean sea level (m).
    pub geodetic: [f64; 3],
    /// Velocity ENU, m/s; NaN up where the receiver does not say.
    pub velocity_enu_mps: Vector3<f64>,
    /// One-sigma, m; NaN where the receiver does not say.
    pub horizontal_sigma_m: f64,
    /// One-sigma, m; NaN where the receiver does not say.
    pub vertical_sigma_m: f64,
    /// Satellites used.
    pub satellites: u32,
}

/// Of motion capture, in the axes of its own world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseReading {
    /// m.
    pub position_m: Vector3<f64>,
    /// World from body.
    pub attitude: UnitQuaternion<f64>,
}

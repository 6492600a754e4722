//! What an attack does to one sample, seen as a short list of scalars.
//!
//! Every sensor's sample is viewed as up to nine scalars; an attack alters those its channel covers.
//! Additive kinds (bias, ramp, noise) need one unit, so on `All` they cover the sensor's first
//! quantity only (position of a GNSS fix, pressure of a barometer); on an IMU, whose quantities are
//! equals, they must name one.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::{time::FlightTime, v1::SensorKind};

use crate::vehicle::{BarometerSample, CameraRangesSample, GnssSample, HeightSample, ImuSample, MocapPoseSample};

/// Most scalars of one sample.
pub(super) const SCALARS: usize = 9;

/// What is done to the covered scalars.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// v → 0
    Zero,
    /// v → v + magnitude
    Bias,
    /// v → v + magnitude · (t − onset)
    Ramp,
    /// v → v · magnitude
    Scale,
    /// v → v + N(0, magnitude²)
    Noise,
    /// v → last value before onset
    Freeze,
    /// v → the `magnitude` seconds before onset, played again and again
    Replay,
    /// v → the value `magnitude` seconds ago
    Delay,
    /// The sample is withheld with probability `magnitude`.
    Dropout,
    /// v → −v
    SignFlip,
}

impl Kind {
    /// Adds a value in the channel's unit, so that it must cover scalars of one unit.
    pub fn is_additive(self) -> bool {
        matches!(self, Kind::Bias | Kind::Ramp | Kind::Noise)
    }
}

/// Which scalars of the sensor are covered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Every scalar; see the module documentation for additive kinds.
    All,
    /// Angular rates of an IMU.
    Gyro,
    /// Specific force of an IMU.
    Accel,
    /// Magnetic field of an IMU.
    Mag,
    /// One axis: of the position, or the n-th scalar.
    Axis(u8),
    /// One axis of the gyroscope, 0..3.
    GyroAxis(u8),
    /// One axis of the accelerometer, 0..3.
    AccelAxis(u8),
}

impl Channel {
    /// Bit mask over the scalars of `sensor` for `kind`; `None` when the sensor has no such channel.
    pub(super) fn mask(self, sensor: SensorKind, kind: Kind) -> Option<u16> {
        let imu = sensor == SensorKind::Imu;
        let (first_quantity, all): (u16, u16) = match sensor {
            SensorKind::Imu => (0, 0x1ff),
            SensorKind::Height => (0x1, 0x1),
            SensorKind::Barometer => (0x1, 0x3),
            SensorKind::Gnss => (0x7, 0x3f),
            SensorKind::MocapPose => (0x7, 0x7f),
            SensorKind::CameraRanges => (0xf, 0xf),
            SensorKind::Unspecified => return None,
        };
        let mask = match self {
            Channel::All if kind.is_additive() => first_quantity,
            Channel::All => all,
            Channel::Gyro if imu => 0x007,
            Channel::Accel if imu => 0x038,
            Channel::Mag if imu => 0x1c0,
            Channel::GyroAxis(axis @ 0..3) if imu => 1 << axis,
            Channel::AccelAxis(axis @ 0..3) if imu => 1 << (3 + axis),
            Channel::Axis(axis @ 0..3) if !imu => (1 << axis) & first_quantity,
            _ => 0,
        };
        (mask != 0).then_some(mask)
    }
}

/// A sample seen as scalars, so that every kind is written once.
pub(super) trait Scalars: Copy {
    fn time(&self) -> FlightTime;
    fn scalars(&self) -> [f64; SCALARS];
    fn with_scalars(self, values: [f64; SCALARS]) -> Self;
}

fn xyz(values: &[f64; SCALARS], from: usize) -> Vector3<f64> {
    Vector3::from_fn(|i, _| values.get(from + i).copied().unwrap_or_default())
}

fn put(values: &mut [f64; SCALARS], from: usize, v: &Vector3<f64>) {
    for (slot, value) in values.iter_mut().skip(from).zip(v.iter()) {
        *slot = *value;
    }
}

impl Scalars for ImuSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        put(&mut values, 0, &self.gyro_radps);
        put(&mut values, 3, &self.accel_mps2);
        put(&mut values, 6, &self.mag_ut.unwrap_or_default());
        values
    }
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        self.gyro_radps = xyz(&values, 0);
        self.accel_mps2 = xyz(&values, 3);
        // A sample without a magnetometer reading stays without one.
        self.mag_ut = self.mag_ut.map(|_| xyz(&values, 6));
        self
    }
}

impl Scalars for HeightSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        values[0] = self.height_m;
        values
    }
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        self.height_m = values[0];
        self
    }
}

impl Scalars for BarometerSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        values[0] = self.pressure_pa;
        values[1] = self.temperature_c;
        values
    }
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        self.pressure_pa = values[0];
        self.temperature_c = values[1];
        self
    }
}

impl Scalars for GnssSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        put(&mut values, 0, &self.position_enu_m);
        put(&mut values, 3, &self.velocity_enu_mps);
        values
    }
    /// `geodetic` is kept: estimators use the local metres.
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        self.position_enu_m = xyz(&values, 0);
        self.velocity_enu_mps = xyz(&values, 3);
        self
    }
}

impl Scalars for MocapPoseSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    /// Position and the attitude as a quaternion (w, x, y, z).
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        put(&mut values, 0, &self.position_enu_m);
        let q = self.world_from_body;
        values[3..7].copy_from_slice(&[q.w, q.i, q.j, q.k]);
        values
    }
    /// A quaternion that an attack made zero becomes the identity; scaled ones keep their attitude.
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        self.position_enu_m = xyz(&values, 0);
        let q = nalgebra::Quaternion::new(values[3], values[4], values[5], values[6]);
        self.world_from_body = UnitQuaternion::try_new(q, 1e-6).unwrap_or_default();
        self
    }
}

impl Scalars for CameraRangesSample {
    fn time(&self) -> FlightTime {
        self.time
    }
    fn scalars(&self) -> [f64; SCALARS] {
        let mut values = [0.0; SCALARS];
        values[..self.range_m.len()].copy_from_slice(&self.range_m);
        values
    }
    fn with_scalars(mut self, values: [f64; SCALARS]) -> Self {
        let n = self.range_m.len();
        self.range_m.copy_from_slice(&values[..n]);
        self
    }
}

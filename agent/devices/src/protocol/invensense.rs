//! InvenSense MPU and ICM with the common register map (MPU-6050 RM 4, MPU-6500, MPU-9250, ICM-20602, ICM-20608, ICM-20689
//! register maps): acceleration, temperature, rate in one burst, big-endian.
//!
//! A magnetometer behind an MPU-9250 is another chip and is not read; the ICM-20948 has another map, and is refused by its
//! identity.

use nalgebra::Vector3;

use crate::reading::ImuReading;

/// Registers.
pub mod register {
    /// Sample rate divider; configuration of the filter, of the gyroscope and of the accelerometer follow it.
    pub const SMPLRT_DIV: u8 = 0x19;
    /// Acceleration, temperature, rate: seven i16.
    pub const DATA: u8 = 0x3B;
    /// Power, and the clock.
    pub const PWR_MGMT_1: u8 = 0x6B;
    /// Identity.
    pub const WHO_AM_I: u8 = 0x75;
}

/// Into [`register::PWR_MGMT_1`]: all as after power-on, which is asleep.
pub const RESET: u8 = 0x80;
/// Into [`register::PWR_MGMT_1`]: awake, on the gyroscope's clock.
pub const AWAKE: u8 = 0x01;
/// Into [`register::SMPLRT_DIV`] and what follows: 1 kHz; low-pass at about 92 Hz; ±2000 °/s; ±16 g; the accelerometer's
/// own low-pass at about 99 Hz, where it has one.
pub const SETTING: [u8; 5] = [0, 2, 0x18, 0x18, 2];
/// Register and value that leave a chip on SPI no I²C, which it could take its clock for (ICM-20602 8.1.30; MPU-6500, ICM-20608
/// and ICM-20689 in USER_CTRL).
pub fn without_i2c(identity: u8) -> [u8; 2] {
    if identity == 0x12 { [0x70, 0x40] } else { [0x6A, 0x10] }
}

/// Bytes of a burst.
pub const DATA_LENGTH: usize = 14;

/// Standard gravity over 2048 counts at ±16 g.
const ACCEL_MPS2: f64 = 9.806_65 / 2048.0;
/// 16.4 counts for 1 °/s at ±2000 °/s.
const GYRO_RADPS: f64 = std::f64::consts::PI / 180.0 / 16.4;

/// How a chip counts temperature: counts for 1 °C, and °C at zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermometer {
    per_c: f64,
    zero_c: f64,
}

/// A chip's thermometer by its identity; `None` for another chip.
pub fn chip(identity: u8) -> Option<Thermometer> {
    let (per_c, zero_c) = match identity {
        // MPU-6050.
        0x68 => (340.0, 36.53),
        // MPU-6500, MPU-9250, MPU-9255.
        0x70 | 0x71 | 0x73 => (333.87, 21.0),
        // ICM-20602, ICM-20608, ICM-20689.
        0x12 | 0xAF | 0x98 => (326.8, 25.0),
        _ => return None,
    };
    Some(Thermometer { per_c, zero_c })
}

/// A burst in SI units.
pub fn decode(data: &[u8; DATA_LENGTH], thermometer: &Thermometer) -> ImuReading {
    let count = |at: usize| f64::from(i16::from_be_bytes(crate::framer::le::bytes(data, at)));
    let three = |at: usize, unit: f64| Vector3::from_fn(|axis, _| unit * count(at + 2 * axis));
    ImuReading {
        accel_mps2: three(0, ACCEL_MPS2),
        gyro_radps: three(8, GYRO_RADPS),
        mag_ut: None,
        temperature_c: thermometer.zero_c + count(6) / thermometer.per_c,
    }
}

/// The burst of a reading, cut to its range.
pub fn encode(reading: &ImuReading, thermometer: &Thermometer) -> [u8; DATA_LENGTH] {
    let temperature = (reading.temperature_c - thermometer.zero_c) * thermometer.per_c;
    let accel = reading.accel_mps2.iter().map(|a| a / ACCEL_MPS2);
    let gyro = reading.gyro_radps.iter().map(|w| w / GYRO_RADPS);
    let mut bytes = accel.chain([temperature]).chain(gyro).flat_map(|value| (value.round() as i16).to_be_bytes());
    std::array::from_fn(|_| bytes.next().unwrap_or_default())
}

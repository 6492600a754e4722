//! Bosch BNO055: registers, raw nine-axis mode, and its UART framing (data sheet BST-BNO055-DS000, 3.3, 4.3, 4.7).
//!
//! On I²C registers are read directly (the chip stretches the clock: that breaks on the I²C of a Raspberry Pi before the 5; use
//! UART or `i2c-gpio` there). On UART (115 200 baud) the host writes `AA 01 register length` or `AA 00 register length data`;
//! the answer is `BB length data` or `EE status`, without a checksum: what has another length than was asked is garbage.

use nalgebra::Vector3;

use crate::fault::Fault;
use crate::framer::{Protocol, Scan, le};
use crate::reading::ImuReading;

/// Registers, page 0 but where said.
pub mod register {
    /// Identity: 0xA0, then 0xFB (accelerometer), 0x32 (magnetometer), 0x0F (gyroscope).
    pub const CHIP_ID: u8 = 0x00;
    /// Which page the others are of.
    pub const PAGE_ID: u8 = 0x07;
    /// Accelerometer, magnetometer, gyroscope: nine i16.
    pub const DATA: u8 = 0x08;
    /// Temperature, °C.
    pub const TEMP: u8 = 0x34;
    /// Bits 0 to 3: accelerometer, magnetometer, gyroscope, processor passed the self-test at power-on.
    pub const ST_RESULT: u8 = 0x36;
    /// Error code of the system; 0 for none.
    pub const SYS_ERR: u8 = 0x3A;
    /// Units.
    pub const UNIT_SEL: u8 = 0x3B;
    /// Operating mode.
    pub const OPR_MODE: u8 = 0x3D;
    /// Power mode.
    pub const PWR_MODE: u8 = 0x3E;
    /// Page 1: range and bandwidth of accelerometer, magnetometer, gyroscope.
    pub const CONFIG: u8 = 0x08;
}

/// Identity of chip, accelerometer, magnetometer, gyroscope.
pub const IDENTITY: [u8; 4] = [0xA0, 0xFB, 0x32, 0x0F];
/// All four passed.
pub const SELF_TEST_PASSED: u8 = 0x0F;
/// m/s², °/s, °C.
pub const UNITS: u8 = 0x00;
/// Configuration, and all raw sensors (AMG).
pub const MODE_CONFIG: u8 = 0x00;
/// Raw accelerometer, magnetometer, gyroscope.
pub const MODE_AMG: u8 = 0x07;
/// Not suspended.
pub const POWER_NORMAL: u8 = 0x00;
/// Accelerometer ±16 g at 62.5 Hz, magnetometer 30 Hz regular, gyroscope ±2000 °/s at 116 Hz (page 1, from 0x08).
pub const RANGES: [u8; 3] = [0x0F, 0x0F, 0x10];
/// Bytes of the nine axes.
pub const DATA_LENGTH: usize = 18;

const ACCEL_MPS2: f64 = 0.01;
const MAG_UT: f64 = 1.0 / 16.0;
const GYRO_RADPS: f64 = std::f64::consts::PI / 180.0 / 16.0;

/// Nine axes from the registers as [`UNITS`] sets them.
pub fn decode_data(data: &[u8; DATA_LENGTH], temperature_c: f64) -> ImuReading {
    let three = |at: usize, unit: f64| Vector3::from_fn(|axis, _| unit * f64::from(le::i16(data, at + 2 * axis)));
    ImuReading {
        accel_mps2: three(0, ACCEL_MPS2),
        mag_ut: Some(three(6, MAG_UT)),
        gyro_radps: three(12, GYRO_RADPS),
        temperature_c,
    }
}

/// The registers of a reading, cut to their range.
pub fn encode_data(reading: &ImuReading) -> [u8; DATA_LENGTH] {
    let axes = [
        (reading.accel_mps2, ACCEL_MPS2),
        (reading.mag_ut.unwrap_or_default(), MAG_UT),
        (reading.gyro_radps, GYRO_RADPS),
    ];
    let mut values =
        axes.iter().flat_map(|(v, unit)| v.iter().map(move |x| ((x / unit).round() as i16).to_le_bytes())).flatten();
    std::array::from_fn(|_| values.next().unwrap_or_default())
}

/// What the chip answers on UART.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UartReply {
    /// What was read; only the first `length` asked for count.
    Data([u8; 32]),
    /// A write was done.
    Written,
}

/// Decoder of answers to the read of `expected` bytes (0: to a write).
#[derive(Debug, Clone, Copy, Default)]
pub struct UartReplies {
    /// Bytes that were asked for.
    pub expected: usize,
}

impl Protocol for UartReplies {
    type Reading = UartReply;
    const LONGEST: usize = 34;

    fn scan(&mut self, bytes: &[u8]) -> Scan<UartReply> {
        match bytes {
            [0xBB | 0xEE] => Scan::More,
            [0xEE, 0x01, ..] => Scan::Frame(2, Ok(UartReply::Written)),
            [0xEE, code @ 2..=10, ..] => {
                Scan::Frame(2, Err(Fault::Reported { what: "UART status", code: (*code).into() }))
            }
            [0xBB, length, data @ ..] if usize::from(*length) == self.expected && self.expected > 0 => {
                match data.get(..self.expected.min(32)) {
                    Some(data) => {
                        let mut kept = [0; 32];
                        kept.iter_mut().zip(data).for_each(|(to, from)| *to = *from);
                        Scan::Frame(2 + data.len(), Ok(UartReply::Data(kept)))
                    }
                    None => Scan::More,
                }
            }
            _ => Scan::Skip(1),
        }
    }
}

/// The request to read `length` bytes from `register`.
pub fn encode_read(register: u8, length: u8) -> [u8; 4] {
    [0xAA, 0x01, register, length]
}

/// What a host asks, as the emulator hears it.
#[derive(Debug, Clone, PartialEq)]
pub enum UartRequest {
    /// So many bytes from a register.
    Read(u8, u8),
    /// A byte into a register.
    Write(u8, u8),
}

/// Decoder of requests; writes of one byte only, as the driver makes them.
#[derive(Debug, Clone, Copy, Default)]
pub struct UartRequests;

impl Protocol for UartRequests {
    type Reading = UartRequest;
    const LONGEST: usize = 5;

    fn scan(&mut self, bytes: &[u8]) -> Scan<UartRequest> {
        match bytes {
            [0xAA, 0x01, register, length, ..] => Scan::Frame(4, Ok(UartRequest::Read(*register, *length))),
            [0xAA, 0x00, register, 1, value, ..] => Scan::Frame(5, Ok(UartRequest::Write(*register, *value))),
            [0xAA] | [0xAA, 0 | 1, ..] if bytes.len() < 5 => Scan::More,
            _ => Scan::Skip(1),
        }
    }
}

//! A UART IMU in the manner of the Mongoose of \[Paternain\]: its microcontroller sends one frame each 10 ms.
//!
//! The source does not print its frame; ours carries what its Table I lists, in its resolutions, little-endian:
//!
//! | offset | type | meaning |
//! |---|---|---|
//! | 0 | 2 bytes | 0x4D 0x49 ("MI") |
//! | 2 | u8 | version of the frame, 1 |
//! | 3 | u8 | sequence, +1 a frame |
//! | 4 | u32 | device's clock at sampling, µs, rolls over at 2³² |
//! | 8 | 3 × i16 | angular rate x y z, 0.07 °/s |
//! | 14 | 3 × i16 | specific force x y z, 4 mg |
//! | 20 | 3 × i16 | magnetic field x y z, 5 mGa = 0.5 µT |
//! | 26 | i32 | pressure, Pa |
//! | 30 | i16 | temperature, 0.1 °C |
//! | 32 | u16 | Fletcher-16 (modulo 256) of bytes 2 to 31 |

use nalgebra::Vector3;

use crate::fault::Fault;
use crate::framer::{Protocol, Scan, le, to};
use crate::protocol::ubx::fletcher;
use crate::reading::{BarometerReading, ImuReading};

const HEAD: [u8; 2] = [0x4D, 0x49];
const VERSION: u8 = 1;
/// Bytes of a frame.
pub const LENGTH: usize = 34;
const GYRO_RADPS: f64 = 0.07 * std::f64::consts::PI / 180.0;
const ACCEL_MPS2: f64 = 4e-3 * 9.81;
const MAG_UT: f64 = 0.5;

/// What a frame says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MongooseReading {
    /// Counts frames, modulo 256.
    pub sequence: u8,
    /// Device's clock, µs modulo 2³².
    pub stamp_us: u32,
    /// Nine axes.
    pub imu: ImuReading,
    /// Barometer.
    pub barometer: BarometerReading,
}

/// Decoder.
#[derive(Debug, Clone, Copy, Default)]
pub struct Mongoose;

impl Protocol for Mongoose {
    type Reading = MongooseReading;
    const LONGEST: usize = LENGTH;

    fn scan(&mut self, bytes: &[u8]) -> Scan<MongooseReading> {
        let [first, second] = HEAD;
        match bytes {
            [a] if *a == first => return Scan::More,
            [a, b, ..] if *a == first && *b == second => {}
            _ => return to(bytes, first),
        }
        let Some(frame) = bytes.first_chunk::<LENGTH>() else { return Scan::More };
        match decode(frame) {
            // What has another length may hide in a damaged one.
            Err(fault @ Fault::Checksum { .. }) => Scan::Frame(1, Err(fault)),
            outcome => Scan::Frame(LENGTH, outcome),
        }
    }
}

/// What a frame says that begins with its head.
///
/// # Errors
/// A wrong sum, or another version.
pub fn decode(frame: &[u8; LENGTH]) -> Result<MongooseReading, Fault> {
    let expected = u16::from_le_bytes(fletcher(frame.get(2..LENGTH - 2).unwrap_or_default()));
    let got = le::u16(frame, LENGTH - 2);
    if expected != got {
        return Err(Fault::Checksum { expected: expected.into(), got: got.into() });
    }
    let [_, _, version, sequence, ..] = *frame;
    if version != VERSION {
        return Err(Fault::Value { what: "frame version", value: version.into(), expected: "1" });
    }
    let three = |at: usize, unit: f64| Vector3::from_fn(|axis, _| unit * f64::from(le::i16(frame, at + 2 * axis)));
    let temperature_c = 0.1 * f64::from(le::i16(frame, 30));
    Ok(MongooseReading {
        sequence,
        stamp_us: le::u32(frame, 4),
        imu: ImuReading {
            gyro_radps: three(8, GYRO_RADPS),
            accel_mps2: three(14, ACCEL_MPS2),
            mag_ut: Some(three(20, MAG_UT)),
            temperature_c,
        },
        barometer: BarometerReading { pressure_pa: f64::from(le::i32(frame, 26)), temperature_c },
    })
}

/// A frame as the device sends it; values are rounded to its resolutions and cut to its ranges.
pub fn encode(reading: &MongooseReading) -> [u8; LENGTH] {
    let mut frame = arrayvec::ArrayVec::<u8, LENGTH>::new();
    frame.extend(HEAD);
    frame.extend([VERSION, reading.sequence]);
    frame.extend(reading.stamp_us.to_le_bytes());
    let imu = &reading.imu;
    for (vector, unit) in
        [(imu.gyro_radps, GYRO_RADPS), (imu.accel_mps2, ACCEL_MPS2), (imu.mag_ut.unwrap_or_default(), MAG_UT)]
    {
        vector.iter().for_each(|value| frame.extend(((value / unit).round() as i16).to_le_bytes()));
    }
    frame.extend((reading.barometer.pressure_pa.round() as i32).to_le_bytes());
    frame.extend(((imu.temperature_c * 10.0).round() as i16).to_le_bytes());
    let check = fletcher(frame.get(2..).unwrap_or_default());
    frame.extend(check);
    frame.into_inner().unwrap_or([0; LENGTH])
}

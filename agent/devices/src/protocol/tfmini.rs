//! Benewake TFmini class: one beam, a frame of nine bytes at 100 Hz on 115 200 baud.
//!
//! | byte | meaning |
//! |---|---|
//! | 0, 1 | 0x59 0x59 |
//! | 2, 3 | distance, cm, little-endian; 65535, 65534, 65532: no echo, saturated, ambient light |
//! | 4, 5 | strength of the echo; below 100 or 65535 the distance means nothing |
//! | 6, 7 | temperature, °C = value / 8 − 256 |
//! | 8 | low byte of the sum of the others |

use crate::fault::Fault;
use crate::framer::{Protocol, Scan, le, to};
use crate::reading::{RangeReading, Reading};

const HEAD: u8 = 0x59;
/// Bytes of a frame.
pub const LENGTH: usize = 9;
/// Weaker echoes mean nothing.
const STRENGTH_MIN: u16 = 100;
/// Distances from here on are codes, cm.
const CODES: u16 = 65_532;
/// One-sigma of a distance: 1 cm of resolution, and the 0.5 cm that the maker gives below 6 m.
const SIGMA_M: f64 = 0.006;

/// Decoder.
#[derive(Debug, Clone, Copy, Default)]
pub struct TfMini;

impl Protocol for TfMini {
    type Reading = Reading;
    const LONGEST: usize = LENGTH;

    fn scan(&mut self, bytes: &[u8]) -> Scan<Reading> {
        match bytes {
            [HEAD] => return Scan::More,
            [HEAD, HEAD, ..] => {}
            _ => return to(bytes, HEAD),
        }
        let Some(frame) = bytes.get(..LENGTH) else { return Scan::More };
        let (expected, got) = (sum(frame), frame.last().copied().unwrap_or_default());
        if expected != got {
            return Scan::Frame(1, Err(Fault::Checksum { expected: expected.into(), got: got.into() }));
        }
        Scan::Frame(LENGTH, read(frame))
    }
}

fn sum(frame: &[u8]) -> u8 {
    frame.iter().take(LENGTH - 1).fold(0, |sum: u8, b| sum.wrapping_add(*b))
}

fn read(frame: &[u8]) -> Result<Reading, Fault> {
    let (distance_cm, strength) = (le::u16(frame, 2), le::u16(frame, 4));
    if distance_cm >= CODES {
        return Err(Fault::Reported { what: "distance code", code: distance_cm.into() });
    }
    if strength < STRENGTH_MIN || strength == u16::MAX {
        return Err(Fault::Value { what: "strength", value: strength.into(), expected: "100 to 65534" });
    }
    let distance_m = f64::from(distance_cm) * 0.01;
    Ok(Reading::Range(RangeReading { distance_m, scanned: false, sigma_m: SIGMA_M }))
}

/// A frame as the device sends it.
pub fn encode(distance_m: f64, strength: u16, temperature_c: f64) -> [u8; LENGTH] {
    let [d0, d1] = ((distance_m * 100.0).round() as u16).to_le_bytes();
    let [s0, s1] = strength.to_le_bytes();
    let [t0, t1] = (((temperature_c + 256.0) * 8.0) as u16).to_le_bytes();
    let frame = [HEAD, HEAD, d0, d1, s0, s1, t0, t1, 0];
    [HEAD, HEAD, d0, d1, s0, s1, t0, t1, sum(&frame)]
}

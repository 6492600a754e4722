//! u-blox UBX: NAV-PVT, the navigation solution in one message (u-blox M8 protocol specification, 32.17.17).

use nalgebra::Vector3;

use crate::fault::Fault;
use crate::framer::{Scan, le, to};
use crate::reading::FixReading;

const HEAD: [u8; 2] = [0xB5, 0x62];
const NAV_PVT: [u8; 2] = [0x01, 0x07];
const NAV_PVT_LENGTH: usize = 92;
/// Header, class, id, length; checksum.
const AROUND: usize = 8;
/// Longest message that is waited for, payload and all around it.
pub const LONGEST: usize = 1024;

/// Fletcher's sum modulo 256 over `bytes`, as UBX defines it.
pub fn fletcher(bytes: &[u8]) -> [u8; 2] {
    let (a, b) = bytes.iter().fold((0_u8, 0_u8), |(a, b), byte| {
        let a = a.wrapping_add(*byte);
        (a, b.wrapping_add(a))
    });
    [a, b]
}

/// What a UBX message says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UbxReading {
    /// A usable fix, with the time of week of its epoch, ms.
    Fix(u32, FixReading),
    /// No fix yet: its type (0 to 5).
    NoFix(u8),
    /// Another message.
    Other([u8; 2]),
}

/// What `bytes`, that begin with the first byte of a header, begin with.
pub fn scan(bytes: &[u8]) -> Scan<UbxReading> {
    let [first, second] = HEAD;
    match bytes {
        [_] => return Scan::More,
        [a, b, ..] if *a == first && *b == second => {}
        _ => return to(bytes, first),
    }
    let Some(length) = bytes.get(4..6).map(|_| usize::from(le::u16(bytes, 4))) else { return Scan::More };
    let pvt = bytes.get(2..4) == Some(&NAV_PVT[..]);
    if length + AROUND > LONGEST || (pvt && length != NAV_PVT_LENGTH) {
        return Scan::Frame(1, Err(Fault::Malformed("UBX length")));
    }
    let Some(frame) = bytes.get(..length + AROUND) else { return Scan::More };
    let (body, check) = frame.split_at(length + AROUND - 2);
    let expected = u16::from_le_bytes(fletcher(body.get(2..).unwrap_or_default()));
    let got = le::u16(check, 0);
    if expected != got {
        return Scan::Frame(1, Err(Fault::Checksum { expected: expected.into(), got: got.into() }));
    }
    let reading = if pvt { nav_pvt(body.get(6..).unwrap_or_default()) } else { UbxReading::Other(le::bytes(body, 2)) };
    Scan::Frame(frame.len(), Ok(reading))
}

fn nav_pvt(p: &[u8]) -> UbxReading {
    let byte = |at: usize| p.get(at).copied().unwrap_or_default();
    let (fix_type, flags) = (byte(20), byte(21));
    // 2D, 3D, and 3D with dead reckoning; the receiver's own limits met (gnssFixOK).
    if !(2..=4).contains(&fix_type) || flags & 1 == 0 {
        return UbxReading::NoFix(fix_type);
    }
    let mm = |at: usize| f64::from(le::i32(p, at)) * 1e-3;
    let fix = FixReading {
        geodetic: [f64::from(le::i32(p, 28)) * 1e-7, f64::from(le::i32(p, 24)) * 1e-7, mm(36)],
        // NED on the wire.
        velocity_enu_mps: Vector3::new(mm(52), mm(48), -mm(56)),
        horizontal_sigma_m: f64::from(le::u32(p, 40)) * 1e-3,
        vertical_sigma_m: f64::from(le::u32(p, 44)) * 1e-3,
        satellites: byte(23).into(),
    };
    UbxReading::Fix(le::u32(p, 0), fix)
}

/// A NAV-PVT message as a receiver sends it.
pub fn encode_nav_pvt(time_of_week_ms: u32, fix: &FixReading) -> [u8; NAV_PVT_LENGTH + AROUND] {
    let mut frame = [0_u8; NAV_PVT_LENGTH + AROUND];
    let mut put = |at: usize, bytes: &[u8]| {
        if let Some(place) = frame.get_mut(at..at + bytes.len()) {
            place.copy_from_slice(bytes);
        }
    };
    put(0, &HEAD);
    put(2, &NAV_PVT);
    put(4, &(NAV_PVT_LENGTH as u16).to_le_bytes());
    put(6, &time_of_week_ms.to_le_bytes());
    put(6 + 20, &[3, 1]);
    put(6 + 23, &[fix.satellites as u8]);
    let [latitude, longitude, altitude] = fix.geodetic;
    let v = fix.velocity_enu_mps;
    let ground = v.xy().norm();
    for (at, value) in [
        (24, longitude * 1e7),
        (28, latitude * 1e7),
        (32, altitude * 1e3),
        (36, altitude * 1e3),
        (40, fix.horizontal_sigma_m * 1e3),
        (44, fix.vertical_sigma_m * 1e3),
        (48, v.y * 1e3),
        (52, v.x * 1e3),
        (56, -v.z * 1e3),
        (60, ground * 1e3),
        // Of the motion, clockwise from north.
        (64, v.x.atan2(v.y).to_degrees().rem_euclid(360.0) * 1e5),
    ] {
        put(6 + at, &(value.round() as i32).to_le_bytes());
    }
    let check = fletcher(frame.get(2..NAV_PVT_LENGTH + AROUND - 2).unwrap_or_default());
    if let Some(place) = frame.get_mut(NAV_PVT_LENGTH + AROUND - 2..) {
        place.copy_from_slice(&check);
    }
    frame
}

//! A GNSS receiver's stream: UBX NAV-PVT where it speaks UBX, NMEA otherwise, both between each other.

use crate::fault::Fault;
use crate::framer::{Protocol, Scan};
use crate::protocol::nmea::{self, Epoch, NmeaReading};
use crate::protocol::ubx::{self, UbxReading};
use crate::reading::FixReading;

/// What a frame says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GnssReading {
    /// A fix, with the receiver's own time of its epoch (of the week, or of the day).
    Fix {
        /// Of the epoch, ms.
        stamp_ms: u32,
        /// When it counts from zero again, ms.
        roll_over_ms: u32,
        /// The fix.
        fix: FixReading,
    },
    /// The receiver is alive, and has no fix in this message.
    Alive,
}

const WEEK_MS: u32 = 604_800_000;
const DAY_MS: u32 = 86_400_000;
/// Fixes of NMEA alone after which the receiver speaks UBX no more: its power failed, say, and it has lost its set-up.
const NMEA_ALONE: u8 = 2;

/// Decoder.
#[derive(Debug, Clone, Copy, Default)]
pub struct GnssStream {
    /// UBX fixes come: NMEA of the same receiver would give each fix twice.
    ubx: bool,
    /// Fixes of NMEA since UBX spoke of one, or of none.
    nmea: u8,
    epoch: Epoch,
}

impl Protocol for GnssStream {
    type Reading = GnssReading;
    const LONGEST: usize = ubx::LONGEST;

    fn scan(&mut self, bytes: &[u8]) -> Scan<GnssReading> {
        match bytes.first() {
            Some(0xB5) => match ubx::scan(bytes) {
                Scan::Frame(n, reading) => Scan::Frame(n, self.ubx(reading)),
                Scan::Skip(_) => Scan::Skip(1),
                // A length that garbage claims holds up no more than the next frame, which is whole in what it would take.
                Scan::More if holds_frame(bytes) => Scan::Skip(1),
                Scan::More => Scan::More,
            },
            Some(b'$') => match nmea::scan(bytes) {
                Scan::Frame(n, reading) => Scan::Frame(n, self.nmea(reading)),
                // Whatever begins in it is looked at.
                Scan::Skip(_) => Scan::Skip(1),
                Scan::More => Scan::More,
            },
            _ => {
                let next = bytes.iter().position(|b| matches!(b, 0xB5 | b'$'));
                Scan::Skip(next.unwrap_or(bytes.len()))
            }
        }
    }
}

/// Is there a whole frame after the first byte?
fn holds_frame(bytes: &[u8]) -> bool {
    let begins = |at: &usize| matches!(bytes.get(*at), Some(0xB5 | b'$'));
    (1..bytes.len()).filter(begins).any(|at| {
        let rest = bytes.get(at..).unwrap_or_default();
        match rest.first() {
            Some(0xB5) => matches!(ubx::scan(rest), Scan::Frame(_, Ok(_))),
            _ => matches!(nmea::scan(rest), Scan::Frame(_, Ok(_))),
        }
    })
}

impl GnssStream {
    fn ubx(&mut self, reading: Result<UbxReading, Fault>) -> Result<GnssReading, Fault> {
        let reading = reading?;
        if !matches!(reading, UbxReading::Other(_)) {
            self.nmea = 0;
        }
        Ok(match reading {
            UbxReading::Fix(stamp_ms, fix) => {
                self.ubx = true;
                GnssReading::Fix { stamp_ms, roll_over_ms: WEEK_MS, fix }
            }
            UbxReading::NoFix(_) | UbxReading::Other(_) => GnssReading::Alive,
        })
    }

    fn nmea(&mut self, reading: Result<NmeaReading, Fault>) -> Result<GnssReading, Fault> {
        let fix = self.epoch.take(reading?);
        if fix.is_some() {
            self.ubx &= self.nmea < NMEA_ALONE;
            self.nmea = self.nmea.saturating_add(1);
        }
        Ok(fix.filter(|_| !self.ubx).map_or(GnssReading::Alive, |(time_s, fix)| GnssReading::Fix {
            stamp_ms: (time_s * 1e3).round() as u32,
            roll_over_ms: DAY_MS,
            fix,
        }))
    }
}

//! Hokuyo URG-04LX: SCIP 2.0 (Hokuyo, "URG Series Communication Protocol Specification SCIP-Version 2.0").
//!
//! A reply is a block of lines that an empty line ends: the echo of the command, status and its checksum, and for a scan the
//! time stamp (24 bit, ms) and the ranges (18 bit, mm) in three characters each, 64 characters and a checksum a line.
//! A checksum is the low six bits of the sum of the line's characters, plus 0x30; the semicolon before
//! that of a line of information does not count.
//!
//! A range below 20 is an error code, not a distance.

use std::fmt::Write as _;

use arrayvec::{ArrayString, ArrayVec};

use crate::fault::Fault;
use crate::framer::{Protocol, Scan};

/// First and last measured step of the URG-04LX, and the one that looks straight ahead.
pub const STEPS: std::ops::RangeInclusive<usize> = 44..=725;
/// Straight ahead.
pub const FRONT_STEP: usize = 384;
/// Steps of a whole turn.
pub const STEPS_PER_TURN: usize = 1024;
/// Ranges of a whole scan.
pub const RANGES: usize = 682;
/// Ranges below this are error codes.
pub const SMALLEST_MM: u16 = 20;
/// The time stamp rolls over at this many ms.
pub const ROLL_OVER_MS: u32 = 1 << 24;
/// Characters of ranges in a line.
const LINE: usize = 64;
/// No line is longer than this, lines of information included.
const LINE_MAX: usize = 256;
/// The longest echo, and its line end.
const ECHO_MAX: usize = 16;

/// Identifies: vendor, product, firmware, protocol, serial number.
pub const VERSION: &[u8] = b"VV\n";
/// Laser on.
pub const LASER_ON: &[u8] = b"BM\n";
/// Laser off, streaming ends.
pub const QUIT: &[u8] = b"QT\n";
/// Sets SCIP 2.0 on units that start with 1.1.
pub const SCIP_2: &[u8] = b"SCIP2.0\n";
/// Streams whole scans, every one, without end.
pub const STREAM: &[u8] = b"MD0044072500000\n";

/// What a block says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScipReading {
    /// Answer to the command of two letters with its status: 0 for done.
    Reply([u8; 2], u8),
    /// Answer to VV, PP or II; its lines are in [`Scip::info`].
    Info([u8; 2]),
    /// A scan; its ranges are in [`Scip::ranges`].
    Scan {
        /// Device's clock, ms modulo 2²⁴.
        stamp_ms: u32,
    },
}

/// Decoder; keeps the last scan and the last information.
#[derive(Debug, Clone, Default)]
pub struct Scip {
    ranges_mm: ArrayVec<u16, RANGES>,
    info: ArrayString<512>,
}

impl Scip {
    /// Ranges of the last scan from step 44 on, mm; below [`SMALLEST_MM`] an error code.
    pub fn ranges(&self) -> &[u16] {
        &self.ranges_mm
    }

    /// Value of a line of the last information, as `"PROD"`.
    pub fn info(&self, key: &str) -> Option<&str> {
        self.info.lines().find_map(|line| line.split_once(':').filter(|(name, _)| *name == key)).map(|(_, value)| value)
    }

    fn block(&mut self, echo: &[u8], lines: &[u8]) -> Result<ScipReading, Fault> {
        const SHORT: Fault = Fault::Malformed("SCIP reply");
        let command = echo.first_chunk::<2>().copied().ok_or(SHORT)?;
        let mut lines = lines.split(|b| *b == b'\n');
        // `SCIP2.0` is answered by its status alone.
        let status = checked(lines.next().ok_or(SHORT)?)?;
        let code = std::str::from_utf8(status).ok().and_then(|digits| u8::from_str_radix(digits, 16).ok());
        let code = code.ok_or(Fault::Malformed("SCIP status"))?;
        match (&command, status) {
            (b"MD" | b"MS" | b"GD" | b"GS", b"99") | (b"GD" | b"GS", b"00") => {
                let stamp = checked(lines.next().ok_or(SHORT)?)?;
                let stamp_ms = number(stamp).filter(|_| stamp.len() == 4).ok_or(Fault::Malformed("SCIP time stamp"))?;
                self.scan(lines, if command[1] == b'D' { 3 } else { 2 })?;
                Ok(ScipReading::Scan { stamp_ms })
            }
            (b"VV" | b"PP" | b"II", b"00") => {
                self.info.clear();
                for line in lines.filter(|line| !line.is_empty()) {
                    let text = std::str::from_utf8(checked_information(line)?).map_err(|_| SHORT)?;
                    let _ = self.info.try_push_str(text).and_then(|()| self.info.try_push_str("\n"));
                }
                Ok(ScipReading::Info(command))
            }
            _ => Ok(ScipReading::Reply(command, code)),
        }
    }

    /// Ranges of `width` characters each, that run on over the ends of lines.
    fn scan<'a>(&mut self, lines: impl Iterator<Item = &'a [u8]>, width: usize) -> Result<(), Fault> {
        self.ranges_mm.clear();
        let mut open = ArrayVec::<u8, 3>::new();
        for line in lines.filter(|line| !line.is_empty()) {
            for character in checked(line)? {
                open.push(*character);
                if open.len() == width {
                    let range = number(&open).ok_or(Fault::Malformed("SCIP range"))?;
                    let range = u16::try_from(range).unwrap_or(u16::MAX);
                    self.ranges_mm.try_push(range).map_err(|_| Fault::Malformed("SCIP scan: too many ranges"))?;
                    open.clear();
                }
            }
        }
        if open.is_empty() { Ok(()) } else { Err(Fault::Malformed("SCIP scan: half a range")) }
    }
}

/// `line` without its checksum, which must be right.
fn checked(line: &[u8]) -> Result<&[u8], Fault> {
    let (got, text) = line.split_last().ok_or(Fault::Malformed("SCIP line"))?;
    same(text, *got)
}

/// The same of a line of information, whose checksum stands behind a semicolon that it does not count. Among ranges a
/// semicolon is a character like any other.
fn checked_information(line: &[u8]) -> Result<&[u8], Fault> {
    match line {
        [text @ .., b';', got] => same(text, *got),
        _ => Err(Fault::Malformed("SCIP line of information")),
    }
}

fn same(text: &[u8], got: u8) -> Result<&[u8], Fault> {
    let expected = checksum(text);
    if expected == got { Ok(text) } else { Err(Fault::Checksum { expected: expected.into(), got: got.into() }) }
}

fn checksum(text: &[u8]) -> u8 {
    (text.iter().map(|b| u32::from(*b)).sum::<u32>() & 0x3f) as u8 + 0x30
}

/// Six bits a character.
fn number(characters: &[u8]) -> Option<u32> {
    characters.iter().try_fold(0, |value: u32, c| match c {
        0x30..=0x6f => Some((value << 6) | u32::from(c - 0x30)),
        _ => None,
    })
}

/// The echo at the end of `line`: garbage may stand before it.
fn echo(line: &[u8]) -> Option<&[u8]> {
    let ending = |length: usize| line.len().checked_sub(length).and_then(|at| line.get(at..));
    let streaming = [(15, [&b"MD"[..], b"MS"]), (12, [b"GD", b"GS"])];
    let long = streaming.into_iter().find_map(|(length, commands)| {
        let end = ending(length)?;
        let digits = end.get(2..)?.iter().all(u8::is_ascii_digit);
        (digits && commands.iter().any(|c| end.starts_with(c))).then_some(end)
    });
    let plain = || ending(2).filter(|end| [&b"VV"[..], b"PP", b"II", b"BM", b"QT", b"RS"].contains(end));
    long.or_else(|| ending(7).filter(|end| *end == b"SCIP2.0")).or_else(plain)
}

impl Protocol for Scip {
    type Reading = ScipReading;
    const LONGEST: usize = 4096;

    fn scan(&mut self, bytes: &[u8]) -> Scan<ScipReading> {
        let Some(first_line) = bytes.iter().position(|b| *b == b'\n') else {
            // An echo may begin among the last bytes, and nothing longer before it is one.
            return if bytes.len() > LINE_MAX { Scan::Skip(bytes.len() - ECHO_MAX) } else { Scan::More };
        };
        let Some(echo) = bytes.get(..first_line).and_then(echo) else { return Scan::Skip(first_line + 1) };
        let rest = bytes.get(first_line..).unwrap_or_default();
        let Some(length) = rest.windows(2).position(|pair| pair == b"\n\n") else {
            return if bytes.len() >= Self::LONGEST { Scan::Skip(first_line + 1) } else { Scan::More };
        };
        match self.block(echo, rest.get(1..length).unwrap_or_default()) {
            Ok(reading) => Scan::Frame(first_line + length + 2, Ok(reading)),
            // The lines after it may hold the echo of the next block.
            Err(fault) => Scan::Frame(first_line + 1, Err(fault)),
        }
    }
}

/// A text with its checksum and line end.
fn line(out: &mut Vec<u8>, text: &[u8]) {
    out.extend(text);
    out.extend([checksum(text), b'\n']);
}

fn characters(value: u32, count: usize) -> impl Iterator<Item = u8> {
    (0..count).rev().map(move |at| (value >> (6 * at) & 0x3f) as u8 + 0x30)
}

/// A reply as the device sends it: `command` as it came (without line end), status, lines of information.
pub fn encode_reply(command: &str, status: &str, info: &[&str]) -> Vec<u8> {
    let mut out = format!("{command}\n").into_bytes();
    line(&mut out, status.as_bytes());
    for text in info {
        out.extend(text.bytes());
        out.extend([b';', checksum(text.as_bytes()), b'\n']);
    }
    out.push(b'\n');
    out
}

/// A scan as the device streams it for `command`.
pub fn encode_scan(command: &str, stamp_ms: u32, ranges_mm: &[u16]) -> Vec<u8> {
    let mut out = format!("{command}\n").into_bytes();
    line(&mut out, b"99");
    line(&mut out, &characters(stamp_ms % ROLL_OVER_MS, 4).collect::<Vec<_>>());
    let ranges: Vec<u8> = ranges_mm.iter().flat_map(|mm| characters((*mm).into(), 3)).collect();
    ranges.chunks(LINE).for_each(|piece| line(&mut out, piece));
    out.push(b'\n');
    out
}

/// The lines that a URG-04LX-UG01 answers to VV.
pub fn identity(serial: &str) -> [ArrayString<64>; 5] {
    let text = |key: &str, value: &str| {
        let mut text = ArrayString::new();
        let _ = write!(text, "{key}:{value}");
        text
    };
    [
        text("VEND", "Hokuyo Automatic Co.,Ltd."),
        text("PROD", "SOKUIKI Sensor URG-04LX-UG01(Simple-URG)"),
        text("FIRM", "3.4.03(17/Dec./2012)"),
        text("PROT", "SCIP 2.0"),
        text("SERI", serial),
    ]
}

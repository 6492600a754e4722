//! NMEA 0183: GGA (position, altitude, satellites) and RMC (speed, course), for receivers without UBX.
//!
//! A fix needs both of one epoch: they are matched by their time of day, whichever comes first.

use nalgebra::Vector3;

use crate::fault::Fault;
use crate::framer::Scan;
use crate::reading::FixReading;

/// Longest sentence, `$` and line end counted: the standard says 82, receivers go further.
pub const LONGEST: usize = 120;
/// Metres a second in a knot.
const KNOT_MPS: f64 = 1852.0 / 3600.0;
/// One-sigma of a range as horizontal dilution multiplies it, m (chosen; common for single-frequency receivers).
const RANGE_SIGMA_M: f64 = 2.5;

/// What a sentence says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NmeaReading {
    /// GGA.
    Position(Gga),
    /// RMC.
    Motion(Rmc),
    /// Another sentence, or one without a fix.
    Other,
}

/// Of a GGA sentence with a fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gga {
    /// UTC, s since midnight.
    pub time_s: f64,
    /// Latitude, longitude, degrees.
    pub place_deg: [f64; 2],
    /// Above mean sea level, m; NaN where absent.
    pub altitude_m: f64,
    /// Satellites used.
    pub satellites: u32,
    /// Horizontal dilution of precision; NaN where absent.
    pub dilution: f64,
}

/// Of an RMC sentence with a fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rmc {
    /// UTC, s since midnight.
    pub time_s: f64,
    /// Latitude, longitude, degrees.
    pub place_deg: [f64; 2],
    /// East and north, m/s.
    pub velocity_en_mps: [f64; 2],
}

/// What `bytes`, that begin with `$`, begin with.
pub fn scan(bytes: &[u8]) -> Scan<NmeaReading> {
    let line = bytes.get(..bytes.len().min(LONGEST)).unwrap_or(bytes);
    let Some(end) = line.iter().position(|b| *b == b'\n') else {
        // A sentence holds printable characters only; another `$` begins another one.
        let odd = line.iter().skip(1).position(|b| !(matches!(b, b' '..=b'~') || *b == b'\r') || *b == b'$');
        return match odd {
            Some(at) => Scan::Skip(at + 1),
            None if bytes.len() >= LONGEST => Scan::Skip(LONGEST),
            None => Scan::More,
        };
    };
    let (sentence, length) = (line.get(1..end).unwrap_or_default().trim_ascii_end(), end + 1);
    if let Some(at) = sentence.iter().position(|b| *b == b'$' || !(b' '..=b'~').contains(b)) {
        return Scan::Skip(at + 1);
    }
    Scan::Frame(length, read(sentence))
}

fn read(sentence: &[u8]) -> Result<NmeaReading, Fault> {
    let text = std::str::from_utf8(sentence).map_err(|_| Fault::Malformed("NMEA sentence"))?;
    let (body, check) = text.rsplit_once('*').ok_or(Fault::Malformed("NMEA sentence without checksum"))?;
    let expected = body.bytes().fold(0, |sum, b| sum ^ b);
    let got = u8::from_str_radix(check.trim(), 16).map_err(|_| Fault::Malformed("NMEA checksum"))?;
    if expected != got {
        return Err(Fault::Checksum { expected: expected.into(), got: got.into() });
    }
    let mut fields = body.split(',');
    let address = fields.next().unwrap_or_default();
    let fields: arrayvec::ArrayVec<&str, 24> = fields.take(24).collect();
    let field = |at: usize| fields.get(at).copied().unwrap_or_default();
    let number = |at: usize| field(at).parse::<f64>().unwrap_or(f64::NAN);
    Ok(match address.get(2..) {
        Some("GGA") if !matches!(field(5), "" | "0") => NmeaReading::Position(Gga {
            time_s: time_of_day(field(0))?,
            place_deg: place([field(1), field(2), field(3), field(4)])?,
            altitude_m: number(8),
            satellites: field(6).parse().unwrap_or(0),
            dilution: number(7),
        }),
        Some("RMC") if field(1) == "A" => {
            // Course is left out at standstill.
            let (speed, course) = (number(6) * KNOT_MPS, number(7));
            let (sin, cos) = if course.is_finite() { course.to_radians().sin_cos() } else { (0.0, 1.0) };
            let speed = if speed.is_finite() { speed } else { 0.0 };
            NmeaReading::Motion(Rmc {
                time_s: time_of_day(field(0))?,
                place_deg: place([field(2), field(3), field(4), field(5)])?,
                velocity_en_mps: [speed * sin, speed * cos],
            })
        }
        _ => NmeaReading::Other,
    })
}

/// `hhmmss.sss` as seconds.
fn time_of_day(field: &str) -> Result<f64, Fault> {
    const BAD: Fault = Fault::Malformed("NMEA time");
    let part = |range: std::ops::Range<usize>| {
        field.get(range).and_then(|digits| digits.parse::<u32>().ok()).map(f64::from).ok_or(BAD)
    };
    let seconds: f64 = field.get(4..).and_then(|digits| digits.parse().ok()).ok_or(BAD)?;
    let (hours, minutes) = (part(0..2)?, part(2..4)?);
    let fine = hours < 24.0 && minutes < 60.0 && (0.0..61.0).contains(&seconds);
    if fine { Ok(hours * 3600.0 + minutes * 60.0 + seconds) } else { Err(BAD) }
}

/// `ddmm.mm`, hemisphere, `dddmm.mm`, hemisphere as degrees.
fn place([latitude, north, longitude, east]: [&str; 4]) -> Result<[f64; 2], Fault> {
    let degrees = |field: &str, digits: usize, largest: f64| {
        let whole: f64 = field.get(..digits)?.parse::<u32>().ok()?.into();
        let minutes: f64 = field.get(digits..)?.parse().ok()?;
        let degrees = whole + minutes / 60.0;
        ((0.0..60.0).contains(&minutes) && degrees <= largest).then_some(degrees)
    };
    let sign = |hemisphere: &str, positive: &str, negative: &str| match hemisphere {
        h if h == positive => Some(1.0),
        h if h == negative => Some(-1.0),
        _ => None,
    };
    let latitude = degrees(latitude, 2, 90.0).zip(sign(north, "N", "S"));
    let longitude = degrees(longitude, 3, 180.0).zip(sign(east, "E", "W"));
    let ((latitude, n), (longitude, e)) = latitude.zip(longitude).ok_or(Fault::Malformed("NMEA place"))?;
    Ok([n * latitude, e * longitude])
}

/// The two sentences of a fix at `time_s` (s since midnight), as a receiver sends them.
pub fn encode(time_s: f64, fix: &FixReading) -> String {
    let sentence = |body: String| {
        let check = body.bytes().fold(0, |sum, b| sum ^ b);
        format!("${body}*{check:02X}\r\n")
    };
    // Hundredths, so that no minute has sixty seconds.
    let hundredths = (time_s.rem_euclid(86_400.0) * 100.0).round() as u64 % 8_640_000;
    let (minutes, seconds) = (hundredths / 6000, (hundredths % 6000) as f64 * 0.01);
    let time = format!("{:02}{:02}{seconds:05.2}", minutes / 60, minutes % 60);
    let angle = |degrees: f64, digits: usize, [positive, negative]: [char; 2]| {
        // Of a minute the fifth decimal, 2 cm.
        let minutes = (degrees.abs() * 60e5).round() * 1e-5;
        let whole = (minutes / 60.0).floor();
        format!("{whole:0digits$}{:08.5},{}", minutes - 60.0 * whole, if degrees < 0.0 { negative } else { positive })
    };
    let [latitude, longitude, altitude_m] = fix.geodetic;
    let place = format!("{},{}", angle(latitude, 2, ['N', 'S']), angle(longitude, 3, ['E', 'W']));
    let velocity = fix.velocity_enu_mps.xy();
    let (knots, course) = (velocity.norm() / KNOT_MPS, velocity.x.atan2(velocity.y).to_degrees().rem_euclid(360.0));
    let dilution = fix.horizontal_sigma_m / RANGE_SIGMA_M;
    let satellites = fix.satellites;
    sentence(format!("GNRMC,{time},A,{place},{knots:.3},{course:.2},010126,,,A"))
        + &sentence(format!("GNGGA,{time},{place},1,{satellites:02},{dilution:.2},{altitude_m:.3},M,0.0,M,,"))
}

/// Matches the sentences of an epoch.
#[derive(Debug, Clone, Copy, Default)]
pub struct Epoch {
    position: Option<Gga>,
    motion: Option<Rmc>,
}

impl Epoch {
    /// Takes a sentence; the fix and its time of day (s) once both of one epoch are there.
    pub fn take(&mut self, reading: NmeaReading) -> Option<(f64, FixReading)> {
        match reading {
            NmeaReading::Position(gga) => self.position = Some(gga),
            NmeaReading::Motion(rmc) => self.motion = Some(rmc),
            NmeaReading::Other => return None,
        }
        let (gga, rmc) = self.position.zip(self.motion)?;
        if (gga.time_s - rmc.time_s).abs() > 1e-3 || !gga.altitude_m.is_finite() {
            return None;
        }
        *self = Self::default();
        let [east, north] = rmc.velocity_en_mps;
        let fix = FixReading {
            geodetic: [gga.place_deg[0], gga.place_deg[1], gga.altitude_m],
            // Climb is part of neither sentence.
            velocity_enu_mps: Vector3::new(east, north, f64::NAN),
            horizontal_sigma_m: RANGE_SIGMA_M * gga.dilution,
            vertical_sigma_m: 1.5 * RANGE_SIGMA_M * gga.dilution,
            satellites: gga.satellites,
        };
        Some((gga.time_s, fix))
    }
}

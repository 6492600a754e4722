//! GNSS: recorded NMEA of 16 receivers against gpsd's own answers, UBX and NMEA mixed.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use plumbline_devices::framer::{Protocol, Scan};
use plumbline_devices::protocol::gnss::{GnssReading, GnssStream};
use plumbline_devices::protocol::nmea::{self, NmeaReading};
use plumbline_devices::protocol::ubx;
use plumbline_devices::reading::FixReading;

use super::read;
use crate::shared::shared;

/// NMEA sentences alone.
struct Sentences;

impl Protocol for Sentences {
    type Reading = NmeaReading;
    const LONGEST: usize = nmea::LONGEST;
    fn scan(&mut self, bytes: &[u8]) -> Scan<NmeaReading> {
        if bytes[0] == b'$' { nmea::scan(bytes) } else { Scan::Skip(1) }
    }
}

/// Degrees within which a position is gpsd's own.
const AGREES_DEG: f64 = 2e-5;
/// Of the positions that gpsd gives at the same time of day; a well-known Python reader has 1358 of 1425.
const SHARE_MIN: f64 = 0.95;

#[test]
fn recorded_positions_are_those_of_gpsd() {
    let Some(folder) = shared("data/nmea_gpsd") else { return };
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "log"));
    files.sort();
    let (mut all, mut same, mut fixes) = (0, 0, 0);
    for log in &files {
        let check = std::fs::read_to_string(log.with_extension("log.chk")).unwrap_or_default();
        let mut truth: BTreeMap<u64, Vec<[f64; 2]>> = BTreeMap::new();
        for line in check.lines().filter(|line| line.starts_with("{\"class\":\"TPV\"")) {
            let tpv: serde_json::Value = serde_json::from_str(line).unwrap();
            if let (Some(time), Some(lat), Some(lon)) = (tpv["time"].as_str(), tpv["lat"].as_f64(), tpv["lon"].as_f64())
            {
                let part = |range: std::ops::Range<usize>| time[range].parse::<f64>().unwrap();
                let seconds = 3600.0 * part(11..13) + 60.0 * part(14..16) + part(17..23);
                truth.entry((seconds * 1e3).round() as u64).or_default().push([lat, lon]);
            }
        }
        let bytes = std::fs::read(log).unwrap();
        for reading in read(Sentences, &bytes, 61).into_iter().flatten() {
            let (time_s, place) = match reading {
                NmeaReading::Position(gga) => (gga.time_s, gga.place_deg),
                NmeaReading::Motion(rmc) => (rmc.time_s, rmc.place_deg),
                NmeaReading::Other => continue,
            };
            let Some(known) = truth.get(&((time_s * 1e3).round() as u64)) else { continue };
            all += 1;
            let near = |p: &[f64; 2]| (p[0] - place[0]).abs() < AGREES_DEG && (p[1] - place[1]).abs() < AGREES_DEG;
            same += usize::from(known.iter().any(near));
        }
        let stream = read(GnssStream::default(), &bytes, 47);
        fixes += stream.iter().filter(|r| matches!(r, Ok(GnssReading::Fix { .. }))).count();
    }
    println!(
        "{same} of {all} GGA/RMC positions agree with gpsd within 2e-5 degrees; {fixes} fixes of {} logs",
        files.len()
    );
    assert!(all > 1000 && same as f64 > SHARE_MIN * all as f64, "{same} of {all}");
    assert!(fixes > 300, "{fixes}");
}

/// Of a receiver that moves a little.
pub(super) fn fix() -> FixReading {
    FixReading {
        geodetic: [-34.918_123_4, -56.167_765_4, 31.234],
        velocity_enu_mps: Vector3::new(0.25, -1.5, 0.125),
        horizontal_sigma_m: 1.25,
        vertical_sigma_m: 2.5,
        satellites: 11,
    }
}

#[test]
fn ubx_fixes_there_and_back_and_nmea_of_the_same_receiver_gives_none_while_they_come() {
    let nmea = |sum: bool| {
        let sentence = |body: &str| {
            let check = body.bytes().fold(u8::from(!sum), |sum, b| sum ^ b);
            format!("${body}*{check:02X}\r\n")
        };
        sentence("GNRMC,171926.00,A,4404.14063,N,12118.85478,W,0.117,90.0,180315,,,A")
            + &sentence("GNGGA,171926.00,4404.14063,N,12118.85478,W,1,12,0.91,1147.2,M,-21.3,M,,")
    };
    // NMEA alone is a fix.
    let alone = read(GnssStream::default(), nmea(true).as_bytes(), 7);
    let [Ok(GnssReading::Alive), Ok(GnssReading::Fix { stamp_ms, fix: of_nmea, .. })] = alone[..] else {
        panic!("{alone:?}")
    };
    assert_eq!(stamp_ms, 62_366_000);
    assert!((of_nmea.geodetic[0] - 44.069_010_5).abs() < 1e-8 && (of_nmea.velocity_enu_mps.x - 0.0602).abs() < 1e-3);
    assert!(read(GnssStream::default(), nmea(false).as_bytes(), 7).iter().all(Result::is_err), "checksums");
    // Beside UBX it is not.
    let pvt = |stamp_ms: u32| ubx::encode_nav_pvt(stamp_ms, &fix());
    let bytes = [&pvt(1234)[..], nmea(true).as_bytes(), &pvt(1334)[..], nmea(true).repeat(4).as_bytes()].concat();
    let all = read(GnssStream::default(), &bytes, 13);
    let fixes: Vec<_> = all
        .iter()
        .filter_map(|r| match r {
            Ok(GnssReading::Fix { stamp_ms, fix, .. }) => Some((*stamp_ms, *fix)),
            _ => None,
        })
        .collect();
    // Where UBX has been missing for two epochs it is again.
    assert_eq!(fixes.iter().map(|f| f.0).collect::<Vec<_>>(), [1234, 1334, 62_366_000, 62_366_000]);
    let back = fixes[0].1;
    assert!((Vector3::from(back.geodetic) - Vector3::from(fix().geodetic)).amax() < 1e-6, "{back:?}");
    assert_eq!((back.velocity_enu_mps, back.satellites), (fix().velocity_enu_mps, 11));
    assert_eq!((back.horizontal_sigma_m, back.vertical_sigma_m), (1.25, 2.5));
}

#[test]
fn nmea_fixes_there_and_back_within_their_resolution() {
    for (time_s, fix) in
        [(43_200.0, fix()), (86_399.996, fix()), (59.999, FixReading { geodetic: [47.5, 8.75, -3.5], ..fix() })]
    {
        let sent = nmea::encode(time_s, &fix);
        let frames = read(GnssStream::default(), sent.as_bytes(), 17);
        let [Ok(GnssReading::Alive), Ok(GnssReading::Fix { stamp_ms, roll_over_ms, fix: back })] = frames[..] else {
            panic!("{sent}{frames:?}")
        };
        assert!(roll_over_ms == 86_400_000 && stamp_ms < roll_over_ms, "{sent}");
        let late_ms = (f64::from(stamp_ms) - 1e3 * time_s).rem_euclid(86_400e3);
        assert!(late_ms.min(86_400e3 - late_ms) <= 5.0, "{time_s}: {stamp_ms}");
        let off = Vector3::from(back.geodetic) - Vector3::from(fix.geodetic);
        assert!(off.xy().amax() < 1e-7 && off.z.abs() < 1e-3, "{sent}{off}");
        // Vertical speed is part of neither sentence, and none is made up.
        assert!((back.velocity_enu_mps.xy() - fix.velocity_enu_mps.xy()).amax() < 1e-3, "{sent}");
        assert!(back.velocity_enu_mps.z.is_nan(), "{back:?}");
        assert!((back.horizontal_sigma_m - 1.25).abs() < 0.02 && back.satellites == 11, "{back:?}");
    }
}

//! Hokuyo: recorded scans and replies, and heights from scans.

use plumbline_core::sensor::noise::Stream;
use plumbline_devices::framer::Framer;
use plumbline_devices::protocol::scan_height::{self, angle_rad};
use plumbline_devices::protocol::scip::{self, RANGES, SMALLEST_MM, Scip, ScipReading};

use super::read;
use crate::shared::shared;

const STREAMED: &str = "MD0044072500000";

#[test]
fn replies_recorded_of_a_real_unit_are_read() {
    let Some(file) = shared("data/hokuyo_urg04lx/vv_reply_URG-04LX-UG01.txt") else { return };
    let mut framer = Framer::new(Scip::default());
    let mut all = Vec::new();
    framer.push(&std::fs::read(file).unwrap(), |reply| all.push(reply));
    assert_eq!(all, [Ok(ScipReading::Info(*b"VV"))]);
    let info = |key: &str| framer.protocol().info(key);
    assert_eq!(info("PROD"), Some("SOKUIKI Sensor URG-04LX-UG01(Simple-URG)"));
    assert_eq!((info("PROT"), info("SERI"), info("NONE")), (Some("SCIP 2.0"), Some("H1510998"), None));
    // What the emulator says is what the unit said.
    let lines = scip::identity("H1510998");
    let lines: Vec<&str> = lines.iter().map(|line| line.as_str()).collect();
    let recorded = std::fs::read(shared("data/hokuyo_urg04lx/vv_reply_URG-04LX-UG01.txt").unwrap()).unwrap();
    assert_eq!(scip::encode_reply("VV", "00", &lines), recorded.trim_ascii_end_and(b"\n\n"));
    let Some(file) = shared("data/hokuyo_urg04lx/bm_reply_laser_already_on.txt") else { return };
    let on = read(Scip::default(), &std::fs::read(file).unwrap(), 1);
    assert_eq!(on, [Ok(ScipReading::Reply(*b"BM", 2))]);
}

trait Ending {
    fn trim_ascii_end_and(&self, end: &[u8]) -> Vec<u8>;
}

impl Ending for Vec<u8> {
    fn trim_ascii_end_and(&self, end: &[u8]) -> Vec<u8> {
        [self.trim_ascii_end(), end].concat()
    }
}

/// Scans recorded by a URG-04LX in a house, and their times, ms.
fn recorded() -> Option<Vec<(u32, Vec<u16>)>> {
    let text = std::fs::read_to_string(shared("data/hokuyo_urg04lx/exp1.dat")?).unwrap();
    let scan = |line: &str| {
        let numbers: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let ranges = numbers[24..24 + RANGES].iter().map(|mm| *mm as u16).collect();
        ((numbers[0] / 1e3) as u32, ranges)
    };
    Some(text.lines().map(scan).collect())
}

#[test]
fn every_recorded_scan_passes_the_wire_exactly_in_pieces_of_any_size() {
    let Some(scans) = recorded() else { return };
    assert_eq!(scans.len(), 756);
    let (mut framer, mut codes) = (Framer::new(Scip::default()), 0);
    for (number, (stamp_ms, ranges)) in scans.iter().enumerate() {
        let bytes = scip::encode_scan(STREAMED, *stamp_ms, ranges);
        let mut seen = Vec::new();
        for piece in bytes.chunks(1 + number % 97) {
            framer.push(piece, |block| seen.push(block));
        }
        assert_eq!(seen, [Ok(ScipReading::Scan { stamp_ms: stamp_ms % (1 << 24) })], "scan {number}");
        assert_eq!(framer.protocol().ranges(), ranges, "scan {number}");
        codes += ranges.iter().filter(|mm| **mm < SMALLEST_MM).count();
    }
    println!("{} scans of {RANGES} ranges exact; {codes} of them error codes", scans.len());
    assert!(codes > 10_000, "error codes pass as such: {codes}");
}

#[test]
fn a_damaged_line_costs_one_scan_and_is_told() {
    let ranges: Vec<u16> = (0..RANGES).map(|i| 1000 + i as u16).collect();
    let mut bytes = scip::encode_scan(STREAMED, 100, &ranges);
    bytes[300] ^= 1;
    bytes.extend(scip::encode_scan(STREAMED, 200, &ranges));
    let seen = read(Scip::default(), &bytes, 64);
    assert!(seen[0].unwrap_err().to_string().contains("instead of"), "{seen:?}");
    assert_eq!(seen[1..], [Ok(ScipReading::Scan { stamp_ms: 200 })]);
    // Cut off in its middle, the next one following at once.
    let cut = [&scip::encode_scan(STREAMED, 300, &ranges)[..999], &scip::encode_scan(STREAMED, 400, &ranges)].concat();
    let seen = read(Scip::default(), &cut, 50);
    assert_eq!(seen.last(), Some(&Ok(ScipReading::Scan { stamp_ms: 400 })), "{seen:?}");
}

/// Largest error of a fitted height without, and with, what stands on the floor, m.
const HEIGHT_M: f64 = 0.004;
const CLUTTERED_M: f64 = 0.012;

#[test]
fn heights_are_found_through_noise_tilt_clutter_and_lost_beams() {
    let mut noise = Stream::new(3, "scan");
    let (mut worst, mut squares, mut count): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for height_m in [0.15, 0.3, 0.8, 1.0, 1.5, 2.2] {
        for roll_rad in [-0.3, -0.1, 0.0, 0.2] {
            let scan = scan_height::encode(height_m, roll_rad, 4.0, || 0.01 * noise.normal());
            let fit = scan_height::fit(&scan).unwrap();
            let error = fit.distance_m - height_m;
            worst = worst.max(error.abs());
            (squares, count) = (squares + error * error, count + 1.0);
            assert!((fit.slope_rad.abs() - roll_rad.abs()).abs() < 0.02, "{height_m} m, {roll_rad} rad: {fit:?}");
            assert!(error.abs() < 6.0 * fit.sigma_m + 1e-3, "its own sigma: {fit:?}, off by {error}");
        }
    }
    println!(
        "height of a scan with 10 mm of noise: rms {:.2} mm, worst {:.2} mm",
        1e3 * (squares / count).sqrt(),
        1e3 * worst
    );
    assert!(worst < HEIGHT_M, "{worst}");
    // A box over a third of the sector, each fifth beam lost.
    let mut scan = scan_height::encode(1.0, 0.05, 4.0, || 0.01 * noise.normal());
    for (index, mm) in scan.iter_mut().enumerate() {
        if (-0.4..0.0).contains(&angle_rad(index)) {
            *mm = (*mm as f64 * 0.7) as u16;
        }
        if index % 5 == 0 {
            *mm = 7;
        }
    }
    let fit = scan_height::fit(&scan).unwrap();
    assert!((fit.distance_m - 1.0).abs() < CLUTTERED_M && fit.share < 0.8, "{fit:?}");
}

#[test]
fn what_is_no_floor_is_refused_with_its_reason() {
    let text = |scan: &[u16]| scan_height::fit(scan).unwrap_err().to_string();
    assert_eq!(text(&[16; RANGES]), "the device reports range code 16");
    assert_eq!(text(&[]), "echoes of the floor 0 is not 20 or more");
    let mut noise = Stream::new(4, "scan");
    let scattered: Vec<u16> = (0..RANGES).map(|_| 200 + (3500.0 * noise.uniform()) as u16).collect();
    assert!(text(&scattered).contains("share of points on the floor"), "{}", text(&scattered));
}

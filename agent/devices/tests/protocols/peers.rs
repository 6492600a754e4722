//! Against implementations that others wrote: pyubx2, pynmeagps, natnet and hokuyolx, in a Python named by `PLUMBLINE_PYTHON`, or any,
//! and gpsd, where gpsfake is installed.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpListener;
use std::process::{Command, Stdio};

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_devices::protocol::gnss::{GnssReading, GnssStream};
use plumbline_devices::protocol::{natnet, nmea, scip, ubx};
use plumbline_devices::reading::{FixReading, PoseReading};

use super::gnss::fix;
use super::read;

/// What `script` prints for `input`; `None`, and a line that says so, where Python lacks `module`.
fn python(module: &str, script: &str, input: &str) -> Option<String> {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", &format!("import {module}")]).stderr(Stdio::null()).status();
    if !has.is_ok_and(|status| status.success()) {
        crate::shared::shared(&format!("python module {module}"));
        return None;
    }
    let mut child =
        Command::new(&python).args(["-c", script]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    let done = child.wait_with_output().unwrap();
    assert!(done.status.success(), "{module}");
    Some(String::from_utf8(done.stdout).unwrap())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

pub fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|at| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16).unwrap()).collect()
}

#[test]
fn pyubx2_reads_our_fixes_and_we_read_its_own() {
    let fix = fix();
    let script = "import sys\nfrom pyubx2 import UBXReader, UBXMessage\n\
        m = UBXReader.parse(bytes.fromhex(sys.stdin.read()))\n\
        print(m.identity, m.iTOW, m.lat, m.lon, m.hMSL, m.velN, m.velE, m.velD, m.hAcc, m.vAcc, m.numSV, m.fixType, m.gnssFixOk)\n\
        print(UBXMessage('NAV', 'NAV-PVT', 0, iTOW=5000, fixType=3, gnssFixOk=1, numSV=8, lon=11.5, lat=48.25, \
        hMSL=512345, hAcc=900, vAcc=1700, velN=100, velE=-200, velD=300).serialize().hex())\n";
    let Some(printed) = python("pyubx2", script, &hex(&ubx::encode_nav_pvt(987_654, &fix))) else { return };
    let (ours, theirs) = printed.trim().split_once('\n').unwrap();
    let words: Vec<&str> = ours.split(' ').collect();
    assert_eq!(words[..2], ["NAV-PVT", "987654"]);
    let numbers: Vec<f64> = words[2..11].iter().map(|word| word.parse().unwrap()).collect();
    let expected = [-34.918_123_4, -56.167_765_4, 31_234.0, -1500.0, 250.0, -125.0, 1250.0, 2500.0, 11.0];
    assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{ours}");
    assert_eq!(words[11..], ["3", "1"], "{ours}");
    let frames = read(GnssStream::default(), &bytes(theirs), 11);
    let [Ok(GnssReading::Fix { stamp_ms: 5000, fix, .. })] = frames[..] else { panic!("{frames:?}") };
    assert!((Vector3::from(fix.geodetic) - Vector3::new(48.25, 11.5, 512.345)).amax() < 1e-6, "{fix:?}");
    assert!((fix.velocity_enu_mps - Vector3::new(-0.2, 0.1, -0.3)).amax() < 1e-9, "{fix:?}");
}

#[test]
fn a_natnet_client_of_others_reads_our_frames() {
    let script = "import sys\nfrom natnet.data_frame import DataFrame\nfrom natnet.packet_buffer import PacketBuffer\n\
        from natnet.version import Version\n\
        for line in sys.stdin:\n    major, minor, data = line.split()\n\
        \x20   b = PacketBuffer(bytes.fromhex(data)[4:])\n\
        \x20   f = DataFrame.read_from_buffer(b, Version(int(major), int(minor)))\n\
        \x20   r = f.rigid_bodies[0]\n\
        \x20   print(f.prefix.frame_number, r.id_num, *r.pos, *r.rot, r.tracking_valid, f.suffix.timestamp)\n";
    let attitude = UnitQuaternion::from_euler_angles(0.2, -0.4, 2.5);
    let pose = PoseReading { position_m: Vector3::new(1.5, -0.25, 0.875), attitude };
    let versions = [(3, 0), (4, 0), (4, 1)];
    let line = |v: natnet::Version| format!("{} {} {}\n", v.0, v.1, hex(&natnet::encode(42, v, 5, &pose, true, 12.5)));
    let input: String = versions.into_iter().map(line).collect();
    let Some(printed) = python("natnet", script, &input) else { return };
    assert_eq!(printed.lines().count(), versions.len(), "{printed}");
    for line in printed.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        assert!(words[..2] == ["42", "5"] && words[9..] == ["True", "12.5"], "{line}");
        let numbers: Vec<f64> = words[2..9].iter().map(|word| word.parse().unwrap()).collect();
        let expected = [1.5, -0.25, 0.875, attitude.i, attitude.j, attitude.k, attitude.w];
        assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{line}");
    }
}

#[test]
fn pynmeagps_reads_our_sentences() {
    let fix = FixReading { velocity_enu_mps: Vector3::new(3.0, -4.0, 0.0), ..fix() };
    let script = "import sys\nfrom pynmeagps import NMEAReader\nfor line in sys.stdin:\n\
        \x20   m = NMEAReader.parse(line.strip() + '\\r\\n')\n\
        \x20   print(m.identity, m.time, m.lat, m.lon, *([m.spd, m.cog, m.status] if m.msgID == 'RMC' else \
        [m.alt, m.numSV, m.HDOP, m.quality]))\n";
    let Some(printed) = python("pynmeagps", script, &nmea::encode(45_296.25, &fix)) else { return };
    let lines: Vec<Vec<&str>> = printed.lines().map(|line| line.split(' ').collect()).collect();
    let [rmc, gga] = &lines[..] else { panic!("{printed}") };
    let numbers = |words: &[&str]| words.iter().map(|word| word.parse().unwrap()).collect::<Vec<f64>>();
    let near = |found: &[f64], expected: &[f64], within: f64| {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < within), "{printed}");
    };
    assert_eq!((rmc[0], rmc[1], gga[0]), ("GNRMC", "12:34:56.250000", "GNGGA"), "{printed}");
    near(&numbers(&rmc[2..4]), &[-34.918_123_4, -56.167_765_4], 2e-7);
    // 5 m/s are 9.719 knots; 36.87° east of south.
    near(&numbers(&rmc[4..6]), &[9.719, 143.13], 6e-3);
    near(&numbers(&gga[2..4]), &[-34.918_123_4, -56.167_765_4], 2e-7);
    near(&numbers(&gga[4..]), &[31.234, 11.0, 0.5, 1.0], 1e-3);
    assert_eq!(rmc[6], "A", "{printed}");
}

/// What gpsd says of each fix of `log`, which gpsfake gives it at a pseudo terminal; `None`, and a line that says so, without
/// gpsfake.
fn gpsd(name: &str, log: &[u8]) -> Option<Vec<serde_json::Value>> {
    if !Command::new("gpsfake").arg("-h").output().is_ok_and(|done| done.status.success()) {
        crate::shared::shared("program gpsfake");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    std::fs::write(&file, log).unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
    let ran = Command::new("gpsfake").args(["-1", "-n", "-c", "0.02", "-P", &port, "-p"]).arg(&file).output().unwrap();
    let printed = String::from_utf8_lossy(&ran.stdout).into_owned();
    let fixes = printed.lines().filter(|line| line.starts_with("{\"class\":\"TPV\""));
    let fixes: Vec<serde_json::Value> = fixes.map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(!fixes.is_empty(), "{printed}{}", String::from_utf8_lossy(&ran.stderr));
    Some(fixes)
}

#[test]
fn gpsd_reads_our_sentences_and_fixes() {
    let fix = FixReading { velocity_enu_mps: Vector3::new(3.0, -4.0, 0.0), ..fix() };
    let sentences: String = (0..12).map(|second| nmea::encode(45_296.0 + f64::from(second), &fix)).collect();
    let messages: Vec<u8> =
        (0..12_u32).flat_map(|second| ubx::encode_nav_pvt(45_296_000 + 1000 * second, &fix)).collect();
    for (name, log) in [("ours.nmea", sentences.as_bytes()), ("ours.ubx", &messages)] {
        let Some(fixes) = gpsd(name, log) else { return };
        let number = |fix: &serde_json::Value, key: &str| fix[key].as_f64().unwrap_or(f64::NAN);
        let last = fixes.iter().rev().find(|fix| fix["mode"] == 3).unwrap_or_else(|| panic!("{name}: {fixes:?}"));
        // 5 m/s, 36.87° east of south.
        for (key, expected, within) in [
            ("lat", -34.918_123_4, 2e-7),
            ("lon", -56.167_765_4, 2e-7),
            ("altMSL", 31.234, 2e-3),
            ("speed", 5.0, 6e-3),
            ("track", 143.13, 6e-3),
        ] {
            assert!((number(last, key) - expected).abs() < within, "{name}: {key} in {last}");
        }
    }
}

#[test]
fn a_natnet_client_of_others_reads_our_answer() {
    let script = "import sys\nfrom natnet.packet_buffer import PacketBuffer\nfrom natnet.server_info import ServerInfo\n\
        from natnet.version import Version\n\
        i = ServerInfo.read_from_buffer(PacketBuffer(bytes.fromhex(sys.stdin.read())[4:]), Version(3))\n\
        print(i.application_name, i.nat_net_protocol_version.major, i.nat_net_protocol_version.minor)\n";
    let Some(printed) = python("natnet", script, &hex(&natnet::encode_server_info((4, 1)))) else { return };
    assert_eq!(printed.trim(), "Motive 4 1");
}

/// The client is for the devices with a network port of the same family: what it asks comes here, and is answered as on the wire.
#[test]
fn a_hokuyo_client_of_others_reads_our_answers_and_scans() {
    let script = "import sys, numpy\nfrom hokuyolx import HokuyoLX\n\
        l = HokuyoLX(False, False, False, ('127.0.0.1', int(sys.stdin.read())), convert_time=False)\n\
        print(l._get_info('VV'), l.activate()[0])\n\
        for scan, stamp, pending in l.iter_dist(0, 44, 725):\n\
        \x20   print(stamp, pending, *scan, flush=True)\n\
        \x20   if stamp == 100: break\nl.close()\n";
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let scan = |n: usize| -> Vec<u16> { (0..scip::RANGES).map(|i| ((37 * i + 911 * n) % 5600) as u16).collect() };
    let device = std::thread::spawn(move || {
        let (mut socket, _) = listener.accept().unwrap();
        let asked = BufReader::new(socket.try_clone().unwrap());
        for asked in asked.lines().map_while(Result::ok) {
            let identity = scip::identity("H1510998");
            let lines: Vec<&str> = identity.iter().map(|line| line.as_str()).collect();
            let info = if asked == "VV" { &lines[..] } else { &[] };
            socket.write_all(&scip::encode_reply(&asked, "00", info)).unwrap();
            if format!("{asked}\n").as_bytes() != scip::STREAM {
                continue;
            }
            // The stamp rolls over between the two.
            for (n, stamp_ms) in [scip::ROLL_OVER_MS - 1, scip::ROLL_OVER_MS + 100].into_iter().enumerate() {
                std::thread::sleep(std::time::Duration::from_millis(100));
                socket.write_all(&scip::encode_scan(&asked, stamp_ms, &scan(n))).unwrap();
            }
            return;
        }
        panic!("it never asked for scans as we do");
    });
    // Where there is no such client the device waits for nobody, and ends with the test.
    let Some(printed) = python("hokuyolx", script, &port.to_string()) else { return };
    device.join().unwrap();
    let (told, scans) = printed.split_once('\n').unwrap();
    assert!(
        told.contains("'SERI': 'H1510998'") && told.contains("'PROT': 'SCIP 2.0'") && told.ends_with("} 0"),
        "{told}"
    );
    let scans: Vec<Vec<u32>> =
        scans.lines().map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect();
    assert_eq!(scans.len(), 2);
    for (n, (found, stamp_ms)) in scans.iter().zip([scip::ROLL_OVER_MS - 1, 100]).enumerate() {
        assert_eq!(found[..2], [stamp_ms, 0]);
        assert!(found[2..].iter().copied().eq(scan(n).into_iter().map(u32::from)), "scan {n}");
    }
}

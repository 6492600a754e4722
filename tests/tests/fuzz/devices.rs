//! Decoders of what devices say on their wires, and of what a MAVLink station sends.

use mavlink::dialects::common::{COMMAND_LONG_DATA, MavCmd, MavMessage, PARAM_REQUEST_LIST_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_devices::framer::{Framer, Protocol};
use plumbline_devices::protocol::bno055::{UartReplies, UartRequests};
use plumbline_devices::protocol::gnss::GnssStream;
use plumbline_devices::protocol::mavlink::Frames;
use plumbline_devices::protocol::mongoose::{self, Mongoose, MongooseReading};
use plumbline_devices::protocol::scip::{self, RANGES, Scip};
use plumbline_devices::protocol::tfmini::{self, TfMini};
use plumbline_devices::protocol::{natnet, scan_height, ubx, vicon};
use plumbline_devices::reading::{BarometerReading, FixReading, ImuReading, PoseReading};

use super::engine::fuzz;

/// Damaged `frames` in pieces; after them a valid frame is found again, within the longest that garbage may claim.
fn stream<P: Protocol>(name: &str, new: impl Fn() -> P, frames: &[Vec<u8>]) {
    let frame = &frames[0];
    let valid = frame.repeat(P::LONGEST / frame.len() + 2);
    fuzz(name, frames, |input| {
        let mut framer = Framer::new(new());
        input.chunks(37).for_each(|piece| framer.push(piece, |_| {}));
        let mut good = 0;
        framer.push(&valid, |outcome| good += u32::from(outcome.is_ok()));
        assert!(good > 0, "{name}: no frame found in {} bytes of valid ones", valid.len());
    });
}

fn imu() -> ImuReading {
    ImuReading {
        gyro_radps: Vector3::new(0.1, 0.2, -0.3),
        accel_mps2: Vector3::new(0.0, 0.1, 9.8),
        mag_ut: Some(Vector3::new(17.0, 0.0, 13.0)),
        temperature_c: 25.0,
    }
}

#[test]
fn fuzz_device_scip() {
    let frames = [
        scip::encode_scan("MD0044072500000", 777, &[1234; RANGES]),
        scip::encode_reply("BM", "00", &[]),
        scip::encode_reply(
            "VV",
            "00",
            &scip::identity("H1510998").iter().map(|line| line.as_str()).collect::<Vec<_>>(),
        ),
    ];
    stream("device_scip", Scip::default, &frames);
}

#[test]
fn fuzz_device_bno055() {
    let reply = [&[0xBB, 18][..], &[3; 18]].concat();
    stream("device_bno055", || UartReplies { expected: 18 }, &[reply, vec![0xEE, 0x07]]);
}

#[test]
fn fuzz_device_bno055_host() {
    stream("device_bno055_host", || UartRequests, &[vec![0xAA, 1, 8, 18], vec![0xAA, 0, 0x3D, 1, 7]]);
}

#[test]
fn fuzz_device_ubx() {
    let fix = FixReading {
        geodetic: [48.0, 11.0, 500.0],
        velocity_enu_mps: Vector3::zeros(),
        horizontal_sigma_m: 1.0,
        vertical_sigma_m: 2.0,
        satellites: 9,
    };
    stream("device_ubx", GnssStream::default, &[ubx::encode_nav_pvt(1000, &fix).to_vec()]);
}

#[test]
fn fuzz_device_nmea() {
    let frames = [
        &b"$GNGGA,171926.00,4404.14063,N,12118.85478,W,1,12,0.91,1147.2,M,-21.3,M,,*44\r\n"[..],
        b"$GNRMC,171926.00,A,4404.14063,N,12118.85478,W,0.117,,180315,,,A*76\r\n",
    ];
    stream("device_nmea", GnssStream::default, &frames.map(<[u8]>::to_vec));
}

#[test]
fn fuzz_device_mongoose() {
    let barometer = BarometerReading { pressure_pa: 100_000.0, temperature_c: 25.0 };
    let frame = mongoose::encode(&MongooseReading { sequence: 9, stamp_us: 123_456, imu: imu(), barometer });
    stream("device_mongoose", || Mongoose, &[frame.to_vec()]);
}

#[test]
fn fuzz_device_tfmini() {
    stream("device_tfmini", || TfMini, &[tfmini::encode(1.5, 900, 30.0).to_vec()]);
}

fn pose() -> PoseReading {
    PoseReading { position_m: Vector3::x(), attitude: UnitQuaternion::identity() }
}

fn usable(pose: Option<PoseReading>) {
    if let Some(pose) = pose {
        assert!(pose.position_m.iter().all(|x| x.is_finite()), "{pose:?}");
    }
}

#[test]
fn fuzz_device_vicon() {
    fuzz("device_vicon", &[vicon::encode(1, "iris", &pose())], |input| {
        if let Ok((_, pose)) = vicon::decode(input, "iris") {
            usable(pose);
        }
    });
}

#[test]
fn fuzz_device_natnet() {
    const VERSIONS: [(u8, u8); 3] = [(3, 0), (4, 0), (4, 1)];
    let mut seeds = VERSIONS.map(|version| natnet::encode(1, version, 1, &pose(), true, 0.0)).to_vec();
    seeds.push(natnet::encode_server_info((4, 1)));
    fuzz("device_natnet", &seeds, |input| {
        let _ = natnet::decode_server_info(input);
        for version in VERSIONS {
            if let Ok(Some((_, pose))) = natnet::decode(input, version, 1) {
                usable(pose);
            }
        }
    });
}

#[test]
fn fuzz_device_scan_height() {
    let scan: Vec<u8> = scan_height::encode(1.2, 0.1, 4.0, || 0.0).iter().flat_map(|mm| mm.to_le_bytes()).collect();
    fuzz("device_scan_height", &[scan], |input| {
        let ranges: Vec<u16> = input.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
        if let Ok(fit) = scan_height::fit(&ranges) {
            assert!(fit.distance_m.is_finite() && fit.sigma_m.is_finite(), "{fit:?}");
        }
    });
}

/// Frames of a station's orders.
fn mavlink_frames() -> [Vec<u8>; 2] {
    let arm = COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        param1: 1.0,
        target_system: 1,
        ..COMMAND_LONG_DATA::DEFAULT
    };
    let messages = [
        MavMessage::COMMAND_LONG(arm),
        MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA { target_system: 1, target_component: 1 }),
    ];
    messages.map(|message| {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(MavHeader { system_id: 255, component_id: 190, sequence: 3 }, &message);
        raw.raw_bytes().to_vec()
    })
}

#[test]
fn fuzz_device_mavlink() {
    stream("device_mavlink", Frames::default, &mavlink_frames());
}

#[test]
fn fuzz_mavlink_station() {
    let seeds = mavlink_frames();
    assert_eq!(plumbline_ground::understood(&seeds.concat()), 2);
    fuzz("mavlink_station", &seeds, |input| {
        plumbline_ground::understood(input);
    });
}

//! Garbage before, between and inside frames: no panic, no frame lost that is whole, found again at once.

use mavlink::dialects::common::MavMessage;
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use nalgebra::Vector3;
use plumbline_core::estimate::Estimate;
use plumbline_core::sensor::noise::Stream;
use plumbline_devices::autopilot::pose::odometry;
use plumbline_devices::framer::{Framer, Protocol};
use plumbline_devices::protocol::gnss::{GnssReading, GnssStream};
use plumbline_devices::protocol::mavlink::Frames;
use plumbline_devices::protocol::mongoose::{self, Mongoose, MongooseReading};
use plumbline_devices::protocol::scip::{self, RANGES, Scip};
use plumbline_devices::protocol::tfmini::{self, TfMini};
use plumbline_devices::protocol::ubx;
use plumbline_devices::reading::{BarometerReading, FixReading, ImuReading};

/// Rounds of each protocol.
const ROUNDS: usize = 400;

struct Drawn(Stream);

impl Drawn {
    fn below(&mut self, most: usize) -> usize {
        (self.0.uniform() * most as f64) as usize
    }

    /// Bytes of any value, or of those that `frame` is made of: they pass the first checks.
    fn garbage(&mut self, frame: &[u8]) -> Vec<u8> {
        let own = self.0.uniform() < 0.5;
        (0..self.below(3 * frame.len().min(400)))
            .map(|_| if own { frame[self.below(frame.len())] } else { self.below(256) as u8 })
            .collect()
    }
}

/// Draws garbage, then two whole frames: the second is always read, the first where the garbage before it claims no more.
fn resynchronises<P: Protocol>(name: &str, new: impl Fn() -> P, frame: &[u8]) {
    let mut drawn = Drawn(Stream::new(7, name));
    let (mut first, mut worst) = (0, 0);
    for round in 0..ROUNDS {
        let garbage = drawn.garbage(frame);
        let bytes = [&garbage, frame, frame].concat();
        let mut framer = Framer::new(new());
        let (mut good, mut at) = (Vec::new(), 0);
        for piece in bytes.chunks(1 + drawn.below(40)) {
            at += piece.len();
            framer.push(piece, |outcome| good.extend(outcome.is_ok().then_some(at)));
        }
        // What a piece read holds beyond the end of a frame does not count.
        assert!(!good.is_empty(), "{name}, round {round}: no frame after {} bytes of garbage", garbage.len());
        first += usize::from(good.iter().any(|at| *at < garbage.len() + frame.len() + 40));
        worst = worst.max(good.last().map_or(0, |at| at - garbage.len()));
        // Where nothing follows, what waits is given up, and the only frame found behind it.
        let (mut framer, mut found) = (Framer::new(new()), false);
        framer.push(&[&garbage, frame].concat(), |outcome| found |= outcome.is_ok());
        while !found && framer.give_up() {
            while let Some(outcome) = framer.next() {
                found |= outcome.is_ok();
            }
        }
        assert!(found, "{name}, round {round}: the only frame is lost after {} bytes of garbage", garbage.len());
    }
    println!("{name}: of {ROUNDS} first frames after garbage {first} were read when whole, the rest with the second");
    assert!(worst <= 2 * frame.len() + 40, "{name}: read {worst} bytes after the garbage");
}

fn imu() -> MongooseReading {
    let imu = ImuReading {
        gyro_radps: Vector3::new(0.1, 0.2, -0.3),
        accel_mps2: Vector3::new(0.0, 0.1, 9.8),
        mag_ut: Some(Vector3::new(17.0, 0.0, 13.0)),
        temperature_c: 25.0,
    };
    let barometer = BarometerReading { pressure_pa: 100_000.0, temperature_c: 25.0 };
    MongooseReading { sequence: 9, stamp_us: 123_456, imu, barometer }
}

fn fix() -> FixReading {
    FixReading {
        geodetic: [48.0, 11.0, 500.0],
        velocity_enu_mps: Vector3::zeros(),
        horizontal_sigma_m: 1.0,
        vertical_sigma_m: 2.0,
        satellites: 9,
    }
}

#[test]
fn every_stream_is_found_again_within_a_frame() {
    resynchronises("tfmini", || TfMini, &tfmini::encode(1.5, 900, 30.0));
    resynchronises("mongoose", || Mongoose, &mongoose::encode(&imu()));
    let scan = scip::encode_scan("MD0044072500000", 777, &[1234; RANGES]);
    resynchronises("scip", Scip::default, &scan);
    let sentence = b"$GNGGA,171926.00,4404.14063,N,12118.85478,W,1,12,0.91,1147.2,M,-21.3,M,,*44\r\n";
    resynchronises("nmea", GnssStream::default, sentence);
    resynchronises("ubx", GnssStream::default, &ubx::encode_nav_pvt(1000, &fix()));
    // A long message: a length that garbage claims is one as well.
    let mut raw = MAVLinkV2MessageRaw::new();
    let header = MavHeader { system_id: 1, component_id: 1, sequence: 7 };
    let estimate = Estimate { body_rates_radps: Vector3::repeat(0.1), ..Estimate::default() };
    raw.serialize_message(header, &MavMessage::ODOMETRY(odometry(&estimate, 1_234_567, 0)));
    resynchronises("mavlink", Frames::default, raw.raw_bytes());
}

#[test]
fn a_length_that_garbage_claims_holds_up_one_frame_and_a_long_message_is_one() {
    let frame = ubx::encode_nav_pvt(1000, &fix());
    let fixes = |bytes: &[u8]| {
        let mut framer = Framer::new(GnssStream::default());
        let mut all = Vec::new();
        framer.push(bytes, |outcome| all.push(outcome));
        all.into_iter().filter(|outcome| matches!(outcome, Ok(GnssReading::Fix { .. }))).count()
    };
    // NAV-SAT with 1000 bytes of payload, none of which ever comes.
    let claims = [0xB5, 0x62, 0x01, 0x35, 0xE8, 0x03];
    assert_eq!(fixes(&[&claims[..], &frame].concat()), 1, "the first fix after it");
    let sentence = b"$GNGGA,171926.00,4404.14063,N,12118.85478,W,1,12,0.91,1147.2,M,-21.3,M,,*44\r\n";
    let read = super::read(GnssStream::default(), &[&claims[..], sentence].concat(), 64);
    assert!(matches!(read[..], [Ok(_)]), "{read:?}");
    // The same message whole, and a fix after it: nothing of it is a fault.
    let mut whole = [&claims[..], &[0x55; 1000]].concat();
    let sum = ubx::fletcher(&whole[2..]);
    whole.extend(sum);
    let read = super::read(GnssStream::default(), &[&whole[..], &frame].concat(), 64);
    assert!(matches!(read[..], [Ok(GnssReading::Alive), Ok(GnssReading::Fix { .. })]), "{read:?}");
}

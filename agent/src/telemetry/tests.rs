use plumbline_proto::codec::{Frame, decode_frames};
use rtrb::{Consumer, RingBuffer};

use super::*;
use crate::command::Command;
use crate::sim::{Scenario, SimVehicle};
use crate::types::Mode;
use crate::vehicle::Vehicle;

struct Bench {
    vehicle: SimVehicle,
    flight: Flight,
    telemetry: Telemetry,
    link: Consumer<u8>,
    log: Consumer<u8>,
}

impl Bench {
    fn new(link_bytes: usize) -> Self {
        let scenario = Scenario::bare();
        let flight = Flight::new(scenario.flight_config()).unwrap();
        let identification = Identification {
            agent_id: "iris-1".into(),
            boot_id: 0xabcd,
            boot_wall_time: WallTime(1_795_262_400_000_000),
            vehicle: "sim",
            rig: scenario.rig.name().into(),
            scenario: scenario.text.clone(),
            seed: scenario.seed,
            source_file: String::new(),
            sensors: scenario.suite.descriptions(),
            strings: scenario.rig.lines(&scenario.airframe),
            promise: None,
        };
        let (link_ring, link) = RingBuffer::new(link_bytes);
        let (log_ring, log) = RingBuffer::new(8 << 20);
        let telemetry =
            Telemetry::new(identification, &flight, Some(Outlet::new(link_ring)), Some(Outlet::new(log_ring)));
        Self { vehicle: SimVehicle::new(&scenario).unwrap(), flight, telemetry, link, log }
    }

    fn fly(&mut self, ticks: usize) {
        for _ in 0..ticks {
            let frame = self.vehicle.sense().unwrap();
            self.flight.heartbeat(frame.time);
            let command = self.flight.step(&frame).command;
            let applied = self.vehicle.actuate(&command).unwrap();
            self.flight.applied(applied);
            let truth = self.vehicle.truth();
            self.telemetry.tick(&mut self.flight, truth.as_ref(), &Around::default());
        }
    }

    fn now(&self) -> FlightTime {
        self.flight.report().sensed.time
    }
}

fn drain(ring: &mut Consumer<u8>) -> Vec<u8> {
    let chunk = ring.read_chunk(ring.slots()).unwrap();
    let (first, second) = chunk.as_slices();
    let bytes = [first, second].concat();
    chunk.commit_all();
    bytes
}

fn count(frames: &[Frame<'_>], kind: Kind, instance: u16) -> usize {
    frames.iter().filter(|f| f.known_kind() == Some(kind) && f.instance == instance).count()
}

#[test]
fn a_second_of_ticks_has_every_topic_at_its_rate() {
    let mut bench = Bench::new(8 << 20);
    bench.fly(1000);
    drain(&mut bench.link);
    bench.fly(200);
    let bytes = drain(&mut bench.link);
    let frames: Vec<_> = decode_frames(&bytes).map(Result::unwrap).collect();
    let sequences: Vec<_> = frames.iter().map(|f| f.sequence).collect();
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "no gap, no repetition");
    assert_eq!(*sequences.last().unwrap(), bench.telemetry.sequence());
    assert_eq!(count(&frames, Kind::Control, 0), 200);
    assert_eq!(count(&frames, Kind::Estimate, EstimatorKind::Lanes as u16), 200);
    assert_eq!(count(&frames, Kind::Estimate, EstimatorKind::Complementary as u16), 25);
    assert_eq!(count(&frames, Kind::Truth, 0), 100);
    assert_eq!(count(&frames, Kind::Secure, 0), 25, "with every window");
    assert!((10..=12).contains(&count(&frames, Kind::Status, 0)));
    assert!((1..=2).contains(&count(&frames, Kind::Attacks, 0)));
    assert!(count(&frames, Kind::Description, 0) <= 1);
    let heights = count(&frames, Kind::Height, 2);
    assert!((9..=11).contains(&heights), "{heights} samples of a 10 Hz laser");
    // What the page needs travels in datagrams.
    let oversize: Vec<_> = frames.iter().filter(|f| f.encoded_len() > 1098).filter_map(Frame::known_kind).collect();
    assert!(oversize.iter().all(|kind| matches!(kind, Kind::Description | Kind::Gains | Kind::Status)), "{oversize:?}");
    let control: v1::Control =
        frames.iter().find(|f| f.known_kind() == Some(Kind::Control)).unwrap().message().unwrap();
    assert_eq!((control.motor_command.len(), control.integrator.len()), (4, 4));
    assert!(control.setpoint.unwrap().altitude_m.is_some());
}

#[test]
fn arming_records_a_flight_and_the_log_gets_the_same_bytes() {
    let mut bench = Bench::new(32 << 20);
    bench.fly(1000);
    drain(&mut bench.link);
    assert!(drain(&mut bench.log).is_empty(), "nothing is logged outside a flight");
    let now = bench.now();
    let ack = bench.flight.apply(&Command::Arm, now);
    assert!(ack.accepted, "{}", ack.reason);
    let _ = bench.flight.apply(&Command::SetMode(Mode::Stabilise), now);
    bench.fly(100);
    assert!(bench.telemetry.recording().flight_id().starts_with("20261121T120005-iris-1-abcd-1"));
    let now = bench.now();
    bench.flight.apply(&Command::CutMotors, now);
    bench.fly(300);
    assert!(!bench.telemetry.recording().is_open());
    let (radio, log) = (drain(&mut bench.link), drain(&mut bench.log));
    let start = radio.windows(log.len()).position(|window| window == log);
    assert!(start.is_some(), "the flight's bytes stand in the radio's");
    let frames: Vec<_> = decode_frames(&log).map(Result::unwrap).collect();
    let first: v1::FlightMark = frames[0].message().unwrap();
    let last: v1::FlightMark = frames.last().unwrap().message().unwrap();
    assert_eq!((first.first_sequence, first.last_sequence, first.reason.as_str()), (frames[0].sequence, None, "armed"));
    assert_eq!(last.last_sequence, Some(frames.last().unwrap().sequence));
    assert_eq!(last.reason, "disarmed");
    // The file explains itself from the start.
    for kind in [Kind::Description, Kind::Gains, Kind::Status, Kind::Attacks] {
        let at = frames.iter().position(|f| f.known_kind() == Some(kind)).unwrap();
        assert!(at < 60, "{kind:?} only comes as message {at}");
    }
    let description = frames.iter().find(|f| f.known_kind() == Some(Kind::Description)).unwrap();
    assert_eq!(description.message::<v1::Description>().unwrap().boot_id, 0xabcd);
}

#[test]
fn a_full_ring_refuses_and_counts_and_never_waits() {
    let mut bench = Bench::new(4096);
    bench.fly(50);
    let (link, log) = bench.telemetry.refused();
    assert!(link > 0 && log == 0);
    // What is in the ring is whole.
    let bytes = drain(&mut bench.link);
    assert!(decode_frames(&bytes).all(|frame| frame.is_ok()));
}

#[test]
fn recording_by_hand_outlasts_disarming_until_the_hand_ends_it() {
    let mut bench = Bench::new(32 << 20);
    bench.fly(10);
    let now = bench.now();
    assert_eq!(bench.telemetry.record(now, true, false), (true, "recording"));
    bench.fly(600);
    assert!(bench.telemetry.recording().is_open());
    let now = bench.now();
    assert!(!bench.telemetry.record(now, false, true).0, "an armed flight is always recorded");
    assert_eq!(bench.telemetry.record(now, false, false), (true, "recording stopped"));
    assert!(!bench.telemetry.recording().is_open());
}

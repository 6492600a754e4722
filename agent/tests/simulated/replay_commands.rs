//! What a ground may ask of a replay: attacks, estimators and recording; nothing that would move a motor.

use std::fmt::Write as _;

use arrayvec::ArrayVec;
use plumbline_agent::calibration::Kind as Of;
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::estimate::secure::Decoder;
use plumbline_agent::flight::{Flight, FlightConfig, RigKind};
use plumbline_agent::link::inbound::{Calibrating, Inbound, Request};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::recordings;
use plumbline_agent::recordings::replay::{ReplayVehicle, Samples};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::{Runner, RunnerOptions, RunnerPorts};
use plumbline_agent::sensor::suite::Suite;
use plumbline_agent::telemetry::{Identification, Outlet, Telemetry};
use plumbline_agent::types::{EstimatorKind, Mode};
use plumbline_proto::codec::decode_frames;
use plumbline_proto::ids::CommandId;
use plumbline_proto::time::WallTime;
use plumbline_proto::{Kind, Message, v1};

/// A recording of an IMU at rest, in the form of BROAD.
fn at_rest(rows: u32) -> String {
    let mut text =
        "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,\
                    ref_px_m,ref_py_m,ref_pz_m,movement\n"
            .to_owned();
    for k in 0..rows {
        writeln!(text, "{},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,0,0,0,1", f64::from(k) * 0.005).unwrap();
    }
    text
}

#[test]
fn motors_and_setpoints_are_refused_and_the_rest_is_obeyed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rest.csv");
    std::fs::write(&file, at_rest(400)).unwrap();
    let recording = recordings::open(&file).unwrap();
    let mut config = FlightConfig::new(Airframe::iris(), RigKind::Free, &Suite::empty());
    config.estimators.push(EstimatorKind::Secure);
    let flight = Flight::new(config).unwrap();
    let identification = Identification {
        agent_id: "iris-1".into(),
        boot_id: 7,
        boot_wall_time: WallTime(1_795_262_400_000_000),
        vehicle: "replay",
        rig: "recording".into(),
        scenario: String::new(),
        seed: 0,
        source_file: "rest.csv".into(),
        sensors: ArrayVec::new(),
        strings: ArrayVec::new(),
        promise: None,
    };
    let requests = [
        (Request::Flight(Command::Arm), false),
        (Request::Flight(Command::SetMode(Mode::Hold)), false),
        (Request::Flight(Command::Setpoint(SetpointChange { altitude_m: Some(1.0), ..Default::default() })), false),
        (Request::Flight(Command::CutMotors), false),
        (Request::Flight(Command::SelectEstimator(EstimatorKind::Complementary)), true),
        (Request::Flight(Command::SelectDecoder(Decoder::L1)), true),
        (Request::Flight(Command::AbortAttacks), true),
        (Request::Calibration(Calibrating::Drop { kind: Of::Gyroscope, imu: 1 }), false),
        (Request::Recording(true), true),
    ];
    let (mut commands, inbound) = rtrb::RingBuffer::new(16);
    for (id, (request, _)) in (1..).zip(&requests) {
        commands.push(Inbound { id: CommandId(id), request: request.clone() }).unwrap();
    }
    let (ring, mut link) = rtrb::RingBuffer::new(8 << 20);
    let telemetry = Telemetry::new(identification, &flight, Some(Outlet::new(ring)), None);
    let options = RunnerOptions {
        pace: Pace::Free,
        end: None,
        script: None,
        attacks: None,
        own_operator: false,
        stay: false,
        real_time: false,
        bounding: None,
        calibrations: None,
    };
    let ports = RunnerPorts { inbound: Some(inbound), ..RunnerPorts::default() };
    let vehicle = Box::new(ReplayVehicle::new(recording, Samples::Received));
    let mut runner = Runner::new(vehicle, flight, telemetry, options, ports);
    let summary = runner.run(&plumbline_agent::runner::stop::Stop::default()).unwrap();
    assert_eq!(summary.ticks, 400);
    assert_eq!(runner.flight().estimator_in_loop(), EstimatorKind::Complementary);
    assert!(!runner.flight().report().armed && runner.flight().report().mode == Mode::Disarmed);

    let chunk = link.read_chunk(link.slots()).unwrap();
    let bytes = [chunk.as_slices().0, chunk.as_slices().1].concat();
    let frames: Vec<_> = decode_frames(&bytes).map(Result::unwrap).collect();
    let of = |kind: Kind| frames.iter().filter(move |frame| frame.known_kind() == Some(kind));
    let acks: Vec<_> = of(Kind::Ack).map(|frame| v1::Ack::decode(frame.payload).unwrap()).collect();
    assert_eq!(acks.len(), requests.len());
    for (ack, (request, accepted)) in acks.iter().zip(&requests) {
        assert_eq!(ack.stage() == v1::AckStage::Accepted, *accepted, "{request:?}: {ack:?}");
        assert!(*accepted || ack.reason.contains("a recording is flown"), "{ack:?}");
    }
    // Recorded by hand until the program ends.
    let marks: Vec<_> = of(Kind::Flight).map(|frame| v1::FlightMark::decode(frame.payload).unwrap()).collect();
    assert_eq!(marks.iter().map(|m| m.reason.as_str()).collect::<Vec<_>>(), ["operator", "shutdown"]);
    let status = v1::Status::decode(of(Kind::Status).next_back().unwrap().payload).unwrap();
    assert_eq!((status.checks.len(), status.checks[0].name.as_str(), status.ready_to_arm), (1, "recording", false));
    assert!((status.replay_progress - 1.0).abs() < 0.1, "{}", status.replay_progress);
}

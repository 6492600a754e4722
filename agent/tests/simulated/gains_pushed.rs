//! GIVEN weights that come over the link WHEN the runner gets them THEN they are certified beside the
//! flight and acknowledged once in use, or refused; commands behind them do not wait.

use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_agent::command::Command;
use plumbline_agent::control::lqr_integral::Weights;
use plumbline_agent::control::tuning::Proposal;
use plumbline_agent::flight::Flight;
use plumbline_agent::link::inbound::{Inbound, Request};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::{Runner, RunnerPorts};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::{Outlet, Telemetry};
use plumbline_proto::codec::decode_frames;
use plumbline_proto::ids::{CommandId, GainsRevision};
use plumbline_proto::{Kind, v1};
use plumbline_support::flown::{identification, runner_options};

#[test]
fn a_push_is_answered_when_it_is_in_use_and_nothing_waits_for_it() {
    let scenario = Scenario::bare();
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let good = Weights::for_airframe(&flight.config().airframe);
    let before = flight.gains_in_use().sha256;
    let (ring, mut radio) = rtrb::RingBuffer::new(64 << 20);
    let telemetry = Telemetry::new(identification(&scenario), &flight, Some(Outlet::new(ring)), None);
    let options = runner_options(Pace::Times(1.0), None, None);
    let (mut commands, inbound) = rtrb::RingBuffer::new(16);
    let ports = RunnerPorts { inbound: Some(inbound), ..RunnerPorts::default() };
    let (mut better, mut bad) = (good, good);
    better.state[2] *= 2.0;
    bad.input[1] = -3.0;
    let pushes = [
        (1, Request::Gains { revision: GainsRevision(5), proposal: Proposal::from_weights(better) }),
        (2, Request::Gains { revision: GainsRevision(6), proposal: Proposal::from_weights(bad) }),
        (3, Request::Flight(Command::AbortAttacks)),
    ];
    for (id, request) in pushes {
        commands.push(Inbound { id: CommandId(id), request }).unwrap();
    }
    let stop = Arc::new(plumbline_agent::runner::stop::Stop::default());
    let stopped = stop.clone();
    let flying = std::thread::spawn(move || {
        let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
        let mut runner = Runner::new(vehicle, flight, telemetry, options, ports);
        runner.run(&stopped).unwrap();
        runner.flight().gains_in_use().clone()
    });

    let (mut bytes, mut acks, begun) = (Vec::new(), Vec::new(), Instant::now());
    // The gains in use are told in a message of their own, beside the acknowledgement.
    let mut told = None;
    while acks.len() < 3 || told.is_none() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{acks:?}");
        std::thread::sleep(Duration::from_millis(5));
        let chunk = radio.read_chunk(radio.slots()).unwrap();
        let (first, second) = chunk.as_slices();
        bytes.extend_from_slice(first);
        bytes.extend_from_slice(second);
        chunk.commit_all();
        acks = decode_frames(&bytes)
            .map(Result::unwrap)
            .filter(|frame| frame.known_kind() == Some(Kind::Ack))
            .map(|frame| frame.message::<v1::Ack>().unwrap())
            .collect();
        told = decode_frames(&bytes)
            .map(Result::unwrap)
            .filter(|frame| frame.known_kind() == Some(Kind::Gains))
            .map(|frame| frame.message::<v1::GainsInUse>().unwrap())
            .find(|gains| gains.revision == 5);
    }
    stop.ask();
    let in_use = flying.join().unwrap();

    let of = |id| acks.iter().find(|ack| ack.command_id == id).unwrap();
    assert_eq!(acks[0].command_id, 3, "the command behind the pushes waits for them");
    assert_eq!(of(1).stage(), v1::AckStage::Accepted);
    assert!(of(1).reason.starts_with("gains 5 in use"), "{}", of(1).reason);
    assert_eq!(of(2).stage(), v1::AckStage::Rejected);
    assert!(of(2).reason.contains("input weight 1 (torque x) is -3"), "{}", of(2).reason);
    assert_eq!(in_use.revision, GainsRevision(5));
    assert_ne!(in_use.sha256, before);
    // The ground sees both matrices, and the hash over them.
    let gains = told.unwrap();
    let mut hash = <sha2::Sha256 as sha2::Digest>::new();
    for value in gains.k.unwrap().values.iter().chain(&gains.k_attitude.unwrap().values) {
        sha2::Digest::update(&mut hash, value.to_le_bytes());
    }
    let hash: [u8; 32] = sha2::Digest::finalize(hash).into();
    assert_eq!((gains.revision, gains.sha256), (5, hash.iter().map(|b| format!("{b:02x}")).collect::<String>()));
    assert_eq!(hash, in_use.sha256);
}

//! GIVEN a simulated agent in real time WHEN it is connected THEN its telemetry is live and its commands answered.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use plumbline_agent::runner::stop::Stop;
use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_agent::flight::Flight;
use plumbline_agent::link::backfill::NoArchive;
use plumbline_agent::link::clock::FlightClock;
use plumbline_agent::link::{INBOUND_QUEUE, LinkConfig, LinkPorts, identity, spawn};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::{Runner, RunnerOptions, RunnerPorts};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::{Identification, Outlet, Telemetry};
use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig, LinkEvent, clock};
use plumbline_proto::codec::decode_batch;
use plumbline_proto::time::WallTime;
use plumbline_proto::{Kind, SCHEMA, v1};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_simulated_agent_is_live() {
    let folder = tempfile::tempdir().unwrap();
    let agent = identity::load_or_create(&folder.path().join("agent")).unwrap();
    let ground = identity::load_or_create(&folder.path().join("ground")).unwrap();
    identity::pair(&agent, "iris-1", &ground).unwrap();
    let link = AgentLink::bind(AgentLinkConfig::new("127.0.0.1:0".parse().unwrap(), ground)).unwrap();
    let address = link.local_addr();
    let (events, mut received) = tokio::sync::mpsc::channel(65_536);
    let serving = tokio::spawn(link.run(events, std::future::pending()));

    let scenario = Scenario::bare();
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let boot_wall_time = WallTime(clock::wall_us(Instant::now()));
    let identification = Identification {
        agent_id: "iris-1".into(),
        boot_id: 7,
        boot_wall_time,
        vehicle: "sim",
        rig: scenario.rig.name().into(),
        scenario: scenario.text.clone(),
        seed: scenario.seed,
        source_file: String::new(),
        sensors: scenario.suite.descriptions(),
        strings: scenario.rig.lines(&scenario.airframe),
        promise: None,
    };
    let (ring, telemetry) = rtrb::RingBuffer::new(2 << 20);
    let (commands, inbound) = rtrb::RingBuffer::new(INBOUND_QUEUE);
    let flight_clock = Arc::new(FlightClock::default());
    let config = LinkConfig {
        ground: address.to_string(),
        agent_id: "iris-1".into(),
        version: "test".into(),
        schema: u32::from(SCHEMA),
        boot_id: 7,
        boot_wall_time,
        identity: agent,
        telemetry_bytes_per_s: 1.5e6,
        backfill_bytes_per_s: 5e5,
    };
    let ports = LinkPorts { telemetry, inbound: commands, clock: flight_clock.clone(), archive: Arc::new(NoArchive) };
    let handle = spawn(config, ports).unwrap();
    let telemetry = Telemetry::new(identification, &flight, Some(Outlet::new(ring)), None);
    let options = RunnerOptions {
        pace: Pace::Times(1.0),
        replay: false,
        end: None,
        script: None,
        attacks: None,
        own_operator: false,
        stay: false,
        real_time: false,
    };
    let ports = RunnerPorts {
        inbound: Some(inbound),
        link: Some(handle.state().clone()),
        clock: flight_clock,
        ..RunnerPorts::default()
    };
    let stop = Arc::new(Stop::default());
    let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
    let flying = {
        let stop = stop.clone();
        std::thread::spawn(move || Runner::new(vehicle, flight, telemetry, options, ports).run(&stop).unwrap())
    };

    let begun = Instant::now();
    let (mut control, mut bytes, mut first) = (0_u32, 0, None);
    let (mut description, mut gains, mut ack) = (false, false, None);
    let mut stats = None;
    while control < 600 {
        assert!(begun.elapsed() < Duration::from_secs(30), "{control} control messages in 30 s");
        let event = tokio::time::timeout(Duration::from_secs(10), received.recv()).await.unwrap().unwrap();
        let (batch, at) = match event {
            LinkEvent::Batch { batch, received, .. } => (batch, received),
            LinkEvent::Connected { commands, .. } => {
                let body = Some(v1::command::Body::SetMode(v1::SetMode { mode: 77 }));
                commands.send(v1::Command { command_id: 5, operator: "t".into(), body }).await.unwrap();
                continue;
            }
            LinkEvent::Stats { round_trip_ms, clock_offset_us, .. } => {
                stats = Some((round_trip_ms, clock_offset_us));
                continue;
            }
            _ => continue,
        };
        bytes += batch.len();
        for frame in decode_batch(&batch).unwrap().map(Result::unwrap) {
            match frame.known_kind() {
                Some(Kind::Control) => {
                    first.get_or_insert(at);
                    control += 1;
                }
                Some(Kind::Description) => description = true,
                Some(Kind::Gains) => gains = true,
                Some(Kind::Ack) => ack = Some(frame.message::<v1::Ack>().unwrap()),
                _ => {}
            }
        }
    }
    let seconds = first.unwrap().elapsed().as_secs_f64();
    println!(
        "{:.0} control/s, {:.0} kB/s, round trip and offset {stats:?}",
        f64::from(control) / seconds,
        bytes as f64 * 1e-3 / seconds,
    );
    assert!(description && gains && stats.is_some());
    let ack = ack.expect("the answer came back by the telemetry");
    assert_eq!((ack.command_id, ack.reason.as_str()), (5, "mode 77 is not known"));
    // Half the rate: this machine may be busy with other tests.
    assert!(f64::from(control) / seconds > 100.0, "{control} control messages in {seconds} s at 200 Hz");

    stop.ask();
    flying.join().unwrap();
    handle.stop();
    serving.abort();
}

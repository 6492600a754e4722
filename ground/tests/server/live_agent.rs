//! GIVEN a simulated agent in real time WHEN it is connected THEN its telemetry is live and its commands answered.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use plumbline_agent::flight::Flight;
use plumbline_agent::link::backfill::NoArchive;
use plumbline_agent::link::clock::FlightClock;
use plumbline_agent::link::identity::{self, Identity};
use plumbline_agent::link::{INBOUND_QUEUE, LinkConfig, LinkHandle, LinkPorts, spawn};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::stop::Stop;
use plumbline_agent::runner::{Runner, RunnerOptions, RunnerPorts};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::{Identification, Outlet, Telemetry};
use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig, LinkEvent, clock};
use plumbline_proto::time::WallTime;
use plumbline_proto::{Kind, SCHEMA, v1};
use plumbline_support::flown::{identification, runner_options};
use tokio::sync::mpsc::Receiver;

/// Control messages that are waited for.
const CONTROLS: u32 = 600;

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

    let stop = Arc::new(Stop::default());
    let (handle, flying) = fly(address.to_string(), agent, &stop);
    let heard = listen(&mut received).await;
    println!(
        "{:.0} control/s, {:.0} kB/s, round trip and offset {:?}",
        f64::from(CONTROLS) / heard.seconds,
        heard.bytes as f64 * 1e-3 / heard.seconds,
        heard.stats,
    );
    assert!(heard.description && heard.gains && heard.stats.is_some());
    let ack = heard.ack.expect("the answer came back by the telemetry");
    assert_eq!((ack.command_id, ack.reason.as_str()), (5, "mode 77 is not known"));
    // Half the rate: this machine may be busy with other tests.
    let seconds = heard.seconds;
    assert!(f64::from(CONTROLS) / seconds > 100.0, "{CONTROLS} control messages in {seconds} s at 200 Hz");

    stop.ask();
    flying.join().unwrap();
    handle.stop();
    serving.abort();
}

/// An agent in real time, linked to `ground`.
fn fly(ground: String, identity: Identity, stop: &Arc<Stop>) -> (LinkHandle, JoinHandle<()>) {
    let scenario = Scenario::bare();
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let boot_wall_time = WallTime(clock::wall_us(Instant::now()));
    let identification = Identification { boot_wall_time, ..identification(&scenario) };
    let (ring, telemetry) = rtrb::RingBuffer::new(2 << 20);
    let (commands, inbound) = rtrb::RingBuffer::new(INBOUND_QUEUE);
    let flight_clock = Arc::new(FlightClock::default());
    let config = LinkConfig {
        ground,
        agent_id: "iris-1".into(),
        version: "test".into(),
        schema: u32::from(SCHEMA),
        boot_id: 7,
        boot_wall_time,
        identity,
        telemetry_bytes_per_s: 1.5e6,
        backfill_bytes_per_s: 5e5,
    };
    let ports = LinkPorts { telemetry, inbound: commands, clock: flight_clock.clone(), archive: Arc::new(NoArchive) };
    let handle = spawn(config, ports).unwrap();
    let telemetry = Telemetry::new(identification, &flight, Some(Outlet::new(ring)), None);
    let options = RunnerOptions { own_operator: false, ..runner_options(Pace::Times(1.0), None, None) };
    let ports = RunnerPorts {
        inbound: Some(inbound),
        link: Some(handle.state().clone()),
        clock: flight_clock,
        ..RunnerPorts::default()
    };
    let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
    let stop = stop.clone();
    let flying = std::thread::spawn(move || {
        Runner::new(vehicle, flight, telemetry, options, ports).run(&stop).unwrap();
    });
    (handle, flying)
}

/// What came over the link.
#[derive(Default)]
struct Heard {
    description: bool,
    gains: bool,
    ack: Option<v1::Ack>,
    /// Round trip, ms, and clock offset, µs.
    stats: Option<(f64, f64)>,
    bytes: usize,
    /// From the arrival of the first control message to the last.
    seconds: f64,
}

/// Asks for a mode that does not exist, and listens until [`CONTROLS`] control messages have come.
async fn listen(received: &mut Receiver<LinkEvent>) -> Heard {
    let begun = Instant::now();
    let (mut heard, mut control, mut first) = (Heard::default(), 0, None);
    while control < CONTROLS {
        assert!(begun.elapsed() < Duration::from_secs(30), "{control} control messages in 30 s");
        let event = tokio::time::timeout(Duration::from_secs(10), received.recv()).await.unwrap().unwrap();
        let (batch, at) = match event {
            LinkEvent::Batch { batch, received, .. } => (batch, received),
            LinkEvent::Connected { commands, .. } => {
                let body = Some(v1::command::Body::SetMode(v1::SetMode { mode: 77 }));
                commands.send(v1::Command { command_id: 5, operator: "t".into(), seen_us: None, body }).await.unwrap();
                continue;
            }
            LinkEvent::Stats { round_trip_ms, clock_offset_us, .. } => {
                heard.stats = Some((round_trip_ms, clock_offset_us));
                continue;
            }
            _ => continue,
        };
        heard.bytes += batch.wire_len();
        for frame in batch.frames() {
            match frame.known_kind() {
                Some(Kind::Control) => {
                    first.get_or_insert(at);
                    control += 1;
                }
                Some(Kind::Description) => heard.description = true,
                Some(Kind::Gains) => heard.gains = true,
                Some(Kind::Ack) => heard.ack = Some(frame.message::<v1::Ack>().unwrap()),
                _ => {}
            }
        }
    }
    heard.seconds = first.unwrap().elapsed().as_secs_f64();
    heard
}

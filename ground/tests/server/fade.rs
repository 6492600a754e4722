//! GIVEN an agent that talks to its ground WHEN the radio fades THEN both hear each other soon after it is back.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use plumbline_agent::link::backfill::NoArchive;
use plumbline_agent::link::clock::FlightClock;
use plumbline_agent::link::transport::IDLE_TIMEOUT_MS;
use plumbline_agent::link::{INBOUND_QUEUE, LinkConfig, LinkPorts, identity, spawn};
use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig, LinkEvent, clock};
use plumbline_proto::codec::Frame;
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::{Kind, SCHEMA};
use tokio::net::UdpSocket;
use tokio::sync::mpsc::Receiver;
use tokio::time::{sleep, timeout};

/// Bytes of a message that takes the reliable stream; one each tick fills the window of that connection in a fade.
const EVENT_BYTES: usize = 1000;
const TICK: Duration = Duration::from_millis(10);
/// Far above the two seconds that it may take, far below what QUIC's own probes would take; only a failing test waits.
const BACK_MAX: Duration = Duration::from_secs(5);

/// A relay to `ground` that passes nothing while the flag stands.
async fn radio(ground: SocketAddr) -> (SocketAddr, Arc<AtomicBool>) {
    let near = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let far = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    far.connect(ground).await.unwrap();
    let (address, out) = (near.local_addr().unwrap(), Arc::new(AtomicBool::new(false)));
    let faded = out.clone();
    tokio::spawn(async move {
        let (mut up, mut down, mut agent) = (vec![0; 2048], vec![0; 2048], None);
        loop {
            let passes = || !faded.load(Ordering::Acquire);
            tokio::select! {
                Ok((length, from)) = near.recv_from(&mut up) => {
                    agent = Some(from);
                    if passes() {
                        let _ = far.send(&up[..length]).await;
                    }
                }
                Ok(length) = far.recv(&mut down) => {
                    if let Some(agent) = agent && passes() {
                        let _ = near.send_to(&down[..length], agent).await;
                    }
                }
                else => return,
            }
        }
    });
    (address, out)
}

/// Waits for the ground to hear an echo of its heartbeat, of which it makes statistics.
async fn echo(events: &mut Receiver<LinkEvent>) {
    while !matches!(events.recv().await, Some(LinkEvent::Stats { .. })) {}
}

/// How long after a fade of this length the agent hears a heartbeat, and the ground its echo.
async fn back_after(fade: Duration) -> Duration {
    let folder = tempfile::tempdir().unwrap();
    let agent = identity::load_or_create(&folder.path().join("agent")).unwrap();
    let ground = identity::load_or_create(&folder.path().join("ground")).unwrap();
    identity::pair(&agent, "iris-1", &ground).unwrap();
    let server = AgentLink::bind(AgentLinkConfig::new("127.0.0.1:0".parse().unwrap(), ground)).unwrap();
    let (address, out) = radio(server.local_addr()).await;
    let (events, mut received) = tokio::sync::mpsc::channel(65_536);
    tokio::spawn(server.run(events, std::future::pending()));

    let (mut ring, telemetry) = rtrb::RingBuffer::new(2 << 20);
    let (inbound, _commands) = rtrb::RingBuffer::new(INBOUND_QUEUE);
    let config = LinkConfig {
        ground: address.to_string(),
        agent_id: "iris-1".into(),
        version: "test".into(),
        schema: u32::from(SCHEMA),
        boot_id: 7,
        boot_wall_time: WallTime(clock::wall_us(Instant::now())),
        identity: agent,
        telemetry_bytes_per_s: 1.5e6,
        backfill_bytes_per_s: 5e5,
    };
    let flight_clock = Arc::new(FlightClock::default());
    flight_clock.run(Instant::now(), FlightTime(0), 1.0);
    let ports = LinkPorts { telemetry, inbound, clock: flight_clock, archive: Arc::new(NoArchive) };
    let link = spawn(config, ports).unwrap();
    let flying = tokio::spawn(async move {
        let mut sequence = 0;
        loop {
            let mut bytes = Vec::new();
            for (kind, length) in [(Kind::Control, 100), (Kind::Event, EVENT_BYTES)] {
                sequence += 1;
                let payload = vec![0; length];
                let frame = Frame { kind: kind.to_wire(), instance: 0, sequence, time_us: sequence, payload: &payload };
                frame.encode(&mut bytes);
            }
            // A ring that is full refuses: nobody counts here.
            let _ = ring.push_entire_slice(&bytes);
            sleep(TICK).await;
        }
    });

    timeout(BACK_MAX, echo(&mut received)).await.expect("connected");
    sleep(Duration::from_secs(1)).await;
    out.store(true, Ordering::Release);
    sleep(fade).await;
    // What came before the fade is no answer.
    while received.try_recv().is_ok() {}
    let heartbeats = link.state().heartbeats.load(Ordering::Acquire);
    out.store(false, Ordering::Release);
    let begun = Instant::now();
    timeout(2 * BACK_MAX, echo(&mut received)).await.expect("the ground hears the agent");
    while link.state().heartbeats.load(Ordering::Acquire) == heartbeats {
        assert!(begun.elapsed() < 2 * BACK_MAX, "the agent hears the ground");
        sleep(TICK).await;
    }
    flying.abort();
    begun.elapsed()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fade_that_the_connections_outlive() {
    let back = back_after(Duration::from_secs(6)).await;
    eprintln!("back after {back:?}");
    assert!(back < BACK_MAX, "{back:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fade_that_ends_the_connections() {
    let back = back_after(Duration::from_millis(u64::from(IDLE_TIMEOUT_MS) + 2_000)).await;
    eprintln!("back after {back:?}");
    assert!(back < BACK_MAX, "{back:?}");
}

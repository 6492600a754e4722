//! Both ends of the link on the loopback, port 0.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use plumbline_agent::command::Command;
use plumbline_agent::link::backfill::{Archive, NoArchive};
use plumbline_agent::link::clock::FlightClock;
use plumbline_agent::link::inbound::{Inbound, Request};
use plumbline_agent::link::{INBOUND_QUEUE, LinkConfig, LinkHandle, LinkPorts, spawn};
use plumbline_link::identity::{self, Identity};
use plumbline_proto::codec::Frame;
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::{Kind, SCHEMA, v1};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::*;

mod traffic;

/// Nothing on the loopback takes longer; only a failing test waits for it.
const LONG: Duration = Duration::from_secs(10);

struct Ground {
    address: SocketAddr,
    events: mpsc::Receiver<LinkEvent>,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<Result<(), AgentLinkError>>,
}

impl Ground {
    fn start(identity: &Identity, listen: SocketAddr) -> Self {
        let link = AgentLink::bind(AgentLinkConfig::new(listen, identity.clone())).unwrap();
        let address = link.local_addr();
        let (sender, events) = mpsc::channel(65_536);
        let (stop, stopped) = oneshot::channel::<()>();
        let task = tokio::spawn(link.run(sender, async {
            let _ = stopped.await;
        }));
        Self { address, events, stop: Some(stop), task }
    }

    async fn next(&mut self) -> LinkEvent {
        timeout(LONG, self.events.recv()).await.expect("an event in time").expect("the link runs")
    }

    /// The next event that is not telemetry or statistics.
    async fn change(&mut self) -> LinkEvent {
        loop {
            match self.next().await {
                LinkEvent::Stats { .. } | LinkEvent::Batch { .. } => {}
                other => return other,
            }
        }
    }

    async fn connected(&mut self) -> (String, CommandSender) {
        match self.change().await {
            LinkEvent::Connected { agent_id, commands, .. } => (agent_id, commands),
            other => panic!("{other:?}"),
        }
    }

    async fn disconnected(&mut self) -> String {
        match self.change().await {
            LinkEvent::Disconnected { reason, .. } => reason,
            other => panic!("{other:?}"),
        }
    }

    async fn stop(mut self) {
        self.stop.take().unwrap().send(()).unwrap();
        self.task.await.unwrap().unwrap();
    }
}

struct Agent {
    link: LinkHandle,
    telemetry: rtrb::Producer<u8>,
    inbound: rtrb::Consumer<Inbound>,
    sequence: u64,
}

impl Agent {
    fn start(identity: &Identity, ground: SocketAddr, change: impl FnOnce(&mut LinkConfig)) -> Self {
        Self::with_archive(identity, ground, Arc::new(NoArchive), change)
    }

    fn with_archive(
        identity: &Identity,
        ground: SocketAddr,
        archive: Arc<dyn Archive>,
        change: impl FnOnce(&mut LinkConfig),
    ) -> Self {
        let mut config = LinkConfig {
            ground: ground.to_string(),
            agent_id: "iris-1".to_owned(),
            version: "test".to_owned(),
            schema: u32::from(SCHEMA),
            boot_id: 1,
            boot_wall_time: WallTime(clock::wall_us(Instant::now())),
            identity: identity.clone(),
            telemetry_bytes_per_s: 1e6,
            backfill_bytes_per_s: 1e6,
        };
        change(&mut config);
        let (telemetry, consumer) = rtrb::RingBuffer::new(4 << 20);
        let (producer, inbound) = rtrb::RingBuffer::new(INBOUND_QUEUE);
        let clock = Arc::new(FlightClock::default());
        clock.run(Instant::now(), FlightTime(0), 1.0);
        let ports = LinkPorts { telemetry: consumer, inbound: producer, clock, archive };
        Self { link: spawn(config, ports).unwrap(), telemetry, inbound, sequence: 0 }
    }

    /// Writes one frame as the flight thread would; `false` when the ring is full.
    fn say(&mut self, kind: Kind, length: usize) -> bool {
        let payload = vec![0; length];
        let mut bytes = Vec::new();
        let sequence = self.sequence + 1;
        Frame { kind: kind.to_wire(), instance: 1, sequence, time_us: sequence, payload: &payload }.encode(&mut bytes);
        let said = self.telemetry.push_entire_slice(&bytes).is_ok();
        self.sequence += u64::from(said);
        said
    }

    async fn connected(&self) {
        let begun = Instant::now();
        while !self.link.state().connected.load(Ordering::Acquire) {
            assert!(begun.elapsed() < LONG, "{}", self.link.state().reason());
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Waits until it gives a reason that says so; on a busy machine the first may be that there was no answer in time.
    async fn refused(&self, why: &str) {
        let begun = Instant::now();
        while !self.link.state().reason().contains(why) {
            assert!(begun.elapsed() < LONG, "{:?} instead of {why:?}", self.link.state().reason());
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn command(&mut self) -> Inbound {
        let begun = Instant::now();
        loop {
            match self.inbound.pop() {
                Ok(inbound) => return inbound,
                Err(_) => assert!(begun.elapsed() < LONG, "no command came"),
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
}

fn paired(folder: &Path) -> (Identity, Identity) {
    let ground = identity::load_or_create(&folder.join("ground")).unwrap();
    (enrolled(folder, "iris-1", &ground), ground)
}

/// A new agent that `ground` knows by this id.
fn enrolled(folder: &Path, agent_id: &str, ground: &Identity) -> Identity {
    let agent = identity::load_or_create(&folder.join(agent_id)).unwrap();
    identity::pair(&agent, agent_id, ground).unwrap();
    agent
}

fn any_port() -> SocketAddr {
    "127.0.0.1:0".parse().unwrap()
}

fn sequences(batch: &Batch) -> Vec<u64> {
    batch.frames().map(|frame| frame.sequence).collect()
}

fn arm(command_id: u64) -> v1::Command {
    v1::Command { command_id, operator: "test".into(), seen_us: None, body: Some(v1::command::Body::Arm(v1::Arm {})) }
}

/// Whoever stops the ground stops what takes the events too, and the link may see both at once.
#[tokio::test]
async fn a_ground_that_is_stopped_ends_without_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let identity = identity::load_or_create(&folder.path().join("ground")).unwrap();
    for _ in 0..16 {
        let mut ground = Ground::start(&identity, any_port());
        ground.stop.take().unwrap().send(()).unwrap();
        drop(ground.events);
        ground.task.await.unwrap().unwrap();
    }
    let ground = Ground::start(&identity, any_port());
    drop(ground.events);
    assert!(matches!(ground.task.await.unwrap(), Err(AgentLinkError::HubGone)));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn telemetry_comes_down_and_commands_go_up() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground) = paired(folder.path());
    let mut ground = Ground::start(&ground, any_port());
    let mut agent = Agent::start(&agent, ground.address, |_| {});
    let (id, commands) = ground.connected().await;
    assert_eq!(id, "iris-1");
    agent.connected().await;

    // Small, rare, and far larger than any datagram: all arrive, whichever way they take.
    for (kind, length) in [(Kind::Control, 200), (Kind::Ack, 20), (Kind::Gains, 5_000), (Kind::Residuals, 300_000)] {
        assert!(agent.say(kind, length));
    }
    let mut seen = Vec::new();
    let mut stats = None;
    while seen.len() < 4 || stats.is_none() {
        match ground.next().await {
            LinkEvent::Batch { agent_id, batch, backfill, .. } => {
                assert_eq!((agent_id.as_str(), backfill), ("iris-1", false));
                seen.extend(sequences(&batch));
            }
            LinkEvent::Stats { round_trip_ms, clock_offset_us, .. } => stats = Some((round_trip_ms, clock_offset_us)),
            other => panic!("{other:?}"),
        }
    }
    seen.sort_unstable();
    assert_eq!(seen, [1, 2, 3, 4]);
    let (round_trip_ms, clock_offset_us) = stats.unwrap();
    // One machine, one clock: the offset is what scheduling leaves of it.
    assert!(round_trip_ms < 1_000.0 && clock_offset_us.abs() < 50_000.0, "{round_trip_ms} ms, {clock_offset_us} µs");

    commands.send(arm(7)).await.unwrap();
    assert_eq!(agent.command().await.request, Request::Flight(Command::Arm));
    assert!(agent.link.state().heartbeats.load(Ordering::Relaxed) > 0);

    agent.link.stop();
    assert_eq!(ground.disconnected().await, "the agent shuts down");
    // The way down is closed with the link.
    while commands.send(arm(8)).await.is_ok() {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_schema_is_refused_naming_both() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground_identity) = paired(folder.path());
    let mut ground = Ground::start(&ground_identity, any_port());
    let newer = Agent::start(&agent, ground.address, |config| config.schema = 9);
    newer.refused("iris-1 speaks schema 9 (version test), this side speaks schema 1").await;
    newer.link.stop();
    // Nothing of it reached the hub; an agent of this schema is served.
    let second = enrolled(folder.path(), "iris-2", &ground_identity);
    let _agent = Agent::start(&second, ground.address, |config| config.agent_id = "iris-2".into());
    assert_eq!(ground.connected().await.0, "iris-2");
    ground.stop().await;
}

/// Waits until somebody was refused since it had refused so many.
async fn refuses(identity: &Identity, before: u64) {
    let begun = Instant::now();
    while identity.refused() == before {
        assert!(begun.elapsed() < LONG, "nobody was refused");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_unpaired_peer_gets_nothing_until_it_is_paired() {
    let folder = tempfile::tempdir().unwrap();
    let agent_identity = identity::load_or_create(&folder.path().join("agent")).unwrap();
    let ground_identity = identity::load_or_create(&folder.path().join("ground")).unwrap();
    let mut ground = Ground::start(&ground_identity, any_port());
    let agent = Agent::start(&agent_identity, ground.address, |_| {});

    // The agent does not know the ground: it shows nothing of itself.
    refuses(&agent_identity, 0).await;
    assert_eq!(ground_identity.refused(), 0);
    // The agent trusts the ground, the ground does not know the agent.
    agent_identity.trust(ground_identity.fingerprint(), "ground").unwrap();
    refuses(&ground_identity, 0).await;
    assert!(ground.events.try_recv().is_err(), "an unpaired agent reached the hub");
    assert_eq!(agent.link.state().heartbeats.load(Ordering::Relaxed), 0);
    // Paired by file, without a restart of either side.
    ground_identity.trust(agent_identity.fingerprint(), "iris-1").unwrap();
    ground.connected().await;
    agent.connected().await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_agent_comes_back_after_a_restart_of_the_ground() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground_identity) = paired(folder.path());
    let mut ground = Ground::start(&ground_identity, any_port());
    let address = ground.address;
    let mut agent = Agent::start(&agent, address, |_| {});
    ground.connected().await;
    agent.connected().await;
    ground.stop().await;
    // The flight thread goes on; nothing blocks it while nobody listens.
    for _ in 0..20_000 {
        while !agent.say(Kind::Control, 200) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    let mut ground = Ground::start(&ground_identity, address);
    ground.connected().await;
    let before = agent.link.state().connections.load(Ordering::Acquire);
    agent.connected().await;
    assert!(before <= 2 && agent.link.state().connections.load(Ordering::Acquire) == 2);
    assert!(agent.say(Kind::Status, 10));
    loop {
        if let LinkEvent::Batch { batch, .. } = ground.next().await
            && sequences(&batch).contains(&agent.sequence)
        {
            break;
        }
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_agents_with_one_id() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground_identity) = paired(folder.path());
    let mut ground = Ground::start(&ground_identity, any_port());
    let first = Agent::start(&agent, ground.address, |_| {});
    ground.connected().await;
    first.connected().await;
    let second = Agent::start(&agent, ground.address, |config| config.boot_id = 2);
    second.refused("\"iris-1\" is already connected from 127.0.0.1").await;
    // Another agent is welcome beside it.
    let third = enrolled(folder.path(), "iris-3", &ground_identity);
    let third = Agent::start(&third, ground.address, |config| config.agent_id = "iris-3".into());
    assert_eq!(ground.connected().await.0, "iris-3");
    third.connected().await;
    assert!(first.link.state().connected.load(Ordering::Acquire), "the first one is not disturbed");
    // The name is free when the first one leaves.
    first.link.stop();
    assert_eq!(ground.disconnected().await, "the agent shuts down");
    assert_eq!(ground.connected().await.0, "iris-1");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_paired_agent_connects_under_its_own_id_only() {
    // GIVEN two paired agents, the first of them away
    let folder = tempfile::tempdir().unwrap();
    let (first, ground_identity) = paired(folder.path());
    let second = enrolled(folder.path(), "iris-2", &ground_identity);
    let mut ground = Ground::start(&ground_identity, any_port());
    // WHEN the second connects under the id of the first THEN it is refused and reaches nothing
    let impostor = Agent::start(&second, ground.address, |_| {});
    impostor.refused("this certificate is paired as \"iris-2\", not as \"iris-1\"").await;
    impostor.link.stop();
    assert!(ground.events.try_recv().is_err(), "it reached the hub");
    // AND the name is there for the first, whom a revocation of the second does not touch
    let genuine = Agent::start(&first, ground.address, |_| {});
    assert_eq!(ground.connected().await.0, "iris-1");
    genuine.connected().await;
    assert_eq!(ground_identity.revoke("iris-2").unwrap(), 1);
    assert!(ground_identity.peer(first.fingerprint()).is_some());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn agents_stay_connected_while_the_identity_folder_is_away() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground_identity) = paired(folder.path());
    let mut ground = Ground::start(&ground_identity, any_port());
    let mut agent = Agent::start(&agent, ground.address, |_| {});
    ground.connected().await;
    agent.connected().await;
    std::fs::rename(ground_identity.folder(), folder.path().join("away")).unwrap();
    // Trust is looked at every second: once it has been, the agent is still heard.
    let begun = Instant::now();
    while ground_identity.trouble().is_none() {
        assert!(begun.elapsed() < LONG, "nobody noticed");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert!(agent.say(Kind::Control, 200));
    let wanted = agent.sequence;
    loop {
        match ground.next().await {
            LinkEvent::Batch { batch, .. } if sequences(&batch).contains(&wanted) => break,
            LinkEvent::Disconnected { reason, .. } => panic!("{reason}"),
            _ => {}
        }
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_short_code_pairs_once_and_a_wrong_one_never() {
    use plumbline_link::pairing::{Code, expect, meet};
    let folder = tempfile::tempdir().unwrap();
    let agent = identity::load_or_create(&folder.path().join("agent")).unwrap();
    let ground_identity = identity::load_or_create(&folder.path().join("ground")).unwrap();
    let mut ground = Ground::start(&ground_identity, any_port());
    let code = Code::random().unwrap();
    // GIVEN no code at the ground THEN the agent does not even pass the handshake
    assert!(meet(ground.address, &agent, "iris-1", &code).await.is_err());
    assert_eq!((ground_identity.refused(), agent.peer(ground_identity.fingerprint())), (1, None));
    // GIVEN a code WHEN strangers connect and leave before they prove anything THEN that costs nothing
    expect(ground_identity.folder(), &code).unwrap();
    let waiting = || std::fs::read_to_string(ground_identity.folder().join("pairing")).unwrap();
    let before = waiting();
    for _ in 0..server::PROOFS + 2 {
        let tls = plumbline_link::tls::client(&agent, plumbline_link::tls::Purpose::Pairing).unwrap();
        let endpoint = quinn::Endpoint::client(any_port()).unwrap();
        let config = quinn::ClientConfig::new(Arc::new(tls));
        let connection = endpoint.connect_with(config, ground.address, "plumbline").unwrap().await.unwrap();
        connection.close(0_u32.into(), b"");
        endpoint.wait_idle().await;
    }
    assert_eq!(waiting(), before);
    // WHEN an agent guesses THEN it is refused, and counted
    for _ in 0..server::PROOFS - 1 {
        let error = meet(ground.address, &agent, "iris-1", &Code::random().unwrap()).await.unwrap_err().to_string();
        assert!(error.contains("does not know this code"), "{error}");
    }
    assert_ne!(waiting(), before);
    // A stranger that does not pair gets nothing, although a code waits.
    let before = agent.refused();
    let stranger = Agent::start(&agent, ground.address, |_| {});
    refuses(&agent, before).await;
    stranger.link.stop();
    assert!(ground.events.try_recv().is_err());
    // WHEN the right one comes THEN both trust each other, and the code is spent
    let met = meet(ground.address, &agent, "iris-1", &code).await.unwrap();
    assert_eq!(met, ground_identity.fingerprint());
    assert_eq!(agent.peer(met).as_deref(), Some("ground"));
    assert_eq!(ground_identity.peer(agent.fingerprint()).as_deref(), Some("iris-1"));
    let second = identity::load_or_create(&folder.path().join("second")).unwrap();
    assert!(meet(ground.address, &second, "iris-2", &code).await.is_err());
    let flying = Agent::start(&agent, ground.address, |_| {});
    ground.connected().await;
    flying.connected().await;
    // WHEN it is revoked THEN its session ends, and it finds no other
    let refused = ground_identity.refused();
    assert_eq!(ground_identity.revoke("iris-1").unwrap(), 1);
    assert_eq!(ground.disconnected().await, "the agent is trusted no more");
    refuses(&ground_identity, refused).await;
    ground.stop().await;
}

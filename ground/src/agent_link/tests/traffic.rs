//! What goes over the link: floods, gaps, and a session that somebody plays again.

use std::ops::ControlFlow;
use std::sync::Mutex;

use super::*;

/// A relay that remembers what the agent sent; its other end is `ground`.
async fn overheard(ground: SocketAddr) -> (SocketAddr, Arc<Mutex<Vec<Vec<u8>>>>) {
    let near = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let far = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    far.connect(ground).await.unwrap();
    let (address, heard) = (near.local_addr().unwrap(), Arc::new(Mutex::new(Vec::new())));
    let kept = heard.clone();
    tokio::spawn(async move {
        let (mut up, mut down, mut agent) = (vec![0; 2048], vec![0; 2048], None);
        loop {
            tokio::select! {
                Ok((length, from)) = near.recv_from(&mut up) => {
                    agent = Some(from);
                    kept.lock().unwrap().push(up[..length].to_vec());
                    let _ = far.send(&up[..length]).await;
                }
                Ok(length) = far.recv(&mut down) => {
                    if let Some(agent) = agent {
                        let _ = near.send_to(&down[..length], agent).await;
                    }
                }
                else => return,
            }
        }
    });
    (address, heard)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_played_again_reaches_nobody_and_is_counted() {
    // GIVEN a session of which somebody has kept every packet
    let folder = tempfile::tempdir().unwrap();
    let (agent_identity, ground_identity) = paired(folder.path());
    let mut ground = Ground::start(&ground_identity, any_port());
    let (relay, heard) = overheard(ground.address).await;
    let mut agent = Agent::start(&agent_identity, relay, |_| {});
    ground.connected().await;
    agent.connected().await;
    while !matches!(ground.next().await, LinkEvent::Batch { .. }) {
        agent.say(Kind::Control, 200);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    drop(agent);
    ground.disconnected().await;
    while ground.events.try_recv().is_ok() {}
    // WHEN it is played again, from another place, twice
    let heard = heard.lock().unwrap().clone();
    assert!(heard.len() > 10, "{} packets", heard.len());
    let before = ground_identity.broken_off();
    let socket = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    for packet in heard.iter().chain(&heard) {
        socket.send_to(packet, ground.address).await.unwrap();
    }
    // THEN it comes to nothing, and that is counted
    let begun = Instant::now();
    while ground_identity.broken_off() == before {
        assert!(begun.elapsed() < LONG, "nothing was counted");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(ground.events.try_recv().is_err(), "a replayed session reached the hub");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_is_held_to_the_cap_and_commands_pass() {
    const CAP: f64 = 300e3;
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground) = paired(folder.path());
    let mut ground = Ground::start(&ground, any_port());
    let mut agent = Agent::start(&agent, ground.address, |config| config.telemetry_bytes_per_s = CAP);
    let (_, commands) = ground.connected().await;
    agent.connected().await;

    // Ten times the cap for a second, from a thread like the flight thread.
    let begun = Instant::now();
    let flood = tokio::task::spawn_blocking(move || {
        let mut refused = 0;
        while begun.elapsed() < Duration::from_secs(1) {
            for _ in 0..15 {
                refused += u64::from(!agent.say(Kind::Control, 200));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        (agent, refused)
    });
    // A flood of commands at the same time: twice what the queue holds, none is lost.
    let many = 2 * INBOUND_QUEUE as u64;
    let sending = tokio::spawn(async move {
        for id in 1..=many {
            commands.send(arm(id)).await.unwrap();
        }
    });
    let (mut agent, refused) = timeout(LONG, flood).await.unwrap().unwrap();
    assert_eq!(refused, 0, "the ring never filled: the link emptied it in time");
    for id in 1..=many {
        assert_eq!(agent.command().await.id.0, id);
    }
    sending.await.unwrap();

    let elapsed = begun.elapsed().as_secs_f64();
    let mut bytes = 0;
    let mut messages = 0;
    while let Ok(event) = ground.events.try_recv() {
        if let LinkEvent::Batch { batch, .. } = event {
            bytes += batch.wire_len();
            messages += sequences(&batch).len() as u64;
        }
    }
    let rate = bytes as f64 / elapsed;
    assert!(rate < 1.1 * CAP, "{rate} B/s received, the cap is {CAP}");
    assert!(bytes as f64 > 0.5 * CAP, "{bytes} bytes received: the flood starved the link");
    let state = agent.link.state();
    let (sent, dropped) = (state.sent.load(Ordering::Relaxed), state.dropped.load(Ordering::Relaxed));
    assert!(
        dropped > 0 && messages <= sent && sent + dropped <= agent.sequence + sent,
        "{sent} sent, {dropped} dropped"
    );
    assert!(dropped + messages <= agent.sequence, "{dropped} dropped and {messages} received of {}", agent.sequence);
    ground.stop().await;
}

/// Frames 1..=1000 of flight "f", less 500..=509.
struct Gappy;

impl Archive for Gappy {
    fn read(
        &self,
        request: &v1::BackfillRequest,
        sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
    ) -> Result<(), String> {
        assert_eq!(request.flight_id, "f");
        for sequence in (1..=1000).filter(|sequence| !(500..510).contains(sequence)) {
            let frame = Frame { kind: 20, instance: 0, sequence, time_us: sequence, payload: &[0; 400] };
            if sink(&frame).is_break() {
                break;
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn gaps_are_filled_from_the_onboard_log() {
    let folder = tempfile::tempdir().unwrap();
    let (agent, ground) = paired(folder.path());
    let mut ground = Ground::start(&ground, any_port());
    let agent = Agent::with_archive(&agent, ground.address, Arc::new(Gappy), |_| {});
    let (_, commands) = ground.connected().await;
    agent.connected().await;
    let request = v1::BackfillRequest { flight_id: "f".into(), first_sequence: 300, last_sequence: 1010 };
    commands.backfill(request).await.unwrap();
    let mut seen = Vec::new();
    let mut missing = Vec::new();
    while missing.len() < 2 {
        match ground.next().await {
            LinkEvent::Batch { batch, backfill, .. } => {
                assert!(backfill);
                seen.extend(sequences(&batch));
            }
            LinkEvent::BackfillUnavailable { request, .. } => {
                missing.push((request.first_sequence, request.last_sequence));
            }
            LinkEvent::Stats { .. } => {}
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(missing, [(500, 509), (1001, 1010)]);
    let expected: Vec<u64> = (300..500).chain(510..=1000).collect();
    assert_eq!(seen, expected);
    ground.stop().await;
}

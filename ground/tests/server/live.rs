//! The live view: order, completeness, history, and viewers that stall.

use std::time::Instant;

use crate::common::viewer::Viewer;
use crate::common::{Ground, PATIENCE};
use plumbline_proto::codec::Batch;
use plumbline_proto::{Kind, v1};
use tokio::sync::watch;

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_sees_state_then_history_then_live_without_gap_or_repetition() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    for _ in 0..100 {
        let tick = agent.tick();
        agent.send(tick, false).await;
    }
    // Wait until the hub has it all: the newest sample is in a view without history.
    let mut probe = ground.view("iris-1", 60).await;
    while probe.next_of(Kind::Height).await.sequence != agent.sequence {}

    let mut viewer = ground.view("iris-1", 60).await;
    assert_eq!(viewer.next().await.kind, Some(Kind::Link));
    assert_eq!(viewer.next_of(Kind::Description).await.message::<v1::Description>().rig, "strings");
    let mut expected = 4; // control of the second tick; that of the first is read here
    assert_eq!(viewer.next_of(Kind::Control).await.sequence, 2);
    let tick = agent.tick();
    agent.send(tick, false).await;
    for _ in 0..100 {
        let got = viewer.next_of(Kind::Control).await;
        expected += 1;
        assert_eq!(got.sequence, expected, "history, then live");
        expected += 2;
    }
    let mut fresh = ground.view("iris-1", 0).await;
    let first = fresh.next_of(Kind::Control).await;
    assert_eq!(first.sequence, expected - 2, "without history: only the latest");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_past_is_asked_for_apart_and_the_newest_state_does_not_wait_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    // A minute of a topic: far more than a chart has columns.
    for n in 1..=6000_u64 {
        let sample = v1::HeightSample { time_us: n * 10_000, sensed_m: 0.5 + n as f64 * 1e-4, ..Default::default() };
        agent.time_us = n * 10_000;
        agent.say(Kind::Height, 1, &sample).await;
    }
    let mut viewer = ground.view("iris-1", 0).await;
    while viewer.next_of(Kind::Height).await.sequence != agent.sequence {}
    // The first messages of a connection: the link, with the flight time that its age is the age of, and the newest.
    let mut fresh = ground.view("iris-1", 0).await;
    let link = fresh.next_of(Kind::Link).await.message::<v1::LinkStatus>();
    assert_eq!(link.newest_time_us, agent.time_us);
    assert_eq!(fresh.next_of(Kind::Height).await.sequence, agent.sequence);
    let past = ground.get("/api/v1/vehicles/iris-1/history?seconds=60").await;
    assert_eq!(past.status, 200);
    let frames = plumbline_proto::codec::decode_batch(&past.body).unwrap().map(Result::unwrap);
    let heights: Vec<u64> = frames.filter(|f| f.known_kind() == Some(Kind::Height)).map(|f| f.sequence).collect();
    assert!((900..=962).contains(&heights.len()), "{} heights", heights.len());
    assert!(heights.is_sorted() && heights.contains(&agent.sequence));
    for (path, status) in [("iris-1/history?seconds=0", 422), ("iris-1/history", 422), ("no/history?seconds=9", 404)] {
        assert_eq!(ground.get(&format!("/api/v1/vehicles/{path}")).await.status, status, "{path}");
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stalled_viewer_changes_nothing_for_nineteen_others() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    // A viewer is told the newest state first: from then on it misses nothing.
    let watching = async || {
        let mut viewer = ground.view("iris-1", 0).await;
        viewer.next_of(Kind::Description).await;
        viewer
    };
    let mut stalled = watching().await;
    let first = agent.sequence + 1;
    let messages = 4000_u64;
    let mut readers = Vec::new();
    let mut progress = Vec::new();
    for _ in 0..19 {
        let (read, seen) = watch::channel(0);
        readers.push(tokio::spawn(read_events(watching().await, messages, read)));
        progress.push(seen);
    }
    // 4000 messages of 4 kB are 16 MB: more than the queue and the socket buffers of one viewer hold.
    let text = "x".repeat(4000);
    for n in 0..messages {
        let event = v1::Event { time_us: n, kind: "warning".into(), text: text.clone(), severity: 1 };
        agent.say(Kind::Event, 0, &event).await;
        if n % 100 == 0 {
            // As fast as the slowest of the nineteen reads on this machine, 200 messages behind at most: it must miss none.
            for seen in &mut progress {
                let close = seen.wait_for(|read| read + 200 >= n);
                tokio::time::timeout(PATIENCE, close).await.expect("a reader that misses none").unwrap();
            }
        }
    }
    for reader in readers {
        let read = tokio::time::timeout(PATIENCE, reader).await.expect("a reader that misses none");
        assert_eq!(read.unwrap(), (first..first + messages).collect::<Vec<_>>(), "complete and in order");
    }
    // The stalled one reads at last: it lost the oldest and is told how many.
    let mut seen = 0;
    let mut dropped = 0;
    let mut newest = 0;
    while newest < first + messages - 1 {
        let got = stalled.next().await;
        match got.kind {
            Some(Kind::Event) => {
                seen += 1;
                newest = got.sequence;
            }
            Some(Kind::Link) => dropped = got.message::<v1::LinkStatus>().viewer_dropped,
            _ => {}
        }
    }
    while dropped == 0 {
        dropped = stalled.next_of(Kind::Link).await.message::<v1::LinkStatus>().viewer_dropped;
    }
    assert!(seen < messages, "the test must stall a viewer to say anything");
    // Ground-made messages in dropped batches count as well.
    assert!(dropped >= messages - seen && dropped < messages - seen + 200, "{dropped} dropped, {seen} seen");
    let told = ground.figure("viewer_dropped_total").await;
    assert!(told >= dropped as f64, "{told}, and this viewer alone missed {dropped}");
    ground.stop().await;
}

async fn read_events(mut viewer: Viewer, wanted: u64, read: watch::Sender<u64>) -> Vec<u64> {
    let mut sequences = Vec::new();
    while (sequences.len() as u64) < wanted {
        sequences.push(viewer.next_of(Kind::Event).await.sequence);
        read.send_replace(sequences.len() as u64);
    }
    sequences
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_kinds_are_passed_on() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let mut viewer = ground.view("iris-1", 0).await;
    let mut newer = Vec::new();
    plumbline_proto::codec::begin_batch(&mut newer);
    plumbline_proto::codec::Frame { kind: 999, instance: 3, sequence: 1, time_us: 1, payload: b"new" }
        .encode(&mut newer);
    let event = plumbline_ground::agent_link::LinkEvent::Batch {
        agent_id: "iris-1".into(),
        batch: Batch::parse(newer.into()).unwrap(),
        received: Instant::now(),
        backfill: false,
    };
    ground.send(event).await;
    agent.describe().await;
    // The batch above and the agent's own connection are two ways in: whichever of them comes first.
    let (mut unknown, mut described) = (None, false);
    while unknown.is_none() || !described {
        let got = viewer.next().await;
        described |= got.kind == Some(Kind::Description);
        if got.kind.is_none() {
            unknown = Some(got.payload);
        }
    }
    assert_eq!(unknown.as_deref(), Some(&b"new"[..]));
    ground.stop().await;
}

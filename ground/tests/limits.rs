//! Bounds hold: slow viewers, floods of commands, huge bodies, thousands of flights. Memory is measured, not guessed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "server/common/mod.rs"]
mod common;

use std::time::{Duration, Instant};

use common::Ground;
use plumbline_ground::GroundConfig;
use plumbline_ground::commands::MAX_WAITING;
use plumbline_proto::{Kind, v1};
use plumbline_support::memory_mib;

/// Memory is that of the whole process: one at a time.
static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

/// Resident memory of this process, MiB.
fn resident_mib() -> f64 {
    memory_mib(std::process::id(), "VmRSS")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_commands_is_refused_beyond_its_bound_and_the_rest_is_answered() {
    let _alone = ALONE.lock().await;
    let folder = tempfile::tempdir().unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.command_timeout = Duration::from_secs(3);
    let ground = Ground::start_with(config).await;
    // GIVEN an agent that reads no command
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    // WHEN many more come than may wait THEN those beyond are refused at once, and the others time out
    let flood = MAX_WAITING + 40;
    let asked = (0..flood).map(|_| ground.request("POST", "/api/v1/vehicles/iris-1/disarm", "{}"));
    let answers = futures_util::future::join_all(asked).await;
    let count = |status| answers.iter().filter(|answer| answer.status == status).count();
    assert_eq!(count(503) + count(504), flood);
    assert!(count(503) >= 40 && count(504) <= MAX_WAITING, "{} refused, {} timed out", count(503), count(504));
    // AND afterwards there is room again
    while agent.outgoing.try_recv().is_ok() {}
    let (answer, _) = tokio::join!(ground.request("POST", "/api/v1/vehicles/iris-1/disarm", "{}"), agent.accept());
    assert_eq!(answer.status, 200, "{}", answer.text());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn huge_bodies_are_refused_and_not_kept() {
    let _alone = ALONE.lock().await;
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let _agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let before = resident_mib();
    let huge = format!("{{\"attacks\":[{}]}}", " ".repeat(8 << 20));
    for (method, path) in [
        ("PUT", "/api/v1/vehicles/iris-1/attacks"),
        ("PATCH", "/api/v1/flights/f"),
        ("POST", "/api/v1/session"),
        ("POST", "/login"),
    ] {
        for _ in 0..5 {
            let mut stream = tokio::net::TcpStream::connect(ground.address).await.unwrap();
            let request = format!(
                "{method} {path} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\ncontent-length: {}\r\n\r\n{huge}",
                ground.address,
                huge.len()
            );
            // The ground may answer and hang up before it was sent everything.
            let answer = common::exchange(&mut stream, &request).await;
            if answer.starts_with(b"HTTP") {
                let status = common::Response::parse(&answer).status;
                assert!([413, 422, 429].contains(&status), "{method} {path}: {status}");
            }
        }
    }
    let grown = resident_mib() - before;
    // Twenty bodies of 8 MiB; this test's own copies of one or two of them remain.
    assert!(grown < 64.0, "{grown:.0} MiB more");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_that_stop_reading_cost_a_bounded_queue_each() {
    let _alone = ALONE.lock().await;
    const STALLED: usize = 5;
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let mut stalled = Vec::new();
    for _ in 0..STALLED {
        stalled.push(ground.view("iris-1", 0).await);
    }
    let mut reader = ground.view("iris-1", 0).await;
    let before = resident_mib();
    // 64 MiB of telemetry: many times what may wait for a viewer (4 MiB), as much as the history holds.
    let text = "x".repeat(8 << 10);
    let mut newest = 0;
    for n in 0..8_192_u64 {
        agent.time_us = n * 1000;
        let event = v1::Event { time_us: agent.time_us, text: text.clone(), ..Default::default() };
        newest = agent.say(Kind::Event, 0, &event).await;
        agent.log.last_mut().unwrap().1.clear();
        if n % 64 == 0 {
            while let Ok(got) = tokio::time::timeout(Duration::from_millis(1), reader.next()).await {
                if got.sequence + 64 >= newest {
                    break;
                }
            }
        }
    }
    while reader.next().await.sequence < newest {}
    let grown = resident_mib() - before;
    println!(
        "{{\"limits\":\"viewers\",\"name\":\"memory\",\"value\":{grown:.1},\"unit\":\"MiB\",\"stalled\":{STALLED}}}"
    );
    // History (64 MiB) and recorder's recent messages once, 4 MiB and socket buffers for each stalled viewer, twice that
    // for the allocator.
    assert!(grown < 2.0 * (64.0 + 8.0 + STALLED as f64 * 8.0), "{grown:.0} MiB more");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn thousands_of_flights_are_indexed_and_listed_in_bounded_time_and_memory() {
    let _alone = ALONE.lock().await;
    // More by hand: `PLUMBLINE_FLIGHTS=5000`.
    let flown: usize = std::env::var("PLUMBLINE_FLIGHTS").map_or(500, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    for _ in 0..20 {
        let tick = agent.tick();
        agent.send(tick, false).await;
    }
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;
    ground.stop().await;
    let flights = folder.path().join("flights");
    for n in 0..flown {
        std::fs::copy(flights.join("f1.mcap"), flights.join(format!("copy-{n}.mcap"))).unwrap();
    }
    for file in ["index.sqlite", "index.sqlite-wal", "index.sqlite-shm"] {
        let _ = std::fs::remove_file(folder.path().join(file));
    }
    let before = resident_mib();
    let begun = Instant::now();
    let ground = Ground::start(folder.path()).await;
    let list = ground.wait_json("/api/v1/flights", |list| list["ready"] == true).await;
    let indexed_s = begun.elapsed().as_secs_f64();
    assert_eq!(list["total"], flown + 1);
    assert_eq!(list["flights"].as_array().unwrap().len(), plumbline_rest::flight::PAGE, "one page of them");
    let begun = Instant::now();
    ground.json("/api/v1/flights").await;
    let listed_s = begun.elapsed().as_secs_f64();
    let grown = resident_mib() - before;
    println!(
        "{{\"limits\":\"flights\",\"name\":\"index_rebuilt\",\"value\":{indexed_s:.2},\"unit\":\"s\",\"flights\":{flown},\
         \"list_s\":{listed_s:.3},\"memory_mib\":{grown:.1}}}"
    );
    assert!(grown < 100.0, "{grown:.0} MiB more");
    ground.stop().await;
}

//! However long the keeper merges, what comes live is in its file within a flush, and memory stays bounded.
//!
//! A program of its own: the memory measured is that of the whole process.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "server/common/mod.rs"]
mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use common::agent::BOOT_WALL_US;
use common::{Ground, PATIENCE, mcap_counts};

/// The promise: a kill costs at most the last flush.
const AGE_MAX: Duration = Duration::from_millis(250);
/// One look in fifty may find this instead: a machine that compiles beside us stops everybody for a moment. The merging,
/// if it held up the recording, would for seconds.
const AGE_MAX_ONCE: Duration = Duration::from_secs(1);
/// What merging may take beyond what was there before: chunks of 1 MiB being read and written, and their compression.
const GROWN_MAX_MIB: f64 = 48.0;
/// Two parts that a crash left, of this much each: they are merged for seconds on a fast machine too.
const PART_MESSAGES: u32 = 240_000;
const MESSAGE_BYTES: usize = 1_000;

/// Most memory this process ever held, MiB.
fn peak_mib() -> f64 {
    let peak_mib = plumbline_support::memory_mib(std::process::id(), "VmHWM");
    assert!(peak_mib > 0.0);
    peak_mib
}

/// A part of flight `long` as a killed ground leaves it: no summary.
fn leave_part(flights: &Path, number: u32) {
    let path = flights.join(format!("long.{number:03}.part"));
    let options = mcap::WriteOptions::new().chunk_size(Some(1 << 20)).disable_seeking(true).compression_threads(0);
    let mut part = options.create(mcap::write::NoSeek::new(std::fs::File::create(path).unwrap())).unwrap();
    let metadata = BTreeMap::from([
        ("flight_id".to_owned(), "long".to_owned()),
        ("agent_id".to_owned(), "iris-2".to_owned()),
        ("boot_id".to_owned(), "77".to_owned()),
        ("boot_wall_time_us".to_owned(), BOOT_WALL_US.to_string()),
        ("first_sequence".to_owned(), "1".to_owned()),
    ]);
    part.write_metadata(&mcap::records::Metadata { name: "plumbline".into(), metadata }).unwrap();
    let channel = part.add_channel(0, "/unknown/900/0", "protobuf", &BTreeMap::new()).unwrap();
    let mut noise = u64::from(number);
    let mut data = vec![0; MESSAGE_BYTES];
    for n in 0..PART_MESSAGES {
        // Xorshift: all eight bytes are noise, which does not compress.
        for eight in data.chunks_exact_mut(8) {
            noise ^= noise << 13;
            noise ^= noise >> 7;
            noise ^= noise << 17;
            eight.copy_from_slice(&noise.to_le_bytes());
        }
        let sequence = (number - 1) * PART_MESSAGES + n + 1;
        let log_time = (BOOT_WALL_US + u64::from(sequence) * 1000) * 1000;
        let header = mcap::records::MessageHeader { channel_id: channel, sequence, log_time, publish_time: log_time };
        part.write_to_known_channel(&header, &data).unwrap();
    }
    part.flush().unwrap();
    // Dropped, it would be finished.
    std::mem::forget(part);
}

/// The newest message in the parts of flight `live`.
fn newest(flights: &Path) -> u32 {
    let parts = std::fs::read_dir(flights).unwrap().flatten().map(|entry| entry.path());
    let live = parts.filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with("live."));
    let newest_of = |path: std::path::PathBuf| {
        let bytes = std::fs::read(path).unwrap_or_default();
        let options = mcap::read::Options::IgnoreEndMagic.into();
        let Ok(messages) = mcap::MessageStream::new_with_options(&bytes, options) else { return 0 };
        messages.map_while(Result::ok).map(|message| message.sequence).max().unwrap_or(0)
    };
    live.map(newest_of).max().unwrap_or(0)
}

#[tokio::test(flavor = "multi_thread")]
async fn live_messages_are_flushed_in_time_while_a_long_flight_is_merged() {
    // GIVEN a long flight in two parts, which the ground merges when it starts
    let folder = tempfile::tempdir().unwrap();
    let flights = folder.path().join("flights");
    std::fs::create_dir(&flights).unwrap();
    leave_part(&flights, 1);
    leave_part(&flights, 2);
    let before_mib = peak_mib();
    // AND which does not keep it from ending: what it has begun is done at the next start
    let ground = Ground::start(folder.path()).await;
    let merging = flights.join("long.merge.tmp");
    while !merging.exists() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let begun = Instant::now();
    ground.stop().await;
    let ended_s = begun.elapsed().as_secs_f64();
    assert!(ended_s < 2.0, "the ground took {ended_s} s to end");
    assert!(!merging.exists() && !flights.join("long.mcap").exists());
    let ground = Ground::start(folder.path()).await;
    // WHEN another one is flown meanwhile
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("live").await;
    let mut sent = BTreeMap::new();
    let mut ages = Vec::new();
    let begun = Instant::now();
    loop {
        for _ in 0..4 {
            let tick = agent.tick();
            let now = Instant::now();
            sent.extend(tick.iter().map(|sequence| (*sequence as u32, now)));
            agent.send(tick, false).await;
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let asked = Instant::now();
        sent = sent.split_off(&(newest(&flights) + 1));
        ages.push(sent.first_key_value().map_or(Duration::ZERO, |(_, at)| asked - *at));
        if ground.json("/api/v1/flights").await["ready"] == true {
            break;
        }
        assert!(begun.elapsed() < 3 * PATIENCE, "still merging");
    }
    let merged_s = begun.elapsed().as_secs_f64();
    ages.sort();
    let (oldest, most) = (ages[ages.len() - 1], ages[(ages.len() - 1) * 49 / 50]);
    // THEN every message was in its file within a flush, and merging took no memory to speak of
    let grown = peak_mib() - before_mib;
    println!(
        "{{\"limits\":\"merging\",\"name\":\"oldest_unflushed\",\"value\":{},\"unit\":\"ms\",\"p98\":{},\
         \"looked\":{},\"merging_s\":{merged_s:.2},\"memory_mib\":{grown:.1}}}",
        oldest.as_millis(),
        most.as_millis(),
        ages.len()
    );
    assert!(ages.len() >= 50, "looked {} times: too little", ages.len());
    assert!(merged_s > 2.0 * AGE_MAX_ONCE.as_secs_f64(), "merged within {merged_s} s: no trial of anything");
    assert!(most <= AGE_MAX && oldest <= AGE_MAX_ONCE, "a message waited {oldest:?}, one in fifty {most:?}");
    assert!(grown < GROWN_MAX_MIB, "{grown:.0} MiB more");
    // AND both flights are whole
    let last = agent.end("live", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/live", |flight| flight["completeness"] == "complete").await;
    let long = ground.json("/api/v1/flights/long").await;
    assert_eq!(long["messages"], 2 * PART_MESSAGES);
    let file = std::fs::read(flights.join("long.mcap")).unwrap();
    assert_eq!(mcap_counts(&file)["/unknown/900/0"], u64::from(2 * PART_MESSAGES));
    ground.stop().await;
}

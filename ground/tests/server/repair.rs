//! Whatever state the data folder is in, the ground starts and serves what can be read.

use std::path::Path;

use crate::common::{Ground, api_counts, mcap_counts};
use serde_json::Value;

fn complete(flight: &Value) -> bool {
    flight["completeness"] == "complete"
}

/// Records one flight and returns its file. Chunks are cut by pauses longer than a flush.
async fn record(folder: &Path) -> Vec<u8> {
    let ground = Ground::start(folder).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let first = agent.begin("f1").await;
    for _ in 0..4 {
        for _ in 0..10 {
            let tick = agent.tick();
            agent.send(tick, false).await;
        }
        tokio::time::sleep(std::time::Duration::from_millis(260)).await;
    }
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", complete).await;
    let file = ground.get("/api/v1/flights/f1/mcap").await.body;
    ground.stop().await;
    file
}

async fn start_on(name: &str, content: &[u8]) -> (tempfile::TempDir, Ground, Value) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("flights")).unwrap();
    std::fs::write(folder.path().join("flights").join(name), content).unwrap();
    let ground = Ground::start(folder.path()).await;
    let listed = ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    (folder, ground, listed)
}

/// Messages that whole chunks of `file` hold.
fn readable(file: &[u8]) -> u64 {
    let Ok(stream) = mcap::MessageStream::new_with_options(file, mcap::read::Options::IgnoreEndMagic.into()) else {
        return 0;
    };
    stream.map_while(Result::ok).count() as u64
}

/// Written and removed again, once a second, to see whether the folder takes files.
const PROBE: &str = "probe.tmp";

/// Messages that a ground serves of a file of that name cut there; what it left behind is looked at.
async fn held_after(name: &str, whole: &[u8], cut: usize) -> u64 {
    let (data, ground, listed) = start_on(name, &whole[..cut]).await;
    let flights = listed["flights"].as_array().unwrap();
    let held = match flights.as_slice() {
        [] => 0,
        [flight] => {
            let file = ground.get("/api/v1/flights/f1/mcap").await.body;
            assert_eq!(mcap_counts(&file), api_counts(flight), "cut at {cut}");
            assert!(mcap::Summary::read(&file).unwrap().unwrap().stats.is_some());
            assert_eq!(flight["missing"], 0, "only the end is missing");
            flight["messages"].as_u64().unwrap()
        }
        more => panic!("{more:?}"),
    };
    // The mcap crate also gives messages of the chunk that is cut; those have no checksum.
    let upper = readable(&whole[..cut]);
    assert!(held <= upper && held + 31 >= upper, "cut at {cut}: {held} of {upper}");
    let left: Vec<_> = std::fs::read_dir(data.path().join("flights")).unwrap().flatten().collect();
    let names: Vec<_> = left.iter().map(|e| e.file_name().into_string().unwrap()).collect();
    assert!(names.iter().all(|n| !n.ends_with(".part") && (!n.ends_with(".tmp") || n == PROBE)), "{names:?}");
    ground.stop().await;
    held
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_cut_anywhere_is_repaired_to_its_last_whole_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let whole = record(folder.path()).await;
    let all = readable(&whole);
    assert_eq!(all, 122);
    let step = (whole.len() / 60).max(1);
    let mut most = 0;
    for cut in (0..whole.len()).step_by(step).chain([whole.len() - 1, 1, 7, 8, 9]) {
        let (part, finished) = tokio::join!(held_after("f1.001.part", &whole, cut), held_after("f1.mcap", &whole, cut));
        most = most.max(part).max(finished);
    }
    assert_eq!(most, all, "a cut in the summary loses nothing");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_corrupted_chunk_is_left_out_named_and_the_rest_served() {
    let folder = tempfile::tempdir().unwrap();
    let whole = record(folder.path()).await;
    let chunk = mcap::Summary::read(&whole).unwrap().unwrap().chunk_indexes[1].clone();
    let mut bad = whole.clone();
    let inside = chunk.chunk_start_offset as usize + chunk.chunk_length as usize / 2;
    bad[inside..inside + 8].iter_mut().for_each(|b| *b ^= 0xff);
    let (data, ground, listed) = start_on("f1.mcap", &bad).await;
    let flight = &listed["flights"][0];
    let file = ground.get("/api/v1/flights/f1/mcap").await.body;
    assert_eq!(mcap_counts(&file), api_counts(flight));
    let (messages, missing) = (flight["messages"].as_u64().unwrap(), flight["missing"].as_u64().unwrap());
    assert!(messages < 122 && messages + missing == 122, "{flight:#}");
    assert_eq!(flight["completeness"], "filling", "the agent may still have it");
    assert_eq!(ground.json("/api/v1/ground").await["set_aside"], serde_json::json!(["f1.mcap.corrupt"]));
    assert_eq!(std::fs::read(data.path().join("flights/f1.mcap.corrupt")).unwrap(), bad, "evidence is kept");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rubbish_is_set_aside_and_the_others_are_served() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path()).await;
    let flights = folder.path().join("flights");
    std::fs::write(flights.join("rubbish.mcap"), b"this is not a flight").unwrap();
    std::fs::write(flights.join("zeros.001.part"), [0; 5000]).unwrap();
    std::fs::write(flights.join("old.merge.tmp"), b"half").unwrap();
    let ground = Ground::start(folder.path()).await;
    let listed = ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    assert_eq!(listed["flights"].as_array().unwrap().len(), 1);
    let aside = ground.json("/api/v1/ground").await["set_aside"].clone();
    assert_eq!(aside, serde_json::json!(["rubbish.mcap.corrupt", "zeros.001.part.corrupt"]));
    assert!(!flights.join("old.merge.tmp").exists());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_index_is_rebuilt_from_the_files_with_names_and_notes() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path()).await;
    let ground = Ground::start(folder.path()).await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    let body = r#"{"name":"step test","notes":"string slack at 0.9 m\nsecond line"}"#;
    let answer = ground.request("PATCH", "/api/v1/flights/f1", body).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let before = ground.json("/api/v1/flights/f1").await;
    assert_eq!(before["name"], "step test");
    ground.stop().await;
    for damage in ["removed", "damaged", "of another version"] {
        let index = folder.path().join("index.sqlite");
        match damage {
            "removed" => std::fs::remove_file(&index).unwrap(),
            "damaged" => std::fs::write(&index, [7; 9000]).unwrap(),
            _ => {
                let connection = rusqlite::Connection::open(&index).unwrap();
                connection
                    .execute_batch("PRAGMA user_version = 99; DROP TABLE flights; CREATE TABLE flights (x)")
                    .unwrap();
            }
        }
        let ground = Ground::start(folder.path()).await;
        ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
        assert_eq!(ground.json("/api/v1/flights/f1").await, before, "{damage}");
        ground.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn files_removed_or_added_by_hand_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let file = record(folder.path()).await;
    std::fs::remove_file(folder.path().join("flights/f1.mcap")).unwrap();
    std::fs::write(folder.path().join("flights/copied.mcap"), &file).unwrap();
    let ground = Ground::start(folder.path()).await;
    let listed = ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    let ids: Vec<_> = listed["flights"].as_array().unwrap().iter().map(|f| f["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["copied"]);
    assert_eq!(ground.get("/api/v1/flights/f1").await.status, 404);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_data_folder_serves_one_ground() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    ground.json("/api/v1/ground").await;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (_link, events) = tokio::sync::mpsc::channel(1);
    let config = plumbline_ground::GroundConfig::new(folder.path());
    let second = plumbline_ground::run(config, listener, events, std::future::pending()).await;
    assert!(second.unwrap_err().to_string().contains("in use by another ground"));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_room_for_merging_a_flight_is_read_as_it_is() {
    // GIVEN what a crash left of a flight, and a disk that has no room for a second copy of it
    let folder = tempfile::tempdir().unwrap();
    let whole = record(folder.path()).await;
    let flights = folder.path().join("flights");
    let (part, finished) = (flights.join("f1.001.part"), flights.join("f1.mcap"));
    std::fs::remove_file(&finished).unwrap();
    std::fs::write(&part, &whole[..whole.len() / 2]).unwrap();
    let left = readable(&whole[..whole.len() / 2]);
    let mut config = plumbline_ground::GroundConfig::new(folder.path());
    config.reserve_bytes = u64::MAX;
    // WHEN a ground starts THEN the flight is listed and read as it is, and nothing more is on the disk
    let ground = Ground::start_with(config).await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    assert_eq!(ground.json("/api/v1/flights/f1").await["messages"], left);
    assert_eq!(readable(&ground.get("/api/v1/flights/f1/mcap").await.body), left);
    ground.stop().await;
    assert!(part.exists() && !finished.exists() && !flights.join("f1.merge.tmp").exists());
    // AND it is repaired once there is room
    let ground = Ground::start(folder.path()).await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    assert_eq!(ground.json("/api/v1/flights/f1").await["messages"], left);
    ground.stop().await;
    assert!(!part.exists() && finished.exists());
}

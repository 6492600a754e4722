//! Nothing is lost: what the recorder writes is what the agent sent, whatever the link and the
//! ground did meanwhile.

use std::time::Duration;

use crate::common::agent::Agent;
use crate::common::viewer::frames;
use crate::common::{Ground, api_counts, freeze, mcap_counts};
use plumbline_ground::agent_link::LinkEvent;
use plumbline_proto::{Kind, v1};
use serde_json::Value;

fn complete(flight: &Value) -> bool {
    flight["completeness"] == "complete"
}

/// Ticks of a flight; `arrives` says which messages get through live.
async fn fly(agent: &mut Agent, ticks: u32, arrives: impl Fn(u64) -> bool) {
    for _ in 0..ticks {
        let tick: Vec<u64> = agent.tick().into_iter().filter(|s| arrives(*s)).collect();
        agent.send(tick, false).await;
    }
}

/// Flight `f1` ends, and is complete with every message since `first` once the agent has answered what it is asked.
async fn ends_whole(ground: &Ground, agent: &mut Agent, first: u64) {
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    agent.answering(ground.wait_json("/api/v1/flights/f1", complete)).await;
    check_whole(ground, agent, "f1", first, last).await;
}

/// The file, the API and the agent's log agree on every message.
async fn check_whole(ground: &Ground, agent: &Agent, id: &str, first: u64, last: u64) {
    let flight = ground.json(&format!("/api/v1/flights/{id}")).await;
    let expected = agent.counts(first, last);
    assert_eq!(api_counts(&flight), expected);
    assert_eq!(flight["messages"], last - first + 1);
    assert_eq!((flight["missing"].as_u64(), flight["first_sequence"].as_u64()), (Some(0), Some(first)));
    assert_eq!(flight["last_sequence"], last);
    let file = ground.get(&format!("/api/v1/flights/{id}/mcap")).await.body;
    assert_eq!(flight["size_bytes"], file.len());
    assert_eq!(mcap_counts(&file), expected);
    let stats = mcap::Summary::read(&file).unwrap().unwrap().stats.unwrap();
    assert_eq!(stats.message_count, last - first + 1);
    // Byte for byte what the agent encoded, in the order of time.
    let mut replayed = frames(&ground.get(&format!("/api/v1/flights/{id}/frames")).await.body);
    assert!(replayed.is_sorted_by_key(|f| f.time_us));
    replayed.sort_by_key(|f| f.sequence);
    let log: Vec<_> = agent.log[first as usize - 1..last as usize]
        .iter()
        .flat_map(|(_, bytes)| {
            let mut batch = vec![plumbline_proto::codec::MAGIC, plumbline_proto::SCHEMA];
            batch.extend_from_slice(bytes);
            frames(&batch)
        })
        .collect();
    assert_eq!(replayed, log);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_over_a_bad_link_becomes_complete() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    fly(&mut agent, 20, |_| true).await;
    let first = agent.begin("f1").await;
    // A third of the messages is lost, in bursts and singly.
    fly(&mut agent, 300, |s| s % 3 != 0 && !(400..600).contains(&s)).await;
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    fly(&mut agent, 20, |_| true).await;
    agent.answering(ground.wait_json("/api/v1/flights/f1", complete)).await;
    check_whole(&ground, &agent, "f1", first, last).await;
    let flight = ground.json("/api/v1/flights/f1").await;
    assert!(flight["filled"].as_u64().unwrap() > 300, "{flight:#}");
    assert_eq!(flight["live"].as_u64().unwrap() + flight["filled"].as_u64().unwrap(), last - first + 1);
    // The estimate is 0.1 m above the setpoint throughout.
    assert!((flight["tracking_rms_m"].as_f64().unwrap() - 0.1).abs() < 1e-9);
    let again = ground.json("/api/v1/flights").await;
    assert_eq!(again["flights"][0]["id"], "f1");
    assert_eq!(again["storage"]["flights"], 1);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_ends_or_shortens_another_s_recording() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    // GIVEN a vehicle in flight, whose radio loses a few messages, and another one that claims the same boot
    let mut agent = ground.agent("iris-1", 1).await;
    let mut other = ground.agent("iris-2", 1).await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 100, |s| !(40..60).contains(&s)).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "recording").await;
    // WHEN the other one says that this flight is over, began late, is not to be had, and is its own
    (0..200).for_each(|_| drop(other.tick()));
    let last = other.end("f1", first);
    other.send([last], false).await;
    other.begin("f1").await;
    for (first_sequence, last_sequence) in [(1, 30), (40, 59)] {
        let request = v1::BackfillRequest { flight_id: "f1".into(), first_sequence, last_sequence };
        ground.send(LinkEvent::BackfillUnavailable { agent_id: "iris-2".into(), request }).await;
    }
    other.status("f1", 0).await;
    // AND its own agent sends marks that are out of place: after the message they speak of, or of one that is here
    let mark = |first_sequence, last_sequence| v1::FlightMark {
        flight_id: "f1".into(),
        first_sequence,
        last_sequence,
        ..Default::default()
    };
    agent.say(Kind::Flight, 0, &mark(first, Some(50))).await;
    agent.say(Kind::Flight, 0, &mark(agent.sequence - 20, None)).await;
    fly(&mut agent, 100, |_| true).await;
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    // THEN the flight becomes complete, with every message
    agent.answering(ground.wait_json("/api/v1/flights/f1", complete)).await;
    check_whole(&ground, &agent, "f1", first, last).await;
    assert_eq!(ground.json("/api/v1/flights").await["flights"].as_array().unwrap().len(), 1);
    ground.stop().await;
    // AND so it is read again without the index
    for file in ["index.sqlite", "index.sqlite-wal", "index.sqlite-shm"] {
        let _ = std::fs::remove_file(folder.path().join(file));
    }
    let ground = Ground::start(folder.path()).await;
    ground.wait_json("/api/v1/flights/f1", complete).await;
    check_whole(&ground, &agent, "f1", first, last).await;
    // AND its name is not to be had for a flight of another vehicle
    let mut other = ground.agent("iris-2", 1).await;
    let begun = other.begin("f1").await;
    let last_of_other = other.end("f1", begun);
    other.send([last_of_other], false).await;
    other.begin("f2").await;
    ground.wait_json("/api/v1/flights/f2", |f| f["completeness"] == "recording").await;
    check_whole(&ground, &agent, "f1", first, last).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_around_a_late_opening_mark_are_in_the_flight() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let mark = v1::FlightMark { flight_id: "late".into(), first_sequence: 1, ..Default::default() };
    let opening = agent.encode(Kind::Flight, 0, &mark);
    // The radio delivers the first 30 messages before the mark, which takes a slower way.
    fly(&mut agent, 10, |_| true).await;
    agent.send([opening], false).await;
    let last = agent.end("late", 1);
    agent.send([last], false).await;
    // The agent answers nothing: all of it came live.
    ground.wait_json("/api/v1/flights/late", complete).await;
    check_whole(&ground, &agent, "late", 1, last).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_agent_has_lost_leaves_a_truncated_flight_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 50, |s| !(20..30).contains(&s)).await;
    agent.forgotten = (20..30).collect();
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    let truncated = |f: &Value| f["completeness"] == "truncated";
    let flight = agent.answering(ground.wait_json("/api/v1/flights/f1", truncated)).await;
    assert_eq!((flight["missing"].as_u64(), flight["messages"].as_u64()), (Some(10), Some(last - first + 1 - 10)));
    let file = ground.get("/api/v1/flights/f1/mcap").await.body;
    assert_eq!(mcap_counts(&file), api_counts(&flight));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_that_ended_out_of_reach_is_completed_when_the_agent_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 50, |_| true).await;
    agent.disconnect().await;
    for _ in 0..100 {
        agent.tick();
    }
    let last = agent.end("f1", first);
    // Out of reach the recording stays open: for all the ground knows, the flight goes on.
    tokio::time::sleep(Duration::from_millis(300)).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "recording").await;
    agent.reconnect(ground.link.clone()).await;
    agent.status("", 0).await;
    let talk = async {
        ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "filling" || complete(f)).await;
    };
    // The status contradicts the open flight; the ground looks for its end by itself.
    let mut beats = tokio::time::interval(Duration::from_millis(200));
    let mut talk = Box::pin(talk);
    loop {
        tokio::select! {
            () = &mut talk => break,
            _ = beats.tick() => {
                agent.time_us += 200_000;
                agent.status("", 0).await;
                while let Ok(outgoing) = agent.outgoing.try_recv() {
                    if let plumbline_ground::agent_link::Outgoing::Backfill(request) = outgoing {
                        agent.backfill(&request).await;
                    }
                }
            }
        }
    }
    drop(talk);
    agent.answering(ground.wait_json("/api/v1/flights/f1", complete)).await;
    check_whole(&ground, &agent, "f1", first, last).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ground_restarted_in_flight_completes_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 100, |_| true).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["messages"].as_u64() > Some(100)).await;
    ground.stop().await;
    for _ in 0..100 {
        agent.tick();
    }
    let ground = Ground::start(folder.path()).await;
    assert_eq!(
        ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await["flights"][0]["completeness"],
        "filling"
    );
    agent.reconnect(ground.link.clone()).await;
    agent.status("f1", 0).await;
    fly(&mut agent, 100, |_| true).await;
    ends_whole(&ground, &mut agent, first).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ground_killed_in_flight_loses_no_more_than_its_last_flush() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 100, |_| true).await;
    // The sequence number of 250 ms ago is in the files whenever the ground is killed.
    tokio::time::sleep(Duration::from_millis(450)).await;
    let safe = agent.sequence;
    fly(&mut agent, 10, |_| true).await;
    let killed = folder.path().join("killed");
    freeze(&folder.path().join("flights"), &killed.join("flights"));
    ground.stop().await;

    let ground = Ground::start(&killed).await;
    let listed = ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    let flight = &listed["flights"][0];
    assert_eq!((flight["id"].as_str(), flight["completeness"].as_str()), (Some("f1"), Some("filling")));
    assert!(flight["messages"].as_u64().unwrap() > safe - first, "{flight:#}");
    assert_eq!((flight["missing"].as_u64(), flight["vehicle_id"].as_str()), (Some(0), Some("iris-1")));
    let file = ground.get("/api/v1/flights/f1/mcap").await.body;
    assert_eq!(mcap_counts(&file), api_counts(flight));
    agent.reconnect(ground.link.clone()).await;
    ends_whole(&ground, &mut agent, first).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_agent_restarted_in_flight_ends_one_flight_and_begins_another() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut old = ground.agent("iris-1", 1).await;
    old.begin("old").await;
    fly(&mut old, 50, |_| true).await;
    let reached = old.sequence;
    // Another boot: sequence numbers and times begin again.
    let mut new = ground.agent("iris-1", 2).await;
    new.describe().await;
    let first = new.begin("new").await;
    fly(&mut new, 50, |_| true).await;
    let last = new.end("new", first);
    new.send([last], false).await;
    // The new agent does not have the old one's log.
    let nothing = |agent: &mut Agent| agent.log.clone();
    let kept = nothing(&mut new);
    let wait = async {
        ground.wait_json("/api/v1/flights/new", complete).await;
        ground.wait_json("/api/v1/flights/old", |f| f["completeness"] == "truncated").await
    };
    let mut wait = Box::pin(wait);
    let flight = loop {
        tokio::select! {
            flight = &mut wait => break flight,
            Some(outgoing) = new.outgoing.recv() => {
                if let plumbline_ground::agent_link::Outgoing::Backfill(request) = outgoing {
                    assert_eq!(request.flight_id, "old", "nothing of the new flight is missing");
                    assert_eq!((request.first_sequence, request.last_sequence), (reached + 1, u64::MAX));
                    let event = plumbline_ground::agent_link::LinkEvent::BackfillUnavailable { agent_id: "iris-1".into(), request };
                    ground.send(event).await;
                }
            }
        }
    };
    drop(wait);
    assert_eq!(new.log, kept);
    assert_eq!((flight["completeness"].as_str(), flight["messages"].as_u64()), (Some("truncated"), Some(reached)));
    check_whole(&ground, &new, "new", first, last).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_agents_record_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut one = ground.agent("one", 1).await;
    let mut two = ground.agent("two", 2).await;
    let a = one.begin("a").await;
    fly(&mut two, 7, |_| true).await;
    let b = two.begin("b").await;
    for _ in 0..50 {
        fly(&mut one, 1, |_| true).await;
        fly(&mut two, 2, |s| s % 5 != 0).await;
    }
    let a_last = one.end("a", a);
    one.send([a_last], false).await;
    let b_last = two.end("b", b);
    two.send([b_last], false).await;
    ground.wait_json("/api/v1/flights/a", complete).await;
    two.answering(ground.wait_json("/api/v1/flights/b", complete)).await;
    check_whole(&ground, &one, "a", a, a_last).await;
    check_whole(&ground, &two, "b", b, b_last).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unwritable_folder_is_loud_the_flight_goes_on_and_nothing_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    let flights = folder.path().join("flights");
    std::fs::remove_dir_all(&flights).unwrap();
    std::fs::write(&flights, b"in the way").unwrap();
    let said = ground.wait_json("/api/v1/ground", |g| g["recording_error"].is_string()).await;
    assert!(said["recording_error"].as_str().unwrap().contains("flights"), "{said}");

    let mut viewer = ground.view("iris-1", 0).await;
    let first = agent.begin("f1").await;
    fly(&mut agent, 50, |_| true).await;
    assert!(viewer.next_of(Kind::Control).await.sequence > first, "the live view goes on");
    let status: v1::RecordingStatus = loop {
        let status: v1::RecordingStatus = viewer.next_of(Kind::Recording).await.message();
        if !status.error.is_empty() {
            break status;
        }
    };
    assert!(!status.recording);

    std::fs::remove_file(&flights).unwrap();
    fly(&mut agent, 50, |_| true).await;
    ends_whole(&ground, &mut agent, first).await;
    assert!(ground.json("/api/v1/ground").await["recording_error"].is_null());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vehicle_that_is_lost_while_nothing_can_be_written_leaves_no_error_behind() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    // GIVEN a vehicle in flight of which nothing can be written, and which is lost
    let flights = folder.path().join("flights");
    std::fs::remove_dir_all(&flights).unwrap();
    std::fs::write(&flights, b"in the way").unwrap();
    let first = agent.begin("f1").await;
    fly(&mut agent, 5, |_| true).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "recording").await;
    ground.wait_json("/api/v1/ground", |g| g["recording_error"].is_string()).await;
    agent.disconnect().await;
    // WHEN the folder takes files again THEN that is seen without it
    std::fs::remove_file(&flights).unwrap();
    ground.wait_json("/api/v1/ground", |g| g["recording_error"].is_null()).await;
    // AND what it flew comes when it is back
    agent.reconnect(ground.link.clone()).await;
    ends_whole(&ground, &mut agent, first).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_data_folder_that_is_moved_away_is_missed_and_not_begun_anew() {
    let folder = tempfile::tempdir().unwrap();
    let (here, away) = (folder.path().join("data"), folder.path().join("away"));
    let ground = Ground::start(&here).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/flights", |f| f["ready"] == true).await;
    std::fs::rename(&here, &away).unwrap();
    let said = ground.wait_json("/api/v1/ground", |g| g["recording_error"].is_string()).await;
    assert!(said["recording_error"].as_str().unwrap().contains("data"), "{said}");
    let first = agent.begin("f1").await;
    fly(&mut agent, 50, |_| true).await;
    assert!(!here.exists(), "a second data folder was begun");
    std::fs::rename(&away, &here).unwrap();
    fly(&mut agent, 50, |_| true).await;
    ends_whole(&ground, &mut agent, first).await;
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_below_its_reserve_is_said_with_both_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = plumbline_ground::GroundConfig::new(folder.path());
    config.reserve_bytes = u64::MAX;
    let ground = Ground::start_with(config).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.begin("f1").await;
    fly(&mut agent, 5, |_| true).await;
    let said = ground.wait_json("/api/v1/ground", |g| g["recording_error"].is_string()).await;
    let text = said["recording_error"].as_str().unwrap();
    assert!(text.contains(&u64::MAX.to_string()) && text.contains("bytes are free"), "{text}");
    ground.stop().await;
}

//! The flights API: names, notes, deletion, CSV, frames, and flights in progress.

use crate::common::agent::Agent;
use crate::common::viewer::frames;
use crate::common::{Ground, PATIENCE, api_counts, mcap_counts};
use plumbline_proto::{Kind, v1};
use plumbline_rest::flight::{OVERVIEW_COLUMNS, OVERVIEW_KINDS};

async fn flown(ground: &Ground) -> (Agent, u64) {
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let first = agent.begin("f1").await;
    for _ in 0..40 {
        let tick = agent.tick();
        agent.send(tick, false).await;
    }
    let residual = |instance| v1::Residual {
        sensor: v1::SensorKind::Height as i32,
        instance,
        innovation: 0.25,
        ..Default::default()
    };
    let residuals =
        v1::Residuals { time_us: agent.time_us, residuals: vec![residual(1), residual(2)], ..Default::default() };
    agent.say(Kind::Residuals, 1, &residuals).await;
    (agent, first)
}

async fn land(ground: &Ground, agent: &mut Agent, first: u64) {
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn flights_are_named_annotated_and_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let (mut agent, first) = flown(&ground).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["messages"].as_u64() > Some(0)).await;
    let busy = ground.request("DELETE", "/api/v1/flights/f1", "").await;
    assert_eq!((busy.status, busy.error().as_str()), (409, "flight \"f1\" is being recorded"));
    let named = ground.request("PATCH", "/api/v1/flights/f1", r#"{"name":"in flight"}"#).await;
    assert_eq!(named.json()["name"], "in flight", "a flight can be named while it goes on");
    land(&ground, &mut agent, first).await;
    assert_eq!(ground.json("/api/v1/flights/f1").await["name"], "in flight", "and keeps the name when it ends");
    let noted = ground.request("PATCH", "/api/v1/flights/f1", r#"{"notes":"calm"}"#).await.json();
    assert_eq!((noted["name"].as_str(), noted["notes"].as_str()), (Some("in flight"), Some("calm")));

    let long = format!(r#"{{"name":"{}"}}"#, "x".repeat(201));
    let refused = ground.request("PATCH", "/api/v1/flights/f1", &long).await;
    assert_eq!((refused.status, refused.error().as_str()), (422, "name has 201 characters, limit 200"));
    assert_eq!(ground.request("PATCH", "/api/v1/flights/f1", r#"{"seed":1}"#).await.status, 422);
    for path in ["/api/v1/flights/none", "/api/v1/flights/none/mcap", "/api/v1/flights/..%2Findex.sqlite/mcap"] {
        assert_eq!(ground.get(path).await.status, 404, "{path}");
    }
    assert_eq!(ground.request("DELETE", "/api/v1/flights/none", "").await.status, 404);
    assert_eq!(ground.request("DELETE", "/api/v1/flights/f1", "").await.status, 204);
    assert_eq!(ground.get("/api/v1/flights/f1").await.status, 404);
    assert_eq!(ground.get("/api/v1/flights/f1/mcap").await.status, 404);
    let left: Vec<_> = std::fs::read_dir(folder.path().join("flights")).unwrap().flatten().collect();
    assert!(left.is_empty(), "{left:?}");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn csv_is_wide_or_by_topic() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let (mut agent, first) = flown(&ground).await;
    land(&ground, &mut agent, first).await;

    let wide = ground.get("/api/v1/flights/f1/csv").await;
    assert_eq!((wide.status, wide.header("content-type")), (200, Some("text/csv; charset=utf-8")));
    assert_eq!(wide.header("content-disposition"), Some("attachment; filename=\"f1.csv\""));
    let mut rows = csv::Reader::from_reader(wide.body.as_slice());
    let header = rows.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|h| h == name).unwrap_or_else(|| panic!("{name}: {header:?}"));
    let rows: Vec<_> = rows.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 21, "40 ticks of 5 ms are at most one row in 10 ms: bins 0 to 20");
    let second = &rows[1];
    assert_eq!(&second[0], "0.010000");
    assert_eq!(&second[column("control.mode")], "altitude_hold");
    assert_eq!(&second[column("control.setpoint.altitude_m")], "0.8");
    assert_eq!(&second[column("control.motor_command[3]")], "0.5");
    assert_eq!(&second[column("estimate_1.position_enu_m.z")], "0.9");
    assert_eq!(&second[column("height_2.sensed_m")], "0.81");
    assert_eq!(&second[column("height_2.received_m")], "", "not attacked: nothing else was received");

    let residuals = ground.get("/api/v1/flights/f1/csv?topic=/residuals/1").await;
    let text = residuals.text();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.len(), 3, "{text}");
    assert!(lines[0].starts_with("time_s,sequence,time_us,estimator,residuals.sensor,residuals.instance"), "{text}");
    assert!(lines[2].contains(",height,2,"), "{text}");
    let unknown = ground.get("/api/v1/flights/f1/csv?topic=/nothing").await;
    assert_eq!((unknown.status, unknown.error().as_str()), (404, "the flight has no topic \"/nothing\""));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_can_be_asked_for_by_kind() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let (mut agent, first) = flown(&ground).await;
    land(&ground, &mut agent, first).await;
    let some = frames(&ground.get("/api/v1/flights/f1/frames?kinds=height,residuals").await.body);
    assert_eq!(some.len(), 41);
    assert!(some.iter().all(|f| matches!(f.kind, Some(Kind::Height | Kind::Residuals))));
    assert_eq!((some[0].instance, some[0].time_us), (2, 5000));
    let none = frames(&ground.get("/api/v1/flights/f1/frames?kinds=gnss").await.body);
    assert!(none.is_empty());
    let wrong = ground.get("/api/v1/flights/f1/frames?kinds=height,psychic").await;
    assert_eq!((wrong.status, wrong.error().as_str()), (422, "kind \"psychic\" is not known"));

    let part = frames(&ground.get("/api/v1/flights/f1/frames?kinds=height&from_s=0.05&to_s=0.1").await.body);
    let start_us = some[0].time_us;
    assert!(!part.is_empty() && part.len() < 20, "{}", part.len());
    assert!(part.iter().all(|f| (45_000..=100_000).contains(&(f.time_us - start_us))), "{:?}", part[0].time_us);
    // Two stretches at most, as they need not begin with the flight: least and greatest of each, and one of residuals.
    let thinned = frames(&ground.get("/api/v1/flights/f1/frames?kinds=height,residuals&columns=1").await.body);
    assert!((3..=6).contains(&thinned.len()), "{}", thinned.len());
    for (query, why) in [
        ("columns=0", "columns 0 is outside 1 to 10000"),
        ("columns=10001", "columns 10001 is outside 1 to 10000"),
        ("from_s=2&to_s=1", "from_s 2 to to_s 1 is no range of time"),
    ] {
        let refused = ground.get(&format!("/api/v1/flights/f1/frames?{query}")).await;
        assert_eq!((refused.status, refused.error().as_str()), (422, why));
    }
    assert_eq!(ground.get("/api/v1/flights/f1/frames?colums=9").await.status, 422, "a misspelt one is not passed over");
    let overview = frames(&ground.get(&format!("/api/v1/flights/f1/{}", overview())).await.body);
    assert!(
        overview.len() > thinned.len() && !folder.path().join("flights/f1.overview").exists(),
        "too short to be kept"
    );
    ground.stop().await;
}

fn overview() -> String {
    format!("frames?kinds={OVERVIEW_KINDS}&columns={OVERVIEW_COLUMNS}")
}

#[tokio::test(flavor = "multi_thread")]
async fn what_charts_show_of_a_long_flight_is_kept_from_its_landing_on_and_goes_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let (mut agent, first) = flown(&ground).await;
    agent.time_us += 121_000_000;
    let tick = agent.tick();
    agent.send(tick, false).await;
    land(&ground, &mut agent, first).await;
    let kept = folder.path().join("flights/f1.overview");
    let begun = std::time::Instant::now();
    while !kept.exists() {
        assert!(begun.elapsed().as_secs() < 20, "nobody makes it");
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let asked = async || ground.get(&format!("/api/v1/flights/f1/{}", overview())).await.body;
    let sent = asked().await;
    // Asked for otherwise, the same is read from the flight.
    let backwards: Vec<_> = OVERVIEW_KINDS.rsplit(',').collect();
    let read = format!("/api/v1/flights/f1/frames?kinds={}&columns={OVERVIEW_COLUMNS}", backwards.join(","));
    assert_eq!(sent, ground.get(&read).await.body);
    let file = std::fs::read(&kept).unwrap();
    let head = file.len() - sent.len();
    assert_eq!((&file[head..], file.iter().position(|byte| *byte == b'\n')), (&*sent, Some(head - 1)));
    // What is kept is what is sent; what is of another file, or half there, is made anew.
    std::fs::write(&kept, [&file[..head], b"kept"].concat()).unwrap();
    assert_eq!(asked().await, b"kept");
    for other in [&b"\"1.2.3\" 0.1.0\nother"[..], &file[..head / 2], b""] {
        std::fs::write(&kept, other).unwrap();
        assert_eq!((asked().await, std::fs::read(&kept).unwrap()), (sent.clone(), file.clone()));
    }
    assert_eq!(ground.request("DELETE", "/api/v1/flights/f1", "").await.status, 204);
    let left: Vec<_> = std::fs::read_dir(folder.path().join("flights")).unwrap().flatten().collect();
    assert!(left.is_empty(), "{left:?}");
    // One whose flight somebody took away goes at the next start.
    std::fs::write(&kept, &file).unwrap();
    ground.stop().await;
    let ground = Ground::start(folder.path()).await;
    ground.wait_json("/api/v1/flights", |flights| flights["ready"] == true).await;
    assert!(!kept.exists());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_in_progress_can_be_downloaded() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let (mut agent, first) = flown(&ground).await;
    let sent = agent.sequence - first + 1;
    let flight = ground.wait_json("/api/v1/flights/f1", |f| f["messages"].as_u64() == Some(sent)).await;
    // What is counted is in its file within a flush.
    let begun = std::time::Instant::now();
    while mcap_counts(&ground.get("/api/v1/flights/f1/mcap").await.body) != api_counts(&flight) {
        assert!(begun.elapsed() < PATIENCE, "{flight:#}");
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(ground.json("/api/v1/flights/f1").await["completeness"], "recording");
    land(&ground, &mut agent, first).await;
    let left: Vec<_> =
        std::fs::read_dir(folder.path().join("flights")).unwrap().flatten().map(|e| e.file_name()).collect();
    assert_eq!(left, ["f1.mcap"], "snapshots leave nothing behind");
    ground.stop().await;
}

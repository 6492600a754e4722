//! Flights as tables: what is in them, and that others read them.

use std::path::Path;
use std::process::Command;

use crate::common::Ground;
use plumbline_proto::{Kind, v1};
use plumbline_support::files;

/// Two seconds with an attack that begins after one of them, and an event there; the ground's folder of flights.
async fn flown(ground: &Ground) {
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    agent.fly(200).await;
    let attack = v1::Attack {
        id: 1,
        sensor: v1::SensorKind::Height as i32,
        instance: 2,
        kind: v1::AttackKind::Bias as i32,
        magnitude: 0.5,
        ..Default::default()
    };
    let progress =
        v1::AttackProgress { attack: Some(attack), phase: v1::AttackPhase::Active as i32, ..Default::default() };
    agent.say(Kind::Attacks, 0, &v1::AttackState { attacks: vec![progress], ..Default::default() }).await;
    let text = "height 2, \"bias\" of 0.5 m".to_owned();
    agent.say(Kind::Event, 0, &v1::Event { kind: "attack".into(), text, ..Default::default() }).await;
    agent.fly(200).await;
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;
}

async fn table(ground: &Ground, query: &str) -> Vec<Vec<String>> {
    let answer = ground.get(&format!("/api/v1/flights/f1/csv?{query}")).await;
    assert_eq!(answer.status, 200, "{query}: {}", answer.text());
    let mut rows = csv::ReaderBuilder::new().has_headers(false).from_reader(answer.body.as_slice());
    rows.records().map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_table_has_the_columns_the_range_and_the_rate_that_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let all = table(&ground, "rate_hz=0").await;
    assert_eq!(all.len(), 401, "every control tick, and the names");
    let some =
        table(&ground, "columns=height_2.sensed_m,control.motor_command,attacks,events&from_s=0.9&to_s=1.1&rate_hz=50")
            .await;
    let motors = (0..4).map(|n| format!("control.motor_command[{n}]"));
    let names: Vec<String> = std::iter::once("time_s".into())
        .chain(motors)
        .chain(["height_2.sensed_m", "attacks.active", "attacks.what", "events"].map(str::to_owned))
        .collect();
    assert_eq!(some[0], names);
    assert!((10..=12).contains(&(some.len() - 1)), "{} rows", some.len());
    let times: Vec<f64> = some[1..].iter().map(|row| row[0].parse().unwrap()).collect();
    assert!(times[0] >= 0.9 && *times.last().unwrap() <= 1.1, "{times:?}");
    let told: Vec<_> = some[1..].iter().filter(|row| !row[8].is_empty()).collect();
    assert_eq!(told.len(), 1, "an event is in one row");
    assert_eq!(told[0][8], "attack: height 2, \"bias\" of 0.5 m");
    assert_eq!((told[0][6].as_str(), told[0][7].as_str()), ("1", "height 2 all bias 0.5"));
    assert_eq!((some[1][6].as_str(), some[1][7].as_str(), some.last().unwrap()[6].as_str()), ("0", "", "1"));
    for (query, status, named) in [
        ("csv?columns=control,colour", 422, "colour"),
        ("csv?from_s=2&to_s=1", 422, "from_s 2"),
        ("csv?rate_hz=-1", 422, "rate_hz -1"),
        ("csv?rate_hz=fast", 422, "rate_hz"),
        ("csv?topic=/control&rate_hz=7", 422, "topic"),
        ("parquet?topic=/control", 422, "topic"),
        ("mat?range=1", 422, "range"),
    ] {
        let answer = ground.get(&format!("/api/v1/flights/f1/{query}")).await;
        assert_eq!(answer.status, status, "{query}: {}", answer.text());
        assert!(answer.error().contains(named), "{query}: {}", answer.error());
    }
    ground.stop().await;
}

/// GIVEN a flight with residuals, the secure estimator's account and a status WHEN a table is asked for THEN they have columns per sensor,
/// with their units, and hold until their sensor is named again; residuals where they are asked for.
#[tokio::test(flavor = "multi_thread")]
async fn residuals_and_the_attacked_set_are_columns_of_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    agent.fly(10).await;
    let height = v1::Residual {
        sensor: v1::SensorKind::Height as i32,
        instance: 2,
        channel: v1::Channel::Height as i32,
        innovation: -0.25,
        sigma: 0.1,
        gate: 0.5,
        ratio: 0.5,
        accepted: true,
    };
    let gyro = v1::Residual {
        sensor: v1::SensorKind::Imu as i32,
        instance: 1,
        channel: v1::Channel::GyroX as i32,
        innovation: 0.01,
        accepted: false,
        ..height
    };
    let sensor = |flagged| v1::SecureSensor {
        sensor: v1::SensorKind::Height as i32,
        instance: 2,
        present: true,
        flagged,
        reason: v1::FlagReason::Drift as i32,
        drift_ratio: 1.5,
        ..Default::default()
    };
    let margin = v1::SecureMargin { sensor: v1::SensorKind::Height as i32, present: 3, flagged: 1, margin: 1 };
    let flight_id = "f1".to_owned();
    let status = v1::Status { mode: v1::Mode::Hold as i32, battery_v: 11.5, flight_id, ..Default::default() };
    agent.say(Kind::Residuals, 9, &v1::Residuals { residuals: vec![height, gyro], ..Default::default() }).await;
    let secure = v1::SecureStatus {
        sensors: vec![sensor(true)],
        margins: vec![margin],
        height_bound_m: Some(0.06),
        ..Default::default()
    };
    agent.say(Kind::Secure, 0, &secure).await;
    agent.say(Kind::Status, 0, &status).await;
    agent.fly(10).await;
    // From now on of the gyroscope alone: the height keeps what it had.
    let later = v1::Residual { innovation: 0.02, ..gyro };
    agent.say(Kind::Residuals, 9, &v1::Residuals { residuals: vec![later], ..Default::default() }).await;
    agent.fly(10).await;
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;

    let asked = table(&ground, "rate_hz=0&columns=residuals_9,secure,status.mode,status.battery_v").await;
    let column = |name: &str| {
        let at = asked[0].iter().position(|column| column == name).unwrap_or_else(|| panic!("{name}: {:?}", asked[0]));
        asked[1..].iter().map(|row| row[at].clone()).collect::<Vec<_>>()
    };
    let told = |name: &str| [0, 15, 29].map(|row| column(name)[row].clone());
    assert_eq!(told("residuals_9.height_2.height.innovation_m"), ["", "-0.25", "-0.25"]);
    assert_eq!(told("residuals_9.imu_1.gyro_x.innovation_radps"), ["", "0.01", "0.02"]);
    assert_eq!(told("residuals_9.imu_1.gyro_x.gate_radps")[1], "0.5");
    assert_eq!(told("residuals_9.height_2.height.ratio")[2], "0.5");
    assert_eq!(told("residuals_9.imu_1.gyro_x.accepted")[1], "false");
    assert_eq!(told("secure.height_2.flagged"), ["", "true", "true"]);
    assert_eq!(told("secure.height_2.reason")[1], "drift");
    assert_eq!(told("secure.height.margin"), ["", "1", "1"]);
    assert_eq!(told("secure.height_bound_m")[2], "0.06");
    assert_eq!((told("status.mode")[1].as_str(), told("status.battery_v")[1].as_str()), ("hold", "11.5"));

    let narrow = table(&ground, "columns=residuals_9.height_2,secure.height_2.flagged").await;
    assert!(narrow[0].len() == 7 && narrow[0].iter().all(|name| !name.contains("gyro")), "{:?}", narrow[0]);
    let usual = table(&ground, "").await;
    let has = |begin: &str| usual[0].iter().any(|name| name.starts_with(begin));
    assert!(has("secure.height_2.") && has("status.mode") && !has("residuals_9"), "{:?}", usual[0]);
    let refused = ground.get("/api/v1/flights/f1/csv?columns=residuals_9.height_7").await;
    assert!(refused.status == 422 && refused.error().contains("height_7"), "{}", refused.text());
    let parquet = ground.get("/api/v1/flights/f1/parquet?columns=residuals_9").await.body;
    let text = String::from_utf8_lossy(&parquet);
    assert!(text.contains("\"residuals_9.imu_1.gyro_x.innovation_radps\":\"rad/s\""), "units");
    ground.stop().await;
}

/// GIVEN exports of a flight WHEN their tags are shown again THEN they are not sent, until what they are made of has changed.
#[tokio::test(flavor = "multi_thread")]
async fn an_export_that_a_client_has_is_not_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let known = async |path: &str, tags: &str| {
        ground.request_as("GET", &format!("/api/v1/{path}"), "", &[("if-none-match", tags)]).await
    };
    let mut tags = std::collections::BTreeMap::new();
    for path in [
        "flights/f1/csv",
        "flights/f1/csv?rate_hz=50",
        "flights/f1/csv?columns=control",
        "flights/f1/csv?to_s=1",
        "flights/f1/csv?topic=/control",
        "flights/f1/parquet",
        "flights/f1/mat",
        "flights/f1/ros2",
        "flights/f1/frames",
        "flights/f1/frames?kinds=control",
        "flights/f1/frames?columns=9",
        "archive?ids=f1",
    ] {
        let first = known(path, "\"other\"").await;
        let tag = first.header("etag").unwrap_or_else(|| panic!("{path}: {}", first.head)).to_owned();
        assert!(first.status == 200 && !first.body.is_empty(), "{path}");
        for shown in [tag.clone(), format!("\"other\", W/{tag}"), "*".to_owned()] {
            let again = known(path, &shown).await;
            assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(tag.as_str())), "{path}");
        }
        assert!(tags.insert(tag, path).is_none(), "{path} has the tag of another");
    }
    assert_eq!(known("flights/f1/csv?columns=colour", "*").await.status, 422, "what is refused has no tag");
    assert_eq!(ground.figure("downloads_open").await, 0.0);
    // A name is in the archive, and in no table.
    assert_eq!(ground.request("PATCH", "/api/v1/flights/f1", "{\"name\":\"first\"}").await.status, 200);
    for (tag, path) in &tags {
        let status = if path.starts_with("archive") { 200 } else { 304 };
        assert_eq!(known(path, tag).await.status, status, "{path}");
    }
    // One that still grows is another a moment later.
    let mut agent = ground.agent("iris-2", 2).await;
    agent.begin("f2").await;
    let mut before = String::new();
    for ticks in [40, 80] {
        agent.fly(40).await;
        ground.wait_json("/api/v1/flights/f2", |f| f["messages"].as_u64() > Some(3 * ticks)).await;
        let now = known("flights/f2/csv?rate_hz=0", &before).await;
        assert_eq!(now.status, 200, "after {ticks} ticks");
        now.header("etag").unwrap().clone_into(&mut before);
    }
    assert_eq!(known("archive?ids=f1,f2", "*").await.header("etag"), None);
    ground.stop().await;
}

/// GIVEN the same table three times WHEN other people's readers open it THEN each finds the same in it.
#[tokio::test(flavor = "multi_thread")]
async fn others_read_what_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let mut paths = Vec::new();
    for format in ["csv", "parquet", "mat"] {
        let answer = ground.get(&format!("/api/v1/flights/f1/{format}?rate_hz=0")).await;
        assert_eq!(answer.status, 200, "{format}");
        let path = folder.path().join(format!("f1.{format}"));
        std::fs::write(&path, &answer.body).unwrap();
        paths.push(path);
    }
    ground.stop().await;
    let Some(python) = files::python_with("scipy.io, duckdb, polars") else { return };
    let three = [paths[0].as_path(), paths[1].as_path(), paths[2].as_path()];
    let found = files::tables_by(&python, three, "height_2.sensed_m", "events").unwrap();
    println!("{} {} {}", found["duckdb"]["version"], found["polars"]["version"], found["scipy"]["version"]);
    for reader in ["duckdb", "polars", "scipy"] {
        let table = &found[reader];
        for same in ["columns", "rows", "known", "texts"] {
            assert_eq!(table[same], found["csv"][same], "{reader}: {same}");
        }
        let difference = table["sum"].as_f64().unwrap() - found["csv"]["sum"].as_f64().unwrap();
        assert!(difference.abs() < 1e-9, "{reader}: {difference}");
    }
    assert_eq!(found["csv"]["rows"], 400);
    // Control comes before the first height: there is nothing to put beside it.
    assert_eq!(found["csv"]["known"], 399);
    let types = &found["duckdb"]["types"];
    let type_of = |name: &str| types[name].as_str().unwrap().to_owned();
    assert_eq!(
        [type_of("time_s"), type_of("control.armed"), type_of("control.mode"), type_of("control.time_us")],
        ["DOUBLE", "BOOLEAN", "VARCHAR", "BIGINT"]
    );
    for reader in ["duckdb", "scipy"] {
        assert_eq!(found[reader]["units"]["estimate_1.position_enu_m.z"], "m", "{reader}");
    }
    let at = found["scipy"]["event_time_s"][0].as_f64().unwrap();
    assert!((0.9..1.1).contains(&at), "{at}");
}

/// GIVEN the table as .mat WHEN Octave loads it THEN it finds what stands in the CSV.
#[tokio::test(flavor = "multi_thread")]
async fn octave_loads_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let rows = table(&ground, "rate_hz=0").await;
    let answer = ground.get("/api/v1/flights/f1/mat?rate_hz=0").await;
    let path = folder.path().join("f1.mat");
    std::fs::write(&path, &answer.body).unwrap();
    ground.stop().await;
    let name = "height_2.sensed_m";
    let Some(found) = files::table_by_octave(&path, name) else { return };
    let found = found.unwrap();
    println!("Octave {}", found["version"]);
    let at = rows[0].iter().position(|column| column == name).unwrap();
    let known: Vec<f64> = rows[1..].iter().filter_map(|row| row[at].parse().ok()).collect();
    // Texts are no rows of the matrix; what happened is told beside it.
    let columns: Vec<&str> = found["columns"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!((columns[0], columns.contains(&name)), ("time_s", true));
    assert_eq!(
        (found["rows"].as_u64(), found["known"].as_u64(), found["unit"].as_str()),
        (Some(400), Some(known.len() as u64), Some("m"))
    );
    let difference = found["sum"].as_f64().unwrap() - known.iter().sum::<f64>();
    assert!(difference.abs() < 1e-9, "{difference}");
    assert_eq!(found["event_text"][0], "attack: height 2, \"bias\" of 0.5 m");
    let told_s = found["event_time_s"].as_f64().or_else(|| found["event_time_s"][0].as_f64());
    assert!(told_s.is_some_and(|s| (0.9..1.1).contains(&s)), "{told_s:?}");
}

/// Messages in protobuf: sequence, time, topic, bytes.
fn protobuf(file: &[u8]) -> Vec<(u32, u64, String, Vec<u8>)> {
    let all = mcap::MessageStream::new(file).unwrap().map(|message| message.unwrap());
    let own = all.filter(|message| message.channel.message_encoding == "protobuf");
    let mut own: Vec<_> = own.map(|m| (m.sequence, m.log_time, m.channel.topic.clone(), m.data.into_owned())).collect();
    own.sort();
    own
}

/// GIVEN a flight for Foxglove WHEN the reader of MCAP opens it THEN it holds the flight's own messages, and where the vehicle was
/// in Foxglove's schemas.
#[tokio::test(flavor = "multi_thread")]
async fn others_read_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let answer = ground.get("/api/v1/flights/f1/foxglove").await;
    assert_eq!(answer.header("content-disposition"), Some("attachment; filename=\"f1.foxglove.mcap\""));
    let path = folder.path().join("f1.foxglove.mcap");
    std::fs::write(&path, &answer.body).unwrap();
    let part = ground.get("/api/v1/flights/f1/foxglove?from_s=0.5&to_s=1.0").await;
    let refused = ground.get("/api/v1/flights/f1/foxglove?columns=control").await;
    assert!(refused.status == 422 && refused.error().contains("columns"), "{}", refused.text());
    let flight = ground.json("/api/v1/flights/f1").await;
    let own = ground.get("/api/v1/flights/f1/mcap").await.body;
    ground.stop().await;
    let mut counts = crate::common::mcap_counts(&answer.body);
    let drawn = ["/tf", "/scene", "/log"].map(|topic| counts.remove(topic).unwrap_or_default());
    assert_eq!(counts, crate::common::api_counts(&flight), "the flight's own messages");
    // A transform for each estimate in the loop, a scene 20 times a second, each event.
    assert_eq!((drawn[0], drawn[2]), (400, 1));
    assert!((35..=41).contains(&drawn[1]), "{} scenes in 2 s", drawn[1]);
    assert_eq!(protobuf(&answer.body), protobuf(&own), "the same bytes, at the same times");
    let counts = crate::common::mcap_counts(&part.body);
    assert!((100..=101).contains(&counts["/tf"]) && counts["/control"] == counts["/tf"], "{counts:?}");
    let inspected = plumbline_ground::recorder::inspect(&path).unwrap();
    assert_eq!((inspected.flight_id.as_str(), inspected.damage), ("", None), "it is no flight file");
    let Some(python) = files::python_with("mcap_protobuf.decoder") else { return };
    let found = files::scene_by(&python, &path).unwrap();
    println!("mcap {}", found["version"]);
    let channels = &found["channels"];
    for (topic, schema, messages) in [
        ("/tf", "foxglove.FrameTransform", drawn[0]),
        ("/scene", "foxglove.SceneUpdate", drawn[1]),
        ("/log", "foxglove.Log", drawn[2]),
    ] {
        let channel = &channels[topic];
        assert_eq!(
            (channel["schema"].as_str(), channel["messages"].as_u64()),
            (Some(schema), Some(messages)),
            "{topic}"
        );
        assert_eq!(channel["encodings"], serde_json::json!(["json", "jsonschema"]), "{topic}");
    }
    assert_eq!(channels["/tf"]["off_m"], 0.0, "it is where the estimate in the loop is");
    assert_eq!(channels["/estimate/1"]["schema"], "plumbline.v1.Estimate");
    assert!(found["entities"].as_array().unwrap().contains(&"vehicle".into()), "{}", found["entities"]);
    assert_eq!(found["texts"], serde_json::json!(["height 2, \"bias\" of 0.5 m"]));
}

/// GIVEN a flight as a ROS 2 bag WHEN rosbags opens it THEN it finds every message, where the flight had one.
#[tokio::test(flavor = "multi_thread")]
async fn others_read_the_bag() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let answer = ground.get("/api/v1/flights/f1/ros2").await;
    assert_eq!(answer.header("content-disposition"), Some("attachment; filename=\"f1.ros2.mcap\""));
    let path = folder.path().join("f1.ros2.mcap");
    std::fs::write(&path, &answer.body).unwrap();
    let refused = ground.get("/api/v1/flights/f1/ros2?rate_hz=5").await;
    assert!(refused.status == 422 && refused.error().contains("rate"), "{}", refused.text());
    // Of a range it has what lies between both ends.
    let mut agent = ground.agent("iris-2", 2).await;
    let first = agent.begin("f2").await;
    for _ in 0..4 {
        agent.time_us += 100_000;
        agent.say(Kind::Estimate, 1, &v1::Estimate { time_us: agent.time_us, ..Default::default() }).await;
    }
    say_each(&mut agent).await;
    let last = agent.end("f2", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f2", |f| f["completeness"] == "complete").await;
    let part = ground.get("/api/v1/flights/f2/ros2?from_s=0.15&to_s=0.35").await;
    assert_eq!(crate::common::mcap_counts(&part.body).into_values().sum::<u64>(), 2);
    let each_kind = folder.path().join("f2.ros2.mcap");
    std::fs::write(&each_kind, ground.get("/api/v1/flights/f2/ros2").await.body).unwrap();
    ground.stop().await;
    let counts = crate::common::mcap_counts(&answer.body);
    let each = |topic: &str| counts.get(topic).copied().unwrap_or_default();
    assert_eq!(
        [each("/estimate/ekf_bias"), each("/height_2/sensed"), each("/height_2/received"), each("/rosout")],
        [400, 400, 400, 1]
    );
    let Some(python) = files::python_with("rosbags.highlevel") else { return };
    let found = files::bag_by(&python, &path).unwrap();
    println!("rosbags {}", found["version"]);
    for (topic, count) in &counts {
        assert_eq!(found["topics"][topic]["messages"], *count, "{topic}");
    }
    let estimate = &found["topics"]["/estimate/ekf_bias"];
    assert_eq!(
        (estimate["frame"].as_str(), estimate["z"].as_f64(), &estimate["stamped"]),
        (Some("map"), Some(0.9), &true.into())
    );
    let range = found["topics"]["/height_2/sensed"]["range"].as_f64().unwrap();
    assert!((range - 0.81).abs() < 1e-6, "{range}");
    assert_eq!(found["topics"]["/rosout"]["text"], "height 2, \"bias\" of 0.5 m");
    let found = files::bag_by(&python, &each_kind).unwrap();
    let near = |topic: &str, expected: &[f64]| {
        let value = &found["topics"][topic]["value"];
        let values = value.as_array().cloned().unwrap_or_else(|| vec![value.clone()]);
        let same = |(v, e): (&serde_json::Value, &f64)| v.as_f64().is_some_and(|v| (v - e).abs() < 1e-6);
        assert!(values.len() == expected.len() && values.iter().zip(expected).all(same), "{topic}: {found}");
    };
    near("/barometer_1/sensed", &[98_100.0]);
    near("/barometer_1/received", &[98_000.0]);
    near("/mag_1/sensed", &[-4.3e-5]);
    near("/gnss_1/sensed", &[47.4, 8.5, 0.64, 0.64, 2.25]);
    assert!(found["topics"].get("/gnss_1/received").is_none(), "it was withheld: {found}");
    near("/scan_1", &[0.1, 0.0, 1.2, 0.8]);
    near("/battery", &[15.1, 0.8]);
    near("/motors/commanded", &[0.1, 0.2, 0.3, 0.4]);
    near("/motors/applied", &[0.1, 0.2, 0.3, 0.35]);
    near("/setpoint", &[0.8, std::f64::consts::FRAC_1_SQRT_2]);
    assert_eq!(
        found["topics"]["/tf"]["frames"],
        serde_json::json!({ "map base_link": 0.75, "base_link scan_1": -0.1 })
    );
}

/// One of each kind that a bag has a message for, and that the others did not say.
async fn say_each(agent: &mut crate::common::Agent) {
    let time_us = agent.time_us;
    let up = |z: f64| v1::Vector3 { z, ..Default::default() };
    let reading = |pressure_pa| v1::BarometerReading { pressure_pa, ..Default::default() };
    let barometer = v1::BarometerSample {
        time_us,
        reception: v1::Reception::Altered as i32,
        sensed: Some(reading(98_100.0)),
        received: Some(reading(98_000.0)),
        ..Default::default()
    };
    agent.say(Kind::Barometer, 1, &barometer).await;
    let sensed = v1::ImuReading { mag_ut: Some(up(-43.0)), ..Default::default() };
    agent.say(Kind::Imu, 1, &v1::ImuSample { time_us, sensed: Some(sensed), ..Default::default() }).await;
    let fix = v1::GnssReading {
        latitude_deg: 47.4,
        longitude_deg: 8.5,
        horizontal_sigma_m: 0.8,
        vertical_sigma_m: 1.5,
        ..Default::default()
    };
    let dropped = v1::Reception::Dropped as i32;
    let gnss = v1::GnssSample { time_us, reception: dropped, sensed: Some(fix), ..Default::default() };
    agent.say(Kind::Gnss, 1, &gnss).await;
    let scan = v1::Scan {
        time_us,
        first_angle_rad: -0.1,
        step_angle_rad: 0.1,
        range_mm: vec![0, 1200, 800],
        position_flu_m: Some(up(-0.1)),
        ..Default::default()
    };
    agent.say(Kind::Scan, 1, &scan).await;
    let flight_id = "f2".to_owned();
    let status = v1::Status { time_us, battery_v: 15.1, battery_fraction: 0.8, flight_id, ..Default::default() };
    agent.say(Kind::Status, 0, &status).await;
    let setpoint =
        v1::Setpoint { altitude_m: Some(0.8), yaw_rad: Some(std::f64::consts::FRAC_PI_2), ..Default::default() };
    let control = v1::Control {
        time_us,
        motor_command: vec![0.1, 0.2, 0.3, 0.4],
        motor_applied: vec![0.1, 0.2, 0.3, 0.35],
        setpoint: Some(setpoint),
        ..Default::default()
    };
    agent.say(Kind::Control, 0, &control).await;
    let (in_loop, position_enu_m) = (true, Some(up(0.75)));
    let estimate = v1::Estimate { time_us, in_loop, position_enu_m, ..Default::default() };
    agent.say(Kind::Estimate, 1, &estimate).await;
}

fn export(arguments: &[&str]) -> (bool, String) {
    let ran = Command::new(env!("CARGO_BIN_EXE_plumbline-ground")).arg("export").args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&ran.stdout).into_owned() + &String::from_utf8_lossy(&ran.stderr);
    (ran.status.success(), text)
}

fn file_of(flights: &str) -> String {
    format!("{flights}/f1.mcap")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_exports_without_a_ground_and_says_what_it_could_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    flown(&ground).await;
    let flights = folder.path().join("flights");
    let served = ground.get("/api/v1/flights/f1/csv").await.body;
    let drawn = ground.get("/api/v1/flights/f1/foxglove").await.body;
    ground.stop().await;
    let out = folder.path().join("out");
    let (flights, target) = (flights.to_str().unwrap(), out.to_str().unwrap());
    let (done, text) = export(&[flights, "--output", target]);
    assert!(done, "{text}");
    assert_eq!(std::fs::read(out.join("f1.csv")).unwrap(), served);
    // A file cut in the middle is exported as far as it goes.
    let whole = std::fs::read(Path::new(flights).join("f1.mcap")).unwrap();
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &whole[..whole.len() * 2 / 3]).unwrap();
    let (done, text) = export(&[cut.to_str().unwrap(), "--format", "parquet", "--output", target]);
    assert!(done && out.join("cut.parquet").exists(), "{text}");
    let noise = folder.path().join("noise.mcap");
    std::fs::write(&noise, "not a flight").unwrap();
    let file = file_of(flights);
    let file = file.as_str();
    // Of another version, and of another format: named as what they are, and no empty table comes of them.
    let newer = folder.path().join("newer.mcap");
    let mut changed = whole.clone();
    changed[5] = b'9';
    std::fs::write(&newer, &changed).unwrap();
    let bag = folder.path().join("bag");
    let (done, text) = export(&[file_of(flights).as_str(), "--format", "ros2", "--output", bag.to_str().unwrap()]);
    assert!(done, "{text}");
    let bag = bag.join("f1.ros2.mcap");
    let (done, text) = export(&[file_of(flights).as_str(), "--format", "foxglove", "--output", target]);
    assert!(done && std::fs::read(out.join("f1.foxglove.mcap")).unwrap() == drawn, "{text}");
    // A folder with what an export left there has no more flights than before.
    for _ in 0..2 {
        let (done, text) = export(&[flights, "--format", "ros2"]);
        assert!(done && text.lines().count() == 1 && text.contains("f1.ros2.mcap"), "{text}");
    }
    for (arguments, named) in [
        (vec![noise.to_str().unwrap()], "noise.mcap"),
        (vec![newer.to_str().unwrap()], "MCAP9"),
        (vec![bag.to_str().unwrap()], "no topic \"/control\""),
        (vec!["nowhere.mcap"], "nowhere.mcap"),
        (vec![file, "--columns", "colour"], "colour"),
        (vec![file, "--from-s", "3", "--to-s", "2"], "from_s 3"),
        (vec![file, "--format", "parquet", "--topic", "/control"], "csv"),
        (vec![file, "--format", "xls"], "parquet"),
        (vec![file, "--output", noise.to_str().unwrap()], "noise.mcap"),
    ] {
        let (done, text) = export(&arguments);
        assert!(!done && text.contains(named), "{arguments:?}: {text}");
    }
    let left: Vec<_> = std::fs::read_dir(&out).unwrap().flatten().map(|e| e.file_name()).collect();
    assert_eq!(left.len(), 3, "nothing unfinished stays: {left:?}");
}

//! Calibrations over HTTP: from an uploaded table, from a flight, refused with the reason, kept.

use crate::common::Ground;
use crate::common::agent::Agent;
use plumbline_core::calibration::{CalibrationFile, Kind};
use plumbline_proto::v1::command::Body;
use plumbline_proto::{Kind as Topic, v1};
use serde_json::json;

const BENCH: &str = "rpm,thrust_n,torque_nm\n3000,1.6,0.02\n4000,2.85,0.036\n5000,4.45,0.056\n6000,6.4,0.08\n";

#[tokio::test(flavor = "multi_thread")]
async fn a_table_becomes_a_calibration_that_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    assert_eq!(ground.json("/api/v1/calibrations").await, json!({ "calibrations": [], "total": 0 }));
    let body = json!({ "kind": "thrust", "csv": BENCH, "name": "bench.csv" }).to_string();
    let made = ground.request("POST", "/api/v1/calibrations", &body).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let made = made.json();
    assert_eq!((made["input"].as_str(), made["picture"].as_array().unwrap().len()), (Some("bench.csv"), 2));
    let k = made["parameters"][0]["value"].as_f64().unwrap();
    assert!((k / 1.62e-5 - 1.0).abs() < 0.02, "{k}");
    // Another of the same second has a name of its own.
    let second = ground.request("POST", "/api/v1/calibrations", &body).await.json();
    assert_ne!(made["id"], second["id"]);
    let list = ground.json("/api/v1/calibrations").await;
    assert_eq!(list["calibrations"].as_array().unwrap().len(), 2);
    assert!(list["calibrations"][0].get("picture").is_none());
    let page = ground.json("/api/v1/calibrations?offset=1&limit=1").await;
    assert_eq!((&page["total"], &page["calibrations"]), (&json!(2), &json!([list["calibrations"][1]])));
    let total =
        async |search: &str| ground.json(&format!("/api/v1/calibrations?search={search}")).await["total"].clone();
    assert_eq!([total("Bench").await, total("bench+shelf").await], [json!(2), json!(0)]);
    let id = made["id"].as_str().unwrap();
    assert_eq!(ground.json(&format!("/api/v1/calibrations/{id}")).await["covariance"], made["covariance"]);
    assert!(folder.path().join(format!("calibrations/{id}.json")).is_file());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_fitted_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    for (body, status, expected) in [
        (json!({ "kind": "soup" }), 422, "kind \"soup\" is not one of accelerometer"),
        (json!({ "kind": "thrust" }), 422, "one of flight, csv and vehicle"),
        (json!({ "kind": "thrust", "csv": "rpm,thrust_n\n1,1\n" }), 422, "thrust calibration refused: 1 points"),
        (json!({ "kind": "allan", "csv": BENCH }), 422, "uploaded.csv: no column t_s or time_s"),
        (json!({ "kind": "allan", "flight": "nowhere" }), 404, "nowhere"),
        (json!({ "kind": "allan", "flight": "../index" }), 404, "../index"),
        (json!({ "kind": "thrust", "csv": BENCH, "from_s": null }), 422, "null"),
        (json!({ "kind": "thrust", "csv": BENCH, "air_density_kgpm3": -1.0 }), 422, "air_density_kgpm3 is -1"),
        (json!({ "kind": "gyroscope", "csv": BENCH, "accelerometer": "x" }), 404, "no calibration \"x\""),
        (json!({ "kind": "thrust", "colour": "red" }), 422, "colour"),
    ] {
        let answer = ground.request("POST", "/api/v1/calibrations", &body.to_string()).await;
        assert_eq!(answer.status, status, "{body}: {}", answer.text());
        assert!(answer.error().contains(expected), "{body}: {}", answer.error());
    }
    assert_eq!(ground.get("/api/v1/calibrations/..%2F..%2Fx").await.status, 404);
    assert_eq!(ground.json("/api/v1/calibrations").await, json!({ "calibrations": [], "total": 0 }));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_is_read_by_the_agents_own_reader() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let first = agent.begin("f1").await;
    for _ in 0..40 {
        let tick = agent.tick();
        agent.send(tick, false).await;
    }
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;
    // Too short to hold an answer: the refusal shows that its samples were read.
    let body = json!({ "kind": "accelerometer", "flight": "f1" }).to_string();
    let answer = ground.request("POST", "/api/v1/calibrations", &body).await;
    assert_eq!(answer.status, 422, "{}", answer.text());
    assert!(answer.error().contains("needed") || answer.error().contains("f1"), "{}", answer.error());
    ground.stop().await;
}

/// The specific force of a vehicle whose up is there, with a little noise that repeats.
fn at_rest(up: [f64; 3], n: u64) -> v1::ImuReading {
    let noise = 0.01 * ((n * 7919 % 13) as f64 - 6.0) / 6.0;
    let vector = |[x, y, z]: [f64; 3]| Some(v1::Vector3 { x, y, z });
    v1::ImuReading {
        gyro_radps: vector([0.001 * noise, 0.0, 0.0]),
        accel_mps2: vector(up.map(|u| 9.81 * u + noise)),
        mag_ut: None,
        temperature_c: 25.0,
    }
}

/// Holds a pose for two seconds, at 100 Hz.
async fn hold(agent: &mut Agent, up: [f64; 3]) {
    let length = up.iter().map(|u| u * u).sum::<f64>().sqrt();
    let mut sequences = Vec::new();
    for _ in 0..200 {
        agent.time_us += 10_000;
        let sensed = Some(at_rest(up.map(|u| u / length), agent.time_us));
        let sample = v1::ImuSample { time_us: agent.time_us, sensed, ..Default::default() };
        sequences.push(agent.encode(Topic::Imu, 1, &sample));
    }
    agent.send(sequences, false).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn samples_taken_by_hand_are_counted_by_the_fit_and_fitted() {
    const TAKING: &str = "/api/v1/vehicles/iris-1/calibration";
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    hold(&mut agent, [0.0, 0.0, 1.0]).await;
    let status = |armed, time_us| v1::Status { time_us, armed, ..Default::default() };
    let begin = async |kind: &str| ground.request("POST", TAKING, &json!({ "kind": kind, "imu": 1 }).to_string()).await;
    // GIVEN nothing that is taken THEN that is the answer, and nothing can be fitted
    assert_eq!(ground.json(TAKING).await["kind"], "");
    let fit = json!({ "kind": "accelerometer", "vehicle": "iris-1" }).to_string();
    let answer = ground.request("POST", "/api/v1/calibrations", &fit).await;
    assert!(answer.status == 404 && answer.error().contains("no samples are taken"), "{}", answer.error());
    // WHEN it is armed, or no such sensor, or no such vehicle THEN none are taken
    agent.say(Topic::Status, 0, &status(true, agent.time_us)).await;
    ground.wait_json("/api/v1/vehicles", |all| all[0]["armed"] == true).await;
    let answer = begin("accelerometer").await;
    assert!(answer.status == 409 && answer.error().contains("disarm it first"), "{}", answer.text());
    agent.say(Topic::Status, 0, &status(false, agent.time_us)).await;
    ground.wait_json("/api/v1/vehicles", |all| all[0]["armed"] == false).await;
    assert!(begin("thrust").await.error().contains("thrust is not calibrated by hand"));
    assert!(begin("soup").await.error().contains("soup"));
    let answer = ground.request("POST", TAKING, r#"{"kind":"accelerometer","imu":9}"#).await;
    assert!(answer.error().contains("imu 9 is not 1 to"), "{}", answer.error());
    let nobody = ground.request("POST", "/api/v1/vehicles/nobody/calibration", r#"{"kind":"gyroscope"}"#).await;
    assert_eq!((nobody.status, ground.get("/api/v1/vehicles/nobody/calibration").await.status), (404, 404));
    // WHEN it is put on each of its sides and on one in between THEN each counts, and what came before does not
    let begun = begin("accelerometer").await;
    assert_eq!((begun.status, begun.json()["samples"].as_u64()), (200, Some(0)), "{}", begun.text());
    let poses =
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
    for (n, up) in poses.into_iter().chain([[1.0, 1.0, 1.0]]).enumerate() {
        hold(&mut agent, up).await;
        let taken = ground.wait_json(TAKING, |taken| taken["samples"] == 200 * (n as u64 + 1)).await;
        assert_eq!((taken["poses"].as_array().unwrap().len(), taken["still"].as_f64()), (n + 1, Some(1.0)), "{taken}");
        assert_eq!((taken["aims"][0]["found"].as_u64(), &taken["problem"]), (Some(n as u64 + 1), &json!("")));
        assert_eq!(taken["ready"], n == 6, "{taken}");
    }
    // WHEN it is armed meanwhile THEN that is said, and its samples are passed over
    agent.say(Topic::Status, 0, &status(true, agent.time_us)).await;
    ground.wait_json("/api/v1/vehicles", |all| all[0]["armed"] == true).await;
    hold(&mut agent, [1.0, -1.0, 1.0]).await;
    let taken = ground.wait_json(TAKING, |taken| taken["problem"] != "").await;
    assert_eq!((&taken["samples"], &taken["problem"]), (&json!(1400), &json!("the vehicle is armed: disarm it first")));
    // THEN the fit is of what was taken
    let made = ground.request("POST", "/api/v1/calibrations", &fit).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let made = made.json();
    assert_eq!((&made["input"], &made["sensor"], &made["samples"]), (&json!("iris-1, by hand"), &json!(1), &json!(7)));
    assert!((made["parameters"][0]["value"].as_f64().unwrap() - 1.0).abs() < 0.01);
    let other = json!({ "kind": "magnetometer", "vehicle": "iris-1" }).to_string();
    let answer = ground.request("POST", "/api/v1/calibrations", &other).await;
    assert!(answer.error().contains("for accelerometer, not for magnetometer"), "{}", answer.error());
    // WHEN it is put to use THEN the vehicle is given the file; what a picture is drawn of stays here
    let id = made["id"].as_str().unwrap();
    let using = json!({ "calibration": id }).to_string();
    let uses = "/api/v1/vehicles/iris-1/calibrations";
    let (answer, command) = tokio::join!(ground.request("POST", uses, &using), agent.accept());
    assert_eq!(answer.status, 200, "{}", answer.text());
    let Some(Body::UseCalibration(sent)) = command.body else { panic!("{:?}", command.body) };
    let file = CalibrationFile::from_json(&sent.file).unwrap();
    assert_eq!((file.kind, file.sensor, file.picture.len()), (Kind::Accelerometer, Some(1), 0));
    let answer = ground.request("POST", uses, r#"{"calibration":"../x"}"#).await;
    assert!(answer.status == 404 && answer.error().contains("../x"), "{}", answer.text());
    // WHEN it says that it flies with it THEN no samples are taken on top of it
    agent.say(Topic::Status, 0, &status(false, agent.time_us)).await;
    ground.wait_json("/api/v1/vehicles", |all| all[0]["armed"] == false).await;
    let used = v1::CalibrationInUse { kind: "accelerometer".into(), imu: 1, date: "then".into(), ..Default::default() };
    agent.say(Topic::Description, 0, &v1::Description { calibrations: vec![used], ..Default::default() }).await;
    ground.wait_json("/api/v1/vehicles", |all| all[0]["rig"] != "strings").await;
    let answer = begin("accelerometer").await;
    assert!(answer.status == 409 && answer.error().contains("of then: stop using that first"), "{}", answer.text());
    let one = format!("{uses}/accelerometer/1");
    let (answer, command) = tokio::join!(ground.request("DELETE", &one, ""), agent.accept());
    assert_eq!(answer.status, 200, "{}", answer.text());
    let drop = v1::DropCalibration { kind: "accelerometer".into(), imu: 1 };
    assert_eq!(command.body, Some(Body::DropCalibration(drop)));
    let answer = ground.request("DELETE", &format!("{uses}/soup/1"), "").await;
    assert!(answer.status == 422 && answer.error().contains("soup"), "{}", answer.text());
    // WHEN its link is lost THEN that is said; WHEN it is given up THEN nothing is left
    agent.disconnect().await;
    ground.wait_json(TAKING, |taken| taken["problem"].as_str().unwrap().contains("link")).await;
    assert_eq!(ground.request("DELETE", TAKING, "").await.status, 204);
    assert_eq!(ground.json(TAKING).await["kind"], "");
    ground.stop().await;
}

//! Calibrations over HTTP: from an uploaded table, from a flight, refused with the reason, kept.

use crate::common::Ground;
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
        (json!({ "kind": "thrust" }), 422, "one of flight and csv"),
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

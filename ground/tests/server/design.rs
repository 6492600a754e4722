//! Designs over HTTP: previews by the agent's library, export and import, the way back, paths.

use crate::common::Ground;
use plumbline_proto::v1::{self, command::Body};
use serde_json::Value;

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_needs_no_vehicle_and_refuses_with_the_value() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let path = "/api/v1/design/preview";
    let answer = ground.request("POST", path, r#"{"controller":"lqr","duration_s":2}"#).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let preview = answer.json();
    assert_eq!(preview["accepted"], true, "{}", preview["refusal"]);
    assert_eq!(preview["steps"].as_array().unwrap().len(), 4);
    assert!(preview["position"]["margins"][0]["phase_rad"].as_f64().unwrap() > 0.2);
    for (body, mentions) in [
        (r#"{"controller":"magic"}"#, "magic"),
        (r#"{"tick_rate_hz":1e999}"#, "out of range"),
        (r#"{"state_weight":[1],"input_weight":[1,1,1,1]}"#, "1 values"),
        (r#"{"colour":1}"#, "colour"),
        ("[]", "object"),
        ("{", "EOF"),
    ] {
        let answer = ground.request("POST", path, body).await;
        assert_eq!(answer.status, 422, "{body}: {}", answer.text());
        assert!(answer.error().contains(mentions), "{body}: {}", answer.error());
    }
    assert_eq!(ground.request("POST", "/api/v1/design/preview?vehicle=nobody", "{}").await.status, 404);
    let controllers = ground.json("/api/v1/design/controllers?airframe=clinic").await;
    assert!(controllers["controllers"].as_array().unwrap().iter().any(|c| c["controller"] == "pid"));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn gains_travel_as_files_and_the_way_back_is_one_request() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let preview = ground.request("POST", "/api/v1/design/preview", r#"{"duration_s":1}"#).await.json();
    let file = preview["gains"].to_string();
    let push = "/api/v1/vehicles/iris-1/gains";
    let pid = r#"{"controller":"pid","parameters":{"tilt_p":6.5}}"#;
    for body in [file.as_str(), pid] {
        let (answer, command) = tokio::join!(ground.request("PUT", push, body), agent.accept());
        assert_eq!(answer.status, 200, "{}", answer.text());
        assert!(matches!(command.body, Some(Body::PushGains(_))));
    }
    let kept: Value = ground.json("/api/v1/vehicles/iris-1/gains/export?revision=1").await;
    assert_eq!(kept["controller"], "lqr_integral");
    assert!(kept["certificate"].is_null() && kept["state_weight"].is_array());
    let revert = "/api/v1/vehicles/iris-1/gains/revert";
    let (answer, command) = tokio::join!(ground.request("POST", revert, r#"{"revision":2}"#), agent.accept());
    assert_eq!(answer.json()["revision"], 3);
    let Some(Body::PushGains(again)) = command.body else { panic!("{command:?}") };
    assert_eq!((again.revision, again.controller()), (3, v1::ControllerKind::Pid));
    assert_eq!(again.parameters, [v1::Parameter { name: "tilt_p".into(), value: 6.5 }]);
    assert_eq!(ground.request("POST", revert, r#"{"revision":9}"#).await.status, 404);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn paths_reach_the_agent_or_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let path = "/api/v1/vehicles/iris-1/trajectory";
    let body = r#"{"shape":"circle","size_m":1,"period_s":10}"#;
    let (answer, command) = tokio::join!(ground.request("POST", path, body), agent.accept());
    assert_eq!(answer.status, 200, "{}", answer.text());
    let circle = v1::SetTrajectory { shape: 1, size_m: 1.0, period_s: 10.0, ..Default::default() };
    assert_eq!(command.body, Some(Body::SetTrajectory(circle)));
    let (answer, command) = tokio::join!(ground.request("DELETE", path, ""), agent.accept());
    assert_eq!((answer.status, command.body), (200, Some(Body::SetTrajectory(v1::SetTrajectory::default()))));
    for (body, mentions) in [
        (r#"{"shape":"spiral"}"#, "spiral"),
        (r#"{"shape":"unspecified"}"#, "unspecified"),
        (r#"{"shape":"circle","size_m":1}"#, "needs period_s"),
        (r#"{"shape":"altitudes","hold_s":5}"#, "needs altitude_m"),
        (r#"{"shape":"circle","size_m":1,"period_s":9,"speed_mps":1}"#, "has no speed_mps"),
    ] {
        let answer = ground.request("POST", path, body).await;
        assert_eq!(answer.status, 422, "{}", answer.text());
        assert!(answer.error().contains(mentions), "{body}: {}", answer.error());
    }
    ground.stop().await;
}

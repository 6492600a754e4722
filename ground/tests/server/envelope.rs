//! The attack envelope over HTTP.

use crate::common::Ground;
use plumbline_proto::Kind;
use plumbline_proto::v1;
use serde_json::Value;

#[tokio::test(flavor = "multi_thread")]
async fn a_set_is_answered_once_and_what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let path = "/api/v1/envelope";
    let body = r#"{"sensors":["height 2"],"horizon_s":5}"#;
    let answer = ground.request("POST", path, body).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let first = answer.json();
    let bound = first["sets"][0]["altitude_m"].as_f64().unwrap();
    assert!((0.01..0.05).contains(&bound) && first["suite"] == "string_rig", "{first}");
    // The time it took says that it was not solved again.
    assert_eq!(ground.request("POST", path, body).await.json(), first);
    assert!(first["sets"][0]["certificate"].is_null() && first["sets"][0]["climb_mps"].is_null(), "{first}");
    let proved = r#"{"sensors":["height 2"],"horizon_s":5,"climb":true,"proof":true}"#;
    let proved = ground.request("POST", path, proved).await.json();
    let (set, certificate) = (&proved["sets"][0], &proved["sets"][0]["certificate"]);
    assert_eq!(set["altitude_m"].as_f64(), Some(bound));
    let held = certificate["multipliers"].as_array().unwrap().iter();
    let held = held.map(|one| one["multiplier"].as_f64().unwrap().abs() * one["limit"].as_f64().unwrap());
    let sum = held.sum::<f64>() + certificate["added_m"].as_f64().unwrap();
    assert!((sum / bound - 1.0).abs() < 1e-9 && set["climb_mps"].as_f64().unwrap() > 0.0, "{sum} {set}");
    assert_eq!(
        (&set["attack"][0]["sensor"], set["attack"][0]["values"].as_array().unwrap().len()),
        (&"height 2".into(), 50)
    );
    let unstable = format!(r#"{{"design":{{"k":{k},"k_attitude":{k}}}}}"#, k = pushing_away());
    for (body, named) in [
        (r#"{"sensors":["height 9"]}"#, "sensor height 9 is not one that this loop uses: height 1, "),
        (r#"{"most":12}"#, "a set of 12 sensors: this loop uses 7"),
        (r#"{"suite":"moon"}"#, "moon"),
        (r#"{"more":"sonar"}"#, "it must be height, imu, gnss or pose"),
        (r#"{"without":["height 7"]}"#, "sensor height 7 is not one that this loop uses"),
        (
            r#"{"without":["imu 1","imu 2","imu 3","imu 4"]}"#,
            "heights or IMUs that are not excluded is 0, it must be at least 1",
        ),
        (r#"{"proof":true}"#, "proof is true, it is told of one set of `sensors` along z"),
        (r#"{"colour":1}"#, "colour"),
        (r#"{"horizon_s":0.1}"#, "horizon_s is 0.1"),
        (r#"{"design":{"controller":"magic"}}"#, "magic"),
        (unstable.as_str(), "these gains do not stabilise: the slowest pole is at +"),
    ] {
        let answer = ground.request("POST", path, body).await;
        assert_eq!(answer.status, 422, "{body}: {}", answer.text());
        assert!(answer.error().contains(named), "{body}: {}", answer.error());
    }
    // Fewer are left to contradict it, or one more.
    let of = |more: &str| format!(r#"{{"sensors":["height 1"],"horizon_s":5{more}}}"#);
    let mut bounds = Vec::new();
    for more in ["", r#","without":["height 2"]"#, r#","more":"height""#] {
        let answer = ground.request("POST", path, &of(more)).await;
        assert_eq!(answer.status, 200, "{more}: {}", answer.text());
        bounds.push(answer.json()["sets"][0]["altitude_m"].as_f64().unwrap());
    }
    assert!(bounds[1] > 1.1 * bounds[0] && bounds[2] < bounds[0], "{bounds:?}");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_attack_is_prepared_and_judged_and_what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let path = "/api/v1/envelope/attack";
    let body = r#"{"generator":"optimal","of":{"sensors":["height 2"],"horizon_s":5},"start_s":3}"#;
    let prepared = ground.request("POST", path, body).await;
    assert_eq!(prepared.status, 200, "{}", prepared.text());
    let prepared = prepared.json();
    let attack = &prepared["attacks"][0];
    assert_eq!((attack["sequence"].as_array().unwrap().len(), &attack["start_s"]), (50, &serde_json::json!(3.0)));
    // Judged as it is, it is as expected as when it was prepared.
    let again = serde_json::json!({ "attacks": prepared["attacks"], "of": { "horizon_s": 5 } }).to_string();
    let again = ground.request("POST", path, &again).await.json();
    assert_eq!((&again["probability"], &again["altitude_m"]), (&prepared["probability"], &prepared["altitude_m"]));
    // Along x: of the axis that the attacks are along.
    let aside = r#"{"of":{"more":"pose"},"attacks":[{"sensor":"imu","instance":1,"channel":"accel_x","kind":"bias","start_s":3,"duration_s":4,"magnitude":2}]}"#;
    let aside = ground.request("POST", path, aside).await.json();
    assert!(aside["probability"].as_f64() == Some(1.0) && aside["altitude_m"].is_null(), "{aside}");
    assert!((0.01..0.05).contains(&aside["tilt_rad"].as_f64().unwrap()), "{aside}");
    for (body, named) in [
        (
            r#"{"generator":"stealthy_bias","of":{"axis":"x","more":"pose","sensors":["height 2"]}}"#,
            "sensor height 2 is not one that this loop uses: imu 1, ",
        ),
        (r#"{"generator":"covert","of":{"axis":"y","more":"pose","sensors":["imu 1"]}}"#, "leave out imu 2, imu 3"),
        (r#"{"generator":"magic","of":{"sensors":["height 2"]}}"#, "magic"),
        (r#"{"generator":"optimal"}"#, "sensors"),
        (r#"{"generator":"covert","accel_mps2":99,"of":{"sensors":["height 2"]}}"#, "accel_mps2 is 99"),
    ] {
        let answer = ground.request("POST", path, body).await;
        assert_eq!(answer.status, 422, "{body}: {}", answer.text());
        assert!(answer.error().contains(named), "{body}: {}", answer.error());
    }
    ground.stop().await;
}

/// 4 rows of 16 that leave a setpoint the faster the further it is.
fn pushing_away() -> Value {
    let mut k = vec![vec![0.0; 16]; 4];
    k[0][2] = -50.0;
    serde_json::json!(k)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vehicle_has_the_envelope_of_its_own_sensors_and_gains() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let path = "/api/v1/vehicles/iris-1/envelope";
    ground.wait_json("/api/v1/vehicles", |v| v[0]["id"] == "iris-1").await;
    let early = ground.get(path).await;
    assert!(early.status == 404 && early.error().contains("has not told its sensors yet"), "{}", early.text());
    assert_eq!(ground.get("/api/v1/vehicles/nobody/envelope").await.status, 404);
    let description = v1::Description {
        agent_id: "iris-1".into(),
        airframe: "iris".into(),
        rig: "strings".into(),
        tick_rate_hz: 200.0,
        scenario: "name = \"five\"\n[suite]\npreset = \"clinic\"\n".into(),
        ..Default::default()
    };
    agent.say(Kind::Description, 0, &description).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let envelope = ground.json(path).await;
    assert_eq!((&envelope["suite"], &envelope["airframe"]), (&"iris-1".into(), &"iris".into()));
    let sets = envelope["sets"].as_array().unwrap();
    assert_eq!(sets.len(), 6 + 15, "no set of all heights more, two heights and four IMUs: {envelope}");
    let of = |envelope: &Value, names: &[&str]| {
        envelope["sets"]
            .as_array()
            .unwrap()
            .iter()
            .find(|set| set["sensors"] == serde_json::json!(names))
            .unwrap()
            .clone()
    };
    // Nothing is left that could contradict them.
    assert!(of(&envelope, &["height 1", "height 2"])["drift_mps"].as_f64().unwrap() > 0.01);
    assert!(of(&envelope, &["imu 3"])["altitude_m"].as_f64().unwrap() > 0.001);
    // Others' gains are another question.
    let softer = r#"{"design":{"controller":"pid"},"sensors":["imu 3"]}"#;
    let softer = ground.request("POST", "/api/v1/envelope?vehicle=iris-1", softer).await;
    assert_eq!(softer.status, 200, "{}", softer.text());
    let (old, new) = (of(&envelope, &["imu 3"]), of(&softer.json(), &["imu 3"]));
    assert!(
        (new["altitude_m"].as_f64().unwrap() / old["altitude_m"].as_f64().unwrap() - 1.0).abs() > 0.01,
        "{old} {new}"
    );
    ground.stop().await;
}

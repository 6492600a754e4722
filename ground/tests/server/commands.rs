//! Commands over HTTP: answers, rejections, silence, leases, invalid input.

use crate::common::Ground;
use plumbline_proto::v1::{self, command::Body};
use plumbline_proto::{Kind, v1::AckStage};

const ANN: [(&str, &str); 1] = [("x-plumbline-operator", "ann")];
const BOB: [(&str, &str); 1] = [("x-plumbline-operator", "bob")];

#[tokio::test(flavor = "multi_thread")]
async fn a_command_is_numbered_sent_and_answered() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;

    let path = "/api/v1/vehicles/iris-1/setpoint";
    let (answer, command) =
        tokio::join!(ground.request_as("POST", path, r#"{"altitude_m":0.8}"#, &ANN), agent.accept());
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert_eq!(answer.json()["stage"], "accepted");
    assert_eq!(answer.json()["command_id"], command.command_id);
    assert_eq!(answer.json()["reason"], "done");
    assert_eq!(command.operator, "ann");
    let setpoint = v1::Setpoint { altitude_m: Some(0.8), ..Default::default() };
    assert_eq!(command.body, Some(Body::Setpoint(setpoint)));

    let refuse = async {
        let command = agent.command().await;
        assert_eq!(command.body, Some(Body::Arm(v1::Arm {})));
        agent.ack(command.command_id, AckStage::Rejected, "battery 9.9 V below 10.5 V").await;
    };
    let (answer, ()) = tokio::join!(ground.request_as("POST", "/api/v1/vehicles/iris-1/arm", "{}", &ANN), refuse);
    assert_eq!(answer.status, 409);
    assert_eq!(answer.json()["code"], "rejected");
    assert!(answer.json()["command_id"].as_u64() > Some(command.command_id));
    assert_eq!(answer.error(), "battery 9.9 V below 10.5 V");
    ground.stop().await;
}

/// GIVEN a page that tells what its operator saw WHEN it commands THEN the agent hears it; an odd header is refused with
/// its value, and never takes the cut away.
#[tokio::test(flavor = "multi_thread")]
async fn what_the_operator_saw_goes_with_the_command() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let seen = |seen| [ANN[0], ("x-plumbline-seen", seen)];
    let (arm, cut) = ("/api/v1/vehicles/iris-1/arm", "/api/v1/vehicles/iris-1/cut");

    let headers = seen("5000000");
    let (answer, command) = tokio::join!(ground.request_as("POST", arm, "{}", &headers), agent.accept());
    assert_eq!((answer.status, command.seen_us), (200, Some(5_000_000)));

    let headers = seen("yesterday");
    let refused = ground.request_as("POST", arm, "{}", &headers).await;
    assert_eq!(refused.status, 422);
    assert!(refused.error().contains("yesterday"), "{}", refused.error());
    assert!(agent.outgoing.try_recv().is_err(), "it reached the agent");
    let (answer, command) = tokio::join!(ground.request_as("POST", cut, "{}", &headers), agent.accept());
    assert_eq!((answer.status, command.body), (200, Some(Body::CutMotors(v1::CutMotors {}))));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_command_reaches_the_agent_as_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let weights = format!(r#"{{"state_weight":{:?},"input_weight":{:?}}}"#, [1.0; 16], [0.5; 4]);
    let plan =
        r#"{"attacks":[{"sensor":"height","instance":2,"kind":"bias","start_s":5,"duration_s":10,"magnitude":0.5}]}"#;
    let attack = v1::Attack {
        id: 1,
        sensor: v1::SensorKind::Height as i32,
        instance: 2,
        kind: v1::AttackKind::Bias as i32,
        start_s: 5.0,
        duration_s: 10.0,
        magnitude: 0.5,
        ..Default::default()
    };
    let lqr = v1::LqrWeights { state_weight: vec![1.0; 16], input_weight: vec![0.5; 4] };
    let expected = [
        ("POST", "disarm", "", Body::Disarm(v1::Disarm {})),
        ("POST", "cut", "{}", Body::CutMotors(v1::CutMotors {})),
        ("POST", "release-cut", "{}", Body::ReleaseCut(v1::ReleaseCut {})),
        (
            "POST",
            "simulator",
            r#"{"battery":true}"#,
            Body::SetSimulator(v1::SetSimulator { new_battery: true, reset: false }),
        ),
        ("POST", "mode", r#"{"mode":"altitude_hold"}"#, Body::SetMode(v1::SetMode { mode: 3 })),
        (
            "POST",
            "estimator",
            r#"{"estimator":"ekf_bias"}"#,
            Body::SelectEstimator(v1::SelectEstimator { estimator: 1 }),
        ),
        ("POST", "decoder", r#"{"decoder":"l1_split"}"#, Body::SelectDecoder(v1::SelectDecoder { decoder: 4 })),
        ("POST", "recording", r#"{"on":true}"#, Body::SetRecording(v1::SetRecording { on: true })),
        ("POST", "replay", r#"{"speed":0.0,"step":3}"#, Body::SetReplay(v1::SetReplay { speed: 0.0, step: 3 })),
        (
            "PUT",
            "attacks",
            plan,
            Body::AttackSchedule(v1::AttackSchedule { schedule_id: 1, attacks: vec![attack], ..Default::default() }),
        ),
        ("DELETE", "attacks", "", Body::AbortAttacks(v1::AbortAttacks {})),
        (
            "PUT",
            "gains",
            &weights,
            Body::PushGains(v1::PushGains {
                revision: 1,
                weights: Some(lqr),
                controller: v1::ControllerKind::LqrIntegral as i32,
                ..Default::default()
            }),
        ),
    ];
    for (method, resource, body, wanted) in expected {
        let path = format!("/api/v1/vehicles/iris-1/{resource}");
        let (answer, command) = tokio::join!(ground.request(method, &path, body), agent.accept());
        assert_eq!(answer.status, 200, "{resource}: {}", answer.text());
        assert_eq!(command.body, Some(wanted), "{resource}");
    }
    let gains = ground.json("/api/v1/vehicles/iris-1/gains").await;
    assert_eq!(gains["revisions"][0]["stage"], "accepted");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn silence_is_504_and_a_lost_link_503() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = plumbline_ground::GroundConfig::new(folder.path());
    config.command_timeout = std::time::Duration::from_millis(100);
    let ground = Ground::start_with(config).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let answer = ground.request("POST", "/api/v1/vehicles/iris-1/arm", "{}").await;
    assert_eq!(answer.status, 504, "{}", answer.text());
    agent.disconnect().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == false).await;
    assert_eq!(ground.request("POST", "/api/v1/vehicles/iris-1/arm", "{}").await.status, 503);
    let unknown = ground.request("POST", "/api/v1/vehicles/nobody/arm", "{}").await;
    assert_eq!((unknown.status, unknown.error().as_str()), (404, "vehicle \"nobody\" is not known"));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_operator_controls_anyone_cuts_and_control_can_be_taken() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let mut viewer = ground.view("iris-1", 0).await;
    let arm = "/api/v1/vehicles/iris-1/arm";
    let (answer, _) = tokio::join!(ground.request_as("POST", arm, "{}", &ANN), agent.accept());
    assert_eq!(answer.status, 200);
    assert_eq!(viewer.next_of(Kind::Lease).await.message::<v1::ControlLease>().holder, "ann");

    let answer = ground.request_as("POST", arm, "{}", &BOB).await;
    assert_eq!((answer.status, answer.error().as_str()), (423, "operator \"ann\" holds control"));
    let (answer, command) =
        tokio::join!(ground.request_as("POST", "/api/v1/vehicles/iris-1/cut", "{}", &BOB), agent.accept());
    assert_eq!(answer.status, 200, "the cut is open to everyone");
    assert_eq!(command.body, Some(Body::CutMotors(v1::CutMotors {})));
    assert_eq!(ground.json("/api/v1/vehicles/iris-1/lease").await["holder"], "ann", "and takes no control");

    let answer = ground.request_as("DELETE", "/api/v1/vehicles/iris-1/lease", "", &BOB).await;
    assert_eq!(answer.status, 423);
    let answer = ground.request_as("PUT", "/api/v1/vehicles/iris-1/lease", "{}", &BOB).await;
    assert_eq!((answer.status, answer.json()["taken_from"].as_str()), (200, Some("ann")));
    assert_eq!(viewer.next_of(Kind::Lease).await.message::<v1::ControlLease>().holder, "bob");
    assert_eq!(ground.request_as("POST", arm, "{}", &ANN).await.status, 423);
    let answer = ground.request_as("DELETE", "/api/v1/vehicles/iris-1/lease", "", &BOB).await;
    assert_eq!(answer.status, 200);
    let mut late = ground.view("iris-1", 0).await;
    assert_eq!(late.next_of(Kind::Lease).await.message::<v1::ControlLease>().holder, "", "late viewers see it too");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_invalid_is_refused_with_its_value() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let big = format!(r#"{{"mode":"{}"}}"#, "x".repeat(300 << 10));
    let cases = [
        ("POST", "mode", r#"{"mode":"hover"}"#, 422, "\"hover\""),
        ("POST", "mode", r#"{"mode":"cut"}"#, 422, "\"cut\""),
        ("POST", "mode", "{", 422, "EOF"),
        ("POST", "mode", &big, 413, "262144"),
        ("POST", "setpoint", r#"{"altitude_m":null}"#, 422, "null"),
        ("POST", "setpoint", r#"{"altitude_m":1e999}"#, 422, "out of range"),
        ("POST", "setpoint", r#"{"altitude":1}"#, 422, "altitude"),
        ("POST", "setpoint", "{}", 422, "no field"),
        ("POST", "replay", r#"{"speed":-1}"#, 422, "-1"),
        ("POST", "estimator", r#"{"estimator":"psychic"}"#, 422, "\"psychic\""),
        ("POST", "decoder", r#"{"decoder":"l3"}"#, 422, "\"l3\""),
        ("PUT", "attacks", r#"{"attacks":[]}"#, 422, "no attack"),
        (
            "PUT",
            "attacks",
            r#"{"attacks":[{"sensor":"height","instance":9,"kind":"bias","start_s":0,"duration_s":1}]}"#,
            422,
            "no height 9",
        ),
        ("PUT", "gains", r#"{"state_weight":[1],"input_weight":[1,1,1,1]}"#, 422, "1 values"),
        ("GET", "arm", "", 405, "GET"),
        ("POST", "dance", "{}", 404, "dance"),
    ];
    for (method, resource, body, status, mentions) in cases {
        let answer = ground.request(method, &format!("/api/v1/vehicles/iris-1/{resource}"), body).await;
        assert_eq!(answer.status, status, "{resource} {}", answer.text());
        assert!(answer.error().contains(mentions), "{resource}: {}", answer.error());
    }
    let long = "x".repeat(65);
    let answer =
        ground.request_as("POST", "/api/v1/vehicles/iris-1/arm", "{}", &[("x-plumbline-operator", &long)]).await;
    assert_eq!(answer.status, 422);
    assert!(agent.outgoing.try_recv().is_err(), "nothing invalid reached the agent");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cut_is_done_whatever_the_operator_is_called() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let long = "x".repeat(65);
    let names = [(long.as_str(), "unnamed"), ("", "unnamed"), ("Zo\u{eb}", "unnamed"), ("ann", "ann")];
    for (name, heard) in names {
        let header = [("x-plumbline-operator", name)];
        let cut = ground.request_as("POST", "/api/v1/vehicles/iris-1/cut", "", &header);
        let (answer, command) = tokio::join!(cut, agent.accept());
        assert_eq!(answer.status, 200, "{name:?}: {}", answer.text());
        assert_eq!((command.body, command.operator.as_str()), (Some(Body::CutMotors(v1::CutMotors {})), heard));
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_agents_are_two_vehicles() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut one = ground.agent("one", 1).await;
    let mut two = ground.agent("two", 2).await;
    one.describe().await;
    two.describe().await;
    let both = ground.wait_json("/api/v1/vehicles", |v| v[1]["rig"] == "strings").await;
    assert_eq!((both[0]["id"].as_str(), both[1]["boot_id"].as_u64()), (Some("one"), Some(2)));
    let (answer, command) = tokio::join!(ground.request("POST", "/api/v1/vehicles/two/arm", "{}"), two.accept());
    assert_eq!((answer.status, command.body), (200, Some(Body::Arm(v1::Arm {}))));
    assert!(one.outgoing.try_recv().is_err());
    let mut viewer = ground.view("one", 0).await;
    let ticks = two.tick();
    two.send(ticks, false).await;
    let ticks = one.tick();
    one.send(ticks, false).await;
    assert_eq!(viewer.next_of(Kind::Control).await.sequence, 2, "the control of one, not of two");
    ground.stop().await;
}
